//! What earlier spoonfuls of a powder say about the next one: where it begins to flow, how much a
//! shake releases, how that grows with the pitch and how it scatters, and how often a shake of a
//! spoon that flows is silent.
//!
//! Slope and scatter are those that make the readings of the earlier spoonfuls most plausible: the
//! likelihood of the filter of [`forecast`](super::forecast), from the first piece on and with
//! nothing known about the level before it, over a grid of both:
//!
//! ```text
//! p(k, r | falls) ~ N(k; 0.09, 0.03^2) N(ln r; ln 0.35, 0.3^2) prod t_4(surprise_i / sqrt(expected variance_i))
//! ```
//!
//! Their means replace `per_deg` and `scatter`. The prior's spread is that between the powders of the
//! table there (0.046 to 0.112 per degree); it leaves a slope that no powder had out of reach.

use super::forecast::{FIRST_PER_LN_MM, Fall, Forecast, Level, PIECE_MG, Shaking};
use super::settings::{AGITATED_DEG, hangs};
use flip_core::stats::normal::quantile;

/// SD of the slope between powders, 1/deg,
const PER_DEG_SD: f64 = 0.03;
/// and of the logarithm of the scatter.
const LN_SCATTER_SD: f64 = 0.3;
/// Nodes of the grid in each direction: quantiles of the prior.
const NODES: usize = 9;
/// Variance of the level of a spoonful of which nothing is known: a factor of 50 either way.
const UNKNOWN: f64 = 16.0;
/// Shakes that the prior of a piece's probability is worth.
const WAITED: f64 = 8.0;
/// Fewest shakes from which a share of silent ones is said.
const SHAKES_MIN: usize = 10;
/// Fewest spoonfuls from which the pitch is said at which a powder begins to flow.
const ONSETS_MIN: usize = 2;

/// What is expected of a powder before a dose of it begins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expected {
    /// Forecast of its shakes.
    pub forecast: Forecast,
    /// Probability that a spoonful stops flowing while powder is left in it ([`hangs`]).
    pub hangs: f64,
    /// Share of silent shakes while it flowed, if known ([`silent_share`]).
    pub silent_share: Option<f64>,
    /// Pitch at which it began to flow, degrees, if known ([`onset_deg`]).
    pub onset_deg: Option<f64>,
}

impl Expected {
    /// Of a powder about which nothing is known.
    pub const NOTHING: Self =
        Self { forecast: Forecast::GENERIC, hangs: 0.0, silent_share: None, onset_deg: None };

    /// Of a powder with this angle of repose, after these spoonfuls of it, each given by its shakes
    /// in order.
    pub fn of(repose_deg: f64, earlier: &[Vec<Fall>], readability_mg: f64) -> Self {
        // A powder that must be agitated comes in pieces.
        let forecast = match repose_deg > AGITATED_DEG {
            true => Forecast::GENERIC.in_pieces(),
            false => Forecast::GENERIC,
        };
        Self {
            forecast: forecast.informed(earlier, readability_mg),
            hangs: hangs(Some(repose_deg)),
            silent_share: silent_share(earlier, readability_mg),
            onset_deg: onset_deg(earlier, readability_mg),
        }
    }
}

impl Forecast {
    /// The prior updated with earlier spoonfuls of the powder, each given by its shakes in order.
    ///
    /// The slope and the scatter first, as in the table of the module. The initial levels of the
    /// spoonfuls, referred to 0 deg and 1 mm, and the logarithms of their first pieces, are then draws
    /// around the powder's own values; half of the prior's variance is assumed to be between powders
    /// and half between spoonfuls of one powder, so that n of them leave the fraction
    /// 1/2 + 1/(2 (n + 1)) of it:
    ///
    /// ```text
    /// mean = (prior + sum of x_i) / (n + 1)          variance = V / 2 + V / (2 (n + 1))
    /// ```
    ///
    /// The prior's level is kept where the powder flowed, not at 0 deg: a steeper slope begins lower.
    #[must_use]
    pub fn informed(&self, spoonfuls: &[Vec<Fall>], readability_mg: f64) -> Self {
        let prior = self.with_slope(spoonfuls, readability_mg);
        let levels = spoonfuls.iter().filter_map(|falls| prior.first_level(falls, readability_mg));
        let firsts = spoonfuls.iter().flat_map(|falls| prior.pieces(falls));
        let (level, level_sd) = pooled(prior.level, prior.level_sd, levels);
        let (first_ln_mg, first_sd) = pooled(prior.first_ln_mg, prior.first_sd, firsts);
        let first_chance =
            if self.in_pieces { self.piece_chance(spoonfuls) } else { self.first_chance };
        Self { level, level_sd, first_chance, first_ln_mg, first_sd, ..prior }
    }

