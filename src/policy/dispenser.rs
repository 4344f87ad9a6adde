//! A dispenser without a network: a model of what a shake lets fall, identified while it doses, and a look ahead.
//!
//! *Model.* A spoon at pitch p lets go of what stands above its slope of rest. Shaken with amplitude A it could let go of G in all, and has
//! let go of M; of the rest one shake takes a share:
//!
//! ```text
//! G = slope width softplus((p + reach ln(A / 1 mm) - onset) / width)
//! mean of a shake = max(G - M, 0) (1 - exp(-(A / stroke)^bend))
//! sqrt(mass of a shake) ~ N(sqrt(mean), floor^2 + scatter^2 mean)
//! ```
//!
//! *Identification.* The onset, the slope and the stroke are another powder's, or another spoonful's, each time. [`GUESSES`] of them are drawn
//! from what many simulated spoons had ([`Response`]) and weighted with what the balance has shown since (a particle filter whose particles
//! do not move). The balance's own rounding counts in the likelihood, and its tails are those of Student's t with four degrees of freedom, as
//! avalanches happen.
//!
//! *Decision.* Each possible action is played to the end of the weighing with [`ROLLOUTS`] of the guesses, the later steps by a rule that aims
//! at the share of the missing mass which is best for masses scattered like that (`Aims`, by dynamic programming). The action whose
//! expected loss is least is taken: a rollout algorithm (Bertsekas, Tesauro and Wu 1997). Too much costs [`Response::overdose_factor`] times
//! as much as too little, for it cannot be taken back.
//!
//! Log-linear models of mg per tap against tilt, the usual ones, do not describe these spoons: what falls depends on what has fallen
//! (`docs/dispenser.md`).

use super::controller::Done;
use super::episode::{Ending, ON_TARGET_MG, Rules};
use super::observation::Observation;
use crate::domain::bench::{Action, INCLINE_CHANGE_DEG_MAX, SHAKE_MM_MAX};
use crate::domain::{FieldError, bounded};
use crate::stats::normal::quantile;
use serde::{Deserialize, Serialize};

/// Guesses of the spoon at hand.
const GUESSES: usize = 384;
/// Guesses with which each action is played to the end.
const ROLLOUTS: usize = 96;
/// Changes of the pitch among which it chooses, degrees.
const CHANGES_DEG: [f64; 9] = [-8.0, -5.0, -3.0, -1.5, 0.0, 2.0, 4.0, 6.0, 8.0];
/// Amplitudes among which it chooses, mm.
const SHAKES_MM: [f64; 7] = [0.0, 1.0, 2.0, 4.0, 7.0, 11.0, SHAKE_MM_MAX];
/// The rule of the later steps shakes with this amplitude, mm, and where the pitch cannot follow with the largest or the smallest.
const USUAL_MM: f64 = 4.0;

/// What simulated spoons do, over powders and spoonfuls: the prior of a dispenser, and what it holds to be a loss.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Response {
    /// Pitch at which a spoon begins to let go, degrees: mean and standard deviation.
    pub onset_deg: [f64; 2],
    /// ln of the mass let go by each further degree, mg: mean and standard deviation.
    pub ln_slope_mg_deg: [f64; 2],
    /// ln of the amplitude that takes most of what is loose, mm: mean and standard deviation.
    pub ln_stroke_mm: [f64; 2],
    /// Correlations of onset and slope, of onset and stroke, of slope and stroke: a spoon that begins late lets go of more by each degree.
    pub correlations: [f64; 3],
    /// Exponent of the amplitude over the stroke.
    pub bend: f64,
    /// Degrees that a shake of e mm is worth more than one of 1 mm.
    pub reach_deg: f64,
    /// Degrees over which the beginning is spread.
    pub width_deg: f64,
    /// Scatter of the root of a small mass, mg^(1/2).
    pub floor: f64,
    /// Scatter of the root of a mass in shares of the root of its mean; twice this is the coefficient of variation.
    pub scatter: f64,
    /// Factor on the scatter: the spoon is not the model.
    pub caution: f64,
    /// Mass that a spoon holds, mg: nothing lets go of more.
    pub held_mg: f64,
    /// How much worse than too little too much is.
    pub overdose_factor: f64,
}

