//! Angles of repose by camera: measurements on the bench, the frames they wait for, and the
//! comparison of automated with manual measurements.

use super::caller_labels::written;
use super::check::Check;
use super::jobs::{corrupt, specification, stored};
use super::trainings::without_sets;
use super::vials::refused;
use super::weighings::latched;
use super::{App, Error, Result};
use crate::jobs::repose::ReposeResult;
use crate::jobs::{JobSpec, ReposeSpec};
use flip_bench::hardware::camera::Upload;
use flip_bench::hardware::stand::Procedure;
use flip_bench::pile::{Compared, Dimensions, Limits, Stored, compare};
use flip_bench::rig::{Awaited, PileStand};
use flip_core::domain::FieldError;
use flip_core::domain::bench::BenchKind;
use flip_core::domain::job::JobKind;
use flip_core::domain::labels::Labels;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::powder::Flowability;
use flip_store::jobs::{Job, JobRow};
use flip_store::page::{LIST_LIMIT_MAX, Page, PageQuery};
use flip_store::piles::Pile;
use serde::{Deserialize, Serialize};
use tokio::sync::Semaphore;

/// Maximum number of camera measurements per powder.
const RUNS_MAX: u32 = 1_000_000;
/// Number of frames decoded at once: one of a few kB may decompress to 28 MB.
static DECODERS: Semaphore = Semaphore::const_new(2);

/// A measurement by camera to make. Everything but the powder has a default.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReposeRequest {
    /// Powder id.
    pub powder: String,
    /// Which measurement of this powder, from 1; repeating a number returns the existing
    /// measurement and makes no new piles. Default the next.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub run: Option<u32>,
    /// How piles are made and imaged.
    #[serde(default)]
    pub procedure: Procedure,
    /// The rig, as measured with a ruler or calipers.
    #[serde(default)]
    pub rig: Dimensions,
    /// What frames must show.
    #[serde(default)]
    pub limits: Limits,
    /// The bench reservation under which the request is made, `rs-…`, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reservation: Option<String>,
    /// What the caller writes on it, to find it again.
    #[serde(default, skip_serializing_if = "Labels::is_empty")]
    pub labels: Labels,
}

/// A measurement by camera: its job, its piles, and the angle once it has succeeded.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ReposeMeasurement {
    /// The job; the measurement has the same id.
    pub job: Job,
    /// Powder id.
    pub powder: String,
    /// Which measurement of this powder.
    pub run: u32,
    /// The bench that makes the piles.
    pub bench: BenchKind,
    /// How piles are made and imaged.
    pub procedure: Procedure,
    /// The rig.
    pub rig: Dimensions,
    /// What frames must show.
    pub limits: Limits,
    /// The pile waiting for frames now.
    pub awaits: Option<Awaited>,
    /// Piles so far, including those without an angle; left out of lists.
    pub piles: Vec<Pile>,
    /// Result; absent until it has succeeded.
    pub result: Option<ReposeResult>,
}

