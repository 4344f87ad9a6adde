//! Versions of the simulator: what investigations extended it by, and what it predicts then.

use super::jobs::{corrupt, stored};
use super::{App, Error, Result, campaign_csv};
use crate::discover::report::{Report, Row};
use crate::discover::{Campaign, predict, responses};
use crate::domain::FieldError;
use crate::jobs::JobSpec;
use crate::store::page::{Page, PageQuery};
use crate::store::simulators::SimulatorVersion;
use serde::{Deserialize, Serialize};

/// Rows whose angles are asked for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PredictionRequest {
    /// The rows as CSV text, as investigations take them; `repose_deg` may be left out, and is not looked at.
    pub measurements_csv: String,
}

impl App {
    /// Versions, newest first.
    pub async fn simulators(&self, page: PageQuery) -> Result<Page<SimulatorVersion>> {
        Ok(self.store().simulators(page.window(crate::store::page::LIST_LIMIT_MAX)?).await?)
    }

    /// One version.
    pub async fn simulator(&self, id: &str) -> Result<SimulatorVersion> {
        self.store().simulator(id).await?.ok_or_else(|| Error::not_found("simulator version", id))
    }

    /// Angles of rows that nobody measured, by the simulator as it was and by an extended version.
    ///
    /// # Errors
    /// `NotFound`; `Invalid`: a file by row and column, or one without what the version's causes act through.
    pub async fn predict(&self, version: &str, measurements_csv: &str) -> Result<Vec<Row>> {
        let version = self.simulator(version).await?;
        let new = campaign_csv::read(measurements_csv, &["powder"])?;
        let made = self.store().job(&version.investigation).await?.ok_or_else(|| corrupt("an investigation"))?;
        let JobSpec::Investigation(spec) = stored(&made.spec)? else {
            return Err(corrupt("an investigation's specification"));
        };
        let report: Option<Report> = made.result.as_deref().map(stored).transpose()?;
        lacking(&report.ok_or_else(|| corrupt("an investigation's report"))?, &new, &version.id)?;
        let joined = spec.campaign.joined(&new);
        let rows = tokio::task::spawn_blocking(move || predict(&joined, &responses(&joined))).await;
        Ok(rows.map_err(|error| Error::Internal(error.into()))??)
    }
}

/// A version that needs a covariate says nothing of rows without.
fn lacking(report: &Report, new: &Campaign, version: &str) -> Result<()> {
    let needed = report.findings.iter().filter_map(|finding| finding.covariate.as_deref());
    let needed = needed.flat_map(|covariates| covariates.split(" and "));
    let lacks = |name: &&str| !new.covariates.iter().any(|covariate| covariate.name == *name);
    match needed.filter(lacks).collect::<Vec<_>>().as_slice() {
        [] => Ok(()),
        missing => {
            let advice =
                format!("lacks {}, through which {version} acts: add what it was in each row", missing.join(", "));
            Err(FieldError::new("measurements", advice).into())
        }
    }
}
