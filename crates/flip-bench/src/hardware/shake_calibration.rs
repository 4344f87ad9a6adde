//! Shake calibration: how commanded shakes are executed by an arm. An empty, level spoon is shaken
//! away from the vial, at several amplitudes in random order.
//!
//! The driver returns the executed amplitude, as measured by its robot. The stream of states is
//! evaluated as well: where both are available and disagree, one of them is wrong. States come 100
//! to 200 times per second, so the amplitude from the stream is slightly low.

use super::DeviceError;
use super::arm::Arm;
use super::bench_file::BenchFile;
use super::conformance::Looked;
use super::conformance::raw::{Raw, Seen};
use super::wire::Tap;
use flip_core::domain::bench_check::{ExecutedShake, ShakeCalibration};
use flip_core::domain::motion::Move;
use flip_core::domain::seed::derive;
use flip_core::domain::{FieldError, bounded};
use serde::Serialize;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Which shakes to make.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Commanded amplitudes, mm. Default 2, 4, 8, 12, 16.
    pub amplitudes_mm: Vec<f64>,
    /// Repeats of each. Default 3.
    pub repeats: u32,
    /// Seed of the order. Default 1.
    pub seed: u64,
}

impl Default for Plan {
    fn default() -> Self {
        Self { amplitudes_mm: vec![2.0, 4.0, 8.0, 12.0, 16.0], repeats: 3, seed: 1 }
    }
}

/// Maximum number of amplitudes, and of repeats.
const AMPLITUDES_MAX: usize = 50;
const REPEATS_MAX: u32 = 20;
/// How long after an answer its last states may arrive.
const LATE: Duration = Duration::from_millis(20);
/// Fewest states during a shake that can be evaluated.
const STATES_MIN: usize = 5;
/// Relative difference between stream and answer above which someone should investigate.
const DISAGREE: f64 = 0.2;

/// One shake, with what the stream of states showed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Shaken {
    /// As commanded and as reported.
    #[serde(flatten)]
    pub shake: ExecutedShake,
    /// Largest displacement in the stream, mm, where there were enough states.
    pub streamed_mm: Option<f64>,
    /// Largest speed between two states, mm/s.
    pub streamed_mm_s: Option<f64>,
}

/// Result of a calibration.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Calibrated {
    /// The arm and its serial number.
    pub arm: String,
    /// The line fitted to the shakes.
    pub calibration: ShakeCalibration,
    /// The shakes in execution order.
    pub shakes: Vec<Shaken>,
    /// Notes for the operator.
    pub notes: Vec<String>,
}

/// Why there is no calibration.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The plan, or the shakes, cannot be used.
    #[error(transparent)]
    Field(#[from] FieldError),
    /// A device failed.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// A stop was requested.
    #[error("stopped before every shake was made; nothing is kept")]
    Stopped,
}

impl Plan {
    /// Returns the plan if it is valid.
    ///
    /// # Errors
    /// The first field that is out of bounds.
    pub fn checked(self) -> Result<Self, FieldError> {
        let n = self.amplitudes_mm.len();
        if !(2..=AMPLITUDES_MAX).contains(&n) {
            return Err(FieldError::new(
                "amplitudes_mm",
                format!("must be from 2 to {AMPLITUDES_MAX}, got {n}"),
            ));
        }
        for mm in &self.amplitudes_mm {
            bounded("amplitudes_mm", *mm, 0.1, flip_core::domain::bench::SHAKE_MM_MAX, "mm")?;
        }
        bounded("repeats", self.repeats.into(), 1.0, REPEATS_MAX.into(), "")?;
        Ok(self)
    }

    /// Every amplitude with its repeats, in random order, so that warming up is not mistaken for a
    /// slope.
    pub fn order(&self) -> Vec<f64> {
        let all = (0..self.repeats).flat_map(|_| self.amplitudes_mm.iter().copied());
        let mut keyed: Vec<(u64, f64)> =
            all.enumerate().map(|(k, mm)| (derive(self.seed, &[k as u64]), mm)).collect();
        keyed.sort_by_key(|(key, _)| *key);
        keyed.into_iter().map(|(_, mm)| mm).collect()
    }
}

