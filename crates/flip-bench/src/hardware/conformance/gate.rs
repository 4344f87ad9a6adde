//! Gate checks: does it speak FLIP's protocol, and does it close by itself?

use super::{Check, Findings, Found, Looked};
use crate::hardware::DeviceError;
use crate::hardware::gate::{Gate, GateStatus, Opening, State, Why};
use crate::hardware::wire::Tap;
use std::time::{Duration, Instant};

/// Maximum time for the gate to close once heartbeats have ended: its watchdog plus the slide's
/// travel.
const CLOSES: Duration = Duration::from_secs(4);
/// How long heartbeats are sent while the gate is opened and closed.
const OPEN: Duration = Duration::from_secs(10);
const ASK_EVERY: Duration = Duration::from_millis(20);

pub(super) fn check(port: &str, looked: &Looked, tap: &Tap) -> Vec<Check> {
    let mut found = Findings::of("gate");
    let moving = ["opens", "closes", "watchdog"];
    let mut gate = match Gate::open(port, tap.clone()) {
        Ok(gate) => gate,
        Err(error) => {
            found.add("hello", format!("open {port}"), error.into());
            found.skip(&moving, "it does not answer");
            return found.checks;
        }
    };
    let advice = "free the slide and look at the end stops";
    found.add(
        "hello",
        format!("open {port}, then its state"),
        stands(gate.status(), State::Closed, advice),
    );
    if !looked.empty_funnel {
        found.skip(&moving, "nobody has said that the funnel is empty");
        return found.checks;
    }
    let opened = gate.open_gate(Opening::FULL, OPEN);
    found.add("opens", "open all the way", stands(opened, State::Open, advice));
    found.add("closes", "close", stands(gate.close(), State::Closed, advice));
    found.add("watchdog", "open, then send no heartbeat", watchdog(&mut gate));
    found.checks
}

fn stands(told: Result<GateStatus, DeviceError>, wanted: State, advice: &str) -> Found {
    match told {
        Ok(status) => Found::judged(
            status.state == wanted && status.closed_stop == (wanted == State::Closed),
            format!("{:?}, {} of 1000 open", status.state, status.opening_permille),
            advice,
        ),
        Err(error) => error.into(),
    }
}

fn watchdog(gate: &mut Gate) -> Found {
    let opened = gate.open_gate(Opening::FULL, Duration::ZERO);
    let began = Instant::now();
    let advice =
        "a gate that stays open empties the funnel when FLIP dies: look at board and sketch";
    // The slide may be on its way back before it has arrived: only closing matters.
    if let Err(error) = opened {
        return error.into();
    }
    loop {
        match gate.status() {
            Ok(GateStatus { state: State::Closed, closed_for: Some(Why::Beats), .. }) => {
                return Found::ok(format!(
                    "closed by itself {} ms after it stood open",
                    began.elapsed().as_millis()
                ));
            }
            Ok(status) if began.elapsed() >= CLOSES => {
                return Found::failed(
                    format!("{:?} after {} s", status.state, CLOSES.as_secs()),
                    advice,
                );
            }
            Ok(_) => std::thread::sleep(ASK_EVERY),
            Err(error) => return error.into(),
        }
    }
}
