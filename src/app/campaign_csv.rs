//! A campaign as CSV: one angle of repose per row, with everything that was recorded alongside it.
//!
//! | columns | what becomes of them |
//! |---------|----------------------|
//! | `powder`, `repose_deg` | the run; with `repose_sd_deg` and `n` the row stands for n runs |
//! | `session` | the day, numbered in order of time (`sessions`); a row without has a day of its own |
//! | the known numbers and names below | covariates, within bounds |
//! | `flow_time_s` | a measurement beside the angle, judged by itself; of a summary the mean of its runs, which counts once |
//! | any other | a covariate, of numbers or of names (`column`) |
//!
//! An empty cell is a missing value, never zero. How every column was interpreted, and what was
//! left out, is returned with the campaign.

mod column;
mod sessions;
mod summaries;
mod twice;

use super::check::Check;
use super::csv_file::date::{DateOrder, day};
use super::csv_file::words::{self, yes_or_no};
use super::csv_file::{Cells, Columns, Holds, REFUSALS_MAX, Refused, Table, Told, at, within};
use super::powder_names::PowderNames;
use super::{Error, Result, humidity};
use column::Column;
use flip_core::domain::FieldError;
use flip_core::domain::powder::{Flowability, Method};
use flip_discover::reading::{ColumnRead, FileRead, TakenAs};
use flip_discover::{Campaign, Covariate, Run, repeats_of};
use sessions::{Sessions, sessions};
use summaries::Summaries;

/// Maximum number of runs, including the repeats behind summaries: an investigation holds about
/// thirty runs-by-runs matrices.
const RUNS_MAX: usize = 2000;
/// Maximum number of repeats behind a summary.
pub(super) const REPEATS_MAX: u32 = 1000;
/// Maximum number of columns; each unknown column is one more cause to judge.
const COLUMNS_MAX: usize = 60;
/// Longest text that counts as a name; longer text is prose.
const NAME_CHARS_MAX: usize = 100;

/// Columns of the run itself.
const OWN: [&str; 6] = ["powder", "repose_deg", "repose_sd_deg", "n", "session", "flow_time_s"];
/// Columns of names, even if the names look like numbers.
const NAMES: [&str; 5] = ["method", "operator", "batch", "plate", "ioniser_on"];
/// Columns of numbers: lowest, highest, unit.
const NUMBERS: [(&str, f64, f64, &str); 10] = [
    (ORDER, 0.0, 1e6, ""),
    (humidity::COLUMN, 0.0, 100.0, "%"),
    ("temperature_c", -50.0, 100.0, "deg C"),
    ("rest_min", 0.0, 1e7, "min"),
    ("container_age_d", 0.0, 1e5, "days"),
    ("funnel_height_mm", 0.1, 1e4, "mm"),
    ("base_diameter_mm", 0.1, 1e4, "mm"),
    ("poured_mass_g", 1e-3, 1e6, "g"),
    (FLOW, 1e-3, 1e6, "s"),
    ("vibration_rms_m_s2", 0.0, 1e3, "m/s2"),
];
/// Typos: one letter per this many, and two at most: `sesion` for `session`, but not `bench` for
/// `batch`.
const SLIP_CHARS: usize = 5;
const SLIPS_MAX: usize = 2;
const FLOW: &str = "flow_time_s";
const ORDER: &str = "order_in_session";
const ANGLE: &str = "repose_deg";

/// A campaign, and how its file was interpreted.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CampaignRead {
    pub campaign: Campaign,
    pub read: FileRead,
}

/// Content of a row.
struct Line<'a> {
    row: usize,
    powder: String,
    session: Cell<'a>,
    /// Mean, SD and number of the runs behind it; none if the angle is to be predicted.
    angle: Option<Flowability>,
    /// Cells of the covariates' columns, in their order.
    cells: Vec<Cell<'a>>,
    flow_time_s: Option<f64>,
    /// Whether it gives the run's place in its session.
    has_order: bool,
    /// The angle as written, and every other cell: two rows with equal values may be duplicates.
    angle_text: &'a str,
    beside: Vec<&'a str>,
}

