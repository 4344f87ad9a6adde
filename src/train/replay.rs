//! The steps a learner remembers, and the batches it draws from them.

use super::environment::{Step, reward};
use super::settings::Settings;
use crate::domain::parameters::COUNT;
use crate::policy::{Encoding, Ending, ON_TARGET_MG, Observation, is_on_target};
use rand::{Rng, RngExt};

/// A remembered step: the target it was played for, and the powder's parameters for the critic.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Memory {
    /// What happened.
    pub step: Step,
    /// Target of the episode, mg.
    pub target_mg: f32,
    /// The nine parameters as fractions of their ranges.
    pub parameters: [f32; COUNT],
}

/// Numbers in one [`Memory`], for the checkpoint.
const WIDTH: usize = 8 + COUNT;

impl Memory {
    fn to_row(self) -> [f32; WIDTH] {
        let s = self.step;
        let mut row = [0.0; WIDTH];
        row[..8].copy_from_slice(&[
            s.reading_mg,
            s.pitch_deg,
            s.action[0],
            s.action[1],
            s.next_reading_mg,
            s.next_pitch_deg,
            s.next_true_mg,
            self.target_mg,
        ]);
        row[8..].copy_from_slice(&self.parameters);
        row
    }

    fn from_row(row: &[f32]) -> Self {
        Self {
            step: Step {
                reading_mg: row[0],
                pitch_deg: row[1],
                action: [row[2], row[3]],
                next_reading_mg: row[4],
                next_pitch_deg: row[5],
                next_true_mg: row[6],
            },
            target_mg: row[7],
            parameters: std::array::from_fn(|k| row[8 + k]),
        }
    }
}

/// A ring of remembered steps.
#[derive(Debug, Clone, PartialEq)]
pub struct Replay {
    memories: Vec<Memory>,
    capacity: usize,
    oldest: usize,
}

/// A drawn batch, flat and by rows, ready to become tensors.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Batch {
    /// `[batch, inputs + 9 + 2]`: encoded observation, parameters, action.
    pub now: Vec<f32>,
    /// `[batch, inputs + 9]`: encoded next observation, parameters.
    pub next: Vec<f32>,
    /// `[batch]`: scaled training reward.
    pub reward: Vec<f32>,
    /// `[batch]`: 1 where the episode went on or was cut off by its step limit, 0 where it terminated.
    pub goes_on: Vec<f32>,
}

impl Replay {
    /// Remembers nothing yet, and at most `capacity` steps.
    pub fn new(capacity: usize) -> Self {
        Self { memories: Vec::new(), capacity: capacity.max(1), oldest: 0 }
    }

    /// Number of remembered steps.
    pub fn len(&self) -> usize {
        self.memories.len()
    }

    /// Nothing is remembered.
    pub fn is_empty(&self) -> bool {
        self.memories.is_empty()
    }

    /// Remember one more step; when full, the oldest is forgotten.
    pub fn push(&mut self, memory: Memory) {
        if self.memories.len() < self.capacity {
            self.memories.push(memory);
        } else {
            self.memories[self.oldest] = memory;
            self.oldest = (self.oldest + 1) % self.capacity;
        }
    }

    /// Draw a batch with replacement.
    ///
    /// A share of the steps is asked about another target in hindsight: what the powder did does not depend on what was
    /// asked for, so observation, reward and ending are computed anew (Andrychowicz et al., NeurIPS 2017; here with exact
    /// rewards for any target, not only for one that was reached). New targets are uniform over those for which the
    /// episode would still have been running before the step.
    ///
    /// # Panics
    /// On an empty memory.
    pub fn draw(&self, settings: &Settings, rng: &mut impl Rng) -> Batch {
        let mut batch = Batch::default();
        for _ in 0..settings.batch {
            let memory = &self.memories[rng.random_range(0..self.memories.len())];
            let mut target_mg = f64::from(memory.target_mg);
            if rng.random::<f64>() < settings.relabel_share {
                target_mg = hindsight_target(memory, settings, rng).unwrap_or(target_mg);
            }
            batch.push(memory, target_mg, settings);
        }
        batch
    }

    /// Everything as flat rows and the position of the oldest, for a checkpoint.
    pub fn to_rows(&self) -> (Vec<f32>, usize) {
        (self.memories.iter().flat_map(|m| m.to_row()).collect(), self.oldest)
    }

    /// The inverse of [`Replay::to_rows`]; `None` when the numbers cannot be such a memory.
    pub fn from_rows(rows: &[f32], oldest: usize, capacity: usize) -> Option<Self> {
        let memories: Vec<Memory> = rows.chunks_exact(WIDTH).map(Memory::from_row).collect();
        let fits = rows.len().is_multiple_of(WIDTH) && memories.len() <= capacity && oldest < capacity.max(1);
        fits.then_some(Self { memories, capacity: capacity.max(1), oldest })
    }
}

/// A target for which this step would have been taken too; `None` when there is none in range.
fn hindsight_target(memory: &Memory, settings: &Settings, rng: &mut impl Rng) -> Option<f64> {
    let lower = match settings.rules.ending {
        Ending::Never | Ending::Decided => settings.relabel_mg_min,
        Ending::OnTarget => settings.relabel_mg_min.max(f64::from(memory.step.reading_mg) + ON_TARGET_MG),
    };
    (lower < settings.target_mg_max).then(|| rng.random_range(lower..settings.target_mg_max))
}

/// What one step is worth to the learner, unscaled: the published reward, heavier where the dose is too high for good,
/// and paid for ever where the episode ends.
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

