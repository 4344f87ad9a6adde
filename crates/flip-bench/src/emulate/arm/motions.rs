//! The worker of an emulated arm: one thread carries out motions in order, in bench time, and lets
//! powder fall on the way.

use super::body::{Asked, Brake, End};
use super::desk::{Desk, Robot, Why};
use super::fault::{FACTOR_MAX, Fault};
use super::{Event, Laboratory};
use crate::hardware::arm::proto::{Executed, Station};
use crate::hardware::waypoints::Stroke;
use flip_core::domain::bench::Action;
use flip_core::domain::motion::Move;
use std::sync::Arc;

/// Bench time between two checks of the brake, s; poses are as fresh.
const SLICE_S: f64 = 0.01;

/// Outcome of a motion.
#[derive(Debug, Clone, Copy, Default)]
struct Done {
    amplitude_mm: f64,
    peak_speed_m_s: f64,
    duration_s: f64,
    poured_mg: f64,
}

/// The emulated robot.
pub(super) struct Emulated(pub Arc<Laboratory>);

impl Robot for Emulated {
    fn carry_out(
        &mut self,
        asked: Asked,
        why: Why,
        brake: &Brake,
        desk: &Desk,
    ) -> Result<Executed, End> {
        let hand = Hand { lab: &self.0, desk, brake };
        hand.lab.clock().wait_s(hand.lab.settings.reply_s);
        let mut done = Done::default();
        let outcome = hand.carry_out(asked, &mut done);
        let Done { amplitude_mm, peak_speed_m_s, duration_s, poured_mg } = done;
        let (at_s, pitch_deg) = (hand.lab.clock().now_s(), desk.pose().0);
        let ended = outcome.err();
        self.0.write(Event { at_s, motion: asked, why, ended, pitch_deg, amplitude_mm, poured_mg });
        outcome.map(|()| Executed {
            sequence: 0,
            amplitude_mm,
            peak_speed_m_s,
            duration_s,
            pitch_deg,
        })
    }
}

/// One motion in progress.
struct Hand<'a> {
    lab: &'a Laboratory,
    desk: &'a Desk,
    brake: &'a Brake,
}

