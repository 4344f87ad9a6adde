//! CSV files as laboratories write them: a header, rows, an empty cell for what is missing.
//!
//! A refusal names the cell, such as `row[2].repose_deg`; the header is row 1.

use super::check::Check;
use super::{Error, Result};
use crate::domain::{FieldError, bounded};
use std::collections::HashMap;

/// Most rows of a file.
const ROWS_MAX: usize = 20_000;
/// Refusals after which reading stops: a wrong delimiter makes every row wrong.
pub(super) const REFUSALS_MAX: usize = 50;

/// What was made of a row, or all that is wrong with it.
pub(super) type Refused<T> = std::result::Result<T, Vec<FieldError>>;

/// A refusal of a cell.
pub(super) fn at(row: usize, column: &str, message: impl Into<String>) -> FieldError {
    FieldError::new(format!("row[{row}].{column}"), message)
}

/// The filled cells of a row, by column.
#[derive(Debug)]
pub(super) struct Cells<'a> {
    /// Row of the file, the header being row 1.
    pub row: usize,
    filled: HashMap<&'a str, &'a str>,
}

impl Cells<'_> {
    /// Whether the column is there and its cell filled.
    pub fn holds(&self, column: &str) -> bool {
        self.filled.contains_key(column)
    }

    /// The cell as it is written; nothing where it is empty.
    pub fn written(&self, column: &str) -> &str {
        self.filled.get(column).copied().unwrap_or_default()
    }

    /// The cell without the blanks around it.
    pub fn text(&self, column: &str) -> &str {
        self.written(column).trim()
    }

    /// The number in the cell.
    ///
    /// # Errors
    /// An empty cell, or one without a finite number.
    pub fn number(&self, column: &str) -> std::result::Result<f64, FieldError> {
        if !self.holds(column) {
            return Err(at(self.row, column, "is missing"));
        }
        let cell = self.text(column);
        let wrong = || at(self.row, column, format!("must be a number with a decimal point, got `{cell}`"));
        number(cell).ok_or_else(wrong)
    }

    /// The number of repeats in the cell, none where it is empty.
    ///
    /// # Errors
    /// Anything but a whole number.
    pub fn repeats(&self, column: &str) -> std::result::Result<Option<u32>, FieldError> {
        self.whole(column, "repeats")
    }

    /// The number of `what` in the cell, none where it is empty. `5.0` is five: a table with gaps writes it so.
    ///
    /// # Errors
    /// Anything but a whole number.
    pub fn whole(&self, column: &str, what: &str) -> std::result::Result<Option<u32>, FieldError> {
        if !self.holds(column) {
            return Ok(None);
        }
        let cell = self.text(column);
        let whole = number(cell).filter(|n| n.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(n));
        let wrong = || at(self.row, column, format!("must be a whole number of {what}, got `{cell}`"));
        whole.map(|n| Some(n as u32)).ok_or_else(wrong)
    }
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

/// Yes and no as laboratories write them.
pub(super) fn yes_or_no(text: &str) -> Option<&'static str> {
    match text.to_ascii_lowercase().as_str() {
        "1" | "true" | "yes" => Some("yes"),
        "0" | "false" | "no" => Some("no"),
        _ => None,
    }
}

/// A finite number.
pub(super) fn number(text: &str) -> Option<f64> {
    text.parse().ok().filter(|number: &f64| number.is_finite())
}

/// A file whose header has been read.
pub(super) struct CsvFile<'a> {
    /// Names of its columns, in their order.
    pub columns: Vec<String>,
    reader: csv::Reader<&'a [u8]>,
    place: Place<'a>,
}

impl<'a> CsvFile<'a> {
    /// Read the header, and let `check` look at the names of the columns.
    ///
    /// # Errors
    /// A column that stands twice, and what `check` refused.
    pub fn open(text: &'a str, check: impl FnOnce(&[String], &mut Check)) -> Result<Self> {
        let mut reader = csv::ReaderBuilder::new().from_reader(text.as_bytes());
        let names = reader.headers().map_err(|error| unreadable(1, &error))?;
        let columns: Vec<String> = names.iter().map(|name| name.trim().to_owned()).collect();
        let place = Place { text: text.as_bytes(), row: 1, seen: 0, lines: 0, inside: line_breaks(names) };
        let mut refusals = Check::default();
        for (k, name) in columns.iter().enumerate() {
            if !name.is_empty() && columns[..k].contains(name) {
                refusals.refuse(name, "stands twice in the header");
            }
        }
        check(&columns, &mut refusals);
        refusals.done()?;
        Ok(Self { columns, reader, place })
    }

