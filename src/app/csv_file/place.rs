//! Row number of a record in the file, as a spreadsheet counts.

/// Counts rows: blank ones count, line breaks within cells do not.
pub(super) struct Place<'a> {
    text: &'a [u8],
    /// Row of the last record.
    row: usize,
    /// Number of bytes in which line breaks have been counted.
    seen: usize,
    lines: usize,
    /// Line breaks within cells.
    inside: usize,
}

impl<'a> Place<'a> {
    /// Starts after the header.
    pub fn new(text: &'a str, header: &csv::StringRecord) -> Self {
        Self { text: text.as_bytes(), row: 1, seen: 0, lines: 0, inside: line_breaks(header) }
    }

    /// Row of a record.
    pub fn of(&mut self, record: &csv::StringRecord) -> usize {
        let row = self.row_at(record.position());
        self.inside += line_breaks(record);
        row
    }

    /// Row of the record found by the reader from `position` on: blank lines before it are skipped.
    pub fn row_at(&mut self, position: Option<&csv::Position>) -> usize {
        let start = position
            .map_or(self.seen, |position| position.byte() as usize)
            .clamp(self.seen, self.text.len());
        let blank =
            self.text[start..].iter().take_while(|byte| matches!(byte, b'\r' | b'\n')).count();
        self.lines +=
            self.text[self.seen..start + blank].iter().filter(|byte| **byte == b'\n').count();
        self.seen = start + blank;
        // A file that predates line feeds has none to count.
        self.row = (self.row + 1).max((1 + self.lines).saturating_sub(self.inside));
        self.row
    }
}

fn line_breaks(record: &csv::StringRecord) -> usize {
    record.iter().map(|cell| cell.matches('\n').count()).sum()
}
