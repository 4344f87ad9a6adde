//! The calibration job: every trial is saved as it completes, and a resumed job replays them. The
//! heaps of the emulator that calibrations share are saved likewise; the first calibration that
//! needs the emulator builds it.

use super::context::{JobContext, JobError};
use super::observe::{self, Observed};
use super::spec::CalibrationSpec;
use flip_core::domain::job::Progress;
use flip_core::domain::parameters::ParameterSet;
use flip_learn::calibrate::{
    self, CalibratedSet, Calibration, Channel, Emulator, Heap, Knowledge, Outcome, Phase, Pour,
};
use flip_sim::{self as sim, repose};
use flip_store::parameter_sets::NewSet;
use flip_store::trials::{Trial, TrialPhase};
use flip_store::{self as store, Tx};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::ops::{AsyncFnOnce, ControlFlow};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

pub use flip_learn::calibrate::posterior::{Marginal, Pair, Posterior};
pub use flip_learn::calibrate::{Design, Method, Settings, Shortfall};

/// Number of posterior draws that are kept.
const DRAWS: usize = 400;

/// What a calibration found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct CalibrationResult {
    /// Whether as many sets were found as requested.
    #[serde(default = "yes")]
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

fn yes() -> bool {
    true
}

/// The emulator that a calibration used.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
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

/// One set found by a calibration.
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
    /// The error by which the method chose it, degrees: with the published method, that of its
    /// search run, otherwise the verified one.
    pub error_deg: f64,
    /// Absolute difference between mean and target, degrees; absent in results stored before it was
    /// distinguished from `error_deg`.
    #[serde(default)]
    pub verified_error_deg: Option<f64>,
}

pub(super) fn perform(context: &JobContext, spec: &CalibrationSpec) -> Result<(), JobError> {
    let history = context.read(context.store.all_trials(context.id()))?;
    let history: Vec<calibrate::Trial> = history.into_iter().map(from_row).collect();
    let clock = Clock::default();
    let simulate = |set: &ParameterSet, pour: Pour, seed: u64| {
        let settings = repose::Settings {
            readings: pour.readings,
            ..repose::Settings::with_particles(pour.particles)
        };
        let begun = Instant::now();
        let repose = (context.functions.simulate)(set, &settings, seed);
        clock
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .insert(seed, begun.elapsed().as_secs_f64());
        let repose = repose?;
        let repose::Repose { tip_deg, tip_sd_deg, cone_deg, creep_deg_per_s, .. } = repose;
        Ok::<_, repose::Refusal>(Heap { tip_deg, tip_sd_deg, cone_deg, creep_deg_per_s })
    };
    let shared = spec
        .design
        .as_ref()
        .map(|design| emulator(context, design, &spec.simulator, simulate, &clock))
        .transpose()?;
    let (channels, built): (Vec<Channel>, Vec<u32>) = match &shared {
        Some((emulator, _)) => {
            observe::channels(context, &spec.observations, emulator, &spec.simulator)?
        }
        None => Vec::new(),
    }
    .into_iter()
    .unzip();
    let knowledge =
        shared.as_ref().map(|(emulator, _)| Knowledge { emulator, channels: &channels });
    let mut unsaved = None;
    let found = calibrate::calibrate(
        &spec.target,
        &spec.settings,
        knowledge,
        &history,
        simulate,
        |trial, progress| {
            let row = timed(trial, &clock);
            let saved = keep(context, progress, async |tx| {
                tx.insert_trial(context.id(), &row).await?;
                context.tell(tx, "trial", &row).await
            });
            unless(saved, &mut unsaved, context)
        },
    );
    match (found, unsaved) {
        (_, Some(error)) => Err(error.into()),
        (Ok(calibration), None) => {
            let target = calibrate::in_emulator_heaps(&spec.target, calibration.size_shift_deg);
            let posterior =
                knowledge.map(|known| Posterior::of(known, &target, DRAWS, spec.settings.seed));
            let sets: Vec<ParameterSet> =
                calibration.sets.iter().map(|set| set.parameters).collect();
            let observed = observe::look(context, &channels, &built, &sets, spec.settings.seed)?;
            finish(context, spec, calibration, shared.map(|(_, used)| used), posterior, observed)
        }
        (Err(calibrate::Error::Stopped), None) => Err(JobError::Stopped),
        (Err(error), None) => Err(JobError::Fail(error.to_string())),
    }
}

