//! How many episodes a round of a training on a graphics card should have: time and accuracy.
//!
//! ```sh
//! cargo run --release -p flip-learn --example rounds_on_a_card -- 8 32 64          # trains with each
//! cargo run --release -p flip-learn --example rounds_on_a_card -- 32 episodes=1200 seed=2 cores
//! ```
//!
//! `updates=1` makes so many updates for each simulated step instead of ten, and a tenth of those on the
//! surrogate: what the simulation alone takes shows then. Gradients are our own, and the card makes the
//! updates; with `libtorch` they are libtorch's, on one core.
//!
//! Trains FLIP's preset on three made-up powders, by default with its 4800 episodes, a fifth of them in
//! the simulator, and weighs with what was learned on spoons that no training met. `cores` trains on the
//! processor, too, with the same rounds. Without a card it says why.

use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use flip_learn::train::environment::simulated;
use flip_learn::train::rivals::assess;
use flip_learn::train::schedule::Tuning;
use flip_learn::train::{Event, Gradients, Level, Order, Preset, Settings, Start, train_beside};
use flip_policy::{Controller, Paced};
use flip_sim::batch::{Cores, Engine};
use std::ops::ControlFlow;
use std::time::Instant;

/// Doses of each powder and target.
const DOSES: u32 = 8;

/// Sets like those that calibrations find: a powder's differ a little.
fn levels() -> Vec<Level> {
    let even = |k: u64| (derive(11, &[k]) >> 11) as f64 / (1u64 << 53) as f64;
    let level = |(n, (powder, repose_deg, friction, cohesion)): (u64, (&str, f64, f64, f64))| {
        let set = |k: u64| {
            let off = |which: u64| 0.1 * (even(100 * n + 10 * k + which) - 0.5);
            let set = ParameterSet::default().with("friction", friction + off(0));
            set.and_then(|set| set.with("cohesion", (cohesion + off(1)).max(0.0)))
                .expect("within its bounds")
        };
        Level { powder: powder.into(), repose_deg, sets: (0..7).map(set).collect() }
    };
    let powders =
        [("easy", 28.0, 0.25, 0.0), ("middling", 32.0, 0.45, 0.15), ("hard", 37.0, 0.7, 0.3)];
    (0..).zip(powders).map(level).collect()
}

fn main() {
    let asked: Vec<String> = std::env::args().skip(1).collect();
    let number =
        |name: &str| asked.iter().find_map(|it| it.strip_prefix(name)?.parse::<f64>().ok());
    let card = match flip_cuda::Card::open(0) {
        Ok(card) => card,
        Err(reason) => return println!("skipped: {reason}"),
    };
    let seed = number("seed=").map_or(1, |it| it as u64);
    let mut usual = Settings::of(Preset::Flip, Order::Curriculum, seed);
    usual.episodes = number("episodes=").map_or(usual.episodes, |it| it as u32);
    usual.surrogate_episodes = usual.surrogate_by_default();
    if !asked.iter().any(|it| it == "libtorch") {
        usual.gradients = Gradients::Fused;
    }
    if let Some(updates) = number("updates=") {
        let share = updates / usual.updates_per_step;
        usual.surrogate_updates_per_step *= share;
        usual.updates_per_step = updates;
    }
    let tuning = Tuning::new(99);
    let errors = |controller: &Controller| {
        assess(&simulated(&usual), &levels(), &tuning, controller, DOSES, 5)
    };
    let rules = errors(&Controller::Paced(Paced::CHOSEN));
    println!("{}; the rules err by {rules:.2} mg", card.name());
    println!("| on | episodes a round | s | of them on the surrogate | mean error, mg |");
    println!("|---|---|---|---|---|");
    let mut engines: Vec<&dyn Engine> = vec![&card];
    if asked.iter().any(|it| it == "cores") {
        engines.push(&Cores);
    }
    for engine in engines {
        for episodes_per_round in asked.iter().filter_map(|it| it.parse().ok()) {
            let settings = Settings { episodes_per_round, ..usual.clone() };
            let start = Instant::now();
            let mut surrogate_s = 0.0;
            let on_event = |event: Event| {
                if let Event::Episode(record) = event
                    && record.index + 1 == settings.surrogate_episodes
                {
                    surrogate_s = start.elapsed().as_secs_f64();
                }
                ControlFlow::Continue(())
            };
            let go_on = || ControlFlow::Continue(());
            let trained =
                train_beside(engine, &levels(), &settings, Start::Nothing, &go_on, on_event);
            let seconds = start.elapsed().as_secs_f64();
            match trained {
                Err(error) => println!("failed: {error}"),
                Ok(trained) => {
                    let policy = flip_policy::decode(&trained.artifact).expect("it was encoded");
                    let error_mg = errors(&policy.controller);
                    println!(
                        "| {} | {episodes_per_round} | {seconds:.0} | {surrogate_s:.0} | {error_mg:.2} |",
                        engine.name()
                    );
                }
            }
        }
    }
}
