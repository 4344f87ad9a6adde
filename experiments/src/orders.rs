//! Comparisons of trainings by several seeds of each: results, table and curves.

use crate::calibrated::Calibrated;
use flip_core::domain::parameters::ParameterSet;
use flip_core::stats::summary::{mean, sd};
use flip_learn::train::evaluate::{Evaluation, Row, Subject, Summary};
use flip_learn::train::{Level, Order, Preset, Settings};
use flip_policy::Switch;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Targets, mg.
pub const TARGETS_MG: [f64; 4] = [5.0, 10.0, 15.0, 20.0];
/// Episodes averaged per point of a curve.
const WINDOW: usize = 100;
/// Parameter sets of a powder used for training; the others are weighed.
const TRAINED: usize = 7;
const COLOURS: [&str; 4] = ["#0b7a75", "#5b6c8f", "#c77d0a", "#a4243b"];

/// The four published orders of the powders, with a preset's settings.
pub fn of_all_orders(preset: Preset, episodes: u32, seed: u64) -> Vec<(String, Settings)> {
    let all = [
        (Order::Curriculum, "curriculum"),
        (Order::Random, "random"),
        (Order::DomainRandomisation, "domain-randomisation"),
        (Order::Reverse, "reverse"),
    ];
    let of = |(order, name): (Order, &str)| {
        (name.to_owned(), Settings { episodes, ..Settings::of(preset, order, seed) })
    };
    all.into_iter().map(of).collect()
}

/// A training and its policy's weighing results.
#[derive(Default, Serialize, Deserialize)]
pub struct Run {
    pub study: String,
    pub name: String,
    pub seed: u64,
    pub episodes: u32,
    /// Mean absolute error of each [`WINDOW`] episodes, exploring, mg.
    pub curve_mg: Vec<f64>,
    /// Episodes at which the level changed, and why.
    pub switches: Vec<Switch>,
    /// Mean absolute error of the policy by powder, mg.
    pub mae_mg: BTreeMap<String, f64>,
    /// Over all doses, mg.
    pub mae_all_mg: f64,
    /// Over all doses with sampled actions in place of the policy's mean, mg; 0 where none were.
    #[serde(default)]
    pub drawn_mg: f64,
    /// Share of all doses more than 1 mg too high.
    pub over_share: f64,
    /// Mean number of shakes.
    pub shakes: f64,
    /// Duration of the training, s; several ran at once.
    pub seconds: f64,
}

impl Run {
    /// What an evaluation found about one controller; names and training are filled in later.
    pub fn of(found: &Evaluation, controller: &str) -> Self {
        let mut by_powder: BTreeMap<String, Vec<f64>> = BTreeMap::new();
        let own = |row: &&Row| row.controller == controller;
        for row in found.rows.iter().filter(own) {
            by_powder.entry(row.powder.clone()).or_default().push(row.mae_mg);
        }
        let own = |summary: &&Summary| summary.controller == controller;
        let Some(summary) = found.summary.iter().find(own) else { return Self::default() };
        let mean = |(powder, errors): (String, Vec<f64>)| (powder, mean(&errors).unwrap_or(0.0));
        Self {
            mae_mg: by_powder.into_iter().map(mean).collect(),
            mae_all_mg: summary.mae_mg,
            over_share: summary.over_share,
            shakes: summary.shakes_mean,
            ..Self::default()
        }
    }

    /// The curve of a training with these errors.
    pub fn curve(errors: &[f64]) -> Vec<f64> {
        errors.chunks(WINDOW).filter_map(mean).collect()
    }
}

/// Mean and standard deviation over the seeds.
fn over_seeds(values: &[f64]) -> String {
    match sd(values) {
        Some(sd) => format!("{:.2} ± {sd:.2}", mean(values).unwrap_or(0.0)),
        None => format!("{:.2}", mean(values).unwrap_or(0.0)),
    }
}

/// Prints a row for each of these trainings.
pub fn tell(names: &[String], runs: &[Run]) {
    let powders: BTreeSet<&String> = runs.iter().flat_map(|run| run.mae_mg.keys()).collect();
    let header: Vec<&str> = powders.iter().map(|powder| powder.as_str()).collect();
    println!(
        "| training | seeds | last {WINDOW} episodes mg | policy mg | lowest last, its policy mg | drawn mg | {} | over % | shakes | s |",
        header.join(" | ")
    );
    println!("|{}", "---|".repeat(9 + header.len()));
    for name in names {
        let of: Vec<&Run> = runs.iter().filter(|run| run.name == *name).collect();
        let each = |value: &dyn Fn(&Run) -> f64| {
            over_seeds(&of.iter().map(|run| value(run)).collect::<Vec<_>>())
        };
        let last = |run: &Run| run.curve_mg.last().copied().unwrap_or(0.0);
        let chosen =
            of.iter().min_by(|a, b| last(a).total_cmp(&last(b))).map_or(0.0, |run| run.mae_all_mg);
        let of_powder = |powder: &&String| {
            each(&|run| run.mae_mg.get(powder.as_str()).copied().unwrap_or(f64::NAN))
        };
        let by_powder: Vec<String> = powders.iter().map(of_powder).collect();
        println!(
            "| {name} | {} | {} | {} | {chosen:.2} | {} | {} | {} | {} | {:.0} |",
            of.len(),
            each(&last),
            each(&|run| run.mae_all_mg),
            each(&|run| run.drawn_mg),
            by_powder.join(" | "),
            each(&|run| 100.0 * run.over_share),
            each(&|run| run.shakes),
            mean(&of.iter().map(|run| run.seconds).collect::<Vec<_>>()).unwrap_or(0.0)
        );
    }
}

