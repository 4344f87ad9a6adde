//! Decides what may be claimed of what the evidence proposes: the one place where a verdict is
//! made.
//!
//! | proposed | an effect told from zero | predicts what was left out | verdict |
//! |---|---|---|---|
//! | a cause | yes | yes | cause |
//! | a cause | one of the two | | hint |
//! | a cause | no | no | no discrepancy |
//! | several causes, or none of the catalogue | | | ambiguous, unexplained |
//!
//! An effect counts as nonzero if its 95 % interval, as printed, excludes zero. Evidence alone is
//! not enough: the best of many causes looks larger than it is, and outliers can be evidence for a
//! cause that moves nothing.

use crate::causes::hypothesis::Cause;
use crate::report::printed::is_told;
use crate::report::{Finding, Verdict};

/// The conclusion from the evidence alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Proposal {
    Nothing,
    Cause,
    Ambiguous,
    Unexplained,
}

/// A cause, and its effect if the covariate it depends on was recorded.
#[derive(Debug, Clone)]
pub(crate) struct Told {
    pub cause: Cause,
    pub finding: Option<Finding>,
}

/// What is claimed of a channel.
pub(crate) struct Claim {
    pub verdict: Verdict,
    /// The causes behind the verdict, most probable first; empty if nothing is shown.
    pub told: Vec<Told>,
    /// A cause favoured by the evidence that has neither an effect nor a gain.
    pub passing: Option<Finding>,
    /// Whether extending the simulator by it makes it better: left-out data are predicted better,
    /// and it is more than a hint.
    pub is_worth_something: bool,
}

impl Proposal {
    pub fn is_found(self) -> bool {
        self != Self::Nothing
    }
}

impl Claim {
    /// `told`: the proposed causes, most probable first. `is_accepted`: they predict left-out data
    /// better.
    pub fn of(proposal: Proposal, mut told: Vec<Told>, is_accepted: bool) -> Self {
        let has_effect = told.iter().any(Told::is_known_and_told);
        let verdict = verdict(proposal, has_effect, is_accepted);
        let passing = match verdict {
            Verdict::NoDiscrepancy => told.drain(..).find_map(|told| told.finding),
            _ => None,
        };
        if verdict == Verdict::Cause {
            told.retain(Told::is_told);
        }
        let is_worth_something =
            is_accepted && !matches!(verdict, Verdict::NoDiscrepancy | Verdict::Hint);
        Self { verdict, told, passing, is_worth_something }
    }

    /// The effects of the reported causes.
    pub fn findings(&self) -> Vec<Finding> {
        self.told.iter().filter_map(|told| told.finding.clone()).collect()
    }

    /// The reported effect of a cause.
    pub fn finding(&self, cause: &Cause) -> Option<&Finding> {
        self.told.iter().find(|told| told.cause == *cause)?.finding.as_ref()
    }
}

impl Told {
    fn is_told(&self) -> bool {
        self.finding.as_ref().is_some_and(|finding| is_told(finding.ci95, &finding.unit))
    }

    fn is_known_and_told(&self) -> bool {
        matches!(self.cause, Cause::Known(_)) && self.is_told()
    }
}

/// The verdict on a proposal.
pub(crate) fn verdict(proposal: Proposal, has_effect: bool, is_accepted: bool) -> Verdict {
    match (proposal, has_effect, is_accepted) {
        (Proposal::Nothing, ..) | (Proposal::Cause, false, false) => Verdict::NoDiscrepancy,
        (Proposal::Cause, true, true) => Verdict::Cause,
        (Proposal::Cause, ..) => Verdict::Hint,
        (Proposal::Ambiguous, ..) => Verdict::Ambiguous,
        (Proposal::Unexplained, ..) => Verdict::Unexplained,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Mechanism;
    use crate::report::Channel;

    fn told(cause: Cause, ci95: [f64; 2]) -> Told {
        let finding = Finding {
            channel: Channel::Repose,
            covariate: None,
            powders: Vec::new(),
            effect: f64::midpoint(ci95[0], ci95[1]),
            ci95,
            unit: "deg".to_owned(),
            span: String::new(),
            powder: None,
            by_powder: Vec::new(),
        };
        Told { cause, finding: Some(finding) }
    }

    #[test]
    fn a_cause_without_an_effect_or_without_a_gain_is_no_cause() {
        let known = || Cause::Known(Mechanism::FunnelHeight);
        let of = |ci95, accepted| Claim::of(Proposal::Cause, vec![told(known(), ci95)], accepted);
        let (effect, none) = ([-1.4, -0.2], [-1.4, 0.4]);
        assert_eq!(of(effect, true).verdict, Verdict::Cause);
        assert_eq!([of(effect, false).verdict, of(none, true).verdict], [Verdict::Hint; 2]);
        let nothing = of(none, false);
        assert_eq!((nothing.verdict, nothing.told.len()), (Verdict::NoDiscrepancy, 0));
        assert_eq!(nothing.passing.map(|it| it.ci95), Some(none));
    }

    #[test]
    fn beside_a_cause_nothing_is_told_that_has_no_effect() {
        let all = vec![
            told(Cause::Known(Mechanism::Humidity), [0.5, 1.5]),
            told(Cause::Known(Mechanism::Operator), [-0.5, 1.5]),
            Told { cause: Cause::Unrecorded, finding: None },
        ];
        let claim = Claim::of(Proposal::Cause, all.clone(), true);
        assert_eq!((claim.verdict, claim.findings().len()), (Verdict::Cause, 1));
        assert!(claim.finding(&Cause::Known(Mechanism::Operator)).is_none());
        // The effect of an unknown does not make it a cause of the catalogue.
        let unknown = vec![all[1].clone(), told(Cause::Unknown("supply_v".to_owned()), [0.5, 1.5])];
        assert_eq!(Claim::of(Proposal::Cause, unknown, true).verdict, Verdict::Hint);
        assert_eq!(Claim::of(Proposal::Ambiguous, all, false).told.len(), 3);
    }
}
