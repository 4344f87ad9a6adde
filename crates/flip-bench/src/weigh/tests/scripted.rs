//! A bench that follows a script, and records the calls it gets.

use crate::hardware::{Bench, DeviceError};
use flip_core::domain::bench::{Action, Moment, Reach, Reading, Standing, Tare};
use flip_core::domain::rest::Rest;
use std::sync::atomic::{AtomicBool, Ordering};

/// No reading at all.
const NOTHING: Rest = Rest {
    readings: 1,
    at_s: 0.0,
    seconds: 0.0,
    mean_mg: 0.0,
    last_mg: 0.0,
    slope_mg_s: 0.0,
    squares_mg2: 0.0,
    times_s2: 0.0,
    steps: [0.0; 3],
    level: 1.0,
    tilt: 0.0,
    forgotten: 0.0,
};
/// The vial.
const VIAL_MG: f64 = 12_000.0;
/// Two vials of one make differ by this or more.
pub(super) const EXCHANGED_MG: f64 = 40.0;

/// A call of the bench.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Call {
    Stand,
    /// One second of watching the display for its mean.
    Watch,
    Approach,
    Tare,
    Read,
    Life,
    Act,
    Level,
    Retract,
    Discard,
    /// The check that it is the balance that was tared.
    Same,
}

/// A fault.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Fault {
    Silent,
    /// A stop that arrives late ends the motion.
    Ended,
    Panics,
    NotANumber,
    Unstable,
    VialLifted,
    /// The reading jumps up.
    Draught,
    /// The balance restarted and lost the tare.
    Untared,
    /// Another vial, lighter by [`EXCHANGED_MG`].
    Exchanged,
}

/// A display that changes only when the mass changes, or when it is watched.
#[derive(Debug, Clone, Copy)]
pub(super) struct Display {
    pub(super) shown_mg: f64,
    pub(super) lived_s: f64,
    /// It is stuck from this act on.
    pub(super) dies_at: u32,
    /// It shows the mass that had fallen while a shake's yield was still falling, and nothing more
    /// of it later.
    pub(super) is_early: bool,
}

impl Display {
    pub(super) fn dying_at(dies_at: u32) -> Option<Self> {
        Some(Self { shown_mg: 0.0, lived_s: 0.0, dies_at, is_early: false })
    }
}

/// Each shake releases the next of these masses, repeating the last one, unless a fault is active.
pub(super) struct Scripted {
    /// `None`: it always shows the mass, and is always alive.
    pub(super) display: Option<Display>,
    /// Set while the display is being watched for a change.
    pub(super) stops_in_life: Option<&'static AtomicBool>,
    pub(super) fault: Option<(Call, u32, Fault)>,
    pub(super) gives_mg: Vec<f64>,
    /// Falls while the spoon is levelled.
    pub(super) late_mg: f64,
    /// The arm fills its spoon.
    pub(super) refills: bool,
    /// What is left in the spoon, mg, and in a full one; `None`: it never runs out.
    pub(super) spoon_mg: Option<[f64; 2]>,
    /// Every action carried out, and the pitch after it.
    pub(super) actions: Vec<(f64, Action)>,
    pub(super) reach: Reach,
    pub(super) pitch_deg: f64,
    pub(super) mass_mg: f64,
    pub(super) over_the_vial: bool,
    pub(super) calls: Vec<Call>,
    /// Bench time of each call, s.
    pub(super) call_s: f64,
}

impl Scripted {
    pub(super) fn giving(gives_mg: &[f64]) -> Self {
        Self {
            display: None,
            stops_in_life: None,
            fault: None,
            gives_mg: gives_mg.to_vec(),
            late_mg: 0.0,
            refills: false,
            spoon_mg: None,
            actions: Vec::new(),
            reach: Reach::FULL,
            pitch_deg: 0.0,
            mass_mg: 0.0,
            over_the_vial: false,
            calls: Vec::new(),
            call_s: 1.0,
        }
    }

    pub(super) fn with(call: Call, at: u32, fault: Fault) -> Self {
        Self { fault: Some((call, at, fault)), ..Self::giving(&[2.0]) }
    }

    /// Record the call; returns the fault it triggers, if any.
    fn called(&mut self, call: Call) -> Result<Option<Fault>, DeviceError> {
        let nth = self.count(call);
        self.calls.push(call);
        match self.fault {
            Some((at, n, fault)) if (at, n) == (call, nth) => match fault {
                Fault::Silent => Err(DeviceError::Silent { device: "the scripted device" }),
                Fault::Ended => Err(DeviceError::Faulted {
                    device: "the arm",
                    cause: "the motion was stopped".into(),
                }),
                Fault::Panics => panic!("a driver's bug"),
                fault => Ok(Some(fault)),
            },
            _ => Ok(None),
        }
    }

    pub(super) fn count(&self, call: Call) -> u32 {
        self.calls.iter().filter(|it| **it == call).count() as u32
    }

    fn is_dead(&self) -> bool {
        self.display.is_some_and(|display| self.count(Call::Act) > display.dies_at)
    }

