//! What callers write on weighings and jobs.

use super::{Error, Result};
use flip_core::domain::FieldError;
use flip_core::domain::labels::Labels;
use flip_store::who::correlation_id;

/// Longest id of a request that is kept.
const CORRELATION_MAX: usize = 200;

/// Labels as they are stored: with the caller's own id of the request.
///
/// # Errors
/// `Invalid`: too many or too long, or a key or an id in other characters.
pub(super) fn written(labels: Labels) -> Result<Labels> {
    let labels = labels.trimmed();
    let (id, mut faults) = (correlation_id(), labels.faults("labels"));
    let is_kept =
        |id: &String| id.len() <= CORRELATION_MAX && id.bytes().all(|byte| byte.is_ascii_graphic());
    if !id.as_ref().is_none_or(is_kept) {
        let advice = format!("must be at most {CORRELATION_MAX} visible ASCII characters");
        faults.push(FieldError::new("x-correlation-id", advice));
    }
    match faults.is_empty() {
        true => Ok(labels.correlated(id.as_deref())),
        false => Err(Error::Invalid(faults)),
    }
}
