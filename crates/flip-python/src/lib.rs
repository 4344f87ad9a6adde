//! `flip_powder._native`: the compiled part of the Python package flip-powder.
//!
//! Thin: everything here is called, nothing is decided. Settings cross the border as JSON under the
//! names that the crates give them, so that a thing has one name in both languages; arrays are
//! NumPy's, written in place. The interpreter's lock is released while anything is simulated.

mod calibration;
mod heap;
mod lockstep;
mod policy;
mod refusal;
mod settings;
mod snapshot;
mod spoon;

use pyo3::prelude::*;

/// The compiled part of flip-powder.
#[pymodule(name = "_native")]
mod native {
    #[pymodule_export]
    use super::calibration::calibrate;
    #[pymodule_export]
    use super::heap::{Heap, heaps};
    #[pymodule_export]
    use super::lockstep::Lockstep;
    #[pymodule_export]
    use super::policy::policy_file;
    #[pymodule_export]
    use super::settings::{extensions, parameters, set_id};
    #[pymodule_export]
    use super::snapshot::Snapshot;
    #[pymodule_export]
    use super::spoon::{Spoon, step_all};
    use super::{Bound, PyModule, PyModuleMethods, PyResult};

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("VERSION", env!("CARGO_PKG_VERSION"))?;
        module.add("SIMULATOR", flip_sim::VERSION)?;
        module.add("FACTS", flip_learn::train::lockstep::FACTS)
    }
}
