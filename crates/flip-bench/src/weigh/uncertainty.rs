//! Uncertainty of a net weight: readings taken while nothing moved show how far the zero may have
//! drifted.
//!
//! ```text
//! U = |B| t + 2 sqrt(u_0^2 + u_1^2 + 2 d^2 / 12 + v_B t^2)
//! ```
//!
//! | symbol | what | unit |
//! |---|---|---|
//! | u_0, u_1 | of the mean after the tare and of the mean of the final watch: what their wander leaves, at least the repeatability that was checked | mg |
//! | d | step of the display: each of the two is rounded to it (rectangular) | mg |
//! | B, v_B | drift that the readings prove, and variance of what they leave open | mg/s, mg^2/s^2 |
//! | t | from the one mean to the other | s |
//!
//! *Wander.* Readings consist of a level, a common slope, independent noise, and a wander with a
//! memory of `MEMORY_S`; the sums of squares about the slope and between neighbours separate the
//! last two. Its variance is raised by n / (n - 2), because only n times that memory was observed
//! (at most fourfold).
//!
//! *Drift.* The slopes of every watch, and that from the watch before the tare to the one after it,
//! are weighted by the effect of wander on each. One digit of a display is not a drift: a priori
//! the zero moves by as little as half of its own wander in a minute (SD; at least an eighth of a
//! digit), and with a probability of 0.05 it drifts by any amount (Cauchy, ten times as wide; an
//! enclosed A&D HR-100A crept by 1.7 to 4.6 mg a minute while it wandered by 0.5). The posterior
//! given the readings has mean B and variance v_B. A drift that is neither proven nor slow is not
//! covered: the readings cannot reveal it.
//!
//! Buoyancy and a balance that is not adjusted are not included.

use flip_core::domain::rest::{MEMORY_S, Rest};

/// Coverage factor of the expanded uncertainty.
const COVERAGE: f64 = 2.0;
/// Maximum factor by which the wander's variance is raised for a short observation.
const RAISED_MAX: f64 = 4.0;
/// A zero that does not drift moves by this fraction of its wander in a minute (SD).
const SLOW: f64 = 0.5;
/// One that does drift, by this many times its wander in a minute (Cauchy).
const FAST: f64 = 5.0;
/// Prior probability of drift.
const DRIFTS: f64 = 0.05;
/// Minimum wander assumed, in steps of the display: less would not show.
const WANDER_STEPS_MIN: f64 = 0.25;

/// Readings taken while nothing moved.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Watched {
    /// The vial before it was tared, and the display at the tare, mg.
    pub(super) before: Option<(Rest, Option<f64>)>,
    /// After the tare.
    pub(super) zero: Option<Rest>,
    /// At the end.
    pub(super) last: Option<Rest>,
}

/// Scatter of readings at rest.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Scatter {
    /// Variance of the part that fades within `MEMORY_S`, mg^2.
    wander_mg2: f64,
    /// Variance of each reading's own noise, mg^2.
    noise_mg2: f64,
}

/// A slope and its sources of uncertainty: in units of the wander's variance, in units of the
/// noise's, and its own.
#[derive(Debug, Clone, Copy)]
struct Slope {
    mg_s: f64,
    wander: f64,
    noise: f64,
    own: f64,
}

/// Posterior of the drift, mg/s and mg^2/s^2.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Drift {
    mean: f64,
    variance: f64,
}

impl Watched {
    fn rests(&self) -> impl Iterator<Item = Rest> {
        [self.before.map(|it| it.0), self.zero, self.last].into_iter().flatten()
    }

    fn slopes(&self, step_mg: f64) -> Vec<Slope> {
        let mut slopes: Vec<Slope> =
            self.rests().filter(|it| it.tilt > 0.0).map(Slope::within).collect();
        if let (Some((before, Some(tare_mg))), Some(zero)) = (self.before, self.zero) {
            slopes.extend(Slope::between(&before, tare_mg, &zero, step_mg));
        }
        slopes
    }
}

