//! Text tables for people: left-aligned words, right-aligned numbers.

/// A table with a header; every row has as many cells as the header.
pub(super) fn table(header: &[&str], rows: &[Vec<String>]) -> String {
    let columns: Vec<Column> =
        (0..header.len()).map(|index| Column::of(header, rows, index)).collect();
    let header: Vec<String> = header.iter().map(|cell| (*cell).to_owned()).collect();
    let rule: Vec<String> = columns.iter().map(|column| "-".repeat(column.width)).collect();
    let lines = [&header, &rule].into_iter().chain(rows).map(|row| line(row, &columns));
    lines.collect::<Vec<_>>().join("\n")
}

struct Column {
    width: usize,
    /// Whether every cell below the header starts like a number.
    numbers: bool,
}

impl Column {
    fn of(header: &[&str], rows: &[Vec<String>], index: usize) -> Self {
        let cells = || rows.iter().filter_map(|row| row.get(index));
        let widths =
            cells().map(|cell| cell.chars().count()).chain([header[index].chars().count()]);
        let is_number =
            |cell: &String| cell.starts_with(|c: char| c.is_ascii_digit() || c == '-' || c == '+');
        Self { width: widths.max().unwrap_or(0), numbers: cells().all(is_number) }
    }
}

fn line(row: &[String], columns: &[Column]) -> String {
    let pad = |(cell, column): (&String, &Column)| {
        let space = " ".repeat(column.width.saturating_sub(cell.chars().count()));
        if column.numbers { format!("{space}{cell}") } else { format!("{cell}{space}") }
    };
    row.iter().zip(columns).map(pad).collect::<Vec<_>>().join("  ").trim_end().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_go_left_and_numbers_go_right() {
        let rows = [
            vec!["sand".to_owned(), "14.9".to_owned()],
            vec!["semolina".to_owned(), "-0.25".to_owned()],
        ];
        assert_eq!(
            table(&["powder", "mg"], &rows),
            "powder       mg\n--------  -----\nsand       14.9\nsemolina  -0.25"
        );
    }
}
