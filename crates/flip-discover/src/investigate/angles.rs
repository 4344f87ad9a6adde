//! A complete investigation of angles: from a campaign to a report.

use super::channel::{Channel, Conclusion};
use super::scatter::{scatters, simulated};
use super::side::heard;
use super::steps::{Halt, Steps};
use super::words;
use crate::causes::catalogue::Mechanism;
use crate::causes::follows;
use crate::causes::hypothesis::{Cause, Untestable};
use crate::causes::response::{Action, Responses};
use crate::data::campaign::{Campaign, Run};
use crate::judge::claim::{Claim, Proposal};
use crate::judge::posterior::Posterior;
use crate::judge::prepared::Prepared;
use crate::judge::screen::{Settings, screen_among};
use crate::judge::verdict::correlation;
use crate::report::{
    CauseReport, Curve, Experiment, Finding, ParameterReport, Report, Row, UntestableReport,
    Verdict,
};
use crate::thresholds::{CLAIM, MOVED_TOGETHER};
use crate::worth::detectable::detectable;
use crate::worth::effects::curves;
use crate::worth::experiment::{experiment, settling};
use flip_core::domain::FieldError;
use flip_core::stats::summary::mean;
use std::ops::ControlFlow;

/// Investigates the angles of a campaign.
///
/// | argument | meaning |
/// |----------|---------|
/// | `responses` | how much each mechanism moves each powder, according to a simulator |
/// | `base` | version of the simulator that is judged |
/// | `corrected` | p-value of these angles, given what else is judged |
/// | `steps` | receives progress |
///
/// # Errors
/// A campaign whose runs carry no information about their noise; a stop was requested.
pub(crate) fn angles(
    campaign: &Campaign,
    responses: &Responses,
    base: &str,
    settings: &Settings,
    corrected: impl Fn(f64) -> f64,
    steps: &mut Steps<'_>,
) -> Result<Report, Halt> {
    let prepared = Prepared::new(campaign, responses)?;
    let channel = Channel::screened(campaign, responses, &prepared, settings, |share| {
        steps.go_on(0.3 * share, "judging every cause, here and where nothing is wrong")
    })?;
    steps.begin(0.3, "how large the effect is")?;
    let p_value = corrected(channel.screening.p_value);
    let conclusion = channel.concluded(p_value, settings, Proposal::is_found, |done| {
        let message = "leaving out days, powders and ranges, and searching again";
        steps.go_on(0.35 + 0.4 * done, message)
    })?;
    steps.begin(0.75, "what this design would find")?;
    let mut report = document(&channel, &conclusion, base, settings)?;
    steps.begin(0.9, "the experiment that would tell most")?;
    report.suggested_experiment = next_experiment(&channel, &conclusion, settings)?;
    report.sentence = sentence(&report, &channel, &conclusion.claim);
    if !report.null_check.is_judged() {
        let why = words::unjudged(campaign.sessions());
        report.sentence = format!("These angles cannot be judged: {why}.");
        report.unjudged = Some(why);
    }
    scatter(&mut report, campaign, &channel.posterior.shifts(), settings)?;
    Ok(report)
}

/// Everything in the document but the experiment and the sentences.
fn document(
    channel: &Channel<'_>,
    Conclusion { judgement, claim, gain }: &Conclusion,
    base: &str,
    settings: &Settings,
) -> Result<Report, FieldError> {
    let Channel { campaign, responses, prepared, posterior, screening } = channel;
    let is_found = claim.verdict != Verdict::NoDiscrepancy;
    let explained = judgement.proposal.is_found().then_some(posterior);
    let curves = curves(campaign, responses)?;
    Ok(Report {
        verdict: claim.verdict,
        findings: claim.findings(),
        causes: causes(prepared, posterior, claim),
        ambiguous_between: judgement.ambiguous_between(),
        unexplained: channel.unexplained(judgement),
        gain: gain.clone().filter(|_| is_found),
        minimum_detectable: detectable(campaign, prepared, screening, explained, settings),
        blind_spots: words::blind_spots(
            campaign.powders.len(),
            campaign.sessions() < campaign.runs.len(),
            &correlated(campaign),
        ),
        evidence: channel.evidence(),
        untestable: screening.untestable.iter().map(untestable).collect(),
        rows: rows(campaign, posterior, is_found),
        curves: if is_found { curves } else { flat(curves) },
        ..Report::blank(base, screening.p_value, channel.null_check())
    })
}

