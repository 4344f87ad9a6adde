//! Simulated doses, one after another: the learner's training environment.

use super::settings::Settings;
use flip_core::domain::bench::Action;
use flip_core::domain::conditions::Patch;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use flip_policy::{Episode, ON_TARGET_MG, Observation, Rules};
use flip_sim::balance;
use flip_sim::batch::{Filled, Motion};
use flip_sim::dispense::{self, Dispenser};

/// A source of filled spoons. The simulator's is [`Simulated`]; tests use a formula.
pub trait Filling: Sync {
    /// The type of a filled spoon.
    type Spoon: Spoon + Clone + Send + Sync;
    /// Fills a spoon with this powder; expensive, so the result is kept and cloned.
    fn fill(&self, set: &ParameterSet, seed: u64) -> Self::Spoon;
    /// Like [`Self::fill`], under conditions whose effect on the powder's parameters is already in
    /// `set`; a spoon without mechanisms ignores the rest.
    fn fill_under(&self, set: &ParameterSet, _patch: &Patch, seed: u64) -> Self::Spoon {
        self.fill(set, seed)
    }
}

impl<F: Filling> Filling for &F {
    type Spoon = F::Spoon;
    fn fill(&self, set: &ParameterSet, seed: u64) -> F::Spoon {
        (*self).fill(set, seed)
    }
    fn fill_under(&self, set: &ParameterSet, patch: &Patch, seed: u64) -> F::Spoon {
        (*self).fill_under(set, patch, seed)
    }
}

/// A filled spoon over a vial.
pub trait Spoon {
    /// Carries out one action and waits until the powder rests.
    fn step(&mut self, action: Action);
    /// Current pitch, degrees.
    fn pitch_deg(&self) -> f64;
    /// True mass in the vial, mg.
    fn vial_mg(&self) -> f64;
    /// Whether the simulation has left the range where its numbers are meaningful; the last step
    /// must then not be used.
    fn has_failed(&self) -> bool {
        false
    }
}

/// The simulator's spoon.
#[derive(Debug, Clone, Copy)]
pub struct Simulated {
    /// Grains and pitch range.
    pub settings: dispense::Settings,
}

impl Simulated {
    /// Like [`Filling::fill_under`], before the powder has fallen ([`Dispenser::loose`]).
    pub fn loose(&self, set: &ParameterSet, patch: &Patch, seed: u64) -> Dispenser {
        Dispenser::loose(set, &self.under(patch), seed)
    }

    fn under(&self, patch: &Patch) -> dispense::Settings {
        let extensions =
            self.settings.extensions.patched(patch).expect("checked before the training begins");
        dispense::Settings { extensions, ..self.settings }
    }
}

impl Filling for Simulated {
    type Spoon = Dispenser;
    fn fill(&self, set: &ParameterSet, seed: u64) -> Dispenser {
        Dispenser::new(set, &self.settings, seed)
    }
    fn fill_under(&self, set: &ParameterSet, patch: &Patch, seed: u64) -> Dispenser {
        Dispenser::new(set, &self.under(patch), seed)
    }
}

/// The simulator's spoons, on a core and in a place of a batch.
impl<S: Filled> Spoon for S {
    fn step(&mut self, action: Action) {
        self.carry_out(Motion::Act(action));
    }
    fn pitch_deg(&self) -> f64 {
        Filled::pitch_deg(self)
    }
    fn vial_mg(&self) -> f64 {
        Filled::vial_mg(self)
    }
    fn has_failed(&self) -> bool {
        self.fault().is_some()
    }
}

/// The published reward for the true mass in the vial, mg.
///
/// ```text
/// D = -|target - true|          r = D + 1 if D > -1 mg, else D
/// ```
pub fn reward(target_mg: f64, true_mg: f64) -> f64 {
    let d = -(target_mg - true_mg).abs();
    if d > -ON_TARGET_MG { d + 1.0 } else { d }
}

/// The unscaled reward of one step for the learner: the published reward, with a factor for an
/// irreversible overdose, and paid for ever if the episode ends.
///
/// ```text
/// r' = f D  if true - target > 1 mg, else r          f = overdose factor
/// r' / (1 - gamma)  if the step terminates and endings are absorbing
/// ```
pub fn training_reward(settings: &Settings, target_mg: f64, true_mg: f64, terminated: bool) -> f64 {
    let mut r = reward(target_mg, true_mg);
    if true_mg - target_mg > ON_TARGET_MG {
        r *= settings.overdose_factor;
    }
    if terminated && settings.absorbing_ending { r / (1.0 - settings.gamma) } else { r }
}

