//! Tables as laboratories write them: a header, rows, an empty cell for a missing value. All
//! importers use this.
//!
//! ```text
//! text.rs       bytes to text, without what a spreadsheet wraps it in
//! separator.rs  what separates cells         place.rs   which row of the file a record is
//! number.rs     numbers, with a point or a comma, with units
//! date.rs       days                         words.rs   words for what is missing, yes and no, by hand, stable
//! ```
//!
//! An error names the cell, such as `row[2].repose_deg`; the header is row 1. Known columns are
//! matched regardless of case, with blanks for underscores; trailing empty columns are ignored.

pub(super) mod date;
pub(super) mod number;
mod place;
mod separator;
mod text;
pub(super) mod words;

#[cfg(test)]
mod tests;

pub use text::table_text;

use super::check::Check;
use super::{Error, Result};
use flip_core::domain::{FieldError, bounded};
use number::{Cell, Signs, unit_of};
use place::Place;
use std::collections::HashMap;

/// Maximum number of rows in a file.
const ROWS_MAX: usize = 20_000;
/// Maximum size of a file, bytes: 400 for each of [`ROWS_MAX`] rows.
pub const TABLE_BYTES_MAX: usize = 8 * 1024 * 1024;
/// Number of errors after which reading stops: a wrong delimiter invalidates every row.
pub(super) const REFUSALS_MAX: usize = 50;

/// The result for a row, or all its errors.
pub(super) type Refused<T> = std::result::Result<T, Vec<FieldError>>;

/// The error of a cell.
pub(super) fn at(row: usize, column: &str, message: impl Into<String>) -> FieldError {
    FieldError::new(format!("row[{row}].{column}"), message)
}

/// Content of a known column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Holds {
    Numbers,
    Text,
}

/// The columns of a kind of file.
pub(super) struct Columns<'a> {
    /// Columns without which there is no row.
    pub required: &'a [&'a str],
    /// Content of a column; `None` if it is not known.
    pub known: fn(&str) -> Option<Holds>,
    /// The column meant by a laboratory's name for it; `None` if the name is not recognized.
    pub meant: fn(&str) -> Option<&'static str>,
    /// Maximum number of columns.
    pub most: usize,
}

/// A file in memory.
pub(super) struct Table {
    /// Names of its columns, in order; empty for a column without a name.
    pub columns: Vec<String>,
    holds: Vec<Option<Holds>>,
    rows: Vec<Row>,
    separator: u8,
    /// Decimal signs of each column, and of all columns.
    signs: Vec<Signs>,
    all_signs: Signs,
}

struct Row {
    /// Row number in the file, the header being row 1.
    number: usize,
    cells: Vec<String>,
}

impl Table {
    /// Reads a file, and lets `check` inspect the names of its columns.
    ///
    /// # Errors
    /// A file that is too large or has too many rows or none; a missing or repeated column, and
    /// errors added by `check`; a row whose length differs from the header's.
    pub fn open(
        text: &str,
        columns: &Columns<'_>,
        check: impl FnOnce(&[String], &mut Check),
    ) -> Result<Self> {
        if text.len() > TABLE_BYTES_MAX {
            let advice = format!(
                "has {} bytes, and at most {TABLE_BYTES_MAX} are allowed: split the file",
                text.len()
            );
            return Err(FieldError::new("file", advice).into());
        }
        let bare = text::bare(text)?;
        let is_known = |name: &str| {
            let name = name_of(name, columns);
            (columns.known)(&name).is_some() || columns.meant_by(&name).is_some()
        };
        let separator = bare.separator.unwrap_or_else(|| separator::separator(bare.text, is_known));
        let mut reader = csv::ReaderBuilder::new()
            .delimiter(separator)
            .flexible(true)
            .from_reader(bare.text.as_bytes());
        let header = reader.headers().map_err(|error| unreadable(1, &error))?.clone();
        let names = names_of(&header, columns);
        let mut refusals = Check::default();
        check_header(&names, columns, &mut refusals);
        check(&names, &mut refusals);
        refusals.done()?;
        let rows = rows(&mut reader, Place::new(bare.text, &header), &names)?;
        let holds = names.iter().map(|name| (columns.known)(name)).collect();
        let mut table = Self {
            columns: names,
            holds,
            rows,
            separator,
            signs: Vec::new(),
            all_signs: Signs::default(),
        };
        table.signs = (0..table.columns.len()).map(|column| table.signs_of(column)).collect();
        table.all_signs = table.signs.iter().fold(Signs::default(), |all, signs| all.and(*signs));
        Ok(table)
    }

    /// Decimal signs shown by the cells of a column.
    fn signs_of(&self, column: usize) -> Signs {
        let cells = self.rows.iter().filter_map(|row| row.cells.get(column));
        cells.fold(Signs::default(), |signs, cell| match number::cell(cell.trim()) {
            Cell::Number(written) => signs.and(written.signs()),
            _ => signs,
        })
    }