/// A cell: its text, empty if nothing was recorded, and what it is.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Cell<'a> {
    text: &'a str,
    told: Told<'a>,
}

impl<'a> Cell<'a> {
    fn of(cells: &Cells<'a>, column: &str) -> Self {
        Self { text: cells.text(column), told: cells.told(column) }
    }

    fn is_filled(&self) -> bool {
        self.told != Told::Missing
    }
}

/// Reads the campaign in a file. Every one of the `required` columns must be in its header and
/// filled in each row; `dates` gives the component that comes first in dates such as 2/3/2026.
///
/// # Errors
/// Every invalid cell by row and column, up to 50; a missing or repeated column by name.
pub(super) fn read(
    text: &str,
    required: &[&str],
    dates: Option<DateOrder>,
) -> Result<CampaignRead> {
    let columns = Columns { required, known, meant, most: COLUMNS_MAX };
    let table = Table::open(text, &columns, check_header)?;
    let covariates =
        table.columns.iter().filter(|name| !OWN.contains(&name.as_str()) && !name.is_empty());
    let covariates: Vec<&str> = covariates.map(String::as_str).collect();
    let (mut lines, mut powders, mut summaries) =
        (Vec::new(), PowderNames::default(), Summaries::of(&table));
    // Rows to be predicted are queries: all of them are answered, and duplicates are allowed.
    let is_campaign = required.contains(&ANGLE);
    let refusals = table.each(|cells| {
        if is_campaign && summaries.has(cells) {
            return Ok(());
        }
        lines.push(line(cells, &covariates, required, &mut powders)?);
        Ok(())
    });
    refused(refusals)?;
    summaries.leave_any(lines.len())?;
    let left_out = if is_campaign { twice::leave_out(&mut lines) } else { twice::Twice::default() };
    bounded(&lines)?;
    let (session, read) = conditions(&lines, &covariates, dates)?;
    let mut columns = own_columns(&table, &lines);
    columns.extend(session.column.clone());
    columns
        .extend(covariates.iter().zip(&read).map(|(name, column)| column.told(name, lines.len())));
    columns.sort_by_key(|it| table.columns.iter().position(|name| *name == it.column));
    let read_as = FileRead {
        file: "measurements".to_owned(),
        rows: (lines.len() + left_out.rows.len() + summaries.rows.len()) as u32,
        columns,
        powders: powders.named(),
        left_out: summaries.told().into_iter().chain(left_out.told()).collect(),
        notes: left_out.note.into_iter().collect(),
    };
    Ok(CampaignRead {
        campaign: campaign(&lines, &session.places, &covariates, read),
        read: read_as,
    })
}

