//! Cache of filled spoons: filling takes as long as several steps.

use super::environment::Filling;
#[cfg(feature = "libtorch")]
use super::environment::Simulated;
use flip_core::domain::conditions::Patch;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
#[cfg(feature = "libtorch")]
use flip_sim::dispense::Dispenser;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, OnceLock};

/// Filled spoons, each filled on first request.
type Shelf<S> = HashMap<(String, u32, String), Arc<OnceLock<S>>>;

/// Filled spoons by parameter set, heap number and conditions. A clone of one is a new dose from
/// the same heap.
pub struct Spoons<F: Filling> {
    filling: F,
    seed: u64,
    kept: Mutex<Shelf<F::Spoon>>,
}

impl<F: Filling> Spoons<F> {
    /// Creates an empty cache.
    pub fn new(filling: F, seed: u64) -> Self {
        Self { filling, seed, kept: Mutex::new(HashMap::new()) }
    }

    /// Returns heap `heap` of this powder in these conditions, filled on first use. The result does
    /// not depend on who requests it first.
    pub fn take(&self, set: &ParameterSet, heap: u32, patch: &Patch) -> F::Spoon {
        let conditions = serde_json::to_string(patch).expect("plain data");
        let slot = {
            let mut kept = self.kept.lock().unwrap_or_else(|broken| broken.into_inner());
            kept.entry((set.id(), heap, conditions)).or_default().clone()
        };
        slot.get_or_init(|| self.fill(set, heap, patch)).clone()
    }

    /// The same without caching, for powders and conditions that occur once.
    pub fn fill(&self, set: &ParameterSet, heap: u32, patch: &Patch) -> F::Spoon {
        self.filling.fill_under(set, patch, derive(self.seed, &[heap.into()]))
    }
}

#[cfg(feature = "libtorch")]
impl Spoons<Simulated> {
    /// Like [`Self::fill`], before the powder has fallen.
    pub fn loose(&self, set: &ParameterSet, heap: u32, patch: &Patch) -> Dispenser {
        self.filling.loose(set, patch, derive(self.seed, &[heap.into()]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::environment::Spoon;
    use crate::train::formula::Formula;
    use flip_core::domain::bench::{Action, PitchLimits};

    #[test]
    fn a_kept_spoon_is_never_poured_from() {
        let formula = Formula { pitch: PitchLimits::WIDE };
        let spoons = Spoons::new(formula, 1);
        let set = ParameterSet::default();
        let none = Patch::default();
        let mut first = spoons.take(&set, 0, &none);
        first.step(Action::once(8.0, 16.0));
        assert!(first.vial_mg() > 0.0);
        assert_eq!(spoons.take(&set, 0, &none).vial_mg(), 0.0);
        assert_eq!(spoons.kept.lock().unwrap().len(), 1);
    }
}
