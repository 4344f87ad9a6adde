//! What is known of the bench, in memory: a stop, a status and the lane look here and wait for no database.
//!
//! The data folder's lock makes this process the only one that changes any of it, so what is here is true, and what is stored follows: a hold and a latch
//! count from the moment they are here.

use super::sign::StopSign;
use flip_core::domain::bench_check::{CheckKind, Repeatability};
use flip_core::domain::timestamp::Timestamp;
use flip_core::domain::vial::{Pan, Vial};
use flip_core::domain::weighing::WeighingState;
use flip_store::bench::Latch;
use flip_store::holds::Held;
use flip_store::pan::Reservation;
use flip_store::weighings::{Waiting, Weighing};
use flip_store::who::Who;
use flip_store::{self as store, Store, now};
use serde::{Deserialize, Serialize};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::OwnedMutexGuard;

/// The end of a dose that could not be written down yet. Nothing begins before it is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Unwritten {
    /// The weighing.
    pub weighing: String,
    /// Since when.
    pub since: Timestamp,
    /// What is in the way.
    pub why: String,
}

/// What is known of the bench now.
#[derive(Debug, Clone, Default)]
pub struct Standing {
    /// Why it may not be used, until a person has cleared it.
    pub latch: Option<Latch>,
    /// After a stop: nothing begins until a person resumes.
    pub held: Option<Held>,
    /// Weighings that wait, in order.
    pub waiting: Vec<Waiting>,
    /// The vial on the pan; none where the bench exchanges vials.
    pub vial: Option<Vial>,
    /// The newest check of how well the balance repeats.
    pub repeatability: Option<Repeatability>,
    /// Who has it for himself.
    pub reservation: Option<Reservation>,
    /// The weighing that moves.
    pub moving: Option<String>,
    /// The end of a dose that could not be written down yet.
    pub unwritten: Option<Unwritten>,
}

/// A weighing that moves.
struct Moving {
    weighing: Weighing,
    stop: Arc<StopSign>,
}

#[derive(Default)]
struct Known {
    latch: Option<Latch>,
    held: Option<Held>,
    waiting: Vec<Waiting>,
    pan: Pan,
    repeatability: Option<Repeatability>,
    reservation: Option<Reservation>,
    moving: Option<Moving>,
    unwritten: Option<Unwritten>,
    /// The weighing whose vial somebody says is in, and the vial's name if he gave one.
    ready: Option<(String, Option<String>)>,
    /// Stops so far: whoever resumes must not take away one that came meanwhile.
    stops: u64,
}

/// Shared by the lane and by whoever asks.
#[derive(Clone, Default)]
pub(super) struct Condition {
    known: Arc<Mutex<Known>>,
    /// One at a time reads which weighings wait, so that the last one read last.
    reading: Arc<tokio::sync::Mutex<()>>,
    /// Held by whoever clears the bench, by the lane while it writes an ending down, and for a moment when it begins: one comes after the other.
    alone: Arc<tokio::sync::Mutex<()>>,
    /// The same as `held`, for whoever moves the bench beside the lane.
    flag: Arc<AtomicBool>,
}

/// What a stop found, and what is to be stored of it.
#[derive(Debug, Clone)]
pub(super) struct Halted {
    /// The weighing that moved.
    pub weighing: Option<String>,
    /// The hold that begins with it, unless there is one already.
    pub held: Held,
    /// Who stopped: the record is written by another task, later.
    pub who: Option<Who>,
}

impl Known {
    fn halt(&mut self, by: Option<&str>) -> Halted {
        self.stops += 1;
        // Whoever stops may take the vial away.
        self.ready = None;
        let weighing = self.moving.as_ref().map(|moving| {
            moving.stop.press();
            moving.weighing.id.clone()
        });
        let reason = match &weighing {
            Some(id) => format!("stop was pressed while weighing {id} moved"),
            None => "stop was pressed".to_owned(),
        };
        let who = Who::now();
        let by = by.map(str::to_owned).or_else(|| who.as_ref().map(|who| who.name.clone()));
        let held = Held { at: now(), reason, by };
        self.held.get_or_insert_with(|| held.clone());
        Halted { weighing, held, who }
    }
}