/// Sessions and covariates of the rows, or all errors in either.
fn conditions(
    lines: &[Line<'_>],
    names: &[&str],
    dates: Option<DateOrder>,
) -> Result<(Sessions, Vec<Column>)> {
    let (mut columns, mut refusals) = (Vec::new(), Vec::new());
    let rows: Vec<usize> = lines.iter().map(|line| line.row).collect();
    let cells: Vec<Cell<'_>> = lines.iter().map(|line| line.session).collect();
    let session = sessions(&cells, &rows, dates).map_err(|all| refusals.extend(all)).ok();
    for (k, name) in names.iter().enumerate() {
        let cells: Vec<Cell<'_>> = lines.iter().map(|line| line.cells[k]).collect();
        match column::read(name, &cells, &rows) {
            Ok(column) => columns.push(column),
            Err(all) => refusals.extend(all),
        }
    }
    days_without_session(names, lines, &mut refusals);
    refused(refusals)?;
    let Some(session) = session else { unreachable!("refused above") };
    Ok((session, columns))
}

fn refused(mut refusals: Vec<FieldError>) -> Result<()> {
    refusals.truncate(REFUSALS_MAX);
    if refusals.is_empty() { Ok(()) } else { Err(Error::Invalid(refusals)) }
}

fn known(name: &str) -> Option<Holds> {
    let is_number = NUMBERS.iter().any(|(column, ..)| *column == name)
        || ["repose_deg", "repose_sd_deg", "n"].contains(&name);
    match is_number {
        true => Some(Holds::Numbers),
        false => (OWN.contains(&name) || NAMES.contains(&name)).then_some(Holds::Text),
    }
}

/// The known column behind a laboratory's name for it, in letters and digits alone. A temperature
/// without a unit may be in any.
fn meant(letters: &str) -> Option<&'static str> {
    Some(match letters {
        "date" | "day" | "sessiondate" | "measuredon" | "testdate" | "datum" | "tag"
        | "messtag" => "session",
        "rh"
        | "rhpct"
        | "rhpercent"
        | "relrh"
        | "humidity"
        | "humiditypct"
        | "relhumidity"
        | "relhumiditypct"
        | "relativehumidity"
        | "relativehumiditypercent"
        | "airhumidity"
        | "rf"
        | "luftfeuchte"
        | "luftfeuchtigkeit"
        | "relativeluftfeuchte"
        | "relativeluftfeuchtigkeit" => humidity::COLUMN,
        "tempc" | "temperaturec" | "roomtemperaturec" | "temperaturdegc" | "temperaturedegc"
        | "temperaturc" => "temperature_c",
        "aor" | "angleofrepose" | "reposeangle" | "angleofreposedeg" | "reposeangledeg"
        | "aordeg" | "schüttwinkel" | "böschungswinkel" => ANGLE,
        "material" | "substance" | "pulver" => "powder",
        _ => return None,
    })
}

/// Refuses an unknown column whose name is nearly that of a missing known one: as it stands it
/// would become a different condition.
fn slips(names: &[String], check: &mut Check) {
    let columns = || OWN.into_iter().chain(NAMES).chain(NUMBERS.map(|column| column.0));
    for name in names.iter().filter(|name| known(name).is_none() && !is_again(name)) {
        let written = name.to_lowercase();
        let slips = (written.chars().count() / SLIP_CHARS).min(SLIPS_MAX);
        let mut missing = columns().filter(|column| !names.iter().any(|name| name == column));
        if let Some(column) = missing.find(|column| strsim::osa_distance(&written, column) <= slips)
        {
            let advice = format!(
                "is almost `{column}`, which the file lacks: write that, or a name less like it"
            );
            check.refuse(name, advice);
        }
    }
}

