//! What a file becomes, and what it is refused for.

use super::*;
use crate::stats::summary::{mean, sd};

const REQUIRED: [&str; 2] = ["powder", "repose_deg"];

fn campaign_of(text: &str) -> Campaign {
    read(text, &REQUIRED).unwrap_or_else(|error| panic!("{text}: {error}"))
}

fn refused(text: &str) -> Vec<String> {
    match read(text, &REQUIRED) {
        Err(Error::Invalid(errors)) => errors.into_iter().map(|error| error.field).collect(),
        other => panic!("{text}: {other:?}"),
    }
}

fn column<'a>(campaign: &'a Campaign, name: &str) -> Option<&'a Values> {
    campaign.covariates.iter().find(|covariate| covariate.name == name).map(|covariate| &covariate.values)
}

fn levels(names: &[&str], of: &[Option<usize>]) -> Values {
    Values::Levels { names: names.iter().map(|name| (*name).to_owned()).collect(), of: of.to_vec() }
}

/// A column `name` beside the angles of salt, a row for each cell.
fn with_column(name: &str, cells: &[&str]) -> String {
    let rows: String = cells.iter().map(|cell| format!("salt,36,{cell}\n")).collect();
    format!("powder,repose_deg,{name}\n{rows}")
}

#[test]
fn a_row_is_a_run_with_what_was_recorded_beside_it() {
    let text = "\u{feff}powder, repose_deg ,session,method,relative_humidity_pct,batch\n\
                salt,36.5,2,camera,40,7\n\nsugar,31,1,manual,,\nsalt,35,2,,60.5,12\n";
    let campaign = campaign_of(text);
    assert_eq!(campaign.powders, ["salt", "sugar"]);
    let run = |row, powder, session, angle| Run { row, powder, session, repose_deg: Some(angle) };
    assert_eq!(campaign.runs, [run(2, 0, 1, 36.5), run(4, 1, 0, 31.0), run(5, 0, 1, 35.0)]);
    assert_eq!(
        column(&campaign, "method").unwrap(),
        &levels(&["camera", "manual"], &[Some(0), Some(1), None]),
        "an empty cell is missing"
    );
    let humidity = Values::Numbers(vec![Some(40.0), None, Some(60.5)]);
    assert_eq!(column(&campaign, "relative_humidity_pct").unwrap(), &humidity);
    // A batch is a name, and names are sorted as text.
    assert_eq!(column(&campaign, "batch").unwrap(), &levels(&["12", "7"], &[Some(1), None, Some(0)]));
    let names: Vec<&str> = campaign.covariates.iter().map(|covariate| covariate.name.as_str()).collect();
    assert_eq!(names, ["method", "relative_humidity_pct", "batch"]);
}

#[test]
fn a_summary_is_as_many_runs_of_the_same_row_and_day() {
    let text = "powder,repose_deg,repose_sd_deg,n,temperature_c\nsalt,36,2.5,5,21\nsalt,30,,,22\nsalt,31,,1,23\nsalt,32,4,1.0,24\n";
    let campaign = campaign_of(text);
    let rows: Vec<(u32, usize)> = campaign.runs.iter().map(|run| (run.row, run.session)).collect();
    assert_eq!(rows, [(2, 0), (2, 0), (2, 0), (2, 0), (2, 0), (3, 1), (4, 2), (5, 3)]);
    let angles: Vec<f64> = campaign.runs.iter().filter_map(|run| run.repose_deg).collect();
    let (mean, sd) = (mean(&angles[..5]).unwrap(), sd(&angles[..5]).unwrap());
    assert!((mean - 36.0).abs() < 1e-12 && (sd - 2.5).abs() < 1e-12, "{mean} +- {sd}");
    assert_eq!(angles[5..], [30.0, 31.0, 32.0]);
    let temperature = [21.0, 21.0, 21.0, 21.0, 21.0, 22.0, 23.0, 24.0].map(Some).to_vec();
    assert_eq!(column(&campaign, "temperature_c").unwrap(), &Values::Numbers(temperature));
}

