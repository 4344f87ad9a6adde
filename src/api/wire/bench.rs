//! The bench: its state, what holds it, its checks.

use super::{BenchKind, Reservation, Timestamp, Vial, Waiting};
use crate::app;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// The end of a dose that could not be recorded yet. Nothing starts until it is.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Unwritten {
    /// The weighing.
    pub weighing: String,
    /// Since when.
    pub since: Timestamp,
    /// What prevents it.
    pub why: String,
}

answer! { app::Unwritten => Unwritten { weighing, since, why } }

/// The bench, and whether it may be used.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct BenchStatus {
    /// Kind of bench; absent if another process has it.
    pub kind: Option<BenchKind>,
    /// Devices by role, as they identify themselves.
    pub devices: BTreeMap<String, String>,
    /// Each dose gets an empty vial without human help; absent if another process has the bench.
    pub exchanges_vials: Option<bool>,
    /// Why it may not be used until a person clears it.
    pub latch: Option<Latch>,
    /// After a stop: nothing starts until a person resumes.
    pub held: Option<Held>,
    /// The weighing in motion.
    pub moving: Option<String>,
    /// The pile being made: the gate may be open. Stopping the bench ends it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub piling: Option<PileInMaking>,
    /// Waiting weighings, in order.
    pub waiting: Vec<Waiting>,
    /// The vial on the pan, as far as known.
    pub vial: Option<Vial>,
    /// The current reservation of the bench.
    pub reservation: Option<Reservation>,
    /// The end of a dose that could not be recorded yet: nothing starts until it is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unwritten: Option<Unwritten>,
    /// The newest repeatability check of the balance.
    pub repeatability: Option<Repeatability>,
}

answer! { app::BenchStatus => BenchStatus {
    kind, devices, exchanges_vials, latch, held, moving, piling, waiting, vial, reservation,
    unwritten, repeatability,
} }

/// What a bench's container holds.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Loaded {
    /// Powder id.
    pub powder: String,
    /// Its lot, if it was said.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lot: Option<String>,
    /// Since when.
    pub at: Timestamp,
}

answer! { app::Loaded => Loaded { powder, lot, at } }

/// One of the benches.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Bench {
    /// Its name.
    pub name: String,
    /// What it is; absent if no process has had it yet.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kind: Option<BenchKind>,
    /// The process that has it (GET /v1/workers); absent if none has, or if there is one bench only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub owner: Option<String>,
    /// The machine on which that runs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub machine: Option<String>,
    /// Since when that process has it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub since: Option<Timestamp>,
    /// When that process was last heard of.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub heard_at: Option<Timestamp>,
    /// Whether a process carries out its weighings.
    pub served: bool,
    /// Why it is latched, if it is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub latch: Option<String>,
    /// Why nothing starts on it until a person resumes, if so.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub held: Option<String>,
    /// The weighing in motion.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moving: Option<String>,
    /// How many weighings wait for it.
    pub waiting: u32,
    /// What its container holds, if it was said.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub holds: Option<Loaded>,
}

answer! { app::BenchRow => Bench {
    name, kind, owner, machine, since, heard_at, served, latch, held, moving, waiting, holds,
} }

/// What a bench's container holds from now on.
#[derive(Debug, Clone, Default, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LoadRequest {
    /// Powder id; absent: the container is empty.
    #[serde(default)]
    pub powder: Option<String>,
    /// Its lot.
    #[serde(default)]
    pub lot: Option<String>,
}

request! { LoadRequest => app::LoadRequest { powder, lot } }

/// A person confirms having checked the bench.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ClearRequest {
    /// Name of the person who checked.
    pub by: String,
    /// What was found and done.
    #[serde(default)]
    pub note: String,
    /// Confirms that the bench was checked. Must be true.
    pub looked: bool,
    /// Confirms that the vial is empty or new and that the balance will be tared. Must be true.
    pub vial_ready: bool,
    /// Waiting weighings may start at once, even after a stop; otherwise the bench is held until a
    /// person resumes.
    #[serde(default)]
    pub resume: bool,
}

request! { ClearRequest => app::ClearRequest { by, note, looked, vial_ready, resume } }

