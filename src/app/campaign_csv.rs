//! A campaign as CSV: one angle of repose a row, and beside it whatever was recorded with it.
//!
//! | columns | what becomes of them |
//! |---------|----------------------|
//! | `powder`, `repose_deg` | the run; with `repose_sd_deg` and `n` the row stands for n runs |
//! | `session` | the day, numbered in order of time: numbers and dates sorted, other text as it appears; a row without has a day of its own |
//! | the known numbers and names below | covariates, within bounds |
//! | `flow_time_s` | a measurement beside the angle, judged by itself; of a summary the mean of its runs, which counts once |
//! | any other | a covariate: of numbers if every filled cell is one, else of names |
//!
//! An empty cell is a missing value, never zero. A column of names that hardly repeat says nothing and is left out.

use super::check::Check;
use super::csv_file::{Cells, CsvFile, REFUSALS_MAX, Refused, at, number, within, yes_or_no};
use super::{Error, Result};
use crate::discover::{Campaign, Covariate, LEVELS_MAX, Run, Values, repeats_of};
use crate::domain::FieldError;
use crate::domain::powder::{Flowability, powder_id};
use std::collections::HashMap;
use time::Date;
use time::macros::format_description;

/// Most runs, the repeats behind summaries counted: an investigation holds some thirty matrices of runs times runs.
const RUNS_MAX: usize = 2000;
/// Most repeats behind a summary.
pub(super) const REPEATS_MAX: u32 = 1000;
/// Most columns; each one that FLIP does not know is one more cause to judge.
const COLUMNS_MAX: usize = 60;
/// Longest name that is one; what is longer is prose.
const NAME_CHARS_MAX: usize = 100;
/// Largest number in a column without bounds of its own: its square must be one too.
const NUMBER_MAX: f64 = 1e15;

/// Columns of the run itself.
const OWN: [&str; 6] = ["powder", "repose_deg", "repose_sd_deg", "n", "session", "flow_time_s"];
/// Columns of names, also where the names look like numbers.
const NAMES: [&str; 5] = ["method", "operator", "batch", "plate", "ioniser_on"];
/// Columns of numbers: lowest, highest, unit.
const NUMBERS: [(&str, f64, f64, &str); 10] = [
    ("order_in_session", 0.0, 1e6, ""),
    ("relative_humidity_pct", 0.0, 100.0, "%"),
    ("temperature_c", -50.0, 100.0, "deg C"),
    ("rest_min", 0.0, 1e7, "min"),
    ("container_age_d", 0.0, 1e5, "days"),
    ("funnel_height_mm", 0.1, 1e4, "mm"),
    ("base_diameter_mm", 0.1, 1e4, "mm"),
    ("poured_mass_g", 1e-3, 1e6, "g"),
    ("flow_time_s", 1e-3, 1e6, "s"),
    ("vibration_rms_m_s2", 0.0, 1e3, "m/s2"),
];

/// What a row says.
struct Line {
    row: usize,
    powder: String,
    session: String,
    /// Mean, SD and number of the runs behind it; none where the angle is to be predicted.
    angle: Option<Flowability>,
    /// Cells of the covariates' columns, in their order; empty where nothing was recorded.
    cells: Vec<String>,
    flow_time_s: Option<f64>,
}

/// The campaign that a file describes. Every one of the `required` columns is in its header and filled in each row.
///
/// # Errors
/// Every wrong cell by row and column, up to 50; a missing or repeated column by name.
pub(super) fn read(text: &str, required: &[&str]) -> Result<Campaign> {
    let file = CsvFile::open(text, |names, check| check_header(names, required, check))?;
    let covariates = file.columns.iter().filter(|name| !OWN.contains(&name.as_str()) && !name.is_empty());
    let covariates: Vec<String> = covariates.cloned().collect();
    let mut lines = Vec::new();
    let mut refusals = file.rows(|cells| {
        lines.push(line(cells, &covariates, required)?);
        Ok(())
    })?;
    refusals.truncate(REFUSALS_MAX);
    if !refusals.is_empty() {
        return Err(Error::Invalid(refusals));
    }
    let mut runs = 0;
    for line in &lines {
        runs += line.runs();
        if runs > RUNS_MAX {
            let advice = format!(
                "brings the runs, those behind summaries counted, above {RUNS_MAX}, the most that are looked at together: leave rows out"
            );
            return Err(FieldError::new(format!("row[{}]", line.row), advice).into());
        }
    }
    Ok(campaign(&lines, covariates))
}

