//! What was measured beside the angle, judged as angles are: the time that powder takes to flow out (`flow.rs`), and how far repeats scatter
//! (`scatter.rs`).
//!
//! Both are logarithms ([`percent`](super::campaign::percent)), so that a cause multiplies; a powder's own time and scatter are its means, which are not
//! looked at. Nobody knows how much a cause of the catalogue changes the flow of which powder, so signs and responses are left open.

use super::campaign::Campaign;
use super::claim::{Claim, Proposal};
use super::hypothesis::{Cause, Responses};
use super::investigate::{Judgement, evidence, worth};
use super::posterior::Posterior;
use super::report::{
    CauseReport, Experiment, Finding, FormClass, NullCheck, ParameterReport, SideChannel, Unexplained, Verdict,
};
use super::screen::{Prepared, Screening, Settings};
use super::{effects, experiment, law, words};
use flip_core::domain::FieldError;
use std::ops::ControlFlow;

/// A channel that was screened.
pub(super) struct Beside<'a> {
    pub campaign: &'a Campaign,
    pub prepared: &'a Prepared,
    pub posterior: Posterior<'a>,
    pub screening: Screening,
}

/// What one more channel says, to be added to a document.
pub(super) struct Heard {
    /// What was measured, to begin a sentence with.
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
    /// What it says; `p_value` is corrected for what else is judged.
    ///
    /// # Errors
    /// A campaign whose runs say nothing of their noise.
    pub fn heard(&self, p_value: f64, settings: &Settings) -> Result<(Heard, SideChannel), FieldError> {
        let Self { campaign, prepared, posterior, screening } = self;
        let judgement = Judgement::of(prepared, posterior, p_value);
        let none = Responses::new();
        let told = effects::told(campaign, &none, &judgement.told)?;
        let gain = match judgement.proposal {
            Proposal::Cause => {
                worth(campaign, &none, &judgement, settings, |_| ControlFlow::Continue(())).ok().flatten()
            }
            _ => None,
        };
        let claim = Claim::of(judgement.proposal, told, gain.as_ref().is_some_and(|gain| gain.accepted));
        let causes = claim.told.iter().filter_map(|it| self.cause(&it.cause, it.finding.as_ref()?)).collect();
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
        let sentence = words::beside(campaign.quantity, &claim, probability, &ambiguous_between, p_value);
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
        Ok((Heard { what, verdict, sentence, findings, causes, ambiguous_between, unexplained, experiment }, side))
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

/// The same runs, of which the flow is what counts.
fn timed(it: Experiment) -> Experiment {
    Experiment { what: format!("{}, and of each the time that the powder takes to flow out", it.what), ..it }
}
