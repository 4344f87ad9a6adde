//! A film of a spoonful: where its grains were while a recorded spoonful is made again. A film of a
//! heap ([`heap_film`](super::heap_film)) has the same layout and another head.
//!
//! The spoon's frame has x along the bowl, its tip at positive x, y across it and z up; its origin is
//! the middle of the level rim. The room's frame is the same while the spoon is level and at rest.
//! Grains in the spoon are recorded in the spoon's frame, where those at rest do not move. A grain
//! that has left is recorded once, in the room's frame: from there it falls freely.
//!
//! # File
//!
//! Little-endian, without gaps.
//!
//! ```text
//! FLIPFILM            8 bytes
//! version             u32      1
//! n                   u32      length of the head, bytes
//! head                n bytes  JSON, see Head; it counts the grains, frames and falls that follow
//! radius              u16      um                                   for each grain, by id
//! falls, in order of time:
//!   id, reaches       2 u16    reaches: 1 if it falls into the vial's mouth, 0 if it misses it
//!   at                f32      when it left, s
//!   x, y, z           3 f32    mm, room
//!   vx, vy, vz        3 f32    mm/s, room
//! frames, in order of time:
//!   at                f32      s
//!   pitch             f32      degrees, tip down is positive
//!   shift             f32      mm along the pitched spoon, from its position at rest
//!   moved             u32      how many grains are elsewhere than in the frame before
//!   id, x, y, z       u16, 3 i16   for each of them; steps of 10 um, spoon
//! ```
//!
//! A grain is in the spoon until it leaves, and where it was last recorded. Before it is recorded for
//! the first time it is not there.

use super::VERSION;
use super::dispense::{Dispenser, Flight, Pose};
use super::grains::Grains;
use super::law::Law;
use super::replay::{Replay, limits};
use super::repose::Refusal;
use serde::{Deserialize, Serialize};
use std::ops::ControlFlow;

/// Length of a step of a recorded position, mm.
pub const STEP_MM: f64 = 0.01;
/// Version of the file's layout.
const LAYOUT: u32 = 1;
/// Shortest simulated time between two frames, s.
const EVERY_S: f64 = 0.04;
/// Most positions of a film: at 8 bytes each, a file of at most 16 MiB.
pub(super) const POSITIONS_MAX: usize = 2_000_000;

/// How the moves of a step follow each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Moves {
    /// The simulated bench's way: the first stroke begins as soon as the spoon is pitched.
    AtOnce,
    /// An arm's way: the powder rests between the pitch and the strokes.
    InTurn,
}

/// What is filmed: a spoonful, made again, and the way back to level after it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// The spoonful.
    pub replay: Replay,
    /// How its steps are made.
    pub moves: Moves,
}

/// What a film says in numbers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Head {
    /// Version of the simulator.
    pub simulator: String,
    /// Number of grains in the spoon at first.
    pub grains: u32,
    /// Number of frames.
    pub frames: u32,
    /// Number of grains that left the spoon.
    pub falls: u32,
    /// Diameter of a mean grain, mm.
    pub grain_mm: f64,
    /// Mass of a mean grain, mg.
    pub grain_mg: f64,
    /// Semi-axes of the bowl, half an ellipsoid, along its length, width and depth, mm.
    pub bowl_mm: [f64; 3],
    /// Radius of the vial's mouth, mm.
    pub vial_radius_mm: f64,
    /// From the middle of the spoon at rest to the axis of the vial, along the spoon, mm.
    pub vial_offset_mm: f64,
    /// Height of the level spoon's rim above the vial's mouth, mm.
    pub drop_height_mm: f64,
    /// Simulated time between two frames, s.
    pub every_s: f64,
    /// Simulated time in all, s: motion and the powder coming to rest, without the bench's waits.
    pub duration_s: f64,
    /// Powder in the spoon before the first step, mg.
    pub filled_mg: f64,
    /// Powder that fell into the vial, mg.
    pub vial_mg: f64,
    /// Powder that missed it, mg.
    pub spilled_mg: f64,
    /// The steps in order, the last of them the way back to level.
    pub steps: Vec<StepSeen>,
}

