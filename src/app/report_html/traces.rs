//! Findings on balance readings alone.

use super::figures;
use super::sections::{experiment_card, row, section, table};
use super::words::{chance, counted, interval, num, signed, text, with_unit};
use flip_discover::report::{Channel, Finding, Report};
use flip_discover::traces::{TraceMechanism, WANDER};

/// Whether a cause is judged on balance readings.
pub fn is_of_traces(name: &str) -> bool {
    name == WANDER || TraceMechanism::ALL.iter().any(|mechanism| mechanism.name().0 == name)
}

pub fn traces(report: &Report) -> String {
    let Some(it) = &report.traces else { return String::new() };
    let shown = format!(
        "<p>{} and {} of the empty pan or a standard mass: {}, {}. By themselves p\u{a0}=\u{a0}{}.</p>",
        counted(it.weighings as usize, "dose"),
        counted(it.controls as usize, "log"),
        counted(it.readings as usize, "reading"),
        counted(it.shakes as usize, "shake"),
        chance(it.p_value)
    );
    let found: String = report
        .findings
        .iter()
        .filter(|finding| finding.channel == Channel::Trace)
        .map(finding)
        .collect();
    let found = match found.as_str() {
        "" => found,
        rows => table("", &[">From where to where", "Change", "95 % interval"], rows),
    };
    let unjudged = it.unjudged.as_ref().map_or(String::new(), |why| {
        format!("<p>What the spoon lets fall is not judged: {}.</p>", text(why))
    });
    let check = &it.null_check;
    let null = check.statistic.zip(check.threshold95).map_or(String::new(), |(statistic, threshold95)| format!(
        "<h3>Null check</h3><p>Readings of this design were simulated {} times with nothing wrong, and the whole search was done on each. \
         One in twenty exceeds {}; here it is {}.</p><div class=\"figures\">{}</div>",
        check.campaigns,
        num(threshold95, 1),
        num(statistic, 1),
        figures::null_scale(check)
    ));
    let own = it
        .suggested_experiment
        .as_ref()
        .filter(|own| report.suggested_experiment.as_ref() != Some(*own));
    let own = own
        .map_or(String::new(), |own| format!("<h3>The next control</h3>{}", experiment_card(own)));
    section(
        "Balance readings",
        "What the balance showed during weighings, against the simulated spoon and balance. A powder's own response to the shakes is fitted, \
         so what counts is the course of readings after a shake, of shakes in a weighing, and of scatter.",
        &format!("{shown}{unjudged}{found}{null}{own}"),
    )
}

fn finding(it: &Finding) -> String {
    let decimals = if it.unit == "%" { 0 } else { 2 };
    row(
        &text(&it.span),
        &[with_unit(&signed(it.effect, decimals), &text(&it.unit)), interval(it.ci95, decimals)],
    )
}
