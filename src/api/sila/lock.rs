//! LockController, on request: the lock is a reservation of the bench, so that it holds for every
//! other way to the bench too.
//!
//! A call with the lock's identifier extends the reservation by the lock's timeout. A lock without
//! one lasts a day after the last such call, which is the longest reservation.

use super::error::{Call, defined, framework, unanswered, undefined};
use super::feature::{LOCK, LOCKED, command};
use super::nameplate::HeldLock;
use super::proto::sila2::org::silastandard::core::lockcontroller::v1::*;
use super::standard::framework_error::ErrorType;
use super::value::{boolean, text};
use super::{Sila, operate, read};
use crate::app::{Error, ReservationRequest, Who};
use lock_controller_server::LockController;
use tokio::sync::Mutex;
use tonic::{Request, Response, Status};

/// Longest reservation, s.
const SECONDS_MAX: u32 = 24 * 60 * 60;

const LOCK_SERVER: Call = Call {
    feature: LOCK,
    command: "LockServer",
    parameters: &[("seconds", "Timeout")],
    errors: &[("bench_reserved", "ServerAlreadyLocked")],
};
const UNLOCK_SERVER: Call =
    Call { feature: LOCK, command: "UnlockServer", parameters: &[], errors: &[] };

/// Locking and unlocking, one after the other.
#[derive(Default)]
pub struct Lock(Mutex<()>);

#[tonic::async_trait]
impl LockController for Sila {
    async fn lock_server(
        &self,
        request: Request<LockServerParameters>,
    ) -> Result<Response<LockServerResponses>, Status> {
        let asked = operate(request)?;
        let identifier = LOCK_SERVER.text("LockIdentifier", asked.lock_identifier)?;
        let seconds = match LOCK_SERVER.count("Timeout", asked.timeout)? {
            None => SECONDS_MAX,
            Some(seconds) => seconds,
        };
        let _one = self.one().await;
        if self.held().await?.is_some() {
            let message = "somebody holds the lock: wait until it is released or ends";
            return Err(LOCK_SERVER.defined("ServerAlreadyLocked", message));
        }
        let asked = ReservationRequest { owner: owner(), seconds, id: None };
        let reserved = self.app.reserve_bench(asked).await.map_err(not_locked)?;
        self.note(Some(HeldLock { identifier, reservation: reserved.id, seconds }))?;
        Ok(Response::new(LockServerResponses {}))
    }

    async fn unlock_server(
        &self,
        request: Request<UnlockServerParameters>,
    ) -> Result<Response<UnlockServerResponses>, Status> {
        let asked = operate(request)?;
        let identifier = UNLOCK_SERVER.text("LockIdentifier", asked.lock_identifier)?;
        let _one = self.one().await;
        let Some(held) = self.held().await? else {
            let message = "nobody holds the lock: there is nothing to release";
            return Err(UNLOCK_SERVER.defined("ServerNotLocked", message));
        };
        if held.identifier != identifier {
            return Err(wrong_identifier());
        }
        match self.app.release_bench(&held.reservation).await {
            Ok(()) | Err(Error::NotFound { .. }) => {}
            Err(error) => return Err(UNLOCK_SERVER.refused(error)),
        }
        self.note(None)?;
        Ok(Response::new(UnlockServerResponses {}))
    }

    async fn get_is_locked(
        &self,
        request: Request<GetIsLockedParameters>,
    ) -> Result<Response<GetIsLockedResponses>, Status> {
        read(request)?;
        let bench = self.app.bench().await.map_err(unanswered)?;
        let is_locked = boolean(bench.reservation.is_some());
        Ok(Response::new(GetIsLockedResponses { is_locked }))
    }

    async fn get_fcp_affected_by_metadata_lock_identifier(
        &self,
        _: Request<GetFcpAffectedByMetadataLockIdentifierParameters>,
    ) -> Result<Response<GetFcpAffectedByMetadataLockIdentifierResponses>, Status> {
        let names = LOCKED.iter().map(|(feature, name)| command(feature, name));
        let affected_calls = names.filter_map(text).collect();
        Ok(Response::new(GetFcpAffectedByMetadataLockIdentifierResponses { affected_calls }))
    }
}

impl Sila {
    /// The reservation under which a call with this identifier is made, extended; none if nobody
    /// holds the lock.
    ///
    /// # Errors
    /// `InvalidLockIdentifier` for a call without the lock's identifier while somebody holds it.
    pub(super) async fn reservation(&self, sent: Option<String>) -> Result<Option<String>, Status> {
        if self.lock.is_none() {
            return Ok(None);
        }
        let _one = self.one().await;
        let Some(held) = self.held().await? else { return Ok(None) };
        if sent.as_deref() != Some(&*held.identifier) {
            return Err(wrong_identifier());
        }
        let HeldLock { reservation, seconds, .. } = held;
        let id = Some(reservation.clone());
        let extended =
            self.app.reserve_bench(ReservationRequest { owner: owner(), seconds, id }).await;
        extended.map_err(not_locked)?;
        Ok(Some(reservation))
    }

    async fn one(&self) -> Option<tokio::sync::MutexGuard<'_, ()>> {
        match &self.lock {
            Some(lock) => Some(lock.0.lock().await),
            None => None,
        }
    }

    /// The lock, if its reservation still stands.
    async fn held(&self) -> Result<Option<HeldLock>, Status> {
        let Some(held) = self.plate.lock() else { return Ok(None) };
        let now = self.app.bench().await.map_err(unanswered)?.reservation;
        Ok(Some(held).filter(|held| now.is_some_and(|now| now.id == held.reservation)))
    }

    fn note(&self, lock: Option<HeldLock>) -> Result<(), Status> {
        self.plate.set_lock(lock).map_err(|error| undefined(error.to_string()))
    }
}

/// Who the bench is reserved for.
fn owner() -> String {
    let name = Who::now().map_or_else(|| "anonymous".to_owned(), |who| who.name);
    format!("{name} (SiLA)")
}

fn wrong_identifier() -> Status {
    let message =
        "the server is locked: send the metadata LockIdentifier with the identifier that locked it";
    defined(LOCK, "InvalidLockIdentifier", message)
}

/// Why the bench cannot be reserved now.
fn not_locked(error: Error) -> Status {
    match &error {
        Error::Conflict { code: "bench_in_use", message } => {
            framework(ErrorType::CommandExecutionNotAccepted, message)
        }
        _ => LOCK_SERVER.refused(error),
    }
}
