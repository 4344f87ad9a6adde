//! A document's sentences about balance readings, made from its numbers, and the controls that
//! would prove a cause.

use super::{Kind, TraceCause, TraceJudged, TraceMechanism, TraceScreening, Traces};
use crate::report::printed::is_told;
use crate::report::sizes;
use crate::report::{Experiment, TraceChannel, Verdict};
use std::collections::BTreeMap;

/// One run of a control: column and value.
type Settings = &'static [(&'static str, &'static str)];

/// A control that shows one cause and no other: what to do, the runs in their order, minutes.
struct Control {
    what: &'static str,
    runs: &'static [Settings],
    minutes: f64,
}

const EMPTY_PAN: Settings = &[("kind", "zero"), ("duration_s", "600")];
const STANDARD: Settings = &[("kind", "standard"), ("duration_s", "600")];

fn control(cause: TraceCause) -> Control {
    let TraceCause::Known(mechanism) = cause else {
        return Control {
            what: "log the empty pan and a covered standard mass for ten minutes each: what wanders in both is the balance or its surroundings, \
                   what wanders in neither is the vial",
            runs: &[EMPTY_PAN, STANDARD],
            minutes: 20.0,
        };
    };
    let (what, runs, minutes): (&'static str, &'static [Settings], f64) = match mechanism {
        TraceMechanism::BalanceDrift => (
            "log the empty pan for ten minutes, then a covered standard mass for ten minutes: a drift of the balance goes on in both, a change \
             of the vial in neither",
            &[EMPTY_PAN, STANDARD],
            20.0,
        ),
        TraceMechanism::BalanceLag => (
            "put a standard mass of the size of a dose on the pan and take it off, five times each, and log ten readings a second: a lag of \
             the balance follows each step, with no powder there",
            &[&[("kind", "standard"), ("steps", "10"), ("reading_every_s", "0.1")]],
            5.0,
        ),
        TraceMechanism::MassUptake | TraceMechanism::Evaporation => (
            "weigh a dose and log the vial for ten minutes open and ten minutes covered, and the empty pan for ten minutes: what the air gives \
             to the vial or takes from it stops under the cover, a drift of the balance goes on",
            &[
                &[("kind", "dose"), ("vial", "open"), ("duration_s", "600")],
                &[("kind", "dose"), ("vial", "covered"), ("duration_s", "600")],
                EMPTY_PAN,
            ],
            35.0,
        ),
        TraceMechanism::BalanceStatic => (
            "weigh three doses with an ioniser at the pan and three without, in turn: only charge goes away with it",
            &[
                &[("kind", "dose"), ("ioniser_on", "1")],
                &[("kind", "dose"), ("ioniser_on", "0")],
                &[("kind", "dose"), ("ioniser_on", "0")],
                &[("kind", "dose"), ("ioniser_on", "1")],
                &[("kind", "dose"), ("ioniser_on", "1")],
                &[("kind", "dose"), ("ioniser_on", "0")],
            ],
            15.0,
        ),
        TraceMechanism::VibrationNoise => (
            "log the empty pan for five minutes with everything that shakes the bench off, and five with it on",
            &[
                &[("kind", "zero"), ("bench", "still"), ("duration_s", "300")],
                &[("kind", "zero"), ("bench", "shaken"), ("duration_s", "300")],
            ],
            10.0,
        ),
        TraceMechanism::SpoonHoldup => (
            "weigh three doses from a clean spoon and three from one that was filled, shaken empty and filled again, in turn: what the spoon \
             keeps it keeps once",
            &[
                &[("kind", "dose"), ("spoon", "clean")],
                &[("kind", "dose"), ("spoon", "coated")],
                &[("kind", "dose"), ("spoon", "coated")],
                &[("kind", "dose"), ("spoon", "clean")],
                &[("kind", "dose"), ("spoon", "clean")],
                &[("kind", "dose"), ("spoon", "coated")],
            ],
            20.0,
        ),
        TraceMechanism::FillLevel => (
            "weigh three doses from a full spoon and three from a third of it, in turn, with the same shakes",
            &[
                &[("kind", "dose"), ("spoon", "full")],
                &[("kind", "dose"), ("spoon", "third")],
                &[("kind", "dose"), ("spoon", "third")],
                &[("kind", "dose"), ("spoon", "full")],
                &[("kind", "dose"), ("spoon", "full")],
                &[("kind", "dose"), ("spoon", "third")],
            ],
            20.0,
        ),
        TraceMechanism::Densification => (
            "weigh six doses with the same shakes; in every second one stop after shake 8 and stir the powder in the spoon, but add none: packed powder \
             then lets fall again what it did at first, a spoon that has emptied does not",
            &[
                &[("kind", "dose"), ("after_shake_8", "go on")],
                &[("kind", "dose"), ("after_shake_8", "stir")],
                &[("kind", "dose"), ("after_shake_8", "go on")],
                &[("kind", "dose"), ("after_shake_8", "stir")],
                &[("kind", "dose"), ("after_shake_8", "go on")],
                &[("kind", "dose"), ("after_shake_8", "stir")],
            ],
            25.0,
        ),
        TraceMechanism::Actuator => (
            "command ten shakes each of the smallest, a middle and the largest amplitude without powder and measure the spoon's travel",
            &[
                &[("amplitude", "smallest"), ("shakes", "10")],
                &[("amplitude", "middle"), ("shakes", "10")],
                &[("amplitude", "largest"), ("shakes", "10")],
            ],
            10.0,
        ),
    };
    Control { what, runs, minutes }
}

