//! Mass that an unchanged display may hide, on balances whose display stays constant for minutes
//! when all is well (`Readings::life_s` 0): a spoon that releases nothing and a stuck balance look
//! the same.
//!
//! Spoons follow the dispenser's model ([`Response`]): the loose mass depends on the pitch and on
//! the mass that has fallen, so a spoon that has just released a large piece is expected to release
//! nothing until it is inclined further. [`GUESSES`] spoonfuls g are weighted by the display up to
//! its last change; for the z shakes since then each predicts the mass that should have fallen, S_g
//! with its variance. A live display of step d does not change for a sum S with probability 1 - S /
//! d, as the sum begins anywhere within a step:
//!
//! ```text
//! live      = sum over g of w_g E max(0, 1 - S_g / d)                                  S_g log-normal
//! P(still)  = p / (p + live)                                                           p = 0.003 before the dose
//! P(S + next > u | still) = sum over g of w_g P(S_g + next_g > u)
//! ```
//!
//! No statement is made before the display has changed once: a powder that comes late cannot be
//! told from a display that was never alive.

use super::forecast::{Fall, Shaking};
use flip_core::stats::normal::{cdf, quantile};
use flip_policy::{Response, Spoonful};
use std::sync::LazyLock;

/// Number of candidate spoonfuls.
const GUESSES: usize = 384;
/// Nodes for the expectation over the mass that should have fallen.
const NODES: usize = 16;
/// Probability from which a display counts as stuck,
const RATHER: f64 = 0.5;
/// and from which nothing else is tried.
const SURELY: f64 = 0.9;

/// Spoon model.
const RESPONSE: Response = Response::FITTED;
static SPOONFULS: LazyLock<Vec<Spoonful>> = LazyLock::new(|| RESPONSE.guesses(GUESSES));
static Z: LazyLock<Vec<f64>> =
    LazyLock::new(|| (0..NODES).map(|k| quantile((k as f64 + 0.5) / NODES as f64)).collect());

/// A display that stayed constant through one shake or more, after it had changed.
#[derive(Debug, Clone)]
pub struct Silence {
    /// Number of shakes.
    pub shakes: usize,
    /// Probability that the display is stuck.
    pub still: f64,
    /// Probability of the silence on a display that is alive.
    live: f64,
    /// Prior probability of a stuck one.
    stands_still: f64,
    shown_mg: f64,
    hidden: Vec<Hidden>,
}

/// The mass that one of the spoonfuls would have released meanwhile.
#[derive(Debug, Clone, Copy)]
struct Hidden {
    weight: f64,
    mean_mg: f64,
    variance: f64,
}

/// Prediction of one spoonful for a dose.
#[derive(Debug, Clone, Copy, Default)]
struct Account {
    ln_weight: f64,
    mean_mg: f64,
    variance: f64,
}

impl Silence {
    /// The silence at the end of these shakes, with prior probability `stands_still` of a stuck
    /// display; `None` if the last one changed the display, or none has.
    pub fn after(falls: &[Fall], readability_mg: f64, stands_still: f64) -> Option<Self> {
        let moved = |fall: &Fall| fall.mass_mg.abs() > readability_mg - 1e-9;
        let falls = falls.iter().filter(|fall| fall.shake_mm > 0.0 && fall.mass_mg.is_finite());
        let shakes = falls.clone().rev().position(moved)?;
        if shakes == 0 || stands_still <= 0.0 {
            return None;
        }
        let mut accounts = vec![Account::default(); GUESSES];
        let mut shown_mg = 0.0f64;
        for fall in falls {
            for (account, spoonful) in accounts.iter_mut().zip(SPOONFULS.iter()) {
                for _ in 0..fall.strokes {
                    let poured_mg = shown_mg.max(0.0) + account.mean_mg;
                    let mean_mg =
                        spoonful.mean_mg(&RESPONSE, fall.pitch_deg, fall.shake_mm, poured_mg);
                    let [more_mg, variance] = RESPONSE.moments(mean_mg);
                    account.mean_mg += mean_mg + more_mg;
                    account.variance += variance;
                }
                if moved(fall) {
                    // Variance of the difference of two rounded readings; Student's t with four
                    // degrees of freedom, because avalanches happen.
                    let variance = account.variance + readability_mg.powi(2) / 6.0;
                    let z2 = (fall.mass_mg - account.mean_mg).powi(2) / variance;
                    account.ln_weight -= 2.5 * libm::log1p(z2 / 4.0) + 0.5 * libm::log(variance);
                    (account.mean_mg, account.variance) = (0.0, 0.0);
                }
            }
            shown_mg += if moved(fall) { fall.mass_mg } else { 0.0 };
        }
        let most =
            accounts.iter().map(|account| account.ln_weight).fold(f64::NEG_INFINITY, f64::max);
        let sum: f64 = accounts.iter().map(|account| libm::exp(account.ln_weight - most)).sum();
        let of = |account: &Account| Hidden {
            weight: libm::exp(account.ln_weight - most) / sum,
            mean_mg: account.mean_mg,
            variance: account.variance,
        };
        let hidden: Vec<Hidden> = accounts.iter().map(of).collect();
        let live: f64 = hidden.iter().map(|it| it.weight * it.unseen(readability_mg)).sum();
        let still = stands_still / (stands_still + live);
        Some(Self { shakes, still, live, stands_still, shown_mg, hidden })
    }