fn check_header(names: &[String], required: &[&str], check: &mut Check) {
    for column in required.iter().filter(|column| !names.iter().any(|name| name == *column)) {
        check.refuse(column, "is missing in the header");
    }
    if names.len() > COLUMNS_MAX {
        check.refuse("header", format!("has {} columns, and at most {COLUMNS_MAX} are read", names.len()));
    }
    if !names.iter().all(|name| is_name(&name.as_str())) {
        check.refuse(
            "header",
            format!("holds a name of more than {NAME_CHARS_MAX} characters, or of more than one line"),
        );
    }
}

/// A row, if it is right.
fn line(cells: &Cells<'_>, covariates: &[String], required: &[&str]) -> Refused<Line> {
    let row = cells.row;
    let mut check = Check::default();
    for column in required.iter().filter(|column| !cells.holds(column)) {
        check.keep::<()>(Err(at(row, column, "is missing")));
    }
    if cells.holds("") {
        check.refuse(&format!("row[{row}]"), format!("holds `{}` in a column without a name", cells.text("")));
    }
    let powder = cells.holds("powder").then(|| powder_id(&format!("row[{row}].powder"), cells.text("powder")));
    let powder = powder.and_then(|id| check.keep(id));
    let angle = check.keep(angle(cells)).flatten();
    for (column, lower, upper, unit) in NUMBERS.into_iter().filter(|(column, ..)| cells.holds(column)) {
        check.keep(within(cells, column, lower, upper, unit));
    }
    for column in NAMES.into_iter().chain(["session"]).filter(|column| cells.holds(column)) {
        check.text(&format!("row[{row}].{column}"), cells.text(column), NAME_CHARS_MAX);
    }
    if !["", "camera", "automated", "manual"].contains(&cells.text("method")) {
        check.keep::<()>(Err(at(row, "method", format!("must be camera or manual, got `{}`", cells.text("method")))));
    }
    if cells.holds("ioniser_on") && yes_or_no(cells.text("ioniser_on")).is_none() {
        let advice = format!("must be one of 1, 0, true, false, yes and no, got `{}`", cells.text("ioniser_on"));
        check.keep::<()>(Err(at(row, "ioniser_on", advice)));
    }
    check.refusals()?;
    let cell = |column: &String| match column.as_str() {
        "ioniser_on" => yes_or_no(cells.text(column)).unwrap_or_default().to_owned(),
        // As `flip measurements export` writes it.
        "method" if cells.text(column) == "automated" => "camera".to_owned(),
        _ => cells.text(column).to_owned(),
    };
    Ok(Line {
        row,
        powder: powder.unwrap_or_default(),
        session: cells.text("session").to_owned(),
        angle,
        cells: covariates.iter().map(cell).collect(),
        flow_time_s: number(cells.text("flow_time_s")),
    })
}

/// One angle, or the summary of several.
fn angle(cells: &Cells<'_>) -> std::result::Result<Option<Flowability>, FieldError> {
    if !cells.holds("repose_deg") {
        return Ok(None);
    }
    let repose_deg = within(cells, "repose_deg", 5.0, 85.0, "deg")?;
    let sd_deg = cells.holds("repose_sd_deg").then(|| within(cells, "repose_sd_deg", 0.0, 45.0, "deg")).transpose()?;
    let refused = |column, advice: &str| Err(at(cells.row, column, advice));
    match (cells.repeats("n")?, sd_deg) {
        (None, None) | (Some(1), _) => Ok(Some(Flowability { repose_deg, sd_deg: 0.0, n: 1 })),
        (Some(n @ 2..=REPEATS_MAX), Some(sd_deg)) => Ok(Some(Flowability { repose_deg, sd_deg, n })),
        (Some(2..=REPEATS_MAX), None) => {
            refused("repose_sd_deg", "is missing: a summary needs the SD over its repeats")
        }
        (Some(_), _) => refused("n", &format!("must be from 1 to {REPEATS_MAX} repeats")),
        (None, Some(_)) => {
            refused("repose_sd_deg", "belongs to a summary: fill `n` too, or leave it empty for a single run")
        }
    }
}

impl Line {
    /// Runs behind it; a row to be predicted is one.
    fn runs(&self) -> usize {
        self.angle.map_or(1, |angle| angle.n as usize)
    }
}