impl App {
    /// Queues a measurement by camera. `false`: the same one was requested before, and this is its
    /// job.
    ///
    /// # Errors
    /// `Invalid`; `Conflict` (`no_stand`, `bench_latched`, `bench_held`, `bench_reserved`,
    /// `calibration_missing`).
    pub async fn start_repose(&self, request: ReposeRequest) -> Result<(Job, bool)> {
        let within = |part: &'static str| {
            move |error: FieldError| {
                FieldError::new(format!("{part}.{}", error.field), error.message)
            }
        };
        let mut check = Check::default();
        let procedure = check.keep(request.procedure.checked().map_err(within("procedure")));
        check.keep(request.rig.checked().map_err(within("rig")));
        let limits = check.keep(request.limits.checked().map_err(within("limits")));
        if let Some(run) = request.run {
            check.count("run", run, 1, RUNS_MAX);
        }
        if let (Some(procedure), Some(limits)) = (procedure, limits)
            && procedure.frames < limits.frames_min
        {
            let advice = format!(
                "must be at least `limits.frames_min`, {}, got {}",
                limits.frames_min, procedure.frames
            );
            check.refuse("procedure.frames", advice);
        }
        check.done()?;
        let powder = self.powder_of("powder", &request.powder).await?.id;
        let jobs = self.jobs_or_refuse()?;
        let bench = jobs.bench().kind();
        self.bench_may_pile(request.reservation.as_deref())?;
        let set = match bench {
            BenchKind::Devices => None,
            _ => Some(self.emulated_powder(&powder).await?),
        };
        let run = match request.run {
            Some(run) => run,
            None => self.store().repose_runs(&powder).await? + 1,
        };
        let ReposeRequest { procedure, rig, limits, reservation, labels, .. } = request;
        let labels = written(labels)?;
        let spec = ReposeSpec { powder, run, procedure, rig, limits, bench, set };
        let (spec, reservation) = (JobSpec::Repose(spec), reservation.as_deref());
        let queued = jobs.enqueue_on_bench(&spec, reservation, (None, &labels)).await?;
        queued.map_err(refused)
    }

    /// Queues the measurement of a job that failed or was cancelled, if the bench may make piles.
    pub(super) async fn repose_again(&self, spec: &JobSpec, before: &Job) -> Result<(Job, bool)> {
        self.bench_may_pile(None)?;
        let of = (Some(before.id.as_str()), &before.labels);
        let queued = self.jobs_or_refuse()?.enqueue_on_bench(spec, None, of).await?;
        queued.map_err(refused)
    }

    /// Refuses if the bench has no stand, or is latched, held or reserved.
    fn bench_may_pile(&self, reservation: Option<&str>) -> Result<()> {
        let jobs = self.jobs_or_refuse()?;
        if jobs.bench().stand().is_none() {
            let advice = "the simulated bench has no gate and no camera: start FLIP with `--bench emulated` or with a bench file";
            return Err(Error::conflict("no_stand", advice));
        }
        self.check_reservation(reservation)?;
        let standing = jobs.bench().standing();
        if let Some(latch) = standing.latch {
            return Err(latched(&latch));
        }
        if let Some(held) = standing.held {
            let advice = format!(
                "the bench is held since {}: {}. Resume it first (page, `flip bench resume`, POST /v1/bench/resume)",
                held.at, held.reason
            );
            return Err(Error::conflict("bench_held", advice));
        }
        Ok(())
    }

    /// What represents a powder on an emulated bench: one of its calibrated sets, chosen by
    /// content, so that it is the same in every data folder that has them.
    async fn emulated_powder(&self, powder: &str) -> Result<ParameterSet> {
        let every = PageQuery::first(LIST_LIMIT_MAX).window(LIST_LIMIT_MAX)?;
        let sets = self.store().sets_under(powder, None, every).await?.items;
        let set = sets.into_iter().min_by(|a, b| a.id.cmp(&b.id)).map(|set| set.parameters);
        set.ok_or_else(|| {
            let advice = format!(
                "an emulated bench piles simulated powder, and {}",
                without_sets(powder, None)
            );
            Error::conflict("calibration_missing", advice)
        })
    }

    /// One measurement by camera, with its piles.
    pub async fn repose(&self, id: &str) -> Result<ReposeMeasurement> {
        let row = self.store().job(id).await?.filter(|row| row.job.kind == JobKind::Repose);
        let mut found = repose(
            self.placed(row.ok_or_else(|| Error::not_found("repose measurement", id))?).await?,
        )?;
        found.piles = self.store().piles(id).await?;
        found.awaits =
            self.inner.jobs.as_ref().and_then(|jobs| jobs.bench().stand()?.inbox()?.awaits(id));
        Ok(found)
    }

    /// Measurements by camera, newest first, without their piles.
    pub async fn reposes(&self, page: PageQuery) -> Result<Page<ReposeMeasurement>> {
        self.jobs_as(JobKind::Repose, page, repose).await
    }

    /// The pile of this measurement that is still waiting for frames: checked before a frame is
    /// decoded, which costs a hundred times its bytes.
    ///
    /// # Errors
    /// `NotFound`; `Conflict` (`no_pile_waits`).
    pub async fn frames_awaited(&self, id: &str) -> Result<Awaited> {
        let awaited = self.repose(id).await?.awaits.filter(|it| it.have < it.wanted);
        awaited.ok_or_else(no_pile_waits)
    }

    /// Adds a frame to the pile that waits for frames; returns how many it has now.
    ///
    /// # Errors
    /// `Invalid`: the frame cannot be read; `Conflict` (`no_pile_waits`).
    pub async fn add_frame(&self, id: &str, frame: Upload) -> Result<Awaited> {
        let jobs = self.jobs_or_refuse()?;
        self.frames_awaited(id).await?;
        let _decoder = DECODERS.acquire().await.map_err(|error| Error::Internal(error.into()))?;
        // Decoding errors are reported to the uploader while the pile is still there.
        let decoding = frame.clone();
        let decoded = tokio::task::spawn_blocking(move || decoding.decode().map(drop)).await;
        decoded.map_err(|error| Error::Internal(error.into()))??;
        let inbox = jobs.bench().stand().and_then(PileStand::inbox);
        inbox.and_then(|inbox| inbox.add(id, frame)).ok_or_else(no_pile_waits)
    }

    /// A part of a raw frame as received: `depth`, `colour` or `description`; piles and frames
    /// count from 1.
    ///
    /// # Errors
    /// `NotFound`
    pub async fn raw_frame(&self, id: &str, pile: u32, frame: u32, part: &str) -> Result<Vec<u8>> {
        let found = self.repose(id).await?;
        let pile = found.piles.iter().find(|it| it.number == pile);
        let files = pile.and_then(|pile| pile.frames.get((frame as usize).checked_sub(1)?));
        let sha256 = files
            .and_then(|files| files.part(part))
            .ok_or_else(|| Error::not_found("raw frame", part))?;
        self.store()
            .artifacts()
            .get(sha256)
            .await
            .map_err(|error| Error::of_part("this raw frame", error))
    }

    /// Compares automated with manual measurements, for every powder measured both ways; the newest
    /// measurement by each method counts.
    ///
    /// # Errors
    /// `Internal`
    pub async fn compare_methods(&self) -> Result<Vec<Compared>> {
        let measurements = self.store().all_measurements(None).await?;
        let stored: std::result::Result<Vec<Stored>, FieldError> = measurements
            .into_iter()
            .map(|it| {
                let flowability = Flowability::new(it.repose_deg, it.sd_deg, it.n)?;
                Ok(Stored { powder: it.powder, method: it.method, flowability })
            })
            .collect();
        Ok(compare(&stored.map_err(|error| Error::Internal(error.into()))?))
    }
}

fn no_pile_waits() -> Error {
    let advice = "no pile of this measurement is waiting for frames: `awaits` says when one is";
    Error::conflict("no_pile_waits", advice)
}

fn repose(row: JobRow) -> Result<ReposeMeasurement> {
    let JobSpec::Repose(spec) = specification(&row)? else {
        return Err(corrupt("a measurement's specification"));
    };
    let ReposeSpec { powder, run, procedure, rig, limits, bench, .. } = spec;
    Ok(ReposeMeasurement {
        job: row.job,
        powder,
        run,
        bench,
        procedure,
        rig,
        limits,
        awaits: None,
        piles: Vec::new(),
        result: row.result.as_deref().map(stored).transpose()?,
    })
}
