use super::figures::Scale;
use super::words::{
    cause, chance, column_with_unit, duration, interval, num, percent, signed, span, with_unit,
};
use super::{fragment, html};
use crate::app::document::hostile::assert_inert;
use flip_discover::numerics::{Dependence, Varied};
use flip_discover::reading::{ColumnRead, FileRead, LeftOut, NamedPowder, TakenAs};
use flip_discover::report::{
    CauseReport, Channel, ColumnLeftOut, Coverage, Curve, Detectable, Evidence, Experiment,
    Finding, FormClass, Gain, HeldOut, LogScore, NullCheck, Numerics, ParameterReport,
    PowderEffect, Row, SCHEMA_VERSION, SimulatorVersions, Unexplained, UntestableReport, Verdict,
    WeighingGain,
};
use flip_discover::{FitSet, Report};
use std::collections::BTreeMap;

/// A report with only a verdict.
fn bare(verdict: Verdict) -> Report {
    Report {
        schema_version: SCHEMA_VERSION,
        sentence: "Nothing is wrong that this campaign could show.".to_owned(),
        verdict,
        p_value: 0.4,
        findings: Vec::new(),
        causes: Vec::new(),
        ambiguous_between: Vec::new(),
        unexplained: None,
        suggested_experiment: None,
        simulator_version: SimulatorVersions {
            base: "base-1".to_owned(),
            extended: None,
            verified: false,
        },
        gain: None,
        minimum_detectable: Vec::new(),
        blind_spots: Vec::new(),
        evidence: Vec::new(),
        untestable: Vec::new(),
        left_out: Vec::new(),
        unjudged: None,
        null_check: NullCheck { campaigns: 0, statistic: None, threshold95: None },
        rows: Vec::new(),
        curves: Vec::new(),
        numerics: None,
        beside: Vec::new(),
        traces: None,
        spoon: None,
        files: Vec::new(),
        simulator_runs: 0,
        wall_s: 0.0,
    }
}

