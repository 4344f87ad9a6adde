//! What a command that is interrupted has begun at its server: a dose is stopped, as on the bench of
//! this process; a job goes on.

use super::super::failure::Failure;
use super::{Inner, Request, Server};
use crate::app::{Error, Result, Weighing, WeighingDetail};
use flip_core::domain::weighing::WeighingState;

/// Something begun at the server that has not ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Underway {
    id: String,
    what: What,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum What {
    Job,
    Dose,
    /// A dose of a list, which goes on with the same command.
    Listed,
    /// What a server has not answered to: in place of the id, why.
    Unsure,
}

impl Underway {
    pub(super) fn job(id: &str) -> Self {
        Self { id: id.to_owned(), what: What::Job }
    }

    /// What an error leaves open.
    pub(super) fn unsure(error: &Error) -> Option<Self> {
        let is_open = matches!(error, Error::Unavailable(_));
        is_open.then(|| Self { id: error.to_string(), what: What::Unsure })
    }

    pub(super) fn dose(id: &str) -> Self {
        Self { id: id.to_owned(), what: What::Dose }
    }
}

impl Server {
    /// Begins a list of doses; they have these ids.
    pub(in super::super) async fn doses<T: Send + 'static>(
        &self,
        request: Request,
        read: impl FnOnce(&super::Answer) -> Result<(T, Vec<String>)> + Send + 'static,
    ) -> Result<T> {
        self.begin(request, |answer| {
            let (list, ids) = read(answer)?;
            let listed = |id| Underway { id, what: What::Listed };
            Ok((list, ids.into_iter().map(listed).collect()))
        })
        .await
    }

    /// Notes a dose that this command waits for.
    pub(in super::super) fn awaits(&self, id: &str) {
        let mut underway = self.inner.underway();
        if underway.iter().all(|it| it.id != id) {
            underway.push(Underway::dose(id));
        }
    }

    /// Notes that something has ended.
    pub(in super::super) fn ended(&self, id: &str) {
        self.inner.underway().retain(|it| it.id != id);
    }

    /// Leaves because of a signal: stops the dose that this command asked for, and says what goes
    /// on.
    pub(in super::super) async fn leave(&self, signal: &str) -> Failure {
        let told = self.blocking(|server| Ok(server.leave())).await;
        let told = told.unwrap_or_else(|error| vec![error.to_string()]);
        let told = if told.is_empty() { "nothing was begun".to_owned() } else { told.join("; ") };
        Failure::Failed(anyhow::anyhow!("stopped by {signal}: {told}"))
    }
}

impl Inner {
    fn leave(&self) -> Vec<String> {
        // Waits for what is just being begun.
        let underway = self.underway().clone();
        let mut told = Vec::new();
        for it in &underway {
            let (sentence, is_enough) = match it.what {
                What::Job => (self.goes_on(&it.id), false),
                What::Unsure => (it.id.clone(), false),
                What::Dose | What::Listed => self.stop(it),
            };
            told.push(sentence);
            if is_enough {
                break;
            }
        }
        told
    }

    fn goes_on(&self, job: &str) -> String {
        let url = &self.address;
        format!(
            "job {job} goes on at {url}; `flip jobs --server {url}` shows it, and the same command again waits for it"
        )
    }

    /// Stops a dose. `true`: no later dose of its list begins by itself.
    fn stop(&self, dose: &Underway) -> (String, bool) {
        let id = &dose.id;
        if dose.what == What::Listed && self.waits_for_its_vial(id) {
            return (format!("weighing {id} waits for its vial at {}", self.address), true);
        }
        let stopped = Request::post(&["weighings", id, "stop"], &serde_json::json!({}))
            .and_then(|request| self.send(&request.repeatable())?.json::<Weighing>());
        match stopped {
            Ok(weighing) if weighing.state == WeighingState::Done => (
                format!("weighing {id} had ended before: `flip bench status` shows the bench"),
                true,
            ),
            Ok(weighing) if weighing.started_at.is_some() => {
                let advice =
                    "the bench is held until someone has looked and resumes (`flip bench resume`)";
                (format!("weighing {id} is stopped at {}; {advice}", self.address), true)
            }
            Ok(_) => (format!("weighing {id} had not begun, and will not"), false),
            Err(error) => {
                let advice = "stop it on the page, or at the bench itself";
                (format!("weighing {id} could NOT be stopped: {error}: {advice}"), false)
            }
        }
    }

    fn waits_for_its_vial(&self, id: &str) -> bool {
        let found = self.send(&Request::get(&["weighings", id]));
        let found = found.and_then(|answer| answer.json::<WeighingDetail>());
        found.is_ok_and(|it| it.weighing.state == WeighingState::AwaitingVial)
    }
}
