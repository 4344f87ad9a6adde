//! Rates over many hidden effects, M1 to M15 of the suite, each with its Clopper-Pearson limits.

use crate::heaps;
use crate::judge::{Answer, Laboratory, limits, side_by_side};
use crate::truth::{Case, Family, case};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

/// Effects whose SD within a powder is this many degrees.
pub const LARGE_DEG: f64 = 1.0;
pub const MEDIUM_DEG: f64 = 0.75;
/// Simulated campaigns per investigation here: the fewest allowed.
pub const SIMULATIONS: u32 = 99;
/// Unseen days, for the error against the noise-free truth.
const NEW_DAYS: usize = 20;

/// The origin of a campaign.
#[derive(Debug, Clone, Copy)]
pub enum Source {
    /// Formulas.
    Formulas(Family),
    /// The same, given to the saboteur whose noise has no days: see [`without_days`].
    WithoutDays(Family),
    /// Heaps of another kind of simulator.
    Heaps(heaps::Kind),
}

/// Source, size in degrees, seed.
pub type Asked = (Source, f64, u64);

impl Source {
    fn name(self) -> String {
        match self {
            Self::Formulas(family) => family.name().to_owned(),
            Self::WithoutDays(family) => format!("{}{WITHOUT_DAYS}", family.name()),
            Self::Heaps(kind) => kind.name().to_owned(),
        }
    }
}

/// Suffix of a family's name if the saboteur judged it.
const WITHOUT_DAYS: &str = " without its days";

/// Every family with every seed.
pub fn wanted(families: &[Family], size_deg: f64, seeds: std::ops::Range<u64>) -> Vec<Asked> {
    seeds
        .flat_map(|seed| {
            families.iter().map(move |&family| (Source::Formulas(family), size_deg, seed))
        })
        .collect()
}

/// Every family with every seed, for the saboteur.
pub fn wanted_without_days(families: &[Family], seeds: std::ops::Range<u64>) -> Vec<Asked> {
    let of =
        |seed| families.iter().map(move |&family| (Source::WithoutDays(family), LARGE_DEG, seed));
    seeds.flat_map(of).collect()
}

/// Every kind of heaps with every seed; the size is determined by the grains.
pub fn wanted_heaps(seeds: std::ops::Range<u64>) -> Vec<Asked> {
    seeds.flat_map(|seed| heaps::Kind::ALL.map(|kind| (Source::Heaps(kind), 0.0, seed))).collect()
}

/// The result for one hidden effect.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Scored {
    pub family: String,
    /// Requested and hidden size: nulls have none, and wild cases their own.
    pub asked_deg: f64,
    pub size_deg: f64,
    pub seed: u64,
    pub is_null: bool,
    pub is_found: bool,
    pub is_top_right: bool,
    pub is_confident_and_right: bool,
    pub claims: usize,
    pub false_claims: usize,
    /// Whether the covariate of an effect outside the catalogue is right, and its form class.
    pub is_covariate_right: bool,
    pub is_form_right: bool,
    /// Whether the 90 % interval contains the true change over the covariate's span; absent if
    /// nothing comparable was reported.
    pub is_effect_covered: Option<bool>,
    pub coverage90: Option<f64>,
    /// Mean squared error against the noise-free truth on new days, before, after, degrees squared.
    pub new_days: Option<[f64; 2]>,
    /// Share of the effect's mean square that the extended simulator explains for powders whose
    /// angles it never saw.
    pub other_powders: Option<f64>,
    /// After the experiment suggested by the report: claims, all right.
    pub after_experiment: Option<(usize, bool)>,
    pub wall_s: f64,
    pub verdict: String,
    pub top: String,
}

/// Runs the command on a campaign and scores its answer.
pub fn score(laboratory: &Laboratory, asked: &Asked, simulations: u32) -> Scored {
    let &(source, size_deg, seed) = asked;
    match source {
        Source::Formulas(family) => score_formulas(laboratory, family, size_deg, seed, simulations),
        Source::WithoutDays(family) => {
            let case = case(family, size_deg, seed);
            let answer = laboratory.discover(&without_days(&case.csv), simulations);
            Scored { family: source.name(), ..scored_of(&case, answer, size_deg, seed) }
        }
        Source::Heaps(kind) => score_heaps(laboratory, kind, seed, simulations),
    }
}

