//! The replay memory and the batches drawn from it: steps, or whole episodes ([`super::episodes`]).

use super::environment::{Step, training_reward};
use super::episodes::{self, Episode};
use super::settings::{Network, Settings};
use flip_core::domain::parameters::COUNT;
use flip_policy::{Encoding, Ending, Known, Observation, is_on_target, on_target_mg};
use rand::{Rng, RngExt};

/// A stored step, with the target it was played for and the powder's parameters for the critic.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Memory {
    /// The step.
    pub step: Step,
    /// Target of the episode, mg.
    pub target_mg: f32,
    /// The powder's angle of repose, degrees; 0 if unknown.
    pub repose_deg: f32,
    /// The nine parameters as fractions of their ranges.
    pub parameters: [f32; COUNT],
}

/// Numbers per [`Memory`] in a checkpoint.
const WIDTH: usize = 10 + COUNT;

impl Memory {
    /// The observation before the step, had the target been `target_mg`.
    pub(super) fn before(&self, target_mg: f64) -> Observation {
        let s = &self.step;
        Observation { reading_mg: s.reading_mg.into(), target_mg, pitch_deg: s.pitch_deg.into() }
    }

    /// The observation after it.
    pub(super) fn after(&self, target_mg: f64) -> Observation {
        let s = &self.step;
        Observation {
            reading_mg: s.next_reading_mg.into(),
            target_mg,
            pitch_deg: s.next_pitch_deg.into(),
        }
    }

    /// The additional knowledge before it.
    pub(super) fn known_before(&self) -> Known {
        self.known(self.step.fell_mg.into())
    }

    /// The additional knowledge after it.
    pub(super) fn known_after(&self) -> Known {
        self.known(f64::from(self.step.next_reading_mg) - f64::from(self.step.reading_mg))
    }

    fn known(&self, fell_mg: f64) -> Known {
        Known { fell_mg, repose_deg: (self.repose_deg > 0.0).then_some(self.repose_deg.into()) }
    }

    fn to_row(self) -> [f32; WIDTH] {
        let s = self.step;
        let mut row = [0.0; WIDTH];
        row[..10].copy_from_slice(&[
            s.reading_mg,
            s.pitch_deg,
            s.action[0],
            s.action[1],
            s.next_reading_mg,
            s.next_pitch_deg,
            s.next_true_mg,
            self.target_mg,
            s.fell_mg,
            self.repose_deg,
        ]);
        row[10..].copy_from_slice(&self.parameters);
        row
    }

    fn from_row(row: &[f32]) -> Self {
        Self {
            step: Step {
                fell_mg: row[8],
                reading_mg: row[0],
                pitch_deg: row[1],
                action: [row[2], row[3]],
                next_reading_mg: row[4],
                next_pitch_deg: row[5],
                next_true_mg: row[6],
            },
            target_mg: row[7],
            repose_deg: row[9],
            parameters: std::array::from_fn(|k| row[10 + k]),
        }
    }
}

/// A ring buffer: when full, the oldest item is overwritten.
#[derive(Debug, Clone, PartialEq)]
pub struct Ring<T> {
    items: Vec<T>,
    capacity: usize,
    oldest: usize,
}

impl<T> Ring<T> {
    fn new(capacity: usize) -> Self {
        Self { items: Vec::new(), capacity: capacity.max(1), oldest: 0 }
    }

    fn push(&mut self, item: T) {
        if self.items.len() < self.capacity {
            self.items.push(item);
        } else {
            self.items[self.oldest] = item;
            self.oldest = (self.oldest + 1) % self.capacity;
        }
    }

    /// Picks an item uniformly at random.
    ///
    /// # Panics
    /// If there are no items.
    pub(super) fn pick(&self, rng: &mut impl Rng) -> &T {
        &self.items[rng.random_range(0..self.items.len())]
    }
}

/// The replay memory, in the form its network can learn from.
#[derive(Debug, Clone, PartialEq)]
pub enum Replay {
    /// Single steps, for feed-forward networks.
    Steps(Ring<Memory>),
    /// Whole episodes, for recurrent ones.
    Episodes(Ring<Episode>),
}

