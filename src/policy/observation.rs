//! What a controller sees before each step.

use serde::{Deserialize, Serialize};

/// The state of a weighing as far as a controller may know it: the same in simulation and on a bench.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Observation {
    /// What the balance shows, mg; not the true mass.
    pub reading_mg: f64,
    /// Mass that was asked for, mg.
    pub target_mg: f64,
    /// Pitch of the spoon, degrees, positive is tip down.
    pub pitch_deg: f64,
}

/// How an [`Observation`] becomes the inputs of a network. Part of a policy: weights mean nothing without it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Encoding {
    /// The published robot's: `[reading / 2, -5 pitch, target / 2]` with masses in mg and the pitch in radians.
    Paper,
    /// FLIP's: what is missing, on a linear and on a logarithmic scale, the pitch, and what is in the vial.
    ///
    /// ```text
    /// d = clamp(target - reading, 0, 15 mg)
    /// [d / 10 mg, ln(1 + d / 1 mg) - 1.5, pitch / 25 deg - 1, min(reading, 15 mg) / 10 mg]
    /// ```
    ///
    /// What is missing decides the next shake, so it is given directly, and the logarithm separates 1 mg from 2 mg as
    /// well as 7 mg from 14 mg. Both masses are clamped to what training visits: a larger target then looks like the
    /// largest trained one until it comes within reach, instead of like nothing ever seen.
    Missing,
}

/// Largest mass that [`Encoding::Missing`] tells apart, mg: the upper end of the training targets.
const MISSING_MG_MAX: f64 = 15.0;

impl Encoding {
    /// Number of inputs.
    pub fn width(self) -> usize {
        match self {
            Self::Paper => 3,
            Self::Missing => 4,
        }
    }
}

impl Observation {
    /// Mass that is missing by the balance's account, mg; negative once the target is passed.
    pub fn missing_mg(&self) -> f64 {
        self.target_mg - self.reading_mg
    }

    /// The inputs of a network, appended to `inputs`: [`Encoding::width`] numbers of order one.
    pub fn encode_into(&self, encoding: Encoding, inputs: &mut Vec<f32>) {
        match encoding {
            Encoding::Paper => inputs.extend([
                (self.reading_mg / 2.0) as f32,
                (-5.0 * self.pitch_deg.to_radians()) as f32,
                (self.target_mg / 2.0) as f32,
            ]),
            Encoding::Missing => {
                let missing = self.missing_mg().clamp(0.0, MISSING_MG_MAX);
                inputs.extend([
                    (missing / 10.0) as f32,
                    (missing.ln_1p() - 1.5) as f32,
                    (self.pitch_deg / 25.0 - 1.0) as f32,
                    (self.reading_mg.clamp(0.0, MISSING_MG_MAX) / 10.0) as f32,
                ]);
            }
        }
    }

    /// [`Observation::encode_into`] a new vector.
    pub fn encode(&self, encoding: Encoding) -> Vec<f32> {
        let mut inputs = Vec::with_capacity(encoding.width());
        self.encode_into(encoding, &mut inputs);
        inputs
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_encoding_has_its_published_scales() {
        let seen = Observation { reading_mg: 4.0, target_mg: 12.0, pitch_deg: 36.0 };
        let inputs = seen.encode(Encoding::Paper);
        assert_eq!((inputs[0], inputs[2]), (2.0, 6.0));
        // 36 deg are a fifth of pi, times five.
        assert!((inputs[1] + std::f32::consts::PI).abs() < 1e-3);
    }

    #[test]
    fn a_target_beyond_training_looks_like_the_largest_trained_one() {
        let at =
            |reading_mg, target_mg| Observation { reading_mg, target_mg, pitch_deg: 10.0 }.encode(Encoding::Missing);
        assert_eq!(at(0.0, 20.0), at(0.0, 15.0));
        assert_eq!(at(18.0, 20.0), at(15.5, 17.5), "near the end only what is missing counts");
        for encoding in [Encoding::Paper, Encoding::Missing] {
            let inputs = Observation { reading_mg: 1e6, target_mg: 0.0, pitch_deg: 0.0 }.encode(encoding);
            assert_eq!(inputs.len(), encoding.width());
            assert!(inputs.iter().all(|x| x.is_finite()));
        }
    }
}
