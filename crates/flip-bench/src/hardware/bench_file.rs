//! The bench file: a TOML file that lists the devices of a bench.
//!
//! ```toml
//! [balance]
//! dialect = "mt_sics"            # mt_sics, ohaus, sbi, aandd; `flip bench probe` finds it
//! port = "/dev/ttyUSB0"          # or tcp://host:port
//! readability_mg = 1.0
//!
//! [arm]
//! url = "http://127.0.0.1:50061" # a driver process, proto/flip/bench/v1/arm.proto
//! motion_s = 30                  # longest time of one motion; the driver is told
//!
//! [spoon]                        # in the arm's hand; may be absent
//! capacity_mg = 60               # what one filling brings; or the bowl: length_mm, width_mm, depth_mm
//! filled_by = "arm"              # or "hand": a person or a station fills it before each dose
//!
//! [gripper]                      # that holds the spoon; may be absent
//! port = "/dev/ttyUSB1"
//!
//! [vial]                         # an empty one; may be absent
//! empty_mg = 12000.0
//! spread_mg = 150.0
//! ```

use super::arm::Deadlines;
use super::balance;
use flip_core::domain::spoon::Spoon;
use flip_core::domain::vial::EmptyVial;
use flip_core::domain::{FieldError, bounded};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// A bench.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BenchFile {
    /// The balance.
    pub balance: balance::Settings,
    /// The arm.
    pub arm: ArmAddress,
    /// The gripper that holds the spoon, where FLIP can query it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gripper: Option<PortAddress>,
    /// The gate under the funnel.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gate: Option<PortAddress>,
    /// The spoon in the arm's hand.
    #[serde(default, skip_serializing_if = "Spoon::is_usual")]
    pub spoon: Spoon,
    /// How readings are taken.
    #[serde(default)]
    pub readings: Readings,
    /// Mass of an empty vial. If the file does not give it, FLIP learns it from vials that were
    /// declared empty.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vial: Option<EmptyVial>,
}

/// Address of an arm's driver process.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ArmAddress {
    /// `http://host:port`.
    pub url: String,
    /// Longest time of one motion, s; passed to the driver. Default 30.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub motion_s: Option<f64>,
}

impl ArmAddress {
    /// Timeouts for its answers.
    pub fn deadlines(&self) -> Deadlines {
        let usual = Deadlines::default();
        let motion =
            self.motion_s.and_then(|s| Duration::try_from_secs_f64(s).ok()).unwrap_or(usual.motion);
        Deadlines { motion, idle: usual.idle.max(motion), ..usual }
    }
}

/// Port of a device.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PortAddress {
    /// A path.
    pub port: String,
}

/// How readings are taken.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Readings {
    /// Noise of one reading, mg: a display with finer steps never settles. Default 0.1.
    pub noise_mg: f64,
    /// Wait this long after each motion and read once, s, like the published robot (4 s), instead
    /// of watching the display settle. Default none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fixed_wait_s: Option<f64>,
    /// Longest wait for a reading to settle while dosing, s. Default 6.
    pub settle_max_s: f64,
    /// Longest wait for the balance to settle before and after a dose, s. Default 20.
    pub stand_max_s: f64,
    /// Longest wait for the display to change where a shake changed nothing, s: a working balance
    /// wanders, a stuck one does not. Default 60; an enclosed analytical balance stood still for
    /// 10 s at most, for 18 s rounded to 1 mg (`docs/reliability.md`). 0: no wait, for a balance
    /// whose display stands still for minutes when all is well, as with zero tracking.
    pub life_s: f64,
}

impl Default for Readings {
    fn default() -> Self {
        Self {
            noise_mg: 0.1,
            fixed_wait_s: None,
            settle_max_s: 6.0,
            stand_max_s: 20.0,
            life_s: 60.0,
        }
    }
}

