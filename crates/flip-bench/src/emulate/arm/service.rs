//! The contract's calls, answered from the state of the desk.

use super::body::{Asked, End, refused};
use super::dead_man::{LOOK, Unrenewed};
use super::desk::{Desk, Why};
use super::fault::Fault;
use crate::hardware::arm::proto::{self, Executed, Mode, arm_server};
use std::pin::Pin;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::{mpsc, oneshot};
use tokio::time::sleep;
use tokio_stream::Stream;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status};

/// Interval between states, wall-clock: while moving, and otherwise.
const STATES: [Duration; 2] = [Duration::from_millis(5), Duration::from_millis(50)];

/// An answer, or a status that refuses it.
type Answered<T> = Result<Response<T>, Status>;

/// The driver as seen by its clients.
pub(super) struct Service(pub Arc<Desk>);

impl Service {
    /// Accept a motion, or find its earlier answer, and wait for it.
    async fn motion(&self, ticket: Option<proto::Ticket>, asked: Asked) -> Answered<Executed> {
        let ticket = ticket.ok_or_else(|| Status::invalid_argument("ticket: must be set"))?;
        let mut answer = self.0.accept(&ticket, asked)?;
        let outcome = match answer.wait_for(Option::is_some).await {
            Ok(outcome) => outcome.clone(),
            Err(_) => None,
        };
        self.hold_back().await;
        outcome.unwrap_or_else(|| Err(Status::unavailable("the driver ends"))).map(Response::new)
    }

    /// Delay an answer, or withhold it, according to the active faults.
    async fn hold_back(&self) {
        let slow = self.0.locked().faults.iter().find_map(|fault| match fault {
            Fault::SlowReply(late) => Some(*late),
            _ => None,
        });
        if let Some(late) = slow {
            sleep(late).await;
        }
        while self.0.locked().has(Fault::FrozenReply) {
            sleep(LOOK).await;
        }
    }

    /// Level and retract on behalf of a call, and wait for it.
    async fn bring_back(
        &self,
        returning: oneshot::Receiver<Result<(), Status>>,
    ) -> Result<(), Status> {
        let outcome = returning.await;
        self.hold_back().await;
        outcome.unwrap_or_else(|_| Err(Status::unavailable("the driver ends")))
    }
}

/// The dead-man: checks forever whether the lease was renewed in time.
pub(super) async fn watch_over(desk: Arc<Desk>) {
    loop {
        sleep(LOOK).await;
        let mut body = desk.locked();
        if body.is_abandoned(desk.dead_man()) {
            body.latch = End::DeadMan.latch_cause();
            // Nobody waits for the result: the mode shows it.
            drop(desk.begin_return(&mut body, Why::DeadMan, End::DeadMan));
        }
    }
}

#[tonic::async_trait]
impl arm_server::Arm for Service {
    async fn describe(&self, _: Request<proto::DescribeRequest>) -> Answered<proto::Description> {
        Ok(Response::new(self.0.describe()))
    }

    async fn acquire(&self, request: Request<proto::AcquireRequest>) -> Answered<proto::Lease> {
        if request.into_inner().client.is_empty() {
            return Err(Status::invalid_argument("client: must say who asks"));
        }
        let lease_id = self.0.locked().acquire()?;
        Ok(Response::new(proto::Lease {
            lease_id,
            dead_man_ms: self.0.dead_man().limit.as_millis() as u32,
        }))
    }

    async fn renew(&self, request: Request<proto::RenewRequest>) -> Answered<proto::RenewResponse> {
        let mut body = self.0.locked();
        body.held_by(&request.into_inner().lease_id)?.unrenewed = Unrenewed::since(Instant::now());
        Ok(Response::new(proto::RenewResponse { mode: body.mode.into() }))
    }

    async fn release(
        &self,
        request: Request<proto::ReleaseRequest>,
    ) -> Answered<proto::ReleaseResponse> {
        let returning = {
            let mut body = self.0.locked();
            body.held_by(&request.into_inner().lease_id)?;
            self.0.begin_return(&mut body, Why::Released, End::Released)
        };
        self.bring_back(returning).await?;
        Ok(Response::new(proto::ReleaseResponse {}))
    }

    async fn approach(&self, request: Request<proto::ApproachRequest>) -> Answered<Executed> {
        self.motion(request.into_inner().ticket, Asked::Approach).await
    }

    async fn retract(&self, request: Request<proto::RetractRequest>) -> Answered<Executed> {
        self.motion(request.into_inner().ticket, Asked::Retract).await
    }

    async fn pitch(&self, request: Request<proto::PitchRequest>) -> Answered<Executed> {
        let request = request.into_inner();
        self.motion(request.ticket, Asked::Pitch(request.pitch_deg)).await
    }

    async fn shake(&self, request: Request<proto::ShakeRequest>) -> Answered<Executed> {
        let request = request.into_inner();
        self.motion(request.ticket, Asked::Shake(request.amplitude_mm)).await
    }

    async fn scoop(&self, request: Request<proto::ScoopRequest>) -> Answered<Executed> {
        self.motion(request.into_inner().ticket, Asked::Scoop).await
    }

    async fn discard(&self, request: Request<proto::DiscardRequest>) -> Answered<Executed> {
        self.motion(request.into_inner().ticket, Asked::Discard).await
    }

    async fn invert(&self, request: Request<proto::InvertRequest>) -> Answered<Executed> {
        self.motion(request.into_inner().ticket, Asked::Invert).await
    }

    /// Answered once the brake is set: robots check it at least every 10 ms, and must be at rest
    /// within another 40 ms.
    async fn stop(&self, _: Request<proto::StopRequest>) -> Answered<proto::StopResponse> {
        let mut body = self.0.locked();
        if let Some(lease) = &mut body.lease {
            lease.stopped = true;
            // A motion that has already ended keeps its own cause.
            let _ = body.brake.set(End::Stopped);
            body.mode = Mode::Stopped;
        }
        Ok(Response::new(proto::StopResponse {}))
    }

    async fn recover(
        &self,
        request: Request<proto::RecoverRequest>,
    ) -> Answered<proto::RecoverResponse> {
        if request.into_inner().person.is_empty() {
            return Err(Status::invalid_argument("person: must say who has looked"));
        }
        let returning = {
            let mut body = self.0.locked();
            match body.mode {
                Mode::Idle => return Ok(Response::new(proto::RecoverResponse {})),
                Mode::Latched if body.has(Fault::UserStop) => {
                    return Err(refused("the user stop is still pressed"));
                }
                Mode::Latched => self.0.begin_return(&mut body, Why::Recovered, End::Stopped),
                _ => return Err(refused("the arm is not latched")),
            }
        };
        self.bring_back(returning).await?;
        Ok(Response::new(proto::RecoverResponse {}))
    }

    type StreamStateStream = Pin<Box<dyn Stream<Item = Result<proto::State, Status>> + Send>>;

    async fn stream_state(
        &self,
        _: Request<proto::StreamStateRequest>,
    ) -> Answered<Self::StreamStateStream> {
        let (say, states) = mpsc::channel(1);
        let desk = self.0.clone();
        tokio::spawn(async move {
            loop {
                let (state, moving) = desk.state();
                let ended = state.is_err();
                if say.send(state).await.is_err() || ended {
                    return;
                }
                sleep(STATES[usize::from(!moving)]).await;
            }
        });
        Ok(Response::new(Box::pin(ReceiverStream::new(states))))
    }
}