/// The emulator of a design, with the stored heaps, and the missing ones.
fn emulator(
    context: &JobContext,
    design: &Design,
    simulator: &str,
    simulate: impl Fn(&ParameterSet, Pour, u64) -> Result<Heap, repose::Refusal> + Sync,
    clock: &Clock,
) -> Result<(Emulator, EmulatorUse), JobError> {
    let id = design.id(simulator);
    let stored = context.read(context.store.emulator_runs(&id))?;
    let stored: Vec<calibrate::Trial> = stored.into_iter().map(from_row).collect();
    let mut unsaved = None;
    let built = calibrate::build(design, sim::directions, &stored, simulate, |run, progress| {
        let row = timed(run, clock);
        let saved = keep(context, progress, async |tx| tx.insert_emulator_run(&id, &row).await);
        unless(saved, &mut unsaved, context)
    });
    match (built, unsaved) {
        (_, Some(error)) => Err(error.into()),
        (Ok(emulator), None) => {
            let (sha256, runs) = (emulator.hash().to_owned(), emulator.runs());
            Ok((emulator, EmulatorUse { id, sha256, runs, built: runs - stored.len() as u32 }))
        }
        (Err(calibrate::Error::Stopped), None) => Err(JobError::Stopped),
        (Err(error), None) => Err(JobError::Fail(error.to_string())),
    }
}

/// Saves a new item and reports progress.
pub(super) fn keep(
    context: &JobContext,
    progress: &Progress,
    save: impl AsyncFnOnce(&mut Tx) -> store::Result<()>,
) -> store::Result<()> {
    context.save(async |tx| save(tx).await.map(|()| true))?;
    context.report(progress)
}

/// Continues unless the job was asked to stop or the last item could not be saved, in which case
/// the error is left in `unsaved`.
pub(super) fn unless(
    saved: store::Result<()>,
    unsaved: &mut Option<store::Error>,
    context: &JobContext,
) -> ControlFlow<()> {
    match saved {
        Ok(()) => context.flow(),
        Err(error) => {
            *unsaved = Some(error);
            ControlFlow::Break(())
        }
    }
}

fn finish(
    context: &JobContext,
    spec: &CalibrationSpec,
    calibration: Calibration,
    emulator: Option<EmulatorUse>,
    posterior: Option<Posterior>,
    observed: Vec<Observed>,
) -> Result<(), JobError> {
    let posterior = match posterior {
        Some(posterior) => {
            let text = serde_json::to_vec(&posterior)
                .map_err(|error| JobError::Fail(error.to_string()))?;
            Some(context.store.artifacts().put(&text)?)
        }
        None => None,
    };
    let result = CalibrationResult {
        reached: calibration.shortfall.is_none(),
        evaluations: calibration.evaluations,
        verification_runs: calibration.verification_runs,
        sets: calibration.sets.iter().map(kept).collect(),
        mean_error_deg: calibration.mean_error_deg,
        sd_error_deg: calibration.sd_error_deg,
        verified_error_deg: calibration.verified_error_deg,
        size_shift_deg: calibration.size_shift_deg,
        shortfall: calibration.shortfall,
        emulator,
        posterior,
        observed,
    };
    context.succeed(&result, async |tx| {
        for (position, set) in (0..).zip(calibration.sets) {
            let new = NewSet {
                parameters: set.parameters,
                repose_deg: set.repose_deg,
                repose_sd_deg: set.repose_sd_deg,
                runs: set.runs,
                error_deg: set.verified_error_deg,
                simulator: spec.under.as_ref().map(|under| under.simulator.clone()),
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
        verified_error_deg: Some(set.verified_error_deg),
    }
}

/// Duration of each simulation, by seed, until it is stored; s.
type Clock = Mutex<HashMap<u64, f64>>;

fn timed(trial: &calibrate::Trial, clock: &Clock) -> Trial {
    let seconds = clock.lock().unwrap_or_else(PoisonError::into_inner).remove(&trial.seed);
    Trial { seconds, ..to_row(trial) }
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
        readings: trial.readings,
        tip_sd_deg: heap.and_then(|h| h.tip_sd_deg),
        tip_deg: heap.map(|h| h.tip_deg),
        cone_deg: heap.map(|h| h.cone_deg),
        creep_deg_per_s: heap.map(|h| h.creep_deg_per_s),
        refusal,
        error_deg: trial.error_deg,
        seconds: None,
    }
}

fn from_row(row: Trial) -> calibrate::Trial {
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
