//! Conformance test of a bench: a dry test of every device in a bench file. Nothing is poured, and
//! everything that is wrong is listed.
//!
//! Checks that move nothing always run. Checks that move something run only after a person has
//! inspected the bench and confirmed it ([`Looked`]). The arm is tested call by call, bypassing the
//! client, which would refuse a bad number before it is sent: whether the driver refuses it is the
//! question.

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

/// Verdict of one check.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// As required.
    Ok,
    /// FLIP can work with it, but a person should know.
    Warning,
    /// Nobody should weigh with this bench until it is fixed.
    Failed,
    /// The check did not run: `came` gives the reason.
    Skipped,
}

/// One check of a device.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Check {
    /// The device, by its role.
    pub device: &'static str,
    /// Name of the check.
    pub name: &'static str,
    /// What was requested.
    pub asked: String,
    /// The outcome, with the measured values.
    pub came: String,
    /// What the outcome means.
    pub verdict: Verdict,
    /// How to fix it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub advice: Option<String>,
}

/// All checks of a bench.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// No check failed.
    pub passed: bool,
    /// In the order in which they ran.
    pub checks: Vec<Check>,
}

impl Report {
    /// Number of checks with this verdict.
    pub fn count(&self, verdict: Verdict) -> usize {
        self.checks.iter().filter(|check| check.verdict == verdict).count()
    }
}

/// What a person has inspected and vouches for.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Looked {
    by: String,
    empty_spoon: bool,
    empty_funnel: bool,
}

impl Looked {
    /// Nobody has inspected the bench: nothing moves.
    pub fn nobody() -> Self {
        Self::default()
    }

    /// This person has inspected the bench. `empty_spoon`: the spoon holds no powder, the vial is
    /// empty or away, and the arm's path is clear. `empty_funnel`: nothing can flow through the
    /// gate.
    ///
    /// # Errors
    /// `by` names nobody although something is vouched for.
    pub fn by(person: &str, empty_spoon: bool, empty_funnel: bool) -> Result<Self, FieldError> {
        if (empty_spoon || empty_funnel) && person.trim().is_empty() {
            return Err(FieldError::new(
                "by",
                "must name the person who looked at spoon, vial and funnel",
            ));
        }
        Ok(Self { by: person.trim().to_owned(), empty_spoon, empty_funnel })
    }

    /// The spoon may move: it is empty, and the vial is empty or away.
    pub(super) fn spoon_is_empty(&self) -> bool {
        self.empty_spoon
    }
}

/// Time limits and rates that a bench must keep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// From Stop until the spoon is at rest.
    pub stop: Duration,
    /// Dead-man time reported by the arm.
    pub dead_man: Duration,
    /// From the last renewal until the arm starts bringing its spoon back.
    pub return_begins: Duration,
    /// Until the spoon is level and away.
    pub return_ends: Duration,
    /// State rate while the arm moves, Hz.
    pub states_hz: f64,
}

impl Bounds {
    /// As `proto/flip/bench/v1/arm.proto` requires, with 200 ms allowed for noticing that renewals
    /// have ended.
    pub const CONTRACT: Self = Self {
        stop: Duration::from_millis(50),
        dead_man: Duration::from_millis(300),
        return_begins: Duration::from_millis(500),
        return_ends: Duration::from_secs(30),
        states_hz: 100.0,
    };
}

/// Check every device in this file.
pub fn check(
    file: &BenchFile,
    looked: &Looked,
    bounds: &Bounds,
    clock: &Clock,
    tap: &Tap,
) -> Report {
    let mut checks = balance::check(file, clock, tap);
    checks.extend(file.gripper.iter().flat_map(|gripper| fingers::check(&gripper.port, tap)));
    checks.extend(file.gate.iter().flat_map(|gate| gate::check(&gate.port, looked, tap)));
    checks.extend(arm::check(&file.arm.url, looked, bounds, tap));
    Report { passed: checks.iter().all(|check| check.verdict != Verdict::Failed), checks }
}

/// Outcome of one check.
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

    /// Ok if `good`, else failed.
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
        self.checks.push(Check {
            device: self.device,
            name,
            asked: asked.into(),
            came,
            verdict,
            advice,
        });
    }

    /// Mark these checks as skipped, all for one reason.
    fn skip(&mut self, names: &[&'static str], reason: &str) {
        names.iter().for_each(|name| self.add(name, "nothing", Found::skipped(reason)));
    }
}
