//! Networks trained elsewhere as policy files.

use crate::refusal::unreadable;
use flip_learn::train::Settings;
use flip_policy::{Actor, Controller, Manifest, Policy, encode, id};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

/// A policy file of a perceptron with ReLU between its layers: its id and its bytes.
///
/// `settings` is a [`crate::lockstep::Lockstep`]'s. `weights` has, for each layer, its weight
/// `[inputs, outputs]` by rows and its bias; the last layer's outputs are two means, before tanh, and two
/// log standard deviations.
#[pyfunction]
pub(crate) fn policy_file<'py>(
    py: Python<'py>,
    settings: &str,
    widths: Vec<usize>,
    weights: Vec<f32>,
    episodes: u32,
) -> PyResult<(String, Bound<'py, PyBytes>)> {
    let settings: Settings =
        serde_json::from_str(settings).map_err(|error| unreadable("settings", error))?;
    let actor = Actor::from_flat(settings.encoding, &widths, &weights)
        .map_err(|error| unreadable("weights", error))?;
    let preset = serde_json::to_value(settings.preset).unwrap_or_default();
    let manifest = Manifest {
        preset: preset.as_str().unwrap_or_default().to_owned(),
        settings: serde_json::to_value(&settings).unwrap_or_default(),
        simulator_version: flip_sim::VERSION.to_owned(),
        episodes,
        ..Manifest::of_untrained(actor.kind(), settings.rules, settings.seed)
    };
    let bytes = encode(&Policy { manifest, controller: Controller::Learned(actor) });
    Ok((id(&bytes), PyBytes::new(py, &bytes)))
}
