//! The simulator version used where none is named. Versions never change: rolling back means
//! choosing another.

use super::check::Check;
use super::{App, Result};
use crate::jobs::SIMULATOR;
use flip_core::domain::FieldError;
use flip_core::domain::timestamp::Timestamp;
use flip_store::current_simulator::Choice;
use flip_store::simulators::SimulatorVersion;
use serde::{Deserialize, Serialize};

/// The simulator without any extension from an investigation.
pub const BASE: &str = "base";
/// Alias of the current version.
pub const CURRENT: &str = "current";

/// The version used where none is named.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CurrentSimulator {
    /// `base`, or a version, `sv-…`.
    pub simulator: String,
    /// Name of the base, as used by versions that extend it.
    pub base: String,
    /// When it was chosen; absent if none was ever chosen and the base is current.
    pub chosen_at: Option<Timestamp>,
    /// Why it was chosen, if anyone said so.
    pub reason: Option<String>,
    /// The previously current version, which can be chosen again; absent if none was ever chosen.
    pub before: Option<String>,
}

/// Version to use from now on where none is named.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChosenSimulator {
    /// `base`, or a version, `sv-…`.
    pub simulator: String,
    /// Why, for the record: 1 to 500 characters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

impl App {
    /// The current version: the base until another is chosen.
    pub async fn current_simulator(&self) -> Result<CurrentSimulator> {
        let choices = self.store().simulator_choices().await?;
        let name = |choice: &Choice| choice.version.clone().unwrap_or_else(|| BASE.to_owned());
        let newest = choices.first();
        Ok(CurrentSimulator {
            simulator: newest.map_or_else(|| BASE.to_owned(), name),
            base: SIMULATOR.to_owned(),
            chosen_at: newest.map(|newest| newest.chosen_at),
            reason: newest.and_then(|newest| newest.reason.clone()),
            before: newest.map(|_| choices.get(1).map_or_else(|| BASE.to_owned(), name)),
        })
    }

    /// Makes a version, or the base, current. Choosing the current one again changes nothing.
    ///
    /// # Errors
    /// `Invalid`: no such version, the reason; `Unavailable` if the data folder was opened read-only.
    pub async fn choose_simulator(&self, chosen: &ChosenSimulator) -> Result<CurrentSimulator> {
        let version = (chosen.simulator != BASE).then_some(chosen.simulator.as_str());
        if let Some(id) = version.filter(|id| *id != SIMULATOR)
            && self.store().simulator(id).await?.is_none()
        {
            let advice = format!(
                "must be `{BASE}` or an existing version, got `{id}`: `flip discover versions` lists them"
            );
            return Err(FieldError::new("simulator", advice).into());
        }
        let mut check = Check::default();
        if let Some(reason) = &chosen.reason {
            check.text("reason", reason, 500);
        }
        check.done()?;
        let mut tx = self.store().write().await?;
        let version = version.filter(|id| *id != SIMULATOR);
        tx.choose_simulator(version, chosen.reason.as_deref()).await?;
        tx.commit().await?;
        self.current_simulator().await
    }

    /// The version with this id; for `current`, the current one.
    ///
    /// # Errors
    /// `NotFound`; `Invalid` for `current` while that is the base, which has no causes.
    pub(super) async fn extended_simulator(&self, id: &str) -> Result<SimulatorVersion> {
        if id != CURRENT {
            return self.simulator(id).await;
        }
        match self.current_simulator().await?.simulator {
            base if base == BASE => {
                let advice = "is the base now, which gives each powder the same angle under all conditions: name a version, `sv-…`";
                Err(FieldError::new("simulator", advice).into())
            }
            version => self.simulator(&version).await,
        }
    }
}
