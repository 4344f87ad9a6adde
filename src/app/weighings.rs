//! Weighings: checked, committed as intents, then carried out one at a time by the bench.

use super::{App, Result};
use crate::domain::bench::Tick;
use crate::store::page::{Page, PageQuery};
use crate::store::weighings::Weighing;
use serde::{Deserialize, Serialize};

/// What to weigh.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct WeighingRequest {
    /// Powder id.
    pub powder: String,
    /// Mass wanted.
    pub target: Target,
    /// Accepted error.
    pub tolerance: Tolerance,
    /// Policy id; default the best evaluated one for the powder, the newest if none is evaluated.
    pub policy: Option<String>,
    /// Seed of the simulated bench; default one of its own for each weighing.
    pub seed: Option<u64>,
}

/// A mass with its unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Target {
    /// How much, above 0 and within what the spoon holds.
    pub value: f64,
    /// `mg` or `g`.
    #[schema(examples("mg"))]
    pub unit: String,
}

/// How far a dose may be off.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Tolerance {
    /// Accepted shortfall, >= 0.
    pub lower: f64,
    /// Accepted excess, >= 0.
    pub upper: f64,
    /// `mg`, `g`, or `%` of the target.
    #[schema(examples("mg"))]
    pub unit: String,
}

/// A weighing with its ticks, also while it runs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct WeighingDetail {
    /// The weighing.
    pub weighing: Weighing,
    /// What the bench did and the balance showed, in order.
    pub ticks: Vec<Tick>,
}

impl App {
    /// Commit the intent to weigh; the bench moves later. `true`: the key was used before with the same request,
    /// and this is the weighing it made.
    ///
    /// # Errors
    /// `Invalid`, `Unprocessable` (the key belongs to another request), `Busy` (64 are waiting), `Conflict`
    /// (`calibration_missing`, `policy_missing`).
    pub async fn start_weighing(&self, _request: WeighingRequest, _idempotency_key: &str) -> Result<(Weighing, bool)> {
        self.stub()
    }

    /// One weighing with its ticks.
    pub async fn weighing(&self, _id: &str) -> Result<WeighingDetail> {
        self.stub()
    }

    /// Weighings, newest first.
    pub async fn weighings(&self, _page: PageQuery) -> Result<Page<Weighing>> {
        self.stub()
    }

    /// Stop a weighing: at once when it waits, at the next tick when it runs. Not an emergency stop.
    pub async fn stop_weighing(&self, _id: &str) -> Result<Weighing> {
        self.stub()
    }
}
