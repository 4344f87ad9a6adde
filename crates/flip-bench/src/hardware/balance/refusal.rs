//! Answers that are no number, as errors that say what to do.

use super::*;

impl Condition {
    /// Whether the condition may be over in a moment, so that a retry is worthwhile.
    pub(super) fn passes(&self) -> bool {
        matches!(self, Self::NotReady | Self::NotStable | Self::NoUnit)
    }
}

/// The error returned instead of a number.
pub(super) fn refusal(condition: Condition) -> DeviceError {
    faulted(match condition {
        Condition::Overload => "overload: take something off the pan".to_owned(),
        Condition::Underload => "underload: is the pan in place and free?".to_owned(),
        Condition::NotReady => {
            "not ready: it may be adjusting itself, or a person uses its keys, or it may be in standby: switch it on"
                .to_owned()
        }
        Condition::NoUnit => {
            "not ready: its readings carry no unit, as those that are not stable do; if it never flags one stable write stable_by = \"window\" and \
             readability_mg under [balance] in the bench file"
                .to_owned()
        }
        Condition::Standby => "its display is off: it is in standby, switch it on".to_owned(),
        Condition::NotStable => "no stable reading: keep draughts and vibration away".to_owned(),
        Condition::Unknown => {
            "it does not know a command that every balance of this dialect should: is the dialect right?".to_owned()
        }
        Condition::ForeignUnit(unit) => format!("it shows {unit}: set its unit to g or mg"),
        Condition::Fault(words) => words,
        Condition::Adjusting => {
            let cause = "it adjusts itself: wait until it has ended, then tare again".to_owned();
            return DeviceError::Forbidden { device: DEVICE, cause };
        }
    })
}

/// Interpret the acknowledgement of a command. A damaged one is ignored: the display shows the
/// outcome.
pub(super) fn obeyed(
    answer: Result<(Reply, Vec<u8>), DeviceError>,
    verb: &str,
) -> Result<(), DeviceError> {
    match answer {
        Ok((Reply { said: Said::Condition(Condition::NotReady), .. }, _)) => {
            Err(faulted(format!("it refused to {verb}: not stable, or busy")))
        }
        Ok((
            Reply { said: Said::Condition(Condition::Overload | Condition::Underload), .. },
            _,
        )) => Err(faulted(format!("it refused to {verb}: too much or too little on the pan"))),
        Ok((Reply { said: Said::Condition(Condition::Unknown), .. }, _)) => {
            Err(faulted(format!("it does not know how to {verb} by command, or must not")))
        }
        Ok((Reply { said: Said::Condition(condition), .. }, _)) => Err(refusal(condition)),
        Ok(_) | Err(DeviceError::Garbled { .. }) => Ok(()),
        Err(error) => Err(error),
    }
}

/// A display with steps of `step_mg` shows no other numbers.
pub(super) fn in_steps_of(
    step_mg: f64,
    weight: &Weight,
    unit: Unit,
    raw: &[u8],
) -> Result<(), DeviceError> {
    let why = match weight.number.is_in_steps_of(step_mg, unit) {
        Fit::Fits => return Ok(()),
        Fit::OtherPlace => "the last place should be",
        Fit::Between => "it should step by",
    };
    Err(DeviceError::Garbled {
        device: DEVICE,
        got: format!("{} ({why} {step_mg} mg)", shown(raw)),
    })
}

pub(super) fn faulted(cause: String) -> DeviceError {
    DeviceError::Faulted { device: DEVICE, cause }
}

pub(super) fn garbled(raw: &[u8]) -> DeviceError {
    DeviceError::Garbled { device: DEVICE, got: shown(raw) }
}

/// A limit from the settings or a caller.
pub(super) fn seconds(limit_s: f64) -> Duration {
    Duration::try_from_secs_f64(limit_s).unwrap_or(Duration::ZERO)
}