/// A report with every section, and every text from `word`.
fn full(verdict: Verdict, word: &str) -> Report {
    let owned = || word.to_owned();
    let rows: Vec<Row> = (0..12)
        .map(|k| Row {
            row: k + 2,
            powder: if k % 2 == 0 { owned() } else { "salt".to_owned() },
            measured_deg: (k != 5).then_some(31.0 + f64::from(k)),
            before_deg: (k != 6).then_some(36.0),
            before_sd_deg: 1.2,
            after_deg: Some(31.5 + f64::from(k)),
            after_sd_deg: 0.9,
        })
        .collect();
    let places = |k: usize| (k != 3).then_some(30.0 + 3.0 * k as f64);
    let held_out =
        HeldOut { rmse_before: 2.31, rmse_after: 1.72, ci95: [0.4, 0.8], unit: owned(), n: 11 };
    Report {
        sentence: owned(),
        p_value: 0.002,
        findings: vec![Finding {
            channel: Channel::Repose,
            covariate: Some(owned()),
            powders: vec![owned()],
            effect: 2.4,
            ci95: [1.6, 3.1],
            unit: owned(),
            span: owned(),
            powder: None,
            by_powder: vec![
                PowderEffect { powder: owned(), effect: 3.0, ci95: [2.0, 4.0] },
                PowderEffect { powder: "salt".to_owned(), effect: -0.1, ci95: [-0.6, 0.4] },
            ],
        }],
        causes: vec![CauseReport {
            mechanism: owned(),
            family: owned(),
            inclusion_probability: 0.93,
            confidence_level: 2,
            parameters: vec![ParameterReport {
                name: owned(),
                value: 0.31,
                ci95: [0.2, 0.41],
                unit: owned(),
            }],
            powders: vec![owned()],
        }],
        ambiguous_between: vec![owned(), "container_age".to_owned()],
        unexplained: Some(Unexplained {
            covariate: Some(owned()),
            law: owned(),
            form_class: FormClass::Linear,
        }),
        suggested_experiment: Some(Experiment {
            what: owned(),
            runs: vec![BTreeMap::from([("powder".to_owned(), owned()), (owned(), owned())])],
            minutes: 90.0,
            chance_of_resolution: Some(0.88),
            expected_posterior: Some(0.92),
        }),
        simulator_version: SimulatorVersions {
            base: owned(),
            extended: Some(owned()),
            verified: true,
        },
        gain: Some(Gain {
            by_powder: Some(held_out.clone()),
            by_range: Some(held_out.clone()),
            held_out,
            log_score: LogScore { before: -2.2, after: -1.9, ci95: [0.1, 0.5] },
            coverage90: Coverage { before: 0.71, after: 0.89 },
            weighing_error_mg: Some(WeighingGain {
                before: 1.4,
                after: 0.9,
                sham: 1.3,
                oracle: None,
                ci95: [0.2, 0.7],
            }),
            accepted: true,
        }),
        minimum_detectable: vec![Detectable { mechanism: owned(), effect_deg: 1.3, power: 0.8 }],
        blind_spots: vec![owned()],
        evidence: vec![
            Evidence {
                cause: owned(),
                family: Some(owned()),
                log10_evidence: 6.2,
                inclusion_probability: 0.93,
            },
            Evidence {
                cause: format!("unknown: {word}"),
                family: None,
                log10_evidence: -0.4,
                inclusion_probability: 0.02,
            },
        ],
        untestable: vec![UntestableReport { mechanism: owned(), reason: owned() }],
        left_out: vec![ColumnLeftOut { column: owned(), reason: owned() }],
        null_check: NullCheck { campaigns: 499, statistic: Some(9.5), threshold95: Some(3.1) },
        curves: vec![
            Curve {
                covariate: owned(),
                levels: Vec::new(),
                at: (0..12).map(places).collect(),
                course: vec![[30.0, -1.0, 2.0], [60.0, 1.0, 2.0]],
            },
            Curve {
                covariate: "operator".to_owned(),
                levels: vec![owned(), "B".to_owned()],
                at: (0..12).map(|k| Some(f64::from(k % 2))).collect(),
                course: vec![[0.0, -0.5, 2.0], [1.0, 0.5, 2.0]],
            },
        ],
        rows,
        numerics: Some(Numerics {
            set: FitSet { powder: owned(), set: owned(), source: owned() },
            dependences: vec![
                Dependence {
                    varied: Varied::SettlingTime,
                    slope_deg: -0.81,
                    ci99: [-1.2, -0.42],
                    is_defect: true,
                    runs: 9,
                },
                Dependence {
                    varied: Varied::Substep,
                    slope_deg: 0.11,
                    ci99: [-0.5, 0.7],
                    is_defect: false,
                    runs: 6,
                },
            ],
        }),
        files: vec![FileRead {
            file: owned(),
            rows: 12,
            columns: vec![ColumnRead {
                column: owned(),
                taken_as: TakenAs::Nothing,
                filled: 11,
                missing: 1,
                note: owned(),
            }],
            powders: vec![NamedPowder { name: owned(), id: owned() }],
            left_out: vec![LeftOut { rows: (2..40).collect(), reason: owned() }],
            notes: vec![owned()],
        }],
        simulator_runs: 160,
        wall_s: 900.0,
        ..bare(verdict)
    }
}

const VERDICTS: [Verdict; 5] = [
    Verdict::NoDiscrepancy,
    Verdict::Cause,
    Verdict::Ambiguous,
    Verdict::Unexplained,
    Verdict::Hint,
];

/// Checks that every closing tag matches the last opened one.
fn check_balance(page: &str) {
    let mut open: Vec<&str> = Vec::new();
    let mut rest = page.strip_prefix("<!DOCTYPE html>").expect("begins as HTML does");
    while let Some(start) = rest.find('<') {
        let end = start + rest[start..].find('>').expect("a tag ends");
        let tag = &rest[start + 1..end];
        assert!(!tag.contains('<'), "< within a tag: {tag}");
        assert!(tag.matches('"').count().is_multiple_of(2), "an attribute ends: {tag}");
        let name = tag.trim_start_matches('/').split([' ', '/']).next().unwrap();
        match (tag.starts_with('/'), ["meta", "br"].contains(&name)) {
            (true, _) => assert_eq!(open.pop(), Some(name), "closes what is open"),
            (false, true) => {}
            (false, false) => open.push(name),
        }
        rest = &rest[end + 1..];
        // A style sheet may contain `>`.
        if name == "style" && !tag.starts_with('/') {
            rest = &rest[rest.find("</style>").expect("a style sheet ends")..];
        }
    }
    assert_eq!(open, Vec::<&str>::new());
}

/// The text between the tags, without the style sheet.
fn words_of(page: &str) -> String {
    let body = page.split("<body>").nth(1).unwrap();
    body.split('<').map(|piece| piece.split_once('>').map_or(piece, |(_, words)| words)).collect()
}

