//! One job on several machines: its batches of experiments, of which other workers carry out portions.
//!
//! ```text
//!   batch --> next experiment --> hands: one for each thread of this worker --+
//!     |                             ^                                         v
//!     |                             | taken back, or given up               each
//!     v                             |                                         ^
//!   portions, each about a minute of one thread --> rows --> other workers ---+
//! ```
//!
//! This worker's hands take one experiment after another and never wait for anybody: whoever helps, and
//! whoever dies, the batch ends. Portions are cut only while somebody may help; they become smaller
//! towards the end of the batch, so that all end at about the same time. An outcome depends on its
//! experiment alone, so the result is the same whoever carried it out.

use super::lanes::{Lane, TURNS, lane_of};
use super::portion::{self, Portable};
use super::runner::{Each, Run, Runner};
use super::stop::StopFlag;
use super::{Functions, Shared};
use flip_core::domain::job::JobKind;
use flip_core::domain::timestamp::Timestamp;
use flip_store::ledger::{Claimed, Lease};
use flip_store::portions::{NewPortion, Stands};
use flip_store::workers::Worker;
use flip_store::{self as store, Store, new_id, now};
use serde::de::DeserializeOwned;
use std::any::Any;
use std::collections::{HashMap, VecDeque};
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::runtime::Handle;
use tokio::sync::Notify;

/// How often the portions are looked at when nothing is heard of them, and whether the job is to end.
const LOOK: Duration = Duration::from_millis(500);
/// How long the answer counts who may help.
const KNOWN: Duration = Duration::from_secs(2);
/// A worker that was not heard of for so long is not expected to help, ms: it says at least twice in
/// this time that it is there.
const SILENT_MS: i64 = 20_000;
/// The shortest portion that is worth its rows, as a part of the usual one.
const LEAST: f64 = 1.0 / 60.0;
/// Portions that wait for each thread that may help, so that none waits for the next to be cut.
const AHEAD: usize = 2;

/// The functions with which this job computes: those of this worker, and others' help where there may
/// be others.
pub(super) fn functions(
    shared: &Shared,
    claimed: &Claimed,
    stop: &Arc<StopFlag>,
    runtime: &Handle,
) -> Functions {
    let local = shared.functions.clone();
    if !shared.store.is_shared() || lane_of(claimed.kind) != Lane::Turns {
        return local;
    }
    let job = Arc::new(SharedJob {
        store: shared.store.clone(),
        lease: claimed.lease.clone(),
        kind: claimed.kind,
        worker: shared.worker.clone(),
        portion_s: shared.portion.as_secs_f64(),
        stop: stop.clone(),
        runtime: runtime.clone(),
        cut: AtomicI64::default(),
        helpers: Mutex::default(),
        usual_s: Mutex::default(),
    });
    Functions {
        simulate: Spread::over(local.simulate, &job),
        observe: Spread::over(local.observe, &job),
        replay: Spread::over(local.replay, &job),
        weigh: Spread::over(local.weigh, &job),
        ..local
    }
}

/// A job under its lease that others may help with.
struct SharedJob {
    store: Store,
    lease: Lease,
    kind: JobKind,
    /// Who computes it.
    worker: Worker,
    /// How long one thread computes a portion, s.
    portion_s: f64,
    stop: Arc<StopFlag>,
    runtime: Handle,
    /// Portions cut so far.
    cut: AtomicI64,
    /// Threads of others that may help, and when that was so.
    helpers: Mutex<Option<(Instant, usize)>>,
    /// How long an experiment of each kind took in the last batch, s.
    usual_s: Mutex<HashMap<&'static str, f64>>,
}

impl SharedJob {
    /// Threads of other workers that may help.
    fn helpers(&self) -> store::Result<usize> {
        let mut known = lock(&self.helpers);
        if let Some((at, threads)) = *known
            && at.elapsed() < KNOWN
        {
            return Ok(threads);
        }
        let since = Timestamp::from_unix_ms(now().unix_ms() - SILENT_MS);
        let asked = self.store.helpers(&self.worker, self.kind, &TURNS, since);
        let helpers = self.runtime.block_on(asked)?;
        let threads = helpers.iter().map(|it| it.threads as usize).sum();
        *known = Some((Instant::now(), threads));
        Ok(threads)
    }
}

