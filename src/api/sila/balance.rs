//! BalanceReading: the readings of doses, and the balance between doses.

use super::error::{Call, unanswered};
use super::execution::Values;
use super::feature::BALANCE;
use super::identity::lock_identifier;
use super::proto::sila2::flip::weighing::balancereading::v1::subscribe_reading_responses::ReadingStruct;
use super::proto::sila2::flip::weighing::balancereading::v1::*;
use super::value::{boolean, integer, real, text};
use super::{Sila, operate, read};
use crate::app::{App, BalanceRequest, Event, PageQuery, Topic, WeighingsAsked};
use balance_reading_server::BalanceReading;
use flip_core::domain::bench::Tick;
use futures::StreamExt;
use futures::stream;
use std::future::ready;
use tonic::{Request, Response, Status};

/// Newest weighings among which one with a reading is looked for: those that wait have none.
const LOOKED_AT: u32 = 20;
/// Topics of weighings begin so.
const WEIGHING: &str = "weighing:";

const READ: Call = Call {
    feature: BALANCE,
    command: "Read",
    parameters: &[],
    errors: &[
        ("no_balance", "NoBalance"),
        ("bench_busy", "BenchBusy"),
        ("ending_unwritten", "BenchBusy"),
        ("bench_latched", "BenchLatched"),
        ("bench_reserved", "BenchReserved"),
        ("reservation_ended", "BenchReserved"),
        ("balance_failed", "BalanceFailed"),
    ],
};
const TARE: Call = Call { command: "Tare", ..READ };
const ZERO: Call = Call { command: "Zero", ..READ };

#[tonic::async_trait]
impl BalanceReading for Sila {
    async fn read(
        &self,
        request: Request<ReadParameters>,
    ) -> Result<Response<ReadResponses>, Status> {
        read(request)?;
        let shown = self.app.read_balance().await.map_err(|error| READ.refused(error))?;
        let (mass, stable) = (real(shown.mass_mg), boolean(shown.stable));
        Ok(Response::new(ReadResponses { mass, stable }))
    }

    async fn tare(
        &self,
        request: Request<TareParameters>,
    ) -> Result<Response<TareResponses>, Status> {
        let request = self.locked(request).await?;
        let tared = self.app.tare_balance(request).await.map_err(|error| TARE.refused(error))?;
        let (mass, stable) = (real(tared.mass_mg), boolean(tared.stable));
        Ok(Response::new(TareResponses { mass, stable }))
    }

    async fn zero(
        &self,
        request: Request<ZeroParameters>,
    ) -> Result<Response<ZeroResponses>, Status> {
        let request = self.locked(request).await?;
        let zeroed = self.app.zero_balance(request).await.map_err(|error| ZERO.refused(error))?;
        let (mass, stable) = (real(zeroed.mass_mg), boolean(zeroed.stable));
        Ok(Response::new(ZeroResponses { mass, stable }))
    }

    type Subscribe_ReadingStream = Values<SubscribeReadingResponses>;

    async fn subscribe_reading(
        &self,
        request: Request<SubscribeReadingParameters>,
    ) -> Result<Response<Values<SubscribeReadingResponses>>, Status> {
        read(request)?;
        let after = self.app.last_event();
        let first = last_reading(&self.app).await?;
        let events = self.app.events(Topic::All, after).await.map_err(unanswered)?;
        let later = events.filter_map(|event| {
            ready(match event {
                Ok(event) => of_event(&event).map(Ok),
                Err(error) => Some(Err(unanswered(error))),
            })
        });
        Ok(Response::new(stream::iter([Ok(first)]).chain(later).boxed()))
    }
}

impl Sila {
    /// What an operator asks for, under the lock that was sent along.
    async fn locked<T>(&self, request: Request<T>) -> Result<BalanceRequest, Status> {
        let lock = lock_identifier(request.metadata().as_ref())?;
        operate(request)?;
        Ok(BalanceRequest { reservation: self.reservation(lock).await? })
    }
}

fn of_event(event: &Event) -> Option<SubscribeReadingResponses> {
    let weighing = event.topic.strip_prefix(WEIGHING).filter(|_| event.kind == "tick")?;
    let tick = serde_json::from_value(event.data.clone()).ok()?;
    Some(reading(weighing, &tick))
}

/// The last reading so far; nothing was ever read if it names no weighing.
async fn last_reading(app: &App) -> Result<SubscribeReadingResponses, Status> {
    let newest = app.weighings(WeighingsAsked::default(), PageQuery::first(LOOKED_AT)).await;
    for weighing in newest.map_err(unanswered)?.page.items {
        let detail = app.weighing(&weighing.id).await.map_err(unanswered)?;
        if let Some(tick) = detail.ticks.last() {
            return Ok(reading(&weighing.id, tick));
        }
    }
    let nothing = ReadingStruct {
        mass: real(0.0),
        stable: boolean(false),
        weighing: text(""),
        step: integer(0),
    };
    Ok(SubscribeReadingResponses { reading: Some(nothing) })
}

fn reading(weighing: &str, tick: &Tick) -> SubscribeReadingResponses {
    let reading = ReadingStruct {
        mass: real(tick.reading.mass_mg),
        stable: boolean(tick.reading.stable),
        weighing: text(weighing),
        step: integer(tick.step),
    };
    SubscribeReadingResponses { reading: Some(reading) }
}
