//! How soon a reading is final: the filter of `hardware/settle.rs` on published step responses of a
//! balance.
//!
//! ```text
//! cargo experiment settling
//! ```
//!
//! 28 clean steps of 2 to 10 g on an analytical balance of 0.1 mg, a frame every 0.19 s (SOURCES.md
//! next to the data names their owners). They are read as on a balance of 1 mg and of 0.1 mg. A
//! step begins with its fitted exponential; the true value is the median of the display from 1.2 s
//! on until the weight was lifted. Doses are a thousand times smaller, and settle sooner. The data
//! are not part of FLIP: `FLIP_DATA` names the folder; without it the example reports so and exits
//! successfully.

use anyhow::Context;
use flip_bench::hardware::settle::{Settled, Settling, Shown, settled};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// An exponential that explains less of a step than this was not a clean step (28 are left, as in
/// the data's own summary).
const R2_MIN: f64 = 0.995;
/// From here on the display is taken as the true value, s.
const RESTED_S: f64 = 1.2;
/// Time before lifting at which a hand touches the weight, s.
const TOUCH_S: f64 = 0.3;

/// One step: the displayed values since its beginning, and the true value.
struct Step {
    shown: Vec<Shown>,
    right_mg: f64,
}

/// How soon and with what error a rule reads a step.
struct Read {
    t_s: f64,
    error_mg: f64,
}

fn main() -> anyhow::Result<()> {
    let root =
        std::env::var("FLIP_DATA").map_or_else(|_| PathBuf::from("../shared/data"), PathBuf::from);
    let folder = root.join("powder-doser/data/balance-step/2026-08-14");
    if !folder.exists() {
        println!(
            "skipped: there is no {}; FLIP_DATA names the folder that holds the data",
            folder.display()
        );
        return Ok(());
    }
    let steps = steps(&folder)?;
    for step_mg in [1.0, 0.1] {
        println!("\n{} clean steps, read as on a balance of {step_mg} mg\n", steps.len());
        println!(
            "| rule | steps read | median s | slowest s | mean error mg | largest error mg | within 1 mg | within 2 mg |"
        );
        println!("|---|---|---|---|---|---|---|---|");
        let rounded: Vec<Step> = steps.iter().map(|step| step.on_balance_of(step_mg)).collect();
        print("right within 2 mg for good", &rounded, |step| step.right_for_good(2.0));
        print("right within 1 mg for good", &rounded, |step| step.right_for_good(1.0));
        // The noise of that balance in use, where it exceeds the display's step.
        let settling = Settling::new(f64::max(step_mg, 0.3));
        print("this filter", &rounded, |step| {
            step.filtered(&settling).map(|it| step.read(it.t_s, it.mass_mg))
        });
        print("this filter, end of its exponential", &rounded, |step| {
            step.filtered(&settling).map(|it| step.read(it.t_s, it.end_mg))
        });
        print("the balance's flag", &rounded, |step| {
            step.at(|shown| shown.flag && shown.t_s > 0.0)
        });
        for wait_s in [0.5, 0.7, 1.0, 1.5] {
            print(&format!("{wait_s} s"), &rounded, |step| step.at(|shown| shown.t_s >= wait_s));
        }
    }
    println!("\nThe published robot waited 4 s; most of these weights were lifted before that.");
    Ok(())
}

impl Step {
    fn on_balance_of(&self, step_mg: f64) -> Self {
        let round = |shown: &Shown| Shown {
            mass_mg: (shown.mass_mg / step_mg).round() * step_mg,
            ..*shown
        };
        Self { shown: self.shown.iter().map(round).collect(), right_mg: self.right_mg }
    }

    fn read(&self, t_s: f64, mass_mg: f64) -> Read {
        Read { t_s, error_mg: (mass_mg - self.right_mg).abs() }
    }

    fn at(&self, is_it: impl Fn(&Shown) -> bool) -> Option<Read> {
        self.shown
            .iter()
            .find(|shown| is_it(shown))
            .map(|shown| self.read(shown.t_s, shown.mass_mg))
    }

