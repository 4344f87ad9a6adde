//! One simulation of a calibration, and the calibration's result.

use super::settings::Settings;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::powder::Flowability;
use flip_core::domain::seed::derive;
use serde::{Deserialize, Serialize};

/// Why a simulation ran.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// Finds where the target angle is reached.
    Search,
    /// Measures a candidate again with a seed not used in the search.
    Verification,
}

/// A heap to simulate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pour {
    /// The powder.
    pub parameters: ParameterSet,
    /// Number of grains.
    pub particles: u32,
    /// Number of readings, over which its angle is averaged.
    pub readings: u32,
    /// Seed of the simulation.
    pub seed: u64,
}

/// One simulated heap.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Heap {
    /// Angle of repose from the apex, atan(2 h / d_base), degrees; the one used in calibration.
    pub tip_deg: f64,
    /// Standard deviation of that angle over the readings of the heap, degrees; none for a single
    /// reading.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tip_sd_deg: Option<f64>,
    /// Slope of a cone fitted between 20 % and 80 % of the height, degrees.
    pub cone_deg: f64,
    /// Change of the cone's slope over the last 0.2 s, degrees per second.
    pub creep_deg_per_s: f64,
}

/// How a simulation ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// A heap with an angle.
    Heap(Heap),
    /// No angle, with the reason.
    Refused(String),
}

impl Outcome {
    /// Converts a simulation's result. A result that is not a number counts as refused.
    ///
    /// Rounded to a millionth of a degree: far below any noise, and unchanged by a round trip
    /// through JSON, which a resumed calibration depends on.
    pub(super) fn of(answer: Result<Heap, String>) -> Self {
        match answer {
            Ok(h) if [h.tip_deg, h.cone_deg, h.creep_deg_per_s].iter().all(|v| v.is_finite()) => {
                Self::Heap(Heap {
                    tip_deg: micro(h.tip_deg),
                    tip_sd_deg: h.tip_sd_deg.filter(|sd| sd.is_finite()).map(micro),
                    cone_deg: micro(h.cone_deg),
                    creep_deg_per_s: micro(h.creep_deg_per_s),
                })
            }
            Ok(_) => Self::Refused("the simulated angle is not a number".to_owned()),
            Err(reason) => Self::Refused(reason),
        }
    }

    /// The tip angle, if there is one, degrees.
    pub fn tip_deg(&self) -> Option<f64> {
        match self {
            Self::Heap(heap) => Some(heap.tip_deg),
            Self::Refused(_) => None,
        }
    }
}

fn one() -> u32 {
    1
}

/// Rounds to six decimals.
pub(super) fn micro(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}

/// One simulation: its inputs and its outcome.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Trial {
    /// Index in the history, from 0, counting both phases.
    pub index: u32,
    /// Search or verification.
    pub phase: Phase,
    /// Index of the search trial whose parameters these are; its own for a search trial.
    pub candidate: u32,
    /// The simulated parameters.
    pub parameters: ParameterSet,
    /// Seed of the simulation: derived from the calibration's seed, the candidate and the repeat.
    pub seed: u64,
    /// Number of readings of the heap, over which its angle is averaged.
    #[serde(default = "one")]
    pub readings: u32,
    /// Its outcome.
    pub outcome: Outcome,
    /// |tip angle - target|, degrees, rounded like the angle; none if refused.
    pub error_deg: Option<f64>,
}

/// A simulation to be run: a [`Trial`] without its outcome.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Planned {
    pub phase: Phase,
    pub candidate: u32,
    pub parameters: ParameterSet,
    pub seed: u64,
    pub readings: u32,
}

impl Planned {
    /// A search trial, which will get the index `index`.
    pub fn search(index: u32, parameters: ParameterSet, seed: u64) -> Self {
        let seed = derive(seed, &[u64::from(index), 0]);
        Self { phase: Phase::Search, candidate: index, parameters, seed, readings: 1 }
    }

    /// Sets the number of readings of its heap.
    pub fn read(self, readings: u32) -> Self {
        Self { readings, ..self }
    }

    /// The `repeat`-th verification, from 1, of a search trial.
    pub fn verification(of: &Trial, repeat: u32, settings: &Settings) -> Self {
        Self::fresh(of.index, of.parameters, repeat, settings)
    }

    /// The `repeat`-th verification, from 1, of candidate `index`, which need not have been
    /// simulated before.
    pub fn fresh(
        candidate: u32,
        parameters: ParameterSet,
        repeat: u32,
        settings: &Settings,
    ) -> Self {
        let seed = derive(settings.seed, &[u64::from(candidate), u64::from(repeat)]);
        Self {
            phase: Phase::Verification,
            candidate,
            parameters,
            seed,
            readings: settings.readings,
        }
    }

    /// The heap to simulate, of this many grains.
    pub fn pour(&self, particles: u32) -> Pour {
        let Self { parameters, readings, seed, .. } = *self;
        Pour { parameters, particles, readings, seed }
    }

    /// Whether `trial` is this simulation's record.
    pub fn is(&self, trial: &Trial) -> bool {
        (trial.phase, trial.candidate, trial.seed, trial.readings)
            == (self.phase, self.candidate, self.seed, self.readings)
            && trial.parameters == self.parameters
    }

    /// The record of this simulation.
    pub fn concluded(self, index: u32, outcome: Outcome, target: Option<&Flowability>) -> Trial {
        let error_deg = target
            .zip(outcome.tip_deg())
            .map(|(target, tip)| micro((tip - target.repose_deg).abs()));
        let Self { phase, candidate, parameters, seed, readings } = self;
        Trial { index, phase, candidate, parameters, seed, readings, outcome, error_deg }
    }
}

/// A verified parameter set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CalibratedSet {
    /// The nine values.
    pub parameters: ParameterSet,
    /// Mean tip angle over its verification runs, degrees. The search run, which chose the set, is
    /// excluded because it is biased towards the target.
    pub repose_deg: f64,
    /// SD of the tip angle over its verification runs, degrees; none for a single run.
    pub repose_sd_deg: Option<f64>,
    /// Verification runs.
    pub runs: u32,
    /// The error by which the method chose the set, degrees: |repose_deg - target|; with the
    /// published method, that of the search run.
    pub error_deg: f64,
    /// |repose_deg - target|, degrees.
    pub verified_error_deg: f64,
}

/// A finished calibration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// The target.
    pub target: Flowability,
    /// Search simulations of this calibration; those of a shared emulator are counted with the
    /// emulator.
    pub evaluations: u32,
    /// Verification simulations.
    pub verification_runs: u32,
    /// The verified sets, in the order in which they were found.
    pub sets: Vec<CalibratedSet>,
    /// Mean of the sets' errors, degrees; none without sets.
    pub mean_error_deg: Option<f64>,
    /// SD of the sets' errors, degrees; none below two sets.
    pub sd_error_deg: Option<f64>,
    /// Mean of the sets' verified errors, degrees; none without sets.
    pub verified_error_deg: Option<f64>,
    /// Angle of the verification heaps minus that of heaps of the emulator's size, degrees; none if
    /// the sizes are equal.
    pub size_shift_deg: Option<f64>,
    /// Why there are fewer sets than wanted, if there are.
    pub shortfall: Option<Shortfall>,
}

/// Why a target could not be reached.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Shortfall {
    /// The simulated angle nearest to the target, degrees: the mean of the verification runs if
    /// there are any.
    pub nearest_repose_deg: f64,
    /// The parameter at one of its bounds whose further change would bring the angle nearest to the
    /// target; none if the target is within reach and only the budget was too small.
    pub limiting_parameter: Option<String>,
}
