//! What can go wrong with a device.

/// A device did not do its part. The variants say what a caller can do about it.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DeviceError {
    /// No answer in time: check power and cables.
    #[error("{device} does not answer")]
    Silent {
        /// Which device.
        device: &'static str,
    },
    /// What came is not what the protocol allows: check the dialect and the port's settings.
    #[error("{device} sent what cannot be read: {got}")]
    Garbled {
        /// Which device.
        device: &'static str,
        /// What came, escaped.
        got: String,
    },
    /// The connection is gone or cannot be made.
    #[error("the connection to {device} is lost: {cause}")]
    Lost {
        /// Which device.
        device: &'static str,
        /// In the system's words.
        cause: String,
    },
    /// The device reports a fault of its own: look at it.
    #[error("{device} reports a fault: {cause}")]
    Faulted {
        /// Which device.
        device: &'static str,
        /// In its own words.
        cause: String,
    },
    /// The device must not be asked for this now.
    #[error("{device} must not do this now: {cause}")]
    Forbidden {
        /// Which device.
        device: &'static str,
        /// Why, and what to do first.
        cause: String,
    },
}
