//! Before and after: predictions of the original and of the extended simulator, on the rows of the
//! file and on rows left out.

use super::figures;
use super::sections::{row, section, table};
use super::words::{interval, num, percent, signed, text, with_unit};
use flip_discover::report::{HeldOut, Report};

pub fn before_after(report: &Report) -> String {
    let with_both = |row: &&flip_discover::report::Row| row.measured_deg.is_some();
    let measured: Vec<_> = report.rows.iter().filter(with_both).collect();
    let mut drawn = String::new();
    if measured.iter().any(|row| row.before_deg.is_some()) {
        drawn += &figures::predicted(report, "Before: the simulator as it was", |row| {
            (row.before_deg, row.before_sd_deg)
        });
    }
    if measured.iter().any(|row| row.after_deg.is_some()) {
        drawn += &figures::predicted(report, "After: with what was found", |row| {
            (row.after_deg, row.after_sd_deg)
        });
    }
    if !drawn.is_empty() {
        drawn = format!(
            "<div class=\"figures\">{drawn}</div><p class=\"note\">Dashed: predicted as measured; 90 % of runs should lie \
             between the dotted lines. These rows were used in the fit, so both sides look better than they are{}</p>",
            if report.gain.is_some() { "; the tables below are of rows left out." } else { "." }
        );
    }
    section(
        "Before and after",
        "What the simulator predicts, against what was measured.",
        &(drawn + &gain(report)),
    )
}

fn gain(report: &Report) -> String {
    let Some(gain) = &report.gain else { return String::new() };
    let splits = [
        ("Days", Some(&gain.held_out)),
        ("Powders", gain.by_powder.as_ref()),
        ("Ends of the range", gain.by_range.as_ref()),
    ];
    let split = |(name, held_out): (&str, Option<&HeldOut>)| {
        held_out.map_or(String::new(), |it| {
            let unit = text(&it.unit);
            let smaller = with_unit(&signed(it.rmse_before - it.rmse_after, 2), &unit);
            row(
                name,
                &[
                    it.n.to_string(),
                    with_unit(&num(it.rmse_before, 2), &unit),
                    with_unit(&num(it.rmse_after, 2), &unit),
                    format!("{smaller} {}", interval(it.ci95, 2)),
                ],
            )
        })
    };
    let errors: String = splits.into_iter().map(split).collect();
    let errors = table(
        "",
        &[">Left out in turn", "Runs", "RMS error before", "after", "smaller by [95 %]"],
        &errors,
    );
    let score = &gain.log_score;
    let scores = row(
        "Log score, nats a run (more is better)",
        &[
            num(score.before, 2),
            num(score.after, 2),
            format!("{} {}", signed(score.after - score.before, 2), interval(score.ci95, 2)),
        ],
    ) + &row(
        "Runs within their 90 % interval (90 % is right)",
        &[percent(gain.coverage90.before), percent(gain.coverage90.after), String::new()],
    );
    let scores =
        table("", &[">Days left out in turn", "before", "after", "better by [95 %]"], &scores);
    let weighing = gain.weighing_error_mg.as_ref().map_or(String::new(), |it| {
        let oracle = it.oracle.map_or("–".to_owned(), |oracle| format!("{} mg", num(oracle, 2)));
        let cells = [
            format!("{} mg", num(it.before, 2)),
            format!("{} mg", num(it.after, 2)),
            format!("{} mg", num(it.sham, 2)),
            oracle,
            format!("{} mg {}", signed(it.before - it.after, 2), interval(it.ci95, 2)),
        ];
        table(
            "",
            &[
                ">Policy trained on",
                "simulator before",
                "after",
                "sham",
                "the truth",
                "smaller by [95 %]",
            ],
            &row("Mean error of a weighing", &cells),
        )
    });
    let verdict = match gain.accepted {
        true => "The extended simulator predicts better what it was not fitted to. It is accepted.",
        false => {
            "The extended simulator does not surely predict better what it was not fitted to. It is not accepted."
        }
    };
    format!(
        "<h3>On data that were left out of the fit</h3><p>{verdict} The whole search was repeated without the part left out; \
         days left out decide.</p>{errors}{scores}{weighing}"
    )
}
