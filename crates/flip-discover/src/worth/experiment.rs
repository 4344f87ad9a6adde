//! Plans the one experiment that best distinguishes two or three causes.
//!
//! Runs at low and high settings of the covariates the causes act through, all in one session and
//! in random order, so the day is the same for all. Each candidate is simulated: an angle is drawn
//! for each run under one of the causes (as probable as it is now), all are judged again with these
//! runs, and a success is counted when the right cause then holds [`ANSWER`] of their joint
//! probability.

use crate::causes::hypothesis::Cause;
use crate::causes::response::Responses;
use crate::data::campaign::{Campaign, Values};
use crate::data::scenario::{Conditions, Setting, extended, levels, percentile};
use crate::judge::posterior::Posterior;
use crate::judge::prepared::Prepared;
use crate::judge::screen::Settings;
use crate::report::Experiment;
use crate::report::names::{quantity, rounded};
use crate::thresholds::{ANSWER, CLAIM, ENOUGH, SETTLED_DEG};
use flip_core::domain::FieldError;
use flip_core::domain::seed::derive;
use flip_core::stats::normal;
use nalgebra::DMatrix;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use std::collections::BTreeMap;

/// Simulations of each candidate.
const PLAYS: usize = 60;
/// Runs of a candidate.
const RUNS: [usize; 4] = [12, 24, 48, 80];
/// Powders that take part: those with the largest response.
const POWDERS: usize = 3;
/// SD of the day effect over that of a repeat; it is the same for all causes.
const DAY: f64 = 0.3;
/// SD of the size of an effect over its estimate.
const SIZE_SD: f64 = 0.3;
/// Minutes of a run: filling, pouring, reading, cleaning.
const RUN_MIN: f64 = 4.0;

/// A covariate and its low and high settings.
type Ends = (String, [Setting; 2]);

/// What to measure to distinguish these causes; `None` where no setting differs. `is_claimed`: the
/// first is to be confirmed, so the covariate it acts through is always varied.
pub(crate) fn experiment(
    campaign: &Campaign,
    responses: &Responses,
    causes: &[&Cause],
    is_claimed: bool,
    settings: &Settings,
) -> Result<Option<Experiment>, FieldError> {
    let now = Prepared::new(campaign, responses)?;
    let powders = responding(campaign, &Posterior::new(&now));
    let ends = varied(campaign, causes.iter().flat_map(|cause| cause.covariates()));
    let mut designs = designs(&ends);
    if is_claimed {
        let acts = |name: &str| causes[0].covariates().contains(&name);
        designs.retain(|design| design.iter().any(|(name, _)| acts(name)));
    }
    let planned =
        |design: &Vec<&Ends>, count| runs(campaign, design, &ends, &powders, count, settings.seed);
    let candidates: Vec<[Vec<Planned>; RUNS.len()]> =
        designs.iter().map(|design| RUNS.map(|count| planned(design, count))).collect();
    let game = Game::new(campaign, responses, causes, &candidates)?;
    let asked = |Choice { design, size, chance, expected }: Choice| {
        let runs = &candidates[design][size];
        Experiment {
            what: words(campaign, &designs[design], &ends, &powders, runs.len()),
            runs: runs.iter().map(|run| written(campaign, run)).collect(),
            minutes: minutes(runs),
            chance_of_resolution: Some(chance),
            expected_posterior: Some(expected),
        }
    };
    Ok(game.best(&candidates, settings.seed)?.map(asked))
}

/// Those of the covariates whose setting can differ, each once.
fn varied<'a>(campaign: &Campaign, covariates: impl Iterator<Item = &'a str>) -> Vec<Ends> {
    let mut ends: Vec<Ends> = Vec::new();
    for name in covariates {
        if ends.iter().all(|end| end.0 != name) {
            ends.extend(settings_of(campaign, name).map(|of| (name.to_owned(), of)));
        }
    }
    ends
}

/// Possible designs: each covariate alone, each two against each other, and all.
fn designs(ends: &[Ends]) -> Vec<Vec<&Ends>> {
    let mut designs: Vec<Vec<&Ends>> = ends.iter().map(|end| vec![end]).collect();
    for (k, one) in ends.iter().enumerate() {
        designs.extend(ends[k + 1..].iter().map(|other| vec![one, other]));
    }
    if ends.len() > 2 {
        designs.push(ends.iter().collect());
    }
    designs
}

