use super::families::{correlation, numbers, within_powders};
use super::laboratory::{Value, mean};
use super::*;
use std::iter::once;

const SEEDS: std::ops::Range<u64> = 0..12;

fn every_family() -> impl Iterator<Item = Family> {
    Family::NULLS.into_iter().chain(Family::SINGLES).chain(Family::OTHERS)
}

fn sd(values: &[f64]) -> f64 {
    mean(&values.iter().map(|x| x * x).collect::<Vec<_>>()).sqrt()
}

/// Header and rows.
fn parsed(text: &str) -> (Vec<String>, Vec<Vec<String>>) {
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let header = reader.headers().unwrap().iter().map(str::to_owned).collect();
    (header, reader.records().map(|row| row.unwrap().iter().map(str::to_owned).collect()).collect())
}

fn setting(cells: &[(&str, &str)]) -> BTreeMap<String, String> {
    cells.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect()
}

#[test]
fn the_effect_of_each_cause_has_its_size_within_powders() {
    for (family, seed) in every_family().flat_map(|family| SEEDS.map(move |seed| (family, seed))) {
        let case = case(family, 0.75, seed);
        let causes = &case.laboratory.terms;
        for cause in causes {
            let effect: Vec<f64> = case.runs.iter().map(|run| cause.at(run)).collect();
            let within = within_powders(&case.runs, &effect);
            // Of 1 deg: only rounding.
            assert!((sd(&within) - case.size_deg).abs() < 1e-9, "{}: {}", case.name, sd(&within));
            assert!(
                within.iter().zip(&effect).all(|(a, b)| (a - b).abs() < 1e-9),
                "{}: no mean of 0",
                case.name
            );
        }
        assert_eq!(case.family, family.name());
        if family != Family::Wild {
            assert_eq!(case.size_deg, if causes.is_empty() { 0.0 } else { 0.75 });
            assert_eq!(
                causes.len(),
                [usize::from(!Family::NULLS.contains(&family)), 2]
                    [usize::from(family == Family::TwoCauses)]
            );
        }
    }
}

#[test]
fn nulls_have_no_effect_and_name_no_cause() {
    for (family, seed) in
        Family::NULLS.iter().flat_map(|family| SEEDS.map(move |seed| (*family, seed)))
    {
        let case = case(family, 1.0, seed);
        assert!(case.effect_deg.iter().all(|effect| *effect == 0.0) && case.effect_5_95_deg == 0.0);
        assert!(case.mechanism.is_none() && case.mechanisms.is_empty() && case.covariate.is_none());
    }
}

#[test]
fn the_file_holds_the_campaign_and_what_its_truth_needs() {
    for (family, seed) in every_family().flat_map(|family| SEEDS.map(move |seed| (family, seed))) {
        let case = case(family, 1.0, seed);
        let (header, rows) = parsed(&case.csv);
        assert_eq!(header[..3], ["powder", "repose_deg", "session"]);
        let laboratory = &case.laboratory;
        assert_eq!(rows.len(), laboratory.powders.len() * laboratory.days * laboratory.repeats);
        assert_eq!(rows.len(), case.effect_deg.len());
        match family {
            Family::Wild => {}
            Family::NullRestless => assert_eq!(rows.len(), 60),
            _ => assert_eq!(rows.len(), 200),
        }
        assert!(
            case.covariate.iter().all(|covariate| header.contains(covariate)),
            "{}: {header:?}",
            case.name
        );
        assert!(!header.iter().any(|name| name == "day"));
        let mut seen: Vec<&String> = rows.iter().map(|row| &row[2]).collect();
        seen.dedup();
        assert_eq!(seen.len(), laboratory.days);
        for (row, run) in rows.iter().zip(&case.runs) {
            let angle: f64 = row[1].parse().unwrap();
            assert!((0.0..90.0).contains(&angle), "{}: {angle}", case.name);
            for (name, text) in header.iter().zip(row).skip(3).filter(|(_, text)| !text.is_empty())
            {
                assert_eq!(Value::parse(name, text), run.values[name.as_str()], "{}", case.name);
            }
        }
    }
}

