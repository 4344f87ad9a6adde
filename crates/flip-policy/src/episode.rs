//! When an episode or a weighing is over.

use super::observation::Observation;
use flip_core::domain::bench::PitchLimits;
use serde::{Deserialize, Serialize};

/// Condition that ends an episode before its steps are used up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Ending {
    /// None: every step is carried out, as the paper describes its episodes.
    Never,
    /// Ends when less than one display step and less than 1 mg is missing, or the target is passed.
    OnTarget,
}

/// Error below which the reward gets its bonus, mg; also the largest shortfall for
/// [`Ending::OnTarget`].
pub const ON_TARGET_MG: f64 = 1.0;

/// The limits a controller was made for.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Rules {
    /// Most steps in one episode.
    pub steps_max: u32,
    /// Condition that ends it earlier.
    pub ending: Ending,
    /// Range of the spoon's pitch.
    pub pitch: PitchLimits,
}

impl Rules {
    /// The published robot's rules: exactly 10 steps, pitch from -10 to 36 deg.
    pub const PAPER: Self =
        Self { steps_max: 10, ending: Ending::Never, pitch: PitchLimits::PAPER };
    /// FLIP's rules: at most 10 steps, stops on target, and a pitch range in which cohesive powders
    /// still leave the spoon.
    pub const FLIP: Self =
        Self { steps_max: 10, ending: Ending::OnTarget, pitch: PitchLimits::WIDE };

    /// The state of a weighing after `steps` steps with this observation, on a balance of this
    /// readability.
    pub fn after(&self, steps: u32, observation: &Observation, readability_mg: f64) -> Episode {
        if self.ending == Ending::OnTarget && is_on_target(observation.missing_mg(), readability_mg)
        {
            return Episode::Terminated;
        }
        if steps >= self.steps_max { Episode::TimedOut } else { Episode::Running }
    }
}

/// State of an episode. A learner must distinguish the last two: only after termination is the
/// future worth nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Episode {
    /// Another step follows.
    Running,
    /// Ended by its own rule: on target, or past it.
    Terminated,
    /// Ran out of steps; with more, it would have continued.
    TimedOut,
}

/// Shortfall below which a weighing is on target, mg: one display step, at most 1 mg.
pub fn on_target_mg(readability_mg: f64) -> f64 {
    readability_mg.min(ON_TARGET_MG)
}

/// Whether less than [`on_target_mg`] is missing, or the target is passed.
pub fn is_on_target(missing_mg: f64, readability_mg: f64) -> bool {
    // 15 - 14.9 is less than 0.1 in floating point: the tolerance of 1e-9 treats a shortfall of
    // exactly one step as one step.
    missing_mg < on_target_mg(readability_mg) - 1e-9
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(reading_mg: f64) -> Observation {
        Observation { reading_mg, target_mg: 10.0, pitch_deg: 0.0 }
    }

    #[test]
    fn ours_ends_on_target_or_past_it_and_the_papers_never_early() {
        for (reading, steps, ours, papers) in [
            (0.0, 0, Episode::Running, Episode::Running),
            (9.0, 3, Episode::Running, Episode::Running),
            (9.1, 3, Episode::Terminated, Episode::Running),
            (25.0, 3, Episode::Terminated, Episode::Running),
            (9.0, 10, Episode::TimedOut, Episode::TimedOut),
            (9.5, 10, Episode::Terminated, Episode::TimedOut),
        ] {
            assert_eq!(
                Rules::FLIP.after(steps, &seen(reading), 1.0),
                ours,
                "{reading} mg after {steps}"
            );
            assert_eq!(
                Rules::PAPER.after(steps, &seen(reading), 1.0),
                papers,
                "{reading} mg after {steps}"
            );
        }
    }

    #[test]
    fn a_finer_balance_lets_a_dose_come_nearer_and_a_coarser_one_does_not_end_it_sooner() {
        for (reading, readability, ends) in [
            (9.5, 0.1, false),
            (9.9, 0.1, false),
            (9.95, 0.1, true),
            (10.0, 0.1, true),
            (8.0, 5.0, false),
            (9.5, 5.0, true),
        ] {
            let ended = Rules::FLIP.after(3, &seen(reading), readability) == Episode::Terminated;
            assert_eq!(ended, ends, "{reading} mg in steps of {readability} mg");
        }
    }
}
