//! Whether a card and this process still have the memory they had, after very many launches.

use crate::powders::{cores, filled, powder};
use flip_core::domain::bench::Action;
use flip_cuda::{Bed, Card, CardError, Result, Spoons};
use flip_sim::dispense::Settings;
use std::time::Instant;

/// Launches before memory is first looked at, and between two looks.
const FIRST: usize = 1000;
const BETWEEN: usize = 100_000;
/// Grains of the spoon: the fewest make the shortest launches.
const GRAINS: u32 = 100;
/// Each launch turns the spoon by so much, there and back, which takes a few substeps, deg.
const TURN_DEG: f64 = 0.005;

/// Prints the memory before and after.
pub fn report(card: &Card, launches: usize) -> Result<()> {
    let settings = Settings { particles: GRAINS, ..Settings::default() };
    let beds: Vec<Bed> = filled(1, &[powder(0.6, 0.3)], &settings)
        .iter()
        .map(Bed::of)
        .collect::<std::result::Result<_, _>>()?;
    // One such spoon leaves nearly all of a card idle, so each core launches one of its own, in a
    // stream of its own.
    let alone = || Spoons::new(&Card::open(0)?, beds.clone(), 1);
    let mut spoons = (0..cores()).map(|_| alone()).collect::<Result<Vec<_>>>()?;
    let mut substeps = 0;
    let mut launch = |many: usize| -> Result<()> {
        let share = |at: usize, of: usize| (at + 1) * many / of - at * many / of;
        let of = spoons.len();
        let done = std::thread::scope(|scope| {
            let threads = spoons.iter_mut().enumerate();
            let threads =
                threads.map(|(at, spoon)| scope.spawn(move || turns(spoon, share(at, of))));
            let threads: Vec<_> = threads.collect();
            let all = threads.into_iter().map(|thread| thread.join().expect("does not panic"));
            all.collect::<Result<Vec<_>>>()
        });
        substeps += done?.iter().sum::<u64>();
        Ok(())
    };
    launch(FIRST)?;
    let (free, resident) = (card.free_bytes()?, resident_kib());
    let (begun, mut done) = (Instant::now(), 0);
    println!("\n## Launches of a spoon of {GRAINS} grains, {} side by side\n", cores());
    println!(
        "| launches | s | more of the card's memory taken, bytes | more of this process's, KiB |"
    );
    println!("|---|---|---|---|");
    while done < launches {
        let many = BETWEEN.min(launches - done);
        launch(many)?;
        done += many;
        let taken = free as i64 - card.free_bytes()? as i64;
        let grown = resident_kib() as i64 - resident as i64;
        println!("| {done} | {:.0} | {taken} | {grown} |", begun.elapsed().as_secs_f64());
    }
    println!("\n{:.1} substeps each", substeps as f64 / (FIRST + launches) as f64);
    Ok(())
}

/// Turns a spoon there and back, a launch each; the substeps of all.
fn turns(spoon: &mut Spoons, launches: usize) -> Result<u64> {
    let mut substeps = 0;
    for k in 0..launches {
        let turn = if k % 2 == 0 { TURN_DEG } else { -TURN_DEG };
        let poured = spoon.step(&[(0, Action::once(turn, 0.0))])?;
        if let Some(fault) = poured.iter().find_map(|it| it.fault.as_ref()) {
            println!("fault: {fault}");
            return Err(CardError::Nonsense("a spoon that only turns has no fault"));
        }
        substeps += poured.iter().map(|it| u64::from(it.substeps)).sum::<u64>();
    }
    Ok(substeps)
}

/// Memory that this process has at hand, KiB; 0 where the system does not say.
fn resident_kib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    line.and_then(|line| line.split_whitespace().next()?.parse().ok()).unwrap_or(0)
}
