//! A film of a heap: where its grains were while it is poured again from a parameter set and a seed,
//! and the cone that its angle comes from.
//!
//! The file has the layout of [`film`](super::film) and a [`Head`] of its own. Its frame has the
//! base's middle as origin and z up; the base stands still, so spoon and room are one frame, and
//! pitch and shift are 0. A grain is there from the frame that records it first. One that falls off
//! the base is a fall that reaches nothing.

use super::VERSION;
use super::constraints::Vector;
use super::dispense::{Flight, Pose};
use super::engine::{Engine, Physical, Scales};
use super::film::{Film, NoFilm, POSITIONS_MAX, Recorder};
use super::flank::Cone;
use super::repose::{Compat, Repose, Settings, heap_of};
use super::snapshot::Snapshot;
use flip_core::domain::parameters::ParameterSet;
use serde::{Deserialize, Serialize};
use std::ops::ControlFlow;

/// Shortest simulated time between two frames, s: grains fall past the heap within a few of them.
const EVERY_S: f64 = 0.02;
/// Steps between two reports of progress.
const REPORT: u32 = 512;
/// Part of the work that pouring is; the rest is coming to rest.
const POURING: f64 = 0.7;

/// What is filmed: a heap, poured again.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// The powder.
    pub set: ParameterSet,
    /// How it is poured: `compat` physical; its angle is read once.
    pub settings: Settings,
    /// Seed of the heap.
    pub seed: u64,
}

/// What a film of a heap says in numbers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Head {
    /// Version of the simulator.
    pub simulator: String,
    /// Number of grains poured.
    pub grains: u32,
    /// Number of frames.
    pub frames: u32,
    /// Number of grains that fell off the base.
    pub falls: u32,
    /// Diameter of a mean grain, mm.
    pub grain_mm: f64,
    /// Simulated time between two frames, s.
    pub every_s: f64,
    /// Simulated time in all, s.
    pub duration_s: f64,
    /// Radius of the base, mm.
    pub base_radius_mm: f64,
    /// Number of grains that stayed on the base.
    pub on_base: u32,
    /// Angle from the apex, atan(2 h / d_base), degrees: the one that calibration uses.
    pub tip_deg: f64,
    /// Slope of the cone, degrees.
    pub cone_deg: f64,
    /// h: height of the apex over the base, mm.
    pub height_mm: f64,
    /// Height of the cone's point over the base, mm.
    pub cone_height_mm: f64,
    /// What the cone was fitted to.
    pub rings: Vec<Ring>,
}

/// The mean surface of a ring, one grain wide, in one of twelve sectors around the axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Ring {
    /// Which sector, from 0, against the clock, beginning opposite to x.
    pub sector: u32,
    /// Mean distance from the axis, mm.
    pub radius_mm: f64,
    /// Mean height over the base, mm.
    pub height_mm: f64,
}

/// Films a heap. `on_progress` hears the part that is done, 0 to 1, and may end it. Same inputs, same
/// bytes, and the heap of [`repose`](super::repose::repose). About 3 s of CPU for 2000 grains.
///
/// # Errors
/// [`NoFilm`]
pub fn film(
    of: &Scene,
    on_progress: &mut dyn FnMut(f64) -> ControlFlow<()>,
) -> Result<Film<Head>, NoFilm> {
    let Scene { set, settings, seed } = of;
    let settings = &Settings { readings: 1, compat: Compat::Physical, ..*settings };
    let engine = Physical::new(set, settings);
    let mut recorder = Recorder::new(EVERY_S, POSITIONS_MAX, 0, &engine.law);
    let mut stopped = false;
    let filmed = Filmed {
        engine,
        recorder: &mut recorder,
        steps: 0,
        poured: 0,
        particles: settings.particles,
        on_progress,
        stopped: &mut stopped,
    };
    let made = heap_of(filmed, settings, *seed);
    let made = made.map(|(repose, cone, filmed)| (repose, cone, filmed.ended()));
    match made {
        _ if stopped => Err(NoFilm::Stopped),
        Err(refusal) => Err(refusal.into()),
        Ok((repose, cone, diameter_mm)) => {
            Ok(developed(&recorder, settings, diameter_mm, &repose, &cone))
        }
    }
}

fn developed(
    recorder: &Recorder,
    settings: &Settings,
    diameter_mm: f64,
    repose: &Repose,
    cone: &Cone,
) -> Film<Head> {
    let (radii_um, falls, frames) = recorder.developed();
    let base_radius_mm = settings.base_radius_diameters * diameter_mm;
    let ring = |(sector, [radius, height]): &(usize, [f64; 2])| Ring {
        sector: *sector as u32,
        radius_mm: radius * diameter_mm,
        height_mm: height * diameter_mm,
    };
    let head = Head {
        simulator: VERSION.to_owned(),
        grains: radii_um.len() as u32,
        frames: frames.len() as u32,
        falls: falls.len() as u32,
        grain_mm: diameter_mm,
        every_s: recorder.every_s(),
        duration_s: frames.last().map_or(0.0, |frame| f64::from(frame.at_s)),
        base_radius_mm,
        on_base: repose.particles_on_base,
        tip_deg: repose.tip_deg,
        cone_deg: repose.cone_deg,
        height_mm: base_radius_mm * libm::tan(repose.tip_deg.to_radians()),
        cone_height_mm: cone.height * diameter_mm,
        rings: cone.rings.iter().map(ring).collect(),
    };
    Film { head, radii_um, falls, frames }
}

/// An engine whose grains are recorded.
struct Filmed<'a> {
    engine: Physical,
    recorder: &'a mut Recorder,
    steps: u32,
    poured: u32,
    particles: u32,
    on_progress: &'a mut dyn FnMut(f64) -> ControlFlow<()>,
    stopped: &'a mut bool,
}

