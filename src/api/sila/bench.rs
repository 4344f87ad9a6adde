//! BenchControl.

use super::error::{Call, unanswered};
use super::execution::{Seen, Values, follow};
use super::feature::BENCH;
use super::proto::sila2::flip::weighing::benchcontrol::v1::subscribe_bench_responses::BenchStruct;
use super::proto::sila2::flip::weighing::benchcontrol::v1::*;
use super::value::{integer, text};
use super::{Sila, clear, operate, read};
use crate::app::{App, BENCH_TOPIC, BenchStatus, ClearRequest, Event, ResumeRequest, Topic};
use bench_control_server::BenchControl;
use flip_core::domain::weighing::WeighingState;
use tonic::{Request, Response, Status};

/// Most characters of the name of a person who stops: a stop is never refused for it.
const NAME_MAX: usize = 200;

const STOP: Call = Call { feature: BENCH, command: "Stop", parameters: &[], errors: &[] };
const CLEAR: Call = Call {
    feature: BENCH,
    command: "Clear",
    parameters: &[
        ("by", "Person"),
        ("note", "Note"),
        ("looked", "Looked"),
        ("vial_ready", "VialReady"),
    ],
    errors: &[
        ("bench_not_latched", "BenchNotLatched"),
        ("bench_differs", "BenchDiffers"),
        ("arm_not_recovered", "ArmNotRecovered"),
        ("ending_unwritten", "EndingUnwritten"),
        ("stopped_meanwhile", "StoppedMeanwhile"),
    ],
};
const RESUME: Call = Call {
    feature: BENCH,
    command: "Resume",
    parameters: &[("by", "Person"), ("note", "Note")],
    errors: &[
        ("bench_not_held", "BenchNotHeld"),
        ("bench_latched", "BenchLatched"),
        ("stopped_meanwhile", "StoppedMeanwhile"),
    ],
};

#[tonic::async_trait]
impl BenchControl for Sila {
    async fn stop(
        &self,
        request: Request<StopParameters>,
    ) -> Result<Response<StopResponses>, Status> {
        let by = STOP.some_text("Person", operate(request)?.person)?;
        let plain = |by: String| by.chars().filter(|c| !c.is_control()).take(NAME_MAX).collect();
        let by: Option<String> = by.map(plain);
        let bench = self.app.halt(by.as_deref()).map_err(unanswered)?;
        Ok(Response::new(StopResponses { state: text(state(&bench)) }))
    }

    async fn clear(
        &self,
        request: Request<ClearParameters>,
    ) -> Result<Response<ClearResponses>, Status> {
        let asked = clear(request)?;
        let request = ClearRequest {
            by: CLEAR.text("Person", asked.person)?,
            note: CLEAR.text("Note", asked.note)?,
            looked: CLEAR.boolean("Looked", asked.looked)?,
            vial_ready: CLEAR.boolean("VialReady", asked.vial_ready)?,
            resume: CLEAR.boolean("Resume", asked.resume)?,
        };
        let bench = self.app.clear_bench(request).await.map_err(|error| CLEAR.refused(error))?;
        Ok(Response::new(ClearResponses { state: text(state(&bench)) }))
    }

    async fn resume(
        &self,
        request: Request<ResumeParameters>,
    ) -> Result<Response<ResumeResponses>, Status> {
        let asked = operate(request)?;
        let (by, note) = (RESUME.text("Person", asked.person)?, RESUME.text("Note", asked.note)?);
        let resumed = self.app.resume_bench(ResumeRequest { by, note }).await;
        let bench = resumed.map_err(|error| RESUME.refused(error))?;
        Ok(Response::new(ResumeResponses { state: text(state(&bench)) }))
    }

    type Subscribe_StateStream = Values<SubscribeStateResponses>;

    async fn subscribe_state(
        &self,
        request: Request<SubscribeStateParameters>,
    ) -> Result<Response<Values<SubscribeStateResponses>>, Status> {
        read(request)?;
        watch(&self.app, |bench| SubscribeStateResponses { state: text(state(bench)) }).await
    }

    type Subscribe_BenchStream = Values<SubscribeBenchResponses>;

    async fn subscribe_bench(
        &self,
        request: Request<SubscribeBenchParameters>,
    ) -> Result<Response<Values<SubscribeBenchResponses>>, Status> {
        read(request)?;
        watch(&self.app, |bench| SubscribeBenchResponses { bench: Some(described(bench)) }).await
    }
}

/// Something about the bench as it changes.
async fn watch<T: Clone + PartialEq + Send + 'static>(
    app: &App,
    value: fn(&BenchStatus) -> T,
) -> Result<Response<Values<T>>, Status> {
    let looking = app.clone();
    let look = move || {
        let app = looking.clone();
        async move {
            let bench = app.bench().await.map_err(unanswered)?;
            Ok(Seen { value: value(&bench), is_last: false })
        }
    };
    follow(app, Topic::All, is_of_the_bench, look).await
}

fn is_of_the_bench(event: &Event) -> bool {
    event.topic == BENCH_TOPIC || event.topic.starts_with("weighing:") && event.kind == "state"
}

/// What prevents the next dose, or that one moves.
fn state(bench: &BenchStatus) -> &'static str {
    let awaits = || bench.waiting.first().is_some_and(|it| it.state == WeighingState::AwaitingVial);
    match bench {
        BenchStatus { latch: Some(_), .. } => "Latched",
        BenchStatus { unwritten: Some(_), .. } => "Unwritten",
        BenchStatus { moving: Some(_), .. } | BenchStatus { piling: Some(_), .. } => "Moving",
        BenchStatus { held: Some(_), .. } => "Held",
        _ if awaits() => "AwaitingVial",
        _ => "Idle",
    }
}

fn described(bench: &BenchStatus) -> BenchStruct {
    let latched = bench.latch.as_ref().map(|latch| latch.reason.clone());
    let held = || bench.held.as_ref().map(|held| held.reason.clone());
    BenchStruct {
        state: text(state(bench)),
        kind: text(bench.kind.map_or("", |kind| kind.name())),
        reason: text(latched.or_else(held).unwrap_or_default()),
        moving: text(bench.moving.clone().unwrap_or_default()),
        waiting: integer(bench.waiting.len() as i64),
        vial: text(bench.vial.as_ref().and_then(|vial| vial.name.clone()).unwrap_or_default()),
        reserved_by: text(bench.reservation.as_ref().map_or("", |it| it.owner.as_str())),
    }
}