/// The dispenser: [`Response`] and the tables made from it.
#[derive(Debug, Clone)]
pub struct Dispenser {
    response: Response,
    guesses: Vec<Guess>,
    aims: Aims,
}

impl PartialEq for Dispenser {
    fn eq(&self, other: &Self) -> bool {
        self.response == other.response
    }
}

/// One idea of the spoon at hand.
#[derive(Debug, Clone, Copy)]
struct Guess {
    onset_deg: f64,
    slope_mg_deg: f64,
    stroke_mm: f64,
}

/// A moment of a weighing, as it is played in thought.
#[derive(Debug, Clone, Copy)]
struct Moment {
    pitch_deg: f64,
    poured_mg: f64,
    missing_mg: f64,
    left: u32,
}

impl Response {
    /// What `benches/dispenser/fit.py` found for 250 courses of fifty calibrated sets (`examples/shake_response.rs`).
    pub const FITTED: Self = Self {
        onset_deg: [-3.42, 36.06],
        ln_slope_mg_deg: [-0.39, 0.71],
        ln_stroke_mm: [4.53, 1.09],
        correlations: [0.77, 0.54, 0.64],
        bend: 0.45,
        reach_deg: 3.1,
        width_deg: 0.31,
        floor: 0.095,
        scatter: 0.309,
        caution: 1.5,
        held_mg: 40.0,
        overdose_factor: 2.0,
    };

    /// The response if each number is within its bounds.
    ///
    /// # Errors
    /// The first that is not, by name.
    pub fn checked(self) -> Result<Self, FieldError> {
        bounded("onset_deg", self.onset_deg[0], -90.0, 90.0, "deg")?;
        bounded("onset_deg", self.onset_deg[1], 0.0, 45.0, "deg")?;
        bounded("ln_slope_mg_deg", self.ln_slope_mg_deg[0], -7.0, 7.0, "")?;
        bounded("ln_slope_mg_deg", self.ln_slope_mg_deg[1], 0.0, 3.0, "")?;
        bounded("ln_stroke_mm", self.ln_stroke_mm[0], -3.0, 9.0, "")?;
        bounded("ln_stroke_mm", self.ln_stroke_mm[1], 0.0, 3.0, "")?;
        self.correlations.iter().try_for_each(|c| bounded("correlations", *c, -0.99, 0.99, "").map(|_| ()))?;
        if self.roots().iter().flatten().any(|root| root.is_nan()) {
            return Err(FieldError::new("correlations", "are not those of any three numbers: bring them nearer to 0"));
        }
        bounded("bend", self.bend, 0.05, 5.0, "")?;
        bounded("reach_deg", self.reach_deg, 0.0, 20.0, "deg")?;
        bounded("width_deg", self.width_deg, 0.01, 20.0, "deg")?;
        bounded("floor", self.floor, 0.01, 5.0, "mg^(1/2)")?;
        bounded("scatter", self.scatter, 0.01, 2.0, "")?;
        bounded("caution", self.caution, 0.1, 10.0, "")?;
        bounded("held_mg", self.held_mg, 1.0, 1e6, "mg")?;
        bounded("overdose_factor", self.overdose_factor, 1.0, 100.0, "")?;
        Ok(self)
    }

    /// The lower triangle whose product with its transpose has these correlations; not a number if there is none.
    fn roots(&self) -> [[f64; 3]; 3] {
        let [ab, ac, bc] = self.correlations;
        let b = (1.0 - ab * ab).sqrt();
        let cb = (bc - ab * ac) / b;
        [[1.0, 0.0, 0.0], [ab, b, 0.0], [ac, cb, (1.0 - ac * ac - cb * cb).sqrt()]]
    }

    /// Loss of an ending with so much missing, mg; negative is too much.
    fn loss(&self, missing_mg: f64) -> f64 {
        if missing_mg < 0.0 { -self.overdose_factor * missing_mg } else { missing_mg }
    }

