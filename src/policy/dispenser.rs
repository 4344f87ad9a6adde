//! A dispenser without a network: a model of what a shake lets fall, identified while it doses, and a look ahead.
//!
//! *Model* ([`Spoonful`]). A spoon at pitch p lets go of what stands above its slope of rest. Shaken with amplitude A it could let go of G in all, and has
//! let go of M; of the rest one shake takes a share:
//!
//! ```text
//! G = slope width softplus((p + reach ln(A / 1 mm) - onset) / width)
//! mean of a shake = max(G - M, 0) (1 - exp(-(A / stroke)^bend))
//! sqrt(mass of a shake) ~ sqrt(mean) + sqrt(floor^2 + scatter^2 mean) t
//! ```
//!
//! with t of Student's distribution with four degrees of freedom, as avalanches happen.
//!
//! *Identification.* The onset, the slope and the stroke are another powder's, or another spoonful's, each time. [`GUESSES`] of them are drawn
//! from what many simulated spoons had ([`Response`]), about the means that belong to the powder's angle of repose, and weighted with what the
//! balance has shown since (a particle filter whose particles do not move). The balance's own rounding counts in the likelihood.
//!
//! *Decision.* Each possible action is played to the end of the weighing with [`ROLLOUTS`] of the guesses, the later steps by a rule that aims
//! at the share of the missing mass which is best for masses scattered like that (`Aims`, by dynamic programming). The action whose
//! expected loss is least is taken: a rollout algorithm (Bertsekas, Tesauro and Wu 1997). Where none promises less than what is in the vial
//! now, it proposes to do nothing, which ends the weighing. Too much costs [`Response::overdose_factor`] times as much as too little, for it
//! cannot be taken back. What a coarse balance shows is known to be within half a step of the truth, in thought too.
//!
//! Log-linear models of mg per tap against tilt, the usual ones, do not describe these spoons: what falls depends on what has fallen
//! (`docs/dispenser.md`).

use super::aims::{Aims, radical_inverse, student4};
use super::controller::Done;
use super::episode::{Known, Rules};
use super::observation::Observation;
use super::response::{Response, Spoonful};
use crate::domain::bench::{Action, INCLINE_CHANGE_DEG_MAX, SHAKE_MM_MAX};
use crate::stats::normal::quantile;

/// Spoonfules of the spoon at hand.
const GUESSES: usize = 384;
/// Spoonfules with which each action is played to the end.
const ROLLOUTS: usize = 96;
/// Changes of the pitch among which it chooses, degrees.
const CHANGES_DEG: [f64; 9] = [-8.0, -5.0, -3.0, -1.5, 0.0, 2.0, 4.0, 6.0, 8.0];
/// Amplitudes among which it chooses, mm.
const SHAKES_MM: [f64; 7] = [0.0, 1.0, 2.0, 4.0, 7.0, 11.0, SHAKE_MM_MAX];
/// Bases of the guesses' numbers. None may divide [`GUESSES`] / [`ROLLOUTS`]: every fourth guess would then lie in one quarter of its range.
const GUESS_BASES: [usize; 4] = [3, 5, 7, 11];
/// Bases of the numbers that rollouts draw, all different from those: of what a step lets fall, by steps left, ...
const STEP_BASES: [usize; 12] = [13, 17, 19, 23, 29, 31, 37, 41, 43, 47, 53, 59];
/// ... of what is in the vial while the balance shows a round number, and of what it shows later.
const POURED_BASE: usize = 2;
const SHOWN_BASE: usize = 61;
/// The rule of the later steps shakes with this amplitude, mm, and where the pitch cannot follow with the largest or the smallest.
const USUAL_MM: f64 = 4.0;

/// The dispenser: [`Response`] and the tables made from it.
#[derive(Debug, Clone)]
pub struct Dispenser {
    response: Response,
    /// For each guess a standard normal number for onset, slope, stroke and angle of repose, evenly spread.
    numbers: Vec<[f64; 4]>,
    aims: Aims,
}

