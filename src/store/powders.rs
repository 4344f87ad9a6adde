//! Powders and their measurements.

use crate::domain::powder::{Flowability, Method};
use crate::domain::timestamp::Timestamp;
use serde::{Deserialize, Serialize};

/// A real powder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Powder {
    /// Short name in lower case, e.g. `sodium_bicarbonate`.
    pub id: String,
    /// Name for people.
    pub name: String,
    /// The flowability that calibrations aim at: the newest automated measurement, else the newest manual one.
    pub flowability: Option<Flowability>,
    /// When it was registered.
    pub created_at: Timestamp,
}

/// One measurement of a powder's flowability.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Measurement {
    /// Id.
    pub id: String,
    /// Powder id.
    pub powder: String,
    /// How it was measured.
    pub method: Method,
    /// Mean angle of repose, degrees.
    pub repose_deg: f64,
    /// Standard deviation over the repeats, degrees.
    pub sd_deg: f64,
    /// Number of repeats.
    pub n: u32,
    /// Where the numbers come from.
    pub source: String,
    /// When it was registered.
    pub created_at: Timestamp,
}
