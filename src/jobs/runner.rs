//! Where experiments are carried out: on this machine's cores, or wherever another [`Runner`] sends
//! them.

use flip_bench::rig::{Simulation, Task};
use flip_core::domain::conditions::Patch;
use flip_core::domain::observable::Observable;
use flip_core::domain::parameters::ParameterSet;
use flip_learn::train::evaluate::Dose;
use flip_sim::replay::{Replay, Replayed};
use flip_sim::repose::{Refusal, Repose, Settings};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::panic::resume_unwind;
use std::sync::mpsc::sync_channel;
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
    /// further experiment begins; the runs of those that had begun on this machine are still received.
    /// Where its job is to end, a runner may end early by itself.
    fn run(&self, experiments: &[E], each: &mut Each<'_, O>);

    /// Carries out `experiments`; the runs are in their order. For runners that do not end early.
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

/// Carries out `experiments` and hands over their runs on this thread, in their order, each as soon as
/// it and those before it have ended. After `Break` no further experiment begins.
pub(super) fn in_order<E: Sync, O: Send>(
    runner: &dyn Runner<E, O>,
    experiments: &[E],
    mut each: impl FnMut(Run<O>) -> ControlFlow<()>,
) {
    // Without a place to wait: what is not handed over yet is lost if the process dies.
    let (send, receive) = sync_channel(0);
    std::thread::scope(|scope| {
        let running = scope.spawn(move || {
            runner.run(experiments, &mut |place, run| match send.send((place, run)) {
                Ok(()) => ControlFlow::Continue(()),
                Err(_) => ControlFlow::Break(()),
            });
        });
        let (mut early, mut next) = (BTreeMap::new(), 0);
        'receives: for (place, run) in receive {
            early.insert(place, run);
            while let Some(run) = early.remove(&next) {
                next += 1;
                if each(run).is_break() {
                    break 'receives;
                }
            }
        }
        running.join().unwrap_or_else(|panic| resume_unwind(panic));
    });
}

/// An experiment that was carried out.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
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
        // In the order of the experiments, so that what is wanted first ends first.
        let _ = experiments.iter().enumerate().par_bridge().try_for_each(|(place, experiment)| {
            let begun = Instant::now();
            let outcome = (self.0)(experiment);
            let run = Run { outcome, seconds: begun.elapsed().as_secs_f64() };
            let mut each = each.lock().unwrap_or_else(PoisonError::into_inner);
            each(place, run)
        });
    }
}

/// A heap to simulate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct HeapExperiment {
    /// The powder.
    pub set: ParameterSet,
    /// How it is poured and read.
    pub settings: Settings,
    /// Seed.
    pub seed: u64,
}

/// Another experiment to simulate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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

/// A dose to weigh on the simulator, to its end.
#[derive(Debug, Clone)]
pub struct DoseExperiment {
    /// What to weigh. Doses of one controller and target have one in common.
    pub task: Arc<Task>,
    /// The bench.
    pub simulation: Simulation,
}

/// Simulates heaps.
pub type HeapRunner = Arc<dyn Runner<HeapExperiment, Result<Repose, Refusal>>>;

/// Simulates the other experiments, reduced to a number.
pub type ObservableRunner = Arc<dyn Runner<ObservableExperiment, Result<f64, Refusal>>>;

/// Replays spoonfuls.
pub type SpoonRunner = Arc<dyn Runner<Replay, Result<Replayed, Refusal>>>;

/// Weighs doses. The error is why one has no result.
pub type DoseRunner = Arc<dyn Runner<DoseExperiment, Result<Dose, String>>>;

/// Weighs doses on this machine's cores, each by a function of task and bench:
/// [`simulated`](super::evaluate::simulated) in the product, a formula in tests.
pub fn doses_on_cores(
    one: impl Fn(&Task, &Simulation) -> Result<Dose, String> + Send + Sync + 'static,
) -> DoseRunner {
    Arc::new(Cores(move |of: &DoseExperiment| one(&of.task, &of.simulation)))
}

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
    fn runs_are_handed_over_in_order_on_the_calling_thread_until_a_break() {
        let experiments: Vec<u64> = (0..20).collect();
        let here = std::thread::current().id();
        let mut heard = Vec::new();
        in_order(&Cores(square), &experiments, |run| {
            assert_eq!(std::thread::current().id(), here);
            heard.push(run.outcome);
            if heard.len() < 12 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        });
        assert_eq!(heard, (0..12).map(|x| x * x).collect::<Vec<u64>>());
        let panics = Cores(|x: &u64| if *x == 3 { panic!("the third") } else { square(x) });
        let caught = std::panic::catch_unwind(|| {
            in_order(&panics, &experiments, |_| ControlFlow::Continue(()));
        });
        assert_eq!(caught.unwrap_err().downcast_ref::<&str>(), Some(&"the third"));
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
