//! The plain names of causes, columns and laws, used by the sentences, the report and the page
//! alike.
//!
//! `web/src/names.json` is generated from them, and a test compares the two.

use serde_json::{Value, json};

/// Suffixes of columns, longest first, and their units.
const UNITS: [(&str, &str); 18] = [
    ("_m_s2", "m/s²"),
    ("_pct", "%"),
    ("_deg", "°"),
    ("_min", "min"),
    ("_hpa", "hPa"),
    ("_kpa", "kPa"),
    ("_mm", "mm"),
    ("_um", "µm"),
    ("_mg", "mg"),
    ("_ms", "ms"),
    ("_pa", "Pa"),
    ("_hz", "Hz"),
    ("_c", "°C"),
    ("_d", "d"),
    ("_g", "g"),
    ("_h", "h"),
    ("_s", "s"),
    ("_v", "V"),
];

/// Columns whose names differ from the words a chemist would use.
const COLUMNS: [(&str, &str); 6] = [
    ("rest_min", "Time at rest"),
    ("container_age_d", "Time since opening"),
    ("vibration_rms_m_s2", "Vibration (rms)"),
    ("plate", "Base plate"),
    ("ioniser_on", "Ioniser"),
    ("method", "Method of measuring"),
];

/// Causes whose names differ from the words a chemist would use. Each can be the subject of a
/// sentence.
const CAUSES: [(&str, &str); 23] = [
    ("rest_time", "Consolidation at rest"),
    ("densification", "Densification by shaking"),
    ("humid_ageing", "Ageing at rest in humid air"),
    ("container_age", "Ageing since opening"),
    ("batch", "Batch or grain size"),
    ("polydispersity", "Spread of grain sizes"),
    ("rolling_resistance", "Grain shape (rolling resistance)"),
    ("charge", "Electrostatic charge"),
    ("cohesion", "Attraction between grains"),
    ("consolidation", "Strengthening of old contacts"),
    ("stickiness", "Attraction between grains and to the spoon"),
    ("shape", "Grain shape"),
    ("size_spread", "Spread of grain sizes"),
    ("spoon_adhesion", "Adhesion to the spoon"),
    ("gravity_scale", "Gravity of the calibrated set"),
    ("balance_static", "Charge at the balance"),
    ("spoon_holdup", "Powder held up on the spoon"),
    ("method_bias", "Bias of the measuring method"),
    ("operator", "Difference between operators"),
    ("base_friction", "Friction of the base plate"),
    ("creep", "Creep of simulated heaps"),
    ("order", "Order in the session"),
    ("unrecorded", "Unknown cause, with nothing recorded"),
];

/// Laws of what no cause explains.
const FORMS: [(&str, &str); 6] = [
    ("linear", "a straight line"),
    ("power", "a power"),
    ("threshold", "a step"),
    ("saturating", "towards a limit"),
    ("periodic", "a wave"),
    ("smooth", "smooth, of no simpler form"),
];

/// What each confidence level means, from 1 on.
const LEVELS: [&str; 3] = [
    "its pattern is in the data",
    "the simulator extended by it predicts better what it was not fitted to",
    "an intervention confirmed it",
];

/// Fitted numbers whose names are not words: the effect, and amplitudes of the simulator's
/// mechanisms.
const PARAMETERS: [(&str, &str); 11] = [
    ("effect_5_95", "Change from the 5th to the 95th percentile"),
    ("flow_effect_5_95", "Change of the flow time from the 5th to the 95th percentile"),
    ("creep_deg_per_decade", "Change of the angle with every tenfold of the settling time"),
    ("humidity", "Strength of liquid bridges in the simulator"),
    ("consolidation", "Strengthening of old contacts in the simulator"),
    ("charge", "Attraction by charge in the simulator"),
    ("vibration_g", "Vibration in the simulator"),
    ("size_spread", "Spread of grain sizes in the simulator"),
    ("cohesion", "Change of cohesion in the simulator"),
    ("funnel_clearance", "Added height of the funnel in the simulator"),
    ("base_friction", "Change of base friction in the simulator"),
];

/// Letters that stand for columns in the laws of the catalogue.
const SYMBOLS: [(&str, &str); 7] = [
    ("relative_humidity_pct", "h"),
    ("rest_min", "t"),
    ("container_age_d", "a"),
    ("temperature_c", "T"),
    ("vibration_rms_m_s2", "v"),
    ("funnel_height_mm", "H"),
    ("order_in_session", "k"),
];