    /// Non-blank rows.
    pub fn rows(&self) -> impl Iterator<Item = Cells<'_>> {
        self.rows.iter().map(|row| {
            let filled =
                self.columns.iter().enumerate().zip(&row.cells).filter_map(|((k, name), cell)| {
                    let text = cell.trim();
                    let numbers = self.holds[k] == Some(Holds::Numbers);
                    let is_missing =
                        words::is_missing(text) || (numbers && words::is_no_number(text));
                    (!is_missing).then_some((name.as_str(), (k, cell.as_str())))
                });
            Cells { row: row.number, table: self, filled: filled.collect() }
        })
    }

    /// Passes every non-blank row to `row`. Returns its errors; reading stops at [`REFUSALS_MAX`]
    /// or more.
    pub fn each<'a>(&'a self, mut row: impl FnMut(&Cells<'a>) -> Refused<()>) -> Vec<FieldError> {
        let mut refusals = Vec::new();
        for cells in self.rows() {
            refusals.extend(row(&cells).err().into_iter().flatten());
            if refusals.len() >= REFUSALS_MAX {
                refusals.truncate(REFUSALS_MAX);
                break;
            }
        }
        refusals
    }
}

impl Columns<'_> {
    /// The known column meant by this name.
    fn meant_by(&self, name: &str) -> Option<&'static str> {
        let letters: String =
            name.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).collect();
        (self.meant)(&letters)
    }
}

/// The column names of a header: a laboratory's name for a known column is replaced by it, unless
/// the file has that column itself.
fn names_of(header: &csv::StringRecord, columns: &Columns<'_>) -> Vec<String> {
    let mut names: Vec<String> = header.iter().map(|name| name_of(name, columns)).collect();
    for k in 0..names.len() {
        let meant = columns.meant_by(&names[k]).filter(|_| (columns.known)(&names[k]).is_none());
        if let Some(meant) = meant.filter(|meant| names.iter().all(|name| name != meant)) {
            names[k] = meant.to_owned();
        }
    }
    names
}

/// The name of a column: the known spelling, else as written.
fn name_of(written: &str, columns: &Columns<'_>) -> String {
    let written = text::visible(written);
    let written = written.trim();
    let plain = written.to_lowercase().replace(|c: char| c.is_whitespace() || c == '-', "_");
    if (columns.known)(&plain).is_some() { plain } else { written.to_owned() }
}

fn check_header(names: &[String], columns: &Columns<'_>, check: &mut Check) {
    for (k, name) in names.iter().enumerate() {
        if !name.is_empty() && names[..k].contains(name) {
            check.refuse(name, "appears twice in the header");
        }
    }
    for column in columns.required.iter().filter(|column| !names.iter().any(|name| name == *column))
    {
        check.refuse(column, "is missing in the header");
    }
    let count = names.iter().filter(|name| !name.is_empty()).count();
    if count > columns.most {
        check.refuse(
            "header",
            format!("has {count} columns, and at most {} are allowed", columns.most),
        );
    }
}

fn rows(
    reader: &mut csv::Reader<&[u8]>,
    mut place: Place<'_>,
    names: &[String],
) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|error| unreadable(place.row_at(error.position()), &error))?;
        let number = place.of(&record);
        if record.iter().all(|cell| cell.trim().is_empty()) {
            continue;
        }
        check_length(number, &record, names)?;
        if rows.len() == ROWS_MAX {
            let advice = format!("is one too many: a file may have {ROWS_MAX} rows; split it");
            return Err(FieldError::new(format!("row[{number}]"), advice).into());
        }
        rows.push(Row {
            number,
            cells: record.iter().map(|cell| text::visible(cell).into_owned()).collect(),
        });
    }
    match rows.is_empty() {
        true => {
            Err(FieldError::new("row[2]", "is missing: the file has no row below its header")
                .into())
        }
        false => Ok(rows),
    }
}

/// Checks that a row has a cell for each named column, and nothing in addition.
fn check_length(
    row: usize,
    record: &csv::StringRecord,
    names: &[String],
) -> std::result::Result<(), FieldError> {
    let refused = |message: String| Err(FieldError::new(format!("row[{row}]"), message));
    let named = names.iter().rposition(|name| !name.is_empty()).map_or(0, |last| last + 1);
    if record.len() < named {
        return refused(format!(
            "has {} cells where the header has {named}: quote cells that contain a separator",
            record.len()
        ));
    }
    let stray = record
        .iter()
        .enumerate()
        .find(|(k, cell)| !cell.trim().is_empty() && names.get(*k).is_none_or(String::is_empty));
    match stray {
        Some((k, _)) if k >= names.len() => refused(format!(
            "has {} cells where the header has {named}: quote cells that contain a separator",
            record.len()
        )),
        Some((_, cell)) => refused(format!("holds `{}` in a column without a name", cell.trim())),
        None => Ok(()),
    }
}

