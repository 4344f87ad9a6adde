//! Rates over many hidden effects, M1 to M15 of the suite, each with its Clopper-Pearson limits.

use crate::judge::{Answer, Laboratory, limits};
use crate::truth::{Case, Family, case};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

/// Effects whose SD within a powder is this many degrees.
pub const LARGE_DEG: f64 = 1.0;
pub const MEDIUM_DEG: f64 = 0.75;
/// Simulated campaigns of an investigation here: the fewest that there may be.
pub const SIMULATIONS: u32 = 99;
/// Days of which nothing was seen, for the error against the noise-free truth.
const NEW_DAYS: usize = 20;

/// Every family with every seed.
pub fn wanted(families: &[Family], size_deg: f64, seeds: std::ops::Range<u64>) -> Vec<(Family, f64, u64)> {
    seeds.flat_map(|seed| families.iter().map(move |&family| (family, size_deg, seed))).collect()
}

/// What one hidden effect came to.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Scored {
    pub family: String,
    pub size_deg: f64,
    pub seed: u64,
    pub is_null: bool,
    pub is_found: bool,
    pub is_top_right: bool,
    pub is_confident_and_right: bool,
    pub claims: usize,
    pub false_claims: usize,
    /// The covariate of an effect outside the catalogue, and its form class.
    pub is_covariate_right: bool,
    pub is_form_right: bool,
    /// Whether the 90 % interval holds the true change over the covariate's span; absent where nothing comparable was told.
    pub is_effect_covered: Option<bool>,
    pub coverage90: Option<f64>,
    /// Mean squared error against the noise-free truth on new days, before, after, degrees squared.
    pub new_days: Option<[f64; 2]>,
    /// After the experiment that the report asked for: claims, all right.
    pub after_experiment: Option<(usize, bool)>,
    pub wall_s: f64,
    pub verdict: String,
    pub top: String,
}

/// Give a case to the command and score what it says.
pub fn score(laboratory: &Laboratory, family: Family, size_deg: f64, seed: u64, simulations: u32) -> Scored {
    let case = case(family, size_deg, seed);
    let answer = laboratory.discover(&case.csv, simulations);
    let after_experiment =
        (family == Family::Confounded && !answer.experiment.is_empty() && answer.verdict == "ambiguous").then(|| {
            let more = case.after_experiment(&answer.experiment);
            let then = laboratory.discover(&more.csv, simulations);
            (then.claimed.len(), then.is_confident_and_right(&case))
        });
    Scored {
        family: case.family.to_owned(),
        size_deg: case.size_deg,
        seed,
        is_null: case.effect_deg.iter().all(|effect| *effect == 0.0),
        is_found: answer.is_found(),
        is_top_right: answer.is_top_right(&case),
        is_confident_and_right: answer.is_confident_and_right(&case),
        claims: answer.claimed.len(),
        false_claims: answer.false_claims(&case),
        is_covariate_right: answer.verdict == "unexplained" && answer.covariate == case.covariate,
        is_form_right: answer.form_class.is_some() && answer.form_class.as_deref() == case.form_class,
        is_effect_covered: is_effect_covered(&case, &answer),
        coverage90: answer.coverage90,
        new_days: new_days(laboratory, &case, &answer),
        after_experiment,
        wall_s: answer.wall_s,
        verdict: answer.verdict,
        top: answer.top,
    }
}

/// The interval of the report at 90 %: its 95 % interval drawn in by the ratio of the normal deviates.
fn is_effect_covered(case: &Case, answer: &Answer) -> Option<bool> {
    let single = case.mechanisms.len() == 1 && answer.claimed.len() == 1 && answer.false_claims(case) == 0;
    let has_span = case.covariate.is_some() && case.effect_5_95_deg.is_finite();
    // Of names the report tells the two that differ most, the truth the first and the last: comparable where there are two.
    let is_of_names = ["batch", "method", "operator", "plate"].contains(&case.covariate.as_deref().unwrap_or(""));
    if !single || !has_span || is_of_names {
        return None;
    }
    let (effect, ci95) = answer.effect?;
    let [low, high] = ci95.map(|end| effect + (end - effect) * 1.645 / 1.96);
    Some((low..=high).contains(&case.effect_5_95_deg))
}

