//! What the command answers to a file, and how that compares with the truth.

use crate::truth::Case;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::path::PathBuf;
use std::process::Command;

/// Inclusion probability from which a report claims a cause.
const CLAIM: f64 = 0.8;

/// What a report says, as far as it is judged.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Answer {
    pub verdict: String,
    pub p_value: f64,
    /// With inclusion probability at least 0.8, under verdict `cause`.
    pub claimed: Vec<String>,
    /// Most probable of all, with `unknown: <covariate>` and `unrecorded`.
    pub top: String,
    pub top_family: Option<String>,
    pub ambiguous_between: Vec<String>,
    pub covariate: Option<String>,
    pub form_class: Option<String>,
    /// Of the first finding: effect and 95 % interval.
    pub effect: Option<(f64, [f64; 2])>,
    /// Of the first finding: where the effect is told from and to, in words.
    pub span: Option<String>,
    pub experiment: Vec<std::collections::BTreeMap<String, String>>,
    /// Version of the simulator that was made.
    pub extended: Option<String>,
    /// Share of held-out runs within the 90 % interval of the extended simulator.
    pub coverage90: Option<f64>,
    pub wall_s: f64,
}

/// A folder in which the command works; what it was asked before, it finds.
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
        // Tests know the program; the report is told.
        let known = option_env!("CARGO_BIN_EXE_flip").map(str::to_owned);
        let program = known.or_else(|| std::env::var("FLIP_BIN").ok()).expect("FLIP_BIN names the program");
        let output =
            Command::new(program).arg("--data-dir").arg(self.folder.join("data")).args(arguments).output().unwrap();
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "flip {}: {errors}", arguments.join(" "));
        String::from_utf8(output.stdout).unwrap()
    }

    fn file(&self, name: &str, text: &str) -> String {
        let path = self.folder.join(name);
        std::fs::write(&path, text).unwrap();
        path.display().to_string()
    }

    /// Give the command this file and nothing else.
    pub fn discover(&self, csv: &str, simulations: u32) -> Answer {
        let file = self.file("M.csv", csv);
        let out = self.folder.join("out").display().to_string();
        let simulations = simulations.to_string();
        let arguments = [
            "discover",
            "--measurements",
            &file,
            "--out",
            &out,
            "--simulations",
            &simulations,
            "--budget-runs",
            "0",
            "--json",
        ];
        Answer::of(&serde_json::from_str(&self.flip(&arguments)).unwrap())
    }

    /// Angles that an extended simulator predicts for the rows of a file: before and after.
    pub fn predict(&self, version: &str, csv: &str) -> Vec<[f64; 2]> {
        let file = self.file("new.csv", csv);
        let text = self.flip(&["discover", "predict", "--simulator", version, "--measurements", &file]);
        let mut reader = csv::Reader::from_reader(text.as_bytes());
        let number = |record: &csv::StringRecord, k: usize| record[k].parse().unwrap_or(f64::NAN);
        reader.records().map(|record| record.unwrap()).map(|record| [number(&record, 2), number(&record, 4)]).collect()
    }
}

impl Answer {
    fn of(report: &Value) -> Self {
        let text = |value: &Value| value.as_str().map(str::to_owned);
        let verdict = report["verdict"].as_str().unwrap().to_owned();
        let causes = report["causes"].as_array().unwrap();
        let claimed =
            causes.iter().filter(|it| verdict == "cause" && it["inclusion_probability"].as_f64().unwrap() >= CLAIM);
        let claimed = claimed.filter_map(|it| text(&it["mechanism"])).collect();
        let finding = report["findings"].get(0);
        let effect = finding.map(|it| {
            let ci = [0, 1].map(|k| it["ci95"][k].as_f64().unwrap());
            (it["effect"].as_f64().unwrap(), ci)
        });
        let experiment = &report["suggested_experiment"]["runs"];
        Self {
            p_value: report["p_value"].as_f64().unwrap(),
            claimed,
            top: report["evidence"].get(0).and_then(|it| text(&it["cause"])).unwrap_or_default(),
            top_family: report["evidence"].get(0).and_then(|it| text(&it["family"])),
            ambiguous_between: report["ambiguous_between"].as_array().unwrap().iter().filter_map(text).collect(),
            covariate: text(&report["unexplained"]["covariate"]),
            form_class: text(&report["unexplained"]["form_class"]),
            effect,
            span: finding.and_then(|it| text(&it["span"])),
            experiment: serde_json::from_value(experiment.clone()).unwrap_or_default(),
            extended: text(&report["simulator_version"]["extended"]),
            coverage90: report["gain"]["coverage90"]["after"].as_f64(),
            wall_s: report["wall_s"].as_f64().unwrap_or(0.0),
            verdict,
        }
    }

    /// Whether something was declared to be wrong.
    pub fn is_found(&self) -> bool {
        self.verdict != "no_discrepancy"
    }

    /// Claims that the truth does not bear out.
    pub fn false_claims(&self, case: &Case) -> usize {
        self.claimed.iter().filter(|it| !is_right(case, it)).count()
    }

    /// Every cause of the truth claimed, and no other.
    pub fn is_confident_and_right(&self, case: &Case) -> bool {
        !self.claimed.is_empty()
            && self.false_claims(case) == 0
            && case
                .mechanisms
                .iter()
                .all(|it| self.claimed.iter().any(|claimed| claimed == it) || !case.also_right.is_empty())
    }

    /// Whether the most probable cause is one that is at work.
    pub fn is_top_right(&self, case: &Case) -> bool {
        is_right(case, &self.top)
    }
}

fn is_right(case: &Case, cause: &str) -> bool {
    case.mechanisms.contains(&cause) || case.also_right.contains(&cause)
}

/// Lower and upper 95 % limits of a rate, Clopper and Pearson's: quantiles of beta distributions.
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
