//! Whole campaigns: the command with the number of heaps it simulates by default, from the file of
//! angles to a version of the simulator whose amplitude was fitted on heaps and verified on fresh
//! ones, and its gain on left-out days.
//!
//! Causes that act through the grains; seeds that no test uses. Campaigns run one at a time, so the
//! seconds are those of a campaign alone on this machine.

use crate::judge::{Answer, Laboratory, kept};
use crate::rates::{LARGE_DEG, line};
use crate::truth::{Family, case};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Causes that the simulator has a mechanism for.
pub const FAMILIES: [Family; 5] = [
    Family::Humidity,
    Family::RestTime,
    Family::Vibration,
    Family::ContainerAge,
    Family::FunnelHeight,
];
/// Bounds on a campaign's duration and cost.
const SECONDS_MAX: f64 = 3600.0;
const RUNS_MAX: u64 = 220;

/// The result of a whole campaign.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Campaign {
    pub family: String,
    pub seed: u64,
    pub verdict: String,
    pub claimed: Vec<String>,
    pub is_right: bool,
    /// Whether the extension won on left-out days, so that there is a version.
    pub is_accepted: bool,
    /// Whether fresh heaps moved as the measured ones did.
    pub is_verified: bool,
    pub runs: u64,
    pub wall_s: f64,
    /// Root mean square error on left-out days, before and after, degrees; 95 % interval of the
    /// difference, and the number of runs left out.
    pub held_out: Option<HeldOut>,
    pub extensions: Vec<Extension>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct HeldOut {
    pub before_deg: f64,
    pub after_deg: f64,
    pub ci95: [f64; 2],
    pub n: u64,
}

/// The simulated heaps' result for one cause.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Extension {
    pub mechanism: String,
    /// The change in the campaign, mean over the powders whose heaps were poured, degrees.
    pub fitted_deg: f64,
    /// How far fresh heaps moved at the fitted amplitude, and its standard error, degrees; absent
    /// where none were poured.
    pub heaps_deg: Option<[f64; 2]>,
}

/// This many campaigns, cycling through the families.
pub fn wanted(count: u64, first_seed: u64) -> Vec<(Family, u64)> {
    let families = FAMILIES.len() as u64;
    (0..count).map(|k| (FAMILIES[(k % families) as usize], first_seed + k / families)).collect()
}

/// Results known from the file in the folder, and the others as they are computed.
pub fn campaigns(folder: &Path, wanted: &[(Family, u64)], simulations: u32) -> Vec<Campaign> {
    let laboratory = Laboratory::new(folder.join("campaigns"));
    let named: Vec<(String, u64)> =
        wanted.iter().map(|(family, seed)| (family.name().to_owned(), *seed)).collect();
    let one = |asked: &(String, u64)| {
        let family = FAMILIES.into_iter().find(|family| family.name() == asked.0).unwrap();
        campaign(&laboratory, family, asked.1, simulations)
    };
    kept(&folder.join("campaigns.jsonl"), &named, |it: &Campaign| (it.family.clone(), it.seed), one)
}

