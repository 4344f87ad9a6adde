//! What a verdict says, and what it does not.

use super::words::{cause, column, form, listed, lower};
use flip_discover::Report;
use flip_discover::numerics::CREEP;
use flip_discover::report::{Channel, Unexplained, Verdict};

/// The sentences below a verdict.
pub fn meaning(report: &Report) -> String {
    let what = deviating(report);
    if what.is_empty() {
        return "Regardless of the measurements, simulated heaps keep moving: the fault is in how \
                they are computed. These data show nothing else."
            .to_owned();
    }
    let deviate = format!("The {} deviate from the simulation", listed(&what));
    match report.verdict {
        Verdict::NoDiscrepancy if report.unjudged.is_some() => {
            "These angles can show neither that the simulation is wrong nor that it is right."
                .to_owned()
        }
        Verdict::NoDiscrepancy if report.rows.is_empty() && report.spoon.is_some() => {
            "These spoonfuls do not show that the simulated spoon is wrong. That does not prove it \
             right: what stays within the bands below cannot be seen."
                .to_owned()
        }
        Verdict::NoDiscrepancy => {
            "These data do not show that the simulation is wrong. That does not prove it right: \
             see below which effects this campaign would have found, and which it cannot show."
                .to_owned()
        }
        Verdict::Cause => format!(
            "{deviate}, and a cause in the catalogue explains how. A good explanation is not \
             proof; only an experiment that changes the cause is."
        ),
        Verdict::Ambiguous => {
            let causes: Vec<String> =
                report.ambiguous_between.iter().map(|name| lower(&cause(name))).collect();
            let causes =
                if causes.is_empty() { "several causes".to_owned() } else { listed(&causes) };
            let next = match report.suggested_experiment {
                Some(_) => " The experiment below would be the most informative.",
                None => "",
            };
            format!("{deviate}, but this campaign cannot distinguish between {causes}.{next}")
        }
        Verdict::Hint => {
            "Evidence this strong is rare by chance, and it points to one cause. But the effect \
             cannot be distinguished from zero, or it does not improve the prediction of left-out \
             days. Do not act on it before the experiment below."
                .to_owned()
        }
        Verdict::Unexplained => {
            let law = report.unexplained.as_ref().map_or(String::new(), law);
            format!("{deviate}, and no cause in the catalogue explains how.{law}")
        }
    }
}

/// The measured quantities that deviate from the simulation; none if only simulated heaps are at
/// fault.
fn deviating(report: &Report) -> Vec<String> {
    let is_found = |verdict: Verdict| verdict != Verdict::NoDiscrepancy;
    let has_traces = report.traces.as_ref().is_some_and(|it| is_found(it.verdict));
    let has_flow =
        report.beside.iter().any(|it| it.channel == Channel::FlowTime && is_found(it.verdict));
    let creeps = report.causes.iter().any(|it| it.mechanism == CREEP);
    let has_spoons = report
        .spoon
        .as_ref()
        .is_some_and(|it| it.powders.iter().any(|powder| is_found(powder.verdict)));
    let has_angles = !(has_traces || has_flow || has_spoons || creeps)
        || report.findings.iter().any(|it| it.channel == Channel::Repose);
    let parts = [
        (has_angles, "measured angles"),
        (has_flow, "flow times"),
        (has_traces, "balance readings"),
        (has_spoons, "spoonfuls"),
    ];
    parts.iter().filter(|(deviates, _)| *deviates).map(|(_, what)| (*what).to_owned()).collect()
}

fn law(it: &Unexplained) -> String {
    let on = match &it.covariate {
        Some(name) => format!("It depends on {}", lower(&column(name).0)),
        None => "No recorded condition explains it".to_owned(),
    };
    let law = it.law.trim_end_matches('.');
    format!(" {on}. Its law ({}): {law}.", form(it.form_class.name()))
}