/// A person lets weighings start again.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ResumeRequest {
    /// Name of the person resuming.
    pub by: String,
    /// What was found and done.
    #[serde(default)]
    pub note: String,
}

request! { ResumeRequest => app::ResumeRequest { by, note } }

/// What the balance shows while nothing is dosed.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct BalanceReading {
    /// Display, mg: net of what was tared last.
    pub mass_mg: f64,
    /// Whether the balance calls it stable.
    pub stable: bool,
    /// When it was read.
    pub at: Timestamp,
    /// Readability (display step), mg, where known.
    pub readability_mg: Option<f64>,
    /// The balance as it identified itself at the last dose, if there was one.
    pub balance: Option<String>,
}

answer! { app::BalanceReading => BalanceReading { mass_mg, stable, at, readability_mg, balance } }

/// A request to tare or zero the balance.
#[derive(Debug, Clone, Default, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BalanceRequest {
    /// The bench reservation under which the request is made, `rs-…`, if any.
    #[serde(default)]
    pub reservation: Option<String>,
}

request! { BalanceRequest => app::BalanceRequest { reservation } }

/// Weighings of one test weight.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RepeatabilityRequest {
    /// Readings, mg, the weight reloaded for each; at least ten.
    pub readings_mg: Vec<f64>,
    /// Readability (display step) of the balance, mg.
    pub readability_mg: f64,
}

request! { RepeatabilityRequest => app::RepeatabilityRequest { readings_mg, readability_mg } }

/// The pile waiting for frames, and how many it has and needs.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Awaited {
    /// Which pile, from 1.
    pub pile: u32,
    /// Frames received.
    pub have: u32,
    /// Frames needed.
    pub wanted: u32,
}

answer! { flip_bench::rig::Awaited => Awaited { pile, have, wanted } }

/// A pile that is being made.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct PileInMaking {
    /// The measurement, by its job id.
    pub job: String,
    /// Which pile, from 1.
    pub pile: u32,
}

answer! { flip_bench::rig::PileInMaking => PileInMaking { job, pile } }

/// A held bench, on which nothing starts until a person resumes.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Held {
    /// Since when.
    pub at: Timestamp,
    /// Why it is held.
    pub reason: String,
    /// Who held it, if known.
    pub by: Option<String>,
}

answer! { flip_store::holds::Held => Held { at, reason, by } }

/// A latched bench, which nobody may use until a person has checked it.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Latch {
    /// Since when.
    pub at: Timestamp,
    /// Why, and what to check.
    pub reason: String,
    /// The weighing that caused it.
    pub weighing: Option<String>,
    /// Description of the bench: only a process with such a bench can clear the latch. Absent if
    /// unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bench: Option<BenchKind>,
}

answer! { flip_store::bench::Latch => Latch { at, reason, weighing, bench } }

/// Limits of a straight move.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct MotionLimits {
    /// Maximum speed, m/s.
    pub velocity_m_s: f64,
    /// Maximum acceleration, m/s^2.
    pub acceleration_m_s2: f64,
    /// Maximum jerk, m/s^3.
    pub jerk_m_s3: f64,
}

answer! { flip_core::domain::motion::MotionLimits => MotionLimits {
    velocity_m_s, acceleration_m_s2, jerk_m_s3,
} }

/// Result of a repeatability check.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Repeatability {
    /// The readings, mg.
    pub readings_mg: Vec<f64>,
    /// Their standard deviation, mg.
    pub sd_mg: f64,
    /// Readability (display step) of the balance, mg.
    pub readability_mg: f64,
}

answer! { flip_core::domain::bench_check::Repeatability => Repeatability {
    readings_mg, sd_mg, readability_mg,
} }

/// What a person checks before a dose.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Checklist {
    /// In order.
    pub items: Vec<String>,
    /// When the lab wrote it; absent while it is the one that ships.
    pub changed_at: Option<Timestamp>,
}

answer! { app::Checklist => Checklist { items, changed_at } }

/// A checklist to use from now on.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NewChecklist {
    /// In order, at most 20, each 1 to 200 characters; empty asks for nothing.
    pub items: Vec<String>,
}

request! { NewChecklist => app::NewChecklist { items } }
