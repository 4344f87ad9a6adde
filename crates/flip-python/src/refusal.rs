//! What is refused, as Python's exceptions.

use flip_core::domain::FieldError;
use pyo3::PyErr;
use pyo3::exceptions::PyValueError;

/// A refused field as a `ValueError` that names it.
pub(crate) fn refused(error: FieldError) -> PyErr {
    PyValueError::new_err(format!("{}: {}", error.field, error.message))
}

/// Text that is not what it should be, as a `ValueError`.
pub(crate) fn unreadable(what: &str, error: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(format!("{what}: {error}"))
}
