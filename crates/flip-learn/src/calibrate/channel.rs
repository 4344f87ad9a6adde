//! Observables other than the angle of repose: an emulator of each, built when a measurement
//! includes it.
//!
//! [`RUNS`] simulations are run at points that the emulator of the angle places between 20 and 52
//! deg, spread over the numbers the observable depends on. A Gaussian process of the reduced number
//! (`sim/observe.rs`) is fitted to them; its noise is that of one simulation.

use super::emulator::{ASKED, Emulator};
use super::space;
use super::trial::micro;
use super::{Error, Simulate, in_order};
use flip_core::domain::job::Progress;
use flip_core::domain::observable::{Observable, Observation};
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use flip_core::stats::gaussian_process::evidence::Prior;
use flip_core::stats::gaussian_process::{GaussianProcess, Prediction};
use flip_core::stats::latin_hypercube::{distance, latin_hypercube};
use rand::SeedableRng;
use rand_pcg::Pcg64;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::ops::ControlFlow;

/// Number of inputs an observable depends on.
pub const NUMBERS: usize = 7;
/// Simulations behind the emulator of an observable.
pub const RUNS: usize = 128;
/// Number of points from which those of the runs are chosen.
const POOL: usize = 6000;
/// Seeds of the pool and of the runs; used for nothing else.
const POINTS: u64 = u64::MAX - 3;

/// Properties of the simulator's observables that need no simulation.
#[derive(Debug, Clone, Copy)]
pub struct Instrument {
    /// Maps a parameter set to the numbers its observables depend on, each 0 to 1.
    pub numbers: fn(&ParameterSet) -> [f64; NUMBERS],
    /// Converts a reduced number of a set to the observable's unit.
    pub value: fn(&Observable, &ParameterSet, f64) -> f64,
}

/// One simulation of an observable.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Probe {
    /// Index among the runs with its purpose, from 0.
    pub index: u32,
    /// The simulated parameters.
    pub parameters: ParameterSet,
    /// Seed of the simulation.
    pub seed: u64,
    /// The reduced number; none if the simulation was refused.
    pub reduced: Option<f64>,
    /// Why it was refused.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub refusal: Option<String>,
}

impl Probe {
    /// This simulation with its result. One that is not a number counts as refused.
    fn concluded(self, reduced: Result<f64, String>) -> Self {
        match reduced {
            Ok(reduced) if reduced.is_finite() => Self { reduced: Some(micro(reduced)), ..self },
            Ok(_) => {
                let refusal = "the simulated observable is not a number".to_owned();
                Self { refusal: Some(refusal), ..self }
            }
            Err(reason) => Self { refusal: Some(reason), ..self },
        }
    }
}

/// A measured observable and the emulator of it.
#[derive(Debug, Clone)]
pub struct Channel {
    /// What was measured.
    pub observation: Observation,
    instrument: Instrument,
    reduced: GaussianProcess<NUMBERS>,
    sha256: String,
}

/// Knowledge of simulated powders: the angle and other measured observables.
#[derive(Debug, Clone, Copy)]
pub struct Knowledge<'a> {
    /// Emulator of the angle of repose.
    pub emulator: &'a Emulator,
    /// Emulators of the other measured observables.
    pub channels: &'a [Channel],
}

impl<'a> From<&'a Emulator> for Knowledge<'a> {
    fn from(emulator: &'a Emulator) -> Self {
        Self { emulator, channels: &[] }
    }
}

/// Plans the runs of an observable's emulator: points and seeds.
pub fn design(emulator: &Emulator, instrument: &Instrument) -> Vec<Probe> {
    let mut rng = Pcg64::seed_from_u64(derive(1, &[POINTS]));
    let pool = latin_hypercube(POOL, &mut rng);
    let sets: Vec<ParameterSet> = pool.par_iter().map(space::parameters_at).collect();
    let asked = |set: &&ParameterSet| (ASKED[0]..=ASKED[1]).contains(&emulator.mean_deg(set));
    let mut left: Vec<_> = sets
        .par_iter()
        .filter(asked)
        .map(|set| (*set, (instrument.numbers)(set), f64::MAX))
        .collect();
    let mut chosen = Vec::new();
    // Each point is the farthest from those before it.
    while chosen.len() < RUNS && !left.is_empty() {
        let farthest =
            (0..left.len()).max_by(|a, b| left[*a].2.total_cmp(&left[*b].2)).expect("not empty");
        let (set, numbers, _) = left.swap_remove(farthest);
        left.par_iter_mut()
            .for_each(|(_, other, nearest)| *nearest = nearest.min(distance(other, &numbers)));
        chosen.push(set);
    }
    planned(&chosen, 1, 1)
}

