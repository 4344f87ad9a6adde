//! The bench as seen by the weighing loop, and its implementations.

pub mod arm;
pub mod balance;
pub mod bench_file;
pub mod camera;
pub mod clock;
pub mod conformance;
pub mod gate;
pub mod gripper;
pub mod line;
pub mod settle;
pub mod shake_calibration;
pub mod simulated;
pub mod stand;
pub mod station;
pub mod waypoints;
pub mod wire;

mod error;

pub use error::DeviceError;

use flip_core::domain::bench::{Action, Moment, Reach, Reading, Standing, Tare};

/// A balance under a spoon on an arm. Every call returns when the motion or the reading is
/// complete.
pub trait Bench {
    /// Fill the spoon, shake off the surplus, and bring it level over the vial.
    ///
    /// # Errors
    /// A device failed or may not move.
    fn approach(&mut self) -> Result<(), DeviceError>;

    /// Set the balance to zero with the vial on it; returns the mass of the vial.
    ///
    /// # Errors
    /// A device failed.
    fn tare(&mut self) -> Result<Tare, DeviceError>;

    /// Take a fresh reading, once the balance has settled or its time is up; `stable` tells which.
    ///
    /// # Errors
    /// A device failed.
    fn read(&mut self) -> Result<Reading, DeviceError>;

    /// Watch the balance for this long with nothing moving: its level, whether it is still, and its
    /// drift.
    ///
    /// # Errors
    /// A device failed.
    fn stand(&mut self, seconds: f64) -> Result<Standing, DeviceError>;

    /// Read the display from now on for this long, s, with nothing moving; at least one reading.
    ///
    /// # Errors
    /// A device failed.
    fn readings(&mut self, seconds: f64) -> Result<Vec<Moment>, DeviceError>;

    /// Check that the balance is the one that was tared, and has run without a break since.
    ///
    /// # Errors
    /// It is not, or does not report it: the display shows no net mass.
    fn is_the_same(&mut self) -> Result<(), DeviceError>;

    /// When the display last changed, bench time, s: proof that it was alive then. Infinity: it is
    /// always alive.
    fn lived_s(&self) -> f64;

    /// Watch the display with nothing moving until it changes, for at most this long, s; returns
    /// whether it did.
    ///
    /// # Errors
    /// A device failed.
    fn watch_for_life(&mut self, seconds: f64) -> Result<bool, DeviceError>;

    /// Carry out one action: incline, then shake.
    ///
    /// # Errors
    /// A device failed; the spoon may be anywhere.
    fn act(&mut self, action: Action) -> Result<(), DeviceError>;

    /// Level the spoon, whatever happened before.
    ///
    /// # Errors
    /// The arm failed: a person must check it.
    fn level(&mut self) -> Result<(), DeviceError>;

    /// Take the spoon away from the vial; it must be level.
    ///
    /// # Errors
    /// The arm failed: a person must check it.
    fn retract(&mut self) -> Result<(), DeviceError>;

    /// Return the powder left in the spoon to its container.
    ///
    /// # Errors
    /// The arm failed: a person must check it.
    fn discard(&mut self) -> Result<(), DeviceError>;

    /// Whether [`Bench::refill`] can fill the spoon anew during a dose.
    fn can_refill(&self) -> bool {
        false
    }

    /// Level the spoon, take it away from the vial, return what is left in it, fill it anew, and
    /// bring it level over the vial. The vial stays on the balance, which is not tared.
    ///
    /// # Errors
    /// A device failed or may not move.
    fn refill(&mut self) -> Result<(), DeviceError> {
        self.level()?;
        self.retract()?;
        self.discard()?;
        self.approach()
    }

    /// The arm's range; a dose stays within it.
    fn reach(&self) -> Reach {
        Reach::FULL
    }

    /// Current pitch of the spoon, degrees, positive is tip down.
    fn pitch_deg(&self) -> f64;

    /// Bench time since the bench was created, s; in simulation, the time of the simulated motions.
    fn elapsed_s(&self) -> f64;
}
