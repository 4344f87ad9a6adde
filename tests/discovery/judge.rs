//! The command's answer to a file, and its comparison with the truth.

use crate::truth::Case;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Inclusion probability required to claim a cause in a report.
const CLAIM: f64 = 0.8;

/// The judged part of a report.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Answer {
    pub sentence: String,
    pub verdict: String,
    pub p_value: f64,
    /// With inclusion probability at least 0.8, under verdict `cause`.
    pub claimed: Vec<String>,
    /// Most probable of all, including `unknown: <covariate>` and `unrecorded`.
    pub top: String,
    pub top_family: Option<String>,
    pub ambiguous_between: Vec<String>,
    pub covariate: Option<String>,
    pub form_class: Option<String>,
    /// Channel of each finding.
    pub channels: Vec<String>,
    /// Of the first finding: effect and 95 % interval; none if it is reported for a single powder.
    pub effect: Option<(f64, [f64; 2])>,
    /// Of the first finding: the columns over which the effect is reported; for an interaction
    /// both, which change at once.
    pub over: Vec<String>,
    pub experiment: Vec<std::collections::BTreeMap<String, String>>,
    /// Version of the simulator made by the investigation.
    pub extended: Option<String>,
    /// Share of held-out runs within the 90 % interval of the extended simulator.
    pub coverage90: Option<f64>,
    /// Root mean square error on powders left out completely, before and after.
    pub by_powder: Option<[f64; 2]>,
    pub wall_s: f64,
}

/// A folder in which the command works; it finds the results of its earlier runs.
pub struct Laboratory {
    folder: PathBuf,
}

impl Laboratory {
    pub fn new(folder: impl Into<PathBuf>) -> Self {
        let folder = folder.into();
        std::fs::create_dir_all(&folder).unwrap();
        Self { folder }
    }

    fn flip(&self, arguments: &[&str]) -> String {
        // Tests know the program; the report gets its path.
        let known = option_env!("CARGO_BIN_EXE_flip").map(str::to_owned);
        let program =
            known.or_else(|| std::env::var("FLIP_BIN").ok()).expect("FLIP_BIN names the program");
        let output = Command::new(program)
            .arg("--data-dir")
            .arg(self.folder.join("data"))
            .args(arguments)
            .output()
            .unwrap();
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "flip {}: {errors}", arguments.join(" "));
        String::from_utf8(output.stdout).unwrap()
    }

    fn file(&self, name: &str, text: &str) -> String {
        let path = self.folder.join(name);
        std::fs::write(&path, text).unwrap();
        path.display().to_string()
    }

    /// Runs the command on this file and nothing else; no heaps are simulated.
    pub fn discover(&self, csv: &str, simulations: u32) -> Answer {
        Answer::of(&self.report(csv, simulations, &["--budget-runs", "0"]))
    }

    /// Runs the command on this file and nothing else, with the default number of simulated heaps.
    pub fn whole(&self, csv: &str, simulations: u32) -> Value {
        self.report(csv, simulations, &[])
    }

    fn report(&self, csv: &str, simulations: u32, more: &[&str]) -> Value {
        let (file, out) = (self.file("M.csv", csv), self.folder.join("out").display().to_string());
        let simulations = simulations.to_string();
        let usual = [
            "discover",
            "--measurements",
            &file,
            "--out",
            &out,
            "--simulations",
            &simulations,
            "--json",
        ];
        serde_json::from_str(&self.flip(&[&usual[..], more].concat())).unwrap()
    }

    /// The versions of the simulator made by the command.
    pub fn versions(&self) -> Vec<Value> {
        serde_json::from_str(&self.flip(&["discover", "versions", "--json"])).unwrap()
    }

    /// Runs the command on balance readings, with or without angles.
    pub fn discover_traces(
        &self,
        traces: &str,
        measurements: Option<&str>,
        simulations: u32,
    ) -> Answer {
        let mut files = vec!["--traces".to_owned(), self.file("T.csv", traces)];
        files.extend(
            measurements.map_or(Vec::new(), |csv| {
                vec!["--measurements".to_owned(), self.file("M.csv", csv)]
            }),
        );
        let (out, simulations) =
            (self.folder.join("out").display().to_string(), simulations.to_string());
        let files: Vec<&str> = files.iter().map(String::as_str).collect();
        let rest = ["--out", &out, "--simulations", &simulations, "--json"];
        Answer::of(
            &serde_json::from_str(&self.flip(&[&["discover"], &files[..], &rest].concat()))
                .unwrap(),
        )
    }

    /// Angles predicted by an extended simulator for the rows of a file: before and after.
    pub fn predict(&self, version: &str, csv: &str) -> Vec<[f64; 2]> {
        let file = self.file("new.csv", csv);
        let text =
            self.flip(&["discover", "predict", "--simulator", version, "--measurements", &file]);
        let mut reader = csv::Reader::from_reader(text.as_bytes());
        let number = |record: &csv::StringRecord, k: usize| record[k].parse().unwrap_or(f64::NAN);
        reader
            .records()
            .map(|record| record.unwrap())
            .map(|record| [number(&record, 2), number(&record, 4)])
            .collect()
    }
}

/// Calls `one` for every index below `count`, as many at a time as there are processors, each lane
/// with its own folder: a single investigation cannot use them all.
pub fn side_by_side(folder: &Path, count: usize, one: impl Fn(&Laboratory, usize) + Sync) {
    let next = AtomicUsize::new(0);
    let lanes = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let lane = |lane: usize| {
        let laboratory = Laboratory::new(folder.join(format!("lane-{lane}")));
        while let Some(k) = Some(next.fetch_add(1, Ordering::Relaxed)).filter(|k| *k < count) {
            one(&laboratory, k);
        }
    };
    std::thread::scope(|scope| {
        for k in 0..lanes.min(count) {
            scope.spawn(move || lane(k));
        }
    });
}

