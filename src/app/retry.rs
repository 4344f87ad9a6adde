//! Requests to weigh that come again: the same key with the same request is the same weighing.

use super::{Error, Result, WeighingRequest};
use flip_core::domain::FieldError;
use flip_store::weighings::{Weighing, WeighingRow};
use sha2::{Digest, Sha256};

/// What tells whether a repeated key comes with the same request: all of it but the reservation, of
/// which a caller may have another by then.
pub(super) fn request_sha256(request: &WeighingRequest) -> Result<Vec<u8>> {
    let request = WeighingRequest { reservation: None, ..request.clone() };
    let text = serde_json::to_vec(&request).map_err(|error| Error::Internal(error.into()))?;
    Ok(Sha256::digest(text).to_vec())
}

/// The weighing created with a key, if it was requested with the same request.
pub(super) fn replay(
    first: WeighingRow,
    request_sha256: &[u8],
    key: &str,
) -> Result<(Weighing, bool)> {
    match first.request_sha256 == request_sha256 {
        true => Ok((first.weighing, true)),
        false => Err(Error::Unprocessable { key: key.to_owned(), weighing: first.weighing.id }),
    }
}

pub(super) fn check_key(key: &str) -> Result<()> {
    match (1..=255).contains(&key.len()) && key.bytes().all(|b| b.is_ascii_graphic()) {
        true => Ok(()),
        false => Err(FieldError::new(
            "Idempotency-Key",
            "must be 1 to 255 visible ASCII characters: use a new random one, such as a UUID, for each new weighing",
        )
        .into()),
    }
}
