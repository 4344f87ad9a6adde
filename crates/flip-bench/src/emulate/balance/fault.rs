//! Faults of an emulated balance.

use super::super::fault::named;
use flip_core::domain::FieldError;
use serde::{Deserialize, Serialize};

/// A fault. Each variant states what happens and how a driver must respond.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Fault {
    /// The reading creeps by 0.05 mg a second, flagged stable: users of readings must compare them
    /// over time.
    Drift,
    /// Air moves: readings scatter by 5 mg and are never flagged stable. The driver must not invent
    /// a stable reading.
    Draught,
    /// Each reply comes after a line printed before the request, and before one printed after it.
    /// The old line must not be taken for the reply, nor either of them for the reply to a later
    /// request.
    AutoPrint,
    /// Replies break off in the middle, without a terminator: no number must be read from the
    /// fragment.
    PartialLine,
    /// One byte of each reply is damaged or, in every other one, lost: no other number must be read
    /// from it.
    GarbledLine,
    /// Nothing is received and nothing is sent: the driver must give up in time.
    Silence,
    /// The plug is pulled: the driver must report it, and must not reconnect by itself.
    Unplug,
    /// Replies are late by wall-clock time, and stale by then: once given up, they must not be
    /// taken for the reply to a later request.
    SlowReply,
    /// Someone switched the unit to ounces at the keypad: a number in ounces is no number of mg.
    UnitSwitched,
    /// Someone pressed the tare key, once: the reading falls to zero. The driver cannot tell; the
    /// weighing loop sees the reading fall.
    KeypadTare,
    /// Someone lifts the vial: the reading falls by the whole load on the pan. The weighing must
    /// stop.
    VialLifted,
    /// The balance reports overload: no number.
    Overload,
    /// The balance reports underload: no number.
    Underload,
    /// The balance is busy: polled for a while, then refused.
    NotReady,
    /// The balance is adjusting itself: no number until a person has checked it. Where the dialect
    /// cannot report this, it looks like [`Self::NotReady`].
    Adjusting,
    /// The reading stays constant, flagged stable, whatever lands on the pan. The driver cannot
    /// tell; the weighing loop sees no response to a shake.
    Stuck,
    /// `NaN` in place of the number: damaged, not a number to calculate with.
    NotANumber,
    /// Mains power fails briefly, once: nothing is received or sent for a tenth of a second of
    /// bench time; then the balance sends its serial number unsolicited where its dialect does, has
    /// lost the tare, and shows 2 mg for any load on the pan. The tare is lost, and a driver that
    /// notices must report it.
    Restart,
    /// One digit of each number is replaced by another. Frames carry no checksum, so the driver
    /// cannot tell; the weighing loop compares readings with one another.
    WrongDigit,
}

impl Fault {
    /// Every fault.
    pub const ALL: [Self; 19] = [
        Self::Drift,
        Self::Draught,
        Self::AutoPrint,
        Self::PartialLine,
        Self::GarbledLine,
        Self::Silence,
        Self::Unplug,
        Self::SlowReply,
        Self::UnitSwitched,
        Self::KeypadTare,
        Self::VialLifted,
        Self::Overload,
        Self::Underload,
        Self::NotReady,
        Self::Adjusting,
        Self::Stuck,
        Self::NotANumber,
        Self::Restart,
        Self::WrongDigit,
    ];

    /// Name used on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Drift => "drift",
            Self::Draught => "draught",
            Self::AutoPrint => "auto-print",
            Self::PartialLine => "partial-line",
            Self::GarbledLine => "garbled-line",
            Self::Silence => "silence",
            Self::Unplug => "unplug",
            Self::SlowReply => "slow-reply",
            Self::UnitSwitched => "unit-switched",
            Self::KeypadTare => "keypad-tare",
            Self::VialLifted => "vial-lifted",
            Self::Overload => "overload",
            Self::Underload => "underload",
            Self::NotReady => "not-ready",
            Self::Adjusting => "adjusting",
            Self::Stuck => "stuck",
            Self::NotANumber => "not-a-number",
            Self::Restart => "restart",
            Self::WrongDigit => "wrong-digit",
        }
    }
}

impl std::str::FromStr for Fault {
    type Err = FieldError;

    fn from_str(name: &str) -> Result<Self, FieldError> {
        named(Self::ALL, Self::name, name)
    }
}

/// Active faults, each forever or for a number of replies.
#[derive(Debug, Default)]
pub(super) struct Faults(Vec<(Fault, Option<u32>)>);

impl Faults {
    pub(super) fn add(&mut self, fault: Fault, answers: Option<u32>) {
        self.0.retain(|(present, _)| *present != fault);
        self.0.push((fault, answers));
    }

    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    pub(super) fn has(&self, fault: Fault) -> bool {
        self.0.iter().any(|(present, _)| *present == fault)
    }

    /// Count one reply, sent or withheld.
    pub(super) fn count_answer(&mut self) {
        for (_, left) in &mut self.0 {
            *left = left.map(|left| left.saturating_sub(1));
        }
        self.0.retain(|(_, left)| *left != Some(0));
    }
}