    /// The same silence of a powder whose shakes were silent in this share, if known, while it
    /// flowed: n in a row then happen with at least the n-th power of it on a display that is alive.
    #[must_use]
    pub fn as_before(self, share: Option<f64>) -> Self {
        let chance = share.map_or(0.0, |share| libm::pow(share, self.shakes as f64));
        self.unless(chance)
    }

    /// The same silence of a powder that stops flowing with this probability while powder is left: a
    /// display that is alive is then silent with at least that probability.
    #[must_use]
    pub fn unless(self, hangs: f64) -> Self {
        let live = self.live.max(hangs);
        Self { live, still: self.stands_still / (self.stands_still + live), ..self }
    }

    /// Whether the display is more likely stuck than not.
    pub fn is_still(&self) -> bool {
        self.still > RATHER
    }

    /// Whether hardly anything speaks for a display that is alive.
    pub fn is_surely_still(&self) -> bool {
        self.still > SURELY
    }

    /// Probability that a shake releases more than `room_mg`, including the mass that has fallen
    /// unseen; `seen` is that probability for a display that is trusted.
    pub fn chance_above(&self, seen: f64, shake: Shaking, room_mg: f64) -> f64 {
        let with = |(hidden, spoonful): (&Hidden, &Spoonful)| {
            let mut sum = *hidden;
            for _ in 0..shake.strokes {
                let poured_mg = self.shown_mg.max(0.0) + sum.mean_mg;
                let mean_mg =
                    spoonful.mean_mg(&RESPONSE, shake.pitch_deg, shake.shake_mm, poured_mg);
                let [more_mg, variance] = RESPONSE.moments(mean_mg);
                sum.mean_mg = sum.mean_mg + mean_mg + more_mg;
                sum.variance += variance;
            }
            hidden.weight * sum.chance_above(room_mg)
        };
        let unseen: f64 = self.hidden.iter().zip(SPOONFULS.iter()).map(with).sum();
        seen + self.still * (unseen - seen).max(0.0)
    }

    /// Mass fallen unseen if the display is stuck, mg.
    pub fn hidden_mg(&self) -> f64 {
        self.hidden.iter().map(|it| it.weight * it.mean_mg).sum()
    }
}

impl Hidden {
    /// Mean and standard deviation of the logarithm of a log-normal mass.
    fn ln(&self) -> [f64; 2] {
        let variance = libm::log1p(self.variance / self.mean_mg.powi(2));
        [libm::log(self.mean_mg) - variance / 2.0, variance.sqrt()]
    }

    /// Probability that a display of this step shows none of it.
    fn unseen(&self, readability_mg: f64) -> f64 {
        let [mean, sd] = self.ln();
        Z.iter().map(|z| (1.0 - libm::exp(mean + sd * z) / readability_mg).max(0.0)).sum::<f64>()
            / NODES as f64
    }

