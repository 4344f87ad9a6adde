//! BalanceReading: the last reading of the last dose. FLIP does not read its balance between doses.

use super::error::unanswered;
use super::execution::Values;
use super::proto::sila2::flip::weighing::balancereading::v1::subscribe_reading_responses::ReadingStruct;
use super::proto::sila2::flip::weighing::balancereading::v1::*;
use super::value::{boolean, integer, real, text};
use super::{Sila, read};
use crate::app::{App, Event, PageQuery, Topic, WeighingsAsked};
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

#[tonic::async_trait]
impl BalanceReading for Sila {
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
