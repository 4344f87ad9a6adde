//! The type of a covariate's column: numbers, names, or nothing that can be judged.
//!
//! | cells | taken as |
//! |-------|----------|
//! | all numbers, but for what is missing and limits such as `<5` | numbers; a limit is missing |
//! | more than half numbers | numbers: the others are refused by row and column |
//! | others | names, unless hardly one stands twice |

mod ends;
mod names;

use super::{Cell, NAMES, NUMBERS};
use crate::app::csv_file::number::unit_of;
use crate::app::csv_file::words::is_no_number;
use crate::app::csv_file::{Refused, Told, at, two_numbers};
use crate::app::humidity;
use flip_discover::Values;
use flip_discover::reading::{ColumnRead, TakenAs};

/// Largest number in a column without bounds of its own: its square must be finite too.
const NUMBER_MAX: f64 = 1e15;
/// Number of rows that a note names.
const ROWS_NAMED: usize = 10;

/// A column, one value per row.
#[derive(Debug)]
pub(super) struct Column {
    values: Option<Values>,
    filled: usize,
    note: String,
}

impl Column {
    /// How it was interpreted, out of `rows` rows.
    pub fn told(&self, name: &str, rows: usize) -> ColumnRead {
        let taken_as = match self.values {
            Some(Values::Numbers(_)) => TakenAs::Numbers,
            Some(Values::Levels { .. }) => TakenAs::Names,
            None => TakenAs::Nothing,
        };
        let (filled, missing) = (self.filled as u32, (rows - self.filled) as u32);
        ColumnRead { column: name.to_owned(), taken_as, filled, missing, note: self.note.clone() }
    }

    /// One value per run: the value of a row applies to every run behind it.
    pub fn values(self, runs: &[usize]) -> Option<Values> {
        match self.values? {
            Values::Numbers(of) => Some(Values::Numbers(of_runs(&of, runs))),
            Values::Levels { names, of } => Some(Values::Levels { names, of: of_runs(&of, runs) }),
        }
    }

    fn nothing(filled: usize, note: &str) -> Self {
        Self { values: None, filled, note: note.to_owned() }
    }
}

fn marked(text: &str) -> String {
    format!(
        "is `{text}`, which loggers write for a missing value: leave the cell empty, or write {text}.0 if it was measured"
    )
}

fn of_runs<T: Copy>(of_rows: &[T], runs: &[usize]) -> Vec<T> {
    of_rows.iter().zip(runs).flat_map(|(value, runs)| std::iter::repeat_n(*value, *runs)).collect()
}

/// Reads the column `name` of the rows with these numbers.
///
/// # Errors
/// Cells that cannot be interpreted, by row and column.
pub(super) fn read(name: &str, cells: &[Cell<'_>], rows: &[usize]) -> Refused<Column> {
    let filled = cells.iter().filter(|cell| cell.is_filled()).count();
    if filled == 0 {
        return Ok(Column::nothing(0, "no cell of it is filled"));
    }
    if name.starts_with("Unnamed: ") {
        return Ok(Column::nothing(
            filled,
            "it has no name but the one that pandas gives, mostly to a count of the rows",
        ));
    }
    let is_text = |cell: &&Cell<'_>| matches!(cell.told, Told::Text(text) if !is_no_number(text));
    let numbers = cells
        .iter()
        .filter(|cell| matches!(cell.told, Told::Number(..) | Told::TwoNumbers(_)))
        .count();
    let texts = cells.iter().filter(is_text).count();
    if NAMES.contains(&name) || (texts > 0 && 2 * numbers <= filled) {
        return Ok(names::read(name, cells, filled));
    }
    Numbers { name, cells, rows }.read()
}

/// A column of numbers.
struct Numbers<'a> {
    name: &'a str,
    cells: &'a [Cell<'a>],
    rows: &'a [usize],
}

