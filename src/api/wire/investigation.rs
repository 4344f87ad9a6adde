//! Investigations of measured data.

use super::{BenchKind, Job, Labels, Report, Verdict};
use crate::app;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What to investigate. Everything has a default.
#[derive(Debug, Clone, PartialEq, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct InvestigationRequest {
    /// The runs as CSV text, one per row; default every stored measurement of an angle of repose,
    /// or none if `traces_csv` or shakes are given.
    ///
    /// Columns: `powder` (id or name) and `repose_deg`; with `repose_sd_deg` and `n`, the row is a
    /// summary of n runs. Conditions: `session` (the day), `order_in_session`, `method` (camera,
    /// manual), `operator`, `batch`, `plate`, `relative_humidity_pct`, `temperature_c`, `rest_min`,
    /// `container_age_d`, `funnel_height_mm`, `base_diameter_mm`, `poured_mass_g`, `flow_time_s`,
    /// `vibration_rms_m_s2`, `ioniser_on`, and any other column. Separators are commas, semicolons
    /// or tabs; decimals take a point or a comma; at most 20000 rows and 8 MiB. Empty cells, `NA`
    /// and the like are missing values. A refusal names the cell, such as `row[2].repose_deg`; the
    /// header is row 1. The report's `files` lists how each column was interpreted.
    pub measurements_csv: Option<String>,
    /// Balance readings of weighings as CSV text, one per row; default none.
    ///
    /// Columns: `weighing_id`, `t_s` and `balance_mg`. Conditions: `stable`, `powder`, `session`
    /// (the day), `shake_index` (shakes so far), `shake_mm`, `spoon_pitch_deg`, `spoon_fill_mg`,
    /// `target_mg`, `relative_humidity_pct`, `vibration_rms_m_s2`, and `kind`: `dose`, or for a
    /// control log `zero` (empty pan) or `standard` (a standard mass). Formats and limits are those
    /// of `measurements_csv`.
    pub traces_csv: Option<String>,
    /// Shakes of weighings as CSV text, one per row, in the format of `/v1/shakes.csv`; default
    /// none. They are compared with what the calibrated simulator lets fall in the same steps.
    pub shakes_csv: Option<String>,
    /// Stored shakes of weighings in place of a file; default none.
    pub shakes: Option<StoredShakes>,
    /// Maximum spoonfuls of each powder to replay, 156 (more beside other data) to 100000; default
    /// 600. Where nothing is wrong a third of them are.
    pub budget_replays: Option<u32>,
    /// Order of dates such as 2/3/2026 and 26/02/21, `day_first`, `month_first` or `year_first`;
    /// needed where the column is ambiguous.
    pub dates: Option<DateOrder>,
    /// Null campaigns, in which nothing is wrong, to compare with, 99 to 9999; default 499.
    pub simulations: Option<u32>,
    /// Maximum heaps to simulate, 0 to 10000; default 60. They check the simulator's own numerics
    /// and, if an extension is accepted, find and verify its amplitude; with 0 the amplitude is
    /// read from a table and not verified.
    pub budget_runs: Option<u32>,
    /// Seed; default 1.
    pub seed: Option<u64>,
    /// What the caller writes on it, to find it again.
    #[serde(default)]
    pub labels: Labels,
}

request! { InvestigationRequest => app::InvestigationRequest {
    measurements_csv, traces_csv, shakes_csv, shakes, budget_replays, dates, simulations,
    budget_runs, seed, labels,
} }

/// Which stored shakes to judge. Empty: all.
#[derive(Debug, Clone, PartialEq, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct StoredShakes {
    /// Only of this powder.
    pub powder: Option<String>,
    /// Only of this lot.
    pub lot: Option<String>,
    /// Only of weighings on this kind of bench, and imported ones; needed where shakes of several
    /// kinds are stored.
    pub bench: Option<BenchKind>,
}

request! { StoredShakes => app::StoredShakes { powder, lot, bench } }

/// An investigation: its job, its data, and its findings once it has succeeded.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Investigation {
    /// The job; the investigation has the same id.
    pub job: Job,
    /// Powder ids, in the order of the files.
    pub powders: Vec<String>,
    /// Number of runs, including the repeats behind summaries.
    pub runs: u32,
    /// Number of days on which runs were made.
    pub sessions: u32,
    /// Weighings whose balance readings it uses, including controls.
    #[serde(default)]
    pub weighings: u32,
    /// Spoonfuls whose shakes it judges.
    #[serde(default)]
    pub spoonfuls: u32,
    /// Recorded conditions. The report's `files` lists the columns left out, and why.
    pub covariates: Vec<String>,
    /// Number of null campaigns, in which nothing is wrong, that it compares with.
    pub simulations: u32,
    /// Maximum heaps it may simulate.
    pub budget_runs: u32,
    /// Seed.
    pub seed: u64,
    /// Simulator version under test.
    pub simulator: String,
    /// Whether anything is wrong, and whether its cause can be named; absent until it has
    /// succeeded, like the following fields.
    pub verdict: Option<Verdict>,
    /// Probability of equally strong evidence for any cause if nothing is wrong.
    pub p_value: Option<f64>,
    /// The finding, in plain words.
    pub sentence: Option<String>,
    /// The full report; also absent from lists.
    pub report: Option<Report>,
}

answer! { app::Investigation => Investigation {
    job, powders, runs, sessions, weighings, spoonfuls, covariates, simulations, budget_runs, seed, simulator,
    verdict, p_value, sentence, report,
} }

/// Order of day, month and year in a date such as 2/3/2026.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum DateOrder {
    /// 2 March.
    DayFirst,
    /// 3 February.
    MonthFirst,
    /// With two-digit years: 26/02/21 is 21 February 2026.
    YearFirst,
}

request! { enum DateOrder => app::DateOrder { DayFirst, MonthFirst, YearFirst } }
