//! The part of the suite that an engine of batches computes: heaps, and doses of spoons.

use super::super::batch::heaps::{Wanted, pour_on};
use super::super::batch::{Engine, Failed, Motion, Stand, in_step};
use super::super::dispense::Dispenser;
use super::super::repose::{Refusal, Repose};
use super::{Check, Experiment, KnownDeviation, Suite, known};
use flip_core::domain::bench::Action;
use std::ops::ControlFlow;
use std::sync::{Arc, Mutex, PoisonError};

/// Experiments of nothing but heaps of one size and full spoons; the scenes of the others are not on a
/// card, or their heaps are larger than one has room for.
const ON_ENGINES: [&str; 9] = [
    "dose_free_flowing",
    "dose_frictional",
    "repose_substep",
    "repose_funnel",
    "repose_friction",
    "repose_cohesion",
    "repose_base_friction",
    "rest_free_flowing",
    "rest_cohesive",
];

/// Doses that miss their goal by more than the cores' on an H200, whose sums round otherwise, and by how
/// much, mg; the reasons are the same.
const FURTHER_OFF: [(&str, f64); 4] = [
    ("dose_free_flowing_4mm", 0.75),
    ("dose_frictional_4mm", 0.40),
    ("dose_frictional_steeper_4mm", 3.61),
    ("dose_frictional_steeper_8mm", 1.90),
];

/// An engine, and why it failed if it did.
#[derive(Clone)]
pub(super) struct On {
    engine: Arc<dyn Engine>,
    failed: Arc<Mutex<Option<String>>>,
}

impl std::fmt::Debug for On {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.engine.name())
    }
}

impl Suite {
    /// The same experiments on an engine; only those that [`Experiment::is_on_engines`] may be run.
    #[must_use]
    pub fn on(self, engine: Arc<dyn Engine>) -> Self {
        Self { on: Some(On { engine, failed: Arc::default() }), ..self }
    }

