//! Powders, their measurements, and the parameter sets calibrated to them.

use super::{App, Result};
use crate::domain::powder::Method;
use crate::store::page::{Page, PageQuery};
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
    pub async fn powders(&self, _page: PageQuery) -> Result<Page<Powder>> {
        self.stub()
    }

    /// One powder with its measurements and sets.
    pub async fn powder(&self, _id: &str) -> Result<PowderDetail> {
        self.stub()
    }

    /// Register a powder; `Conflict` when the id is taken.
    pub async fn create_powder(&self, _new: NewPowder) -> Result<Powder> {
        self.stub()
    }

    /// Measurements of a powder, oldest first.
    pub async fn measurements(&self, _powder: &str, _page: PageQuery) -> Result<Page<Measurement>> {
        self.stub()
    }

    /// Register a measurement of a powder.
    pub async fn add_measurement(&self, _powder: &str, _new: NewMeasurement) -> Result<Measurement> {
        self.stub()
    }

    /// Calibrated sets, newest first; of one powder when named.
    pub async fn parameter_sets(&self, _powder: Option<&str>, _page: PageQuery) -> Result<Page<CalibratedSet>> {
        self.stub()
    }

    /// One calibrated set.
    pub async fn parameter_set(&self, _id: &str) -> Result<CalibratedSet> {
        self.stub()
    }
}
