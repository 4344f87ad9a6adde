//! Faults of devices, by name.

use flip_core::domain::FieldError;

/// The fault with this name.
///
/// # Errors
/// None of `all` has it; the message lists their names.
pub(super) fn named<T: Copy, const N: usize>(
    all: [T; N],
    name: impl Fn(T) -> &'static str,
    wanted: &str,
) -> Result<T, FieldError> {
    all.into_iter().find(|fault| name(*fault) == wanted).ok_or_else(|| {
        let names = all.map(name).join(", ");
        FieldError::new("fault", format!("must be one of {names}, got {wanted}"))
    })
}
