//! Conditions under which powder is measured and weighed, and how they change the simulated powder.

use super::parameters::{PARAMETERS, ParameterSet};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;

/// A recorded condition: a number in the unit given by the suffix of its name, or a name.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Condition {
    /// A number, for example `relative_humidity_pct`.
    Number(f64),
    /// A name, for example `batch`.
    Name(String),
}

/// Conditions by column name of the campaign, e.g. `relative_humidity_pct`.
pub type Conditions = BTreeMap<String, Condition>;

impl Condition {
    /// Parses user input: a number if it reads as one, otherwise a name.
    pub fn typed(text: &str) -> Self {
        text.parse().map_or_else(|_| Self::Name(text.to_owned()), Self::Number)
    }
}

impl fmt::Display for Condition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(number) => number.fmt(f),
            Self::Name(name) => f.write_str(name),
        }
    }
}

/// An extended simulator version, and the conditions it simulates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Under {
    /// Version, `sv-…`.
    pub simulator: String,
    /// The conditions given. A calibration without any runs at the version's reference; a training
    /// draws those left out.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub conditions: Conditions,
}

/// Changes that conditions make to a simulated powder and its experiments. None by default: the
/// base simulator, bit for bit.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Patch {
    /// Amplitudes of mechanisms not in the base simulator, by name.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub amplitudes: BTreeMap<String, f64>,
    /// Offsets of the powder's parameters, by key.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub parameters: BTreeMap<String, f64>,
    /// Offsets of the heap experiment's settings, by name; not applied to a spoon.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub heap: BTreeMap<String, f64>,
}

impl Patch {
    /// Whether nothing is changed.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// The powder under these conditions; parameters are clamped to their published bounds.
    pub fn powder(&self, set: &ParameterSet) -> ParameterSet {
        let mut values = set.values();
        for (value, parameter) in values.iter_mut().zip(&PARAMETERS) {
            if let Some(more) = self.parameters.get(parameter.key) {
                *value = (*value + more).clamp(parameter.lower, parameter.upper);
            }
        }
        ParameterSet::new(values).unwrap_or(*set)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_patched_powder_stays_within_the_published_box_and_an_empty_patch_changes_no_bit() {
        let set = ParameterSet::default().with("cohesion", 1.0).unwrap();
        assert_eq!(
            Patch::default().powder(&set).values().map(f64::to_bits),
            set.values().map(f64::to_bits)
        );
        let patch = |more: f64| Patch {
            parameters: [("cohesion".to_owned(), more)].into(),
            ..Patch::default()
        };
        assert_eq!(patch(0.1).powder(&set).cohesion(), 1.1);
        assert_eq!(patch(0.5).powder(&set).cohesion(), 1.2);
        assert_eq!(serde_json::to_string(&Patch::default()).unwrap(), "{}");
    }

    #[test]
    fn conditions_are_read_as_numbers_or_names() {
        assert_eq!(Condition::typed("65.5"), Condition::Number(65.5));
        assert_eq!(Condition::typed("B2"), Condition::Name("B2".into()));
        let both: Conditions = serde_json::from_str(r#"{"batch":"B2","rest_min":5}"#).unwrap();
        assert_eq!(
            (both["batch"].to_string(), both["rest_min"].to_string()),
            ("B2".to_owned(), "5".to_owned())
        );
    }
}
