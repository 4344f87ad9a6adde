//! What callers write on weighings and jobs.

use super::{Error, Result};
use flip_core::domain::labels::Labels;
use flip_store::who::correlation_id;

/// Labels as they are stored: with the caller's own id of the request.
///
/// # Errors
/// `Invalid`: too many or too long, or a key in other characters.
pub(super) fn written(labels: Labels) -> Result<Labels> {
    let faults = labels.faults("labels");
    match faults.is_empty() {
        true => Ok(labels.correlated(correlation_id().as_deref())),
        false => Err(Error::Invalid(faults)),
    }
}
