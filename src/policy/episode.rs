//! When an episode, or a weighing, is over.

use super::observation::Observation;
use crate::domain::bench::PitchLimits;
use serde::{Deserialize, Serialize};

/// What ends an episode before its steps are spent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Ending {
    /// Nothing: every step is carried out, as the paper describes its episodes.
    Never,
    /// The reading is within 1 mg of the target, or has passed it.
    OnTarget,
}

/// Error below which [`Ending::OnTarget`] is satisfied, mg; also where the reward gets its bonus.
pub const ON_TARGET_MG: f64 = 1.0;

/// The frame that a controller was made for.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Rules {
    /// Most steps in one episode.
    pub steps_max: u32,
    /// What ends it earlier.
    pub ending: Ending,
    /// Range of the spoon's pitch.
    pub pitch: PitchLimits,
}

impl Rules {
    /// The published robot's: exactly 10 steps, pitch from -10 to 36 deg.
    pub const PAPER: Self = Self { steps_max: 10, ending: Ending::Never, pitch: PitchLimits::PAPER };
    /// FLIP's: at most 10 steps, stops on target, and a pitch at which cohesive powders still leave the spoon.
    pub const FLIP: Self = Self { steps_max: 10, ending: Ending::OnTarget, pitch: PitchLimits::WIDE };

    /// Where a weighing stands that has carried out `steps` steps and now sees `observation`.
    pub fn after(&self, steps: u32, observation: &Observation) -> Episode {
        if self.ending == Ending::OnTarget && is_on_target(observation.missing_mg()) {
            return Episode::Terminated;
        }
        if steps >= self.steps_max { Episode::TimedOut } else { Episode::Running }
    }
}

/// Where an episode stands. A learner must tell the last two apart: only termination makes the future worth nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Episode {
    /// Another step follows.
    Running,
    /// It ended by its own rule: on target, or past it.
    Terminated,
    /// The steps were spent; had there been more, it would have gone on.
    TimedOut,
}

/// Less than 1 mg is missing, or the target is passed.
pub fn is_on_target(missing_mg: f64) -> bool {
    missing_mg < ON_TARGET_MG
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
            assert_eq!(Rules::FLIP.after(steps, &seen(reading)), ours, "{reading} mg after {steps}");
            assert_eq!(Rules::PAPER.after(steps, &seen(reading)), papers, "{reading} mg after {steps}");
        }
    }
}
