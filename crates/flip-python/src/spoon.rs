//! Spoons: a dose in the simulator, one action at a time.

use crate::settings::{changed, set_of};
use crate::snapshot::Snapshot;
use flip_core::domain::bench::Action;
use flip_core::domain::parameters::COUNT;
use flip_sim::dispense::{Dispenser, Poured, Settings};
use flip_sim::snapshot::Camera;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use rayon::prelude::*;
use std::sync::{Arc, Mutex, PoisonError};

/// What fell: into the vial, mg; beside it, mg; and how long it took, s.
type Fell = (f64, f64, f64);

fn fell(poured: Poured) -> Fell {
    (poured.vial_mg, poured.spilled_mg, poured.duration_s)
}

fn action(incline_change_deg: f64, shake_mm: f64, strokes: u32) -> Action {
    Action { incline_change_deg, shake_mm, strokes }
}

/// A spoon filled with simulated powder, over a vial.
#[pyclass(module = "flip_powder._native")]
#[derive(Clone)]
pub(crate) struct Spoon {
    dispenser: Dispenser,
}

#[pymethods]
impl Spoon {
    /// Fills a level spoon; `settings` is JSON.
    #[new]
    fn new(py: Python<'_>, set: [f64; COUNT], seed: u64, settings: &str) -> PyResult<Self> {
        let set = set_of(set)?;
        let settings: Settings = changed("settings", &Settings::default(), settings)?;
        let dispenser = py.detach(|| Dispenser::new(&set, &settings, seed));
        Ok(Self { dispenser })
    }

    /// Inclines, then shakes; returns what fell into the vial, what fell beside it, mg, and the time
    /// taken, s.
    fn step(
        &mut self,
        py: Python<'_>,
        incline_change_deg: f64,
        shake_mm: f64,
        strokes: u32,
    ) -> Fell {
        let action = action(incline_change_deg, shake_mm, strokes);
        fell(py.detach(|| self.dispenser.step(action)))
    }

    /// The same, with a snapshot every so many seconds.
    fn film(
        &mut self,
        py: Python<'_>,
        incline_change_deg: f64,
        shake_mm: f64,
        strokes: u32,
        every_s: f64,
    ) -> PyResult<(Fell, Vec<Snapshot>)> {
        if every_s.is_nan() || every_s <= 0.0 {
            return Err(PyValueError::new_err("every_s: must be more than 0 s"));
        }
        let seen = Arc::new(Mutex::new(Vec::new()));
        let kept = Arc::clone(&seen);
        let see = move |it| kept.lock().unwrap_or_else(PoisonError::into_inner).push(it);
        let action = action(incline_change_deg, shake_mm, strokes);
        let poured = py.detach(|| {
            self.dispenser.watch(Camera { every_s, see: Arc::new(see) });
            let poured = self.dispenser.step(action);
            self.dispenser.watch(None);
            poured
        });
        let seen = std::mem::take(&mut *seen.lock().unwrap_or_else(PoisonError::into_inner));
        let frames = seen.iter().map(|it| Snapshot::of(py, it)).collect::<PyResult<_>>()?;
        Ok((fell(poured), frames))
    }

    /// Current pitch, degrees; positive is tip down.
    #[getter]
    fn pitch_deg(&self) -> f64 {
        self.dispenser.pitch_deg()
    }

    /// Powder in the vial, mg.
    #[getter]
    fn vial_mg(&self) -> f64 {
        self.dispenser.vial_mg()
    }

    /// Powder that missed the vial, mg.
    #[getter]
    fn spilled_mg(&self) -> f64 {
        self.dispenser.spilled_mg()
    }

    /// Powder left in the spoon, mg.
    #[getter]
    fn spoon_mg(&self) -> f64 {
        self.dispenser.spoon_mg()
    }

    /// Why its numbers mean nothing any more, or None.
    #[getter]
    fn fault(&self) -> Option<&str> {
        self.dispenser.fault()
    }

    /// The grains in it.
    fn snapshot(&self, py: Python<'_>) -> PyResult<Snapshot> {
        Snapshot::of(py, &self.dispenser.snapshot())
    }

    fn copy(&self, py: Python<'_>) -> Self {
        py.detach(|| self.clone())
    }
}

/// One action of each spoon, on all cores.
#[pyfunction]
pub(crate) fn step_all(
    py: Python<'_>,
    mut spoons: Vec<PyRefMut<'_, Spoon>>,
    actions: Vec<(f64, f64, u32)>,
) -> PyResult<Vec<Fell>> {
    if spoons.len() != actions.len() {
        let (n, m) = (spoons.len(), actions.len());
        return Err(PyValueError::new_err(format!("actions: {m} for {n} spoons")));
    }
    let mut held: Vec<&mut Dispenser> = spoons.iter_mut().map(|it| &mut it.dispenser).collect();
    Ok(py.detach(|| {
        held.par_iter_mut()
            .zip(actions)
            .map(|(it, (a, b, c))| fell(it.step(action(a, b, c))))
            .collect()
    }))
}
