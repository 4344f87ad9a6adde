//! What callers write on weighings and jobs so that their own programs find them again.

use super::FieldError;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Key of the caller's own id of the request, which `X-Correlation-Id` sets too.
pub const CORRELATION_ID: &str = "correlation_id";
/// Most labels on one thing.
const COUNT_MAX: usize = 32;
/// Longest key, characters.
const KEY_CHARS_MAX: usize = 63;
/// Longest value, characters.
const VALUE_CHARS_MAX: usize = 255;
/// Most that all of them may be together, bytes.
const BYTES_MAX: usize = 4096;

/// Values by key.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Labels(pub BTreeMap<String, String>);

impl Labels {
    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Without blanks around the values, as they are looked for.
    #[must_use]
    pub fn trimmed(mut self) -> Self {
        self.0.values_mut().for_each(|value| *value = value.trim().to_owned());
        self
    }

    /// With the caller's own id of the request, unless it names one itself.
    #[must_use]
    pub fn correlated(mut self, id: Option<&str>) -> Self {
        if let Some(id) = id {
            self.0.entry(CORRELATION_ID.to_owned()).or_insert_with(|| id.to_owned());
        }
        self
    }

    /// All that is wrong with them: too many, too long, or not in the characters of a key.
    pub fn faults(&self, field: &str) -> Vec<FieldError> {
        let bytes: usize = self.0.iter().map(|(key, value)| key.len() + value.len()).sum();
        let amounts = [(self.0.len(), COUNT_MAX, "labels"), (bytes, BYTES_MAX, "bytes in all")];
        let too_much = amounts.into_iter().filter(|(n, most, _)| n > most).map(|(n, most, of)| {
            FieldError::new(field, format!("must be at most {most} {of}, got {n}"))
        });
        too_much.chain(self.0.iter().filter_map(|(key, value)| fault(field, key, value))).collect()
    }
}

fn fault(field: &str, key: &str, value: &str) -> Option<FieldError> {
    if !is_key(key) {
        let advice = format!(
            "the key `{key}` must be 1 to {KEY_CHARS_MAX} letters, digits, `-`, `_`, `.` or `/`"
        );
        return Some(FieldError::new(field, advice));
    }
    let length = value.chars().count();
    (length > VALUE_CHARS_MAX || value.chars().any(char::is_control)).then(|| {
        let advice = format!(
            "must be at most {VALUE_CHARS_MAX} characters without control characters, got {length}"
        );
        FieldError::new(format!("{field}.{key}"), advice)
    })
}

fn is_key(key: &str) -> bool {
    let is_allowed = |c: char| c.is_ascii_alphanumeric() || "-_./".contains(c);
    (1..=KEY_CHARS_MAX).contains(&key.len()) && key.chars().all(is_allowed)
}

/// One label that things must have, as `key:value`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct LabelWanted {
    /// Its key.
    pub key: String,
    /// Its value, exactly.
    pub value: String,
}

impl LabelWanted {
    /// Whether it is one of these.
    pub fn is_among(&self, labels: &Labels) -> bool {
        labels.0.get(&self.key) == Some(&self.value)
    }

    /// From the parameter `label` of a list, if it is given.
    ///
    /// # Errors
    /// As for [`Self::parsed`].
    pub fn among(label: Option<&str>) -> Result<Option<Self>, FieldError> {
        label.map(|text| Self::parsed("label", text)).transpose()
    }

    /// From `key:value`; the value may hold further colons.
    ///
    /// # Errors
    /// Without a colon, or with a key that no label has.
    pub fn parsed(field: &str, text: &str) -> Result<Self, FieldError> {
        match text.split_once(':').map(|(key, value)| (key.trim(), value.trim())) {
            Some((key, value)) if is_key(key) => {
                Ok(Self { key: key.to_owned(), value: value.to_owned() })
            }
            _ => Err(FieldError::new(
                field,
                format!("must be a key and its value, as `plate:A7`, got `{text}`"),
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(all: &[(&str, &str)]) -> Labels {
        Labels(all.iter().map(|(key, value)| ((*key).to_owned(), (*value).to_owned())).collect())
    }

    fn fields(all: &Labels) -> Vec<String> {
        all.faults("labels").into_iter().map(|fault| fault.field).collect()
    }

    #[test]
    fn any_text_is_a_value_and_a_key_is_a_word() {
        let good =
            labels(&[("plate", "A7"), ("lab.example/run-2_b", "Grüße: 7, \"8\""), ("x", "")]);
        assert_eq!(fields(&good), [""; 0]);
        assert_eq!(fields(&labels(&[("", "a")])), ["labels"]);
        assert_eq!(fields(&labels(&[("a b", "c"), ("ä", "d")])), ["labels", "labels"]);
        assert_eq!(fields(&labels(&[(&"k".repeat(64), "a")])), ["labels"]);
        assert_eq!(fields(&labels(&[("k", "a\nb")])), ["labels.k"]);
        assert_eq!(fields(&labels(&[("k", &"v".repeat(256))])), ["labels.k"]);
    }

    #[test]
    fn a_value_is_found_as_it_is_typed_with_and_without_blanks() {
        let kept = labels(&[("study", " X 2 ")]).trimmed();
        for typed in ["study:X 2", "study: X 2", " study :X 2 "] {
            assert!(LabelWanted::parsed("label", typed).unwrap().is_among(&kept), "{typed}");
        }
    }

    #[test]
    fn there_are_no_more_than_fit() {
        let many: Vec<String> = (0..33).map(|k| format!("k{k}")).collect();
        let many: Vec<(&str, &str)> = many.iter().map(|key| (key.as_str(), "v")).collect();
        assert_eq!(fields(&labels(&many[..32])), [""; 0]);
        assert_eq!(labels(&many).faults("labels")[0].message, "must be at most 32 labels, got 33");
        let long = "v".repeat(255);
        let full: Vec<(&str, &str)> = many[..17].iter().map(|(key, _)| (*key, &*long)).collect();
        assert!(labels(&full).faults("labels")[0].message.contains("4096 bytes"));
    }

    #[test]
    fn what_is_looked_for_has_a_key_and_a_value() {
        let found = LabelWanted::parsed("label", "url: http://x:1/").unwrap();
        assert_eq!((found.key.as_str(), found.value.as_str()), ("url", "http://x:1/"));
        for wrong in ["plate", ":A7", "a b:c", ""] {
            assert_eq!(LabelWanted::parsed("label", wrong).unwrap_err().field, "label", "{wrong}");
        }
    }

    #[test]
    fn the_callers_id_stays_what_the_caller_named_it() {
        let named = labels(&[(CORRELATION_ID, "mine")]);
        assert_eq!(named.clone().correlated(Some("other")), named);
        assert_eq!(Labels::default().correlated(Some("a")), labels(&[(CORRELATION_ID, "a")]));
        assert_eq!(Labels::default().correlated(None), Labels::default());
    }
}