    fn filtered(&self, settling: &Settling) -> Option<Settled> {
        (1..=self.shown.len()).find_map(|n| settled(settling, &self.shown[..n]))
    }

    /// The first reading from which on all are within this distance.
    fn right_for_good(&self, within_mg: f64) -> Option<Read> {
        let wrong =
            self.shown.iter().rposition(|shown| (shown.mass_mg - self.right_mg).abs() > within_mg);
        let first = self.shown.get(wrong.map_or(0, |at| at + 1))?;
        Some(self.read(first.t_s, first.mass_mg))
    }
}

fn print(rule: &str, steps: &[Step], read: impl Fn(&Step) -> Option<Read>) {
    let found: Vec<Read> = steps.iter().filter_map(read).collect();
    let mut times: Vec<f64> = found.iter().map(|it| it.t_s).collect();
    times.sort_by(f64::total_cmp);
    let n = found.len();
    if n == 0 {
        println!("| {rule} | 0 | | | | | | |");
        return;
    }
    let mean = found.iter().map(|it| it.error_mg).sum::<f64>() / n as f64;
    let largest = found.iter().map(|it| it.error_mg).fold(0.0, f64::max);
    let within = |mg: f64| found.iter().filter(|it| it.error_mg <= mg + 1e-9).count();
    println!(
        "| {rule} | {n} | {:.2} | {:.2} | {mean:.2} | {largest:.1} | {} | {} |",
        times[n / 2],
        times[n - 1],
        within(1.0),
        within(2.0)
    );
}

/// Every clean step of the folder.
fn steps(folder: &Path) -> anyhow::Result<Vec<Step>> {
    let mut captures = BTreeMap::new();
    let mut steps = Vec::new();
    let events = csv::Reader::from_path(folder.join("events.csv"))?
        .deserialize()
        .collect::<Result<Vec<Event>, _>>()?;
    for event in events.iter().filter(|event| {
        event.r2.is_some_and(|r2| r2 > R2_MIN) && !event.condition.contains("lay-down")
    }) {
        if !captures.contains_key(&event.file) {
            captures.insert(event.file.clone(), capture(&folder.join(&event.file))?);
        }
        let (begin_s, end_s) =
            (event.t0.context("a clean step begins")?, event.t_up + event.top_dur_s - TOUCH_S);
        let shown: Vec<Shown> = captures[&event.file]
            .iter()
            .filter(|shown| (begin_s..end_s).contains(&shown.t_s))
            .map(|shown| Shown { t_s: shown.t_s - begin_s, ..*shown })
            .collect();
        let mut rested: Vec<f64> =
            shown.iter().filter(|s| s.t_s >= RESTED_S).map(|s| s.mass_mg).collect();
        rested.sort_by(f64::total_cmp);
        if let Some(right_mg) = rested.get(rested.len() / 2) {
            steps.push(Step { right_mg: *right_mg, shown });
        }
    }
    Ok(steps)
}

/// A row of `events.csv`; times are since the first reading of the file.
#[derive(serde::Deserialize)]
struct Event {
    file: String,
    condition: String,
    t_up: f64,
    t0: Option<f64>,
    r2: Option<f64>,
    top_dur_s: f64,
}

/// The readings of a file: rows `D, ms, g, S or U`.
fn capture(path: &Path) -> anyhow::Result<Vec<Shown>> {
    let mut reader = csv::ReaderBuilder::new().has_headers(false).flexible(true).from_path(path)?;
    let mut shown = Vec::new();
    for row in reader.records() {
        let row = row?;
        if row.get(0) == Some("D") {
            let number = |k: usize| -> anyhow::Result<f64> {
                Ok(row.get(k).context("a reading has four cells")?.parse()?)
            };
            shown.push(Shown {
                t_s: number(1)? / 1000.0,
                mass_mg: 1000.0 * number(2)?,
                flag: row.get(3) == Some("S"),
            });
        }
    }
    let first_s = shown.first().context("a file has readings")?.t_s;
    Ok(shown.into_iter().map(|it| Shown { t_s: it.t_s - first_s, ..it }).collect())
}