/// Carries out experiments on this machine, as `local` does, and on others.
struct Spread<E, O> {
    local: Arc<dyn Runner<E, O>>,
    job: Arc<SharedJob>,
}

impl<E, O> Spread<E, O>
where
    E: Portable + Sync + Send + 'static,
    O: DeserializeOwned + Send + 'static,
{
    fn over(local: Arc<dyn Runner<E, O>>, job: &Arc<SharedJob>) -> Arc<dyn Runner<E, O>> {
        Arc::new(Self { local, job: job.clone() })
    }
}

impl<E: Portable + Sync + Send, O: DeserializeOwned + Send> Runner<E, O> for Spread<E, O> {
    fn run(&self, experiments: &[E], each: &mut Each<'_, O>) {
        if experiments.len() < 2 {
            return self.local.run(experiments, each);
        }
        let hands = (self.job.worker.threads as usize).clamp(1, experiments.len());
        let batch = Batch {
            experiments,
            local: &*self.local,
            job: &self.job,
            hands,
            each: Mutex::new(each),
            state: Mutex::new(State { idle: hands, ..State::default() }),
            freed: Condvar::new(),
            turned: Notify::new(),
        };
        std::thread::scope(|scope| {
            // Also if what follows panics: a hand must not wait for ever.
            let _ends = Ends(&batch);
            for _ in 0..hands {
                scope.spawn(|| batch.lend_a_hand());
            }
            batch.tend();
        });
        let state = batch.state.into_inner().unwrap_or_else(PoisonError::into_inner);
        if let Some(took_s) = state.took_s() {
            lock(&self.job.usual_s).insert(E::KIND, took_s);
        }
        if let Some(panic) = state.panic {
            resume_unwind(panic);
        }
    }
}

/// A batch that is being carried out.
struct Batch<'a, 'e, E, O> {
    experiments: &'a [E],
    local: &'a dyn Runner<E, O>,
    job: &'a SharedJob,
    /// How many experiments this worker carries out at once.
    hands: usize,
    each: Mutex<&'a mut Each<'e, O>>,
    state: Mutex<State>,
    /// There may be something to do for a hand.
    freed: Condvar,
    /// There may be something to do for [`Batch::tend`].
    turned: Notify,
}

#[derive(Default)]
struct State {
    /// The first experiment that nobody has yet.
    next: usize,
    /// Experiments of portions that came back undone.
    back: VecDeque<usize>,
    /// The experiments of each portion that is out, by its id.
    out: HashMap<String, Range<usize>>,
    /// Portions that have a row, or may have one.
    rows: usize,
    /// Hands that carry out nothing now.
    idle: usize,
    /// Runs received, and their time in all, s.
    received: usize,
    seconds: f64,
    /// No further experiment begins.
    over: bool,
    panic: Option<Box<dyn Any + Send>>,
}

impl State {
    /// How long an experiment takes, s.
    fn took_s(&self) -> Option<f64> {
        (self.received > 0).then(|| self.seconds / self.received as f64)
    }
}

/// Ends a batch when it is dropped.
struct Ends<'b, 'a, 'e, E, O>(&'b Batch<'a, 'e, E, O>);

impl<E, O> Drop for Ends<'_, '_, '_, E, O> {
    fn drop(&mut self) {
        lock(&self.0.state).over = true;
        self.0.freed.notify_all();
    }
}

impl<E: Portable + Sync, O: DeserializeOwned + Send> Batch<'_, '_, E, O> {
    /// Carries out one experiment after another, until there is none left for anybody.
    fn lend_a_hand(&self) {
        while let Some(place) = self.take() {
            let mut done = None;
            let ended = catch_unwind(AssertUnwindSafe(|| {
                let one = &self.experiments[place..=place];
                done = self.local.run_all(one).pop();
                done.take().map(|run| self.receive(place, run))
            }));
            let mut state = lock(&self.state);
            state.idle += 1;
            if let Err(panic) = ended {
                state.panic.get_or_insert(panic);
                state.over = true;
            }
            drop(state);
            self.freed.notify_all();
            self.turned.notify_one();
        }
    }