/// The control that would prove the most probable cause and rule the others out; nothing where
/// nothing is wrong.
pub(super) fn experiment(told: &[TraceCause], verdict: Verdict) -> Option<Experiment> {
    let first = told.first().filter(|_| verdict != Verdict::NoDiscrepancy)?;
    let Control { what, runs, minutes } = control(*first);
    let run = |settings: &Settings| {
        settings.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned()))
    };
    Some(Experiment {
        what: what.to_owned(),
        runs: runs.iter().map(|settings| run(settings).collect::<BTreeMap<_, _>>()).collect(),
        minutes,
        chance_of_resolution: None,
        expected_posterior: None,
    })
}

/// The effect of a cause, worded for a chemist.
fn spoken(cause: TraceCause) -> &'static str {
    let TraceCause::Known(mechanism) = cause else {
        return "readings wander, in each weighing in their own way";
    };
    match mechanism {
        TraceMechanism::BalanceDrift => "the balance drifts, whatever is on it",
        TraceMechanism::BalanceLag => "the balance follows a shake later than the simulated one",
        TraceMechanism::MassUptake => "the powder in the vial gains mass",
        TraceMechanism::Evaporation => "the vial loses mass",
        TraceMechanism::BalanceStatic => "charge pulls at the pan after each shake",
        TraceMechanism::VibrationNoise => "readings scatter more where the bench vibrates more",
        TraceMechanism::SpoonHoldup => {
            "the spoon keeps part of what its first shakes would let fall"
        }
        TraceMechanism::FillLevel => "a fuller spoon lets fall more than simulated",
        TraceMechanism::Densification => "shaken powder packs and lets fall less",
        TraceMechanism::Actuator => "shakes are not as long as they were commanded to be",
    }
}

/// What readings depart from: the simulated balance, or the law fitted to the shakes, which is no
/// simulated spoon.
fn departs(cause: TraceCause) -> &'static str {
    match is_of_spoon(cause) {
        true => "Masses of shakes depart from a law of amplitude, pitch and powder",
        false => "Balance readings depart from the simulated balance",
    }
}

fn is_of_spoon(cause: TraceCause) -> bool {
    use TraceMechanism::{Actuator, Densification, FillLevel, SpoonHoldup};
    matches!(cause, TraceCause::Known(SpoonHoldup | FillLevel | Densification | Actuator))
}

/// The quantity the effect changes.
fn changed(cause: TraceCause) -> &'static str {
    match cause {
        TraceCause::Known(TraceMechanism::VibrationNoise) => "the SD of a reading changes by ",
        cause if is_of_spoon(cause) => "the mass of a shake changes by ",
        _ => "",
    }
}

