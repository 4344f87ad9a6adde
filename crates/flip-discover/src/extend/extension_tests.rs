//! What an extended simulator is at given conditions, and which conditions it refuses.

use super::*;
use crate::Settings;
use crate::{Campaign, Covariate, Measured, Run, Values, extend, investigate, responses};
use flip_core::stats::normal;
use std::ops::ControlFlow;

fn through(name: &str, reference: f64, quantiles: &[f64]) -> Through {
    Through {
        name: name.into(),
        reference: Condition::Number(reference),
        quantiles: quantiles.to_vec(),
        shares: BTreeMap::new(),
    }
}

fn fitted(name: &str, value: f64) -> ParameterReport {
    ParameterReport { name: name.into(), value, ci95: [0.5 * value, 1.5 * value], unit: "1".into() }
}

/// Bridges that grow with the square of the humidity between 40 and 70 %, and a batch of other
/// sizes.
fn extended() -> Extended {
    let humidity = Extension {
        mechanism: "humidity".into(),
        hook: Hook::Extension("humidity".into()),
        form: Form::Named("h^2".into()),
        through: vec![through("relative_humidity_pct", 40.0, &[40.0, 50.0, 60.0, 70.0])],
        strength: [0.4_f64.powi(2), 0.41],
        effect_deg: 3.0,
        effect_ci95: [1.5, 4.5],
        amplitude: fitted("humidity", 0.2),
        powders: vec![OnPowder { powder: "salt".into(), effect_deg: 6.0, factor: 2.0 }],
        fit: None,
    };
    let batch = Extension {
        mechanism: "batch".into(),
        hook: Hook::Extension("size_spread".into()),
        form: Form::Levels([("A".to_owned(), 0.0), ("B".to_owned(), 1.0)].into()),
        through: vec![Through {
            name: "batch".into(),
            reference: Condition::Name("A".into()),
            quantiles: Vec::new(),
            shares: [("A".to_owned(), 0.75), ("B".to_owned(), 0.25)].into(),
        }],
        strength: [0.0, 1.0],
        effect_deg: -2.0,
        effect_ci95: [-3.0, -1.0],
        amplitude: fitted("size_spread", 0.05),
        powders: Vec::new(),
        fit: None,
    };
    let operator = Extension {
        mechanism: "operator".into(),
        hook: Hook::Reading,
        through: vec![Through { name: "operator".into(), ..batch.through[0].clone() }],
        form: Form::Levels([("A".to_owned(), -0.25), ("B".to_owned(), 0.75)].into()),
        ..batch.clone()
    };
    Extended { extensions: vec![humidity, batch, operator], powders: Vec::new() }
}

fn day(humidity: f64, batch: &str) -> Conditions {
    let batch = Condition::Name(batch.into());
    [("relative_humidity_pct".to_owned(), Condition::Number(humidity)), ("batch".to_owned(), batch)]
        .into()
}

#[test]
fn below_the_reference_a_mechanism_does_nothing_and_a_reading_goes_on() {
    let [humidity, _, operator] = &extended().extensions[..] else { panic!() };
    assert_eq!(humidity.shift_deg(None, &day(39.0, "A")), 0.0);
    assert!(humidity.shift_deg(None, &day(41.0, "A")) > 0.0);
    let by = |name: &str| [("operator".to_owned(), Condition::Name(name.into()))].into();
    // A quarter of -2 deg below the campaign's average, and three quarters above it.
    assert_eq!(["A", "B"].map(|name| operator.shift_deg(None, &by(name))), [0.5, -1.5]);
}

#[test]
fn the_reference_is_the_base_and_strengths_grow_from_it() {
    let extended = extended();
    assert!(extended.at(Some("salt"), &day(40.0, "A")).unwrap().is_none());
    let patch = extended.at(None, &day(50.0, "B")).unwrap();
    // (0.25 - 0.16) / 0.25 of 0.2, and all of 0.05.
    assert!(
        (patch.amplitudes["humidity"] - 0.072).abs() < 1e-12
            && patch.amplitudes["size_spread"] == 0.05
    );
    let salt = extended.at(Some("salt"), &day(50.0, "A")).unwrap();
    assert!(
        (salt.amplitudes["humidity"] - 0.144).abs() < 1e-12
            && !salt.amplitudes.contains_key("size_spread")
    );
    // Beyond the 95th percentile it continues as far as the campaign's range.
    assert!(extended.at(None, &day(70.0, "A")).unwrap().amplitudes["humidity"] > 0.2);
}

