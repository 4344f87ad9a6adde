//! Updates per second of the learner on one thread: `cargo bench --bench sac_update`.
//!
//! Each update draws its batch from the replay memory, relabels it where settings ask for that, and steps critics, actor,
//! temperature and targets. The recurrent ones are the `paper` preset's: 16 episodes of 10 steps.

use criterion::{Criterion, criterion_group, criterion_main};
use flip::domain::bench::PitchLimits;
use flip::domain::parameters::{COUNT, ParameterSet};
use flip::policy::{Rules, normal};
use flip::sim::balance;
use flip::train::environment::{Filling, play};
use flip::train::episodes::Episode;
use flip::train::formula::Formula;
use flip::train::replay::{Memory, Replay};
use flip::train::sac::Learner;
use flip::train::{Network, Order, Preset, Replayed, Settings};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Episodes of random actions on the formula spoon.
fn replay(settings: &Settings, rng: &mut Pcg64Mcg) -> Replay {
    let mut replay = Replay::new(settings);
    let formula = Formula { pitch: PitchLimits::WIDE };
    for seed in 0..200 {
        let mut spoon = formula.fill(&ParameterSet::default(), seed);
        let played = play(&mut spoon, &Rules::PAPER, &balance::Settings::default(), 12.0, seed, |_| {
            [rng.random::<f32>(), 2.0 * rng.random::<f32>() - 1.0]
        });
        let steps = played.steps.into_iter().map(|step| Memory { step, target_mg: 12.0, parameters: [0.5; COUNT] });
        let state = if settings.stores_states() { vec![0.1; 2 * settings.hidden as usize] } else { Vec::new() };
        replay.push(Episode { steps: steps.collect(), state });
    }
    replay
}

/// Time one update after another.
fn bench(criterion: &mut Criterion, name: &str, settings: &Settings) {
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    let replay = replay(settings, &mut rng);
    let mut learner = Learner::new(settings, &mut rng);
    criterion.bench_function(name, |bencher| {
        bencher.iter(|| {
            let drawn = replay.draw(settings, &mut rng);
            let noise: Vec<f32> = (0..4 * drawn.reward.len()).map(|_| normal(&mut rng)).collect();
            learner.update(&drawn, &noise, settings)
        });
    });
}

fn updates(criterion: &mut Criterion) {
    for (hidden, batch) in [(64, 16), (64, 256), (128, 16), (128, 256), (256, 16), (256, 256)] {
        let settings = Settings { hidden, batch, ..Settings::of(Preset::Flip, Order::Curriculum, 1) };
        bench(criterion, &format!("{hidden} units, batch {batch}"), &settings);
    }
    let paper = Settings::of(Preset::Paper, Order::Curriculum, 1);
    for (name, replayed) in [("stored state", Replayed::StoredState), ("episodes", Replayed::Episodes)] {
        let settings = Settings { network: Network::Recurrent { replayed }, ..paper.clone() };
        bench(
            criterion,
            &format!("recurrent, {} units, {} episodes, {name}", settings.hidden, settings.batch),
            &settings,
        );
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20);
    targets = updates
}
criterion_main!(benches);
