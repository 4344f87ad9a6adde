//! The sections of a report below its sentence. A section without content is empty.

use super::Named;
use super::figures::{self, Sample};
use super::table::{left, right, row, section, table, wrapped};
use super::words::{
    cause, chance, column, column_with_unit, counted, duration, interval, num, percent, signed,
    span,
};
use flip_discover::report::{Channel, Experiment, Finding, PowderEffect, Report, SideChannel};
use flip_discover::{Mechanism, is_told};
use maud::{Markup, html};

/// Maximum number of residual figures.
const FIGURES_MAX: usize = 8;
/// Number of colour shades of an effect.
const SHADES: f64 = 4.0;

/// Covariates in the order a reader wants to see them: those of findings, those of causes by
/// decreasing probability, all others.
fn covariates(report: &Report) -> Vec<&str> {
    let of_findings = report.findings.iter().filter_map(|finding| finding.covariate.as_deref());
    let of_unexplained = report.unexplained.iter().filter_map(|it| it.covariate.as_deref());
    let of_evidence =
        report.evidence.iter().flat_map(|it| match it.cause.strip_prefix("unknown: ") {
            Some(covariate) => vec![covariate],
            None => {
                let known = Mechanism::ALL.iter().find(|mechanism| mechanism.name().0 == it.cause);
                known.map_or(Vec::new(), |mechanism| mechanism.covariates().to_vec())
            }
        });
    let mut order: Vec<&str> = Vec::new();
    for name in of_findings.chain(of_unexplained).chain(of_evidence) {
        if !order.contains(&name) {
            order.push(name);
        }
    }
    order
}

pub fn residuals(report: &Report, named: Named) -> Markup {
    let order = covariates(report);
    let mut curves: Vec<_> = report.curves.iter().collect();
    curves.sort_by_key(|curve| {
        order.iter().position(|name| *name == curve.covariate).unwrap_or(order.len())
    });
    let drawn: Vec<Markup> =
        curves.iter().filter_map(|curve| figures::residuals(report, curve)).collect();
    if drawn.is_empty() {
        return html! {};
    }
    let missing = report.curves.iter().any(|curve| curve.at.iter().any(Option::is_none));
    let mut samples = vec![
        (Sample::Zero, "simulated before"),
        (
            Sample::Course,
            "with the findings: the average over powders, and the band around it that should hold \
             90 % of runs",
        ),
    ];
    if missing {
        samples.push((Sample::Missing, "not recorded"));
    }
    let left_out = drawn.len().saturating_sub(FIGURES_MAX);
    section(
        "Where measured and simulated angles differ",
        "Each mark is one row of the file. Each powder's mean is fitted, so look for a trend along \
         a condition. Marks fall outside the band when a powder responds differently from the \
         average, or because of other conditions.",
        &html! {
            (figures::legend(&figures::powders(&report.rows), named, &samples))
            div.figures { @for figure in drawn.iter().take(FIGURES_MAX) { (figure) } }
            @if left_out > 0 {
                p.note {
                    (counted(left_out, "less important recorded condition"))
                    (if left_out == 1 { " is" } else { " are" }) " not plotted."
                }
            }
        },
    )
}

