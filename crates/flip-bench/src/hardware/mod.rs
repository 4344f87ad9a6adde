//! What a bench is to the weighing loop, and the benches there are.

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

/// A balance under a spoon on an arm. Every call returns when the motion or the reading is complete.
pub trait Bench {
    /// Fill the spoon, shake off what does not hold, and bring it level over the vial.
    ///
    /// # Errors
    /// A device failed or may not move.
    fn approach(&mut self) -> Result<(), DeviceError>;

    /// Set the balance to zero with the vial on it; returns what the vial weighs.
    ///
    /// # Errors
    /// A device failed.
    fn tare(&mut self) -> Result<Tare, DeviceError>;

    /// A fresh reading, taken when the balance has settled or its time is up: `stable` says which.
    ///
    /// # Errors
    /// A device failed.
    fn read(&mut self) -> Result<Reading, DeviceError>;

    /// Watch the balance for this long with nothing moving: where it stands, whether it is still, and how it drifts.
    ///
    /// # Errors
    /// A device failed.
    fn stand(&mut self, seconds: f64) -> Result<Standing, DeviceError>;

    /// What the display shows from now on for this long, s, with nothing moving; at least one reading.
    ///
    /// # Errors
    /// A device failed.
    fn readings(&mut self, seconds: f64) -> Result<Vec<Moment>, DeviceError>;

    /// The balance is the one that was tared, and has weighed without a break since.
    ///
    /// # Errors
    /// It is not, or does not say: what it shows is no net mass.
    fn is_the_same(&mut self) -> Result<(), DeviceError>;

    /// When the display last showed another number than just before, bench time, s: it lived then. Infinity: it always lives.
    fn lived_s(&self) -> f64;

    /// Watch the display with nothing moving until it shows another number, for at most this long, s; whether it did.
    ///
    /// # Errors
    /// A device failed.
    fn watch_for_life(&mut self, seconds: f64) -> Result<bool, DeviceError>;

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

    /// Take the spoon away from the vial; it must be level.
    ///
    /// # Errors
    /// The arm failed: a person must look.
    fn retract(&mut self) -> Result<(), DeviceError>;

    /// Return what is left in the spoon to the powder's container.
    ///
    /// # Errors
    /// The arm failed: a person must look.
    fn discard(&mut self) -> Result<(), DeviceError>;

    /// What the arm can do: a dose keeps within it.
    fn reach(&self) -> Reach {
        Reach::FULL
    }

    /// Pitch of the spoon now, degrees, positive is tip down.
    fn pitch_deg(&self) -> f64;

    /// Bench time since the bench was made, s: in simulation that of the simulated motions.
    fn elapsed_s(&self) -> f64;
}
