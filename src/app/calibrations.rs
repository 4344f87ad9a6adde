//! Calibrations: from a flowability to parameter sets.

use super::jobs::{corrupt, stored};
use super::{App, Error, Result};
use crate::domain::FieldError;
use crate::domain::job::JobKind;
use crate::domain::powder::Flowability;
use crate::jobs::calibrate::{CalibrationResult, Settings};
use crate::jobs::{CalibrationSpec, JobSpec, SIMULATOR};
use crate::store::jobs::{Job, JobRow};
use crate::store::page::{Page, PageQuery, SERIES_LIMIT_MAX};
use crate::store::trials::Trial;
use serde::{Deserialize, Serialize};

/// What to calibrate: a powder, or a bare angle of repose. Everything else has a default.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CalibrationRequest {
    /// Powder id; its newest automated measurement (else manual) is the target.
    pub powder: Option<String>,
    /// Target angle of repose instead of a powder, degrees.
    pub repose_deg: Option<f64>,
    /// Parameter sets to find, 1 to 100; default 10.
    pub sets: Option<u32>,
    /// Accepted difference between simulated and measured angle, 0.1 to 10 degrees; default 1.5.
    pub tolerance_deg: Option<f64>,
    /// Grains in a simulated heap, 100 to 100000; default 2000.
    pub particles: Option<u32>,
    /// Most simulations, search and verification together, 1 to 500; default 150.
    pub trials_max: Option<u32>,
    /// Seed; default 1.
    pub seed: Option<u64>,
}

/// A calibration: its job, what it aims at, and once it has succeeded what it found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Calibration {
    /// The job; the calibration has the same id.
    pub job: Job,
    /// Powder id; absent for a bare angle.
    pub powder: Option<String>,
    /// What it aims at.
    pub target: Flowability,
    /// Every setting of the search and of the heap experiment.
    #[schema(value_type = Object)]
    pub settings: serde_json::Value,
    /// What it found; absent until it has succeeded.
    pub result: Option<CalibrationResult>,
}

impl App {
    /// Queue a calibration. `false`: the same one was asked for before, and this is its job.
    ///
    /// # Errors
    /// `Invalid`; `Conflict` (`measurement_missing`) for a powder that nobody has measured.
    pub async fn start_calibration(&self, request: CalibrationRequest) -> Result<(Job, bool)> {
        let (powder, target) = self.target_of(&request).await?;
        let defaults = Settings::default();
        let settings = Settings {
            sets: request.sets.unwrap_or(defaults.sets),
            tolerance_deg: request.tolerance_deg.unwrap_or(defaults.tolerance_deg),
            particles: request.particles.unwrap_or(defaults.particles),
            trials_max: request.trials_max.unwrap_or(defaults.trials_max),
            seed: request.seed.unwrap_or(defaults.seed),
            ..defaults
        };
        let spec = CalibrationSpec { powder, target, settings: settings.checked()?, simulator: SIMULATOR.to_owned() };
        Ok(self.jobs_or_refuse()?.enqueue(&JobSpec::Calibration(spec)).await?)
    }

    /// What to aim at: a powder's measurement, or a bare angle.
    async fn target_of(&self, request: &CalibrationRequest) -> Result<(Option<String>, Flowability)> {
        let only_one = "name a powder, or a `repose_deg` to aim at without one, and not both";
        match (&request.powder, request.repose_deg) {
            (Some(id), None) => {
                let powder = self.powder_of("powder", id).await?;
                let target = powder.flowability.ok_or_else(|| {
                    let advice = format!("`{id}` has no measurement: POST /v1/powders/{id}/measurements adds one");
                    Error::conflict("measurement_missing", advice)
                })?;
                Ok((Some(powder.id), target))
            }
            (None, Some(repose_deg)) => Ok((None, Flowability::new(repose_deg, 0.0, 1)?)),
            _ => Err(FieldError::new("powder", only_one).into()),
        }
    }

    /// One calibration.
    pub async fn calibration(&self, id: &str) -> Result<Calibration> {
        let row = self.store().job(id).await?.filter(|row| row.job.kind == JobKind::Calibration);
        calibration(row.ok_or_else(|| Error::not_found("calibration", id))?)
    }

    /// Calibrations, newest first.
    pub async fn calibrations(&self, page: PageQuery) -> Result<Page<Calibration>> {
        self.jobs_as(JobKind::Calibration, page, calibration).await
    }

    /// Trials of a calibration in order; pages of up to 5000.
    pub async fn trials(&self, calibration: &str, page: PageQuery) -> Result<Page<Trial>> {
        self.calibration(calibration).await?;
        Ok(self.store().trials(calibration, page.window(SERIES_LIMIT_MAX)?).await?)
    }
}

fn calibration(row: JobRow) -> Result<Calibration> {
    let JobSpec::Calibration(spec) = stored(&row.spec)? else { return Err(corrupt("a calibration's specification")) };
    Ok(Calibration {
        job: row.job,
        powder: spec.powder,
        target: spec.target,
        settings: serde_json::to_value(spec.settings).map_err(|error| Error::Internal(error.into()))?,
        result: row.result.as_deref().map(stored).transpose()?,
    })
}