/// Make the shakes of the plan. The spoon is level and retracted before and after, whatever
/// happens; `stop` is checked before each shake.
///
/// # Errors
/// [`Error`]; if nobody has confirmed that the spoon is empty, [`DeviceError::Forbidden`].
pub fn calibrate(
    file: &BenchFile,
    plan: Plan,
    looked: &Looked,
    stop: &AtomicBool,
    tap: &Tap,
) -> Result<Calibrated, Error> {
    let plan = plan.checked()?;
    if !looked.spoon_is_empty() {
        let cause = "a person must look that the spoon is empty, and say so".to_owned();
        return Err(DeviceError::Forbidden { device: "the arm", cause }.into());
    }
    let mut arm = Arm::connect(&file.arm.url, tap.clone(), file.arm.deadlines())?;
    let raw = Raw::connect(&file.arm.url, &Tap::none())?;
    let states = raw.watch();
    arm.acquire()?;
    arm.retract()?;
    let (limits, name) =
        (*arm.limits(), format!("{}, serial {}", arm.description().name, arm.description().serial));
    let mut shakes = Vec::new();
    for commanded_mm in plan.order().into_iter().filter(|mm| *mm <= limits.shake_mm_max) {
        if stop.load(Ordering::SeqCst) {
            return Err(Error::Stopped);
        }
        let began = Instant::now();
        let executed = arm.shake(commanded_mm)?;
        std::thread::sleep(LATE);
        let seen = states.since(began);
        let shake = ExecutedShake {
            commanded_mm,
            executed_mm: executed.amplitude_mm,
            planned_mm_s: 1e3 * Move::new(commanded_mm * 1e-3, limits.motion).top_m_s(),
            peak_mm_s: 1e3 * executed.peak_speed_m_s,
        };
        shakes.push(Shaken {
            shake,
            streamed_mm: furthest_mm(&seen),
            streamed_mm_s: fastest_mm_s(&seen),
        });
    }
    arm.release()?;
    let calibration = ShakeCalibration::of(shakes.iter().map(|it| it.shake).collect())?;
    let notes = notes(&calibration, &shakes);
    Ok(Calibrated { arm: name, calibration, shakes, notes })
}

/// States of the stroke itself.
fn stroke(seen: &[Seen]) -> Option<Vec<(f64, f64)>> {
    let moving = |it: &&Seen| it.state.shake_displacement_mm.abs() > 1e-3;
    let first = seen.iter().position(|it| moving(&it))?.saturating_sub(1);
    let stroke =
        seen[first..].iter().map(|it| (it.state.measured_at_s, it.state.shake_displacement_mm));
    Some(stroke.collect()).filter(|it: &Vec<_>| it.len() >= STATES_MIN)
}

fn furthest_mm(seen: &[Seen]) -> Option<f64> {
    Some(stroke(seen)?.iter().fold(0.0, |furthest, (_, mm)| mm.max(furthest)))
}

fn fastest_mm_s(seen: &[Seen]) -> Option<f64> {
    let stroke = stroke(seen)?;
    // Two states at the same time give no speed.
    let speed = |pair: &[(f64, f64)]| {
        let (dt, dx) = (pair[1].0 - pair[0].0, pair[1].1 - pair[0].1);
        (dt > 1e-3).then(|| dx.abs() / dt)
    };
    Some(stroke.windows(2).filter_map(speed).fold(0.0, f64::max))
}

