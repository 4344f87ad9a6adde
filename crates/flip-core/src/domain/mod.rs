//! The domain types: powders, parameter sets, readings, actions, weighings, jobs. No I/O, no clock,
//! no async.

pub mod apparatus;
pub mod bench;
pub mod bench_check;
pub mod conditions;
pub mod device;
pub mod job;
pub mod labels;
pub mod motion;
pub mod observable;
pub mod parameters;
pub mod pile;
pub mod powder;
pub mod powder_card;
pub mod powder_name;
pub mod rest;
pub mod seed;
pub mod shake;
pub mod spoon;
pub mod timestamp;
pub mod vial;
pub mod weighing;

/// A rejected input field: which field, what was expected, what to do.
///
/// Every layer that rejects an input reports it with this type; the API turns it into problem+json.
#[derive(Debug, Clone, PartialEq, thiserror::Error, serde::Serialize, serde::Deserialize)]
#[error("{field}: {message}")]
pub struct FieldError {
    /// Path of the field as the caller wrote it, e.g. `target.value`.
    pub field: String,
    /// The bound and how to fix it, e.g. `must be between 0.1 and 30 mg; ask for less or use a
    /// larger spoon`.
    pub message: String,
}

impl FieldError {
    /// A rejection of `field`.
    pub fn new(field: impl Into<String>, message: impl Into<String>) -> Self {
        Self { field: field.into(), message: message.into() }
    }
}

/// Returns `value` if it is finite and within `lower..=upper`, otherwise a [`FieldError`] that
/// states the bound.
pub fn bounded(
    field: &str,
    value: f64,
    lower: f64,
    upper: f64,
    unit: &str,
) -> Result<f64, FieldError> {
    if value.is_finite() && (lower..=upper).contains(&value) {
        return Ok(value);
    }
    let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
    Err(FieldError::new(
        field,
        format!("must be a number from {lower} to {upper}{unit}, got {value}"),
    ))
}