#[test]
fn corrections_of_readings_shift_angles_and_change_no_grain() {
    let extended = extended();
    let read_by = |name: &str| {
        let mut conditions = day(40.0, "A");
        conditions.insert("operator".into(), Condition::Name(name.into()));
        conditions
    };
    assert!(extended.at(None, &read_by("B")).unwrap().is_none());
    assert!((extended.shift_deg(None, &read_by("A")).unwrap() - 0.5).abs() < 1e-12);
    assert!((extended.shift_deg(None, &read_by("B")).unwrap() + 1.5).abs() < 1e-12);
    // The operator who reads an angle does not matter to a dose, but does to a measured angle.
    let missing = extended.shift_deg(None, &day(40.0, "A")).unwrap_err();
    assert_eq!(missing[0].field, "conditions.operator");
}

#[test]
fn conditions_that_nobody_saw_are_refused_with_what_may_be_asked_for() {
    let refused = |conditions: &Conditions| -> Vec<String> {
        extended().at(None, conditions).unwrap_err().iter().map(ToString::to_string).collect()
    };
    let outside = refused(&day(71.0, "C"));
    assert!(outside[0].starts_with("conditions.batch: must be one of A, B, got C"), "{outside:?}");
    assert!(
        outside[1].contains("conditions.relative_humidity_pct: must be a number from 40 to 70"),
        "{outside:?}"
    );
    let missing = refused(&Conditions::new());
    assert!(
        missing.len() == 2 && missing[0].contains("conditions.relative_humidity_pct: is missing"),
        "{missing:?}"
    );
    let mut stray = day(50.0, "A");
    stray.insert("lamp_nm".into(), Condition::Number(500.0));
    assert!(refused(&stray)[0].contains("conditions.lamp_nm: does nothing in this version"));
    let mut word = day(50.0, "A");
    word.insert("relative_humidity_pct".into(), Condition::Name("wet".into()));
    assert!(refused(&word)[0].contains("from 40 to 70"));
}

#[test]
fn days_are_as_the_campaign_saw_them_and_what_is_held_stays() {
    let extended = extended();
    let days = extended.days(&Conditions::new(), 40, 7).unwrap();
    assert_eq!(days, extended.days(&Conditions::new(), 40, 7).unwrap());
    assert_ne!(days, extended.days(&Conditions::new(), 40, 8).unwrap());
    let humidity = |day: &Conditions| match day["relative_humidity_pct"] {
        Condition::Number(number) => number,
        Condition::Name(_) => f64::NAN,
    };
    let below = |value: f64| days.iter().filter(|day| humidity(day) < value).count();
    // Evenly over the quantiles: one of forty may lie on either side of a bound.
    assert!(
        (12..=14).contains(&below(50.0)) && (26..=27).contains(&below(60.0)) && below(70.0) == 40
    );
    let of_b = days.iter().filter(|day| day["batch"] == Condition::Name("B".into())).count();
    assert_eq!(of_b, 10);
    let held = [("relative_humidity_pct".to_owned(), Condition::Number(55.0))].into();
    assert!(extended.days(&held, 5, 1).unwrap().iter().all(|day| humidity(day) == 55.0));
    let outside = [("relative_humidity_pct".to_owned(), Condition::Number(99.0))].into();
    assert!(extended.days(&outside, 5, 1).is_err());
}

#[test]
fn a_course_is_linear_between_its_places_and_flat_beyond() {
    let course = [[0.0, 1.0], [10.0, 3.0], [20.0, 0.0]];
    for (at, expected) in
        [(-1.0, 1.0), (0.0, 1.0), (5.0, 2.0), (10.0, 3.0), (15.0, 1.5), (30.0, 0.0)]
    {
        assert_eq!(along(&course, at), Some(expected), "{at}");
    }
}