/// Runs needed to show a difference of this many degrees between low and high of the covariate a
/// cause acts through, in four of five cases at 5 %: `N = (2 (1.96 + 0.84) s / difference)^2` for
/// two groups of N / 2 with SD s.
pub(crate) fn settling(
    campaign: &Campaign,
    prepared: &Prepared,
    cause: &Cause,
    seed: u64,
) -> Option<Experiment> {
    let ends = varied(campaign, cause.covariates().into_iter());
    let design: Vec<&Ends> = ends.iter().collect();
    if design.is_empty() {
        return None;
    }
    let powders: Vec<usize> = (0..campaign.powders.len()).collect();
    let needed = (2.0 * (1.96 + 0.84) * prepared.repeat_sd(&prepared.observed) / SETTLED_DEG)
        .powi(2)
        .ceil() as usize;
    let cells = powders.len() << design.len();
    let count = needed.div_ceil(cells) * cells;
    let runs = runs(campaign, &design, &ends, &powders, count, seed);
    let what = words(campaign, &design, &ends, &powders, runs.len());
    let what = format!("{what}, to show a difference of {SETTLED_DEG}°");
    let minutes = minutes(&runs);
    let runs = runs.iter().map(|run| written(campaign, run)).collect();
    Some(Experiment {
        what,
        runs,
        minutes,
        chance_of_resolution: Some(0.8),
        expected_posterior: Some(CLAIM),
    })
}

/// The powders that the found effect moves most.
fn responding(campaign: &Campaign, posterior: &Posterior<'_>) -> Vec<usize> {
    let shifts = posterior.shifts();
    let moved = |powder: usize| {
        let of = campaign.measured().into_iter().filter(|&i| campaign.runs[i].powder == powder);
        of.map(|i| shifts[i].powi(2)).sum::<f64>()
    };
    let mut order: Vec<usize> = (0..campaign.powders.len()).collect();
    order.sort_by(|&a, &b| moved(b).total_cmp(&moved(a)));
    order.truncate(POWDERS);
    order
}

/// Values at which a time-dependent cause has not begun, regardless of the range seen.
const BEGINNINGS: [(&str, f64); 2] = [("rest_min", 1.0), ("container_age_d", 0.0)];

/// Low and high: the ends of the range seen, from the beginning if the cause is time; or the first
/// two names.
fn settings_of(campaign: &Campaign, covariate: &str) -> Option<[Setting; 2]> {
    match campaign.values(covariate)? {
        Values::Levels { names, .. } => {
            (names.len() > 1).then_some([Setting::Level(0), Setting::Level(1)])
        }
        Values::Numbers(_) => {
            let [low, high] =
                [percentile(campaign, covariate, 0.02)?, percentile(campaign, covariate, 0.98)?];
            let beginning = BEGINNINGS
                .iter()
                .find(|time| time.0 == covariate)
                .map_or(low, |time| time.1.min(low));
            Some([beginning, high].map(Setting::Number))
        }
    }
}

type Planned = (usize, Conditions);

/// Every combination of the design's settings on each powder, as often as `count` allows, in random
/// order; covariates the design does not vary are held at their low end.
fn runs(
    campaign: &Campaign,
    design: &[&Ends],
    all: &[Ends],
    powders: &[usize],
    count: usize,
    seed: u64,
) -> Vec<Planned> {
    let cells = 1usize << design.len();
    let repeats = (count / (cells * powders.len())).max(1);
    let held: Conditions = all.iter().map(|(name, ends)| (name.clone(), ends[0])).collect();
    let mut runs = Vec::new();
    for _ in 0..repeats {
        for &powder in powders {
            for cell in 0..cells {
                let mut conditions = held.clone();
                for (k, (name, ends)) in design.iter().enumerate() {
                    conditions.insert(name.clone(), ends[cell >> k & 1]);
                }
                runs.push((powder, conditions));
            }
        }
    }
    runs.shuffle(&mut Pcg64::seed_from_u64(derive(seed, &[0x4558_5045])));
    if campaign.values("order_in_session").is_some() {
        for (k, (_, conditions)) in runs.iter_mut().enumerate() {
            conditions
                .entry("order_in_session".to_owned())
                .or_insert(Setting::Number(k as f64 + 1.0));
        }
    }
    runs
}

