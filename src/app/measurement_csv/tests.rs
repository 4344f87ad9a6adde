//! How a file is read, why it is refused, and that it survives a round trip.

use super::*;
use flip_store::now;

fn refused(text: &str) -> Vec<String> {
    match read(text) {
        Err(Error::Invalid(errors)) => errors.into_iter().map(|error| error.field).collect(),
        other => panic!("{text}: {other:?}"),
    }
}

fn entries(text: &str) -> Vec<Entry> {
    read(text).unwrap_or_else(|error| panic!("{text:?}: {error}")).0
}

#[test]
fn repeats_of_one_powder_method_and_source_become_one_measurement() {
    let text = "\u{feff}powder, repose_deg ,method,source\nsalt,30,,a\nsalt,36,manual,a\nsalt,32,automated,a\nsalt,34,,b\n\nsalt,34,,a\n,,,\n";
    let entries = entries(text);
    let angle = |row, method, repose_deg, sd_deg, n, source: &str| {
        let value = Value::Angle(method, Flowability { repose_deg, sd_deg, n });
        Entry { row, powder: "salt".into(), origin: Origin::undated(source), value }
    };
    let expected = [
        angle(2, Method::Automated, 32.0, 2.0, 3, "a"),
        angle(3, Method::Manual, 36.0, 0.0, 1, "a"),
        angle(5, Method::Automated, 34.0, 0.0, 1, "b"),
    ];
    assert_eq!(entries, expected);
}

#[test]
fn heights_and_angles_are_repeats_of_the_same_measurement() {
    let text = "powder,repose_deg,height_mm,base_diameter_mm,funnel_height_mm\nsalt,45,,,\nsalt,,20,40,\nsalt,,50,100,60\n";
    let Value::Angle(_, measured) = entries(text)[0].value else { panic!() };
    assert!(
        (measured.repose_deg - 45.0).abs() < 1e-12 && measured.sd_deg < 1e-12 && measured.n == 3
    );
}

#[test]
fn a_row_may_hold_a_repeat_of_every_experiment() {
    let text = "powder,repose_deg,flow_time_s,poured_mass_g,orifice_mm,shake_mg,spoon_pitch_deg,shake_mm,drained_deg,\
                pile_height_mm,base_diameter_mm,fall_mm\n\
                salt,30,10,50,2.54,3,30,4,40,12,40,8\nsalt,32,12,50,2.54,5,30,4,44,14,40,8\n";
    let entries = entries(text);
    let means = entries.iter().map(|entry| match entry.value {
        Value::Angle(_, measured) => (measured.repose_deg, measured.n),
        Value::Observed(observed) => (observed.mean, observed.n),
    });
    assert_eq!(means.collect::<Vec<_>>(), [(31.0, 2), (11.0, 2), (4.0, 2), (42.0, 2), (13.0, 2)]);
}