/// One step as stored: nothing in it depends on the target, so it can be evaluated for any target
/// afterwards.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// Mass that fell in the previous step according to the balance, mg; for the first step, the
    /// reading of the tared balance.
    pub fell_mg: f32,
    /// Reading before the step, mg.
    pub reading_mg: f32,
    /// Pitch before the step, degrees.
    pub pitch_deg: f32,
    /// The policy's outputs in -1..=1.
    pub action: [f32; 2],
    /// Reading after the step, mg.
    pub next_reading_mg: f32,
    /// Pitch after the step, degrees.
    pub next_pitch_deg: f32,
    /// True mass in the vial after the step, mg.
    pub next_true_mg: f32,
}

/// A finished episode.
#[derive(Debug, Clone, PartialEq)]
pub struct Played {
    /// Its steps.
    pub steps: Vec<Step>,
    /// Target, mg.
    pub target_mg: f64,
    /// True mass in the vial at the end, mg.
    pub dispensed_mg: f64,
    /// Last reading, mg.
    pub reading_mg: f64,
    /// Sum of the published rewards over the episode.
    pub reward: f64,
    /// Final state of the episode.
    pub ending: Episode,
}

/// Seed indices of the random events within one episode.
const BALANCE: u64 = 1;

/// An episode in the middle of being played, one step at a time. [`play`] plays one to its end.
#[derive(Debug, Clone, PartialEq)]
pub struct Playing {
    rules: Rules,
    balance: balance::Settings,
    /// Seed of the balance's noise.
    noise: u64,
    tare_mg: f64,
    true_mg: f64,
    seen: Observation,
    fell_mg: f64,
    steps: u32,
}

impl Playing {
    /// Tares the vial below this spoon and reads the balance.
    pub fn begin(
        spoon: &impl Spoon,
        rules: &Rules,
        balance: &balance::Settings,
        target_mg: f64,
        seed: u64,
    ) -> Self {
        let noise = derive(seed, &[BALANCE]);
        let reading_mg = balance.read(0.0, 0.0, noise, 0).mass_mg;
        Self {
            rules: *rules,
            balance: *balance,
            noise,
            tare_mg: spoon.vial_mg(),
            true_mg: 0.0,
            seen: Observation { reading_mg, target_mg, pitch_deg: spoon.pitch_deg() },
            fell_mg: reading_mg,
            steps: 0,
        }
    }

    /// The observation before the next step.
    pub fn seen(&self) -> &Observation {
        &self.seen
    }

    /// Mass that fell in the last step according to the balance, mg; before the first, the reading
    /// of the tared balance.
    pub fn fell_mg(&self) -> f64 {
        self.fell_mg
    }

    /// True mass in the vial, mg.
    pub fn true_mg(&self) -> f64 {
        self.true_mg
    }

    /// Steps so far.
    pub fn steps(&self) -> u32 {
        self.steps
    }

    /// Carries out one action of two numbers in -1..=1, on the spoon that it began with, and returns
    /// the step and the state after it. `None` if the simulation failed: nothing has changed then, and
    /// the episode has timed out.
    pub fn step(&mut self, spoon: &mut impl Spoon, action: [f32; 2]) -> Option<(Step, Episode)> {
        spoon.step(Action::from_unit(action.map(f64::from)));
        if spoon.has_failed() {
            return None;
        }
        self.steps += 1;
        let before_mg = self.true_mg;
        self.true_mg = spoon.vial_mg() - self.tare_mg;
        let reading = self.balance.read(before_mg, self.true_mg, self.noise, self.steps.into());
        let next =
            Observation { reading_mg: reading.mass_mg, pitch_deg: spoon.pitch_deg(), ..self.seen };
        let step = Step {
            fell_mg: self.fell_mg as f32,
            reading_mg: self.seen.reading_mg as f32,
            pitch_deg: self.seen.pitch_deg as f32,
            action,
            next_reading_mg: next.reading_mg as f32,
            next_pitch_deg: next.pitch_deg as f32,
            next_true_mg: self.true_mg as f32,
        };
        self.fell_mg = next.reading_mg - self.seen.reading_mg;
        self.seen = next;
        Some((step, self.rules.after(self.steps, &next, self.balance.readability_mg)))
    }
}