/// The candidate chosen: its design, its place in [`RUNS`], and what [`Game::play`] said of it.
struct Choice {
    design: usize,
    size: usize,
    chance: f64,
    expected: f64,
}

/// Inputs for simulating candidates.
struct Game<'a> {
    campaign: &'a Campaign,
    responses: &'a Responses,
    causes: &'a [&'a Cause],
    /// Current probability of each.
    now: Vec<f64>,
    /// The contribution of each cause to each run, those of all candidates after the measured.
    shifts: Vec<Vec<f64>>,
    /// With the runs of all candidates, none of them measured.
    prepared: Prepared,
    /// The first of these runs.
    first: usize,
    /// Their session, a new one.
    session: usize,
}

impl<'a> Game<'a> {
    fn new(
        campaign: &'a Campaign,
        responses: &'a Responses,
        causes: &'a [&'a Cause],
        candidates: &[[Vec<Planned>; RUNS.len()]],
    ) -> Result<Self, FieldError> {
        let session = campaign.runs.iter().map(|run| run.session).max().unwrap_or(0) + 1;
        let asked: Vec<_> =
            candidates.iter().flatten().flatten().map(|(p, c)| (*p, c.clone(), None)).collect();
        let (unseen, first) = extended(campaign, session, &asked);
        let prepared = Prepared::new(&unseen, responses)?;
        let posterior = Posterior::new(&prepared);
        let shifts = causes.iter().map(|cause| posterior.shifts_by(cause)).collect();
        let now = causes.iter().map(|cause| posterior.inclusion_of(cause).max(0.05)).collect();
        Ok(Self { campaign, responses, causes, now, shifts, prepared, first, session })
    }

    /// The cheapest candidate that is likely to answer, else the one most likely to answer.
    fn best(
        &self,
        candidates: &[[Vec<Planned>; RUNS.len()]],
        seed: u64,
    ) -> Result<Option<Choice>, FieldError> {
        let mut best: Option<(f64, Choice)> = None;
        let mut first = self.first;
        for (design, sizes) in candidates.iter().enumerate() {
            let mut is_enough = false;
            for (size, runs) in sizes.iter().enumerate() {
                let rows = first..first + runs.len();
                first = rows.end;
                if is_enough {
                    continue; // More runs of the same cost more.
                }
                let shifts: Vec<&[f64]> = self.shifts.iter().map(|of| &of[rows.clone()]).collect();
                let [chance, expected] = self.play(runs, &shifts, seed)?;
                is_enough = chance >= ENOUGH;
                let minutes = minutes(runs);
                let score = if is_enough { 2.0 - minutes / 1e5 } else { chance - minutes / 1e6 };
                if best.as_ref().is_none_or(|(best, _)| score > *best) {
                    best = Some((score, Choice { design, size, chance, expected }));
                }
            }
        }
        Ok(best.map(|(_, choice)| choice))
    }

    /// How often the right cause holds [`ANSWER`] of the candidates' probability, and its mean
    /// share. `shifts`: the contribution of each cause to each run.
    fn play(&self, runs: &[Planned], shifts: &[&[f64]], seed: u64) -> Result<[f64; 2], FieldError> {
        let old = &self.prepared.observed;
        let mut rng = Pcg64::seed_from_u64(derive(seed, &[0x504c_4159]));
        let mut normal = || normal::quantile(rng.random::<f64>().clamp(1e-12, 1.0 - 1e-12));
        let repeat_sd = self.prepared.repeat_sd(old);
        let right_in = |play: usize| play % self.causes.len();
        let mut draw = |play: usize| -> Vec<f64> {
            let (day, size) = (DAY * repeat_sd * normal(), 1.0 + SIZE_SD * normal());
            shifts[right_in(play)]
                .iter()
                .map(|shift| size * shift + day + repeat_sd * normal())
                .collect()
        };
        let drawn: Vec<Vec<f64>> = (0..PLAYS).map(&mut draw).collect();
        let measured: Vec<_> = runs
            .iter()
            .zip(&drawn[0])
            .map(|((powder, at), shift)| {
                (*powder, at.clone(), Some(self.prepared.centres[*powder] + shift))
            })
            .collect();
        let (with_runs, _) = extended(self.campaign, self.session, &measured);
        let after = Prepared::new(&with_runs, self.responses)?;
        let all = DMatrix::from_fn(old.len() + runs.len(), PLAYS, |i, k| {
            match i.checked_sub(old.len()) {
                None => old[i],
                Some(new) => drawn[k][new],
            }
        });
        let of =
            |cause: &&Cause| after.hypotheses.iter().find(|hypothesis| hypothesis.cause == **cause);
        let Some(judged) = self.causes.iter().map(of).collect::<Option<Vec<_>>>() else {
            return Ok([0.0, 0.5]);
        };
        let seen = after.seen(&all);
        let odds: Vec<Vec<f64>> =
            judged.iter().map(|hypothesis| after.log_odds(hypothesis, &seen)).collect();
        let (mut resolved, mut expected, mut total) = (0.0, 0.0, 0.0);
        for play in 0..PLAYS {
            let log: Vec<f64> = odds
                .iter()
                .zip(&judged)
                .map(|(of, hypothesis)| of[play] + hypothesis.prior.ln())
                .collect();
            let right = right_in(play);
            let share = 1.0 / log.iter().map(|other| (other - log[right]).exp()).sum::<f64>();
            let weight = self.now[right];
            total += weight;
            expected += weight * share;
            resolved += weight * f64::from(u8::from(share >= ANSWER));
        }
        Ok([resolved / total, expected / total])
    }
}

