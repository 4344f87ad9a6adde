//! Decimal text and unit to milligrams, without loss.
//!
//! A display shows a decimal number. Shifting its decimal point according to the unit and parsing
//! the text once yields the nearest `f64`; multiplying an already parsed number would round twice
//! (`100.0003 * 1000.0` is not `100000.3`).

use serde::{Deserialize, Serialize};

/// Longest number accepted, digits: every shorter one has an `f64` of its own.
const DIGITS_MAX: usize = 15;

/// Units supported by FLIP. Every other unit is refused by name.
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
    /// The unit that a balance writes as `name`.
    pub fn named(name: &[u8]) -> Option<Self> {
        match name {
            b"mg" => Some(Self::Milligram),
            b"g" => Some(Self::Gram),
            b"kg" => Some(Self::Kilogram),
            _ => None,
        }
    }

    /// Places by which the decimal point shifts when converting to mg.
    fn places(self) -> i32 {
        match self {
            Self::Milligram => 0,
            Self::Gram => 3,
            Self::Kilogram => 6,
        }
    }
}

/// Display steps, in its last place.
pub const STEPS: [i64; 3] = [1, 2, 5];

/// Whether a number matches the step of a display.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fit {
    /// It does.
    Fits,
    /// Its last place is not the one in which the display steps.
    OtherPlace,
    /// It lies between two steps.
    Between,
}

/// A number as shown, without spaces: `-12.340`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Decimal {
    text: String,
    decimals: i32,
}

impl Decimal {
    /// Parse an optional sign, optional spaces, and digits with at most one decimal point: no
    /// exponent, no names such as NaN. A comma counts as a point: displays are set to either and
    /// never group digits. The last digit may be in brackets, like the auxiliary digit of a
    /// verified balance.
    pub fn parse(text: &[u8]) -> Option<Self> {
        let (sign, rest) = match text.first()? {
            b'+' => ("", &text[1..]),
            b'-' => ("-", &text[1..]),
            _ => ("", text),
        };
        let digits = unbracketed(std::str::from_utf8(rest).ok()?.trim_start_matches(' '))?;
        let (whole, part) = digits.split_once(['.', ',']).unwrap_or((&digits, ""));
        let count = whole.len() + part.len();
        let all_digits = whole.bytes().chain(part.bytes()).all(|byte| byte.is_ascii_digit());
        if whole.is_empty() || !all_digits || count > DIGITS_MAX {
            return None;
        }
        let text = format!("{sign}{}", digits.replace(',', "."));
        Some(Self { text, decimals: i32::try_from(part.len()).ok()? })
    }

    /// Check the number against `step_mg`, for a display that steps by 1, 2 or 5 in its last place.
    pub fn is_in_steps_of(&self, step_mg: f64, unit: Unit) -> Fit {
        let last_place_mg = self.last_place_mg(unit);
        match STEPS.into_iter().find(|step| is_same(*step as f64 * last_place_mg, step_mg)) {
            None => Fit::OtherPlace,
            Some(step) if self.in_last_places() % step == 0 => Fit::Fits,
            Some(_) => Fit::Between,
        }
    }

    /// The number without its decimal point: `-12340` for `-12.340`.
    pub fn in_last_places(&self) -> i64 {
        // At most 15 digits.
        self.text.replace('.', "").parse().unwrap_or_default()
    }

    /// The nearest number of mg; zero has no sign.
    pub fn mg(&self, unit: Unit) -> f64 {
        nearest(&format!("{}e{}", self.text, unit.places())) + 0.0
    }

    /// The last place shown, mg: 1 for `0.000 g`.
    pub fn last_place_mg(&self, unit: Unit) -> f64 {
        place_mg(unit, self.decimals)
    }

    /// Digits after the decimal point.
    pub fn decimals(&self) -> i32 {
        self.decimals
    }
}

/// `12.0000` for `12.000[0]`.
fn unbracketed(digits: &str) -> Option<String> {
    let Some((before, last)) = digits.split_once('[') else { return Some(digits.to_owned()) };
    let last = last.strip_suffix(']').filter(|last| last.len() == 1)?;
    Some(format!("{before}{last}"))
}

/// Equal up to the rounding of a setting written in decimal.
pub fn is_same(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-9 * b.abs()
}

/// One step in the last of this many decimals, mg.
pub fn place_mg(unit: Unit, decimals: i32) -> f64 {
    nearest(&format!("1e{}", unit.places() - decimals))
}

/// Text accepted by [`Decimal::parse`] always parses as `f64` as well.
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
            ("12,0001", Gram, 12_000.1),
            ("-0,0150", Gram, -15.0),
            ("12.000[3]", Gram, 12_000.3),
            ("-12,00[5]", Gram, -12_005.0),
            ("220.0000", Gram, 220_000.0),
        ] {
            assert_eq!(
                Decimal::parse(text.as_bytes()).map(|number| number.mg(unit)),
                Some(mg),
                "{text}"
            );
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
        for (text, unit, mg) in [
            ("0.000", Gram, 1.0),
            ("0.0000", Gram, 0.1),
            ("0.1", Milligram, 0.1),
            ("0.000001", Kilogram, 1.0),
        ] {
            assert_eq!(Decimal::parse(text.as_bytes()).unwrap().last_place_mg(unit), mg, "{text}");
        }
    }

    #[test]
    fn steps_of_one_two_and_five_in_the_last_place_are_known() {
        let fit = |text: &str, step_mg: f64| {
            Decimal::parse(text.as_bytes()).unwrap().is_in_steps_of(step_mg, Gram)
        };
        for text in ["12.0000", "12.0005", "-12.0010", "0.0000"] {
            assert_eq!((fit(text, 0.5), fit(text, 0.1)), (Fit::Fits, Fit::Fits), "{text}");
        }
        assert_eq!((fit("12.0003", 0.5), fit("12.0003", 0.2)), (Fit::Between, Fit::Between));
        assert_eq!((fit("12.0004", 0.2), fit("12.00[2]", 2.0)), (Fit::Fits, Fit::Fits));
        assert_eq!((fit("12.000", 0.5), fit("12.0005", 1.0)), (Fit::OtherPlace, Fit::OtherPlace));
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
            "1,234.5",
            "1,2,3",
            "12.00[00]",
            "12.000[]",
            "12.000[0",
            "12.0000]",
            "1[2].0",
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
