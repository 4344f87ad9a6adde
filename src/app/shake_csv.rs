//! Shakes as CSV: one step of a spoonful per row, with what the balance says fell.
//!
//! | columns | what becomes of them |
//! |---------|----------------------|
//! | `weighing`, `spoonful`, `powder` | rows with the same are one spoonful; without `spoonful` it is the first of its weighing |
//! | `step` | the order within the spoonful; without it, the order of the rows |
//! | `lot`, `session`, `readability_mg` | of the whole spoonful: one row may say it for all |
//! | `fell_mg` | what fell during the step, also 0 and below |
//! | `balance_mg` in place of it | the reading after the step; step 0 is before the first, else that was 0 |
//! | `sd_mg` | its standard uncertainty; without it that of a difference of two readings of such a display |
//! | `pitch_deg`, `shake_mm` and the other numbers | of the step |
//! | those of a trace, as `t_s`, `stable` | `t_s` orders readings of one step, of which the last counts; a `kind` other than dose is left out |
//!
//! Traces for an investigation have the second form, by other names ([`meant`]). An empty cell is a
//! missing value, never zero. [`read`] reads the output of [`write()`].

use super::check::Check;
use super::csv_file::{Cells, Columns, Holds, REFUSALS_MAX, Refused, Table, at, within};
use super::nearest::did_you_mean;
use super::powder_names::PowderNames;
use super::{Error, Result};
use flip_core::domain::FieldError;
use flip_core::domain::apparatus::Apparatus;
use flip_core::domain::shake::{SPOONFUL_MG_MAX, Shake, Spoonful, display_step_mg};
use std::collections::HashMap;

/// All columns, in the order of an export.
const COLUMNS: [&str; 15] = [
    "weighing",
    "spoonful",
    "step",
    "powder",
    "lot",
    "session",
    "readability_mg",
    "pitch_deg",
    "shake_mm",
    "strokes",
    "acceleration_m_s2",
    "spoon_mg",
    "fell_mg",
    "sd_mg",
    "since_filled_s",
];
/// Columns without which a row is no step of a spoonful.
const REQUIRED: [&str; 4] = ["weighing", "powder", "pitch_deg", "shake_mm"];
/// The reading after a step, in place of what fell.
const BALANCE: &str = "balance_mg";
/// Further columns of a trace; only the first two matter here.
const OF_TRACES: [&str; 6] =
    ["t_s", "kind", "stable", "target_mg", "relative_humidity_pct", "vibration_rms_m_s2"];
/// Columns of words.
const WORDS: [&str; 6] = ["weighing", "powder", "lot", "session", "kind", "stable"];
/// Maximum length of a name.
const NAME_CHARS_MAX: usize = 200;

/// A spoonful of a file.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Entry {
    /// Its first row in the file, the header being row 1.
    pub row: usize,
    pub spoonful: Spoonful,
}

/// A row.
struct Line {
    row: usize,
    of: SpoonfulName,
    lot: Option<String>,
    session: Option<String>,
    readability_mg: Option<f64>,
    step: Option<u32>,
    t_s: Option<f64>,
    said: Said,
    balance_mg: f64,
    /// Complete but for what the other rows of its spoonful say.
    shake: Shake,
}

/// What a row says of its step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Said {
    /// What fell.
    Fell,
    /// The reading after it.
    Balance,
}

/// Powder, weighing and number of a spoonful.
type SpoonfulName = (String, String, u32);

/// The rows of one spoonful.
struct Gathered {
    row: usize,
    of: SpoonfulName,
    lot: Option<String>,
    session: Option<String>,
    readability_mg: Option<f64>,
    lines: Vec<Line>,
}

/// The spoonfuls of a file, in the order of their first rows, and the powders that it gives by name.
///
/// # Errors
/// Every invalid cell by row and column, up to 50; an unknown, missing or repeated column by name.
pub(super) fn read(text: &str) -> Result<(Vec<Entry>, PowderNames)> {
    let most = COLUMNS.len() + OF_TRACES.len() + 1;
    let columns = Columns { required: &REQUIRED, known, meant, most };
    let table = Table::open(text, &columns, check_header)?;
    let (mut powders, mut all) = (PowderNames::default(), Spoonfuls::default());
    let said =
        if table.columns.iter().any(|name| name == BALANCE) { Said::Balance } else { Said::Fell };
    let mut refusals = table.each(|cells| match is_dose(cells) {
        true => all.add(line(cells, said, &mut powders)?),
        false => Ok(()),
    });
    let step_mg = all.display_step_mg();
    let mut entries = Vec::new();
    for gathered in all.list {
        match gathered.entry(step_mg) {
            Ok(entry) => entries.push(entry),
            Err(error) => refusals.push(error),
        }
    }
    refusals.truncate(REFUSALS_MAX);
    if refusals.is_empty() { Ok((entries, powders)) } else { Err(Error::Invalid(refusals)) }
}

