//! The devices of a bench file.

use super::wires::Wires;
use super::{OnEvent, Order, PileStand, Poured, Pouring, Rig, Shown, scale};
use crate::hardware::DeviceError;
use crate::hardware::arm::proto::Mode;
use crate::hardware::arm::{Arm, Deadlines};
use crate::hardware::balance::StableBy;
use crate::hardware::bench_file::BenchFile;
use crate::hardware::clock::Clock;
use crate::hardware::station::Station;
use crate::hardware::wire::{Exchange, Tap};
use crate::weigh::{Settings, weigh};
use flip_core::domain::bench::BenchKind;
use flip_core::domain::spoon::{FilledBy, Spoon};
use flip_core::domain::vial::EmptyVial;
use flip_core::domain::weighing::Outcome;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

/// Maximum length of a latch cause that is passed on, characters.
const CAUSE_MAX: usize = 200;
/// How long to wait for an arm under another client's control before querying its latch.
const ABANDONED_MAX: Duration = Duration::from_secs(10);
/// How often it is polled meanwhile.
const LOOK_AGAIN: Duration = Duration::from_millis(20);

/// The devices of one bench file, opened for each dose.
pub struct Devices {
    file: BenchFile,
    clock: Clock,
    wires: Arc<Wires>,
    stand: PileStand,
}

impl Devices {
    /// The devices of this file, in wall-clock time.
    pub fn new(file: BenchFile) -> Self {
        Self::with_clock(file, Clock::wall())
    }

    /// The same with another clock: that of an emulated laboratory with its own time.
    pub fn with_clock(file: BenchFile, clock: Clock) -> Self {
        let wires = Arc::<Wires>::default();
        let stand = PileStand::of_devices(file.clone(), wires.clone());
        Self { file, clock, wires, stand }
    }
}

impl Rig for Devices {
    fn kind(&self) -> BenchKind {
        BenchKind::Devices
    }

    fn exchanges_vials(&self) -> bool {
        false
    }

    fn pour(&self, pouring: &Pouring, on_event: OnEvent<'_>, stop: &AtomicBool) -> Poured {
        dose(&self.wires, &self.file, self.clock.clone(), pouring, on_event, stop)
    }

    fn halt(&self) -> Result<(), DeviceError> {
        self.wires.halt()
    }

    fn devices(&self) -> BTreeMap<String, String> {
        self.wires.devices()
    }

    fn exchanges(&self) -> Vec<Exchange> {
        self.wires.recorder.take()
    }

    /// An arm whose client has gone, as after a restart, first retracts its spoon and then latches
    /// itself: this waits for it, unless it is this process that moves it.
    fn arm_latch(&self) -> Result<Option<String>, DeviceError> {
        let (url, tap) = (&self.file.arm.url, self.wires.recorder.tap());
        let arm = Arm::connect(url, tap.clone(), Deadlines::default())?;
        let until = Instant::now() + ABANDONED_MAX;
        let is_controlled =
            || arm.state().is_ok_and(|state| !matches!(state.mode(), Mode::Idle | Mode::Latched));
        while !self.wires.is_open() && is_controlled() && Instant::now() < until {
            std::thread::sleep(LOOK_AGAIN);
        }
        latch_cause(url, tap)
    }

    fn recover(&self, person: &str) -> Result<(), DeviceError> {
        let arm = &self.file.arm;
        Arm::connect(&arm.url, self.wires.recorder.tap(), arm.deadlines())?.recover(person)
    }

    fn spoon(&self) -> Spoon {
        self.file.spoon
    }

    fn fills_spoon(&self) -> bool {
        self.file.spoon.filled_by == FilledBy::Arm
    }

    fn empty_vial(&self) -> Option<EmptyVial> {
        self.file.vial
    }

    fn readability_mg(&self) -> Option<f64> {
        self.file.balance.readability_mg
    }

    fn balance(&self, order: Order) -> Result<Shown, DeviceError> {
        let (balance, noise_mg) = (&self.file.balance, self.file.readings.noise_mg);
        scale::order(&self.wires, balance, noise_mg, self.clock.clone(), order)
    }

    fn remembers(&self) -> bool {
        true
    }

    fn stand(&self) -> Option<&PileStand> {
        Some(&self.stand)
    }
}

/// Opens the devices, weighs, closes them.
pub(super) fn dose(
    wires: &Wires,
    file: &BenchFile,
    clock: Clock,
    pouring: &Pouring,
    on_event: OnEvent<'_>,
    stop: &AtomicBool,
) -> Poured {
    let _floor = wires.floor();
    let tap = wires.recorder.tap();
    let opened =
        Station::open(file, pouring.shakes.clone(), clock, &tap).and_then(|mut station| {
            wires.opened(station.devices()?, station.stopper()?);
            Ok(station)
        });
    let mut station = match opened {
        Ok(station) => station,
        // Nothing moved; but a latched arm must be checked by a person.
        Err(error) => {
            let poured = Poured::not_begun(error.to_string());
            return latched_or(poured, latch_cause(&file.arm.url, tap));
        }
    };
    let (task, stroke) = (&pouring.task, Some(station.stroke()));
    let (accuracy, expected, readings) = (task.accuracy, pouring.expected, file.readings);
    let (life_s, rest_max_s, pan) = (readings.life_s, readings.stand_max_s, pouring.pan);
    let spoon_mg = pouring.spoon_mg;
    let settings = Settings {
        accuracy,
        forecast: Some(expected.forecast),
        life_s,
        rest_max_s,
        pan,
        hangs: expected.hangs,
        silent_share: expected.silent_share,
        onset_deg: expected.onset_deg,
        spoon_mg,
        probe: pouring.probe,
        ..Settings::for_target(task.order.target_mg, spoon_mg)
    };
    let weighed =
        weigh(&mut station, &task.controller, &task.rules, &task.order, &settings, on_event, stop);
    wires.closed();
    let went_well =
        !weighed.must_look && !matches!(weighed.outcome, Outcome::Aborted | Outcome::Stopped);
    let mut poured = Poured { stroke, ..Poured::of(weighed, None) };
    // For a balance that flags nothing, FLIP's own stability window decides: the balance itself
    // reported nothing.
    if let Some(measured) =
        poured.measured.as_mut().filter(|_| file.balance.stable_by == StableBy::Window)
    {
        measured.stable_by_balance = false;
    }
    match went_well {
        true => poured,
        false => latched_or(poured, latch_cause(&file.arm.url, tap)),
    }
}

fn latched_or(poured: Poured, latch: Result<Option<String>, DeviceError>) -> Poured {
    match latch {
        Ok(Some(cause)) => poured.with_latch(&cause),
        _ => poured,
    }
}

/// Why the arm reports that it is latched, if it is.
fn latch_cause(url: &str, tap: Tap) -> Result<Option<String>, DeviceError> {
    let arm = Arm::connect(url, tap, Deadlines::default())?;
    let cause: String =
        arm.description().latch_cause.chars().filter(|c| !c.is_control()).take(CAUSE_MAX).collect();
    Ok(Some(cause).filter(|cause| !cause.is_empty()))
}