#[test]
fn wrong_cells_are_refused_by_row_and_column() {
    for (text, fields) in [
        ("powder,angle\nsalt,30\n", &["angle"] as &[&str]),
        ("powder:repose_deg\nsalt:30\n", &["powder", "powder:repose_deg"]),
        ("repose_deg\n30\n", &["powder"]),
        ("powder,repose_deg,repose_deg\nsalt,30,30\n", &["repose_deg"]),
        ("powder,repose_deg\n", &["row[2]"]),
        ("powder,repose_deg\n,\n", &["row[2]"]),
        ("powder,repose_deg\nsalt,30,5\n", &["row[2]"]),
        ("powder,repose_deg\n,30\n?!,30\n", &["row[2].powder", "row[3].powder"]),
        (
            "powder,repose_deg\nsalt,30\nsalt,4.9\nsalt,<30\nsalt,inf\nsalt,30 mm\n",
            &["row[3].repose_deg", "row[4].repose_deg", "row[5].repose_deg", "row[6].repose_deg"],
        ),
        ("powder,repose_deg\nsalt,NaN\n", &["row[2]"]),
        ("powder,repose_deg\nsalt,\n", &["row[2]"]),
        ("powder,method,repose_deg\nsalt,guess,30\n", &["row[2].method"]),
        ("powder,repose_deg,repose_sd_deg\nsalt,30,1\n", &["row[2].repose_sd_deg"]),
        ("powder,repose_deg,n\nsalt,30,5\n", &["row[2].repose_sd_deg"]),
        ("powder,repose_deg,repose_sd_deg,n\nsalt,30,-1,5\n", &["row[2].repose_sd_deg"]),
        (
            "powder,repose_deg,repose_sd_deg,n\nsalt,30,1,0\nsalt,30,1,2.5\n",
            &["row[2].n", "row[3].n"],
        ),
        ("powder,repose_deg,height_mm,base_diameter_mm\nsalt,45,20,40\n", &["row[2].height_mm"]),
        ("powder,height_mm\nsalt,20\n", &["row[2].base_diameter_mm"]),
        ("powder,height_mm,base_diameter_mm,n\nsalt,20,40,5\n", &["row[2].n"]),
        (
            "powder,height_mm,base_diameter_mm,funnel_height_mm\nsalt,20,40,19\n",
            &["row[2].height_mm"],
        ),
        ("powder,height_mm,base_diameter_mm\nsalt,20,0\n", &["row[2].base_diameter_mm"]),
        ("powder,repose_deg,orifice_mm\nsalt,30,2.5\n", &["row[2].orifice_mm"]),
        ("powder,flow_time_s,poured_mass_g,orifice_mm\nsalt,10,50,9\n", &["row[2].orifice_mm"]),
        ("powder,flow_time_s,poured_mass_g,orifice_mm\nsalt,10,,2.5\n", &["row[2].poured_mass_g"]),
        ("powder,shake_mg,spoon_pitch_deg,shake_mm\nsalt,3,30,4\n", &["row[2].shake_mg"]),
        ("powder,drained_deg\nsalt,40\nsugar,40\nsalt,42\n", &["row[3].drained_deg"]),
        ("powder,repose_deg\nsalt,5\nsalt,85\n", &["row[2].repose_deg"]),
    ] {
        assert_eq!(refused(text), fields, "{text}");
    }
    let many = format!("powder,repose_deg\n{}", "salt,30\n".repeat(10_001));
    assert_eq!(refused(&many), ["row[2].repose_deg"], "too many repeats");
    let wrong = format!("powder,repose_deg\n{}", "salt,x\n".repeat(1000));
    assert_eq!(refused(&wrong).len(), REFUSALS_MAX);
}

#[test]
fn what_is_written_is_read_to_the_last_bit() {
    let created_at = now();
    let measurement = |method, repose_deg, source: &str| Measurement {
        id: "m".into(),
        powder: "salt".into(),
        method,
        repose_deg,
        sd_deg: 0.1 + 0.2,
        sd_unknown: false,
        n: 3,
        source: source.into(),
        measured_on: (method == Method::Manual).then(|| "2026-02-03".to_owned()),
        created_at,
        withdrawn: None,
    };
    let measurements = [
        measurement(Method::Automated, 100.0 / 3.0, "a, \"quoted\" source"),
        measurement(Method::Manual, 5.0, ""),
    ];
    let observables = [
        Observable::FlowTime { mass_g: 50.0, orifice_mm: 2.54 },
        Observable::ShakeMass { pitch_deg: 30.0, shake_mm: 4.1 },
        Observable::DrainedAngle {},
        Observable::PileHeight { base_diameter_mm: 40.0, fall_mm: 8.0 },
    ];
    let observations = observables.map(|observable| PowderObservation {
        id: "o".into(),
        powder: "sugar".into(),
        observable,
        mean: 10.0 + 1.0 / 3.0,
        sd: 0.1 + 0.2,
        n: 2,
        source: "bench".into(),
        measured_on: None,
        created_at,
        withdrawn: None,
    });
    let entries = entries(&write(&measurements, &observations));
    assert_eq!(entries.len(), 6);
    for (entry, m) in entries.iter().zip(&measurements) {
        let value = Flowability { repose_deg: m.repose_deg, sd_deg: m.sd_deg, n: m.n };
        assert_eq!(
            (&entry.origin.source, &entry.value),
            (&m.source, &Value::Angle(m.method, value))
        );
    }
    for (entry, o) in entries[2..].iter().zip(&observations) {
        let value = Observation { observable: o.observable, mean: o.mean, sd: o.sd, n: o.n };
        assert_eq!((&entry.powder, &entry.value), (&o.powder, &Value::Observed(value)));
    }
}

