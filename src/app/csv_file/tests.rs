//! Files in the formats that laboratories write, and the errors of those that are refused.

use super::*;

const COLUMNS: Columns<'_> = Columns {
    required: &["a"],
    known: |name| match name {
        "a" | "long_name" => Some(Holds::Text),
        "x_mm" => Some(Holds::Numbers),
        _ => None,
    },
    meant: |letters| (letters == "length").then_some("x_mm"),
    most: 4,
};

fn open(text: &str) -> Result<Table> {
    Table::open(text, &COLUMNS, |_, _| {})
}

fn refused(text: &str) -> String {
    match open(text) {
        Err(error) => error.to_string(),
        Ok(_) => panic!("{text:?} was read"),
    }
}

#[test]
fn rows_are_counted_as_a_spreadsheet_counts_them() {
    let rows = |text: &str| {
        open(text).map(|table| {
            table.rows().map(|cells| (cells.row, cells.text("a").to_owned())).collect::<Vec<_>>()
        })
    };
    for (text, expected) in [
        ("a\nx\ny\n", [(2, "x"), (3, "y")]),
        ("a\nx\n\n\ny", [(2, "x"), (5, "y")]),
        ("\u{feff}a,b\r\n\r\nx,1\r\n,\r\ny,2\r\n", [(3, "x"), (5, "y")]),
        ("a,\"b\nc\"\nx,\"1\n2\n3\"\ny,2\n", [(2, "x"), (3, "y")]),
        ("a\rx\ry\r", [(2, "x"), (3, "y")]),
        ("sep=;\r\na;b\r\nx;1\r\ny;2\r\n\u{1a}", [(2, "x"), (3, "y")]),
    ] {
        let expected = expected.map(|(row, cell)| (row, cell.to_owned()));
        assert_eq!(rows(text).unwrap(), expected, "{text:?}");
    }
}

#[test]
fn empty_columns_at_the_end_are_none_and_a_row_of_another_length_is_refused() {
    for text in ["a,b,,\nx,1,,\n", "a,b,,\nx,1\n", "a,b\nx,1,,\n", "a,b,,,,,,,\nx,1\n"] {
        let table = open(text).unwrap_or_else(|error| panic!("{text:?}: {error}"));
        assert_eq!(
            table.rows().map(|cells| cells.text("b").to_owned()).collect::<Vec<_>>(),
            ["1"],
            "{text:?}"
        );
    }
    assert!(refused("a,b\n\n1,2\n\n1\n").contains("row[5]: has 1 cells where the header has 2"));
    assert!(refused("a,b\n1,2,3\n").contains("row[2]: has 3 cells where the header has 2"));
    assert!(
        refused("a,,b\n1,stray,2\n").contains("row[2]: holds `stray` in a column without a name")
    );
}

#[test]
fn known_columns_are_found_whatever_the_case_of_their_names() {
    let table = open("A; Long Name ;X_MM;Other One\nx;y;1,5;z\n").unwrap();
    assert_eq!(table.columns, ["a", "long_name", "x_mm", "Other One"]);
    assert_eq!(table.rows().next().unwrap().number("x_mm"), Ok(1.5));
    // Non-breaking and invisible blanks.
    let hidden = open("\u{200b}A;Long\u{a0}Name;\u{feff}x_mm\nx\u{200b};y;1,5\n").unwrap();
    assert_eq!(hidden.columns, ["a", "long_name", "x_mm"]);
    assert_eq!(hidden.rows().next().unwrap().text("a"), "x");
    assert!(refused("a,A\n1,2\n").contains("a: appears twice in the header"));
    assert!(refused("b\n1\n").contains("a: is missing in the header"));
    assert!(refused("a,b,c,d,e\n1,2,3,4,5\n").contains("header: has 5 columns"));
}

#[test]
fn a_number_is_in_the_unit_of_its_column() {
    let number = |cell: &str| {
        open(&format!("a\tx_mm\nx\t{cell}\n")).unwrap().rows().next().unwrap().number("x_mm")
    };
    assert_eq!((number("1.5"), number("1,5 mm"), number("1,125")), (Ok(1.5), Ok(1.5), Ok(1.125)));
    for (cell, message) in [
        ("1.5 cm", "is in cm, but the column is in mm"),
        ("<5", "is a limit, `<5`, not a number: leave it empty, or leave the row out"),
        ("NA", "is missing"),
        ("none", "is missing"),
        ("wide", "must be a number, got `wide`"),
    ] {
        assert_eq!(number(cell).unwrap_err(), at(2, "x_mm", message), "{cell}");
    }
    let table = open("a,x_mm\nx,\"1,125\"\ny,2.5\n").unwrap();
    let message = "may be 1.125 or 1125: write it as one of these";
    assert_eq!(table.rows().next().unwrap().number("x_mm").unwrap_err(), at(2, "x_mm", message));
}

#[test]
fn a_file_has_as_many_bytes_and_rows_as_are_read() {
    assert!(open(&format!("a\n{}", "x\n".repeat(20_000))).is_ok());
    assert!(
        refused(&format!("a\n{}", "x\n".repeat(20_001))).contains("row[20002]: is one too many")
    );
    assert!(
        refused(&format!("a\n{}", "x".repeat(TABLE_BYTES_MAX))).contains("file: has 8388610 bytes")
    );
    assert!(refused("a\n").contains("row[2]: is missing"));
}