fn sized(judged: &TraceJudged) -> String {
    let Some(effect) = judged.effect.as_ref().filter(|it| is_told(it.ci95, it.unit)) else {
        return String::new();
    };
    format!(
        ": {}{} {}",
        changed(judged.mechanism),
        sizes::sized(effect.value, effect.ci95, effect.unit),
        effect.span
    )
}

/// What balance readings show, in one sentence or two.
pub(super) fn sentence(told: &[&TraceJudged], channel: &TraceChannel) -> String {
    let unjudged = channel.unjudged.as_ref();
    let unjudged = unjudged
        .map_or(String::new(), |why| format!("What the spoon lets fall is not judged: {why}."));
    let first = match (channel.verdict, told) {
        (Verdict::Cause, [one, ..]) => format!(
            "{}, because {}{} (probability {:.0} %).",
            departs(one.mechanism),
            spoken(one.mechanism),
            sized(one),
            100.0 * one.probability
        ),
        (Verdict::Hint, [one, ..]) => format!(
            "A hint, and no cause yet, perhaps because {}, but that changes nothing that is told from zero.",
            spoken(one.mechanism)
        ),
        (Verdict::Ambiguous, [one, ..]) => {
            let names: Vec<&str> = told.iter().map(|judged| spoken(judged.mechanism)).collect();
            format!(
                "{}{}, and these data cannot tell whether {}.",
                departs(one.mechanism),
                sized(one),
                names.join(" or ")
            )
        }
        (Verdict::Unexplained, _) => {
            "Balance readings wander, in each weighing in their own way, and no cause of the catalogue does that."
                .to_owned()
        }
        _ => {
            let chance = 100.0 * channel.p_value;
            let shown = match told.is_empty() && channel.p_value >= 1.0 && channel.unjudged.is_some() {
                true => String::new(),
                false => format!(
                    "Balance readings show no discrepancy: evidence as strong arises by chance in {chance:.0} % of such weighings."
                ),
            };
            let parts = [shown, unjudged];
            return parts.iter().filter(|it| !it.is_empty()).map(String::as_str).collect::<Vec<_>>().join(" ");
        }
    };
    let first = [first, unjudged].join(" ").trim_end().to_owned();
    let opening = if channel.verdict == Verdict::Ambiguous {
        "What would tell them apart"
    } else {
        "What would prove it"
    };
    match &channel.suggested_experiment {
        Some(it) => format!("{first} {opening}: {} ({:.0} minutes).", it.what, it.minutes),
        None => first,
    }
}

/// What cannot be seen with these readings.
pub(super) fn blind_spots(traces: &Traces, screening: &TraceScreening) -> Vec<String> {
    let mut spots = vec![
        "What a powder's own response to amplitude and pitch of the spoon explains, and where the balance ends up after each shake: calibration \
         takes both from these weighings, so what moves all shakes of a powder alike is absorbed there."
            .to_owned(),
    ];
    let has = |kind: Kind| traces.weighings.iter().any(|weighing| weighing.kind == kind);
    match (has(Kind::Zero), has(Kind::Standard)) {
        (true, true) => {}
        (false, false) => spots.push(
            "What the balance does by itself: neither the empty pan nor a standard mass was logged, so a change of the vial may pass for one of the \
             balance."
                .to_owned(),
        ),
        (has_zero, _) => spots.push(format!(
            "What the balance does {}: {} was not logged.",
            if has_zero { "under a load that does not change" } else { "with nothing on it" },
            if has_zero { "a standard mass" } else { "the empty pan" },
        )),
    }
    if !screening.untestable.is_empty() {
        let names: Vec<String> = screening
            .untestable
            .iter()
            .map(|(mechanism, _)| mechanism.name().0.replace('_', " "))
            .collect();
        spots.push(format!(
            "Of the bench: {}. What they need was not recorded, or did not vary.",
            names.join(", ")
        ));
    }
    spots
}
