//! Forecast of the mass released by the next shake, from the shakes of this dose, including the
//! probability of the worst case.
//!
//! The level x is the logarithm of the mass released by a shake. It depends on pitch and amplitude,
//! wanders, and drops a little with each shake; it is estimated from the released masses (a Kalman
//! filter, with Student's t for the remaining randomness):
//!
//! ```text
//! x_1 ~ N(m + k pitch_1 + b ln amplitude_1, s^2)                                       before the first shake
//! x_i = x_(i-1) + k (pitch_i - pitch_(i-1)) + b ln(amplitude_i / amplitude_(i-1)) - w + N(0, q^2)
//! ln(fell_i + c) = x_i + N(0, r^2 + (0.41 d / (fell_i + c))^2)                         0.41 d: of the difference of two rounded readings
//! ln(next + c)   ~ x + sqrt(P + r^2) t_4                                               P: variance of x before the next shake
//! ```
//!
//! As long as nothing has fallen, the next shake may free a first piece, which comes with
//! probability h and is larger the harder the shake:
//!
//! ```text
//! P(next > u) = (1 - h) P_level(next > u) + h Phi((f + 0.55 ln amplitude - ln u) / g)
//! ```
//!
//! A powder that comes in pieces ([`Forecast::in_pieces`]) may free another one after any silent
//! shake: the same formula then holds in place of the level's alone.
//!
//! A step of n strokes counts as one shake that releases n times as much (x + ln n), may free a
//! first piece at each stroke (1 - (1 - h)^n), and spends n w.
//!
//! | symbol | field | value | from |
//! |---|---|---|---|
//! | m, s | `level`, `level_sd` | -2.3, 0.8 | courses of the shipped rules on simulated spoons; s is three times what they need, for powders that no simulator knows |
//! | k | `per_deg` | 0.09 1/deg | the same (0.076 and 0.112 by readings and by true masses); taps of salt: 0.046 |
//! | b | `per_ln_mm` | 0.75 | the same (0.57, 0.87) |
//! | w, q, r | `spent`, `wander`, `scatter` | 0.15, 0.3, 0.35 | the same; taps of salt scatter by 0.4 to 0.8 of their mean, q and r together do by 0.5 |
//! | c | [`DUST_MG`] | 0.3 mg | less is dust |
//! | h | `first_chance` | 0.12 | a first piece in eight shakes |
//! | f, g | `first_ln_mg`, `first_sd` | 0.14, 1 | `docs/dispenser.md`, first pieces: medians 1.4 to 4.5 mg, 0.10 to 0.45 above 5 mg |
//!
//! Source: Kalman, "A New Approach to Linear Filtering and Prediction Problems", 1960, for the
//! level; the rest as given.

use flip_core::domain::bench::{Action, Tick};
use serde::{Deserialize, Serialize};

/// Added to a mass before taking its logarithm, mg: anything less is dust.
pub(super) const DUST_MG: f64 = 0.3;
/// While less than this has fallen in total, the first piece is still to come, mg.
pub(super) const PIECE_MG: f64 = 0.5;
/// Risk of a shake of a powder that comes in pieces.
const RISK_IN_PIECES: f64 = 0.02;
/// Exponent of the amplitude in the size of the first piece.
pub(super) const FIRST_PER_LN_MM: f64 = 0.55;
/// SD of the difference of two rounded readings, in steps of the display: the root of a sixth.
const ROUNDING: f64 = 0.41;
/// Upper bound on the mass of a single fall, mg: where the search for a bound ends.
const MASS_MG_MAX: f64 = 1e4;

/// A shake and its result according to the balance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Fall {
    /// Pitch during the shake, degrees.
    pub pitch_deg: f64,
    /// Its amplitude, mm.
    pub shake_mm: f64,
    /// How often it was made before the reading.
    pub strokes: u32,
    /// Mass that fell in all, mg; negative if the readings give that.
    pub mass_mg: f64,
}

/// A shake that may be made: at this pitch, of this amplitude, so often before the next reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shaking {
    /// Pitch during it, degrees.
    pub pitch_deg: f64,
    /// Its amplitude, mm; 0: none.
    pub shake_mm: f64,
    /// Number of strokes.
    pub strokes: u32,
}

impl Shaking {
    /// A single stroke.
    pub fn once(pitch_deg: f64, shake_mm: f64) -> Self {
        Self { pitch_deg, shake_mm, strokes: 1 }
    }

    /// What this action would do from a pitch.
    pub fn of(from_deg: f64, action: &Action) -> Self {
        Self {
            pitch_deg: from_deg + action.incline_change_deg,
            shake_mm: action.executed_shake_mm(),
            strokes: action.strokes,
        }
    }
}

