//! Powders and the parameter sets calibrated to them.

use super::check::Check;
use super::nearest::did_you_mean;
use super::{App, Error, NewMeasurement, Result};
use flip_core::domain::FieldError;
use flip_core::domain::observable::Observation;
use flip_core::domain::powder::powder_id;
use flip_core::domain::powder_name::{NAME_CHARS_MAX, id_of_powder, same_name, with_suffix};
use flip_store::now;
use flip_store::page::{LIST_LIMIT_MAX, Page, PageQuery};
use flip_store::parameter_sets::CalibratedSet;
use flip_store::powders::{Measurement, Powder};
use serde::{Deserialize, Serialize};
use serde_json::json;

/// A powder to register.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NewPowder {
    /// A lower-case letter, then up to 63 of a-z, 0-9 and _; made from the name if omitted or
    /// empty: `Lactose 200M` is `lactose_200m`, and `lactose_200m_2` if another powder has that id.
    #[serde(default)]
    pub id: String,
    /// Name for people, 1 to 100 characters.
    pub name: String,
    /// Whether it dissolves in water that it takes up from humid air, if known: an investigation
    /// then does not blame deliquescence for what a powder that does not dissolve does.
    #[serde(default)]
    pub soluble: Option<bool>,
    /// Its first measurement, registered with it or not at all.
    #[serde(default)]
    pub measurement: Option<NewMeasurement>,
}

/// A powder with all data on it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PowderDetail {
    /// The powder.
    pub powder: Powder,
    /// Its measurements, oldest first.
    pub measurements: Vec<Measurement>,
    /// Other measurements: the newest observation of each observable.
    pub observations: Vec<Observation>,
    /// Its calibrated sets, oldest first.
    pub sets: Vec<CalibratedSet>,
}

impl App {
    /// Powders, oldest first.
    pub async fn powders(&self, page: PageQuery) -> Result<Page<Powder>> {
        Ok(self.store().powders(page.window(LIST_LIMIT_MAX)?).await?)
    }

    /// One powder with its measurements and sets: the first 200 measurements, the newest 200 sets.
    pub async fn powder(&self, id: &str) -> Result<PowderDetail> {
        let powder = self.existing_powder(id).await?;
        let all = PageQuery::first(LIST_LIMIT_MAX).window(LIST_LIMIT_MAX)?;
        let measurements = self.store().measurements(id, all.clone()).await?.items;
        let mut sets = self.store().parameter_sets(Some(id), all).await?.items;
        sets.reverse();
        let observations = self.store().observations_now(id).await?;
        Ok(PowderDetail { powder, measurements, observations, sets })
    }

    /// Registers a powder, with its first measurement if there is one: both or neither.
    ///
    /// # Errors
    /// `Invalid`; `Conflict` (`powder_exists`): the id is taken, or another powder has that name.
    pub async fn create_powder(&self, new: NewPowder) -> Result<Powder> {
        let mut check = Check::default();
        let wanted =
            (!new.id.is_empty()).then(|| powder_id("id", &new.id)).and_then(|id| check.keep(id));
        let name = new.name.trim();
        check.text("name", name, NAME_CHARS_MAX);
        let made = match new.id.is_empty() && !name.is_empty() {
            true => check.keep(id_of_powder("name", name)),
            false => None,
        };
        let measurement = match new.measurement {
            Some(measurement) => {
                let mut of_measurement = Check::default();
                let measurement = measurement.checked(&mut of_measurement);
                for error in of_measurement.refusals().err().unwrap_or_default() {
                    check.refuse(&format!("measurement.{}", error.field), error.message);
                }
                measurement
            }
            None => None,
        };
        check.done()?;
        let mut tx = self.store().write().await?;
        let known = tx.powder_names().await?;
        let id = match (wanted, made) {
            (Some(id), _) => id,
            (None, Some(made)) => {
                same_name_refused(&known, None, name)?;
                with_suffix(&made, |id| known.iter().any(|(known, _)| known == id))
            }
            (None, None) => unreachable!("checked above"),
        };
        let Some(created_at) = tx.insert_powder(&id, name, new.soluble).await? else {
            let advice = format!(
                "powder `{id}` already exists: add measurements to it, or choose another id"
            );
            return Err(Error::conflict("powder_exists", advice));
        };
        let mut powder = json!({ "id": id, "name": name, "created_at": created_at });
        if let Some(soluble) = new.soluble {
            powder["soluble"] = soluble.into();
        }
        let mut said = json!({ "powder": powder });
        if let Some((method, flowability, origin)) = measurement {
            said["measurement"] =
                json!(tx.insert_measurement(&id, method, flowability, &origin).await?);
        }
        tx.audit_deed(None, "new powder", said, now()).await?;
        tx.commit().await?;
        self.existing_powder(&id).await
    }

    /// Calibrated sets, newest first; optionally of one powder.
    pub async fn parameter_sets(
        &self,
        powder: Option<&str>,
        page: PageQuery,
    ) -> Result<Page<CalibratedSet>> {
        if let Some(powder) = powder {
            self.existing_powder(powder).await?;
        }
        Ok(self.store().parameter_sets(powder, page.window(LIST_LIMIT_MAX)?).await?)
    }

    /// One calibrated set.
    pub async fn parameter_set(&self, id: &str) -> Result<CalibratedSet> {
        self.store().parameter_set(id).await?.ok_or_else(|| Error::not_found("parameter set", id))
    }

    pub(super) async fn existing_powder(&self, id: &str) -> Result<Powder> {
        self.store().powder(id).await?.ok_or_else(|| Error::not_found("powder", id))
    }

    /// The powder named in a request's field: an unknown one is the request's fault.
    pub(super) async fn powder_of(&self, field: &str, id: &str) -> Result<Powder> {
        let id = powder_id(field, id)?;
        if let Some(powder) = self.store().powder(&id).await? {
            return Ok(powder);
        }
        let known = self.store().powder_names().await?;
        let meant = did_you_mean(&id, known.iter().map(|(id, _)| id.as_str()));
        let advice = format!(
            "there is no powder `{id}`{meant}: GET /v1/powders lists them, POST /v1/powders adds one"
        );
        Err(FieldError::new(field, advice).into())
    }
}

/// Refuses a name that another powder has: files name powders by it.
pub(super) fn same_name_refused(
    known: &[(String, String)],
    itself: Option<&str>,
    name: &str,
) -> Result<()> {
    let another = known
        .iter()
        .find(|(id, known)| Some(id.as_str()) != itself && same_name(known) == same_name(name));
    match another {
        Some((id, known)) => {
            let advice = format!(
                "powder `{id}` is already called `{known}` (it may be archived): add measurements to it, or choose another name"
            );
            Err(Error::conflict("powder_exists", advice))
        }
        None => Ok(()),
    }
}
