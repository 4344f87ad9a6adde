//! Faults of an emulated arm.

use super::super::fault::named;
use flip_core::domain::FieldError;
use std::str::FromStr;
use std::time::Duration;

/// One fault. It lasts until faults are cleared, unless stated otherwise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fault {
    /// Half way through the current motion, or the next, the robot's reflex stops it: it answers
    /// with an error, holds still and is latched. Happens once.
    Reflex,
    /// Every connection breaks and no new one is accepted; the dead-man acts.
    CommunicationLoss,
    /// Motions are carried out, but never answered.
    FrozenReply,
    /// Motions are answered late, in wall-clock time.
    SlowReply(Duration),
    /// A shake exceeds the commanded amplitude by this factor, 1 to [`FACTOR_MAX`].
    ShakeTooLarge(f64),
    /// Someone presses the user stop: the current motion stops, every motion is refused and the arm
    /// is latched.
    UserStop,
    /// State streams end and are refused; motions continue.
    StateStreamLost,
    /// The spoon cannot be levelled: an attempt answers with an error and latches the arm.
    LevelFails,
}

/// Largest factor of [`Fault::ShakeTooLarge`].
pub const FACTOR_MAX: f64 = 2.0;

impl Fault {
    /// Each fault once, with harmful values.
    pub const ALL: [Self; 8] = [
        Self::Reflex,
        Self::CommunicationLoss,
        Self::FrozenReply,
        Self::SlowReply(Duration::from_millis(800)),
        Self::ShakeTooLarge(1.3),
        Self::UserStop,
        Self::StateStreamLost,
        Self::LevelFails,
    ];

    /// Name used to select it.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Reflex => "reflex",
            Self::CommunicationLoss => "communication_loss",
            Self::FrozenReply => "frozen_reply",
            Self::SlowReply(_) => "slow_reply",
            Self::ShakeTooLarge(_) => "shake_too_large",
            Self::UserStop => "user_stop",
            Self::StateStreamLost => "state_stream_lost",
            Self::LevelFails => "level_fails",
        }
    }
}

impl FromStr for Fault {
    type Err = FieldError;

    fn from_str(name: &str) -> Result<Self, FieldError> {
        named(Self::ALL, |fault| fault.name(), name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_fault_has_a_name_that_reads_back() {
        for fault in Fault::ALL {
            assert_eq!(fault.name().parse(), Ok(fault));
        }
        assert!(
            "drops_spoon"
                .parse::<Fault>()
                .unwrap_err()
                .message
                .contains("reflex, communication_loss")
        );
    }
}