    /// Scatter of the root of a mass of this mean.
    fn sd(&self, mean_mg: f64) -> f64 {
        (self.floor.powi(2) + (self.caution * self.scatter).powi(2) * mean_mg).sqrt()
    }

    /// A mass of this mean, `z` standard deviations from the middle of its root.
    fn draw(&self, mean_mg: f64, z: f64) -> f64 {
        (mean_mg.sqrt() + z * self.sd(mean_mg)).max(0.0).powi(2)
    }
}

impl Guess {
    /// What a shake there could let go of in all, mg.
    fn loose_mg(&self, r: &Response, pitch_deg: f64, shake_mm: f64) -> f64 {
        let x = (pitch_deg + r.reach_deg * libm::log(shake_mm) - self.onset_deg) / r.width_deg;
        let softplus = if x > 30.0 { x } else { libm::log1p(libm::exp(x)) };
        (self.slope_mg_deg * r.width_deg * softplus).min(r.held_mg)
    }

    /// Share of it that one shake takes.
    fn share(&self, r: &Response, shake_mm: f64) -> f64 {
        -libm::expm1(-libm::pow(shake_mm / self.stroke_mm, r.bend))
    }

    /// Mean of a shake, mg.
    fn mean_mg(&self, r: &Response, pitch_deg: f64, shake_mm: f64, poured_mg: f64) -> f64 {
        if shake_mm <= 0.0 {
            return 0.0;
        }
        (self.loose_mg(r, pitch_deg, shake_mm) - poured_mg).max(0.0) * self.share(r, shake_mm)
    }

    /// The pitch at which a usual shake has this mean, degrees.
    fn pitch_for(&self, r: &Response, mean_mg: f64, poured_mg: f64) -> f64 {
        let loose = poured_mg + mean_mg / self.share(r, USUAL_MM);
        let y = loose.min(r.held_mg) / (self.slope_mg_deg * r.width_deg);
        let x = if y > 30.0 { y } else { libm::log(libm::expm1(y.max(1e-9))) };
        self.onset_deg - r.reach_deg * libm::log(USUAL_MM) + r.width_deg * x
    }
}

impl Dispenser {
    /// A dispenser with this prior.
    pub fn new(response: Response) -> Self {
        let roots = response.roots();
        let guess = |k: usize| {
            let z = [2, 3, 5].map(|base| quantile(radical_inverse(k + 1, base)));
            let [onset, slope, stroke] = roots.map(|row| (0..3).map(|j| row[j] * z[j]).sum::<f64>());
            let of = |[mean, sd]: [f64; 2], by: f64| mean + sd * by;
            Guess {
                onset_deg: of(response.onset_deg, onset),
                slope_mg_deg: libm::exp(of(response.ln_slope_mg_deg, slope)),
                stroke_mm: libm::exp(of(response.ln_stroke_mm, stroke)),
            }
        };
        Self { response, guesses: (0..GUESSES).map(guess).collect(), aims: Aims::new(&response) }
    }

    /// Its prior.
    pub fn response(&self) -> &Response {
        &self.response
    }

    /// The action after these steps.
    pub(super) fn propose(&self, done: &[Done], seen: &Observation, rules: &Rules) -> Action {
        let guesses = self.resampled(&self.weights(done));
        let moment = Moment {
            pitch_deg: seen.pitch_deg,
            poured_mg: seen.reading_mg.max(0.0),
            missing_mg: seen.missing_mg(),
            left: rules.steps_max.saturating_sub(done.len() as u32).max(1),
        };
        let change = |change: f64| {
            let pitch = (seen.pitch_deg + change).clamp(rules.pitch.lower_deg, rules.pitch.upper_deg);
            pitch - seen.pitch_deg
        };
        let actions = CHANGES_DEG
            .iter()
            .flat_map(|by| SHAKES_MM.map(|shake_mm| Action { incline_change_deg: change(*by), shake_mm }));
        let rated = actions.map(|action| (self.expected_loss(&guesses, moment, action, rules), action));
        rated.min_by(|a, b| a.0.total_cmp(&b.0)).map_or_else(Action::default, |(_, action)| action)
    }

