//! Requests to a bench of another process: a row in the database that its owner answers.
//!
//! Nothing is carried out later than its row says: who did not hear an answer by then knows that it
//! was not. A stop is the exception. It may come late, and then still stops.

use super::bench::{ClearRequest, ResumeRequest};
use super::{App, Error, Result, VialReadyRequest, WeighingRequest};
use flip_core::domain::FieldError;
use flip_core::domain::timestamp::Timestamp;
use flip_store::bench_requests::BenchRequest;
use flip_store::weighings::Weighing;
use flip_store::who::{Who, acting_maybe};
use flip_store::{self as store, Store, new_id, now};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::HashSet;
use std::time::Duration;
use tokio::sync::watch;

/// How long an answer is waited for.
const PATIENCE: Duration = Duration::from_secs(5);
/// Within which an owner begins to carry out a request, ms; less than is waited.
const BEGIN_MS: i64 = 4000;
/// Within which a stop still stops, ms.
const STOP_MS: i64 = 60_000;
/// How often an answer, and requests, are looked for without a word of them.
const LOOK: Duration = Duration::from_millis(500);

/// What is asked of a bench's owner.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum BenchAsk {
    /// Commit an intent to weigh.
    Weigh { request: Box<WeighingRequest>, key: String },
    /// Stop whatever moves.
    Stop,
    /// Stop one weighing.
    StopWeighing { id: String },
    /// Let weighings start again.
    Resume(ResumeRequest),
    /// Clear the latch.
    Clear(ClearRequest),
    /// Confirm that a vial is in.
    VialReady { id: String, request: VialReadyRequest },
}

impl BenchAsk {
    fn is_stop(&self) -> bool {
        matches!(self, Self::Stop | Self::StopWeighing { .. })
    }
}

/// A request with its caller.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Letter {
    who: Option<Who>,
    ask: BenchAsk,
}

/// An answer.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Reply {
    Done(Value),
    Invalid(Vec<FieldError>),
    NotFound { what: String, id: String },
    Conflict { code: String, message: String },
    Unprocessable { key: String, weighing: String },
    Busy(String),
    Unavailable(String),
}

/// Reading answers.
pub(super) mod asks {
    use super::{Error, Result, Value};
    use serde::de::DeserializeOwned;

    /// The result in an answer.
    pub(in super::super) fn read<T: DeserializeOwned>(value: Value) -> Result<T> {
        serde_json::from_value(value).map_err(|error| Error::Internal(error.into()))
    }
}

impl App {
    /// Asks the owner of another bench, which `there` speaks for, and waits for its answer.
    ///
    /// # Errors
    /// Those of the request; `Unavailable`: it was not heard.
    pub(super) async fn ask(&self, there: &Store, ask: BenchAsk) -> Result<Value> {
        let is_stop = ask.is_stop();
        let at = now();
        let within = if is_stop { STOP_MS } else { BEGIN_MS };
        let until = Timestamp::from_unix_ms(at.unix_ms() + within);
        let letter = Letter { who: Who::now(), ask };
        let request = BenchRequest { id: format!("br-{}", new_id()), body: letter, until };
        let mut heard = there.watch_events();
        let mut tx = there.write().await?;
        tx.ask_bench(&request, at).await?;
        tx.commit().await?;
        let answered = async {
            loop {
                if let Some(reply) = there.bench_answer::<Reply>(&request.id).await? {
                    return Ok::<_, store::Error>(reply);
                }
                wait(&mut heard).await;
            }
        };
        match tokio::time::timeout(PATIENCE, answered).await {
            Ok(reply) => reply?.read(),
            Err(_) => Err(unheard(there.bench_name(), is_stop)),
        }
    }

    /// Answers what other processes ask of this one's bench, until work ends.
    pub(super) fn keep_answering(&self) {
        let Some(jobs) = self.inner.jobs.as_ref() else { return };
        if self.store().bench_owner().is_none() {
            return;
        }
        let (closing, app) = (jobs.closing(), std::sync::Arc::downgrade(&self.inner));
        let mut heard = self.store().watch_events();
        tokio::spawn(async move {
            // Those that were taken up: none is carried out twice.
            let mut taken = HashSet::new();
            while !closing.is_cancelled() {
                let Some(inner) = app.upgrade() else { return };
                let app = Self { inner };
                if let Err(error) = app.take_up_all(&mut taken).await
                    && !error.is_closed()
                {
                    tracing::warn!(%error, "what others ask of the bench cannot be read now");
                }
                drop(app);
                tokio::select! {
                    () = wait(&mut heard) => {}
                    () = closing.cancelled() => {}
                }
            }
        });
    }

