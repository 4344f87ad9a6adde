//! Powders, their measurements, and the parameter sets calibrated to them.

use super::check::Check;
use super::{App, Error, Result};
use crate::domain::FieldError;
use crate::domain::powder::{Flowability, Method, powder_id};
use crate::store::page::{LIST_LIMIT_MAX, Page, PageQuery};
use crate::store::parameter_sets::CalibratedSet;
use crate::store::powders::{Measurement, Powder};
use serde::{Deserialize, Serialize};

/// A powder to register.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NewPowder {
    /// A lower-case letter, then up to 63 of a-z, 0-9 and _.
    pub id: String,
    /// Name for people, 1 to 100 characters.
    pub name: String,
}

/// A measurement to register.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NewMeasurement {
    /// How it was measured.
    pub method: Method,
    /// Mean angle of repose, 5 to 85 degrees.
    pub repose_deg: f64,
    /// Standard deviation over the repeats, 0 to 45 degrees.
    pub sd_deg: f64,
    /// Number of repeats, 1 to 10000.
    pub n: u32,
    /// Where the numbers come from; up to 500 characters.
    pub source: Option<String>,
}

/// A powder with everything that is known about it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct PowderDetail {
    /// The powder.
    pub powder: Powder,
    /// Its measurements, oldest first.
    pub measurements: Vec<Measurement>,
    /// Its calibrated sets, oldest first.
    pub sets: Vec<CalibratedSet>,
}

impl App {
    /// Powders, oldest first.
    pub async fn powders(&self, page: PageQuery) -> Result<Page<Powder>> {
        Ok(self.store().powders(page.window(LIST_LIMIT_MAX)?).await?)
    }

    /// One powder with its measurements and sets: the first 200 measurements, the newest 200 sets.
    pub async fn powder(&self, id: &str) -> Result<PowderDetail> {
        let powder = self.existing_powder(id).await?;
        let all = PageQuery::first(LIST_LIMIT_MAX).window(LIST_LIMIT_MAX)?;
        let measurements = self.store().measurements(id, all).await?.items;
        let mut sets = self.store().parameter_sets(Some(id), all).await?.items;
        sets.reverse();
        Ok(PowderDetail { powder, measurements, sets })
    }

    /// Register a powder; `Conflict` when the id is taken.
    pub async fn create_powder(&self, new: NewPowder) -> Result<Powder> {
        let mut check = Check::default();
        check.keep(powder_id("id", &new.id));
        check.text("name", &new.name, 100);
        check.done()?;
        let mut tx = self.store().write().await?;
        if !tx.insert_powder(&new.id, &new.name).await? {
            let advice = format!("powder `{}` exists already: add measurements to it, or choose another id", new.id);
            return Err(Error::conflict("powder_exists", advice));
        }
        tx.commit().await?;
        self.existing_powder(&new.id).await
    }

    /// Measurements of a powder, oldest first.
    pub async fn measurements(&self, powder: &str, page: PageQuery) -> Result<Page<Measurement>> {
        self.existing_powder(powder).await?;
        Ok(self.store().measurements(powder, page.window(LIST_LIMIT_MAX)?).await?)
    }

    /// Register a measurement of a powder.
    pub async fn add_measurement(&self, powder: &str, new: NewMeasurement) -> Result<Measurement> {
        let mut check = Check::default();
        let flowability = check.keep(Flowability::new(new.repose_deg, new.sd_deg, new.n));
        let source = new.source.unwrap_or_default();
        if !source.is_empty() {
            check.text("source", &source, 500);
        }
        check.done()?;
        let Some(flowability) = flowability else { unreachable!("checked above") };
        self.existing_powder(powder).await?;
        let mut tx = self.store().write().await?;
        let measurement = tx.insert_measurement(powder, new.method, flowability, &source).await?;
        tx.commit().await?;
        Ok(measurement)
    }

    /// Calibrated sets, newest first; of one powder when named.
    pub async fn parameter_sets(&self, powder: Option<&str>, page: PageQuery) -> Result<Page<CalibratedSet>> {
        if let Some(powder) = powder {
            self.existing_powder(powder).await?;
        }
        Ok(self.store().parameter_sets(powder, page.window(LIST_LIMIT_MAX)?).await?)
    }

    /// One calibrated set.
    pub async fn parameter_set(&self, id: &str) -> Result<CalibratedSet> {
        self.store().parameter_set(id).await?.ok_or_else(|| Error::not_found("parameter set", id))
    }

    async fn existing_powder(&self, id: &str) -> Result<Powder> {
        self.store().powder(id).await?.ok_or_else(|| Error::not_found("powder", id))
    }

    /// The powder that a field of a request names: an unknown one is the request's fault.
    pub(super) async fn powder_of(&self, field: &str, id: &str) -> Result<Powder> {
        let id = powder_id(field, id)?;
        self.store().powder(&id).await?.ok_or_else(|| {
            let advice = format!("there is no powder `{id}`: GET /v1/powders lists them, POST /v1/powders adds one");
            FieldError::new(field, advice).into()
        })
    }
}
