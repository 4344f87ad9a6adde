//! The requirements on every case, and the cause of an overdose.

use crate::bench::{Dose, Ran};
use crate::cases::{Case, Fault, When};
use crate::record::Entry;
use flip_bench::hardware::wire::Direction;
use flip_bench::weigh::Weighed;
use flip_core::domain::weighing::Outcome;

/// A display of whole milligrams is correct if it is no further from the true mass, mg.
const TRUE_MG: f64 = 1.5;
/// Masses that differ by less are equal up to rounding, mg.
const SAME_MG: f64 = 1e-6;

/// Why more than target and tolerance lies in the vial.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Excess {
    /// It does not.
    None,
    /// The healthy twin has as much.
    Twin,
    /// The motion in progress when the fault began.
    InFlight,
    /// A shake decided on a correct reading: the risk the guard takes without any fault.
    Chance,
    /// The fault.
    Fault,
}

/// Where the excess comes from.
///
/// The shake that passed the limit is the last one decided while no more than the limit lay in the
/// vial. If it was decided before the fault began, its powder was in flight; if afterwards on a
/// correct display, it is the risk the guard takes in every dose; otherwise the fault caused it.
pub fn excess(dose: Dose, case: &Case, ran: &Ran, twin_mg: f64) -> Excess {
    let limit_mg = dose.limit_mg();
    if ran.vial_mg <= limit_mg + SAME_MG {
        return Excess::None;
    }
    if ran.vial_mg <= twin_mg + SAME_MG {
        return Excess::Twin;
    }
    let decided = ran.record.entries.iter().enumerate().rev().find_map(|(at, entry)| match entry {
        Entry::Decision { allowed: Some(_), reading_mg, vial_mg }
            if *vial_mg <= limit_mg + SAME_MG =>
        {
            Some((at, (reading_mg - vial_mg).abs() <= TRUE_MG))
        }
        _ => None,
    });
    let is_wilder =
        matches!(case.fault, Fault::Arm(flip_bench::emulate::arm::Fault::ShakeTooLarge(_)));
    match (decided, ran.record.injected_at()) {
        _ if is_wilder => Excess::Fault,
        (Some((at, _)), Some(begun)) if at < begun => Excess::InFlight,
        (Some((_, true)), _) => Excess::Chance,
        _ => Excess::Fault,
    }
}

/// Everything wrong with how this case ended.
pub fn faults(dose: Dose, case: &Case, ran: &Ran, twin_mg: f64) -> Vec<String> {
    let mut wrong = Vec::new();
    if ran.record.injected_at().is_none() {
        wrong.push("its moment never came".to_owned());
    }
    if let Err(what) = ran.record.check() {
        wrong.push(format!("the record: {what}"));
    }
    let over_mg = ran.vial_mg - dose.limit_mg();
    match (excess(dose, case, ran, twin_mg), case.fault.unseen_mg()) {
        (Excess::Fault, None) => wrong.push(format!("the fault made it {over_mg:.2} mg too much")),
        (Excess::Fault, Some(most_mg)) if over_mg > most_mg => {
            wrong.push(format!("{over_mg:.2} mg too much, unseen, and {most_mg} mg are the bound"));
        }
        _ => {}
    }
    let is_safe = ran.is_level && ran.is_retracted;
    let must_look = ran.weighed.as_ref().map_or(true, |weighed| weighed.must_look);
    if !(is_safe || (ran.latched.is_some() && must_look)) {
        let Ran { is_level, is_retracted, latched, .. } = ran;
        wrong.push(format!(
            "level {is_level}, retracted {is_retracted}, latched {latched:?}, must look {must_look}"
        ));
    }
    wrong.extend(unnamed(ran));
    wrong.extend(untold(ran));
    wrong.extend(unheard(case, ran));
    wrong.extend(believed(case, ran));
    wrong
}

/// What the outcome or its cause leaves open.
fn unnamed(ran: &Ran) -> Option<String> {
    let (cause, outcome) = match &ran.weighed {
        Err(cause) => (Some(cause.as_str()), None),
        Ok(weighed) => (weighed.cause.as_deref(), Some(weighed.outcome)),
    };
    let needs_none = matches!(outcome, Some(Outcome::Within | Outcome::Under | Outcome::Over));
    match cause {
        None if needs_none => None,
        None => Some(format!("{outcome:?} without a cause")),
        Some(text) if text.contains("the log has the details") => {
            Some(format!("something panicked: {text}"))
        }
        Some(text) if needs_none || NAMED.iter().any(|name| text.contains(name)) => None,
        Some(text) => Some(format!("names nothing: {text}")),
    }
}

/// Names of things a person can check.
const NAMED: [&str; 6] =
    ["the balance", "the arm", "the gripper", "the reading", "the vial", "spoon"];

/// Received pieces of answers that are not on record.
fn unheard(case: &Case, ran: &Ran) -> Option<String> {
    let begun = ran.record.injected_at()?;
    let is_piece = case.fault == Fault::Balance(flip_bench::emulate::balance::Fault::PartialLine);
    let (mut asked, mut heard) = (0, 0);
    for entry in &ran.record.entries[begun..] {
        match entry {
            Entry::Passed(it) if it.device == "the balance" && it.direction == Direction::Sent => {
                asked += 1
            }
            Entry::Passed(it) if it.device == "the balance" => heard += 1,
            _ => {}
        }
    }
    (is_piece && asked > 0 && heard == 0)
        .then(|| "a piece of an answer is not on record".to_owned())
}

/// An invalid reading that was accepted: of an aborted dose, or of a balance that was switched on
/// again between the tare and the final reading.
fn believed(case: &Case, ran: &Ran) -> Option<String> {
    use flip_bench::emulate::balance::Fault::Restart;
    let weighed = ran.weighed.as_ref().ok()?;
    let Weighed { outcome, reading_mg, must_look, .. } = weighed;
    if *outcome == Outcome::Aborted && reading_mg.is_some() {
        return Some(format!("an aborted dose of {reading_mg:?} mg"));
    }
    let is_harmless = matches!(
        case.when,
        When::Opening
            | When::StandBefore
            | When::Scoop
            | When::Approach
            | When::Discard
            | When::Release
    );
    let is_told = *outcome == Outcome::Aborted && *must_look;
    (case.fault == Fault::Balance(Restart) && !is_harmless && !is_told)
        .then(|| format!("a balance that restarted is believed: {outcome:?}, {reading_mg:?} mg, must look {must_look}"))
}

/// The result does not match the record.
fn untold(ran: &Ran) -> Option<String> {
    let weighed = ran.weighed.as_ref().ok()?;
    let ticks: Vec<u32> = weighed.ticks.iter().map(|tick| tick.step).collect();
    (ticks != ran.record.ticks())
        .then(|| format!("ticks {ticks:?}, and {:?} were told", ran.record.ticks()))
}