fn known(name: &str) -> Option<Holds> {
    let is_known = COLUMNS.contains(&name) || OF_TRACES.contains(&name) || name == BALANCE;
    let holds = if WORDS.contains(&name) { Holds::Text } else { Holds::Numbers };
    is_known.then_some(holds)
}

/// The column meant by other names, without blanks and marks: those of a trace, and common ones.
fn meant(letters: &str) -> Option<&'static str> {
    Some(match letters {
        "weighingid" | "run" | "runid" => "weighing",
        "shakeindex" => "step",
        "spoonpitchdeg" | "pitch" => "pitch_deg",
        "amplitudemm" | "strokemm" => "shake_mm",
        "spoonfillmg" => "spoon_mg",
        "fallenmg" | "shakemg" => "fell_mg",
        "fellsdmg" | "uncertaintymg" => "sd_mg",
        "displaystepmg" => "readability_mg",
        "batch" => "lot",
        "day" | "date" => "session",
        _ => return None,
    })
}

fn check_header(header: &[String], check: &mut Check) {
    let is_unknown = |name: &&String| !name.is_empty() && known(name).is_none();
    for name in header.iter().filter(is_unknown) {
        let meant = did_you_mean(name, COLUMNS);
        let columns = COLUMNS.join(", ");
        check.refuse(name, format!("is not a known column{meant}; the columns are: {columns}"));
    }
    let has = |column: &str| header.iter().any(|name| name == column);
    match (has("fell_mg"), has(BALANCE)) {
        (false, false) => check.refuse(
            "fell_mg",
            "is missing in the header: give what fell, or `balance_mg`, the reading after each step",
        ),
        (true, true) => {
            check.refuse(BALANCE, "says the same as `fell_mg`: leave one of the columns out")
        }
        (false, true) if !has("step") => check.refuse(
            "step",
            "is missing in the header: readings need the number of the shake before them",
        ),
        _ => {}
    }
}

fn is_dose(cells: &Cells<'_>) -> bool {
    ["", "dose"].contains(&cells.text("kind").to_lowercase().as_str())
}