/// Refuses a column of days without a session: it would be one more condition, and every difference
/// between days its effect.
fn days_without_session(names: &[&str], lines: &[Line<'_>], refusals: &mut Vec<FieldError>) {
    if lines.iter().any(|line| line.session.is_filled()) {
        return;
    }
    for (k, name) in names.iter().enumerate() {
        let mut filled = lines.iter().map(|line| line.cells[k]).filter(Cell::is_filled).peekable();
        if filled.peek().is_some()
            && filled.all(|cell| matches!(cell.told, Told::Text(text) if day(text).is_some()))
        {
            let advice = "holds dates, but no column is called `session`: rename this one to `session`, or differences between days are taken for effects";
            refusals.push(FieldError::new(*name, advice));
        }
    }
}

fn check_header(names: &[String], check: &mut Check) {
    slips(names, check);
    // As pandas renames duplicate columns, and as repeats stand side by side.
    for name in names.iter().filter(|name| is_again(name)) {
        check.refuse(
            name,
            "is a column given twice, or one of several repeats in a row: write one run per row",
        );
    }
    if !names.iter().all(|name| is_name(name)) {
        check.refuse(
            "header",
            format!(
                "holds a name of more than {NAME_CHARS_MAX} characters, or of more than one line"
            ),
        );
    }
}

/// `repose_deg.1`, `repose_deg_2`: another measurement of the same run.
fn is_again(name: &str) -> bool {
    let name = name.to_lowercase().replace([' ', '-', '.'], "_");
    let column = name.trim_end_matches(|c: char| c.is_ascii_digit());
    let is_own = |column: &str| ["powder", ANGLE, "repose_sd_deg", FLOW].contains(&column);
    column.len() < name.len() && is_own(column.trim_end_matches('_'))
}

fn is_name(name: &str) -> bool {
    name.chars().count() <= NAME_CHARS_MAX && !name.chars().any(char::is_control)
}

/// A row, if it is valid.
fn line<'a>(
    cells: &Cells<'a>,
    covariates: &[&str],
    required: &[&str],
    powders: &mut PowderNames,
) -> Refused<Line<'a>> {
    let row = cells.row;
    let mut check = Check::default();
    for column in required.iter().filter(|column| !cells.holds(column)) {
        check.keep::<()>(Err(at(row, column, "is missing")));
    }
    let powder = cells.holds("powder").then(|| powders.id_of(row, cells.text("powder")));
    let powder = powder.and_then(|id| check.keep(id));
    let angle = check.keep(angle(cells)).flatten();
    for (column, lower, upper, unit) in
        NUMBERS.into_iter().filter(|(column, ..)| cells.holds(column))
    {
        // A value beyond the measuring range is not a measurement; leaving it out of the judged
        // quantity would be a selection.
        if column == FLOW || !matches!(cells.told(column), Told::Limit(_)) {
            check.keep(within(cells, column, lower, upper, unit));
        }
    }
    for column in NAMES.into_iter().chain(["session"]).filter(|column| cells.holds(column)) {
        check.text(&format!("row[{row}].{column}"), cells.text(column), NAME_CHARS_MAX);
    }
    if words::method(cells.text("method")).is_none() {
        check.keep::<()>(Err(at(
            row,
            "method",
            format!("must be camera or manual, got `{}`", cells.text("method")),
        )));
    }
    if cells.holds("ioniser_on") && yes_or_no(cells.text("ioniser_on")).is_none() {
        let advice = format!(
            "must be yes or no, also 1, 0, true, false, on and off, got `{}`",
            cells.text("ioniser_on")
        );
        check.keep::<()>(Err(at(row, "ioniser_on", advice)));
    }
    check.refusals()?;
    let named = |column: &str, text| {
        if cells.holds(column) {
            Cell { text, told: Told::Text(text) }
        } else {
            Cell::of(cells, column)
        }
    };
    let cell = |column: &&str| match *column {
        "ioniser_on" => named(column, yes_or_no(cells.text(column)).unwrap_or_default()),
        "method" => named(column, by(words::method(cells.text(column)))),
        _ => Cell::of(cells, column),
    };
    Ok(Line {
        row,
        powder: powder.unwrap_or_default(),
        session: Cell::of(cells, "session"),
        angle,
        cells: covariates.iter().map(cell).collect(),
        flow_time_s: cells.holds(FLOW).then(|| cells.number(FLOW).ok()).flatten(),
        has_order: cells.holds(ORDER),
        angle_text: cells.text(ANGLE),
        beside: cells.all_but(ANGLE),
    })
}

/// A campaign's name for a method.
fn by(method: Option<Method>) -> &'static str {
    match method {
        Some(Method::Manual) => "manual",
        _ => "camera",
    }
}

