//! Simulator versions: the extensions made by investigations, and their predictions.

use super::current_simulator::{BASE, CURRENT};
use super::jobs::{corrupt, specification, stored};
use super::{App, Error, Result, campaign_csv};
use crate::jobs::{JobSpec, SIMULATOR};
use flip_core::domain::FieldError;
use flip_core::domain::conditions::{Conditions, Under};
use flip_discover::Extended;
use flip_discover::report::{Channel, Report, Row};
use flip_discover::{Campaign, predict, responses};
use flip_store::page::{Page, PageQuery};
use flip_store::simulators::SimulatorVersion;
use serde::{Deserialize, Serialize};

/// Rows whose angles are to be predicted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PredictionRequest {
    /// The rows as CSV text, in the format of investigations; `repose_deg` is optional and ignored.
    pub measurements_csv: String,
}

impl App {
    /// Versions, newest first.
    pub async fn simulators(&self, page: PageQuery) -> Result<Page<SimulatorVersion>> {
        Ok(self.store().simulators(page.window(flip_store::page::LIST_LIMIT_MAX)?).await?)
    }

    /// One version.
    pub async fn simulator(&self, id: &str) -> Result<SimulatorVersion> {
        self.store().simulator(id).await?.ok_or_else(|| Error::not_found("simulator version", id))
    }

    /// The simulator selected by a request; the base if absent or `base`, and the version in use if
    /// `current`.
    ///
    /// # Errors
    /// `Invalid`: a version that does not exist, belongs to another simulator, or cannot be
    /// simulated; conditions without a version.
    pub(super) async fn extended(
        &self,
        simulator: Option<&str>,
        conditions: &Conditions,
    ) -> Result<Option<(Under, Extended)>> {
        let current = match simulator {
            Some(CURRENT) => Some(self.current_simulator().await?.simulator),
            _ => None,
        };
        let Some(id) =
            current.as_deref().or(simulator).filter(|name| ![BASE, SIMULATOR].contains(name))
        else {
            let advice =
                "are those of an extended version: name it with `simulator`, or leave them out";
            return if conditions.is_empty() {
                Ok(None)
            } else {
                Err(FieldError::new("conditions", advice).into())
            };
        };
        let refuse = |message: String| Err(FieldError::new("simulator", message).into());
        let Some(version) = self.store().simulator(id).await? else {
            return refuse(format!(
                "there is no version `{id}`: GET /v1/simulators or `flip discover versions` lists them; `base` is the simulator without extensions"
            ));
        };
        if version.base != SIMULATOR {
            return refuse(format!(
                "`{id}` extends simulator {}, and this is {SIMULATOR}: investigate again to make one that extends it",
                version.base
            ));
        }
        let Ok(extended) = serde_json::from_value::<Extended>(version.body) else {
            return refuse(format!(
                "`{id}` holds nothing to simulate: its cause was not recorded, or an earlier release made it; record more or investigate again"
            ));
        };
        Ok(Some((Under { simulator: id.to_owned(), conditions: conditions.clone() }, extended)))
    }

    /// Angles of unmeasured rows, by the original simulator and by an extended version; `current`
    /// is the current one.
    ///
    /// # Errors
    /// `NotFound`; `Invalid`: errors in the file by row and column, or a file without the columns
    /// through which the version's causes act.
    pub async fn predict(&self, version: &str, measurements_csv: &str) -> Result<Vec<Row>> {
        let version = self.extended_simulator(version).await?;
        let new = campaign_csv::read(measurements_csv, &["powder"], None)?.campaign;
        let made = self
            .store()
            .job(&version.investigation)
            .await?
            .ok_or_else(|| corrupt("an investigation"))?;
        let JobSpec::Investigation(spec) = specification(&made)? else {
            return Err(corrupt("an investigation's specification"));
        };
        let report: Option<Report> = made.result.as_deref().map(stored).transpose()?;
        lacking(&report.ok_or_else(|| corrupt("an investigation's report"))?, &new, &version.id)?;
        let Some(campaign) = spec.campaign else {
            let advice = format!(
                "`{}` was made from spoonfuls: it changes what falls from a spoon and no angle",
                version.id
            );
            return Err(FieldError::new("simulator", advice).into());
        };
        let joined = campaign.joined(&new);
        let rows = tokio::task::spawn_blocking(move || predict(&joined, &responses(&joined))).await;
        Ok(rows.map_err(|error| Error::Internal(error.into()))??)
    }
}

/// Refuses rows without a covariate that the version needs.
fn lacking(report: &Report, new: &Campaign, version: &str) -> Result<()> {
    // Flow times and balance readings do not make versions: the covariates of their departures are
    // not required.
    let angles = report.findings.iter().filter(|finding| finding.channel == Channel::Repose);
    let needed = angles.filter_map(|finding| finding.covariate.as_deref());
    let needed = needed.flat_map(|covariates| covariates.split(" and "));
    let lacks = |name: &&str| !new.covariates.iter().any(|covariate| covariate.name == *name);
    match needed.filter(lacks).collect::<Vec<_>>().as_slice() {
        [] => Ok(()),
        missing => {
            let advice = format!(
                "lacks {}, on which {version} depends: add its value in each row",
                missing.join(", ")
            );
            Err(FieldError::new("measurements", advice).into())
        }
    }
}
