//! How the files were read: how each column was interpreted, and what was left out.

use super::table::{left, right, row, section, table, wrapped};
use super::words::{column_with_unit, upper};
use flip_discover::Report;
use flip_discover::reading::{ColumnRead, FileRead, TakenAs};
use maud::{Markup, html};

/// Maximum number of left-out rows that are listed; the document has all.
const ROWS_SHOWN: usize = 20;

pub fn files(report: &Report) -> Markup {
    section(
        "How the data were read",
        "How each column of the files was interpreted, and what was ignored.",
        &html! { @for it in &report.files { (file(it)) } },
    )
}

fn file(file: &FileRead) -> Markup {
    let headings =
        [left("Column"), left("Read as"), right("Filled"), right("Missing"), left("Note")];
    let columns: Vec<Markup> = file.columns.iter().map(column).collect();
    let left_out = file
        .left_out
        .iter()
        .map(|it| format!("Left out: rows {}: {}.", numbers(&it.rows), it.reason));
    let powders = file.powders.iter().map(|it| format!("Powder “{}” is {}.", it.name, it.id));
    let notes = file.notes.iter().map(|note| format!("{}.", upper(note)));
    let notes: Vec<String> = left_out.chain(notes).chain(powders).collect();
    html! {
        h3 { (upper(&file.file)) " " small { (file.rows) " rows" } }
        (table(&format!("Columns of {}", file.file), "", &headings, &columns))
        @if !notes.is_empty() { ul.plain { @for note in notes { li { (note) } } } }
    }
}

fn column(it: &ColumnRead) -> Markup {
    let cells = [
        wrapped(taken_as(it.taken_as)),
        html! { (it.filled) },
        html! { (it.missing) },
        wrapped(&it.note),
    ];
    row(column_with_unit(&it.column), &cells)
}

fn taken_as(what: TakenAs) -> &'static str {
    match what {
        TakenAs::Subject => "what was measured",
        TakenAs::Measured => "measured",
        TakenAs::Session => "session",
        TakenAs::Numbers => "numbers",
        TakenAs::Names => "names",
        TakenAs::Nothing => "left out",
    }
}

fn numbers(rows: &[u32]) -> String {
    let named: Vec<String> = rows.iter().take(ROWS_SHOWN).map(u32::to_string).collect();
    let more = rows.len().saturating_sub(ROWS_SHOWN);
    named.join(", ") + &if more > 0 { format!(" and {more} more") } else { String::new() }
}
