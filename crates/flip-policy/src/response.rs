//! A model with few parameters of the mass released by a shaken spoon: the prior of a dispenser.

use flip_core::domain::{FieldError, bounded};
use flip_core::stats::normal::quantile;
use serde::{Deserialize, Serialize};

/// Distribution of simulated spoons over powders and spoonfuls: the prior of a dispenser, and its
/// loss.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Response {
    /// Pitch at which a spoon begins to release powder, degrees: mean and standard deviation.
    pub onset_deg: [f64; 2],
    /// ln of the mass released per further degree, mg: mean and standard deviation.
    pub ln_slope_mg_deg: [f64; 2],
    /// ln of the amplitude that releases most of the loose powder, mm: mean and standard deviation.
    pub ln_stroke_mm: [f64; 2],
    /// Correlations of onset and slope, of onset and stroke, of slope and stroke: a spoon that
    /// begins late releases more per degree.
    pub correlations: [f64; 3],
    /// Exponent of the amplitude over the stroke.
    pub bend: f64,
    /// Pitch equivalent of a shake of e mm over one of 1 mm, degrees.
    pub reach_deg: f64,
    /// Width over which the onset is spread, degrees.
    pub width_deg: f64,
    /// Scatter of the square root of a small mass, mg^(1/2).
    pub floor: f64,
    /// Scatter of the square root of a mass as a share of the square root of its mean; twice this
    /// is the coefficient of variation.
    pub scatter: f64,
    /// Factor on the scatter, since the model is not exact.
    pub caution: f64,
    /// Mass held by a spoon, mg; an upper limit on what it can release.
    pub held_mg: f64,
    /// Cost of an overdose relative to an equal shortfall.
    pub overdose_factor: f64,
}

/// Parameters of one filled spoon.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spoonful {
    /// Pitch at which it begins to release powder, degrees.
    pub onset_deg: f64,
    /// Mass released per further degree, mg.
    pub slope_mg_deg: f64,
    /// Amplitude that releases most of the loose powder, mm.
    pub stroke_mm: f64,
}

impl Response {
    /// Fitted by `benches/dispenser/fit.py` to 250 courses of fifty calibrated sets
    /// (`cargo experiment shake_response`).
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

