//! Words that laboratories write in cells: what is missing, yes and no, who measured, whether a balance stood.

use crate::domain::powder::Method;

/// A cell that says that there is nothing to say, as R, pandas, spreadsheets and people write it.
const MISSING: [&str; 28] = [
    "NA", "N/A", "n/a", "n.a.", "N.A.", "<NA>", "#N/A", "#N/A N/A", "#NA", "#NV", "NaN", "nan", "NAN", "-NaN", "-nan",
    "NULL", "null", "-", "--", "---", "–", "—", "n.d.", "n. d.", "N.D.", "k.A.", "k. A.", "?",
];
/// The same where only numbers belong: of a column of names they may be names.
const NO_NUMBER: [&str; 9] = ["none", "nil", "na", "nd", "n.v.", "missing", ".", "..", "*"];

/// Whether a cell is as good as empty.
pub fn is_missing(cell: &str) -> bool {
    cell.is_empty() || MISSING.contains(&cell)
}

/// Whether it is where a number belongs.
pub fn is_no_number(cell: &str) -> bool {
    NO_NUMBER.contains(&cell.to_ascii_lowercase().as_str())
}

/// Yes and no as laboratories write them.
pub fn yes_or_no(text: &str) -> Option<&'static str> {
    match text.to_lowercase().as_str() {
        "1" | "1.0" | "true" | "t" | "yes" | "y" | "on" => Some("yes"),
        "0" | "0.0" | "false" | "f" | "no" | "n" | "off" => Some("no"),
        _ => None,
    }
}

/// What a balance says of a reading: whether it stood. `S`, `ST`: stable; `U`, `US`, `D`, `SD`: not, dynamic.
pub fn stable(text: &str) -> Option<bool> {
    match text.to_lowercase().as_str() {
        "s" | "st" | "stable" => Some(true),
        "u" | "us" | "d" | "sd" | "unstable" | "dynamic" => Some(false),
        _ => yes_or_no(text).map(|it| it == "yes"),
    }
}

/// How an angle was measured; an empty cell is by camera, as our own robot does it.
pub fn method(text: &str) -> Option<Method> {
    match text.to_lowercase().as_str() {
        "" | "automated" | "automatic" | "auto" | "camera" => Some(Method::Automated),
        "manual" | "hand" | "by hand" | "by_hand" => Some(Method::Manual),
        _ => None,
    }
}
