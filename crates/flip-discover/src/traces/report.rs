//! The part of a document about balance readings.

use super::words;
use super::{Kind, Parameter, TraceCause, TraceJudged, TraceMechanism, TraceScreening, Traces};
use crate::judge::claim::{self, Proposal};
use crate::report::printed::is_told;
use crate::report::{
    CauseReport, Channel, Evidence, Finding, FormClass, NullCheck, ParameterReport, TraceChannel,
    Unexplained, UntestableReport, Verdict,
};
use crate::thresholds::trace::LEAD_MIN;
use crate::thresholds::{CERTAIN, CLAIM, SIGNIFICANCE, WORTH_TELLING};
use std::f64::consts::LN_10;

/// Something that wanders in each weighing in its own way, as named in documents.
pub const WANDER: &str = "wander";

/// The parts of a document that come from balance readings.
pub(crate) struct TraceReport {
    pub channel: TraceChannel,
    pub sentence: String,
    pub findings: Vec<Finding>,
    pub causes: Vec<CauseReport>,
    pub ambiguous_between: Vec<String>,
    pub unexplained: Option<Unexplained>,
    pub blind_spots: Vec<String>,
    pub evidence: Vec<Evidence>,
    pub untestable: Vec<UntestableReport>,
}

/// The result of a screening; `corrected` is its p-value, given what else is judged.
pub(crate) fn report(traces: &Traces, screening: &TraceScreening, corrected: f64) -> TraceReport {
    let (proposal, told) = judge(screening, corrected);
    let has_effect = told
        .first()
        .and_then(|judged| judged.effect.as_ref())
        .is_some_and(|judged| is_told(judged.ci95, judged.unit));
    let verdict = claim::verdict(proposal, has_effect, true);
    let is_control = |kind: Kind| kind != Kind::Dose;
    let controls = traces.weighings.iter().filter(|weighing| is_control(weighing.kind)).count();
    let known = |judged: &&TraceJudged| matches!(judged.mechanism, TraceCause::Known(_));
    let findings: Vec<Finding> = told.iter().filter_map(|judged| finding(judged)).collect();
    let experiment =
        words::experiment(&told.iter().map(|judged| judged.mechanism).collect::<Vec<_>>(), verdict);
    let channel = TraceChannel {
        verdict,
        p_value: screening.p_value,
        weighings: (traces.weighings.len() - controls) as u32,
        controls: controls as u32,
        readings: screening.looked_at[0],
        shakes: screening.looked_at[1],
        null_check: NullCheck::of(&screening.null, screening.statistic),
        suggested_experiment: experiment,
        unjudged: screening.unjudged.as_ref().map(|unjudged| unjudged.why.clone()),
    };
    TraceReport {
        sentence: words::sentence(&told, &channel),
        blind_spots: words::blind_spots(traces, screening),
        causes: screening
            .judged
            .iter()
            .filter(known)
            .map(|judged| cause(judged, told.contains(&judged)))
            .collect(),
        ambiguous_between: match verdict {
            Verdict::Ambiguous => {
                told.iter().map(|judged| name(judged.mechanism).to_owned()).collect()
            }
            _ => Vec::new(),
        },
        unexplained: (verdict == Verdict::Unexplained).then(|| Unexplained {
            covariate: None,
            law: "a wander of the readings, in each weighing in its own way".to_owned(),
            form_class: FormClass::Smooth,
        }),
        evidence: screening.judged.iter().map(evidence).collect(),
        untestable: screening.untestable.iter().map(untestable).collect(),
        findings,
        channel,
    }
}

/// Name used in documents.
pub(super) fn name(cause: TraceCause) -> &'static str {
    match cause {
        TraceCause::Known(mechanism) => mechanism.name().0,
        TraceCause::Unknown => WANDER,
    }
}

/// The proposal from the evidence, and the causes reported, most probable first.
fn judge(screening: &TraceScreening, corrected: f64) -> (Proposal, Vec<&TraceJudged>) {
    let judged = &screening.judged;
    let Some(top) = judged.first().filter(|_| corrected <= SIGNIFICANCE) else {
        return (Proposal::Nothing, Vec::new());
    };
    let wander = judged
        .iter()
        .find(|other| other.mechanism == TraceCause::Unknown)
        .map_or(0.0, |other| other.log_evidence);
    let over = |one: &TraceJudged| one.log_evidence - wander.max(0.0);
    let is_close = |one: &&TraceJudged| {
        let is_behind =
            over(one) <= (1.0 - LEAD_MIN) * over(top) && one.probability <= 1.0 - CERTAIN;
        one.acts_like(top) && !is_behind
    };
    let look_alike = judged[1..].iter().find(is_close);
    if top.probability >= CLAIM && look_alike.is_none() {
        let proposal = if top.mechanism == TraceCause::Unknown {
            Proposal::Unexplained
        } else {
            Proposal::Cause
        };
        return (proposal, vec![top]);
    }
    let mut told: Vec<&TraceJudged> =
        judged.iter().take_while(|one| one.probability >= WORTH_TELLING).collect();
    if told.len() < 2 {
        told = vec![top];
        told.extend(look_alike.or(judged.get(1)));
    }
    told.truncate(3);
    (Proposal::Ambiguous, told)
}

impl TraceJudged {
    /// Whether both are causes of the catalogue that act on the same level.
    fn acts_like(&self, other: &Self) -> bool {
        match (self.mechanism, other.mechanism) {
            (TraceCause::Known(one), TraceCause::Known(two)) => one.level() == two.level(),
            _ => false,
        }
    }
}

fn finding(judged: &TraceJudged) -> Option<Finding> {
    let effect = judged.effect.as_ref()?;
    Some(Finding {
        channel: Channel::Trace,
        covariate: Some(effect.covariate.to_owned()),
        powders: Vec::new(),
        effect: effect.value,
        ci95: effect.ci95,
        unit: effect.unit.to_owned(),
        span: effect.span.clone(),
        powder: None,
        by_powder: Vec::new(),
    })
}

fn cause(judged: &TraceJudged, is_told: bool) -> CauseReport {
    let (mechanism, family) = judged.mechanism.name();
    let effect = judged.effect.iter().map(|effect| ParameterReport {
        name: "effect_5_95".to_owned(),
        value: effect.value,
        ci95: effect.ci95,
        unit: effect.unit.to_owned(),
    });
    let own = judged.parameters.iter().map(|&Parameter { name, value, low95, high95, unit }| {
        ParameterReport {
            name: name.to_owned(),
            value,
            ci95: [low95, high95],
            unit: unit.to_owned(),
        }
    });
    CauseReport {
        mechanism: mechanism.to_owned(),
        family: family.unwrap_or_default().to_owned(),
        inclusion_probability: judged.probability,
        confidence_level: 1,
        parameters: if is_told { effect.chain(own).collect() } else { Vec::new() },
        powders: Vec::new(),
    }
}

fn evidence(judged: &TraceJudged) -> Evidence {
    Evidence {
        cause: name(judged.mechanism).to_owned(),
        family: judged.mechanism.name().1.map(str::to_owned),
        log10_evidence: judged.log_evidence / LN_10,
        inclusion_probability: judged.probability,
    }
}

fn untestable((mechanism, reason): &(TraceMechanism, String)) -> UntestableReport {
    UntestableReport { mechanism: mechanism.name().0.to_owned(), reason: reason.clone() }
}