impl Batch {
    fn push(&mut self, memory: &Memory, target_mg: f64, settings: &Settings) {
        let s = &memory.step;
        let seen = |reading_mg: f32, pitch_deg: f32| Observation {
            reading_mg: reading_mg.into(),
            target_mg,
            pitch_deg: pitch_deg.into(),
        };
        let encoding: Encoding = settings.encoding;
        seen(s.reading_mg, s.pitch_deg).encode_into(encoding, &mut self.now);
        self.now.extend(memory.parameters);
        self.now.extend(s.action);
        let next = seen(s.next_reading_mg, s.next_pitch_deg);
        next.encode_into(encoding, &mut self.next);
        self.next.extend(memory.parameters);
        let terminated = settings.rules.ending == Ending::OnTarget && is_on_target(next.missing_mg());
        let r = training_reward(settings, target_mg, s.next_true_mg.into(), terminated);
        self.reward.push((settings.reward_scale * r) as f32);
        self.goes_on.push(if terminated { 0.0 } else { 1.0 });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::settings::{Order, Preset};
    use rand::SeedableRng;
    use rand_pcg::Pcg64Mcg;

    fn memory(reading_mg: f32, next_reading_mg: f32) -> Memory {
        Memory {
            step: Step {
                reading_mg,
                pitch_deg: 8.0,
                action: [0.25, -0.5],
                next_reading_mg,
                next_pitch_deg: 10.0,
                next_true_mg: next_reading_mg + 0.25,
            },
            target_mg: 12.0,
            parameters: [0.5; COUNT],
        }
    }

    fn settings(preset: Preset) -> Settings {
        Settings { batch: 400, relabel_share: 1.0, ..Settings::of(preset, Order::Random, 1) }
    }

    #[test]
    fn a_step_without_relabelling_is_given_back_as_it_was_played() {
        let settings = Settings { relabel_share: 0.0, batch: 1, ..Settings::of(Preset::Paper, Order::Random, 1) };
        let mut replay = Replay::new(4);
        replay.push(memory(3.0, 5.0));
        let batch = replay.draw(&settings, &mut Pcg64Mcg::seed_from_u64(1));
        let seen = Observation { reading_mg: 3.0, target_mg: 12.0, pitch_deg: 8.0 }.encode(Encoding::Paper);
        assert_eq!(batch.now, [seen, vec![0.5; COUNT], vec![0.25, -0.5]].concat());
        assert_eq!((batch.reward, batch.goes_on), (vec![-6.75], vec![1.0]));
    }

    #[test]
    fn relabelled_targets_keep_the_dynamics_and_agree_with_reward_and_ending() {
        let settings = settings(Preset::Flip);
        let mut replay = Replay::new(4);
        replay.push(memory(3.0, 9.0));
        let batch = replay.draw(&settings, &mut Pcg64Mcg::seed_from_u64(1));
        let width = settings.encoding.width();
        let (mut ended, mut overdosed) = (0, 0);
        for (k, now) in batch.now.chunks_exact(width + COUNT + 2).enumerate() {
            // The first input is what is missing over 10 mg: it tells the target that was asked for.
            let target = f64::from(now[0]) * 10.0 + 3.0;
            assert!((4.0..15.0).contains(&target), "the step would not have been taken for {target} mg");
            assert_eq!((now[width - 2], now[width + COUNT..].to_vec()), (8.0 / 25.0 - 1.0, vec![0.25, -0.5]));
            let terminated = target - 9.0 < 1.0;
            assert_eq!(batch.goes_on[k], if terminated { 0.0 } else { 1.0 });
            let expected = settings.reward_scale * training_reward(&settings, target, 9.25, terminated);
            assert!((f64::from(batch.reward[k]) - expected).abs() < 1e-4);
            ended += u32::from(terminated);
            overdosed += u32::from(9.25 - target > 1.0);
        }
        // Targets are uniform over 4 to 15 mg: 6/11 of 400 end the episode, 4.25/11 are overdosed; 4 sd are 40.
        assert!((178..=258).contains(&ended) && (115..=195).contains(&overdosed), "{ended} {overdosed}");
    }

    #[test]
    fn a_step_that_no_target_in_range_explains_keeps_its_own() {
        let settings = settings(Preset::Flip);
        let mut replay = Replay::new(4);
        replay.push(memory(14.5, 16.0));
        let batch = replay.draw(&settings, &mut Pcg64Mcg::seed_from_u64(1));
        assert!(batch.goes_on.iter().all(|&g| g == 0.0));
    }

    #[test]
    fn an_ending_is_worth_its_reward_for_ever_and_an_overdose_more_than_a_shortfall() {
        let settings = Settings { gamma: 0.9, overdose_factor: 2.0, ..settings(Preset::Flip) };
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a} {b}");
        close(training_reward(&settings, 10.0, 9.5, true), 5.0);
        close(training_reward(&settings, 10.0, 13.0, true), -60.0);
        close(training_reward(&settings, 10.0, 7.0, false), -3.0);
        close(training_reward(&self::settings(Preset::Paper), 10.0, 13.0, false), -3.0);
    }

    #[test]
    fn the_oldest_step_is_forgotten_first_and_rows_bring_everything_back() {
        let mut replay = Replay::new(3);
        for k in 0..5 {
            replay.push(memory(k as f32, 9.0));
        }
        let readings: Vec<f32> = replay.memories.iter().map(|m| m.step.reading_mg).collect();
        assert_eq!((readings, replay.oldest), (vec![3.0, 4.0, 2.0], 2));
        let (rows, oldest) = replay.to_rows();
        assert_eq!(Replay::from_rows(&rows, oldest, 3), Some(replay));
        assert_eq!(Replay::from_rows(&rows, oldest, 2), None);
        assert_eq!(Replay::from_rows(&rows[1..], oldest, 3), None);
    }
}