    /// The next experiment for this worker; waits while only others have some.
    fn take(&self) -> Option<usize> {
        let mut state = lock(&self.state);
        loop {
            if state.over {
                return None;
            }
            let next = (state.next < self.experiments.len()).then_some(state.next);
            if let Some(place) = state.back.pop_front() {
                state.idle -= 1;
                return Some(place);
            }
            if let Some(place) = next {
                state.next += 1;
                state.idle -= 1;
                return Some(place);
            }
            if state.out.is_empty() {
                return None;
            }
            state = self.freed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Hands a run over.
    fn receive(&self, place: usize, run: Run<O>) {
        let seconds = run.seconds;
        let mut each = lock(&self.each);
        let flow = (*each)(place, run);
        drop(each);
        let mut state = lock(&self.state);
        state.received += 1;
        state.seconds += seconds;
        state.over |= flow.is_break() || state.received == self.experiments.len();
    }

    /// Cuts portions, receives what they gave and takes back what nobody carries out, until the batch is
    /// over.
    fn tend(&self) {
        let mut changes = self.job.store.watch_portions();
        loop {
            changes.borrow_and_update();
            if self.job.stop.flow().is_break() {
                lock(&self.state).over = true;
            }
            if lock(&self.state).over {
                break;
            }
            match self.look() {
                Ok(()) => {}
                // Another attempt at the job has begun, or it was cancelled: nobody waits for this one.
                Err(store::Error::Fenced) => lock(&self.state).over = true,
                Err(error) => {
                    tracing::warn!(job = self.job.lease.job, %error, "portions were not looked at; the next try may");
                }
            }
            self.freed.notify_all();
            if lock(&self.state).over {
                break;
            }
            self.job.runtime.block_on(async {
                tokio::select! {
                    () = self.turned.notified() => {}
                    changed = changes.changed() => if changed.is_err() {
                        tokio::time::sleep(LOOK).await;
                    },
                    () = tokio::time::sleep(LOOK) => {}
                }
            });
        }
        self.freed.notify_all();
        if lock(&self.state).rows == 0 {
            return;
        }
        let dropped = self.job.runtime.block_on(async {
            let mut tx = self.job.store.write().await?;
            tx.drop_portions(&self.job.lease).await?;
            tx.commit().await
        });
        if let Err(error) = dropped {
            tracing::warn!(job = self.job.lease.job, %error, "portions were left behind; they end with the attempt");
        }
    }

    fn look(&self) -> store::Result<()> {
        let (job, runtime) = (self.job, &self.job.runtime);
        let helpers = job.helpers()?;
        let is_out = !lock(&self.state).out.is_empty();
        if !is_out && helpers == 0 {
            return Ok(());
        }
        let (mut done, mut waiting) = (Vec::new(), Vec::new());
        if is_out {
            let mut there = Vec::new();
            for (id, stands) in runtime.block_on(job.store.portions(&job.lease, now()))? {
                match stands {
                    Stands::Done(outcomes) => done.push((id.clone(), outcomes)),
                    Stands::Waits => waiting.push(id.clone()),
                    Stands::Taken => {}
                }
                there.push(id);
            }
            // Nobody drops them but this batch: carried out here, should it ever happen.
            let mut state = lock(&self.state);
            let lost: Vec<String> =
                state.out.keys().filter(|id| !there.contains(id)).cloned().collect();
            lost.iter().for_each(|id| state.give_back(id));
        }
        for (id, outcomes) in &done {
            self.hand_over(id, outcomes);
        }
        let (cut, unwanted) = {
            let mut state = lock(&self.state);
            if state.over {
                return Ok(());
            }
            let cut = self.cut(&mut state, helpers, waiting.len());
            // The last first: they are the smallest.
            let hungry = if state.has_more(self.experiments.len()) { 0 } else { state.idle };
            waiting.reverse();
            waiting.truncate(hungry);
            (cut, waiting)
        };
        if done.is_empty() && cut.is_empty() && unwanted.is_empty() {
            return Ok(());
        }
        lock(&self.state).rows += cut.len();
        let written = runtime.block_on(async {
            let mut tx = job.store.write().await?;
            for (id, _) in &done {
                tx.drop_portion(id).await?;
            }
            let mut back = Vec::new();
            for id in unwanted {
                if tx.take_portion_back(&id, now()).await? {
                    back.push(id);
                }
            }
            if !cut.is_empty() {
                tx.cut_portions(&job.lease, &cut).await?;
            }
            tx.commit().await.map(|()| back)
        });
        let mut state = lock(&self.state);
        match written {
            Ok(back) => {
                state.rows = state.rows.saturating_sub(done.len() + back.len());
                back.iter().for_each(|id| state.give_back(id));
            }
            Err(error) => {
                cut.iter().for_each(|portion| state.give_back(&portion.id));
                return Err(error);
            }
        }
        Ok(())
    }

    /// Hands over the runs of a portion. One that cannot be read is carried out here.
    fn hand_over(&self, id: &str, outcomes: &[u8]) {
        let Some(places) = lock(&self.state).out.get(id).cloned() else { return };
        match portion::runs::<O>(outcomes, places.len()) {
            Ok(runs) => {
                for (place, run) in places.zip(runs) {
                    if lock(&self.state).over {
                        return;
                    }
                    self.receive(place, run);
                }
                lock(&self.state).out.remove(id);
            }
            Err(why) => {
                tracing::warn!(
                    job = self.job.lease.job,
                    why,
                    "what a worker sent cannot be read; it is computed here"
                );
                lock(&self.state).give_back(id);
            }
        }
    }

    /// Cuts portions off what nobody has yet, for so many threads of others, of which so many portions
    /// still wait.
    fn cut(&self, state: &mut State, helpers: usize, waiting: usize) -> Vec<NewPortion> {
        let mut cut = Vec::new();
        let usual_s = lock(&self.job.usual_s).get(E::KIND).copied();
        let all = self.hands + helpers;
        while waiting + cut.len() < AHEAD * helpers {
            // One for each hand that is free.
            let rest = (self.experiments.len() - state.next).saturating_sub(state.idle);
            let least_s = LEAST * self.job.portion_s;
            // It would end sooner than anybody could begin.
            let is_short = |one_s: f64| rest as f64 * one_s < 2.0 * least_s * self.hands as f64;
            if rest == 0 || state.took_s().or(usual_s).is_some_and(is_short) {
                break;
            }
            // One at a time until it is known how long that takes.
            let size = state.took_s().map_or(1, |one_s| {
                let of = |seconds: f64| (seconds / one_s) as usize;
                let least = of(least_s).max(1);
                (rest / (2 * all)).clamp(least, of(self.job.portion_s).max(least)).min(rest)
            });
            let places = state.next..state.next + size;
            let experiments = match E::packed(&self.experiments[places.clone()]) {
                Ok(experiments) => experiments,
                Err(why) => {
                    tracing::warn!(
                        job = self.job.lease.job,
                        why,
                        "experiments cannot be sent; all are carried out here"
                    );
                    break;
                }
            };
            state.next = places.end;
            let id = new_id();
            state.out.insert(id.clone(), places);
            let number = self.job.cut.fetch_add(1, Ordering::Relaxed);
            cut.push(NewPortion { id, number, kind: E::KIND, experiments });
        }
        cut
    }
}

impl State {
    /// Whether there is an experiment that nobody has.
    fn has_more(&self, of: usize) -> bool {
        self.next < of || !self.back.is_empty()
    }

    /// Experiments of a portion that is out no more are to be carried out here.
    fn give_back(&mut self, id: &str) {
        self.back.extend(self.out.remove(id).into_iter().flatten());
    }
}

fn lock<T>(of: &Mutex<T>) -> MutexGuard<'_, T> {
    of.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests;