/// A [`Replay`] as plain numbers, for a checkpoint.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Remembered {
    /// Steps, one row each.
    pub rows: Vec<f32>,
    /// Steps of each episode; empty if single steps are stored.
    pub lengths: Vec<u32>,
    /// The episodes' stored states, one after another.
    pub states: Vec<f32>,
    /// Position of the oldest step or episode.
    pub oldest: usize,
}

/// A drawn batch, flat and by rows, ready for conversion to tensors.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Batch {
    /// `[batch, inputs + 9 + 2]`: encoded observation, parameters, action.
    pub now: Vec<f32>,
    /// `[batch, inputs + 9]`: encoded next observation, parameters.
    pub next: Vec<f32>,
    /// `[batch]`: scaled training reward.
    pub reward: Vec<f32>,
    /// `[batch]`: 1 where the episode continued or was cut off by its step limit, 0 where it
    /// terminated.
    pub goes_on: Vec<f32>,
    /// The steps leading to each row, for a recurrent network.
    pub courses: Option<Courses>,
}

/// The episodes that a batch's rows belong to: `steps` is the length of the longest one, the others
/// are padded with zeros.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Courses {
    /// Number of episodes.
    pub episodes: usize,
    /// `[steps + 1, episodes, inputs + 2]`: encoded observation and previous action; one row more
    /// than steps, because there is an observation after the last.
    pub inputs: Vec<f32>,
    /// `[rows]`: index of each of the batch's rows in `[steps, episodes]`.
    pub at: Vec<i64>,
    /// `[episodes, 2 * hidden]`: the actor's state after the first step as played; absent if not
    /// stored.
    pub stored: Option<Vec<f32>>,
}

impl Replay {
    /// Creates an empty memory with the capacity from these settings.
    pub fn new(settings: &Settings) -> Self {
        let capacity = settings.replay_capacity as usize;
        match settings.network {
            Network::FeedForward => Self::Steps(Ring::new(capacity)),
            Network::Recurrent { .. } => {
                Self::Episodes(Ring::new(capacity / settings.rules.steps_max as usize))
            }
        }
    }

    /// Stores an episode. One without steps, whose simulation failed at once, is ignored.
    pub fn push(&mut self, episode: Episode) {
        match self {
            Self::Steps(ring) => episode.steps.into_iter().for_each(|step| ring.push(step)),
            Self::Episodes(ring) if !episode.steps.is_empty() => ring.push(episode),
            Self::Episodes(_) => {}
        }
    }

    /// Draws a batch with replacement.
    ///
    /// A share of the steps, or of the episodes, is relabelled with another target in hindsight:
    /// the powder's behaviour does not depend on the target, so observation, reward and ending are
    /// recomputed (Andrychowicz et al., NeurIPS 2017; here with exact rewards for any target, not
    /// only for one that was reached). New targets are uniform over those for which the episode
    /// would still have been running before the step, or its first step.
    ///
    /// # Panics
    /// If the memory is empty.
    pub fn draw(&self, settings: &Settings, rng: &mut impl Rng) -> Batch {
        match self {
            Self::Steps(ring) => {
                let mut batch = Batch::default();
                for _ in 0..settings.batch {
                    let memory = ring.pick(rng);
                    let target_mg = drawn_target(memory, settings, rng);
                    batch.push(memory, target_mg, settings);
                }
                batch
            }
            Self::Episodes(ring) => episodes::draw(ring, settings, rng),
        }
    }

    /// Converts the memory to plain numbers.
    pub fn to_plain(&self) -> Remembered {
        let rows =
            |steps: &mut dyn Iterator<Item = &Memory>| steps.flat_map(|m| m.to_row()).collect();
        match self {
            Self::Steps(ring) => Remembered {
                rows: rows(&mut ring.items.iter()),
                oldest: ring.oldest,
                ..Remembered::default()
            },
            Self::Episodes(ring) => Remembered {
                rows: rows(&mut ring.items.iter().flat_map(|episode| &episode.steps)),
                lengths: ring.items.iter().map(|episode| episode.steps.len() as u32).collect(),
                states: ring.items.iter().flat_map(|episode| &episode.state).copied().collect(),
                oldest: ring.oldest,
            },
        }
    }

