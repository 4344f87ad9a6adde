//! Jobs of every kind.

use super::caller_labels::written;
use super::{App, Error, Result};
use crate::jobs::{JobSpec, lane_of, simulator_on};
use flip_core::domain::FieldError;
use flip_core::domain::device::Device;
use flip_core::domain::job::{JobKind, JobState};
use flip_core::domain::labels::Labels;
use flip_store as store;
use flip_store::jobs::{Job, JobRow, JobsWanted, Waiting};
use flip_store::page::{LIST_LIMIT_MAX, Page, PageQuery};
use serde::de::DeserializeOwned;

impl App {
    /// Jobs that match, newest first.
    pub async fn jobs(&self, wanted: JobsWanted, page: PageQuery) -> Result<Page<Job>> {
        let mut found = self.store().jobs(&wanted, page.window(LIST_LIMIT_MAX)?).await?;
        self.place(found.items.iter_mut().collect()).await?;
        Ok(found)
    }

    /// One job.
    pub async fn job(&self, id: &str) -> Result<Job> {
        let row = self.store().job(id).await?.ok_or_else(|| Error::not_found("job", id))?;
        Ok(self.placed(row).await?.job)
    }

    /// Starts a failed or cancelled job again: the same inputs, a new job that names the old one. On
    /// the processor, if that is asked for: a training whose card failed goes on from its checkpoint.
    /// `false`: an equal job was requested meanwhile, and this is it.
    ///
    /// # Errors
    /// `Invalid`, `device`: a card that was not its device, or that nobody has;
    /// `Conflict`: `job_not_over` if it has not ended that way, `simulator_changed`; those of the
    /// bench for a measurement by camera.
    pub async fn start_again(&self, id: &str, device: Option<Device>) -> Result<(Job, bool)> {
        let jobs = self.jobs_or_refuse()?;
        let row = self.store().job(id).await?.ok_or_else(|| Error::not_found("job", id))?;
        if !matches!(row.job.state, JobState::Failed | JobState::Cancelled) {
            let advice = match row.job.state {
                JobState::Succeeded => format!(
                    "job {id} has succeeded, and the same inputs give the same result: change an input and request it anew"
                ),
                state => format!("job {id} is {}: cancel it first", word(state)),
            };
            return Err(Error::conflict("job_not_over", advice));
        }
        let spec = specification(&row)?;
        let present = simulator_on(spec.device());
        if let Some(old) = spec.simulator().filter(|old| *old != present) {
            let advice = format!(
                "job {id} is of simulator {old}, and this is {present}: request it anew, with the same settings"
            );
            return Err(Error::conflict("simulator_changed", advice));
        }
        let spec = match device {
            None => spec,
            Some(Device::Cpu) => spec.on_cpu(self.store().checkpoint_of(id).await?),
            Some(device) if device == spec.device() => spec,
            Some(_) => {
                let advice = format!("job {id} was for the processor: request it anew with `cuda`");
                return Err(FieldError::new("device", advice).into());
            }
        };
        self.check_device(spec.kind(), spec.device()).await?;
        match spec {
            JobSpec::Repose(_) => self.repose_again(&spec, &row.job).await,
            _ => Ok(jobs.enqueue_again(&spec, &row.job).await?),
        }
    }

    /// Queues a job that a caller asks for. `false`: the same one was requested before, and this is
    /// it.
    pub(super) async fn queue(&self, spec: JobSpec, labels: Labels) -> Result<(Job, bool)> {
        let labels = written(labels)?;
        Ok(self.jobs_or_refuse()?.enqueue(&spec, &labels).await?)
    }

    /// The row of a job, with its place in the queue.
    pub(super) async fn placed(&self, mut row: JobRow) -> Result<JobRow> {
        self.place(vec![&mut row.job]).await?;
        Ok(row)
    }

    /// Notes which place those that wait have among the jobs of their lane, and how long jobs like
    /// them took.
    async fn place(&self, mut jobs: Vec<&mut Job>) -> Result<()> {
        jobs.retain(|job| job.state == JobState::Queued);
        if jobs.is_empty() {
            return Ok(());
        }
        let around = [&jobs[0].id, &jobs[jobs.len() - 1].id].map(String::as_str);
        let Waiting { before, jobs: queue } = self.store().waiting_jobs(around).await?;
        let times = self.job_times().await?;
        for job in jobs {
            // It may have begun meanwhile.
            let Some(at) = queue.iter().position(|(id, _)| *id == job.id) else { continue };
            let lane = lane_of(job.kind);
            let near = queue[..at].iter().filter(|(_, it)| lane_of(it.kind) == lane).count() as u64;
            let far = before.iter().filter(|(kind, _)| lane_of(*kind) == lane);
            let ahead = near + far.map(|(_, many)| many).sum::<u64>();
            job.place = u32::try_from(ahead + 1).ok();
            let sort = &queue[at].1;
            job.expected_s = times.iter().find(|it| it.sort == *sort).map(|it| it.median_s);
        }
        Ok(())
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
        let mut rows = self.store().whole_jobs(kind, page.window(LIST_LIMIT_MAX)?).await?;
        self.place(rows.items.iter_mut().map(|row| &mut row.job).collect()).await?;
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