    /// Weight of each guess after what the balance has shown.
    fn weights(&self, done: &[Done]) -> Vec<f64> {
        let r = &self.response;
        let log = |guess: &Guess| -> f64 {
            let shakes = done.iter().filter(|step| step.action.executed_shake_mm() > 0.0);
            let one = |step: &Done| {
                let mean =
                    guess.mean_mg(r, step.after.pitch_deg, step.action.shake_mm, step.before.reading_mg.max(0.0));
                let gained = step.after.reading_mg - step.before.reading_mg;
                let sd = r.sd(mean);
                // Of a squared normal number, and of two readings rounded to a mg, which is what a coarse balance shows.
                let variance = 4.0 * mean * sd * sd + 2.0 * sd.powi(4) + 1.0 / 6.0;
                let z2 = (gained - mean - sd * sd).powi(2) / variance;
                -2.5 * libm::log1p(z2 / 4.0) - 0.5 * libm::log(variance)
            };
            shakes.map(one).sum()
        };
        let logs: Vec<f64> = self.guesses.iter().map(log).collect();
        let largest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        logs.iter().map(|log| libm::exp(log - largest)).collect()
    }

    /// [`ROLLOUTS`] guesses by their weights, at even distances.
    fn resampled(&self, weights: &[f64]) -> Vec<Guess> {
        let sum: f64 = weights.iter().sum();
        let (mut k, mut reached) = (0, weights[0]);
        let at = |j: usize| (j as f64 + 0.5) / ROLLOUTS as f64 * sum;
        let mut take = |goal: f64| {
            while reached < goal && k + 1 < weights.len() {
                k += 1;
                reached += weights[k];
            }
            self.guesses[k]
        };
        (0..ROLLOUTS).map(|j| take(at(j))).collect()
    }

    /// Mean loss of an action over the guesses, each played to the end.
    fn expected_loss(&self, guesses: &[Guess], now: Moment, action: Action, rules: &Rules) -> f64 {
        let play = |(j, guess): (usize, &Guess)| {
            let mut moment = self.after(guess, now, now.pitch_deg + action.incline_change_deg, action.shake_mm, j);
            while moment.left > 0 && !(rules.ending == Ending::OnTarget && moment.missing_mg < ON_TARGET_MG / 2.0) {
                let (pitch_deg, shake_mm) = self.usual(guess, &moment, rules);
                moment = self.after(guess, moment, pitch_deg, shake_mm, j);
            }
            self.response.loss(moment.missing_mg)
        };
        guesses.iter().enumerate().map(play).sum::<f64>() / guesses.len() as f64
    }

    /// A step in thought; the `j`-th rollout draws the same numbers whatever it does.
    fn after(&self, guess: &Guess, now: Moment, pitch_deg: f64, shake_mm: f64, j: usize) -> Moment {
        let mean = guess.mean_mg(&self.response, pitch_deg, shake_mm, now.poured_mg);
        let z = quantile(radical_inverse(j + 1, PRIMES[now.left as usize % PRIMES.len()]));
        let mass = if mean > 0.0 { self.response.draw(mean, z) } else { 0.0 };
        Moment { pitch_deg, poured_mg: now.poured_mg + mass, missing_mg: now.missing_mg - mass, left: now.left - 1 }
    }

    /// The rule of the later steps: the pitch at which a usual shake has the mean that is aimed at, as near as the spoon can come.
    fn usual(&self, guess: &Guess, now: &Moment, rules: &Rules) -> (f64, f64) {
        let r = &self.response;
        let aim = self.aims.of(now.left, now.missing_mg);
        if aim <= 0.0 {
            return (now.pitch_deg, 0.0);
        }
        let wanted = guess.pitch_for(r, aim, now.poured_mg);
        let lower = (now.pitch_deg - INCLINE_CHANGE_DEG_MAX).max(rules.pitch.lower_deg);
        let upper = (now.pitch_deg + INCLINE_CHANGE_DEG_MAX).min(rules.pitch.upper_deg);
        let pitch_deg = wanted.clamp(lower, upper);
        let shake_mm = match wanted {
            w if w > upper => SHAKE_MM_MAX,
            w if w < lower => SHAKES_MM[1],
            _ => USUAL_MM,
        };
        (pitch_deg, shake_mm)
    }
}

