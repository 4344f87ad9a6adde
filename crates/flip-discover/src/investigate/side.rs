//! Quantities measured alongside the angle and judged the same way: the time a powder takes to flow
//! out (`flow.rs`), and how much repeats scatter (`scatter.rs`).
//!
//! Both are logarithms ([`percent`](crate::data::campaign::percent)), so a cause multiplies; a powder's
//! own time and scatter are its means, which are not judged. How much a cause of the catalogue
//! changes the flow of each powder is unknown, so signs and responses are left open.

use super::angles::{evidence, worth};
use super::words;
use crate::causes::hypothesis::Cause;
use crate::causes::response::Responses;
use crate::data::campaign::Campaign;
use crate::judge::claim::{Claim, Proposal};
use crate::judge::posterior::Posterior;
use crate::judge::prepared::Prepared;
use crate::judge::screen::{Screening, Settings};
use crate::judge::verdict::Judgement;
use crate::report::{
    CauseReport, Experiment, Finding, FormClass, NullCheck, ParameterReport, SideChannel,
    Unexplained, Verdict,
};
use crate::worth::{effects, experiment, law};
use flip_core::domain::FieldError;
use std::ops::ControlFlow;

/// A screened channel.
pub(crate) struct Beside<'a> {
    pub campaign: &'a Campaign,
    pub prepared: &'a Prepared,
    pub posterior: Posterior<'a>,
    pub screening: Screening,
}

/// The results of one more channel, to be added to a document.
pub(crate) struct Heard {
    /// What was measured, as the beginning of a sentence.
    pub what: &'static str,
    pub verdict: Verdict,
    pub sentence: String,
    pub findings: Vec<Finding>,
    pub causes: Vec<CauseReport>,
    pub ambiguous_between: Vec<String>,
    pub unexplained: Option<Unexplained>,
    pub experiment: Option<Experiment>,
}

impl Beside<'_> {
    /// The channel's results; `p_value` is corrected for the other channels judged.
    ///
    /// # Errors
    /// A campaign whose runs carry no information about their noise.
    pub fn heard(
        &self,
        p_value: f64,
        settings: &Settings,
    ) -> Result<(Heard, SideChannel), FieldError> {
        let Self { campaign, prepared, posterior, screening } = self;
        let judgement = Judgement::of(prepared, posterior, p_value);
        let none = Responses::new();
        let told = effects::told(campaign, &none, &judgement.told)?;
        let gain = match judgement.proposal {
            Proposal::Cause => {
                worth(campaign, &none, &judgement, settings, |_| ControlFlow::Continue(()))
                    .ok()
                    .flatten()
            }
            _ => None,
        };
        let claim =
            Claim::of(judgement.proposal, told, gain.as_ref().is_some_and(|gain| gain.accepted));
        let causes = claim
            .told
            .iter()
            .filter_map(|it| self.cause(&it.cause, it.finding.as_ref()?))
            .collect();
        let unexplained = judgement.unexplained().map(|covariate| match covariate {
            Some(covariate) => law::law(campaign, prepared, covariate),
            None => Unexplained {
                covariate: None,
                law: "a wander over the sessions".to_owned(),
                form_class: FormClass::Smooth,
            },
        });
        let verdict = claim.verdict;
        let experiment = match (verdict, judgement.to_tell_apart()) {
            (Verdict::Ambiguous, Some(causes)) => {
                experiment::experiment(campaign, &none, &causes, false, settings)?.map(timed)
            }
            _ => None,
        };
        let ambiguous_between = judgement.ambiguous_between();
        let probability = |cause: &Cause| posterior.inclusion_of(cause);
        let sentence =
            words::beside(campaign.quantity, &claim, probability, &ambiguous_between, p_value);
        let side = SideChannel {
            channel: campaign.quantity.channel(),
            verdict,
            p_value: screening.p_value,
            n: prepared.measured.len() as u32,
            sentence: sentence.clone(),
            evidence: evidence(prepared, screening, posterior),
            null_check: NullCheck::of(&screening.null, screening.statistic),
            gain,
        };
        let (what, findings) = (campaign.quantity.name(), claim.findings());
        Ok((
            Heard {
                what,
                verdict,
                sentence,
                findings,
                causes,
                ambiguous_between,
                unexplained,
                experiment,
            },
            side,
        ))
    }

    fn cause(&self, cause: &Cause, finding: &Finding) -> Option<CauseReport> {
        let Cause::Known(mechanism) = cause else { return None };
        let (name, family) = mechanism.name();
        let effect = ParameterReport {
            name: "flow_effect_5_95".to_owned(),
            value: finding.effect,
            ci95: finding.ci95,
            unit: finding.unit.clone(),
        };
        Some(CauseReport {
            mechanism: name.to_owned(),
            family: family.to_owned(),
            inclusion_probability: self.posterior.inclusion_of(cause),
            confidence_level: 1,
            parameters: vec![effect],
            powders: finding.powders.clone(),
        })
    }
}

/// The same runs with flow time as the measured quantity.
fn timed(it: Experiment) -> Experiment {
    Experiment {
        what: format!("{}, and of each the time that the powder takes to flow out", it.what),
        ..it
    }
}
