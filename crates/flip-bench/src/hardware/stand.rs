//! The stand for the automated angle of repose: a platform that the arm turns over the funnel, the
//! gate below the funnel, and the base on which the pile forms. The camera is not part of it:
//! frames may come from any source.

use super::DeviceError;
use super::arm::{Arm, Stopper};
use super::bench_file::BenchFile;
use super::clock::Clock;
use super::gate::{Gate, Opening};
use super::wire::Tap;
use flip_core::domain::{FieldError, bounded};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::time::Duration;

/// How often the caller is asked whether to continue, bench time, s.
const ASK_EVERY_S: f64 = 0.1;
/// How much longer than requested heartbeats keep the gate open, s: the slide's travel.
const TRAVEL_S: f64 = 10.0;

/// How piles are made and imaged.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Procedure {
    /// Number of piles, 1 to 20. Default 5, as published.
    pub repeats: u32,
    /// Frames per pile, 3 to 100. Default 10, as published.
    pub frames: u32,
    /// How long the gate stays open, 1 to 300 s. Default 20.
    pub open_s: f64,
    /// How long the pile rests before frames are taken, 0 to 300 s. Default 5.
    pub rest_s: f64,
}

impl Default for Procedure {
    fn default() -> Self {
        Self { repeats: 5, frames: 10, open_s: 20.0, rest_s: 5.0 }
    }
}

impl Procedure {
    /// Returns the settings if they are valid.
    ///
    /// # Errors
    /// A number outside the bounds in its field's description.
    pub fn checked(self) -> Result<Self, FieldError> {
        for (field, value, low, high, unit) in [
            ("repeats", f64::from(self.repeats), 1.0, 20.0, "piles"),
            ("frames", f64::from(self.frames), 3.0, 100.0, "frames"),
            ("open_s", self.open_s, 1.0, 300.0, "s"),
            ("rest_s", self.rest_s, 0.0, 300.0, "s"),
        ] {
            bounded(field, value, low, high, unit)?;
        }
        Ok(self)
    }
}

/// An arm and a gate under control. Dropping it closes the gate and releases the arm.
pub struct Stand {
    // Dropped first, which closes the gate.
    gate: Gate,
    arm: Arm,
    clock: Clock,
}

impl Stand {
    /// Open the gate's port and take control of the arm.
    ///
    /// # Errors
    /// The bench has no gate, or the first device that is not available.
    pub fn open(file: &BenchFile, clock: Clock, tap: &Tap) -> Result<Self, DeviceError> {
        let port = file.gate.as_ref().ok_or_else(|| DeviceError::Forbidden {
            device: "the gate",
            cause: "the bench file names none: add [gate] with its port".to_owned(),
        })?;
        let gate = Gate::open(&port.port, tap.clone())?;
        let mut arm = Arm::connect(&file.arm.url, tap.clone(), file.arm.deadlines())?;
        arm.acquire()?;
        Ok(Self { gate, arm, clock })
    }

    /// A handle that stops the arm at once from any thread.
    ///
    /// # Errors
    /// The arm cannot be reached.
    pub fn stopper(&self) -> Result<Stopper, DeviceError> {
        self.arm.stopper()
    }

    /// Identities of the devices, by role.
    pub fn devices(&self) -> BTreeMap<String, String> {
        let arm = self.arm.description();
        [
            ("arm".to_owned(), format!("{}, serial {}", arm.name, arm.serial)),
            ("gate".to_owned(), "slide gate".to_owned()),
        ]
        .into()
    }