impl Slope {
    fn within(rest: Rest) -> Self {
        Self { mg_s: rest.slope_mg_s, wander: rest.tilt, noise: 1.0 / rest.times_s2, own: 0.0 }
    }

    /// From the vial before the tare, minus the tare, to the zero after it.
    fn between(before: &Rest, tare_mg: f64, zero: &Rest, step_mg: f64) -> Option<Self> {
        let seconds = zero.at_s - before.at_s;
        let per_s2 = 1.0 / seconds.powi(2);
        let noise = (1.0 / before.readings as f64 + 1.0 / zero.readings as f64) * per_s2;
        let mg_s = (zero.mean_mg - (before.mean_mg - tare_mg)) / seconds;
        let wander = (before.level + zero.level) * per_s2;
        (seconds > 0.0).then_some(Self { mg_s, wander, noise, own: step_mg.powi(2) / 6.0 * per_s2 })
    }

    fn variance(&self, scatter: &Scatter, step_mg: f64) -> f64 {
        // A display that shows a single number hides what it rounds.
        let noise_mg2 = scatter.noise_mg2.max(step_mg.powi(2) / 12.0);
        scatter.wander_mg2 * self.wander + noise_mg2 * self.noise + self.own
    }
}

/// The mean of the slopes, weighted by the effect of wander on each; and its variance, given the
/// scatter of the readings.
fn pooled(slopes: &[Slope], variance: impl Fn(&Slope) -> f64) -> (f64, f64) {
    let all: f64 = slopes.iter().map(|it| 1.0 / it.wander).sum();
    let share = |it: &Slope| 1.0 / it.wander / all;
    let mean = slopes.iter().map(|it| share(it) * it.mg_s).sum();
    (mean, slopes.iter().map(|it| share(it).powi(2) * variance(it)).sum())
}

impl Scatter {
    /// By the method of moments, about a common slope.
    fn of(rests: &[Rest], slope_mg_s: f64) -> Self {
        let about = |it: &Rest| {
            it.squares_mg2 - slope_mg_s * (2.0 * it.slope_mg_s - slope_mg_s) * it.times_s2
        };
        let next = |it: &Rest| {
            (it.steps[0] - slope_mg_s * (2.0 * it.steps[1] - slope_mg_s * it.steps[2])) / 2.0
        };
        let sum = |of: &dyn Fn(&Rest) -> f64| rests.iter().map(of).sum::<f64>();
        let (about, next) = (sum(&about), sum(&next));
        let neighbours = sum(&|it| it.readings as f64 - 1.0);
        let apart = sum(&|it| it.readings as f64 * (1.0 - it.level));
        let forgotten = sum(&|it| it.forgotten);
        if neighbours < 1.0 || apart - forgotten < 1e-9 {
            return Self { wander_mg2: 0.0, noise_mg2: 0.0 };
        }
        let wander_mg2 = ((about - next) / (apart - forgotten)).max(0.0);
        let memories = sum(&|it| it.seconds) / MEMORY_S;
        let raised =
            if memories > 2.0 { (memories / (memories - 2.0)).min(RAISED_MAX) } else { RAISED_MAX };
        Self {
            wander_mg2: raised * wander_mg2,
            noise_mg2: ((next - forgotten * wander_mg2) / neighbours).max(0.0),
        }
    }

    /// Variance of the mean of such readings, mg^2.
    fn of_mean(&self, rest: &Rest) -> f64 {
        self.wander_mg2 * rest.level + self.noise_mg2 / rest.readings as f64
    }
}

