//! Words that laboratories write in cells: missing values, yes and no, who measured, whether a
//! balance was stable.

use flip_core::domain::powder::Method;

/// Words for a missing value, as written by R, pandas, spreadsheets and people.
const MISSING: [&str; 28] = [
    "NA", "N/A", "n/a", "n.a.", "N.A.", "<NA>", "#N/A", "#N/A N/A", "#NA", "#NV", "NaN", "nan",
    "NAN", "-NaN", "-nan", "NULL", "null", "-", "--", "---", "–", "—", "n.d.", "n. d.", "N.D.",
    "k.A.", "k. A.", "?",
];
/// The same where only numbers belong: in a column of names they may be names.
const NO_NUMBER: [&str; 9] = ["none", "nil", "na", "nd", "n.v.", "missing", ".", "..", "*"];

/// Whether a cell counts as empty.
pub fn is_missing(cell: &str) -> bool {
    cell.is_empty() || MISSING.contains(&cell) || is_error(cell)
}

/// Whether it is a spreadsheet error: `#DIV/0!`, `#VALUE!`, `#NAME?`, in every language.
fn is_error(cell: &str) -> bool {
    let name = cell.strip_prefix('#').and_then(|rest| rest.strip_suffix(['!', '?']));
    name.is_some_and(|name| {
        name.len() >= 3 && name.chars().all(|c| c.is_uppercase() || "/0".contains(c))
    })
}

/// Words that rarely mean anything but a value computed from other rows.
const SURELY: [&str; 16] = [
    "mean",
    "mean value",
    "average",
    "avg",
    "median",
    "sd",
    "s.d",
    "std",
    "std dev",
    "stdev",
    "standard deviation",
    "rsd",
    "sem",
    "mittelwert",
    "stabw",
    "standardabweichung",
];

/// Whether a cell labels a value computed from the rows above it, as in the last rows of a table:
/// `Mean`, `SD`, `Total`, `salt average`.
pub fn is_summary(cell: &str) -> bool {
    /// On their own, in addition to the unambiguous ones.
    const WORDS: [&str; 35] = [
        "all",
        "all powders",
        "all samples",
        "all materials",
        "all runs",
        "all data",
        "alle",
        "alle pulver",
        "ensemble",
        "combined",
        "pooled",
        "insgesamt",
        "std. dev",
        "st dev",
        "st. dev",
        "rsd%",
        "% rsd",
        "%rsd",
        "rsd (%)",
        "cv",
        "cv%",
        "% cv",
        "variance",
        "min",
        "minimum",
        "max",
        "maximum",
        "range",
        "count",
        "n",
        "sum",
        "total",
        "subtotal",
        "summe",
        "moyenne",
    ];
    /// Also next to a name: no powder is called that.
    const BESIDE: [&str; 11] = [
        "overall",
        "mean",
        "average",
        "avg",
        "median",
        "total",
        "subtotal",
        "mittelwert",
        "summe",
        "gesamt",
        "moyenne",
    ];
    let text = plain(cell);
    let mut words = text
        .split(|c: char| c.is_whitespace() || "()_,-".contains(c))
        .filter(|word| !word.is_empty());
    let (first, last) = (words.next().unwrap_or_default(), words.next_back());
    SURELY.contains(&text.as_str())
        || WORDS.contains(&text.as_str())
        || last.is_some_and(|last| BESIDE.contains(&first) || BESIDE.contains(&last))
        || BESIDE.contains(&text.as_str())
}

/// Whether it is one of the unambiguous words: in a column of names there may be a `max` or a
/// `total`.
pub fn is_surely_summary(cell: &str) -> bool {
    SURELY.contains(&plain(cell).as_str())
}

fn plain(cell: &str) -> String {
    cell.trim().trim_end_matches([':', '=', '.']).trim_end().to_lowercase()
}

/// Whether it means a missing value where a number belongs.
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

/// A balance's stability flag. `S`, `ST`: stable; `U`, `US`, `D`, `SD`: unstable, dynamic.
pub fn stable(text: &str) -> Option<bool> {
    match text.to_lowercase().as_str() {
        "s" | "st" | "stable" => Some(true),
        "u" | "us" | "d" | "sd" | "unstable" | "dynamic" => Some(false),
        _ => yes_or_no(text).map(|it| it == "yes"),
    }
}

/// How an angle was measured; an empty cell means by camera, as our own robot does.
pub fn method(text: &str) -> Option<Method> {
    match text.to_lowercase().as_str() {
        "" | "automated" | "automatic" | "auto" | "camera" => Some(Method::Automated),
        "manual" | "hand" | "by hand" | "by_hand" => Some(Method::Manual),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_spreadsheet_could_not_compute_is_missing() {
        for cell in ["#DIV/0!", "#VALUE!", "#REF!", "#NAME?", "#BEZUG!", "#ZÄHL!", "#N/A"] {
            assert!(is_missing(cell), "{cell}");
        }
        for cell in ["#3", "#A!", "# 12", "#lot!", "DIV/0!"] {
            assert!(!is_missing(cell), "{cell}");
        }
    }

    #[test]
    fn a_row_of_means_is_no_powder() {
        for word in [
            "Mean",
            "AVERAGE:",
            "SD",
            "Std. Dev.",
            "Total",
            "Grand Total",
            "salt Average",
            "mean (salt)",
            "% RSD",
            "n",
            "Mittelwert",
            "Overall",
            "overall:",
            "All powders",
            "All",
        ] {
            assert!(is_summary(word), "{word}");
        }
        for powder in [
            "salt",
            "Mannitol SD 200",
            "lactose SD",
            "Std sand",
            "meant",
            "Maxim",
            "totally",
            "NaCl",
            "n-hexatriacontane",
            "allantoin",
            "all-purpose flour",
            "",
        ] {
            assert!(!is_summary(powder), "{powder}");
        }
    }
}
