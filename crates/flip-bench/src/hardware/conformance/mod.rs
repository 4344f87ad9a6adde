//! Does a bench keep its word? A dry test of every device that a bench file names: nothing is poured, and everything that is wrong is listed.
//!
//! Questions that move nothing are always asked. What moves is asked only on the word of a person who has looked ([`Looked`]). The arm is asked call by
//! call, past the client that would refuse a bad number before it is sent: whether the driver refuses it is the question.

mod arm;
mod balance;
mod dead_man;
mod fingers;
mod gate;
mod motions;
pub(super) mod raw;
mod refusals;
mod stop;
#[cfg(test)]
mod tests;

use super::DeviceError;
use super::bench_file::BenchFile;
use super::clock::Clock;
use super::wire::Tap;
use flip_core::domain::FieldError;
use serde::Serialize;
use std::time::Duration;

/// What came of one check.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// As it must be.
    Ok,
    /// FLIP can work with it, and a person should know.
    Warning,
    /// Nobody should weigh with this bench before it is put right.
    Failed,
    /// It was not asked: `came` says why.
    Skipped,
}

/// One question to a device.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Check {
    /// Which device, by its role.
    pub device: &'static str,
    /// What is checked.
    pub name: &'static str,
    /// What was asked.
    pub asked: String,
    /// What came, with the numbers that were measured.
    pub came: String,
    /// What that means.
    pub verdict: Verdict,
    /// What to do about it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub advice: Option<String>,
}

/// Everything that was asked.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// No check failed.
    pub passed: bool,
    /// In the order in which they were made.
    pub checks: Vec<Check>,
}

impl Report {
    /// How many checks came out like this.
    pub fn count(&self, verdict: Verdict) -> usize {
        self.checks.iter().filter(|check| check.verdict == verdict).count()
    }
}

/// What a person has looked at and vouches for.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Looked {
    by: String,
    empty_spoon: bool,
    empty_funnel: bool,
}

impl Looked {
    /// Nobody has looked: nothing moves.
    pub fn nobody() -> Self {
        Self::default()
    }

    /// This person has looked. `empty_spoon`: the spoon holds no powder, the vial is empty or away, and the arm's way is free. `empty_funnel`: nothing can
    /// flow through the gate.
    ///
    /// # Errors
    /// `by` names nobody while something is vouched for.
    pub fn by(person: &str, empty_spoon: bool, empty_funnel: bool) -> Result<Self, FieldError> {
        if (empty_spoon || empty_funnel) && person.trim().is_empty() {
            return Err(FieldError::new("by", "must name the person who looked at spoon, vial and funnel"));
        }
        Ok(Self { by: person.trim().to_owned(), empty_spoon, empty_funnel })
    }

    /// The spoon may move: it is empty, and so is the vial, or it is away.
    pub(super) fn spoon_is_empty(&self) -> bool {
        self.empty_spoon
    }
}

/// How quick a bench must be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// From Stop until the spoon stands.
    pub stop: Duration,
    /// What the arm says of its dead-man.
    pub dead_man: Duration,
    /// From the last renewal until the arm brings its spoon back.
    pub return_begins: Duration,
    /// Until the spoon is level and away.
    pub return_ends: Duration,
    /// States in a second while the arm moves.
    pub states_hz: f64,
}

impl Bounds {
    /// As `proto/flip/bench/v1/arm.proto` demands, with 200 ms for a dead-man to be noticed.
    pub const CONTRACT: Self = Self {
        stop: Duration::from_millis(50),
        dead_man: Duration::from_millis(300),
        return_begins: Duration::from_millis(500),
        return_ends: Duration::from_secs(30),
        states_hz: 100.0,
    };
}

/// Ask every device of this file.
pub fn check(file: &BenchFile, looked: &Looked, bounds: &Bounds, clock: &Clock, tap: &Tap) -> Report {
    let mut checks = balance::check(file, clock, tap);
    checks.extend(file.gripper.iter().flat_map(|gripper| fingers::check(&gripper.port, tap)));
    checks.extend(file.gate.iter().flat_map(|gate| gate::check(&gate.port, looked, tap)));
    checks.extend(arm::check(&file.arm.url, looked, bounds, tap));
    Report { passed: checks.iter().all(|check| check.verdict != Verdict::Failed), checks }
}

/// What one question brought.
struct Found {
    came: String,
    verdict: Verdict,
    advice: Option<String>,
}

impl Found {
    fn ok(came: impl Into<String>) -> Self {
        Self { came: came.into(), verdict: Verdict::Ok, advice: None }
    }

    fn warning(came: impl Into<String>, advice: impl Into<String>) -> Self {
        Self { came: came.into(), verdict: Verdict::Warning, advice: Some(advice.into()) }
    }

    fn failed(came: impl Into<String>, advice: impl Into<String>) -> Self {
        Self { came: came.into(), verdict: Verdict::Failed, advice: Some(advice.into()) }
    }

    fn skipped(reason: impl Into<String>) -> Self {
        Self { came: reason.into(), verdict: Verdict::Skipped, advice: None }
    }

    /// Well if `good`, else failed.
    fn judged(good: bool, came: impl Into<String>, advice: impl Into<String>) -> Self {
        if good { Self::ok(came) } else { Self::failed(came, advice) }
    }
}

impl From<DeviceError> for Found {
    fn from(error: DeviceError) -> Self {
        let advice = error.advice();
        Self::failed(error.to_string(), advice)
    }
}

/// The checks of one device, as they are made.
struct Findings {
    device: &'static str,
    checks: Vec<Check>,
}

impl Findings {
    fn of(device: &'static str) -> Self {
        Self { device, checks: Vec::new() }
    }

    fn add(&mut self, name: &'static str, asked: impl Into<String>, found: Found) {
        let Found { came, verdict, advice } = found;
        self.checks.push(Check { device: self.device, name, asked: asked.into(), came, verdict, advice });
    }

    /// These were not asked, all for one reason.
    fn skip(&mut self, names: &[&'static str], reason: &str) {
        names.iter().for_each(|name| self.add(name, "nothing", Found::skipped(reason)));
    }
}