#[test]
fn what_is_measured_scatters_about_the_truth() {
    let campaigns: Vec<Case> = (0..40).map(|seed| case(Family::Humidity, 1.0, seed)).collect();
    let residuals = |case: &Case| -> Vec<f64> {
        let (_, rows) = parsed(&case.csv);
        rows.iter()
            .zip(&case.noise_free_deg)
            .map(|(row, truth)| row[1].parse::<f64>().unwrap() - truth)
            .collect()
    };
    let all: Vec<f64> = campaigns.iter().flat_map(residuals).collect();
    // Root of the mean square of the five repeat SDs, with 0.5² and 0.4². 8000 runs give it to
    // 0.017 deg; four of these.
    assert!((sd(&all) - 2.150).abs() < 0.07, "{}", sd(&all));
    // 800 days of 0.5 deg and runs of 2.2 deg: 0.03 deg; five of them.
    assert!(mean(&all).abs() < 0.15, "{}", mean(&all));
}

#[test]
fn the_same_seed_gives_the_same_bytes_and_another_seed_others() {
    for family in every_family() {
        let [a, b, c] = [3, 3, 4].map(|seed| case(family, 1.0, seed));
        assert_eq!((&a.csv, &a.effect_deg), (&b.csv, &b.effect_deg));
        assert_ne!(a.csv, c.csv);
    }
    assert_eq!(wild(5).csv, case(Family::Wild, 1.0, 5).csv);
}

#[test]
fn covariates_that_are_confounded_went_together() {
    for seed in 0..30 {
        let case = case(Family::Confounded, 1.0, seed);
        let columns = &case.laboratory.tie.as_ref().unwrap().columns;
        let [a, b] = [0, 1].map(|k| numbers(&case.runs, columns[k]).unwrap());
        assert!(correlation(&a, &b).abs() > 0.95, "{}", case.name);
        // The logarithms of times must move together as well.
        let [a, b] = [a, b].map(|x| x.into_iter().map(f64::ln_1p).collect::<Vec<_>>());
        assert!(
            columns[1] == "container_age_d" || correlation(&a, &b).abs() > 0.93,
            "{}",
            case.name
        );
        assert!(
            case.mechanism.is_some()
                && case.rivals.len() == 1
                && !case.rivals.contains(&case.mechanism.unwrap())
        );
        assert!(columns.iter().all(|name| parsed(&case.csv).0.iter().any(|it| it == name)));
    }
}

#[test]
fn the_change_from_the_5th_to_the_95th_percentile_is_that_of_the_effect() {
    for (family, seed) in
        Family::SINGLES.iter().flat_map(|family| SEEDS.map(move |seed| (*family, seed)))
    {
        let case = case(family, 1.0, seed);
        let Some(covariate) = case.covariate.as_deref() else {
            panic!("{} has no covariate", case.name)
        };
        let Some([from, to]) = case.span(covariate) else {
            assert!(case.effect_5_95_deg.is_nan() && covariate == "batch");
            continue;
        };
        // Every run twice with the covariate set, the term's formula written out, the powders
        // weighted alike.
        let term = &case.laboratory.terms[0];
        let mut change = 0.0;
        for powder in 0..5 {
            let mut sum = 0.0;
            for run in case.runs.iter().filter(|run| run.powder == powder) {
                for (text, side) in [(&to, 1.0), (&from, -1.0)] {
                    let mut moved = run.clone();
                    let value =
                        text.parse().map_or_else(|_| Value::Name(text.clone()), Value::Number);
                    moved.values.insert(term.factors[0].column(), value);
                    let product = term
                        .factors
                        .iter()
                        .fold(1.0, |product, factor| product * factor.at(&moved));
                    sum += side * term.scale * term.susceptibility[powder] * product;
                }
            }
            change += sum / 40.0 / 5.0;
        }
        assert!((change - case.effect_5_95_deg).abs() < 1e-9, "{}: {change}", case.name);
        if let Some(x) = numbers(&case.runs, covariate) {
            let mut sorted = x.clone();
            sorted.sort_by(f64::total_cmp);
            let from: f64 = from.parse().unwrap();
            assert!(
                sorted[9] <= from && from <= sorted[10],
                "{}: 5th percentile {from}",
                case.name
            );
        }
    }
}