/// The whole table, as the page uses it.
pub fn table() -> Value {
    let map = |pairs: &[(&str, &str)]| {
        Value::Object(pairs.iter().map(|&(k, v)| (k.to_owned(), v.into())).collect())
    };
    json!({
        "units": UNITS.to_vec(), "columns": map(&COLUMNS), "causes": map(&CAUSES), "levels": LEVELS,
        "parameters": map(&PARAMETERS),
    })
}

fn named(table: &[(&'static str, &'static str)], name: &str) -> Option<String> {
    table.iter().find(|(key, _)| *key == name).map(|(_, plain)| (*plain).to_owned())
}

/// `sodium_bicarbonate` as words.
pub fn words(name: &str) -> String {
    let spaced = name.replace(['_', '-'], " ");
    let mut letters = spaced.chars();
    match letters.next() {
        Some(first) => first.to_uppercase().chain(letters).collect(),
        None => spaced,
    }
}

/// Lower-cases the first letter, for the middle of a sentence.
pub fn lower(phrase: &str) -> String {
    let mut letters = phrase.chars();
    letters.next().map_or_else(String::new, |first| first.to_lowercase().chain(letters).collect())
}

/// What a column holds, and its unit.
pub fn column(name: &str) -> (String, &'static str) {
    let unit = UNITS.iter().find(|(ending, _)| name.len() > ending.len() && name.ends_with(ending));
    let stem = unit.map_or(name, |(ending, _)| name.strip_suffix(ending).unwrap_or(name));
    (named(&COLUMNS, name).unwrap_or_else(|| words(stem)), unit.map_or("", |(_, unit)| unit))
}

/// A number for display: three digits.
pub fn rounded(value: f64) -> String {
    let digits = (2.0 - value.abs().max(1e-9).log10().floor()).clamp(0.0, 6.0) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

/// What a column holds, worded for the middle of a sentence, and its unit with a leading space.
pub fn quantity(covariate: &str) -> (String, String) {
    let (label, unit) = column(covariate);
    (lower(&label), with_unit("", unit))
}

/// A cause in words.
pub fn cause(name: &str) -> String {
    match name.strip_prefix("unknown: ") {
        Some(covariate) => format!("Unknown cause, with {}", lower(&column(covariate).0)),
        None => named(&CAUSES, name).unwrap_or_else(|| words(name)),
    }
}

/// A law's kind in words.
pub fn form(name: &str) -> String {
    named(&FORMS, name).unwrap_or_else(|| words(name))
}

/// The letter that stands for a column in laws.
pub fn symbol(column: &str) -> Option<&'static str> {
    SYMBOLS.iter().find(|(name, _)| *name == column).map(|(_, letter)| *letter)
}

/// What a confidence level means.
pub fn level(confidence: u8) -> &'static str {
    LEVELS[usize::from(confidence).clamp(1, LEVELS.len()) - 1]
}

/// A fitted number in words.
pub fn parameter(name: &str) -> String {
    named(&PARAMETERS, name).unwrap_or_else(|| words(name))
}

/// A number with its unit: no space before the degree sign, one before other units.
pub fn with_unit(number: &str, unit: &str) -> String {
    match unit {
        "" | "1" => number.to_owned(),
        "deg" | "°" => format!("{number}°"),
        unit => format!("{number} {unit}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Mechanism;

    #[test]
    fn endings_of_columns_are_longest_first() {
        for (k, (ending, _)) in UNITS.iter().enumerate() {
            let hidden = UNITS[..k].iter().find(|(earlier, _)| ending.ends_with(earlier));
            assert_eq!(hidden, None, "{ending} is never reached");
        }
    }

    #[test]
    fn a_reader_meets_words_and_units() {
        assert_eq!(column("relative_humidity_pct"), ("Relative humidity".to_owned(), "%"));
        assert_eq!(column("rest_min"), ("Time at rest".to_owned(), "min"));
        assert_eq!(column("_pct"), (" pct".to_owned(), ""), "an ending alone is a name");
        assert_eq!(cause("unknown: pressure_hpa"), "Unknown cause, with pressure");
        assert_eq!(
            (with_unit("+2.4", "deg"), with_unit("3", "mg")),
            ("+2.4°".to_owned(), "3 mg".to_owned())
        );
        for name in Mechanism::ALL.map(|mechanism| mechanism.name().0) {
            let plain = cause(name);
            assert!(
                plain.starts_with(char::is_uppercase) && !plain.contains('_'),
                "{name}: {plain}"
            );
        }
    }
}
