//! A recorded spoonful, made again by a simulated spoon: the same steps, one after another.
//!
//! Nothing is clamped: the steps are what an arm did, so they lie within its limits, and a step
//! that was made here at another pitch would be another experiment.

use super::dispense::{Dispenser, Settings};
use super::repose::Refusal;
use flip_core::domain::motion::{MotionLimits, Move};
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::shake::{Shake, Spoonful};
use serde::{Deserialize, Serialize};

/// One step: the pitch, then the shake.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Step {
    /// Pitch, degrees; positive is tip down.
    pub pitch_deg: f64,
    /// Amplitude, mm; 0 for none.
    pub shake_mm: f64,
    /// Number of strokes.
    pub strokes: u32,
    /// Largest acceleration of the stroke, m/s^2; `None`: by the spoon's settings.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acceleration_m_s2: Option<f64>,
}

/// A spoonful to make again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Replay {
    /// The powder.
    pub set: ParameterSet,
    /// Spoon and motion. The limits of the pitch have no effect.
    pub settings: Settings,
    /// The steps, in order.
    pub steps: Vec<Step>,
    /// Seed.
    pub seed: u64,
}

/// What a replayed spoonful let fall.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Replayed {
    /// Powder in the spoon before the first step, mg.
    pub filled_mg: f64,
    /// Mass that fell into the vial during each step, mg.
    pub fell_mg: Vec<f64>,
    /// Mass that missed the vial, over all steps, mg.
    pub spilled_mg: f64,
}

/// Fewest and most grains of a filling.
const GRAINS: [f64; 2] = [1.0, 20_000.0];

impl From<&Shake> for Step {
    fn from(shake: &Shake) -> Self {
        Self {
            pitch_deg: shake.pitch_deg,
            shake_mm: shake.shake_mm,
            strokes: shake.strokes,
            acceleration_m_s2: shake.acceleration_m_s2.filter(|most| *most > 0.0),
        }
    }
}

impl Replay {
    /// The steps of a spoonful, with as much powder as it held at first, or as the settings pour
    /// where that is unknown.
    pub fn of(set: &ParameterSet, settings: &Settings, spoonful: &Spoonful, seed: u64) -> Self {
        let held = spoonful.shakes.first().and_then(|shake| shake.spoon_mg);
        let particles =
            held.filter(|mg| *mg > 0.0).map_or(settings.particles, |mg| grains(mg, set));
        let settings = Settings { particles, ..*settings };
        Self { set: *set, settings, steps: spoonful.shakes.iter().map(Step::from).collect(), seed }
    }
}

/// Number of grains of a mass, within [`GRAINS`].
fn grains(mg: f64, set: &ParameterSet) -> u32 {
    (mg * 1e3 / set.particle_mass_ug()).round().clamp(GRAINS[0], GRAINS[1]) as u32
}

/// Makes a spoonful again. Same inputs, same bytes. About 0.2 s of CPU for each step of 2500 grains.
///
/// # Errors
/// [`Refusal`] if the solver diverged.
pub fn replay(of: &Replay) -> Result<Replayed, Refusal> {
    let mut spoon = Dispenser::new(&of.set, &of.settings, of.seed);
    let (filled_mg, mut elapsed_s) = (spoon.spoon_mg(), 0.0);
    let mut fell_mg = Vec::with_capacity(of.steps.len());
    for step in &of.steps {
        spoon.shake_within(limits(step, of.settings.shake));
        // An arm pitches, and is then told to shake: the powder rests in between.
        let pitched = spoon.carry_out(step.pitch_deg, 0.0, 0);
        let shaken = spoon.carry_out(step.pitch_deg, step.shake_mm, step.strokes);
        elapsed_s += pitched.duration_s + shaken.duration_s;
        if let Some(cause) = spoon.fault() {
            return Err(Refusal::Diverged { at_s: elapsed_s, cause: cause.to_owned() });
        }
        fell_mg.push(pitched.vial_mg + shaken.vial_mg);
    }
    Ok(Replayed { filled_mg, fell_mg, spilled_mg: spoon.spilled_mg() })
}

