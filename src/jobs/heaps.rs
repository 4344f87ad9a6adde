//! The heaps of an investigation: numerical errors of the simulator, independent of any data, and
//! the amplitudes of an extension.

use super::host::{JobError, JobHost, Result, go_on};
use super::runner::{HeapExperiment, HeapRunner, Run};
use super::spec::{Heaps, InvestigationSpec};
use flip_core::domain::conditions::Patch;
use flip_core::domain::job::Progress;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use flip_discover::extension::Hook;
use flip_discover::numerics::{self, Varied, VariedHeap};
use flip_discover::report::{Numerics, Report};
use flip_discover::{Extended, FitHeap, fit};
use flip_sim::repose::Settings;
use std::cell::{Cell, RefCell};

/// Readings per heap, as in the verification of calibrations.
const READINGS: u32 = 4;
/// Heaps of the budget per repeat of the check of the numerics, which takes eight of them.
const BUDGET_PER_REPEAT: u32 = 20;
const REPEATS_MAX: u32 = 8;
/// Minimum height of the opening above the apex, grain diameters.
const CLEARANCE_MIN: f64 = 0.5;

/// Seed indices.
const NUMERICS: u64 = 1;
const FIT: u64 = 2;

/// Pours the heaps of an investigation, counts them, and reports progress.
pub(super) struct Pourer<'a> {
    host: &'a dyn JobHost,
    simulator: &'a HeapRunner,
    heaps: &'a Heaps,
    seed: u64,
    poured: Cell<u32>,
    unsaved: RefCell<Option<JobError>>,
}

impl<'a> Pourer<'a> {
    /// Creates one that has poured nothing; `None` if an investigation simulates nothing.
    pub(super) fn of(
        host: &'a dyn JobHost,
        simulator: &'a HeapRunner,
        spec: &'a InvestigationSpec,
    ) -> Option<Self> {
        let heaps = spec.heaps.as_ref().filter(|heaps| !heaps.sets.is_empty())?;
        Some(Self {
            host,
            simulator,
            heaps,
            seed: spec.settings.seed,
            poured: Cell::default(),
            unsaved: RefCell::default(),
        })
    }

    /// Number of heaps so far.
    pub(super) fn poured(&self) -> u32 {
        self.poured.get()
    }

    /// Whether angles depend on numerical settings, with a share of the budget; `None` if that is
    /// too small.
    pub(super) fn numerics(&self, share: [f64; 2]) -> Result<Option<Numerics>> {
        let repeats = (self.heaps.budget_runs / BUDGET_PER_REPEAT).min(REPEATS_MAX);
        // The middle powder in the order listed.
        let (set, parameters) = &self.heaps.sets[self.heaps.sets.len() / 2];
        if repeats < 2 {
            return Ok(None);
        }
        let what = "whether heaps depend on how they are computed";
        let heap = |of: &VariedHeap| {
            Some(HeapExperiment { set: *parameters, settings: computed(of), seed: of.seed })
        };
        let found = numerics::criticise(1, repeats, derive(self.seed, &[NUMERICS]), |heaps| {
            self.pour(heaps.iter().map(heap), what, share)
        });
        self.settled()?;
        // A dependence without an interval cannot be reported and carries no information.
        let dependences: Vec<_> =
            found.into_iter().filter(|it| it.ci99.iter().all(|end| end.is_finite())).collect();
        Ok((!dependences.is_empty()).then(|| Numerics { set: set.clone(), dependences }))
    }

    /// Fits amplitudes with simulated heaps instead of the table, using the rest of the budget; the
    /// report includes them.
    pub(super) fn fit(
        &self,
        extended: &mut Extended,
        report: &mut Report,
        share: [f64; 2],
    ) -> Result<()> {
        let sets: Vec<_> = self.heaps.sets.iter().map(|it| it.0.clone()).collect();
        let mut left =
            extended.extensions.iter().filter(|it| it.hook != Hook::Reading).count() as u32;
        let mut all_verified = left > 0;
        for (k, extension) in
            extended.extensions.iter_mut().enumerate().filter(|it| it.1.hook != Hook::Reading)
        {
            let budget = self.heaps.budget_runs.saturating_sub(self.poured()) / left;
            left -= 1;
            let seed = derive(self.seed, &[FIT, k as u64]);
            let heap = |of: &FitHeap| {
                let (set, settings) = under(&self.heaps.sets[of.set].1, &of.patch)?;
                Some(HeapExperiment { set, settings, seed: of.seed })
            };
            let found = fit(extension, &sets, budget, seed, |heaps| {
                self.pour(heaps.iter().map(heap), "the amplitude of the extension", share)
            });
            self.settled()?;
            let Some((amplitude, fit)) = found else {
                all_verified = false;
                continue;
            };
            all_verified &= fit.verified;
            let told =
                report.causes.iter_mut().filter(|cause| cause.mechanism == extension.mechanism);
            for parameter in
                told.flat_map(|cause| &mut cause.parameters).filter(|it| it.name == amplitude.name)
            {
                parameter.clone_from(&amplitude);
            }
            extension.amplitude = amplitude;
            extension.fit = Some(fit);
        }
        report.simulator_version.verified = all_verified;
        Ok(())
    }

