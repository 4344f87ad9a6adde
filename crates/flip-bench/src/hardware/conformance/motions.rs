//! Motion checks against the contract: what is executed, how it is reported, and that no motion is
//! executed twice.

use super::arm::{AT_REST_MM, LEVEL_DEG, Lease, Subject};
use super::raw::told;
use super::refusals::{moved, refused};
use super::{Findings, Found};
use crate::hardware::arm::proto::{Executed, Mode, Station};
use flip_core::domain::motion::Move;
use std::time::{Duration, Instant};
use tonic::{Code, Status};

/// Shake amplitude, mm, where the arm can.
const SHAKE_MM: f64 = 8.0;
/// Ratios of executed to commanded amplitude that need no remark.
const CLOSE: [f64; 2] = [0.9, 1.05];
/// Beyond these ratios the arm does not do what it was commanded.
const FAR: [f64; 2] = [0.5, 1.15];
/// Motion within this time after a repeated request counts as caused by it.
const AFTER: Duration = Duration::from_millis(150);
/// Fewest states from which their rate can be determined.
const STATES_MIN: usize = 10;

pub(super) fn check(subject: &Subject<'_>, lease: &mut Lease<'_>, found: &mut Findings) {
    let upper_deg = subject.limits.pitch.upper_deg;
    let began = Instant::now();
    let pitched = lease.pitch(upper_deg);
    found.add(
        "pitch",
        format!("Pitch to {upper_deg} deg, away from the vial"),
        pitch(&pitched, upper_deg),
    );
    found.add("state rate", "states during that", state_rate(subject, began));
    let _ = lease.pitch(0.0);
    let amplitude_mm = SHAKE_MM.min(subject.limits.shake_mm_max);
    lease.sequence += 1;
    let number = lease.sequence;
    let first = lease.shake(number, amplitude_mm);
    found.add("shake", format!("Shake by {amplitude_mm} mm"), shake(subject, &first, amplitude_mm));
    found.add(
        "repeats",
        "the same and other shakes under a number that was used",
        repeats(subject, lease, number, &first),
    );
    let approached = lease.approach();
    found.add("approach", "Approach", approach(subject, &approached));
}

fn pitch(answer: &Result<Executed, Status>, wanted_deg: f64) -> Found {
    match answer {
        Ok(executed) => Found::judged(
            (executed.pitch_deg - wanted_deg).abs() <= LEVEL_DEG,
            format!("{:.2} deg after {:.2} s", executed.pitch_deg, executed.duration_s),
            format!("the spoon must rest within {LEVEL_DEG} deg of what was asked for"),
        ),
        Err(status) => {
            Found::failed(told(status), "the driver must carry out a pitch within its own limits")
        }
    }
}

/// Measured by the driver's clock, so that a slow reader does not count against it.
fn state_rate(subject: &Subject<'_>, since: Instant) -> Found {
    let seen = subject.states.since(since);
    let moving: Vec<f64> = seen
        .iter()
        .filter(|it| it.state.mode() == Mode::Moving)
        .map(|it| it.state.measured_at_s)
        .collect();
    let (Some(first), Some(last)) = (moving.first(), moving.last()) else {
        return Found::warning(
            "no state said that it moves",
            "the motion was over too soon to say anything",
        );
    };
    if moving.len() < STATES_MIN && last - first < 0.1 {
        return Found::warning(
            format!("{} states", moving.len()),
            "the motion was over too soon to say anything",
        );
    }
    let hz = (moving.len() - 1) as f64 / (last - first).max(1e-3);
    let advice = format!(
        "at least {} states in a second must come while it moves",
        subject.bounds.states_hz
    );
    Found::judged(hz >= subject.bounds.states_hz, format!("{hz:.0} in a second"), advice)
}

fn shake(subject: &Subject<'_>, answer: &Result<Executed, Status>, asked_mm: f64) -> Found {
    let executed = match answer {
        Ok(executed) => executed,
        Err(status) => {
            return Found::failed(
                told(status),
                "the driver must carry out a shake within its own limits",
            );
        }
    };
    let share = executed.amplitude_mm / asked_mm;
    let planned_m_s = Move::new(executed.amplitude_mm * 1e-3, subject.limits.motion).top_m_s();
    let came = format!(
        "{:.2} mm, {:.0} % of it, at up to {:.0} mm/s of {:.0} planned",
        executed.amplitude_mm,
        100.0 * share,
        1e3 * executed.peak_speed_m_s,
        1e3 * planned_m_s
    );
    match share {
        _ if executed.peak_speed_m_s > 1.05 * subject.limits.motion.velocity_m_s => {
            Found::failed(came, "it was faster than the driver's own limit")
        }
        share if !(FAR[0]..=FAR[1]).contains(&share) => Found::failed(
            came,
            "the arm does not do what it is asked for: look at its tuning and load",
        ),
        share if !(CLOSE[0]..=CLOSE[1]).contains(&share) => Found::warning(
            came,
            "run `flip bench calibrate-shake`, so that amplitudes are commanded accordingly",
        ),
        _ => Found::ok(came),
    }
}

/// The sequence number of an executed motion: the same request gets the same answer, another one is
/// refused, and nothing moves.
fn repeats(
    subject: &Subject<'_>,
    lease: &Lease<'_>,
    number: u64,
    first: &Result<Executed, Status>,
) -> Found {
    let Ok(first) = first else { return Found::skipped("the shake was not made") };
    let asked_mm = SHAKE_MM.min(subject.limits.shake_mm_max);
    std::thread::sleep(AFTER);
    let began = Instant::now();
    let advice =
        "a message that comes twice must not pour twice: see the contract's sequence numbers";
    match lease.shake(number, asked_mm) {
        Ok(again) if again == *first => {}
        Ok(again) => return Found::failed(format!("first {first:?}, then {again:?}"), advice),
        Err(status) => return Found::failed(told(&status), advice),
    }
    for (sequence, amplitude_mm) in [(number, asked_mm / 2.0), (number - 1, asked_mm)] {
        let other = refused(lease.shake(sequence, amplitude_mm), &[Code::AlreadyExists]);
        if other.advice.is_some() {
            return other;
        }
    }
    std::thread::sleep(AFTER);
    Found::judged(
        !moved(subject, began),
        "answered as before, others refused; the spoon stood still",
        advice,
    )
}

fn approach(subject: &Subject<'_>, answer: &Result<Executed, Status>) -> Found {
    if let Err(status) = answer {
        return Found::failed(
            told(status),
            "an arm that is level and retracted must come over the vial",
        );
    }
    let there = subject.states.until(Instant::now(), Duration::from_secs(1), |state| {
        state.station() == Station::OverVial
            && state.pitch_deg.abs() <= LEVEL_DEG
            && state.shake_displacement_mm.abs() <= AT_REST_MM
    });
    Found::judged(
        there.is_some(),
        "over the vial, level",
        "after Approach the states must say OVER_VIAL, level",
    )
}
