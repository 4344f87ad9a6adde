//! What spoons let fall, beside what the calibrated simulator lets fall in the same steps.

use super::Named;
use super::figures;
use super::table::{left, right, row, section, table, wrapped};
use super::words::{cause, chance, counted, interval, num, percent, with_unit};
use flip_discover::Report;
use flip_discover::report::spoon::{PowderReport, SpoonCauseReport, SpoonGain, SummaryRow};
use maud::{Markup, html};

/// Spoonfuls drawn of each powder; the document has all.
const DRAWN: usize = 6;

pub fn spoon(report: &Report, named: Named) -> Markup {
    let Some(it) = &report.spoon else { return html! {} };
    section(
        "Spoonfuls",
        "What fell from the spoon in weighings, compared with what the calibrated simulator lets \
         fall in the same steps. The band holds the balance's noise, the scatter of shakes, \
         differences between spoonfuls, days and calibrated sets.",
        &html! {
            @for powder in &it.powders { (of_powder(powder, named)) }
            @if !it.unjudged.is_empty() {
                h3 { "Not judged" }
                ul.plain {
                    @for powder in &it.unjudged { li { (named(&powder.powder)) ": " (powder.why) } }
                }
            }
            p.note {
                (counted(it.replays as usize, "spoonful")) " replayed, "
                (counted(it.heaps as usize, "heap")) " poured."
            }
        },
    )
}

fn of_powder(powder: &PowderReport, named: Named) -> Markup {
    let [judged, given] = powder.spoonfuls;
    let name = named(&powder.powder);
    let headings =
        [left("Of a spoonful"), right("Weighed"), right("Simulated"), right("90 % of replays")];
    let summaries: Vec<Markup> = powder.summaries.iter().map(summary).collect();
    html! {
        h3 { (name) }
        p { (powder.sentence) }
        p.note {
            (counted(judged as usize, "spoonful"))
            @if judged < given { " of " (given) }
            ", " (counted(powder.sets as usize, "calibrated set")) ". On its own, p\u{a0}=\u{a0}"
            (chance(powder.p_value)) "."
        }
        div.figures {
            @for (k, course) in powder.courses.iter().take(DRAWN).enumerate() {
                (figures::course(course, &format!("{name}, spoonful {}", k + 1)))
            }
        }
        (table(&format!("Spoonfuls of {name} in numbers"), "", &headings, &summaries))
        @if !powder.causes.is_empty() { (causes(&powder.causes, &name)) }
        @if let Some(gain) = &powder.gain { (of_gain(gain)) }
    }
}

fn summary(it: &SummaryRow) -> Markup {
    let number = |value: f64| with_unit(&num(value, 2), &it.unit);
    let [low, high] = it.band90;
    let is_outside = !(low..=high).contains(&it.measured);
    let weighed = html! { span.sure[is_outside] { (number(it.measured)) } };
    row(
        &it.name,
        &[weighed, html! { (number(it.simulated)) }, html! { (interval([low, high], 2)) }],
    )
}

fn causes(all: &[SpoonCauseReport], powder: &str) -> Markup {
    let headings = [
        left("Cause"),
        right("Probability"),
        right("How strong"),
        right("Of a spoonful, mg"),
        left("What would prove it"),
    ];
    let told = |it: &SpoonCauseReport| {
        let amplitude = format!("{} {}", num(it.amplitude, 2), interval(it.amplitude_ci95, 2));
        let effect = format!("{} {}", num(it.effect_mg, 1), interval(it.effect_ci95_mg, 1));
        row(
            cause(it.cause.name().0),
            &[
                html! { (percent(it.probability)) " %" },
                html! { (amplitude) },
                html! { (effect) },
                wrapped(&it.experiment),
            ],
        )
    };
    let rows: Vec<Markup> = all.iter().take(DRAWN).map(told).collect();
    table(&format!("Causes of what {powder} does, if anything is wrong"), "", &headings, &rows)
}

fn of_gain(gain: &SpoonGain) -> Markup {
    let headings = [left("Predicted by"), right("Mean absolute error of a spoonful, mg")];
    let line = |by: &str, mg: f64| row(by, &[html! { (num(mg, 2)) }]);
    let rows = [
        line("The calibrated sets", gain.error_before_mg),
        line("The causes found", gain.error_after_mg),
        line("A sham: causes that change nothing", gain.error_sham_mg),
    ];
    html! {
        (table("Gain on spoonfuls left out", "", &headings, &rows))
        p.note {
            (counted(gain.spoonfuls as usize, "spoonful")) ", left out by " (gain.by)
            "; the error falls by " (num(gain.error_before_mg - gain.error_after_mg, 2)) " mg, 95 % "
            (interval(gain.gain_ci95_mg, 2)) ". "
            @if gain.accepted { "It is accepted." } @else { "It is not accepted." }
        }
    }
}

#[cfg(test)]
#[path = "spoon_tests.rs"]
mod tests;