    /// Shakes of a spoonful before which nothing fell: before the first piece, and after each silent
    /// shake where the powder comes in pieces.
    fn waited<'f>(&self, falls: &'f [Fall]) -> impl Iterator<Item = &'f Fall> {
        let in_pieces = self.in_pieces;
        let waits = move |k: usize| match in_pieces {
            true => k == 0 || falls[k - 1].mass_mg < PIECE_MG,
            false => falls[..k].iter().all(|fall| fall.mass_mg < PIECE_MG),
        };
        let shaken = falls.iter().enumerate().filter(|(_, fall)| fall.is_known());
        shaken.filter(move |(k, _)| waits(*k)).map(|(_, fall)| fall)
    }

    /// Logarithms of the pieces of a spoonful that came after nothing, referred to a shake of 1 mm.
    fn pieces(&self, falls: &[Fall]) -> Vec<f64> {
        let ln = |fall: &Fall| libm::log(fall.mass_mg) - FIRST_PER_LN_MM * libm::log(fall.shake_mm);
        self.waited(falls).filter(|fall| fall.mass_mg >= PIECE_MG).map(ln).collect()
    }

    /// Probability of such a piece: the prior counts as [`WAITED`] shakes. Only shakes after the first
    /// piece count: those before it may have been below the onset.
    fn piece_chance(&self, spoonfuls: &[Vec<Fall>]) -> f64 {
        let flowing = spoonfuls.iter().filter_map(|falls| Some(&falls[first(falls, PIECE_MG)?..]));
        let (mut shakes, mut pieces) = (WAITED, WAITED * self.first_chance);
        for fall in flowing.flat_map(|falls| self.waited(falls).skip(1)) {
            shakes += 1.0;
            pieces += if fall.mass_mg >= PIECE_MG { 1.0 } else { 0.0 };
        }
        pieces / shakes
    }

    /// The same with the slope and the scatter of these spoonfuls.
    fn with_slope(&self, spoonfuls: &[Vec<Fall>], readability_mg: f64) -> Self {
        let flowing: Vec<&[Fall]> =
            spoonfuls.iter().filter_map(|falls| Some(&falls[first(falls, PIECE_MG)?..])).collect();
        if flowing.iter().all(|falls| falls.len() < 2) {
            return *self;
        }
        let nodes = || (0..NODES).map(|k| quantile((k as f64 + 0.5) / NODES as f64));
        let candidates = nodes().flat_map(|slope| {
            nodes().map(move |scatter| Self {
                per_deg: self.per_deg + PER_DEG_SD * slope,
                scatter: self.scatter * libm::exp(LN_SCATTER_SD * scatter),
                ..*self
            })
        });
        let rated: Vec<(f64, Self)> = candidates
            .map(|it| {
                (flowing.iter().map(|falls| it.ln_likelihood(falls, readability_mg)).sum(), it)
            })
            .collect();
        let most = rated.iter().map(|it| it.0).fold(f64::NEG_INFINITY, f64::max);
        let weight = |of: &(f64, Self)| libm::exp(of.0 - most);
        let sum: f64 = rated.iter().map(weight).sum();
        let mean =
            |of: fn(&Self) -> f64| rated.iter().map(|it| weight(it) * of(&it.1)).sum::<f64>() / sum;
        let per_deg = mean(|it| it.per_deg);
        let pitch_deg =
            flowing.iter().map(|falls| falls[0].pitch_deg).sum::<f64>() / flowing.len() as f64;
        let level = self.level + (self.per_deg - per_deg) * pitch_deg;
        Self { level, per_deg, scatter: libm::exp(mean(|it| libm::log(it.scatter))), ..*self }
    }

    /// Logarithm of the probability of these falls, up to a constant, of a spoonful of unknown level.
    fn ln_likelihood(&self, falls: &[Fall], readability_mg: f64) -> f64 {
        let mut level = Level { at: self.level, variance: UNKNOWN };
        let one = |fall: &Fall| {
            let [surprise, variance] = level.learn(self, fall, readability_mg);
            -2.5 * libm::log1p(surprise.powi(2) / variance / 4.0) - 0.5 * libm::log(variance)
        };
        // The first says where the level is, whatever the slope.
        falls.iter().filter(|fall| fall.is_known()).map(one).skip(1).sum()
    }

    /// Initial level of a spoonful, at 0 deg and 1 mm: the filter's estimate from its first shakes
    /// up to the first piece.
    fn first_level(&self, falls: &[Fall], readability_mg: f64) -> Option<f64> {
        let n = 1 + first(falls, PIECE_MG)?;
        let strokes: u32 = falls[..n].iter().map(|fall| fall.strokes).sum();
        let level = self.filtered(&falls[..n], readability_mg, Shaking::once(0.0, 1.0)).0;
        Some(level + self.spent * f64::from(strokes))
    }
}