fn campaign(lines: &[Line], columns: Vec<String>) -> Campaign {
    let mut powders: Vec<String> = Vec::new();
    let mut runs = Vec::new();
    for (line, session) in lines.iter().zip(sessions(lines)) {
        let known = powders.iter().position(|powder| *powder == line.powder);
        let powder = known.unwrap_or(powders.len());
        if known.is_none() {
            powders.push(line.powder.clone());
        }
        let run = |repose_deg| Run { row: line.row as u32, powder, session, repose_deg };
        match line.angle {
            Some(angle) => {
                runs.extend(repeats_of(angle.repose_deg, angle.sd_deg, angle.n).into_iter().map(|deg| run(Some(deg))));
            }
            None => runs.push(run(None)),
        }
    }
    let covariate = |(k, name): (usize, String)| {
        let cells: Vec<&str> = lines.iter().map(|line| line.cells[k].as_str()).collect();
        values(&name, &cells, lines).map(|values| Covariate { name, values })
    };
    let times = lines.iter().flat_map(|line| (0..line.runs()).map(|k| line.flow_time_s.filter(|_| k == 0)));
    let flow_time_s: Vec<Option<f64>> = times.collect();
    Campaign {
        powders,
        runs,
        covariates: columns.into_iter().enumerate().filter_map(covariate).collect(),
        flow_time_s: if flow_time_s.iter().any(Option::is_some) { flow_time_s } else { Vec::new() },
        ..Campaign::default()
    }
}

/// A column, one value for each run; none if it says nothing.
fn values(name: &str, cells: &[&str], lines: &[Line]) -> Option<Values> {
    let filled: Vec<&str> = cells.iter().copied().filter(|cell| !cell.is_empty()).collect();
    let numbers = || cells.iter().map(|cell| number(cell).filter(|number| number.abs() <= NUMBER_MAX)).collect();
    let numbers: Vec<Option<f64>> = if NAMES.contains(&name) { Vec::new() } else { numbers() };
    if numbers.iter().flatten().count() == filled.len() {
        return (!filled.is_empty()).then(|| Values::Numbers(of_runs(&numbers, lines)));
    }
    let mut names = filled.clone();
    names.sort_unstable();
    names.dedup();
    // A column that a cause needs is kept, so that the report can say why the cause cannot be told.
    let says_nothing = 2 * names.len() > filled.len() || names.len() > LEVELS_MAX;
    if (says_nothing && !NAMES.contains(&name)) || !names.iter().all(is_name) {
        return None;
    }
    let of: Vec<Option<usize>> = cells.iter().map(|cell| names.binary_search(cell).ok()).collect();
    Some(Values::Levels { names: names.into_iter().map(str::to_owned).collect(), of: of_runs(&of, lines) })
}

fn is_name(name: &&str) -> bool {
    name.chars().count() <= NAME_CHARS_MAX && !name.chars().any(char::is_control)
}

/// What is said of a row holds for every run behind it.
fn of_runs<T: Copy>(of_lines: &[T], lines: &[Line]) -> Vec<T> {
    of_lines.iter().zip(lines).flat_map(|(value, line)| std::iter::repeat_n(*value, line.runs())).collect()
}

/// Session of each row, numbered in order of time.
fn sessions(lines: &[Line]) -> Vec<usize> {
    let named: Vec<&str> = lines.iter().map(|line| line.session.as_str()).filter(|name| !name.is_empty()).collect();
    let times = |time: fn(&str) -> Option<f64>| named.iter().map(|name| time(name)).collect::<Option<Vec<f64>>>();
    let places: Vec<usize> = match times(number).or_else(|| times(day)) {
        Some(times) => {
            let mut order = times.clone();
            order.sort_unstable_by(f64::total_cmp);
            order.dedup();
            times.iter().map(|time| order.partition_point(|other| other < time)).collect()
        }
        None => {
            let mut known: HashMap<&str, usize> = HashMap::new();
            let mut place = |name| {
                let next = known.len();
                *known.entry(name).or_insert(next)
            };
            named.iter().map(|name| place(*name)).collect()
        }
    };
    // Rows without one come last, each by itself.
    let unnamed = places.iter().max().map_or(0, |last| last + 1)..;
    let (mut places, mut unnamed) = (places.into_iter(), unnamed);
    let session = |line: &Line| if line.session.is_empty() { unnamed.next() } else { places.next() };
    lines.iter().filter_map(session).collect()
}

/// Days since the year 0 of a date, which a time of day may follow.
fn day(text: &str) -> Option<f64> {
    let (date, rest) = text.split_at_checked(10).unwrap_or((text, ""));
    let is_time = |rest: &str| rest.starts_with(['T', ' ']) && rest[1..].starts_with(|c: char| c.is_ascii_digit());
    if !rest.is_empty() && !is_time(rest) {
        return None;
    }
    let iso = Date::parse(date, format_description!("[year]-[month]-[day]"));
    let dotted = || Date::parse(date, format_description!("[day].[month].[year]"));
    iso.or_else(|_| dotted()).ok().map(|date| f64::from(date.to_julian_day()))
}

#[cfg(test)]
mod tests;
