//! Doses of powder.

use super::{
    Apparatus, Day, Labels, MassUnit, Patch, Timestamp, ToleranceUnit, Under, VialCheck, is_default,
};
use crate::app;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// What to weigh.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct WeighingRequest {
    /// Powder id.
    pub powder: String,
    /// Target mass.
    pub target: Target,
    /// Accepted error.
    pub tolerance: Tolerance,
    /// Policy id; default the one with the smallest evaluated error for the powder, or the shipped
    /// one if there is none.
    pub policy: Option<String>,
    /// Seed of the simulated bench; by default each weighing gets its own.
    pub seed: Option<u64>,
    /// Extended simulator version, `sv-…`; default the base.
    #[serde(default)]
    pub simulator: Option<String>,
    /// Conditions of the version on the simulated bench, each within the range of its campaign, as
    /// `{"relative_humidity_pct": 65}`.
    #[serde(default)]
    #[schema(value_type = std::collections::BTreeMap<String, super::Condition>)]
    pub conditions: Day,
    /// Purpose and circumstances: lot, vial, operator, air, and what follows an overdose.
    #[serde(default)]
    pub asked: Asked,
    /// Whether a person must confirm that the vial is in (POST /v1/weighings/{id}/vial-ready),
    /// where the bench cannot exchange vials.
    #[serde(default)]
    pub vial_check: VialCheck,
    /// The bench reservation under which the request is made, `rs-…`, if any.
    #[serde(default)]
    pub reservation: Option<String>,
    /// The bench, by its name, or `any`: the least busy of those that hold the powder (GET
    /// /v1/benches); default the one of this service.
    #[serde(default)]
    pub bench_name: Option<String>,
    /// What the caller writes on it, to find it again.
    #[serde(default)]
    pub labels: Labels,
}

request! { WeighingRequest => app::WeighingRequest {
    powder, target, tolerance, policy, seed, simulator, conditions, asked, vial_check, reservation,
    bench_name, labels,
} }

/// A mass with its unit.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Target {
    /// Value: at least one display step of the balance, and within what the spoon holds.
    pub value: f64,
    /// `mg` or `g`.
    #[schema(value_type = MassUnit)]
    pub unit: String,
}

request! { Target => app::Target { value, unit } }

/// Permitted deviation of a dose.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Tolerance {
    /// Accepted shortfall, >= 0 and less than the target.
    pub lower: f64,
    /// Accepted excess, >= 0; together they are more than 0 and at least one display step of the
    /// balance.
    pub upper: f64,
    /// `mg`, `g`, or `%` of the target.
    #[schema(value_type = ToleranceUnit)]
    pub unit: String,
}

request! { Tolerance => app::Tolerance { lower, upper, unit } }

/// A weighing with its ticks, even while it runs.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct WeighingDetail {
    /// The weighing.
    pub weighing: Weighing,
    /// Actions of the bench and balance readings, in order.
    pub ticks: Vec<Tick>,
    /// Why ticks are missing: their file is missing or damaged. The weighing itself is not
    /// affected.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trace_lost: Option<String>,
    /// Who stopped it, and when; absent if nobody did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stopped: Option<Stopped>,
}

answer! { app::WeighingDetail => WeighingDetail { weighing, ticks, trace_lost, stopped } }

/// A person's stop of a weighing.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Stopped {
    /// When.
    pub at: Timestamp,
    /// By whom: the name of the token; absent if unknown.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub by: Option<String>,
}

answer! { app::Stopped => Stopped { at, by } }