    /// Why the engine failed, if it did. What was measured then is no number.
    pub fn failed(&self) -> Option<String> {
        let on = self.on.as_ref()?;
        on.failed.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Experiment {
    /// Whether an engine of batches can compute it.
    pub fn is_on_engines(&self) -> bool {
        ON_ENGINES.contains(&self.name)
    }
}

impl Check {
    /// The same check of what an engine computed: its documented deviations count, too.
    pub(super) fn on_an_engine(mut self) -> Self {
        let documented = FURTHER_OFF.iter().find(|(name, _)| *name == self.name);
        if let (Some((_, miss)), false) = (documented, self.is_accounted_for())
            && self.miss() <= *miss
        {
            self.known_deviation = known(self.name).map(|of| KnownDeviation { miss: *miss, ..of });
        }
        self
    }
}

impl On {
    /// Notes a failure.
    fn given<T>(&self, result: Result<T, Failed>) -> Option<T> {
        let note = |Failed(why): Failed| {
            self.failed.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(why);
        };
        result.map_err(note).ok()
    }

    /// These heaps, side by side; none where one has no angle, or the engine failed.
    pub(super) fn heaps(&self, wanted: &[Wanted]) -> Vec<Option<Repose>> {
        let mut heaps = vec![None; wanted.len()];
        let mut each = |k: usize, heap: Result<Repose, Refusal>| {
            heaps[k] = heap.ok();
            ControlFlow::Continue(())
        };
        self.given(pour_on(&*self.engine, wanted, &mut each));
        heaps
    }

    /// What each of these spoons, whose powder has yet to fall, gives in each of these actions, mg;
    /// none where the solver diverged, or the engine failed.
    pub(super) fn doses(&self, loose: &[Dispenser], actions: &[Action]) -> Vec<Option<Vec<f64>>> {
        let motions: Vec<Motion> = actions.iter().copied().map(Motion::Act).collect();
        let stands = self.given(in_step(&*self.engine, loose, &motions));
        let Some(stands) = stands else { return vec![None; loose.len()] };
        let given = |stands: Vec<Stand>| {
            let masses = stands.iter().map(|it| it.fault.is_none().then_some(it.vial_mg));
            let masses: Vec<f64> = masses.collect::<Option<_>>()?;
            Some(masses.windows(2).map(|pair| pair[1] - pair[0]).collect())
        };
        stands.into_iter().map(given).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::batch::{Batch, Cores};
    use super::super::super::{dispense, repose};
    use super::super::experiments;
    use super::*;

    fn named(name: &str) -> Experiment {
        experiments().into_iter().find(|it| it.name == name).unwrap()
    }

    #[test]
    fn on_the_cores_behind_the_interface_heaps_and_spoons_are_those_of_the_suite() {
        let usual = Suite::default();
        let on = Suite::default().on(Arc::new(Cores)).on.unwrap();
        let (set, settings) = (usual.powder(&[]), repose::Settings::with_particles(120));
        let wanted = |seed| Wanted { set, settings, seed };
        let expected: Vec<_> = [1, 2, 3].map(|seed| usual.heap(&set, &settings, seed).ok()).into();
        assert_eq!(on.heaps(&[1, 2, 3].map(wanted)), expected);

        let settings = dispense::Settings {
            particles: 200,
            semi_axes_mm: [2.4, 1.7, 1.0],
            ..dispense::Settings::default()
        };
        let spoons = [3, 4].map(|seed| Dispenser::loose(&set, &settings, seed));
        let actions = [Action::once(8.0, 4.0), Action::once(16.0, 8.0), Action::once(0.0, 8.0)];
        let given = on.doses(&spoons, &actions);
        for (mut spoon, given) in spoons.into_iter().zip(given) {
            spoon.settle();
            let given = given.unwrap();
            let expected = actions.map(|action| spoon.step(action).vial_mg);
            assert!(expected.iter().sum::<f64>() > 0.0, "nothing was poured");
            let apart = given.iter().zip(expected).map(|(a, b)| (a - b).abs());
            assert!(apart.fold(0.0, f64::max) < 1e-9);
        }
    }

    /// An engine that is lost when it is asked for anything.
    struct Lost;

    impl Engine for Lost {
        fn name(&self) -> String {
            "lost".to_owned()
        }
        fn places(&self) -> usize {
            4
        }
        fn batch(&self, _: usize) -> Result<Box<dyn Batch>, Failed> {
            Err(Failed("it was taken away".to_owned()))
        }
    }

    #[test]
    fn a_dose_on_an_engine_may_miss_its_goal_as_far_as_is_documented_there() {
        let miss_mg = |name, mg: f64| {
            let check = Check::near(name, 0.1 + mg, [0.0, 0.1], "mg", "a test");
            let on_engine = check.clone().on_an_engine();
            [check, on_engine].map(|check| check.known_deviation.map(|known| known.miss))
        };
        assert_eq!(miss_mg("dose_frictional_4mm", 0.36), [Some(0.37), Some(0.37)]);
        assert_eq!(miss_mg("dose_frictional_4mm", 0.39), [None, Some(0.40)]);
        assert_eq!(miss_mg("dose_frictional_4mm", 0.41), [None, None]);
        assert_eq!(miss_mg("repose_friction", 0.39), [None, None]);
        assert_eq!(miss_mg("dose_frictional_4mm", f64::NAN), [None, None]);
    }

    #[test]
    fn an_engine_that_fails_says_so_and_passes_no_check() {
        for name in ["dose_free_flowing", "rest_free_flowing"] {
            let suite = Suite::default().on(Arc::new(Lost));
            let checks = named(name).run(&suite);
            assert!(checks.iter().all(|check| !check.is_accounted_for()), "{checks:?}");
            assert!(suite.failed().is_some());
        }
    }

    #[test]
    fn every_experiment_of_an_engine_exists() {
        let all = experiments();
        let there: Vec<_> = all.iter().filter(|it| it.is_on_engines()).collect();
        assert_eq!(there.len(), ON_ENGINES.len());
    }
}