/// A row, if it is valid.
fn line(cells: &Cells<'_>, said: Said, powders: &mut PowderNames) -> Refused<Line> {
    let row = cells.row;
    let mut check = Check::default();
    for column in ["weighing", "powder"].iter().filter(|column| !cells.holds(column)) {
        check.keep::<()>(Err(at(row, column, "is missing")));
    }
    for column in ["weighing", "lot", "session"].iter().filter(|column| cells.holds(column)) {
        check.text(&format!("row[{row}].{column}"), cells.text(column), NAME_CHARS_MAX);
    }
    let powder = cells.holds("powder").then(|| powders.id_of(row, cells.text("powder")));
    let powder = powder.and_then(|id| check.keep(id)).unwrap_or_default();
    let spoonful = check.keep(cells.whole("spoonful", "fillings")).flatten();
    if spoonful == Some(0) {
        check.keep::<()>(Err(at(row, "spoonful", "must be 1 or more: the first is 1")));
    }
    let step = check.keep(cells.whole("step", "steps")).flatten();
    let strokes = check.keep(cells.whole("strokes", "strokes")).flatten();
    if strokes == Some(0) {
        check.keep::<()>(Err(at(
            row,
            "strokes",
            "must be 1 or more: how often the shake was made",
        )));
    }
    let is_before = said == Said::Balance && step == Some(0);
    if said == Said::Balance && step.is_none() && !cells.holds("step") {
        check.keep::<()>(Err(at(row, "step", "is missing")));
    }
    let mut number = |column: &str, lower: f64, upper: f64, unit: &str| {
        let value = cells.holds(column).then(|| within(cells, column, lower, upper, unit));
        value.and_then(|value| check.keep(value))
    };
    let readability_mg = number("readability_mg", 1e-4, 1e3, "mg");
    let t_s = number("t_s", -1e12, 1e12, "s");
    let balance_mg = number(BALANCE, -1e9, 1e9, "mg");
    let shake = Shake {
        pitch_deg: number("pitch_deg", -90.0, 180.0, "deg").unwrap_or_default(),
        shake_mm: number("shake_mm", 0.0, 100.0, "mm").unwrap_or_default(),
        strokes: strokes.unwrap_or(1),
        acceleration_m_s2: number("acceleration_m_s2", 0.0, 1e3, "m/s^2"),
        spoon_mg: number("spoon_mg", -SPOONFUL_MG_MAX, SPOONFUL_MG_MAX, "mg"),
        fell_mg: number("fell_mg", -SPOONFUL_MG_MAX, SPOONFUL_MG_MAX, "mg").unwrap_or_default(),
        // Zero until it is known.
        sd_mg: number("sd_mg", 1e-4, 1e3, "mg").unwrap_or_default(),
        since_filled_s: number("since_filled_s", 0.0, 1e7, "s"),
    };
    let value = if said == Said::Fell { "fell_mg" } else { BALANCE };
    let needed = ["pitch_deg", "shake_mm"].into_iter().filter(|_| !is_before).chain([value]);
    for column in needed.filter(|column| !cells.holds(column)) {
        check.keep::<()>(Err(at(row, column, "is missing: an empty cell is not zero")));
    }
    check.refusals()?;
    let text = |column: &str| cells.holds(column).then(|| cells.text(column).to_owned());
    Ok(Line {
        row,
        of: (powder, cells.text("weighing").to_owned(), spoonful.unwrap_or(1)),
        lot: text("lot"),
        session: text("session"),
        readability_mg,
        step,
        t_s,
        said,
        balance_mg: balance_mg.unwrap_or_default(),
        shake,
    })
}

/// Spoonfuls in the order of their first rows.
#[derive(Default)]
struct Spoonfuls {
    list: Vec<Gathered>,
    places: HashMap<SpoonfulName, usize>,
}

impl Spoonfuls {
    /// Adds a row; refuses one that contradicts earlier rows.
    fn add(&mut self, line: Line) -> Refused<()> {
        let place = *self.places.entry(line.of.clone()).or_insert(self.list.len());
        if place == self.list.len() {
            self.list.push(Gathered {
                row: line.row,
                of: line.of.clone(),
                lot: None,
                session: None,
                readability_mg: None,
                lines: Vec::new(),
            });
        }
        self.list[place].add(line)
    }

    /// Step of the display that shows every reading of the file, mg.
    fn display_step_mg(&self) -> Option<f64> {
        let lines = self.list.iter().flat_map(|it| &it.lines);
        let readings = lines.filter(|line| line.said == Said::Balance);
        display_step_mg(readings.map(|line| line.balance_mg))
    }
}

impl Gathered {
    fn add(&mut self, line: Line) -> Refused<()> {
        let mut check = Check::default();
        let (row, name) = (line.row, self.of.1.clone());
        let mut agree = |column: &str, agrees: bool| {
            if !agrees {
                let advice = format!(
                    "differs from the earlier rows of this spoonful of `{name}`: give the same in each, or number its spoonfuls"
                );
                check.keep::<()>(Err(at(row, column, advice)));
            }
        };
        agree("lot", same(&mut self.lot, &line.lot));
        agree("session", same(&mut self.session, &line.session));
        agree("readability_mg", same(&mut self.readability_mg, &line.readability_mg));
        let is_twice = line.said == Said::Fell
            && line.step.is_some()
            && self.lines.iter().any(|before| before.step == line.step);
        if is_twice {
            check.keep::<()>(Err(at(row, "step", "appears twice in its spoonful")));
        }
        self.lines.push(line);
        check.refusals()
    }

