//! Measurements of a powder: its angle of repose, and the results of other experiments.

use super::check::Check;
use super::csv_file::date::day_of;
use super::file_powders::FilePowders;
use super::measurement_csv::{self, Value};
use super::stored_before::StoredBefore;
use super::{App, Result};
use flip_core::domain::FieldError;
use flip_core::domain::observable::{Observable, Observation};
use flip_core::domain::powder::{Flowability, HeapReadings, Method};
use flip_discover::reading::NamedPowder;
use flip_store::artifacts::sha256_hex;
use flip_store::now;
use flip_store::observations::PowderObservation;
use flip_store::page::{LIST_LIMIT_MAX, Page, PageQuery};
use flip_store::powders::{Measurement, Origin};
use flip_store::said::{Row, RowOf};
use serde::{Deserialize, Serialize};
use serde_json::json;

/// A measurement to register, in exactly one of three forms.
///
/// `repose_deg` with `sd_deg` and `n`, or alone as a single value; the angles of all repeats in
/// `repeats_deg`; or the heaps themselves, `heights_mm` with `base_diameters_mm`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NewMeasurement {
    /// How it was measured.
    pub method: Method,
    /// Mean angle of repose, 5 to 85 degrees.
    pub repose_deg: Option<f64>,
    /// Standard deviation over the repeats, 0 to 45 degrees; left out for a single value, whose
    /// spread is unknown.
    pub sd_deg: Option<f64>,
    /// Number of repeats, 1 to 10000; 1 if neither it nor `sd_deg` is given.
    pub n: Option<u32>,
    /// Angle of repose of each of 1 to 10000 repeats, 5 to 85 degrees; mean, sample SD (0 for a
    /// single one) and number are computed.
    pub repeats_deg: Option<Vec<f64>>,
    /// Height of each of 1 to 10000 heaps above the base it covers, mm. The angle of each is atan(2
    /// h / d), 5 to 85 degrees.
    pub heights_mm: Option<Vec<f64>>,
    /// Diameter of the base, 5 to 500 mm: one for each height, or one for all.
    pub base_diameters_mm: Option<Vec<f64>>,
    /// Height of the funnel's tip above the base, 0.1 to 3000 mm; a heap higher than this is
    /// refused.
    pub funnel_height_mm: Option<f64>,
    /// Where the numbers come from; up to 500 characters.
    pub source: Option<String>,
    /// On which day it was made, as `2026-02-03`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured_on: Option<String>,
}

/// A measurement to register, other than the angle of repose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NewObservation {
    /// What was measured, with the settings of the experiment.
    pub observable: Observable,
    /// Mean over the repeats, in the observable's unit: s, mg, deg or mm.
    pub mean: f64,
    /// Standard deviation over the repeats, above 0.
    pub sd: f64,
    /// Number of repeats, 2 to 10000.
    pub n: u32,
    /// Where the numbers come from; up to 500 characters.
    pub source: Option<String>,
    /// On which day it was made, as `2026-02-03`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured_on: Option<String>,
}

/// Result of importing a file of measurements.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Imported {
    /// Ids of the powders registered because the file names them.
    pub powders: Vec<String>,
    /// Powders given by name in the file, with the ids made or found for them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub named: Vec<NamedPowder>,
    /// The measurements, in the order of the file.
    pub measurements: Vec<Measurement>,
    /// The observations other than the angle, in the order of the file.
    pub observations: Vec<PowderObservation>,
    /// Entries of the file that were stored already, with the same powder, values and source, and
    /// were skipped.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub already_stored: usize,
}

fn is_zero(count: &usize) -> bool {
    *count == 0
}

/// All measurements and observations.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Measured {
    /// Measurements, oldest first.
    pub measurements: Vec<Measurement>,
    /// Observations other than the angle, oldest first.
    pub observations: Vec<PowderObservation>,
}

impl Measured {
    /// As a file that [`App::import_measurements`] reads.
    pub fn csv(&self) -> String {
        measurement_csv::write(&self.measurements, &self.observations)
    }
}

impl NewMeasurement {
    /// What is stored: method, angle and origin; its errors are collected.
    pub(super) fn checked(self, check: &mut Check) -> Option<(Method, Flowability, Origin)> {
        let flowability = check.keep(self.flowability());
        let origin = origin(self.source, self.measured_on, check);
        flowability.map(|flowability| (self.method, flowability, origin))
    }

