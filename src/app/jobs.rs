//! Jobs of every kind.

use super::{App, Result};
use crate::domain::job::{JobKind, JobState};
use crate::store::jobs::Job;
use crate::store::page::{Page, PageQuery};

impl App {
    /// Jobs, newest first; of one kind or state when named.
    pub async fn jobs(&self, _kind: Option<JobKind>, _state: Option<JobState>, _page: PageQuery) -> Result<Page<Job>> {
        self.stub()
    }

    /// One job.
    pub async fn job(&self, _id: &str) -> Result<Job> {
        self.stub()
    }

    /// Ask a job to end: at once when it waits, at its next step when it runs. `Conflict` when it has ended.
    pub async fn cancel_job(&self, _id: &str) -> Result<Job> {
        self.stub()
    }
}
