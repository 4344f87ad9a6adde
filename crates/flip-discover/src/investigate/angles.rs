//! A complete investigation of angles: from a campaign to a report.

use super::scatter::{scatters, simulated};
use super::side::Beside;
use super::words;
use crate::causes::catalogue::Mechanism;
use crate::causes::follows;
use crate::causes::hypothesis::{Cause, Untestable};
use crate::causes::response::Action;
use crate::causes::response::Responses;
use crate::data::campaign::{Campaign, Run};
use crate::judge::claim::Claim;
use crate::judge::posterior::Posterior;
use crate::judge::prepared::Prepared;
use crate::judge::screen::{Judged, Screening, Settings, screen_among, screen_prepared};
use crate::judge::verdict::{Judgement, correlation};
use crate::report::{
    CauseReport, Curve, Evidence, Finding, FormClass, Gain, NullCheck, ParameterReport, Report,
    Row, Unexplained, UntestableReport, Verdict,
};
use crate::thresholds::{CLAIM, MOVED_TOGETHER};
use crate::worth::detectable::detectable;
use crate::worth::effects::{self, curves};
use crate::worth::experiment::{experiment, settling};
use crate::worth::held_out::{Stopped, gain};
use crate::worth::law::law;
use flip_core::domain::FieldError;
use flip_core::domain::job::Progress;
use flip_core::stats::summary::mean;
use std::ops::ControlFlow;

/// Investigates a campaign.
///
/// | argument | meaning |
/// |----------|---------|
/// | `responses` | how much each mechanism moves each powder, according to a simulator |
/// | `base` | version of the simulator that is judged |
/// | `corrected` | p-value of these angles, given what else is judged |
/// | `on_progress` | receives progress; `Break` stops, and there is no report |
///
/// # Errors
/// A setting out of bounds; a campaign whose runs carry no information about their noise.
pub(crate) fn angles(
    campaign: &Campaign,
    responses: &Responses,
    base: &str,
    settings: &Settings,
    corrected: impl Fn(f64) -> f64,
    mut on_progress: impl FnMut(&Progress) -> ControlFlow<()>,
) -> Result<Option<Report>, FieldError> {
    let mut step = |fraction: f64, message: &str| {
        on_progress(&Progress { fraction, message: message.to_owned() }).is_break()
    };
    let settings = settings.checked()?;
    let prepared = Prepared::new(campaign, responses)?;
    let judged = |share: f64| match step(
        0.3 * share,
        "judging every cause, here and where nothing is wrong",
    ) {
        true => ControlFlow::Break(()),
        false => ControlFlow::Continue(()),
    };
    let posterior = Posterior::new(&prepared);
    let shifts = posterior.shifts();
    let screened = screen_prepared(&prepared, campaign, &shifts, &settings, judged);
    let Some(screening) = screened else { return Ok(None) };
    let judgement = Judgement::of(&prepared, &posterior, corrected(screening.p_value));
    let mut report = blank(&screening, base);
    report.evidence = evidence(&prepared, &screening, &posterior);
    report.blind_spots = words::blind_spots(
        campaign.powders.len(),
        campaign.sessions() < campaign.runs.len(),
        &correlated(campaign),
    );
    if step(0.3, "how large the effect is") {
        return Ok(None);
    }
    let told = effects::told(campaign, responses, &judgement.told)?;
    let fold = |done: f64| match step(
        0.35 + 0.4 * done,
        "leaving out days, powders and ranges, and searching again",
    ) {
        true => ControlFlow::Break(()),
        false => ControlFlow::Continue(()),
    };
    let gain = match worth(campaign, responses, &judgement, &settings, fold) {
        Ok(gain) => gain,
        Err(Stopped) => return Ok(None),
    };
    let claim =
        Claim::of(judgement.proposal, told, gain.as_ref().is_some_and(|gain| gain.accepted));
    report.verdict = claim.verdict;
    let is_found = report.verdict != Verdict::NoDiscrepancy;
    report.gain = gain.filter(|_| is_found);
    if step(0.75, "what this design would find") {
        return Ok(None);
    }
    let explained = judgement.proposal.is_found().then_some(&posterior);
    report.minimum_detectable = detectable(campaign, &prepared, &screening, explained, &settings);
    report.rows = rows(campaign, &posterior, is_found);
    report.curves =
        if is_found { curves(campaign, responses)? } else { flat(curves(campaign, responses)?) };
    report.findings = claim.findings();
    report.causes = causes(&prepared, &posterior, &claim);
    report.ambiguous_between = judgement.ambiguous_between();
    report.unexplained = judgement.unexplained().map(|covariate| match covariate {
        Some(covariate) => law(campaign, &prepared, covariate),
        None => Unexplained {
            covariate: None,
            law: "a wander over the sessions".to_owned(),
            form_class: FormClass::Smooth,
        },
    });
    if step(0.9, "the experiment that would tell most") {
        return Ok(None);
    }
    report.suggested_experiment = match (judgement.to_tell_apart(), judgement.ranked.first()) {
        (Some(causes), _) if is_found => experiment(
            campaign,
            responses,
            &causes,
            report.verdict != Verdict::Ambiguous,
            &settings,
        )?,
        (_, Some((likeliest, _))) if !is_found => {
            settling(campaign, &prepared, likeliest, settings.seed)
        }
        _ => None,
    };
    let first = claim.told.first().filter(|_| report.verdict == Verdict::Cause);
    report.sentence =
        words::sentence(&report, &claim, first.and_then(|it| posterior.law(&it.cause)));
    if !report.null_check.is_judged() {
        let why = words::unjudged(campaign.sessions());
        report.sentence = format!("These angles cannot be judged: {why}.");
        report.unjudged = Some(why);
    }
    scatter(&mut report, campaign, &shifts, &settings)?;
    Ok(Some(report))
}

