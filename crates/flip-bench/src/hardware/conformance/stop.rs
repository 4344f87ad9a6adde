//! Stop checks: how long until the spoon is at rest, and what is allowed afterwards.

use super::arm::{Lease, Subject, is_home};
use super::raw::{CALL, MOTION, Raw, Seen, told};
use super::refusals::refused;
use super::{Findings, Found};
use crate::hardware::arm::proto::{self, Mode};
use std::time::{Duration, Instant};
use tonic::Code;

/// How long states are recorded after Stop.
const AFTER: Duration = Duration::from_millis(400);
/// Pitch change at which a motion is certainly under way, degrees.
const UNDER_WAY_DEG: f64 = 2.0;
/// A pitch that changes by less counts as at rest, degrees.
const STANDS_DEG: f64 = 0.02;

/// Requires the spoon over the vial, level; leaves it retracted.
pub(super) fn check(subject: &Subject<'_>, lease: &mut Lease<'_>, found: &mut Findings) {
    let upper_deg = subject.limits.pitch.upper_deg;
    found.add(
        "stop",
        format!("Stop on another connection during a pitch to {upper_deg} deg"),
        stop(subject, lease, upper_deg),
    );
    found.add(
        "after stop",
        "Pitch, which must be refused, then Retract",
        afterwards(subject, lease),
    );
}

fn stop(subject: &Subject<'_>, lease: &mut Lease<'_>, upper_deg: f64) -> Found {
    let stopper = match Raw::connect(subject.url, subject.tap) {
        Ok(stopper) => stopper,
        Err(error) => return error.into(),
    };
    let request = proto::PitchRequest { ticket: lease.next(), pitch_deg: upper_deg };
    let began = Instant::now();
    let motion = subject.raw.begin("Pitch, to be stopped", MOTION, |mut client| async move {
        client.pitch(request).await
    });
    let under_way = subject
        .states
        .until(began, Duration::from_secs(2), |state| state.pitch_deg > UNDER_WAY_DEG);
    let request = proto::StopRequest { reason: "flip bench check".to_owned() };
    let asked = Instant::now();
    let answer = stopper.ask("Stop", CALL, |mut client| async move { client.stop(request).await });
    let answered = asked.elapsed();
    let ended = subject.raw.wait(motion);
    std::thread::sleep(AFTER);
    if let Err(status) = answer {
        return Found::failed(told(&status), "Stop must be answered in every mode");
    }
    match (under_way, ended) {
        (None, _) | (_, Ok(_)) => Found::warning(
            "the motion was over before it was stopped",
            "the motion is too quick for this test: stop a slow one by hand",
        ),
        (_, Err(status)) if status.code() != Code::Aborted => Found::failed(
            format!("the motion answered {}", told(&status)),
            "a stopped motion must answer ABORTED",
        ),
        _ => {
            let stood = stood_after(&subject.states.since(began), asked);
            let came = format!(
                "stood after {} ms, answered after {} ms",
                stood.as_millis(),
                answered.as_millis()
            );
            let advice =
                format!("the spoon must stand within {} ms", subject.bounds.stop.as_millis());
            Found::judged(stood <= subject.bounds.stop, came, advice)
        }
    }
}

/// How long after `asked` the pitch last changed. States carry the driver's timestamps, which are
/// mapped to our clock by the state with the least delay.
fn stood_after(seen: &[Seen], asked: Instant) -> Duration {
    let (Some(first), Some(last)) = (seen.first(), seen.last()) else { return Duration::ZERO };
    let since_first = |at: Instant| at.saturating_duration_since(first.at).as_secs_f64();
    let lag_s = seen
        .iter()
        .map(|it| since_first(it.at) - it.state.measured_at_s)
        .fold(f64::INFINITY, f64::min);
    let changing = |it: &&Seen| (it.state.pitch_deg - last.state.pitch_deg).abs() > STANDS_DEG;
    let stood = seen.iter().rposition(|it| changing(&it)).and_then(|k| seen.get(k + 1));
    let stood_s = stood.map_or(0.0, |it| it.state.measured_at_s + lag_s - since_first(asked));
    Duration::from_secs_f64(stood_s.max(0.0))
}

fn afterwards(subject: &Subject<'_>, lease: &mut Lease<'_>) -> Found {
    let stopped = subject
        .states
        .until(Instant::now(), Duration::from_secs(1), |state| state.mode() == Mode::Stopped);
    if stopped.is_none() {
        return Found::failed(
            "its states do not say STOPPED",
            "after Stop only Retract and Release may be carried out",
        );
    }
    let refusal = refused(lease.pitch(0.0), &[Code::FailedPrecondition]);
    if refusal.advice.is_some() {
        return refusal;
    }
    if let Err(status) = lease.retract() {
        return Found::failed(told(&status), "Retract must bring the spoon back after Stop");
    }
    let home = subject.states.until(Instant::now(), Duration::from_secs(1), is_home);
    Found::judged(
        home.is_some(),
        "refused, then level and retracted",
        "after Retract the spoon must be level and away",
    )
}
