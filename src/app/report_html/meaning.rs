//! What a verdict says, and what it does not.

use super::words::{cause, column, form, listed, lower, upper};
use flip_discover::Report;
use flip_discover::numerics::CREEP;
use flip_discover::report::{Channel, Unexplained, Verdict};
use maud::{Markup, html};

/// The sentences below a verdict.
pub fn meaning(report: &Report) -> Markup {
    let what = departing(report);
    if what.is_empty() {
        return html! {
            "Whatever was measured, simulated heaps go on moving: what is wrong is how they are computed. "
            "These data show nothing else."
        };
    }
    let what = upper(&listed(&what));
    match report.verdict {
        Verdict::NoDiscrepancy if report.unjudged.is_some() => html! {
            "These angles can neither show that the simulation is wrong nor that it is right."
        },
        Verdict::NoDiscrepancy => html! {
            "These data do not show that the simulation is wrong. That is no proof that it is right: "
            "see below which effects this campaign would have found, and which it cannot show."
        },
        Verdict::Cause => html! {
            (what) " depart from the simulation, and the catalogue has a cause that explains how. "
            "A good explanation is not a proof: only an experiment that changes the cause is."
        },
        Verdict::Ambiguous => html! {
            (what) " depart from the simulation, but these data cannot tell between "
            (between(&report.ambiguous_between)) "."
            @if report.suggested_experiment.is_some() { " The experiment below would tell most." }
        },
        Verdict::Hint => html! {
            "Evidence this strong is rare by chance, and points at one cause. But its effect is not told from zero, "
            "or days that were left out are not predicted better by it: nothing to act on before the experiment below."
        },
        Verdict::Unexplained => html! {
            (what) " depart from the simulation, and no cause of the catalogue explains how."
            @if let Some(unexplained) = &report.unexplained { " " (law(unexplained)) }
        },
    }
}

/// The measured quantities that depart from the simulation; none if only simulated heaps are at
/// fault.
fn departing(report: &Report) -> Vec<String> {
    let is_found = |verdict: Verdict| verdict != Verdict::NoDiscrepancy;
    let has_traces = report.traces.as_ref().is_some_and(|it| is_found(it.verdict));
    let has_flow =
        report.beside.iter().any(|it| it.channel == Channel::FlowTime && is_found(it.verdict));
    let creeps = report.causes.iter().any(|it| it.mechanism == CREEP);
    let has_angles = !(has_traces || has_flow || creeps)
        || report.findings.iter().any(|it| it.channel == Channel::Repose);
    let parts = [
        (has_angles, "the measured angles"),
        (has_flow, "the flow times"),
        (has_traces, "the balance readings"),
    ];
    parts.iter().filter(|(departs, _)| *departs).map(|(_, what)| (*what).to_owned()).collect()
}

fn between(names: &[String]) -> Markup {
    html! {
        @if names.is_empty() { "several causes" }
        @for (k, name) in names.iter().enumerate() {
            @if k > 0 { @if k + 1 == names.len() { " and " } @else { ", " } }
            strong { (lower(&cause(name))) }
        }
    }
}

fn law(it: &Unexplained) -> Markup {
    html! {
        @match &it.covariate {
            Some(name) => { "It depends on " strong { (lower(&column(name).0)) } },
            None => "Nothing that was recorded explains it",
        }
        ". Its law (" (form(it.form_class.name())) "): " (it.law.trim_end_matches('.')) "."
    }
}