pub fn by_powder(report: &Report, named: Named) -> Markup {
    let findings: Vec<&Finding> =
        report.findings.iter().filter(|it| it.channel != Channel::Trace).collect();
    if findings.is_empty() {
        return html! {};
    }
    let mut powders: Vec<&str> = Vec::new();
    for it in findings.iter().flat_map(|finding| &finding.by_powder) {
        if !powders.contains(&it.powder.as_str()) {
            powders.push(&it.powder);
        }
    }
    // Degrees and percent have separate shades.
    let most = |unit: &str| {
        let alike = findings.iter().filter(|it| it.unit == unit);
        let all = alike.flat_map(|f| f.by_powder.iter().map(|it| it.effect).chain([f.effect]));
        all.map(f64::abs).filter(|it| it.is_finite()).fold(1e-9, f64::max)
    };
    let line = |name: &str, of: &dyn Fn(&Finding) -> Option<PowderEffect>| {
        html! {
            tr {
                th scope="row" { (name) }
                @for it in &findings { (effect(of(it), most(&it.unit), &it.unit)) }
            }
        }
    };
    let mut rows: Vec<Markup> = powders
        .iter()
        .map(|powder| {
            line(&named(powder), &|finding| {
                finding.by_powder.iter().find(|it| it.powder == *powder).cloned()
            })
        })
        .collect();
    rows.push(line("On average", &|finding| {
        let (effect, ci95) = (finding.effect, finding.ci95);
        finding.powder.is_none().then(|| PowderEffect { powder: String::new(), effect, ci95 })
    }));
    let headings: Vec<Markup> =
        [left("Powder")].into_iter().chain(findings.iter().map(|it| right(heading(it)))).collect();
    section(
        "Effect on each powder",
        "How far the measurement changes from one end of the condition's range to the other, with \
         its 95 % interval. Bold: the interval excludes zero.",
        &table("Effect on each powder", "heat", &headings, &rows),
    )
}

/// Measurements other than the angle.
pub fn beside(report: &Report) -> Markup {
    let line = |it: &SideChannel| {
        let name = match it.channel {
            Channel::FlowTime => "Flow times",
            _ => "Scatter of repeats",
        };
        let result = match it.sentence.as_str() {
            "" => "No difference found.",
            sentence => sentence,
        };
        row(name, &[html! { (it.n) }, html! { (chance(it.p_value)) }, wrapped(result)])
    };
    let rows: Vec<Markup> = report.beside.iter().map(line).collect();
    if rows.is_empty() {
        return html! {};
    }
    let headings = [left("Measurement"), right("Values"), right("p"), left("Result")];
    section(
        "Other measurements",
        "Each is judged separately, in the same way as the angles. The simulator does not predict \
         how far repeats scatter, so scatter alone is not a discrepancy.",
        &table("Other measurements", "", &headings, &rows),
    )
}

fn heading(finding: &Finding) -> Markup {
    let channel = match finding.channel {
        Channel::Repose => "",
        Channel::FlowTime => "Flow time: ",
        Channel::Trace => "Balance readings: ",
        Channel::Scatter => "Scatter: ",
    };
    let what =
        finding.covariate.as_deref().map_or("Nothing recorded".to_owned(), |name| column(name).0);
    html! {
        (channel) (what) ", " (span(&finding.span, &what))
        @match finding.unit.as_str() {
            "" | "1" => {},
            "deg" => " (°)",
            unit => { " (" (unit) ")" },
        }
    }
}

fn effect(effect: Option<PowderEffect>, most: f64, unit: &str) -> Markup {
    let Some(it) = effect else { return html! { td.small { "–" } } };
    let shade = (SHADES * it.effect.abs() / most).round().clamp(0.0, SHADES);
    let shade = match (it.effect > 0.0, shade as u32) {
        (_, 0) => String::new(),
        (true, shade) => format!(" up{shade}"),
        (false, shade) => format!(" down{shade}"),
    };
    let sure = if is_told(it.ci95, unit) { "sure" } else { "plain-effect" };
    html! {
        td class={ (sure) (shade) } {
            (signed(it.effect, 1)) " " span.small { (interval(it.ci95, 1)) }
        }
    }
}

pub fn blind_spots(report: &Report) -> Markup {
    if report.blind_spots.is_empty() {
        return html! {};
    }
    section(
        "What these data cannot show",
        "No claim is made about these, neither that they are present nor that they are absent.",
        &html! { ul.plain { @for spot in &report.blind_spots { li { (spot) } } } },
    )
}

