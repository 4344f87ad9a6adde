//! Calibrations, their trials and the parameter sets they found.

use super::{
    Day, Device, Flowability, Job, Labels, Observation, ParameterSetValues, StoredShakes, Under,
    is_default,
};
use crate::app;
use flip_core::domain::parameters::COUNT;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// Comparison of a calibration's sets with an observation.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Observed {
    /// What was measured.
    pub observation: Observation,
    /// SHA-256 of the simulations that make up its emulator.
    pub sha256: String,
    /// How many of them this calibration ran; the others existed already.
    pub built: u32,
    /// Results of fresh simulations of each set, in the order of the sets.
    pub sets: Vec<Simulated>,
    /// Mean over the sets, in the observable's unit; absent without sets.
    pub mean: Option<f64>,
    /// Whether that mean is within two standard errors of the measured one; both errors count.
    pub agrees: bool,
}

answer! { app::Observed => Observed { observation, sha256, built, sets, mean, agrees } }

/// Simulations of an observation with one set.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Simulated {
    /// Mean over the simulations, in the observable's unit; absent if each was refused or nothing
    /// flowed.
    pub mean: Option<f64>,
    /// Standard deviation over them.
    pub sd: Option<f64>,
    /// Simulations with a result.
    pub runs: u32,
}

answer! { app::Simulated => Simulated { mean, sd, runs } }

/// What a calibration found.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct CalibrationResult {
    /// Whether as many sets were found as requested.
    #[serde(default)]
    pub reached: bool,
    /// Simulations of the search, without those of a shared emulator.
    pub evaluations: u32,
    /// Simulations with fresh seeds that checked candidates.
    pub verification_runs: u32,
    /// The sets found.
    pub sets: Vec<CalibrationSet>,
    /// Mean of the sets' errors, degrees; absent without sets.
    pub mean_error_deg: Option<f64>,
    /// Standard deviation of the sets' errors, degrees; absent for a single set.
    pub sd_error_deg: Option<f64>,
    /// Mean of the sets' verified errors, degrees; absent without sets.
    #[serde(default)]
    pub verified_error_deg: Option<f64>,
    /// Angle of the verification heaps minus that of heaps of the emulator's size, degrees; absent
    /// if they are the same size. The posterior is that of the target minus this.
    #[serde(default)]
    pub size_shift_deg: Option<f64>,
    /// What prevented it; absent when the target was reached.
    #[serde(default)]
    pub shortfall: Option<Shortfall>,
    /// The emulator it used; absent with a method that has none.
    #[serde(default)]
    pub emulator: Option<EmulatorUse>,
    /// SHA-256 of the posterior over the parameters; absent with a method that has none.
    #[serde(default)]
    pub posterior: Option<String>,
    /// Comparison of the sets with all other measurements.
    #[serde(default)]
    pub observed: Vec<Observed>,
}

answer! { app::CalibrationResult => CalibrationResult {
    reached, evaluations, verification_runs, sets, mean_error_deg, sd_error_deg, verified_error_deg,
    size_shift_deg, shortfall, emulator, posterior, observed,
} }

/// The emulator that a calibration used.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct EmulatorUse {
    /// Content address of its design and of the simulator's version.
    pub id: String,
    /// SHA-256 of its heaps.
    pub sha256: String,
    /// Number of its heaps.
    pub runs: u32,
    /// How many of them this calibration simulated; the others existed already.
    pub built: u32,
}

answer! { app::EmulatorUse => EmulatorUse { id, sha256, runs, built } }

/// One set found by a calibration.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct CalibrationSet {
    /// Content address of the nine values.
    pub id: String,
    /// The nine values.
    pub parameters: ParameterSetValues,
    /// Mean simulated angle over its runs, degrees.
    pub repose_deg: f64,
    /// Standard deviation over its runs, degrees; absent for a single run.
    pub repose_sd_deg: Option<f64>,
    /// Simulations behind the mean.
    pub runs: u32,
    /// The error by which the method chose it, degrees: with the published method, that of its
    /// search run, otherwise the verified one.
    pub error_deg: f64,
    /// Absolute difference between mean and target, degrees; absent in results stored before it was
    /// distinguished from `error_deg`.
    #[serde(default)]
    pub verified_error_deg: Option<f64>,
}

