//! Calibrations: from a flowability to parameter sets.

use super::jobs::{corrupt, specification, stored};
use super::judged_shakes::StoredShakes;
use super::steepness::Steepness;
use super::trainings::without_sets;
use super::{App, Error, Result};
use crate::jobs::calibrate::{CalibrationResult, Design, Method, Posterior, Settings};
use crate::jobs::{CalibrationSpec, JobSpec, can_pour, simulator_on};
use flip_core::card::cells::cells;
use flip_core::domain::FieldError;
use flip_core::domain::conditions::{Conditions, Patch, Under};
use flip_core::domain::device::Device;
use flip_core::domain::job::JobKind;
use flip_core::domain::labels::Labels;
use flip_core::domain::observable::Observation;
use flip_core::domain::powder::Flowability;
use flip_discover::Extended;
use flip_store::jobs::{Job, JobRow};
use flip_store::page::{Page, PageQuery, SERIES_LIMIT_MAX};
use flip_store::trials::Trial;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// What to calibrate: a powder, or a bare angle of repose. Everything else has a default.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CalibrationRequest {
    /// Powder id; its newest automated measurement (else manual) is the target.
    pub powder: Option<String>,
    /// Target angle of repose instead of a powder, degrees.
    pub repose_deg: Option<f64>,
    /// Standard deviation of the repeats behind `repose_deg`, 0 to 45 degrees; default 0, an exact
    /// target.
    pub sd_deg: Option<f64>,
    /// Repeats behind `repose_deg`, 1 to 10000; default 1.
    pub n: Option<u32>,
    /// How to search for sets; default `emulator`.
    pub method: Option<Method>,
    /// Parameter sets to find, 1 to 100; default 10.
    pub sets: Option<u32>,
    /// Accepted difference between simulated and measured angle, 0.1 to 10 degrees; default 0.5,
    /// with the other methods 1.5.
    pub tolerance_deg: Option<f64>,
    /// Grains per simulated heap, 100 to 100000; default 2000.
    pub particles: Option<u32>,
    /// Maximum simulations, search and verification together, 1 to 20000; default three times what
    /// verifying all sets takes, with the other methods
    /// 150. For the published method, which verifies afterwards, it limits the search alone.
    pub trials_max: Option<u32>,
    /// Heaps simulated to verify each set, 1 to 50; default 8, with the method `sequential` 2.
    pub verify_repeats: Option<u32>,
    /// Readings per verification heap, 1 to 64; default 4, with the method `sequential` 1.
    pub readings: Option<u32>,
    /// Seed; default 1.
    pub seed: Option<u64>,
    /// Other measurements, up to 8 observations, for the method `emulator`; default those
    /// registered for the powder.
    pub observations: Option<Vec<Observation>>,
    /// Stored shakes of the powder, in place of observations: angle and spoon are met together, and
    /// gravity is held at 1 unless `fixed` says otherwise. Default none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shakes: Option<StoredShakes>,
    /// Grains per verification heap, 100 to 100000; default as many as in the other heaps. Not for
    /// the method `sequential`.
    pub verify_particles: Option<u32>,
    /// Parameters held at a value instead of searched, by key, as `{"gravity_scale": 1}`; default
    /// none: all nine are searched.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub fixed: BTreeMap<String, f64>,
    /// Extended simulator version, `sv-…`; default the base.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub simulator: Option<String>,
    /// Conditions under which the target was measured, as `{"relative_humidity_pct": 55}`; the
    /// target is converted to the version's reference. Default: the angle that the version predicts
    /// there, for a powder of its campaign.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub conditions: Conditions,
    /// What simulates the heaps: the processor, or a graphics card of this process or of a worker,
    /// which has room for 2560 grains. A card's heaps have the statistics of the processor's and other
    /// bytes. Other measurements are simulated on the processor alone.
    #[serde(default, skip_serializing_if = "Device::is_cpu")]
    pub device: Device,
    /// What the caller writes on it, to find it again.
    #[serde(default, skip_serializing_if = "Labels::is_empty")]
    pub labels: Labels,
}