#[test]
fn files_of_a_spreadsheet_in_another_country_read_as_one_of_ours() {
    let ours = entries(
        "powder,method,repose_deg,repose_sd_deg,n,source\nsalt,manual,36.2,0.8,5,Prüfstand A\n",
    );
    for text in [
        "powder;method;repose_deg;repose_sd_deg;n;source\r\nsalt;manual;36,2;0,8;5;Prüfstand A\r\n",
        "sep=;\r\npowder;method;repose_deg;repose_sd_deg;n;source\r\nsalt;manual;36.2;0.8;5;Prüfstand A\r\n",
        "powder\tmethod\trepose_deg\trepose_sd_deg\tn\tsource\nsalt\thand\t36,2\t0,8\t5\tPrüfstand A\n",
        "\u{feff}Powder,Method,Repose_Deg,Repose SD deg,N,Source,,\r\nsalt,Manual,36.2°,0.8,5.0,Prüfstand A,,\r\n\u{1a}",
        "powder,method,repose_deg,repose_sd_deg,n,flow_time_s,source\nsalt,manual,\"36,2\",\"0,8\",5,NA,Prüfstand A\n",
    ] {
        assert_eq!(entries(text), ours, "{text:?}");
    }
    let camera = entries("powder,method,repose_deg\nsalt,camera,36\nsalt,Automated,36\nsalt,,36\n");
    assert!(matches!(
        camera[..],
        [Entry { value: Value::Angle(Method::Automated, Flowability { n: 3, .. }), .. }]
    ));
}

#[test]
fn a_single_value_has_no_spread_and_needs_none() {
    let single = Flowability { repose_deg: 36.2, sd_deg: 0.0, n: 1 };
    for text in [
        "powder,repose_deg,n\nsalt,36.2,1\n",
        "powder,repose_deg,repose_sd_deg,n\nsalt,36.2,NA,1\n",
        "powder,repose_deg\nsalt,36.2\n",
    ] {
        assert_eq!(entries(text)[0].value, Value::Angle(Method::Automated, single), "{text:?}");
    }
}

#[test]
fn a_shake_that_let_nothing_fall_may_read_less_than_nothing() {
    let shakes = |cells: [&str; 3]| {
        let rows = cells.map(|cell| format!("salt,{cell},20,4\n")).concat();
        format!("powder,shake_mg,spoon_pitch_deg,shake_mm\n{rows}")
    };
    let Value::Observed(observed) = entries(&shakes(["-0.1", "0.3", "0.1"]))[0].value else {
        panic!()
    };
    assert!((observed.mean - 0.1).abs() < 1e-12 && observed.n == 3);
    assert_eq!(
        refused(&shakes(["-0.3", "0.1", "0.1"])),
        ["row[2].shake_mg"],
        "on average it did not rise"
    );
    assert_eq!(refused(&shakes(["-60", "30", "40"])), ["row[2].shake_mg"]);
}

#[test]
fn a_powder_may_be_written_by_its_name() {
    let (entries, names) =
        read("powder,repose_deg\nLactose 200M,40\nlactose_200m,42\n3-Nitrotoluene,38\n").unwrap();
    let found: Vec<(&str, Option<&str>)> =
        entries.iter().map(|entry| (entry.powder.as_str(), names.name_of(&entry.powder))).collect();
    assert_eq!(
        found,
        [("lactose_200m", Some("Lactose 200M")), ("p_3_nitrotoluene", Some("3-Nitrotoluene"))]
    );
}

#[test]
fn repeats_of_another_day_are_another_measurement_and_a_day_that_may_be_two_is_refused() {
    let text = "powder,repose_deg,date\nsalt,30,2026-02-03\nsalt,32,3.2.2026\nsalt,40,2026-02-04\nsalt,50,\n";
    let of = |entry: &Entry| match entry.value {
        Value::Angle(_, angle) => (entry.origin.measured_on.clone(), angle.repose_deg, angle.n),
        Value::Observed(_) => panic!("{entry:?}"),
    };
    let day = |day: &str| Some(format!("2026-02-{day}"));
    assert_eq!(
        entries(text).iter().map(of).collect::<Vec<_>>(),
        [(day("03"), 31.0, 2), (day("04"), 40.0, 1), (None, 50.0, 1)]
    );
    for wrong in ["2/3/2026", "Tuesday", "2026-02-31"] {
        assert_eq!(refused(&format!("powder,repose_deg,date\nsalt,30,{wrong}\n")), ["row[2].date"]);
    }
}
