//! Numbers as laboratories write them.
//!
//! | written | read |
//! |---------|------|
//! | `36.2`, `36,2`, `1e-3`, `−5` | with a decimal point or a decimal comma |
//! | `1,234.5`, `1.234,5`, `1 234,5`, `1'234.5`, `1,234,567` | groups of three digits left out |
//! | `1,234`, `1.234` | may be either: what the column's other cells do decides, else what the file's do ([`Signs`]) |
//! | `47 %`, `24.3 °C`, `5mm` | a number with its unit |
//! | `<5`, `>95` | no number: a limit of what could be measured |

/// Decimal signs that cells show unambiguously.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Signs {
    pub point: bool,
    pub comma: bool,
    /// A whole number of three digits or more without any sign: then 1.013 may be the next
    /// thousand.
    pub hundreds: bool,
}

impl Signs {
    /// The union of both.
    pub fn and(self, other: Self) -> Self {
        Self {
            point: self.point || other.point,
            comma: self.comma || other.comma,
            hundreds: self.hundreds || other.hundreds,
        }
    }

    fn of(mark: char) -> Self {
        Self { point: mark == '.', comma: mark == ',', hundreds: false }
    }

    /// Whether they show `mark` and not the other sign.
    fn is_only(self, mark: char) -> bool {
        (self.point, self.comma) == (mark == '.', mark == ',')
    }

    fn is_silent(self) -> bool {
        !self.point && !self.comma
    }
}

/// A cell that contains a number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Written {
    value: Value,
    /// Its unit, as named by [`unit()`]; none if it has no unit.
    pub unit: Option<&'static str>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Value {
    /// Unambiguous, with the decimal signs it shows.
    Sure(f64, Signs),
    /// `mark` separates either decimals or groups of three digits.
    Either { mark: char, decimal: f64 },
}

/// Content of a cell that is neither empty nor a word for a missing value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Cell {
    Number(Written),
    /// Below or above the measuring range.
    Limit,
    Other,
}

/// Reads a cell.
pub fn cell(text: &str) -> Cell {
    let limit =
        text.strip_prefix(['<', '>', '≤', '≥']).map(|rest| rest.trim_start_matches('=').trim());
    match (limit, written(limit.unwrap_or(text))) {
        (Some(_), Some(_)) => Cell::Limit,
        (None, Some(written)) => Cell::Number(written),
        _ => Cell::Other,
    }
}

impl Written {
    /// Decimal signs that it shows.
    pub fn signs(&self) -> Signs {
        match self.value {
            Value::Sure(_, signs) => signs,
            Value::Either { .. } => Signs::default(),
        }
    }

    /// Its value in a column and a file with these signs; `None` if it is ambiguous.
    ///
    /// Signs in the column take precedence over those in the file. If neither has any, a point is a
    /// decimal point, and a comma a decimal comma unless it also separates cells; but next to 980
    /// there is no telling whether 1.013 is the next thousand.
    pub fn value(&self, column: Signs, file: Signs, separator: u8) -> Option<f64> {
        let Value::Either { mark, decimal } = self.value else {
            let Value::Sure(value, _) = self.value else { return None };
            return Some(value);
        };
        let signs = if column.is_silent() { file } else { column };
        let is_free = (mark == '.' || separator != b',') && !column.hundreds;
        let is_decimal =
            signs.is_only(mark) || (signs.is_silent() && is_free) || (mark == '.' && signs.point);
        is_decimal.then_some(decimal)
    }
}

fn written(text: &str) -> Option<Written> {
    let text = text.trim().replace(['\u{2212}', '\u{fe63}'], "-");
    let is_part = |c: char| c.is_ascii_digit() || ".,' \u{a0}\u{202f}\u{2009}’".contains(c);
    let unsigned = text.trim_start_matches(['+', '-']);
    if text.len() - unsigned.len() > 1 {
        return None;
    }
    let end = unsigned.find(|c| !is_part(c)).unwrap_or(unsigned.len());
    let (digits, rest) = unsigned.split_at(end);
    let (exponent, rest) = exponent(digits, rest);
    let is_apart = digits.ends_with(char::is_whitespace);
    let unit = match rest.trim() {
        "" => None,
        name => Some(unit(name).filter(|_| is_apart || !is_letter(name))?),
    };
    let sign = if text.starts_with('-') { "-" } else { "" };
    let number = |plain: &str| {
        format!("{sign}{plain}{exponent}").parse().ok().filter(|it: &f64| it.is_finite())
    };
    Some(Written { value: value(digits.trim(), exponent.is_empty(), number)?, unit })
}

/// A letter directly after a number is more often part of a name, as in `12C`, than a unit.
fn is_letter(name: &str) -> bool {
    name.len() == 1 && name != "%"
}

