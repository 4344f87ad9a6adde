//! The kernel's source, and a card where there is one, beside flip-learn.

use super::*;
use crate::Card;
use crate::learner_twin::updated;
use flip_core::learner::ACTIONS;
use flip_learn::train::replay::Batch;
use flip_learn::train::sac::Learner;
use flip_learn::train::{CriticLoss, Gradients, Order, Preset, Settings};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

const UPDATES: usize = 6;

fn settings(hidden: u32, batch: u32, critic_loss: CriticLoss) -> Settings {
    let base = Settings::of(Preset::Flip, Order::Curriculum, 1);
    let gradients = Gradients::Fused;
    Settings { hidden, batch, critic_loss, gradients, learning_rate: 3e-3, tau: 0.05, ..base }
}

fn shape(settings: &Settings) -> Shape {
    Learner::shape(settings).expect("perceptrons, from the beginning")
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
        let update = |(batch, noise): &(Batch, Vec<f32>)| learner.update(batch, noise, settings);
        let losses = self.batches.iter().map(update).collect();
        (learner.learned(), losses)
    }
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
        let states = cases.each_ref().map(|case| case.learner.learned());
        let batches: Vec<Drawn> = cases.iter().flat_map(Case::drawn).collect();
        for blocks in [1, 3] {
            let layout = Layout(shape(&settings));
            let Some(updated) = updated(layout, blocks, &states, &batches) else { return };
            let (learned, losses) = updated.expect("they are of this shape");
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
            let states: Vec<_> = cases.iter().map(|case| case.learner.learned()).collect();
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
    let layout = Layout(shape(&settings));
    let case = Case::new(&settings, 1);
    let whole = case.learner.learned();
    let mut short = whole.clone();
    short.targets.pop();
    assert!(matches!(layout.image(&short), Err(CardError::Unfit(_))));
    let odd = Layout(Shape { hidden: 12, ..layout.0 });
    assert!(!odd.is_served() && matches!(odd.image(&whole), Err(CardError::Unfit(_))));
    let batch = case.drawn().next().expect("there are batches");
    let short = Drawn { reward: &batch.reward[1..], ..batch };
    assert!(matches!(layout.add(&short, &mut Vec::new()), Err(CardError::Unfit(_))));
    assert_eq!(layout.learned_in(&layout.image(&whole).expect("it fits"), whole.steps), whole);
    let mut back = Learner::new(&settings, &mut Pcg64Mcg::seed_from_u64(2));
    back.put(whole.clone());
    assert_eq!(back.learned(), whole);
}
