//! Before and after: predictions of the original and of the extended simulator, on the rows of the
//! file and on rows left out.

use super::figures;
use super::table::{left, right, row, section, table};
use super::words::{interval, num, percent, signed, with_unit};
use flip_discover::report::{Gain, HeldOut, Report};
use maud::{Markup, html};

pub fn before_after(report: &Report) -> Markup {
    let measured = || report.rows.iter().filter(|row| row.measured_deg.is_some());
    let has_before = measured().any(|row| row.before_deg.is_some());
    let has_after = measured().any(|row| row.after_deg.is_some());
    section(
        "Before and after",
        "Simulator predictions compared with measurements.",
        &html! {
            @if has_before || has_after {
                div.figures {
                    @if has_before {
                        (figures::predicted(report, "Before: the simulator as it was", |row| {
                            (row.before_deg, row.before_sd_deg)
                        }))
                    }
                    @if has_after {
                        (figures::predicted(report, "After: with the findings", |row| {
                            (row.after_deg, row.after_sd_deg)
                        }))
                    }
                }
                p.note {
                    "Dashed line: prediction equals measurement. 90 % of runs should lie between "
                    "the dotted lines. These rows were used in the fit, so both plots look better "
                    "than they are"
                    @if report.gain.is_some() {
                        "; the tables below use rows left out of the fit"
                    }
                    "."
                }
            }
            @if let Some(it) = &report.gain { (gain(it)) }
        },
    )
}

fn gain(gain: &Gain) -> Markup {
    html! {
        p {
            @if gain.accepted {
                "The extended simulator is better at predicting data it was not fitted to. "
                "It is accepted."
            } @else {
                "The extended simulator is not clearly better at predicting data it was not "
                "fitted to. It is not accepted."
            }
            " The whole search was repeated without the part left out. "
            "The result for left-out days decides."
        }
        (errors(gain))
        (scores(gain))
    }
}

fn errors(gain: &Gain) -> Markup {
    let split = |name: &str, it: &HeldOut| {
        let error = |written: String| html! { (with_unit(&written, &it.unit)) };
        let cells = [
            html! { (it.n) },
            error(num(it.rmse_before, 2)),
            error(num(it.rmse_after, 2)),
            error(signed(it.rmse_before - it.rmse_after, 2)),
            html! { (interval(it.ci95, 2)) },
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
        right("RMS error after"),
        right("Reduction"),
        right("95 % interval"),
    ];
    table("Errors on rows left out of the fit", "", &headings, &rows)
}

/// Before, after, improvement and its interval.
type Scored = [Option<String>; 4];

fn scores(gain: &Gain) -> Markup {
    let compared = |before: f64, after: f64, better: f64, ci95: [f64; 2]| -> Scored {
        [num(before, 2), num(after, 2), signed(better, 2), interval(ci95, 2)].map(Some)
    };
    let (score, coverage) = (&gain.log_score, &gain.coverage90);
    let mut all: Vec<(&str, Scored)> = vec![
        (
            "Log score, nats per run (higher is better)",
            compared(score.before, score.after, score.after - score.before, score.ci95),
        ),
        (
            "Runs within their 90 % interval, % (ideal: 90)",
            [Some(percent(coverage.before)), Some(percent(coverage.after)), None, None],
        ),
    ];
    if let Some(it) = &gain.weighing_error_mg {
        let trained = |error: f64| -> Scored { [None, Some(num(error, 2)), None, None] };
        all.push((
            "Mean weighing error, mg",
            compared(it.before, it.after, it.before - it.after, it.ci95),
        ));
        all.push((
            "The same, trained equally long on an extension with no effect, mg",
            trained(it.sham),
        ));
        all.extend(it.oracle.map(|of| ("The same, trained on the truth, mg", trained(of))));
    }
    let line = |(name, cells): (&str, Scored)| {
        row(name, &cells.map(|cell| html! { (cell.as_deref().unwrap_or("–")) }))
    };
    let headings = [
        left("Other scores, days left out in turn"),
        right("Before"),
        right("After"),
        right("Improvement"),
        right("95 % interval"),
    ];
    let rows: Vec<Markup> = all.into_iter().map(line).collect();
    table("Other scores before and after", "", &headings, &rows)
}
