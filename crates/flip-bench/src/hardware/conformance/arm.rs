//! Arm checks: does its driver conform to `proto/flip/bench/v1/arm.proto`? First the checks that
//! move nothing, then, once a person has confirmed, the motions.

use super::raw::{CALL, MOTION, Raw, Renewals, Watch, told};
use super::{Bounds, Check, Findings, Found, Looked, dead_man, motions, refusals, stop};
use crate::hardware::arm::proto::{self, Executed, Mode, State, Station};
use crate::hardware::arm::{Arm, Deadlines, Limits};
use crate::hardware::wire::Tap;
use flip_core::domain::bench::PitchLimits;
use std::time::{Duration, Instant};
use tonic::Status;

/// How long the arm is observed at rest.
const REST: Duration = Duration::from_millis(500);
/// State rate at rest required by the contract, Hz.
const REST_HZ: f64 = 10.0;
/// Tolerance of level, degrees, and of zero displacement, mm.
pub(super) const LEVEL_DEG: f64 = 0.5;
pub(super) const AT_REST_MM: f64 = 0.2;

/// Checks that involve motion.
const MOVING: [&str; 12] = [
    "control",
    "one client",
    "bad numbers",
    "wrong lease",
    "pitch",
    "state rate",
    "shake",
    "repeats",
    "approach",
    "stop",
    "dead-man",
    "recover",
];

/// Shared by the motion checks.
pub(super) struct Subject<'a> {
    pub url: &'a str,
    pub raw: &'a Raw,
    pub states: &'a Watch,
    pub limits: Limits,
    pub bounds: &'a Bounds,
    pub looked: &'a Looked,
    pub tap: &'a Tap,
}

pub(super) fn check(url: &str, looked: &Looked, bounds: &Bounds, tap: &Tap) -> Vec<Check> {
    let mut found = Findings::of("arm");
    // FLIP's own client refuses a driver with a meaningless description.
    let arm = match Arm::connect(url, tap.clone(), Deadlines::default()) {
        Ok(arm) => arm,
        Err(error) => {
            found.add("describe", format!("{url}: Describe"), error.into());
            return found.checks;
        }
    };
    found.add("describe", format!("{url}: Describe"), described(&arm));
    let raw = match Raw::connect(url, tap) {
        Ok(raw) => raw,
        Err(error) => {
            found.add("state", "a second connection", error.into());
            return found.checks;
        }
    };
    let began = Instant::now();
    let states = raw.watch();
    std::thread::sleep(REST);
    let seen = states.since(began);
    found.add(
        "state",
        "the stream of its states, at rest",
        at_rest(&seen.iter().map(|seen| seen.state).collect::<Vec<_>>()),
    );
    let idle = seen.last().is_some_and(|seen| seen.state.mode() == Mode::Idle);
    // Its own pitch: a driver that does not refuse stays where it is.
    found.add("no lease", "Pitch to 0 deg without control", refusals::without_lease(&raw));
    let subject =
        Subject { url, raw: &raw, states: &states, limits: *arm.limits(), bounds, looked, tap };
    drop(arm);
    match (looked.empty_spoon, idle) {
        (true, true) => moving(&subject, &mut found),
        (true, false) => found.skip(&MOVING, "it is not idle"),
        (false, _) => found
            .skip(&MOVING, "nobody has said that the spoon is empty and the vial empty or away"),
    }
    found.skip(&["scoop and discard"], "a dry test has no powder");
    found.checks
}

fn described(arm: &Arm) -> Found {
    let (it, limits) = (arm.description(), arm.limits());
    let PitchLimits { lower_deg, upper_deg } = limits.pitch;
    let came = format!(
        "{}, serial {}, driver {}; pitch {lower_deg} to {upper_deg} deg, shake to {} mm",
        it.name, it.serial, it.driver_version, limits.shake_mm_max
    );
    if it.name.is_empty() || it.serial.is_empty() {
        return Found::failed(
            came,
            "the driver must give name and serial number: they stand in every weighing's record",
        );
    }
    if !it.can_scoop {
        return Found::warning(
            format!("{came}; it cannot fill its spoon"),
            "a person or a station fills the spoon before each dose: write filled_by = \"hand\" under [spoon] in the bench file",
        );
    }
    if limits.pitch.within(PitchLimits::WIDE) != PitchLimits::WIDE {
        let PitchLimits { lower_deg, upper_deg } = PitchLimits::WIDE;
        return Found::warning(
            came,
            format!(
                "policies are trained for {lower_deg} to {upper_deg} deg: doses keep to the narrower range and may end early"
            ),
        );
    }
    Found::ok(came)
}

