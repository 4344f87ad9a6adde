//! The sections of a report below its sentence. A section without content is empty.

use super::Named;
use super::figures::{self, Sample, bar};
use super::traces::is_of_traces;
use super::words::{
    cause, chance, column, column_with_unit, counted, decimals_of, duration, interval, level,
    listed, num, parameter, percent, signed, span, with_unit, words,
};
use flip_discover::report::{
    CauseReport, Channel, Evidence, Experiment, Finding, ParameterReport, PowderEffect, Report,
    SideChannel, UntestableReport, Verdict,
};
use flip_discover::{Mechanism, is_told};
use maud::{Markup, Render, html};

/// Maximum number of residual figures.
const FIGURES_MAX: usize = 8;
/// Inclusion probability from which a cause is described in more than its bar.
const TOLD: f64 = 0.1;
/// Number of colour shades of an effect.
const SHADES: f64 = 4.0;

/// A section: heading, a line that explains how to read it, content.
pub fn section(title: &str, intro: &str, content: &Markup) -> Markup {
    html! {
        @if !content.0.is_empty() {
            section { h2 { (title) } p.intro { (intro) } (content) }
        }
    }
}

/// Heading of a column of text.
pub(super) fn left(label: impl Render) -> Markup {
    html! { th.left scope="col" { (label) } }
}

/// Heading of a column of numbers.
pub(super) fn right(label: impl Render) -> Markup {
    html! { th scope="col" { (label) } }
}

/// A table that scrolls sideways; the style hides a caption that repeats the section's heading.
pub(super) fn table(caption: &str, class: &str, headings: &[Markup], rows: &[Markup]) -> Markup {
    html! {
        div.scroll tabindex="0" role="region" aria-label=(caption) {
            table class=(class) {
                caption { (caption) }
                thead { tr { @for heading in headings { (heading) } } }
                tbody { @for row in rows { (row) } }
            }
        }
    }
}

pub(super) fn row(head: impl Render, cells: &[Markup]) -> Markup {
    html! { tr { th scope="row" { (head) } @for cell in cells { td { (cell) } } } }
}

/// Text of a cell that may wrap.
pub(super) fn wrapped(words: &str) -> Markup {
    html! { span.left.wrap { (words) } }
}

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

pub fn evidence(report: &Report, named: Named) -> Markup {
    let finite = |it: &f64| it.is_finite();
    let weights = || report.evidence.iter().map(|it| it.log10_evidence).filter(finite);
    let ends = (weights().fold(0.0, f64::min), weights().fold(1.0, f64::max));
    let rows_of = |of_traces: bool| {
        let alike = report.evidence.iter().filter(move |it| is_of_traces(&it.cause) == of_traces);
        alike.map(|it| weighed(it, ends)).collect::<Vec<Markup>>()
    };
    let (mut angles, mut traces) = (rows_of(false), rows_of(true));
    let untestable = report.untestable.iter().map(untestable);
    // They follow the last table.
    if traces.is_empty() { &mut angles } else { &mut traces }.extend(untestable);
    if angles.is_empty() && traces.is_empty() {
        return html! {};
    }
    let has_both = !angles.is_empty() && !traces.is_empty();
    let headings = [
        left("Cause"),
        right("Evidence (log10)"),
        right("Probability (%)"),
        left("Family"),
        left("Cannot be tested"),
    ];
    let caption = "Evidence for each cause";
    let tables = [("angles of repose", angles), ("balance readings", traces)];
    section(
        "How well each cause explains the data",
        "Evidence: 0 is no better than noise alone, 1 explains the data ten times as well, 2 a \
         hundred times; below 0, noise alone does better. Probability: the chance that the cause \
         is at work, if anything is. Two causes can be at work together.",
        &html! {
            @for (of, rows) in tables.iter().filter(|(_, rows)| !rows.is_empty()) {
                @let whole = if has_both { format!("{caption}: {of}") } else { caption.to_owned() };
                (table(&whole, "evidence", &headings, rows))
            }
            (causes(report, named))
        },
    )
}

fn weighed(it: &Evidence, (low, high): (f64, f64)) -> Markup {
    let class = if it.log10_evidence < 0.0 { "against" } else { "weight" };
    let family = it.family.as_deref().map_or_else(|| "–".to_owned(), words);
    let number = |bar: Markup, written: String| html! { (bar) span.number { (written) } };
    row(
        cause(&it.cause),
        &[
            number(bar(it.log10_evidence, low, high, class), signed(it.log10_evidence, 1)),
            number(
                bar(it.inclusion_probability, 0.0, 1.0, "share"),
                percent(it.inclusion_probability),
            ),
            wrapped(&family),
            wrapped("–"),
        ],
    )
}

fn untestable(it: &UntestableReport) -> Markup {
    html! {
        tr.greyed {
            th scope="row" { (cause(&it.mechanism)) }
            @for _ in 0..3 { td { "–" } }
            td { (wrapped(&it.reason)) }
        }
    }
}

/// What is known of the probable causes; empty if nothing is wrong.
fn causes(report: &Report, named: Named) -> Markup {
    if report.verdict == Verdict::NoDiscrepancy {
        return html! {};
    }
    let probable = report.causes.iter().filter(|it| it.inclusion_probability >= TOLD);
    let told: Vec<Markup> = probable.take(5).map(|it| told(it, named)).collect();
    html! {
        @if !told.is_empty() {
            h3 { "The most probable causes" }
            ul.plain { @for it in told { (it) } }
        }
    }
}

fn told(it: &CauseReport, named: Named) -> Markup {
    let powders: Vec<String> = it.powders.iter().map(|id| named(id)).collect();
    html! {
        li {
            strong { (cause(&it.mechanism)) }
            ", " (percent(it.inclusion_probability)) " %. "
            "Level " (it.confidence_level) " of 3: " (level(it.confidence_level)) "."
            @if !powders.is_empty() { " Seen in " (listed(&powders)) "." }
            @for it in &it.parameters { " " (fitted(it)) }
        }
    }
}

fn fitted(it: &ParameterReport) -> Markup {
    let decimals = decimals_of(it.value);
    html! {
        (parameter(&it.name)) ": " (with_unit(&num(it.value, decimals), &it.unit)) " "
        (interval(it.ci95, decimals)) "."
    }
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
                    "; here it is " (num(statistic, 1)) ", p\u{a0}=\u{a0}" (chance(report.p_value)) "."
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
