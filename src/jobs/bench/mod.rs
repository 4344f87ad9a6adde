//! The bench lane: one thread owns the bench and carries out weighings in the order of their
//! intents.
//!
//! A weighing is not a job. Powder cannot be taken back, so nothing here is ever retried: the
//! intent is committed before any motion, a weighing that was moving when the process ended is
//! `unknown` at the next start, the bench is latched, and a person must check it.
//!
//! ```text
//!  [planned] --> [awaiting_vial] --> [armed] --> [dosing] --> [settling] --> [done]      within, under, over, not_stable, blocked, probed
//!      |                |               |            |             |-------> [aborted]   stopped, aborted
//!      +----stopped-----+---------------+------------+-------------+
//!                                       +--process ended-----------+-------> [unknown]   and the bench is latched
//! ```
//!
//! A weighing waits for its vial only if the bench cannot exchange vials and the request did not
//! waive the confirmation.
//!
//! `lane.rs` is the thread, `journal.rs` the record it keeps, `prepare.rs` gathers what a dose
//! needs, `ending.rs` describes how it ended and records that whatever the database does;
//! `condition.rs` is the state of the bench in memory; `sign.rs` is the stop of one dose,
//! `halter.rs` notifies the arm of it, and `records.rs` writes stops down afterwards; `turns.rs`
//! handles people's requests other than doses, `scale.rs` those to the balance between doses; `owner.rs`
//! keeps the bench in a server's database. What moves is a [`Rig`]: the simulator, an emulated
//! laboratory, or devices.

mod condition;
mod ending;
mod halter;
mod journal;
mod lane;
mod owner;
mod prepare;
mod records;
mod scale;
mod sign;
mod turns;

pub use condition::{Standing, Unwritten};
pub(super) use journal::audit_exchanges;
pub use turns::Change;

use super::spoon::holds_mg;
use condition::{Condition, Halted};
use ending::record_interrupted;
use flip_bench::rig::{PileStand, Rig};
use flip_core::domain::bench::BenchKind;
use flip_core::domain::bench_check::Repeatability;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::spoon::{FilledBy, Spoon};
use flip_core::domain::weighing::{Outcome, WeighingState};
use flip_store::weighings::{Ending, Weighing};
use flip_store::{self as store, Store, now};
use halter::Halter;
use lane::LaneThread;
use owner::{Keeper, Keeping};
use records::Records;
use std::collections::{BTreeMap, HashMap};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use tokio::runtime::Handle;

/// Maximum number of weighings that may wait for the bench.
pub const WAITING_MAX: i64 = 64;

/// Handle to the lane: wakes it, stops it, reports its state, shuts it down.
pub struct Bench {
    store: Store,
    rig: Arc<dyn Rig>,
    condition: Condition,
    records: Arc<Records>,
    halter: Halter,
    /// Serializes reserving and releasing the bench, so that memory follows the store.
    reserving: tokio::sync::Mutex<()>,
    closing: Arc<AtomicBool>,
    lane: Mutex<Option<Lane>>,
    /// Keeps the bench in a server's database.
    keeper: Mutex<Option<Keeper>>,
}

struct Lane {
    wake: SyncSender<()>,
    thread: JoinHandle<()>,
}

impl Bench {
    /// Records what the last process left moving, and loads the state of the bench.
    /// `held` is set while the bench is held, before anything else hears of it.
    pub(super) async fn open(
        store: Store,
        rig: Arc<dyn Rig>,
        held: Arc<AtomicBool>,
    ) -> store::Result<Self> {
        let (condition, records) = (Condition::of(held), Arc::<Records>::default());
        // Even if this process does not weigh: the lock on the data folder, or having the bench in a
        // server's database, proves that no other one does.
        record_interrupted(&store, &condition).await?;
        condition.load(&store).await?;
        records.keep_writing(&store);
        let halter = Halter::start(rig.clone())
            .map_err(|source| store::Error::File { path: "the thread for stops".into(), source })?;
        let (reserving, closing, lane, keeper) = Default::default();
        Ok(Self { store, rig, condition, records, halter, reserving, closing, lane, keeper })
    }

