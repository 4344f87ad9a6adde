//! Simulated seconds per second.

use crate::powders::{cores, filled, mixed, on_all, powder};
use flip_core::domain::bench::Action;
use flip_cuda::{Bed, Card, Result, Spoons};
use flip_sim::dispense::{Dispenser, Settings};
use flip_sim::mechanisms::Extensions;
use std::time::Instant;

/// Steps of the mixed load, the first ones not timed: a level, full spoon does nothing yet.
const STEPS: usize = 8;
const WARM: usize = 2;
/// Batches.
const COUNTS: [usize; 4] = [132, 264, 528, 1056];

/// A spoon that pitches by half a degree in a second: a bed at rest in all but name, for as long as
/// one likes.
fn slow() -> Settings {
    Settings { pitch_deg_s: 0.5, ..Settings::default() }
}

/// Grains that turn and resist it.
pub fn turning() -> Settings {
    let extensions = Extensions { rotation: 1.0, rolling_friction: 0.2, ..Extensions::default() };
    Settings { extensions, ..Settings::default() }
}

const SLOWLY: Action = Action::once(0.5, 0.0);

/// Prints the table; `quick` is one batch on the card alone.
pub fn report(card: &Card, quick: bool) -> Result<()> {
    let powders = [powder(0.3, 0.0), powder(0.6, 0.0), powder(0.5, 0.6), powder(0.8, 0.3)];
    let beds = filled(16, &powders, &Settings::default());
    let at_rest = filled(4, &powders, &slow());
    println!("\nsimulated seconds per second, spoons of 2500 grains, substep 80 us");
    println!(
        "| what | spoons | at rest | mixed | mixed, kernel alone | substeps a list | faults |"
    );
    println!("|---|---|---|---|---|---|---|");
    if !quick {
        let (resting, flowing) = on_cores(&at_rest, &beds);
        let n = cores();
        let [one, another] = [resting, flowing].map(|all| all / n as f64);
        println!("| one core | 1 | {one:.2} | {another:.2} | | | |");
        println!("| {n} cores | {} | {resting:.1} | {flowing:.1} | | | |", 4 * n);
    }
    let counts = if quick { &COUNTS[1..2] } else { &COUNTS[..] };
    let row = |what: &str, rest: &[Dispenser], beds: &[Dispenser], count: usize| -> Result<()> {
        let rest = rest_on_card(card, rest, count)?;
        let Mixed { whole, kernel, per_list, faults } = mixed_on_card(card, beds, count)?;
        let name = card.name();
        println!(
            "| {name}{what} | {count} | {rest:.0} | {whole:.0} | {kernel:.0} | {per_list:.1} | {faults} |"
        );
        Ok(())
    };
    for &count in counts {
        row("", &at_rest, &beds, count)?;
    }
    let beds = filled(16, &powders, &turning());
    let at_rest = filled(4, &powders, &Settings { pitch_deg_s: 0.5, ..turning() });
    if !quick {
        let (resting, flowing) = on_cores(&at_rest, &beds);
        let n = cores();
        println!("| {n} cores, grains turn | {} | {resting:.1} | {flowing:.1} | | | |", 4 * n);
    }
    for &count in counts {
        row(", grains turn", &at_rest, &beds, count)?;
    }
    Ok(())
}

/// Both loads on all cores: simulated seconds per second of all together.
fn on_cores(at_rest: &[Dispenser], beds: &[Dispenser]) -> (f64, f64) {
    let count = 4 * cores();
    let rate = |simulated: &(dyn Fn(usize) -> f64 + Sync)| {
        let start = Instant::now();
        let seconds: f64 = on_all(count, simulated).iter().sum();
        seconds / start.elapsed().as_secs_f64()
    };
    let rest = |k: usize| at_rest[k % at_rest.len()].clone().step(SLOWLY).duration_s;
    let mix = |k: usize| {
        let mut spoon = beds[k % beds.len()].clone();
        (0..STEPS).map(|step| spoon.step(mixed(k, step)).duration_s).sum()
    };
    (rate(&rest), rate(&mix))
}

fn beds_of(spoons: &[Dispenser]) -> Result<Vec<Bed>> {
    Ok(spoons.iter().map(Bed::of).collect::<std::result::Result<_, _>>()?)
}

fn rest_on_card(card: &Card, spoons: &[Dispenser], count: usize) -> Result<f64> {
    let mut spoons = Spoons::new(card, beds_of(spoons)?, count)?;
    let all: Vec<_> = (0..count).map(|spoon| (spoon, SLOWLY)).collect();
    spoons.step(&all)?;
    let start = Instant::now();
    let poured = spoons.step(&all)?;
    let seconds: f64 = poured.iter().map(|it| it.duration_s).sum();
    Ok(seconds / start.elapsed().as_secs_f64())
}

struct Mixed {
    whole: f64,
    kernel: f64,
    per_list: f64,
    faults: usize,
}

fn mixed_on_card(card: &Card, spoons: &[Dispenser], count: usize) -> Result<Mixed> {
    let mut spoons = Spoons::new(card, beds_of(spoons)?, count)?;
    let (mut seconds, mut kernel_s, mut wall_s, mut faults) = (0.0, 0.0, 0.0, 0);
    let (mut substeps, mut lists) = (0u64, 0u64);
    for step in 0..STEPS {
        let all: Vec<_> = (0..count).map(|spoon| (spoon, mixed(spoon, step))).collect();
        let start = Instant::now();
        let poured = spoons.step(&all)?;
        if step < WARM {
            continue;
        }
        wall_s += start.elapsed().as_secs_f64();
        kernel_s += spoons.kernel_s();
        seconds += poured.iter().map(|it| it.duration_s).sum::<f64>();
        faults += poured.iter().filter(|it| it.fault.is_some()).count();
        substeps += poured.iter().map(|it| u64::from(it.substeps)).sum::<u64>();
        lists += poured.iter().map(|it| u64::from(it.rebuilds)).sum::<u64>();
    }
    let per_list = substeps as f64 / lists.max(1) as f64;
    Ok(Mixed { whole: seconds / wall_s, kernel: seconds / kernel_s, per_list, faults })
}
