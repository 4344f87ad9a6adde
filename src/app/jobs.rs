//! Jobs of every kind.

use super::{App, Error, Result};
use crate::jobs::JobSpec;
use flip_core::domain::job::{JobKind, JobState};
use flip_store as store;
use flip_store::jobs::{Job, JobRow};
use flip_store::page::{LIST_LIMIT_MAX, Page, PageQuery};
use serde::de::DeserializeOwned;

impl App {
    /// Jobs, newest first; optionally of one kind or state.
    pub async fn jobs(
        &self,
        kind: Option<JobKind>,
        state: Option<JobState>,
        page: PageQuery,
    ) -> Result<Page<Job>> {
        Ok(self.store().jobs(kind, state, page.window(LIST_LIMIT_MAX)?).await?)
    }

    /// One job.
    pub async fn job(&self, id: &str) -> Result<Job> {
        let row = self.store().job(id).await?.ok_or_else(|| Error::not_found("job", id))?;
        Ok(row.job)
    }

    /// Cancels a job: at once if it is waiting, at its next step if it is running. `Conflict` if it
    /// has ended.
    pub async fn cancel_job(&self, id: &str) -> Result<Job> {
        if let Some(job) = self.jobs_or_refuse()?.cancel(id).await? {
            return Ok(job);
        }
        let job = self.job(id).await?;
        let advice =
            format!("job {id} has ended ({}): there is nothing to cancel", word(job.state));
        Err(Error::conflict("job_finished", advice))
    }

    /// Jobs of one kind, newest first, each converted to its resource.
    pub(super) async fn jobs_as<T>(
        &self,
        kind: JobKind,
        page: PageQuery,
        item: impl Fn(JobRow) -> Result<T>,
    ) -> Result<Page<T>> {
        let rows = self.store().whole_jobs(kind, page.window(LIST_LIMIT_MAX)?).await?;
        let items: Result<Vec<T>> = rows.items.into_iter().map(item).collect();
        Ok(Page { items: items?, next: rows.next })
    }
}

/// Parses a stored JSON document.
pub(super) fn stored<T: DeserializeOwned>(text: &str) -> Result<T> {
    serde_json::from_str(text).map_err(|error| Error::Internal(error.into()))
}

/// What a job was asked for.
pub(super) fn specification(row: &JobRow) -> Result<JobSpec> {
    JobSpec::read(&row.spec).map_err(|error| Error::Internal(error.into()))
}

/// The error for invalid stored data.
pub(super) fn corrupt(what: &str) -> Error {
    store::Error::Corrupt(format!("{what} is of another kind")).into()
}

fn word(state: JobState) -> &'static str {
    match state {
        JobState::Queued => "queued",
        JobState::Running => "running",
        JobState::Succeeded => "succeeded",
        JobState::Failed => "failed",
        JobState::Cancelled => "cancelled",
    }
}
