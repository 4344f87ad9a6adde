//! How files are interpreted, and why they are refused.

use super::*;
use flip_core::stats::summary::{mean, sd};
use flip_discover::{LEVELS_MAX, Values};

mod forms;
mod odd;

const REQUIRED: [&str; 2] = ["powder", "repose_deg"];

fn read_of(text: &str) -> CampaignRead {
    read(text, &REQUIRED, None).unwrap_or_else(|error| panic!("{text}: {error}"))
}

fn campaign_of(text: &str) -> Campaign {
    read_of(text).campaign
}

/// How this column of a file was interpreted.
fn told(name: &str, cells: &[&str]) -> ColumnRead {
    let columns = read_of(&with_column(name, cells)).read.columns;
    columns.into_iter().find(|it| it.column == name).unwrap()
}

fn refused(text: &str) -> Vec<String> {
    match read(text, &REQUIRED, None) {
        Err(Error::Invalid(errors)) => errors.into_iter().map(|error| error.field).collect(),
        other => panic!("{text}: {other:?}"),
    }
}

fn column<'a>(campaign: &'a Campaign, name: &str) -> Option<&'a Values> {
    campaign
        .covariates
        .iter()
        .find(|covariate| covariate.name == name)
        .map(|covariate| &covariate.values)
}

fn levels(names: &[&str], of: &[Option<usize>]) -> Values {
    Values::Levels { names: names.iter().map(|name| (*name).to_owned()).collect(), of: of.to_vec() }
}

/// A column `name` next to the angles of salt, one row per cell.
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
    let run = |row, powder, session, angle| Run { row, powder, session, value: Some(angle) };
    assert_eq!(campaign.runs, [run(2, 0, 1, 36.5), run(4, 1, 0, 31.0), run(5, 0, 1, 35.0)]);
    assert_eq!(
        column(&campaign, "method").unwrap(),
        &levels(&["camera", "manual"], &[Some(0), Some(1), None]),
        "an empty cell is missing"
    );
    let humidity = Values::Numbers(vec![Some(40.0), None, Some(60.5)]);
    assert_eq!(column(&campaign, "relative_humidity_pct").unwrap(), &humidity);
    // A batch is a name, and names are sorted as text.
    assert_eq!(
        column(&campaign, "batch").unwrap(),
        &levels(&["12", "7"], &[Some(1), None, Some(0)])
    );
    let names: Vec<&str> =
        campaign.covariates.iter().map(|covariate| covariate.name.as_str()).collect();
    assert_eq!(names, ["method", "relative_humidity_pct", "batch"]);
}

#[test]
fn a_summary_is_as_many_runs_of_the_same_row_and_day() {
    let text = "powder,repose_deg,repose_sd_deg,n,temperature_c\nsalt,36,2.5,5,21\nsalt,30,,,22\nsalt,31,,1,23\nsalt,32,4,1.0,24\n";
    let campaign = campaign_of(text);
    let rows: Vec<(u32, usize)> = campaign.runs.iter().map(|run| (run.row, run.session)).collect();
    assert_eq!(rows, [(2, 0), (2, 0), (2, 0), (2, 0), (2, 0), (3, 1), (4, 2), (5, 3)]);
    let angles: Vec<f64> = campaign.runs.iter().filter_map(|run| run.value).collect();
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
        // Runs of one day belong together, whatever the hour.
        (
            ["2026-02-01T09:30", "2026-01-31 08:00", "2026-02-01 14:00:00", "2025-12-31"],
            [2, 1, 2, 0],
        ),
        (["Tuesday", "Monday", "Tuesday", "Friday"], [0, 1, 0, 2]),
        (["2026-02-01 b", "2026-02-01 a", "2026-02-01 b", "2026-01-31"], [0, 1, 0, 2]),
        (["", "7", "", "3"], [2, 1, 3, 0]),
        (["", "", "", ""], [0, 1, 2, 3]),
    ] {
        assert_eq!(
            campaign_of(&with_column("session", &cells)).session_of(),
            sessions,
            "{cells:?}"
        );
    }
    assert_eq!(campaign_of("powder,repose_deg\nsalt,36\nsalt,37\n").session_of(), [0, 1]);
}

#[test]
fn other_columns_are_numbers_or_names_and_those_that_say_nothing_are_left_out() {
    let read =
        |name: &str, cells: &[&str]| column(&campaign_of(&with_column(name, cells)), name).cloned();
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
    assert_eq!(
        read("method", &["automated", "manual", "camera"]),
        Some(methods),
        "an exported file"
    );
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
    assert!(
        matches!(kept, Some(Values::Levels { names, .. }) if names.len() == LEVELS_MAX + 1),
        "the report says why"
    );
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
    let campaign = read("powder,relative_humidity_pct\nsalt,40\nsugar,50\n", &["powder"], None)
        .unwrap()
        .campaign;
    assert_eq!(
        campaign.runs.iter().map(|run| (run.row, run.value)).collect::<Vec<_>>(),
        [(2, None), (3, None)]
    );
}

