//! What carries out a dose: the simulator, a laboratory emulated around it, or devices.
//!
//! A rig opens its devices for a dose, runs the loop of [`weigh`](crate::weigh) on them, and closes
//! them. Its owner decides what is dosed and when, records the events, and passes on stops.

mod devices;
mod emulated;
mod inbox;
mod poured;
mod pouring;
mod scale;
mod simulated;
mod stand;
mod wires;

pub use devices::Devices;
pub use emulated::Emulated;
pub use inbox::{Awaited, Inbox};
pub use poured::Poured;
pub use pouring::{Pouring, Simulation, Task};
pub use scale::{Order, Shown};
pub use simulated::{Simulated, simulate, simulate_from};
pub use stand::{PileInMaking, PileStand, Piling, Unpiled};

use crate::hardware::DeviceError;
use crate::hardware::wire::Exchange;
use crate::weigh::Event;
use flip_core::domain::bench::BenchKind;
use flip_core::domain::spoon::Spoon;
use flip_core::domain::vial::EmptyVial;
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::sync::atomic::AtomicBool;

/// Called with each event of a dose before the motion that follows; `Break` forbids that motion.
pub type OnEvent<'a> = &'a mut dyn FnMut(&Event<'_>) -> ControlFlow<()>;

/// A bench that carries out whole doses. Doses take turns; everything else may be called from any
/// thread at any time.
///
/// To stop a dose, set its stop flag and then call [`Rig::halt`].
pub trait Rig: Send + Sync {
    /// What is behind it.
    fn kind(&self) -> BenchKind;

    /// Whether it puts an empty vial in place for each dose. If not, a person must, and must have
    /// confirmed it before [`Rig::pour`].
    fn exchanges_vials(&self) -> bool;

    /// Carries out one dose. `stop` is read before every motion.
    ///
    /// On return the spoon is level and retracted, or [`Poured::must_look`] says why a person must
    /// check.
    fn pour(&self, pouring: &Pouring, on_event: OnEvent<'_>, stop: &AtomicBool) -> Poured;

    /// Stops the arm over a connection of its own, without waiting for the dose: returns once the
    /// command has been sent, at once if nothing is open. Ends a pile in the making, too.
    ///
    /// # Errors
    /// The arm cannot be reached: its dead-man acts.
    fn halt(&self) -> Result<(), DeviceError>;

    /// Devices by role, as they identified themselves when last open.
    fn devices(&self) -> BTreeMap<String, String> {
        BTreeMap::new()
    }

    /// Takes the wire traffic of doses since the last call.
    fn exchanges(&self) -> Vec<Exchange> {
        Vec::new()
    }

    /// Why the arm is latched, if it is.
    ///
    /// # Errors
    /// The arm cannot be reached.
    fn arm_latch(&self) -> Result<Option<String>, DeviceError> {
        Ok(None)
    }

    /// Lets a latched arm move again, after this person has checked it: it levels and retracts the
    /// spoon.
    ///
    /// # Errors
    /// The arm cannot be reached, the cause of the latch persists, or it was stopped on its way.
    fn recover(&self, _person: &str) -> Result<(), DeviceError> {
        Ok(())
    }

    /// The spoon that it doses with.
    fn spoon(&self) -> Spoon {
        Spoon::default()
    }

    /// Whether it fills the spoon by itself, during a dose too; for devices, as far as the bench file
    /// says.
    fn fills_spoon(&self) -> bool {
        false
    }

    /// Mass of an empty vial, where known.
    fn empty_vial(&self) -> Option<EmptyVial> {
        None
    }

    /// Readability (display step) of the balance, mg, where known in advance.
    fn readability_mg(&self) -> Option<f64> {
        None
    }

    /// Reads, tares or zeroes the balance while nothing is dosed.
    ///
    /// # Errors
    /// There is no balance between doses ([`DeviceError::Unsupported`]), a dose or a pile has the
    /// devices ([`DeviceError::Forbidden`]), or the balance failed; it may then have tared.
    fn balance(&self, _order: Order) -> Result<Shown, DeviceError> {
        let cause = "it exists only while a dose is simulated".to_owned();
        Err(DeviceError::Unsupported { device: "the simulated balance", cause })
    }

    /// Whether earlier doses of a powder may inform the forecast; not where a dose must follow from
    /// its seed alone.
    fn remembers(&self) -> bool {
        false
    }

    /// The stand on which it makes piles for an angle of repose.
    fn stand(&self) -> Option<&PileStand> {
        None
    }
}

#[cfg(test)]
mod tests;