    /// Hand every row that is not blank to `row`. What it refused is returned, and reading ends when that is [`REFUSALS_MAX`] or more.
    ///
    /// # Errors
    /// No rows or too many, a row of another length than the header.
    pub fn rows(self, mut row: impl FnMut(&Cells<'_>) -> Refused<()>) -> Result<Vec<FieldError>> {
        let Self { columns, mut reader, mut place } = self;
        let (mut refusals, mut rows) = (Vec::new(), 0);
        for record in reader.records() {
            let record = record.map_err(|error| unreadable(place.row_at(error.position()), &error))?;
            let number = place.row_at(record.position());
            place.inside += line_breaks(&record);
            let cells = columns.iter().map(String::as_str).zip(record.iter());
            let filled: HashMap<&str, &str> = cells.filter(|(_, cell)| !cell.trim().is_empty()).collect();
            if filled.is_empty() {
                continue;
            }
            rows += 1;
            if rows > ROWS_MAX {
                let advice = format!("is one too many: a file may hold {ROWS_MAX} rows; split it");
                return Err(FieldError::new(format!("row[{number}]"), advice).into());
            }
            refusals.extend(row(&Cells { row: number, filled }).err().into_iter().flatten());
            if refusals.len() >= REFUSALS_MAX {
                break;
            }
        }
        match rows {
            0 => Err(FieldError::new("row[2]", "is missing: the file has no row below its header").into()),
            _ => Ok(refusals),
        }
    }
}

/// Which row of the file a record is, blank ones counted, as a spreadsheet counts.
struct Place<'a> {
    text: &'a [u8],
    /// Of the last record.
    row: usize,
    /// Bytes in which line breaks have been counted.
    seen: usize,
    lines: usize,
    /// Line breaks within cells.
    inside: usize,
}

impl Place<'_> {
    /// Row of the record that the reader found from `position` on: blank lines before it are skipped.
    fn row_at(&mut self, position: Option<&csv::Position>) -> usize {
        let start = position.map_or(self.seen, |position| position.byte() as usize).clamp(self.seen, self.text.len());
        let blank = self.text[start..].iter().take_while(|byte| matches!(byte, b'\r' | b'\n')).count();
        self.lines += self.text[self.seen..start + blank].iter().filter(|byte| **byte == b'\n').count();
        self.seen = start + blank;
        // A file of before line feeds has none to count.
        self.row = (self.row + 1).max((1 + self.lines).saturating_sub(self.inside));
        self.row
    }
}

fn line_breaks(record: &csv::StringRecord) -> usize {
    record.iter().map(|cell| cell.matches('\n').count()).sum()
}

fn unreadable(row: usize, error: &csv::Error) -> Error {
    let field = if row == 1 { "header".to_owned() } else { format!("row[{row}]") };
    let message = match error.kind() {
        csv::ErrorKind::UnequalLengths { expected_len, len, .. } => {
            format!("has {len} cells where the header has {expected_len}: quote cells that hold a comma")
        }
        _ => "is not UTF-8 text: save the file as CSV UTF-8".to_owned(),
    };
    FieldError::new(field, message).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_counted_as_a_spreadsheet_counts_them() {
        let rows = |text: &str| {
            let mut found = Vec::new();
            let file = CsvFile::open(text, |_, _| {}).unwrap();
            let read = file.rows(|cells| {
                found.push((cells.row, cells.text("a").to_owned()));
                Ok(())
            });
            read.map(|_| found)
        };
        for (text, expected) in [
            ("a\nx\ny\n", [(2, "x"), (3, "y")]),
            ("a\nx\n\n\ny", [(2, "x"), (5, "y")]),
            ("\u{feff}a,b\r\n\r\nx,1\r\n,\r\ny,2\r\n", [(3, "x"), (5, "y")]),
            ("a,\"b\nc\"\nx,\"1\n2\n3\"\ny,2\n", [(2, "x"), (3, "y")]),
            ("a\rx\ry\r", [(2, "x"), (3, "y")]),
        ] {
            let expected = expected.map(|(row, cell)| (row, cell.to_owned()));
            assert_eq!(rows(text).unwrap(), expected, "{text:?}");
        }
        let ragged = rows("a,b\n\n1,2\n\n1\n").unwrap_err().to_string();
        assert!(ragged.starts_with("row[5]: has 1 cells where the header has 2"), "{ragged}");
    }
}
