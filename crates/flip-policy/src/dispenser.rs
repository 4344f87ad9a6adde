//! A dispenser without a network: a model of the mass a shake releases, identified while dosing,
//! plus look-ahead.
//!
//! *Model* ([`Spoonful`]). A spoon at pitch p releases the powder above its slope of rest. Shaken
//! with amplitude A it could release G in total, and has already released M; one shake takes a
//! share of the rest:
//!
//! ```text
//! G = slope width softplus((p + reach ln(A / 1 mm) - onset) / width)
//! mean of a shake = max(G - M, 0) (1 - exp(-(A / stroke)^bend))
//! sqrt(mass of a shake) ~ N(sqrt(mean), floor^2 + scatter^2 mean)
//! ```
//!
//! *Identification.* The onset, slope and stroke differ between powders and between spoonfuls.
//! [`GUESSES`] of them are drawn from the distribution over many simulated spoons ([`Response`])
//! and weighted by the balance readings so far (a particle filter with static particles). The
//! likelihood accounts for the balance's rounding, and its tails are those of Student's t with four
//! degrees of freedom, since avalanches happen.
//!
//! *Decision.* Each possible action is simulated to the end of the weighing with [`ROLLOUTS`] of
//! the guesses; the later steps follow a rule that aims at the share of the missing mass which is
//! best for masses scattered like that (`Aims`, by dynamic programming). The action with the least
//! expected loss is taken: a rollout algorithm (Bertsekas, Tesauro and Wu 1997). An overdose costs
//! [`Response::overdose_factor`] times as much as an equal shortfall, because it cannot be undone.
//!
//! The usual log-linear models of mg per tap against tilt do not describe these spoons: the mass
//! released depends on how much has already fallen (`docs/dispenser.md`).

use super::controller::Done;
use super::episode::{Ending, Rules, on_target_mg};
use super::observation::Observation;
use super::response::{Response, Spoonful, radical_inverse};
use flip_core::domain::bench::{Action, INCLINE_CHANGE_DEG_MAX, SHAKE_MM_MAX};
use flip_core::stats::normal::quantile;
use serde::{Deserialize, Serialize};

/// Number of guesses of the current spoonful.
const GUESSES: usize = 384;
/// Number of guesses with which each action is simulated to the end.
const ROLLOUTS: usize = 96;
/// Candidate changes of the pitch, degrees.
const CHANGES_DEG: [f64; 9] = [-8.0, -5.0, -3.0, -1.5, 0.0, 2.0, 4.0, 6.0, 8.0];
/// Candidate amplitudes, mm.
const SHAKES_MM: [f64; 7] = [0.0, 1.0, 2.0, 4.0, 7.0, 11.0, SHAKE_MM_MAX];
/// Amplitude used by the rule of the later steps, mm; where the pitch cannot follow, it uses the
/// largest or the smallest.
const USUAL_MM: f64 = 4.0;

/// The dispenser: [`Response`] and the tables made from it. Written down, it is the former alone.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(from = "Response", into = "Response")]
pub struct Dispenser {
    response: Response,
    guesses: Vec<Spoonful>,
    aims: Aims,
}

impl From<Response> for Dispenser {
    fn from(response: Response) -> Self {
        Self::new(response)
    }
}

impl From<Dispenser> for Response {
    fn from(dispenser: Dispenser) -> Self {
        dispenser.response
    }
}

impl PartialEq for Dispenser {
    fn eq(&self, other: &Self) -> bool {
        self.response == other.response
    }
}

/// A moment of a simulated weighing.
#[derive(Debug, Clone, Copy)]
struct Moment {
    pitch_deg: f64,
    poured_mg: f64,
    missing_mg: f64,
    left: u32,
    /// The weighing ends when less than this is missing.
    ends_mg: f64,
}

impl Dispenser {
    /// A dispenser with this prior.
    pub fn new(response: Response) -> Self {
        Self { response, guesses: response.guesses(GUESSES), aims: Aims::new(&response) }
    }

    /// Its prior.
    pub fn response(&self) -> &Response {
        &self.response
    }

    /// Returns the action after these steps.
    pub(super) fn propose(
        &self,
        done: &[Done],
        seen: &Observation,
        rules: &Rules,
        readability_mg: f64,
    ) -> Action {
        let guesses = self.resampled(&self.weights(done, readability_mg));
        let moment = Moment {
            pitch_deg: seen.pitch_deg,
            poured_mg: seen.reading_mg.max(0.0),
            missing_mg: seen.missing_mg(),
            left: rules.steps_max.saturating_sub(done.len() as u32).max(1),
            // A reading is rounded: half of the time it shows the missing step before it has
            // fallen.
            ends_mg: match rules.ending {
                Ending::OnTarget => on_target_mg(readability_mg) / 2.0,
                Ending::Never => f64::NEG_INFINITY,
            },
        };
        let change = |change: f64| {
            let pitch =
                (seen.pitch_deg + change).clamp(rules.pitch.lower_deg, rules.pitch.upper_deg);
            pitch - seen.pitch_deg
        };
        let actions = CHANGES_DEG
            .iter()
            .flat_map(|by| SHAKES_MM.map(|shake_mm| Action::once(change(*by), shake_mm)));
        let rated =
            actions.map(|action| (self.expected_loss(&guesses, moment, action, rules), action));
        rated.min_by(|a, b| a.0.total_cmp(&b.0)).map_or_else(Action::default, |(_, action)| action)
    }

