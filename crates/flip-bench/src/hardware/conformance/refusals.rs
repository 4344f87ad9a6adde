//! Requests that a driver must refuse: FLIP's client never sends them, but another program might.

use super::arm::{Lease, Subject};
use super::raw::{CALL, MOTION, Raw, told};
use super::{Bounds, Findings, Found};
use crate::hardware::arm::proto::{self, Executed};
use std::time::{Duration, Instant};
use tonic::{Code, Status};

/// Motion within this time after a refusal counts as caused by the request.
const AFTER: Duration = Duration::from_millis(100);
/// A pose counts as changed if it differs by more than this, degrees and mm.
const MOVED: f64 = 0.05;

/// A motion without a lease; it commands the pose that the spoon already has.
pub(super) fn without_lease(raw: &Raw) -> Found {
    let ticket = Some(proto::Ticket { lease_id: "nobody".to_owned(), sequence: 1, deadline_ms: 0 });
    let request = proto::PitchRequest { ticket, pitch_deg: 0.0 };
    let answer = raw.ask("Pitch to 0 deg, by nobody", CALL, |mut client| async move {
        client.pitch(request).await
    });
    // A latched arm reports that first.
    refused(answer, &[Code::PermissionDenied, Code::FailedPrecondition])
}

pub(super) fn control(dead_man_ms: Result<u32, Status>, bounds: &Bounds) -> Found {
    match dead_man_ms {
        Ok(ms) => Found::judged(
            Duration::from_millis(ms.into()) == bounds.dead_man,
            format!("a lease with a dead-man of {ms} ms"),
            format!("the contract's dead-man is {} ms", bounds.dead_man.as_millis()),
        ),
        Err(status) => {
            Found::failed(told(&status), "an idle arm must give control to whoever asks first")
        }
    }
}

pub(super) fn check(subject: &Subject<'_>, lease: &Lease<'_>, found: &mut Findings) {
    let request = proto::AcquireRequest { client: "another".to_owned() };
    let second = subject.raw.ask("Acquire, by another", CALL, |mut client| async move {
        client.acquire(request).await
    });
    found.add(
        "one client",
        "Acquire while another has control",
        refused(second, &[Code::ResourceExhausted]),
    );
    found.add(
        "bad numbers",
        "pitches and shakes out of bounds, NaN and infinite",
        bad_numbers(subject, lease),
    );
    let ticket =
        Some(proto::Ticket { lease_id: format!("{}-not", lease.id), sequence: 1, deadline_ms: 0 });
    let request = proto::PitchRequest { ticket, pitch_deg: 0.0 };
    let answer = subject
        .raw
        .ask("Pitch, wrong lease", CALL, |mut client| async move { client.pitch(request).await });
    found.add(
        "wrong lease",
        "Pitch to 0 deg under a lease that was never given",
        refused(answer, &[Code::PermissionDenied]),
    );
}

fn bad_numbers(subject: &Subject<'_>, lease: &Lease<'_>) -> Found {
    let began = Instant::now();
    let mut wrong = Vec::new();
    // Beyond any driver's range, so that even one with wider limits than FLIP's must refuse it.
    for pitch_deg in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 90.5, -90.5] {
        let request = proto::PitchRequest { ticket: lease.numbered(1), pitch_deg };
        let what = format!("Pitch to {pitch_deg} deg");
        let answer =
            subject.raw.ask(&what, MOTION, |mut client| async move { client.pitch(request).await });
        wrong.extend(accepted(&what, answer));
    }
    for amplitude_mm in [f64::NAN, f64::INFINITY, -1.0, 1e4] {
        wrong
            .extend(accepted(&format!("Shake by {amplitude_mm} mm"), lease.shake(1, amplitude_mm)));
    }
    std::thread::sleep(AFTER);
    if moved(subject, began) {
        wrong.push("the spoon moved".to_owned());
    }
    let came =
        if wrong.is_empty() { "all refused, nothing moved".to_owned() } else { wrong.join("; ") };
    Found::judged(
        wrong.is_empty(),
        came,
        "such a request must be refused with INVALID_ARGUMENT before anything moves",
    )
}

fn accepted(what: &str, answer: Result<Executed, Status>) -> Option<String> {
    match answer {
        Err(status) if status.code() == Code::InvalidArgument => None,
        Err(status) => Some(format!("{what}: {}", told(&status))),
        Ok(_) => Some(format!("{what}: carried out")),
    }
}

/// Whether the spoon has been anywhere else since.
pub(super) fn moved(subject: &Subject<'_>, since: Instant) -> bool {
    let seen = subject.states.since(since);
    let first = seen.first().map(|seen| seen.state);
    let differs = |a: f64, b: f64| (a - b).abs() > MOVED;
    first.is_some_and(|first| {
        seen.iter().any(|seen| {
            differs(seen.state.pitch_deg, first.pitch_deg)
                || differs(seen.state.shake_displacement_mm, first.shake_displacement_mm)
                || seen.state.station != first.station
        })
    })
}

/// The call must be refused, with one of these codes.
pub(super) fn refused<A>(answer: Result<A, Status>, codes: &[Code]) -> Found {
    match answer {
        Ok(_) => Found::failed("it was carried out", format!("it must be refused with {codes:?}")),
        Err(status) => Found::judged(
            codes.contains(&status.code()),
            told(&status),
            format!("it must be refused with {codes:?}"),
        ),
    }
}