fn score_heaps(laboratory: &Laboratory, kind: heaps::Kind, seed: u64, simulations: u32) -> Scored {
    let answer = laboratory.discover(&heaps::campaign(kind, seed), simulations);
    let is_right = |cause: &str| kind.mechanism() == Some(cause);
    let false_claims = answer.claimed.iter().filter(|cause| !is_right(cause)).count();
    Scored {
        family: kind.name().to_owned(),
        asked_deg: 0.0,
        size_deg: 0.0,
        seed,
        is_null: kind.mechanism().is_none(),
        is_found: answer.is_found(),
        is_top_right: is_right(&answer.top),
        is_confident_and_right: !answer.claimed.is_empty() && false_claims == 0,
        claims: answer.claimed.len(),
        false_claims,
        is_covariate_right: false,
        is_form_right: false,
        is_effect_covered: None,
        coverage90: answer.coverage90,
        new_days: None,
        other_powders: None,
        after_experiment: None,
        wall_s: answer.wall_s,
        verdict: answer.verdict,
        top: answer.top,
    }
}

fn score_formulas(
    laboratory: &Laboratory,
    family: Family,
    size_deg: f64,
    seed: u64,
    simulations: u32,
) -> Scored {
    let case = case(family, size_deg, seed);
    let answer = laboratory.discover(&case.csv, simulations);
    let after_experiment = (family == Family::Confounded
        && !answer.experiment.is_empty()
        && answer.verdict == "ambiguous")
        .then(|| {
            let more = case.after_experiment(&answer.experiment);
            let then = laboratory.discover(&more.csv, simulations);
            (then.claimed.len(), then.is_confident_and_right(&case))
        });
    Scored {
        new_days: new_days(laboratory, &case, &answer),
        after_experiment,
        ..scored_of(&case, answer, size_deg, seed)
    }
}

/// The score of an answer alone.
fn scored_of(case: &Case, answer: Answer, asked_deg: f64, seed: u64) -> Scored {
    Scored {
        family: case.family.to_owned(),
        asked_deg,
        size_deg: case.size_deg,
        seed,
        is_null: case.effect_deg.iter().all(|effect| *effect == 0.0),
        is_found: answer.is_found(),
        is_top_right: answer.is_top_right(case),
        is_confident_and_right: answer.is_confident_and_right(case),
        claims: answer.claimed.len(),
        false_claims: answer.false_claims(case),
        is_covariate_right: answer.verdict == "unexplained" && answer.covariate == case.covariate,
        is_form_right: answer.form_class.is_some()
            && answer.form_class.as_deref() == case.form_class,
        is_effect_covered: is_effect_covered(case, &answer),
        coverage90: answer.coverage90,
        new_days: None,
        other_powders: other_powders(case, &answer),
        after_experiment: None,
        wall_s: answer.wall_s,
        verdict: answer.verdict,
        top: answer.top,
    }
}