/// Maximum number of observations per calibration.
const OBSERVATIONS_MAX: usize = 8;

/// A calibration: its job, its target, and its result once it has succeeded.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// The job; the calibration has the same id.
    pub job: Job,
    /// Powder id; absent for a bare angle.
    pub powder: Option<String>,
    /// Target.
    pub target: Flowability,
    /// The extended simulator version and the conditions given; absent for the base.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub under: Option<Under>,
    /// Other measurements.
    pub observations: Vec<Observation>,
    /// What it simulates on; absent for the processor.
    #[serde(default, skip_serializing_if = "Device::is_cpu")]
    pub device: Device,
    /// Every setting of the search and of the heap experiment.
    pub settings: serde_json::Value,
    /// Result; absent until it has succeeded.
    pub result: Option<CalibrationResult>,
    /// Whether the simulated heaps are as steep as the measured one; absent without sets.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub steepness: Option<Steepness>,
}

impl App {
    /// Queues a calibration. `false`: the same one was requested before, and this is its job.
    ///
    /// # Errors
    /// `Invalid`; `Conflict` (`measurement_missing`) for a powder without measurements.
    pub async fn start_calibration(&self, request: CalibrationRequest) -> Result<(Job, bool)> {
        let (powder, target) = self.target_of(&request).await?;
        let extended = self.extended(request.simulator.as_deref(), &request.conditions).await?;
        let target = match &extended {
            Some((under, extended)) => at_reference(target, powder.as_deref(), under, extended)?,
            None => target,
        };
        let defaults = Settings::of(request.method.unwrap_or(Method::Emulator));
        let particles = request.particles.unwrap_or(defaults.particles);
        let mut fixed = request.fixed.clone();
        if request.shakes.is_some() {
            // No bench has another: a spoon that shows too much or too little would find one.
            fixed.entry("gravity_scale".to_owned()).or_insert(1.0);
        }
        let settings = Settings {
            sets: request.sets.unwrap_or(defaults.sets),
            tolerance_deg: request.tolerance_deg.unwrap_or(defaults.tolerance_deg),
            particles,
            // The same number as in the other heaps means the same as none.
            verify_particles: request.verify_particles.filter(|count| *count != particles),
            verify_repeats: request.verify_repeats.unwrap_or(defaults.verify_repeats),
            readings: request.readings.unwrap_or(defaults.readings),
            seed: request.seed.unwrap_or(defaults.seed),
            fixed,
            ..defaults
        };
        let trials_max = request.trials_max.unwrap_or_else(|| settings.budget());
        let settings = Settings { trials_max, ..settings }.checked()?;
        can_pour(request.device, &settings)?;
        self.check_device(JobKind::Calibration, request.device).await?;
        let design = (settings.method == Method::Emulator)
            .then(|| Design::with_particles(settings.particles));
        let observations = match &request.shakes {
            None => self.observations_of(&request, settings.method).await?,
            Some(shakes) => {
                self.cells_of(&request, shakes, powder.as_deref(), settings.method).await?
            }
        };
        if !request.device.is_cpu() && !observations.is_empty() {
            let advice = "`cuda` cannot compute other measurements: leave the field out to compute on the CPU, or calibrate to the angle alone with `observations` empty";
            return Err(FieldError::new("device", advice).into());
        }
        // A version of spoons holds under all conditions, so a spoon is observed with it.
        let of_spoon = extended.as_ref().filter(|(_, extended)| extended.through().is_empty());
        let patch = of_spoon.map(|(_, it)| it.at(powder.as_deref(), &Conditions::new()));
        let patch = patch.transpose().map_err(Error::Invalid)?.unwrap_or_default();
        let patch = if observations.is_empty() { Patch::default() } else { patch };
        let under = extended.map(|it| it.0);
        let spec = CalibrationSpec {
            powder,
            target,
            observations,
            patch,
            settings,
            design,
            under,
            device: Device::Cpu,
            simulator: simulator_on(Device::Cpu),
        };
        self.queue(JobSpec::Calibration(spec.on(request.device)), request.labels).await
    }