/// Columns that are not conditions; empty if there are none.
pub fn left_out(report: &Report) -> Markup {
    if report.left_out.is_empty() {
        return html! {};
    }
    let rows: Vec<Markup> = report
        .left_out
        .iter()
        .map(|it| row(column_with_unit(&it.column), &[wrapped(&it.reason)]))
        .collect();
    section(
        "Columns that were left out",
        "A condition is set or recorded before a heap is poured. What is read off the heap \
         afterwards may explain its angle, but cannot cause it.",
        &table("Columns that were left out", "", &[left("Column"), left("Reason")], &rows),
    )
}

pub fn null_check(report: &Report) -> Markup {
    // Balance readings have their own section.
    if report.traces.as_ref().is_some_and(|it| it.null_check == report.null_check) {
        return html! {};
    }
    let check = &report.null_check;
    let detectable: Vec<Markup> = report
        .minimum_detectable
        .iter()
        .map(|it| {
            let cells = [html! { (num(it.effect_deg, 1)) }, html! { (percent(it.power)) }];
            row(cause(&it.mechanism), &cells)
        })
        .collect();
    let headings = [left("Cause"), right("Smallest effect (°)"), right("Found in (%)")];
    section(
        "Null check",
        "How often this much is found when nothing is wrong.",
        &html! {
            @if let Some((statistic, threshold95)) = check.statistic.zip(check.threshold95) {
                p {
                    (counted(check.campaigns as usize, "campaign"))
                    " of this design (same powders, days, repeats and gaps) were simulated with "
                    "nothing wrong, and the whole search was run on each. The statistic is the "
                    "natural log of the strongest evidence for any cause, weighted by the cause's "
                    "prior probability. One in twenty exceeds " (num(threshold95, 1))
                    "; here it is " (num(statistic, 1)) ", p\u{a0}=\u{a0}"
                    (chance(report.p_value)) "."
                }
                div.figures { (figures::null_scale(check)) }
            }
            @if !detectable.is_empty() {
                p.note {
                    "The smallest effects that this design would find, as the change in angle from "
                    "the 5th to the 95th percentile of the condition, the same for all powders. "
                    "Smaller effects are easily missed."
                }
                (table("Smallest detectable effects", "", &headings, &detectable))
            }
        },
    )
}

pub fn experiment(report: &Report) -> Markup {
    let Some(it) = &report.suggested_experiment else { return html! {} };
    section(
        "The next experiment",
        "The most informative experiment. Do the runs in this order.",
        &experiment_card(it, "Runs of the next experiment"),
    )
}

/// An experiment in words, and the table of its runs.
pub(super) fn experiment_card(it: &Experiment, caption: &str) -> Markup {
    html! {
        div.card {
            p { strong { (it.what) } }
            dl.facts {
                div { dt { "Time needed" } dd { (duration(60.0 * it.minutes)) } }
                @if let Some(chance) = it.chance_of_resolution {
                    div { dt { "Chance of settling the cause" } dd { (percent(chance)) " %" } }
                }
                @if let Some(posterior) = it.expected_posterior {
                    div {
                        dt { "Probability of the right cause afterwards" }
                        dd { (percent(posterior)) " % " small { "on average" } }
                    }
                }
            }
        }
        (runs(it, caption))
    }
}

fn runs(experiment: &Experiment, caption: &str) -> Markup {
    let mut columns: Vec<&str> = Vec::new();
    for name in experiment.runs.iter().flat_map(|run| run.keys()) {
        if !columns.contains(&name.as_str()) {
            columns.push(name);
        }
    }
    columns.sort_by_key(|name| *name != "powder");
    if columns.is_empty() {
        return html! {};
    }
    let named = columns.iter().map(|name| right(column_with_unit(name)));
    let headings: Vec<Markup> = [left("Run")].into_iter().chain(named).collect();
    let rows: Vec<Markup> = experiment
        .runs
        .iter()
        .zip(1_u32..)
        .map(|(run, number)| {
            let cell = |name: &&str| html! { (run.get(*name).map_or("–", String::as_str)) };
            row(number, &columns.iter().map(cell).collect::<Vec<_>>())
        })
        .collect();
    table(caption, "", &headings, &rows)
}
