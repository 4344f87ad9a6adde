//! The state of the bench, in memory: a stop, a status query and the lane read it here without
//! waiting for a database.
//!
//! The data folder's lock, or having the bench in a server's database, makes this process the only
//! one that changes any of it, so this state is authoritative and the store follows: a hold and a latch take effect as soon as they are set
//! here.

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

/// The end of a dose that could not be recorded yet. Nothing starts until it is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Unwritten {
    /// The weighing.
    pub weighing: String,
    /// Since when.
    pub since: Timestamp,
    /// What prevents it.
    pub why: String,
}

/// The current state of the bench.
#[derive(Debug, Clone, Default)]
pub struct Standing {
    /// Why it may not be used, until a person has cleared it.
    pub latch: Option<Latch>,
    /// After a stop: nothing starts until a person resumes.
    pub held: Option<Held>,
    /// Waiting weighings, in order.
    pub waiting: Vec<Waiting>,
    /// The vial on the pan; none if the bench exchanges vials.
    pub vial: Option<Vial>,
    /// The newest repeatability check of the balance.
    pub repeatability: Option<Repeatability>,
    /// The current reservation of the bench.
    pub reservation: Option<Reservation>,
    /// The weighing in motion.
    pub moving: Option<String>,
    /// The end of a dose that could not be recorded yet.
    pub unwritten: Option<Unwritten>,
}

/// A weighing in motion.
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
    /// The weighing whose vial was confirmed as in, and the vial's name if given.
    ready: Option<(String, Option<String>)>,
    /// Number of stops so far: resuming must not undo a stop that came meanwhile.
    stops: u64,
}

/// Shared by the lane and by requests.
#[derive(Clone, Default)]
pub(super) struct Condition {
    known: Arc<Mutex<Known>>,
    /// Serializes reading which weighings wait, so that the last result is also the newest.
    reading: Arc<tokio::sync::Mutex<()>>,
    /// Held while the bench is cleared, while the lane records an ending, and briefly when it
    /// starts a weighing: these exclude each other.
    alone: Arc<tokio::sync::Mutex<()>>,
    /// The same as `held`, for code that moves the bench outside the lane.
    flag: Arc<AtomicBool>,
}

/// What a stop found, and what to store about it.
#[derive(Debug, Clone)]
pub(super) struct Halted {
    /// The weighing that was moving.
    pub weighing: Option<String>,
    /// The hold that starts with the stop, unless there is one already.
    pub held: Held,
    /// Who stopped: the record is written later, by another task.
    pub who: Option<Who>,
}

