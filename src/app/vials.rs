//! Whose turn it is on the bench: somebody says that a vial is in, or has the bench for himself for a while.

use super::check::Check;
use super::{App, Error, Result};
use crate::domain::timestamp::Timestamp;
use crate::domain::weighing::WeighingState;
use crate::store::pan::Reservation;
use crate::store::weighings::Weighing;
use crate::store::{new_id, now};
use serde::{Deserialize, Serialize};

/// Longest name, characters, as of what a weighing is for.
const NAME_MAX: usize = 200;
/// Longest reservation, s: a day.
const SECONDS_MAX: u32 = 24 * 60 * 60;

/// Somebody says that the vial of a weighing is in, and empty.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct VialReadyRequest {
    /// Who says so.
    #[serde(default)]
    pub by: Option<String>,
    /// What is written on the vial; where the weighing names one, it must be that.
    #[serde(default)]
    pub vial: Option<String>,
}

/// Somebody wants the bench for himself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ReservationRequest {
    /// Who.
    pub owner: String,
    /// For how long from now, s, 1 to 86400. It ends by itself then.
    pub seconds: u32,
    /// One's own reservation, to have it for longer.
    #[serde(default)]
    pub id: Option<String>,
}

impl App {
    /// The vial of the weighing whose turn it is is in: it begins.
    ///
    /// # Errors
    /// `Invalid`; `NotFound`; `Conflict` (`weighing_finished`, `not_its_turn`, `vial_differs`).
    pub async fn vial_ready(&self, id: &str, request: VialReadyRequest) -> Result<Weighing> {
        let mut check = Check::default();
        for (field, text) in [("by", &request.by), ("vial", &request.vial)] {
            text.iter().for_each(|text| check.text(field, text, NAME_MAX));
        }
        check.done()?;
        let bench = self.jobs_or_refuse()?.bench();
        let row = self.store().weighing(id).await?.ok_or_else(|| Error::not_found("weighing", id))?;
        let weighing = row.weighing;
        if weighing.outcome.is_some() {
            return Err(Error::conflict("weighing_finished", format!("weighing {id} has ended: it needs no vial")));
        }
        if weighing.state != WeighingState::AwaitingVial {
            return Err(not_its_turn(id, self.turn()?));
        }
        if let (Some(wanted), Some(said)) = (&weighing.asked.vial, &request.vial)
            && wanted != said
        {
            let advice = format!("weighing {id} is for vial `{wanted}`, and `{said}` was said to be in");
            return Err(Error::conflict("vial_differs", advice));
        }
        let vial = request.vial.or_else(|| weighing.asked.vial.clone());
        bench.vial_is_in(&weighing, request.by.as_deref(), vial).await?;
        Ok(weighing)
    }

    /// The weighing whose turn it is: the one that moves, or the oldest that waits.
    fn turn(&self) -> Result<Option<String>> {
        let standing = self.jobs_or_refuse()?.bench().standing();
        Ok(standing.moving.or_else(|| standing.waiting.into_iter().next().map(|it| it.id)))
    }

    /// Have the bench for oneself, or for longer.
    ///
    /// # Errors
    /// `Invalid`; `Conflict` (`bench_reserved`, `bench_in_use`).
    pub async fn reserve_bench(&self, request: ReservationRequest) -> Result<Reservation> {
        let mut check = Check::default();
        check.text("owner", &request.owner, NAME_MAX);
        check.count("seconds", request.seconds, 1, SECONDS_MAX);
        check.done()?;
        let bench = self.jobs_or_refuse()?.bench();
        let standing = bench.standing();
        self.check_reservation(request.id.as_deref())?;
        if request.id.is_none()
            && let Some(other) = standing.moving.or_else(|| standing.waiting.into_iter().next().map(|it| it.id))
        {
            let advice = format!("weighing {other} was asked for before: reserve the bench when nothing waits");
            return Err(Error::conflict("bench_in_use", advice));
        }
        let until = Timestamp::from_unix_ms(now().unix_ms() + 1000 * i64::from(request.seconds));
        let id = request.id.unwrap_or_else(|| format!("rs-{}", new_id()));
        let reservation = Reservation { id, owner: request.owner, until };
        bench.reserve(&reservation).await?;
        Ok(reservation)
    }

    /// Give the bench back before the reservation ends.
    ///
    /// # Errors
    /// `NotFound`
    pub async fn release_bench(&self, id: &str) -> Result<()> {
        match self.jobs_or_refuse()?.bench().release(id).await? {
            true => Ok(()),
            false => Err(Error::not_found("reservation", id)),
        }
    }

    /// Nobody else has the bench, and a reservation that is named holds.
    ///
    /// # Errors
    /// `Conflict` (`bench_reserved`, `reservation_ended`).
    pub(super) fn check_reservation(&self, named: Option<&str>) -> Result<()> {
        match (self.jobs_or_refuse()?.bench().standing().reservation, named) {
            (Some(reservation), Some(id)) if reservation.id == id => Ok(()),
            (Some(Reservation { owner, until, .. }), _) => {
                let advice = format!(
                    "{owner} has the bench for himself until {until}: name his reservation, or wait until it ends"
                );
                Err(Error::conflict("bench_reserved", advice))
            }
            (None, Some(id)) => {
                let advice = format!("reservation {id} has ended or never was: others may have used the bench since");
                Err(Error::conflict("reservation_ended", advice))
            }
            (None, None) => Ok(()),
        }
    }
}

fn not_its_turn(id: &str, turn: Option<String>) -> Error {
    let advice = match turn {
        Some(turn) if turn != id => {
            format!("it is not the turn of weighing {id} but of {turn}: leave the vial as it is")
        }
        _ => format!("weighing {id} does not wait for a vial"),
    };
    Error::conflict("not_its_turn", advice)
}