#[test]
fn every_verdict_makes_a_page_whose_tags_balance() {
    for verdict in VERDICTS {
        for report in [bare(verdict), full(verdict, "relative_humidity_pct")] {
            let page = html(&report);
            check_balance(&page);
            assert!(
                page.contains("chance of evidence this strong if nothing is wrong"),
                "{verdict:?}"
            );
        }
    }
}

#[test]
fn nothing_that_comes_from_a_file_is_markup() {
    for verdict in VERDICTS {
        assert_inert(|name| html(&full(verdict, name)));
    }
    assert!(html(&full(Verdict::Cause, "<script>")).contains("&lt;script&gt;"));
}

#[test]
fn nothing_is_fetched_and_nothing_runs() {
    let page = html(&full(Verdict::Cause, "salt"));
    for bad in
        ["http:", "https:", "<script", "<link", "@import", "url(", "src=", "href=", " style="]
    {
        assert!(!page.contains(bad), "{bad}");
    }
}

#[test]
fn a_part_without_anything_to_say_is_not_there() {
    let page = html(&bare(Verdict::NoDiscrepancy));
    assert_eq!(page.matches("<section").count(), 2, "the sentence and the provenance");
    for empty in ["<table", "<svg", "<ul", "<h3", "></p>", "<figure"] {
        assert!(!page.contains(empty), "{empty}");
    }
    assert_eq!(html(&full(Verdict::Cause, "salt")).matches("<section").count(), 11);
}

#[test]
fn every_number_of_every_figure_is_finite() {
    let mut reports = VERDICTS.map(|verdict| full(verdict, "relative_humidity_pct")).to_vec();
    // One run, all values equal, nothing measured, and numbers that are not finite.
    let mut one = full(Verdict::Cause, "rest_min");
    one.rows.truncate(1);
    let mut alike = full(Verdict::Cause, "rest_min");
    alike.rows.iter_mut().for_each(|row| {
        (row.measured_deg, row.before_deg, row.after_deg) = (Some(30.0), Some(30.0), Some(30.0))
    });
    alike.curves.iter_mut().for_each(|curve| curve.at.iter_mut().for_each(|at| *at = Some(50.0)));
    alike.curves.iter_mut().for_each(|curve| curve.course.clear());
    let mut unmeasured = full(Verdict::Cause, "rest_min");
    unmeasured.rows.iter_mut().for_each(|row| row.measured_deg = None);
    let mut broken = full(Verdict::Cause, "rest_min");
    broken.rows[0].measured_deg = Some(f64::NAN);
    broken.rows[1].after_sd_deg = f64::INFINITY;
    broken.curves[0].at[2] = Some(f64::NAN);
    broken.curves[0].course[0][1] = f64::NAN;
    broken.evidence[0].log10_evidence = f64::NEG_INFINITY;
    broken.findings[0].effect = f64::NAN;
    broken.null_check.threshold95 = Some(f64::NEG_INFINITY);
    reports.extend([one, alike, unmeasured, broken]);
    for report in reports {
        let page = html(&report);
        check_balance(&page);
        for name in ["d", "x", "y", "cx", "cy", "r", "width", "height", "points", "viewBox"] {
            for place in page.split(&format!(" {name}=\"")).skip(1) {
                let value = place.split('"').next().unwrap();
                let is_number = |c: char| c.is_ascii_digit() || "MHVLhvlz ,.-".contains(c);
                assert!(value.chars().all(is_number), "{name}={value}");
            }
        }
        assert!(!words_of(&page).contains("NaN"));
    }
}

#[test]
fn the_same_report_makes_the_same_page() {
    let report = full(Verdict::Ambiguous, "relative_humidity_pct");
    assert_eq!(html(&report), html(&report.clone()));
}

#[test]
fn what_a_report_says_is_on_its_page() {
    let words = words_of(&html(&full(Verdict::Cause, "humidity")));
    for said in [
        "Cause named",
        "p = 0.002",
        "smallest that 499 simulated campaigns can show",
        "humidity +3.0",
        "[2.0, 4.0]",
        "93 %",
        "Cannot be tested",
        "+0.59",
        "[0.40, 0.80]",
        "It is accepted",
        "Mean weighing error, mg",
        "1.3",
        "88 %",
        "1 not",
        "15 min",
        "Level 2 of 3",
    ] {
        let folded = words.to_lowercase();
        assert!(folded.contains(&said.to_lowercase().replace("humidity +3.0", "+3.0")), "{said}");
    }
    let between = words_of(&html(&full(Verdict::Ambiguous, "humidity")));
    assert!(
        between.contains("cannot distinguish between humidity and ageing since opening"),
        "{between}"
    );
    assert!(between.contains(" The experiment below would be the most informative."), "{between}");
    let law = words_of(&html(&full(Verdict::Unexplained, "pressure_hpa")));
    assert!(
        law.contains("It depends on pressure. Its law (a straight line): pressure_hpa."),
        "{law}"
    );
}

