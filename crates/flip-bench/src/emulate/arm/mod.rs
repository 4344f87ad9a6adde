//! An emulated arm: a driver process that implements `proto/flip/bench/v1/arm.proto`, whose spoon
//! follows the simulator or a formula.
//!
//! Motions take bench time by the clock of the [`Pan`]; the dead-man and late answers use
//! wall-clock time, and time that a busy machine did not provide is forgiven (`dead_man.rs`).
//! Powder lands on the pan while the spoon is over the vial, evenly during the motion and delayed
//! by the fall time; elsewhere it falls back into the container.

mod body;
mod dead_man;
mod desk;
mod fault;
mod formula;
mod motions;
mod service;
mod spoon;
#[cfg(test)]
mod tests;
mod wires;

pub use body::{Asked, Brake, End};
pub use desk::{Desk, Driver, Robot, Why};
pub use fault::Fault;
pub use formula::{Flow, FormulaSpoon};
pub use spoon::{GrainsSpoon, Pour, Spoon};

use super::pan::Pan;
use crate::hardware::arm::PROTOCOL_VERSION;
use crate::hardware::arm::proto::{self, Station};
use crate::hardware::clock::Clock;
use dead_man::DeadMan;
use flip_core::domain::bench::{PitchLimits, SHAKE_MM_MAX};
use flip_core::domain::bench_check::{ExecutedShake, ShakeCalibration};
use flip_core::domain::motion::{MotionLimits, Move, TurnLimits};
use flip_core::domain::{FieldError, bounded};
use motions::Emulated;
use serde::{Deserialize, Serialize};
use std::net::Ipv4Addr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Behaviour of an emulated arm without faults. Times are bench time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// From a request to the first movement, s. Default 0.02.
    pub reply_s: f64,
    /// Moving over the vial, s. Default 1.5.
    pub approach_s: f64,
    /// Moving away from the vial, s. Default 1.
    pub retract_s: f64,
    /// Filling the spoon and shaking off the surplus, s. Default 8.
    pub scoop_s: f64,
    /// Emptying it, s. Default 4.
    pub discard_s: f64,
    /// Turning the platform over the funnel and back, s. Default 6.
    pub invert_s: f64,
    /// Executed amplitude as a fraction of the commanded one. Default 0.94.
    pub shake_gain: f64,
    /// Minus this, mm. Default 0.1.
    pub shake_loss_mm: f64,
    /// A commanded amplitude below this causes no motion, mm. Default 0.3.
    pub shake_deadband_mm: f64,
    /// Speed of a shake, as a fraction of its limits, above 0 to 1. Default 0.95.
    pub speed: f64,
    /// Pitch range. Default FLIP's own.
    pub pitch: PitchLimits,
    /// It can fill and empty its spoon. Default true.
    pub scoops: bool,
    /// Limits of pitching.
    pub turn: TurnLimits,
    /// Limits of the shake. Default those of the simulated spoon.
    pub shake: MotionLimits,
    /// Maximum commanded amplitude, mm. Default 16.
    pub shake_mm_max: f64,
    /// Fall time from the spoon to the pan, s. Default 0.05.
    pub fall_s: f64,
    /// After this long without renewal, in wall-clock time, the arm levels, retracts and latches,
    /// ms. Time in which the machine was too busy for the emulator itself does not count.
    /// Default 300.
    pub dead_man_ms: u32,
}

impl Default for Settings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

impl Settings {
    /// Defaults given at the fields.
    pub const DEFAULT: Self = Self {
        reply_s: 0.02,
        approach_s: 1.5,
        retract_s: 1.0,
        scoop_s: 8.0,
        discard_s: 4.0,
        invert_s: 6.0,
        shake_gain: 0.94,
        shake_loss_mm: 0.1,
        shake_deadband_mm: 0.3,
        speed: 0.95,
        pitch: PitchLimits::WIDE,
        scoops: true,
        turn: TurnLimits::DEFAULT,
        shake: MotionLimits::BRISK,
        shake_mm_max: SHAKE_MM_MAX,
        fall_s: 0.05,
        dead_man_ms: 300,
    };

    /// Amplitude executed when this one is commanded, mm.
    pub fn executed_mm(&self, commanded_mm: f64) -> f64 {
        if commanded_mm < self.shake_deadband_mm {
            return 0.0;
        }
        (self.shake_gain * commanded_mm - self.shake_loss_mm).max(0.0)
    }

    /// Limits of a shake as this arm makes it; the powder feels these.
    pub fn executed(&self) -> MotionLimits {
        self.shake.at_speed(self.speed)
    }

    /// Shake calibration of this arm: its gain and loss.
    pub fn shakes(&self) -> Option<ShakeCalibration> {
        let shake = |commanded_mm: f64| {
            let planned_mm_s = 1e3 * Move::new(1e-3 * commanded_mm, self.shake).top_m_s();
            let peak_mm_s =
                1e3 * Move::new(1e-3 * self.executed_mm(commanded_mm), self.executed()).top_m_s();
            ExecutedShake {
                commanded_mm,
                executed_mm: self.executed_mm(commanded_mm),
                planned_mm_s,
                peak_mm_s,
            }
        };
        ShakeCalibration::of([2.0, 4.0, 8.0, self.shake_mm_max].map(shake).to_vec()).ok()
    }

