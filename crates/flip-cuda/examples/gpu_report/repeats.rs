//! The same bytes from repeats, other batches and other numbers of threads.

use crate::powders::{filled, mixed, powder};
use flip_cuda::{Bed, Card, Result, Spoons};
use flip_sim::dispense::Settings;
use std::hash::{DefaultHasher, Hash, Hasher};

/// Spoons compared.
const COMPARED: usize = 12;
const STEPS: usize = 4;

/// Prints one line a variant.
pub fn report(card: &Card) -> Result<()> {
    let powders = [powder(0.3, 0.0), powder(0.6, 0.3)];
    let spoons = filled(6, &powders, &Settings::default());
    let beds: Vec<Bed> = spoons.iter().map(Bed::of).collect::<std::result::Result<_, _>>()?;
    println!("\nthe first {COMPARED} spoons after {STEPS} mixed steps");
    let reference = hash(card, &beds, COMPARED)?;
    let tell = |what: String, found: u64| {
        println!("{what}: {}", if found == reference { "the same bytes" } else { "DIFFERENT" });
    };
    tell("again".to_owned(), hash(card, &beds, COMPARED)?);
    for count in [132, 528] {
        tell(format!("among {count} spoons"), hash(card, &beds, count)?);
    }
    for threads in [256, 512, 640, 768] {
        let card = card.clone().with_threads(threads);
        tell(format!("{threads} threads a block"), hash(&card, &beds, COMPARED)?);
    }
    tell("the kernel for 99 KB".to_owned(), hash(&Card::open_small(0)?, &beds, COMPARED)?);
    Ok(())
}

/// A hash of the bits of the first spoons' states after some steps.
fn hash(card: &Card, beds: &[Bed], count: usize) -> Result<u64> {
    let mut spoons = Spoons::new(card, beds.to_vec(), count)?;
    let mut hasher = DefaultHasher::new();
    for step in 0..STEPS {
        let all: Vec<_> = (0..count).map(|spoon| (spoon, mixed(spoon, step))).collect();
        for poured in &spoons.step(&all)?[..COMPARED] {
            [poured.vial_mg, poured.spilled_mg, poured.duration_s]
                .map(f64::to_bits)
                .hash(&mut hasher);
        }
    }
    for spoon in 0..COMPARED {
        let state = spoons.state(spoon)?;
        for grain in &state.grains {
            (grain.id, [grain.x, grain.v].map(|it| it.map(f32::to_bits))).hash(&mut hasher);
        }
        for (ends, anchor) in &state.stuck {
            (ends, anchor.map(f32::to_bits)).hash(&mut hasher);
        }
    }
    Ok(hasher.finish())
}