fn untestable(cause: &Untestable) -> UntestableReport {
    UntestableReport {
        mechanism: cause.mechanism.name().0.to_owned(),
        reason: cause.reason.clone(),
    }
}

/// The experiment that would tell most: what is open apart, or whether the likeliest is nothing.
fn next_experiment(
    channel: &Channel<'_>,
    Conclusion { judgement, claim, .. }: &Conclusion,
    settings: &Settings,
) -> Result<Option<Experiment>, FieldError> {
    let Channel { campaign, responses, prepared, .. } = channel;
    if claim.verdict == Verdict::NoDiscrepancy {
        let likeliest = judgement.ranked.first();
        return Ok(
            likeliest.and_then(|cause| settling(campaign, prepared, &cause.0, settings.seed))
        );
    }
    let Some(causes) = judgement.to_tell_apart() else { return Ok(None) };
    let is_claimed = claim.verdict != Verdict::Ambiguous;
    experiment(campaign, responses, &causes, is_claimed, settings)
}

fn sentence(report: &Report, channel: &Channel<'_>, claim: &Claim) -> String {
    let first = claim.told.first().filter(|_| report.verdict == Verdict::Cause);
    words::sentence(report, claim, first.and_then(|told| channel.posterior.law(&told.cause)))
}

/// Reports whether repeats scatter more in some conditions, or that this cannot be seen. It decides
/// nothing: the simulator makes no prediction of it.
fn scatter(
    report: &mut Report,
    campaign: &Campaign,
    explained: &[f64],
    settings: &Settings,
) -> Result<(), Halt> {
    let none = Responses::new();
    let prepared = scatters(campaign, explained)
        .ok()
        .and_then(|scatters| Some((Prepared::new(&scatters, &none).ok()?, scatters)));
    let Some((prepared, scatters)) =
        prepared.filter(|(prepared, _)| !prepared.hypotheses.is_empty())
    else {
        report.blind_spots.push(words::NO_SCATTER.to_owned());
        return Ok(());
    };
    let null = simulated(&scatters, settings.seed, settings.simulations);
    let screening = screen_among(&prepared, &[null], |_| ControlFlow::Continue(()));
    let screening = screening.ok_or(Halt::Stopped)?;
    let channel = Channel {
        campaign: &scatters,
        responses: &none,
        prepared: &prepared,
        posterior: Posterior::new(&prepared),
        screening,
    };
    let (heard, side) = heard(&channel, channel.screening.p_value, settings)?;
    report.findings.extend(heard.findings);
    if !heard.sentence.is_empty() {
        report.sentence = format!("{} {}", report.sentence, heard.sentence);
    }
    report.beside.push(side);
    Ok(())
}

/// Predicts runs that were not measured, by the simulator as it was and as a campaign extends it:
/// one row for each run without an angle.
///
/// # Errors
/// A campaign whose runs carry no information about their noise.
pub fn predict(campaign: &Campaign, responses: &Responses) -> Result<Vec<Row>, FieldError> {
    let (campaign, _) = follows::without(campaign);
    let prepared = Prepared::new(&campaign, responses)?;
    let rows = rows(&campaign, &Posterior::new(&prepared), true);
    Ok(rows.into_iter().filter(|row| row.measured_deg.is_none()).collect())
}

/// Pairs of recorded numbers that moved together.
fn correlated(campaign: &Campaign) -> Vec<(String, String, f64)> {
    let known: Vec<(&str, Vec<f64>)> = campaign
        .covariates
        .iter()
        .filter_map(|covariate| {
            Some((covariate.name.as_str(), campaign.numbers(&covariate.name).ok()?))
        })
        .collect();
    let pairs = (0..known.len()).flat_map(|a| (a + 1..known.len()).map(move |b| (a, b)));
    let of = |(a, b): (usize, usize)| {
        let r = correlation(&known[a].1, &known[b].1);
        (r.abs() >= MOVED_TOGETHER).then(|| (known[a].0.to_owned(), known[b].0.to_owned(), r))
    };
    pairs.filter_map(of).collect()
}

/// If nothing is found, the course is that of the simulator as it is.
fn flat(mut curves: Vec<Curve>) -> Vec<Curve> {
    curves.iter_mut().flat_map(|curve| &mut curve.course).for_each(|place| place[1] = 0.0);
    curves
}

