//! The available controllers.

use super::actor::{Actor, Carried};
use super::dispenser::Dispenser;
use super::episode::Rules;
use super::fuzzy::Fuzzy;
use super::observation::{Encoding, Observation};
use super::paced::{self, Paced};
use super::pid::Pid;
use flip_core::domain::bench::{Action, INCLINE_CHANGE_DEG_MAX};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

/// A controller proposes an action for each step. A closed set: the controller proposes, the guard
/// decides.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Controller {
    /// A trained network, at the centre of its distribution.
    Learned(Actor),
    /// One pitch and one shake, regardless of the readings.
    Fixed(ScheduledStep),
    /// A list of pitches and shakes, regardless of the readings.
    Schedule(Schedule),
    /// A model of the mass a shake releases, identified while dosing.
    Dispenser(Dispenser),
    /// The prior work's PID rule.
    Pid(Pid),
    /// Fuzzy rules on the missing mass and the last fall.
    Fuzzy(Fuzzy),
    /// Fuzzy rules adapted to the number of steps and the target.
    Paced(Paced),
}

/// A pitch and the shake to make there.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScheduledStep {
    /// Pitch, degrees; approached by at most 8 deg per step, and no shake is made before it is
    /// reached.
    pub pitch_deg: f64,
    /// Amplitude of the shake, mm.
    pub shake_mm: f64,
}

/// Steps to carry out in order; the last one repeats. A step lasts until its pitch is reached.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Schedule {
    /// The pitch before the first shake and after each one, with the shake made at that pitch.
    pub steps: Vec<ScheduledStep>,
}

impl ScheduledStep {
    /// The fixed action used as the baseline for policies: 8 mm shakes at 20 deg.
    pub const FIXED: Self = Self { pitch_deg: 20.0, shake_mm: 8.0 };

    /// One step from the current pitch towards this one, with a shake on arrival.
    fn approach(&self, pitch_deg: f64) -> Action {
        let missing = self.pitch_deg - pitch_deg;
        let change = missing.clamp(-INCLINE_CHANGE_DEG_MAX, INCLINE_CHANGE_DEG_MAX);
        // A servo may stop a little short: within half a degree counts as arrived.
        let arrives = (missing - change).abs() < 0.5;
        Action::once(change, if arrives { self.shake_mm } else { 0.0 })
    }
}

impl Schedule {
    /// The step to carry out after `steps` steps from a level spoon, counting inclines that take
    /// several steps.
    fn step(&self, steps: u32) -> ScheduledStep {
        let mut pitch = 0.0f64;
        let mut done = 0;
        for step in &self.steps {
            let needed =
                ((step.pitch_deg - pitch).abs() / INCLINE_CHANGE_DEG_MAX).ceil().max(1.0) as u32;
            done += needed;
            pitch = step.pitch_deg;
            if steps < done {
                return *step;
            }
        }
        self.steps.last().copied().unwrap_or(ScheduledStep::FIXED)
    }
}

impl Controller {
    /// Whether its proposals depend on the current observation alone, so that it can take over a
    /// weighing with no history.
    pub fn is_memoryless(&self) -> bool {
        match self {
            Self::Learned(actor) => actor.is_memoryless(),
            Self::Fixed(_) => true,
            Self::Schedule(_)
            | Self::Dispenser(_)
            | Self::Pid(_)
            | Self::Fuzzy(_)
            | Self::Paced(_) => false,
        }
    }

    /// An untrained network, by seed: the baseline for learning.
    pub fn untrained(seed: u64) -> Self {
        Self::Learned(Actor::untrained(
            Encoding::Missing,
            &[128, 128],
            &mut Pcg64Mcg::seed_from_u64(seed),
        ))
    }

    /// Starts the controller for a weighing within these rules, on a balance with a display step of
    /// `readability_mg`.
    pub fn begin(&self, rules: &Rules, readability_mg: f64) -> Dosing<'_> {
        let carried = match self {
            Self::Learned(actor) => actor.begin(),
            Self::Fixed(_)
            | Self::Schedule(_)
            | Self::Dispenser(_)
            | Self::Pid(_)
            | Self::Fuzzy(_)
            | Self::Paced(_) => Carried::default(),
        };
        Dosing {
            controller: self,
            rules: *rules,
            readability_mg,
            done: Vec::new(),
            proposed: None,
            carried,
            onset_deg: None,
        }
    }
}

/// A step that was carried out.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Done {
    /// Observation before it.
    pub before: Observation,
    /// Proposed action; the guard may have reduced it.
    pub action: Action,
    /// Observation after it.
    pub after: Observation,
}

/// A running controller; its knowledge of the weighing is its observations and proposals so far.
#[derive(Debug, Clone)]
pub struct Dosing<'a> {
    controller: &'a Controller,
    rules: Rules,
    readability_mg: f64,
    done: Vec<Done>,
    proposed: Option<(Observation, Action)>,
    carried: Carried,
    onset_deg: Option<f64>,
}