#[test]
fn the_change_over_two_columns_is_that_of_both_at_once() {
    for seed in SEEDS {
        let case = case(Family::HumidAgeing, 1.0, seed);
        let columns = ["relative_humidity_pct", "rest_min"];
        let [humid, rested] = columns.map(|column| case.span(column).unwrap());
        let term = &case.laboratory.terms[0];
        // A product of one factor in each: the other conditions of the runs do not matter.
        let at = |factor: usize, text: &str| {
            let mut run = case.runs[0].clone();
            run.values.insert(columns[factor], Value::Number(text.parse().unwrap()));
            term.factors[factor].at(&run)
        };
        let [low, high] = [0, 1].map(|end| at(0, &humid[end]) * at(1, &rested[end]));
        let change = term.scale * mean(&term.susceptibility) * (high - low);
        assert!(
            (case.change_over_spans_deg(&columns).unwrap() - change).abs() < 1e-9,
            "{}: {change}",
            case.name
        );
        assert!(
            (case.change_over_spans_deg(&columns[..1]).unwrap() - case.effect_5_95_deg).abs()
                < 1e-12
        );
    }
}

#[test]
fn the_effect_of_a_recorded_cause_depends_on_its_columns_alone() {
    // Runs alike in powder and in all columns of the cause have the same effect, by the uploaded
    // file.
    for (family, seed) in
        once(Family::Recorded).chain(Family::SINGLES).flat_map(|f| SEEDS.map(move |seed| (f, seed)))
    {
        let case = case(family, 1.0, seed);
        let own: Vec<&str> =
            case.laboratory.terms[0].factors.iter().map(|factor| factor.column()).collect();
        let mut of: BTreeMap<String, f64> = BTreeMap::new();
        for (run, effect) in case.runs.iter().zip(&case.effect_deg) {
            let key = format!(
                "{} {:?}",
                run.powder,
                own.iter().map(|name| &run.values[name]).collect::<Vec<_>>()
            );
            assert!((*of.entry(key).or_insert(*effect) - *effect).abs() < 1e-12);
        }
    }
}

#[test]
fn families_have_their_signs_and_places() {
    for seed in SEEDS {
        let humid = case(Family::Humidity, 1.0, seed);
        assert!(humid.effect_5_95_deg > 0.0);
        let felt = |case: &Case| {
            case.laboratory.terms[0].susceptibility.iter().filter(|felt| **felt != 0.0).count()
        };
        assert!(felt(&humid) >= 3);
        assert_eq!(felt(&case(Family::Deliquescence, 1.0, seed)), 2);
        let dry = case(Family::Charge, 1.0, seed);
        assert!(dry.effect_5_95_deg < 0.0);
        assert_eq!(dry.change_deg("relative_humidity_pct", "48", "80"), 0.0);
        assert!(dry.change_deg("ioniser_on", "0", "1") < 0.0);
        assert!(case(Family::Vibration, 1.0, seed).effect_5_95_deg < 0.0);
        assert!(case(Family::FunnelHeight, 1.0, seed).effect_5_95_deg < 0.0);
        let ageing = case(Family::HumidAgeing, 1.0, seed);
        // Nothing in the driest air, and nothing without rest.
        let centre = |run: &Run| {
            -ageing.laboratory.terms[0].scale * ageing.laboratory.terms[0].centre[run.powder]
        };
        let mut run = ageing.runs[0].clone();
        run.values.insert("relative_humidity_pct", Value::Number(20.0));
        assert!((ageing.laboratory.effect_deg(&run) - centre(&run)).abs() < 1e-9);
        let outside = [Family::Recorded, Family::Unrecorded].map(|family| case(family, 1.0, seed));
        assert!(outside.iter().all(|case| case.mechanisms.is_empty()));
        assert!(
            outside[0].form_class.is_some()
                && outside[0].covariate.is_some()
                && outside[0].also_right.is_empty()
        );
        assert!(outside[1].also_right == ["unrecorded"] && outside[1].covariate.is_none());
        let two = case(Family::TwoCauses, 1.0, seed);
        assert!(
            two.mechanism.is_none()
                && two.mechanisms.len() == 2
                && two.mechanisms[0] != two.mechanisms[1]
        );
    }
}