/// One dose: the order and how it ended.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
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
    /// The simulated powder on the bench: one of the powder's sets, preferably one that the policy
    /// was not trained on.
    pub parameter_set: String,
    /// Seed of the simulated bench.
    pub seed: u64,
    /// The extended version of the simulator on the bench, and its conditions; absent for the base.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub under: Option<Under>,
    /// Changes of the powder under these conditions.
    #[serde(default, skip_serializing_if = "is_default")]
    pub patch: Patch,
    /// Other requested options.
    #[serde(default, skip_serializing_if = "is_default")]
    pub asked: Asked,
    /// Whether someone has to confirm that its vial is in; absent for `confirm`.
    #[serde(default, skip_serializing_if = "is_default")]
    pub vial_check: VialCheck,
    /// The kind of bench that was armed for it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bench: Option<BenchKind>,
    /// The bench that carries it out, by its name; absent for the one named `bench`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bench_name: Option<String>,
    /// Its state.
    pub state: WeighingState,
    /// How it ended.
    pub outcome: Option<Outcome>,
    /// True mass in the vial, mg: known only in simulation, and not used to judge the outcome.
    pub dispensed_mg: Option<f64>,
    /// Final reading of the balance, mg; null if there is none, as for an aborted dose.
    pub reading_mg: Option<f64>,
    /// Reading minus target, mg, on every bench; null if the dose did not run its course.
    pub error_mg: Option<f64>,
    /// Number of shakes.
    pub shakes: Option<u32>,
    /// Bench time, s.
    pub seconds: Option<f64>,
    /// Measurements in addition to the reading.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured: Option<MeasuredMass>,
    /// Display, spoon and strokes with which its shakes were made and read; absent if none was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub apparatus: Option<Apparatus>,
    /// Why it was aborted.
    pub error: Option<String>,
    /// When the intent was committed.
    pub created_at: Timestamp,
    /// When the bench was armed.
    pub started_at: Option<Timestamp>,
    /// When it ended.
    pub finished_at: Option<Timestamp>,
    /// What callers wrote on it.
    #[serde(default, skip_serializing_if = "is_default")]
    pub labels: Labels,
}

answer! { flip_store::weighings::Weighing => Weighing {
    id, powder, target_mg, tolerance_lower_mg, tolerance_upper_mg, policy, parameter_set, seed,
    under, patch, asked, vial_check, bench, bench_name, state, outcome, dispensed_mg, reading_mg, error_mg,
    shakes, seconds, measured, apparatus, error, created_at, started_at, finished_at, labels,
} }

/// A weighing waiting for the bench.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Waiting {
    /// Weighing id.
    pub id: String,
    /// Powder id.
    pub powder: String,
    /// Target mass, mg.
    pub target_mg: f64,
    /// Its vial, if it was named.
    pub vial: Option<String>,
    /// `planned` or `awaiting_vial`.
    pub state: WeighingState,
}

answer! { flip_store::weighings::Waiting => Waiting { id, powder, target_mg, vial, state } }

/// What to do after an overdose, which cannot be undone.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
#[serde(tag = "action", rename_all = "snake_case", deny_unknown_fields)]
pub enum OnOverdose {
    /// Report it and stop.
    #[default]
    #[schema(title = "StopAfterOverdose")]
    Stop,
    /// Exchange the vial for an empty one and repeat the dose. Only on a bench that can exchange
    /// vials.
    #[schema(title = "DiscardAndRetry")]
    DiscardAndRetry {
        /// Maximum number of retries, 1 to 5.
        max: u32,
    },
}

answer! { flip_core::domain::weighing::OnOverdose => enum OnOverdose {
    Stop, DiscardAndRetry { max },
} }
request! { enum OnOverdose => flip_core::domain::weighing::OnOverdose {
    Stop, DiscardAndRetry { max },
} }

/// Purpose and conditions of a weighing, besides the mass.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
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
    /// What a person confirmed before asking, as in the checklist of the bench (GET
    /// /v1/bench/checklist); at most 20.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub checked: Vec<String>,
    /// What to do after an overdose.
    #[serde(default)]
    pub on_overdose: OnOverdose,
    /// Set where the powder was probed, not dosed; refused in a request to weigh.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub probe: Option<Probe>,
}

answer! { flip_core::domain::weighing::Asked => Asked {
    lot, vial, operator, list, position, temperature_c, relative_humidity_pct, accuracy_pct,
    checked, on_overdose, probe,
} }
request! { Asked => flip_core::domain::weighing::Asked {
    lot, vial, operator, list, position, temperature_c, relative_humidity_pct, accuracy_pct,
    checked, on_overdose, probe,
} }

/// Spoonfuls that are shaken to see how a powder flows: no dose is aimed at, and what falls is
/// discarded. The target of such a weighing is the most that may fall altogether.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Probe {
    /// Fillings of the spoon, 1 to 9; one where a person fills it.
    pub spoonfuls: u32,
}

answer! { flip_core::domain::weighing::Probe => Probe { spoonfuls } }
request! { Probe => flip_core::domain::weighing::Probe { spoonfuls } }