/// Plays one episode: `propose` is called before each step and returns values in -1..=1. The vial
/// is tared first.
///
/// If the simulation fails, the episode ends before the failed step, as a time-out, so that nothing
/// is learned from it.
pub fn play(
    spoon: &mut impl Spoon,
    rules: &Rules,
    balance: &balance::Settings,
    target_mg: f64,
    seed: u64,
    mut propose: impl FnMut(&Observation) -> [f32; 2],
) -> Played {
    let mut playing = Playing::begin(spoon, rules, balance, target_mg, seed);
    let (mut steps, mut sum) = (Vec::new(), 0.0);
    let ending = loop {
        let action = propose(&playing.seen);
        let Some((step, state)) = playing.step(spoon, action) else { break Episode::TimedOut };
        steps.push(step);
        sum += reward(target_mg, playing.true_mg);
        if state != Episode::Running {
            break state;
        }
    };
    Played {
        steps,
        target_mg,
        dispensed_mg: playing.true_mg,
        reading_mg: playing.seen.reading_mg,
        reward: sum,
        ending,
    }
}

/// The simulator's spoon for these settings.
pub fn simulated(settings: &Settings) -> Simulated {
    Simulated { settings: dispense::Settings { pitch: settings.rules.pitch, ..settings.spoon } }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flip_core::domain::bench::PitchLimits;

    #[test]
    fn the_reward_is_the_published_one() {
        for (target, true_mg, expected) in
            [(10.0, 10.0, 1.0), (10.0, 9.5, 0.5), (10.0, 9.0, -1.0), (10.0, 13.0, -3.0)]
        {
            assert_eq!(reward(target, true_mg), expected);
        }
    }

    #[test]
    fn an_extended_spoon_at_the_reference_is_the_base_in_every_bit_and_a_wet_one_is_not() {
        let filling = Simulated {
            settings: dispense::Settings {
                particles: 600,
                pitch: PitchLimits::WIDE,
                ..Default::default()
            },
        };
        let set = ParameterSet::default();
        let pour = |mut spoon: Dispenser| {
            for _ in 0..5 {
                Spoon::step(&mut spoon, Action::once(8.0, 16.0));
            }
            Spoon::vial_mg(&spoon).to_bits()
        };
        let base = pour(filling.fill(&set, 3));
        assert!(f64::from_bits(base) > 0.0, "nothing fell, so nothing can differ");
        assert_eq!(pour(filling.fill_under(&set, &Patch::default(), 3)), base);
        let wet = |amplitude: f64| {
            let amplitudes = [("humidity".to_owned(), amplitude)].into();
            pour(filling.fill_under(&set, &Patch { amplitudes, ..Patch::default() }, 3))
        };
        assert_eq!(wet(0.0), base);
        assert_ne!(wet(0.5), base);
    }

    #[test]
    fn the_papers_episodes_have_ten_steps_and_ours_stop_on_target() {
        let filling = Simulated {
            settings: dispense::Settings { pitch: PitchLimits::WIDE, ..Default::default() },
        };
        let filled = filling.fill(&ParameterSet::default(), 1);
        let pour = |rules: &Rules| {
            play(&mut filled.clone(), rules, &balance::Settings::default(), 5.0, 2, |_| [1.0, 1.0])
        };
        assert_eq!(
            (pour(&Rules::PAPER).steps.len(), pour(&Rules::PAPER).ending),
            (10, Episode::TimedOut)
        );
        let ours = pour(&Rules::FLIP);
        assert_eq!(ours.ending, Episode::Terminated);
        assert!(ours.steps.len() < 10 && ours.reading_mg > 4.0);
        assert_eq!(ours.steps.last().unwrap().next_reading_mg, ours.reading_mg as f32);
        assert!(
            ours.steps.windows(2).all(|w| w[0].next_reading_mg == w[1].reading_mg
                && w[0].next_pitch_deg == w[1].pitch_deg)
        );
    }
}
