//! What the posterior proposes: nothing, a cause, several that cannot be told apart, or none of the
//! catalogue.

use super::claim::Proposal;
use super::posterior::Posterior;
use super::prepared::Prepared;
use crate::causes::hypothesis::Cause;
use crate::thresholds::{CERTAIN, CLAIM, LOOK_ALIKE, SIGNIFICANCE, WORTH_TELLING};

/// The conclusion from the posterior.
pub(crate) struct Judgement {
    pub(crate) proposal: Proposal,
    /// The causes whose effects are reported, most probable first.
    pub(crate) told: Vec<Cause>,
    /// All causes, most probable first, with their inclusion probability.
    pub(crate) ranked: Vec<(Cause, f64)>,
}

impl Judgement {
    pub(crate) fn of(prepared: &Prepared, posterior: &Posterior<'_>, p_value: f64) -> Self {
        let mut ranked: Vec<(Cause, f64)> = prepared
            .hypotheses
            .iter()
            .map(|it| it.cause.clone())
            .zip(posterior.inclusion.iter().copied())
            .collect();
        ranked.sort_by(|a, b| b.1.total_cmp(&a.1));
        let claimed: Vec<Cause> =
            ranked.iter().filter(|it| it.1 >= CLAIM).map(|it| it.0.clone()).collect();
        let top = ranked.first().map(|it| it.0.clone());
        let has_look_alike = |cause: &Cause| {
            let probability = ranked.iter().find(|it| it.0 == *cause).map_or(0.0, |it| it.1);
            probability < CERTAIN && look_alike(prepared, posterior, cause).is_some()
        };
        let proposal = match &top {
            _ if p_value > SIGNIFICANCE => Proposal::Nothing,
            Some(Cause::Known(_)) if !claimed.is_empty() && !claimed.iter().any(has_look_alike) => {
                Proposal::Cause
            }
            Some(Cause::Unknown(_) | Cause::Unrecorded) if !claimed.is_empty() => {
                Proposal::Unexplained
            }
            _ => Proposal::Ambiguous,
        };
        let told = match proposal {
            Proposal::Nothing => Vec::new(),
            Proposal::Cause | Proposal::Unexplained => claimed,
            Proposal::Ambiguous => {
                let mut told: Vec<Cause> = ranked
                    .iter()
                    .take_while(|it| it.1 >= WORTH_TELLING)
                    .map(|it| it.0.clone())
                    .collect();
                if told.len() < 2 {
                    let first =
                        top.iter().filter_map(|cause| look_alike(prepared, posterior, cause));
                    let next = ranked.get(1).map(|it| it.0.clone());
                    told = top.iter().cloned().chain(first.chain(next).next()).collect();
                }
                told.truncate(3);
                told
            }
        };
        Self { proposal, told, ranked }
    }

    pub(crate) fn ambiguous_between(&self) -> Vec<String> {
        match self.proposal {
            Proposal::Ambiguous => self.told.iter().map(|cause| cause.name().0).collect(),
            _ => Vec::new(),
        }
    }

    /// The covariate of an unexplained departure, if one was recorded.
    pub(crate) fn unexplained(&self) -> Option<Option<&str>> {
        match (self.proposal, self.told.first()) {
            (Proposal::Unexplained, Some(Cause::Unknown(covariate))) => Some(Some(covariate)),
            (Proposal::Unexplained, _) => Some(None),
            _ => None,
        }
    }

    /// The causes an experiment should distinguish: the candidates, or the identified one and the
    /// next, if a setting differs.
    pub(crate) fn to_tell_apart(&self) -> Option<Vec<&Cause>> {
        let mut causes: Vec<&Cause> = match self.proposal {
            Proposal::Nothing => return None,
            Proposal::Ambiguous => self.told.iter().collect(),
            _ => self.told.iter().take(1).collect(),
        };
        if causes.len() < 2 {
            let next = self
                .ranked
                .iter()
                .map(|it| &it.0)
                .find(|it| !causes.contains(it) && !it.covariates().is_empty());
            causes.extend(next);
        }
        (causes.len() > 1).then_some(causes)
    }
}

/// Another catalogued cause that this design can hardly distinguish from this one: it acts through
/// other covariates, and their courses are correlated.
fn look_alike(prepared: &Prepared, posterior: &Posterior<'_>, cause: &Cause) -> Option<Cause> {
    let common = |cause: &Cause| {
        let f = posterior.best_feature(cause)?;
        let hypothesis = prepared.hypotheses.iter().find(|it| it.cause == *cause)?;
        let column = hypothesis.features[f].column(0);
        Some(prepared.measured.iter().map(|&i| column[i]).collect::<Vec<f64>>())
    };
    let own = common(cause)?;
    let others = prepared
        .hypotheses
        .iter()
        .filter(|it| matches!(it.cause, Cause::Known(_)) && shares_none(&it.cause, cause));
    let alike = others
        .filter_map(|it| Some((it.cause.clone(), correlation(&own, &common(&it.cause)?).abs())));
    alike.filter(|it| it.1 >= LOOK_ALIKE).max_by(|a, b| a.1.total_cmp(&b.1)).map(|it| it.0)
}

fn shares_none(one: &Cause, other: &Cause) -> bool {
    !one.covariates().iter().any(|name| other.covariates().contains(name))
}

pub(crate) fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let mean = |of: &[f64]| of.iter().sum::<f64>() / of.len() as f64;
    let (mean_a, mean_b) = (mean(a), mean(b));
    let sum = |of: &dyn Fn(f64, f64) -> f64| {
        a.iter().zip(b).map(|(x, y)| of(x - mean_a, y - mean_b)).sum::<f64>()
    };
    let scale = (sum(&|x, _| x * x) * sum(&|_, y| y * y)).sqrt();
    if scale > 0.0 { sum(&|x, y| x * y) / scale } else { 0.0 }
}