impl Numbers<'_> {
    fn read(&self) -> Refused<Column> {
        let unit =
            unit_of(self.name).or_else(|| self.cells.iter().find_map(|cell| self.unit(cell)));
        let (mut values, mut refusals) = (Vec::new(), Vec::new());
        for (cell, row) in self.cells.iter().zip(self.rows) {
            match self.value(cell, unit) {
                Ok(_) if self.is_mark(cell) => {
                    refusals.push(at(*row, self.name, marked(cell.text)))
                }
                Ok(value) => values.push(value),
                Err(message) => refusals.push(at(*row, self.name, message)),
            }
        }
        if !refusals.is_empty() {
            return Err(refusals);
        }
        let mut notes: Vec<String> = self.limits().into_iter().collect();
        let has_unit = |k: usize| self.unit(&self.cells[k]).is_some();
        // Fractions by themselves are a valid scale, in a column not labelled as per cent.
        let is_percent = |(k, value): (usize, &Option<f64>)| {
            has_unit(k) || value.is_some_and(|value| value > 1.0)
        };
        let is_mixed =
            || humidity::is_meant(self.name) && values.iter().enumerate().any(is_percent);
        if self.name == humidity::COLUMN || is_mixed() {
            notes.extend(
                humidity::to_percent(self.name, &mut values, has_unit, |k| self.rows[k])?
                    .map(str::to_owned),
            );
        }
        ends::check(self.name, &values, has_unit, |k| self.rows[k])?;
        let filled = values.iter().flatten().count();
        if filled == 0 {
            return Ok(Column::nothing(0, "it holds limits and no number"));
        }
        if filled < values.len() {
            notes.push(
                "where it is missing, the mean of its session stands in, else that of all"
                    .to_owned(),
            );
        }
        Ok(Column { values: Some(Values::Numbers(values)), filled, note: notes.join("; ") })
    }

    fn unit(&self, cell: &Cell<'_>) -> Option<&'static str> {
        match cell.told {
            Told::Number(_, unit) => unit,
            _ => None,
        }
    }

    fn value(&self, cell: &Cell<'_>, unit: Option<&str>) -> Result<Option<f64>, String> {
        match cell.told {
            Told::Missing | Told::Limit(_) => Ok(None),
            Told::Number(_, Some(is)) if Some(is) != unit => {
                Err(format!("is in {is}, but the column is in {}", unit.unwrap_or("no unit")))
            }
            Told::Number(value, _) if value.abs() <= NUMBER_MAX || self.is_known() => {
                Ok(Some(value))
            }
            Told::Number(..) => {
                Err(format!("must be from -{NUMBER_MAX:e} to {NUMBER_MAX:e}, got `{}`", cell.text))
            }
            Told::TwoNumbers(text) => Err(two_numbers(text)),
            Told::Text(text) if is_no_number(text) => Ok(None),
            Told::Text(text) => Err(format!(
                "must be a number, as most cells of the column are, got `{text}`: correct it or leave it empty; if the cells are names, call the column batch"
            )),
        }
    }

    /// Whether a cell is a logger's placeholder for a missing value, far from everything measured:
    /// -999 where nothing else is negative, or 9999 in several rows where everything else is at
    /// most a tenth of it.
    fn is_mark(&self, cell: &Cell<'_>) -> bool {
        let digits = cell.text.trim_start_matches('-');
        if digits.len() < 2 || digits.bytes().any(|digit| digit != b'9') {
            return false;
        }
        let number = |cell: &Cell<'_>| match cell.told {
            Told::Number(number, _) => Some(number),
            _ => None,
        };
        let Some(mark) = number(cell) else { return false };
        let others: Vec<f64> =
            self.cells.iter().filter(|it| it.text != cell.text).filter_map(number).collect();
        let times = self.cells.iter().filter(|it| it.text == cell.text).count();
        let is_far =
            |other: &f64| if mark < 0.0 { *other >= 0.0 } else { other.abs() <= 0.1 * mark };
        let is_usual = mark < 0.0 || (digits.len() > 2 && times > 1);
        is_usual && !others.is_empty() && others.iter().all(is_far)
    }

    fn is_known(&self) -> bool {
        NUMBERS.iter().any(|(column, ..)| *column == self.name)
    }

    /// The note on limits.
    fn limits(&self) -> Option<String> {
        let is_limit = |(cell, _): &(&Cell<'_>, &usize)| matches!(cell.told, Told::Limit(_));
        let rows: Vec<usize> =
            self.cells.iter().zip(self.rows).filter(is_limit).map(|(_, row)| *row).collect();
        if rows.is_empty() {
            return None;
        }
        let named: Vec<String> = rows.iter().take(ROWS_NAMED).map(usize::to_string).collect();
        let more = if rows.len() > ROWS_NAMED { " and more" } else { "" };
        Some(format!(
            "{} cells are limits such as <5 and count as missing: rows {}{more}",
            rows.len(),
            named.join(", ")
        ))
    }
}
