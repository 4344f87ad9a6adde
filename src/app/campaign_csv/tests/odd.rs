//! Odd tables: why they are refused, and the notes on those that are read.

use super::*;

/// Fourteen rows below a header.
fn table(header: &str, row: impl Fn(usize) -> String) -> String {
    let rows: Vec<String> = (0..14).map(row).collect();
    format!("{header}\n{}\n", rows.join("\n"))
}

/// Fourteen runs of salt, each with a cell in one extra column.
fn beside(column: &str, cell: impl Fn(usize) -> String) -> String {
    table(&format!("powder,repose_deg,{column}"), |k| {
        format!("salt,3{}.{},{}", k % 7, k % 10, cell(k))
    })
}

fn note(text: &str, column: &str) -> String {
    let columns = read_of(text).read.columns;
    columns.into_iter().find(|it| it.column == column).unwrap().note
}

#[test]
fn a_date_with_its_year_of_two_digits_first_is_no_day_of_2021() {
    // Three consecutive days: in 2026, or 2019 to 2021.
    for written in [
        |k: usize| format!("26/02/{}", 19 + k % 3),
        |k| format!("26.02.{}", 19 + k % 3),
        |k| format!("26-02-{}", 19 + k % 3),
    ] {
        let text = beside("session", written);
        assert_eq!(refused(&text), ["row[2].session"], "{text}");
        let read = read(&text, &REQUIRED, Some(DateOrder::YearFirst)).unwrap();
        assert_eq!(read.read.columns[2].note, "3 days, 2026-02-19 to 2026-02-21");
    }
    // A column covering more of the month is unambiguous: nobody measured from 2001 to 2027.
    assert_eq!(
        note(&beside("session", |k| format!("26/02/{:02}", 1 + 2 * k)), "session"),
        "14 days, 2026-02-01 to 2026-02-27"
    );
    assert_eq!(
        note(&beside("session", |k| format!("{:02}.02.26", 1 + 2 * k)), "session"),
        "14 days, 2026-02-01 to 2026-02-27"
    );
    // The same without separators; as numbers they would be sorted by the day of the month.
    let days =
        |k: usize| format!("{:02}{}26", 10 + k, if k.is_multiple_of(2) { "02" } else { "01" });
    assert_eq!(note(&beside("session", days), "session"), "14 days, 2026-01-11 to 2026-02-22");
}

#[test]
fn session_1_10_is_not_session_1_1() {
    let sessions = |cells: &[&str]| campaign_of(&with_column("session", cells)).session_of();
    assert_eq!(sessions(&["1.1", "1.2", "1.10", "1.1"]), [0, 1, 2, 0]);
    assert_eq!(sessions(&["1.10", "1.20", "2.00"]), [0, 1, 2], "numbers of two decimals");
    assert!(told("session", &["1.9", "1.10", "1.11"]).note.starts_with("3 names such as 1.10"));
}

#[test]
fn a_wrong_digit_among_counted_days_does_not_make_numbers_of_them() {
    let text =
        beside("session", |k| if k == 4 { "4605".to_owned() } else { format!("{}.5", 46_050 + k) });
    assert_eq!(refused(&text), ["row[6].session"]);
}

#[test]
fn two_sessions_on_one_day_are_not_made_one_without_a_word() {
    let text = beside("session", |k| {
        format!("2026-02-{:02} {}:00", 1 + k / 4, if k % 2 == 0 { 9 } else { 15 })
    });
    let note = note(&text, "session");
    assert!(
        note.starts_with("4 days")
            && note.contains("4 of them have runs at several times of day, which are one session"),
        "{note}"
    );
    let once = told("session", &["2026-02-01 09:00", "2026-02-01 09:00", "2026-02-02 10:00"]);
    assert_eq!(once.note, "2 days, 2026-02-01 to 2026-02-02");
}

#[test]
fn a_humidity_in_fractions_and_per_cents_is_refused_whatever_its_column_is_called() {
    for column in
        ["humidity", "RH", "Relative Humidity [%]", "relative_humidity_pct", "Luftfeuchte"]
    {
        assert_eq!(
            refused(&with_column(column, &["45", "0.41", "47", "0.5"])).len(),
            2,
            "{column}"
        );
    }
    let mixed = campaign_of(&with_column("humidity", &["45 %", "0.41", "47 %"]));
    assert_eq!(
        column(&mixed, "relative_humidity_pct"),
        Some(&Values::Numbers(vec![Some(45.0), Some(41.0), Some(47.0)]))
    );
    // A share that can be anything.
    assert!(column(&campaign_of(&with_column("fill", &["45", "0.41", "47"])), "fill").is_some());
}

#[test]
fn days_under_another_name_are_the_sessions_and_no_condition() {
    let days = |k: usize| format!("2026-02-{:02}", 1 + k / 2);
    let plain = campaign_of(&beside("session", days));
    for header in ["Date", "day", "Datum", "Session date"] {
        assert_eq!(campaign_of(&beside(header, days)), plain, "{header}");
    }
    for header in ["Sesion", "When", "Zeitpunkt"] {
        assert_eq!(refused(&beside(header, days)), [header], "{header}");
    }
    // Next to a session they can be anything: the day on which a batch was made.
    let both = beside("session", |k| format!("{},2026-01-{:02}", days(k), 1 + k % 3))
        .replace("session\n", "session,date\n");
    assert!(column(&campaign_of(&both), "date").is_some());
}

