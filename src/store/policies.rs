//! Policies: the trained weights as bytes, and what is known about them.

use crate::domain::timestamp::Timestamp;
use serde::{Deserialize, Serialize};

/// A trained policy. Never changes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Policy {
    /// Content address: `p-` and 16 hexadecimal digits.
    pub id: String,
    /// `learned`, `fixed` or `schedule`.
    pub kind: String,
    /// The training that made it.
    pub training: Option<String>,
    /// Settings, seed, parameter sets, curriculum history, versions.
    #[schema(value_type = Object)]
    pub manifest: serde_json::Value,
    /// SHA-256 of the bytes, hexadecimal.
    pub sha256: String,
    /// Length of the bytes.
    pub size_bytes: u64,
    /// Mean absolute errors found by evaluations, one entry for each powder.
    pub evaluated: Vec<PolicyError>,
    /// When it was stored.
    pub created_at: Timestamp,
}

/// What evaluations say about a policy on one powder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct PolicyError {
    /// Powder id.
    pub powder: String,
    /// Mean absolute error over the newest evaluation's weighings of the powder, mg.
    pub mae_mg: f64,
    /// Number of those weighings.
    pub n: u32,
}
