//! The kernel's source, and a card where there is one, beside flip-learn.

use super::*;
use crate::twin::built;
use crate::{Card, CardError};
use flip_learn::train::replay::Batch;
use flip_learn::train::sac::Learner;
use flip_learn::train::{CriticLoss, Gradients, Order, Preset, Settings};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::process::Command;

/// Parameters of a powder.
const PARAMETERS: usize = 9;
const UPDATES: usize = 6;

fn settings(hidden: u32, batch: u32, critic_loss: CriticLoss) -> Settings {
    let base = Settings::of(Preset::Flip, Order::Curriculum, 1);
    let gradients = Gradients::Fused;
    Settings { hidden, batch, critic_loss, gradients, learning_rate: 3e-3, tau: 0.05, ..base }
}

fn shape(settings: &Settings) -> Shape {
    let inputs = settings.encoding.width();
    Shape {
        rows: settings.batch as usize,
        inputs,
        state: inputs + PARAMETERS,
        hidden: settings.hidden as usize,
        huber: settings.critic_loss == CriticLoss::Huber,
        gamma: settings.gamma as f32,
        tau: settings.tau as f32,
        target_entropy: settings.target_entropy,
        learning_rate: settings.learning_rate,
    }
}

/// A training: its learner, and batches with noise for each update.
struct Case {
    learner: Learner,
    batches: Vec<(Batch, Vec<f32>)>,
}

impl Case {
    fn new(settings: &Settings, seed: u64) -> Self {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let mut uniform = |count: usize, size: f32| -> Vec<f32> {
            (0..count).map(|_| size * (2.0 * rng.random::<f32>() - 1.0)).collect()
        };
        let shape = shape(settings);
        let mut batch = || {
            let batch = Batch {
                now: uniform(shape.rows * (shape.state + ACTIONS), 1.0),
                next: uniform(shape.rows * shape.state, 1.0),
                reward: uniform(shape.rows, 3.0),
                goes_on: (0..shape.rows).map(|row| f32::from(u8::from(row % 4 != 1))).collect(),
                courses: None,
            };
            let noise = uniform(shape.rows * 2 * ACTIONS, 2.0);
            (batch, noise)
        };
        let batches = (0..UPDATES).map(|_| batch()).collect();
        let mut learner = Learner::new(settings, &mut Pcg64Mcg::seed_from_u64(seed));
        // As large as a trained network's.
        for block in [&mut learner.actor, &mut learner.critics, &mut learner.targets] {
            *block = uniform(block.len(), 1.5 / (shape.hidden as f32).sqrt());
        }
        Self { learner, batches }
    }

    fn drawn(&self) -> impl Iterator<Item = Drawn<'_>> {
        self.batches.iter().map(|(batch, noise)| Drawn {
            now: &batch.now,
            next: &batch.next,
            reward: &batch.reward,
            goes_on: &batch.goes_on,
            noise,
        })
    }

    /// What flip-learn makes of it.
    fn expected(&self, settings: &Settings) -> (Learned, Vec<Losses>) {
        let mut learner = self.learner.clone();
        let update = |(batch, noise): &(Batch, Vec<f32>)| {
            let made = learner.update(batch, noise, settings);
            Losses {
                critic: made.critic,
                actor: made.actor,
                entropy: made.entropy,
                alpha: made.alpha,
            }
        };
        let losses = self.batches.iter().map(update).collect();
        (learned(&learner), losses)
    }
}

fn learned(of: &Learner) -> Learned {
    let Learner { actor_adam, critics_adam, alpha_adam, .. } = of;
    Learned {
        actor: [of.actor.clone(), actor_adam.m.clone(), actor_adam.v.clone()],
        critics: [of.critics.clone(), critics_adam.m.clone(), critics_adam.v.clone()],
        targets: of.targets.clone(),
        log_alpha: [of.log_alpha[0], alpha_adam.m[0], alpha_adam.v[0]],
        steps: [critics_adam.t, actor_adam.t],
    }
}