answer! { app::CalibrationSet => CalibrationSet {
    id, parameters, repose_deg, repose_sd_deg, runs, error_deg, verified_error_deg,
} }

/// Two calibrations compared.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Comparison {
    /// The requested calibration.
    pub calibration: ComparedCalibration,
    /// The calibration it is compared with.
    pub with: ComparedCalibration,
    /// Mean verified angle of the first minus that of the second, degrees; absent if one of them
    /// has no sets.
    pub difference_deg: Option<f64>,
    /// Standard error of that difference, degrees: the root of the sum of both squared standard
    /// errors; absent if one of them is.
    pub standard_error_deg: Option<f64>,
    /// Whether the mean verified angles agree: their difference is at most two of its standard
    /// errors. Absent if unknown.
    pub agree: Option<bool>,
}

answer! { app::Comparison => Comparison {
    calibration, with, difference_deg, standard_error_deg, agree,
} }

/// Target, cost and result of one calibration.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ComparedCalibration {
    /// Id of the calibration.
    pub id: String,
    /// Powder id; absent for a bare angle.
    pub powder: Option<String>,
    /// Target.
    pub target: Flowability,
    /// Search method.
    pub method: CalibrationMethod,
    /// Simulations of the search, without those of a shared emulator.
    pub evaluations: u32,
    /// Simulations with fresh seeds to check candidates.
    pub verification_runs: u32,
    /// The emulator it used; absent with a method that has none.
    pub emulator: Option<EmulatorUse>,
    /// Number of its sets.
    pub sets: u32,
    /// Mean over the sets of |mean over fresh seeds - target|, degrees; absent without sets.
    pub verified_error_deg: Option<f64>,
    /// Standard deviation of that over the sets, degrees; absent for fewer than two.
    pub verified_sd_deg: Option<f64>,
    /// Mean of the sets' simulated angles, degrees; absent without sets.
    pub repose_deg: Option<f64>,
    /// Standard error of that mean, degrees: the root of the sum of the sets' squared standard
    /// errors over their number, where a set's is `repose_sd_deg` / sqrt(`runs`). Absent without
    /// sets, or if one of them ran only once, as its spread is then unknown.
    pub standard_error_deg: Option<f64>,
    /// Each parameter over the sets; empty without sets.
    pub parameters: Vec<ParameterSpread>,
}

answer! { app::ComparedCalibration => ComparedCalibration {
    id, powder, target, method, evaluations, verification_runs, emulator, sets, verified_error_deg,
    verified_sd_deg, repose_deg, standard_error_deg, parameters,
} }

/// One parameter over the sets of a calibration.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ParameterSpread {
    /// Its key.
    pub key: String,
    /// Mean over the sets.
    pub mean: f64,
    /// Smallest value of a set.
    pub lower: f64,
    /// Largest value of a set.
    pub upper: f64,
}

answer! { app::ParameterSpread => ParameterSpread { key, mean, lower, upper } }