    /// Takes up what is asked, each in a task of its own: a stop waits for nothing else.
    async fn take_up_all(&self, taken: &mut HashSet<String>) -> store::Result<()> {
        let open = self.store().open_bench_requests::<Letter>().await?;
        taken.retain(|id| open.iter().any(|request| request.id == *id));
        for request in open {
            if taken.insert(request.id.clone()) {
                let app = self.clone();
                tokio::spawn(async move { app.answer(request).await });
            }
        }
        Ok(())
    }

    async fn answer(&self, request: BenchRequest<Letter>) {
        let BenchRequest { id, body: Letter { who, ask }, until } = request;
        let reply = match now() > until {
            true => Reply::Unavailable("it was asked too long ago, and was not done".to_owned()),
            false => Reply::of(acting_maybe(who, self.carry_out(ask)).await),
        };
        let answered = async {
            let mut tx = self.store().write().await?;
            tx.answer_bench_request(&id, &reply, now()).await?;
            tx.commit().await
        };
        let answered: store::Result<()> = answered.await;
        if let Err(error) = answered {
            tracing::warn!(%error, "an answer to another process was not stored");
        }
    }

    async fn carry_out(&self, ask: BenchAsk) -> Result<Value> {
        let value = match ask {
            BenchAsk::Weigh { request, key } => {
                serde_json::to_value(self.commit_here(*request, &key).await?)
            }
            BenchAsk::Stop => serde_json::to_value(self.stop_bench().await?),
            BenchAsk::StopWeighing { id } => serde_json::to_value(self.stop_here(&id).await?),
            BenchAsk::Resume(request) => serde_json::to_value(self.resume_bench(request).await?),
            BenchAsk::Clear(request) => serde_json::to_value(self.clear_bench(request).await?),
            BenchAsk::VialReady { id, request } => {
                serde_json::to_value(self.vial_ready(&id, request).await?)
            }
        };
        value.map_err(|error| Error::Internal(error.into()))
    }

    /// Stops a bench, wherever its process runs.
    ///
    /// # Errors
    /// `NotFound`; `Unavailable`: the stop was not heard.
    pub async fn stop_bench_named(&self, name: &str) -> Result<super::BenchStatus> {
        match self.elsewhere(name).await? {
            None => self.stop_bench().await,
            Some(there) => self.ask(&there, BenchAsk::Stop).await.and_then(asks::read),
        }
    }

    /// As [`App::resume_bench`], wherever the bench's process runs.
    ///
    /// # Errors
    /// As [`App::resume_bench`]; `NotFound`; `Unavailable`: it was not heard.
    pub async fn resume_bench_named(
        &self,
        name: &str,
        request: ResumeRequest,
    ) -> Result<super::BenchStatus> {
        match self.elsewhere(name).await? {
            None => self.resume_bench(request).await,
            Some(there) => self.ask(&there, BenchAsk::Resume(request)).await.and_then(asks::read),
        }
    }

    /// As [`App::clear_bench`], wherever the bench's process runs.
    ///
    /// # Errors
    /// As [`App::clear_bench`]; `NotFound`; `Unavailable`: it was not heard.
    pub async fn clear_bench_named(
        &self,
        name: &str,
        request: ClearRequest,
    ) -> Result<super::BenchStatus> {
        match self.elsewhere(name).await? {
            None => self.clear_bench(request).await,
            Some(there) => self.ask(&there, BenchAsk::Clear(request)).await.and_then(asks::read),
        }
    }

    /// Stops a weighing: at once if it is waiting; if it is running, the arm is notified at once,
    /// then the spoon is levelled. `false`: it had ended before, which whoever stops twice or too
    /// late wanted. Not an emergency stop.
    ///
    /// # Errors
    /// `NotFound`; `Unavailable`: it moves on another process's bench, which did not answer.
    pub async fn stop_weighing(&self, id: &str) -> Result<(Weighing, bool)> {
        let stopped = self.stop_here(id).await?;
        let name = stopped.0.at_bench();
        // One that waited has ended by now, wherever it waited.
        if stopped.0.outcome.is_some() || name == self.store().bench_name() {
            return Ok(stopped);
        }
        match self.elsewhere(name).await? {
            Some(there) => {
                let ask = BenchAsk::StopWeighing { id: id.to_owned() };
                self.ask(&there, ask).await.and_then(asks::read)
            }
            None => Ok(stopped),
        }
    }

