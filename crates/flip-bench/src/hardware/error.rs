//! Errors of devices.

/// A device failed. The variants reflect what the caller can do about it.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DeviceError {
    /// No answer in time: check power and cables.
    #[error("{device} does not answer{}", hint(device))]
    Silent {
        /// Which device.
        device: &'static str,
    },
    /// The data received does not follow the protocol: check the dialect and the port settings.
    #[error("{device} sent what cannot be read: {got}")]
    Garbled {
        /// Which device.
        device: &'static str,
        /// The data received, escaped.
        got: String,
    },
    /// The connection is lost or cannot be made.
    #[error("the connection to {device} is lost: {cause}")]
    Lost {
        /// Which device.
        device: &'static str,
        /// The system's message.
        cause: String,
    },
    /// The device reports a fault: inspect it.
    #[error("{device} reports a fault: {cause}")]
    Faulted {
        /// Which device.
        device: &'static str,
        /// The device's own message.
        cause: String,
    },
    /// The device must not be commanded to do this now.
    #[error("{device} must not do this now: {cause}")]
    Forbidden {
        /// Which device.
        device: &'static str,
        /// The reason, and what to do first.
        cause: String,
    },
    /// The device reports that it cannot do this: nothing moved.
    #[error("{device} cannot do this: {cause}")]
    Unsupported {
        /// Which device.
        device: &'static str,
        /// The device's own message.
        cause: String,
    },
    /// The device is latched: it moves again once a person has inspected it and cleared the latch.
    #[error("{device} is latched: {cause}")]
    Latched {
        /// Which device.
        device: &'static str,
        /// The reason, as reported by the device.
        cause: String,
    },
}

impl DeviceError {
    /// What a person can do about it.
    pub fn advice(&self) -> &'static str {
        match self {
            Self::Silent { .. } => "check power, cables and the port's settings",
            Self::Garbled { .. } => {
                "check the dialect, the port's settings and what the bench file says of the device"
            }
            Self::Lost { cause, .. } => why_lost(cause),
            Self::Faulted { .. } => "look at the device",
            Self::Forbidden { .. } => "do first what it says",
            Self::Unsupported { .. } => "see what the device says it can do",
            Self::Latched { .. } => "look at the device, then clear the bench",
        }
    }
}

/// Some balances sleep with their plug in.
fn hint(device: &str) -> &'static str {
    if device == "the balance" { ": it may be in standby: switch it on" } else { "" }
}

/// System messages for a port that cannot be opened, and what they mean.
const LOST: [(&str, &str); 8] = [
    (
        "permission denied",
        "this user may not open the port: add it to the port's group (often dialout) and log in again",
    ),
    ("no such file", "there is no such port: is its plug in? `ls /dev/serial/by-id` lists what is"),
    (
        "no such device",
        "there is no such port: is its plug in? `ls /dev/serial/by-id` lists what is",
    ),
    ("busy", "another program has the port open: end it first"),
    (
        "connection refused",
        "nothing listens there: is the device or its serial converter on, and is the port number right?",
    ),
    ("no such host", "no machine has that name: check the address"),
    ("failed to lookup", "no machine has that name: check the address"),
    ("timed out", "no machine answers at that address: check it, and the network"),
];

fn why_lost(cause: &str) -> &'static str {
    let cause = cause.to_ascii_lowercase();
    let known = LOST.iter().find(|(words, _)| cause.contains(words));
    known.map_or(
        "check the address in the bench file, and that nothing else uses it",
        |(_, advice)| advice,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_that_cannot_be_opened_has_advice_of_its_own() {
        let advice = |cause: &str| {
            DeviceError::Lost { device: "the balance", cause: cause.to_owned() }.advice()
        };
        assert!(advice("/dev/ttyUSB0: Permission denied").contains("group"));
        assert!(advice("/dev/ttyUSB7: No such file or directory").contains("no such port"));
        assert!(advice("tcp://h:1: Connection refused (os error 111)").contains("nothing listens"));
        assert!(advice("the connection was closed").contains("the address"));
    }

    #[test]
    fn a_silent_balance_may_be_in_standby_and_another_device_may_not() {
        let silent = |device: &'static str| DeviceError::Silent { device }.to_string();
        assert_eq!(
            silent("the balance"),
            "the balance does not answer: it may be in standby: switch it on"
        );
        assert_eq!(silent("the gate"), "the gate does not answer");
    }
}