/// Pitch at which a powder began to flow, degrees: the median, over at least [`ONSETS_MIN`]
/// spoonfuls, of the pitch of the first shake that released a piece; `None` if too few did.
pub fn onset_deg(spoonfuls: &[Vec<Fall>], readability_mg: f64) -> Option<f64> {
    let piece_mg = readability_mg.max(PIECE_MG) - 1e-9;
    let onset = |falls: &Vec<Fall>| Some(falls[first(falls, piece_mg)?].pitch_deg);
    let mut pitches: Vec<f64> = spoonfuls.iter().filter_map(onset).collect();
    pitches.sort_by(f64::total_cmp);
    pitches.get(pitches.len() / 2).filter(|_| pitches.len() >= ONSETS_MIN).copied()
}

/// Probability that a shake of a spoon of this powder that flows leaves the display unchanged: the
/// share of such shakes in these spoonfuls, with one more of either kind. `None` if there are fewer
/// than [`SHAKES_MIN`].
///
/// Only shakes after which the display changed again count: of a display that then stayed the same
/// for good nobody knows that it was alive.
pub fn silent_share(spoonfuls: &[Vec<Fall>], readability_mg: f64) -> Option<f64> {
    let moved = |fall: &Fall| fall.mass_mg.abs() > readability_mg - 1e-9;
    let between = spoonfuls.iter().filter_map(|falls| {
        let (from, to) = (falls.iter().position(moved)?, falls.iter().rposition(moved)?);
        Some(&falls[from + 1..=to.max(from)])
    });
    let (all, silent) = between
        .flatten()
        .filter(|fall| fall.is_known())
        .fold((0, 0), |(all, silent), fall| (all + 1, silent + usize::from(!moved(fall))));
    (all >= SHAKES_MIN).then(|| (silent + 1) as f64 / (all + 2) as f64)
}

/// Index of the first fall of this mass.
fn first(falls: &[Fall], piece_mg: f64) -> Option<usize> {
    falls.iter().position(|fall| fall.mass_mg >= piece_mg)
}

/// Posterior mean and standard deviation after these draws, of a prior with half of its variance
/// between powders.
fn pooled(mean: f64, sd: f64, draws: impl Iterator<Item = f64>) -> (f64, f64) {
    let (n, sum) = draws.fold((0.0, mean), |(n, sum), x| (n + 1.0, sum + x));
    (sum / (n + 1.0), sd * (0.5 + 0.5 / (n + 1.0)).sqrt())
}

#[cfg(test)]
mod tests {
    use super::super::forecast::DUST_MG;
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    const GENERIC: Forecast = Forecast::GENERIC;

    fn fall(pitch_deg: f64, shake_mm: f64, mass_mg: f64) -> Fall {
        Fall { pitch_deg, shake_mm, strokes: 1, mass_mg }
    }

    #[test]
    fn a_powder_that_came_in_large_pieces_before_is_expected_to_do_so_again() {
        let doses = |mass_mg: f64| vec![vec![fall(8.0, 3.0, 0.0), fall(12.0, 3.0, mass_mg)]; 5];
        let upper = |forecast: &Forecast| forecast.upper_mg(&[], 1.0, Shaking::once(12.0, 3.0));
        let [small, large] =
            [1.0, 12.0].map(|mass_mg| upper(&GENERIC.informed(&doses(mass_mg), 1.0)));
        assert!(
            small < upper(&GENERIC) && upper(&GENERIC) < large,
            "{small} {} {large}",
            upper(&GENERIC)
        );
        assert_eq!(GENERIC.informed(&[], 1.0), GENERIC);
        assert_eq!(
            GENERIC.informed(&[vec![fall(8.0, 3.0, 0.0)]], 1.0),
            GENERIC,
            "a dose without a piece says nothing"
        );
    }

