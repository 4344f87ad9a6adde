//! Many simulated doses at once, one step of all of them at a time: the environment for learners
//! other than [`train`](super::train()).
//!
//! Powders, targets and conditions are drawn as in a training, episodes are [`Playing`] as in a
//! training, and rewards are the training's ([`training_reward`]): it is the same decision process.

use super::environment::{Playing, Simulated, Spoon, reward, simulated, training_reward};
use super::plan::{Planned, ordered, plan_of, stream};
use super::record::Level;
use super::settings::Settings;
use super::spoons::Spoons;
use super::surrogate::SurrogateSpoon;
use flip_core::domain::bench::Action;
use flip_core::domain::parameters::{COUNT, ParameterSet};
use flip_core::domain::seed::derive;
use flip_core::domain::{FieldError, bounded};
use flip_policy::{Episode, Known, OUTPUTS, Observation};
use flip_sim::dispense::{Dispenser, capacity_mg};
use serde::{Deserialize, Serialize};

/// What the doses are poured from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pouring {
    /// The fast model of a spoon ([`super::Surrogate`]).
    Surrogate,
    /// The simulator's spoon.
    Simulator,
}

/// When an episode that has ended gives way to the next.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Autoreset {
    /// At the next step, whose action is ignored.
    NextStep,
    /// At once: the observation is the next episode's.
    SameStep,
    /// Not at all: the caller resets.
    Disabled,
}

/// Names of the numbers reported with each observation, in their order: masses in mg, the pitch in
/// degrees; `level` is -1 for a powder from the whole box, and `failed` is 1 where the simulation
/// left the range in which its numbers mean something.
pub const FACTS: [&str; 8] = [
    "target_mg",
    "reading_mg",
    "true_mg",
    "pitch_deg",
    "published_reward",
    "step",
    "level",
    "failed",
];

/// Where the results of a step go: one row for each dose, one after another.
#[derive(Debug)]
pub struct Rows<'a> {
    /// `[doses, inputs]`: encoded observations.
    pub inputs: &'a mut [f32],
    /// `[doses]`: training rewards, unscaled.
    pub rewards: &'a mut [f64],
    /// `[doses]`: whether the episode ended by its own rule.
    pub terminated: &'a mut [bool],
    /// `[doses]`: whether it ran out of steps.
    pub truncated: &'a mut [bool],
    /// `[doses, FACTS]`.
    pub facts: &'a mut [f64],
    /// `[doses, inputs]`: with [`Autoreset::SameStep`], the last observation of an episode that ended;
    /// other rows are left alone.
    pub last_inputs: &'a mut [f32],
    /// `[doses, FACTS]`: likewise.
    pub last_facts: &'a mut [f64],
}

/// Doses in lockstep.
pub struct Lockstep {
    rules: Playbook,
    doses: Vec<Dose>,
    /// Doses that one thread takes at a time.
    grain: usize,
}

/// What all doses have in common.
struct Playbook {
    settings: Settings,
    levels: Vec<Level>,
    level: u32,
    /// Overrides the target drawn, mg.
    target_mg: Option<f64>,
    spoons: Option<Spoons<Simulated>>,
    autoreset: Autoreset,
}

/// One dose after another, from one seed.
struct Dose {
    seed: u64,
    /// Index of its next episode.
    next: u32,
    now: Option<Now>,
    /// The encoded observation; kept so that its memory is.
    inputs: Vec<f32>,
}

/// An episode being played.
struct Now {
    plan: Planned,
    spoon: Poured,
    playing: Playing,
    ended: bool,
}

/// A spoon of either kind.
#[derive(Clone)]
enum Poured {
    Surrogate(SurrogateSpoon),
    Simulator(Box<Dispenser>),
}

impl Spoon for Poured {
    fn step(&mut self, action: Action) {
        match self {
            Self::Surrogate(spoon) => spoon.step(action),
            Self::Simulator(spoon) => Spoon::step(spoon.as_mut(), action),
        }
    }
    fn pitch_deg(&self) -> f64 {
        match self {
            Self::Surrogate(spoon) => spoon.pitch_deg(),
            Self::Simulator(spoon) => spoon.pitch_deg(),
        }
    }
    fn vial_mg(&self) -> f64 {
        match self {
            Self::Surrogate(spoon) => spoon.vial_mg(),
            Self::Simulator(spoon) => spoon.vial_mg(),
        }
    }
    fn has_failed(&self) -> bool {
        match self {
            Self::Surrogate(spoon) => spoon.has_failed(),
            Self::Simulator(spoon) => spoon.has_failed(),
        }
    }
}

/// Surrogate doses that one thread takes at a time: fewer cost more to hand over than to play.
const SURROGATE_GRAIN: usize = 64;

