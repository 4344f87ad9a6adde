//! One measured quantity from its screening to what may be claimed of it: angles, flow times and
//! scatter alike.

use super::steps::Halt;
use crate::causes::hypothesis::Cause;
use crate::causes::response::Responses;
use crate::data::campaign::Campaign;
use crate::judge::claim::{Claim, Proposal};
use crate::judge::posterior::Posterior;
use crate::judge::prepared::Prepared;
use crate::judge::screen::{Judged, Screening, Settings, screen_prepared};
use crate::judge::verdict::Judgement;
use crate::report::{Evidence, FormClass, Gain, NullCheck, Unexplained};
use crate::worth::effects::told;
use crate::worth::held_out::{Stopped, gain};
use crate::worth::law::law;
use std::ops::ControlFlow;

/// A screened channel.
pub(crate) struct Channel<'a> {
    pub campaign: &'a Campaign,
    pub responses: &'a Responses,
    pub prepared: &'a Prepared,
    pub posterior: Posterior<'a>,
    pub screening: Screening,
}

/// What is proposed, what may be claimed of it, and its gain on days left out.
pub(crate) struct Conclusion {
    pub judgement: Judgement,
    pub claim: Claim,
    pub gain: Option<Gain>,
}

impl<'a> Channel<'a> {
    /// Judges every cause, here and where nothing is wrong.
    ///
    /// # Errors
    /// A stop was requested.
    pub(crate) fn screened(
        campaign: &'a Campaign,
        responses: &'a Responses,
        prepared: &'a Prepared,
        settings: &Settings,
        on_cause: impl FnMut(f64) -> ControlFlow<()>,
    ) -> Result<Self, Halt> {
        let posterior = Posterior::new(prepared);
        let screening =
            screen_prepared(prepared, campaign, &posterior.shifts(), settings, on_cause);
        let screening = screening.ok_or(Halt::Stopped)?;
        Ok(Self { campaign, responses, prepared, posterior, screening })
    }

    /// Decides what may be claimed; `p_value` is corrected for the other channels. A proposal that
    /// `is_asked` about is tried on days left out.
    ///
    /// # Errors
    /// A campaign whose runs carry no information about their noise; a stop was requested.
    pub(crate) fn concluded(
        &self,
        p_value: f64,
        settings: &Settings,
        is_asked: impl Fn(Proposal) -> bool,
        on_fold: impl FnMut(f64) -> ControlFlow<()>,
    ) -> Result<Conclusion, Halt> {
        let judgement = Judgement::of(self.prepared, &self.posterior, p_value);
        let told = told(self.campaign, self.responses, &judgement.told)?;
        let gain = match is_asked(judgement.proposal) {
            true => self.gain(&judgement, settings, on_fold)?,
            false => None,
        };
        let is_accepted = gain.as_ref().is_some_and(|gain| gain.accepted);
        let claim = Claim::of(judgement.proposal, told, is_accepted);
        Ok(Conclusion { judgement, claim, gain })
    }

    /// The gain of the proposal on left-out days; nothing if nothing can be left out.
    fn gain(
        &self,
        judgement: &Judgement,
        settings: &Settings,
        on_fold: impl FnMut(f64) -> ControlFlow<()>,
    ) -> Result<Option<Gain>, Stopped> {
        let first = judgement.told.first();
        let covariate = first.and_then(|cause| cause.covariates().first().copied());
        let covariate = covariate.filter(|name| self.campaign.numbers(name).is_ok());
        gain(self.campaign, self.responses, covariate, settings, on_fold)
    }

    /// Every cause that was judged, most probable first.
    pub(crate) fn evidence(&self) -> Vec<Evidence> {
        let of = |judged: &Judged| {
            let (cause, family) = judged.cause.name();
            Evidence {
                cause,
                family: family.map(str::to_owned),
                log10_evidence: judged.log_evidence / std::f64::consts::LN_10,
                inclusion_probability: self.inclusion_of(&judged.cause),
            }
        };
        // A cause explained by the powders' means has no evidence, for or against.
        let judged = self.screening.judged.iter().filter(|it| it.log_evidence.is_finite());
        let mut all: Vec<Evidence> = judged.map(of).collect();
        debug_assert!(all.len() <= self.prepared.hypotheses.len());
        all.sort_by(|a, b| b.inclusion_probability.total_cmp(&a.inclusion_probability));
        all
    }

    /// Probability that a cause is at work, if anything is.
    pub(crate) fn inclusion_of(&self, cause: &Cause) -> f64 {
        self.posterior.inclusion_of(cause)
    }

    /// What a departure without a cause depends on.
    pub(crate) fn unexplained(&self, judgement: &Judgement) -> Option<Unexplained> {
        judgement.unexplained().map(|covariate| match covariate {
            Some(covariate) => law(self.campaign, self.prepared, covariate),
            None => Unexplained {
                covariate: None,
                law: "a wander over the sessions".to_owned(),
                form_class: FormClass::Smooth,
            },
        })
    }

    pub(crate) fn null_check(&self) -> NullCheck {
        NullCheck::of(&self.screening.null, self.screening.statistic)
    }
}