/// One step of a film.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct StepSeen {
    /// When it begins, s.
    pub begins_s: f64,
    /// Pitch during its strokes and after them, degrees; positive is tip down.
    pub pitch_deg: f64,
    /// Amplitude of a stroke, mm; 0 for none.
    pub shake_mm: f64,
    /// Number of strokes.
    pub strokes: u32,
    /// Powder that fell into the vial during the step, mg.
    pub fell_mg: f64,
    /// Powder in the spoon after it, mg.
    pub spoon_mg: f64,
    /// Powder in the vial after it, mg.
    pub vial_mg: f64,
}

/// A film, of a spoonful unless it has another head.
#[derive(Debug, Clone, PartialEq)]
pub struct Film<H = Head> {
    /// What it says in numbers.
    pub head: H,
    /// Radii of the grains by id, um.
    pub radii_um: Vec<u16>,
    /// Grains that left the spoon, in order of time.
    pub falls: Vec<Fall>,
    /// Frames, in order of time.
    pub frames: Vec<Frame>,
}

/// A grain that left the spoon and falls freely.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fall {
    /// Its id: the number in the order of filling, from 0.
    pub id: u16,
    /// Whether it falls into the vial's mouth.
    pub reaches: bool,
    /// When it left, s.
    pub at_s: f32,
    /// Where it left, room, mm.
    pub from_mm: [f32; 3],
    /// Its velocity then, room, mm/s.
    pub speed_mm_s: [f32; 3],
}

/// The spoon at one moment, and the grains that moved since the frame before.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// When, s.
    pub at_s: f32,
    /// Pitch, degrees; positive is tip down.
    pub pitch_deg: f32,
    /// Way along the pitched spoon from its position at rest, mm.
    pub shift_mm: f32,
    /// Grains that are elsewhere than in the frame before, by id.
    pub moved: Vec<Placed>,
}

/// A grain and where it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Placed {
    /// Its id.
    pub id: u16,
    /// Its centre, spoon, in steps of [`STEP_MM`].
    pub at: [i16; 3],
}

/// Why there is no film.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoFilm {
    /// The simulation left the range where its numbers are meaningful.
    #[error(transparent)]
    Diverged(#[from] Refusal),
    /// It was told to stop.
    #[error("stopped on request")]
    Stopped,
}