impl PartialEq for Dispenser {
    fn eq(&self, other: &Self) -> bool {
        self.response == other.response
    }
}

/// A moment of a weighing, as it is played in thought.
#[derive(Debug, Clone, Copy)]
struct Moment {
    pitch_deg: f64,
    poured_mg: f64,
    missing_mg: f64,
    left: u32,
}

/// The part of a weighing that a decision is made in.
struct Frame<'a> {
    rules: &'a Rules,
    readability_mg: f64,
    guesses: &'a [Spoonful],
}

impl Dispenser {
    /// A dispenser with this prior.
    pub fn new(response: Response) -> Self {
        let numbers = |k: usize| GUESS_BASES.map(|base| quantile(radical_inverse(k + 1, base)));
        Self { response, numbers: (0..GUESSES).map(numbers).collect(), aims: Aims::new(&response) }
    }

    /// Its prior.
    pub fn response(&self) -> &Response {
        &self.response
    }

    /// The action after these steps; none at all when it holds the weighing to be done.
    pub(super) fn propose(&self, done: &[Done], seen: &Observation, rules: &Rules, known: &Known) -> Action {
        let prior = self.prior(known.repose_deg);
        let guesses = resampled(&prior, &self.weights(&prior, done, known.readability_mg));
        let frame = Frame { rules, readability_mg: known.readability_mg, guesses: &guesses };
        let change = |change: f64| {
            let pitch = (seen.pitch_deg + change).clamp(rules.pitch.lower_deg, rules.pitch.upper_deg);
            pitch - seen.pitch_deg
        };
        let actions = CHANGES_DEG
            .iter()
            .flat_map(|by| SHAKES_MM.map(|shake_mm| Action { incline_change_deg: change(*by), shake_mm }))
            // To wait is no choice: nothing would be different afterwards, and to do nothing means to end.
            .filter(|action| action.incline_change_deg != 0.0 || action.shake_mm > 0.0);
        let left = rules.steps_max.saturating_sub(done.len() as u32).max(1);
        let rated = actions.map(|action| (self.expected_loss(&frame, seen, left, Some(action)), action));
        let still = (self.expected_loss(&frame, seen, left, None), Action::default());
        // Of equals the first: to do nothing.
        [still].into_iter().chain(rated).min_by(|a, b| a.0.total_cmp(&b.0)).map_or_else(Action::default, |it| it.1)
    }

    /// The guesses before anything was seen of a powder with this angle of repose.
    fn prior(&self, repose_deg: Option<f64>) -> Vec<Spoonful> {
        let r = &self.response;
        let guess = |z: &[f64; 4]| {
            let above_deg = repose_deg.map_or(r.repose_deg[1] * z[3], |deg| deg - r.repose_deg[0]);
            let about: [f64; 3] = std::array::from_fn(|k| r.means()[k] + r.by_repose[k] * above_deg);
            r.spoonful(about, [z[0], z[1], z[2]])
        };
        self.numbers.iter().map(guess).collect()
    }

    /// Weight of each guess after what the balance has shown.
    fn weights(&self, guesses: &[Spoonful], done: &[Done], readability_mg: f64) -> Vec<f64> {
        let r = &self.response;
        let log = |guess: &Spoonful| -> f64 {
            let shakes = done.iter().filter(|step| step.action.executed_shake_mm() > 0.0);
            let one = |step: &Done| {
                let mean =
                    guess.mean_mg(r, step.after.pitch_deg, step.action.shake_mm, step.before.reading_mg.max(0.0));
                let gained = step.after.reading_mg - step.before.reading_mg;
                let sd = r.sd(mean);
                // Of a squared normal number, and of the difference of two readings that are rounded.
                let variance = 4.0 * mean * sd * sd + 2.0 * sd.powi(4) + readability_mg.powi(2) / 6.0;
                let z2 = (gained - mean - sd * sd).powi(2) / variance;
                -2.5 * libm::log1p(z2 / 4.0) - 0.5 * libm::log(variance)
            };
            shakes.map(one).sum()
        };
        let logs: Vec<f64> = guesses.iter().map(log).collect();
        let largest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        logs.iter().map(|log| libm::exp(log - largest)).collect()
    }

