//! Executions of observable commands: looked up by their UUID each time, in the database, whoever
//! began them and whichever process carried them out.
//!
//! A stream says at once how things stand, then again after each event, and ends with the last
//! value: clients wait for its end.

use super::Sila;
use super::error::{no_execution, not_finished, unanswered};
use super::standard::execution_info::CommandStatus;
use super::standard::{CommandConfirmation, CommandExecutionUuid, ExecutionInfo};
use super::value::{duration, real};
use crate::app::{self, App, Event, Job, JobKind, JobState, Topic, WeighingDetail};
use flip_core::domain::weighing::{Outcome, WeighingState};
use futures::StreamExt;
use futures::stream::{self, BoxStream};
use std::future::Future;
use tonic::{Response, Status};

/// Share of the work beyond which only the end counts as done.
const ALMOST: f64 = 0.99;

/// A stream of an answer.
pub type Values<T> = BoxStream<'static, Result<T, Status>>;

/// What a look found.
pub struct Seen<T> {
    /// The value now.
    pub value: T,
    /// Nothing can follow it.
    pub is_last: bool,
}

/// The confirmation of a command; an execution never ends to be known.
pub fn confirmation(id: String) -> Response<CommandConfirmation> {
    let command_execution_uuid = Some(CommandExecutionUuid { value: id });
    Response::new(CommandConfirmation { command_execution_uuid, lifetime_of_execution: None })
}

/// Values as they change: one at once, then one after each event that `matters` if it differs, and
/// the last.
///
/// # Errors
/// The first look's, and the application's for a topic that is not there.
pub async fn follow<T, L, F>(
    app: &App,
    topic: Topic,
    matters: fn(&Event) -> bool,
    look: L,
) -> Result<Response<Values<T>>, Status>
where
    T: Clone + PartialEq + Send + 'static,
    L: Fn() -> F + Send + 'static,
    F: Future<Output = Result<Seen<T>, Status>> + Send + 'static,
{
    // Before the first look, so that no event falls between the two.
    let after = app.last_event();
    let first = look().await?;
    if first.is_last {
        return Ok(Response::new(stream::iter([Ok(first.value)]).boxed()));
    }
    let events = app.events(topic, after).await.map_err(unanswered)?;
    let value = first.value.clone();
    let follower = Follower { events, matters, look, last: first.value, is_over: false };
    let later = stream::unfold(follower, async |mut it| Some((it.next().await?, it)));
    Ok(Response::new(stream::iter([Ok(value)]).chain(later).boxed()))
}

struct Follower<T, L> {
    events: BoxStream<'static, app::Result<Event>>,
    matters: fn(&Event) -> bool,
    look: L,
    last: T,
    is_over: bool,
}

impl<T, L, F> Follower<T, L>
where
    T: Clone + PartialEq,
    L: Fn() -> F,
    F: Future<Output = Result<Seen<T>, Status>>,
{
    async fn next(&mut self) -> Option<Result<T, Status>> {
        while !self.is_over {
            let no_more = match self.events.next().await {
                Some(Ok(event)) if !(self.matters)(&event) => continue,
                Some(Ok(_)) => false,
                Some(Err(error)) => {
                    self.is_over = true;
                    return Some(Err(unanswered(error)));
                }
                None => true,
            };
            let seen = match (self.look)().await {
                Ok(seen) => seen,
                Err(_) if no_more => return self.closing(),
                Err(status) => {
                    self.is_over = true;
                    return Some(Err(status));
                }
            };
            if no_more && !seen.is_last {
                return self.closing();
            }
            self.is_over = seen.is_last;
            if seen.value != self.last || seen.is_last {
                self.last = seen.value.clone();
                return Some(Ok(seen.value));
            }
        }
        None
    }

    /// Events end before the execution only when the server does.
    fn closing(&mut self) -> Option<Result<T, Status>> {
        self.is_over = true;
        Some(Err(Status::unavailable("the server is shutting down: ask again after the restart")))
    }
}

/// A weighing by the UUID of its execution.
///
/// # Errors
/// `InvalidCommandExecutionUUID`
pub async fn weighing(app: &App, uuid: &str) -> Result<WeighingDetail, Status> {
    app.weighing(uuid).await.map_err(|error| unknown(error, uuid))
}

/// A job by the UUID of its execution.
///
/// # Errors
/// `InvalidCommandExecutionUUID`, also for a job of another kind.
pub async fn job(app: &App, uuid: &str, kind: JobKind) -> Result<Job, Status> {
    let job = app.job(uuid).await.map_err(|error| unknown(error, uuid))?;
    if job.kind == kind { Ok(job) } else { Err(no_execution(uuid)) }
}

