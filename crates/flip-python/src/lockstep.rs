//! Doses in lockstep, for the Gymnasium environments.

use crate::refusal::{refused, unreadable};
use crate::settings::changed;
use flip_core::domain::parameters::COUNT;
use flip_learn::train::lockstep::{self, Autoreset, Pouring, Rows};
use flip_learn::train::{Level, Order, Preset, Settings};
use flip_policy::OUTPUTS;
use numpy::{PyArray2, PyReadonlyArray1, PyReadonlyArray2, PyReadwriteArray1, PyReadwriteArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use serde::de::DeserializeOwned;
use std::time::Instant;

/// Doses in lockstep.
#[pyclass(module = "flip_powder._native")]
pub(crate) struct Lockstep {
    doses: lockstep::Lockstep,
}

/// The arrays that a step writes to.
#[derive(FromPyObject)]
struct Arrays<'py>(
    PyReadwriteArray2<'py, f32>,
    PyReadwriteArray1<'py, f64>,
    PyReadwriteArray1<'py, bool>,
    PyReadwriteArray1<'py, bool>,
    PyReadwriteArray2<'py, f64>,
    PyReadwriteArray2<'py, f32>,
    PyReadwriteArray2<'py, f64>,
);

fn named<T: DeserializeOwned>(what: &str, name: &str) -> PyResult<T> {
    serde_json::from_value(name.into()).map_err(|error| unreadable(what, error))
}

impl Arrays<'_> {
    fn rows(&mut self, doses: &lockstep::Lockstep) -> PyResult<Rows<'_>> {
        let not = |_| PyValueError::new_err("the arrays must be contiguous");
        let rows = Rows {
            inputs: self.0.as_slice_mut().map_err(not)?,
            rewards: self.1.as_slice_mut().map_err(not)?,
            terminated: self.2.as_slice_mut().map_err(not)?,
            truncated: self.3.as_slice_mut().map_err(not)?,
            facts: self.4.as_slice_mut().map_err(not)?,
            last_inputs: self.5.as_slice_mut().map_err(not)?,
            last_facts: self.6.as_slice_mut().map_err(not)?,
        };
        let (n, wide, facts) =
            (doses.len(), doses.len() * doses.width(), doses.len() * lockstep::FACTS.len());
        let lengths = [
            (rows.inputs.len(), wide),
            (rows.rewards.len(), n),
            (rows.terminated.len(), n),
            (rows.truncated.len(), n),
            (rows.facts.len(), facts),
            (rows.last_inputs.len(), wide),
            (rows.last_facts.len(), facts),
        ];
        match lengths.iter().all(|(has, wanted)| has == wanted) {
            true => Ok(rows),
            false => Err(PyValueError::new_err("the arrays have another shape than the doses")),
        }
    }
}

#[pymethods]
impl Lockstep {
    /// `levels` and `settings` are JSON.
    #[new]
    fn new(
        count: u32,
        pouring: &str,
        autoreset: &str,
        preset: &str,
        order: &str,
        levels: &str,
        settings: &str,
    ) -> PyResult<Self> {
        let preset: Preset = named("preset", preset)?;
        let order: Order = named("order", order)?;
        let settings = changed("settings", &Settings::of(preset, order, 0), settings)?;
        let levels: Vec<Level> =
            serde_json::from_str(levels).map_err(|error| unreadable("levels", error))?;
        let (pouring, autoreset): (Pouring, Autoreset) =
            (named("pouring", pouring)?, named("autoreset_mode", autoreset)?);
        let doses = lockstep::Lockstep::new(count, pouring, autoreset, &levels, &settings);
        Ok(Self { doses: doses.map_err(refused)? })
    }

    /// Inputs per observation.
    #[getter]
    fn width(&self) -> usize {
        self.doses.width()
    }

    /// The settings in force, as JSON.
    #[getter]
    fn settings(&self) -> PyResult<String> {
        serde_json::to_string(self.doses.settings()).map_err(|error| unreadable("settings", error))
    }

    /// The levels in their order, as JSON.
    #[getter]
    fn levels(&self) -> PyResult<String> {
        serde_json::to_string(self.doses.levels()).map_err(|error| unreadable("levels", error))
    }

    /// Lowest and highest value of each input.
    fn bounds(&self) -> [Vec<f32>; 2] {
        self.doses.bounds()
    }

    fn set_level(&mut self, level: u32) -> PyResult<()> {
        self.doses.set_level(level).map_err(refused)
    }

    #[pyo3(signature = (target_mg))]
    fn set_target_mg(&mut self, target_mg: Option<f64>) -> PyResult<()> {
        self.doses.set_target_mg(target_mg).map_err(refused)
    }

    /// The nine parameters of each powder as fractions of their ranges.
    fn parameters<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let rows: Vec<Vec<f32>> = self.doses.parameters().iter().map(|row| row.to_vec()).collect();
        debug_assert!(rows.iter().all(|row| row.len() == COUNT));
        Ok(PyArray2::from_vec2(py, &rows)?)
    }

    #[pyo3(signature = (which, seeds, arrays))]
    fn reset(
        &mut self,
        py: Python<'_>,
        which: Option<PyReadonlyArray1<'_, bool>>,
        seeds: Vec<Option<u64>>,
        mut arrays: Arrays<'_>,
    ) -> PyResult<()> {
        let rows = arrays.rows(&self.doses)?;
        let which = which.map(|it| it.as_slice().map(<[bool]>::to_vec)).transpose()?;
        let n = self.doses.len();
        if seeds.len() != n || which.as_ref().is_some_and(|which| which.len() != n) {
            return Err(PyValueError::new_err(format!("seeds and mask must have {n} elements")));
        }
        py.detach(|| self.doses.reset(which.as_deref(), &seeds, rows));
        Ok(())
    }

    fn step(
        &mut self,
        py: Python<'_>,
        actions: PyReadonlyArray2<'_, f32>,
        mut arrays: Arrays<'_>,
    ) -> PyResult<()> {
        let rows = arrays.rows(&self.doses)?;
        let (actions, rest) = actions.as_slice()?.as_chunks::<OUTPUTS>();
        if actions.len() != self.doses.len() || !rest.is_empty() {
            let n = self.doses.len();
            return Err(PyValueError::new_err(format!("actions: must have the shape ({n}, 2)")));
        }
        py.detach(|| self.doses.step(actions, rows)).map_err(refused)
    }

    /// Steps through `[steps, doses, 2]` actions with no Python between them, for comparison; returns
    /// the seconds it took.
    fn run(
        &mut self,
        py: Python<'_>,
        actions: PyReadonlyArray2<'_, f32>,
        mut arrays: Arrays<'_>,
    ) -> PyResult<f64> {
        let n = self.doses.len();
        let (actions, _) = actions.as_slice()?.as_chunks::<OUTPUTS>();
        let mut rows = arrays.rows(&self.doses)?;
        let begun = Instant::now();
        py.detach(|| {
            actions.chunks_exact(n).try_for_each(|actions| self.doses.step(actions, rows.again()))
        })
        .map_err(refused)?;
        Ok(begun.elapsed().as_secs_f64())
    }
}