    /// The inverse of [`Replay::to_plain`]; `None` if the numbers cannot be such a memory.
    pub fn from_plain(plain: &Remembered, settings: &Settings) -> Option<Self> {
        let mut steps: Vec<Memory> = plain.rows.chunks_exact(WIDTH).map(Memory::from_row).collect();
        let whole = plain.rows.len().is_multiple_of(WIDTH);
        let fill =
            |capacity: usize, count: usize| whole && count <= capacity && plain.oldest < capacity;
        match Self::new(settings) {
            Self::Steps(ring) => {
                let fits = fill(ring.capacity, steps.len())
                    && plain.lengths.is_empty()
                    && plain.states.is_empty();
                fits.then_some(Self::Steps(Ring { items: steps, oldest: plain.oldest, ..ring }))
            }
            Self::Episodes(ring) => {
                let state = if settings.stores_states() { 2 * settings.hidden as usize } else { 0 };
                let total: u64 = plain.lengths.iter().map(|&length| u64::from(length)).sum();
                let fits = fill(ring.capacity, plain.lengths.len())
                    && !plain.lengths.contains(&0)
                    && total == steps.len() as u64
                    && plain.states.len() == state * plain.lengths.len();
                let items = plain.lengths.iter().enumerate().map(|(k, &length)| Episode {
                    steps: steps.drain(..length as usize).collect(),
                    state: plain.states[k * state..(k + 1) * state].to_vec(),
                });
                fits.then(|| {
                    Self::Episodes(Ring { items: items.collect(), oldest: plain.oldest, ..ring })
                })
            }
        }
    }
}

/// Draws the target for a step, or for the episode it begins: its own, or one in hindsight.
pub(super) fn drawn_target(memory: &Memory, settings: &Settings, rng: &mut impl Rng) -> f64 {
    let own_mg = f64::from(memory.target_mg);
    if rng.random::<f64>() < settings.relabel_share {
        return hindsight_target(memory, settings, rng).unwrap_or(own_mg);
    }
    own_mg
}

/// A target for which this step would have been taken too; `None` if there is none in range.
fn hindsight_target(memory: &Memory, settings: &Settings, rng: &mut impl Rng) -> Option<f64> {
    let lower = match settings.rules.ending {
        Ending::Never => settings.relabel_mg_min,
        Ending::OnTarget => {
            let reached_mg =
                f64::from(memory.step.reading_mg) + on_target_mg(settings.balance.readability_mg);
            settings.relabel_mg_min.max(reached_mg)
        }
    };
    (lower < settings.target_mg_max).then(|| rng.random_range(lower..settings.target_mg_max))
}