/// The exponent at the start of `rest`, and what follows it.
fn exponent<'a>(digits: &str, rest: &'a str) -> (&'a str, &'a str) {
    let Some(after) = rest
        .strip_prefix(['e', 'E'])
        .filter(|_| digits.ends_with(|c: char| c.is_ascii_digit() || ".,".contains(c)))
    else {
        return ("", rest);
    };
    let unsigned = after.strip_prefix(['+', '-']).unwrap_or(after);
    let end = unsigned.find(|c: char| !c.is_ascii_digit()).unwrap_or(unsigned.len());
    if end == 0 { ("", rest) } else { rest.split_at(rest.len() - unsigned.len() + end) }
}

fn value(digits: &str, is_plain: bool, number: impl Fn(&str) -> Option<f64>) -> Option<Value> {
    let marks: Vec<(usize, char)> =
        digits.char_indices().filter(|(_, c)| !c.is_ascii_digit()).collect();
    let is_decimal = |mark: char| ".,".contains(mark);
    match marks.as_slice() {
        [] => {
            let hundreds = is_plain && digits.len() > 2 && !digits.starts_with('0');
            Some(Value::Sure(number(digits)?, Signs { hundreds, ..Signs::default() }))
        }
        [(at, mark)] if is_decimal(*mark) => {
            let (whole, part) = (&digits[..*at], &digits[at + 1..]);
            let decimal = number(&format!("{whole}.{part}"))?;
            let may_group = is_plain
                && part.len() == 3
                && (1..=3).contains(&whole.len())
                && !whole.starts_with('0');
            Some(match may_group {
                true => Value::Either { mark: *mark, decimal },
                false => Value::Sure(decimal, Signs::of(*mark)),
            })
        }
        [.., (at, last)] => {
            // The last mark separates decimals if it differs from all the others.
            let others = &marks[..marks.len() - 1];
            let is_own = is_decimal(*last) && others.iter().all(|(_, mark)| mark != last);
            let (whole, part) =
                if is_own { (&digits[..*at], &digits[at + 1..]) } else { (digits, "") };
            let plain = number(&format!("{}.{part}", ungrouped(whole)?))?;
            let shown = match (is_own, *last) {
                (true, mark) => Signs::of(mark),
                (false, ',') => Signs::of('.'),
                (false, '.') => Signs::of(','),
                (false, _) => Signs::default(),
            };
            Some(Value::Sure(plain, shown))
        }
    }
}

/// The digits without group separators; `None` if the groups are not of three digits, or use two
/// separators.
fn ungrouped(digits: &str) -> Option<String> {
    let mark = digits.chars().find(|c| !c.is_ascii_digit())?;
    let groups: Vec<&str> = digits.split(mark).collect();
    let is_group =
        |group: &&str| group.len() == 3 && group.bytes().all(|byte| byte.is_ascii_digit());
    let first =
        groups.first().filter(|first| (1..=3).contains(&first.len()) && !first.starts_with('0'))?;
    let are_digits = first.bytes().all(|byte| byte.is_ascii_digit());
    (are_digits && groups[1..].iter().all(is_group)).then(|| groups.concat())
}

/// A unit under FLIP's name for it; `None` if it is not known.
fn unit(name: &str) -> Option<&'static str> {
    const UNITS: [(&str, &[&str]); 25] = [
        ("%", &["%", "pct", "percent", "% rh", "%rh", "% r.h.", "% rf", "%rf"]),
        ("deg", &["°", "º", "deg", "degree", "degrees", "grad"]),
        ("deg C", &["°c", "ºc", "℃", "deg c", "degc", "c", "celsius"]),
        ("deg F", &["°f", "ºf", "deg f", "degf", "f"]),
        ("K", &["k", "kelvin"]),
        ("s", &["s", "sec", "secs", "second", "seconds"]),
        ("ms", &["ms"]),
        ("min", &["min", "mins", "minute", "minutes"]),
        ("h", &["h", "hr", "hrs", "hour", "hours"]),
        ("days", &["d", "day", "days"]),
        ("um", &["um", "µm", "μm"]),
        ("mm", &["mm"]),
        ("cm", &["cm"]),
        ("m", &["m"]),
        ("in", &["in", "inch"]),
        ("ug", &["ug", "µg", "μg"]),
        ("mg", &["mg"]),
        ("g", &["g"]),
        ("kg", &["kg"]),
        ("m/s2", &["m/s2", "m/s²", "m/s^2", "m s-2", "m·s⁻²"]),
        ("mm/s2", &["mm/s2", "mm/s²", "mm/s^2"]),
        ("hPa", &["hpa", "mbar"]),
        ("kPa", &["kpa"]),
        ("Hz", &["hz"]),
        ("rpm", &["rpm", "1/min"]),
    ];
    let name = name.to_lowercase();
    UNITS.iter().find(|(_, names)| names.contains(&name.as_str())).map(|(unit, _)| *unit)
}