/// Plans `repeats` simulations of each set, each with its own seed.
pub fn planned(sets: &[ParameterSet], repeats: u32, seed: u64) -> Vec<Probe> {
    let each = sets.iter().flat_map(|set| (0..repeats).map(move |_| *set));
    let probe = |(index, parameters): (u32, ParameterSet)| Probe {
        index,
        parameters,
        seed: derive(seed, &[POINTS, u64::from(index)]),
        reduced: None,
        refusal: None,
    };
    (0..).zip(each).map(probe).collect()
}

/// Carries out the planned runs not yet in `history`, which holds the first of them.
///
/// `simulate` gives the reduced numbers; `on_run` is called with every new run in order, and `Break` stops.
///
/// # Errors
/// [`Error::Stopped`]; [`Error::History`] if the history does not match the plan.
///
/// # Panics
/// `simulate` returns more outcomes than there are runs.
pub fn carry_out(
    plan: Vec<Probe>,
    history: &[Probe],
    what: &str,
    simulate: impl Simulate<Probe, f64>,
    mut on_run: impl FnMut(&Probe, &Progress) -> ControlFlow<()>,
) -> Result<Vec<Probe>, Error> {
    for (planned, known) in plan.iter().zip(history) {
        if (planned.index, planned.seed, planned.parameters)
            != (known.index, known.seed, known.parameters)
        {
            return Err(Error::History { index: planned.index });
        }
    }
    let all = plan.len();
    let mut runs = history[..history.len().min(all)].to_vec();
    let new = &plan[runs.len()..];
    in_order(&simulate, new, |k, reduced| {
        runs.push(new[k].clone().concluded(reduced));
        let progress = Progress {
            fraction: runs.len() as f64 / all as f64,
            message: format!("{what}, simulation {} of {all}", runs.len()),
        };
        on_run(&runs[runs.len() - 1], &progress)
    })?;
    Ok(runs)
}

impl Channel {
    /// Builds a channel from a measurement and the runs of its emulator; none if the runs are
    /// insufficient.
    pub fn of(observation: Observation, runs: &[Probe], instrument: Instrument) -> Option<Self> {
        let seen = runs
            .iter()
            .filter_map(|run| Some(((instrument.numbers)(&run.parameters), run.reduced?)));
        let (inputs, outputs): (Vec<_>, Vec<_>) = seen.unzip();
        let prior = Prior { noise_sd: (0.2, 0.7), ..Prior::default() };
        let reduced = GaussianProcess::fit(&inputs, &outputs, &prior).ok()?;
        let sha256 =
            hex::encode(Sha256::digest(serde_json::to_string(runs).expect("numbers and text")));
        Some(Self { observation, instrument, reduced, sha256 })
    }

    /// SHA-256 of the runs it was built from.
    pub fn sha256(&self) -> &str {
        &self.sha256
    }

    /// The reduced number expected for a set.
    pub fn expect(&self, set: &ParameterSet) -> Prediction {
        self.reduced.predict(&(self.instrument.numbers)(set))
    }

    /// Converts a reduced number of a set to the observable's unit.
    pub fn value(&self, set: &ParameterSet, reduced: f64) -> f64 {
        (self.instrument.value)(&self.observation.observable, set, reduced)
    }

    /// Whether the observable cannot tell two sets apart.
    pub fn sees_alike(&self, a: &ParameterSet, b: &ParameterSet) -> bool {
        (self.instrument.numbers)(a) == (self.instrument.numbers)(b)
            && self.value(a, 1.0) == self.value(b, 1.0)
    }

    /// Distance of a set's expected value from the measurement, in units of twice the standard
    /// error or of the share [`ALIKE`], whichever is larger. Capped at 20, so that a powder that no
    /// set explains still gets the nearest one.
    pub(super) fn misfit(&self, set: &ParameterSet) -> f64 {
        let Observation { mean, sd, n, .. } = self.observation;
        let expected = self.value(set, self.reduced.mean(&(self.instrument.numbers)(set)));
        let allowed = (2.0 * sd / f64::from(n).sqrt()).max(ALIKE * mean.abs());
        ((expected - mean).abs() / allowed.max(f64::MIN_POSITIVE)).min(20.0)
    }
}

/// Relative difference below which a set need not be closer to an observation: the scatter between
/// seeds is of this size.
const ALIKE: f64 = 0.05;