impl Fall {
    /// The shake.
    pub fn shaking(&self) -> Shaking {
        Shaking { pitch_deg: self.pitch_deg, shake_mm: self.shake_mm, strokes: self.strokes }
    }

    /// The shakes of each spoonful of a dose and their results, from the actions and readings.
    pub fn of(ticks: &[Tick]) -> Vec<Vec<Self>> {
        let shaken = |pair: &&[Tick]| pair[1].action.executed_shake_mm() > 0.0;
        let fall = |pair: &[Tick]| Self {
            pitch_deg: pair[1].pitch_deg,
            shake_mm: pair[1].action.shake_mm,
            strokes: pair[1].action.strokes,
            mass_mg: pair[1].reading.mass_mg - pair[0].reading.mass_mg,
        };
        let spoonfuls = ticks.chunk_by(|a, b| a.spoonful == b.spoonful);
        spoonfuls.map(|ticks| ticks.windows(2).filter(shaken).map(fall).collect()).collect()
    }

    /// Whether it says something of the level.
    pub(super) fn is_known(&self) -> bool {
        self.shake_mm > 0.0 && self.mass_mg.is_finite()
    }
}

/// Prior for a powder before its dose begins; the symbols are those of the module.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Forecast {
    /// A shake is refused if the probability that it takes the dose past its tolerance is larger.
    /// Default 0.05: on 1200 doses of a formula's spoons with large first pieces, in thirty steps
    /// with a tolerance of 1 mg, it is the smallest that costs no accuracy; 0.02 leaves 28 % of
    /// them short instead of 9 %, and 0.1 prevents hardly any overdose.
    pub risk: f64,
    /// Mean of the level at 0 deg and 1 mm.
    pub level: f64,
    /// Its standard deviation.
    pub level_sd: f64,
    /// Increase of the level per degree of pitch.
    pub per_deg: f64,
    /// Increase of the level with the logarithm of the amplitude.
    pub per_ln_mm: f64,
    /// Decrease of the level per shake.
    pub spent: f64,
    /// SD of the level's change from shake to shake.
    pub wander: f64,
    /// SD of a fall about its level.
    pub scatter: f64,
    /// Probability that a shake frees the first piece, as long as none has come.
    pub first_chance: f64,
    /// Logarithm of the first piece released by a shake of 1 mm, mg.
    pub first_ln_mg: f64,
    /// Its standard deviation.
    pub first_sd: f64,
    /// Whether a piece like the first may come after any shake that released nothing.
    pub in_pieces: bool,
}

impl Forecast {
    /// For a powder about which nothing is known.
    pub const GENERIC: Self = Self {
        risk: 0.05,
        level: -2.3,
        level_sd: 0.8,
        per_deg: 0.09,
        per_ln_mm: 0.75,
        spent: 0.15,
        wander: 0.3,
        scatter: 0.35,
        first_chance: 0.12,
        first_ln_mg: 0.14,
        first_sd: 1.0,
        in_pieces: false,
    };

    /// The same for a powder that sticks and comes in pieces. Its shakes may each take the dose past
    /// its tolerance with a smaller probability, since it takes many of them: of nine doses of such
    /// a powder at the usual 0.05, three were over.
    #[must_use]
    pub fn in_pieces(self) -> Self {
        Self { in_pieces: true, risk: RISK_IN_PIECES, ..self }
    }

    /// Probability that this shake releases more than `room_mg`.
    pub fn chance_above(
        &self,
        falls: &[Fall],
        readability_mg: f64,
        shake: Shaking,
        room_mg: f64,
    ) -> f64 {
        if shake.shake_mm <= 0.0 {
            return 0.0;
        }
        self.next(falls, readability_mg, shake).chance_above(room_mg)
    }

    /// The mass that this shake exceeds with probability `risk`, mg.
    pub fn upper_mg(&self, falls: &[Fall], readability_mg: f64, shake: Shaking) -> f64 {
        if shake.shake_mm <= 0.0 {
            return 0.0;
        }
        let next = self.next(falls, readability_mg, shake);
        let (mut low, mut high) = (0.0f64, MASS_MG_MAX);
        // Forty bisections of 10 g are below a nanogram.
        for _ in 0..40 {
            let middle = (low + high) / 2.0;
            if next.chance_above(middle) > self.risk { low = middle } else { high = middle }
        }
        high
    }

    /// Probability that the last `silent` of these shakes each released less than half a step of
    /// the display, given those before: each silent one makes the next less surprising.
    pub fn silent_chance(&self, falls: &[Fall], silent: usize, readability_mg: f64) -> f64 {
        let flowed = falls.len().saturating_sub(silent);
        let one = |k: usize| {
            let shake = falls[k].shaking();
            1.0 - self.chance_above(&falls[..k], readability_mg, shake, readability_mg / 2.0)
        };
        (flowed..falls.len()).map(one).product()
    }

