//! Messages of an arm's driver process: how prost decodes them, and what the client accepts.

use crate::engine::{Seen, Target, bounded, outcome};
use flip_bench::hardware::arm::{Limits, checked, proto};
use flip_core::domain::bench::{PitchLimits, Reach, SHAKE_MM_MAX};
use prost::Message;
use std::fmt::Debug;

pub const DESCRIPTION: Target = Target {
    name: "arm_description",
    check: check_description,
    repair: None,
    words: &[],
    bytes_max: 512,
};
pub const MESSAGE: Target =
    Target { name: "arm_message", check: check_message, repair: None, words: &[], bytes_max: 512 };

/// Memory that decoding may use: text of the message's own length, and the message itself.
fn bytes_max(bytes: &[u8]) -> usize {
    4 * bytes.len() + (4 << 10)
}

fn check_description(bytes: &[u8]) -> Result<Seen, String> {
    let Ok(description) = bounded(bytes_max(bytes), || proto::Description::decode(bytes))? else {
        return Ok(Seen::Refused(0));
    };
    same_when_written(&description)?;
    let Ok(limits) = Limits::narrowed(description.limits.as_ref()) else {
        let limits = description.limits;
        return Ok(Seen::Refused(outcome(limits.map(|limits| format!("{:?}", kinds(&limits))))));
    };
    let PitchLimits { lower_deg, upper_deg } = limits.pitch;
    let motion = limits.motion;
    let speeds = [
        limits.pitch_deg_s_max,
        limits.shake_mm_max,
        motion.velocity_m_s,
        motion.acceleration_m_s2,
        motion.jerk_m_s3,
    ];
    let is_narrow = (Reach::FULL.pitch.lower_deg..=0.0).contains(&lower_deg)
        && (0.0..=Reach::FULL.pitch.upper_deg).contains(&upper_deg)
        && limits.shake_mm_max <= SHAKE_MM_MAX
        && speeds.iter().all(|speed| speed.is_finite() && *speed > 0.0);
    if !is_narrow {
        return Err(format!("limits wider than those of an action: {limits:?}"));
    }
    for asked in
        [f64::NAN, f64::INFINITY, lower_deg - 1.0, upper_deg + 1.0, lower_deg, upper_deg, 0.0]
    {
        let may = limits.pitch_deg(asked).is_ok();
        if may != (asked >= lower_deg && asked <= upper_deg) {
            return Err(format!("a pitch of {asked} deg within {lower_deg} to {upper_deg}: {may}"));
        }
    }
    if limits.shake_mm(limits.shake_mm_max.next_up()).is_ok() || limits.shake_mm(-0.001).is_ok() {
        return Err(format!("a shake beyond {limits:?} may be asked for"));
    }
    Ok(Seen::Read(outcome((
        description.protocol_version == 1,
        lower_deg == Reach::FULL.pitch.lower_deg,
    ))))
}

/// The first byte selects the type of the message in the rest.
fn check_message(bytes: &[u8]) -> Result<Seen, String> {
    let Some((which, body)) = bytes.split_first() else { return Ok(Seen::Refused(0)) };
    match which % 11 {
        0 => check_executed(body),
        1 => check_state(body),
        2 => plain::<proto::Lease>(body),
        3 => plain::<proto::RenewResponse>(body),
        4 => plain::<proto::PitchRequest>(body),
        5 => plain::<proto::ShakeRequest>(body),
        6 => plain::<proto::AcquireRequest>(body),
        7 => plain::<proto::StopRequest>(body),
        8 => plain::<proto::RecoverRequest>(body),
        9 => plain::<proto::ReleaseRequest>(body),
        _ => plain::<proto::Ticket>(body),
    }
}

fn check_executed(body: &[u8]) -> Result<Seen, String> {
    let Ok(executed) = bounded(bytes_max(body), || proto::Executed::decode(body))? else {
        return Ok(Seen::Refused(1));
    };
    same_when_written(&executed)?;
    let sequence = executed.sequence;
    if checked(executed, sequence.wrapping_add(1)).is_ok() {
        return Err(format!("an answer to motion {sequence} is taken for the next one's"));
    }
    let Ok(believed) = checked(executed, sequence) else { return Ok(Seen::Refused(2)) };
    let lengths = [believed.amplitude_mm, believed.peak_speed_m_s, believed.duration_s];
    if !believed.pitch_deg.is_finite()
        || lengths.iter().any(|length| !(length.is_finite() && *length >= 0.0))
    {
        return Err(format!("no motion can have been {believed:?}"));
    }
    Ok(Seen::Read(outcome(("executed", lengths.map(|length| length > 0.0)))))
}

fn check_state(body: &[u8]) -> Result<Seen, String> {
    let Ok(state) = bounded(bytes_max(body), || proto::State::decode(body))? else {
        return Ok(Seen::Refused(3));
    };
    same_when_written(&state)?;
    // A mode or station unknown to FLIP is never one it acts on.
    let known = (
        proto::Mode::try_from(state.mode).is_ok(),
        proto::Station::try_from(state.station).is_ok(),
    );
    let is_unspecified =
        (state.mode() == proto::Mode::Unspecified, state.station() == proto::Station::Unspecified);
    if (!known.0 && !is_unspecified.0) || (!known.1 && !is_unspecified.1) {
        return Err(format!("an unknown mode or station is taken for a known one: {state:?}"));
    }
    Ok(Seen::Read(outcome((state.mode(), state.station(), state.last_shake.is_some()))))
}

fn plain<M: Message + Default + Debug>(body: &[u8]) -> Result<Seen, String> {
    let Ok(message) = bounded(bytes_max(body), || M::decode(body))? else {
        return Ok(Seen::Refused(4));
    };
    same_when_written(&message)?;
    Ok(Seen::Read(outcome((std::any::type_name::<M>(), message.encoded_len() > 0))))
}

/// Bytes are compared, because NaN does not equal itself.
fn same_when_written<M: Message + Default + Debug>(message: &M) -> Result<(), String> {
    let written = message.encode_to_vec();
    match M::decode(written.as_slice()).map(|again| again.encode_to_vec() == written) {
        Ok(true) => Ok(()),
        other => Err(format!("written and read again it differs: {message:?}, {other:?}")),
    }
}

/// Which of the limits are meaningful.
fn kinds(limits: &proto::Limits) -> [bool; 6] {
    [
        limits.pitch_deg_s_max,
        limits.shake_mm_max,
        limits.velocity_m_s_max,
        limits.acceleration_m_s2_max,
        limits.jerk_m_s3_max,
        -limits.pitch_deg_min,
    ]
    .map(|number| number.is_finite() && number > 0.0)
}
