//! Functions of the angle less its powder's mean, and conditions as strong as possible.

use super::tests::{Laboratory, investigated};
use super::*;
use crate::data::campaign::Run;
use crate::data::reading::{ColumnRead, FileRead, TakenAs};
use crate::report::Verdict;

fn angles(laboratory: &Laboratory) -> Vec<f64> {
    laboratory.campaign.runs.iter().filter_map(|run| run.value).collect()
}

/// Mean and SD of the angles of each run's group.
fn groups(laboratory: &Laboratory, of: impl Fn(&Run) -> (usize, usize)) -> Vec<(f64, f64)> {
    let runs = &laboratory.campaign.runs;
    let own = |run: &Run| -> Vec<f64> {
        runs.iter().filter(|it| of(it) == of(run)).filter_map(|it| it.value).collect()
    };
    let both = |own: &[f64]| {
        let middle = mean(own).unwrap();
        (
            middle,
            (own.iter().map(|it| (it - middle).powi(2)).sum::<f64>() / own.len() as f64).sqrt(),
        )
    };
    runs.iter().map(|run| both(&own(run))).collect()
}

fn add(laboratory: &mut Laboratory, name: &str, values: Vec<f64>) {
    let values = Values::Numbers(values.into_iter().map(Some).collect());
    laboratory.campaign.covariates.push(Covariate { name: name.to_owned(), values });
}

fn add_flag(laboratory: &mut Laboratory, name: &str, is: impl Iterator<Item = bool>) {
    let values = Values::Levels {
        names: vec!["no".to_owned(), "yes".to_owned()],
        of: is.map(|is| Some(usize::from(is))).collect(),
    };
    laboratory.campaign.covariates.push(Covariate { name: name.to_owned(), values });
}

fn round(value: f64, steps: f64) -> f64 {
    (value * steps).round() / steps
}

const NAMES: [&str; 7] = [
    "dev_from_nominal",
    "z_in_powder",
    "over_mean",
    "over_mean_01",
    "dev_on_day",
    "over_mean_of_day",
    "day_mean_of_residuals",
];

fn with_functions_of_the_residual(mut laboratory: Laboratory) -> Laboratory {
    for run in &mut laboratory.campaign.runs {
        run.value = run.value.map(|angle| round(angle, 10.0));
    }
    let y = angles(&laboratory);
    let (powder, day) = (
        groups(&laboratory, |run| (run.powder, 0)),
        groups(&laboratory, |run| (run.powder, run.session)),
    );
    let residuals: Vec<f64> = y.iter().zip(&powder).map(|(y, it)| y - it.0).collect();
    let session: Vec<f64> = laboratory
        .campaign
        .runs
        .iter()
        .map(|run| {
            let own: Vec<f64> = (0..y.len())
                .filter(|&k| laboratory.campaign.runs[k].session == run.session)
                .map(|k| residuals[k])
                .collect();
            mean(&own).unwrap()
        })
        .collect();
    let each = |of: &dyn Fn(usize) -> f64| -> Vec<f64> { (0..y.len()).map(of).collect() };
    // Nominal to half a degree, means written down to a tenth.
    let nominal = each(&|k| round(y[k] - round(powder[k].0, 2.0), 10.0));
    let z = each(&|k| round((y[k] - powder[k].0) / powder[k].1, 100.0));
    let on_day = each(&|k| round(y[k] - round(day[k].0, 10.0), 10.0));
    add(&mut laboratory, NAMES[0], nominal);
    add(&mut laboratory, NAMES[1], z);
    add_flag(&mut laboratory, NAMES[2], residuals.iter().map(|it| *it > 0.0));
    add(
        &mut laboratory,
        NAMES[3],
        residuals.iter().map(|it| f64::from(u8::from(*it > 0.0))).collect(),
    );
    add(&mut laboratory, NAMES[4], on_day);
    add_flag(&mut laboratory, NAMES[5], (0..y.len()).map(|k| y[k] > day[k].0));
    add(&mut laboratory, NAMES[6], session.iter().map(|it| round(*it, 100.0)).collect());
    laboratory
}