/// Posterior given readings with this slope and variance.
fn believed(slope_mg_s: f64, variance: f64, wander_mg: f64) -> Drift {
    let per_s = wander_mg / 60.0;
    let (slow, fast) = ((SLOW * per_s).powi(2), (FAST * per_s).powi(2) + variance);
    let density = |variance: f64| {
        libm::exp(-slope_mg_s.powi(2) / 2.0 / variance) / (std::f64::consts::TAU * variance).sqrt()
    };
    let drifts = DRIFTS / (std::f64::consts::PI * fast.sqrt() * (1.0 + slope_mg_s.powi(2) / fast));
    let stays = (1.0 - DRIFTS) * density(slow + variance);
    let chance = drifts / (drifts + stays);
    let kept = slow / (slow + variance);
    let mean = slope_mg_s * (chance + (1.0 - chance) * kept);
    let square = chance * (slope_mg_s.powi(2) + variance)
        + (1.0 - chance) * ((kept * slope_mg_s).powi(2) + kept * variance);
    Drift { mean, variance: (square - mean.powi(2)).max(0.0) }
}

/// The drift, and the scatter about it.
fn drift(watched: &Watched, step_mg: f64) -> (Drift, Scatter) {
    let slopes = watched.slopes(step_mg);
    let rests: Vec<Rest> = watched.rests().collect();
    if slopes.is_empty() {
        return (Drift { mean: 0.0, variance: 0.0 }, Scatter::of(&rests, 0.0));
    }
    let (slope_mg_s, _) = pooled(&slopes, |_| 0.0);
    let scatter = Scatter::of(&rests, slope_mg_s);
    let (_, variance) = pooled(&slopes, |it| it.variance(&scatter, step_mg));
    let wander_mg = scatter.wander_mg2.sqrt().max(WANDER_STEPS_MIN * step_mg);
    (believed(slope_mg_s, variance, wander_mg), scatter)
}

/// Expanded uncertainty of a net weight, mg: the formula above.
///
/// `repeatability_mg` is the checked one, if there is one. If nothing was watched, each of the two
/// readings counts with 0.41 steps, as in USP <41>.
pub(super) fn uncertainty_mg(
    watched: &Watched,
    repeatability_mg: Option<f64>,
    step_mg: f64,
) -> f64 {
    let (drift, scatter) = drift(watched, step_mg);
    let checked_mg2 = repeatability_mg.unwrap_or(0.0).powi(2);
    let of = |rest: Option<Rest>| {
        let unseen_mg2 = scatter.wander_mg2.max((0.41 * step_mg).powi(2));
        rest.map_or(unseen_mg2, |rest| scatter.of_mean(&rest)).max(checked_mg2)
    };
    let seconds = watched.zero.zip(watched.last).map_or(0.0, |(zero, last)| last.at_s - zero.at_s);
    let variance = of(watched.zero)
        + of(watched.last)
        + step_mg.powi(2) / 6.0
        + drift.variance * seconds.powi(2);
    (drift.mean * seconds).abs() + COVERAGE * variance.sqrt()
}

/// Standard uncertainty of the mean of a watch, mg, from its readings and those watched before it: a
/// display that happens to stand still for a few seconds does not say that it does not wander.
/// `None` if the watch is too short to tell.
pub(super) fn of_mean_mg(rest: &Rest, watched: &Watched) -> Option<f64> {
    let rests: Vec<Rest> = watched.rests().chain([*rest]).collect();
    (rest.seconds > 0.0).then(|| Scatter::of(&rests, 0.0).of_mean(rest).sqrt())
}

/// The slope of a watch in mg/min, if it is more than twice the effect of wander and rounding;
/// else 0.
pub(super) fn proven_mg_min(rest: &Rest, watched: &Watched, step_mg: f64) -> f64 {
    let (_, scatter) = drift(watched, step_mg);
    let slope = Slope::within(*rest);
    let is_proven =
        rest.tilt > 0.0 && slope.mg_s.abs() > 2.0 * slope.variance(&scatter, step_mg).sqrt();
    if is_proven { 60.0 * slope.mg_s } else { 0.0 }
}

#[cfg(test)]
#[path = "uncertainty_tests.rs"]
mod tests;
