//! Updates per second of the learner on one thread: `cargo bench --bench sac_update`.
//!
//! Each update draws its batch from the replay memory, relabels it, and steps critics, actor, temperature and targets.

use criterion::{Criterion, criterion_group, criterion_main};
use flip::domain::bench::PitchLimits;
use flip::domain::parameters::{COUNT, ParameterSet};
use flip::policy::{Rules, normal};
use flip::sim::balance;
use flip::train::environment::{Filling, play};
use flip::train::formula::Formula;
use flip::train::replay::{Memory, Replay};
use flip::train::sac::Learner;
use flip::train::{Order, Preset, Settings};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Steps of random actions on the formula spoon.
fn replay(rng: &mut Pcg64Mcg) -> Replay {
    let mut replay = Replay::new(10_000);
    let formula = Formula { pitch: PitchLimits::WIDE };
    for seed in 0..200 {
        let mut spoon = formula.fill(&ParameterSet::default(), seed);
        let played = play(&mut spoon, &Rules::PAPER, &balance::Settings::default(), 12.0, seed, |_| {
            [rng.random::<f32>(), 2.0 * rng.random::<f32>() - 1.0]
        });
        for step in played.steps {
            replay.push(Memory { step, target_mg: 12.0, parameters: [0.5; COUNT] });
        }
    }
    replay
}

fn updates(criterion: &mut Criterion) {
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    let replay = replay(&mut rng);
    for (hidden, batch) in [(64, 16), (64, 256), (128, 16), (128, 256), (256, 16), (256, 256)] {
        let settings = Settings { hidden, batch, ..Settings::of(Preset::Flip, Order::Curriculum, 1) };
        let mut learner = Learner::new(&settings, &mut rng);
        criterion.bench_function(&format!("{hidden} units, batch {batch}"), |bencher| {
            bencher.iter(|| {
                let drawn = replay.draw(&settings, &mut rng);
                let noise: Vec<f32> = (0..4 * batch).map(|_| normal(&mut rng)).collect();
                learner.update(&drawn, &noise, &settings)
            });
        });
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20);
    targets = updates
}
criterion_main!(benches);
