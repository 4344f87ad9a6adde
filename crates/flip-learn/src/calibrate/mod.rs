//! From a measured angle of repose to parameter sets whose simulated heap has it.
//!
//! Three methods ([`Method`]), one loop. Each round of simulations is a pure function of the trials
//! before it:
//!
//! | method | file | what a round is |
//! |---|---|---|
//! | `emulator` | `amortised.rs` | read sets off the emulator that all powders share (`emulator.rs`), verify them |
//! | `paper` | `paper.rs` | one point of Bayesian optimisation of the error, in bounds that shrink; at the end, verification |
//! | `sequential` | `propose.rs` | a batch of points by expected improvement of an own Gaussian process; verification of likely ones |
//!
//! This makes the result independent of the number of threads, and resuming trivial: the history is
//! replayed through the same rounds, and only the missing part is simulated. Sets are verified by
//! heaps with fresh seeds ([`Settings::verify_repeats`]) whose mean must be within the tolerance
//! (`verify.rs`).
//!
//! The `sequential` method in steps: the first round is a space-filling design
//! ([`Settings::initial`] points); a Gaussian process of the angle is fitted to all trials so far;
//! search trials that it considers likely to be within the tolerance are *candidates* and are
//! verified; without candidates, a batch of further points is searched, chosen by the expected
//! improvement of the distance to the target (`acquisition.rs`), the probability of getting a heap
//! at all, and a penalty for repeating a set.

mod acquisition;
mod amortised;
pub mod channel;
pub mod emulator;
mod paper;
pub mod posterior;
mod propose;
mod settings;
mod space;
mod trial;
mod verify;

#[cfg(test)]
mod channel_tests;
#[cfg(test)]
mod emulator_tests;
#[cfg(test)]
mod fixed_tests;
#[cfg(test)]
mod tests;

pub use acquisition::{expected_improvement, probability_within};
pub use amortised::in_emulator_heaps;
pub use channel::{Channel, Instrument, Knowledge, Probe};
pub use emulator::{DIRECTIONS, Design, Directions, Emulator, build};
pub use settings::{Method, Settings};
pub use space::Space;
pub use trial::{CalibratedSet, Calibration, Heap, Outcome, Phase, Pour, Shortfall, Trial};

use flip_core::domain::FieldError;
use flip_core::domain::job::Progress;
use flip_core::domain::powder::Flowability;
use flip_core::domain::seed::derive;
use flip_core::stats::latin_hypercube::maximin_latin_hypercube;
use flip_core::stats::summary;
use propose::Belief;
use rand::SeedableRng;
use rand_pcg::Pcg64;
use std::ops::ControlFlow;
use trial::Planned;

/// First index of the seeds of proposals; no trial uses it.
const PROPOSALS: u64 = u64::MAX;
/// Number of experiments for which a plain function is called: the first is reported, and can be stored,
/// when the last is done.
const CHUNK: usize = 8;

/// Carries out batches of experiments. An outcome must follow from its experiment alone.
///
/// A function that returns the outcomes of a batch is one, too.
pub trait Simulate<E, O> {
    /// Hands over the outcome of each experiment, or the reason why it has none: in the order of the
    /// experiments, each as soon as it is known. After `Break` no more is wanted; if fewer are handed
    /// over, the calibration stops.
    fn simulate(&self, experiments: &[E], heard: &mut Heard<'_, O>);
}

/// Receives an outcome.
pub type Heard<'a, O> = dyn FnMut(Result<O, String>) -> ControlFlow<()> + 'a;

impl<E, O, F: Fn(&[E]) -> Vec<Result<O, String>>> Simulate<E, O> for F {
    fn simulate(&self, experiments: &[E], heard: &mut Heard<'_, O>) {
        for batch in experiments.chunks(CHUNK) {
            let outcomes = self(batch);
            assert_eq!(outcomes.len(), batch.len(), "every experiment has one outcome");
            if outcomes.into_iter().try_for_each(&mut *heard).is_break() {
                return;
            }
        }
    }
}

/// Why a calibration has no result.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// A setting or the target is out of bounds.
    #[error(transparent)]
    Settings(#[from] FieldError),
    /// The history was made with other settings, another target or another version of the code.
    #[error(
        "trial {index} of the history is not what these settings and this version propose: start a new calibration"
    )]
    History {
        /// The first trial that differs.
        index: u32,
    },
    /// `on_trial` requested a stop. The calibration can be resumed from the history so far.
    #[error("stopped on request")]
    Stopped,
    /// The budget is used up.
    #[error(transparent)]
    TooFew(Box<TooFew>),
    /// The method needs an emulator, but none was given.
    #[error("the method `emulator` needs an emulator")]
    NoEmulator,
    /// No heap of an emulator's design has an angle.
    #[error("no heap of the emulator's design has an angle of repose")]
    NoHeap,
}