    fn next(&self, falls: &[Fall], readability_mg: f64, shake: Shaking) -> Next {
        let (level, variance) = self.filtered(falls, readability_mg, shake);
        let fallen_mg: f64 = falls.iter().map(|fall| fall.mass_mg).sum();
        let none = libm::pow(1.0 - self.first_chance, f64::from(shake.strokes));
        let is_silent = falls.last().is_none_or(|fall| fall.mass_mg < PIECE_MG);
        let may_come = fallen_mg < PIECE_MG || (self.in_pieces && is_silent);
        let first = may_come.then(|| First {
            chance: if shake.strokes == 1 { self.first_chance } else { 1.0 - none },
            ln_mg: self.first_ln_mg + FIRST_PER_LN_MM * libm::log(shake.shake_mm),
            sd: self.first_sd,
        });
        Next { level, sd: (variance + self.scatter.powi(2)).sqrt(), first }
    }

    /// Mean and variance of the level of a shake, after these.
    pub(super) fn filtered(
        &self,
        falls: &[Fall],
        readability_mg: f64,
        shake: Shaking,
    ) -> (f64, f64) {
        // The level with its pitch and amplitude terms removed: only randomness and depletion
        // change it.
        let mut level = Level { at: self.level, variance: self.level_sd.powi(2) };
        for fall in falls.iter().filter(|fall| fall.is_known()) {
            level.learn(self, fall, readability_mg);
        }
        (level.at + self.place(shake), level.variance)
    }

    /// What the pitch, the amplitude and the number of strokes add to the level.
    fn place(&self, shake: Shaking) -> f64 {
        let by_strokes = libm::log(f64::from(shake.strokes.max(1)));
        self.per_deg * shake.pitch_deg + self.per_ln_mm * libm::log(shake.shake_mm) + by_strokes
    }
}

/// The level at 0 deg and 1 mm before a shake: its mean and variance.
#[derive(Debug, Clone, Copy)]
pub(super) struct Level {
    pub(super) at: f64,
    pub(super) variance: f64,
}

impl Level {
    /// A step of the filter. Returns how far the fall was from what was expected, and the variance
    /// expected of that.
    pub(super) fn learn(
        &mut self,
        forecast: &Forecast,
        fall: &Fall,
        readability_mg: f64,
    ) -> [f64; 2] {
        let mass_mg = fall.mass_mg.max(0.0) + DUST_MG;
        let noise = forecast.scatter.powi(2) + (ROUNDING * readability_mg / mass_mg).powi(2);
        let expected = self.variance + noise;
        let gain = self.variance / expected;
        let surprise = libm::log(mass_mg) - forecast.place(fall.shaking()) - self.at;
        self.at += gain * surprise - f64::from(fall.strokes) * forecast.spent;
        self.variance = self.variance * (1.0 - gain) + forecast.wander.powi(2);
        [surprise, expected]
    }
}

/// The distribution of the next fall.
struct Next {
    level: f64,
    sd: f64,
    first: Option<First>,
}

/// A possible first piece.
struct First {
    chance: f64,
    ln_mg: f64,
    sd: f64,
}

impl Next {
    fn chance_above(&self, mass_mg: f64) -> f64 {
        if mass_mg < 0.0 {
            return 1.0;
        }
        let usual = above_t4((libm::log(mass_mg + DUST_MG) - self.level) / self.sd);
        match &self.first {
            Some(first) => {
                let piece = above_normal((libm::log(mass_mg.max(1e-9)) - first.ln_mg) / first.sd);
                (1.0 - first.chance) * usual + first.chance * piece
            }
            None => usual,
        }
    }
}

/// Upper tail probability of Student's t with four degrees of freedom.
///
/// ```text
/// 1 - F(t) = 1/2 - 3/4 w (1 - w^2 / 3)          w = t / sqrt(t^2 + 4)
/// ```
fn above_t4(t: f64) -> f64 {
    let w = t / (t * t + 4.0).sqrt();
    0.5 - 0.75 * w * (1.0 - w * w / 3.0)
}

