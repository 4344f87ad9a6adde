//! The simulated bench that signatures come from: what a shaken spoon dispenses, and what the
//! balance shows.
//!
//! Signatures are differences of two runs of this bench over the recorded actions, times and fills,
//! one with the mechanism at a small size and one without. Scatter of shakes and of readings is the
//! same in both and cancels, so it is left out of both.
//!
//! ```text
//! mass of shake k        d_k = mu_k (1 + a g_k)                    mu_k: the powder's own response, fitted
//! mass on the pan        m(t) = sum over t_k <= t of d_k
//! reading                y(t) = m(t) + a c(t) + a sum over t_k <= t of w_k kappa(t - t_k)
//! ```
//!
//! | mechanism | w_k | kappa(x) | c(t) |
//! |---|---|---|---|
//! | `balance_drift` | | | t, or T (1 - exp(-t / T)) |
//! | `balance_lag` | d_k | -exp(-x / T), or -max(0, 1 - x / T) | |
//! | `mass_uptake`, `evaporation` | d_k f(humidity) | x, or T (1 - exp(-x / T)); minus that | |
//! | `balance_static` | f(humidity) | exp(-x / T) | |
//!
//! | mechanism | g_k of shake n, after p mg | |
//! |---|---|---|
//! | `spoon_holdup` | -exp(-(n - 1) / N), -exp(-p / P) | |
//! | `fill_level` | log of the fill over its mean | d ~ fill^a |
//! | `densification` | -log(1 + n / N), -n | over their size at n = 10 |
//! | `actuator` | log(1 - b / A), -A of the amplitude A | over their range; b: backlash |
//!
//! A reading that relaxes to its plateau comes from a first-order filter, where lag is the part `a`
//! that passes through it, or from a moving average. Source: derived here; first-order and
//! moving-average filters are textbook, the forms of the spoon are ours and none of their numbers
//! was measured.

use super::design::Design;
use super::readings::Kind;

/// A possible effect on the readings, of unit size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Sensor {
    /// mg/s; the time after which it levels off, s.
    Drift { ends_s: f64 },
    /// Share of the reading that lags; the filter's time, s.
    Lag { tau_s: f64 },
    /// As [`Self::Lag`] with a moving average.
    Average { window_s: f64 },
    /// Share of the mass per second.
    Uptake { humidity: Humidity, ends_s: f64 },
    /// mg after each shake; the time in which it decays, s.
    Static { humidity: Humidity, decay_s: f64 },
}

/// Effect of humidity, as a factor: 1 at 60 % where damp increases it, at 20 % where damp reduces
/// it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Humidity {
    /// Nothing.
    Any,
    /// As h^m.
    Humid(i32),
    /// Linear above 40 %, nothing below.
    Above,
    /// As 1 - h.
    Dry,
    /// As (45 % - h)^m below 45 %, nothing above: charge leaks away where surfaces adsorb water.
    Charged(i32),
}

/// A possible effect on the mass of a shake, of unit size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Spoon {
    /// Share of a shake that is held back; the number of shakes it lasts.
    HoldupShakes { lasts: f64 },
    /// As [`Self::HoldupShakes`] over the mass poured, mg.
    HoldupMass { lasts_mg: f64 },
    /// Exponent of the fill.
    Fill,
    /// Fall of log mass by shake 10, as log(1 + shakes / this).
    Densification { shakes: f64 },
    /// Fall of log mass by shake 10, equal for each shake.
    DensificationSteady,
    /// Rise of log mass over the recorded amplitudes, as log(1 - b / A); the backlash b, mm.
    Backlash { backlash_mm: f64 },
    /// Fall of log mass over the recorded amplitudes, as A.
    Saturation,
}

impl Humidity {
    fn factor(self, humidity_pct: f64) -> f64 {
        let h = humidity_pct / 100.0;
        match self {
            Self::Any => 1.0,
            Self::Humid(power) => (h / 0.6).powi(power),
            Self::Above => (h - 0.4).max(0.0) / 0.2,
            Self::Dry => (1.0 - h) / 0.8,
            Self::Charged(power) => ((0.45 - h).max(0.0) / 0.25).powi(power),
        }
    }
}

/// Relaxation over x seconds that levels off in T, T (1 - exp(-x / T)); x if it never does.
fn until(x: f64, ends_s: f64) -> f64 {
    if ends_s.is_finite() { -ends_s * libm::expm1(-x / ends_s) } else { x }
}

/// The bench as it was used.
pub(super) struct Bench<'a> {
    pub design: &'a Design,
    /// Mass of each plateau above the one before, mg; for the first of a log its own, in doses, and
    /// zero in controls.
    steps_mg: Vec<f64>,
    /// Relative humidity of each plateau, percent.
    humidity_pct: Vec<f64>,
}