    /// The spoonful, where the readings of the file are those of a display with such a step.
    fn entry(mut self, step_mg: Option<f64>) -> std::result::Result<Entry, FieldError> {
        // Stable, so rows without a step or a time stay in the order of the file.
        self.lines.sort_by(|a, b| {
            let time = |line: &Line| line.t_s.unwrap_or_default();
            a.step.cmp(&b.step).then(time(a).total_cmp(&time(b)))
        });
        let readability_mg = self.readability_mg.or(step_mg);
        let steps = steps(self.lines);
        let shakes = steps.into_iter().map(|(row, shake)| with_sd(row, shake, readability_mg));
        let shakes = shakes.collect::<std::result::Result<Vec<_>, _>>()?;
        if shakes.is_empty() {
            return Err(at(self.row, "step", "has only a reading before the first shake"));
        }
        let (powder, weighing, spoonful) = self.of;
        let (lot, session) = (self.lot, self.session);
        let spoonful =
            Spoonful { weighing, spoonful, powder, lot, session, readability_mg, shakes };
        Ok(Entry { row: self.row, spoonful })
    }
}

/// The steps of sorted rows, each with its row. Of readings, the last of each step counts, and its
/// difference from the one before is what fell.
fn steps(lines: Vec<Line>) -> Vec<(usize, Shake)> {
    let (mut steps, mut before_mg) = (Vec::new(), 0.0);
    for (k, line) in lines.iter().enumerate() {
        match line.said {
            Said::Fell => steps.push((line.row, line.shake)),
            Said::Balance if lines.get(k + 1).is_some_and(|next| next.step == line.step) => {}
            Said::Balance => {
                if line.step != Some(0) {
                    let fell_mg = line.balance_mg - before_mg;
                    steps.push((line.row, Shake { fell_mg, ..line.shake }));
                }
                before_mg = line.balance_mg;
            }
        }
    }
    steps
}

/// The step with its uncertainty, at the latest from the display.
fn with_sd(
    row: usize,
    shake: Shake,
    readability_mg: Option<f64>,
) -> std::result::Result<Shake, FieldError> {
    let shake = match (shake.sd_mg > 0.0, readability_mg) {
        (true, _) => shake,
        (false, Some(readability_mg)) => {
            let (repeatability_mg, capacity_mg, stroke) = (None, None, None);
            let display = Apparatus { readability_mg, repeatability_mg, capacity_mg, stroke };
            Shake { sd_mg: display.difference_sd_mg().max(1e-4), ..shake }
        }
        (false, None) => {
            let advice = "is missing: give it, or `readability_mg`, the step of the display";
            return Err(at(row, "sd_mg", advice));
        }
    };
    shake.checked().map_err(|error| at(row, &error.field, error.message))
}

/// Whether a row agrees with what earlier rows said, if both say anything.
fn same<T: PartialEq + Clone>(known: &mut Option<T>, said: &Option<T>) -> bool {
    if known.is_none() {
        known.clone_from(said);
    }
    said.is_none() || known == said
}

/// Rows that [`read`] reads, numbers with all their digits; with the header, if it is the beginning.
pub(super) fn write<'a>(
    spoonfuls: impl Iterator<Item = &'a Spoonful>,
    is_beginning: bool,
) -> String {
    let mut text = csv::WriterBuilder::new().from_writer(Vec::new());
    let header = is_beginning.then(|| COLUMNS.map(str::to_owned));
    for row in header.into_iter().chain(spoonfuls.flat_map(rows)) {
        // Writing rows of equal length to memory cannot fail.
        let _infallible = text.write_record(row);
    }
    String::from_utf8(text.into_inner().unwrap_or_default()).unwrap_or_default()
}

fn rows(of: &Spoonful) -> impl Iterator<Item = [String; COLUMNS.len()]> {
    let text = |text: &Option<String>| text.clone().unwrap_or_default();
    of.shakes.iter().enumerate().map(move |(k, shake)| {
        [
            of.weighing.clone(),
            of.spoonful.to_string(),
            (k + 1).to_string(),
            of.powder.clone(),
            text(&of.lot),
            text(&of.session),
            maybe(of.readability_mg),
            number(shake.pitch_deg),
            number(shake.shake_mm),
            shake.strokes.to_string(),
            maybe(shake.acceleration_m_s2),
            maybe(shake.spoon_mg),
            number(shake.fell_mg),
            number(shake.sd_mg),
            maybe(shake.since_filled_s),
        ]
    })
}

fn maybe(value: Option<f64>) -> String {
    value.map(number).unwrap_or_default()
}

/// A number with all its digits that can be read in one way: three decimals could be thousands.
fn number(value: f64) -> String {
    let text = value.to_string();
    let is_ambiguous = text.split_once('.').is_some_and(|(_, decimals)| decimals.len() == 3);
    if is_ambiguous { text + "0" } else { text }
}

#[cfg(test)]
mod tests;
