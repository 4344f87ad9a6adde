//! Powders, beds, and work spread over all cores.

use flip_core::domain::bench::Action;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use flip_sim::dispense::{Dispenser, Settings};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Cores of this machine.
pub fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Applies `each` to `0..count` on all cores, one after another as cores become free.
pub fn on_all<R: Send>(count: usize, each: impl Fn(usize) -> R + Sync) -> Vec<R> {
    let (next, done) = (AtomicUsize::new(0), Mutex::new(Vec::with_capacity(count)));
    std::thread::scope(|scope| {
        for _ in 0..cores() {
            scope.spawn(|| {
                loop {
                    let k = next.fetch_add(1, Ordering::Relaxed);
                    if k >= count {
                        return;
                    }
                    let result = each(k);
                    done.lock()
                        .unwrap_or_else(std::sync::PoisonError::into_inner)
                        .push((k, result));
                }
            });
        }
    });
    let mut done = done.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    done.sort_unstable_by_key(|(k, _)| *k);
    done.into_iter().map(|(_, result)| result).collect()
}

/// A powder with this friction and cohesion, otherwise the defaults.
pub fn powder(friction: f64, cohesion: f64) -> ParameterSet {
    let set = ParameterSet::default().with("friction", friction);
    match set.and_then(|set| set.with("cohesion", cohesion)) {
        Ok(set) => set,
        Err(error) => unreachable!("friction {friction}, cohesion {cohesion}: {error}"),
    }
}

/// Spoons filled with these powders in turn, each from a seed of its own.
pub fn filled(count: usize, powders: &[ParameterSet], settings: &Settings) -> Vec<Dispenser> {
    on_all(count, |k| {
        Dispenser::new(&powders[k % powders.len()], settings, (k / powders.len()) as u64)
    })
}

/// The action of a spoon in a step of the mixed load: pitches between -4 and 8 deg, strokes between
/// 0 and 16 mm, evenly spread.
pub fn mixed(spoon: usize, step: usize) -> Action {
    let even =
        |k: u64| (derive(7, &[spoon as u64, step as u64, k]) >> 11) as f64 / (1u64 << 53) as f64;
    Action::once(-4.0 + 12.0 * even(0), 16.0 * even(1))
}