#[test]
fn humidity_and_angle_are_known_by_what_laboratories_call_them_and_a_slip_is_asked_about() {
    let humidity = |k: usize| format!("{}", 40 + k);
    let plain = campaign_of(&beside("relative_humidity_pct", humidity));
    for header in ["RH", "RH %", "Humidity", "Relative humidity (%)", "rF", "Luftfeuchte"] {
        assert_eq!(campaign_of(&beside(header, humidity)), plain, "{header}");
    }
    assert_eq!(refused(&beside("relative_humidity_pc", humidity)), ["relative_humidity_pc"]);
    assert_eq!(refused(&beside("temperature", humidity)), ["temperature"], "of which unit?");
    assert!(
        column(&campaign_of(&beside("bench", |k| format!("{}", k % 3))), "bench").is_some(),
        "no slip for batch"
    );
    let renamed =
        beside("relative_humidity_pct", humidity).replacen("repose_deg", "Angle of repose", 1);
    assert_eq!(campaign_of(&renamed), plain);
}

#[test]
fn a_mean_below_a_table_is_no_powder_and_no_run() {
    let runs = beside("session", |k| k.to_string());
    let plain = read_of(&runs);
    let with = read_of(&format!("{runs}Mean,33.6,\nSD,1.9,\nGrand Total,471.1,\n"));
    assert_eq!(with.campaign, plain.campaign);
    assert_eq!(
        (with.read.left_out[0].rows.as_slice(), with.read.rows),
        ([16, 17, 18].as_slice(), 17)
    );
    // In a column of its own.
    let text = beside("sample", |k| format!("A{k}"));
    let with = read_of(&format!("{text}salt,33.6,Mean\nsalt,39.9,Max\n"));
    assert_eq!(with.campaign, campaign_of(&text));
    assert_eq!(with.read.left_out[0].rows, [16, 17]);
    // Levels with such names are not summaries.
    let skill = campaign_of(&beside("skill", |k| ["low", "average", "high"][k % 3].to_owned()));
    assert_eq!(skill.runs.len(), 14);
    assert_eq!(
        refused(&beside("statistic", |k| ["mean", "min", "max"][k % 3].to_owned())),
        ["row[2]"]
    );
    let asked = read(&format!("{runs}Mean,33.6,\n"), &["powder"], None).unwrap_err().to_string();
    assert!(asked.contains("row[16].powder"), "a question is not left out: {asked}");
}

#[test]
fn one_name_in_several_ways_is_one_name_and_told() {
    let operators = |k: usize| ["Ada", "ada", "ADA ", "Ben"][k % 4].to_owned();
    let read = campaign_of(&beside("operator", operators));
    assert!(
        matches!(column(&read, "operator"), Some(Values::Levels { names, .. }) if *names == ["Ada", "Ben"])
    );
    assert_eq!(
        note(&beside("operator", operators), "operator"),
        "taken as one name: Ada = ada = ADA"
    );
    let lid = beside("lid", |k| ["yes", "1", "no", "0"][k % 4].to_owned());
    assert!(
        matches!(column(&campaign_of(&lid), "lid"), Some(Values::Levels { names, .. }) if *names == ["no", "yes"])
    );
    assert_eq!(
        campaign_of(&with_column("session", &["Monday", "monday ", "Tuesday"])).session_of(),
        [0, 0, 1]
    );
}

#[test]
fn what_stands_for_nothing_is_no_number() {
    assert_eq!(
        refused(&beside("temp", |k| if k == 5 {
            "-999".to_owned()
        } else {
            format!("2{}", k % 5)
        })),
        ["row[7].temp"]
    );
    assert_eq!(
        refused(&beside("rest_min", |k| if k % 7 == 5 {
            "9999".to_owned()
        } else {
            k.to_string()
        }))
        .len(),
        2
    );
    let meant =
        campaign_of(&beside("temp", |k| if k == 5 { "-999.0".to_owned() } else { k.to_string() }));
    assert!(column(&meant, "temp").is_some());
    assert!(
        column(&campaign_of(&with_column("gap", &["-99", "-50", "20"])), "gap").is_some(),
        "others are below zero"
    );
    let missing = told("x", &["#DIV/0!", "3", "4", "#REF!"]);
    assert_eq!((missing.taken_as, missing.missing), (TakenAs::Numbers, 2));
}

#[test]
fn a_thousand_with_a_point_beside_hundreds_is_no_one_point_something() {
    let pressure = |k: usize| ["980", "1.013", "995", "1.005"][k % 4].to_owned();
    let rows = |text: &str| {
        table("powder;repose_deg;pressure_hpa", |k| {
            format!("salt;{}{text};{}", 30 + k % 7, pressure(k))
        })
    };
    assert_eq!(refused(&rows("")).len(), 7, "may be 1.013 or 1013");
    // Another column shows whether points or commas separate decimals.
    let first = |text: &str| match column(&campaign_of(&rows(text)), "pressure_hpa") {
        Some(Values::Numbers(of)) => of[1],
        other => panic!("{other:?}"),
    };
    assert_eq!(
        (
            first(".5"),
            column(&campaign_of(&with_column("gap", &["2", "1.125", "3"])), "gap").is_some()
        ),
        (Some(1.013), true)
    );
}

