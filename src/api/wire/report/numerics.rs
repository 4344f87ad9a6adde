//! How sure a report is of its own computation.

use serde::Serialize;
use utoipa::ToSchema;

/// Defects of the simulator, found without data.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Numerics {
    /// The set whose heaps were poured.
    pub set: FitSet,
    /// How the angle depends on each setting of the computation.
    pub dependences: Vec<Dependence>,
}

answer! { flip_discover::report::Numerics => Numerics { set, dependences } }

/// A set of the fit.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct FitSet {
    /// Powder id.
    pub powder: String,
    /// Parameter set id.
    pub set: String,
    /// Where the set comes from.
    pub source: String,
}

answer! { flip_discover::report::FitSet => FitSet { powder, set, source } }

/// The varied setting of the computation.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Varied {
    /// Longest wait for rest.
    SettlingTime,
    /// Substep of the solver.
    Substep,
    /// Grains in the heap.
    Particles,
}

answer! { flip_discover::report::Varied => enum Varied { SettlingTime, Substep, Particles } }

/// How the angle depends on one setting of the computation.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Dependence {
    /// The varied setting.
    pub varied: Varied,
    /// Degrees per decade of settling time, or per doubling of the others.
    pub slope_deg: f64,
    /// 99 % interval.
    pub ci99: [f64; 2],
    /// Whether it exceeds the bound: for the settling time, creep.
    pub is_defect: bool,
    /// Number of heaps simulated.
    pub runs: u32,
}

answer! { flip_discover::report::Dependence => Dependence {
    varied, slope_deg, ci99, is_defect, runs,
} }

/// Campaigns of the same design with nothing wrong.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct NullCheck {
    /// Number of campaigns this one was compared with; 0 where there was nothing to judge.
    pub campaigns: u32,
    /// The statistic of this campaign; absent where there was nothing to judge.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub statistic: Option<f64>,
    /// Exceeded by one in twenty of them; absent where there was nothing to judge.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub threshold95: Option<f64>,
}

answer! { flip_discover::report::NullCheck => NullCheck { campaigns, statistic, threshold95 } }
