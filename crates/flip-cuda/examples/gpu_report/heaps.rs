//! The heaps of a calibration's emulator: how long 240 of them take.

use crate::powders::{cores, on_all, powder};
use crate::speed::turning;
use flip_core::domain::seed::derive;
use flip_cuda::{Card, CardError};
use flip_sim::batch::Failed;
use flip_sim::batch::heaps::{Wanted, pour_on};
use flip_sim::mechanisms::Extensions;
use flip_sim::repose::{Settings, repose};
use std::ops::ControlFlow;
use std::time::Instant;

fn failed(failed: Failed) -> CardError {
    CardError::Failed(failed.to_string())
}

/// Heaps of an emulator.
const HEAPS: usize = 240;

/// Pours the heaps of an emulator on the card, and on the cores: without mechanisms, and of grains that
/// turn.
pub fn report(card: &Card) -> Result<(), CardError> {
    println!("\n## {HEAPS} heaps of 2000 grains\n");
    println!("| what | where | s | heaps with an angle | the card's cones less the cores', deg |");
    println!("|---|---|---|---|---|");
    row(card, "", Extensions::default())?;
    row(card, "grains turn", turning().extensions)
}

fn row(card: &Card, what: &str, extensions: Extensions) -> Result<(), CardError> {
    let wanted: Vec<Wanted> = (0..HEAPS)
        .map(|k| {
            let share =
                |index: u64| (derive(k as u64, &[index]) >> 11) as f64 / (1u64 << 53) as f64;
            let set = powder(1.2 * share(1), 1.2 * share(2));
            Wanted { set, settings: Settings { extensions, ..Settings::default() }, seed: k as u64 }
        })
        .collect();
    let mut angles = vec![None; HEAPS];
    let begun = Instant::now();
    pour_on(card, &wanted, &mut |place, outcome| {
        angles[place] = outcome.ok().map(|heap| heap.cone_deg);
        ControlFlow::Continue(())
    })
    .map_err(failed)?;
    let card_s = begun.elapsed().as_secs_f64();
    let begun = Instant::now();
    let theirs = on_all(HEAPS, |k| {
        let Wanted { set, settings, seed } = &wanted[k];
        repose(set, settings, *seed).ok().map(|heap| heap.cone_deg)
    });
    let cores_s = begun.elapsed().as_secs_f64();
    let both: Vec<f64> =
        angles.iter().zip(&theirs).filter_map(|(a, b)| Some((*a)? - (*b)?)).collect();
    let mean = both.iter().sum::<f64>() / both.len() as f64;
    let sd = (both.iter().map(|it| (it - mean).powi(2)).sum::<f64>() / both.len() as f64).sqrt();
    let error = sd / (both.len() as f64).sqrt();
    let [mine, theirs] = [&angles, &theirs].map(|of| of.iter().flatten().count());
    println!(
        "| {what} | card | {card_s:.2} | {mine} | {mean:+.2}, SD {sd:.2}, standard error {error:.2} |"
    );
    println!("| {what} | {} cores | {cores_s:.1} | {theirs} | |", cores());
    Ok(())
}
