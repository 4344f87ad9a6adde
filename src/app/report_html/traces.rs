//! Findings on balance readings alone.

use super::figures;
use super::sections::experiment_card;
use super::table::{left, right, row, section, table};
use super::words::{chance, counted, interval, num, signed, with_unit};
use flip_discover::report::{Channel, Finding, NullCheck, Report};
use flip_discover::traces::{TraceMechanism, WANDER};
use maud::{Markup, html};

/// Whether a cause is judged on balance readings.
pub fn is_of_traces(name: &str) -> bool {
    name == WANDER || TraceMechanism::ALL.iter().any(|mechanism| mechanism.name().0 == name)
}

pub fn traces(report: &Report) -> Markup {
    let Some(it) = &report.traces else { return html! {} };
    let found: Vec<Markup> = report
        .findings
        .iter()
        .filter(|finding| finding.channel == Channel::Trace)
        .map(finding)
        .collect();
    let headings = [left("Range"), right("Change"), right("95 % interval")];
    let own = it
        .suggested_experiment
        .as_ref()
        .filter(|own| report.suggested_experiment.as_ref() != Some(*own));
    section(
        "Balance readings",
        "Balance readings during weighings, compared with the simulated spoon and balance. Each \
         powder's response to the shakes is fitted, so look at how readings change after a shake, \
         from shake to shake within a weighing, and in their scatter.",
        &html! {
            p {
                (counted(it.weighings as usize, "dose")) " and "
                (counted(it.controls as usize, "log")) " of the empty pan or of a standard mass: "
                (counted(it.readings as usize, "reading")) ", "
                (counted(it.shakes as usize, "shake")) ". On their own, p\u{a0}=\u{a0}"
                (chance(it.p_value)) "."
            }
            @if let Some(why) = &it.unjudged {
                p { "The powder that the spoon releases was not judged: " (why) "." }
            }
            @if !found.is_empty() {
                (table("Changes of the balance readings", "", &headings, &found))
            }
            (null(&it.null_check))
            @if let Some(own) = own {
                h3 { "The next control" }
                (experiment_card(own, "Runs of the next control"))
            }
        },
    )
}

fn null(check: &NullCheck) -> Markup {
    let Some((statistic, threshold95)) = check.statistic.zip(check.threshold95) else {
        return html! {};
    };
    html! {
        h3 { "Null check" }
        p {
            "Readings of this design were simulated " (check.campaigns)
            " times with nothing wrong, and the whole search was run on each. "
            "One in twenty exceeds "
            (num(threshold95, 1)) "; here it is " (num(statistic, 1)) "."
        }
        div.figures { (figures::null_scale(check)) }
    }
}

fn finding(it: &Finding) -> Markup {
    let decimals = if it.unit == "%" { 0 } else { 2 };
    let change = with_unit(&signed(it.effect, decimals), &it.unit);
    row(&it.span, &[html! { (change) }, html! { (interval(it.ci95, decimals)) }])
}
