//! Gripper checks: does it answer, and does it hold a spoon? Nothing moves.

use super::{Check, Findings, Found};
use crate::hardware::gripper::{Gripper, GripperStatus, fault_words};
use crate::hardware::wire::Tap;
use std::time::{Duration, Instant};

/// Number of status requests.
const ASKED: u32 = 20;
/// A slower answer needed a retry, or nearly did.
const QUICK: Duration = Duration::from_millis(200);

pub(super) fn check(port: &str, tap: &Tap) -> Vec<Check> {
    let mut found = Findings::of("gripper");
    let asked = format!("open {port}");
    let mut gripper = match Gripper::open(port, tap.clone()) {
        Ok(gripper) => gripper,
        Err(error) => {
            found.add("opens", asked, error.into());
            return found.checks;
        }
    };
    found.add("opens", asked, Found::ok("open"));
    let status = gripper.status();
    let asked = "its state";
    match status {
        Ok(status) => {
            found.add("answers", format!("its state, {ASKED} times"), answers(&mut gripper));
            found.add("activated", asked, activated(&status));
            found.add("spoon", asked, spoon(&status));
        }
        Err(error) => {
            found.add("answers", asked, error.into());
            found.skip(&["activated", "spoon"], "it does not answer");
        }
    }
    found.checks
}

fn answers(gripper: &mut Gripper) -> Found {
    let mut slowest = Duration::ZERO;
    let mut lost = 0;
    for _ in 0..ASKED {
        let began = Instant::now();
        lost += u32::from(gripper.status().is_err());
        slowest = slowest.max(began.elapsed());
    }
    let came = format!(
        "{} of {ASKED} answers, the slowest after {} ms",
        ASKED - lost,
        slowest.as_millis()
    );
    let advice = "check the cable, its shield and the bus terminator: frames are lost";
    match (lost, slowest <= QUICK) {
        (0, true) => Found::ok(came),
        (0, false) => Found::warning(came, advice),
        _ => Found::failed(came, advice),
    }
}

fn activated(status: &GripperStatus) -> Found {
    let came = format!("activated: {}, fault: {}", status.activated, fault_words(status.fault));
    let advice =
        "take the spoon out of the fingers, then activate the gripper; see its lamp for a fault";
    // Faults 5 and 9 belong to the past and clear by themselves.
    Found::judged(status.activated && matches!(status.fault, 0 | 5 | 9), came, advice)
}

/// It need not hold a spoon while nobody weighs, but its state must be unambiguous.
fn spoon(status: &GripperStatus) -> Found {
    match (status.moving, status.holds()) {
        (true, _) => Found::failed(
            "the fingers move, and nobody asked for it",
            "see who else commands the gripper",
        ),
        (_, true) => Found::ok(format!("it holds a spoon, fingers at {} of 255", status.position)),
        (_, false) => Found::warning(
            format!("it holds nothing, fingers at {} of 255", status.position),
            "put the spoon between the fingers and close them before weighing",
        ),
    }
}