/// The file without the information in its `session` column: each run has its own session, numbered
/// up and down. The command then knows nothing of days, and its noise is that of repeats alone: the
/// saboteur is the command itself with this one thing removed.
fn without_days(csv: &str) -> String {
    let mut reader = csv::Reader::from_reader(csv.as_bytes());
    let header = reader.headers().unwrap().clone();
    let place = header.iter().position(|name| name == "session").expect("every campaign has days");
    let rows: Vec<csv::StringRecord> = reader.records().map(|row| row.unwrap()).collect();
    // Fibonacci hashing: neighbours are far apart, no two are equal.
    let number = |row: usize| (row as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32;
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(&header).unwrap();
    for (k, row) in rows.iter().enumerate() {
        let session = number(k).to_string();
        writer
            .write_record(
                row.iter().enumerate().map(|(j, cell)| if j == place { &session } else { cell }),
            )
            .unwrap();
    }
    String::from_utf8(writer.into_inner().unwrap()).unwrap()
}

/// The interval of the report at 90 %: its 95 % interval narrowed by the ratio of the normal
/// deviates.
fn is_effect_covered(case: &Case, answer: &Answer) -> Option<bool> {
    let single =
        case.mechanisms.len() == 1 && answer.claimed.len() == 1 && answer.false_claims(case) == 0;
    let has_span = case.covariate.is_some() && case.effect_5_95_deg.is_finite();
    // For names, the report gives the two that differ most, the truth the first and the last:
    // comparable if there are two.
    let is_of_names =
        ["batch", "method", "operator", "plate"].contains(&case.covariate.as_deref().unwrap_or(""));
    if !single || !has_span || is_of_names {
        return None;
    }
    let (effect, ci95) = answer.effect?;
    let [low, high] = ci95.map(|end| effect + (end - effect) * 1.645 / 1.96);
    // Over the columns used in the report: humidity alone would leave out the contribution of rest
    // to humid ageing.
    let over: Vec<&str> = answer.over.iter().map(String::as_str).collect();
    (!over.is_empty()).then_some(())?;
    Some((low..=high).contains(&case.change_over_spans_deg(&over)?))
}

fn new_days(laboratory: &Laboratory, case: &Case, answer: &Answer) -> Option<[f64; 2]> {
    let version = answer.extended.as_ref()?;
    let new = case.more_days(NEW_DAYS);
    let predicted = laboratory.predict(version, &new.csv);
    assert_eq!(predicted.len(), new.noise_free_deg.len(), "{}: a row each", case.name);
    let mse = |k: usize| {
        let squares =
            predicted.iter().zip(&new.noise_free_deg).map(|(of, truth)| (of[k] - truth).powi(2));
        squares.sum::<f64>() / predicted.len() as f64
    };
    Some([mse(0), mse(1)])
}

/// Errors of powders left out completely, from the report: noise is in both, before and after, and
/// the effect in the first only.
fn other_powders(case: &Case, answer: &Answer) -> Option<f64> {
    let effect =
        case.effect_deg.iter().map(|it| it * it).sum::<f64>() / case.effect_deg.len() as f64;
    let [before, after] = answer.by_powder.filter(|_| answer.extended.is_some())?;
    Some((before.powi(2) - after.powi(2)) / effect)
}

/// Scores already in the file, and the others, each written as soon as it is computed.
pub fn scored(folder: &Path, wanted: &[Asked], simulations: u32) -> Vec<Scored> {
    let file = folder.join("scored.jsonl");
    let known: Vec<Scored> = std::fs::read_to_string(&file)
        .unwrap_or_default()
        .lines()
        .filter_map(|line| serde_json::from_str(line).ok())
        .collect();
    let key = |family: &str, size: f64, seed: u64| {
        (family.to_owned(), (100.0 * size).round() as i64, seed)
    };
    let of: BTreeMap<_, Scored> =
        known.into_iter().map(|it| (key(&it.family, it.asked_deg, it.seed), it)).collect();
    let of = std::sync::Mutex::new(of);
    let named = |&(source, size, seed): &Asked| key(&source.name(), size, seed);
    side_by_side(folder, wanted.len(), |laboratory, k| {
        let asked = &wanted[k];
        if of.lock().unwrap().contains_key(&named(asked)) {
            return;
        }
        let new = score(laboratory, asked, simulations);
        let mut all = of.lock().unwrap();
        let mut out = std::fs::OpenOptions::new().create(true).append(true).open(&file).unwrap();
        writeln!(out, "{}", serde_json::to_string(&new).unwrap()).unwrap();
        eprintln!("{} {} {}: {} ({})", new.family, new.asked_deg, new.seed, new.verdict, new.top);
        all.insert(named(asked), new);
    });
    let of = of.into_inner().unwrap();
    wanted.iter().map(|asked| of[&named(asked)].clone()).collect()
}

/// One line of the table.
pub fn line(name: &str, hits: usize, of: usize, target: &str) -> String {
    let [low, high] = limits(hits, of.max(1)).map(|limit| 100.0 * limit);
    let rate = 100.0 * hits as f64 / of.max(1) as f64;
    format!(
        "{name:<58} {hits:>4} of {of:<4} {rate:>5.1} %  [{low:.1}, {high:.1}]  target {target}\n"
    )
}

fn count<'a>(
    of: impl Iterator<Item = &'a Scored> + Clone,
    which: impl Fn(&Scored) -> bool,
) -> (usize, usize) {
    (of.clone().filter(|it| which(it)).count(), of.count())
}

fn is_single(it: &Scored) -> bool {
    Family::SINGLES.iter().any(|family| family.name() == it.family)
}