fn notes(calibration: &ShakeCalibration, shakes: &[Shaken]) -> Vec<String> {
    let mut notes = Vec::new();
    if !(0.5..=1.1).contains(&calibration.gain) {
        notes.push(format!(
            "the arm executes {:.2} of what is commanded: look at its tuning",
            calibration.gain
        ));
    }
    let lost = shakes.iter().filter(|it| it.shake.executed_mm == 0.0).count();
    if lost > 0 {
        notes.push(format!(
            "{lost} shakes were not executed at all: they are below the arm's least amplitude"
        ));
    }
    let off = |it: &&Shaken| {
        it.streamed_mm.is_some_and(|mm| {
            (mm - it.shake.executed_mm).abs() > DISAGREE * it.shake.executed_mm.max(1.0)
        })
    };
    let off = shakes.iter().filter(off).count();
    if off > 0 {
        notes.push(format!(
            "in {off} shakes the states show another amplitude than the driver's answer"
        ));
    }
    notes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::emulate::arm::{self as arms, Flow, FormulaSpoon};
    use crate::emulate::lab::{Laboratory, Settings};
    use crate::hardware::clock::Clock;

    fn laboratory(clock: Clock) -> Laboratory {
        let arm = arms::Settings { dead_man_ms: 60_000, ..arms::Settings::DEFAULT };
        Laboratory::start(
            Settings { arm, ..Settings::default() },
            clock,
            Box::new(FormulaSpoon::new(Flow::default(), 1)),
        )
        .unwrap()
    }

    #[test]
    fn the_arms_own_gain_loss_and_speed_are_found_and_nothing_is_poured() {
        let lab = laboratory(Clock::standing());
        let looked = Looked::by("Ada", true, false).unwrap();
        let found =
            calibrate(&lab.file(), Plan::default(), &looked, &AtomicBool::new(false), &Tap::none())
                .unwrap();
        let line = &found.calibration;
        assert!((line.gain - 0.94).abs() < 1e-9 && (line.offset_mm + 0.1).abs() < 1e-9, "{line:?}");
        assert!(line.scatter_mm < 1e-9 && (0.85..0.95).contains(&line.speed_gain), "{line:?}");
        assert_eq!((found.shakes.len(), lab.dispensed_mg()), (15, 0.0));
        assert!(
            lab.arm.is_level() && lab.arm.is_retracted() && found.notes.is_empty(),
            "{:?}",
            found.notes
        );
    }

    #[test]
    fn the_stream_shows_the_stroke_as_it_is_executed() {
        let lab = laboratory(Clock::wall());
        let looked = Looked::by("Ada", true, false).unwrap();
        let plan = Plan { amplitudes_mm: vec![12.0, 16.0], repeats: 2, seed: 3 };
        let found =
            calibrate(&lab.file(), plan, &looked, &AtomicBool::new(false), &Tap::none()).unwrap();
        for shaken in found.shakes {
            let share = shaken.streamed_mm.unwrap() / shaken.shake.executed_mm;
            assert!((0.7..1.001).contains(&share), "{shaken:?}");
            assert!(shaken.streamed_mm_s.unwrap() > 0.4 * shaken.shake.peak_mm_s, "{shaken:?}");
        }
    }

    #[test]
    fn the_order_is_random_complete_and_the_same_for_a_seed() {
        let plan = Plan::default();
        let mut order = plan.order();
        assert_eq!(order, plan.order());
        assert_ne!(order, Plan { seed: 2, ..plan.clone() }.order());
        order.sort_by(f64::total_cmp);
        assert_eq!(
            order,
            [2.0, 4.0, 8.0, 12.0, 16.0].into_iter().flat_map(|mm| [mm; 3]).collect::<Vec<_>>()
        );
    }

    #[test]
    fn without_a_look_a_sound_plan_or_time_nothing_is_shaken() {
        let lab = laboratory(Clock::standing());
        let looked = Looked::by("Ada", true, false).unwrap();
        let go = |plan, looked: &Looked, stop| {
            calibrate(&lab.file(), plan, looked, &AtomicBool::new(stop), &Tap::none())
        };
        assert!(matches!(go(Plan::default(), &Looked::nobody(), false), Err(Error::Device(_))));
        let wild = Plan { amplitudes_mm: vec![2.0, 40.0], ..Plan::default() };
        assert!(go(wild, &looked, false).unwrap_err().to_string().contains("amplitudes_mm"));
        assert!(matches!(go(Plan::default(), &looked, true), Err(Error::Stopped)));
        assert!(lab.arm.log().iter().all(|event| !matches!(event.motion, arms::Asked::Shake(_))));
    }
}
