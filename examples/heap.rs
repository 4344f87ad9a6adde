//! The story of a heap, from grains to a powder's flowability: `cargo run --release --example heap
//! -- 0.5 0.2`.
//!
//! A powder is a parameter set. Poured over a round base it piles up, and the slope at which it
//! stays is its angle of repose: a chemist can measure it with a funnel, a plate and a camera, and
//! FLIP matches it when it calibrates.

use flip_core::domain::parameters::ParameterSet;
use flip_sim::mechanisms::Extensions;
use flip_sim::repose::{Settings, repose};

fn main() {
    let arguments: Vec<f64> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let [friction, cohesion] =
        [arguments.first().copied().unwrap_or(0.5), arguments.get(1).copied().unwrap_or(0.0)];

    // Nine published parameters; each acts by a law with a unit (`flip_sim::law`). Two of them
    // shape a heap most.
    let powder = ParameterSet::default()
        .with("friction", friction)
        .and_then(|set| set.with("cohesion", cohesion))
        .expect("friction from 0 to 1.3 and cohesion from 0 to 1.2");

    // Chance decides where single grains land: heaps of one powder differ by about a degree, so
    // pour a few.
    for seed in 1..=3 {
        say(&format!("seed {seed}"), repose(&powder, &Settings::default(), seed));
    }

    // Stickier grains pile steeper; grains that may roll do not pile so steep, unless something
    // resists the rolling.
    let sticky = powder.with("cohesion", 1.2).expect("1.2 is the largest cohesion");
    say("cohesion 1.2", repose(&sticky, &Settings::default(), 1));
    let rolling = Extensions { rotation: 1.0, rolling_friction: 0.2, ..Extensions::default() };
    let rough = Settings { rough_base: true, extensions: rolling, ..Settings::default() };
    say("rolling grains", repose(&powder, &rough, 1));
}

/// A heap with its angle, or why it has none.
fn say(what: &str, heap: Result<flip_sim::repose::Repose, flip_sim::repose::Refusal>) {
    match heap {
        Ok(h) => println!(
            "{what:<15} {:.1} deg at the apex, {:.1} deg along the flank",
            h.tip_deg, h.cone_deg
        ),
        Err(refusal) => println!("{what:<15} {refusal}"),
    }
}
