//! Request validation: every invalid field is reported, not only the first.

use super::{Error, Result};
use flip_core::domain::FieldError;

/// Collects the errors of a request.
#[derive(Debug, Default)]
pub(super) struct Check {
    errors: Vec<FieldError>,
}

impl Check {
    /// The value if it is valid; otherwise its error is collected.
    pub fn keep<T>(&mut self, checked: std::result::Result<T, FieldError>) -> Option<T> {
        checked.map_err(|error| self.errors.push(error)).ok()
    }

    /// Checks text for people: not blank, not too long, no control characters.
    pub fn text(&mut self, field: &str, text: &str, chars_max: usize) {
        let length = text.chars().count();
        if text.trim().is_empty() || length > chars_max || text.chars().any(char::is_control) {
            self.refuse(
                field,
                format!(
                    "must be 1 to {chars_max} characters without control characters, got {length}"
                ),
            );
        }
    }

    /// Checks the source of numbers: may be empty.
    pub fn source(&mut self, field: &str, source: &str) {
        if !source.is_empty() {
            self.text(field, source, 500);
        }
    }

    /// Checks that a whole number is within bounds.
    pub fn count(&mut self, field: &str, value: u32, lower: u32, upper: u32) {
        if !(lower..=upper).contains(&value) {
            self.refuse(
                field,
                format!("must be a whole number from {lower} to {upper}, got {value}"),
            );
        }
    }

    /// Adds an error about `field`.
    pub fn refuse(&mut self, field: &str, message: impl Into<String>) {
        self.errors.push(FieldError::new(field, message));
    }

    /// Succeeds if there are no errors; otherwise returns and removes them, for a caller that
    /// continues collecting.
    pub fn refusals(&mut self) -> std::result::Result<(), Vec<FieldError>> {
        if self.errors.is_empty() { Ok(()) } else { Err(std::mem::take(&mut self.errors)) }
    }

    /// Succeeds if there are no errors.
    ///
    /// # Errors
    /// [`Error::Invalid`] with all errors.
    pub fn done(&mut self) -> Result<()> {
        self.refusals().map_err(Error::Invalid)
    }
}