fn unreadable(row: usize, error: &csv::Error) -> Error {
    let field = if row == 1 { "header".to_owned() } else { format!("row[{row}]") };
    FieldError::new(field, format!("cannot be read: {error}")).into()
}

/// The filled cells of a row, by column.
pub(super) struct Cells<'a> {
    /// Row number in the file, the header being row 1.
    pub row: usize,
    table: &'a Table,
    filled: HashMap<&'a str, (usize, &'a str)>,
}

/// Content of a cell in an unknown column.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Told<'a> {
    Missing,
    Number(f64, Option<&'static str>),
    /// Below or above the measuring range.
    Limit(&'a str),
    /// A comma or point before three digits: one number or a thousand times it.
    TwoNumbers(&'a str),
    Text(&'a str),
}

impl<'a> Cells<'a> {
    /// Whether the column exists and its cell is filled.
    pub fn holds(&self, column: &str) -> bool {
        self.filled.contains_key(column)
    }

    /// The cell as written; empty if it is empty.
    pub fn written(&self, column: &str) -> &'a str {
        self.filled.get(column).map(|(_, cell)| *cell).unwrap_or_default()
    }

    /// The cell without surrounding blanks.
    pub fn text(&self, column: &str) -> &'a str {
        self.written(column).trim()
    }

    /// The content of the cell, judged by itself and by the decimal signs in its column and file.
    pub fn told(&self, column: &str) -> Told<'a> {
        let Some((k, cell)) = self.filled.get(column) else { return Told::Missing };
        let (text, table) = (cell.trim(), self.table);
        match number::cell(text) {
            Cell::Number(written) => {
                match written.value(table.signs[*k], table.all_signs, table.separator) {
                    Some(value) => Told::Number(value, written.unit),
                    None => Told::TwoNumbers(text),
                }
            }
            Cell::Limit => Told::Limit(text),
            Cell::Other => Told::Text(text),
        }
    }

    /// The number in the cell, in the unit of its column.
    ///
    /// # Errors
    /// An empty cell, one without a number, an ambiguous number, or one in another unit.
    pub fn number(&self, column: &str) -> std::result::Result<f64, FieldError> {
        let refused = |message: String| Err(at(self.row, column, message));
        match self.told(column) {
            Told::Missing => refused("is missing".to_owned()),
            Told::Number(value, unit) => match (unit, unit_of(column)) {
                (Some(is), Some(wanted)) if is != wanted => {
                    refused(format!("is in {is}, but the column is in {wanted}"))
                }
                (Some(is), None) => refused(format!("is in {is}, but the column holds counts")),
                _ => Ok(value),
            },
            Told::TwoNumbers(text) => refused(two_numbers(text)),
            Told::Limit(text) => refused(format!(
                "is a limit, `{text}`, not a number: leave it empty, or leave the row out"
            )),
            Told::Text(text) => refused(format!("must be a number, got `{text}`")),
        }
    }

    /// The number of repeats in the cell, none if it is empty.
    ///
    /// # Errors
    /// Anything but a whole number.
    pub fn repeats(&self, column: &str) -> std::result::Result<Option<u32>, FieldError> {
        self.whole(column, "repeats")
    }

    /// The number of `what` in the cell, none if it is empty. `5.0` is five: a table with gaps
    /// writes it like this.
    ///
    /// # Errors
    /// Anything but a whole number.
    pub fn whole(&self, column: &str, what: &str) -> std::result::Result<Option<u32>, FieldError> {
        if !self.holds(column) {
            return Ok(None);
        }
        let number = self.number(column).ok();
        let whole = number.filter(|n| n.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(n));
        let wrong = || {
            at(
                self.row,
                column,
                format!("must be a whole number of {what}, got `{}`", self.text(column)),
            )
        };
        whole.map(|n| Some(n as u32)).ok_or_else(wrong)
    }

    /// All cells except that of one column, without surrounding blanks.
    pub fn all_but(&self, column: &str) -> Vec<&'a str> {
        self.table
            .columns
            .iter()
            .filter(|name| *name != column)
            .map(|name| self.text(name))
            .collect()
    }
}

/// Why a number is ambiguous.
pub(super) fn two_numbers(text: &str) -> String {
    let plain: String = text.chars().filter(|c| !",.".contains(*c)).collect();
    format!("may be {} or {plain}: write it as one of these", text.replace(',', "."))
}

/// The number in a cell, if it is within bounds.
pub(super) fn within(
    cells: &Cells<'_>,
    column: &str,
    lower: f64,
    upper: f64,
    unit: &str,
) -> std::result::Result<f64, FieldError> {
    bounded(&format!("row[{}].{column}", cells.row), cells.number(column)?, lower, upper, unit)
}
