//! Dead-man checks: what the arm does when its lease is not renewed, and that only a person can get
//! it going again.

use super::arm::{Lease, Subject, is_home};
use super::raw::{CALL, MOTION, told};
use super::{Findings, Found};
use crate::hardware::arm::proto::{self, Mode};
use std::time::{Duration, Instant};
use tonic::{Code, Status};

/// Pitch from which the arm has to return, degrees.
const TILTED_DEG: f64 = 20.0;

/// How much longer an arm that has not begun to return is observed after its deadline: the next
/// check finds it latched, if it latches at all.
const LATE: Duration = Duration::from_secs(10);

/// Requires that nobody has control and that the spoon is at home; leaves it so.
pub(super) fn check(subject: &Subject<'_>, found: &mut Findings) {
    let asked = "renewals end while the spoon is tilted over the vial";
    let mut lease = match tilted(subject) {
        Ok(lease) => lease,
        Err(status) => {
            found.add(
                "dead-man",
                asked,
                Found::failed(told(&status), "the arm must approach and pitch under a new lease"),
            );
            found.skip(&["recover"], "the dead-man was not set off");
            return;
        }
    };
    let latched = dead_man(subject, &mut lease);
    found.add("dead-man", asked, latched);
    found.add(
        "recover",
        "Acquire, which must be refused, then Recover by a person",
        recover(subject),
    );
}

fn tilted<'a>(subject: &Subject<'a>) -> Result<Lease<'a>, Status> {
    let mut lease = Lease::acquire(subject)?;
    lease.approach()?;
    lease.pitch(TILTED_DEG.min(subject.limits.pitch.upper_deg))?;
    Ok(lease)
}

fn dead_man(subject: &Subject<'_>, lease: &mut Lease<'_>) -> Found {
    let Some(last) = lease.abandon() else {
        return Found::skipped("there were no renewals to end");
    };
    let bounds = subject.bounds;
    let returns = |state: &proto::State| matches!(state.mode(), Mode::Returning | Mode::Latched);
    let advice = "an arm whose client dies must level, retract and latch by itself: see the contract's dead-man";
    let Some(begun) = subject.states.until(last, bounds.return_begins + LATE, returns) else {
        return Found::failed("it stayed where it was", advice);
    };
    let began = begun.at - last;
    let home = |state: &proto::State| state.mode() == Mode::Latched;
    let Some(ended) = subject.states.until(begun.at, bounds.return_ends, home) else {
        return Found::failed("it did not latch", advice);
    };
    let came = format!(
        "began {} ms after the last renewal, latched after {} ms, {:?}, pitch {:.2} deg",
        began.as_millis(),
        (ended.at - last).as_millis(),
        ended.state.station(),
        ended.state.pitch_deg
    );
    if began < bounds.dead_man {
        return Found::failed(
            came,
            format!(
                "it must wait {} ms, or busy clients lose their lease",
                bounds.dead_man.as_millis()
            ),
        );
    }
    Found::judged(began <= bounds.return_begins && is_home(&ended.state), came, advice)
}

fn recover(subject: &Subject<'_>) -> Found {
    let advice = "a latched arm moves for nobody until a person calls Recover";
    match Lease::acquire(subject) {
        Err(status) if status.code() == Code::FailedPrecondition => {}
        Err(status) => return Found::failed(told(&status), advice),
        Ok(lease) => {
            let _ = lease.release();
            return Found::failed("control was given", advice);
        }
    }
    let describe = || {
        subject.raw.ask("Describe", CALL, |mut client| async move {
            client.describe(proto::DescribeRequest {}).await
        })
    };
    let cause = describe().map(|it| it.latch_cause).unwrap_or_default();
    let request = proto::RecoverRequest { person: subject.looked.by.clone() };
    if let Err(status) = subject
        .raw
        .ask("Recover", MOTION, |mut client| async move { client.recover(request).await })
    {
        return Found::failed(told(&status), "the arm is latched and stays so: look at it");
    }
    let idle = subject.states.until(Instant::now(), Duration::from_secs(1), |state| {
        state.mode() == Mode::Idle && is_home(state)
    });
    let came = format!("refused (`{cause}`), then idle, level and retracted: {}", idle.is_some());
    Found::judged(
        idle.is_some() && !cause.is_empty(),
        came,
        "Describe must say why it is latched; after Recover it is IDLE",
    )
}