impl<'a> Bench<'a> {
    /// The bench over the final masses on the balance.
    pub fn new(design: &'a Design) -> Self {
        let levels = design.levels(&design.shown_mg);
        let known: Vec<f64> =
            design.plateaus.iter().filter_map(|plateau| plateau.humidity_pct).collect();
        let middle = flip_core::stats::summary::mean(&known).unwrap_or(50.0);
        let mut steps_mg = vec![0.0; levels.len()];
        for log in &design.logs {
            for k in log.plateaus.clone() {
                let is_first = k == log.plateaus.start;
                steps_mg[k] = match (is_first, log.kind) {
                    (false, _) => levels[k] - levels[k - 1],
                    (true, Kind::Dose) => levels[k],
                    (true, _) => 0.0,
                };
            }
        }
        let humidity_pct =
            design.plateaus.iter().map(|plateau| plateau.humidity_pct.unwrap_or(middle)).collect();
        Self { design, steps_mg, humidity_pct }
    }

    /// Simulated reading at each time with an effect of this size, mg.
    pub fn shown_mg(&self, effect: Sensor, size: f64) -> Vec<f64> {
        let mut shown = Vec::with_capacity(self.design.times_s.len());
        for log in &self.design.logs {
            let mut mass = 0.0;
            for k in log.plateaus.clone() {
                mass += self.steps_mg[k];
                for &t in &self.design.times_s[self.design.plateaus[k].readings.clone()] {
                    let memory: f64 = (log.plateaus.start..=k)
                        .map(|j| {
                            let is_step = j > log.plateaus.start;
                            self.weight(effect, j, log.kind, is_step)
                                * memory(effect, t - self.design.plateaus[j].step_s)
                        })
                        .sum();
                    let course =
                        if let Sensor::Drift { ends_s } = effect { until(t, ends_s) } else { 0.0 };
                    shown.push(mass + size * (course + memory));
                }
            }
        }
        shown
    }

    /// w of plateau j.
    fn weight(&self, effect: Sensor, j: usize, kind: Kind, is_step: bool) -> f64 {
        match effect {
            Sensor::Lag { .. } | Sensor::Average { .. } if is_step => self.steps_mg[j],
            // The powder in the vial takes up water, the standard does not.
            Sensor::Uptake { humidity, .. } if kind == Kind::Dose => {
                self.steps_mg[j] * humidity.factor(self.humidity_pct[j])
            }
            Sensor::Static { humidity, .. }
                if kind == Kind::Dose && (is_step || self.steps_mg[j] > 0.0) =>
            {
                humidity.factor(self.humidity_pct[j])
            }
            _ => 0.0,
        }
    }

    /// The mass of each shake with an effect of this size, mg, where the powder's own response is
    /// `nominal`, mg.
    pub fn masses_mg(&self, nominal: &[f64], effect: Spoon, size: f64) -> Vec<f64> {
        let (design, mut poured, mut log) = (self.design, 0.0, usize::MAX);
        let fills: Vec<f64> = design
            .plateaus
            .iter()
            .filter_map(|plateau| plateau.fill_mg)
            .filter(|&mg| mg > 0.0)
            .collect();
        let typical = flip_core::stats::summary::mean(&fills).unwrap_or(1.0);
        let amplitudes =
            || design.plateaus.iter().filter_map(|plateau| plateau.shake_mm).filter(|&mm| mm > 0.0);
        let (least, most) =
            (amplitudes().fold(f64::INFINITY, f64::min), amplitudes().fold(0.0, f64::max));
        let bent = |backlash_mm: f64, mm: f64| libm::log((1.0 - backlash_mm / mm).max(0.05));
        let bend = |backlash_mm: f64| bent(backlash_mm, most) - bent(backlash_mm, least);
        let one = |(shake, &mg): (&super::design::Shake, &f64)| {
            if shake.log != log {
                (log, poured) = (shake.log, 0.0);
            }
            let after = &design.plateaus[shake.after];
            let before = shake.before.map_or(after, |k| &design.plateaus[k]);
            let fill = before.fill_mg.or(after.fill_mg).unwrap_or(typical).max(0.02 * typical);
            let amplitude = after.shake_mm.unwrap_or(1.0);
            let course = match effect {
                Spoon::HoldupShakes { lasts } => -libm::exp(-(shake.number - 1.0).max(0.0) / lasts),
                Spoon::HoldupMass { lasts_mg } => -libm::exp(-poured / lasts_mg),
                Spoon::Fill => libm::log(fill / typical),
                Spoon::Densification { shakes } => {
                    -libm::log1p(shake.number / shakes) / libm::log1p(10.0 / shakes)
                }
                Spoon::DensificationSteady => -shake.number / 10.0,
                Spoon::Backlash { backlash_mm } => bent(backlash_mm, amplitude) / bend(backlash_mm),
                Spoon::Saturation => -amplitude / (most - least),
            };
            poured += mg;
            mg * (1.0 + size * course)
        };
        design.shakes.iter().zip(nominal).map(one).collect()
    }
}

/// kappa, of unit size.
fn memory(effect: Sensor, x: f64) -> f64 {
    match effect {
        Sensor::Drift { .. } => 0.0,
        Sensor::Lag { tau_s } => -libm::exp(-x / tau_s),
        Sensor::Average { window_s } => -(1.0 - x / window_s).max(0.0),
        Sensor::Uptake { ends_s, .. } => until(x, ends_s),
        Sensor::Static { decay_s, .. } => libm::exp(-x / decay_s),
    }
}