fn above_normal(z: f64) -> f64 {
    libm::erfc(z / std::f64::consts::SQRT_2) / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;

    const GENERIC: Forecast = Forecast::GENERIC;

    fn fall(pitch_deg: f64, shake_mm: f64, mass_mg: f64) -> Fall {
        Fall { pitch_deg, shake_mm, strokes: 1, mass_mg }
    }

    #[test]
    fn the_tails_are_those_of_the_tables() {
        // Upper 5 %, 2.5 % and 0.5 % points of t with four degrees of freedom, and 2.5 % of the
        // normal distribution.
        for (t, chance) in [(2.1318, 0.05), (2.7764, 0.025), (4.6041, 0.005), (-2.1318, 0.95)] {
            assert!((above_t4(t) - chance).abs() < 1e-5, "{t}");
        }
        assert!((above_normal(1.959_964) - 0.025).abs() < 1e-7);
    }

    #[test]
    fn more_pitch_and_harder_shakes_may_let_more_fall_and_none_lets_nothing() {
        for falls in [vec![], vec![fall(10.0, 3.0, 2.0), fall(12.0, 3.0, 3.0)]] {
            let upper = |pitch_deg, shake_mm| {
                GENERIC.upper_mg(&falls, 1.0, Shaking::once(pitch_deg, shake_mm))
            };
            assert!(upper(10.0, 2.0) < upper(20.0, 2.0) && upper(10.0, 2.0) < upper(10.0, 8.0));
            assert_eq!(upper(10.0, 0.0), 0.0);
            assert!(
                (GENERIC.chance_above(&falls, 1.0, Shaking::once(10.0, 2.0), upper(10.0, 2.0))
                    - GENERIC.risk)
                    .abs()
                    < 1e-6
            );
        }
    }

    #[test]
    fn what_fell_moves_the_forecast() {
        let after =
            |mass_mg| GENERIC.upper_mg(&[fall(20.0, 3.0, mass_mg)], 0.1, Shaking::once(20.0, 3.0));
        assert!(after(1.0) < after(4.0) && after(4.0) < after(20.0));
        let calm: Vec<Fall> = (0..8).map(|_| fall(30.0, 1.0, 1.0)).collect();
        let upper = GENERIC.upper_mg(&calm, 0.1, Shaking::once(30.0, 1.0));
        assert!((1.0..6.0).contains(&upper), "{upper} mg after eight falls of 1 mg");
    }

    #[test]
    fn each_shake_takes_its_share_of_what_the_spoon_can_still_give() {
        // Falls that say nothing: the level sinks by w at each.
        let deaf = Forecast { scatter: 1e9, ..GENERIC };
        let falls = [fall(20.0, 3.0, 2.0); 5];
        let (level, _) = deaf.filtered(&falls, 1.0, Shaking::once(0.0, 1.0));
        assert!((level - (GENERIC.level - 5.0 * GENERIC.spent)).abs() < 1e-9, "{level}");
        // One fall, by the equations of the module.
        let said = 2.3f64.ln() - 0.09 * 20.0 - 0.75 * 3.0f64.ln();
        let gain = 0.64 / (0.64 + 0.35f64.powi(2) + (0.41 / 2.3f64).powi(2));
        let (level, variance) = GENERIC.filtered(&falls[..1], 1.0, Shaking::once(0.0, 1.0));
        assert!((level - (-2.3 + gain * (said + 2.3) - 0.15)).abs() < 1e-12, "{level}");
        assert!((variance - (0.64 * (1.0 - gain) + 0.09)).abs() < 1e-12, "{variance}");
    }

    #[test]
    fn a_gentle_first_shake_of_an_unknown_powder_is_no_risk_for_five_milligrams_and_a_hard_one_is()
    {
        assert!(GENERIC.chance_above(&[], 1.0, Shaking::once(4.0, 1.3), 6.0) < GENERIC.risk);
        assert!(GENERIC.chance_above(&[], 1.0, Shaking::once(20.0, 16.0), 6.0) > GENERIC.risk);
    }

    #[test]
    fn more_strokes_before_a_reading_may_let_more_fall_and_say_more_about_each() {
        let strokes = |strokes| Shaking { strokes, ..Shaking::once(40.0, 4.0) };
        for falls in [vec![], vec![fall(38.0, 4.0, 1.0), fall(40.0, 4.0, 1.0)]] {
            let upper = |n| GENERIC.upper_mg(&falls, 1.0, strokes(n));
            assert!(upper(1) < upper(2) && upper(2) < upper(8));
        }
        // 8 mg in eight strokes is 1 mg in one, and spends as much as eight.
        let level = |strokes, mass_mg| {
            let free = Forecast { spent: 0.0, scatter: 0.0, level_sd: 1e6, ..GENERIC };
            let fell = Fall { strokes, ..fall(40.0, 4.0, mass_mg - DUST_MG) };
            free.filtered(&[fell], 0.0, Shaking::once(40.0, 4.0)).0
        };
        assert!((level(8, 8.0) - level(1, 1.0)).abs() < 1e-6);
    }

    #[test]
    fn nothing_that_can_be_read_makes_the_bound_not_a_number() {
        let odd = [
            fall(10.0, 3.0, f64::NAN),
            fall(-10.0, 0.0, 3.0),
            fall(50.0, 16.0, -40.0),
            fall(50.0, 16.0, 1e6),
        ];
        assert!(GENERIC.upper_mg(&odd, 1.0, Shaking::once(50.0, 16.0)).is_finite());
    }
}
