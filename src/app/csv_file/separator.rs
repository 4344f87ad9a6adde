//! The separator of a file's cells.

/// Possible separators, in order of preference where a header does not decide.
const SEPARATORS: [u8; 4] = [b',', b';', b'\t', b'|'];

/// The separator that yields the most known columns in a header, else the most columns.
pub(super) fn separator(header: &str, is_known: impl Fn(&str) -> bool) -> u8 {
    let columns = |mark: u8| {
        let names = names(header, mark);
        (names.iter().filter(|name| is_known(name)).count(), names.len())
    };
    // `max_by_key` returns the last of equal maxima.
    SEPARATORS.into_iter().rev().max_by_key(|mark| columns(*mark)).unwrap_or(b',')
}

/// The cells of a header, if `mark` separates them.
fn names(header: &str, mark: u8) -> Vec<String> {
    let reader =
        csv::ReaderBuilder::new().delimiter(mark).has_headers(false).from_reader(header.as_bytes());
    let record = reader.into_records().next();
    record
        .and_then(Result::ok)
        .map_or(Vec::new(), |record| record.iter().map(str::to_owned).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_header_tells_what_separates_cells() {
        let of = |header| {
            separator(header, |name| ["powder", "repose_deg", "n"].contains(&name)) as char
        };
        assert_eq!(of("powder,repose_deg,n"), ',');
        assert_eq!(of("powder;repose_deg"), ';');
        assert_eq!(of("powder\trepose_deg"), '\t');
        assert_eq!(of("powder|repose_deg"), '|');
        assert_eq!(
            of("powder;repose_deg;remark, free, or; not"),
            ';',
            "more commas, fewer known columns"
        );
        assert_eq!(of("\"powder\";\"a;b\";repose_deg"), ';');
        assert_eq!(of("powder"), ',');
        assert_eq!(of("Pulver;Winkel"), ';', "nothing is known: what makes most columns");
    }
}
