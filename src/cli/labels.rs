//! `--label KEY:VALUE`: what callers write on weighings and jobs.

use crate::app::Labels;
use flip_core::domain::FieldError;
use flip_core::domain::labels::LabelWanted;

/// Labels as options.
#[derive(Debug, Default, clap::Args)]
pub(super) struct LabelArguments {
    /// Label to keep with it and find it by, as `plate:A7`; may be repeated.
    #[arg(long = "label", value_name = "KEY:VALUE", value_parser = label)]
    labels: Vec<LabelWanted>,
}

impl LabelArguments {
    /// All of them.
    ///
    /// # Errors
    /// One key with two values.
    pub fn all(&self) -> Result<Labels, FieldError> {
        let mut all = Labels::default();
        for LabelWanted { key, value } in &self.labels {
            if all.0.insert(key.clone(), value.clone()).is_some_and(|before| before != *value) {
                let advice = format!("`{key}` has two values: name each key once");
                return Err(FieldError::new("label", advice));
            }
        }
        Ok(all)
    }
}

/// A label as typed.
///
/// # Errors
/// It is not a key and its value.
pub(super) fn label(text: &str) -> Result<LabelWanted, String> {
    LabelWanted::parsed("label", text).map_err(|error| error.message)
}