impl Lockstep {
    /// Creates `count` doses, to be [`reset`](Self::reset) before the first step. Dose k has the
    /// settings' seed plus k.
    ///
    /// # Errors
    /// The first setting or level that is out of range, by name.
    pub fn new(
        count: u32,
        pouring: Pouring,
        autoreset: Autoreset,
        levels: &[Level],
        settings: &Settings,
    ) -> Result<Self, FieldError> {
        bounded("num_envs", count.into(), 1.0, 1e6, "")?;
        let settings = checked(settings)?;
        let levels = ordered(levels, &settings)?;
        let seed = derive(settings.seed, &[stream::SPOONS]);
        let spoons =
            (pouring == Pouring::Simulator).then(|| Spoons::new(simulated(&settings), seed));
        let doses = (0..u64::from(count))
            .map(|k| Dose {
                seed: settings.seed.wrapping_add(k),
                next: 0,
                now: None,
                inputs: Vec::new(),
            })
            .collect();
        let grain = if spoons.is_some() { 1 } else { SURROGATE_GRAIN };
        let rules = Playbook { settings, levels, level: 0, target_mg: None, spoons, autoreset };
        Ok(Self { rules, doses, grain })
    }

    /// Number of doses.
    pub fn len(&self) -> usize {
        self.doses.len()
    }

    /// Whether there are no doses, which never is.
    pub fn is_empty(&self) -> bool {
        self.doses.is_empty()
    }

    /// Inputs per observation.
    pub fn width(&self) -> usize {
        self.rules.settings.encoding.width()
    }

    /// The settings in force.
    pub fn settings(&self) -> &Settings {
        &self.rules.settings
    }

    /// The levels, in the order in which [`Self::set_level`] counts them.
    pub fn levels(&self) -> &[Level] {
        &self.rules.levels
    }

    /// Episodes that begin from now on are on this level, counted from 0, where the order is a
    /// curriculum's.
    ///
    /// # Errors
    /// There is no such level.
    pub fn set_level(&mut self, level: u32) -> Result<(), FieldError> {
        let count = self.rules.levels.len();
        if level as usize >= count.max(1) {
            return Err(FieldError::new("level", format!("must be below {count}, got {level}")));
        }
        self.rules.level = level;
        Ok(())
    }

    /// Episodes that begin from now on have this target, mg, or one drawn as in a training.
    ///
    /// # Errors
    /// Not within 0.1 to 1000 mg.
    pub fn set_target_mg(&mut self, target_mg: Option<f64>) -> Result<(), FieldError> {
        let check = |mg| bounded("target_mg", mg, 0.1, 1000.0, "mg");
        self.rules.target_mg = target_mg.map(check).transpose()?;
        Ok(())
    }

