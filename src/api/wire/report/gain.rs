//! What the extension of a report gains.

use serde::Serialize;
use utoipa::ToSchema;

/// Gain from an extension.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Gain {
    /// Days left out in turn: the number that decides.
    pub held_out: HeldOut,
    /// Powders left out in turn.
    pub by_powder: Option<HeldOut>,
    /// The highest and the lowest fifth of the covariate left out in turn.
    pub by_range: Option<HeldOut>,
    /// Mean log probability density of what was left out.
    pub log_score: LogScore,
    /// Share of what was left out within the 90 % interval.
    pub coverage90: Coverage,
    /// Error of weighings; absent where no policy was trained.
    pub weighing_error_mg: Option<WeighingGain>,
    /// Whether the extension won.
    pub accepted: bool,
}

answer! { flip_discover::report::Gain => Gain {
    held_out, by_powder, by_range, log_score, coverage90, weighing_error_mg, accepted,
} }

/// Errors on what was left out.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct HeldOut {
    /// Root mean square error of the simulator as it was.
    pub rmse_before: f64,
    /// Root mean square error of the extended simulator.
    pub rmse_after: f64,
    /// 95 % interval of the difference, before less after, over days.
    pub ci95: [f64; 2],
    /// `deg`; for flow times `%`.
    pub unit: String,
    /// Runs left out.
    pub n: u32,
}

answer! { flip_discover::report::HeldOut => HeldOut { rmse_before, rmse_after, ci95, unit, n } }

/// Log scores.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct LogScore {
    /// Nats a run.
    pub before: f64,
    /// Nats a run.
    pub after: f64,
    /// 95 % interval of the difference, after less before, over days.
    pub ci95: [f64; 2],
}

answer! { flip_discover::report::LogScore => LogScore { before, after, ci95 } }

/// Coverage of 90 % intervals.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Coverage {
    /// Coverage of the simulator as it was.
    pub before: f64,
    /// Coverage of the extended simulator.
    pub after: f64,
}

answer! { flip_discover::report::Coverage => Coverage { before, after } }

/// Mean absolute errors of weighings, mg.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct WeighingGain {
    /// Policy of the simulator as it was.
    pub before: f64,
    /// Policy adapted on the extended one.
    pub after: f64,
    /// Adapted as long on an extension without effect.
    pub sham: f64,
    /// Adapted on the truth, where it is known.
    pub oracle: Option<f64>,
    /// 95 % interval of before less after.
    pub ci95: [f64; 2],
}

answer! { flip_discover::report::WeighingGain => WeighingGain {
    before, after, sham, oracle, ci95,
} }