/// The error of an execution that cannot be looked up.
pub fn unknown(error: app::Error, uuid: &str) -> Status {
    match error {
        app::Error::NotFound { .. } => no_execution(uuid),
        error => unanswered(error),
    }
}

/// How far a dose is: by the share of the target that the balance shows.
pub async fn weighing_info(
    sila: &Sila,
    uuid: CommandExecutionUuid,
) -> Result<Response<Values<ExecutionInfo>>, Status> {
    let (app, id) = (&sila.app, uuid.value);
    let detail = weighing(app, &id).await?;
    let topic = Topic::Weighing(detail.weighing.id);
    let (looking, seen) = (app.clone(), id.clone());
    let look = move || {
        let (app, id) = (looking.clone(), seen.clone());
        async move { Ok(info_of_dose(&weighing(&app, &id).await?)) }
    };
    Ok(sila.audience.states(&id, follow(app, topic, |_| true, look).await?))
}

fn info_of_dose(detail: &WeighingDetail) -> Seen<ExecutionInfo> {
    let it = &detail.weighing;
    let shown_mg = detail.ticks.last().map_or(0.0, |tick| tick.reading.mass_mg);
    let share = (shown_mg / it.target_mg).clamp(0.0, ALMOST);
    let (status, share) = match (it.outcome, it.state) {
        (Some(outcome), _) if is_result(outcome) => (CommandStatus::FinishedSuccessfully, 1.0),
        (Some(_), _) => (CommandStatus::FinishedWithError, share),
        (None, WeighingState::Planned | WeighingState::AwaitingVial) => {
            (CommandStatus::Waiting, 0.0)
        }
        (None, _) => (CommandStatus::Running, share),
    };
    Seen { value: info(status, share, None), is_last: it.outcome.is_some() }
}

/// Whether a dose that ended so has a result; the others have an error.
pub fn is_result(outcome: Outcome) -> bool {
    matches!(outcome, Outcome::Within | Outcome::Under | Outcome::Probed)
}

/// How far a job is.
pub async fn job_info(
    sila: &Sila,
    uuid: CommandExecutionUuid,
    kind: JobKind,
) -> Result<Response<Values<ExecutionInfo>>, Status> {
    let states = follow_job(&sila.app, &uuid.value, kind, |job| {
        let status = match job.state {
            JobState::Queued => CommandStatus::Waiting,
            JobState::Running => CommandStatus::Running,
            JobState::Succeeded => CommandStatus::FinishedSuccessfully,
            JobState::Failed | JobState::Cancelled => CommandStatus::FinishedWithError,
        };
        let share = match job.state {
            JobState::Succeeded => 1.0,
            _ => job.progress.fraction.clamp(0.0, ALMOST),
        };
        info(status, share, job.left_s.or(job.expected_s))
    });
    Ok(sila.audience.states(&uuid.value, states.await?))
}

/// What an execution tells of its job before it ends.
pub async fn job_values<T: Clone + PartialEq + Send + 'static>(
    sila: &Sila,
    uuid: CommandExecutionUuid,
    kind: JobKind,
    value: fn(&Job) -> T,
) -> Result<Response<Values<T>>, Status> {
    let values = follow_job(&sila.app, &uuid.value, kind, value).await?;
    Ok(sila.audience.values(&uuid.value, values))
}

/// Something about a job as it changes.
async fn follow_job<T: Clone + PartialEq + Send + 'static>(
    app: &App,
    id: &str,
    kind: JobKind,
    value: fn(&Job) -> T,
) -> Result<Response<Values<T>>, Status> {
    job(app, id, kind).await?;
    let (looking, id, topic) = (app.clone(), id.to_owned(), Topic::Job(id.to_owned()));
    let look = move || {
        let (app, id) = (looking.clone(), id.clone());
        async move {
            let job = job(&app, &id, kind).await?;
            Ok(Seen { value: value(&job), is_last: job.state.is_terminal() })
        }
    };
    follow(app, topic, |_| true, look).await
}

/// The job once it has succeeded.
///
/// # Errors
/// `CommandExecutionNotFinished`; what `failed` and `cancelled` make of the others.
pub async fn succeeded(
    app: &App,
    uuid: &str,
    kind: JobKind,
    ended: impl FnOnce(&Job) -> Status,
) -> Result<(), Status> {
    let job = job(app, uuid, kind).await?;
    match job.state {
        JobState::Succeeded => Ok(()),
        JobState::Failed | JobState::Cancelled => Err(ended(&job)),
        JobState::Queued | JobState::Running => Err(not_finished(uuid)),
    }
}

fn info(status: CommandStatus, share: f64, left_s: Option<f64>) -> ExecutionInfo {
    ExecutionInfo {
        command_status: status as i32,
        progress_info: real(share),
        estimated_remaining_time: left_s.map(duration),
        updated_lifetime_of_execution: None,
    }
}