    /// Mean, SD and number, from whichever form was given.
    fn flowability(&self) -> std::result::Result<Flowability, FieldError> {
        let Self {
            repose_deg,
            sd_deg,
            n,
            repeats_deg,
            heights_mm,
            base_diameters_mm,
            funnel_height_mm,
            ..
        } = self;
        let stray = |given: &[(&str, bool)], form: &str| {
            let stray = given.iter().find(|(_, is_given)| *is_given);
            stray.map_or(Ok(()), |(field, _)| {
                Err(FieldError::new(*field, format!("cannot be given with {form}: leave one out")))
            })
        };
        let summary = [
            ("repose_deg", repose_deg.is_some()),
            ("sd_deg", sd_deg.is_some()),
            ("n", n.is_some()),
        ];
        let repeats = [("repeats_deg", repeats_deg.is_some())];
        let bases = [
            ("base_diameters_mm", base_diameters_mm.is_some()),
            ("funnel_height_mm", funnel_height_mm.is_some()),
        ];
        match (heights_mm, repeats_deg, repose_deg) {
            (Some(heights_mm), ..) => {
                stray(&[&summary[..], &repeats].concat(), "`heights_mm`")?;
                let missing = || {
                    FieldError::new(
                        "base_diameters_mm",
                        "is missing: each height needs the diameter of its base",
                    )
                };
                let base_diameters_mm = base_diameters_mm.as_ref().ok_or_else(missing)?;
                Flowability::of_heaps(&HeapReadings {
                    heights_mm,
                    base_diameters_mm,
                    funnel_height_mm: *funnel_height_mm,
                })
            }
            (None, Some(angles), _) => {
                stray(&[&summary[..], &bases].concat(), "`repeats_deg`")?;
                Flowability::of_repeats("repeats_deg", angles)
            }
            (None, None, Some(repose_deg)) => {
                stray(&bases, "`repose_deg`")?;
                // The spread of a single value is unknown: 0 with n = 1, as for one repeat.
                let (sd_deg, n) = match (*sd_deg, *n) {
                    (None, None | Some(1)) => (0.0, 1),
                    (Some(sd_deg), Some(n)) => (sd_deg, n),
                    (None, Some(_)) => {
                        return Err(FieldError::new(
                            "sd_deg",
                            "is missing: the SD over the repeats",
                        ));
                    }
                    (Some(_), None) => {
                        return Err(FieldError::new("n", "is missing: the number of repeats"));
                    }
                };
                Flowability::new(*repose_deg, sd_deg, n)
            }
            (None, None, None) => {
                let advice = "is missing: give it, with `sd_deg` and `n` where there are repeats, or the repeats as `repeats_deg`, \
                              or the heaps as `heights_mm` and `base_diameters_mm`";
                Err(FieldError::new("repose_deg", advice))
            }
        }
    }
}

/// Where numbers come from; errors are collected.
fn origin(source: Option<String>, measured_on: Option<String>, check: &mut Check) -> Origin {
    let source = source.unwrap_or_default();
    check.source("source", &source);
    let day = |text: &String| day_of(text).map_err(|why| FieldError::new("measured_on", why));
    let measured_on = measured_on.as_ref().and_then(|text| check.keep(day(text)));
    Origin { source, measured_on }
}

impl NewObservation {
    /// What is stored: observation and origin; its errors are collected.
    pub(super) fn checked(self, check: &mut Check) -> Option<(Observation, Origin)> {
        let observed = check.keep(self.observation());
        let origin = origin(self.source, self.measured_on, check);
        observed.map(|observed| (observed, origin))
    }

    fn observation(&self) -> std::result::Result<Observation, FieldError> {
        let Self { observable, mean, sd, n, .. } = *self;
        Observation { observable, mean, sd, n }.checked().map_err(|error| {
            match error.field.as_str() {
                "mean" | "sd" | "n" => error,
                // A setting of the experiment, which in the request is nested one level deeper.
                setting => FieldError { field: format!("observable.{setting}"), ..error },
            }
        })
    }
}

impl App {
    /// Measurements of a powder, oldest first.
    pub async fn measurements(&self, powder: &str, page: PageQuery) -> Result<Page<Measurement>> {
        self.existing_powder(powder).await?;
        Ok(self.store().measurements(powder, page.window(LIST_LIMIT_MAX)?).await?)
    }

