//! Calibration in this process: parameter sets that pile at an angle.

use crate::refusal::refused;
use crate::settings::changed;
use flip_core::domain::parameters::COUNT;
use flip_core::domain::powder::Flowability;
use flip_learn::calibrate::{Error, Heap, Method, Pour, Settings, TooFew, calibrate as search};
use flip_sim::repose;
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use rayon::prelude::*;
use std::ops::ControlFlow;

/// A set found: its nine values, its simulated angle, degrees, and by how much that is off, degrees.
type Found = ([f64; COUNT], f64, f64);

fn simulated(pour: &Pour) -> Result<Heap, String> {
    let readings = pour.readings;
    let settings =
        repose::Settings { readings, ..repose::Settings::with_particles(pour.particles) };
    let heap =
        repose::repose(&pour.parameters, &settings, pour.seed).map_err(|no| no.to_string())?;
    let repose::Repose { tip_deg, tip_sd_deg, cone_deg, creep_deg_per_s, .. } = heap;
    Ok(Heap { tip_deg, tip_sd_deg, cone_deg, creep_deg_per_s })
}

/// Searches by the method `sequential`; `settings` is JSON. Ctrl-C ends it.
#[pyfunction]
pub(crate) fn calibrate(
    py: Python<'_>,
    repose_deg: f64,
    sets: u32,
    settings: &str,
) -> PyResult<Vec<Found>> {
    let default = Settings { sets, ..Settings::of(Method::Sequential) };
    let settings: Settings = changed("settings", &default, settings)?;
    let target = Flowability::new(repose_deg, 0.0, 1).map_err(refused)?;
    let mut interrupted = None;
    let found = py.detach(|| {
        let pour = |pours: &[Pour]| pours.par_iter().map(simulated).collect::<Vec<_>>();
        search(&target, &settings, None, &[], pour, |_, _| {
            match Python::attach(|py| py.check_signals()) {
                Ok(()) => ControlFlow::Continue(()),
                Err(error) => {
                    interrupted = Some(error);
                    ControlFlow::Break(())
                }
            }
        })
    });
    if let Some(error) = interrupted {
        return Err(error);
    }
    let found = found.map_err(|error| match error {
        Error::Settings(error) => refused(error),
        Error::TooFew(few) => PyRuntimeError::new_err(TooFew::to_string(&few)),
        error => PyRuntimeError::new_err(error.to_string()),
    })?;
    let row = |set: &flip_learn::calibrate::CalibratedSet| {
        (set.parameters.values(), set.repose_deg, set.error_deg)
    };
    Ok(found.sets.iter().map(row).collect())
}
