//! State of an emulated arm, and which calls it accepts when: the contract's table as code.

use super::dead_man::{DeadMan, Unrenewed};
use super::fault::Fault;
use crate::hardware::arm::proto::{self, Executed, Mode, Station};
use std::sync::{Arc, OnceLock};
use std::time::Instant;
use tokio::sync::watch;
use tonic::{Code, Status};

/// A requested motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Asked {
    /// Move over the vial.
    Approach,
    /// Level, and move away from the vial.
    Retract,
    /// Turn to this pitch, deg.
    Pitch(f64),
    /// Shake by this amplitude, mm.
    Shake(f64),
    /// Fill the spoon.
    Scoop,
    /// Empty it.
    Discard,
    /// Turn the platform over the funnel.
    Invert,
}

/// What ended a motion before it was complete.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// Stop was called.
    Stopped,
    /// Renewals stopped.
    DeadMan,
    /// Control was released.
    Released,
    /// The robot's reflex.
    Reflex,
    /// The user stop was pressed.
    UserStop,
    /// The spoon cannot be brought to level.
    LevelFails,
}

impl End {
    /// The latch cause, if this end latches the arm.
    pub(super) fn latch_cause(self) -> Option<&'static str> {
        match self {
            Self::Stopped | Self::Released => None,
            Self::DeadMan => Some("nobody renewed the lease in time"),
            Self::Reflex => Some("the robot's reflex stopped it: look for what it touched"),
            Self::UserStop => Some("the user stop is pressed: release it first"),
            Self::LevelFails => Some("the spoon cannot be brought to level"),
        }
    }

    /// The status with which the motion is answered.
    pub(super) fn status(self) -> Status {
        match self {
            Self::Stopped => Status::aborted("the motion was stopped"),
            Self::Released => Status::aborted("control was given back during the motion"),
            Self::DeadMan => Status::aborted("nobody renewed the lease in time"),
            fault => Status::internal(fault.latch_cause().unwrap_or_default()),
        }
    }
}

/// Ends one motion, once: the first cause counts.
pub type Brake = Arc<OnceLock<End>>;

/// Answer of a motion, once there is one.
pub(super) type Answer = watch::Receiver<Option<Result<Executed, Status>>>;

/// The most recently accepted motion.
pub(super) struct Accepted {
    pub sequence: u64,
    pub asked: Asked,
    pub answer: Answer,
}

/// The current lease.
pub(super) struct Lease {
    pub id: String,
    pub unrenewed: Unrenewed,
    /// Stop was called: this lease can only bring the spoon back.
    pub stopped: bool,
}

/// Pose of the arm, and who may move it.
pub(super) struct Body {
    pub mode: Mode,
    pub station: Station,
    pub pitch_deg: f64,
    pub displacement_mm: f64,
    pub last_shake: Option<Executed>,
    pub lease: Option<Lease>,
    /// Leases granted so far.
    pub leases: u64,
    pub latch: Option<&'static str>,
    pub accepted: Option<Accepted>,
    pub brake: Brake,
    pub faults: Vec<Fault>,
}

impl Body {
    /// Level, retracted and without a lease.
    pub(super) fn new() -> Self {
        Self {
            mode: Mode::Idle,
            station: Station::Retracted,
            pitch_deg: 0.0,
            displacement_mm: 0.0,
            last_shake: None,
            lease: None,
            leases: 0,
            latch: None,
            accepted: None,
            brake: Brake::default(),
            faults: Vec::new(),
        }
    }

    pub(super) fn is_level(&self) -> bool {
        self.pitch_deg == 0.0 && self.displacement_mm == 0.0
    }

    pub(super) fn has(&self, fault: Fault) -> bool {
        self.faults.contains(&fault)
    }

    pub(super) fn is_moving(&self) -> bool {
        matches!(self.mode, Mode::Moving | Mode::Returning)
    }

    /// Hold still and refuse all motion until a person has checked the arm.
    pub(super) fn latch(&mut self, cause: Option<&'static str>) {
        let cause = cause.unwrap_or("the spoon could not be brought back");
        (self.mode, self.lease, self.latch) = (Mode::Latched, None, Some(cause));
    }

    /// Record an accepted motion; returns its brake.
    pub(super) fn begin(&mut self, sequence: u64, asked: Asked, answer: Answer) -> Brake {
        self.accepted = Some(Accepted { sequence, asked, answer });
        (self.mode, self.brake) = (Mode::Moving, Brake::default());
        self.brake.clone()
    }

    /// End the current motion and control, and start bringing the spoon back; returns the brake of
    /// that motion.
    pub(super) fn begin_return(&mut self, end: End) -> Brake {
        // A motion that has already ended keeps its own cause.
        let _ = self.brake.set(end);
        (self.lease, self.mode, self.brake) = (None, Mode::Returning, Brake::default());
        self.brake.clone()
    }