impl Hand<'_> {
    fn carry_out(&self, asked: Asked, done: &mut Done) -> Result<(), End> {
        let settings = &self.lab.settings;
        match asked {
            Asked::Approach if self.desk.station() == Station::OverVial => Ok(()),
            Asked::Approach => self.travel(settings.approach_s, Station::OverVial, done),
            Asked::Retract => {
                self.turn(0.0, done)?;
                if self.desk.station() == Station::Retracted {
                    return Ok(());
                }
                self.travel(settings.retract_s, Station::Retracted, done)
            }
            Asked::Pitch(deg) => self.turn(deg, done),
            Asked::Shake(mm) => self.shake(mm, done),
            Asked::Scoop => {
                self.turn(0.0, done)?;
                self.at_container(settings.scoop_s, done)?;
                self.lab.spoon().refill();
                Ok(())
            }
            Asked::Discard => {
                self.turn(0.0, done)?;
                self.at_container(settings.discard_s, done)?;
                self.lab.spoon().empty();
                Ok(())
            }
            Asked::Invert => self.at_container(settings.invert_s, done),
        }
    }

    /// A motion away from the vial, where the spoon's own pose does not matter.
    fn at_container(&self, duration_s: f64, done: &mut Done) -> Result<(), End> {
        let (pitch_deg, _) = self.desk.pose();
        self.play(duration_s, 0.0, done, |_| (pitch_deg, 0.0))
    }

    fn travel(&self, duration_s: f64, to: Station, done: &mut Done) -> Result<(), End> {
        self.desk.arrive(Station::Between);
        let (pitch_deg, displacement_mm) = self.desk.pose();
        self.play(duration_s, 0.0, done, |t| {
            (pitch_deg, displacement_mm * (1.0 - t / duration_s).max(0.0))
        })?;
        self.desk.rest(pitch_deg, 0.0);
        self.desk.arrive(to);
        Ok(())
    }

    /// Turn to this pitch; an interrupted stroke is brought back at the same time.
    fn turn(&self, to_deg: f64, done: &mut Done) -> Result<(), End> {
        let (from_deg, displacement_mm) = self.desk.pose();
        if to_deg == from_deg && displacement_mm == 0.0 {
            return Ok(());
        }
        if to_deg == 0.0 && self.desk.locked().has(Fault::LevelFails) {
            return Err(End::LevelFails);
        }
        let turn = Move::new((to_deg - from_deg).abs(), self.lab.settings.turn.into());
        let duration_s = turn.duration_s().max(SLICE_S);
        let mass_mg = self.let_fall(Action::once(to_deg - from_deg, 0.0));
        let ended = self.play(duration_s, mass_mg, done, |t| {
            let pitch_deg = from_deg + (to_deg - from_deg).signum() * turn.position_m(t);
            (pitch_deg, displacement_mm * (1.0 - t / duration_s).max(0.0))
        });
        if ended.is_err() {
            // The spoon model was stepped by the whole turn: bring it to where the turn ended.
            let back = self.desk.pose().0 - to_deg;
            let mass_mg = self.let_fall(Action::once(back, 0.0));
            self.lab.spoon().keep(mass_mg);
            return ended;
        }
        self.desk.rest(to_deg, 0.0);
        Ok(())
    }

    fn shake(&self, commanded_mm: f64, done: &mut Done) -> Result<(), End> {
        let settings = &self.lab.settings;
        let factor = self.desk.locked().faults.iter().find_map(|fault| match fault {
            Fault::ShakeTooLarge(factor) => Some(factor.clamp(1.0, FACTOR_MAX)),
            _ => None,
        });
        let executed_mm = settings.executed_mm(commanded_mm) * factor.unwrap_or(1.0);
        if executed_mm == 0.0 {
            return Ok(());
        }
        let stroke = Stroke::new(executed_mm * 1e-3, settings.executed());
        let (pitch_deg, _) = self.desk.pose();
        let mass_mg = self.let_fall(Action::once(0.0, executed_mm));
        let mut furthest_mm = 0.0f64;
        let ended = self.play(stroke.duration_s(), mass_mg, done, |t| {
            let displacement_mm = stroke.at(t).position * 1e3;
            furthest_mm = furthest_mm.max(displacement_mm);
            (pitch_deg, displacement_mm)
        });
        // A completed stroke turned round between two checks.
        done.amplitude_mm = if ended.is_ok() { executed_mm } else { furthest_mm };
        done.peak_speed_m_s = stroke.top_m_s();
        if ended.is_ok() {
            self.desk.rest(pitch_deg, 0.0);
        }
        ended
    }

    /// The mass that the spoon model releases for this action, mg. The simulator may take some
    /// time, during which bench time stands still.
    fn let_fall(&self, action: Action) -> f64 {
        self.lab.spoon().step(action).mass_mg
    }

    /// Let a motion take its time, with powder falling evenly while the spoon is over the vial;
    /// elsewhere it falls into the container. Powder that would have fallen after the end stays in
    /// the spoon.
    fn play(
        &self,
        duration_s: f64,
        mass_mg: f64,
        done: &mut Done,
        mut pose: impl FnMut(f64) -> (f64, f64),
    ) -> Result<(), End> {
        let slices = (duration_s / SLICE_S).ceil().max(1.0);
        let slice_s = duration_s / slices;
        let mut fallen_mg = 0.0;
        for k in 0..slices as u32 {
            if let Err(end) =
                self.slice(mass_mg / slices, f64::from(k) >= slices / 2.0, &mut fallen_mg, done)
            {
                self.lab.spoon().keep(mass_mg - fallen_mg);
                return Err(end);
            }
            self.lab.clock().wait_s(slice_s);
            done.duration_s += slice_s;
            if self.brake.get().is_none() {
                let (pitch_deg, displacement_mm) = pose(f64::from(k + 1) * slice_s);
                self.desk.show(pitch_deg, displacement_mm);
            }
        }
        match self.brake.get() {
            Some(end) => Err(*end),
            None => Ok(()),
        }
    }

    /// Begin one slice unless the motion has ended. Brake and powder are updated under the same
    /// lock: once Stop has been answered nothing more falls.
    fn slice(
        &self,
        mass_mg: f64,
        half_way: bool,
        fallen_mg: &mut f64,
        done: &mut Done,
    ) -> Result<(), End> {
        let mut body = self.desk.locked();
        if half_way && body.has(Fault::Reflex) {
            body.faults.retain(|fault| *fault != Fault::Reflex);
            let _ = self.brake.set(End::Reflex);
        }
        if let Some(end) = self.brake.get() {
            return Err(*end);
        }
        *fallen_mg += mass_mg;
        if body.station == Station::OverVial {
            done.poured_mg += mass_mg;
            let pan = &self.lab.pan;
            pan.add_at(pan.clock().now_s() + self.lab.settings.fall_s, mass_mg);
        }
        Ok(())
    }
}