impl Condition {
    /// Of a bench that whoever makes piles asks by this flag whether it is held.
    pub fn of(flag: Arc<AtomicBool>) -> Self {
        Self { flag, ..Self::default() }
    }

    /// Read what is stored.
    pub async fn load(&self, store: &Store) -> store::Result<()> {
        let (latch, held, pan) = (store.latch().await?, store.held().await?, store.pan().await?);
        let repeatability = store.newest_check(CheckKind::Repeatability).await?.map(|it| it.1);
        let reservation = store.reservation().await?;
        {
            let mut known = self.known();
            (known.latch, known.held, known.pan) = (latch, held, pan);
            (known.repeatability, known.reservation) = (repeatability, reservation);
            self.flag.store(known.held.is_some(), Ordering::SeqCst);
        }
        self.refresh(store).await;
        Ok(())
    }

    /// Weighings began or ceased to wait. Where that cannot be read, the lane reads it at its next look.
    pub async fn refresh(&self, store: &Store) {
        let _one = self.reading.lock().await;
        match store.waiting_weighings().await {
            Ok(waiting) => self.known().waiting = waiting,
            Err(error) => tracing::warn!(%error, "which weighings wait cannot be read now"),
        }
    }

    /// Wait until nobody clears the bench and no ending is being written down; neither begins while this is held.
    pub async fn alone(&self) -> OwnedMutexGuard<()> {
        self.alone.clone().lock_owned().await
    }

    /// All of it, as others see it.
    pub fn standing(&self, exchanges_vials: bool) -> Standing {
        let known = self.known();
        Standing {
            latch: known.latch.clone(),
            held: known.held.clone(),
            waiting: known.waiting.clone(),
            vial: known.pan.vial.clone().filter(|_| !exchanges_vials),
            repeatability: known.repeatability.clone(),
            reservation: known.reservation.clone().filter(|it| it.until > now()),
            moving: known.moving.as_ref().map(|moving| moving.weighing.id.clone()),
            unwritten: known.unwritten.clone(),
        }
    }

    /// What is known of the pan.
    pub fn pan(&self) -> Pan {
        self.known().pan.clone()
    }

    /// The balance was checked anew, and the check is stored.
    pub fn set_repeatability(&self, found: Repeatability) {
        self.known().repeatability = Some(found);
    }

    /// Somebody has it for himself, or nobody any more, and that is stored.
    pub fn set_reservation(&self, reservation: Option<Reservation>) {
        self.known().reservation = reservation;
    }

    /// Nobody may use the bench from now on; where it is latched already the first reason stays.
    pub fn latch(&self, latch: Latch) {
        let mut known = self.known();
        known.ready = None;
        known.latch.get_or_insert(latch);
    }

    /// A person has cleared it, and that is stored.
    pub fn cleared(&self) {
        let mut known = self.known();
        (known.latch, known.ready) = (None, None);
        known.pan = known.pan.emptied();
    }

    /// The stop of whatever moves and a hold, at once: what moves hears of it before its next motion, and nothing else begins.
    pub fn halt(&self, by: Option<&str>) -> Halted {
        let mut known = self.known();
        self.flag.store(true, Ordering::SeqCst);
        known.halt(by)
    }

    /// The same, if it is this weighing that moves; what is known of it.
    pub fn halt_weighing(&self, id: &str, by: Option<&str>) -> Option<(Weighing, Halted)> {
        let mut known = self.known();
        let moving = known.moving.as_ref().map(|moving| moving.weighing.clone()).filter(|it| it.id == id)?;
        self.flag.store(true, Ordering::SeqCst);
        Some((moving, known.halt(by)))
    }