    /// Record that the motion of this brake is over.
    pub(super) fn settle(&mut self, brake: &Brake) {
        // Stop may have let another motion in meanwhile, with another brake.
        if self.mode == Mode::Moving && Arc::ptr_eq(brake, &self.brake) {
            let stopped = self.lease.as_ref().is_some_and(|lease| lease.stopped);
            self.mode = if stopped { Mode::Stopped } else { Mode::Ready };
        }
    }

    /// Grant control to the first client that requests it.
    pub(super) fn acquire(&mut self) -> Result<String, Status> {
        match self.mode {
            Mode::Latched => Err(self.latched()),
            Mode::Idle => {
                self.leases += 1;
                let id = format!("lease {}", self.leases);
                self.lease = Some(Lease {
                    id: id.clone(),
                    unrenewed: Unrenewed::since(Instant::now()),
                    stopped: false,
                });
                (self.mode, self.accepted) = (Mode::Ready, None);
                Ok(id)
            }
            _ => Err(Status::resource_exhausted("somebody else has control of the arm")),
        }
    }

    /// The lease, if `lease_id` has control.
    pub(super) fn held_by(&mut self, lease_id: &str) -> Result<&mut Lease, Status> {
        if self.mode == Mode::Latched {
            return Err(self.latched());
        }
        let ended = || Status::permission_denied("this lease has ended: acquire the arm again");
        self.lease.as_mut().filter(|lease| lease.id == lease_id).ok_or_else(ended)
    }

    /// Whether renewals came too late.
    pub(super) fn is_abandoned(&mut self, dead_man: DeadMan) -> bool {
        self.lease.as_mut().is_some_and(|lease| lease.unrenewed.is_over(dead_man, Instant::now()))
    }

    /// Whether a motion may begin, in the contract's order of checks; for a repeat, the first
    /// answer.
    pub(super) fn judge(
        &mut self,
        arm: &proto::Description,
        lease: &str,
        sequence: u64,
        asked: Asked,
    ) -> Result<Option<Answer>, Status> {
        possible(arm, asked)?;
        self.held_by(lease)?;
        if sequence == 0 {
            return Err(Status::invalid_argument("sequence: must be 1 or more"));
        }
        if let Some(last) = self.accepted.as_ref().filter(|last| sequence <= last.sequence) {
            return match sequence == last.sequence && asked == last.asked {
                true => Ok(Some(last.answer.clone())),
                false => {
                    Err(Status::already_exists("this sequence number was used for another motion"))
                }
            };
        }
        match self.mode {
            Mode::Ready => {}
            Mode::Stopped if asked == Asked::Retract => {}
            Mode::Stopped => {
                return Err(refused("the arm was stopped: retract it, and acquire it again"));
            }
            _ => return Err(refused("another motion is under way")),
        }
        self.in_place(asked).map(|()| None)
    }

    fn in_place(&self, asked: Asked) -> Result<(), Status> {
        let retracted = self.station == Station::Retracted;
        match asked {
            Asked::Retract => Ok(()),
            Asked::Approach
                if self.station == Station::OverVial || (retracted && self.is_level()) =>
            {
                Ok(())
            }
            Asked::Pitch(_) | Asked::Shake(_) if self.station != Station::Between => Ok(()),
            Asked::Scoop | Asked::Discard | Asked::Invert if retracted => Ok(()),
            _ => Err(refused("the spoon is not where this motion begins: retract it first")),
        }
    }

    fn latched(&self) -> Status {
        refused(&format!(
            "the arm is latched, a person must look at it: {}",
            self.latch.unwrap_or("unknown cause")
        ))
    }
}

pub(super) fn refused(why: &str) -> Status {
    Status::new(Code::FailedPrecondition, why)
}

/// Whether this arm can do that, within its limits.
fn possible(arm: &proto::Description, asked: Asked) -> Result<(), Status> {
    let limits = arm.limits.unwrap_or_default();
    let within = |field, value, lower, upper| {
        let bounded = flip_core::domain::bounded(field, value, lower, upper, "");
        bounded.map(drop).map_err(|error| Status::invalid_argument(error.to_string()))
    };
    match asked {
        Asked::Pitch(deg) => within("pitch_deg", deg, limits.pitch_deg_min, limits.pitch_deg_max),
        Asked::Shake(mm) => within("amplitude_mm", mm, 0.0, limits.shake_mm_max),
        Asked::Scoop if !arm.can_scoop => {
            Err(Status::unimplemented("this arm cannot fill its spoon"))
        }
        Asked::Discard if !arm.can_discard => {
            Err(Status::unimplemented("this arm cannot empty its spoon"))
        }
        Asked::Invert if !arm.can_invert => {
            Err(Status::unimplemented("this arm has no platform to invert"))
        }
        _ => Ok(()),
    }
}
