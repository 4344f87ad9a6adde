//! Where the grains are at one moment, as arrays.

use flip_sim::snapshot;
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyUntypedArrayMethods, ToPyArray};
use pyo3::prelude::*;

/// Where the grains are at one moment.
#[pyclass(frozen, module = "flip_powder._native")]
pub(crate) struct Snapshot {
    time_s: f64,
    centres_mm: Py<PyArray2<f32>>,
    radii_mm: Py<PyArray1<f32>>,
    ids: Py<PyArray1<u32>>,
}

impl Snapshot {
    /// Moves a snapshot of the simulator into NumPy's arrays.
    pub(crate) fn of(py: Python<'_>, taken: &snapshot::Snapshot) -> PyResult<Self> {
        let count = taken.ids.len();
        let centres: Vec<f32> = (0..count).flat_map(|k| taken.centre_mm(k)).collect();
        let radii: Vec<f32> = (0..count).map(|k| taken.radius_mm(k)).collect();
        let centres = PyArray1::from_vec(py, centres);
        Ok(Self {
            time_s: taken.time_s,
            centres_mm: centres.reshape([count, 3])?.unbind(),
            radii_mm: PyArray1::from_vec(py, radii).unbind(),
            ids: taken.ids.to_pyarray(py).unbind(),
        })
    }
}

#[pymethods]
impl Snapshot {
    /// Simulated time, s.
    #[getter]
    fn time_s(&self) -> f64 {
        self.time_s
    }

    /// Centres of the grains, mm, `[grains, 3]`.
    #[getter]
    fn centres_mm(&self, py: Python<'_>) -> Py<PyArray2<f32>> {
        self.centres_mm.clone_ref(py)
    }

    /// Radii of the grains, mm, `[grains]`.
    #[getter]
    fn radii_mm(&self, py: Python<'_>) -> Py<PyArray1<f32>> {
        self.radii_mm.clone_ref(py)
    }

    /// Numbers of the grains in the order of pouring, `[grains]`.
    #[getter]
    fn ids(&self, py: Python<'_>) -> Py<PyArray1<u32>> {
        self.ids.clone_ref(py)
    }

    fn __len__(&self, py: Python<'_>) -> usize {
        self.ids.bind(py).len()
    }
}
