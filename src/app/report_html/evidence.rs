//! How well each cause explains the data.

use super::Named;
use super::figures::bar;
use super::table::{left, right, row, section, table, wrapped};
use super::traces::is_of_traces;
use super::words::{
    cause, decimals_of, interval, level, listed, num, parameter, percent, signed, with_unit, words,
};
use flip_discover::report::{
    CauseReport, Evidence, ParameterReport, Report, UntestableReport, Verdict,
};
use maud::{Markup, html};

/// Inclusion probability from which a cause is described in more than its bar.
const TOLD: f64 = 0.1;

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