#[test]
fn later_days_come_from_the_same_laboratory() {
    for family in every_family() {
        let case = case(family, 1.0, 7);
        let [few, many] = [3, 6].map(|days| case.more_days(days));
        let [few_rows, many_rows] = [&few, &many].map(|case| parsed(&case.csv));
        assert_eq!(few_rows.0, parsed(&case.csv).0);
        // The first of six more days are the three more days.
        assert_eq!(few_rows.1, many_rows.1[..few_rows.1.len()]);
        assert_eq!(few.effect_deg, many.effect_deg[..few.effect_deg.len()]);
        assert_eq!(few_rows.1.len() * 2, many_rows.1.len());
        let last = &parsed(&case.csv).1.pop().unwrap()[2];
        assert!(few_rows.1.iter().all(|row| row[2] != *last));
    }
}

#[test]
fn an_experiment_sets_what_it_was_asked_to_set() {
    let case = case(Family::Confounded, 1.0, 1);
    let settings = [
        setting(&[
            ("powder", "salt"),
            ("relative_humidity_pct", "35"),
            ("container_age_d", "0"),
            ("session", "a"),
        ]),
        setting(&[
            ("powder", "salt"),
            ("relative_humidity_pct", "65"),
            ("container_age_d", "0"),
            ("session", "b"),
        ]),
        setting(&[("relative_humidity_pct", "65"), ("ioniser_on", "1"), ("session", "a")]),
    ];
    let after = case.after_experiment(&settings);
    let (header, rows) = parsed(&after.csv);
    assert_eq!(rows.len(), 200 + 7);
    let place = |name: &str| header.iter().position(|it| it == name).unwrap();
    let cell = |row: usize, name: &str| rows[row][place(name)].as_str();
    assert_eq!(
        (cell(200, "powder"), cell(200, "relative_humidity_pct"), cell(200, "container_age_d")),
        ("salt", "35", "0")
    );
    let powders: Vec<&str> = (201..206).map(|row| cell(row, "powder")).collect();
    assert_eq!(powders, ["sand", "sugar", "salt", "semolina", "sodium_bicarbonate"]);
    assert_eq!((cell(206, "relative_humidity_pct"), cell(205, "ioniser_on")), ("65", "1"));
    assert_eq!(cell(200, "session"), cell(205, "session"));
    assert_ne!(cell(200, "session"), cell(206, "session"));
    // The campaign is unchanged, and its truth with it; so are the days after.
    let before = parsed(&case.csv);
    let same = |name: &str| {
        before.1.iter().zip(&rows).all(|(a, b)| {
            let old = before.0.iter().position(|it| it == name).unwrap();
            a[old] == b[place(name)]
        })
    };
    assert!(before.0.iter().all(|name| same(name)));
    assert_eq!(case.effect_deg, after.effect_deg[..200]);
    assert_ne!(after.more_days(1).csv, case.more_days(1).csv);
}

#[test]
fn wild_cases_are_of_many_kinds() {
    let cases: Vec<Case> = (0..60).map(wild).collect();
    let share = |what: &dyn Fn(&Case) -> bool| cases.iter().filter(|case| what(case)).count();
    assert!((1..20).contains(&share(&|case| case.size_deg == 0.0)));
    assert!(share(&|case| case.laboratory.terms.len() == 2) > 3);
    assert!(share(&|case| case.csv.contains("lactose_m200")) > 3);
    let mut columns: Vec<_> = cases.iter().filter_map(|case| case.covariate.clone()).collect();
    columns.sort_unstable();
    columns.dedup();
    assert!(columns.len() > 8, "{columns:?}");
    assert!(share(&|case| case.formula.contains(" then ")) > 15);
}
