//! Where experiments are carried out: on this machine's cores, or wherever another [`Runner`] sends
//! them.

use flip_core::domain::conditions::Patch;
use flip_core::domain::observable::Observable;
use flip_core::domain::parameters::ParameterSet;
use flip_sim::replay::{Replay, Replayed};
use flip_sim::repose::{Refusal, Repose, Settings};
use rayon::prelude::*;
use std::ops::ControlFlow;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// Carries out batches of experiments of one kind.
///
/// An outcome depends on its experiment alone, so that neither the number of threads nor the
/// machine changes a result. A runner that cannot carry out an experiment panics, and the job is
/// tried again: a refusal is an outcome.
pub trait Runner<E, O>: Send + Sync {
    /// Carries out `experiments`. `each` receives every run, with the place of its experiment in
    /// the slice, as soon as it has ended: in any order, but one at a time. After `Break` no
    /// further experiment begins; the runs of those that had begun are still received.
    fn run(&self, experiments: &[E], each: &mut Each<'_, O>);

    /// Carries out `experiments`; the runs are in their order.
    fn run_all(&self, experiments: &[E]) -> Vec<Run<O>>
    where
        O: Send,
    {
        let mut runs: Vec<Option<Run<O>>> = experiments.iter().map(|_| None).collect();
        self.run(experiments, &mut |place, run| {
            runs[place] = Some(run);
            ControlFlow::Continue(())
        });
        runs.into_iter().map(|run| run.expect("nothing stopped the runner")).collect()
    }
}

/// Receives the runs of a batch. It must not wait for other experiments: they may wait for it.
pub type Each<'a, O> = dyn FnMut(usize, Run<O>) -> ControlFlow<()> + Send + 'a;

/// An experiment that was carried out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Run<O> {
    /// Its outcome.
    pub outcome: O,
    /// How long it took where it ran, s.
    pub seconds: f64,
}

/// Carries out a function of one experiment on this machine's cores.
pub struct Cores<F>(pub F);

impl<E: Sync, O: Send, F: Fn(&E) -> O + Send + Sync> Runner<E, O> for Cores<F> {
    fn run(&self, experiments: &[E], each: &mut Each<'_, O>) {
        let each = Mutex::new(each);
        // A `Break` ends the loop early and has no other meaning.
        let _ = experiments.par_iter().enumerate().try_for_each(|(place, experiment)| {
            let begun = Instant::now();
            let outcome = (self.0)(experiment);
            let run = Run { outcome, seconds: begun.elapsed().as_secs_f64() };
            let mut each = each.lock().unwrap_or_else(PoisonError::into_inner);
            each(place, run)
        });
    }
}

/// A heap to simulate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeapExperiment {
    /// The powder.
    pub set: ParameterSet,
    /// How it is poured and read.
    pub settings: Settings,
    /// Seed.
    pub seed: u64,
}

/// Another experiment to simulate.
#[derive(Debug, Clone, PartialEq)]
pub struct ObservableExperiment {
    /// What is observed.
    pub observable: Observable,
    /// The powder.
    pub set: ParameterSet,
    /// What is changed about it and its spoon.
    pub patch: Patch,
    /// Seed.
    pub seed: u64,
}

/// Simulates heaps.
pub type HeapRunner = Arc<dyn Runner<HeapExperiment, Result<Repose, Refusal>>>;

/// Simulates the other experiments, reduced to a number.
pub type ObservableRunner = Arc<dyn Runner<ObservableExperiment, Result<f64, Refusal>>>;

/// Replays spoonfuls.
pub type SpoonRunner = Arc<dyn Runner<Replay, Result<Replayed, Refusal>>>;

/// Replays spoonfuls on this machine's cores, each by a function of what is to be made again:
/// [`replay`](flip_sim::replay::replay) in the product.
pub fn spoons_on_cores(
    one: impl Fn(&Replay) -> Result<Replayed, Refusal> + Send + Sync + 'static,
) -> SpoonRunner {
    Arc::new(Cores(one))
}

/// Simulates heaps on this machine's cores, each by a function of set, settings and seed:
/// [`repose`](flip_sim::repose::repose) in the product, a formula in tests.
pub fn heaps_on_cores(
    one: impl Fn(&ParameterSet, &Settings, u64) -> Result<Repose, Refusal> + Send + Sync + 'static,
) -> HeapRunner {
    Arc::new(Cores(move |HeapExperiment { set, settings, seed }: &HeapExperiment| {
        one(set, settings, *seed)
    }))
}

/// Simulates the other experiments on this machine's cores, each by a function of observable, set,
/// changes and seed: [`observe`](flip_sim::observe::observe) in the product.
pub fn observables_on_cores(
    one: impl Fn(&Observable, &ParameterSet, &Patch, u64) -> Result<f64, Refusal>
    + Send
    + Sync
    + 'static,
) -> ObservableRunner {
    Arc::new(Cores(move |of: &ObservableExperiment| {
        one(&of.observable, &of.set, &of.patch, of.seed)
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// Later experiments end first.
    fn square(x: &u64) -> u64 {
        std::thread::sleep(std::time::Duration::from_micros(200 * (20 - x)));
        x * x
    }

    #[test]
    fn outcomes_are_in_the_order_of_their_experiments_on_any_number_of_threads() {
        let experiments: Vec<u64> = (0..20).collect();
        for threads in [1, 2, 7] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let runs = pool.install(|| Cores(square).run_all(&experiments));
            assert!(runs.iter().zip(&experiments).all(|(run, x)| run.outcome == x * x));
            assert!(runs.iter().all(|run| run.seconds > 0.0));
        }
    }

    #[test]
    fn after_a_break_only_what_had_begun_is_carried_out() {
        let threads = 3;
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let begun = AtomicUsize::new(0);
        let counted = Cores(|x: &u64| {
            begun.fetch_add(1, Ordering::SeqCst);
            square(x)
        });
        let experiments = vec![10; 1000];
        let mut received = 0;
        pool.install(|| {
            counted.run(&experiments, &mut |_, _| {
                received += 1;
                if received < 50 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
            });
        });
        let begun = begun.into_inner();
        assert!((50..=50 + 2 * threads).contains(&begun));
        assert_eq!(received, begun, "what had begun is not lost");
    }
}
