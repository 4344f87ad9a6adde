//! Rows that say what was computed of others: means, SDs and totals below a table or beside its blocks.
//!
//! What a powder is called tells, and so does any column of names: those in which every name is one of a summary, and those in which a few are, at most
//! one in [`ONE_IN`], as a mean is made of several runs. There `max` and `n` are of a summary too.

use super::{Cells, NUMBERS, Table};
use crate::app::Result;
use crate::app::csv_file::words::{is_summary, is_surely_summary};
use flip_core::domain::FieldError;
use flip_discover::reading::LeftOut;

/// Rows to each that a summary is made of, with it.
const ONE_IN: usize = 4;

/// Where summaries are told, and the rows that are.
pub(super) struct Summaries {
    columns: Vec<String>,
    /// Of the file, the header being row 1.
    pub rows: Vec<u32>,
}

impl Summaries {
    /// Those of a table, before its rows are read.
    pub fn of(table: &Table) -> Self {
        let is_number = |name: &str| name.is_empty() || NUMBERS.iter().any(|(column, ..)| *column == name);
        let others = table.columns.iter().filter(|name| !is_number(name) && *name != "powder" && tells(table, name));
        Self { columns: std::iter::once("powder".to_owned()).chain(others.cloned()).collect(), rows: Vec::new() }
    }

    /// Whether a row is one; it is remembered.
    pub fn has(&mut self, cells: &Cells<'_>) -> bool {
        let is_one = self.columns.iter().any(|column| is_summary(cells.text(column)));
        self.rows.extend(is_one.then_some(cells.row as u32));
        is_one
    }

    /// A file has more than summaries.
    ///
    /// # Errors
    /// None of `runs`.
    pub fn leave_any(&self, runs: usize) -> Result<()> {
        match (runs, self.rows.first()) {
            (0, Some(row)) => {
                let advice = "is called mean, SD or the like, as are all others: give runs, one a row, or their mean as repose_deg with repose_sd_deg and n";
                Err(FieldError::new(format!("row[{row}]"), advice).into())
            }
            _ => Ok(()),
        }
    }

    /// As the report has it.
    pub fn told(&self) -> Option<LeftOut> {
        let reason = "they are called mean, SD, total or the like: computed of other rows, and no runs";
        (!self.rows.is_empty()).then(|| LeftOut { rows: self.rows.clone(), reason: reason.to_owned() })
    }
}

/// Whether a column of names tells summaries.
fn tells(table: &Table, column: &str) -> bool {
    let (mut filled, mut summaries, mut sure) = (0, 0, 0);
    for cells in table.rows().filter(|cells| cells.holds(column)) {
        let text = cells.text(column);
        filled += 1;
        summaries += usize::from(is_summary(text));
        sure += usize::from(is_surely_summary(text));
    }
    sure > 0 && (summaries == filled || ONE_IN * sure <= filled)
}