    /// Begins the next episode of the doses named by `which`, all if it is absent, and shows all. A
    /// dose with a new seed begins with the first episode of that seed.
    ///
    /// # Panics
    /// `which`, `seeds` or `rows` are not as many as the doses.
    pub fn reset(&mut self, which: Option<&[bool]>, seeds: &[Option<u64>], rows: Rows<'_>) {
        assert_eq!(seeds.len(), self.doses.len(), "every dose has a seed or none");
        for (dose, seed) in self.doses.iter_mut().zip(seeds) {
            if let Some(seed) = *seed {
                (dose.seed, dose.next) = (seed, 0);
            }
        }
        let rules = &self.rules;
        let begin = |k: usize, dose: &mut Dose, row: &mut Rows<'_>| {
            if which.is_none_or(|which| which[k]) {
                dose.begin(rules);
            }
            dose.show(rules, row, Told::default());
        };
        each(&mut self.doses, 0, rows, self.grain, &begin);
    }

    /// Carries out one action of each dose: two numbers in -1..=1, the change of the pitch and the
    /// amplitude.
    ///
    /// # Errors
    /// A dose that was never reset, or has ended and is not reset by itself; nothing has moved then.
    ///
    /// # Panics
    /// `actions` or `rows` are not as many as the doses.
    pub fn step(&mut self, actions: &[[f32; OUTPUTS]], rows: Rows<'_>) -> Result<(), FieldError> {
        assert_eq!(actions.len(), self.doses.len(), "every dose has an action");
        let by_itself = self.rules.autoreset != Autoreset::Disabled;
        let stuck = |dose: &Dose| dose.now.as_ref().is_none_or(|now| now.ended && !by_itself);
        if let Some(k) = self.doses.iter().position(stuck) {
            return Err(FieldError::new("actions", format!("dose {k} must be reset first")));
        }
        let rules = &self.rules;
        let step = |k: usize, dose: &mut Dose, row: &mut Rows<'_>| {
            dose.step(rules, actions[k], row);
        };
        each(&mut self.doses, 0, rows, self.grain, &step);
        Ok(())
    }

    /// The nine parameters of each dose's powder as fractions of their ranges, `[doses, 9]`: what a
    /// critic may know and a policy may not.
    pub fn parameters(&self) -> Vec<[f32; COUNT]> {
        let of = |now: &Now| now.plan.set.to_unit().map(|x| x as f32);
        self.doses.iter().map(|dose| dose.now.as_ref().map_or([0.0; COUNT], of)).collect()
    }

    /// Lowest and highest value of each input.
    ///
    /// Every input rises or falls with each of the numbers that it is made from, so that its extremes
    /// lie where those have theirs.
    pub fn bounds(&self) -> [Vec<f32>; 2] {
        let settings = &self.rules.settings;
        let [low_mg, high_mg] = readings_mg(settings);
        let target = [settings.target_mg_min.min(0.1), settings.target_mg_max.max(1000.0)];
        let pitch = settings.rules.pitch;
        let mut bounds = [vec![f32::MAX; self.width()], vec![f32::MIN; self.width()]];
        let mut inputs = Vec::new();
        for corner in 0..64 {
            let end = |k: u32, ends: [f64; 2]| ends[(corner >> k & 1) as usize];
            let seen = Observation {
                reading_mg: end(0, [low_mg, high_mg]),
                target_mg: end(1, target),
                pitch_deg: end(2, [pitch.lower_deg, pitch.upper_deg]),
            };
            let fell_mg = end(3, [low_mg - high_mg, high_mg - low_mg]);
            let repose_deg = (corner >> 4 & 1 == 1).then(|| end(5, [0.0, 90.0]));
            inputs.clear();
            seen.encode_into(settings.encoding, &Known { fell_mg, repose_deg }, &mut inputs);
            for (k, &x) in inputs.iter().enumerate() {
                bounds[0][k] = bounds[0][k].min(x);
                bounds[1][k] = bounds[1][k].max(x);
            }
        }
        bounds
    }
}

/// Validates settings whose spoon and balance nobody else has validated.
fn checked(settings: &Settings) -> Result<Settings, FieldError> {
    let Settings { balance, spoon, .. } = settings;
    bounded("balance.readability_mg", balance.readability_mg, 1e-3, 100.0, "mg")?;
    bounded("balance.noise_mg", balance.noise_mg, 0.0, 100.0, "mg")?;
    bounded("balance.settling_tau_s", balance.settling_tau_s, 1e-3, 100.0, "s")?;
    bounded("balance.wait_s", balance.wait_s, 0.0, 100.0, "s")?;
    bounded("spoon.particles", spoon.particles.into(), 100.0, 100_000.0, "")?;
    let mut extensions = spoon.extensions;
    for (name, amplitude, upper) in extensions.amplitudes() {
        bounded(&format!("spoon.extensions.{name}"), *amplitude, 0.0, upper, "")?;
    }
    settings.clone().checked()
}

/// Lowest and highest possible reading, mg: everything in the spoon, and the balance's noise, whose
/// largest normal number is 8.6.
fn readings_mg(settings: &Settings) -> [f64; 2] {
    let heaviest = ParameterSet::from_unit([1.0; COUNT]);
    // Half as much again for grains of unequal sizes; the surrogate holds 40 mg.
    let held_mg = 1.5 * capacity_mg(&heaviest, &settings.spoon).max(40.0);
    let off_mg = 9.0 * settings.balance.noise_mg + settings.balance.readability_mg;
    [-off_mg, held_mg + off_mg]
}

/// What is told of a step besides the state after it.
#[derive(Debug, Clone, Copy, Default)]
struct Told {
    reward: f64,
    published: f64,
    terminated: bool,
    truncated: bool,
    failed: bool,
}

impl Dose {
    fn begin(&mut self, rules: &Playbook) {
        let Playbook { settings, levels, .. } = rules;
        let mut plan = plan_of(self.seed, self.next, rules.level, levels, settings);
        self.next = self.next.wrapping_add(1);
        plan.target_mg = rules.target_mg.unwrap_or(plan.target_mg);
        let spoon = match &rules.spoons {
            None => Poured::Surrogate(plan.surrogate(settings)),
            Some(spoons) => Poured::Simulator(Box::new(plan.spoon(spoons, settings))),
        };
        let playing =
            Playing::begin(&spoon, &settings.rules, &settings.balance, plan.target_mg, plan.seed);
        self.now = Some(Now { plan, spoon, playing, ended: false });
    }