#[test]
fn wrong_cells_are_refused_by_row_and_column() {
    let columns = |line: &str| format!("powder,repose_deg,repose_sd_deg,n\n{line}\n");
    for (text, fields) in [
        ("repose_deg\n36\n", &["powder"] as &[&str]),
        ("", &["powder", "repose_deg"]),
        ("powder,repose_deg,batch,batch\nsalt,36,a,a\n", &["batch"]),
        ("powder,repose_deg\n", &["row[2]"]),
        ("powder,repose_deg\nsalt,36,40\n", &["row[2]"]),
        (
            "powder,repose_deg\n,36\n?!,36\nsalt,\n",
            &["row[2].powder", "row[3].powder", "row[4].repose_deg"],
        ),
        ("powder,repose_deg\nLactose 200M,36\nLactose-200M,36\n", &["row[3].powder"]),
        (
            "powder,repose_deg\nsalt,4.9\nsalt,85.1\nsalt,NaN\nsalt,<36\nsalt,steep\n",
            &[
                "row[2].repose_deg",
                "row[3].repose_deg",
                "row[4].repose_deg",
                "row[5].repose_deg",
                "row[6].repose_deg",
            ],
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
            &[
                "row[3].relative_humidity_pct",
                "row[4].relative_humidity_pct",
                "row[5].relative_humidity_pct",
            ],
        ),
        (&with_column("temperature_c", &["-51"]), &["row[2].temperature_c"]),
        (&with_column("rest_min", &["-1"]), &["row[2].rest_min"]),
        (&with_column("container_age_d", &["old"]), &["row[2].container_age_d"]),
        (&with_column("funnel_height_mm", &["0"]), &["row[2].funnel_height_mm"]),
        (&with_column("base_diameter_mm", &["0"]), &["row[2].base_diameter_mm"]),
        (&with_column("poured_mass_g", &["0"]), &["row[2].poured_mass_g"]),
        (
            &with_column("flow_time_s", &["0", "fast"]),
            &["row[2].flow_time_s", "row[3].flow_time_s"],
        ),
        (&with_column("vibration_rms_m_s2", &["-0.1"]), &["row[2].vibration_rms_m_s2"]),
        (&with_column("order_in_session", &["first"]), &["row[2].order_in_session"]),
        (&with_column("relative_humidity_pct", &["41", "0.41"]), &["row[3].relative_humidity_pct"]),
        (&with_column("flow_time_s", &["<5"]), &["row[2].flow_time_s"]),
        (&with_column("temperature_c", &["75 °F"]), &["row[2].temperature_c"]),
        (&with_column("gas", &["41", "42", "wet"]), &["row[4].gas"]),
        (&with_column("gas", &["41", "42", "43", "~43", "40-50"]), &["row[5].gas", "row[6].gas"]),
        (&with_column("gap", &["5 mm", "0.6 cm"]), &["row[3].gap"]),
        (&with_column("mass", &["\"1,125\"", "2.5"]), &["row[2].mass"]),
        (&with_column("session", &["12", "Monday", "12", "9"]), &["row[3].session"]),
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
    assert_eq!(
        refused("powder,repose_deg,repose_sd_deg,n\nsalt,36,1,1000\nsalt,36,1,1000\nsalt,36,1,2\n"),
        ["row[4]"]
    );
    let wide: String = (0..COLUMNS_MAX).map(|k| format!(",c{k}")).collect();
    assert_eq!(refused(&format!("powder,repose_deg{wide}\n")), ["header"]);
}

/// Month and day of eight rows.
const DAYS: [(u8, u8); 8] = [(3, 11), (2, 15), (2, 7), (3, 11), (12, 1), (2, 15), (1, 30), (2, 7)];

fn days(written: impl Fn(u8, u8) -> String) -> String {
    with_column(
        "session",
        &DAYS
            .map(|(month, day)| written(month, day))
            .iter()
            .map(String::as_str)
            .collect::<Vec<_>>(),
    )
}

#[test]
fn days_written_another_way_are_the_same_sessions_in_the_same_order() {
    let iso = read_of(&days(|month, day| format!("2026-{month:02}-{day:02}")));
    assert_eq!(iso.campaign.session_of(), [3, 2, 1, 3, 4, 2, 0, 1]);
    let of = |month: u8, day: u8| {
        time::Date::from_calendar_date(2026, time::Month::try_from(month).unwrap(), day).unwrap()
    };
    let name = |month: u8| of(month, 1).month().to_string();
    let since_1970 = |month, day| i64::from(of(month, day).to_julian_day() - 2_440_588);
    let forms: [&dyn Fn(u8, u8) -> String; 12] = [
        &|month, day| format!("{day}.{month}.2026"),
        &|month, day| format!("{day:02}.{month:02}.26"),
        &|month, day| format!("{month}/{day}/2026"),
        &|month, day| format!("{day}/{month}/2026"),
        &|month, day| format!("{day:02}-{}-26", &name(month)[..3]),
        &|month, day| format!("\"{} {day}, 2026\"", name(month)),
        &|month, day| format!("{day} {} 2026 09:3{}", name(month), day % 10),
        &|month, day| format!("2026-{month:02}-{day:02}T1{}:30:00+02:00", day % 10),
        &|month, day| (since_1970(month, day) + 25_569).to_string(),
        &|month, day| format!("{}.5", since_1970(month, day) + 25_569),
        &|month, day| (since_1970(month, day) * 86_400 + i64::from(day) * 3_600 / 2).to_string(),
        &|month, day| format!("2026{month:02}{day:02}"),
    ];
    for form in forms {
        assert_eq!(read_of(&days(form)), iso, "{}", form(3, 11));
    }
    assert_eq!(iso.read.columns[2].note, "5 days, 2026-01-30 to 2026-12-01");
}

#[test]
fn one_typo_among_days_does_not_make_names_of_them() {
    for typo in [
        "2026-02-30",
        "2026-13-02",
        "2026-03-1l",
        "Monday",
        "46056",
        "26-03-11",
        "3 Mar",
        "2026-03-11 25:00",
    ] {
        let cells = ["2026-03-11", "2026-02-15", typo, "2026-02-07"];
        assert_eq!(refused(&with_column("session", &cells)), ["row[4].session"], "{typo}");
    }
    assert_eq!(
        refused(&with_column("session", &["15/2/2026", "2/15/2026", "3/3/2026"])),
        ["row[3].session"]
    );
    let named = told("session", &["Tuesday", "Monday", "Tuesday", ""]);
    assert!(
        named.note.starts_with("2 names, in the order in which they first stand"),
        "{}",
        named.note
    );
    assert_eq!((named.taken_as, named.filled, named.missing), (TakenAs::Session, 3, 1));
}

#[test]
fn a_day_that_may_be_two_is_asked_for() {
    let text = with_column("session", &["2/3/2026", "4/3/2026", "2/3/2026"]);
    let asked = read(&text, &REQUIRED, None).unwrap_err().to_string();
    assert!(asked.contains("row[2].session") && asked.contains("--dates day-first"), "{asked}");
    let sessions = |order| read(&text, &REQUIRED, Some(order)).unwrap();
    let (day_first, month_first) = (sessions(DateOrder::DayFirst), sessions(DateOrder::MonthFirst));
    assert_eq!(day_first.read.columns[2].note, "2 days, 2026-03-02 to 2026-03-04");
    assert_eq!(month_first.read.columns[2].note, "2 days, 2026-02-03 to 2026-04-03");
    let wrong = read(
        &with_column("session", &["15/2/2026", "3/2/2026"]),
        &REQUIRED,
        Some(DateOrder::MonthFirst),
    );
    assert!(wrong.unwrap_err().to_string().contains("row[2].session"));
    // The same whichever comes first.
    assert_eq!(told("session", &["2/2/2026", "3/3/2026"]).note, "2 days, 2026-02-02 to 2026-03-03");
}

#[test]
fn one_cell_without_a_number_does_not_make_names_of_a_column() {
    let numbers = |cells: &[&str]| match column(&campaign_of(&with_column("gas", cells)), "gas") {
        Some(Values::Numbers(values)) => values.clone(),
        other => panic!("{cells:?}: {other:?}"),
    };
    for missing in ["NA", "N/A", "nan", "-", "n.d.", "#N/A", "", "none", "<5", "> 95"] {
        assert_eq!(numbers(&["47", missing, "46.5"]), [Some(47.0), None, Some(46.5)], "{missing}");
    }
    for number in ["47.1", "\"47,1\"", "47.1 %", "\"47,1 %\"", "4.71e1"] {
        assert_eq!(
            numbers(&["47", number, "46.5"]),
            [Some(47.0), Some(47.1), Some(46.5)],
            "{number}"
        );
    }
    let limits = told("gas", &["47", "<5", "", "46"]);
    assert_eq!((limits.taken_as, limits.filled, limits.missing), (TakenAs::Numbers, 2, 2));
    assert!(
        limits.note.contains("limits such as <5 and count as missing: rows 3"),
        "{}",
        limits.note
    );
}

#[test]
fn what_is_left_out_is_told_with_its_reason() {
    let left_out = |name: &str, cells: &[&str]| {
        let told = told(name, cells);
        if told.taken_as == TakenAs::Nothing { told.note } else { Default::default() }
    };
    assert_eq!(left_out("remark", &["a", "b", "c", "c"]), "hardly a name stands twice");
    assert_eq!(left_out("remark", &["", ""]), "no cell of it is filled");
    assert_eq!(left_out("gas", &["<5", "<5"]), "it holds limits and no number");
    assert_eq!(left_out("lab", &["a", "a", "b", "b"]), "");
    assert_eq!(
        told("lab", &["a", "a", "1", "1"]).note,
        "2 of its cells are numbers and count as names"
    );
    let fractions = told("relative_humidity_pct", &["0.41", "0.5", "NA"]);
    assert!(
        fractions.note.starts_with("written as fractions, taken as per cent"),
        "{}",
        fractions.note
    );
    let campaign = campaign_of(&with_column("relative_humidity_pct", &["0.25", "0.5"]));
    assert_eq!(
        column(&campaign, "relative_humidity_pct"),
        Some(&Values::Numbers(vec![Some(25.0), Some(50.0)]))
    );
    let named = read_of("powder,repose_deg\nLactose 200M,36\n3-Nitrotoluene,37\nlactose_200m,35\n");
    assert_eq!(named.campaign.powders, ["lactose_200m", "p_3_nitrotoluene"]);
    let ids: Vec<(&str, &str)> =
        named.read.powders.iter().map(|it| (it.name.as_str(), it.id.as_str())).collect();
    assert_eq!(ids, [("Lactose 200M", "lactose_200m"), ("3-Nitrotoluene", "p_3_nitrotoluene")]);
}

/// 48 runs on four days, rounded to `decimals`; if `place`, each with its place in its day.
fn runs(decimals: usize, place: bool) -> Vec<String> {
    let angle = |k: u32| 36.0 + f64::from((k * 7919 + k * k * 31) % 1009) / 250.0 - 2.0;
    let line = |k: u32| {
        let place = if place { (k / 4).to_string() } else { String::new() };
        format!("{},{:.decimals$},{},{place}", ["salt", "sugar"][(k % 2) as usize], angle(k), k % 4)
    };
    (0..48).map(line).collect()
}

fn file(lines: &[String]) -> String {
    format!("powder,repose_deg,session,order_in_session\n{}\n", lines.join("\n"))
}

#[test]
fn a_row_that_stands_twice_counts_once_and_is_named() {
    for decimals in [0, 2] {
        let lines = runs(decimals, true);
        let once = read_of(&file(&lines));
        let twice = read_of(&file(&[&lines[..], &lines[3..9]].concat()));
        assert_eq!(twice.campaign, once.campaign, "{decimals} decimals");
        assert_eq!(twice.read.left_out[0].rows, [50, 51, 52, 53, 54, 55]);
        assert_eq!((twice.read.rows, once.read.left_out.len()), (54, 0));
    }
    // Nothing identifies the runs, but ten pairs equal to a hundredth of a degree are too many.
    let lines = runs(2, false);
    let copied = read_of(&file(&[&lines[..], &lines[3..13]].concat()));
    assert!(
        (50..60).all(|row| copied.read.left_out[0].rows.contains(&row)),
        "{:?}",
        copied.read.left_out
    );
    // The whole file twice, in whole degrees.
    let whole = runs(0, false);
    let twice = read_of(&file(&[&whole[..], &whole].concat()));
    assert_eq!(twice.campaign, read_of(&file(&whole)).campaign);
    assert_eq!(twice.read.left_out[0].rows, (50..98).collect::<Vec<u32>>());
    let predicted = "powder,rest_min\nsalt,5\nsalt,5\n";
    assert_eq!(
        super::read(predicted, &["powder"], None).unwrap().campaign.runs.len(),
        2,
        "a question twice"
    );
}

#[test]
fn angles_that_are_equal_because_they_are_coarse_all_count() {
    let coarse = read_of(&file(&runs(0, false)));
    assert_eq!((coarse.campaign.runs.len(), coarse.read.left_out.len()), (48, 0));
    assert!(
        coarse.read.notes[0].contains("rows are like an earlier row in every cell"),
        "{:?}",
        coarse.read.notes
    );
    // One pair out of 48 runs equal to a tenth of a degree is within chance.
    let tenths = [&runs(1, false)[..], &runs(1, false)[5..6]].concat();
    assert_eq!(read_of(&file(&tenths)).campaign.runs.len(), 49);
}