fn new_days(laboratory: &Laboratory, case: &Case, answer: &Answer) -> Option<[f64; 2]> {
    let version = answer.extended.as_ref()?;
    let new = case.more_days(NEW_DAYS);
    let predicted = laboratory.predict(version, &new.csv);
    assert_eq!(predicted.len(), new.noise_free_deg.len(), "{}: a row each", case.name);
    let mse = |k: usize| {
        let squares = predicted.iter().zip(&new.noise_free_deg).map(|(of, truth)| (of[k] - truth).powi(2));
        squares.sum::<f64>() / predicted.len() as f64
    };
    Some([mse(0), mse(1)])
}

/// Scores that are in the file already, and the others as they come, each written at once.
pub fn scored(laboratory: &Laboratory, file: &Path, wanted: &[(Family, f64, u64)], simulations: u32) -> Vec<Scored> {
    let known: Vec<Scored> = std::fs::read_to_string(file)
        .unwrap_or_default()
        .lines()
        .filter_map(|line| serde_json::from_str(line).ok())
        .collect();
    let key = |family: &str, size: f64, seed: u64| (family.to_owned(), (100.0 * size).round() as i64, seed);
    let mut of: BTreeMap<_, Scored> = known.into_iter().map(|it| (key(&it.family, it.size_deg, it.seed), it)).collect();
    let mut all = Vec::new();
    for (done, &(family, size, seed)) in wanted.iter().enumerate() {
        let named = if Family::NULLS.contains(&family) { 0.0 } else { size };
        let new = match of.remove(&key(family.name(), named, seed)) {
            Some(known) => known,
            None => {
                let new = score(laboratory, family, size, seed, simulations);
                let mut out = std::fs::OpenOptions::new().create(true).append(true).open(file).unwrap();
                writeln!(out, "{}", serde_json::to_string(&new).unwrap()).unwrap();
                eprintln!(
                    "{} of {}: {} {size} {seed}: {} ({})",
                    done + 1,
                    wanted.len(),
                    new.family,
                    new.verdict,
                    new.top
                );
                new
            }
        };
        all.push(new);
    }
    all
}

/// One line of the table.
fn line(name: &str, hits: usize, of: usize, target: &str) -> String {
    let [low, high] = limits(hits, of.max(1)).map(|limit| 100.0 * limit);
    let rate = 100.0 * hits as f64 / of.max(1) as f64;
    format!("{name:<58} {hits:>4} of {of:<4} {rate:>5.1} %  [{low:.1}, {high:.1}]  target {target}\n")
}

fn count<'a>(of: impl Iterator<Item = &'a Scored> + Clone, which: impl Fn(&Scored) -> bool) -> (usize, usize) {
    (of.clone().filter(|it| which(it)).count(), of.count())
}

fn is_single(it: &Scored) -> bool {
    Family::SINGLES.iter().any(|family| family.name() == it.family)
}