impl Known {
    fn halt(&mut self, by: Option<&str>) -> Halted {
        self.stops += 1;
        // The person who stops may take the vial away.
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
    /// A condition whose hold is also available as this flag, for pile making.
    pub fn of(flag: Arc<AtomicBool>) -> Self {
        Self { flag, ..Self::default() }
    }

    /// Loads what is stored.
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

    /// Called when weighings start or cease to wait. If they cannot be read, the lane reads them at
    /// its next poll.
    pub async fn refresh(&self, store: &Store) {
        let _one = self.reading.lock().await;
        match store.waiting_weighings().await {
            Ok(waiting) => self.known().waiting = waiting,
            Err(error) => tracing::warn!(%error, "which weighings wait cannot be read now"),
        }
    }

    /// Waits until the bench is not being cleared and no ending is being recorded; neither starts
    /// while this is held.
    pub async fn alone(&self) -> OwnedMutexGuard<()> {
        self.alone.clone().lock_owned().await
    }

    /// A snapshot of everything, as presented to others.
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

    /// Sets what is known of the pan, which is already stored.
    pub fn set_pan(&self, pan: Pan) {
        self.known().pan = pan;
    }

    /// Sets a new repeatability check, which is already stored.
    pub fn set_repeatability(&self, found: Repeatability) {
        self.known().repeatability = Some(found);
    }

    /// Sets or clears the reservation, which is already stored.
    pub fn set_reservation(&self, reservation: Option<Reservation>) {
        self.known().reservation = reservation;
    }

    /// Latches the bench from now on; if it is latched already, the first reason stays.
    pub fn latch(&self, latch: Latch) {
        let mut known = self.known();
        known.ready = None;
        known.latch.get_or_insert(latch);
    }

    /// Clears the latch, after a person's clearance has been stored.
    pub fn cleared(&self) {
        let mut known = self.known();
        (known.latch, known.ready) = (None, None);
        known.pan = known.pan.emptied();
    }

    /// Stops anything that moves and holds the bench, at once: the motion is stopped before its
    /// next step, and nothing else starts.
    pub fn halt(&self, by: Option<&str>) -> Halted {
        let mut known = self.known();
        self.flag.store(true, Ordering::SeqCst);
        known.halt(by)
    }

    /// The same, if it is this weighing that moves; returns what is known of it.
    pub fn halt_weighing(&self, id: &str, by: Option<&str>) -> Option<(Weighing, Halted)> {
        let mut known = self.known();
        let moving =
            known.moving.as_ref().map(|moving| moving.weighing.clone()).filter(|it| it.id == id)?;
        self.flag.store(true, Ordering::SeqCst);
        Some((moving, known.halt(by)))
    }

    /// Stops any motion because the process ends: nobody has to resume. Returns whether something
    /// moved.
    pub fn stop_moving(&self) -> bool {
        let known = self.known();
        known.moving.iter().for_each(|moving| moving.stop.press());
        known.moving.is_some()
    }

    /// Holds the bench; the hold is already stored.
    pub fn hold(&self, held: Held) {
        let mut known = self.known();
        self.flag.store(true, Ordering::SeqCst);
        known.held.get_or_insert(held);
    }

    /// Number of stops so far.
    pub fn stops(&self) -> u64 {
        self.known().stops
    }

    /// Resumes the bench, which is already stored. `false`: there has been another stop since
    /// `stops`, and it holds.
    pub fn resume(&self, stops: u64) -> bool {
        let mut known = self.known();
        if known.stops != stops {
            return false;
        }
        known.held = None;
        self.flag.store(false, Ordering::SeqCst);
        true
    }

    /// Confirms that the vial of a weighing is in. `false`: there has been another stop since
    /// `stops`, and the vial may have been taken away.
    pub fn vial_is_in(&self, weighing: &str, vial: Option<String>, stops: u64) -> bool {
        let mut known = self.known();
        if known.stops != stops {
            return false;
        }
        known.ready = Some((weighing.to_owned(), vial));
        true
    }

    /// Whether that was confirmed for this weighing.
    pub fn is_vial_in(&self, weighing: &str) -> bool {
        self.known().ready.as_ref().is_some_and(|(ready, _)| ready == weighing)
    }

    /// Whether the oldest weighing may be considered.
    pub fn is_free(&self) -> bool {
        let known = self.known();
        known.latch.is_none() && known.unwritten.is_none()
    }

    /// Starts a weighing, unless something prevents it. From here on a stop finds it.
    pub fn take_turn(&self, weighing: &Weighing, stop: &Arc<StopSign>, wants_vial: bool) -> bool {
        // The bench is being cleared, and its arm may move: the lane is woken afterwards.
        let Ok(_alone) = self.alone.try_lock() else { return false };
        let mut known = self.known();
        // A stop since the check has invalidated it.
        if wants_vial && known.ready.as_ref().is_none_or(|(ready, _)| *ready != weighing.id) {
            return false;
        }
        if known.latch.is_some() || known.held.is_some() || known.unwritten.is_some() {
            return false;
        }
        known.moving = Some(Moving { weighing: weighing.clone(), stop: stop.clone() });
        true
    }

    /// The vial that a weighing is for, if it has a name.
    pub fn vial_of(&self, weighing: &Weighing) -> Option<String> {
        let said = self.known().ready.clone().filter(|(ready, _)| *ready == weighing.id);
        said.and_then(|(_, vial)| vial).or_else(|| weighing.asked.vial.clone())
    }

    /// Marks the bench as armed for a weighing, with this state of the pan: the confirmation of the
    /// vial is used up.
    pub fn armed(&self, weighing: Weighing, pan: Pan) {
        let mut known = self.known();
        (known.pan, known.ready) = (pan, None);
        if let Some(moving) = &mut known.moving {
            moving.weighing = weighing;
        }
    }

    /// Updates the state of the weighing in motion.
    pub fn advance(&self, state: WeighingState) {
        if let Some(moving) = &mut self.known().moving {
            moving.weighing.state = state;
        }
    }

    /// Marks everything as at rest, with this state of the pan.
    pub fn stands(&self, pan: Pan) {
        let mut known = self.known();
        (known.moving, known.pan) = (None, pan);
    }

    /// The weighing whose turn it was has not been started.
    pub fn not_begun(&self) {
        self.known().moving = None;
    }

    /// Sets or clears the ending that cannot be recorded yet.
    pub fn set_unwritten(&self, unwritten: Option<Unwritten>) {
        self.known().unwritten = unwritten;
    }

    fn known(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_holds_what_moves_outside_the_lane_until_a_person_resumes() {
        let flag = Arc::<AtomicBool>::default();
        let is_held = || flag.load(Ordering::SeqCst);
        let condition = Condition::of(flag.clone());
        condition.halt(None);
        let first = condition.stops();
        assert!(is_held());
        condition.halt(None);
        assert!(!condition.resume(first) && is_held(), "there was another stop since");
        assert!(condition.resume(condition.stops()) && !is_held());
    }

    #[test]
    fn what_was_said_of_a_vial_before_a_stop_is_void_after_it() {
        let condition = Condition::default();
        assert!(condition.vial_is_in("w", None, condition.stops()) && condition.is_vial_in("w"));
        condition.halt(None);
        assert!(!condition.is_vial_in("w"));
    }
}