/// The gain of the proposal on left-out days; nothing if nothing is proposed or nothing can be left
/// out.
pub(crate) fn worth(
    campaign: &Campaign,
    responses: &Responses,
    judgement: &Judgement,
    settings: &Settings,
    on_fold: impl FnMut(f64) -> ControlFlow<()>,
) -> Result<Option<Gain>, Stopped> {
    if !judgement.proposal.is_found() {
        return Ok(None);
    }
    let covariate = judgement.told.first().and_then(|cause| cause.covariates().first().copied());
    let covariate = covariate.filter(|name| campaign.numbers(name).is_ok());
    gain(campaign, responses, covariate, settings, on_fold)
}

/// Reports whether repeats scatter more in some conditions, or that this cannot be seen. It decides
/// nothing: the simulator makes no prediction of it.
fn scatter(
    report: &mut Report,
    campaign: &Campaign,
    explained: &[f64],
    settings: &Settings,
) -> Result<(), FieldError> {
    let prepared = scatters(campaign, explained)
        .ok()
        .and_then(|it| Some((Prepared::new(&it, &Responses::new()).ok()?, it)));
    let Some((prepared, scatters)) =
        prepared.filter(|(prepared, _)| !prepared.hypotheses.is_empty())
    else {
        report.blind_spots.push(words::NO_SCATTER.to_owned());
        return Ok(());
    };
    let null = simulated(&scatters, settings.seed, settings.simulations);
    let Some(screening) = screen_among(&prepared, &[null], |_| ControlFlow::Continue(())) else {
        return Ok(());
    };
    let p_value = screening.p_value;
    let posterior = Posterior::new(&prepared);
    let beside = Beside { campaign: &scatters, prepared: &prepared, posterior, screening };
    let (heard, side) = beside.heard(p_value, settings)?;
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
        .filter_map(|it| Some((it.name.as_str(), campaign.numbers(&it.name).ok()?)))
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
    curves.iter_mut().flat_map(|it| &mut it.course).for_each(|place| place[1] = 0.0);
    curves
}

pub(crate) fn evidence(
    prepared: &Prepared,
    screening: &Screening,
    posterior: &Posterior<'_>,
) -> Vec<Evidence> {
    let of = |judged: &Judged| {
        let (cause, family) = judged.cause.name();
        Evidence {
            cause,
            family: family.map(str::to_owned),
            log10_evidence: judged.log_evidence / std::f64::consts::LN_10,
            inclusion_probability: posterior.inclusion_of(&judged.cause),
        }
    };
    // A cause explained by the powders' means has no evidence, for or against.
    let mut all: Vec<Evidence> =
        screening.judged.iter().filter(|it| it.log_evidence.is_finite()).map(of).collect();
    debug_assert!(all.len() <= prepared.hypotheses.len());
    all.sort_by(|a, b| b.inclusion_probability.total_cmp(&a.inclusion_probability));
    all
}

fn blank(screening: &Screening, base: &str) -> Report {
    let untestable = |it: &Untestable| UntestableReport {
        mechanism: it.mechanism.name().0.to_owned(),
        reason: it.reason.clone(),
    };
    let null_check = NullCheck::of(&screening.null, screening.statistic);
    Report {
        untestable: screening.untestable.iter().map(untestable).collect(),
        ..Report::blank(base, screening.p_value, null_check)
    }
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
            parameters: finding.map_or(Vec::new(), |it| parameters(*mechanism, it)),
            powders: finding.map_or(Vec::new(), |it| it.powders.clone()),
        })
    };
    let mut causes: Vec<CauseReport> =
        prepared.hypotheses.iter().filter_map(|it| report(&it.cause)).collect();
    causes.sort_by(|a, b| b.inclusion_probability.total_cmp(&a.inclusion_probability));
    causes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::sample;
    use crate::judge::claim::{Proposal, Told};

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
                let of = causes.iter().filter(|it| (it.mechanism == "operator") == is_operator);
                of.map(|it| it.confidence_level).collect()
            };
            assert!(levels(false).iter().all(|&level| level == 1));
            levels(true)
        };
        assert_eq!((level(true), level(false)), (vec![2], vec![1]));
    }
}
