//! The bench lane: one thread owns the bench and carries out weighings in the order of their intents.
//!
//! A weighing is not a job. Powder cannot be taken back, so nothing here is ever tried again: the intent is committed
//! before any motion, what was moving when the process ended is `unknown` at the next start, and a person looks.
//!
//! ```text
//!  [planned] --> [armed] --first tick--> [dosing] --> [done]      within, under, over
//!      |            |                       |-------> [aborted]   stopped, aborted
//!      +--stopped---+-----------------------+
//!                   +--process ended--------+-------> [unknown]
//! ```

use super::conditions::Conditions;
use super::worker::panic_message;
use crate::domain::bench::Tick;
use crate::domain::parameters::ParameterSet;
use crate::domain::weighing::{Outcome, WeighingState};
use crate::hardware::simulated::SimulatedBench;
use crate::policy::{self, Controller, Rules};
use crate::sim::{balance, dispense};
use crate::store::weighings::{Ending, Weighing};
use crate::store::{self, Store, now};
use crate::weigh::{Order, weigh};
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;
use tokio::runtime::Handle;

/// Most weighings that may wait for the bench.
pub const WAITING_MAX: i64 = 64;
/// The lane also looks for work on its own this often.
const LOOK: Duration = Duration::from_secs(1);

/// What the spoon holds, whichever of these sets is the powder, mg; `None` without sets.
pub fn spoon_holds_mg<'a>(sets: impl Iterator<Item = &'a ParameterSet>) -> Option<f64> {
    Conditions::default().spoon_holds_mg(sets)
}

/// Everything that one weighing needs.
#[derive(Debug, Clone)]
pub struct Pouring {
    /// What is asked for.
    pub order: Order,
    /// Who decides what to do.
    pub controller: Controller,
    /// The frame that the controller was made for.
    pub rules: Rules,
    /// The balance.
    pub balance: balance::Settings,
    /// The simulated spoon; its pitch range is that of the rules.
    pub spoon: dispense::Settings,
    /// The simulated powder on the bench.
    pub set: ParameterSet,
    /// Seed of the bench.
    pub seed: u64,
}

/// How a pour ended.
#[derive(Debug, Clone, PartialEq)]
pub struct Poured {
    /// Outcome.
    pub outcome: Outcome,
    /// True mass in the vial, mg.
    pub dispensed_mg: f64,
    /// Last reading, mg.
    pub reading_mg: f64,
    /// Shakes made.
    pub shakes: u32,
    /// Bench time, s.
    pub seconds: f64,
    /// What was done and read, in order.
    pub ticks: Vec<Tick>,
    /// Why it was aborted.
    pub error: Option<String>,
}

/// One weighing on the bench: what to weigh, who hears of ticks, and the stop flag that is looked at every tick.
/// On every way out the spoon is level.
pub type Pour = Arc<dyn Fn(&Pouring, &mut dyn FnMut(&Tick), &AtomicBool) -> Poured + Send + Sync>;

/// The closed loop on the simulated bench.
pub fn simulated() -> Pour {
    Arc::new(|pouring, on_tick, stop| {
        let spoon = dispense::Settings { pitch: pouring.rules.pitch, ..pouring.spoon };
        let mut bench = SimulatedBench::new(&pouring.set, &spoon, &pouring.balance, pouring.seed);
        let weighed = weigh(&mut bench, &pouring.controller, &pouring.rules, &pouring.order, on_tick, stop);
        Poured {
            outcome: weighed.outcome,
            dispensed_mg: bench.vial_mg(),
            reading_mg: weighed.reading_mg,
            shakes: weighed.shakes,
            seconds: weighed.seconds,
            ticks: weighed.ticks,
            error: weighed.cause,
        }
    })
}

/// The weighing that moves, and its stop flag.
type Moving = Arc<Mutex<Option<(String, Arc<AtomicBool>)>>>;

/// The lane's outside: wake it, stop what it does, shut it down.
pub struct Bench {
    store: Store,
    pour: Pour,
    moving: Moving,
    closing: Arc<AtomicBool>,
    lane: Mutex<Option<Lane>>,
}

struct Lane {
    wake: SyncSender<()>,
    thread: JoinHandle<()>,
}

impl Bench {
    pub(super) fn new(store: Store, pour: Pour) -> Self {
        Self { store, pour, moving: Arc::default(), closing: Arc::default(), lane: Mutex::default() }
    }

    /// Record what the last process left moving, then begin to work.
    pub(super) async fn start(&self) -> store::Result<()> {
        self.record_interrupted().await?;
        let (wake, woken) = sync_channel(1);
        let lane = LaneThread {
            store: self.store.clone(),
            pour: self.pour.clone(),
            moving: self.moving.clone(),
            closing: self.closing.clone(),
            runtime: Handle::current(),
        };
        let thread = std::thread::Builder::new().name("bench".into()).spawn(move || lane.work(&woken));
        let thread = thread.map_err(|source| store::Error::File { path: "the bench's thread".into(), source })?;
        *self.lane() = Some(Lane { wake, thread });
        Ok(())
    }