    fn chance_above(&self, mass_mg: f64) -> f64 {
        let [mean, sd] = self.ln();
        if mass_mg <= 0.0 { 1.0 } else { cdf((mean - libm::log(mass_mg)) / sd) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const STANDS: f64 = 0.003;

    fn fall(pitch_deg: f64, shake_mm: f64, mass_mg: f64) -> Fall {
        Fall { pitch_deg, shake_mm, strokes: 1, mass_mg }
    }

    fn after(falls: &[Fall], readability_mg: f64) -> Silence {
        Silence::after(falls, readability_mg, STANDS).expect("a silence")
    }

    /// A course that released 2 mg per shake, each 2 deg higher, and then nothing.
    fn course(silent: usize) -> Vec<Fall> {
        let pitch_deg = |k: usize| 14.0 + 2.0 * k as f64;
        (0..5 + silent).map(|k| fall(pitch_deg(k), 4.0, if k < 5 { 2.0 } else { 0.0 })).collect()
    }

    #[test]
    fn there_is_no_silence_before_the_display_has_moved_nor_where_it_moved_last() {
        assert!(Silence::after(&[], 1.0, STANDS).is_none());
        assert!(Silence::after(&[fall(40.0, 16.0, 0.0); 9], 1.0, STANDS).is_none());
        assert!(Silence::after(&course(0), 1.0, STANDS).is_none());
        assert!(
            Silence::after(&course(3), 1.0, 0.0).is_none(),
            "who believes the display asks for nothing"
        );
        assert_eq!(after(&course(3), 1.0).shakes, 3);
    }

    #[test]
    fn the_longer_the_silence_the_likelier_the_display_stands_and_a_fine_one_sooner() {
        let still =
            |silent: usize, readability_mg: f64| after(&course(silent), readability_mg).still;
        assert!(
            (1..8).all(|n| still(n, 1.0) < still(n + 1, 1.0)),
            "{:?}",
            [1, 2, 3, 4].map(|n| still(n, 1.0))
        );
        assert!((1..4).all(|n| still(n, 1.0) < still(n, 0.1)));
        assert!(still(1, 1.0) < 0.05, "{}", still(1, 1.0));
        assert!(!after(&course(1), 1.0).is_still() && after(&course(8), 1.0).is_still());
        let hidden = |silent: usize| after(&course(silent), 1.0).hidden_mg();
        // 2 mg per shake before, each 2 deg higher.
        assert!(
            (1.0..4.0).contains(&hidden(1)) && (4.0..16.0).contains(&hidden(5)),
            "{} {}",
            hidden(1),
            hidden(5)
        );
    }

    #[test]
    fn after_a_large_piece_gentle_shakes_are_silent_and_that_is_no_sign() {
        // A simulated spoon of salt: 1.4 and 10.7 mg, then nothing up to 13 deg.
        let falls = [fall(4.0, 3.0, 1.4), fall(6.0, 7.0, 10.7), fall(3.0, 1.0, 0.0)];
        let falls = [&falls[..], &[fall(6.0, 1.0, 0.0), fall(9.0, 1.0, 0.0), fall(13.0, 1.0, 0.0)]]
            .concat();
        assert!(after(&falls, 0.1).still < 0.05, "{}", after(&falls, 0.1).still);
    }

    #[test]
    fn silence_of_a_powder_that_was_often_silent_is_less_of_a_sign_and_a_long_one_still_is() {
        let as_before = |silent, share| after(&course(silent), 0.1).as_before(share).still;
        let model = |silent| after(&course(silent), 0.1).still;
        assert_eq!(as_before(3, None).to_bits(), model(3).to_bits());
        assert!(as_before(3, Some(0.5)) < 0.03 && 0.03 < model(3), "{}", model(3));
        assert!((as_before(3, Some(0.5)) - 0.003 / (0.003 + 0.125)).abs() < 1e-12);
        assert!(as_before(9, Some(0.5)) > 0.5, "{}", as_before(9, Some(0.5)));
        assert_eq!(as_before(3, Some(1e-9)).to_bits(), model(3).to_bits(), "it never adds doubt");
    }

    #[test]
    fn what_is_hidden_leaves_less_room_and_never_more() {
        let silence = after(&course(4), 0.1);
        for (room_mg, seen) in [(2.0, 0.01), (6.0, 0.001), (30.0, 0.0), (0.0, 1.0), (-1.0, 1.0)] {
            let chance = silence.chance_above(seen, Shaking::once(32.0, 4.0), room_mg);
            assert!((seen..=1.0).contains(&chance), "{room_mg} mg: {chance}");
        }
        let chance = |room_mg: f64| silence.chance_above(0.0, Shaking::once(32.0, 4.0), room_mg);
        assert!(chance(2.0) > chance(10.0) && chance(10.0) > chance(40.0));
    }

    /// Spoons from the model, on live displays: a silence of probability a occurs in at most a
    /// fraction a of the doses that could have it.
    #[test]
    fn spoons_of_the_model_are_seldom_taken_for_displays_that_stand() {
        let doses = 2000;
        let alarms = (0..doses).filter(|dose| {
            let z = |k: usize, base: usize| {
                quantile(((dose * 7919 + k * 104_729) as f64 / base as f64).fract())
            };
            let spoonful =
                RESPONSE.spoonful([z(1, 1009), z(2, 2003), z(3, 3001)].map(|z| z.clamp(-3.0, 3.0)));
            let (mut vial_mg, mut falls) = (0.0f64, Vec::new());
            (0..20).any(|k| {
                let pitch_deg = 4.0 + 2.0 * k as f64;
                let before_mg = vial_mg.round();
                let mean_mg = spoonful.mean_mg(&RESPONSE, pitch_deg, 3.0, vial_mg);
                vial_mg +=
                    if mean_mg > 0.0 { RESPONSE.draw(mean_mg, z(10 + k, 4001)) } else { 0.0 };
                falls.push(fall(pitch_deg, 3.0, vial_mg.round() - before_mg));
                Silence::after(&falls, 1.0, STANDS).is_some_and(|silence| silence.is_still())
            })
        });
        // still > 1/2 requires a probability below 0.003; twenty checks of one course may raise it.
        let share = alarms.count() as f64 / doses as f64;
        assert!(share < 0.02, "{share}");
    }

    proptest! {
        #[test]
        fn whatever_was_read_chances_are_chances(
            falls in prop::collection::vec((-10.0..50.0, 0.0..16.0, prop_oneof![-50.0..1e6, Just(0.0), Just(f64::NAN)]), 0..12),
            room_mg in -10.0..1e3,
        ) {
            let falls: Vec<Fall> = falls.into_iter().map(|(pitch, shake, mass)| fall(pitch, shake, mass)).collect();
            if let Some(silence) = Silence::after(&falls, 0.1, STANDS) {
                prop_assert!((0.0..=1.0).contains(&silence.still), "{}", silence.still);
                let chance = silence.chance_above(0.01, Shaking::once(30.0, 4.0), room_mg);
                prop_assert!((0.0..=1.0).contains(&chance), "{chance}");
            }
        }
    }
}