/// One angle, or the summary of several.
fn angle(cells: &Cells<'_>) -> std::result::Result<Option<Flowability>, FieldError> {
    if !cells.holds("repose_deg") {
        return Ok(None);
    }
    let repose_deg = within(cells, "repose_deg", 5.0, 85.0, "deg")?;
    let sd_deg = cells
        .holds("repose_sd_deg")
        .then(|| within(cells, "repose_sd_deg", 0.0, 45.0, "deg"))
        .transpose()?;
    let refused = |column, advice: &str| Err(at(cells.row, column, advice));
    match (cells.repeats("n")?, sd_deg) {
        (None, None) | (Some(1), _) => Ok(Some(Flowability { repose_deg, sd_deg: 0.0, n: 1 })),
        (Some(n @ 2..=REPEATS_MAX), Some(sd_deg)) => {
            Ok(Some(Flowability { repose_deg, sd_deg, n }))
        }
        (Some(2..=REPEATS_MAX), None) => {
            refused("repose_sd_deg", "is missing: a summary needs the SD over its repeats")
        }
        (Some(_), _) => refused("n", &format!("must be from 1 to {REPEATS_MAX} repeats")),
        (None, Some(_)) => refused(
            "repose_sd_deg",
            "belongs to a summary: fill in `n` too, or leave it empty for a single run",
        ),
    }
}

impl Line<'_> {
    /// Number of runs behind it; a row to be predicted is one.
    fn runs(&self) -> usize {
        self.angle.map_or(1, |angle| angle.n as usize)
    }
}

/// Refuses more runs than can be processed together.
fn bounded(lines: &[Line<'_>]) -> Result<()> {
    let mut runs = 0;
    for line in lines {
        runs += line.runs();
        if runs > RUNS_MAX {
            let advice = format!(
                "brings the number of runs, including those behind summaries, above the limit of {RUNS_MAX}: leave rows out"
            );
            return Err(FieldError::new(format!("row[{}]", line.row), advice).into());
        }
    }
    Ok(())
}

/// How the columns of the run itself were interpreted, except for its session.
fn own_columns(table: &Table, lines: &[Line<'_>]) -> Vec<ColumnRead> {
    let own =
        table.columns.iter().filter(|name| OWN.contains(&name.as_str()) && *name != "session");
    own.map(|name| {
        let is_filled = |line: &&Line<'_>| match name.as_str() {
            FLOW => line.flow_time_s.is_some(),
            "powder" => true,
            ANGLE => line.angle.is_some(),
            _ => line.angle.is_some_and(|angle| angle.n > 1),
        };
        let filled = lines.iter().filter(is_filled).count();
        let taken_as = if name == "powder" { TakenAs::Subject } else { TakenAs::Measured };
        let missing = (lines.len() - filled) as u32;
        ColumnRead {
            column: name.clone(),
            taken_as,
            filled: filled as u32,
            missing,
            note: String::new(),
        }
    })
    .collect()
}

fn campaign(
    lines: &[Line<'_>],
    sessions: &[usize],
    names: &[&str],
    columns: Vec<Column>,
) -> Campaign {
    let mut powders: Vec<String> = Vec::new();
    let mut runs = Vec::new();
    for (line, session) in lines.iter().zip(sessions) {
        let known = powders.iter().position(|powder| *powder == line.powder);
        let powder = known.unwrap_or(powders.len());
        if known.is_none() {
            powders.push(line.powder.clone());
        }
        let run = |value| Run { row: line.row as u32, powder, session: *session, value };
        match line.angle {
            Some(angle) => {
                runs.extend(
                    repeats_of(angle.repose_deg, angle.sd_deg, angle.n)
                        .into_iter()
                        .map(|deg| run(Some(deg))),
                );
            }
            None => runs.push(run(None)),
        }
    }
    let repeats: Vec<usize> = lines.iter().map(Line::runs).collect();
    let covariate = |(name, column): (&&str, Column)| {
        column.values(&repeats).map(|values| Covariate { name: (*name).to_owned(), values })
    };
    let times =
        lines.iter().flat_map(|line| (0..line.runs()).map(|k| line.flow_time_s.filter(|_| k == 0)));
    let flow_time_s: Vec<Option<f64>> = times.collect();
    Campaign {
        powders,
        runs,
        covariates: names.iter().zip(columns).filter_map(covariate).collect(),
        flow_time_s: if flow_time_s.iter().any(Option::is_some) { flow_time_s } else { Vec::new() },
        ..Campaign::default()
    }
}

#[cfg(test)]
mod tests;