    /// Returns the settings if they are valid for an arm.
    ///
    /// # Errors
    /// The first field that is out of bounds.
    pub fn checked(self) -> Result<Self, FieldError> {
        for (field, seconds) in [
            ("reply_s", self.reply_s),
            ("approach_s", self.approach_s),
            ("retract_s", self.retract_s),
            ("scoop_s", self.scoop_s),
            ("discard_s", self.discard_s),
            ("invert_s", self.invert_s),
            ("fall_s", self.fall_s),
        ] {
            bounded(field, seconds, 0.0, 60.0, "s")?;
        }
        bounded("shake_gain", self.shake_gain, 0.1, 1.0, "")?;
        bounded("shake_loss_mm", self.shake_loss_mm, 0.0, 5.0, "mm")?;
        bounded("shake_deadband_mm", self.shake_deadband_mm, 0.0, 5.0, "mm")?;
        bounded("speed", self.speed, 0.05, 1.0, "")?;
        bounded("dead_man_ms", self.dead_man_ms.into(), 50.0, 60_000.0, "ms")?;
        Ok(self)
    }

    fn description(&self) -> proto::Description {
        proto::Description {
            protocol_version: PROTOCOL_VERSION,
            name: "emulated arm".to_owned(),
            serial: "EMULATED".to_owned(),
            driver_version: env!("CARGO_PKG_VERSION").to_owned(),
            limits: Some(proto::Limits {
                pitch_deg_min: self.pitch.lower_deg,
                pitch_deg_max: self.pitch.upper_deg,
                pitch_deg_s_max: self.turn.velocity_deg_s,
                shake_mm_max: self.shake_mm_max,
                velocity_m_s_max: self.shake.velocity_m_s,
                acceleration_m_s2_max: self.shake.acceleration_m_s2,
                jerk_m_s3_max: self.shake.jerk_m_s3,
            }),
            can_scoop: self.scoops,
            can_discard: self.scoops,
            can_invert: true,
            is_emulated: true,
            latch_cause: String::new(),
        }
    }
}

/// One executed motion, complete or not.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Event {
    /// Bench time at its end, s.
    pub at_s: f64,
    /// The motion.
    pub motion: Asked,
    /// Its reason.
    pub why: Why,
    /// What ended it before it was complete.
    pub ended: Option<End>,
    /// Pitch at its end, deg.
    pub pitch_deg: f64,
    /// Executed amplitude, mm.
    pub amplitude_mm: f64,
    /// Mass that fell towards the pan, mg.
    pub poured_mg: f64,
}

/// The environment of the emulated robot.
struct Laboratory {
    settings: Settings,
    pan: Pan,
    spoon: Mutex<Box<dyn Spoon>>,
    events: Mutex<Vec<Event>>,
}

impl Laboratory {
    fn clock(&self) -> &Clock {
        self.pan.clock()
    }

    fn spoon(&self) -> MutexGuard<'_, Box<dyn Spoon>> {
        self.spoon.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self, event: Event) {
        self.events.lock().unwrap_or_else(PoisonError::into_inner).push(event);
    }
}

/// A running emulated arm. Its driver process ends when this is dropped.
pub struct Arm {
    lab: Arc<Laboratory>,
    driver: Driver,
    url: String,
}

impl Arm {
    /// Start the driver on a free TCP port of this machine.
    ///
    /// # Errors
    /// The system has no port or thread left.
    pub fn start(settings: Settings, pan: Pan, spoon: Box<dyn Spoon>) -> std::io::Result<Self> {
        let lab = Arc::new(Laboratory {
            settings,
            pan,
            spoon: Mutex::new(spoon),
            events: Mutex::default(),
        });
        let dead_man =
            DeadMan { limit: Duration::from_millis(settings.dead_man_ms.into()), forgives: true };
        let address = (Ipv4Addr::LOCALHOST, 0).into();
        let driver =
            Driver::start(address, settings.description(), dead_man, Emulated(lab.clone()))?;
        let url = format!("http://{}", driver.address());
        Ok(Self { lab, driver, url })
    }

    /// The URL clients connect to.
    pub fn url(&self) -> &str {
        &self.url
    }

    /// Inject this fault.
    pub fn inject(&self, fault: Fault) {
        let mut body = self.driver.desk().locked();
        body.faults.push(fault);
        match fault {
            Fault::CommunicationLoss => self.driver.wires().cut(),
            Fault::UserStop => {
                let _ = body.brake.set(End::UserStop);
                body.latch(End::UserStop.latch_cause());
            }
            _ => {}
        }
    }

    /// Clear all faults. A latch stays.
    pub fn clear(&self) {
        self.driver.desk().locked().faults.clear();
        self.driver.wires().mend();
    }

    /// Every motion so far.
    pub fn log(&self) -> Vec<Event> {
        self.lab.events.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Whether the spoon is level and at rest on its axis.
    pub fn is_level(&self) -> bool {
        self.driver.desk().pose() == (0.0, 0.0)
    }

    /// Whether the spoon is away from the vial.
    pub fn is_retracted(&self) -> bool {
        self.driver.desk().station() == Station::Retracted
    }

    /// Whether anything moves.
    pub fn is_moving(&self) -> bool {
        self.driver.desk().locked().is_moving()
    }

    /// Why the arm is latched, if it is. Already set while the arm brings the spoon back after its
    /// dead-man.
    pub fn latched(&self) -> Option<&'static str> {
        self.driver.desk().locked().latch
    }

    /// Put another spoon into its hand, between two doses.
    pub fn set_spoon(&self, spoon: Box<dyn Spoon>) {
        *self.lab.spoon() = spoon;
    }

    /// Powder in the spoon, mg.
    pub fn spoon_mg(&self) -> f64 {
        self.lab.spoon().held_mg()
    }
}