/// What to calibrate: a powder, or a bare angle of repose. Everything else has a default.
#[derive(Debug, Clone, PartialEq, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CalibrationRequest {
    /// Powder id; its newest automated measurement (else manual) is the target.
    pub powder: Option<String>,
    /// Target angle of repose instead of a powder, degrees.
    pub repose_deg: Option<f64>,
    /// Standard deviation of the repeats behind `repose_deg`, 0 to 45 degrees; default 0, an exact
    /// target.
    pub sd_deg: Option<f64>,
    /// Repeats behind `repose_deg`, 1 to 10000; default 1.
    pub n: Option<u32>,
    /// How to search for sets; default `emulator`.
    pub method: Option<CalibrationMethod>,
    /// Parameter sets to find, 1 to 100; default 10.
    pub sets: Option<u32>,
    /// Accepted difference between simulated and measured angle, 0.1 to 10 degrees; default 0.5,
    /// with the other methods 1.5.
    pub tolerance_deg: Option<f64>,
    /// Grains per simulated heap, 100 to 100000; default 2000.
    pub particles: Option<u32>,
    /// Maximum simulations, search and verification together, 1 to 20000; default three times what
    /// verifying all sets takes, with the other methods
    /// 150. For the published method, which verifies afterwards, it limits the search alone.
    pub trials_max: Option<u32>,
    /// Heaps simulated to verify each set, 1 to 50; default 8, with the method `sequential` 2.
    pub verify_repeats: Option<u32>,
    /// Readings per verification heap, 1 to 64; default 4, with the method `sequential` 1.
    pub readings: Option<u32>,
    /// Seed; default 1.
    pub seed: Option<u64>,
    /// Other measurements, up to 8 observations, for the method `emulator`; default those
    /// registered for the powder.
    pub observations: Option<Vec<Observation>>,
    /// Stored shakes of the powder, in place of observations: angle and spoon are met together, and
    /// gravity is held at 1 unless `fixed` says otherwise. Default none.
    #[serde(default)]
    pub shakes: Option<StoredShakes>,
    /// Grains per verification heap, 100 to 100000; default as many as in the other heaps. Not for
    /// the method `sequential`.
    pub verify_particles: Option<u32>,
    /// Parameters held at a value instead of searched, by key, as `{"gravity_scale": 1}`; default
    /// none: all nine are searched.
    #[serde(default)]
    pub fixed: BTreeMap<String, f64>,
    /// Extended simulator version, `sv-…`; default the base.
    #[serde(default)]
    pub simulator: Option<String>,
    /// Conditions under which the target was measured, as `{"relative_humidity_pct": 55}`; the
    /// target is converted to the version's reference. Default: the angle that the version predicts
    /// there, for a powder of its campaign.
    #[serde(default)]
    #[schema(value_type = std::collections::BTreeMap<String, super::Condition>)]
    pub conditions: Day,
    /// What simulates the heaps: the processor, or a graphics card of this process or of a worker,
    /// which has room for 2560 grains. A card's heaps have the statistics of the processor's and other
    /// bytes. Other measurements are simulated on the processor alone.
    #[serde(default)]
    pub device: Device,
    /// What the caller writes on it, to find it again.
    #[serde(default)]
    pub labels: Labels,
}

request! { CalibrationRequest => app::CalibrationRequest {
    powder, repose_deg, sd_deg, n, method, sets, tolerance_deg, particles, trials_max,
    verify_repeats, readings, seed, observations, shakes, verify_particles, fixed, simulator, conditions,
    device, labels,
} }

/// A calibration: its job, its target, and its result once it has succeeded.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Calibration {
    /// The job; the calibration has the same id.
    pub job: Job,
    /// Powder id; absent for a bare angle.
    pub powder: Option<String>,
    /// Target.
    pub target: Flowability,
    /// The extended simulator version and the conditions given; absent for the base.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub under: Option<Under>,
    /// Other measurements.
    pub observations: Vec<Observation>,
    /// What it simulates on; absent for the processor.
    #[serde(skip_serializing_if = "is_default")]
    pub device: Device,
    /// Every setting of the search and of the heap experiment.
    #[schema(value_type = Object)]
    pub settings: serde_json::Value,
    /// Result; absent until it has succeeded.
    pub result: Option<CalibrationResult>,
    /// Whether the simulated heaps are as steep as the measured one; absent without sets.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steepness: Option<Steepness>,
}

answer! { app::Calibration => Calibration {
    job, powder, target, under, observations, device, settings, result, steepness,
} }

/// The simulated heaps of a calibration beside the measured one.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Steepness {
    /// Mean verified angle of the sets, degrees.
    pub simulated_deg: f64,
    /// That minus the measured mean, degrees.
    pub difference_deg: f64,
    /// Expanded uncertainty of the difference (k = 2), degrees: the standard errors of both means.
    /// Absent if the spread of one of them is unknown: of a single heap, or of sets run once.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub uncertainty_deg: Option<f64>,
    /// Whether the difference is within it; absent with it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub agrees: Option<bool>,
}

answer! { app::Steepness => Steepness { simulated_deg, difference_deg, uncertainty_deg, agrees } }

/// Why a calibration simulated a heap.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum TrialPhase {
    /// To find candidates.
    Search,
    /// To check a candidate with a fresh seed.
    Verification,
}