    /// Capacity of this bench's spoon, whichever of these sets is the powder, mg; `None` without
    /// sets.
    pub fn spoon_holds_mg<'a>(&self, sets: impl Iterator<Item = &'a ParameterSet>) -> Option<f64> {
        holds_mg(&self.rig.spoon(), sets)
    }

    /// The spoon.
    pub fn spoon(&self) -> Spoon {
        self.rig.spoon()
    }

    /// Whether it is FLIP's own spoon, or the capacity of another one was not given.
    pub fn spoon_is_usual(&self) -> bool {
        Spoon { filled_by: FilledBy::default(), ..self.rig.spoon() }.is_usual()
    }

    /// Whether the bench fills its spoon by itself, so that a dose may take several spoonfuls.
    pub fn fills_spoon(&self) -> bool {
        self.rig.fills_spoon()
    }

    /// Starts the lane.
    pub(super) async fn start(&self) -> store::Result<()> {
        self.forget_vials().await?;
        let (wake, woken) = sync_channel(1);
        let lane = LaneThread {
            store: self.store.clone(),
            rig: self.rig.clone(),
            condition: self.condition.clone(),
            closing: self.closing.clone(),
            runtime: Handle::current(),
            journal: Arc::default(),
        };
        let thread =
            std::thread::Builder::new().name("bench".into()).spawn(move || lane.work(&woken));
        let thread = thread
            .map_err(|source| store::Error::File { path: "the bench's thread".into(), source })?;
        *self.lane() = Some(Lane { wake, thread });
        self.keep()
    }

    /// In a server's database: tells the others that this process has the bench, until it ends.
    fn keep(&self) -> store::Result<()> {
        if self.store.bench_owner().is_none() {
            return Ok(());
        }
        let keeping = Keeping {
            store: self.store.clone(),
            rig: self.rig.clone(),
            condition: self.condition.clone(),
            runtime: Handle::current(),
            silent: HashMap::new(),
        };
        let keeper = Keeper::start(keeping)
            .map_err(|source| store::Error::File { path: "the owner's thread".into(), source })?;
        *self.keeper.lock().unwrap_or_else(PoisonError::into_inner) = Some(keeper);
        Ok(())
    }

    /// Vial confirmations given to the last process may be out of date.
    async fn forget_vials(&self) -> store::Result<()> {
        let mut tx = self.store.write().await?;
        tx.forget_vials(now()).await?;
        tx.commit().await?;
        self.condition.refresh(&self.store).await;
        Ok(())
    }

    /// The current state of the bench; no database is queried.
    pub fn standing(&self) -> Standing {
        self.condition.standing(self.exchanges_vials())
    }

    /// The end of a dose that could not be recorded yet: nothing starts before it is.
    pub fn unwritten(&self) -> Option<Unwritten> {
        self.standing().unwritten
    }

    /// Whether this process carries out weighings on it.
    pub fn works(&self) -> bool {
        self.lane().is_some()
    }

    /// The kind of bench.
    pub fn kind(&self) -> BenchKind {
        self.rig.kind()
    }

    /// Whether it puts an empty vial in place for each dose without a person.
    pub fn exchanges_vials(&self) -> bool {
        self.rig.exchanges_vials()
    }

    /// Readability (display step) of the balance, mg, where known in advance.
    pub fn readability_mg(&self) -> Option<f64> {
        self.rig.readability_mg()
    }

    /// The stand where piles are made, if any.
    pub fn stand(&self) -> Option<&PileStand> {
        self.rig.stand()
    }

    /// Its devices by role, as they identified themselves when last open.
    pub fn devices(&self) -> BTreeMap<String, String> {
        self.rig.devices()
    }

    /// Stops anything that moves, and starts nothing until a person resumes. The flag and the hold
    /// are set when this returns, a separate thread notifies the arm, and the record follows when
    /// the database allows: this call does not block.
    pub fn halt(&self, by: Option<&str>) -> Option<String> {
        let halted = self.condition.halt(by);
        let weighing = halted.weighing.clone();
        self.halted(halted);
        weighing
    }

    /// The same, if it is this weighing that moves; returns what is known of it.
    pub fn halt_weighing(&self, id: &str, by: Option<&str>) -> Option<Weighing> {
        let (weighing, halted) = self.condition.halt_weighing(id, by)?;
        self.halted(halted);
        Some(weighing)
    }

    fn halted(&self, halted: Halted) {
        self.halter.tell();
        self.records.push(halted);
    }

    /// Sets a new repeatability check, which is already stored.
    pub fn repeats(&self, found: Repeatability) {
        self.condition.set_repeatability(found);
    }

    /// Called when another intent has been committed.
    pub async fn planned(&self) {
        self.condition.refresh(&self.store).await;
        self.wake();
    }

    /// Wakes the lane to poll for work.
    pub fn wake(&self) {
        if let Some(lane) = &*self.lane() {
            // A full channel means that it is about to poll anyway.
            let _ = lane.wake.try_send(());
        }
    }

    /// Ends a waiting weighing. `None`: it is not waiting.
    ///
    /// # Errors
    /// [`store::Error`]
    pub async fn stop_waiting(&self, id: &str) -> store::Result<Option<Weighing>> {
        let mut tx = self.store.write().await?;
        let ending =
            Ending::bare(WeighingState::Aborted, Outcome::Stopped, "stopped before its turn");
        let ended = tx.end_planned_weighing(id, &ending, now()).await?;
        if ended.is_some() {
            tx.audit_person(Some(id), "stop", now()).await?;
        }
        tx.commit().await?;
        if ended.is_some() {
            self.planned().await;
        }
        Ok(ended)
    }

    /// Stops any motion, levels the spoon, and ends the lane. Waiting intents stay planned, and
    /// nobody has to resume.
    pub(super) async fn shutdown(&self) {
        self.closing.store(true, Ordering::SeqCst);
        if self.condition.stop_moving() {
            self.halter.tell();
        }
        self.wake();
        if let Some(lane) = self.take_lane() {
            let ended = tokio::task::spawn_blocking(move || lane.thread.join().is_ok()).await;
            if !matches!(ended, Ok(true)) {
                tracing::error!("the bench's thread ended badly");
            }
        }
        self.records.close(&self.store).await;
        drop(self.keeper.lock().unwrap_or_else(PoisonError::into_inner).take());
    }

    fn take_lane(&self) -> Option<Lane> {
        self.lane().take()
    }

    fn lane(&self) -> std::sync::MutexGuard<'_, Option<Lane>> {
        self.lane.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        self.closing.store(true, Ordering::SeqCst);
        self.records.abandon();
    }
}

#[cfg(test)]
mod locked_tests;
