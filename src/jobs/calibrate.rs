//! The calibration job: every trial is saved as it comes, and a resumed job replays them.

use super::context::{JobContext, JobError};
use super::spec::CalibrationSpec;
use crate::calibrate::{self, CalibratedSet, Calibration, Heap, Outcome, Phase};
use crate::domain::parameters::ParameterSet;
use crate::sim::repose;
use crate::store::parameter_sets::NewSet;
use crate::store::trials::{Trial, TrialPhase};
use serde::{Deserialize, Serialize};
use std::ops::ControlFlow;

pub use crate::calibrate::Settings;

/// What a calibration found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct CalibrationResult {
    /// Simulations of the search.
    pub evaluations: u32,
    /// Simulations with fresh seeds that checked candidates.
    pub verification_runs: u32,
    /// The sets it kept.
    pub sets: Vec<CalibrationSet>,
    /// Mean of the sets' errors, degrees.
    pub mean_error_deg: f64,
    /// Standard deviation of the sets' errors, degrees; absent for a single set.
    pub sd_error_deg: Option<f64>,
}

/// One set that a calibration kept.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct CalibrationSet {
    /// Content address of the nine values.
    pub id: String,
    /// The nine values.
    pub parameters: ParameterSet,
    /// Mean simulated angle over its runs, degrees.
    pub repose_deg: f64,
    /// Standard deviation over its runs, degrees; absent for a single run.
    pub repose_sd_deg: Option<f64>,
    /// Simulations behind the mean.
    pub runs: u32,
    /// Absolute difference between mean and target, degrees.
    pub error_deg: f64,
}

pub(super) fn perform(context: &JobContext, spec: &CalibrationSpec) -> Result<(), JobError> {
    let history = context.read(context.store.all_trials(context.id()))?;
    let history: Vec<calibrate::Trial> = history.into_iter().map(from_row).collect();
    let heap = repose::Settings::with_particles(spec.settings.particles);
    let simulate = |set: &ParameterSet, seed: u64| {
        let repose = (context.functions.simulate)(set, &heap, seed)?;
        let (tip_deg, cone_deg, creep_deg_per_s) = (repose.tip_deg, repose.cone_deg, repose.creep_deg_per_s);
        Ok::<_, repose::Refusal>(Heap { tip_deg, cone_deg, creep_deg_per_s })
    };
    let mut unsaved = None;
    let found = calibrate::calibrate(&spec.target, &spec.settings, &history, simulate, |trial, progress| {
        let row = to_row(trial);
        let saved = context.save(async |tx| {
            tx.insert_trial(context.id(), &row).await?;
            context.tell(tx, "trial", &row).await?;
            Ok(true)
        });
        match saved.and_then(|()| context.report(progress)) {
            Ok(()) => context.flow(),
            Err(error) => {
                unsaved = Some(error);
                ControlFlow::Break(())
            }
        }
    });
    match (found, unsaved) {
        (_, Some(error)) => Err(error.into()),
        (Ok(calibration), None) => finish(context, spec, calibration),
        (Err(calibrate::Error::Stopped), None) => Err(JobError::Stopped),
        (Err(error), None) => Err(JobError::Fail(error.to_string())),
    }
}

fn finish(context: &JobContext, spec: &CalibrationSpec, calibration: Calibration) -> Result<(), JobError> {
    let result = CalibrationResult {
        evaluations: calibration.evaluations,
        verification_runs: calibration.verification_runs,
        sets: calibration.sets.iter().map(kept).collect(),
        mean_error_deg: calibration.mean_error_deg.unwrap_or(0.0),
        sd_error_deg: calibration.sd_error_deg,
    };
    context.succeed(&result, async |tx| {
        for (position, set) in (0..).zip(calibration.sets) {
            let new = NewSet {
                parameters: set.parameters,
                repose_deg: set.repose_deg,
                repose_sd_deg: set.repose_sd_deg,
                runs: set.runs,
                error_deg: set.error_deg,
            };
            tx.insert_parameter_set(context.id(), spec.powder.as_deref(), position, &new).await?;
        }
        Ok(())
    })?;
    Ok(())
}

fn kept(set: &CalibratedSet) -> CalibrationSet {
    CalibrationSet {
        id: set.parameters.id(),
        parameters: set.parameters,
        repose_deg: set.repose_deg,
        repose_sd_deg: set.repose_sd_deg,
        runs: set.runs,
        error_deg: set.error_deg,
    }
}

fn to_row(trial: &calibrate::Trial) -> Trial {
    let (heap, refusal) = match &trial.outcome {
        Outcome::Heap(heap) => (Some(heap), None),
        Outcome::Refused(reason) => (None, Some(reason.clone())),
    };
    Trial {
        index: trial.index,
        phase: match trial.phase {
            Phase::Search => TrialPhase::Search,
            Phase::Verification => TrialPhase::Verification,
        },
        candidate: trial.candidate,
        parameters: trial.parameters,
        seed: trial.seed,
        tip_deg: heap.map(|h| h.tip_deg),
        cone_deg: heap.map(|h| h.cone_deg),
        creep_deg_per_s: heap.map(|h| h.creep_deg_per_s),
        refusal,
        error_deg: trial.error_deg,
    }
}

fn from_row(row: Trial) -> calibrate::Trial {
    let outcome = match (row.tip_deg, row.cone_deg, row.creep_deg_per_s) {
        (Some(tip_deg), Some(cone_deg), Some(creep_deg_per_s)) => {
            Outcome::Heap(Heap { tip_deg, cone_deg, creep_deg_per_s })
        }
        _ => Outcome::Refused(row.refusal.unwrap_or_default()),
    };
    calibrate::Trial {
        index: row.index,
        phase: match row.phase {
            TrialPhase::Search => Phase::Search,
            TrialPhase::Verification => Phase::Verification,
        },
        candidate: row.candidate,
        parameters: row.parameters,
        seed: row.seed,
        outcome,
        error_deg: row.error_deg,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trial_survives_the_database_exactly() {
        let heap = Outcome::Heap(Heap { tip_deg: 31.25, cone_deg: 30.5, creep_deg_per_s: 0.001 });
        for outcome in [heap, Outcome::Refused("too few grains".into())] {
            let trial = calibrate::Trial {
                index: 7,
                phase: Phase::Verification,
                candidate: 3,
                parameters: ParameterSet::default(),
                seed: u64::MAX - 5,
                error_deg: outcome.tip_deg().map(|_| 0.75),
                outcome,
            };
            let text = serde_json::to_string(&to_row(&trial)).unwrap();
            assert_eq!(from_row(serde_json::from_str(&text).unwrap()), trial);
        }
    }
}
