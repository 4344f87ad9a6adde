//! Weighings: the intent is committed before any motion, the outcome after it; nothing is ever poured twice.

use crate::domain::timestamp::Timestamp;
use crate::domain::weighing::{Outcome, WeighingState};
use serde::{Deserialize, Serialize};

/// One dose: what was asked and how it ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Weighing {
    /// Id.
    pub id: String,
    /// Powder id.
    pub powder: String,
    /// Target mass, mg.
    pub target_mg: f64,
    /// Accepted shortfall, mg.
    pub tolerance_lower_mg: f64,
    /// Accepted excess, mg.
    pub tolerance_upper_mg: f64,
    /// Policy id.
    pub policy: String,
    /// The simulated powder on the bench; chosen among the powder's sets that the policy was not trained on.
    pub parameter_set: Option<String>,
    /// Seed of the simulated bench.
    pub seed: u64,
    /// Where it stands.
    pub state: WeighingState,
    /// How it ended.
    pub outcome: Option<Outcome>,
    /// True mass in the vial, mg (known in simulation only).
    pub dispensed_mg: Option<f64>,
    /// Last reading of the balance, mg.
    pub reading_mg: Option<f64>,
    /// Dispensed minus target, mg.
    pub error_mg: Option<f64>,
    /// Shakes made.
    pub shakes: Option<u32>,
    /// Bench time, s.
    pub seconds: Option<f64>,
    /// Why it was aborted.
    pub error: Option<String>,
    /// When the intent was committed.
    pub created_at: Timestamp,
    /// When the bench was armed.
    pub started_at: Option<Timestamp>,
    /// When it ended.
    pub finished_at: Option<Timestamp>,
}