/// The partial result when the budget ran out before enough sets were found.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "found {} of {wanted} sets within {tolerance_deg} deg of {:.2} deg in {} simulations ({refused} refused); {}: \
     allow more trials or a wider tolerance, or check the measurement",
    .partial.sets.len(), .partial.target.repose_deg, .partial.evaluations + .partial.verification_runs, nearest_text(*.nearest_deg)
)]
pub struct TooFew {
    /// The result so far.
    pub partial: Calibration,
    /// Number of sets requested.
    pub wanted: u32,
    /// The tolerance, degrees.
    pub tolerance_deg: f64,
    /// Simulations without an angle.
    pub refused: u32,
    /// The simulated angle nearest to the target, degrees; none if every simulation was refused.
    pub nearest_deg: Option<f64>,
}

fn nearest_text(tip_deg: Option<f64>) -> String {
    match tip_deg {
        // A heap may come near by chance: that is why sets are verified.
        Some(deg) => format!(
            "the nearest single heap had {deg:.2} deg, but a set counts by the mean of its verification heaps"
        ),
        None => "no simulation gave an angle".to_owned(),
    }
}

/// Finds parameter sets whose simulated angle of repose matches `target`.
///
/// | argument | meaning |
/// |----------|---------|
/// | `target` | the measurement; its mean is aimed at |
/// | `settings` | method, tolerance, budget, seed |
/// | `knowledge` | the emulator, for the method of that name, and other measurements; its heaps count once, not in every calibration |
/// | `history` | trials of an interrupted run with the same target and settings, in order; replayed, never simulated again |
/// | `simulate` | pours heaps |
/// | `on_trial` | called with every new trial (not the replayed ones) in order of its index; `Break` stops |
///
/// The same target, settings and `simulate` give the same bytes at any number of threads,
/// interrupted or not.
///
/// # Errors
/// [`Error`]
///
/// # Panics
/// `simulate` returns more outcomes than there are heaps.
pub fn calibrate(
    target: &Flowability,
    settings: &Settings,
    knowledge: Option<Knowledge<'_>>,
    history: &[Trial],
    simulate: impl Simulate<Pour, Heap>,
    mut on_trial: impl FnMut(&Trial, &Progress) -> ControlFlow<()>,
) -> Result<Calibration, Error> {
    let settings = settings.clone().checked()?;
    let space = settings.space()?;
    let target = Flowability::new(target.repose_deg, target.sd_deg, target.n)?;
    let mut trials: Vec<Trial> = Vec::new();
    loop {
        let round = match (settings.method, &knowledge) {
            (Method::Sequential, _) => plan(&trials, &target, &settings, &space),
            (Method::Paper, _) => paper::plan(&trials, &settings, &space),
            (Method::Emulator, Some(knowledge)) => {
                amortised::plan(&trials, &target, &settings, &space, knowledge)
            }
            (Method::Emulator, None) => return Err(Error::NoEmulator),
        };
        if round.is_empty() {
            return match history.len() > trials.len() {
                true => Err(Error::History { index: trials.len() as u32 }),
                false => {
                    conclude(&trials, &target, &settings, knowledge.map(|known| known.emulator))
                }
            };
        }
        let new = &round[replay(&round, &mut trials, history, Some(&target))?..];
        let pours: Vec<Pour> = new.iter().map(|p| p.pour(settings.particles_of(p.phase))).collect();
        in_order(&simulate, &pours, |k, heap| {
            let index = trials.len() as u32;
            let trial = new[k].clone().concluded(index, Outcome::of(heap), Some(&target));
            trials.push(trial.clone());
            on_trial(&trial, &progress(&trials, &target, &settings))
        })?;
    }
}

/// Hands `each` every outcome with the place of its experiment.
///
/// # Errors
/// [`Error::Stopped`]: `each` said `Break`, or not all outcomes came.
fn in_order<E, O>(
    simulate: &impl Simulate<E, O>,
    experiments: &[E],
    mut each: impl FnMut(usize, Result<O, String>) -> ControlFlow<()>,
) -> Result<(), Error> {
    let (mut heard, mut flow) = (0, ControlFlow::Continue(()));
    if !experiments.is_empty() {
        simulate.simulate(experiments, &mut |outcome| {
            flow = each(heard, outcome);
            heard += 1;
            flow
        });
    }
    if flow.is_continue() && heard == experiments.len() { Ok(()) } else { Err(Error::Stopped) }
}

/// Appends to `trials` the part of `batch` found in the history, after checking that they match;
/// returns how many.
fn replay(
    batch: &[Planned],
    trials: &mut Vec<Trial>,
    history: &[Trial],
    target: Option<&Flowability>,
) -> Result<usize, Error> {
    let known = history.get(trials.len()..).unwrap_or_default();
    for (planned, trial) in batch.iter().zip(known) {
        let index = trials.len() as u32;
        if trial.index != index || !planned.is(trial) {
            return Err(Error::History { index });
        }
        trials.push(planned.clone().concluded(index, trial.outcome.clone(), target));
    }
    Ok(batch.len().min(known.len()))
}

