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
        let causes = prepared.hypotheses.iter().map(|hypothesis| hypothesis.cause.clone());
        let mut ranked: Vec<(Cause, f64)> =
            causes.zip(posterior.inclusion.iter().copied()).collect();
        ranked.sort_by(|a, b| b.1.total_cmp(&a.1));
        let alike = |cause: &Cause| look_alike(prepared, posterior, cause);
        let proposal = match p_value > SIGNIFICANCE {
            true => Proposal::Nothing,
            false => proposal(&ranked, |cause| alike(cause).is_some()),
        };
        let told = match proposal {
            Proposal::Nothing => Vec::new(),
            Proposal::Cause | Proposal::Unexplained => at_least(&ranked, CLAIM),
            Proposal::Ambiguous => candidates(&ranked, alike),
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
                .map(|(cause, _)| cause)
                .find(|cause| !causes.contains(cause) && !cause.covariates().is_empty());
            causes.extend(next);
        }
        (causes.len() > 1).then_some(causes)
    }
}

/// The causes of at least this probability, most probable first.
fn at_least(ranked: &[(Cause, f64)], probability: f64) -> Vec<Cause> {
    let probable = ranked.iter().take_while(|(_, inclusion)| *inclusion >= probability);
    probable.map(|(cause, _)| cause.clone()).collect()
}

/// What the evidence proposes where something is wrong: a cause is claimed if it is probable, and
/// nearly certain where another looks like it.
fn proposal(ranked: &[(Cause, f64)], has_look_alike: impl Fn(&Cause) -> bool) -> Proposal {
    let claimed: Vec<&(Cause, f64)> =
        ranked.iter().filter(|(_, inclusion)| *inclusion >= CLAIM).collect();
    let is_doubtful =
        |(cause, inclusion): &&(Cause, f64)| *inclusion < CERTAIN && has_look_alike(cause);
    match ranked.first() {
        _ if claimed.is_empty() => Proposal::Ambiguous,
        Some((Cause::Known(_), _)) if claimed.iter().any(is_doubtful) => Proposal::Ambiguous,
        Some((Cause::Known(_), _)) => Proposal::Cause,
        _ => Proposal::Unexplained,
    }
}

/// Up to three causes that cannot be told apart: the probable ones, or the first and one that looks
/// like it, else the next.
fn candidates(ranked: &[(Cause, f64)], look_alike: impl Fn(&Cause) -> Option<Cause>) -> Vec<Cause> {
    let mut told = at_least(ranked, WORTH_TELLING);
    if told.len() < 2 {
        let top = ranked.first().map(|(cause, _)| cause.clone());
        let other = top.as_ref().and_then(look_alike);
        let other = other.or_else(|| ranked.get(1).map(|(cause, _)| cause.clone()));
        told = top.into_iter().chain(other).collect();
    }
    told.truncate(3);
    told
}

/// Another catalogued cause that this design can hardly distinguish from this one: it acts through
/// other covariates, and their courses are correlated.
fn look_alike(prepared: &Prepared, posterior: &Posterior<'_>, cause: &Cause) -> Option<Cause> {
    let common = |cause: &Cause| {
        let f = posterior.best_feature(cause)?;
        let hypothesis = prepared.hypotheses.iter().find(|other| other.cause == *cause)?;
        let column = hypothesis.features[f].column(0);
        Some(prepared.measured.iter().map(|&i| column[i]).collect::<Vec<f64>>())
    };
    let own = common(cause)?;
    let others = prepared.hypotheses.iter().map(|hypothesis| &hypothesis.cause);
    let others =
        others.filter(|other| matches!(other, Cause::Known(_)) && shares_none(other, cause));
    let alike = others.filter_map(|other| Some((other, correlation(&own, &common(other)?).abs())));
    let alike = alike.filter(|(_, correlation)| *correlation >= LOOK_ALIKE);
    alike.max_by(|a, b| a.1.total_cmp(&b.1)).map(|(other, _)| other.clone())
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Mechanism::{Humidity, Operator, RestTime};

    fn known(mechanism: crate::Mechanism) -> Cause {
        Cause::Known(mechanism)
    }

    #[test]
    fn a_cause_is_claimed_if_probable_and_if_certain_where_another_looks_like_it() {
        let ranked = |first: f64| [(known(Humidity), first), (known(Operator), 0.05)];
        let alike = |probability: f64| proposal(&ranked(probability), |_| true);
        let alone = |probability: f64| proposal(&ranked(probability), |_| false);
        assert_eq!([alone(0.79), alone(0.8)], [Proposal::Ambiguous, Proposal::Cause]);
        assert_eq!([alike(0.94), alike(0.95)], [Proposal::Ambiguous, Proposal::Cause]);
        let unknown = [(Cause::Unknown("supply_v".to_owned()), 0.9), (known(Humidity), 0.1)];
        assert_eq!(proposal(&unknown, |_| true), Proposal::Unexplained);
    }

    #[test]
    fn what_cannot_be_told_apart_are_two_or_three() {
        let ranked =
            [Humidity, RestTime, Operator].map(known).into_iter().zip([0.5, 0.05, 0.05]).collect();
        let ranked: Vec<(Cause, f64)> = ranked;
        let like = |other: Option<crate::Mechanism>| candidates(&ranked, move |_| other.map(known));
        assert_eq!(like(Some(Operator)), [known(Humidity), known(Operator)]);
        assert_eq!(like(None), [known(Humidity), known(RestTime)]);
        let close: Vec<(Cause, f64)> =
            ranked.iter().map(|(cause, _)| (cause.clone(), 0.2)).collect();
        assert_eq!(candidates(&close, |_| None).len(), 3);
    }
}
