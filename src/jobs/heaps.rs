//! The heaps of an investigation: numerical errors of the simulator, independent of any data, and
//! the amplitudes of an extension.

use super::context::{JobContext, JobError};
use super::spec::{Heaps, InvestigationSpec};
use flip_core::domain::conditions::Patch;
use flip_core::domain::job::Progress;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use flip_discover::extension::Hook;
use flip_discover::numerics::{self, Varied};
use flip_discover::report::{Numerics, Report};
use flip_discover::{Extended, fit};
use flip_sim::repose::Settings;
use flip_store as store;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, PoisonError};

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
    context: &'a JobContext,
    heaps: &'a Heaps,
    seed: u64,
    poured: AtomicU32,
    unsaved: Mutex<Option<store::Error>>,
}

impl<'a> Pourer<'a> {
    /// Creates one that has poured nothing; `None` if an investigation simulates nothing.
    pub(super) fn of(context: &'a JobContext, spec: &'a InvestigationSpec) -> Option<Self> {
        let heaps = spec.heaps.as_ref().filter(|heaps| !heaps.sets.is_empty())?;
        Some(Self {
            context,
            heaps,
            seed: spec.settings.seed,
            poured: AtomicU32::new(0),
            unsaved: Mutex::default(),
        })
    }

    /// Number of heaps so far.
    pub(super) fn poured(&self) -> u32 {
        self.poured.load(Ordering::SeqCst)
    }

    /// Whether angles depend on numerical settings, with a share of the budget; `None` if that is
    /// too small.
    pub(super) fn numerics(&self, share: [f64; 2]) -> Result<Option<Numerics>, JobError> {
        let repeats = (self.heaps.budget_runs / BUDGET_PER_REPEAT).min(REPEATS_MAX);
        // The middle powder in the order listed.
        let (set, parameters) = &self.heaps.sets[self.heaps.sets.len() / 2];
        if repeats < 2 {
            return Ok(None);
        }
        let found = numerics::criticise(
            1,
            repeats,
            derive(self.seed, &[NUMERICS]),
            |_, varied, factor, seed| {
                let usual = match varied {
                    Varied::Particles => Settings::with_particles(
                        (factor * f64::from(Settings::default().particles)) as u32,
                    ),
                    _ => Settings::default(),
                };
                let settings = match varied {
                    Varied::SettlingTime => {
                        Settings { settle_max_s: usual.settle_max_s * factor, ..usual }
                    }
                    Varied::Substep => Settings { substep_s: usual.substep_s * factor, ..usual },
                    Varied::Particles => usual,
                };
                self.pour(
                    parameters,
                    settings,
                    seed,
                    "whether heaps depend on how they are computed",
                    share,
                )
            },
        );
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
    ) -> Result<(), JobError> {
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
            let found = fit(extension, &sets, budget, seed, |set, patch, seed| {
                let (parameters, settings) = under(&self.heaps.sets[set].1, patch)?;
                self.pour(&parameters, settings, seed, "the amplitude of the extension", share)
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

    /// The angle of a heap; `None` if it has none, or the job is to end.
    fn pour(
        &self,
        set: &ParameterSet,
        settings: Settings,
        seed: u64,
        what: &str,
        share: [f64; 2],
    ) -> Option<f64> {
        if self.context.flow().is_break() {
            return None;
        }
        let settings = Settings { readings: READINGS, ..settings };
        let heap = (self.context.functions.simulate)(set, &settings, seed);
        let poured = self.poured.fetch_add(1, Ordering::SeqCst) + 1;
        let budget = self.heaps.budget_runs;
        let done = (f64::from(poured) / f64::from(budget)).min(1.0);
        let message = format!("{what}: heap {poured} of at most {budget}");
        let progress = Progress { fraction: share[0] + (share[1] - share[0]) * done, message };
        if let Err(error) = self.context.report(&progress) {
            self.unsaved.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
        }
        heap.ok().map(|heap| heap.tip_deg)
    }

    /// Whether all requested heaps were poured.
    fn settled(&self) -> Result<(), JobError> {
        if let Some(error) = self.unsaved.lock().unwrap_or_else(PoisonError::into_inner).take() {
            return Err(error.into());
        }
        if self.context.flow().is_break() { Err(JobError::Stopped) } else { Ok(()) }
    }
}

/// A powder and the heap experiment under conditions.
fn under(set: &ParameterSet, patch: &Patch) -> Option<(ParameterSet, Settings)> {
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