/// The unit at the end of a column's name.
pub fn unit_of(column: &str) -> Option<&'static str> {
    const ENDINGS: [(&str, &str); 16] = [
        ("_pct", "%"),
        ("_deg", "deg"),
        ("_c", "deg C"),
        ("_min", "min"),
        ("_m_s2", "m/s2"),
        ("_mm", "mm"),
        ("_mg", "mg"),
        ("_g", "g"),
        ("_s", "s"),
        ("_d", "days"),
        ("_h", "h"),
        ("_ms", "ms"),
        ("_um", "um"),
        ("_kpa", "kPa"),
        ("_hpa", "hPa"),
        ("_hz", "Hz"),
    ];
    ENDINGS.iter().find(|(ending, _)| column.ends_with(ending)).map(|(_, unit)| *unit)
}

#[cfg(test)]
mod tests {
    use super::*;

    const COMMA: Signs = Signs { point: false, comma: true, hundreds: false };
    const POINT: Signs = Signs { point: true, comma: false, hundreds: false };
    const NONE: Signs = Signs { point: false, comma: false, hundreds: false };
    const BOTH: Signs = Signs { point: true, comma: true, hundreds: false };

    fn value(text: &str, column: Signs, file: Signs) -> Option<f64> {
        match cell(text) {
            Cell::Number(written) => written.value(column, file, b','),
            other => panic!("{text}: {other:?}"),
        }
    }

    #[test]
    fn a_number_has_a_point_or_a_comma_and_perhaps_groups() {
        for (text, expected) in [
            ("36", 36.0),
            ("36.2", 36.2),
            ("36,2", 36.2),
            ("-0,5", -0.5),
            ("\u{2212}3.25", -3.25),
            ("+7", 7.0),
            (".5", 0.5),
            ("5.", 5.0),
            ("1e-3", 1e-3),
            ("1,5E+03", 1500.0),
            ("0,125", 0.125),
            ("0.125", 0.125),
            ("36,1250", 36.125),
            ("1,234.5", 1234.5),
            ("1.234,5", 1234.5),
            ("1 234,5", 1234.5),
            ("1\u{a0}234", 1234.0),
            ("1'234.5", 1234.5),
            ("1,234,567", 1_234_567.0),
            ("1.234.567", 1_234_567.0),
            ("1770076800", 1_770_076_800.0),
        ] {
            assert_eq!(value(text, NONE, NONE), Some(expected), "{text}");
        }
    }

    #[test]
    fn a_comma_before_three_digits_is_what_the_column_says_else_what_the_file_says() {
        assert_eq!(value("36,125", COMMA, POINT), Some(36.125));
        assert_eq!(value("36,125", NONE, COMMA), Some(36.125));
        for (column, file) in
            [(NONE, NONE), (POINT, COMMA), (BOTH, COMMA), (NONE, POINT), (NONE, BOTH)]
        {
            assert_eq!(value("36,125", column, file), None, "{column:?} {file:?}");
        }
        let Cell::Number(written) = cell("36,125") else { panic!() };
        assert_eq!(
            written.value(NONE, NONE, b';'),
            Some(36.125),
            "commas are free where semicolons separate"
        );
        for (column, file, expected) in [
            (NONE, NONE, Some(36.125)),
            (POINT, COMMA, Some(36.125)),
            (NONE, COMMA, None),
            (COMMA, POINT, None),
        ] {
            assert_eq!(value("36.125", column, file), expected, "{column:?} {file:?}");
        }
    }

    #[test]
    fn a_unit_beside_a_number_is_read_and_a_name_is_no_number() {
        let unit = |text: &str| match cell(text) {
            Cell::Number(written) => Some((written.value(NONE, NONE, b',').unwrap(), written.unit)),
            _ => None,
        };
        for (text, expected) in [
            ("47 %", Some((47.0, Some("%")))),
            ("47%", Some((47.0, Some("%")))),
            ("47,5 % r.h.", Some((47.5, Some("%")))),
            ("24.3 °C", Some((24.3, Some("deg C")))),
            ("36.2°", Some((36.2, Some("deg")))),
            ("5mm", Some((5.0, Some("mm")))),
            ("5 g", Some((5.0, Some("g")))),
            ("12C", None),
            ("12A", None),
            ("B3", None),
            ("3rd", None),
            ("40-50", None),
            ("5±0.1", None),
            ("--5", None),
            ("1,23,4", None),
            ("1.2.3", None),
            ("3.2.2026", None),
            ("1 2", None),
            ("inf", None),
            ("1e999", None),
            ("0x10", None),
            (",", None),
            ("-", None),
            ("e5", None),
        ] {
            assert_eq!(unit(text), expected, "{text}");
        }
        assert_eq!([cell("<5"), cell(">= 95 %"), cell("≤0,5")], [Cell::Limit; 3]);
        assert_eq!([cell("<five"), cell("about 5"), cell("~5")], [Cell::Other; 3]);
    }
}
