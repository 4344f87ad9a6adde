//! Whole trainings whose updates are made by the twin, and by a card where there is one.

use crate::Card;
use crate::card_tests::card;
use crate::learner_twin::Twin;
use crate::twin::built;
use flip_core::domain::parameters::ParameterSet;
use flip_core::learner::Shape;
use flip_learn::train::{
    Event, Gradients, Level, Order, Preset, Settings, Start, Trained, train, train_beside,
};
use flip_sim::batch::{Batch, Cores, Engine, Failed, Updates};
use flip_sim::dispense;
use std::ops::ControlFlow;
use std::sync::atomic::Ordering;

fn levels() -> Vec<Level> {
    let set = |friction| ParameterSet::default().with("friction", friction).expect("in its bounds");
    let level = |powder: &str, repose_deg, frictions: [f64; 2]| Level {
        powder: powder.into(),
        repose_deg,
        sets: frictions.map(set).to_vec(),
    };
    vec![level("sand", 28.6, [0.3, 0.35]), level("salt", 36.0, [0.65, 0.7])]
}

/// A few doses of 4 mg spoons, most of them on the surrogate.
fn small() -> Settings {
    let spoon = dispense::Settings {
        particles: 250,
        semi_axes_mm: [2.4, 1.7, 1.0],
        ..dispense::Settings::default()
    };
    Settings {
        episodes: 24,
        surrogate_episodes: 16,
        episodes_per_round: 4,
        warmup_episodes: 4,
        rounds_per_checkpoint: 1,
        hidden: 32,
        batch: 20,
        gradients: Gradients::Fused,
        updates_per_step: 2.0,
        target_mg_min: 1.0,
        target_mg_max: 3.0,
        relabel_mg_min: 0.5,
        spoon,
        ..Settings::of(Preset::Flip, Order::Curriculum, 3)
    }
}

const GO_ON: fn() -> ControlFlow<()> = || ControlFlow::Continue(());

/// A training with all that it said, on an engine or on the cores.
fn trained(engine: Option<&dyn Engine>, start: Start<'_>) -> (Trained, Vec<Event>) {
    let mut events = Vec::new();
    let on_event = |event| {
        events.push(event);
        ControlFlow::Continue(())
    };
    let trained = match engine {
        Some(engine) => train_beside(engine, &levels(), &small(), start, &GO_ON, on_event),
        None => train(&levels(), &small(), start, &GO_ON, on_event),
    };
    (trained.expect("it trains"), events)
}

/// The cores' spoons with updates of a card.
struct CardsUpdates(Card);

impl Engine for CardsUpdates {
    fn name(&self) -> String {
        self.0.name().to_owned()
    }

    fn places(&self) -> usize {
        Cores.places()
    }

    fn batch(&self, places: usize) -> Result<Box<dyn Batch>, Failed> {
        Cores.batch(places)
    }

    fn updates(&self, shape: &Shape) -> Result<Option<Box<dyn Updates>>, Failed> {
        self.0.updates(shape)
    }
}

#[test]
fn a_training_with_updates_by_the_twin_is_that_on_cores_in_every_byte_and_resumes_on_either() {
    if built("cuda/learner_twin.cpp").is_none() {
        return;
    }
    let alone = trained(None, Start::Nothing);
    for blocks in [1, 3] {
        let twin = Twin { blocks, made: Default::default() };
        assert!(trained(Some(&twin), Start::Nothing) == alone, "{blocks} blocks");
        let losses = |event: &Event| match event {
            Event::Episode(episode) => episode.losses.is_some(),
            _ => false,
        };
        assert!(alone.1.iter().any(losses) && twin.made.load(Ordering::SeqCst) > 50);
    }
    let checkpoints = alone.1.iter().filter_map(|event| match event {
        Event::Checkpoint(bytes) => Some(bytes),
        _ => None,
    });
    let twin = Twin { blocks: 2, made: Default::default() };
    for checkpoint in checkpoints.collect::<Vec<_>>().into_iter().rev().take(2) {
        let start = Start::Checkpoint(checkpoint);
        assert_eq!(trained(Some(&twin), start).0, alone.0);
        assert_eq!(trained(None, start).0, alone.0);
    }
}

#[test]
fn a_training_with_updates_on_a_card_is_that_on_cores_in_every_byte() {
    let Some(card) = card(Card::open) else { return };
    let alone = trained(None, Start::Nothing);
    assert!(trained(Some(&CardsUpdates(card)), Start::Nothing) == alone);
}

#[test]
fn a_card_makes_updates_of_whole_sixteens_of_units_as_far_as_its_shared_memory_goes() {
    let Some(card) = card(Card::open) else { return };
    let shape = flip_learn::train::sac::Learner::shape(&small()).expect("perceptrons");
    for (hidden, served) in [(16, true), (128, true), (24, false), (4096, false)] {
        let updates = card.updates(&Shape { hidden, ..shape }).expect("the card works");
        assert_eq!(updates.is_some(), served, "{hidden} units");
    }
}
