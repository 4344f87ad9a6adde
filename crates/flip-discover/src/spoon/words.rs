//! The tables and sentences of the document.

use super::field::{Fell, Field};
use super::screen::Screened;
use super::summaries::{Frame, total};
use super::{Plan, Settings};
use crate::report::spoon::{CourseReport, PowderReport, StepReport, SummaryRow};
use crate::report::{Verdict, names};
use flip_core::domain::shake::Spoonful;
use flip_core::stats::summary::mean;

/// A powder before causes are tried.
pub(super) fn unexplained_yet(
    field: &Field<'_>,
    plan: &Plan<'_>,
    screened: &Screened,
    given: usize,
) -> PowderReport {
    let mut report = PowderReport {
        powder: plan.of.powder.clone(),
        verdict: Verdict::NoDiscrepancy,
        sentence: String::new(),
        p_value: screened.p_value,
        p_corrected: screened.p_corrected,
        spoonfuls: [field.spoonfuls.len() as u32, given as u32],
        sets: plan.of.sets.len() as u32,
        summaries: summaries(field),
        courses: courses(field),
        causes: Vec::new(),
        families: Vec::new(),
        unknown_probability: 0.0,
        ambiguous_between: Vec::new(),
        gain: None,
        extension: None,
    };
    report.sentence = sentence(&report, false);
    report
}

/// A summary: its name, its unit, and how it is formed.
type Summary<'a> = (String, &'static str, Box<dyn Fn(&Fell) -> f64 + 'a>);

fn summaries(field: &Field<'_>) -> Vec<SummaryRow> {
    let keep: Vec<usize> = (0..field.spoonfuls.len()).collect();
    let frame = field.frame(&keep);
    let all = whole(&frame).into_iter().chain(cells(&frame));
    all.map(|(name, unit, of)| {
        let replayed = field.base.iter().map(|it| of(&it.fell)).collect();
        let [low, simulated, high] = band(replayed);
        let (unit, measured) = (unit.to_owned(), of(&field.measured));
        SummaryRow { name, unit, measured, simulated, band90: [low, high] }
    })
    .collect()
}

/// Numbers of whole spoonfuls.
fn whole<'a>(frame: &'a Frame<'a>) -> Vec<Summary<'a>> {
    let onset = |fell: &Fell| {
        let each = frame.spoonfuls.iter().zip(fell).map(|(of, fell)| of.onset_deg(fell));
        mean(&each.collect::<Vec<_>>()).unwrap_or(0.0)
    };
    let mass =
        |fell: &Fell| mean(&fell.iter().map(|fell| total(fell)).collect::<Vec<_>>()).unwrap_or(0.0);
    vec![
        ("onset".to_owned(), "deg", Box::new(onset)),
        ("total".to_owned(), "mg", Box::new(mass)),
        (
            "scatter of ln mass of steps".to_owned(),
            "",
            Box::new(|fell| frame.scatter(&slices(fell))),
        ),
    ]
}

/// Mean steps by pitch and stroke.
fn cells<'a>(frame: &'a Frame<'a>) -> Vec<Summary<'a>> {
    let of = |(c, cell): (usize, &super::summaries::Cell)| -> Summary<'a> {
        let [from, to] = cell.pitch_deg;
        let stroke = match cell.stroke_mm {
            [_, 0.0] => "no stroke".to_owned(),
            [0.0, most] => format!("strokes to {most:.1} mm"),
            [above, _] => format!("strokes above {above:.1} mm"),
        };
        let name = format!("step at {from:.0} to {to:.0} deg, {stroke}");
        (name, "mg", Box::new(move |fell: &Fell| frame.cell_mg(c, &slices(fell))))
    };
    frame.cells.iter().enumerate().map(of).collect()
}

fn slices(fell: &Fell) -> Vec<&[f64]> {
    fell.iter().map(Vec::as_slice).collect()
}

fn courses(field: &Field<'_>) -> Vec<CourseReport> {
    let of = |(j, (_, spoonful)): (usize, &(usize, &Spoonful))| {
        let cumulated = |fell: &Fell, k: usize| total(&fell[j][..=k]);
        let step = |k: usize| {
            let [low, simulated, high] =
                band(field.base.iter().map(|it| cumulated(&it.fell, k)).collect());
            StepReport {
                pitch_deg: spoonful.shakes[k].pitch_deg,
                shake_mm: spoonful.shakes[k].shake_mm,
                weighed_mg: cumulated(&field.measured, k),
                simulated_mg: simulated,
                band90_mg: [low, high],
            }
        };
        let steps: Vec<StepReport> = (0..spoonful.shakes.len()).map(step).collect();
        let filled = spoonful.shakes.first().and_then(|shake| shake.spoon_mg);
        let left_mg = filled
            .zip(steps.last())
            .map(|(filled, last)| [last.weighed_mg, last.simulated_mg].map(|fell| filled - fell));
        CourseReport {
            weighing: spoonful.weighing.clone(),
            spoonful: spoonful.spoonful,
            steps,
            left_mg,
            after_mg: None,
        }
    };
    field.spoonfuls.iter().enumerate().map(of).collect()
}