impl Batch {
    /// Adds a step as if the target had been `target_mg`; returns whether it ends the episode.
    pub(super) fn push(&mut self, memory: &Memory, target_mg: f64, settings: &Settings) -> bool {
        let s = &memory.step;
        let encoding: Encoding = settings.encoding;
        memory.before(target_mg).encode_into(encoding, &memory.known_before(), &mut self.now);
        self.now.extend(memory.parameters);
        self.now.extend(s.action);
        let next = memory.after(target_mg);
        next.encode_into(encoding, &memory.known_after(), &mut self.next);
        self.next.extend(memory.parameters);
        let terminated = settings.rules.ending == Ending::OnTarget
            && is_on_target(next.missing_mg(), settings.balance.readability_mg);
        let r = training_reward(settings, target_mg, s.next_true_mg.into(), terminated);
        self.reward.push((settings.reward_scale * r) as f32);
        self.goes_on.push(if terminated { 0.0 } else { 1.0 });
        terminated
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
                fell_mg: 0.0,
                reading_mg,
                pitch_deg: 8.0,
                action: [0.25, -0.5],
                next_reading_mg,
                next_pitch_deg: 10.0,
                next_true_mg: next_reading_mg + 0.25,
            },
            target_mg: 12.0,
            repose_deg: 30.0,
            parameters: [0.5; COUNT],
        }
    }

    fn settings(preset: Preset) -> Settings {
        let network = Network::FeedForward;
        Settings {
            batch: 400,
            relabel_share: 1.0,
            network,
            ..Settings::of(preset, Order::Random, 1)
        }
    }

    /// A replay memory with these steps.
    fn replay(settings: &Settings, steps: Vec<Memory>) -> Replay {
        let mut replay = Replay::new(settings);
        replay.push(Episode { steps, state: vec![] });
        replay
    }

    #[test]
    fn a_step_without_relabelling_is_given_back_as_it_was_played() {
        let settings = Settings { relabel_share: 0.0, batch: 1, ..settings(Preset::Paper) };
        let batch = replay(&settings, vec![memory(3.0, 5.0)])
            .draw(&settings, &mut Pcg64Mcg::seed_from_u64(1));
        let seen = Observation { reading_mg: 3.0, target_mg: 12.0, pitch_deg: 8.0 }
            .encode(Encoding::Paper, &Known::default());
        assert_eq!(batch.now, [seen, vec![0.5; COUNT], vec![0.25, -0.5]].concat());
        assert_eq!((batch.reward, batch.goes_on), (vec![-6.75], vec![1.0]));
    }

    #[test]
    fn relabelled_targets_keep_the_dynamics_and_agree_with_reward_and_ending() {
        let settings = settings(Preset::Flip);
        let batch = replay(&settings, vec![memory(3.0, 9.0)])
            .draw(&settings, &mut Pcg64Mcg::seed_from_u64(1));
        let width = settings.encoding.width();
        let (mut ended, mut overdosed) = (0, 0);
        for (k, now) in batch.now.chunks_exact(width + COUNT + 2).enumerate() {
            // The first input is the missing mass over 10 mg, which reveals the target used.
            let target = f64::from(now[0]) * 10.0 + 3.0;
            assert!(
                (4.0..15.0).contains(&target),
                "the step would not have been taken for {target} mg"
            );
            assert_eq!(
                (now[2], now[width + COUNT..].to_vec()),
                (8.0 / 25.0 - 1.0, vec![0.25, -0.5])
            );
            let terminated = target - 9.0 < 1.0;
            assert_eq!(batch.goes_on[k], if terminated { 0.0 } else { 1.0 });
            let expected =
                settings.reward_scale * training_reward(&settings, target, 9.25, terminated);
            assert!((f64::from(batch.reward[k]) - expected).abs() < 1e-4);
            ended += u32::from(terminated);
            overdosed += u32::from(9.25 - target > 1.0);
        }
        // Targets are uniform over 4 to 15 mg: 6/11 of 400 end the episode, 4.25/11 are overdosed;
        // 4 SD are 40.
        assert!(
            (178..=258).contains(&ended) && (115..=195).contains(&overdosed),
            "{ended} {overdosed}"
        );
    }

    #[test]
    fn a_step_that_no_target_in_range_explains_keeps_its_own() {
        let settings = settings(Preset::Flip);
        let batch = replay(&settings, vec![memory(14.5, 16.0)])
            .draw(&settings, &mut Pcg64Mcg::seed_from_u64(1));
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
        let settings = |replay_capacity| Settings { replay_capacity, ..settings(Preset::Flip) };
        let steps =
            |range: std::ops::Range<u32>| range.map(|k| memory(k as f32, 9.0)).collect::<Vec<_>>();
        let replay = replay(&settings(3), steps(0..5));
        assert_eq!(
            replay,
            Replay::Steps(Ring {
                items: [steps(3..5), steps(2..3)].concat(),
                capacity: 3,
                oldest: 2
            })
        );
        let plain = replay.to_plain();
        assert_eq!(Replay::from_plain(&plain, &settings(3)), Some(replay));
        assert_eq!(Replay::from_plain(&plain, &settings(2)), None);
        let rows = plain.rows[1..].to_vec();
        assert_eq!(Replay::from_plain(&Remembered { rows, ..plain.clone() }, &settings(3)), None);
        assert_eq!(
            Replay::from_plain(&Remembered { lengths: vec![3], ..plain }, &settings(3)),
            None
        );
    }
}