/// The limits of a stroke whose largest acceleration was recorded: the usual move of this length,
/// so much faster or slower.
pub(super) fn limits(step: &Step, usual: MotionLimits) -> MotionLimits {
    let usual_m_s2 = Move::new(step.shake_mm * 1e-3, usual).peak_m_s2();
    match step.acceleration_m_s2 {
        Some(most_m_s2) if usual_m_s2 > 0.0 => usual.at_speed((most_m_s2 / usual_m_s2).sqrt()),
        _ => usual,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flip_core::domain::bench::{Action, PitchLimits};

    fn small() -> Settings {
        Settings { particles: 300, semi_axes_mm: [2.2, 1.6, 1.0], ..Settings::default() }
    }

    fn step(pitch_deg: f64, shake_mm: f64) -> Step {
        Step { pitch_deg, shake_mm, strokes: 1, acceleration_m_s2: None }
    }

    fn of(steps: Vec<Step>) -> Replayed {
        let set = ParameterSet::default();
        replay(&Replay { set, settings: small(), steps, seed: 7 }).unwrap()
    }

    #[test]
    fn a_replay_is_what_the_dispenser_does_step_by_step_and_the_same_again() {
        let steps = vec![step(12.5, 0.0), step(25.0, 4.0), step(31.0, 8.0)];
        let mut spoon = Dispenser::new(&ParameterSet::default(), &small(), 7);
        let actions = [(12.5, 0.0), (12.5, 4.0), (6.0, 8.0)];
        let by_hand = actions.map(|(incline_change_deg, shake_mm)| {
            let pitched = spoon.step(Action::once(incline_change_deg, 0.0)).vial_mg;
            pitched + spoon.step(Action::once(0.0, shake_mm)).vial_mg
        });
        let replayed = of(steps.clone());
        assert_eq!(replayed.fell_mg, by_hand);
        assert!(by_hand.iter().sum::<f64>() > 0.3, "{by_hand:?}");
        assert_eq!(replayed, of(steps));
    }

    #[test]
    fn a_pitch_beyond_the_limits_of_the_policy_is_made_as_recorded() {
        let mut bounded = Dispenser::new(&ParameterSet::default(), &small(), 7);
        bounded.step(Action::once(70.0, 0.0));
        assert_eq!(bounded.pitch_deg(), PitchLimits::WIDE.upper_deg);
        let steep = of(vec![step(70.0, 0.0)]);
        assert!(steep.fell_mg[0] > 2.0 * bounded.vial_mg(), "{steep:?} {}", bounded.vial_mg());
    }

    #[test]
    fn a_spoonful_is_filled_with_what_it_held_and_shaken_as_hard_as_recorded() {
        let shake = |acceleration_m_s2| Shake {
            pitch_deg: 22.0,
            shake_mm: 8.0,
            strokes: 1,
            acceleration_m_s2,
            spoon_mg: Some(2.95),
            fell_mg: 0.0,
            sd_mg: 0.4,
            since_filled_s: None,
        };
        let spoonful = |acceleration_m_s2| Spoonful {
            weighing: "w".to_owned(),
            spoonful: 1,
            powder: "salt".to_owned(),
            lot: None,
            session: None,
            readability_mg: None,
            shakes: vec![shake(acceleration_m_s2); 3],
        };
        let fell = |acceleration| {
            let replay = Replay::of(&ParameterSet::default(), &small(), &spoonful(acceleration), 3);
            assert_eq!(replay.settings.particles, 200);
            super::replay(&replay).unwrap().fell_mg.iter().sum::<f64>()
        };
        // 8 mm are long enough for 0.46 g, the settings' own; a tenth of it is a gentle stroke.
        assert_eq!(fell(None), fell(Some(small().shake.acceleration_m_s2)));
        assert!(fell(Some(0.45)) < fell(None), "{} {}", fell(Some(0.45)), fell(None));
    }
}