answer! { flip_store::trials::TrialPhase => enum TrialPhase { Search, Verification } }

/// One simulated heap of a calibration.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Trial {
    /// Position in the calibration, from 0.
    pub index: u32,
    /// Why it was simulated.
    pub phase: TrialPhase,
    /// Index of the search trial with these parameters; its own for a search trial.
    pub candidate: u32,
    /// The nine values.
    pub parameters: ParameterSetValues,
    /// Seed of the simulation.
    pub seed: u64,
    /// Number of readings of the heap, over which its angles are averaged.
    #[serde(default)]
    pub readings: u32,
    /// Angle of repose by the tip formula, degrees; absent when the heap has none.
    pub tip_deg: Option<f64>,
    /// Standard deviation of that angle over the readings, degrees; absent for one reading.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tip_sd_deg: Option<f64>,
    /// Slope of the fitted cone, degrees.
    pub cone_deg: Option<f64>,
    /// Creep of the resting heap, degrees per second.
    pub creep_deg_per_s: Option<f64>,
    /// Why the heap has no angle.
    pub refusal: Option<String>,
    /// Absolute difference to the target, degrees.
    pub error_deg: Option<f64>,
    /// Wall-clock time of the simulation, s; the only value here that differs between two runs of
    /// the same calibration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seconds: Option<f64>,
}

answer! { flip_store::trials::Trial => Trial {
    index, phase, candidate, parameters, seed, readings, tip_deg, tip_sd_deg, cone_deg,
    creep_deg_per_s, refusal, error_deg, seconds,
} }

/// Draws from the posterior, with summaries.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Posterior {
    /// Draws, each the nine values in parameter order.
    pub draws: Vec<[f64; COUNT]>,
    /// The angle of each draw, degrees.
    pub repose_deg: Vec<f64>,
    /// Marginal posterior of each parameter.
    pub parameters: Vec<Marginal>,
    /// Pairs that are known only jointly.
    pub together: Vec<Pair>,
    /// Effective number of pool points behind the draws: (sum w)^2 / sum w^2. A small number means
    /// that draws repeat each other.
    pub effective: f64,
}

answer! { app::Posterior => Posterior {
    draws, repose_deg, parameters, together, effective,
} }

/// Marginal posterior of one parameter.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Marginal {
    /// Its key.
    pub key: String,
    /// Posterior mean.
    pub mean: f64,
    /// 16 % and 84 % quantile.
    pub interval: [f64; 2],
    /// 1 - posterior variance / prior variance: 0 if nothing was learned, as of a fixed parameter.
    /// Negative if the posterior concentrates at both ends.
    pub learnt: f64,
    /// Whether none of the measurements depends on it.
    pub inert: bool,
}

answer! { app::Marginal => Marginal { key, mean, interval, learnt, inert } }

/// Two parameters that are known only jointly.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Pair {
    /// Their keys.
    pub keys: [String; 2],
    /// Correlation of their draws, -1 to 1.
    pub correlation: f64,
}

answer! { app::Pair => Pair { keys, correlation } }

/// How parameter sets are searched for.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum CalibrationMethod {
    /// Reads sets off one emulator of the angle, shared by all calibrations, and verifies them.
    Emulator,
    /// Algorithm 1 of the publication: Bayesian optimisation of the error within shrinking bounds.
    Paper,
    /// Bayesian optimisation of the angle for one powder alone, with verification and diversity.
    #[default]
    Sequential,
}

answer! { flip_learn::calibrate::Method => enum CalibrationMethod { Emulator, Paper, Sequential } }
request! { enum CalibrationMethod => flip_learn::calibrate::Method { Emulator, Paper, Sequential } }

/// Why a target could not be reached.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Shortfall {
    /// The simulated angle nearest to the target, degrees: the mean of the verification runs if
    /// there are any.
    pub nearest_repose_deg: f64,
    /// The parameter at one of its bounds whose further change would bring the angle nearest to the
    /// target; none if the target is within reach and only the budget was too small.
    pub limiting_parameter: Option<String>,
}

answer! { flip_learn::calibrate::Shortfall => Shortfall { nearest_repose_deg, limiting_parameter } }
