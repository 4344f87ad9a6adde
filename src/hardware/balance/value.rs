//! Decimal text and unit to milligrams, without loss.
//!
//! A display shows a decimal number. Moving its point by the unit and reading the text once gives the nearest `f64`; multiplying a number that was read
//! before would round twice (`100.0003 * 1000.0` is not `100000.3`).

use serde::{Deserialize, Serialize};

/// Longest number that is believed, digits: every shorter one has an `f64` of its own.
const DIGITS_MAX: usize = 15;

/// Units that FLIP weighs in. Every other unit is refused by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Unit {
    /// mg
    #[serde(rename = "mg")]
    Milligram,
    /// g
    #[serde(rename = "g")]
    Gram,
    /// kg
    #[serde(rename = "kg")]
    Kilogram,
}

impl Unit {
    /// The unit that a balance writes this way.
    pub fn named(name: &[u8]) -> Option<Self> {
        match name {
            b"mg" => Some(Self::Milligram),
            b"g" => Some(Self::Gram),
            b"kg" => Some(Self::Kilogram),
            _ => None,
        }
    }

    /// Places by which the point moves on the way to mg.
    fn places(self) -> i32 {
        match self {
            Self::Milligram => 0,
            Self::Gram => 3,
            Self::Kilogram => 6,
        }
    }
}

/// A number as it was shown, without blanks: `-12.340`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Decimal {
    text: String,
    decimals: i32,
}

impl Decimal {
    /// The number if this is a sign or none, blanks or none, and digits with at most one point: no exponent, no comma, no name of a number.
    pub fn parse(text: &[u8]) -> Option<Self> {
        let (sign, rest) = match text.first()? {
            b'+' => ("", &text[1..]),
            b'-' => ("-", &text[1..]),
            _ => ("", text),
        };
        let digits = std::str::from_utf8(rest).ok()?.trim_start_matches(' ');
        let (whole, part) = digits.split_once('.').unwrap_or((digits, ""));
        let count = whole.len() + part.len();
        let all_digits = whole.bytes().chain(part.bytes()).all(|byte| byte.is_ascii_digit());
        if whole.is_empty() || !all_digits || count > DIGITS_MAX {
            return None;
        }
        Some(Self { text: format!("{sign}{digits}"), decimals: i32::try_from(part.len()).ok()? })
    }

    /// The nearest number of mg; zero has no sign.
    pub fn mg(&self, unit: Unit) -> f64 {
        nearest(&format!("{}e{}", self.text, unit.places())) + 0.0
    }

    /// The last place that is shown, mg: 1 for `0.000 g`.
    pub fn last_place_mg(&self, unit: Unit) -> f64 {
        place_mg(unit, self.decimals)
    }

    /// Digits after the point.
    pub fn decimals(&self) -> i32 {
        self.decimals
    }
}

/// One step in the last of so many decimals, mg.
pub fn place_mg(unit: Unit, decimals: i32) -> f64 {
    nearest(&format!("1e{}", unit.places() - decimals))
}

/// Text that [`Decimal::parse`] has let through is a number to `f64` as well.
fn nearest(text: &str) -> f64 {
    text.parse().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;
    use Unit::{Gram, Kilogram, Milligram};

    #[test]
    fn a_shown_mass_becomes_the_nearest_number_of_mg() {
        for (text, unit, mg) in [
            ("100.0003", Gram, 100_000.3),
            ("0.0001", Gram, 0.1),
            ("0.0003", Gram, 0.3),
            ("1.1234567", Gram, 1123.4567),
            ("0.29", Gram, 290.0),
            ("-12.340", Gram, -12_340.0),
            ("- 12.340", Gram, -12_340.0),
            ("+00123.456", Gram, 123_456.0),
            ("15.3", Milligram, 15.3),
            ("7", Milligram, 7.0),
            ("5.", Gram, 5000.0),
            ("0.0152873", Kilogram, 15_287.3),
            ("220.0000", Gram, 220_000.0),
        ] {
            assert_eq!(Decimal::parse(text.as_bytes()).map(|number| number.mg(unit)), Some(mg), "{text}");
        }
    }

    #[test]
    fn every_display_step_of_a_balance_is_exact() {
        for tenths in 0..20_000_i64 {
            let shown = format!("{}.{:04}", tenths / 10_000, tenths % 10_000);
            let mg: f64 = format!("{}.{}", tenths / 10, tenths % 10).parse().unwrap();
            assert_eq!(Decimal::parse(shown.as_bytes()).unwrap().mg(Gram), mg, "{shown}");
        }
    }

    #[test]
    fn minus_nothing_is_nothing() {
        let zero = Decimal::parse(b"-0.0000").unwrap().mg(Gram);
        assert!(zero == 0.0 && zero.is_sign_positive());
    }

    #[test]
    fn the_last_place_is_that_of_the_text_in_its_unit() {
        for (text, unit, mg) in
            [("0.000", Gram, 1.0), ("0.0000", Gram, 0.1), ("0.1", Milligram, 0.1), ("0.000001", Kilogram, 1.0)]
        {
            assert_eq!(Decimal::parse(text.as_bytes()).unwrap().last_place_mg(unit), mg, "{text}");
        }
    }

    #[test]
    fn what_is_no_decimal_number_is_refused() {
        for text in [
            "",
            "-",
            "+",
            ".",
            ".5",
            "1e5",
            "NaN",
            "inf",
            "1,5",
            "1.2.3",
            "0x10",
            "--1",
            "1 2",
            "1 ",
            "9999999E+19",
            "1234567890123456",
            "\u{663}",
        ] {
            assert_eq!(Decimal::parse(text.as_bytes()), None, "{text}");
        }
    }
}
