//! Every number at which a decision turns, and why it is that number and no other.
//!
//! Grids, priors and numbers of simulations stand where they are used: they shape an estimate and
//! decide nothing by themselves.

// What can be judged at all.

/// Fewest runs beyond one for each powder. With fewer, days cannot be told from repeats: a day and
/// a repeat of at least three powders and days each take about a dozen.
pub const RUNS_MIN: usize = 12;
/// Most distinct names of a judged covariate: each is a coefficient of its own to fit, and a file
/// seldom has more than a few runs of each.
pub const LEVELS_MAX: usize = 50;
/// Share of runs that may lack a covariate. Gaps are filled by means, and beyond half of them the
/// fillings would outweigh what was measured.
pub(crate) const MISSING_MAX: f64 = 0.5;
/// Fewest sessions for which a wander can be separated from day effects: a smooth course has up to
/// five coefficients.
pub(crate) const WANDER_SESSIONS_MIN: usize = 6;
/// Fewest sessions that can be left out in turn: an interval over fewer resampled days is that of
/// one or two of them.
pub(crate) const HELD_OUT_SESSIONS_MIN: usize = 4;

// Is anything wrong, and what.

/// Accepted rate of false alarms: the convention of one in twenty, over all channels together.
pub(crate) const SIGNIFICANCE: f64 = 0.05;
/// Inclusion probability required to claim a cause: at most one in five claims of a calibrated
/// posterior is of the wrong cause, and days left out are asked as well before it is believed.
pub(crate) const CLAIM: f64 = 0.8;
/// The same where the campaign's covariates give another cause nearly the same course: the two are
/// then distinguished only by their forms, which are not known.
pub(crate) const CERTAIN: f64 = 0.95;
/// Correlation of courses above which two causes that share no covariate look alike: less than a
/// fifth of their variance is then left to tell them by.
pub(crate) const LOOK_ALIKE: f64 = 0.9;
/// Correlation of covariates worth reporting: below, an effect of one is mostly not one of the
/// other.
pub(crate) const MOVED_TOGETHER: f64 = 0.8;
/// Inclusion probability above which one of several possible causes is named: each that is left
/// out is wrong in nine of ten cases.
pub(crate) const WORTH_TELLING: f64 = 0.1;
/// Probability required to name a class of laws: more likely than all others together.
pub(crate) const NAMED_LAW: f64 = 0.5;

// What it is worth, and what to measure next.

/// Share of campaigns that must show an effect for it to count as detectable: the convention for
/// the power of a test.
pub(crate) const POWER: f64 = 0.8;
/// Difference that matters to a chemist, degrees: about the repeatability of a mean of five heaps.
pub(crate) const SETTLED_DEG: f64 = 1.0;
/// Chance of an answer from which a longer experiment is not worth its runs.
pub(crate) const ENOUGH: f64 = 0.95;
/// Share among the candidates that counts as an answer: causes that are not candidates keep some of
/// the rest, and [`CLAIM`] is asked of all of them.
pub(crate) const ANSWER: f64 = 0.9;

// Is it the computation.

/// Slope of the angle over a decade of settling time from which heaps count as creeping, degrees: a
/// tenth of the SD of a repeat, so it cannot pass for an effect.
pub const CREEP_DEG: f64 = 0.2;
/// Slope over a doubling of the substep or of the grains that counts as a defect, degrees: finer
/// steps and more grains change the model itself a little.
pub const STEP_DEG: f64 = 0.5;

/// Which columns follow from the measurement and are no conditions.
pub(crate) mod column {
    /// Fewest rows, and degrees of freedom within days: a correlation of fewer can be anything.
    pub(crate) const ROWS_MIN: usize = 10;
    pub(crate) const FREEDOM_MIN: usize = 10;
    /// Least t and least explained share of the scatter of repeats, where powders or values agree:
    /// far beyond what chance does in a file of a hundred columns.
    pub(crate) const STRONG_T: f64 = 5.0;
    pub(crate) const STRONG_SHARE: f64 = 0.2;
    /// Least t if the name indicates it: that reached by chance in one of forty columns.
    pub(crate) const NAMED_T: f64 = 2.0;
    /// Bounds on the slope between powders over that within, and on how well powders' means lie on
    /// a line: powders of different shape keep a heap's geometry to about a factor of two.
    pub(crate) const SAME_SLOPE: [f64; 2] = [0.5, 2.0];
    pub(crate) const ON_A_LINE: f64 = 0.8;
    /// Standard errors between the slope between powders and that of a condition, which is zero.
    pub(crate) const SLOPE_Z: f64 = 4.0;
    /// Least SD of powders' means over that of repeats: powders that are alike say nothing.
    pub(crate) const POWDERS_APART: f64 = 0.5;
    /// How far a column's mean may be from a powder's angle, degrees, to count as nearly the same:
    /// methods of reading one heap differ by as much.
    pub(crate) const NEARLY_DEG: f64 = 6.0;
    /// Share of the scatter of repeats explained and, in degrees or percent of a flow time, the
    /// scatter that no powder repeats to.
    pub(crate) const NEAR_ALL: f64 = 0.9;
    pub(crate) const REPEATS_TO: f64 = 0.4;
    pub(crate) const FLOW_REPEATS_TO: f64 = 2.0;
    /// Part of the scatter of repeats left, by rounding, by a column that is the angle less a mean.
    pub(crate) const ROUNDING: f64 = 0.25;
    /// Share explained by columns together, of which none does it alone.
    pub(crate) const TOGETHER: f64 = 0.7;
    /// Variance of powders' means over that of chance, below which a column does not depend on the
    /// powder: two standard deviations.
    pub(crate) const KNOWS_POWDERS: f64 = 4.0;
    /// Most distinct values of a column that may have been set by hand, if its name could belong to
    /// something other than the heap.
    pub(crate) const SET_VALUES_MAX: usize = 5;
    /// Share of rows that may lie in a class other than that of their angle: typing errors.
    pub(crate) const MISPLACED: f64 = 0.02;
    /// Chance that a condition shows such order, below which the column does not count as one: a
    /// file has up to a hundred columns, and few files may lose one by mistake.
    pub(crate) const ORDER_CHANCE: f64 = 1e-3;
}

/// What balance readings must show.
pub(crate) mod trace {
    /// Fewest readings that can be judged: about three doses of ten readings.
    pub const READINGS_MIN: usize = 30;
    /// Fewest shakes beyond the columns of the response: as many as runs of a campaign.
    pub(crate) const SPARE_SHAKES_MIN: usize = super::RUNS_MIN;
    /// Share of the structure that a cause must explain for its residuals to count as white: what
    /// leaves more wander than it explains is no explanation.
    pub(crate) const EXPLAINED_MIN: f64 = 0.5;
    /// Share of its log evidence over that of a wander, which every cause may have alongside it, by
    /// which a cause must lead every other: a smaller lead may be due to the forms chosen.
    pub(crate) const LEAD_MIN: f64 = 0.1;
    /// Share of simulated readings, which follow a law, that wander as much as those reported to
    /// follow none: the false alarms that [`SIGNIFICANCE`](super::SIGNIFICANCE) accepts.
    pub(crate) const LAWFUL: f64 = super::SIGNIFICANCE;
    /// Rise of the pitch before powder falls from which on a dose looked for an onset, degrees:
    /// more than a bench's pitch wanders by itself, less than any policy tips in search.
    pub(crate) const TIPPED_DEG: f64 = 5.0;
    /// Share of such doses from which on a law without an onset cannot be fitted.
    pub(crate) const TIPPED_SHARE: f64 = 0.25;
}