    /// Turn the platform with its powder over the funnel, put it back as the base, let the powder
    /// run out, and wait until the pile is at rest. The callback is called before each step and
    /// while waiting; if it returns `false`, the pour is stopped and the gate is closed.
    ///
    /// If the arm has no platform, the powder filled in by a person is poured, once.
    ///
    /// # Errors
    /// A device failed; the gate is closed then, or closes by itself.
    pub fn pour(
        &mut self,
        procedure: &Procedure,
        go_on: &mut dyn FnMut(&str) -> ControlFlow<()>,
    ) -> Result<bool, DeviceError> {
        if self.arm.description().can_invert {
            if go_on("turns the platform over the funnel").is_break() {
                return Ok(false);
            }
            self.arm.invert()?;
        } else if procedure.repeats > 1 {
            let cause = "it has no platform to turn over the funnel: fill the funnel by hand and ask for one repeat at a time";
            return Err(DeviceError::Forbidden { device: "the arm", cause: cause.to_owned() });
        }
        if go_on("opens the gate").is_break() {
            return Ok(false);
        }
        self.gate.open_gate(Opening::FULL, Duration::from_secs_f64(procedure.open_s + TRAVEL_S))?;
        let flowed = self.wait(procedure.open_s, "the powder runs out", go_on);
        self.gate.close()?;
        Ok(flowed && self.wait(procedure.rest_s, "the pile comes to rest", go_on))
    }

    fn wait(
        &mut self,
        seconds: f64,
        what: &str,
        go_on: &mut dyn FnMut(&str) -> ControlFlow<()>,
    ) -> bool {
        let until_s = self.clock.now_s() + seconds;
        while self.clock.now_s() < until_s {
            if go_on(what).is_break() {
                return false;
            }
            self.arm.attend();
            self.clock.wait_s(ASK_EVERY_S.min(until_s - self.clock.now_s()));
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::emulate::arm::{Flow, FormulaSpoon};
    use crate::emulate::lab::{self, Laboratory};

    const QUICK: Procedure = Procedure { repeats: 2, frames: 3, open_s: 2.0, rest_s: 1.0 };

    fn laboratory(settings: lab::Settings, clock: &Clock) -> Laboratory {
        Laboratory::start(settings, clock.clone(), Box::new(FormulaSpoon::new(Flow::default(), 1)))
            .unwrap()
    }

    #[test]
    fn the_platform_is_turned_the_gate_opens_closes_and_the_pile_rests() {
        let clock = Clock::fast(20.0);
        let laboratory = laboratory(lab::Settings::default(), &clock);
        let mut stand = Stand::open(&laboratory.file(), clock, &Tap::none()).unwrap();
        let mut told = Vec::new();
        let mut widest = 0.0_f64;
        let poured = stand.pour(&QUICK, &mut |what| {
            widest = widest.max(laboratory.slide.opening());
            if told.last().is_none_or(|last| last != what) {
                told.push(what.to_owned());
            }
            ControlFlow::Continue(())
        });
        assert_eq!((poured, widest, laboratory.slide.opening()), (Ok(true), 1.0, 0.0));
        let steps = [
            "turns the platform over the funnel",
            "opens the gate",
            "the powder runs out",
            "the pile comes to rest",
        ];
        assert_eq!(told, steps);
    }

    #[test]
    fn whoever_says_stop_finds_the_gate_closed() {
        let clock = Clock::fast(20.0);
        let laboratory = laboratory(lab::Settings::default(), &clock);
        let mut stand = Stand::open(&laboratory.file(), clock, &Tap::none()).unwrap();
        let stopped = stand.pour(&QUICK, &mut |what| match what {
            "the powder runs out" => ControlFlow::Break(()),
            _ => ControlFlow::Continue(()),
        });
        assert_eq!((stopped, laboratory.slide.opening()), (Ok(false), 0.0));
    }

    #[test]
    fn numbers_out_of_bounds_and_a_bench_without_a_gate_are_refused_by_name() {
        let refused = |procedure: Procedure| procedure.checked().unwrap_err().field;
        assert_eq!(refused(Procedure { repeats: 0, ..QUICK }), "repeats");
        assert_eq!(refused(Procedure { frames: 2, ..QUICK }), "frames");
        assert_eq!(refused(Procedure { open_s: f64::NAN, ..QUICK }), "open_s");
        assert_eq!(refused(Procedure { rest_s: -1.0, ..QUICK }), "rest_s");
        let clock = Clock::standing();
        let laboratory = laboratory(lab::Settings::default(), &clock);
        let file = BenchFile { gate: None, ..laboratory.file() };
        let error = Stand::open(&file, clock, &Tap::none()).err().unwrap().to_string();
        assert!(error.contains("[gate]"), "{error}");
    }
}