#[test]
fn conditions_of_findings_are_drawn_first_and_at_most_eight() {
    let mut report = full(Verdict::Cause, "relative_humidity_pct");
    let curve = report.curves[0].clone();
    report.curves =
        (0..11).map(|k| Curve { covariate: format!("column{k}"), ..curve.clone() }).collect();
    report.curves.push(curve);
    report.evidence[1].cause = "unknown: column7".to_owned();
    let page = html(&report);
    let captions: Vec<&str> = page
        .split("<figcaption>")
        .skip(1)
        .map(|it| it.split('<').next().unwrap())
        .take(8)
        .collect();
    assert_eq!(captions[..3], ["Relative humidity (%)", "Column7", "Column0"]);
    assert!(words_of(&page).contains("4 less important recorded conditions are not plotted"));
}

#[test]
fn numbers_are_written_as_people_write_them() {
    assert_eq!([2.4, -0.04, 0.0, -1.26].map(|v| signed(v, 1)), ["+2.4", "0.0", "0.0", "−1.3"]);
    assert_eq!(num(f64::NAN, 1), "–");
    assert_eq!(interval([-0.6, 0.4], 1), "[−0.6, 0.4]");
    assert_eq!([0.5, 0.02, 0.0021, 0.0002].map(chance), ["0.50", "0.020", "0.002", "0.0002"]);
    assert_eq!([0.0, 0.001, 0.93, 0.999, 1.0].map(percent), ["0", "< 1", "93", "> 99", "100"]);
    assert_eq!(
        [12.0, 900.0, 5700.0, 9000.0].map(duration),
        ["12 s", "15 min", "1 h 35 min", "2 h 30 min"]
    );
    assert_eq!(
        ["relative_humidity_pct", "vibration_rms_m_s2", "operator", "_c", "rest_min"]
            .map(column_with_unit),
        ["Relative humidity (%)", "Vibration (rms) (m/s²)", "Operator", " c", "Time at rest (min)"]
    );
    assert_eq!(span("from 28 to 70 % relative humidity", "Relative humidity"), "from 28 to 70 %");
    assert_eq!(with_unit("0.13", "1"), "0.13");
    assert_eq!(cause("unknown: pressure_hpa"), "Unknown cause, with pressure");
}

#[test]
fn ticks_are_round_and_on_the_scale() {
    let written = |low: f64, high: f64| -> Vec<String> {
        Scale::over([low, high], 0.0, 100.0)
            .ticks(5.0)
            .into_iter()
            .map(|(_, written)| written)
            .collect()
    };
    assert_eq!(written(0.0, 1.0), ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
    assert_eq!(
        written(-3.0, 2.0),
        ["−3", "−2", "−1", "0", "1", "2"].map(|t| t.to_owned()).to_vec()
    );
    assert_eq!(written(30.0, 70.0), ["30", "40", "50", "60", "70"]);
    assert!(written(5.0, 5.0).contains(&"5.0".to_owned()));
}

#[test]
fn the_page_calls_powders_by_their_registered_names() {
    let names = BTreeMap::from([("salt".to_owned(), "Salt, 3-fold <sieved>".to_owned())]);
    let page = fragment(&full(Verdict::Cause, "zeta"), &names);
    assert_eq!(page.matches("Salt, 3-fold &lt;sieved&gt;").count(), 2, "legend and effects");
    assert!(page.contains("Zeta") && !page.contains("<style") && !page.contains("<h1"));
}

/// The page's tests show what is rendered here: `UPDATE=1` writes it.
#[test]
fn the_page_is_tested_with_what_is_rendered() {
    for name in ["cause", "nothing"] {
        let file = format!("{}/web/tests/reports/{name}", env!("CARGO_MANIFEST_DIR"));
        let report = std::fs::read(format!("{file}.json")).unwrap();
        let report: Report = serde_json::from_slice(&report).unwrap();
        let made = fragment(&report, &BTreeMap::new());
        if std::env::var_os("UPDATE").is_some() {
            std::fs::write(format!("{file}.html"), &made).unwrap();
        }
        let committed = std::fs::read_to_string(format!("{file}.html")).unwrap_or_default();
        assert!(committed == made, "{name}.html is out of date: UPDATE=1 cargo test report_html");
    }
}
