//! How the files were read: how each column was interpreted, and what was left out.

use super::sections::{row, section, table};
use super::words::{column_with_unit, text, upper};
use flip_discover::Report;
use flip_discover::reading::{ColumnRead, FileRead, TakenAs};

/// Maximum number of left-out rows that are listed; the document has all.
const ROWS_SHOWN: usize = 20;

pub fn files(report: &Report) -> String {
    section(
        "How the data were read",
        "Each column of the files, what it was taken as, and what does not count.",
        &report.files.iter().map(file).collect::<String>(),
    )
}

fn file(file: &FileRead) -> String {
    let heading =
        format!("<h3>{} <small>{} rows</small></h3>", text(&upper(&file.file)), file.rows);
    let rows: String = file.columns.iter().map(column).collect();
    let columns = table("", &[">Column", ">Taken as", "Filled", "Missing", ">Note"], &rows);
    let left_out = file
        .left_out
        .iter()
        .map(|it| format!("Left out: rows {}: {}.", numbers(&it.rows), it.reason));
    let powders = file.powders.iter().map(|it| format!("Powder “{}” is {}.", it.name, it.id));
    let notes = file.notes.iter().map(|note| format!("{}.", upper(note)));
    let notes: String =
        left_out.chain(notes).chain(powders).map(|it| format!("<li>{}</li>", text(&it))).collect();
    let notes = if notes.is_empty() { notes } else { format!("<ul class=\"plain\">{notes}</ul>") };
    format!("{heading}{columns}{notes}")
}

fn column(it: &ColumnRead) -> String {
    let left = |words: &str| format!("<span class=\"left wrap\">{}</span>", text(words));
    let cells = [
        left(taken_as(it.taken_as)),
        it.filled.to_string(),
        it.missing.to_string(),
        left(&it.note),
    ];
    row(&text(&column_with_unit(&it.column)), &cells)
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