#[test]
fn sessions_are_numbered_in_order_of_time() {
    for (cells, sessions) in [
        (["10", "9", "1e1", "2"], [2, 1, 2, 0]),
        (["2026-02-01", "2026-01-31", "2026-02-01", "2025-12-31"], [2, 1, 2, 0]),
        (["01.02.2026", "31.01.2026", "01.02.2026", "31.12.2025"], [2, 1, 2, 0]),
        // Runs of a day belong together, whatever the hour.
        (["2026-02-01T09:30", "2026-01-31 08:00", "2026-02-01 14:00:00", "2025-12-31"], [2, 1, 2, 0]),
        (["Tuesday", "Monday", "Tuesday", "Friday"], [0, 1, 0, 2]),
        (["2026-02-01 b", "2026-02-01 a", "2026-02-01 b", "2026-01-31"], [0, 1, 0, 2]),
        (["12", "Monday", "12", "9"], [0, 1, 0, 2]),
        (["", "7", "", "3"], [2, 1, 3, 0]),
        (["", "", "", ""], [0, 1, 2, 3]),
    ] {
        assert_eq!(campaign_of(&with_column("session", &cells)).session_of(), sessions, "{cells:?}");
    }
    assert_eq!(campaign_of("powder,repose_deg\nsalt,36\nsalt,37\n").session_of(), [0, 1]);
}

#[test]
fn other_columns_are_numbers_or_names_and_those_that_say_nothing_are_left_out() {
    let read = |name: &str, cells: &[&str]| column(&campaign_of(&with_column(name, cells)), name).cloned();
    assert_eq!(
        read("pressure_hpa", &["1013", "", "-1e3"]),
        Some(Values::Numbers(vec![Some(1013.0), None, Some(-1e3)]))
    );
    assert_eq!(
        read("lab", &["b", "a", "", "b", "a"]),
        Some(levels(&["a", "b"], &[1, 0, 9, 1, 0].map(|k| (k < 9).then_some(k))))
    );
    assert_eq!(
        read("lab", &["1", "inf", "1", "inf"]),
        Some(levels(&["1", "inf"], &[Some(0), Some(1), Some(0), Some(1)]))
    );
    let methods = levels(&["camera", "manual"], &[Some(0), Some(1), Some(0)]);
    assert_eq!(read("method", &["automated", "manual", "camera"]), Some(methods), "an exported file");
    let switched = levels(&["no", "yes"], &[1, 0, 1, 0, 1, 0].map(Some));
    assert_eq!(read("ioniser_on", &["1", "0", "true", "FALSE", "Yes", "no"]), Some(switched));
    assert_eq!(read("plate", &["3", "1"]), Some(levels(&["1", "3"], &[Some(1), Some(0)])));
    assert_eq!(read("remark", &["a", "b", "c", "c"]), None, "hardly any name twice");
    assert_eq!(read("remark", &["a", "\"b\nb\"", "a", "a"]), None, "prose");
    assert_eq!(read("remark", &["", ""]), None);
    assert_eq!(read("flow_time_s", &["12", "13"]), None, "measured, not recorded");
    let batches: Vec<String> = (0..=LEVELS_MAX).map(|k| format!("b{k}")).collect();
    let batches: Vec<&str> = batches.iter().map(String::as_str).collect();
    let kept = read("batch", &batches);
    assert!(matches!(kept, Some(Values::Levels { names, .. }) if names.len() == LEVELS_MAX + 1), "the report says why");
    assert_eq!(read("lab", &batches.repeat(3)), None, "nothing acts through it");
}

#[test]
fn a_flow_time_is_measured_beside_the_angle_and_of_a_summary_counts_once() {
    let header = "powder,repose_deg,repose_sd_deg,n,flow_time_s\n";
    let campaign = campaign_of(&format!("{header}salt,36,1,3,7.5\nsalt,37,,,\nsalt,35,,,8\n"));
    assert_eq!(campaign.flow_time_s, [Some(7.5), None, None, None, Some(8.0)]);
    let none = campaign_of(&format!("{header}salt,36,1,3,\n"));
    assert!(none.flow_time_s.is_empty() && none.covariates.is_empty());
}

#[test]
fn an_angle_may_be_missing_where_it_is_to_be_predicted() {
    let campaign = read("powder,relative_humidity_pct\nsalt,40\nsugar,50\n", &["powder"]).unwrap();
    assert_eq!(campaign.runs.iter().map(|run| (run.row, run.repose_deg)).collect::<Vec<_>>(), [(2, None), (3, None)]);
}

