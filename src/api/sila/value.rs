//! Values of the standard's types: what a caller gave for a parameter, and what an answer holds.

use super::error::Call;
use super::standard;
use serde::Serialize;
use tonic::Status;

impl Call {
    /// A text.
    ///
    /// # Errors
    /// A validation error if it is missing, as of the others.
    pub fn text(&self, parameter: &str, given: Option<standard::String>) -> Result<String, Status> {
        given.map(|it| it.value).ok_or_else(|| self.missing(parameter))
    }

    /// A text; none if it is empty.
    pub fn some_text(
        &self,
        parameter: &str,
        given: Option<standard::String>,
    ) -> Result<Option<String>, Status> {
        Ok(Some(self.text(parameter, given)?).filter(|text| !text.is_empty()))
    }

    /// A number.
    pub fn real(&self, parameter: &str, given: Option<standard::Real>) -> Result<f64, Status> {
        given.map(|it| it.value).ok_or_else(|| self.missing(parameter))
    }

    /// Yes or no.
    pub fn boolean(
        &self,
        parameter: &str,
        given: Option<standard::Boolean>,
    ) -> Result<bool, Status> {
        given.map(|it| it.value).ok_or_else(|| self.missing(parameter))
    }

    /// A whole number.
    pub fn integer(
        &self,
        parameter: &str,
        given: Option<standard::Integer>,
    ) -> Result<i64, Status> {
        given.map(|it| it.value).ok_or_else(|| self.missing(parameter))
    }

    /// A number of things; none if it is 0, which is the default.
    pub fn count(
        &self,
        parameter: &str,
        given: Option<standard::Integer>,
    ) -> Result<Option<u32>, Status> {
        let value = self.integer(parameter, given)?;
        let count = u32::try_from(value).map_err(|_| {
            self.invalid(parameter, format!("must be from 0 to {}, got {value}", u32::MAX))
        })?;
        Ok(Some(count).filter(|count| *count != 0))
    }
}

/// A text.
pub fn text(value: impl Into<String>) -> Option<standard::String> {
    Some(standard::String { value: value.into() })
}

/// A number.
pub fn real(value: f64) -> Option<standard::Real> {
    Some(standard::Real { value })
}

/// A whole number.
pub fn integer(value: impl Into<i64>) -> Option<standard::Integer> {
    Some(standard::Integer { value: value.into() })
}

/// Yes or no.
pub fn boolean(value: bool) -> Option<standard::Boolean> {
    Some(standard::Boolean { value })
}

/// A length of time, s.
pub fn duration(seconds: f64) -> standard::Duration {
    let seconds = seconds.max(0.0);
    let nanos = (seconds.fract() * 1e9) as i32;
    standard::Duration { seconds: seconds as i64, nanos }
}

/// A document as JSON.
pub fn json(document: &impl Serialize) -> String {
    serde_json::to_string(document).unwrap_or_default()
}