impl Dosing<'_> {
    /// Sets the powder's angle of repose, degrees, if measured.
    pub fn knowing(mut self, repose_deg: Option<f64>) -> Self {
        self.carried.repose_deg = repose_deg;
        self
    }

    /// Sets the pitch at which the powder began to flow in earlier doses, degrees, if known.
    pub fn expecting(self, onset_deg: Option<f64>) -> Self {
        Self { onset_deg, ..self }
    }

    /// Resumes a weighing midway: records a step that was carried out, with its actual action.
    pub fn resume(&mut self, step: Done) {
        self.propose(&step.before);
        self.proposed = None;
        self.done.push(step);
    }

    /// Returns the action for the next step, given the earlier proposals. Deterministic.
    pub fn propose(&mut self, seen: &Observation) -> Action {
        if let Some((before, action)) = self.proposed {
            self.done.push(Done { before, action, after: *seen });
        }
        let steps = self.done.len() as u32;
        let action = match self.controller {
            Controller::Learned(actor) => actor.act(seen, &mut self.carried),
            Controller::Fixed(step) => step.approach(seen.pitch_deg),
            Controller::Schedule(schedule) => schedule.step(steps).approach(seen.pitch_deg),
            Controller::Dispenser(dispenser) => {
                dispenser.propose(&self.done, seen, &self.rules, self.readability_mg)
            }
            Controller::Pid(pid) => pid.propose(&self.done, seen),
            Controller::Fuzzy(fuzzy) => fuzzy.propose(&self.done, seen),
            Controller::Paced(paced) => paced::lead_in(self.onset_deg, seen)
                .unwrap_or_else(|| paced.propose(&self.done, seen, &self.rules)),
        };
        self.proposed = Some((*seen, action));
        action
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pitches and shakes of a controller's first steps on a spoon that follows its commands
    /// exactly.
    fn carry_out(controller: &Controller, steps: u32) -> Vec<(f64, f64)> {
        let mut pitch_deg = 0.0;
        let mut dosing = controller.begin(&Rules::FLIP, 1.0);
        (0..steps)
            .map(|_| {
                let action =
                    dosing.propose(&Observation { reading_mg: 0.0, target_mg: 10.0, pitch_deg });
                pitch_deg += action.incline_change_deg;
                (pitch_deg, action.shake_mm)
            })
            .collect()
    }

    #[test]
    fn the_fixed_controller_inclines_to_20_deg_and_then_shakes_8_mm() {
        let done = carry_out(&Controller::Fixed(ScheduledStep::FIXED), 5);
        assert_eq!(done, [(8.0, 0.0), (16.0, 0.0), (20.0, 8.0), (20.0, 8.0), (20.0, 8.0)]);
    }

    #[test]
    fn a_schedule_finishes_each_incline_before_it_shakes_and_repeats_its_last_step() {
        let step = |pitch_deg, shake_mm| ScheduledStep { pitch_deg, shake_mm };
        let schedule = Schedule { steps: vec![step(12.0, 5.0), step(14.0, 4.0), step(30.0, 3.0)] };
        let done = carry_out(&Controller::Schedule(schedule), 7);
        assert_eq!(
            done,
            [
                (8.0, 0.0),
                (12.0, 5.0),
                (14.0, 4.0),
                (22.0, 0.0),
                (30.0, 3.0),
                (30.0, 3.0),
                (30.0, 3.0)
            ]
        );
    }

    #[test]
    fn a_weighing_taken_up_in_its_middle_goes_on_as_if_it_had_not_been_left() {
        let seen = |reading_mg, pitch_deg| Observation { reading_mg, target_mg: 15.0, pitch_deg };
        let course =
            [seen(0.0, 0.0), seen(0.0, 8.0), seen(3.0, 16.0), seen(4.0, 20.0), seen(9.0, 22.0)];
        let step = |pitch_deg, shake_mm| ScheduledStep { pitch_deg, shake_mm };
        let schedule = Schedule { steps: vec![step(12.0, 5.0), step(30.0, 4.0), step(40.0, 3.0)] };
        let paced = Controller::Paced(Paced::CHOSEN);
        for controller in [
            Controller::Schedule(schedule),
            Controller::Pid(Pid::CHOSEN),
            Controller::Fuzzy(Fuzzy::CHOSEN),
            paced,
        ] {
            let mut whole = controller.begin(&Rules::FLIP, 1.0);
            let actions = course.map(|seen| whole.propose(&seen));
            let mut taken_up = controller.begin(&Rules::FLIP, 1.0);
            for k in 0..3 {
                taken_up.resume(Done {
                    before: course[k],
                    action: actions[k],
                    after: course[k + 1],
                });
            }
            assert_eq!([taken_up.propose(&course[3]), taken_up.propose(&course[4])], actions[3..]);
        }
    }

    #[test]
    fn untrained_controllers_differ_by_seed_and_stay_in_range() {
        let seen = Observation { reading_mg: 0.0, target_mg: 10.0, pitch_deg: 0.0 };
        let actions: Vec<Action> = (0..3)
            .map(|seed| Controller::untrained(seed).begin(&Rules::FLIP, 1.0).propose(&seen))
            .collect();
        assert_ne!(actions[0], actions[1]);
        assert_eq!(actions[2], Controller::untrained(2).begin(&Rules::FLIP, 1.0).propose(&seen));
        assert!(
            actions
                .iter()
                .all(|a| a.incline_change_deg.abs() <= 8.0 && (0.0..=16.0).contains(&a.shake_mm))
        );
    }
}