fn at_rest(states: &[State]) -> Found {
    let (Some(first), Some(last)) = (states.first(), states.last()) else {
        return Found::failed(
            "no state came",
            "the driver must stream states from the moment it is asked",
        );
    };
    let hz = (states.len() - 1) as f64 / REST.as_secs_f64();
    let came = format!(
        "{:?}, {:?}, pitch {:.2} deg, {hz:.0} states in a second",
        last.mode(),
        last.station(),
        last.pitch_deg
    );
    let numbers = states.iter().all(|it| {
        [it.pitch_deg, it.shake_displacement_mm, it.measured_at_s].iter().all(|x| x.is_finite())
    });
    match last.mode() {
        Mode::Latched => {
            Found::failed(came, "a person must look at the arm; then it is told to recover")
        }
        Mode::Idle if !is_home(last) => {
            Found::failed(came, "an idle arm is level and retracted: see the contract's modes")
        }
        _ if !numbers || last.measured_at_s <= first.measured_at_s => {
            Found::failed(came, "every number must be finite, and the driver's clock must go on")
        }
        _ if hz < REST_HZ * 0.8 => {
            Found::failed(came, "at least 10 states in a second must come at rest")
        }
        Mode::Idle => Found::ok(came),
        _ => Found::warning(came, "somebody else has control: check again when it is idle"),
    }
}

/// Level, at rest on its axis, and away from the vial.
pub(super) fn is_home(state: &State) -> bool {
    state.station() == Station::Retracted
        && state.pitch_deg.abs() <= LEVEL_DEG
        && state.shake_displacement_mm.abs() <= AT_REST_MM
}

/// All motion checks; each part ends at home.
fn moving(subject: &Subject<'_>, found: &mut Findings) {
    let lease = Lease::acquire(subject);
    let dead_man_ms = lease.as_ref().map_err(Clone::clone).map(|lease| lease.dead_man_ms);
    found.add("control", "Acquire", refusals::control(dead_man_ms, subject.bounds));
    let Ok(mut lease) = lease else {
        found.skip(&MOVING[1..], "control was not given");
        return;
    };
    refusals::check(subject, &lease, found);
    motions::check(subject, &mut lease, found);
    stop::check(subject, &mut lease, found);
    let released = lease.release();
    if let Err(status) = released {
        found.add(
            "release",
            "Release",
            Found::failed(told(&status), "the driver must level, retract and let go"),
        );
        found.skip(&["dead-man", "recover"], "control could not be given back");
        return;
    }
    dead_man::check(subject, found);
}

/// Control of the arm. Dropping it releases control, unless renewals were ended on purpose.
pub(super) struct Lease<'a> {
    raw: &'a Raw,
    pub id: String,
    pub dead_man_ms: u32,
    pub sequence: u64,
    renewals: Option<Renewals>,
}

impl<'a> Lease<'a> {
    pub(super) fn acquire(subject: &Subject<'a>) -> Result<Self, Status> {
        let request = proto::AcquireRequest { client: "flip bench check".to_owned() };
        let raw = subject.raw;
        let lease =
            raw.ask("Acquire", CALL, |mut client| async move { client.acquire(request).await })?;
        let renewals = Some(raw.renew(&lease.lease_id));
        Ok(Self { raw, id: lease.lease_id, dead_man_ms: lease.dead_man_ms, sequence: 0, renewals })
    }

    /// A ticket for the next motion.
    pub(super) fn next(&mut self) -> Option<proto::Ticket> {
        self.sequence += 1;
        self.numbered(self.sequence)
    }

    pub(super) fn numbered(&self, sequence: u64) -> Option<proto::Ticket> {
        Some(proto::Ticket {
            lease_id: self.id.clone(),
            sequence,
            deadline_ms: MOTION.as_millis() as u32,
        })
    }

    pub(super) fn approach(&mut self) -> Result<Executed, Status> {
        let request = proto::ApproachRequest { ticket: self.next() };
        self.raw.ask("Approach", MOTION, |mut client| async move { client.approach(request).await })
    }

    pub(super) fn retract(&mut self) -> Result<Executed, Status> {
        let request = proto::RetractRequest { ticket: self.next() };
        self.raw.ask("Retract", MOTION, |mut client| async move { client.retract(request).await })
    }

    pub(super) fn pitch(&mut self, pitch_deg: f64) -> Result<Executed, Status> {
        let request = proto::PitchRequest { ticket: self.next(), pitch_deg };
        self.raw.ask(&format!("Pitch to {pitch_deg} deg"), MOTION, |mut client| async move {
            client.pitch(request).await
        })
    }

    pub(super) fn shake(&self, sequence: u64, amplitude_mm: f64) -> Result<Executed, Status> {
        let request = proto::ShakeRequest { ticket: self.numbered(sequence), amplitude_mm };
        self.raw.ask(
            &format!("{sequence} Shake by {amplitude_mm} mm"),
            MOTION,
            |mut client| async move { client.shake(request).await },
        )
    }

    pub(super) fn release(mut self) -> Result<(), Status> {
        let request = proto::ReleaseRequest { lease_id: self.id.clone() };
        let released = self
            .raw
            .ask("Release", MOTION, |mut client| async move { client.release(request).await });
        self.renewals = None;
        released.map(drop)
    }

    /// Stop renewing; returns when the last accepted renewal was sent.
    pub(super) fn abandon(&mut self) -> Option<Instant> {
        self.renewals.take().map(Renewals::end)
    }
}

impl Drop for Lease<'_> {
    fn drop(&mut self) {
        if self.renewals.is_some() {
            // There is nobody left to report a failure to: the dead-man acts on it.
            let request = proto::ReleaseRequest { lease_id: self.id.clone() };
            let _ = self
                .raw
                .ask("Release", MOTION, |mut client| async move { client.release(request).await });
        }
    }
}
