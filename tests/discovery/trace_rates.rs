//! Rates over many hidden causes of balance readings: M13 of the suite, each rate with its
//! Clopper-Pearson limits.

use crate::judge::{limits, side_by_side};
use crate::trace_truth::{TraceFamily, trace_case};
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::path::Path;
use std::sync::Mutex;

/// The result for one bench.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct TraceScored {
    pub family: String,
    pub seed: u64,
    /// The form drawn by the family.
    pub form: u32,
    pub verdict: String,
    /// Causes that were claimed.
    pub claimed: Vec<String>,
    pub top: String,
    pub wall_s: f64,
}

impl TraceScored {
    pub fn is_found(&self) -> bool {
        self.verdict != "no_discrepancy"
    }

    /// Whether the cause has its name and no other was claimed; for a wander, whether it was left
    /// without one.
    pub fn is_named(&self) -> bool {
        match self.right() {
            Some(right) => self.claimed == [right],
            None => self.verdict == "unexplained",
        }
    }

    pub fn is_wrong(&self) -> bool {
        self.claimed.iter().any(|claimed| Some(claimed.as_str()) != self.right())
    }

    fn right(&self) -> Option<&'static str> {
        let all = TraceFamily::SINGLES.into_iter().chain(TraceFamily::OTHERS);
        all.into_iter().find(|family| family.name() == self.family).and_then(TraceFamily::mechanism)
    }
}

/// Every family with every seed.
pub fn wanted(families: &[TraceFamily], seeds: std::ops::Range<u64>) -> Vec<(TraceFamily, u64)> {
    seeds.flat_map(|seed| families.iter().map(move |&family| (family, seed))).collect()
}

/// Scores already in the file, and the others from the command, each written as soon as it is
/// computed.
pub fn scored(folder: &Path, wanted: &[(TraceFamily, u64)], simulations: u32) -> Vec<TraceScored> {
    let file = folder.join("scored_traces.jsonl");
    let known = std::fs::read_to_string(&file).unwrap_or_default();
    let known = Mutex::new(
        known.lines().filter_map(|line| serde_json::from_str(line).ok()).collect::<Vec<_>>(),
    );
    let of = |known: &[TraceScored], &(family, seed): &(TraceFamily, u64)| {
        known.iter().find(|it| it.family == family.name() && it.seed == seed).cloned()
    };
    side_by_side(folder, wanted.len(), |laboratory, k| {
        if of(&known.lock().unwrap(), &wanted[k]).is_some() {
            return;
        }
        let (family, seed) = wanted[k];
        let case = trace_case(family, seed);
        let answer = laboratory.discover_traces(&case.csv, None, simulations);
        let new = TraceScored {
            family: family.name().to_owned(),
            seed,
            form: case.form,
            verdict: answer.verdict,
            claimed: answer.claimed,
            top: answer.top,
            wall_s: answer.wall_s,
        };
        let mut all = known.lock().unwrap();
        let mut out = std::fs::OpenOptions::new().create(true).append(true).open(&file).unwrap();
        writeln!(out, "{}", serde_json::to_string(&new).unwrap()).unwrap();
        eprintln!("{} {seed}: {} {:?}, {:.0} s", new.family, new.verdict, new.top, new.wall_s);
        all.push(new);
    });
    let known = known.into_inner().unwrap();
    wanted.iter().filter_map(|asked| of(&known, asked)).collect()
}

/// The rows of the table for balance readings.
pub fn table(all: &[TraceScored]) -> String {
    let mut text = String::new();
    let mut rate = |name: &str,
                    of: &[&TraceScored],
                    is: &dyn Fn(&TraceScored) -> bool,
                    target: &str| {
        let hits = of.iter().filter(|it| is(it)).count();
        if !of.is_empty() {
            let [low, high] = limits(hits, of.len()).map(|limit| 100.0 * limit);
            let share = 100.0 * hits as f64 / of.len() as f64;
            text += &format!(
                "{name:<58} {hits:>4} of {:<4} {share:>6.1} %  [{low:.1}, {high:.1}]  target {target}\n",
                of.len()
            );
        }
    };
    let of = |families: &[TraceFamily]| -> Vec<&TraceScored> {
        all.iter().filter(|it| families.iter().any(|family| family.name() == it.family)).collect()
    };
    let (nulls, singles) = (of(&TraceFamily::NULLS), of(&TraceFamily::SINGLES));
    rate("M1 false alarms, balance readings", &nulls, &TraceScored::is_found, "<= 5 %");
    for family in TraceFamily::NULLS {
        rate(
            &format!("   {}", family.name()),
            &of(&[family]),
            &TraceScored::is_found,
            "upper limit <= 12 %",
        );
    }
    rate("M13 traces: found, one cause", &singles, &TraceScored::is_found, ">= 90 %");
    rate("M13 traces: named, one cause", &singles, &TraceScored::is_named, ">= 85 %");
    for family in TraceFamily::SINGLES {
        rate(&format!("   {} named", family.name()), &of(&[family]), &TraceScored::is_named, "");
    }
    rate("M13 traces: confident and wrong, one cause", &singles, &TraceScored::is_wrong, "<= 5 %");
    let wander = of(&[TraceFamily::Wander]);
    rate(
        "M13 traces: an uncatalogued wander left without a name",
        &wander,
        &TraceScored::is_named,
        "",
    );
    rate("M13 traces: a wander, confident and wrong", &wander, &TraceScored::is_wrong, "<= 10 %");
    let fill = of(&[TraceFamily::HiddenFill]);
    rate(
        "M13 traces: fill that was not recorded, blamed on anything",
        &fill,
        &TraceScored::is_found,
        "<= 10 %",
    );
    text
}