/// The results a file already has, one per line, plus any of the `wanted` it lacks, each written as
/// soon as it is computed; in the order of the `wanted`.
pub fn kept<K: PartialEq, T: Clone + Serialize + DeserializeOwned>(
    file: &Path,
    wanted: &[K],
    key: impl Fn(&T) -> K,
    one: impl Fn(&K) -> T,
) -> Vec<T> {
    let text = std::fs::read_to_string(file).unwrap_or_default();
    let known: Vec<T> = text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect();
    let of = |asked: &K| {
        known.iter().find(|it| key(it) == *asked).cloned().unwrap_or_else(|| {
            let new = one(asked);
            let line = serde_json::to_string(&new).unwrap();
            eprintln!("{line}");
            let mut out = std::fs::OpenOptions::new().create(true).append(true).open(file).unwrap();
            writeln!(out, "{line}").unwrap();
            new
        })
    };
    wanted.iter().map(of).collect()
}

impl Answer {
    pub fn of(report: &Value) -> Self {
        let text = |value: &Value| value.as_str().map(str::to_owned);
        let verdict = report["verdict"].as_str().unwrap().to_owned();
        let causes = report["causes"].as_array().unwrap();
        let claimed = causes.iter().filter(|it| {
            verdict == "cause" && it["inclusion_probability"].as_f64().unwrap() >= CLAIM
        });
        let claimed = claimed.filter_map(|it| text(&it["mechanism"])).collect();
        let finding = report["findings"].get(0);
        let effect = finding.filter(|it| it["powder"].is_null()).map(|it| {
            let ci = [0, 1].map(|k| it["ci95"][k].as_f64().unwrap());
            (it["effect"].as_f64().unwrap(), ci)
        });
        let experiment = &report["suggested_experiment"]["runs"];
        Self {
            sentence: report["sentence"].as_str().unwrap().to_owned(),
            p_value: report["p_value"].as_f64().unwrap(),
            claimed,
            top: report["evidence"].get(0).and_then(|it| text(&it["cause"])).unwrap_or_default(),
            top_family: report["evidence"].get(0).and_then(|it| text(&it["family"])),
            ambiguous_between: report["ambiguous_between"]
                .as_array()
                .unwrap()
                .iter()
                .filter_map(text)
                .collect(),
            covariate: text(&report["unexplained"]["covariate"]),
            form_class: text(&report["unexplained"]["form_class"]),
            channels: report["findings"]
                .as_array()
                .unwrap()
                .iter()
                .filter_map(|it| text(&it["channel"]))
                .collect(),
            effect,
            over: finding
                .and_then(|it| it["covariate"].as_str())
                .map_or(Vec::new(), |columns| columns.split(" and ").map(str::to_owned).collect()),
            experiment: serde_json::from_value(experiment.clone()).unwrap_or_default(),
            extended: text(&report["simulator_version"]["extended"]),
            coverage90: report["gain"]["coverage90"]["after"].as_f64(),
            by_powder: report["gain"]["by_powder"]["rmse_before"]
                .as_f64()
                .zip(report["gain"]["by_powder"]["rmse_after"].as_f64())
                .map(|(before, after)| [before, after]),
            wall_s: report["wall_s"].as_f64().unwrap_or(0.0),
            verdict,
        }
    }

    /// Whether something was reported as wrong.
    pub fn is_found(&self) -> bool {
        self.verdict != "no_discrepancy"
    }

    /// Number of claims that contradict the truth.
    pub fn false_claims(&self, case: &Case) -> usize {
        self.claimed.iter().filter(|it| !is_right(case, it)).count()
    }

    /// Every true cause claimed, and no other.
    pub fn is_confident_and_right(&self, case: &Case) -> bool {
        !self.claimed.is_empty()
            && self.false_claims(case) == 0
            && case.mechanisms.iter().all(|it| {
                self.claimed.iter().any(|claimed| claimed == it) || !case.also_right.is_empty()
            })
    }

    /// Whether the most probable cause is one that is at work.
    pub fn is_top_right(&self, case: &Case) -> bool {
        is_right(case, &self.top)
    }
}

fn is_right(case: &Case, cause: &str) -> bool {
    case.mechanisms.contains(&cause) || case.also_right.contains(&cause)
}

/// Lower and upper 95 % limits of a rate (Clopper-Pearson): quantiles of beta distributions.
pub fn limits(hits: usize, of: usize) -> [f64; 2] {
    use statrs::distribution::{Beta, ContinuousCDF};
    let (x, n) = (hits as f64, of as f64);
    let low = if hits == 0 { 0.0 } else { Beta::new(x, n - x + 1.0).unwrap().inverse_cdf(0.025) };
    let high = if hits == of { 1.0 } else { Beta::new(x + 1.0, n - x).unwrap().inverse_cdf(0.975) };
    [low, high]
}

#[test]
fn limits_are_those_of_the_tables() {
    // 0 of 10: 1 - 0.025^(1/10); 5 of 10: the tables' 18.71 % to 81.29 %.
    let [low, high] = limits(0, 10);
    assert!(low == 0.0 && (high - 0.3085).abs() < 1e-4, "{low} {high}");
    let [low, high] = limits(5, 10);
    assert!((low - 0.1871).abs() < 1e-4 && (high - 0.8129).abs() < 1e-4, "{low} {high}");
}
