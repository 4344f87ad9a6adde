//! People's requests to the bench other than doses: resume, clear, reserve, and confirm that a vial
//! is in.
//!
//! Each may wait for the database, and a stop that comes meanwhile takes precedence: a request
//! carries the number of stops at the time it was made.

use super::Bench;
use flip_bench::hardware::DeviceError;
use flip_core::domain::timestamp::Timestamp;
use flip_store::bench::Latch;
use flip_store::holds::Held;
use flip_store::pan::{Refused, Reservation};
use flip_store::weighings::Weighing;
use flip_store::{self as store, new_id, now};
use tokio::sync::OwnedMutexGuard;

/// Result of a request to the bench.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Change {
    /// It was carried out.
    Made,
    /// It was so already, or is no longer possible.
    Nothing,
    /// The bench was stopped after the request was made.
    Void,
}

impl Bench {
    /// Number of stops so far: a request that a stop invalidates carries this number from its
    /// beginning.
    pub fn stops(&self) -> u64 {
        self.condition.stops()
    }

    /// Lets doses start again, unless there has been a stop since `stops`; records who resumed.
    ///
    /// # Errors
    /// [`store::Error`]: the bench is still held.
    pub async fn resume(&self, by: &str, note: &str, stops: u64) -> store::Result<Change> {
        self.records.write_down(&self.store).await?;
        let mut tx = self.store.write_for_bench().await?;
        // A stop from here on is recorded after this transaction.
        if self.stops() != stops {
            return Ok(Change::Void);
        }
        if !tx.resume_bench(by, note, now()).await? {
            return Ok(Change::Nothing);
        }
        tx.commit().await?;
        let resumed = self.condition.resume(stops);
        self.wake();
        Ok(if resumed { Change::Made } else { Change::Void })
    }

    /// Waits for its turn to clear the bench: while this is held, no dose starts or ends, and no
    /// other clearance runs. Wake the lane afterwards.
    pub async fn alone(&self) -> OwnedMutexGuard<()> {
        self.condition.alone().await
    }

    /// Why the bench may not be used, including causes known only to the store.
    ///
    /// # Errors
    /// [`store::Error`]
    pub async fn latch(&self) -> store::Result<Option<Latch>> {
        if let Some(latch) = self.standing().latch {
            return Ok(Some(latch));
        }
        let stored = self.store.latch().await?;
        stored.iter().for_each(|latch| self.condition.latch(latch.clone()));
        Ok(stored)
    }

    /// Clears the latch after a person's check, unless there has been a stop since `stops`. The
    /// hold of a stop stays unless `resume` is set; if weighings are waiting, the bench is held.
    ///
    /// # Errors
    /// [`store::Error`]: the bench is still latched.
    pub async fn clear(
        &self,
        by: &str,
        note: &str,
        resume: bool,
        stops: u64,
    ) -> store::Result<Change> {
        self.records.write_down(&self.store).await?;
        let pan = self.condition.pan().emptied();
        let mut tx = self.store.write_for_bench().await?;
        if self.stops() != stops {
            return Ok(Change::Void);
        }
        tx.clear_latch(by, note, now()).await?;
        if !self.exchanges_vials() {
            tx.set_pan(&pan).await?;
        }
        let waits = !resume && tx.planned_weighings().await? > 0;
        let held = waits.then(|| cleared_while_weighings_waited(by));
        if let Some(held) = &held {
            tx.hold_bench(held).await?;
        }
        if resume {
            tx.resume_bench(by, note, now()).await?;
        }
        tx.commit().await?;
        // The hold comes first, so that nothing starts between the two.
        held.into_iter().for_each(|held| self.condition.hold(held));
        if resume {
            self.condition.resume(stops);
        }
        self.condition.cleared();
        Ok(Change::Made)
    }

    /// Confirms that the vial of the weighing whose turn it is is in, unless there has been a stop
    /// since `stops`.
    ///
    /// # Errors
    /// [`store::Error`]
    pub async fn vial_is_in(
        &self,
        weighing: &Weighing,
        by: Option<&str>,
        vial: Option<String>,
        stops: u64,
    ) -> store::Result<Change> {
        let mut tx = self.store.write_for_bench().await?;
        if self.stops() != stops {
            return Ok(Change::Void);
        }
        if !tx.awaits_vial(&weighing.id).await? {
            return Ok(Change::Nothing);
        }
        tx.vial_is_in(&weighing.id, by, vial.as_deref(), now()).await?;
        tx.commit().await?;
        let said = self.condition.vial_is_in(&weighing.id, vial, stops);
        self.wake();
        Ok(if said { Change::Made } else { Change::Void })
    }

    /// Reserves the bench until then: extends the reservation with this id, or makes a new one if
    /// nothing is waiting.
    ///
    /// # Errors
    /// [`store::Error`]
    pub async fn reserve(
        &self,
        id: Option<&str>,
        owner: &str,
        seconds: u32,
    ) -> store::Result<Result<Reservation, Refused>> {
        let _one = self.reserving.lock().await;
        let mut tx = self.store.write_for_bench().await?;
        if let Some(refused) = tx.may_reserve(id, now()).await? {
            return Ok(Err(refused));
        }
        let id = id.map_or_else(|| format!("rs-{}", new_id()), str::to_owned);
        let until = Timestamp::from_unix_ms(now().unix_ms() + 1000 * i64::from(seconds));
        let reservation = Reservation { id, owner: owner.to_owned(), until };
        tx.reserve_bench(&reservation, now()).await?;
        tx.commit().await?;
        self.condition.set_reservation(Some(reservation.clone()));
        Ok(Ok(reservation))
    }

    /// Releases the reservation. `false`: the id is not that of the current one.
    ///
    /// # Errors
    /// [`store::Error`]
    pub async fn release(&self, id: &str) -> store::Result<bool> {
        let _one = self.reserving.lock().await;
        let mut tx = self.store.write_for_bench().await?;
        let released = tx.release_bench(id, now()).await?;
        tx.commit().await?;
        if released {
            self.condition.set_reservation(None);
        }
        Ok(released)
    }

    /// Why the arm is latched, if it is.
    ///
    /// # Errors
    /// The arm cannot be reached.
    pub async fn arm_latch(&self) -> Result<Option<String>, DeviceError> {
        let rig = self.rig.clone();
        let asked = tokio::task::spawn_blocking(move || rig.arm_latch()).await;
        asked.unwrap_or_else(|error| {
            Err(DeviceError::Faulted { device: "the arm", cause: error.to_string() })
        })
    }

    /// Lets a latched arm move again after a person's check. Nothing is recorded here. A stop
    /// aborts it if the arm receives stops.
    ///
    /// # Errors
    /// The arm cannot be reached, the cause of the latch persists, or the arm was stopped on its
    /// way.
    pub async fn recover(&self, person: &str) -> Result<(), DeviceError> {
        let (rig, person) = (self.rig.clone(), person.to_owned());
        let recovered = tokio::task::spawn_blocking(move || rig.recover(&person)).await;
        recovered.unwrap_or_else(|error| {
            Err(DeviceError::Faulted { device: "the arm", cause: error.to_string() })
        })
    }
}

fn cleared_while_weighings_waited(by: &str) -> Held {
    let reason = "the latch was cleared while weighings waited".to_owned();
    Held { at: now(), reason, by: Some(by.to_owned()) }
}
