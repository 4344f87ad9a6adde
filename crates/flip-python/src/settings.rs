//! Powders and settings from JSON: the defaults, overridden by name.

use crate::refusal::{refused, unreadable};
use flip_core::domain::parameters::{COUNT, PARAMETERS, ParameterSet};
use flip_sim::mechanisms::Extensions;
use pyo3::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

/// A parameter set from its nine values, in the order of [`PARAMETERS`].
pub(crate) fn set_of(values: [f64; COUNT]) -> PyResult<ParameterSet> {
    ParameterSet::new(values).map_err(refused)
}

/// `default` with what `changes`, a JSON object, has by the same names, at any depth.
pub(crate) fn changed<T: Serialize + DeserializeOwned>(
    what: &str,
    default: &T,
    changes: &str,
) -> PyResult<T> {
    let mut value = serde_json::to_value(default).map_err(|error| unreadable(what, error))?;
    let changes = serde_json::from_str(changes).map_err(|error| unreadable(what, error))?;
    merge(&mut value, changes);
    serde_json::from_value(value).map_err(|error| unreadable(what, error))
}

fn merge(value: &mut Value, changes: Value) {
    match (value, changes) {
        (Value::Object(value), Value::Object(changes)) => {
            for (name, change) in changes {
                merge(value.entry(name).or_insert(Value::Null), change);
            }
        }
        (value, change) => *value = change,
    }
}

/// The nine parameters: `(key, unit, lower, upper, default, meaning)` of each.
#[pyfunction]
pub(crate) fn parameters() -> Vec<(&'static str, &'static str, f64, f64, f64, &'static str)> {
    let row = |p: &flip_core::domain::parameters::Parameter| {
        (p.key, p.unit, p.lower, p.upper, p.default, p.meaning)
    };
    PARAMETERS.iter().map(row).collect()
}

/// The content address of a parameter set, `ps-…`; a `ValueError` names a value out of its bounds.
#[pyfunction]
pub(crate) fn set_id(values: [f64; COUNT]) -> PyResult<String> {
    Ok(set_of(values)?.id())
}

/// The mechanisms that may be added to the simulator: name and largest sensible amplitude of each.
#[pyfunction]
pub(crate) fn extensions() -> Vec<(&'static str, f64)> {
    Extensions::default().amplitudes().map(|(name, _, upper)| (name, upper)).to_vec()
}