    #[test]
    fn a_powders_onset_is_the_median_pitch_of_its_first_pieces() {
        let dose =
            |onset: f64| vec![fall(8.0, 3.0, 0.0), fall(onset, 3.0, 2.0), fall(50.0, 3.0, 9.0)];
        assert_eq!(onset_deg(&[dose(46.0), dose(20.0), dose(48.0)], 1.0), Some(46.0));
        assert_eq!(onset_deg(&[dose(46.0)], 1.0), None, "one may be odd");
        assert_eq!(onset_deg(&[vec![fall(8.0, 3.0, 0.4)]], 0.1), None);
        assert_eq!(onset_deg(&[], 1.0), None);
    }

    /// Spoonfuls of the forecast's own model: levels, wander and falls drawn from it, these with the
    /// tails of Student's t, at pitches that go down after a large fall and up after a small one, as
    /// a policy's do.
    fn drawn(truth: &Forecast, spoonfuls: usize, seed: u64) -> Vec<Vec<Fall>> {
        let mut rng = Pcg64::seed_from_u64(seed);
        let mut uniform = || rng.random_range(1e-9..1.0f64);
        let mut spoonful = |_| {
            let mut level = 1.0 + 0.4 * quantile(uniform()) - truth.per_deg * 24.0;
            let (mut pitch_deg, mut falls) = (20.0, Vec::new());
            for _ in 0..12 {
                let at = level + truth.per_deg * pitch_deg + truth.per_ln_mm * 2.0f64.ln();
                // Over a quarter of chi squared with four degrees of freedom.
                let t4 = quantile(uniform()) / (-0.5 * (uniform() * uniform()).ln()).sqrt();
                let mass_mg = ((at + truth.scatter * t4).exp() - DUST_MG).max(0.0);
                falls.push(fall(pitch_deg, 2.0, mass_mg));
                level += truth.wander * quantile(uniform()) - truth.spent;
                pitch_deg += if mass_mg > 3.0 { -5.0 } else { 4.0 };
            }
            falls
        };
        (0..spoonfuls).map(&mut spoonful).collect()
    }

    #[test]
    fn slope_and_scatter_of_the_models_own_spoonfuls_are_found() {
        for (per_deg, scatter) in [(0.05, 0.25), (0.09, 0.35), (0.13, 0.6)] {
            let truth = Forecast { per_deg, scatter, ..GENERIC };
            let found: Vec<Forecast> =
                (0..20).map(|seed| GENERIC.informed(&drawn(&truth, 12, seed), 0.1)).collect();
            let off = |of: &dyn Fn(&Forecast) -> f64| {
                found.iter().map(of).sum::<f64>() / found.len() as f64
            };
            let (slope, scatters) =
                (off(&|it| it.per_deg - per_deg), off(&|it| (it.scatter / scatter).ln()));
            // Half of the prior's spread, each.
            assert!(slope.abs() < PER_DEG_SD / 2.0, "{per_deg}: off by {slope}");
            assert!(scatters.abs() < LN_SCATTER_SD / 2.0, "{scatter}: off by e^{scatters}");
        }
    }

    #[test]
    fn the_forecast_stays_where_the_powder_flowed_when_its_slope_changes() {
        let steep = Forecast { per_deg: 0.14, ..GENERIC };
        let doses = drawn(&steep, 12, 1);
        let informed = GENERIC.with_slope(&doses, 0.1);
        let at = |of: &Forecast, pitch_deg| of.upper_mg(&[], 0.1, Shaking::once(pitch_deg, 2.0));
        let mean_deg =
            doses.iter().map(|falls| falls[first(falls, PIECE_MG).unwrap()].pitch_deg).sum::<f64>()
                / doses.len() as f64;
        let same = Forecast { scatter: GENERIC.scatter, ..informed };
        assert!((at(&same, mean_deg) / at(&GENERIC, mean_deg)).ln().abs() < 0.02);
        assert!(at(&same, mean_deg + 10.0) > at(&GENERIC, mean_deg + 10.0));
    }