    /// Validates the response: each number must be within its bounds.
    ///
    /// # Errors
    /// The first number that is out of bounds, by name.
    pub fn checked(self) -> Result<Self, FieldError> {
        bounded("onset_deg", self.onset_deg[0], -90.0, 90.0, "deg")?;
        bounded("onset_deg", self.onset_deg[1], 0.0, 45.0, "deg")?;
        bounded("ln_slope_mg_deg", self.ln_slope_mg_deg[0], -7.0, 7.0, "")?;
        bounded("ln_slope_mg_deg", self.ln_slope_mg_deg[1], 0.0, 3.0, "")?;
        bounded("ln_stroke_mm", self.ln_stroke_mm[0], -3.0, 9.0, "")?;
        bounded("ln_stroke_mm", self.ln_stroke_mm[1], 0.0, 3.0, "")?;
        self.correlations
            .iter()
            .try_for_each(|c| bounded("correlations", *c, -0.99, 0.99, "").map(|_| ()))?;
        if self.roots().iter().flatten().any(|root| root.is_nan()) {
            return Err(FieldError::new(
                "correlations",
                "are not those of any three numbers: bring them nearer to 0",
            ));
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

    /// The lower triangle whose product with its transpose has these correlations (Cholesky
    /// factor); NaN if there is none.
    fn roots(&self) -> [[f64; 3]; 3] {
        let [ab, ac, bc] = self.correlations;
        let b = (1.0 - ab * ab).sqrt();
        let cb = (bc - ab * ac) / b;
        [[1.0, 0.0, 0.0], [ab, b, 0.0], [ac, cb, (1.0 - ac * ac - cb * cb).sqrt()]]
    }

    /// Loss of ending with this much missing, mg; negative is an overdose.
    pub(super) fn loss(&self, missing_mg: f64) -> f64 {
        if missing_mg < 0.0 { -self.overdose_factor * missing_mg } else { missing_mg }
    }

    /// Excess of the mean mass over the square of the median of its root, mg, and variance of the
    /// mass, mg^2.
    ///
    /// ```text
    /// E m - mean = sd^2          Var m = 4 mean sd^2 + 2 sd^4          of the square of a normal number
    /// ```
    pub fn moments(&self, mean_mg: f64) -> [f64; 2] {
        let sd = self.sd(mean_mg);
        [sd * sd, 4.0 * mean_mg * sd * sd + 2.0 * sd.powi(4)]
    }

    /// Scatter of the square root of a mass with this mean.
    pub(super) fn sd(&self, mean_mg: f64) -> f64 {
        (self.floor.powi(2) + (self.caution * self.scatter).powi(2) * mean_mg).sqrt()
    }

    /// Returns a mass with this mean, `z` standard deviations from the middle of its root.
    pub fn draw(&self, mean_mg: f64, z: f64) -> f64 {
        (mean_mg.sqrt() + z * self.sd(mean_mg)).max(0.0).powi(2)
    }

    /// Returns `count` spoonfuls spread evenly over the prior: Halton's points, each coordinate a
    /// quantile.
    pub fn guesses(&self, count: usize) -> Vec<Spoonful> {
        let guess =
            |k: usize| self.spoonful([2, 3, 5].map(|base| quantile(radical_inverse(k + 1, base))));
        (0..count).map(guess).collect()
    }

    /// The spoonful `z` standard deviations from the means of onset, ln slope and ln stroke.
    pub fn spoonful(&self, z: [f64; 3]) -> Spoonful {
        let [onset, slope, stroke] =
            self.roots().map(|row| (0..3).map(|j| row[j] * z[j]).sum::<f64>());
        let of = |[mean, sd]: [f64; 2], by: f64| mean + sd * by;
        Spoonful {
            onset_deg: of(self.onset_deg, onset),
            slope_mg_deg: libm::exp(of(self.ln_slope_mg_deg, slope)),
            stroke_mm: libm::exp(of(self.ln_stroke_mm, stroke)),
        }
    }
}

/// The `index`-th number of the van der Corput sequence in this base, within 0..1.
pub(super) fn radical_inverse(index: usize, base: usize) -> f64 {
    let (mut rest, mut digit, mut value) = (index, 1.0 / base as f64, 0.0);
    while rest > 0 {
        value += (rest % base) as f64 * digit;
        rest /= base;
        digit /= base as f64;
    }
    value
}

impl Spoonful {
    /// Total mass that such shakes could release at this pitch, mg.
    pub(super) fn loose_mg(&self, r: &Response, pitch_deg: f64, shake_mm: f64) -> f64 {
        let x = (pitch_deg + r.reach_deg * libm::log(shake_mm) - self.onset_deg) / r.width_deg;
        let softplus = if x > 30.0 { x } else { libm::log1p(libm::exp(x)) };
        (self.slope_mg_deg * r.width_deg * softplus).min(r.held_mg)
    }

    /// Share of it released by one shake.
    fn share(&self, r: &Response, shake_mm: f64) -> f64 {
        -libm::expm1(-libm::pow(shake_mm / self.stroke_mm, r.bend))
    }

    /// Mean mass of a shake at this pitch after `poured_mg` has fallen, mg.
    pub fn mean_mg(&self, r: &Response, pitch_deg: f64, shake_mm: f64, poured_mg: f64) -> f64 {
        if shake_mm <= 0.0 {
            return 0.0;
        }
        (self.loose_mg(r, pitch_deg, shake_mm) - poured_mg).max(0.0) * self.share(r, shake_mm)
    }

    /// The pitch at which such a shake has this mean, degrees.
    pub(super) fn pitch_for(
        &self,
        r: &Response,
        shake_mm: f64,
        mean_mg: f64,
        poured_mg: f64,
    ) -> f64 {
        let loose = poured_mg + mean_mg / self.share(r, shake_mm);
        let y = loose.min(r.held_mg) / (self.slope_mg_deg * r.width_deg);
        let x = if y > 30.0 { y } else { libm::log(libm::expm1(y.max(1e-9))) };
        self.onset_deg - r.reach_deg * libm::log(shake_mm) + r.width_deg * x
    }
}