    /// Mean loss of an action over the guesses, each played to the end; without an action that of ending here.
    fn expected_loss(&self, frame: &Frame<'_>, seen: &Observation, left: u32, action: Option<Action>) -> f64 {
        let play = |(j, guess): (usize, &Spoonful)| {
            // What is in the vial may be half a step of the display more or less.
            let poured_mg =
                (seen.reading_mg + frame.readability_mg * (radical_inverse(j + 1, POURED_BASE) - 0.5)).max(0.0);
            let missing_mg = seen.target_mg - poured_mg;
            let mut moment = Moment { pitch_deg: seen.pitch_deg, poured_mg, missing_mg, left };
            let Some(action) = action else { return self.response.loss(missing_mg) };
            moment = self.after(guess, moment, seen.pitch_deg + action.incline_change_deg, action.shake_mm, j);
            while moment.left > 0 && moment.missing_mg > 0.0 {
                let Some((pitch_deg, shake_mm)) = self.usual(guess, &moment, frame, j) else { break };
                moment = self.after(guess, moment, pitch_deg, shake_mm, j);
            }
            self.response.loss(moment.missing_mg)
        };
        frame.guesses.iter().enumerate().map(play).sum::<f64>() / frame.guesses.len() as f64
    }

    /// A step in thought; the `j`-th rollout draws the same numbers whatever it does.
    fn after(&self, guess: &Spoonful, now: Moment, pitch_deg: f64, shake_mm: f64, j: usize) -> Moment {
        let mean = guess.mean_mg(&self.response, pitch_deg, shake_mm, now.poured_mg);
        let z = student4(radical_inverse(j + 1, STEP_BASES[now.left as usize % STEP_BASES.len()]));
        let mass = if mean > 0.0 { self.response.draw(mean, z) } else { 0.0 };
        Moment { pitch_deg, poured_mg: now.poured_mg + mass, missing_mg: now.missing_mg - mass, left: now.left - 1 }
    }

    /// The rule of the later steps: the pitch at which a usual shake has the mean that is aimed at, as near as the spoon can come. None
    /// when it is best to end. It sees what a balance would show.
    fn usual(&self, guess: &Spoonful, now: &Moment, frame: &Frame<'_>, j: usize) -> Option<(f64, f64)> {
        let r = &self.response;
        let shown = frame.readability_mg * (radical_inverse(j + 1 + now.left as usize, SHOWN_BASE) - 0.5);
        let aim = self.aims.of(now.left, now.missing_mg + shown);
        if aim <= 0.0 {
            return None;
        }
        let wanted = guess.pitch_for(r, USUAL_MM, aim, now.poured_mg);
        let pitch = frame.rules.pitch;
        let lower = (now.pitch_deg - INCLINE_CHANGE_DEG_MAX).max(pitch.lower_deg);
        let upper = (now.pitch_deg + INCLINE_CHANGE_DEG_MAX).min(pitch.upper_deg);
        let shake_mm = match wanted {
            w if w > upper => SHAKE_MM_MAX,
            w if w < lower => SHAKES_MM[1],
            _ => USUAL_MM,
        };
        Some((wanted.clamp(lower, upper), shake_mm))
    }
}

/// [`ROLLOUTS`] guesses by their weights, at even distances.
fn resampled(guesses: &[Spoonful], weights: &[f64]) -> Vec<Spoonful> {
    let sum: f64 = weights.iter().sum();
    let (mut k, mut reached) = (0, weights[0]);
    let at = |j: usize| (j as f64 + 0.5) / ROLLOUTS as f64 * sum;
    let mut take = |goal: f64| {
        while reached < goal && k + 1 < weights.len() {
            k += 1;
            reached += weights[k];
        }
        guesses[k]
    };
    (0..ROLLOUTS).map(|j| take(at(j))).collect()
}

#[cfg(test)]
#[path = "dispenser_tests.rs"]
mod tests;