/// Bases of the numbers that rollouts draw, a base for each step left.
const PRIMES: [usize; 12] = [7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47];

/// The `index`-th number of van der Corput's sequence of a base, within 0..1.
fn radical_inverse(index: usize, base: usize) -> f64 {
    let (mut rest, mut digit, mut value) = (index, 1.0 / base as f64, 0.0);
    while rest > 0 {
        value += (rest % base) as f64 * digit;
        rest /= base;
        digit /= base as f64;
    }
    value
}

/// The mean to aim at, by steps left and missing mass, if any mean could be had: for masses scattered as [`Response`] says
///
/// ```text
/// V_0(m) = loss(m)     V_k(m) = min(loss(m), min over mu of E V_(k-1)(m - mass(mu)))
/// ```
#[derive(Debug, Clone)]
struct Aims {
    /// By steps left, from 1, then by missing mass in steps of [`GRID_MG`].
    table: Vec<Vec<f64>>,
}

/// Step of the table, mg.
const GRID_MG: f64 = 0.25;
/// Missing masses of the table: 0 to 30 mg.
const CELLS: usize = 121;
/// Most steps left that the table tells apart.
const LEFT_MAX: usize = 30;
/// Means that are tried, mg: 0.1 to 25.
const MEANS: usize = 28;
/// Nodes of an expectation.
const NODES: usize = 16;

impl Aims {
    fn new(r: &Response) -> Self {
        let nodes: Vec<f64> = (0..NODES).map(|k| quantile((k as f64 + 0.5) / NODES as f64)).collect();
        let means: Vec<f64> = (0..MEANS).map(|k| 0.1 * libm::pow(250.0, k as f64 / (MEANS - 1) as f64)).collect();
        let masses: Vec<Vec<f64>> =
            means.iter().map(|mean| nodes.iter().map(|z| r.draw(*mean, *z)).collect()).collect();
        let missing = |cell: usize| cell as f64 * GRID_MG;
        let mut values: Vec<f64> = (0..CELLS).map(|cell| r.loss(missing(cell))).collect();
        let mut table = Vec::new();
        for _ in 0..LEFT_MAX {
            let value = |m: f64| if m < 0.0 { r.loss(m) } else { between(&values, m) };
            let best = |cell: usize| {
                let m = missing(cell);
                let tried = means.iter().zip(&masses).map(|(mean, masses)| {
                    (masses.iter().map(|mass| value(m - mass)).sum::<f64>() / NODES as f64, *mean)
                });
                tried.chain([(r.loss(m), 0.0)]).min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((r.loss(m), 0.0))
            };
            let chosen: Vec<(f64, f64)> = (0..CELLS).map(best).collect();
            table.push(chosen.iter().map(|it| it.1).collect());
            values = chosen.iter().map(|it| it.0).collect();
        }
        Self { table }
    }

    fn of(&self, left: u32, missing_mg: f64) -> f64 {
        if missing_mg <= 0.0 {
            return 0.0;
        }
        between(&self.table[(left as usize).clamp(1, LEFT_MAX) - 1], missing_mg)
    }
}

/// A value between two cells; beyond the last the last.
fn between(values: &[f64], missing_mg: f64) -> f64 {
    let at = (missing_mg / GRID_MG).min((values.len() - 1) as f64);
    let below = (at as usize).min(values.len() - 2);
    let share = at - below as f64;
    values[below] * (1.0 - share) + values[below + 1] * share
}

#[cfg(test)]
#[path = "dispenser_tests.rs"]
mod tests;