/// The training error over the episodes as SVG: the mean over the seeds, in a band of one standard
/// deviation to either side.
pub fn picture(names: &[String], runs: &[Run], episodes: u32) -> String {
    let (wide, high, top_mg) = (600.0, 260.0, 12.0);
    let mut svg = "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 820 320\" font-family=\"sans-serif\" font-size=\"13\">\n\
                   <title>Training error over the episodes, mg: mean over the seeds, and one standard deviation</title>\n"
        .to_owned();
    for mg in [0, 3, 6, 9, 12] {
        let y = 20.0 + high * (1.0 - f64::from(mg) / top_mg);
        svg += &format!(
            "<path d=\"M50 {y:.1}h{wide}\" stroke=\"#ccc\"/><text x=\"42\" y=\"{:.1}\" text-anchor=\"end\">{mg}</text>\n",
            y + 4.0
        );
    }
    for (k, (name, colour)) in names.iter().zip(COLOURS).enumerate() {
        let curves: Vec<&Vec<f64>> =
            runs.iter().filter(|run| run.name == *name).map(|run| &run.curve_mg).collect();
        let points = curves.iter().map(|curve| curve.len()).min().unwrap_or(0);
        // Mean plus so many standard deviations.
        let line = |off: f64| -> Vec<String> {
            let point = |k: usize| {
                let errors: Vec<f64> = curves.iter().map(|curve| curve[k]).collect();
                let mg = mean(&errors).unwrap_or(0.0) + off * sd(&errors).unwrap_or(0.0);
                let x =
                    50.0 + wide * ((k as f64 + 0.5) * WINDOW as f64 / f64::from(episodes)).min(1.0);
                format!("{x:.1},{:.1}", 20.0 + high * (1.0 - (mg / top_mg).clamp(0.0, 1.0)))
            };
            (0..points).map(point).collect()
        };
        let back = line(-1.0).into_iter().rev();
        let band: Vec<String> = line(1.0).into_iter().chain(back).collect();
        svg += &format!(
            "<polygon points=\"{}\" fill=\"{colour}\" fill-opacity=\"0.12\"/>\n",
            band.join(" ")
        );
        svg += &format!(
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"/>\n",
            line(0.0).join(" ")
        );
        svg += &format!("<text x=\"660\" y=\"{}\" fill=\"{colour}\">{name}</text>\n", 40 + 20 * k);
    }
    svg + &format!(
        "<text x=\"50\" y=\"300\">0</text><text x=\"650\" y=\"300\" text-anchor=\"end\">{episodes} episodes</text>\n<text transform=\"translate(14 150) rotate(-90)\" text-anchor=\"middle\">error mg</text>\n</svg>\n"
    )
}

/// A powder to be weighed: its sets, and its angle of repose in degrees.
#[derive(Clone)]
pub struct Weighed {
    pub subject: Subject,
    pub repose_deg: f64,
}

/// The levels and the powders in these files of `flip calibrate --json`. Levels are the bare angles,
/// or the powders named.
///
/// # Errors
/// A file that cannot be read, a powder with too few sets, or files without levels or powders.
pub fn read(
    files: &[String],
    on_powders: Option<&[&str]>,
) -> anyhow::Result<(Vec<Level>, Vec<Weighed>)> {
    let (mut levels, mut powders) = (Vec::new(), Vec::new());
    for file in files {
        let calibrated: Calibrated = serde_json::from_slice(&std::fs::read(file)?)?;
        for found in calibrated.powders {
            let sets: Vec<ParameterSet> =
                found.sets.into_iter().map(|set| set.parameters).collect();
            let (trained, others) = sets.split_at(sets.len().min(TRAINED));
            let (is_angle, repose_deg) = (found.powder.is_empty(), found.target_deg);
            let powder = if is_angle { format!("repose_{repose_deg}") } else { found.powder };
            let is_level =
                on_powders.map_or(is_angle, |names| !is_angle && names.contains(&powder.as_str()));
            if is_level {
                levels.push(Level { powder: powder.clone(), repose_deg, sets: trained.to_vec() });
            }
            if !is_angle {
                anyhow::ensure!(
                    !others.is_empty(),
                    "{powder} needs more than {TRAINED} sets: flip calibrate --sets 10"
                );
                powders.push(Weighed {
                    subject: Subject { powder, sets: others.to_vec() },
                    repose_deg,
                });
            }
        }
    }
    anyhow::ensure!(
        !levels.is_empty() && !powders.is_empty(),
        "name files with bare angles and a file with powders"
    );
    Ok((levels, powders))
}

/// Prints by how much the first of these trainings errs less than each of the others, with the
/// standard error of the difference of the means over the seeds.
///
/// ```text
/// se^2 = s_1^2 / n_1 + s_2^2 / n_2
/// ```
pub fn tell_differences(names: &[String], runs: &[Run]) {
    let errors = |name: &String| -> Vec<f64> {
        runs.iter().filter(|run| run.name == *name).map(|run| run.mae_all_mg).collect()
    };
    let Some((first, others)) = names.split_first() else { return };
    let of_mean = |errors: &[f64]| {
        let sd = sd(errors)?;
        Some((mean(errors)?, sd * sd / errors.len() as f64))
    };
    for other in others {
        let [Some((a, va)), Some((b, vb))] = [first, other].map(|name| of_mean(&errors(name)))
        else {
            continue;
        };
        println!("{other} less {first}: {:.2} mg, standard error {:.2}", b - a, (va + vb).sqrt());
    }
}
