//! The balance while nothing is dosed: read, tared or zeroed for whoever asks.

use super::wires::Wires;
use crate::hardware::DeviceError;
use crate::hardware::balance::{Balance, Settings};
use crate::hardware::clock::Clock;
use crate::hardware::wire::{Exchange, Recorder};
use flip_core::domain::bench::Reading;

/// Longest wait for a stable reading before taring or zeroing, s.
const STABLE_MAX_S: f64 = 10.0;

/// What the balance is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// Its display, as it is.
    Show,
    /// Tare the load on it.
    Tare,
    /// Set the zero point.
    Zero,
}

impl Order {
    /// The word for it in messages and records.
    pub fn verb(self) -> &'static str {
        match self {
            Self::Show => "read",
            Self::Tare => "tare",
            Self::Zero => "zero",
        }
    }
}

/// What it showed.
#[derive(Debug, Clone, PartialEq)]
pub struct Shown {
    /// Stable reading before the order, mg; none if only the display was asked for.
    pub before_mg: Option<f64>,
    /// The reading afterwards.
    pub reading: Reading,
    /// Traffic on its wire.
    pub exchanges: Vec<Exchange>,
}

/// Opens the balance, carries out one order, and closes it.
///
/// # Errors
/// A dose or a pile has the devices ([`DeviceError::Forbidden`]); else as the balance. After a
/// failed tare or zero the balance may have carried it out, or may yet.
pub(super) fn order(
    wires: &Wires,
    settings: &Settings,
    noise_mg: f64,
    clock: Clock,
    order: Order,
) -> Result<Shown, DeviceError> {
    let Some(_floor) = wires.floor_if_free() else {
        let cause = "a dose or a pile is being made: ask again when it has ended".to_owned();
        return Err(DeviceError::Forbidden { device: "the balance", cause });
    };
    let recorder = Recorder::default();
    let mut balance = Balance::open(settings, recorder.tap(), clock)?.with_noise_mg(noise_mg);
    let (before_mg, sample) = match order {
        Order::Show => (None, balance.immediate()?),
        Order::Tare => (Some(balance.stable(STABLE_MAX_S)?.mass_mg), balance.tare()?),
        Order::Zero => (Some(balance.stable(STABLE_MAX_S)?.mass_mg), balance.zero()?),
    };
    let reading = Reading { mass_mg: sample.mass_mg, stable: sample.stable };
    Ok(Shown { before_mg, reading, exchanges: recorder.take() })
}