#[test]
fn wrong_cells_are_refused_by_row_and_column() {
    let columns = |line: &str| format!("powder,repose_deg,repose_sd_deg,n\n{line}\n");
    for (text, fields) in [
        ("repose_deg\n36\n", &["powder"] as &[&str]),
        ("", &["powder", "repose_deg"]),
        ("powder;repose_deg\nsalt;36\n", &["powder", "repose_deg"]),
        ("powder,repose_deg,batch,batch\nsalt,36,a,a\n", &["batch"]),
        ("powder,repose_deg\n", &["row[2]"]),
        ("powder,repose_deg\nsalt,36,40\n", &["row[2]"]),
        ("powder,repose_deg\n,36\nSalt!,36\nsalt,\n", &["row[2].powder", "row[3].powder", "row[4].repose_deg"]),
        (
            "powder,repose_deg\nsalt,4.9\nsalt,85.1\nsalt,NaN\nsalt,\"36,5\"\nsalt,steep\n",
            &["row[2].repose_deg", "row[3].repose_deg", "row[4].repose_deg", "row[5].repose_deg", "row[6].repose_deg"],
        ),
        (&columns("salt,36,,5"), &["row[2].repose_sd_deg"]),
        (&columns("salt,36,2,"), &["row[2].repose_sd_deg"]),
        (&columns("salt,36,-2,5"), &["row[2].repose_sd_deg"]),
        (&columns("salt,36,2,0"), &["row[2].n"]),
        (&columns("salt,36,2,1001"), &["row[2].n"]),
        (&columns("salt,36,2,2.5"), &["row[2].n"]),
        (&with_column("", &["x"]), &["row[2]"]),
        (&with_column("method", &["balance"]), &["row[2].method"]),
        (&with_column("operator", &["\"A\nB\""]), &["row[2].operator"]),
        (&with_column("ioniser_on", &["perhaps"]), &["row[2].ioniser_on"]),
        (
            &with_column("relative_humidity_pct", &["40", "wet", "101", "-1"]),
            &["row[3].relative_humidity_pct", "row[4].relative_humidity_pct", "row[5].relative_humidity_pct"],
        ),
        (&with_column("temperature_c", &["-51"]), &["row[2].temperature_c"]),
        (&with_column("rest_min", &["-1"]), &["row[2].rest_min"]),
        (&with_column("container_age_d", &["old"]), &["row[2].container_age_d"]),
        (&with_column("funnel_height_mm", &["0"]), &["row[2].funnel_height_mm"]),
        (&with_column("base_diameter_mm", &["0"]), &["row[2].base_diameter_mm"]),
        (&with_column("poured_mass_g", &["0"]), &["row[2].poured_mass_g"]),
        (&with_column("flow_time_s", &["0", "fast"]), &["row[2].flow_time_s", "row[3].flow_time_s"]),
        (&with_column("vibration_rms_m_s2", &["-0.1"]), &["row[2].vibration_rms_m_s2"]),
        (&with_column("order_in_session", &["first"]), &["row[2].order_in_session"]),
    ] {
        assert_eq!(refused(text), fields, "{text}");
    }
}

#[test]
fn a_file_has_bounds() {
    let wrong = format!("powder,repose_deg\n{}", "salt,x\n".repeat(1000));
    assert_eq!(refused(&wrong).len(), REFUSALS_MAX);
    let long = format!("powder,repose_deg\n{}", "salt,36\n".repeat(RUNS_MAX + 1));
    assert_eq!(refused(&long), [format!("row[{}]", RUNS_MAX + 2)]);
    let longer = format!("powder,repose_deg\n{}", "salt,36\n".repeat(20_001));
    assert_eq!(refused(&longer), ["row[20002]"]);
    assert_eq!(refused("powder,repose_deg,repose_sd_deg,n\nsalt,36,1,1000\nsalt,36,1,1000\nsalt,36,1,2\n"), ["row[4]"]);
    let wide: String = (0..COLUMNS_MAX).map(|k| format!(",c{k}")).collect();
    assert_eq!(refused(&format!("powder,repose_deg{wide}\n")), ["header"]);
}