impl BenchFile {
    /// Parse the text of a bench file.
    ///
    /// # Errors
    /// What is wrong with it, by line or field.
    pub fn parse(text: &str) -> Result<Self, FieldError> {
        let file: Self = toml::from_str(text)
            .map_err(|error| FieldError::new("bench file", error.to_string()))?;
        file.checked()
    }

    fn checked(mut self) -> Result<Self, FieldError> {
        let within = |part: &'static str| {
            move |e: FieldError| FieldError::new(format!("{part}.{}", e.field), e.message)
        };
        self.balance = self.balance.checked().map_err(within("balance"))?;
        if !self.arm.url.starts_with("http://") {
            return Err(FieldError::new(
                "arm.url",
                "must be http://host:port of the arm's driver process",
            ));
        }
        bounded("arm.motion_s", self.arm.motion_s.unwrap_or(30.0), 1.0, 600.0, "s")?;
        self.spoon = self.spoon.checked().map_err(within("spoon"))?;
        for (part, address) in [("gripper", &self.gripper), ("gate", &self.gate)] {
            if address.as_ref().is_some_and(|it| it.port.trim().is_empty()) {
                return Err(FieldError::new(
                    format!("{part}.port"),
                    "must be a path, as /dev/ttyUSB1",
                ));
            }
        }
        bounded("readings.noise_mg", self.readings.noise_mg, 0.0, 100.0, "mg")?;
        bounded(
            "readings.fixed_wait_s",
            self.readings.fixed_wait_s.unwrap_or(1.0),
            0.1,
            60.0,
            "s",
        )?;
        bounded("readings.settle_max_s", self.readings.settle_max_s, 0.5, 60.0, "s")?;
        bounded("readings.stand_max_s", self.readings.stand_max_s, 0.5, 120.0, "s")?;
        bounded("readings.life_s", self.readings.life_s, 0.0, 600.0, "s")?;
        self.vial = self.vial.map(EmptyVial::checked).transpose().map_err(within("vial"))?;
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEAST: &str = "[balance]\ndialect = \"sbi\"\nport = \"/dev/ttyS0\"\n[arm]\nurl = \"http://127.0.0.1:50061\"\n";

    #[test]
    fn a_balance_and_an_arm_make_a_bench_and_it_is_written_as_it_is_read() {
        let file = BenchFile::parse(LEAST).unwrap();
        assert_eq!((file.balance.dialect, &file.gripper), (balance::Dialect::Sbi, &None));
        assert_eq!(BenchFile::parse(&toml::to_string(&file).unwrap()).unwrap(), file);
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (text, named) in [
            (LEAST.replace("sbi", "scales"), "scales"),
            (LEAST.replace("http://", "tcp://"), "arm.url"),
            (LEAST.replace("/dev/ttyS0", ""), "balance.port"),
            (LEAST.replace("[arm]\nurl", "[arm]\nurll"), "urll"),
            (format!("{LEAST}[gripper]\nport = \"\"\n"), "gripper.port"),
            (format!("{LEAST}[readings]\nsettle_max_s = 0.0\n"), "readings.settle_max_s"),
            (format!("{LEAST}motion_s = 0.1\n"), "arm.motion_s"),
            (format!("{LEAST}[spoon]\ncapacity_mg = -1.0\n"), "spoon.capacity_mg"),
            (format!("{LEAST}[spoon]\nlength_mm = 12.0\n"), "spoon.width_mm"),
            (format!("{LEAST}[readings]\nlife_s = -1.0\n"), "readings.life_s"),
            (format!("{LEAST}[vial]\nempty_mg = 12000.0\nspread_mg = -1.0\n"), "vial.spread_mg"),
            (format!("{LEAST}[vial]\nempty_mg = 12000.0\n"), "spread_mg"),
            (format!("{LEAST}[kettle]\n"), "kettle"),
        ] {
            let refused = BenchFile::parse(&text).unwrap_err().to_string();
            assert!(refused.contains(named), "{refused}");
        }
    }
}
