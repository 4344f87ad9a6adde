//! A spoon that follows the dispenser's model instead of the grains: an episode in microseconds.
//!
//! For studies that need hundreds of thousands of episodes, such as the effect of the order in which a training meets its powders. What it is
//! not: the simulator. Its three numbers for a powder are a linear regression on the five numbers that a powder's heap depends on
//! ([`directions`]), from random courses of sets of the whole published box (`examples/shake_response.rs`, `benches/dispenser/fit.py`); what
//! the regression leaves is drawn for each spoonful.

use super::environment::{Filling, Spoon};
use crate::domain::bench::{Action, PitchLimits};
use crate::domain::parameters::ParameterSet;
use crate::domain::seed::derive;
use crate::policy::{Response, Spoonful, normal};
use crate::sim::{DIRECTIONS, directions};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Version of the surrogate, for the lineage of policies.
pub const VERSION: &str = "surrogate-1";

/// Fills [`SurrogateSpoon`]s.
#[derive(Debug, Clone, Copy)]
pub struct Surrogate {
    /// Range of the pitch.
    pub pitch: PitchLimits,
}

/// A spoonful that obeys the model.
#[derive(Debug, Clone)]
pub struct SurrogateSpoon {
    pitch: PitchLimits,
    spoonful: Spoonful,
    pitch_deg: f64,
    vial_mg: f64,
    seed: u64,
}

impl Surrogate {
    /// Means of onset, ln slope and ln stroke of a powder.
    fn means(set: &ParameterSet) -> [f64; 3] {
        let d = directions(set);
        BY_DIRECTIONS.map(|row| row[0] + d.iter().zip(&row[1..]).map(|(d, by)| d * by).sum::<f64>())
    }
}

impl Filling for Surrogate {
    type Spoon = SurrogateSpoon;
    fn fill(&self, set: &ParameterSet, seed: u64) -> SurrogateSpoon {
        let mut rng = Pcg64Mcg::seed_from_u64(derive(seed, &[0]));
        let z = std::array::from_fn(|_| f64::from(normal(&mut rng)));
        let spoonful = MODEL.spoonful(Self::means(set), z);
        SurrogateSpoon { pitch: self.pitch, spoonful, pitch_deg: 0.0, vial_mg: 0.0, seed }
    }
}

impl Spoon for SurrogateSpoon {
    fn step(&mut self, action: Action) {
        self.pitch_deg = (self.pitch_deg + action.incline_change_deg).clamp(self.pitch.lower_deg, self.pitch.upper_deg);
        let mean = self.spoonful.mean_mg(&MODEL, self.pitch_deg, action.executed_shake_mm(), self.vial_mg);
        if mean > 0.0 {
            // As in the simulator, a clone repeats itself only as long as it is treated the same to the last bit.
            let moment = [self.pitch_deg, self.vial_mg, action.shake_mm].map(f64::to_bits);
            let mut rng = Pcg64Mcg::seed_from_u64(derive(derive(self.seed, &[1]), &moment));
            let mass = MODEL.draw(mean, student4(&mut rng));
            self.vial_mg = (self.vial_mg + mass).min(MODEL.held_mg);
        }
    }
    fn pitch_deg(&self) -> f64 {
        self.pitch_deg
    }
    fn vial_mg(&self) -> f64 {
        self.vial_mg
    }
}

/// A number of Student's t with four degrees of freedom: a normal one over the root of a mean of four squares.
fn student4(rng: &mut impl Rng) -> f64 {
    let z = f64::from(normal(rng));
    let squares: f64 = (0..4).map(|_| f64::from(normal(rng)).powi(2)).sum();
    z / (squares / 4.0).sqrt()
}