/// Films a spoonful. `on_step` hears how many of how many steps are done, and may end it. Same
/// inputs, same bytes. About 0.2 s of CPU for each step of 2500 grains.
///
/// # Errors
/// [`NoFilm`]
pub fn film(
    of: &Scene,
    on_step: &mut dyn FnMut(usize, usize) -> ControlFlow<()>,
) -> Result<Film, NoFilm> {
    let Replay { set, settings, steps, seed } = &of.replay;
    let all = steps.len() + 1;
    if on_step(0, all).is_break() {
        return Err(NoFilm::Stopped);
    }
    let mut spoon = Dispenser::new(set, settings, *seed);
    let filled_mg = spoon.spoon_mg();
    spoon.record(EVERY_S, POSITIONS_MAX);
    let mut seen = Vec::with_capacity(all);
    let mut elapsed_s = 0.0;
    let level = (0.0, 0.0, 0, settings.shake);
    let made = steps
        .iter()
        .map(|step| (step.pitch_deg, step.shake_mm, step.strokes, limits(step, settings.shake)));
    for (k, (pitch_deg, shake_mm, strokes, within)) in made.chain([level]).enumerate() {
        spoon.shake_within(within);
        let mut fell_mg = 0.0;
        let begins_s = elapsed_s;
        let mut go = |shake_mm: f64, strokes: u32| {
            let poured = spoon.carry_out(pitch_deg, shake_mm, strokes);
            fell_mg += poured.vial_mg;
            elapsed_s += poured.duration_s;
        };
        if of.moves == Moves::InTurn {
            go(0.0, 0);
        }
        go(shake_mm, strokes);
        if let Some(cause) = spoon.fault() {
            return Err(Refusal::Diverged { at_s: elapsed_s, cause: cause.to_owned() }.into());
        }
        let (spoon_mg, vial_mg) = (spoon.spoon_mg(), spoon.vial_mg());
        seen.push(StepSeen { begins_s, pitch_deg, shake_mm, strokes, fell_mg, spoon_mg, vial_mg });
        if k + 1 < all && on_step(k + 1, all).is_break() {
            return Err(NoFilm::Stopped);
        }
    }
    let (vial_mg, spilled_mg) = (spoon.vial_mg(), spoon.spilled_mg());
    let Some(recorder) = spoon.recorded() else { return Err(NoFilm::Stopped) };
    let (radii_um, falls, frames) = recorder.developed();
    let head = Head {
        simulator: VERSION.to_owned(),
        grains: radii_um.len() as u32,
        frames: frames.len() as u32,
        falls: falls.len() as u32,
        grain_mm: set.particle_diameter_mm(),
        grain_mg: set.particle_mass_ug() / 1000.0,
        bowl_mm: settings.semi_axes_mm,
        vial_radius_mm: settings.vial_radius_mm,
        vial_offset_mm: settings.vial_offset_mm,
        drop_height_mm: settings.drop_height_mm,
        every_s: recorder.every_s(),
        duration_s: frames.last().map_or(0.0, |frame| f64::from(frame.at_s)),
        filled_mg,
        vial_mg,
        spilled_mg,
        steps: seen,
    };
    Ok(Film { head, radii_um, falls, frames })
}

impl<H: Serialize> Film<H> {
    /// The file.
    pub fn to_bytes(&self) -> Vec<u8> {
        let head = serde_json::to_vec(&self.head).expect("a head holds finite numbers and text");
        let moved: usize = self.frames.iter().map(|frame| frame.moved.len()).sum();
        let size = 16
            + head.len()
            + 2 * self.radii_um.len()
            + 32 * self.falls.len()
            + 16 * self.frames.len()
            + 8 * moved;
        let mut bytes = Vec::with_capacity(size);
        bytes.extend(b"FLIPFILM");
        bytes.extend(LAYOUT.to_le_bytes());
        bytes.extend((head.len() as u32).to_le_bytes());
        bytes.extend(head);
        self.radii_um.iter().for_each(|radius| bytes.extend(radius.to_le_bytes()));
        for fall in &self.falls {
            bytes.extend(fall.id.to_le_bytes());
            bytes.extend(u16::from(fall.reaches).to_le_bytes());
            let numbers = [fall.at_s].into_iter().chain(fall.from_mm).chain(fall.speed_mm_s);
            numbers.for_each(|number| bytes.extend(number.to_le_bytes()));
        }
        for frame in &self.frames {
            for number in [frame.at_s, frame.pitch_deg, frame.shift_mm] {
                bytes.extend(number.to_le_bytes());
            }
            bytes.extend((frame.moved.len() as u32).to_le_bytes());
            for grain in &frame.moved {
                bytes.extend(grain.id.to_le_bytes());
                grain.at.iter().for_each(|at| bytes.extend(at.to_le_bytes()));
            }
        }
        bytes
    }
}

/// Records a spoon's grains. When it holds too many positions, it drops every second frame and goes
/// on at half the pace, so a film of any length fits.
#[derive(Debug, Clone)]
pub(super) struct Recorder {
    /// Substeps between two frames.
    every: u32,
    most: usize,
    begun: u32,
    substep_s: f64,
    radii_um: Vec<u16>,
    shots: Vec<Shot>,
    positions: usize,
    falls: Vec<Fall>,
}

/// All grains in the spoon at one moment.
#[derive(Debug, Clone)]
struct Shot {
    /// Substeps since the recorder began.
    substep: u32,
    pose: Pose,
    /// By id.
    grains: Vec<Placed>,
}

