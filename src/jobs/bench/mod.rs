//! The bench lane: one thread owns the bench and carries out weighings in the order of their intents.
//!
//! A weighing is not a job. Powder cannot be taken back, so nothing here is ever tried again: the intent is committed
//! before any motion, what was moving when the process ended is `unknown` at the next start, the bench is latched, and a person looks.
//!
//! ```text
//!  [planned] --> [awaiting_vial] --> [armed] --> [dosing] --> [settling] --> [done]      within, under, over, not_stable, blocked
//!      |                |               |            |             |-------> [aborted]   stopped, aborted
//!      +----stopped-----+---------------+------------+-------------+
//!                                       +--process ended-----------+-------> [unknown]   and the bench is latched
//! ```
//!
//! A weighing waits for its vial only where the bench cannot exchange vials and nobody said that it need not.
//!
//! `lane.rs` is the thread, `journal.rs` the record it keeps, `prepare.rs` what a dose needs, `ending.rs` how it ended and how that is written down
//! whatever the database does; `condition.rs` is what is known of the bench in memory; `sign.rs` is the stop of one dose, `halter.rs` tells the arm of it,
//! and `records.rs` writes stops down afterwards; `turns.rs` is what people ask of the bench beside doses; `apparatus.rs` is what moves: the simulator, an emulated laboratory, or devices; `stand.rs` is where piles are made between weighings.

mod apparatus;
mod condition;
mod ending;
mod halter;
mod journal;
mod lane;
mod prepare;
mod records;
mod sign;
mod stand;
mod turns;

pub use apparatus::{Apparatus, Pour, Poured, Pouring, devices, devices_by, emulated, simulated};
pub use condition::{Standing, Unwritten};
pub(super) use journal::audit_exchanges;
pub use stand::{Awaited, Inbox, Making, PileInMaking, PileStand, Piling, Unpiled};
pub use turns::Change;

use super::spoon::holds_mg;
use condition::{Condition, Halted};
use ending::record_interrupted;
use flip_core::domain::bench::BenchKind;
use flip_core::domain::bench_check::Repeatability;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::weighing::{Outcome, WeighingState};
use flip_sim::balance;
use flip_store::weighings::{Ending, Weighing};
use flip_store::{self as store, Store, now};
use halter::Halter;
use lane::LaneThread;
use records::Records;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use tokio::runtime::Handle;

/// Most weighings that may wait for the bench.
pub const WAITING_MAX: i64 = 64;

/// The lane's outside: wake it, stop what it does, say what it is like, shut it down.
pub struct Bench {
    store: Store,
    apparatus: Apparatus,
    condition: Condition,
    records: Arc<Records>,
    halter: Halter,
    /// One at a time reserves the bench or gives it back, so that what is known follows what is stored.
    reserving: tokio::sync::Mutex<()>,
    closing: Arc<AtomicBool>,
    lane: Mutex<Option<Lane>>,
}

struct Lane {
    wake: SyncSender<()>,
    thread: JoinHandle<()>,
}

impl Bench {
    /// Record what the last process left moving, and read what is known of the bench.
    pub(super) async fn open(store: Store, apparatus: Apparatus) -> store::Result<Self> {
        let (condition, records) = (Condition::of(apparatus.held.clone()), Arc::<Records>::default());
        // Also where nobody weighs in this process: the lock on the data folder proves that no other one does.
        record_interrupted(&store, &condition).await?;
        condition.load(&store).await?;
        records.keep_writing(&store);
        let halter = Halter::start(apparatus.halt.clone())
            .map_err(|source| store::Error::File { path: "the thread for stops".into(), source })?;
        let (reserving, closing, lane) = Default::default();
        Ok(Self { store, apparatus, condition, records, halter, reserving, closing, lane })
    }

    /// What the spoon on this bench holds, whichever of these sets is the powder, mg; `None` without sets.
    pub fn spoon_holds_mg<'a>(&self, sets: impl Iterator<Item = &'a ParameterSet>) -> Option<f64> {
        holds_mg(&self.apparatus.spoon, sets)
    }

    /// It is FLIP's own spoon, or nobody has said what another one holds.
    pub fn spoon_is_usual(&self) -> bool {
        self.apparatus.spoon.is_usual()
    }

    /// Begin to work.
    pub(super) async fn start(&self) -> store::Result<()> {
        self.forget_vials().await?;
        let (wake, woken) = sync_channel(1);
        let lane = LaneThread {
            store: self.store.clone(),
            apparatus: self.apparatus.clone(),
            condition: self.condition.clone(),
            closing: self.closing.clone(),
            runtime: Handle::current(),
            journal: Arc::default(),
        };
        let thread = std::thread::Builder::new().name("bench".into()).spawn(move || lane.work(&woken));
        let thread = thread.map_err(|source| store::Error::File { path: "the bench's thread".into(), source })?;
        *self.lane() = Some(Lane { wake, thread });
        Ok(())
    }

    /// Whoever exchanged a vial for the last process may have been wrong by now.
    async fn forget_vials(&self) -> store::Result<()> {
        let mut tx = self.store.write().await?;
        tx.forget_vials(now()).await?;
        tx.commit().await?;
        self.condition.refresh(&self.store).await;
        Ok(())
    }

    /// What is known of it now; no database is asked.
    pub fn standing(&self) -> Standing {
        self.condition.standing(self.kind().exchanges_vials())
    }

    /// The end of a dose that could not be written down yet: nothing begins before it is.
    pub fn unwritten(&self) -> Option<Unwritten> {
        self.standing().unwritten
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

    /// Stop whatever moves, and begin nothing until a person resumes. The flag and the hold are set when this returns, the arm is being told by a thread of its
    /// own, and the record follows when the database lets it: this waits for nothing.
    pub fn halt(&self, by: Option<&str>) -> Option<String> {
        let halted = self.condition.halt(by);
        let weighing = halted.weighing.clone();
        self.halted(halted);
        weighing
    }

    /// The same, if it is this weighing that moves; what is known of it.
    pub fn halt_weighing(&self, id: &str, by: Option<&str>) -> Option<Weighing> {
        let (weighing, halted) = self.condition.halt_weighing(id, by)?;
        self.halted(halted);
        Some(weighing)
    }

    fn halted(&self, halted: Halted) {
        self.halter.tell();
        self.records.push(halted);
    }

    /// A new check of how well the balance repeats is stored.
    pub fn repeats(&self, found: Repeatability) {
        self.condition.set_repeatability(found);
    }

    /// Another intent is committed.
    pub async fn planned(&self) {
        self.condition.refresh(&self.store).await;
        self.wake();
    }

    /// The lane has something to look at.
    pub fn wake(&self) {
        if let Some(lane) = &*self.lane() {
            // Full means that it is about to look anyway.
            let _ = lane.wake.try_send(());
        }
    }

    /// End a weighing that waits. `None`: it does not.
    ///
    /// # Errors
    /// [`store::Error`]
    pub async fn stop_waiting(&self, id: &str) -> store::Result<Option<Weighing>> {
        let mut tx = self.store.write().await?;
        let ending = Ending::bare(WeighingState::Aborted, Outcome::Stopped, "stopped before its turn");
        let ended = tx.end_planned_weighing(id, &ending, now()).await?;
        tx.commit().await?;
        if ended.is_some() {
            self.planned().await;
        }
        Ok(ended)
    }

    /// Stop what moves, level the spoon, and end the lane. Intents that wait stay planned, and nobody has to resume.
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