    /// Stop what moves because the process ends: nobody has to resume. Whether something did.
    pub fn stop_moving(&self) -> bool {
        let known = self.known();
        known.moving.iter().for_each(|moving| moving.stop.press());
        known.moving.is_some()
    }

    /// Hold the bench, which is stored.
    pub fn hold(&self, held: Held) {
        let mut known = self.known();
        self.flag.store(true, Ordering::SeqCst);
        known.held.get_or_insert(held);
    }

    /// How often it was stopped so far.
    pub fn stops(&self) -> u64 {
        self.known().stops
    }

    /// A person lets doses begin again, and that is stored. `false`: a stop came since there were so many, and holds.
    pub fn resume(&self, stops: u64) -> bool {
        let mut known = self.known();
        if known.stops != stops {
            return false;
        }
        known.held = None;
        self.flag.store(false, Ordering::SeqCst);
        true
    }

    /// Somebody says that the vial of a weighing is in. `false`: a stop came since there were so many, and whoever stopped may have taken it away.
    pub fn vial_is_in(&self, weighing: &str, vial: Option<String>, stops: u64) -> bool {
        let mut known = self.known();
        if known.stops != stops {
            return false;
        }
        known.ready = Some((weighing.to_owned(), vial));
        true
    }

    /// Whether somebody says so of this weighing.
    pub fn is_vial_in(&self, weighing: &str) -> bool {
        self.known().ready.as_ref().is_some_and(|(ready, _)| ready == weighing)
    }

    /// Nothing keeps the oldest weighing from being looked at.
    pub fn is_free(&self) -> bool {
        let known = self.known();
        known.latch.is_none() && known.unwritten.is_none()
    }

    /// Begin with a weighing, unless something keeps the bench from it. From here on a stop finds it.
    pub fn take_turn(&self, weighing: &Weighing, stop: &Arc<StopSign>, wants_vial: bool) -> bool {
        // Somebody clears the bench, and its arm may move: the lane is woken when he is done.
        let Ok(_alone) = self.alone.try_lock() else { return false };
        let mut known = self.known();
        // A stop since the last look has made it void.
        if wants_vial && known.ready.as_ref().is_none_or(|(ready, _)| *ready != weighing.id) {
            return false;
        }
        if known.latch.is_some() || known.held.is_some() || known.unwritten.is_some() {
            return false;
        }
        known.moving = Some(Moving { weighing: weighing.clone(), stop: stop.clone() });
        true
    }

    /// The vial that a weighing is for, as far as it has a name.
    pub fn vial_of(&self, weighing: &Weighing) -> Option<String> {
        let said = self.known().ready.clone().filter(|(ready, _)| *ready == weighing.id);
        said.and_then(|(_, vial)| vial).or_else(|| weighing.asked.vial.clone())
    }

    /// The bench is armed for a weighing, and this is known of its pan: what somebody said about the vial is spent.
    pub fn armed(&self, weighing: Weighing, pan: Pan) {
        let mut known = self.known();
        (known.pan, known.ready) = (pan, None);
        if let Some(moving) = &mut known.moving {
            moving.weighing = weighing;
        }
    }

    /// The weighing that moves has come so far.
    pub fn advance(&self, state: WeighingState) {
        if let Some(moving) = &mut self.known().moving {
            moving.weighing.state = state;
        }
    }

    /// Nothing moves any more, and this is known of the pan.
    pub fn stands(&self, pan: Pan) {
        let mut known = self.known();
        (known.moving, known.pan) = (None, pan);
    }

    /// The weighing whose turn it was was not begun.
    pub fn not_begun(&self) {
        self.known().moving = None;
    }

    /// The end of a dose cannot be written down yet, or is.
    pub fn set_unwritten(&self, unwritten: Option<Unwritten>) {
        self.known().unwritten = unwritten;
    }

    fn known(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