    /// The stored shakes of the powder as observations.
    async fn cells_of(
        &self,
        request: &CalibrationRequest,
        shakes: &StoredShakes,
        powder: Option<&str>,
        method: Method,
    ) -> Result<Vec<Observation>> {
        let refuse = |message: String| Err(FieldError::new("shakes", message).into());
        if method != Method::Emulator {
            return refuse("are for the method `emulator`: choose it, or leave them out".into());
        }
        if request.observations.is_some() {
            return refuse("stand in place of observations: leave one of the two out".into());
        }
        let Some(powder) = powder.filter(|_| shakes.powder.is_none()) else {
            return refuse("are those of the calibration's powder: name it with `powder`".into());
        };
        let of_powder = StoredShakes { powder: Some(powder.to_owned()), ..shakes.clone() };
        let spoonfuls = self.stored_spoonfuls(&of_powder).await?;
        let cells = cells(&spoonfuls);
        if cells.is_empty() {
            return refuse(format!(
                "of {powder} are too few: {} spoonfuls, and no pitch up to 50 deg with three shakes of a nearly full spoon; weigh more, or leave them out",
                spoonfuls.len()
            ));
        }
        Ok(cells)
    }

    /// The refusal to weigh a powder without sets; it says if a calibration that may find some is
    /// under way.
    pub(super) async fn uncalibrated(
        &self,
        powder: &str,
        simulator: Option<&str>,
    ) -> Result<Error> {
        let under_way = self.store().calibration_under_way(powder, simulator).await?;
        let advice = match under_way {
            Some(id) => format!(
                "`{powder}` has no parameter set yet: its calibration `{id}` is under way; weigh when it has succeeded"
            ),
            None => format!(
                "{} or POST /v1/calibrations, and weigh when it has succeeded",
                without_sets(powder, simulator)
            ),
        };
        Ok(Error::conflict("calibration_missing", advice))
    }

    /// Other measurements: those of the request, else those registered.
    async fn observations_of(
        &self,
        request: &CalibrationRequest,
        method: Method,
    ) -> Result<Vec<Observation>> {
        let refuse = |message: &str| Err(FieldError::new("observations", message).into());
        let registered = match (&request.observations, &request.powder) {
            (None, Some(powder)) if method == Method::Emulator => {
                self.store().observations_now(powder).await?
            }
            _ => Vec::new(),
        };
        let given = request.observations.as_ref().unwrap_or(&registered);
        if method != Method::Emulator && !given.is_empty() {
            return refuse("are for the method `emulator`: leave them out, or choose that method");
        }
        if given.len() > OBSERVATIONS_MAX {
            return refuse("must be at most 8, since each costs minutes: name those that matter");
        }
        let checked = given.iter().enumerate().map(|(k, observation)| {
            observation.checked().map_err(|error| {
                FieldError::new(format!("observations[{k}].{}", error.field), error.message)
            })
        });
        Ok(checked.collect::<std::result::Result<_, _>>()?)
    }