impl Filmed<'_> {
    /// Records the grains as they lie at the end; the diameter of a mean grain, mm.
    fn ended(self) -> f64 {
        let Physical { grains, law, .. } = &self.engine;
        self.recorder.end(grains, law, Pose::default(), self.steps);
        law.diameter_m * 1e3
    }
}

impl Engine for Filmed<'_> {
    fn scales(&self) -> Scales {
        self.engine.scales()
    }
    fn pour(&mut self, x: Vector, v: Vector) {
        self.poured += 1;
        self.engine.pour(x, v);
    }
    fn step(&mut self) {
        self.engine.step();
        self.steps += 1;
        let Physical { grains, law, .. } = &self.engine;
        self.recorder.look(grains, law, Pose::default(), self.steps);
        if self.steps.is_multiple_of(REPORT) {
            let share = POURING * f64::from(self.poured) / f64::from(self.particles.max(1));
            *self.stopped |= (self.on_progress)(share).is_break();
        }
    }
    fn drop_departed(&mut self) {
        let Physical { grains, law, plate, .. } = &mut self.engine;
        let metres = |v: Vector| [0, 1, 2].map(|k| f64::from(v[k]) * law.diameter_m);
        for departure in grains.take_departed(plate) {
            let speed_m_s = metres(departure.v).map(|m| m / law.substep_s);
            let flight = Flight { at_m: metres(departure.x), speed_m_s };
            self.recorder.falls(departure.id, flight, false, self.steps);
        }
    }
    fn centres(&self) -> &[Vector] {
        self.engine.centres()
    }
    fn heap(&self) -> Vec<Vector> {
        self.engine.heap()
    }
    fn snapshot(&self, time_s: f64) -> Snapshot {
        self.engine.snapshot(time_s)
    }
    fn velocities(&self) -> &[Vector] {
        self.engine.velocities()
    }
    fn speed_rms(&self) -> f32 {
        self.engine.speed_rms()
    }
    fn overlaps(&mut self) -> (f64, f64) {
        self.engine.overlaps()
    }
    fn fault(&self) -> Option<String> {
        // The heap knows no other way to end early.
        if *self.stopped { Some("stopped".to_owned()) } else { self.engine.fault() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::repose::{Refusal, repose};

    fn scene() -> Scene {
        let settings = Settings { readings: 4, ..Settings::with_particles(600) };
        Scene { set: ParameterSet::default(), settings, seed: 3 }
    }

    fn filmed() -> Film<Head> {
        film(&scene(), &mut |_| ControlFlow::Continue(())).unwrap()
    }

    #[test]
    fn a_film_has_the_angles_of_the_heap_that_was_not_filmed_and_always_the_same_bytes() {
        let film = filmed();
        let settings = Settings { readings: 1, ..scene().settings };
        let heap = repose(&scene().set, &settings, scene().seed).unwrap();
        let Head { tip_deg, cone_deg, on_base, grains, falls, .. } = film.head;
        assert_eq!(
            (tip_deg, cone_deg, on_base),
            (heap.tip_deg, heap.cone_deg, heap.particles_on_base)
        );
        assert_eq!((grains, on_base + falls), (600, 600), "each grain stayed or fell");
        assert!(film.to_bytes() == filmed().to_bytes());
    }

    #[test]
    fn the_grains_of_the_last_frame_make_the_apex_and_the_rings_lie_on_the_cone() {
        let film = filmed();
        let mut last = vec![None; film.radii_um.len()];
        for grain in film.frames.iter().flat_map(|frame| &frame.moved) {
            last[usize::from(grain.id)] = Some(grain.at[2]);
        }
        film.falls.iter().for_each(|fall| last[usize::from(fall.id)] = None);
        let top = last.iter().zip(&film.radii_um).filter_map(|(z, r)| {
            Some(f64::from((*z)?) * crate::film::STEP_MM + f64::from(*r) * 1e-3)
        });
        let top = top.fold(0.0, f64::max);
        let Head { height_mm, cone_height_mm, cone_deg, rings, grain_mm, .. } = film.head;
        assert!((top - height_mm).abs() < 0.011, "{top} {height_mm}");
        let off =
            |r: &Ring| r.height_mm - (cone_height_mm - r.radius_mm * cone_deg.to_radians().tan());
        let mean = rings.iter().map(off).sum::<f64>() / rings.len() as f64;
        assert!(rings.len() > 24 && mean.abs() < 0.2 * grain_mm, "{mean} of {}", rings.len());
    }

    #[test]
    fn grains_come_one_after_another_and_time_goes_on() {
        let film = filmed();
        let counts: Vec<usize> = film.frames.iter().map(|frame| frame.moved.len()).collect();
        assert!(counts[0] < 300, "{counts:?}");
        assert!(film.frames.windows(2).all(|pair| pair[0].at_s < pair[1].at_s));
        assert!(film.frames.iter().all(|frame| frame.pitch_deg == 0.0 && frame.shift_mm == 0.0));
    }

    #[test]
    fn it_stops_on_request_and_says_why_there_is_no_heap() {
        assert_eq!(film(&scene(), &mut |_| ControlFlow::Break(())), Err(NoFilm::Stopped));
        let few = Scene { settings: Settings { particles: 20, ..Settings::default() }, ..scene() };
        let refused = film(&few, &mut |_| ControlFlow::Continue(())).unwrap_err();
        assert!(matches!(refused, NoFilm::Diverged(Refusal::BaseNotCovered { .. })), "{refused:?}");
    }
}
