//! The apparatus that carries out a weighing: the simulator itself, a laboratory emulated around
//! it, or real devices.

use super::stand::{self, PileStand};
use flip_bench::emulate::arm::GrainsSpoon;
use flip_bench::emulate::lab::{self, Laboratory};
use flip_bench::hardware::DeviceError;
use flip_bench::hardware::arm::proto::Mode;
use flip_bench::hardware::arm::{Arm, Deadlines, Stopper};
use flip_bench::hardware::balance::StableBy;
use flip_bench::hardware::bench_file::BenchFile;
use flip_bench::hardware::clock::Clock;
use flip_bench::hardware::simulated::SimulatedBench;
use flip_bench::hardware::station::Station;
use flip_bench::hardware::wire::{Exchange, Tap};
use flip_bench::weigh::forecast::Forecast;
use flip_bench::weigh::{self, Accuracy, Event, Order, Settings, Weighed, weigh};
use flip_core::domain::bench::{BenchKind, Tick};
use flip_core::domain::bench_check::ShakeCalibration;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::spoon::Spoon;
use flip_core::domain::vial::{EmptyVial, PanCheck};
use flip_core::domain::weighing::{MeasuredMass, Outcome};
use flip_policy::{Controller, Rules};
use flip_sim::{balance, dispense};
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Maximum length of a latch cause that is passed on, characters.
const CAUSE_MAX: usize = 200;
/// How long to wait for an arm under another client's control before querying its latch.
const ABANDONED_MAX: Duration = Duration::from_secs(10);
/// How often it is polled meanwhile.
const LOOK_AGAIN: Duration = Duration::from_millis(20);

/// Everything that a weighing needs.
#[derive(Debug, Clone)]
pub struct Pouring {
    /// The ordered dose.
    pub order: Order,
    /// Known accuracy of the balance, and how accurate the mass must be.
    pub accuracy: Accuracy,
    /// The controller that chooses the actions.
    pub controller: Controller,
    /// The rules that the controller was made for.
    pub rules: Rules,
    /// The simulated balance.
    pub balance: balance::Settings,
    /// The simulated spoon; its pitch range is that of the rules.
    pub spoon: dispense::Settings,
    /// The simulated powder on the bench.
    pub set: ParameterSet,
    /// The arm's actual shakes against the commanded ones, if measured.
    pub shakes: Option<ShakeCalibration>,
    /// Predicted behaviour of the powder.
    pub forecast: Forecast,
    /// Seed of the simulated powder.
    pub seed: u64,
    /// The check of the display before anything moves.
    pub pan: PanCheck,
}

impl Pouring {
    /// Smallest net mass that may be weighed at the requested accuracy, mg.
    pub fn minimum_mg(&self) -> f64 {
        let s = weigh::repeatability_mg(&self.accuracy, self.order.readability_mg);
        weigh::minimum_weight_mg(s, self.accuracy.class_pct / 100.0)
    }

    fn powder(&self) -> dispense::Settings {
        dispense::Settings { pitch: self.rules.pitch, ..self.spoon }
    }
}

/// How a pour ended.
#[derive(Debug, Clone, PartialEq)]
pub struct Poured {
    /// Outcome.
    pub outcome: Outcome,
    /// True mass in the vial, mg; unknown on devices.
    pub dispensed_mg: Option<f64>,
    /// Final reading, mg; none if the dose was aborted or there was no reading once everything was
    /// at rest.
    pub reading_mg: Option<f64>,
    /// Further measurement data for that reading.
    pub measured: Option<MeasuredMass>,
    /// Number of shakes.
    pub shakes: u32,
    /// Bench time, s.
    pub seconds: f64,
    /// Actions and readings, in order.
    pub ticks: Vec<Tick>,
    /// Why it ended as it did, if that needs explaining.
    pub error: Option<String>,
    /// Why a person must check the bench before anything moves again.
    pub must_look: Option<String>,
}