/// Minutes at the bench: the runs, the rests one after another, and half an hour for each humidity
/// that a chamber has to reach.
fn minutes(runs: &[Planned]) -> f64 {
    let of =
        |name: &'static str| runs.iter().filter_map(move |(_, conditions)| conditions.get(name));
    let number =
        |setting: &Setting| if let Setting::Number(value) = setting { *value } else { 0.0 };
    // Heaps rest side by side, so the longest rest counts.
    let rest = of("rest_min").map(number).fold(0.0, f64::max);
    let mut humidities: Vec<u64> =
        of("relative_humidity_pct").map(|setting| number(setting).to_bits()).collect();
    humidities.sort_unstable();
    humidities.dedup();
    let chamber = 30.0 * humidities.len().saturating_sub(1) as f64;
    RUN_MIN * runs.len() as f64 + rest + chamber
}

fn shown(campaign: &Campaign, covariate: &str, setting: Setting) -> String {
    match setting {
        Setting::Number(value) => rounded(value),
        Setting::Level(level) => {
            levels(campaign, covariate).map_or(String::new(), |names| names[level].clone())
        }
    }
}

fn written(campaign: &Campaign, (powder, conditions): &Planned) -> BTreeMap<String, String> {
    let settings =
        conditions.iter().map(|(name, setting)| (name.clone(), shown(campaign, name, *setting)));
    std::iter::once(("powder".to_owned(), campaign.powders[*powder].clone()))
        .chain(settings)
        .collect()
}

fn words(
    campaign: &Campaign,
    design: &[&Ends],
    all: &[Ends],
    powders: &[usize],
    count: usize,
) -> String {
    let at = |(name, ends): &Ends| {
        let (quantity, unit) = quantity(name);
        format!(
            "{quantity} {} and {}{unit}",
            shown(campaign, name, ends[0]),
            shown(campaign, name, ends[1])
        )
    };
    let varied = design.iter().map(|ends| at(ends)).collect::<Vec<_>>().join(" by ");
    let held = all.iter().filter(|ends| !design.iter().any(|varied| varied.0 == ends.0)).map(
        |(name, ends)| {
            let (quantity, unit) = quantity(name);
            format!("{quantity} at {}{unit}", shown(campaign, name, ends[0]))
        },
    );
    let held = held.collect::<Vec<_>>().join(", ");
    let names = powders
        .iter()
        .map(|&powder| campaign.powders[powder].replace('_', " "))
        .collect::<Vec<_>>()
        .join(", ");
    let held = if held.is_empty() { String::new() } else { format!(", holding {held}") };
    format!("{count} runs of {names} in one session and in the order given: {varied}{held}")
}