/// Sixty days, one run of three powders each, whose angles rise by 4 deg from 30 to 70 % of what is
/// called `covariate`.
fn campaign(covariate: &str) -> Campaign {
    let noise = |k: usize| normal::quantile(((k * 7919) % 997) as f64 / 997.0 * 0.98 + 0.01);
    let value = |day: usize| 30.0 + 40.0 * ((day * 37) % 60) as f64 / 59.0;
    let runs: Vec<Run> = (0..180)
        .map(|k| {
            let (session, powder) = (k / 3, k % 3);
            let angle =
                30.0 + 5.0 * powder as f64 + 4.0 * (value(session) - 30.0) / 40.0 + 0.4 * noise(k);
            Run { row: k as u32 + 2, powder, session, value: Some(angle) }
        })
        .collect();
    let values = Values::Numbers((0..180).map(|k| Some(value(k / 3))).collect());
    Campaign {
        powders: ["sand", "salt", "flour"].map(str::to_owned).to_vec(),
        runs,
        covariates: vec![Covariate { name: covariate.into(), values }],
        ..Campaign::default()
    }
}

fn extended_by(campaign: &Campaign) -> Extended {
    let settings = Settings { seed: 1, simulations: 99 };
    let responses = responses(campaign);
    let report =
        investigate(Measured::angles(campaign), "base", &settings, |_| ControlFlow::Continue(()))
            .unwrap()
            .unwrap();
    extend(campaign, &responses, &report)
        .unwrap()
        .unwrap_or_else(|| panic!("{:?}: {}", report.verdict, report.sentence))
}

#[test]
fn humidity_becomes_bridges_that_are_dry_at_the_driest_day() {
    let extended = extended_by(&campaign("relative_humidity_pct"));
    let [humidity] = &extended.extensions[..] else { panic!("{extended:?}") };
    assert_eq!(
        (humidity.mechanism.as_str(), &humidity.hook),
        ("humidity", &Hook::Extension("humidity".into()))
    );
    assert_eq!(humidity.through[0].reference, Condition::Number(30.0));
    // From the 5th to the 95th percentile is nine tenths of 4 deg.
    assert!(
        (humidity.effect_deg - 3.6).abs() < 0.5
            && humidity.effect_ci95[0] < 3.6
            && humidity.effect_ci95[1] > 3.6
    );
    // The table has 9.1 deg at 0.3.
    assert!((humidity.amplitude.value - 0.3 * humidity.effect_deg / 9.1).abs() < 1e-9);
    let at = |powder: &str, value: f64| {
        let conditions = [("relative_humidity_pct".to_owned(), Condition::Number(value))].into();
        (
            extended.at(Some(powder), &conditions).unwrap(),
            extended.shift_deg(Some(powder), &conditions).unwrap(),
        )
    };
    assert!(at("sand", 30.0).0.is_none() && at("sand", 30.0).1 == 0.0);
    assert!(at("sand", 70.0).0.amplitudes["humidity"] > at("sand", 50.0).0.amplitudes["humidity"]);
    let sand = extended.powders.iter().find(|it| it.powder == "sand").unwrap();
    assert!((sand.repose.repose_deg - 30.0).abs() < 0.6 && sand.repose.n == 60, "{sand:?}");
    assert!((sand.repose.repose_deg + at("sand", 70.0).1 - 34.0).abs() < 0.8);
}

#[test]
fn what_has_no_mechanism_becomes_a_law_on_cohesion() {
    let extended = extended_by(&campaign("lamp_pct"));
    let [law] = &extended.extensions[..] else { panic!("{extended:?}") };
    assert_eq!(
        (law.mechanism.as_str(), &law.hook),
        ("unknown: lamp_pct", &Hook::Parameter("cohesion".into()))
    );
    let Form::Course(course) = &law.form else { panic!("{:?}", law.form) };
    assert!(
        course.len() == 21 && course[0][1] == 0.0 && (course[20][1] - 1.0).abs() < 1e-9,
        "{course:?}"
    );
    let at = |value: f64| {
        extended.at(None, &[("lamp_pct".to_owned(), Condition::Number(value))].into()).unwrap()
    };
    assert!(at(30.0).is_none() && at(70.0).parameters["cohesion"] > 0.2);
}