    /// Registers a measurement of a powder.
    pub async fn add_measurement(&self, powder: &str, new: NewMeasurement) -> Result<Measurement> {
        let mut check = Check::default();
        let new = new.checked(&mut check);
        check.done()?;
        let Some((method, flowability, origin)) = new else { unreachable!("checked above") };
        self.existing_powder(powder).await?;
        let mut tx = self.store().write().await?;
        let measurement = tx.insert_measurement(powder, method, flowability, &origin).await?;
        tx.audit_deed(None, "new measurement", json!({ "measurement": measurement }), now())
            .await?;
        tx.commit().await?;
        Ok(measurement)
    }

    /// Registers everything in a CSV file, or nothing. A powder is given by its id or its name. An
    /// unregistered one is refused, or, with `create`, registered under an id derived from its
    /// name. Entries that are stored already, with the same powder, values and source, are skipped:
    /// importing the same file again adds nothing.
    ///
    /// # Errors
    /// `Invalid` with every invalid cell as `row[2].repose_deg`, the header being row 1.
    pub async fn import_measurements(&self, csv: &str, create: bool) -> Result<Imported> {
        let (mut entries, names) = measurement_csv::read(csv)?;
        let known = self.store().powder_names().await?;
        let of_rows = entries.iter().map(|entry| (entry.powder.as_str(), entry.row));
        let powders = FilePowders::find(of_rows, &names, &known, create)?;
        entries.iter_mut().for_each(|entry| powders.rename(&mut entry.powder));
        let mut tx = self.store().write().await?;
        let mut rows = powders.register(&mut tx).await?;
        // Other imports wait for this transaction, so what is stored now is complete.
        // A withdrawn one does not come back with the file that it came from.
        let measurements = self.store().ever_measured().await?;
        let observations = self.store().ever_observed().await?;
        let mut before = StoredBefore::of(&Measured { measurements, observations });
        let left_out = entries.extract_if(.., |entry| before.has(entry)).count();
        let (measurements, observations) = (Vec::new(), Vec::new());
        let (named, powders) = (powders.named.clone(), powders.new_ids());
        let mut imported =
            Imported { powders, named, measurements, observations, already_stored: left_out };
        for entry in &entries {
            let (powder, origin) = (&entry.powder, &entry.origin);
            match &entry.value {
                Value::Angle(method, angle) => {
                    imported
                        .measurements
                        .push(tx.insert_measurement(powder, *method, *angle, origin).await?);
                }
                Value::Observed(observed) => {
                    imported
                        .observations
                        .push(tx.insert_observation(powder, observed, origin).await?);
                }
            }
        }
        let said = json!({ "powders": imported.powders, "measurements": imported.measurements.len(),
            "observations": imported.observations.len(), "already_stored": left_out, "sha256": sha256_hex(csv.as_bytes()) });
        tx.audit_deed(None, "import measurements", said, now()).await?;
        rows.extend(imported.measurements.iter().map(|it| Row::of(RowOf::Measurement, &it.id, it)));
        rows.extend(imported.observations.iter().map(|it| Row::of(RowOf::Observation, &it.id, it)));
        tx.audit_rows(rows).await?;
        tx.commit().await?;
        Ok(imported)
    }

    /// All measurements and observations that count; optionally of one powder.
    pub async fn measured(&self, powder: Option<&str>) -> Result<Measured> {
        if let Some(powder) = powder {
            self.existing_powder(powder).await?;
        }
        let measurements = self.store().all_measurements(powder).await?;
        let observations = self.store().all_observations(powder).await?;
        Ok(Measured { measurements, observations })
    }

    /// Observations of a powder other than its angle, oldest first; for each observable the newest
    /// one is used.
    pub async fn observations(
        &self,
        powder: &str,
        page: PageQuery,
    ) -> Result<Page<PowderObservation>> {
        self.existing_powder(powder).await?;
        Ok(self.store().observations(powder, page.window(LIST_LIMIT_MAX)?).await?)
    }

    /// Registers an observation of a powder other than its angle.
    pub async fn add_observation(
        &self,
        powder: &str,
        new: NewObservation,
    ) -> Result<PowderObservation> {
        let mut check = Check::default();
        let new = new.checked(&mut check);
        check.done()?;
        let Some((observed, origin)) = new else { unreachable!("checked above") };
        self.existing_powder(powder).await?;
        let mut tx = self.store().write().await?;
        let observation = tx.insert_observation(powder, &observed, &origin).await?;
        tx.audit_deed(None, "new observation", json!({ "observation": observation }), now())
            .await?;
        tx.commit().await?;
        Ok(observation)
    }
}
