//! A weighing: what was asked, and how it ended.

use super::conditions::{Patch, Under};
use super::vial::VialCheck;
use serde::{Deserialize, Serialize};

/// What a checked request asks for, all masses in mg.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WeighRequest {
    /// Powder id.
    pub powder: String,
    /// Target mass, mg.
    pub target_mg: f64,
    /// Accepted shortfall, mg, >= 0.
    pub tolerance_lower_mg: f64,
    /// Accepted excess, mg, >= 0.
    pub tolerance_upper_mg: f64,
    /// Policy id; resolved before the intent is stored.
    pub policy: String,
    /// Seed of the simulated bench.
    pub seed: u64,
    /// The extended version of the simulator on the bench, and its conditions; none of the base.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub under: Option<Under>,
    /// What the conditions change about the powder.
    #[serde(default, skip_serializing_if = "Patch::is_none")]
    pub patch: Patch,
    /// What else was asked.
    #[serde(default)]
    pub asked: Asked,
    /// Whether somebody has to say that the vial is in.
    #[serde(default, skip_serializing_if = "VialCheck::is_confirm")]
    pub vial_check: VialCheck,
}

/// What follows an overdose, which nobody can take back.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(tag = "action", rename_all = "snake_case", deny_unknown_fields)]
pub enum OnOverdose {
    /// It is told, and nothing more is done.
    #[default]
    Stop,
    /// The vial is exchanged for an empty one and the dose is made again. Only where the bench can exchange vials.
    DiscardAndRetry {
        /// How often at most, 1 to 5.
        max: u32,
    },
}

/// What a weighing is for and under which conditions, beside the mass.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Asked {
    /// Lot of the powder.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lot: Option<String>,
    /// Vial on the balance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vial: Option<String>,
    /// Who asked for it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub operator: Option<String>,
    /// Temperature at the balance, degrees C.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub temperature_c: Option<f64>,
    /// Relative humidity at the balance, %.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub relative_humidity_pct: Option<f64>,
    /// Share of the net mass that the weighing may be uncertain by, %; the smallest mass that may be weighed follows from it. Default 0.1 (USP <41>).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub accuracy_pct: Option<f64>,
    /// What follows an overdose.
    #[serde(default)]
    pub on_overdose: OnOverdose,
}

impl Asked {
    /// Nothing beside the mass.
    pub fn is_nothing(&self) -> bool {
        *self == Self::default()
    }
}

/// What a weighing measured beside its final reading.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct MeasuredMass {
    /// The vial, mg; absent where the balance does not say.
    pub tare_mg: Option<f64>,
    /// Vial and powder, mg.
    pub gross_mg: Option<f64>,
    /// What the display showed in the mean after the tare, mg: the net mass counts from there; absent where nobody watched.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub zero_mg: Option<f64>,
    /// Powder, mg: what the balance showed in the mean when everything stood still, less the zero.
    pub net_mg: f64,
    /// Expanded uncertainty of the net mass (k = 2), mg: readability, wander or repeatability, drift.
    pub uncertainty_mg: f64,
    /// The outcome holds over all of the net mass and its uncertainty; false of a dose that is within, not proven. Absent where the outcome says nothing of
    /// the tolerance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub proven: Option<bool>,
    /// Smallest net mass that this balance may weigh at the accuracy asked for, mg; absent without a repeatability check.
    pub minimum_mg: Option<f64>,
    /// The net mass is smaller than that.
    pub below_minimum_weight: Option<bool>,
    /// The balance's own flag at the last reading.
    pub stable_by_balance: bool,
    /// Our own criterion at the last reading.
    pub stable_by_window: bool,
    /// Slope of the readings before the dose, mg/min; 0 where they prove none.
    pub drift_before_mg_min: Option<f64>,
    /// And after it.
    pub drift_after_mg_min: Option<f64>,
    /// What the last reading while dosing did not show yet, mg.
    pub in_flight_mg: Option<f64>,
    /// Devices by role, with maker, model and serial number as they say themselves.
    #[serde(default)]
    pub devices: std::collections::BTreeMap<String, String>,
    /// Doses that were made before this one and thrown away.
    #[serde(default)]
    pub discarded_mg: Vec<f64>,
}

/// How a weighing ended. Names are the API's.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// Within tolerance by the reading. Where nothing was poured it is not.
    Within,
    /// Short of the target beyond tolerance by the reading.
    Under,
    /// By the reading above the target beyond tolerance. Powder cannot be taken back.
    Over,
    /// The balance did not come to rest: what it showed is no mass.
    NotStable,
    /// Nothing more leaves the spoon.
    Blocked,
    /// Stopped on request.
    Stopped,
    /// A device failed or the guard refused to go on.
    Aborted,
    /// The process ended during the weighing: a person must look.
    Unknown,
}

/// Where a weighing stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum WeighingState {
    /// Accepted and stored; waits for the bench.
    Planned,
    /// It is its turn; waits until somebody says that its vial is in.
    AwaitingVial,
    /// The bench is about to move.
    Armed,
    /// Powder may be falling.
    Dosing,
    /// The spoon is level and away; the balance comes to rest.
    Settling,
    /// Ended with an outcome.
    Done,
    /// Ended by a stop, a fault or the guard.
    Aborted,
    /// The process ended while it ran; nothing resumes by itself.
    Unknown,
}