/// The twin's results with groups of this many blocks; none, with the reason printed, where it
/// cannot be compiled.
fn by_twin(shape: &Shape, cases: &[Case], blocks: usize) -> Option<(Vec<Learned>, Vec<Losses>)> {
    let program = built("cuda/learner_twin.cpp")?;
    let sizes = shape.sizes(UPDATES, blocks);
    let whole = [sizes.rows, sizes.inputs, sizes.state, sizes.hidden, sizes.updates, sizes.blocks];
    let mut bytes: Vec<u8> = whole.into_iter().flat_map(i32::to_le_bytes).collect();
    bytes.extend(sizes.huber.to_le_bytes());
    bytes.extend([sizes.gamma, sizes.tau].into_iter().flat_map(f32::to_le_bytes));
    bytes.extend(sizes.unused.to_le_bytes());
    bytes.extend(sizes.target_entropy.to_le_bytes());
    bytes.extend((cases.len() as i32).to_le_bytes());
    let mut numbers = Vec::new();
    for case in cases {
        numbers.extend(shape.image(&learned(&case.learner)).expect("it has this shape"));
    }
    for batch in cases.iter().flat_map(Case::drawn) {
        shape.add(&batch, &mut numbers).expect("it has this shape");
    }
    for _ in cases {
        numbers.extend((0..UPDATES as u64).flat_map(|k| shape.scales([k; 2])));
    }
    bytes.extend(numbers.iter().flat_map(|x| x.to_le_bytes()));
    let folder = tempfile::tempdir().expect("a folder for the trainings");
    let (input, output) = (folder.path().join("in"), folder.path().join("out"));
    std::fs::write(&input, bytes).expect("the trainings are written");
    let status = Command::new(program).args([&input, &output]).status().expect("the twin runs");
    assert!(status.success(), "the twin failed: {status}");
    let bytes = std::fs::read(&output).expect("the twin's answer is read");
    let (images, raw) = bytes.split_at(4 * shape.training() * cases.len());
    let images: Vec<f32> = images.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
    let raw: Vec<f64> = raw.as_chunks().0.iter().map(|b| f64::from_le_bytes(*b)).collect();
    let of = |image| shape.learned_in(image, [UPDATES as u64; 2]);
    Some((images.chunks(shape.training()).map(of).collect(), losses(&raw)))
}

/// Widths, batches that are and are not multiples of a chunk, and both losses.
fn all_settings() -> [Settings; 3] {
    [
        settings(16, 5, CriticLoss::Squared),
        settings(48, 37, CriticLoss::Huber),
        settings(128, 64, CriticLoss::Squared),
    ]
}

#[test]
fn the_twin_is_flip_learn_in_every_bit() {
    for settings in all_settings() {
        let cases = [Case::new(&settings, 1), Case::new(&settings, 2)];
        for blocks in [1, 3] {
            let Some((learned, losses)) = by_twin(&shape(&settings), &cases, blocks) else {
                return;
            };
            for (k, case) in cases.iter().enumerate() {
                let expected = case.expected(&settings);
                assert_eq!(losses[k * UPDATES..][..UPDATES], expected.1);
                assert!(learned[k] == expected.0, "{} units, training {k}", settings.hidden);
            }
        }
    }
}

#[test]
fn a_card_is_flip_learn_in_every_bit_however_it_shares_out_the_work() {
    let card = match Card::open(0) {
        Ok(card) => card,
        Err(reason) => return println!("skipped: {reason}"),
    };
    for settings in all_settings() {
        let cases: Vec<Case> = (0..3).map(|seed| Case::new(&settings, seed)).collect();
        let expected: Vec<_> = cases.iter().map(|case| case.expected(&settings)).collect();
        for blocks in [1, 2, 99] {
            let states: Vec<Learned> = cases.iter().map(|case| learned(&case.learner)).collect();
            let learners = Learners::new(&card, shape(&settings), &states).expect("a card");
            let mut learners = learners.with_blocks(blocks);
            let batches: Vec<Drawn> = cases.iter().flat_map(Case::drawn).collect();
            let losses = learners.update(&batches).expect("the card works");
            for (k, (state, expected_losses)) in expected.iter().enumerate() {
                assert_eq!(losses[k * UPDATES..][..UPDATES], *expected_losses);
                assert!(learners.learned(k).expect("the card works") == *state, "training {k}");
            }
        }
    }
}

#[test]
fn learners_and_batches_of_other_sizes_are_refused() {
    let settings = settings(16, 5, CriticLoss::Squared);
    let shape = shape(&settings);
    let case = Case::new(&settings, 1);
    let whole = learned(&case.learner);
    let mut short = whole.clone();
    short.targets.pop();
    assert!(matches!(shape.image(&short), Err(CardError::Unfit(_))));
    let odd = Shape { hidden: 12, ..shape };
    assert!(matches!(odd.image(&whole), Err(CardError::Unfit(_))));
    let batch = case.drawn().next().expect("there are batches");
    let short = Drawn { reward: &batch.reward[1..], ..batch };
    assert!(matches!(shape.add(&short, &mut Vec::new()), Err(CardError::Unfit(_))));
    assert_eq!(shape.learned_in(&shape.image(&whole).expect("it fits"), whole.steps), whole);
}