/// Every row of the file, before and after; the repeats of a summary are one row. If nothing is
/// found, after equals before.
fn rows(campaign: &Campaign, posterior: &Posterior<'_>, is_found: bool) -> Vec<Row> {
    let predicted = posterior.predict(campaign);
    let known = |mean: f64| mean.is_finite().then_some(mean);
    let mut next = 0;
    let row = |repeats: &[Run]| {
        let [before, after] = predicted[next];
        next += repeats.len();
        let after = if is_found { after } else { before };
        Row {
            row: repeats[0].row,
            powder: campaign.powders[repeats[0].powder].clone(),
            measured_deg: mean(&repeats.iter().filter_map(|run| run.value).collect::<Vec<_>>()),
            before_deg: known(before.mean),
            before_sd_deg: before.sd,
            after_deg: known(after.mean),
            after_sd_deg: after.sd,
        }
    };
    let same = |a: &Run, b: &Run| a.row == b.row && a.value.is_some() == b.value.is_some();
    campaign.runs.chunk_by(same).map(row).collect()
}

/// The effect, and the amplitude of the simulator's mechanism that produces it.
fn parameters(mechanism: Mechanism, finding: &Finding) -> Vec<ParameterReport> {
    let effect = ParameterReport {
        name: "effect_5_95".to_owned(),
        value: finding.effect,
        ci95: finding.ci95,
        unit: finding.unit.clone(),
    };
    let amplitude = Action::of(mechanism).map(|action| {
        let mut ci95 = finding.ci95.map(|end| action.amplitude(end));
        ci95.sort_by(f64::total_cmp);
        ParameterReport {
            name: action.name.to_owned(),
            value: action.amplitude(finding.effect),
            ci95,
            unit: action.unit.to_owned(),
        }
    });
    std::iter::once(effect).chain(amplitude).collect()
}

/// Every cause of the catalogue; one whose extension predicts better has level 2.
fn causes(prepared: &Prepared, posterior: &Posterior<'_>, claim: &Claim) -> Vec<CauseReport> {
    let report = |cause: &Cause| {
        let Cause::Known(mechanism) = cause else { return None };
        let (name, family) = mechanism.name();
        let finding = claim.finding(cause);
        let inclusion_probability = posterior.inclusion_of(cause);
        let is_claimed =
            claim.is_worth_something && finding.is_some() && inclusion_probability >= CLAIM;
        Some(CauseReport {
            mechanism: name.to_owned(),
            family: family.to_owned(),
            inclusion_probability,
            confidence_level: if is_claimed { 2 } else { 1 },
            parameters: finding.map_or(Vec::new(), |finding| parameters(*mechanism, finding)),
            powders: finding.map_or(Vec::new(), |finding| finding.powders.clone()),
        })
    };
    let mut causes: Vec<CauseReport> =
        prepared.hypotheses.iter().filter_map(|hypothesis| report(&hypothesis.cause)).collect();
    causes.sort_by(|a, b| b.inclusion_probability.total_cmp(&a.inclusion_probability));
    causes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::sample;
    use crate::judge::claim::Told;
    use crate::worth::effects;

    #[test]
    fn a_claimed_cause_that_predicts_better_has_level_two() {
        let campaign = sample::campaign(1, |at| 3.0 * at.operator as f64);
        let responses = Responses::new();
        let prepared = Prepared::new(&campaign, &responses).unwrap();
        let posterior = Posterior::new(&prepared);
        let operator = Cause::Known(Mechanism::Operator);
        assert!(posterior.inclusion_of(&operator) >= CLAIM);
        let told = || -> Vec<Told> {
            effects::told(&campaign, &responses, std::slice::from_ref(&operator)).unwrap()
        };
        let level = |is_accepted: bool| {
            let claim = Claim::of(Proposal::Cause, told(), is_accepted);
            let causes = causes(&prepared, &posterior, &claim);
            let levels = |is_operator: bool| -> Vec<u8> {
                let of =
                    causes.iter().filter(|cause| (cause.mechanism == "operator") == is_operator);
                of.map(|cause| cause.confidence_level).collect()
            };
            assert!(levels(false).iter().all(|&level| level == 1));
            levels(true)
        };
        assert_eq!((level(true), level(false)), (vec![2], vec![1]));
    }
}
