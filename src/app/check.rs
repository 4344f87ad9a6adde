//! Checking a request: every wrong field is named, not only the first.

use super::{Error, Result};
use flip_core::domain::FieldError;

/// Collects what is wrong with a request.
#[derive(Debug, Default)]
pub(super) struct Check {
    errors: Vec<FieldError>,
}

impl Check {
    /// The value if it is right; what is wrong with it is remembered.
    pub fn keep<T>(&mut self, checked: std::result::Result<T, FieldError>) -> Option<T> {
        checked.map_err(|error| self.errors.push(error)).ok()
    }

    /// Text for people: not blank, not too long, no control characters.
    pub fn text(&mut self, field: &str, text: &str, chars_max: usize) {
        let length = text.chars().count();
        if text.trim().is_empty() || length > chars_max || text.chars().any(char::is_control) {
            self.refuse(field, format!("must be 1 to {chars_max} characters without control characters, got {length}"));
        }
    }

    /// Where numbers come from: may be left empty.
    pub fn source(&mut self, field: &str, source: &str) {
        if !source.is_empty() {
            self.text(field, source, 500);
        }
    }

    /// A whole number within bounds.
    pub fn count(&mut self, field: &str, value: u32, lower: u32, upper: u32) {
        if !(lower..=upper).contains(&value) {
            self.refuse(field, format!("must be a whole number from {lower} to {upper}, got {value}"));
        }
    }

    /// Something is wrong with `field`.
    pub fn refuse(&mut self, field: &str, message: impl Into<String>) {
        self.errors.push(FieldError::new(field, message));
    }

    /// Nothing is wrong; else everything that is, for a caller that goes on collecting.
    pub fn refusals(&mut self) -> std::result::Result<(), Vec<FieldError>> {
        if self.errors.is_empty() { Ok(()) } else { Err(std::mem::take(&mut self.errors)) }
    }

    /// Nothing is wrong.
    ///
    /// # Errors
    /// [`Error::Invalid`] with everything that is.
    pub fn done(&mut self) -> Result<()> {
        self.refusals().map_err(Error::Invalid)
    }
}