    #[test]
    fn a_powder_that_comes_in_pieces_may_free_one_after_any_silence() {
        let dose = |piece_mg: f64| {
            let silent = |n: usize| vec![fall(60.0, 4.0, 0.0); n];
            let piece = || vec![fall(60.0, 4.0, piece_mg)];
            [silent(6), piece(), silent(3), piece(), silent(3), piece()].concat()
        };
        let sticky = GENERIC.in_pieces();
        let quiet = [dose(2.0), vec![fall(60.0, 4.0, 0.0); 3]].concat();
        let chance = |of: &Forecast| of.chance_above(&quiet, 1.0, Shaking::once(60.0, 4.0), 8.0);
        // A piece above 8 mg from 4 mm: 0.12 of the normal tail beyond (ln 8 - 0.14 - 0.55 ln 4) / 1.
        let piece = 0.12 * 0.1196;
        let more = chance(&sticky) - (1.0 - 0.12) * chance(&GENERIC);
        assert!((more - piece).abs() < 1e-4, "{more}");
        // Not right after a piece: then the level says what follows.
        let fell = dose(2.0);
        let after =
            |of: &Forecast| of.chance_above(&fell, 1.0, Shaking::once(60.0, 4.0), 8.0).to_bits();
        assert_eq!(after(&sticky), after(&GENERIC));
        let [small, large] =
            [1.0, 8.0].map(|mg| chance(&sticky.informed(&[dose(mg), dose(mg)], 1.0)));
        assert!(small < chance(&sticky) && chance(&sticky) < large, "{small} {large}");
        // After the first piece, two more in six shakes that followed a silent one, twice.
        let known = sticky.informed(&[dose(2.0), dose(2.0)], 1.0);
        assert!((known.first_chance - (0.96 + 4.0) / (8.0 + 12.0)).abs() < 1e-12);
        assert_eq!(GENERIC.informed(&[dose(2.0)], 1.0).first_chance, GENERIC.first_chance);
        let expected = |deg: f64| Expected::of(deg, &[], 1.0).forecast;
        assert_eq!((expected(45.0), expected(46.0)), (GENERIC, sticky));
    }

    #[test]
    fn a_spoonful_after_another_is_one_of_its_own() {
        use flip_core::domain::bench::{Action, Reading, Tick};
        let tick = |spoonful, pitch_deg, shake_mm, mass_mg| Tick {
            step: 1,
            t_s: 0.0,
            pitch_deg,
            action: Action::once(0.0, shake_mm),
            reading: Reading { mass_mg, stable: true },
            spoonful,
        };
        let ticks = [
            tick(1, 0.0, 0.0, 0.0),
            tick(1, 30.0, 4.0, 2.0),
            tick(1, 34.0, 0.0, 2.5),
            tick(2, 0.0, 0.0, 3.5),
            tick(2, 28.0, 2.0, 5.0),
        ];
        assert_eq!(Fall::of(&ticks), [vec![fall(30.0, 4.0, 2.0)], vec![fall(28.0, 2.0, 1.5)]]);
        assert!(Fall::of(&[]).is_empty());
    }

    #[test]
    fn silent_shakes_count_only_between_two_changes_of_the_display() {
        let falls = |masses: &[f64]| -> Vec<Fall> {
            masses.iter().map(|mass_mg| fall(30.0, 4.0, *mass_mg)).collect()
        };
        // Before the first piece nothing flows yet, and after the last nobody knows.
        let one = falls(&[0.0, 0.0, 2.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
        assert_eq!(silent_share(std::slice::from_ref(&one), 1.0), None, "five shakes are few");
        let share = silent_share(&[one.clone(), one.clone()], 1.0).unwrap();
        assert!((share - (6.0 + 1.0) / (10.0 + 2.0)).abs() < 1e-12, "{share}");
        assert_eq!(silent_share(&vec![falls(&[0.0; 9]); 9], 1.0), None);
        assert_eq!(silent_share(&[], 1.0), None);
        let noise = vec![falls(&[2.0, 0.4, 0.4, 1.0]); 4];
        assert!(silent_share(&noise, 1.0).unwrap() > 0.6, "less than a step of the display");
    }
}