#[test]
fn what_is_computed_of_the_angle_less_its_powders_mean_is_no_condition() {
    for seed in 0..10 {
        for powders in [3, 5] {
            // Three hundred runs: with fewer, a flag may remain a condition.
            let laboratory =
                with_functions_of_the_residual(Laboratory::new(seed, powders, 150 / powders, 1.0));
            assert_eq!(laboratory.left_out(), NAMES, "{powders} powders, seed {seed}");
        }
    }
}

#[test]
fn a_typing_error_does_not_hide_a_deviation_from_the_mean() {
    let mut laboratory = with_functions_of_the_residual(Laboratory::new(3, 5, 30, 1.0));
    laboratory.campaign.covariates.truncate(2);
    for covariate in &mut laboratory.campaign.covariates {
        let Values::Numbers(values) = &mut covariate.values else { panic!() };
        (values[17], values[60]) = (Some(40.0), None);
    }
    assert_eq!(laboratory.left_out(), NAMES[..2]);
}

#[test]
fn conditions_stay_conditions_however_much_they_explain() {
    for seed in 0..20 {
        for repeat_share in [0.25, 0.5, 1.0] {
            for effect in [1.0, 3.0, 6.0, 12.0] {
                let of = || Laboratory::new(seed, 5, 24, repeat_share);
                let mut each = of();
                each.condition("dial", |it, _| it.normal(), |x| effect * x / 2.0);
                assert_eq!(each.left_out(), [""; 0], "dial {effect}, {repeat_share}, seed {seed}");
                let mut two = of();
                two.condition(
                    "lid",
                    |it, _| f64::from(u8::from(it.normal() > 0.0)),
                    |x| effect * x,
                );
                assert_eq!(two.left_out(), [""; 0], "lid {effect}, {repeat_share}, seed {seed}");
                // One run of a day with it and one without.
                let mut pairs = of();
                pairs.condition("valve", |_, run| f64::from(run.row % 2), |x| effect * x);
                assert_eq!(
                    pairs.left_out(),
                    [""; 0],
                    "valve {effect}, {repeat_share}, seed {seed}"
                );
                let days: Vec<f64> = {
                    let mut it = of();
                    (0..24).map(|_| it.normal()).collect()
                };
                let mut daily = of();
                daily.condition("ward_pressure", |_, run| days[run.session], |x| effect * x / 2.0);
                assert_eq!(
                    daily.left_out(),
                    [""; 0],
                    "daily {effect}, {repeat_share}, seed {seed}"
                );
            }
        }
    }
}

#[test]
fn a_deviation_from_the_mean_is_named_and_left_out_and_explains_nothing() {
    let mut laboratory = with_functions_of_the_residual(Laboratory::new(3, 3, 20, 1.0));
    laboratory.campaign.covariates.truncate(2);
    let mut report = investigated(&laboratory.campaign);
    assert_eq!(report.verdict, Verdict::NoDiscrepancy, "{}", report.sentence);
    assert_eq!(report.left_out.iter().map(|it| it.column.as_str()).collect::<Vec<_>>(), NAMES[..2]);
    // The same where the reading of the file is reported.
    let column = ColumnRead {
        column: NAMES[0].to_owned(),
        taken_as: TakenAs::Numbers,
        filled: 120,
        missing: 0,
        note: String::new(),
    };
    let (file, columns) = ("measurements".to_owned(), vec![column]);
    report.read_from(&[FileRead {
        file,
        rows: 120,
        columns,
        powders: vec![],
        left_out: vec![],
        notes: vec![],
    }]);
    let note = &report.files[0].columns[0].note;
    assert!(note.starts_with("left out: follows from the angle"), "{note}");
}
