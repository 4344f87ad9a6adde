//! Before and after: predictions of the original and of the extended simulator, on the rows of the
//! file and on rows left out.

use super::figures;
use super::sections::{left, right, row, section, table};
use super::words::{interval, num, percent, signed, with_unit};
use flip_discover::report::{Gain, HeldOut, Report, WeighingGain};
use maud::{Markup, html};

pub fn before_after(report: &Report) -> Markup {
    let measured = || report.rows.iter().filter(|row| row.measured_deg.is_some());
    let has_before = measured().any(|row| row.before_deg.is_some());
    let has_after = measured().any(|row| row.after_deg.is_some());
    section(
        "Before and after",
        "What the simulator predicts, against what was measured.",
        &html! {
            @if has_before || has_after {
                div.figures {
                    @if has_before {
                        (figures::predicted(report, "Before: the simulator as it was", |row| {
                            (row.before_deg, row.before_sd_deg)
                        }))
                    }
                    @if has_after {
                        (figures::predicted(report, "After: with what was found", |row| {
                            (row.after_deg, row.after_sd_deg)
                        }))
                    }
                }
                p.note {
                    "Dashed: predicted as measured; 90 % of runs should lie between the dotted lines. "
                    "These rows were used in the fit, so both sides look better than they are"
                    @if report.gain.is_some() { "; the tables below are of rows left out." } @else { "." }
                }
            }
            @if let Some(it) = &report.gain { (gain(it)) }
        },
    )
}

fn gain(gain: &Gain) -> Markup {
    html! {
        h3 { "On data that were left out of the fit" }
        p {
            @if gain.accepted {
                "The extended simulator predicts better what it was not fitted to. It is accepted."
            } @else {
                "The extended simulator does not surely predict better what it was not fitted to. "
                "It is not accepted."
            }
            " The whole search was repeated without the part left out; days left out decide."
        }
        (errors(gain))
        (scores(gain))
        @if let Some(it) = &gain.weighing_error_mg { (weighing(it)) }
    }
}

fn errors(gain: &Gain) -> Markup {
    let split = |name: &str, it: &HeldOut| {
        let smaller = with_unit(&signed(it.rmse_before - it.rmse_after, 2), &it.unit);
        let cells = [
            html! { (it.n) },
            html! { (with_unit(&num(it.rmse_before, 2), &it.unit)) },
            html! { (with_unit(&num(it.rmse_after, 2), &it.unit)) },
            html! { (smaller) " " (interval(it.ci95, 2)) },
        ];
        row(name, &cells)
    };
    let splits = [
        ("Days", Some(&gain.held_out)),
        ("Powders", gain.by_powder.as_ref()),
        ("Ends of the range", gain.by_range.as_ref()),
    ];
    let rows: Vec<Markup> =
        splits.into_iter().filter_map(|(name, it)| Some(split(name, it?))).collect();
    let headings = [
        left("Left out in turn"),
        right("Runs"),
        right("RMS error before"),
        right("after"),
        right("smaller by [95 %]"),
    ];
    table("", &headings, &rows)
}

fn scores(gain: &Gain) -> Markup {
    let score = &gain.log_score;
    let rows = [
        row(
            "Log score, nats a run (more is better)",
            &[
                html! { (num(score.before, 2)) },
                html! { (num(score.after, 2)) },
                html! { (signed(score.after - score.before, 2)) " " (interval(score.ci95, 2)) },
            ],
        ),
        row(
            "Runs within their 90 % interval (90 % is right)",
            &[
                html! { (percent(gain.coverage90.before)) },
                html! { (percent(gain.coverage90.after)) },
                html! {},
            ],
        ),
    ];
    let headings =
        [left("Days left out in turn"), right("before"), right("after"), right("better by [95 %]")];
    table("", &headings, &rows)
}

fn weighing(it: &WeighingGain) -> Markup {
    let mg = |value: f64| html! { (num(value, 2)) " mg" };
    let cells = [
        mg(it.before),
        mg(it.after),
        mg(it.sham),
        it.oracle.map_or_else(|| html! { "–" }, mg),
        html! { (signed(it.before - it.after, 2)) " mg " (interval(it.ci95, 2)) },
    ];
    let headings = [
        left("Policy trained on"),
        right("simulator before"),
        right("after"),
        right("sham"),
        right("the truth"),
        right("smaller by [95 %]"),
    ];
    table("", &headings, &[row("Mean error of a weighing", &cells)])
}