/// One weighing on the bench: takes what to weigh, a callback that is notified of each event before
/// the motion that follows and may forbid it, and the stop flag.
/// On every exit the spoon is level and retracted, or a person must check the bench.
pub type Pour = Arc<
    dyn Fn(&Pouring, &mut dyn FnMut(&Event<'_>) -> ControlFlow<()>, &AtomicBool) -> Poured
        + Send
        + Sync,
>;

/// Makes a latched arm movable again.
pub type Recover = Arc<dyn Fn(&str) -> Result<(), DeviceError> + Send + Sync>;

/// Returns why the arm is latched, if it is.
pub type ArmLatch = Arc<dyn Fn() -> Result<Option<String>, DeviceError> + Send + Sync>;

/// The hardware, real or not, driven by the lane.
#[derive(Clone)]
pub struct Apparatus {
    /// The kind of bench.
    pub kind: BenchKind,
    /// Carries out one weighing.
    pub pour: Pour,
    /// Stops the arm at once, from any thread; returns once the command has been sent.
    pub halt: Arc<dyn Fn() + Send + Sync>,
    /// Takes the wire traffic since the last call.
    pub exchanges: Arc<dyn Fn() -> Vec<Exchange> + Send + Sync>,
    /// Devices by role, as they identified themselves when last open.
    pub devices: Arc<dyn Fn() -> BTreeMap<String, String> + Send + Sync>,
    /// Called after a person has checked the arm and confirmed that it may move: it levels and
    /// retracts the spoon. Takes the person's name.
    pub recover: Recover,
    /// Queries whether the arm is latched, over a separate connection.
    pub arm_latch: ArmLatch,
    /// No piles are started while this is set: the bench is held.
    pub held: Arc<AtomicBool>,
    /// Mass of an empty vial of the laboratory, where known.
    pub empty_vial: Option<EmptyVial>,
    /// Readability (display step) of the balance, mg, where known in advance.
    pub readability_mg: Arc<dyn Fn() -> Option<f64> + Send + Sync>,
    /// Whether earlier doses of a powder inform the forecast. False where a dose must follow from
    /// its seed alone.
    pub remembers: bool,
    /// The spoon used for dosing.
    pub spoon: Spoon,
    /// The stand where piles are made for an angle of repose; the simulator has none.
    pub stand: Option<PileStand>,
}

impl Apparatus {
    /// An apparatus without devices: the simulator, or a test's formula.
    pub fn without_devices(pour: Pour) -> Self {
        Self {
            kind: BenchKind::Simulated,
            pour,
            halt: Arc::new(|| {}),
            exchanges: Arc::new(Vec::new),
            devices: Arc::new(BTreeMap::new),
            recover: Arc::new(|_| Ok(())),
            arm_latch: Arc::new(|| Ok(None)),
            held: Arc::default(),
            empty_vial: None,
            readability_mg: Arc::new(|| None),
            remembers: false,
            spoon: Spoon::default(),
            stand: None,
        }
    }
}

/// The closed loop on the simulator.
pub fn simulated() -> Pour {
    Arc::new(|pouring, on_event, stop| {
        let mut bench =
            SimulatedBench::new(&pouring.set, &pouring.powder(), &pouring.balance, pouring.seed);
        let settings = Settings { accuracy: pouring.accuracy, ..Settings::EPISODE };
        let weighed = weigh(
            &mut bench,
            &pouring.controller,
            &pouring.rules,
            &pouring.order,
            &settings,
            on_event,
            stop,
        );
        poured(weighed, Some(bench.vial_mg()))
    })
}

/// The closed loop on a laboratory emulated in this process, around the simulator; its time is
/// virtual, so a dose is quick and deterministic.
pub fn emulated(settings: lab::Settings) -> Apparatus {
    let wires = Wires::default();
    let (readability_mg, remembers) = (settings.balance.readability_mg, settings.remembers);
    let opened = wires.clone();
    let stand = stand::emulated(settings.clone(), wires.clone());
    let pour: Pour = Arc::new(move |pouring, on_event, stop| {
        let clock = Clock::standing();
        let spoon = GrainsSpoon::new(&pouring.set, &pouring.powder(), pouring.seed);
        let settings = lab::Settings {
            balance: flip_bench::emulate::balance::Settings {
                seed: pouring.seed,
                ..settings.balance.clone()
            },
            ..settings.clone()
        };
        // A bench with uncalibrated shakes executes less than it is commanded, and the gentlest
        // shakes not at all: the spoon then climbs unshaken and releases the powder all at once.
        // This arm's shakes are known.
        let measured = pouring.shakes.clone().or_else(|| settings.arm.shakes());
        let pouring = Pouring { shakes: measured, ..pouring.clone() };
        match Laboratory::start(settings, clock.clone(), Box::new(spoon)) {
            Ok(laboratory) => {
                let poured =
                    on_devices(&opened, &laboratory.file(), clock, &pouring, on_event, stop);
                Poured { dispensed_mg: Some(laboratory.dispensed_mg()), ..poured }
            }
            Err(error) => not_begun(format!("the emulated laboratory cannot be set up: {error}")),
        }
    });
    // Each dose has its own laboratory.
    let apparatus =
        wires.apparatus(BenchKind::Emulated, pour, Arc::new(|_| Ok(())), Some(readability_mg));
    Apparatus { stand: Some(stand), remembers, ..apparatus }
}

/// The closed loop on the devices of this bench file.
pub fn devices(file: BenchFile) -> Apparatus {
    devices_by(file, Clock::wall())
}

/// The same with another clock: that of an emulated laboratory with its own time.
pub fn devices_by(file: BenchFile, clock: Clock) -> Apparatus {
    let wires = Wires::default();
    let readability_mg = file.balance.readability_mg;
    let (opened, empty_vial, spoon) = (wires.clone(), file.vial, file.spoon);
    let (arm, tap) = (file.arm.clone(), wires.tap());
    let recover: Recover = Arc::new(move |person| {
        Arm::connect(&arm.url, tap.clone(), arm.deadlines())?.recover(person)
    });
    let (url, asks) = (file.arm.url.clone(), wires.clone());
    let arm_latch: ArmLatch = Arc::new(move || settled_latch(&asks, &url));
    let stand = stand::devices(file.clone(), wires.clone());
    let pour: Pour = Arc::new(move |pouring, on_event, stop| {
        on_devices(&opened, &file, clock.clone(), pouring, on_event, stop)
    });
    let apparatus = wires.apparatus(BenchKind::Devices, pour, recover, readability_mg);
    Apparatus { stand: Some(stand), arm_latch, empty_vial, spoon, ..apparatus }
}

/// Why the arm reports that it is latched, if it is.
fn latch_cause(url: &str, tap: Tap) -> Result<Option<String>, DeviceError> {
    let arm = Arm::connect(url, tap, Deadlines::default())?;
    let cause: String =
        arm.description().latch_cause.chars().filter(|c| !c.is_control()).take(CAUSE_MAX).collect();
    Ok(Some(cause).filter(|cause| !cause.is_empty()))
}

/// The same where nothing in this process has control. An arm whose client has gone, as after a
/// restart, first retracts its spoon and then latches itself.
fn settled_latch(wires: &Wires, url: &str) -> Result<Option<String>, DeviceError> {
    let arm = Arm::connect(url, wires.tap(), Deadlines::default())?;
    let until = Instant::now() + ABANDONED_MAX;
    let is_controlled =
        || arm.state().is_ok_and(|state| !matches!(state.mode(), Mode::Idle | Mode::Latched));
    while !wires.is_open() && is_controlled() && Instant::now() < until {
        std::thread::sleep(LOOK_AGAIN);
    }
    latch_cause(url, wires.tap())
}

/// State that outlives the weighing that opened the devices.
#[derive(Clone, Default)]
pub(super) struct Wires {
    exchanges: Arc<Mutex<Vec<Exchange>>>,
    stopper: Arc<Mutex<Option<Stopper>>>,
    devices: Arc<Mutex<BTreeMap<String, String>>>,
    /// Held while devices move: weighings and piles take turns.
    floor: Arc<Mutex<()>>,
    /// Stop was requested since the floor was taken.
    halted: Arc<AtomicBool>,
    /// The bench is held: set by a stop before anything else, until a person resumes.
    held: Arc<AtomicBool>,
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Wires {
    /// Waits for its turn. From now on a stop applies to the holder, even while devices are being
    /// opened, which takes seconds.
    pub(super) fn floor(&self) -> MutexGuard<'_, ()> {
        let floor = locked(&self.floor);
        self.halted.store(false, Ordering::SeqCst);
        floor
    }

    /// Devices are open.
    pub(super) fn opened(&self, devices: BTreeMap<String, String>, stopper: Stopper) {
        *locked(&self.devices) = devices;
        *locked(&self.stopper) = Some(stopper);
    }

    /// Whether this process is moving devices.
    fn is_open(&self) -> bool {
        locked(&self.stopper).is_some()
    }

    /// Nothing moves any longer.
    pub(super) fn closed(&self) {
        *locked(&self.stopper) = None;
    }

    /// Whether stop was requested since the floor was taken.
    pub(super) fn was_halted(&self) -> bool {
        self.halted.load(Ordering::SeqCst)
    }

    /// Whether the bench is held: a stop may have come while the holder of the floor waited for it.
    pub(super) fn is_held(&self) -> bool {
        self.held.load(Ordering::SeqCst)
    }

    fn tap(&self) -> Tap {
        let exchanges = self.exchanges.clone();
        Tap::new(move |exchange| locked(&exchanges).push(exchange))
    }

    pub(super) fn apparatus(
        self,
        kind: BenchKind,
        pour: Pour,
        recover: Recover,
        readability_mg: Option<f64>,
    ) -> Apparatus {
        let Self { exchanges, stopper, devices, halted, held, .. } = self;
        let halt = move || {
            halted.store(true, Ordering::SeqCst);
            let stopper = locked(&stopper).clone();
            if let Some(Err(error)) = stopper.map(|stopper| stopper.stop("stop was pressed")) {
                tracing::error!(%error, "the arm could not be told to stop: its dead-man acts");
            }
        };
        Apparatus {
            kind,
            pour,
            halt: Arc::new(halt),
            exchanges: Arc::new(move || std::mem::take(&mut *locked(&exchanges))),
            devices: Arc::new(move || locked(&devices).clone()),
            recover,
            readability_mg: Arc::new(move || readability_mg),
            arm_latch: Arc::new(|| Ok(None)),
            held,
            empty_vial: None,
            remembers: kind == BenchKind::Devices,
            spoon: Spoon::default(),
            stand: None,
        }
    }
}

/// Opens the devices, weighs, closes them.
fn on_devices(
    wires: &Wires,
    file: &BenchFile,
    clock: Clock,
    pouring: &Pouring,
    on_event: &mut dyn FnMut(&Event<'_>) -> ControlFlow<()>,
    stop: &AtomicBool,
) -> Poured {
    let _floor = wires.floor();
    let opened =
        Station::open(file, pouring.shakes.clone(), clock, &wires.tap()).and_then(|mut station| {
            wires.opened(station.devices()?, station.stopper()?);
            Ok(station)
        });
    let mut station = match opened {
        Ok(station) => station,
        Err(error) => return refused(error, latch_cause(&file.arm.url, wires.tap())),
    };
    let (accuracy, forecast, readings) = (pouring.accuracy, Some(pouring.forecast), file.readings);
    let (life_s, rest_max_s, pan) = (readings.life_s, readings.stand_max_s, pouring.pan);
    let settings = Settings { accuracy, forecast, life_s, rest_max_s, pan, ..Settings::BENCH };
    let weighed = weigh(
        &mut station,
        &pouring.controller,
        &pouring.rules,
        &pouring.order,
        &settings,
        on_event,
        stop,
    );
    wires.closed();
    let went_well =
        !weighed.must_look && !matches!(weighed.outcome, Outcome::Aborted | Outcome::Stopped);
    let mut poured = poured(weighed, None);
    // For a balance that flags nothing, FLIP's own stability window decides: the balance itself
    // reported nothing.
    if let Some(measured) =
        poured.measured.as_mut().filter(|_| file.balance.stable_by == StableBy::Window)
    {
        measured.stable_by_balance = false;
    }
    match if went_well { Ok(None) } else { latch_cause(&file.arm.url, wires.tap()) } {
        Ok(Some(cause)) => arm_latched(poured, &cause),
        _ => poured,
    }
}

/// The devices could not be opened: nothing moved. A latched arm must be checked by a person.
fn refused(error: DeviceError, latch: Result<Option<String>, DeviceError>) -> Poured {
    match latch {
        Ok(Some(cause)) => arm_latched(not_begun(error.to_string()), &cause),
        _ => not_begun(error.to_string()),
    }
}

/// The arm has latched itself: a person must check it, and gets the reason in the arm's own words.
fn arm_latched(poured: Poured, cause: &str) -> Poured {
    let said =
        format!("the arm is latched: {cause}. Look at spoon, vial and arm, then clear the bench");
    // A latched arm refuses every command: that refusal is not the cause.
    let is_refusal = |error: &String| {
        ["the arm must not do this now", "the arm is latched"]
            .iter()
            .any(|refused| error.contains(refused))
    };
    let error = match poured.error.filter(|error| !is_refusal(error)) {
        Some(error) => format!("{said}; before that: {error}"),
        None => said,
    };
    Poured { error: Some(error.clone()), must_look: Some(error), ..poured }
}

fn not_begun(cause: String) -> Poured {
    Poured {
        outcome: Outcome::Aborted,
        dispensed_mg: None,
        reading_mg: None,
        measured: None,
        shakes: 0,
        seconds: 0.0,
        ticks: Vec::new(),
        error: Some(cause),
        must_look: None,
    }
}

fn poured(weighed: Weighed, dispensed_mg: Option<f64>) -> Poured {
    let measured = |net_mg| MeasuredMass {
        tare_mg: weighed.tare_mg,
        gross_mg: weighed.gross_mg,
        zero_mg: weighed.zero_mg,
        net_mg,
        uncertainty_mg: weighed.uncertainty_mg,
        proven: weighed.proven,
        stable_by_balance: weighed.stable_by_flag.unwrap_or(false),
        stable_by_window: weighed.stable_by_window.unwrap_or(false),
        drift_before_mg_min: weighed.drift_before_mg_min,
        drift_after_mg_min: weighed.drift_after_mg_min,
        in_flight_mg: weighed.in_flight_mg,
        ..MeasuredMass::default()
    };
    let must_look = weighed
        .must_look
        .then(|| weighed.cause.clone().unwrap_or_else(|| "a device failed".to_owned()));
    Poured {
        outcome: weighed.outcome,
        dispensed_mg,
        reading_mg: weighed.reading_mg,
        measured: weighed.reading_mg.filter(|_| weighed.stable_by_flag.is_some()).map(measured),
        shakes: weighed.shakes,
        seconds: weighed.seconds,
        ticks: weighed.ticks,
        error: weighed.cause,
        must_look,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_is_for_whoever_has_the_floor_also_before_the_devices_are_open() {
        let wires = Wires::default();
        let pour: Pour = Arc::new(|_, _, _| not_begun("nothing pours here".into()));
        let halt =
            wires.clone().apparatus(BenchKind::Devices, pour, Arc::new(|_| Ok(())), Some(1.0)).halt;
        let floor = wires.floor();
        halt();
        assert!(wires.was_halted());
        wires.closed();
        drop(floor);
        assert!(wires.was_halted(), "nobody else has begun");
        let _next = wires.floor();
        assert!(!wires.was_halted());
    }
}