impl Recorder {
    pub(super) fn new(every_s: f64, most: usize, substeps: u32, law: &Law) -> Self {
        Self {
            every: law.substeps(every_s).max(1),
            most,
            begun: substeps,
            substep_s: law.substep_s,
            radii_um: Vec::new(),
            shots: Vec::new(),
            positions: 0,
            falls: Vec::new(),
        }
    }

    /// Takes a frame if one is due at this substep of the spoon.
    pub(super) fn look(&mut self, grains: &Grains, law: &Law, pose: Pose, substeps: u32) {
        let substep = substeps - self.begun;
        if substep.is_multiple_of(self.every) {
            self.take(grains, law, pose, substep);
        }
    }

    /// Takes the last frame.
    pub(super) fn end(&mut self, grains: &Grains, law: &Law, pose: Pose, substeps: u32) {
        let substep = substeps - self.begun;
        if self.shots.last().is_none_or(|last| last.substep < substep) {
            self.take(grains, law, pose, substep);
        }
    }

    /// Records that a grain has left, at this substep of the spoon.
    pub(super) fn falls(&mut self, id: u32, flight: Flight, reaches: bool, substeps: u32) {
        self.falls.push(Fall {
            id: id as u16,
            reaches,
            at_s: self.time_s(substeps - self.begun),
            from_mm: flight.at_m.map(|m| (m * 1e3) as f32),
            speed_mm_s: flight.speed_m_s.map(|m| (m * 1e3) as f32),
        });
    }

    fn take(&mut self, grains: &Grains, law: &Law, pose: Pose, substep: u32) {
        let mm = law.diameter_m * 1e3;
        let most = grains.ids().iter().max().map_or(0, |id| *id as usize + 1);
        let known = self.radii_um.len();
        self.radii_um.resize(most.max(known), 0);
        let new =
            grains.ids().iter().zip(grains.centres()).filter(|(id, _)| **id as usize >= known);
        for (id, x) in new {
            self.radii_um[*id as usize] = (f64::from(x[3]) * mm * 1e3).round() as u16;
        }
        let steps = |length: f32| (f64::from(length) * mm / STEP_MM).round() as i16;
        let placed = |(id, x): (&u32, &[f32; 4])| Placed {
            id: *id as u16,
            at: [0, 1, 2].map(|k| steps(x[k])),
        };
        let mut placed: Vec<Placed> =
            grains.ids().iter().zip(grains.centres()).map(placed).collect();
        placed.sort_unstable_by_key(|grain| grain.id);
        self.positions += placed.len();
        self.shots.push(Shot { substep, pose, grains: placed });
        while self.positions > self.most && self.shots.len() > 2 {
            self.every *= 2;
            let every = self.every;
            self.shots.retain(|shot| shot.substep.is_multiple_of(every));
            self.positions = self.shots.iter().map(|shot| shot.grains.len()).sum();
        }
    }

    fn time_s(&self, substep: u32) -> f32 {
        (f64::from(substep) * self.substep_s) as f32
    }

    pub(super) fn every_s(&self) -> f64 {
        f64::from(self.every) * self.substep_s
    }

    /// Radii, falls, and frames that hold what moved.
    pub(super) fn developed(&self) -> (Vec<u16>, Vec<Fall>, Vec<Frame>) {
        let mut last = vec![None; self.radii_um.len()];
        let frame = |shot: &Shot| Frame {
            at_s: self.time_s(shot.substep),
            pitch_deg: shot.pose.pitch_rad.to_degrees() as f32,
            shift_mm: (shot.pose.shift_m * 1e3) as f32,
            moved: shot
                .grains
                .iter()
                .filter(|grain| last[usize::from(grain.id)].replace(grain.at) != Some(grain.at))
                .copied()
                .collect(),
        };
        let frames = self.shots.iter().map(frame).collect();
        (self.radii_um.clone(), self.falls.clone(), frames)
    }
}

#[cfg(test)]
#[path = "film_tests.rs"]
mod tests;