    /// The angles of heaps, in order; `None` where there is no experiment or no angle, or the job
    /// is to end.
    fn pour(
        &self,
        heaps: impl ExactSizeIterator<Item = Option<HeapExperiment>>,
        what: &str,
        share: [f64; 2],
    ) -> Vec<Option<f64>> {
        let mut angles = vec![None; heaps.len()];
        if self.host.flow().is_break() || self.unsaved.borrow().is_some() {
            return angles;
        }
        let (places, experiments): (Vec<usize>, Vec<HeapExperiment>) =
            heaps.enumerate().filter_map(|(place, heap)| Some((place, read(heap?)))).unzip();
        let (mut poured, mut unsaved) = (self.poured.get(), None);
        let (host, budget) = (self.host, self.heaps.budget_runs);
        self.simulator.run(&experiments, &mut |k, Run { outcome, .. }| {
            angles[places[k]] = outcome.ok().map(|heap| heap.tip_deg);
            poured += 1;
            let done = (f64::from(poured) / f64::from(budget)).min(1.0);
            let message = format!("{what}: heap {poured} of at most {budget}");
            let progress = Progress { fraction: share[0] + (share[1] - share[0]) * done, message };
            go_on(host, host.report(&progress), &mut unsaved)
        });
        self.poured.set(poured);
        if let Some(error) = unsaved {
            self.unsaved.borrow_mut().get_or_insert(error);
        }
        angles
    }

    /// Whether all requested heaps were poured.
    fn settled(&self) -> Result<()> {
        match self.unsaved.take() {
            Some(error) => Err(error),
            None if self.host.flow().is_break() => Err(JobError::Stopped),
            None => Ok(()),
        }
    }
}

/// This heap, read as often as those of an investigation are.
pub(super) fn read(heap: HeapExperiment) -> HeapExperiment {
    HeapExperiment { settings: Settings { readings: READINGS, ..heap.settings }, ..heap }
}

/// The heap experiment with one setting of the computation varied.
fn computed(heap: &VariedHeap) -> Settings {
    let usual = Settings::default();
    let factor = heap.factor;
    match heap.varied {
        Varied::SettlingTime => Settings { settle_max_s: usual.settle_max_s * factor, ..usual },
        Varied::Substep => Settings { substep_s: usual.substep_s * factor, ..usual },
        Varied::Particles => Settings::with_particles((factor * f64::from(usual.particles)) as u32),
    }
}

/// A powder and the heap experiment under conditions.
pub(super) fn under(set: &ParameterSet, patch: &Patch) -> Option<(ParameterSet, Settings)> {
    let usual = Settings::default();
    let more = |name: &str| patch.heap.get(name).copied().unwrap_or(0.0);
    let settings = Settings {
        extensions: usual.extensions.patched(patch).ok()?,
        base_friction: (usual.base_friction + more("base_friction")).max(0.0),
        funnel_clearance_diameters: (usual.funnel_clearance_diameters + more("funnel_clearance"))
            .max(CLEARANCE_MIN),
        ..usual
    };
    Some((patch.powder(set), settings))
}

#[cfg(test)]
mod tests {
    use super::*;
    use flip_sim::repose::repose;

    #[test]
    fn an_extended_simulator_at_its_reference_is_its_base_in_every_bit() {
        let set = ParameterSet::default();
        let (powder, settings) = under(&set, &Patch::default()).unwrap();
        let small = |settings: Settings| Settings {
            particles: 400,
            base_radius_diameters: 5.0,
            ..settings
        };
        let bits = |set: &ParameterSet, settings: Settings| {
            repose(set, &small(settings), 1).unwrap().tip_deg.to_bits()
        };
        assert_eq!(bits(&powder, settings), bits(&set, Settings::default()));
        let wet = Patch { amplitudes: [("humidity".to_owned(), 0.5)].into(), ..Patch::default() };
        let (powder, settings) = under(&set, &wet).unwrap();
        assert_ne!(bits(&powder, settings), bits(&set, Settings::default()));
    }

    #[test]
    fn conditions_reach_the_heap_experiment() {
        let heap =
            [("base_friction".to_owned(), -0.3), ("funnel_clearance".to_owned(), -9.0)].into();
        let (_, settings) =
            under(&ParameterSet::default(), &Patch { heap, ..Patch::default() }).unwrap();
        assert!(
            (settings.base_friction - 0.5).abs() < 1e-12
                && settings.funnel_clearance_diameters == CLEARANCE_MIN
        );
        let unknown = Patch { amplitudes: [("wind".to_owned(), 1.0)].into(), ..Patch::default() };
        assert!(under(&ParameterSet::default(), &unknown).is_none());
    }
}
