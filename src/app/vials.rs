//! Turns on the bench: confirming that a vial is in, and reserving the bench for a while.

use super::bench::stopped_meanwhile;
use super::bench_requests::{BenchAsk, asks};
use super::check::Check;
use super::{App, Error, Result};
use crate::jobs::bench::Change;
use flip_core::domain::weighing::WeighingState;
use flip_store::pan::{Refused, Reservation, refusal};
use flip_store::weighings::Weighing;
use serde::{Deserialize, Serialize};

/// Maximum length of a name, characters, as for the purpose of a weighing.
const NAME_MAX: usize = 200;
/// Maximum duration of a reservation, s: a day.
const SECONDS_MAX: u32 = 24 * 60 * 60;

/// A person confirms that the vial of a weighing is in, and empty.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VialReadyRequest {
    /// Name of the person confirming.
    #[serde(default)]
    pub by: Option<String>,
    /// Label on the vial; if the weighing names a vial, it must match.
    #[serde(default)]
    pub vial: Option<String>,
}

/// A request to reserve the bench.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReservationRequest {
    /// Who reserves the bench.
    pub owner: String,
    /// Duration from now, s, 1 to 86400; the reservation then expires.
    pub seconds: u32,
    /// Your own reservation, to extend it.
    #[serde(default)]
    pub id: Option<String>,
}

impl App {
    /// Confirms that the vial of the weighing whose turn it is is in: the weighing starts. Void if
    /// the bench is stopped before that is recorded: the person who stops may take the vial away.
    ///
    /// # Errors
    /// `Invalid`; `NotFound`; `Conflict` (`weighing_finished`, `not_its_turn`, `vial_differs`,
    /// `stopped_meanwhile`).
    pub async fn vial_ready(&self, id: &str, request: VialReadyRequest) -> Result<Weighing> {
        let stops = self.stops_when_asked()?;
        let mut check = Check::default();
        for (field, text) in [("by", &request.by), ("vial", &request.vial)] {
            text.iter().for_each(|text| check.text(field, text, NAME_MAX));
        }
        check.done()?;
        let bench = self.jobs_or_refuse()?.bench();
        let row =
            self.store().weighing(id).await?.ok_or_else(|| Error::not_found("weighing", id))?;
        let weighing = row.weighing;
        if let Some(there) = self.elsewhere(weighing.at_bench()).await? {
            let ask = BenchAsk::VialReady { id: id.to_owned(), request };
            return self.ask(&there, ask).await.and_then(asks::read);
        }
        if weighing.outcome.is_some() {
            return Err(Error::conflict(
                "weighing_finished",
                format!("weighing {id} has ended: it needs no vial"),
            ));
        }
        if weighing.state != WeighingState::AwaitingVial {
            return Err(not_its_turn(id, self.turn()?));
        }
        if let (Some(wanted), Some(said)) = (&weighing.asked.vial, &request.vial)
            && wanted != said
        {
            let advice =
                format!("weighing {id} is for vial `{wanted}`, but `{said}` was confirmed");
            return Err(Error::conflict("vial_differs", advice));
        }
        let vial = request.vial.or_else(|| weighing.asked.vial.clone());
        match bench.vial_is_in(&weighing, request.by.as_deref(), vial, stops).await? {
            Change::Made => Ok(weighing),
            Change::Nothing => Err(not_its_turn(id, self.turn()?)),
            Change::Void => Err(stopped_meanwhile("check the vial, and confirm it again")),
        }
    }

    /// The weighing whose turn it is: the one in motion, or the oldest waiting one.
    fn turn(&self) -> Result<Option<String>> {
        let standing = self.jobs_or_refuse()?.bench().standing();
        Ok(standing.moving.or_else(|| standing.waiting.into_iter().next().map(|it| it.id)))
    }

    /// Reserves the bench, or extends a reservation.
    ///
    /// # Errors
    /// `Invalid`; `Conflict` (`bench_reserved`, `bench_in_use`).
    pub async fn reserve_bench(&self, request: ReservationRequest) -> Result<Reservation> {
        let mut check = Check::default();
        check.text("owner", &request.owner, NAME_MAX);
        check.count("seconds", request.seconds, 1, SECONDS_MAX);
        check.done()?;
        let ReservationRequest { owner, seconds, id } = &request;
        let reserved =
            self.jobs_or_refuse()?.bench().reserve(id.as_deref(), owner, *seconds).await?;
        reserved.map_err(refused)
    }

    /// Releases the bench before the reservation ends.
    ///
    /// # Errors
    /// `NotFound`
    pub async fn release_bench(&self, id: &str) -> Result<()> {
        match self.jobs_or_refuse()?.bench().release(id).await? {
            true => Ok(()),
            false => Err(Error::not_found("reservation", id)),
        }
    }

    /// Checks that nobody else has reserved the bench, and that a named reservation is valid, as
    /// far as is known: the request checks again when it writes.
    ///
    /// # Errors
    /// `Conflict` (`bench_reserved`, `reservation_ended`).
    pub(super) fn check_reservation(&self, named: Option<&str>) -> Result<()> {
        let reserved = self.jobs_or_refuse()?.bench().standing().reservation;
        refusal(reserved, named).map_or(Ok(()), |it| Err(refused(it)))
    }
}

/// Why somebody may not use the bench, and what to do.
pub(super) fn refused(why: Refused) -> Error {
    match why {
        Refused::Reserved(Reservation { owner, until, .. }) => {
            let advice = format!(
                "{owner} has reserved the bench until {until}: name that reservation, or wait until it ends"
            );
            Error::conflict("bench_reserved", advice)
        }
        Refused::Ended(id) => {
            let advice = format!(
                "reservation {id} has ended or never existed: others may have used the bench since"
            );
            Error::conflict("reservation_ended", advice)
        }
        Refused::InUse(id) => {
            let advice = format!(
                "weighing {id} was requested earlier: reserve the bench when nothing is waiting"
            );
            Error::conflict("bench_in_use", advice)
        }
    }
}

fn not_its_turn(id: &str, turn: Option<String>) -> Error {
    let advice = match turn {
        Some(turn) if turn != id => {
            format!("it is not the turn of weighing {id} but of {turn}: leave the vial as it is")
        }
        _ => format!("weighing {id} is not waiting for a vial"),
    };
    Error::conflict("not_its_turn", advice)
}
