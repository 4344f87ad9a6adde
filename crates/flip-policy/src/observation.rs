//! A controller's observation before each step.

use serde::{Deserialize, Serialize};

/// The observable state of a weighing: the same in simulation and on a bench.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Observation {
    /// Balance reading, mg; not the true mass.
    pub reading_mg: f64,
    /// Requested mass, mg.
    pub target_mg: f64,
    /// Pitch of the spoon, degrees; positive is tip down.
    pub pitch_deg: f64,
}

/// A policy's knowledge in addition to its observation: the course of the weighing so far, and the
/// powder.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Known {
    /// Mass that fell in the last step according to the balance, mg; before the first step, the
    /// reading of the tared balance.
    pub fell_mg: f64,
    /// The powder's angle of repose, degrees, if measured.
    pub repose_deg: Option<f64>,
}

/// How an [`Observation`] becomes network inputs. Part of a policy: its weights are meaningless
/// without it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Encoding {
    /// The published robot's encoding: `[reading / 2, -5 pitch, target / 2]` with masses in mg and
    /// the pitch in radians.
    Paper,
    /// FLIP's encoding: the missing mass, on a linear and on a logarithmic scale, the pitch, and
    /// the mass in the vial.
    ///
    /// ```text
    /// d = clamp(target - reading, 0, 15 mg)
    /// [d / 10 mg, ln(1 + d / 1 mg) - 1.5, pitch / 25 deg - 1, min(reading, 15 mg) / 10 mg]
    /// ```
    ///
    /// The missing mass decides the next shake, so it is a direct input, and the logarithm
    /// separates 1 mg from 2 mg as well as 7 mg from 14 mg. Both masses are clamped to the training
    /// range: a larger target then looks like the largest trained one until it comes within reach,
    /// instead of like something never seen.
    Missing,
    /// [`Encoding::Missing`], the same logarithm on a scale of a tenth of a milligram, and a
    /// running estimate of the yield of a step: the last fall.
    ///
    /// ```text
    /// [..., ln(1 + d / 0.1 mg) / 2 - 1, ln(1 + max(fell, 0) / 0.1 mg) / 2 - 1]
    /// ```
    Fall,
    /// [`Encoding::Fall`] and the powder's flowability: `(angle of repose - 35 deg) / 10 deg`, or 0
    /// if not measured.
    FallAndRepose,
}

/// Scale of the finer logarithm of [`Encoding::Fall`], mg: one step of a fine balance.
const FINE_MG: f64 = 0.1;

/// Largest mass that [`Encoding::Missing`] distinguishes, mg: the upper end of the training
/// targets.
const MISSING_MG_MAX: f64 = 15.0;

impl Encoding {
    /// Whether the inputs depend on the observation alone, with no history of the weighing.
    pub fn is_memoryless(self) -> bool {
        matches!(self, Self::Paper | Self::Missing)
    }

    /// Number of inputs.
    pub fn width(self) -> usize {
        match self {
            Self::Paper => 3,
            Self::Missing => 4,
            Self::Fall => 6,
            Self::FallAndRepose => 7,
        }
    }
}

impl Observation {
    /// Missing mass according to the balance, mg; negative once the target is passed.
    pub fn missing_mg(&self) -> f64 {
        self.target_mg - self.reading_mg
    }

    /// Appends the network's inputs to `inputs`: [`Encoding::width`] numbers of order one.
    pub fn encode_into(&self, encoding: Encoding, known: &Known, inputs: &mut Vec<f32>) {
        match encoding {
            Encoding::Paper => inputs.extend([
                (self.reading_mg / 2.0) as f32,
                (-5.0 * self.pitch_deg.to_radians()) as f32,
                (self.target_mg / 2.0) as f32,
            ]),
            Encoding::Missing | Encoding::Fall | Encoding::FallAndRepose => {
                let missing = self.missing_mg().clamp(0.0, MISSING_MG_MAX);
                inputs.extend([
                    (missing / 10.0) as f32,
                    (missing.ln_1p() - 1.5) as f32,
                    (self.pitch_deg / 25.0 - 1.0) as f32,
                    (self.reading_mg.clamp(0.0, MISSING_MG_MAX) / 10.0) as f32,
                ]);
                let fine = |mass_mg: f64| ((mass_mg.max(0.0) / FINE_MG).ln_1p() / 2.0 - 1.0) as f32;
                if encoding != Encoding::Missing {
                    inputs.extend([fine(missing), fine(known.fell_mg)]);
                }
                if encoding == Encoding::FallAndRepose {
                    inputs.push(known.repose_deg.map_or(0.0, |deg| (deg - 35.0) / 10.0) as f32);
                }
            }
        }
    }

    /// Like [`Observation::encode_into`], into a new vector.
    pub fn encode(&self, encoding: Encoding, known: &Known) -> Vec<f32> {
        let mut inputs = Vec::with_capacity(encoding.width());
        self.encode_into(encoding, known, &mut inputs);
        inputs
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_encoding_has_its_published_scales() {
        let seen = Observation { reading_mg: 4.0, target_mg: 12.0, pitch_deg: 36.0 };
        let inputs = seen.encode(Encoding::Paper, &Known::default());
        assert_eq!((inputs[0], inputs[2]), (2.0, 6.0));
        // 36 deg is a fifth of pi; times five.
        assert!((inputs[1] + std::f32::consts::PI).abs() < 1e-3);
    }

    #[test]
    fn a_target_beyond_training_looks_like_the_largest_trained_one() {
        let at = |reading_mg, target_mg| {
            Observation { reading_mg, target_mg, pitch_deg: 10.0 }
                .encode(Encoding::Missing, &Known::default())
        };
        assert_eq!(at(0.0, 20.0), at(0.0, 15.0));
        assert_eq!(at(18.0, 20.0), at(15.5, 17.5), "near the end only what is missing counts");
        let known = Known { fell_mg: -3.0, repose_deg: Some(85.0) };
        for encoding in
            [Encoding::Paper, Encoding::Missing, Encoding::Fall, Encoding::FallAndRepose]
        {
            let inputs = Observation { reading_mg: 1e6, target_mg: 0.0, pitch_deg: 0.0 }
                .encode(encoding, &known);
            assert_eq!(inputs.len(), encoding.width());
            assert!(inputs.iter().all(|x| x.is_finite()));
        }
    }

    #[test]
    fn the_last_fall_and_the_angle_come_after_what_is_missing() {
        let seen = Observation { reading_mg: 4.0, target_mg: 12.0, pitch_deg: 36.0 };
        let of =
            |encoding, fell_mg, repose_deg| seen.encode(encoding, &Known { fell_mg, repose_deg });
        let [missing, fall] =
            [Encoding::Missing, Encoding::Fall].map(|encoding| of(encoding, 0.9, Some(30.0)));
        assert_eq!(fall[..4], missing);
        // 81 and 10 tenths.
        assert!(
            (fall[4] - (81f32.ln() / 2.0 - 1.0)).abs() < 1e-6
                && (fall[5] - (10f32.ln() / 2.0 - 1.0)).abs() < 1e-6
        );
        let all = of(Encoding::FallAndRepose, 0.9, Some(30.0));
        assert_eq!((&all[..6], all[6]), (&fall[..], -0.5));
        assert_eq!(of(Encoding::FallAndRepose, 0.9, None)[6], 0.0);
    }
}