fn campaign(laboratory: &Laboratory, family: Family, seed: u64, simulations: u32) -> Campaign {
    let case = case(family, LARGE_DEG, seed);
    let report = laboratory.whole(&case.csv, simulations);
    let answer = Answer::of(&report);
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    let held_out = report["gain"].get("held_out").map(|it| HeldOut {
        before_deg: number(&it["rmse_before"]),
        after_deg: number(&it["rmse_after"]),
        ci95: [0, 1].map(|end| number(&it["ci95"][end])),
        n: it["n"].as_u64().unwrap(),
    });
    let versions = laboratory.versions();
    let version = versions
        .iter()
        .find(|it| answer.extended.is_some() && it["id"].as_str() == answer.extended.as_deref());
    let extension = |of: &serde_json::Value| {
        let poured = of["fit"]["sets"].as_array().map_or(&[][..], Vec::as_slice);
        let is_poured =
            |powder: &serde_json::Value| poured.iter().any(|set| set["powder"] == powder["powder"]);
        let powders = of["powders"].as_array().unwrap();
        let fitted: Vec<f64> =
            powders.iter().filter(|it| is_poured(it)).map(|it| number(&it["effect_deg"])).collect();
        Extension {
            mechanism: of["mechanism"].as_str().unwrap().to_owned(),
            fitted_deg: match fitted.len() {
                0 => number(&of["effect_deg"]),
                n => fitted.iter().sum::<f64>() / n as f64,
            },
            heaps_deg: (!poured.is_empty())
                .then(|| [0, 1].map(|k| number(&of["fit"]["verification"][k]))),
        }
    };
    let extensions = version.and_then(|it| it["body"]["extensions"].as_array());
    Campaign {
        family: family.name().to_owned(),
        seed,
        is_right: answer.is_confident_and_right(&case),
        is_accepted: answer.extended.is_some(),
        is_verified: report["simulator_version"]["verified"].as_bool().unwrap(),
        runs: report["simulator_runs"].as_u64().unwrap(),
        wall_s: answer.wall_s,
        held_out,
        extensions: extensions.map_or(Vec::new(), |all| all.iter().map(extension).collect()),
        verdict: answer.verdict,
        claimed: answer.claimed,
    }
}

/// Every campaign, and their rows of the table.
pub fn table(all: &[Campaign]) -> String {
    if all.is_empty() {
        return String::new();
    }
    let mut text = String::from("whole campaigns, with simulated heaps\n");
    for it in all {
        let says =
            if it.claimed.is_empty() { it.verdict.clone() } else { it.claimed.join(" and ") };
        let right = if it.is_right { "right" } else { "not claimed, or wrong" };
        let verified = match (it.is_accepted, it.is_verified) {
            (false, _) => "no version",
            (true, false) => "not verified",
            (true, true) => "verified",
        };
        text += &format!("   {} {}: {says} ({right}), {verified}, ", it.family, it.seed);
        text += &format!("{} simulator runs, {:.0} s", it.runs, it.wall_s);
        for of in &it.extensions {
            let heaps = of.heaps_deg.map_or("no heaps".to_owned(), |[deg, se]| {
                format!("fresh heaps {deg:+.1} +- {se:.1}")
            });
            text += &format!("; {}: effect {:+.1} deg, {heaps}", of.mechanism, of.fitted_deg);
        }
        if let Some(HeldOut { before_deg, after_deg, ci95: [low, high], n }) = &it.held_out {
            text += &format!(
                "; held out {before_deg:.2} -> {after_deg:.2} deg [{low:+.2}, {high:+.2}], n {n}"
            );
        }
        text.push('\n');
    }
    let accepted: Vec<_> = all.iter().filter(|it| it.is_accepted).collect();
    let verified = accepted.iter().filter(|it| it.is_verified).count();
    let sorted = |of: &dyn Fn(&Campaign) -> f64| {
        let mut values: Vec<f64> = all.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        (values[values.len() / 2], values[values.len() - 1])
    };
    let ((seconds, seconds_most), (runs, runs_most)) =
        (sorted(&|it| it.wall_s), sorted(&|it| it.runs as f64));
    let within = all.iter().filter(|it| it.wall_s <= SECONDS_MAX && it.runs <= RUNS_MAX).count();
    text += &line(
        "whole campaigns: confident and right",
        all.iter().filter(|it| it.is_right).count(),
        all.len(),
        "",
    );
    text += &line(
        "whole campaigns: a version that won on days left out",
        accepted.len(),
        all.len(),
        "",
    );
    text +=
        &line("whole campaigns: of these, verified by fresh heaps", verified, accepted.len(), "");
    text += &line("M15 a full campaign within 60 min and 220 runs", within, all.len(), "all");
    text += &format!(
        "M15 a full campaign: seconds, simulator runs: median {seconds:.0}, {runs:.0}, most {seconds_most:.0}, {runs_most:.0}  target <= 3600, <= 220\n"
    );
    text
}
