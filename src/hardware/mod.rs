//! What a bench is to the weighing loop, and the benches there are.

pub mod simulated;

use crate::domain::bench::{Action, Reading};

/// A device did not do its part. The variants say what a caller can do about it.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DeviceError {
    /// No answer in time: check power and cables.
    #[error("{device} does not answer")]
    Silent {
        /// Which device.
        device: &'static str,
    },
    /// The device reports a fault of its own: look at it.
    #[error("{device} reports a fault: {cause}")]
    Faulted {
        /// Which device.
        device: &'static str,
        /// In its own words.
        cause: String,
    },
}

/// A balance under a spoon on an arm. Every call returns when the motion or the reading is complete.
pub trait Bench {
    /// Set the balance to zero with the vial on it.
    ///
    /// # Errors
    /// A device failed.
    fn tare(&mut self) -> Result<(), DeviceError>;

    /// A reading taken after the balance had time to settle.
    ///
    /// # Errors
    /// A device failed.
    fn read(&mut self) -> Result<Reading, DeviceError>;

    /// Carry out one action: incline, then shake.
    ///
    /// # Errors
    /// A device failed; the spoon may stand anywhere.
    fn act(&mut self, action: Action) -> Result<(), DeviceError>;

    /// Bring the spoon to level, whatever happened before.
    ///
    /// # Errors
    /// The arm failed: a person must look.
    fn level(&mut self) -> Result<(), DeviceError>;

    /// Pitch of the spoon now, degrees, positive is tip down.
    fn pitch_deg(&self) -> f64;

    /// Bench time since the bench was made, s: in simulation that of the simulated motions.
    fn elapsed_s(&self) -> f64;
}