    async fn record_interrupted(&self) -> store::Result<()> {
        let mut tx = self.store.write().await?;
        let cause = "the process ended during the weighing: check the vial and the bench, then ask for a new weighing";
        for id in tx.interrupted_weighings().await? {
            tracing::warn!(weighing = id, "was interrupted; its outcome is unknown");
            tx.end_weighing(&id, &Ending::bare(WeighingState::Unknown, Outcome::Unknown, cause), now()).await?;
        }
        tx.commit().await
    }

    /// What kind of bench it is.
    pub fn kind(&self) -> &'static str {
        "simulated"
    }

    /// Its devices by role, as they say themselves.
    pub fn devices(&self) -> BTreeMap<String, String> {
        BTreeMap::new()
    }

    /// The weighing that moves.
    pub fn moving_weighing(&self) -> Option<String> {
        self.moving().as_ref().map(|(id, _)| id.clone())
    }

    /// Stop whatever moves; which weighing that is.
    pub fn stop_moving(&self) -> Option<String> {
        let moving = self.moving();
        let (id, stop) = moving.as_ref()?;
        stop.store(true, Ordering::SeqCst);
        Some(id.clone())
    }

    /// A new intent is committed.
    pub fn wake(&self) {
        if let Some(lane) = &*self.lane() {
            // Full means that it is about to look anyway.
            let _ = lane.wake.try_send(());
        }
    }

    /// Stop a weighing: one that waits ends at once; one that moves is told, and levels the spoon at its next tick.
    /// `None`: it had ended already.
    ///
    /// # Errors
    /// [`store::Error`]
    pub async fn stop(&self, id: &str) -> store::Result<Option<Weighing>> {
        // First the flag: it needs no database.
        if let Some((moving, stop)) = &*self.moving()
            && moving == id
        {
            stop.store(true, Ordering::SeqCst);
        }
        let mut tx = self.store.write().await?;
        let ending = Ending::bare(WeighingState::Aborted, Outcome::Stopped, "stopped before its turn");
        let ended = tx.end_planned_weighing(id, &ending, now()).await?;
        tx.commit().await?;
        match ended {
            Some(weighing) => Ok(Some(weighing)),
            None => Ok(self.store.weighing(id).await?.map(|row| row.weighing).filter(|w| w.outcome.is_none())),
        }
    }

    /// Stop what moves, level the spoon, and end the lane. Intents that wait stay planned.
    pub(super) async fn shutdown(&self) {
        self.closing.store(true, Ordering::SeqCst);
        if let Some((_, stop)) = &*self.moving() {
            stop.store(true, Ordering::SeqCst);
        }
        self.wake();
        let Some(lane) = self.lane().take() else { return };
        let ended = tokio::task::spawn_blocking(move || lane.thread.join().is_ok()).await;
        if !matches!(ended, Ok(true)) {
            tracing::error!("the bench's thread ended badly");
        }
    }

    fn moving(&self) -> std::sync::MutexGuard<'_, Option<(String, Arc<AtomicBool>)>> {
        self.moving.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn lane(&self) -> std::sync::MutexGuard<'_, Option<Lane>> {
        self.lane.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        self.closing.store(true, Ordering::SeqCst);
    }
}

/// The thread that owns the bench.
struct LaneThread {
    store: Store,
    pour: Pour,
    moving: Moving,
    closing: Arc<AtomicBool>,
    runtime: Handle,
}

impl LaneThread {
    fn work(&self, woken: &Receiver<()>) {
        while !self.closing.load(Ordering::SeqCst) {
            match self.runtime.block_on(self.store.planned_weighing()) {
                Ok(Some(weighing)) => match self.carry_out(&weighing) {
                    Ok(()) => continue,
                    Err(error) => tracing::error!(weighing = weighing.id, %error, "a weighing was not recorded"),
                },
                Ok(None) => {}
                Err(error) => tracing::error!(%error, "could not look for weighings"),
            }
            if woken.recv_timeout(LOOK) == Err(RecvTimeoutError::Disconnected) {
                return;
            }
        }
    }

    /// Arm, pour, record. Nothing moves unless `armed` is committed.
    fn carry_out(&self, weighing: &Weighing) -> store::Result<()> {
        let stop = Arc::new(AtomicBool::new(false));
        *self.moving() = Some((weighing.id.clone(), stop.clone()));
        // A shutdown between the look and the line above has not seen the flag.
        if self.closing.load(Ordering::SeqCst) {
            *self.moving() = None;
            return Ok(());
        }
        let done = self.arm(weighing).and_then(|armed| match armed {
            true => self.pour_and_record(weighing, &stop),
            false => Ok(()),
        });
        *self.moving() = None;
        done
    }

