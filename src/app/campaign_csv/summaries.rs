//! Rows computed from others: means, SDs and totals below a table or next to its blocks.
//!
//! They are recognized by the powder's name, and by any column of names: one in which every name is
//! that of a summary, or one in which a few are, at most one in [`ONE_IN`], since a mean is made of
//! several runs. There `max` and `n` mark a summary too.

use super::{Cells, NUMBERS, Table};
use crate::app::Result;
use crate::app::csv_file::words::{is_summary, is_surely_summary};
use flip_core::domain::FieldError;
use flip_discover::reading::LeftOut;

/// One summary per this many rows, itself included.
const ONE_IN: usize = 4;

/// Columns that identify summaries, and the rows found.
pub(super) struct Summaries {
    columns: Vec<String>,
    /// Row numbers in the file, the header being row 1.
    pub rows: Vec<u32>,
}

impl Summaries {
    /// The columns of a table that identify summaries, before its rows are read.
    pub fn of(table: &Table) -> Self {
        let is_number =
            |name: &str| name.is_empty() || NUMBERS.iter().any(|(column, ..)| *column == name);
        let others = table
            .columns
            .iter()
            .filter(|name| !is_number(name) && *name != "powder" && tells(table, name));
        Self {
            columns: std::iter::once("powder".to_owned()).chain(others.cloned()).collect(),
            rows: Vec::new(),
        }
    }

    /// Whether a row is a summary; if so it is remembered.
    pub fn has(&mut self, cells: &Cells<'_>) -> bool {
        let is_one = self.columns.iter().any(|column| is_summary(cells.text(column)));
        self.rows.extend(is_one.then_some(cells.row as u32));
        is_one
    }

    /// Checks that the file contains more than summaries.
    ///
    /// # Errors
    /// `runs` is empty.
    pub fn leave_any(&self, runs: usize) -> Result<()> {
        match (runs, self.rows.first()) {
            (0, Some(row)) => {
                let advice = "is called mean, SD or the like, as are all other rows: give one run per row, or the mean of the runs as repose_deg with repose_sd_deg and n";
                Err(FieldError::new(format!("row[{row}]"), advice).into())
            }
            _ => Ok(()),
        }
    }

    /// In the form of the report.
    pub fn told(&self) -> Option<LeftOut> {
        let reason =
            "they are called mean, SD, total or the like: computed of other rows, and no runs";
        (!self.rows.is_empty())
            .then(|| LeftOut { rows: self.rows.clone(), reason: reason.to_owned() })
    }
}

/// Whether a column of names identifies summaries.
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