    /// As [`App::stop_weighing`], as far as this process can.
    pub(super) async fn stop_here(&self, id: &str) -> Result<(Weighing, bool)> {
        if let Some(weighing) = self.halt_weighing(id, None)? {
            return Ok((weighing, true));
        }
        // Lets the task that carries stops go on to the next one: from here on this waits for the
        // disk and the database.
        tokio::task::yield_now().await;
        if let Some(weighing) = self.jobs_or_refuse()?.bench().stop_waiting(id).await? {
            return Ok((weighing, true));
        }
        // It may have started meanwhile.
        if let Some(weighing) = self.halt_weighing(id, None)? {
            return Ok((weighing, true));
        }
        let row =
            self.store().weighing(id).await?.ok_or_else(|| Error::not_found("weighing", id))?;
        // Without an outcome it is at rest, and its end is about to be recorded.
        let ends = row.weighing.outcome.is_none();
        Ok((row.weighing, ends))
    }
}

/// Waits for the next event, but not for long.
async fn wait(heard: &mut watch::Receiver<i64>) {
    let soon = tokio::time::timeout(LOOK, heard.changed());
    if matches!(soon.await, Ok(Err(_))) {
        tokio::time::sleep(LOOK).await;
    }
}

fn unheard(name: &str, is_stop: bool) -> Error {
    let waited = PATIENCE.as_secs();
    Error::Unavailable(match is_stop {
        true => format!(
            "the stop was NOT heard: the process that has bench `{name}` did not answer within {waited} s. Use the wired stop"
        ),
        false => format!(
            "the process that has bench `{name}` did not answer within {waited} s, so nothing was done: see whether it runs (`flip bench list`), and ask again"
        ),
    })
}

impl Reply {
    fn of(done: Result<Value>) -> Self {
        match done {
            Ok(value) => Self::Done(value),
            Err(Error::Invalid(fields)) => Self::Invalid(fields),
            Err(Error::NotFound { what, id }) => Self::NotFound { what: what.to_owned(), id },
            Err(Error::Conflict { code, message }) => {
                Self::Conflict { code: code.to_owned(), message }
            }
            Err(Error::Unprocessable { key, weighing }) => Self::Unprocessable { key, weighing },
            Err(Error::Busy(why)) => Self::Busy(why),
            Err(Error::Internal(error)) => {
                tracing::error!(%error, "what another process asked of the bench failed");
                Self::Unavailable("the process that has the bench failed: its log says why".into())
            }
            Err(error) => Self::Unavailable(error.to_string()),
        }
    }

    fn read(self) -> Result<Value> {
        Err(match self {
            Self::Done(value) => return Ok(value),
            Self::Invalid(fields) => Error::Invalid(fields),
            Self::NotFound { what, id } => {
                let known = ["weighing", "powder", "policy", "simulator", "reservation"];
                let what = known.into_iter().find(|it| *it == what).unwrap_or("bench");
                Error::NotFound { what, id }
            }
            Self::Conflict { code, message } => {
                let code = CODES.into_iter().find(|it| *it == code).unwrap_or("bench_refused");
                Error::Conflict { code, message }
            }
            Self::Unprocessable { key, weighing } => Error::Unprocessable { key, weighing },
            Self::Busy(why) => Error::Busy(why),
            Self::Unavailable(why) => Error::Unavailable(why),
        })
    }
}

/// Conflicts that a bench's owner may answer with.
const CODES: [&str; 15] = [
    "arm_not_recovered",
    "bench_differs",
    "bench_in_use",
    "bench_latched",
    "bench_lost",
    "bench_not_held",
    "bench_not_latched",
    "bench_reserved",
    "calibration_missing",
    "calibration_unfinished",
    "ending_unwritten",
    "not_its_turn",
    "reservation_ended",
    "stopped_meanwhile",
    "vial_differs",
];