/// The table of rates.
pub fn table(all: &[Scored]) -> String {
    let mut text = String::new();
    let mut rate = |name: &str, (hits, of): (usize, usize), target: &str| {
        if of > 0 {
            text += &line(name, hits, of, target);
        }
    };
    let nulls = all.iter().filter(|it| it.is_null && it.family != "wild");
    rate("M1 false alarms, all nulls", count(nulls.clone(), |it| it.is_found), "<= 5 %");
    for family in Family::NULLS {
        let of = nulls.clone().filter(|it| it.family == family.name());
        rate(&format!("   {}", family.name()), count(of, |it| it.is_found), "upper limit <= 12 %");
    }
    let effects = all.iter().filter(|it| !it.is_null);
    let claims: usize = effects.clone().map(|it| it.claims).sum();
    rate("M2 false claims of all claims", (effects.clone().map(|it| it.false_claims).sum(), claims), "<= 5 %");
    let large = effects.clone().filter(|it| is_single(it) && it.size_deg == LARGE_DEG);
    rate("M3 found, one cause, L", count(large.clone(), |it| it.is_found), ">= 95 %");
    for family in Family::SINGLES {
        let of = large.clone().filter(|it| it.family == family.name());
        rate(&format!("   {}", family.name()), count(of, |it| it.is_found), "");
    }
    for (name, target) in [("humidity", ">= 75 %"), ("rest_time", ">= 90 %")] {
        let of = effects.clone().filter(|it| it.family == name && it.size_deg == MEDIUM_DEG);
        rate(&format!("M3 found, {name}, M"), count(of, |it| it.is_found), target);
    }
    let detected = large.clone().filter(|it| it.is_found);
    rate("M4 most probable cause right, of those found, L", count(detected, |it| it.is_top_right), ">= 90 %");
    rate("M5 confident and right, one cause, L", count(large.clone(), |it| it.is_confident_and_right), ">= 85 %");
    for family in Family::SINGLES {
        let of = large.clone().filter(|it| it.family == family.name());
        rate(&format!("   {}", family.name()), count(of, |it| it.is_confident_and_right), "");
    }
    let of = |family: Family| effects.clone().filter(move |it| it.family == family.name());
    rate("M5 confident and right, two causes", count(of(Family::TwoCauses), |it| it.is_confident_and_right), ">= 60 %");
    rate("M6 confident and wrong, all effects", count(effects.clone(), |it| it.false_claims > 0), "<= 5 %");
    let confounded = of(Family::Confounded);
    rate("M7 confounded: confident and wrong", count(confounded.clone(), |it| it.false_claims > 0), "<= 5 %");
    let asked = confounded.filter(|it| it.after_experiment.is_some());
    rate(
        "M7 right after the experiment asked for",
        count(asked, |it| it.after_experiment.is_some_and(|it| it.1)),
        ">= 80 %",
    );
    let recorded = of(Family::Recorded).filter(|it| it.size_deg == LARGE_DEG);
    rate("M8 outside the catalogue: right variable", count(recorded.clone(), |it| it.is_covariate_right), ">= 85 %");
    let named = recorded.filter(|it| it.is_covariate_right);
    rate("M8 class of the law right, of those", count(named, |it| it.is_form_right), ">= 60 %");
    rate("M8 nobody recorded it: found", count(of(Family::Unrecorded), |it| it.is_found), "");
    let told = effects.clone().filter(|it| it.is_effect_covered.is_some());
    rate("M9 effect within its 90 % interval", count(told, |it| it.is_effect_covered == Some(true)), "85 to 95 %");
    let wild = all.iter().filter(|it| it.family == "wild");
    rate("wild: nothing hidden, declared", count(wild.clone().filter(|it| it.is_null), |it| it.is_found), "<= 5 %");
    rate("wild: found", count(wild.clone().filter(|it| !it.is_null), |it| it.is_found), "");
    rate("wild: confident and wrong", count(wild.filter(|it| !it.is_null), |it| it.false_claims > 0), "<= 5 %");
    text += &gains(all);
    text
}

/// Gains and times, which are no rates.
fn gains(all: &[Scored]) -> String {
    let mut text = String::new();
    let gains: Vec<f64> = all.iter().filter_map(|it| it.new_days).map(|[before, after]| 1.0 - after / before).collect();
    if !gains.is_empty() {
        let mean = gains.iter().sum::<f64>() / gains.len() as f64;
        let least = gains.iter().copied().fold(f64::INFINITY, f64::min);
        let n = gains.len();
        text += &format!(
            "M10 explained of new days' noise-free effect: mean {:.0} %, least {:.0} %, n {n}  target 75 %, 60 %\n",
            100.0 * mean,
            100.0 * least
        );
    }
    let covered: Vec<f64> = all.iter().filter(|it| !it.is_null).filter_map(|it| it.coverage90).collect();
    if !covered.is_empty() {
        let mean = covered.iter().sum::<f64>() / covered.len() as f64;
        text += &format!(
            "M11 held-out runs within the 90 % interval: {:.1} %, n {}  target 85 to 95 %\n",
            100.0 * mean,
            covered.len()
        );
    }
    let mut walls: Vec<f64> = all.iter().map(|it| it.wall_s).collect();
    walls.sort_by(f64::total_cmp);
    if let (Some(middle), Some(most)) = (walls.get(walls.len() / 2), walls.last()) {
        text += &format!(
            "M15 seconds of an investigation on this machine: median {middle:.1}, most {most:.1}  target 30 for 200 rows\n"
        );
    }
    text
}
