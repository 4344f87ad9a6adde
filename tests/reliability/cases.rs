//! The list of faults and their moments: data, so that a run can be counted and a case named.

use flip_bench::emulate::{arm, balance, gripper};
use flip_core::domain::seed::derive;
use std::fmt;
use std::time::Duration;

/// Answers spoiled by a passing fault of the balance.
const FEW: u32 = 5;
/// A shake that exceeds the commanded one as far as the emulator allows.
const WILD: f64 = 2.0;
/// Late answers of the arm: within its deadline, and beyond it.
const LATE: Duration = Duration::from_millis(150);
const TOO_LATE: Duration = Duration::from_millis(2500);

/// A fault of one device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fault {
    Balance(balance::Fault),
    Arm(arm::Fault),
    Gripper(gripper::Fault),
}

/// The moment of a weighing at which it begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum When {
    /// Before the devices are opened.
    Opening,
    /// The balance is being watched before anything moves.
    StandBefore,
    Scoop,
    Approach,
    Tare,
    FirstRead,
    /// With the command to incline; early is before the first shake, late when six tenths of the
    /// target lie in the vial.
    Incline(Course),
    /// With the command to shake.
    Shake(Course),
    /// The spoon is shaking: its powder has come loose and is about to fall.
    Pouring(Course),
    /// With the first query to the balance after a shake.
    Read(Course),
    Level,
    Retract,
    FinalStand,
    Discard,
    /// Control of the arm is being given back.
    Release,
}

/// How far the dose has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Course {
    Early,
    Late,
}

impl When {
    pub const ALL: [Self; 19] = [
        Self::Opening,
        Self::StandBefore,
        Self::Scoop,
        Self::Approach,
        Self::Tare,
        Self::FirstRead,
        Self::Incline(Course::Early),
        Self::Shake(Course::Early),
        Self::Pouring(Course::Early),
        Self::Read(Course::Early),
        Self::Incline(Course::Late),
        Self::Shake(Course::Late),
        Self::Pouring(Course::Late),
        Self::Read(Course::Late),
        Self::Level,
        Self::Retract,
        Self::FinalStand,
        Self::Discard,
        Self::Release,
    ];
}

/// One case.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Case {
    pub fault: Fault,
    pub when: When,
    /// It lasts to the end; otherwise it passes after few messages.
    pub lasting: bool,
}

impl Fault {
    /// Every fault of every device that a weighing uses.
    pub fn all() -> Vec<Self> {
        let arm = arm::Fault::ALL.into_iter().map(|fault| match fault {
            arm::Fault::SlowReply(_) => arm::Fault::SlowReply(LATE),
            fault => fault,
        });
        let harder = [arm::Fault::SlowReply(TOO_LATE), arm::Fault::ShakeTooLarge(WILD)];
        balance::Fault::ALL
            .map(Self::Balance)
            .into_iter()
            .chain(arm.chain(harder).map(Self::Arm))
            .chain(gripper::Fault::ALL.map(Self::Gripper))
            .collect()
    }

    /// The device, as messages name it.
    pub fn device(self) -> &'static str {
        match self {
            Self::Balance(_) => "the balance",
            Self::Arm(_) => "the arm",
            Self::Gripper(_) => "the gripper",
        }
    }

    pub fn name(self) -> String {
        match self {
            Self::Balance(fault) => fault.name().to_owned(),
            Self::Arm(arm::Fault::SlowReply(late)) => {
                format!("slow_reply of {} ms", late.as_millis())
            }
            Self::Arm(arm::Fault::ShakeTooLarge(factor)) => format!("shake_too_large by {factor}"),
            Self::Arm(fault) => fault.name().to_owned(),
            Self::Gripper(fault) => fault.name().to_owned(),
        }
    }

    /// It happens at once and only a person ends it, or a passing version has no meaning.
    fn happens_once(self) -> bool {
        use {balance::Fault as B, gripper::Fault as G};
        match self {
            Self::Balance(fault) => matches!(fault, B::Unplug | B::KeypadTare | B::Restart),
            Self::Arm(fault) => fault == arm::Fault::Reflex,
            Self::Gripper(fault) => matches!(fault, G::Unplug | G::FaultCode | G::DroppedSpoon),
        }
    }

    /// Answers it spoils if it passes.
    pub fn answers(self) -> u32 {
        use balance::Fault as B;
        match self {
            Self::Balance(
                B::Drift | B::Draught | B::Stuck | B::NotReady | B::Adjusting | B::VialLifted,
            ) => FEW,
            _ => 1,
        }
    }

    /// Most that the dose may exceed target and tolerance, mg, if no message shows this fault;
    /// `None`: it shows, so not at all.
    ///
    /// | fault | why nobody can see it | what bounds the harm |
    /// |---|---|---|
    /// | drift | it creeps slower than powder falls, upwards: the dose is short | what crept until the tare and ended after it |
    /// | keypad-tare | below 3 mg it looks like a reading that is restless | the guard's 3 mg for a reading that falls |
    /// | shake-too-large | it is known when it has been made | one shake; then the forecast knows |
    /// | wrong-digit | frames carry no checksum | readings that disagree are no reading: nothing, or 3 mg where two agree by chance |
    /// | dropped-spoon | the gripper is asked before a dose, not within it | the balance feels what fell |
    pub fn unseen_mg(self) -> Option<f64> {
        use {balance::Fault as B, gripper::Fault as G};
        match self {
            Self::Balance(B::Drift) => Some(1.0),
            Self::Balance(B::KeypadTare | B::WrongDigit) => Some(3.0),
            Self::Arm(arm::Fault::ShakeTooLarge(_)) => Some(10.0),
            Self::Gripper(G::DroppedSpoon) => Some(0.0),
            _ => None,
        }
    }
}

impl Case {
    /// Every case.
    pub fn all() -> Vec<Self> {
        let mut cases = Vec::new();
        for fault in Fault::all() {
            for when in When::ALL {
                for lasting in [true, false] {
                    if lasting || !fault.happens_once() {
                        cases.push(Self { fault, when, lasting });
                    }
                }
            }
        }
        cases
    }

    /// The balance is switched on again.
    pub fn is_restart(&self) -> bool {
        self.fault == Fault::Balance(balance::Fault::Restart)
    }

    /// A number derived from the case itself, regardless of its place in the list.
    pub fn hash(&self) -> u64 {
        self.to_string().bytes().fold(0, |hash, byte| derive(hash, &[byte.into()]))
    }
}

impl fmt::Display for Case {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let lasts = if self.lasting { "lasting" } else { "passing" };
        write!(f, "{} {} at {:?}, {lasts}", self.fault.device(), self.fault.name(), self.when)
    }
}
