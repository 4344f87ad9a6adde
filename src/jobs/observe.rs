//! Measurements other than the angle: their emulators before a calibration, and a check of the sets
//! after it. Every simulation is saved as it completes.

use super::calibrate::settled;
use super::host::{JobError, JobHost, Piece, Result, go_on};
use super::runner::{ObservableExperiment, ObservableRunner, Run, in_order};
use flip_core::domain::conditions::Patch;
use flip_core::domain::observable::{Observable, Observation};
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use flip_core::stats::summary;
use flip_learn::calibrate::channel::{self, RUNS};
use flip_learn::calibrate::{Channel, Emulator, Heard, Instrument, Probe, Simulate};
use flip_sim::observe;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

/// Simulations per set and observable in the final check.
const REPEATS: u32 = 4;
/// Standard errors within which simulation and measurement agree.
const SIGNIFICANT: f64 = 2.0;

/// Comparison of a calibration's sets with an observation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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

/// Simulations of an observation with one set.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Simulated {
    /// Mean over the simulations, in the observable's unit; absent if each was refused or nothing
    /// flowed.
    pub mean: Option<f64>,
    /// Standard deviation over them.
    pub sd: Option<f64>,
    /// Simulations with a result.
    pub runs: u32,
}

/// Who simulates, and what a version changes about spoons.
pub(super) struct Under<'a> {
    pub runner: &'a ObservableRunner,
    pub patch: &'a Patch,
}

const INSTRUMENT: Instrument = Instrument { numbers: observe::numbers, value: observe::value };

/// The emulators of all measurements other than the angle, each with the number of its simulations
/// that were run now.
pub(super) fn channels(
    host: &dyn JobHost,
    simulator: &Under<'_>,
    observations: &[Observation],
    emulator: &Emulator,
    version: &str,
) -> Result<Vec<(Channel, u32)>> {
    let channel = |observation: &Observation| {
        let experiment = observation.observable.experiment();
        let text = match simulator.patch.is_none() {
            true => serde_json::to_string(&(version, experiment, emulator.hash(), RUNS)),
            false => {
                let of = (version, experiment, emulator.hash(), RUNS, simulator.patch);
                serde_json::to_string(&of)
            }
        };
        let text = text.expect("numbers and text");
        let owner = format!("ob-{}", &hex::encode(Sha256::digest(text))[..16]);
        let plan = channel::design(emulator, &INSTRUMENT);
        let (runs, built) = probes(host, simulator, &owner, plan, observation.observable)?;
        let channel = Channel::of(*observation, &runs, INSTRUMENT);
        let channel = channel.ok_or_else(|| {
            let what = observation.observable.kind();
            JobError::Fail(format!("no simulation has a {what}: measure something else"))
        })?;
        Ok((channel, built))
    };
    observations.iter().map(channel).collect()
}

/// Checks the sets that a calibration ended with.
pub(super) fn look(
    host: &dyn JobHost,
    simulator: &Under<'_>,
    channels: &[Channel],
    built: &[u32],
    sets: &[ParameterSet],
    seed: u64,
) -> Result<Vec<Observed>> {
    let look = |(position, (channel, built)): (usize, (&Channel, &u32))| {
        let observation = channel.observation;
        let owner = format!("{}/{position}", host.id());
        let plan = channel::planned(sets, REPEATS, derive(seed, &[position as u64]));
        let (runs, _) = probes(host, simulator, &owner, plan, observation.observable)?;
        let values = |runs: &[Probe]| -> Vec<f64> {
            let values =
                runs.iter().filter_map(|run| Some(channel.value(&run.parameters, run.reduced?)));
            values.filter(|value| value.is_finite()).collect()
        };
        let of_set = |runs: &[Probe]| {
            let values = values(runs);
            Simulated {
                mean: summary::mean(&values),
                sd: summary::sd(&values),
                runs: values.len() as u32,
            }
        };
        let simulated: Vec<Simulated> = runs.chunks(REPEATS as usize).map(of_set).collect();
        let means: Vec<f64> = simulated.iter().filter_map(|set| set.mean).collect();
        let mean = summary::mean(&means);
        let error = summary::standard_error(&means).unwrap_or(0.0);
        let allowed = SIGNIFICANT * error.hypot(observation.sd / f64::from(observation.n).sqrt());
        let agrees = means.len() == sets.len()
            && mean.is_some_and(|mean| (mean - observation.mean).abs() <= allowed);
        let sha256 = channel.sha256().to_owned();
        Ok(Observed { observation, sha256, built: *built, sets: simulated, mean, agrees })
    };
    channels.iter().zip(built).enumerate().map(look).collect()
}

/// Simulates an observable.
struct Observing<'a> {
    under: &'a Under<'a>,
    observable: Observable,
}

impl Simulate<Probe, f64> for Observing<'_> {
    fn simulate(&self, probes: &[Probe], heard: &mut Heard<'_, f64>) {
        let experiment = |of: &Probe| ObservableExperiment {
            observable: self.observable,
            set: of.parameters,
            patch: self.under.patch.clone(),
            seed: of.seed,
        };
        let experiments: Vec<_> = probes.iter().map(experiment).collect();
        in_order(&**self.under.runner, &experiments, |Run { outcome, .. }| {
            heard(outcome.map_err(|refusal| refusal.to_string()))
        });
    }
}

/// Carries out a plan, reusing stored runs; returns the runs and how many of them are new.
fn probes(
    host: &dyn JobHost,
    simulator: &Under<'_>,
    owner: &str,
    plan: Vec<Probe>,
    observable: Observable,
) -> Result<(Vec<Probe>, u32)> {
    let stored = host.probes(owner)?;
    let simulate = Observing { under: simulator, observable };
    let mut unsaved = None;
    let runs = channel::carry_out(plan, &stored, observable.kind(), simulate, |probe, progress| {
        let saved = host.save(Piece::Probe { owner, probe }).and_then(|()| host.report(progress));
        go_on(host, saved, &mut unsaved)
    });
    let runs = settled(runs, unsaved)?;
    let new = runs.len() - stored.len().min(runs.len());
    Ok((runs, new as u32))
}