    /// Weights of the guesses given the readings so far.
    fn weights(&self, done: &[Done], readability_mg: f64) -> Vec<f64> {
        let r = &self.response;
        let log = |guess: &Spoonful| -> f64 {
            let shakes = done.iter().filter(|step| step.action.executed_shake_mm() > 0.0);
            let one = |step: &Done| {
                let mean = guess.mean_mg(
                    r,
                    step.after.pitch_deg,
                    step.action.shake_mm,
                    step.before.reading_mg.max(0.0),
                );
                let gained = step.after.reading_mg - step.before.reading_mg;
                let [more, variance] = r.moments(mean);
                // Rounding variance of the difference of two readings.
                let variance = variance + readability_mg.powi(2) / 6.0;
                let z2 = (gained - mean - more).powi(2) / variance;
                -2.5 * libm::log1p(z2 / 4.0) - 0.5 * libm::log(variance)
            };
            shakes.map(one).sum()
        };
        let logs: Vec<f64> = self.guesses.iter().map(log).collect();
        let largest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        logs.iter().map(|log| libm::exp(log - largest)).collect()
    }

    /// Draws [`ROLLOUTS`] guesses by weight, systematically at equal distances.
    fn resampled(&self, weights: &[f64]) -> Vec<Spoonful> {
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

    /// Mean loss of an action over the guesses, each simulated to the end.
    fn expected_loss(
        &self,
        guesses: &[Spoonful],
        now: Moment,
        action: Action,
        rules: &Rules,
    ) -> f64 {
        let play = |(j, guess): (usize, &Spoonful)| {
            let mut moment = self.after(
                guess,
                now,
                now.pitch_deg + action.incline_change_deg,
                action.shake_mm,
                j,
            );
            while moment.left > 0 && moment.missing_mg >= now.ends_mg {
                let (pitch_deg, shake_mm) = self.usual(guess, &moment, rules);
                moment = self.after(guess, moment, pitch_deg, shake_mm, j);
            }
            self.response.loss(moment.missing_mg)
        };
        guesses.iter().enumerate().map(play).sum::<f64>() / guesses.len() as f64
    }

    /// One simulated step; the `j`-th rollout draws the same numbers whatever its actions.
    fn after(
        &self,
        guess: &Spoonful,
        now: Moment,
        pitch_deg: f64,
        shake_mm: f64,
        j: usize,
    ) -> Moment {
        let mean = guess.mean_mg(&self.response, pitch_deg, shake_mm, now.poured_mg);
        let z = quantile(radical_inverse(j + 1, PRIMES[now.left as usize % PRIMES.len()]));
        let mass = if mean > 0.0 { self.response.draw(mean, z) } else { 0.0 };
        let (poured_mg, missing_mg) = (now.poured_mg + mass, now.missing_mg - mass);
        Moment { pitch_deg, poured_mg, missing_mg, left: now.left - 1, ..now }
    }

    /// The rule of the later steps: the pitch at which a usual shake has the aimed-for mean, as
    /// near as the spoon can get.
    fn usual(&self, guess: &Spoonful, now: &Moment, rules: &Rules) -> (f64, f64) {
        let r = &self.response;
        let aim = self.aims.of(now.left, now.missing_mg);
        if aim <= 0.0 {
            return (now.pitch_deg, 0.0);
        }
        let wanted = guess.pitch_for(r, USUAL_MM, aim, now.poured_mg);
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

/// Bases of the low-discrepancy numbers drawn by rollouts, one base for each step left.
const PRIMES: [usize; 12] = [7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47];

/// The best mean to aim at, by steps left and missing mass, if any mean were attainable, for masses
/// scattered as in [`Response`]:
///
/// ```text
/// V_0(m) = loss(m)     V_k(m) = min(loss(m), min over mu of E V_(k-1)(m - mass(mu)))
/// ```
#[derive(Debug, Clone)]
struct Aims {
    /// Indexed by steps left, from 1, then by missing mass in steps of [`GRID_MG`].
    table: Vec<Vec<f64>>,
}

/// Grid step of the table, mg.
const GRID_MG: f64 = 0.25;
/// Number of grid points: missing masses of 0 to 30 mg.
const CELLS: usize = 121;
/// Largest number of steps left that the table distinguishes.
const LEFT_MAX: usize = 30;
/// Number of means tried: 0.1 to 25 mg.
const MEANS: usize = 28;
/// Number of quadrature nodes of an expectation.
const NODES: usize = 16;

impl Aims {
    fn new(r: &Response) -> Self {
        let nodes: Vec<f64> =
            (0..NODES).map(|k| quantile((k as f64 + 0.5) / NODES as f64)).collect();
        let means: Vec<f64> =
            (0..MEANS).map(|k| 0.1 * libm::pow(250.0, k as f64 / (MEANS - 1) as f64)).collect();
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
                tried
                    .chain([(r.loss(m), 0.0)])
                    .min_by(|a, b| a.0.total_cmp(&b.0))
                    .unwrap_or((r.loss(m), 0.0))
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

/// Interpolates between two cells; beyond the last cell, returns the last value.
fn between(values: &[f64], missing_mg: f64) -> f64 {
    let at = (missing_mg / GRID_MG).min((values.len() - 1) as f64);
    let below = (at as usize).min(values.len() - 2);
    let share = at - below as f64;
    values[below] * (1.0 - share) + values[below + 1] * share
}

#[cfg(test)]
#[path = "dispenser_tests.rs"]
mod tests;