/// 5th, 50th and 95th percentile.
fn band(mut values: Vec<f64>) -> [f64; 3] {
    values.sort_unstable_by(f64::total_cmp);
    let at = |share: f64| values[(share * (values.len() - 1) as f64).round() as usize];
    [at(0.05), at(0.5), at(0.95)]
}

/// What a powder's spoonfuls say. `is_proposed`: one cause is probable.
pub(super) fn sentence(report: &PowderReport, is_proposed: bool) -> String {
    let powder = &report.powder;
    let Some(mass) = report.summaries.iter().find(|it| it.name == "total") else {
        return String::new();
    };
    let [low, high] = mass.band90;
    let masses = format!(
        "{powder}: {:.1} mg a spoonful were weighed where the calibrated simulator gives {:.1} mg ({low:.1} to {high:.1})",
        mass.measured, mass.simulated
    );
    let first = report.causes.first();
    let why = match (report.verdict, first) {
        (Verdict::NoDiscrepancy, _) if is_proposed => {
            "the cause that fits best has neither an effect nor a gain".to_owned()
        }
        (Verdict::NoDiscrepancy, _) => {
            format!("no discrepancy (p {:.2})", report.p_corrected)
        }
        (Verdict::Cause, Some(first)) => {
            format!(
                "{} ({:.0} %), amplitude {:.2} [{:.2}, {:.2}]",
                plain(first.cause.name().0),
                100.0 * first.probability,
                first.amplitude,
                first.amplitude_ci95[0],
                first.amplitude_ci95[1]
            ) + &gained(report)
        }
        (Verdict::Hint, Some(first)) => {
            format!("perhaps {}. {}", plain(first.cause.name().0), tells(&first.experiment))
        }
        (Verdict::Ambiguous, Some(first)) => {
            let open: Vec<String> = report.ambiguous_between.iter().map(|it| plain(it)).collect();
            let open = either(&open);
            let said = match report.named_family() {
                Some(it) => {
                    format!("{} ({:.0} %): {open}", family(&it.family), 100.0 * it.probability)
                }
                None => open,
            };
            let mended =
                report.extension.as_ref().map_or("", |_| ", and the first mends the simulator");
            format!("{said}{mended}{}. {}", gained(report), tells(&first.experiment))
        }
        _ => "no cause of the catalogue explains it".to_owned(),
    };
    format!("{masses}: {why}.").replace("..", ".")
}

/// What the causes of a family have in common.
fn family(name: &str) -> &str {
    match name {
        "spoon" => "the spoon holds powder back",
        "attraction" => "grains attract each other",
        "shape" => "grains interlock",
        "sizes" => "grains differ in size",
        "motion" => "the spoon moves otherwise than simulated",
        "filling" => "the spoon is filled otherwise than simulated",
        other => other,
    }
}

/// `a, b or c`.
fn either(names: &[String]) -> String {
    match names.split_last() {
        Some((last, others)) if !others.is_empty() => format!("{} or {last}", others.join(", ")),
        _ => names.concat(),
    }
}

/// The experiment that would decide.
fn tells(experiment: &str) -> String {
    format!("What would tell: {}", names::lower(experiment))
}

/// A cause in the middle of a sentence.
fn plain(cause: &str) -> String {
    names::lower(&names::cause(cause))
}

fn gained(report: &PowderReport) -> String {
    let gain = report.gain.as_ref().filter(|gain| gain.accepted);
    gain.map_or(String::new(), |gain| {
        format!(
            "; on {} spoonfuls left out the error falls from {:.1} to {:.1} mg (a sham: {:.1} mg)",
            gain.spoonfuls, gain.error_before_mg, gain.error_after_mg, gain.error_sham_mg
        )
    })
}

pub(super) fn all(reports: &[PowderReport]) -> String {
    reports.iter().map(|report| report.sentence.as_str()).collect::<Vec<_>>().join(" ")
}

pub(super) fn blind_spots(settings: &Settings, reports: &[PowderReport]) -> Vec<String> {
    let mut all = vec![
        format!(
            "Between spoonfuls masses may differ by {:.0} %, between days by {:.0} %: assumed, not measured.",
            100.0 * settings.spoonful_sd,
            100.0 * settings.day_sd
        ),
        "Replays make the recorded steps, which a weighing chose by what fell: an onset that chance made late looks late."
            .to_owned(),
        "One cause at a time is tried.".to_owned(),
    ];
    all.extend(reports.iter().filter(|it| it.spoonfuls[0] < it.spoonfuls[1]).map(|it| {
        let [judged, given] = it.spoonfuls;
        format!("{}: {judged} of {given} spoonfuls, as many as the replays allow.", it.powder)
    }));
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn causes_and_what_would_tell_them_apart_read_as_sentences() {
        let names = ["grain shape", "humidity", "adhesion"].map(str::to_owned);
        assert_eq!(either(&names), "grain shape, humidity or adhesion");
        assert_eq!(either(&names[..2]), "grain shape or humidity");
        assert_eq!((either(&names[..1]), either(&[])), ("grain shape".into(), String::new()));
        assert_eq!(tells("Weigh it again."), "What would tell: weigh it again.");
    }
}