/// Plans the sequential method's next simulations; empty when the calibration is over.
fn plan(
    trials: &[Trial],
    target: &Flowability,
    settings: &Settings,
    space: &Space,
) -> Vec<Planned> {
    let left = (settings.trials_max as usize).saturating_sub(trials.len());
    let sets = verify::verified(trials, target, settings);
    let wanted = (settings.sets as usize).saturating_sub(sets.len());
    if left == 0 || wanted == 0 {
        return Vec::new();
    }
    let mut rng = Pcg64::seed_from_u64(derive(settings.seed, &[PROPOSALS, trials.len() as u64]));
    let search = |points: Vec<space::Point>| {
        let indexed = (trials.len() as u32..).zip(points);
        indexed
            .map(|(index, point)| {
                Planned::search(index, space.parameters_at(&point), settings.seed)
            })
            .collect()
    };
    if trials.is_empty() {
        return search(maximin_latin_hypercube(
            (settings.initial as usize).min(left),
            50,
            &mut rng,
        ));
    }
    let batch = (settings.batch as usize).min(left);
    let Some(belief) = Belief::of(trials, target.repose_deg) else {
        return search(maximin_latin_hypercube(batch, 50, &mut rng));
    };
    let repeats = settings.verify_repeats;
    let candidates = verify::candidates(trials, &belief, settings);
    let affordable = wanted.min(left / repeats as usize);
    let points: Vec<space::Point> = sets.iter().map(|s| s.parameters.to_unit()).collect();
    let chosen = verify::choose(candidates, points.clone(), affordable, &belief, settings);
    if chosen.is_empty() {
        return search(propose::propose(belief, trials, points, settings, space, batch, &mut rng));
    }
    let runs = chosen
        .into_iter()
        .flat_map(|c| (1..=repeats).map(move |r| Planned::verification(c, r, settings)));
    runs.collect()
}

fn conclude(
    trials: &[Trial],
    target: &Flowability,
    settings: &Settings,
    emulator: Option<&Emulator>,
) -> Result<Calibration, Error> {
    let shift = emulator.and_then(|emulator| amortised::size_shift(trials, settings, emulator));
    let calibration = Calibration {
        size_shift_deg: shift.map(trial::micro),
        ..summarised(trials, target, settings)
    };
    if calibration.sets.len() >= settings.sets as usize {
        return Ok(calibration);
    }
    let shortfall = match (settings.method, emulator) {
        (Method::Emulator, Some(emulator)) => {
            amortised::shortfall(trials, target, settings, &settings.space()?, emulator)
        }
        (Method::Paper, _) => nearest(trials)
            .map(|nearest_repose_deg| Shortfall { nearest_repose_deg, limiting_parameter: None }),
        _ => None,
    };
    if shortfall.is_some() {
        return Ok(Calibration { shortfall, ..calibration });
    }
    Err(Error::TooFew(Box::new(TooFew {
        partial: calibration,
        wanted: settings.sets,
        tolerance_deg: settings.tolerance_deg,
        refused: trials.iter().filter(|t| t.error_deg.is_none()).count() as u32,
        nearest_deg: nearest(trials),
    })))
}

/// The simulated angle nearest to the target, degrees; none if every simulation was refused.
fn nearest(trials: &[Trial]) -> Option<f64> {
    let reached = trials.iter().filter_map(|t| Some((t.error_deg?, t.outcome.tip_deg()?)));
    reached.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, tip)| tip)
}

fn summarised(trials: &[Trial], target: &Flowability, settings: &Settings) -> Calibration {
    let evaluations = trials.iter().filter(|t| t.phase == Phase::Search).count();
    let sets = match settings.method {
        Method::Paper => paper::sets(trials, target, settings),
        Method::Emulator | Method::Sequential => verify::verified(trials, target, settings),
    };
    let errors: Vec<f64> = sets.iter().map(|s| s.error_deg).collect();
    let verified: Vec<f64> = sets.iter().map(|s| s.verified_error_deg).collect();
    Calibration {
        target: *target,
        evaluations: evaluations as u32,
        verification_runs: (trials.len() - evaluations) as u32,
        mean_error_deg: summary::mean(&errors),
        sd_error_deg: summary::sd(&errors),
        verified_error_deg: summary::mean(&verified),
        sets,
        size_shift_deg: None,
        shortfall: None,
    }
}

/// Progress is the larger of two shares: of the sets wanted and of the budget.
fn progress(trials: &[Trial], target: &Flowability, settings: &Settings) -> Progress {
    let sets = verify::verified(trials, target, settings).len();
    let found = sets as f64 / f64::from(settings.sets);
    let spent = trials.len() as f64 / f64::from(settings.trials_max);
    Progress {
        fraction: found.max(spent).min(1.0),
        message: format!("trial {}, {sets} of {} sets", trials.len(), settings.sets),
    }
}
