//! What outlives the dose or pile for which devices were opened.

use crate::hardware::DeviceError;
use crate::hardware::arm::Stopper;
use crate::hardware::wire::Recorder;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError, TryLockError};

/// The connections of a rig.
#[derive(Default)]
pub(super) struct Wires {
    /// Traffic of doses.
    pub recorder: Recorder,
    stopper: Mutex<Option<Stopper>>,
    devices: Mutex<BTreeMap<String, String>>,
    /// Held while devices move: doses and piles take turns.
    floor: Mutex<()>,
    /// Stop was requested since the floor was taken.
    halted: AtomicBool,
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Wires {
    /// Waits for its turn. From now on a stop applies to the holder, even while devices are being
    /// opened, which takes seconds.
    pub fn floor(&self) -> MutexGuard<'_, ()> {
        let floor = locked(&self.floor);
        self.halted.store(false, Ordering::SeqCst);
        floor
    }

    /// Takes the floor if nobody has it. What holds it moves nothing, so that a stop is not for it.
    pub fn floor_if_free(&self) -> Option<MutexGuard<'_, ()>> {
        match self.floor.try_lock() {
            Ok(floor) => Some(floor),
            Err(TryLockError::Poisoned(poisoned)) => Some(poisoned.into_inner()),
            Err(TryLockError::WouldBlock) => None,
        }
    }

    /// Devices are open.
    pub fn opened(&self, devices: BTreeMap<String, String>, stopper: Stopper) {
        *locked(&self.devices) = devices;
        *locked(&self.stopper) = Some(stopper);
    }

    /// Whether this process is moving devices.
    pub fn is_open(&self) -> bool {
        locked(&self.stopper).is_some()
    }

    /// Nothing moves any longer.
    pub fn closed(&self) {
        *locked(&self.stopper) = None;
    }

    /// Stops the holder of the floor; does not wait for it.
    pub fn halt(&self) -> Result<(), DeviceError> {
        self.halted.store(true, Ordering::SeqCst);
        let stopper = locked(&self.stopper).clone();
        stopper.map_or(Ok(()), |stopper| stopper.stop("stop was pressed"))
    }

    /// Whether stop was requested since the floor was taken.
    pub fn was_halted(&self) -> bool {
        self.halted.load(Ordering::SeqCst)
    }

    /// Devices by role, as they identified themselves when last open.
    pub fn devices(&self) -> BTreeMap<String, String> {
        locked(&self.devices).clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_is_for_whoever_has_the_floor_also_before_the_devices_are_open() {
        let wires = Wires::default();
        let floor = wires.floor();
        wires.halt().unwrap();
        assert!(wires.was_halted());
        wires.closed();
        drop(floor);
        assert!(wires.was_halted(), "nobody else has begun");
        let _next = wires.floor();
        assert!(!wires.was_halted());
    }
}