    fn arm(&self, weighing: &Weighing) -> store::Result<bool> {
        self.runtime.block_on(async {
            let mut tx = self.store.write().await?;
            let armed = tx.arm_weighing(&weighing.id, now()).await?;
            tx.commit().await?;
            Ok(armed)
        })
    }

    fn pour_and_record(&self, weighing: &Weighing, stop: &AtomicBool) -> store::Result<()> {
        let ending = match self.prepare(weighing) {
            Ok(pouring) => self.pour(&pouring, weighing, stop),
            Err(error) => Ending::bare(WeighingState::Aborted, Outcome::Aborted, error.to_string()),
        };
        self.runtime.block_on(async {
            let mut tx = self.store.write().await?;
            tx.end_weighing(&weighing.id, &ending, now()).await?;
            tx.commit().await
        })
    }

    fn prepare(&self, weighing: &Weighing) -> store::Result<Pouring> {
        let missing = |what: &str| store::Error::Corrupt(format!("the weighing's {what} is gone"));
        self.runtime.block_on(async {
            let policy = self.store.policy_bytes(&weighing.policy).await?.ok_or_else(|| missing("policy"))?;
            let set =
                self.store.parameter_set(&weighing.parameter_set).await?.ok_or_else(|| missing("parameter set"))?;
            let balance = balance::Settings::default();
            let spoon = dispense::Settings::default();
            let extensions = spoon.extensions.patched(&weighing.patch);
            let extensions = extensions.map_err(|error| store::Error::Corrupt(error.to_string()))?;
            let policy = policy::decode(&policy).map_err(|error| store::Error::Corrupt(error.to_string()))?;
            Ok(Pouring {
                order: Order {
                    target_mg: weighing.target_mg,
                    tolerance_lower_mg: weighing.tolerance_lower_mg,
                    tolerance_upper_mg: weighing.tolerance_upper_mg,
                    readability_mg: balance.readability_mg,
                },
                controller: policy.controller,
                rules: policy.manifest.rules,
                balance,
                spoon: dispense::Settings { extensions, ..spoon },
                set: weighing.patch.powder(&set.parameters),
                seed: weighing.seed,
            })
        })
    }

    fn pour(&self, pouring: &Pouring, weighing: &Weighing, stop: &AtomicBool) -> Ending {
        let mut on_tick = |tick: &Tick| {
            if let Err(error) = self.runtime.block_on(self.record_tick(&weighing.id, tick)) {
                // Motion that cannot be recorded must not go on.
                tracing::error!(weighing = weighing.id, %error, "a tick was not recorded: stopping");
                stop.store(true, Ordering::SeqCst);
            }
        };
        let poured = catch_unwind(AssertUnwindSafe(|| (self.pour)(pouring, &mut on_tick, stop)));
        match poured {
            Ok(poured) => self.ending(weighing, poured),
            Err(panic) => {
                let cause = format!("the weighing panicked: {}", panic_message(&*panic));
                Ending::bare(WeighingState::Aborted, Outcome::Aborted, cause)
            }
        }
    }

    async fn record_tick(&self, id: &str, tick: &Tick) -> store::Result<()> {
        let mut tx = self.store.write().await?;
        tx.insert_tick(id, tick).await?;
        tx.commit().await
    }

    fn ending(&self, weighing: &Weighing, poured: Poured) -> Ending {
        let state = match poured.outcome {
            Outcome::Within | Outcome::Under | Outcome::Over | Outcome::NotStable | Outcome::Blocked => WeighingState::Done,
            Outcome::Stopped | Outcome::Aborted => WeighingState::Aborted,
            Outcome::Unknown => WeighingState::Unknown,
        };
        let trace = serde_json::to_vec(&poured.ticks).map_err(|error| store::Error::Corrupt(error.to_string()));
        let trace = trace.and_then(|bytes| self.store.artifacts().put(&bytes));
        let lost = trace.as_ref().err().map(|error| format!("the trace was not stored: {error}"));
        Ending {
            state,
            outcome: poured.outcome,
            dispensed_mg: Some(poured.dispensed_mg),
            reading_mg: Some(poured.reading_mg),
            error_mg: Some(poured.dispensed_mg - weighing.target_mg),
            shakes: Some(poured.shakes),
            seconds: Some(poured.seconds),
            measured: None,
            trace: trace.ok(),
            error: poured.error.or(lost),
        }
    }

    fn moving(&self) -> std::sync::MutexGuard<'_, Option<(String, Arc<AtomicBool>)>> {
        self.moving.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
