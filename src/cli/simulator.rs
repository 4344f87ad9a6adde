//! The simulator version and its conditions: flags shared by several commands.

use flip_core::domain::FieldError;
use flip_core::domain::conditions::{Condition, Conditions, Under};
use std::fmt::Write;

/// A simulator version as typed.
#[derive(Debug, Clone, Default, clap::Args)]
pub(super) struct SimulatorArguments {
    /// Extended simulator version, `sv-…`, made by `flip discover` [default: base].
    #[arg(long, value_name = "VERSION")]
    pub(super) simulator: Option<String>,
    /// Condition, as in `relative_humidity_pct=65` or `batch=B2`; may be repeated. In calibration:
    /// of the measured angle; in training: held fixed; in evaluation and weighing: on the bench.
    #[arg(long, value_name = "NAME=VALUE", requires = "simulator")]
    condition: Vec<String>,
}

impl SimulatorArguments {
    /// The conditions; for a repeated name the last one counts.
    ///
    /// # Errors
    /// A flag without a name and a value.
    pub(super) fn conditions(&self) -> Result<Conditions, FieldError> {
        let condition = |flag: &String| match flag.split_once('=') {
            Some((name, value)) if !name.is_empty() && !value.is_empty() => {
                Ok((name.to_owned(), Condition::typed(value)))
            }
            _ => {
                let advice = format!(
                    "must be a name, an equals sign and a value, as in `relative_humidity_pct=65`, got `{flag}`"
                );
                Err(FieldError::new("condition", advice))
            }
        };
        self.condition.iter().map(condition).collect()
    }
}

/// Formatted for a line of text.
pub(super) fn words(under: &Under) -> String {
    let mut text = format!("simulator {}", under.simulator);
    for (name, condition) in &under.conditions {
        let _ = write!(text, ", {name} {condition}");
    }
    text
}