/// Measured values of a weighing, besides its final reading.
#[derive(Debug, Clone, PartialEq, Default, Serialize, ToSchema)]
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
    pub devices: BTreeMap<String, String>,
    /// Doses made before this one and discarded.
    #[serde(default)]
    pub discarded_mg: Vec<f64>,
}

answer! { flip_core::domain::weighing::MeasuredMass => MeasuredMass {
    tare_mg, gross_mg, zero_mg, net_mg, uncertainty_mg, proven, minimum_mg, below_minimum_weight,
    stable_by_balance, stable_by_window, drift_before_mg_min, drift_after_mg_min, in_flight_mg,
    devices, discarded_mg,
} }

/// How a weighing ended, under the API's names.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
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

answer! { flip_core::domain::weighing::Outcome => enum Outcome {
    Within, Under, Over, NotStable, Blocked, Probed, Stopped, Aborted, Unknown,
} }
request! { enum Outcome => flip_core::domain::weighing::Outcome {
    Within, Under, Over, NotStable, Blocked, Probed, Stopped, Aborted, Unknown,
} }

/// State of a weighing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
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

answer! { flip_core::domain::weighing::WeighingState => enum WeighingState {
    Planned, AwaitingVial, Armed, Dosing, Settling, Done, Aborted, Unknown,
} }
request! { enum WeighingState => flip_core::domain::weighing::WeighingState {
    Planned, AwaitingVial, Armed, Dosing, Settling, Done, Aborted, Unknown,
} }

/// Order of weighings.
#[derive(Debug, Clone, PartialEq, Default, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum WeighingSort {
    /// The newest request first.
    #[default]
    Newest,
    /// The oldest request first.
    Oldest,
    /// The largest error first, of either sign; those without one last.
    Error,
    /// The largest target first.
    Target,
    /// The longest on the bench first; those that did not move last.
    Seconds,
}

request! { enum WeighingSort => app::WeighingSort { Newest, Oldest, Error, Target, Seconds } }

/// A page of the weighings that match, and how many match.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct WeighingsFound {
    /// The weighings, in the order asked for.
    pub items: Vec<super::Labelled<Weighing>>,
    /// Pass it as `after` to read on; absent on the last page.
    pub next: Option<String>,
    /// How many match in all.
    pub total: u64,
}

/// The devices behind a bench.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum BenchKind {
    /// The simulator, called directly.
    Simulated,
    /// Emulated devices that speak their real protocols, with the simulator behind them.
    Emulated,
    /// Real devices.
    Devices,
}

answer! { flip_core::domain::bench::BenchKind => enum BenchKind { Simulated, Emulated, Devices } }
request! { enum BenchKind => flip_core::domain::bench::BenchKind { Simulated, Emulated, Devices } }

/// What a policy proposes for one step: first incline, then shake.
#[derive(Debug, Clone, PartialEq, Default, Serialize, ToSchema)]
pub struct Action {
    /// Change of the spoon's pitch, degrees; positive is tip down; -8 to 8.
    pub incline_change_deg: f64,
    /// Amplitude of one out-and-back shake along the spoon, mm; 0 to 16; below 0.9 there is no
    /// shake.
    pub shake_mm: f64,
    /// How often the shake is made before the balance is read; 1 to 8.
    pub strokes: u32,
}

answer! { flip_core::domain::bench::Action => Action { incline_change_deg, shake_mm, strokes } }

/// One reading of the balance.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Reading {
    /// Net mass shown, mg; a multiple of the readability.
    pub mass_mg: f64,
    /// The balance's own stable flag.
    pub stable: bool,
}

answer! { flip_core::domain::bench::Reading => Reading { mass_mg, stable } }

/// One step of a weighing: the action and the balance reading after it.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Tick {
    /// Step number; 0 is the reading after the tare, before any motion.
    pub step: u32,
    /// Bench time since the tare, seconds.
    pub t_s: f64,
    /// Pitch of the spoon after the step, degrees.
    pub pitch_deg: f64,
    /// The action as passed by the guard.
    pub action: Action,
    /// The settled balance reading.
    pub reading: Reading,
    /// Which filling of the spoon, from 1.
    pub spoonful: u32,
}

answer! { flip_core::domain::bench::Tick => Tick { step, t_s, pitch_deg, action, reading, spoonful } }
