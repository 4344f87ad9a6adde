//! Rows of the store for what bodies save.

use super::calibrate::CalibrationSet;
use flip_learn::calibrate::{self, Heap, Outcome, Phase};
use flip_learn::train::EpisodeRecord;
use flip_store::parameter_sets::NewSet;
use flip_store::trials::{Episode, Trial, TrialPhase};

pub(super) fn trial(trial: &calibrate::Trial, seconds: Option<f64>) -> Trial {
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
        readings: trial.readings,
        tip_sd_deg: heap.and_then(|h| h.tip_sd_deg),
        tip_deg: heap.map(|h| h.tip_deg),
        cone_deg: heap.map(|h| h.cone_deg),
        creep_deg_per_s: heap.map(|h| h.creep_deg_per_s),
        refusal,
        error_deg: trial.error_deg,
        seconds,
    }
}

pub(super) fn trial_of(row: Trial) -> calibrate::Trial {
    let outcome = match (row.tip_deg, row.cone_deg, row.creep_deg_per_s) {
        (Some(tip_deg), Some(cone_deg), Some(creep_deg_per_s)) => {
            Outcome::Heap(Heap { tip_deg, tip_sd_deg: row.tip_sd_deg, cone_deg, creep_deg_per_s })
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
        readings: row.readings,
        outcome,
        error_deg: row.error_deg,
    }
}

pub(super) fn set(set: &CalibrationSet, simulator: Option<&str>) -> NewSet {
    NewSet {
        parameters: set.parameters,
        repose_deg: set.repose_deg,
        repose_sd_deg: set.repose_sd_deg,
        runs: set.runs,
        error_deg: set.verified_error_deg.unwrap_or(set.error_deg),
        simulator: simulator.map(str::to_owned),
    }
}

pub(super) fn episode(record: &EpisodeRecord) -> Episode {
    let losses = record.losses.as_ref();
    Episode {
        index: record.index,
        level: record.level,
        powder: record.powder.clone(),
        parameter_set: record.parameter_set.clone(),
        target_mg: record.target_mg,
        dispensed_mg: record.dispensed_mg,
        final_error_mg: record.final_error_mg,
        reward: record.reward,
        steps: record.steps,
        alpha: losses.map(|l| l.alpha),
        critic_loss: losses.map(|l| l.critic),
        actor_loss: losses.map(|l| l.actor),
    }
}
