//! What an emulated balance can be made to do wrong.

use flip_core::domain::FieldError;
use serde::{Deserialize, Serialize};

/// A misbehaviour. Each says what happens and what a driver must make of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Fault {
    /// The reading creeps by 0.05 mg a second, flagged stable: whoever uses readings must compare them over time.
    Drift,
    /// Air moves: readings scatter by 5 mg and are never flagged stable. A stable reading must not be made up.
    Draught,
    /// Each answer comes behind a line that was printed before the question, and in front of one that was printed after it. The old line must not be taken
    /// for the answer, nor either of them for the answer to a later question.
    AutoPrint,
    /// Answers break off in the middle, without an end: no number must be read from the piece.
    PartialLine,
    /// One byte of each answer is damaged or, in every other one, lost: no other number must be read from it.
    GarbledLine,
    /// Nothing is heard and nothing is said: the driver must give up in time.
    Silence,
    /// The plug is pulled: the driver must say so, and must not reconnect by itself.
    Unplug,
    /// Answers come late by the room's clock and are old by then: given up, they must not be taken for the answer to a later question.
    SlowReply,
    /// Somebody switched the unit to ounces at the keypad: a number in ounces is no number of mg.
    UnitSwitched,
    /// Somebody pressed the tare key, once: the reading falls to zero. The driver cannot tell; whoever weighs sees the reading fall.
    KeypadTare,
    /// Somebody lifts the vial: the reading falls by all that lies on the pan. Whoever weighs must stop.
    VialLifted,
    /// The balance reports overload: no number.
    Overload,
    /// The balance reports underload: no number.
    Underload,
    /// The balance is busy: asked again for a while, then refused.
    NotReady,
    /// The balance adjusts itself: no number until a person has looked. Where the dialect cannot tell, it looks like [`Self::NotReady`].
    Adjusting,
    /// The reading stays what it is, flagged stable, whatever lands on the pan. The driver cannot tell; whoever weighs sees no response to a shake.
    Stuck,
    /// `NaN` stands where the number should: damaged, not a number to calculate with.
    NotANumber,
    /// The mains fail for a moment, once: nothing is heard and said for a tenth of a second of bench time, then the balance tells its serial number unasked where its
    /// dialect does, has forgotten the tare, and shows 2 mg for whatever lies on the pan. What was tared is lost, and a driver that hears it must say so.
    Restart,
    /// One digit of each number is another digit. Frames carry no checksum: the driver cannot tell; whoever weighs compares readings with one another.
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

    /// As the command line names it.
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
        Self::ALL.into_iter().find(|fault| fault.name() == name).ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            FieldError::new("fault", format!("must be one of {names}, got {name}"))
        })
    }
}

/// The faults that are on, each for ever or for so many answers.
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

    /// One answer has been given, or withheld.
    pub(super) fn count_answer(&mut self) {
        for (_, left) in &mut self.0 {
            *left = left.map(|left| left.saturating_sub(1));
        }
        self.0.retain(|(_, left)| *left != Some(0));
    }
}