    /// The target: a powder's measurement, or a bare angle.
    async fn target_of(
        &self,
        request: &CalibrationRequest,
    ) -> Result<(Option<String>, Flowability)> {
        let only_one = "give either a powder, or a `repose_deg` to aim at without one";
        let stray = request.sd_deg.map(|_| "sd_deg").or(request.n.map(|_| "n"));
        match (&request.powder, request.repose_deg) {
            (Some(_), None) if stray.is_some() => {
                let advice = "belongs to a bare `repose_deg`; a powder's measurement has its own";
                Err(FieldError::new(stray.unwrap_or_default(), advice).into())
            }
            (Some(id), None) => {
                let powder = self.powder_of("powder", id).await?;
                let target = powder.flowability.ok_or_else(|| {
                    let advice = format!(
                        "`{id}` has no measurement: POST /v1/powders/{id}/measurements adds one"
                    );
                    Error::conflict("measurement_missing", advice)
                })?;
                Ok((Some(powder.id), target))
            }
            (None, Some(repose_deg)) => Ok((
                None,
                Flowability::new(
                    repose_deg,
                    request.sd_deg.unwrap_or(0.0),
                    request.n.unwrap_or(1),
                )?,
            )),
            _ => Err(FieldError::new("powder", only_one).into()),
        }
    }

    /// One calibration.
    pub async fn calibration(&self, id: &str) -> Result<Calibration> {
        let row = self.store().job(id).await?.filter(|row| row.job.kind == JobKind::Calibration);
        calibration(self.placed(row.ok_or_else(|| Error::not_found("calibration", id))?).await?)
    }

    /// Calibrations, newest first.
    pub async fn calibrations(&self, page: PageQuery) -> Result<Page<Calibration>> {
        self.jobs_as(JobKind::Calibration, page, calibration).await
    }

    /// The posterior over the parameters that a calibration produced.
    ///
    /// # Errors
    /// `NotFound` if there is no such calibration; `Conflict` (`posterior_missing`) while it runs,
    /// or if its method has none.
    pub async fn posterior(&self, id: &str) -> Result<Posterior> {
        let found = self.calibration(id).await?;
        let sha256 = found.result.and_then(|result| result.posterior).ok_or_else(|| {
            let advice =
                "a calibration has a posterior when it has succeeded with the method `emulator`";
            Error::conflict("posterior_missing", advice.to_owned())
        })?;
        let lost = |error| Error::of_part("the posterior of this calibration", error);
        let bytes = self.store().artifacts().get(&sha256).await.map_err(lost)?;
        serde_json::from_slice(&bytes).map_err(|_| corrupt("a posterior"))
    }

    /// Trials of a calibration in order; up to 5000 per page.
    pub async fn trials(&self, calibration: &str, page: PageQuery) -> Result<Page<Trial>> {
        self.calibration(calibration).await?;
        Ok(self.store().trials(calibration, page.window(SERIES_LIMIT_MAX)?).await?)
    }
}

/// The angle under the reference conditions of a version, where the extended simulator equals its
/// base.
fn at_reference(
    measured: Flowability,
    powder: Option<&str>,
    under: &Under,
    extended: &Extended,
) -> Result<Flowability> {
    if !under.conditions.is_empty() {
        let shift_deg = extended.shift_deg(powder, &under.conditions).map_err(Error::Invalid)?;
        return Ok(Flowability::new(measured.repose_deg - shift_deg, measured.sd_deg, measured.n)?);
    }
    let predicted = extended.powders.iter().find(|it| Some(it.powder.as_str()) == powder);
    predicted.map(|it| it.repose).ok_or_else(|| {
        let advice = format!(
            "are needed: the campaign of `{}` did not measure this; say under which conditions it was measured",
            under.simulator
        );
        FieldError::new("conditions", advice).into()
    })
}

fn calibration(row: JobRow) -> Result<Calibration> {
    let JobSpec::Calibration(spec) = specification(&row)? else {
        return Err(corrupt("a calibration's specification"));
    };
    let result: Option<CalibrationResult> = row.result.as_deref().map(stored).transpose()?;
    Ok(Calibration {
        steepness: result.as_ref().and_then(|result| Steepness::of(&spec.target, result)),
        job: row.job,
        powder: spec.powder,
        target: spec.target,
        under: spec.under,
        observations: spec.observations,
        device: spec.device,
        settings: serde_json::to_value(spec.settings)
            .map_err(|error| Error::Internal(error.into()))?,
        result,
    })
}