#[test]
fn a_column_that_stands_twice_or_counts_rows_is_no_condition() {
    for again in ["repose_deg.1", "repose_deg_2", "Repose deg 3", "flow_time_s.1", "powder.1"] {
        assert_eq!(refused(&beside(again, |_| "33".to_owned())), [again], "{again}");
    }
    let counted = told("Unnamed: 0", &["0", "1", "2", "3"]);
    assert_eq!(counted.taken_as, TakenAs::Nothing);
}

#[test]
fn tables_that_are_more_or_less_than_one_are_refused_where_they_begin_to_be() {
    let runs = beside("session", |k| k.to_string());
    for (text, fields) in [
        (format!("Angles of 2026,,\n{runs}"), &["powder", "repose_deg"] as &[&str]),
        (format!("# measured by Ada\n{runs}"), &["powder", "repose_deg"]),
        (runs.replacen('\n', "\n,deg,\n", 1), &["row[2].powder", "row[2].repose_deg"]),
        (format!("{runs}\n\n{runs}"), &["row[18].repose_deg"]),
        (format!("{runs}Measured by Ada,,\n"), &["row[16].repose_deg"]),
        (runs.replace("30.0", "'30.0'"), &["row[2].repose_deg"]),
        (runs.replace("30.0", "=\"30.0\""), &["row[2].repose_deg"]),
        (runs.replace("30.0", "30.0*"), &["row[2].repose_deg"]),
        (runs.replace("30.0", "30°12'"), &["row[2].repose_deg"]),
        (
            table("powder,repose_deg,,powder,repose_deg", |k| {
                format!("salt,3{}.1,,sugar,31.2", k % 7)
            }),
            &["powder", "repose_deg"],
        ),
    ] {
        assert_eq!(refused(&text), fields, "{text}");
    }
}

#[test]
fn a_humidity_of_0_or_100_among_laboratory_air_is_a_loggers_missing_value() {
    let tenth = |end: &'static str, usual: usize| {
        move |k: usize| if k % 10 == 3 { end.to_owned() } else { (usual + k).to_string() }
    };
    for (column, end, usual) in [
        ("relative_humidity_pct", "0", 38),
        ("relative_humidity_pct", "100", 38),
        ("room_humidity", "0.0", 38),
        ("temperature_c", "0", 15),
        ("temperature_c", "-40.0", 15),
        ("temperature_c", "85", 15),
        ("temp_sensor_2", "127", 15),
    ] {
        let refused = refused(&beside(column, tenth(end, usual)));
        assert_eq!(refused, [format!("row[5].{column}"), format!("row[15].{column}")], "{end}");
    }
    let fractions = |k: usize| if k == 4 { "0".to_owned() } else { format!("0.{}", 40 + k) };
    assert_eq!(
        refused(&beside("relative_humidity_pct", fractions)),
        ["row[6].relative_humidity_pct"]
    );
    // With its unit it is taken at face value, and near other values it was measured.
    for (column, end, usual) in [
        ("relative_humidity_pct", "0 %", 38),
        ("relative_humidity_pct", "0", 3),
        ("relative_humidity_pct", "100", 80),
        ("temperature_c", "0", 2),
        ("rest_min", "0", 38),
    ] {
        assert_eq!(
            campaign_of(&beside(column, tenth(end, usual))).runs.len(),
            14,
            "{column} {end}"
        );
    }
    // In half of the cells: somebody dried the air.
    assert_eq!(
        campaign_of(&beside("relative_humidity_pct", |k| (45 * (k % 2)).to_string())).runs.len(),
        14
    );
}

#[test]
fn a_year_typo_among_days_is_refused_by_row() {
    for typo in ["2062-02-07", "1926-02-07", "2206-02-07"] {
        let text = beside("session", |k| {
            if k == 5 { typo.to_owned() } else { format!("2026-02-{:02}", 1 + k) }
        });
        assert_eq!(refused(&text), ["row[7].session"], "{typo}");
    }
    let counted = |k: usize| if k == 5 { "56056".to_owned() } else { (46_056 + k).to_string() };
    assert_eq!(refused(&beside("session", counted)), ["row[7].session"]);
    // A campaign may last nine years.
    assert_eq!(
        campaign_of(&beside("session", |k| format!("20{}-02-03", 18 + k % 9))).sessions(),
        9
    );
}

#[test]
fn a_row_called_overall_or_all_powders_is_no_run() {
    let runs = beside("session", |k| k.to_string());
    let with = read_of(&format!("{runs}Overall,33.6,\nAll powders,33.6,\nAll,33.6,\n"));
    assert_eq!(
        (with.campaign, with.read.left_out[0].rows.as_slice()),
        (campaign_of(&runs), [16, 17, 18].as_slice())
    );
}
