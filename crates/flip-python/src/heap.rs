//! Heaps: the angle of repose of a simulated powder.

use crate::settings::{changed, set_of};
use crate::snapshot::Snapshot;
use flip_core::domain::parameters::{COUNT, ParameterSet};
use flip_sim::repose::{Pile, Refusal, Settings, pile};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use rayon::prelude::*;

/// A simulated heap.
#[pyclass(frozen, module = "flip_powder._native")]
pub(crate) struct Heap {
    pile: Pile,
}

/// Settings of a heap of so many grains, changed by JSON.
fn settings_of(particles: u32, changes: &str) -> PyResult<Settings> {
    changed("settings", &Settings::with_particles(particles), changes)
}

fn poured(pile: Result<Pile, Refusal>) -> PyResult<Heap> {
    let pile = pile.map_err(|refusal| PyRuntimeError::new_err(refusal.to_string()))?;
    Ok(Heap { pile })
}

/// Pours a heap of each set on all cores; `settings` is JSON. A heap without an angle is the text
/// that says why.
#[pyfunction]
pub(crate) fn heaps(
    py: Python<'_>,
    sets: Vec<[f64; COUNT]>,
    seeds: Vec<u64>,
    particles: u32,
    settings: &str,
) -> PyResult<Vec<(Option<Heap>, Option<String>)>> {
    let settings = settings_of(particles, settings)?;
    let sets = sets.into_iter().map(set_of).collect::<PyResult<Vec<ParameterSet>>>()?;
    let piles: Vec<_> = py.detach(|| {
        let pour = |(set, seed): (&ParameterSet, &u64)| pile(set, &settings, *seed, None);
        sets.par_iter().zip(&seeds).map(pour).collect()
    });
    let row = |pile| match pile {
        Ok(pile) => (Some(Heap { pile }), None),
        Err(refusal) => (None, Some(Refusal::to_string(&refusal))),
    };
    Ok(piles.into_iter().map(row).collect())
}

#[pymethods]
impl Heap {
    /// Pours a heap; `settings` is JSON.
    #[new]
    fn new(
        py: Python<'_>,
        set: [f64; COUNT],
        seed: u64,
        particles: u32,
        settings: &str,
    ) -> PyResult<Self> {
        let (set, settings) = (set_of(set)?, settings_of(particles, settings)?);
        poured(py.detach(|| pile(&set, &settings, seed, None)))
    }

    /// Angle of repose from the apex, degrees.
    #[getter]
    fn tip_deg(&self) -> f64 {
        self.pile.repose.tip_deg
    }

    /// Its standard deviation over the readings, degrees; None for a single one.
    #[getter]
    fn tip_sd_deg(&self) -> Option<f64> {
        self.pile.repose.tip_sd_deg
    }

    /// Slope of a cone fitted to the flank, degrees.
    #[getter]
    fn cone_deg(&self) -> f64 {
        self.pile.repose.cone_deg
    }

    /// Change of the cone's slope over the last 0.2 s, degrees per second.
    #[getter]
    fn creep_deg_per_s(&self) -> f64 {
        self.pile.repose.creep_deg_per_s
    }

    /// Grains that stayed on the base.
    #[getter]
    fn particles_on_base(&self) -> u32 {
        self.pile.repose.particles_on_base
    }

    /// Simulated time, s.
    #[getter]
    fn simulated_s(&self) -> f64 {
        self.pile.repose.simulated_s
    }

    /// The grains at the end.
    fn snapshot(&self, py: Python<'_>) -> PyResult<Snapshot> {
        Snapshot::of(py, &self.pile.snapshot)
    }
}