    fn shown(&mut self, fault: Option<Fault>) -> Reading {
        let (is_dead, now_s, mass_mg) = (self.is_dead(), self.elapsed_s(), self.mass_mg.round());
        if let Some(display) =
            self.display.as_mut().filter(|display| !is_dead && display.shown_mg != mass_mg)
        {
            (display.shown_mg, display.lived_s) = (mass_mg, now_s);
        }
        let mass_mg = match fault {
            Some(Fault::NotANumber) => f64::NAN,
            Some(Fault::VialLifted) => -20_000.0,
            Some(Fault::Draught) => self.mass_mg + 5.0,
            Some(Fault::Untared) => self.mass_mg + VIAL_MG,
            _ => self.display.map_or(mass_mg, |display| display.shown_mg),
        };
        Reading { mass_mg, stable: fault != Some(Fault::Unstable) }
    }

    pub(super) fn is_safe(&self) -> bool {
        self.pitch_deg == 0.0 && !self.over_the_vial
    }
}

impl Bench for Scripted {
    fn approach(&mut self) -> Result<(), DeviceError> {
        self.over_the_vial = true;
        if let Some([left_mg, full_mg]) = &mut self.spoon_mg {
            *left_mg = *full_mg;
        }
        self.called(Call::Approach).map(|_| ())
    }
    fn tare(&mut self) -> Result<Tare, DeviceError> {
        let fault = self.called(Call::Tare)?;
        let lighter_mg = if fault == Some(Fault::Exchanged) { EXCHANGED_MG } else { 0.0 };
        Ok(Tare { tare_mg: Some(VIAL_MG - lighter_mg) })
    }
    fn read(&mut self) -> Result<Reading, DeviceError> {
        self.called(Call::Read).map(|fault| self.shown(fault))
    }
    fn stand(&mut self, seconds: f64) -> Result<Standing, DeviceError> {
        let fault = self.called(Call::Stand)?;
        let still = fault != Some(Fault::Unstable);
        let mut reading = self.shown(fault);
        // Until it is tared, the display shows the vial.
        if self.count(Call::Tare) == 0 {
            reading.mass_mg += VIAL_MG;
        }
        let seen = [Moment { t_s: self.elapsed_s(), mass_mg: reading.mass_mg }];
        let rest =
            Rest::of(&seen).unwrap_or(Rest { mean_mg: f64::NAN, last_mg: f64::NAN, ..NOTHING });
        Ok(Standing { reading, still, drift_mg_min: 1.0, scatter_mg: 0.1, seconds, rest })
    }
    fn readings(&mut self, _seconds: f64) -> Result<Vec<Moment>, DeviceError> {
        let fault = self.called(Call::Watch)?;
        let mass_mg = self.shown(fault).mass_mg;
        Ok(vec![Moment { t_s: self.elapsed_s(), mass_mg }])
    }
    fn is_the_same(&mut self) -> Result<(), DeviceError> {
        match self.called(Call::Same)? {
            Some(_) => Err(DeviceError::Faulted {
                device: "the balance",
                cause: "it was switched on anew".into(),
            }),
            None => Ok(()),
        }
    }
    fn lived_s(&self) -> f64 {
        self.display.map_or(f64::INFINITY, |display| display.lived_s)
    }
    fn watch_for_life(&mut self, _seconds: f64) -> Result<bool, DeviceError> {
        self.called(Call::Life)?;
        if let Some(stop) = self.stops_in_life {
            stop.store(true, Ordering::SeqCst);
        }
        let (lives, now_s) = (!self.is_dead(), self.elapsed_s());
        if let Some(display) = self.display.as_mut().filter(|_| lives) {
            display.lived_s = now_s;
        }
        Ok(lives)
    }
    fn act(&mut self, action: Action) -> Result<(), DeviceError> {
        // A fault may come after the motion has begun.
        self.pitch_deg += action.incline_change_deg;
        let shakes = self.count(Call::Act) as usize;
        self.called(Call::Act)?;
        self.actions.push((self.pitch_deg, action));
        if action.executed_shake_mm() > 0.0 {
            let gives_mg = self.gives_mg[shakes.min(self.gives_mg.len() - 1)];
            let left_mg = self.spoon_mg.map_or(f64::INFINITY, |[left_mg, _]| left_mg);
            let fell_mg = gives_mg.min(left_mg);
            self.mass_mg += fell_mg;
            if let Some([left_mg, _]) = &mut self.spoon_mg {
                *left_mg -= fell_mg;
            }
        }
        if self.display.is_some_and(|display| display.is_early) {
            self.shown(None);
        }
        Ok(())
    }
    fn level(&mut self) -> Result<(), DeviceError> {
        self.called(Call::Level)?;
        self.mass_mg += self.late_mg;
        self.pitch_deg = 0.0;
        Ok(())
    }
    fn retract(&mut self) -> Result<(), DeviceError> {
        self.called(Call::Retract)?;
        self.over_the_vial = false;
        Ok(())
    }
    fn discard(&mut self) -> Result<(), DeviceError> {
        self.called(Call::Discard).map(|_| ())
    }
    fn can_refill(&self) -> bool {
        self.refills
    }
    fn reach(&self) -> Reach {
        self.reach
    }
    fn pitch_deg(&self) -> f64 {
        self.pitch_deg
    }
    fn elapsed_s(&self) -> f64 {
        self.calls.len() as f64 * self.call_s
    }
}