/// The table of rates.
pub fn table(all: &[Scored]) -> String {
    let (sabotaged, all): (Vec<_>, Vec<_>) =
        all.iter().cloned().partition(|it| it.family.ends_with(WITHOUT_DAYS));
    let mut text = String::new();
    let mut rate = |name: &str, (hits, of): (usize, usize), target: &str| {
        if of > 0 {
            text += &line(name, hits, of, target);
        }
    };
    let is_of_formulas = |it: &&Scored| !it.family.starts_with("grains_");
    let nulls = all.iter().filter(is_of_formulas).filter(|it| it.is_null && it.family != "wild");
    rate("M1 false alarms, all nulls", count(nulls.clone(), |it| it.is_found), "<= 5 %");
    for family in Family::NULLS {
        let of = nulls.clone().filter(|it| it.family == family.name());
        rate(&format!("   {}", family.name()), count(of, |it| it.is_found), "upper limit <= 12 %");
    }
    for family in Family::NULLS {
        let of = sabotaged.iter().filter(|it| it.family == Source::WithoutDays(family).name());
        rate(
            &format!("   saboteur without days, {}", family.name()),
            count(of, |it| it.is_found),
            "> 12 %, to show it",
        );
    }
    let effects = all.iter().filter(is_of_formulas).filter(|it| !it.is_null);
    let claims: usize = effects.clone().map(|it| it.claims).sum();
    rate(
        "M2 false claims of all claims",
        (effects.clone().map(|it| it.false_claims).sum(), claims),
        "<= 5 %",
    );
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
    rate(
        "M4 most probable cause right, of those found, L",
        count(detected, |it| it.is_top_right),
        ">= 90 %",
    );
    rate(
        "M5 confident and right, one cause, L",
        count(large.clone(), |it| it.is_confident_and_right),
        ">= 85 %",
    );
    for family in Family::SINGLES {
        let of = large.clone().filter(|it| it.family == family.name());
        rate(&format!("   {}", family.name()), count(of, |it| it.is_confident_and_right), "");
    }
    let of = |family: Family| effects.clone().filter(move |it| it.family == family.name());
    rate(
        "M5 confident and right, two causes",
        count(of(Family::TwoCauses), |it| it.is_confident_and_right),
        ">= 60 %",
    );
    rate(
        "M6 confident and wrong, all effects",
        count(effects.clone(), |it| it.false_claims > 0),
        "<= 5 %",
    );
    let confounded = of(Family::Confounded);
    rate(
        "M7 confounded: confident and wrong",
        count(confounded.clone(), |it| it.false_claims > 0),
        "<= 5 %",
    );
    let asked = confounded.filter(|it| it.after_experiment.is_some());
    rate(
        "M7 right after the experiment asked for",
        count(asked, |it| it.after_experiment.is_some_and(|it| it.1)),
        ">= 80 %",
    );
    let recorded = of(Family::Recorded).filter(|it| it.size_deg == LARGE_DEG);
    rate(
        "M8 outside the catalogue: right variable",
        count(recorded.clone(), |it| it.is_covariate_right),
        ">= 85 %",
    );
    let named = recorded.filter(|it| it.is_covariate_right);
    rate("M8 class of the law right, of those", count(named, |it| it.is_form_right), ">= 60 %");
    rate("M8 nobody recorded it: found", count(of(Family::Unrecorded), |it| it.is_found), "");
    let told = effects.clone().filter(|it| it.is_effect_covered.is_some());
    rate(
        "M9 effect within its 90 % interval",
        count(told, |it| it.is_effect_covered == Some(true)),
        "85 to 95 %",
    );
    for kind in heaps::Kind::ALL {
        let of = all.iter().filter(|it| it.family == kind.name());
        match kind.mechanism() {
            None => rate(
                "heaps of another simulator, nothing done: declared",
                count(of, |it| it.is_found),
                "<= 5 %",
            ),
            Some(_) => {
                let name = format!("heaps of another simulator, {}", kind.name());
                rate(&format!("{name}: found"), count(of.clone(), |it| it.is_found), "");
                rate(
                    &format!("{name}: named"),
                    count(of.clone(), |it| it.is_confident_and_right),
                    "",
                );
                rate(&format!("{name}: wrong"), count(of, |it| it.false_claims > 0), "<= 5 %");
            }
        }
    }
    let wild = all.iter().filter(|it| it.family == "wild");
    rate(
        "wild: nothing hidden, declared",
        count(wild.clone().filter(|it| it.is_null), |it| it.is_found),
        "<= 5 %",
    );
    rate("wild: found", count(wild.clone().filter(|it| !it.is_null), |it| it.is_found), "");
    rate(
        "wild: confident and wrong",
        count(wild.filter(|it| !it.is_null), |it| it.false_claims > 0),
        "<= 5 %",
    );
    text += &gains(&all);
    text
}

/// Gains and times, which are not rates.
fn gains(all: &[Scored]) -> String {
    let mut text = String::new();
    let gains: Vec<f64> = all
        .iter()
        .filter_map(|it| it.new_days)
        .map(|[before, after]| 1.0 - after / before)
        .collect();
    if !gains.is_empty() {
        let mean = gains.iter().sum::<f64>() / gains.len() as f64;
        let least = gains.iter().copied().fold(f64::INFINITY, f64::min);
        let n = gains.len();
        text += &format!(
            "M10 explained of new days' noise-free effect: mean {:.0} %, least {:.0} %, n {n}  target 75 %, 60 %\n",
            100.0 * mean,
            100.0 * least
        );
        let most = gains.iter().filter(|gain| **gain >= 0.6).count();
        text += &line("M10 at least 60 % of it explained", most, n, "every case");
    }
    let others: Vec<f64> =
        all.iter().filter(|it| is_single(it)).filter_map(|it| it.other_powders).collect();
    if !others.is_empty() {
        let mean = others.iter().sum::<f64>() / others.len() as f64;
        let n = others.len();
        text += &format!(
            "M12 explained of powders left out whole: mean {:.0} %, n {n}  target 40 %\n",
            100.0 * mean
        );
    }
    let covered: Vec<f64> =
        all.iter().filter(|it| !it.is_null).filter_map(|it| it.coverage90).collect();
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