    fn step(&mut self, rules: &Playbook, action: [f32; OUTPUTS], row: &mut Rows<'_>) {
        let Some(now) = self.now.as_mut().filter(|now| !now.ended) else {
            self.begin(rules);
            return self.show(rules, row, Told::default());
        };
        let told = now.step(&rules.settings, action);
        let ended = now.ended;
        self.show(rules, row, told);
        if ended && rules.autoreset == Autoreset::SameStep {
            row.last_inputs.copy_from_slice(row.inputs);
            row.last_facts.copy_from_slice(row.facts);
            self.begin(rules);
            self.show(rules, row, told);
        }
    }

    /// Writes the present state and what is told of the step into the dose's row.
    fn show(&mut self, rules: &Playbook, row: &mut Rows<'_>, told: Told) {
        let Some(Now { plan, playing, .. }) = &self.now else { return };
        let seen = playing.seen();
        let known = Known { fell_mg: playing.fell_mg(), repose_deg: plan.repose_deg };
        self.inputs.clear();
        seen.encode_into(rules.settings.encoding, &known, &mut self.inputs);
        row.inputs.copy_from_slice(&self.inputs);
        (row.rewards[0], row.terminated[0], row.truncated[0]) =
            (told.reward, told.terminated, told.truncated);
        let level = if plan.randomised { -1.0 } else { f64::from(plan.level) };
        row.facts.copy_from_slice(&[
            seen.target_mg,
            seen.reading_mg,
            playing.true_mg(),
            seen.pitch_deg,
            told.published,
            f64::from(playing.steps()),
            level,
            f64::from(u8::from(told.failed)),
        ]);
    }
}

impl Now {
    fn step(&mut self, settings: &Settings, action: [f32; OUTPUTS]) -> Told {
        let Some((_, state)) = self.playing.step(&mut self.spoon, action) else {
            // As in a training: a time-out before the step, of which nothing is learned.
            self.ended = true;
            return Told { truncated: true, failed: true, ..Told::default() };
        };
        self.ended = state != Episode::Running;
        let (target_mg, true_mg) = (self.plan.target_mg, self.playing.true_mg());
        let terminated = state == Episode::Terminated;
        Told {
            reward: training_reward(settings, target_mg, true_mg, terminated),
            published: reward(target_mg, true_mg),
            terminated,
            truncated: state == Episode::TimedOut,
            failed: false,
        }
    }
}

impl Rows<'_> {
    /// The same rows, for another step.
    pub fn again(&mut self) -> Rows<'_> {
        Rows {
            inputs: self.inputs,
            rewards: self.rewards,
            terminated: self.terminated,
            truncated: self.truncated,
            facts: self.facts,
            last_inputs: self.last_inputs,
            last_facts: self.last_facts,
        }
    }

    /// The rows of the first `count` doses, and the others.
    fn split(self, count: usize, doses: usize) -> (Self, Self) {
        let wide = self.inputs.len() / doses * count;
        let (inputs, inputs_b) = self.inputs.split_at_mut(wide);
        let (rewards, rewards_b) = self.rewards.split_at_mut(count);
        let (terminated, terminated_b) = self.terminated.split_at_mut(count);
        let (truncated, truncated_b) = self.truncated.split_at_mut(count);
        let (facts, facts_b) = self.facts.split_at_mut(FACTS.len() * count);
        let (last_inputs, last_inputs_b) = self.last_inputs.split_at_mut(wide);
        let (last_facts, last_facts_b) = self.last_facts.split_at_mut(FACTS.len() * count);
        (
            Self { inputs, rewards, terminated, truncated, facts, last_inputs, last_facts },
            Self {
                inputs: inputs_b,
                rewards: rewards_b,
                terminated: terminated_b,
                truncated: truncated_b,
                facts: facts_b,
                last_inputs: last_inputs_b,
                last_facts: last_facts_b,
            },
        )
    }
}

/// Calls `work` with every dose, its number and its row, on all cores if there are more than `grain`
/// of them. Fewer are worked on here: a process that forks afterwards then has no threads to lose.
fn each(
    doses: &mut [Dose],
    first: usize,
    rows: Rows<'_>,
    grain: usize,
    work: &(impl Fn(usize, &mut Dose, &mut Rows<'_>) + Sync),
) {
    let count = doses.len();
    if count == 1 {
        let mut rows = rows;
        return work(first, &mut doses[0], &mut rows);
    }
    let half = count / 2;
    let (rows_a, rows_b) = rows.split(half, count);
    let (doses_a, doses_b) = doses.split_at_mut(half);
    let a = move || each(doses_a, first, rows_a, grain, work);
    let b = move || each(doses_b, first + half, rows_b, grain, work);
    if count <= grain {
        a();
        b();
    } else {
        rayon::join(a, b);
    }
}

#[cfg(test)]
#[path = "lockstep_tests.rs"]
mod tests;
