//! The calibration job: every trial is saved as it completes, and a resumed job replays them. The
//! heaps of the emulator that calibrations share are saved likewise; the first calibration that
//! needs the emulator builds it.

use super::Functions;
use super::card::{HeapsByCard, engine_of};
use super::host::{Finished, JobError, JobHost, Piece, Result, go_on};
use super::observe::{self, Observed};
use super::runner::{HeapExperiment, HeapRunner, Run, in_order};
use super::spec::CalibrationSpec;
use flip_core::domain::parameters::ParameterSet;
use flip_learn::calibrate::{
    self, CalibratedSet, Calibration, Channel, Emulator, Heap, Heard, Knowledge, Pour, Simulate,
};
use flip_sim as sim;
use flip_sim::repose::{Refusal, Repose, Settings as HeapSettings};
use serde::{Deserialize, Serialize};
use std::cell::Cell;
use std::sync::Arc;

pub use flip_learn::calibrate::posterior::{Marginal, Pair, Posterior};
pub use flip_learn::calibrate::{Design, Method, Settings, Shortfall};

/// Number of posterior draws that are kept.
const DRAWS: usize = 400;

/// What a calibration found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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

pub(super) fn perform(
    host: &dyn JobHost,
    functions: &Functions,
    spec: &CalibrationSpec,
) -> Result<()> {
    let card = engine_of(&*functions.card, spec.device)?.map(HeapsByCard::of).map(Arc::new);
    let heaps = card.clone().map_or_else(|| functions.simulate.clone(), |card| card as HeapRunner);
    let done = with_heaps(host, functions, spec, &heaps);
    match card.and_then(|card| card.failed()) {
        Some(cause) if done.is_err() => Err(JobError::Device(format!(
            "{cause}. Start it again, or with `device: cpu`, which simulates every heap anew"
        ))),
        _ => done,
    }
}

fn with_heaps(
    host: &dyn JobHost,
    functions: &Functions,
    spec: &CalibrationSpec,
    heaps: &HeapRunner,
) -> Result<()> {
    let simulator = Simulator { heaps, seconds: Cell::default() };
    let history = host.trials()?;
    let shared = spec.design.as_ref();
    let shared =
        shared.map(|design| emulator(host, design, &spec.simulator, &simulator)).transpose()?;
    let observers = observe::Under { runner: &functions.observe, patch: &spec.patch };
    let (channels, built): (Vec<Channel>, Vec<u32>) = match &shared {
        Some((emulator, _)) => {
            observe::channels(host, &observers, &spec.observations, emulator, &spec.simulator)?
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
        &simulator,
        |trial, progress| {
            let saved = host.save(Piece::Trial { trial, seconds: simulator.seconds.get() });
            go_on(host, saved.and_then(|()| host.report(progress)), &mut unsaved)
        },
    );
    let calibration = settled(found, unsaved)?;
    let target = calibrate::in_emulator_heaps(&spec.target, calibration.size_shift_deg);
    let space = spec.settings.space().map_err(|error| JobError::Fail(error.to_string()))?;
    let seed = spec.settings.seed;
    let posterior = knowledge.map(|known| Posterior::within(space, known, &target, DRAWS, seed));
    let sets: Vec<ParameterSet> = calibration.sets.iter().map(|set| set.parameters).collect();
    let observed = observe::look(host, &observers, &channels, &built, &sets, seed)?;
    finish(host, spec, calibration, shared.map(|(_, used)| used), posterior, observed)
}

/// The simulator of heaps.
struct Simulator<'a> {
    heaps: &'a HeapRunner,
    /// Duration of the heap that was handed over last, s.
    seconds: Cell<Option<f64>>,
}

impl Simulate<Pour, Heap> for &Simulator<'_> {
    fn simulate(&self, pours: &[Pour], heard: &mut Heard<'_, Heap>) {
        let experiment = |pour: &Pour| HeapExperiment {
            set: pour.parameters,
            settings: HeapSettings {
                readings: pour.readings,
                ..HeapSettings::with_particles(pour.particles)
            },
            seed: pour.seed,
        };
        let heap = |outcome: std::result::Result<Repose, Refusal>| {
            let repose = outcome.map_err(|refusal| refusal.to_string())?;
            let Repose { tip_deg, tip_sd_deg, cone_deg, creep_deg_per_s, .. } = repose;
            Ok(Heap { tip_deg, tip_sd_deg, cone_deg, creep_deg_per_s })
        };
        let experiments: Vec<HeapExperiment> = pours.iter().map(experiment).collect();
        in_order(&**self.heaps, &experiments, |Run { outcome, seconds }| {
            self.seconds.set(Some(seconds));
            heard(heap(outcome))
        });
    }
}

/// The emulator of a design, with the stored heaps, and the missing ones.
fn emulator(
    host: &dyn JobHost,
    design: &Design,
    version: &str,
    simulator: &Simulator<'_>,
) -> Result<(Emulator, EmulatorUse)> {
    let id = design.id(version);
    let stored = host.emulator_heaps(&id)?;
    let mut unsaved = None;
    let built = calibrate::build(design, sim::directions, &stored, simulator, |heap, progress| {
        let piece = Piece::EmulatorHeap { emulator: &id, heap, seconds: simulator.seconds.get() };
        let saved = host.save(piece).and_then(|()| host.report(progress));
        go_on(host, saved, &mut unsaved)
    });
    let emulator = settled(built, unsaved)?;
    let (sha256, runs) = (emulator.hash().to_owned(), emulator.runs());
    Ok((emulator, EmulatorUse { id, sha256, runs, built: runs - stored.len() as u32 }))
}

/// The result of a step of a calibration; what could not be saved comes first.
pub(super) fn settled<T>(
    found: std::result::Result<T, calibrate::Error>,
    unsaved: Option<JobError>,
) -> Result<T> {
    match (found, unsaved) {
        (_, Some(error)) => Err(error),
        (Ok(found), None) => Ok(found),
        (Err(calibrate::Error::Stopped), None) => Err(JobError::Stopped),
        (Err(error), None) => Err(JobError::Fail(error.to_string())),
    }
}

fn finish(
    host: &dyn JobHost,
    spec: &CalibrationSpec,
    calibration: Calibration,
    emulator: Option<EmulatorUse>,
    posterior: Option<Posterior>,
    observed: Vec<Observed>,
) -> Result<()> {
    let text = posterior.as_ref().map(serde_json::to_vec).transpose();
    let text = text.map_err(|error| JobError::Fail(error.to_string()))?;
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
        posterior: text.map(|text| host.put(&text)).transpose()?,
        observed,
    };
    host.finish(&Finished::Calibration { spec, result: &result })
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
