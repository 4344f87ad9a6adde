//! A weighing: the request and its outcome.

use super::conditions::{Patch, Under};
use super::labels::Labels;
use super::vial::VialCheck;
use serde::{Deserialize, Serialize};

/// A validated request; all masses in mg.
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
    /// Extended version of the simulator on the bench and its conditions; none for the base
    /// version.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub under: Option<Under>,
    /// Changes that the conditions make to the powder.
    #[serde(default, skip_serializing_if = "Patch::is_none")]
    pub patch: Patch,
    /// Purpose and conditions of the weighing.
    #[serde(default)]
    pub asked: Asked,
    /// What the caller writes on it, to find it again.
    #[serde(default, skip_serializing_if = "Labels::is_empty")]
    pub labels: Labels,
    /// Whether a person must confirm that the vial is in place.
    #[serde(default, skip_serializing_if = "VialCheck::is_confirm")]
    pub vial_check: VialCheck,
}

/// What to do after an overdose, which cannot be undone.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "action", rename_all = "snake_case", deny_unknown_fields)]
pub enum OnOverdose {
    /// Report it and stop.
    #[default]
    Stop,
    /// Exchange the vial for an empty one and repeat the dose. Only on a bench that can exchange
    /// vials.
    DiscardAndRetry {
        /// Maximum number of retries, 1 to 5.
        max: u32,
    },
}

/// Spoonfuls that are shaken to see how a powder flows: no dose is aimed at, and what falls is
/// discarded. The target of such a weighing is the most that may fall altogether.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Probe {
    /// Fillings of the spoon, 1 to [`PROBE_SPOONFULS_MAX`]; one where a person fills it.
    pub spoonfuls: u32,
}

/// Most spoonfuls of one probing run: about half an hour.
pub const PROBE_SPOONFULS_MAX: u32 = 9;

/// Purpose and conditions of a weighing, besides the mass.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Asked {
    /// Lot of the powder.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lot: Option<String>,
    /// Vial on the balance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vial: Option<String>,
    /// Name of the operator.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub operator: Option<String>,
    /// Name of the list of doses that it belongs to.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub list: Option<String>,
    /// Where its vial belongs in a rack.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position: Option<String>,
    /// Temperature at the balance, degrees C.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub temperature_c: Option<f64>,
    /// Relative humidity at the balance, %.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub relative_humidity_pct: Option<f64>,
    /// Permitted uncertainty as a share of the net mass, %; determines the smallest mass that may
    /// be weighed. Default 0.1 (USP <41>).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub accuracy_pct: Option<f64>,
    /// What a person confirmed before asking, as in the checklist of the bench.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub checked: Vec<String>,
    /// What to do after an overdose.
    #[serde(default)]
    pub on_overdose: OnOverdose,
    /// The powder is probed, not dosed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub probe: Option<Probe>,
}

impl Asked {
    /// Whether nothing besides the mass is set.
    pub fn is_nothing(&self) -> bool {
        *self == Self::default()
    }
}

/// Measured values of a weighing, besides its final reading.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct MeasuredMass {
    /// Mass of the vial, mg; absent if the balance does not report it.
    pub tare_mg: Option<f64>,
    /// Mass of vial and powder, mg.
    pub gross_mg: Option<f64>,
    /// Mean reading after the tare, mg; the net mass is counted from it. Absent if the balance was
    /// not watched.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub zero_mg: Option<f64>,
    /// Mass of the powder, mg: mean reading once everything stood still, minus the zero.
    pub net_mg: f64,
    /// Expanded uncertainty of the net mass (k = 2), mg: readability, wander or repeatability,
    /// drift.
    pub uncertainty_mg: f64,
    /// Whether the outcome holds over the whole uncertainty interval of the net mass; false for a
    /// dose that is within, but not provably so. Absent if the outcome does not concern the
    /// tolerance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub proven: Option<bool>,
    /// Smallest net mass this balance may weigh at the requested accuracy, mg; absent without a
    /// repeatability check.
    pub minimum_mg: Option<f64>,
    /// Whether the net mass is below that minimum.
    pub below_minimum_weight: Option<bool>,
    /// The balance's own flag at the last reading.
    pub stable_by_balance: bool,
    /// FLIP's own criterion at the last reading.
    pub stable_by_window: bool,
    /// Slope of the readings before the dose, mg/min; 0 if not significant.
    pub drift_before_mg_min: Option<f64>,
    /// Slope of the readings after the dose, mg/min.
    pub drift_after_mg_min: Option<f64>,
    /// Mass not yet shown by the last reading during dosing, mg.
    pub in_flight_mg: Option<f64>,
    /// Devices by role, with manufacturer, model and serial number as they report them.
    #[serde(default)]
    pub devices: std::collections::BTreeMap<String, String>,
    /// Doses made before this one and discarded.
    #[serde(default)]
    pub discarded_mg: Vec<f64>,
}

/// How a weighing ended, under the API's names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// Within tolerance by the reading. Never used if nothing was poured.
    Within,
    /// By the reading, below the target by more than the tolerance.
    Under,
    /// By the reading, above the target by more than the tolerance. Powder cannot be taken back.
    Over,
    /// The balance did not settle: its display is not a valid mass.
    NotStable,
    /// No more powder leaves the spoon.
    Blocked,
    /// A probing run that ran its course: there is no dose to judge.
    Probed,
    /// Stopped on request.
    Stopped,
    /// A device failed, or the guard refused to continue.
    Aborted,
    /// The process ended during the weighing: a person must check.
    Unknown,
}

/// State of a weighing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WeighingState {
    /// Accepted and stored; waiting for the bench.
    Planned,
    /// Its turn has come; waiting for confirmation that its vial is in.
    AwaitingVial,
    /// The bench is about to move.
    Armed,
    /// Powder may be falling.
    Dosing,
    /// The spoon is level and retracted; the balance is settling.
    Settling,
    /// Ended with an outcome.
    Done,
    /// Ended by a stop, a fault or the guard.
    Aborted,
    /// The process ended while it ran; nothing resumes automatically.
    Unknown,
}
