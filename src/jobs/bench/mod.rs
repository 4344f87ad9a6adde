//! The bench lane: one thread owns the bench and carries out weighings in the order of their intents.
//!
//! A weighing is not a job. Powder cannot be taken back, so nothing here is ever tried again: the intent is committed
//! before any motion, what was moving when the process ended is `unknown` at the next start, the bench is latched, and a person looks.
//!
//! ```text
//!  [planned] --> [armed] --> [dosing] --> [settling] --> [done]      within, under, over, not_stable, blocked
//!      |            |            |             |-------> [aborted]   stopped, aborted
//!      +--stopped---+------------+-------------+
//!                   +--process ended-----------+-------> [unknown]   and the bench is latched
//! ```
//!
//! `lane.rs` is the thread and the record it keeps; `apparatus.rs` is what moves: the simulator, an emulated laboratory, or devices; `stand.rs` is where
//! piles are made between weighings.

mod apparatus;
mod lane;
mod stand;

pub use apparatus::{Apparatus, Pour, Poured, Pouring, devices, emulated, simulated};
pub(super) use lane::audit_exchanges;
pub use stand::{Awaited, Inbox, PileStand, Piling, Unpiled};

use super::spoon::holds_mg;
use crate::domain::bench::BenchKind;
use crate::domain::parameters::ParameterSet;
use crate::domain::weighing::{Outcome, WeighingState};
use crate::hardware::DeviceError;
use crate::sim::balance;
use crate::store::weighings::{Ending, Weighing};
use crate::store::{self, Store, now};
use lane::LaneThread;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use tokio::runtime::Handle;

/// Most weighings that may wait for the bench.
pub const WAITING_MAX: i64 = 64;

/// The weighing that moves, and its stop flag.
type Moving = Arc<Mutex<Option<(String, Arc<AtomicBool>)>>>;

/// The lane's outside: wake it, stop what it does, shut it down.
pub struct Bench {
    store: Store,
    apparatus: Apparatus,
    moving: Moving,
    closing: Arc<AtomicBool>,
    lane: Mutex<Option<Lane>>,
}

struct Lane {
    wake: SyncSender<()>,
    thread: JoinHandle<()>,
}

impl Bench {
    pub(super) fn new(store: Store, apparatus: Apparatus) -> Self {
        Self { store, apparatus, moving: Arc::default(), closing: Arc::default(), lane: Mutex::default() }
    }

    /// What the spoon on this bench holds, whichever of these sets is the powder, mg; `None` without sets.
    pub fn spoon_holds_mg<'a>(&self, sets: impl Iterator<Item = &'a ParameterSet>) -> Option<f64> {
        holds_mg(&self.apparatus.spoon, sets)
    }

    /// It is FLIP's own spoon, or nobody has said what another one holds.
    pub fn spoon_is_usual(&self) -> bool {
        self.apparatus.spoon.is_usual()
    }

    /// Record what the last process left moving, then begin to work.
    pub(super) async fn start(&self) -> store::Result<()> {
        self.record_interrupted().await?;
        let (wake, woken) = sync_channel(1);
        let lane = LaneThread {
            store: self.store.clone(),
            apparatus: self.apparatus.clone(),
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
        for (id, bench) in tx.interrupted_weighings().await? {
            tracing::warn!(weighing = id, "was interrupted; its outcome is unknown");
            tx.end_weighing(&id, &Ending::bare(WeighingState::Unknown, Outcome::Unknown, cause), now()).await?;
            if bench.has_devices() {
                tx.latch_bench(cause, Some(&id), now()).await?;
            }
        }
        tx.commit().await
    }

    /// What kind of bench it is.
    pub fn kind(&self) -> BenchKind {
        self.apparatus.kind
    }

    /// Step of the balance's display, mg, where it is known beforehand.
    pub fn readability_mg(&self) -> Option<f64> {
        let is_simulated = self.apparatus.kind == BenchKind::Simulated;
        (self.apparatus.readability_mg)().or(is_simulated.then(|| balance::Settings::default().readability_mg))
    }

    /// Where piles are made, if anywhere.
    pub fn stand(&self) -> Option<&PileStand> {
        self.apparatus.stand.as_ref()
    }

    /// Its devices by role, as they said themselves when they were last open.
    pub fn devices(&self) -> BTreeMap<String, String> {
        (self.apparatus.devices)()
    }

    /// The weighing that moves.
    pub fn moving_weighing(&self) -> Option<String> {
        self.moving().as_ref().map(|(id, _)| id.clone())
    }

    /// Stop whatever moves; which weighing that is, if it is one.
    pub fn stop_moving(&self) -> Option<String> {
        let moving = self.moving();
        let Some((id, stop)) = moving.as_ref() else {
            (self.apparatus.halt)();
            return None;
        };
        self.halt(stop);
        Some(id.clone())
    }

    /// A person has looked: a latched arm may move again. Nothing is written down here.
    ///
    /// # Errors
    /// The arm cannot be reached, or what latched it lasts.
    pub async fn recover(&self, person: &str) -> Result<(), DeviceError> {
        let (recover, person) = (self.apparatus.recover.clone(), person.to_owned());
        let recovered = tokio::task::spawn_blocking(move || recover(&person)).await;
        recovered.unwrap_or_else(|error| Err(DeviceError::Faulted { device: "the arm", cause: error.to_string() }))
    }

    /// First the flag, then the arm itself: both need no database and wait for nothing that the lane does.
    fn halt(&self, stop: &AtomicBool) {
        stop.store(true, Ordering::SeqCst);
        (self.apparatus.halt)();
    }

    /// A new intent is committed.
    pub fn wake(&self) {
        if let Some(lane) = &*self.lane() {
            // Full means that it is about to look anyway.
            let _ = lane.wake.try_send(());
        }
    }

    /// Stop a weighing: one that waits ends at once; of one that moves the arm stands still first, then the spoon is levelled and taken away.
    /// `None`: it had ended already.
    ///
    /// # Errors
    /// [`store::Error`]
    pub async fn stop(&self, id: &str) -> store::Result<Option<Weighing>> {
        if let Some((moving, stop)) = &*self.moving()
            && moving == id
        {
            self.halt(stop);
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
            self.halt(stop);
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
