//! The best fixed schedule, the open-loop rival that `flip evaluate` compares policies with; and the best gains and breakpoints of the
//! rivals of other robots.
//!
//! ```text
//! flip calibrate --powder all --sets 10 --seed 1 --json > sets.json
//! cargo run --release --example tune_schedule -- sets.json [candidates] [seed] [schedule|pid|fuzzy] [surrogate]
//! ```
//!
//! A rival's every advantage is granted: it is tuned on all five powders, not on three, and for the targets of the evaluation, 15 and
//! 20 mg. Only the heaps differ. With `surrogate`, PID and fuzzy rules are searched on the surrogate spoon, where a pour takes microseconds; their error on
//! other heaps is the simulator's either way. Prints the rival, its error in the search (optimistic: it was chosen for being small), and its
//! error on heaps that the search did not see.

use flip::domain::parameters::ParameterSet;
use flip::train::environment::simulated;
use flip::train::rivals::{self, Rival};
use flip::train::schedule::{self, Tuning};
use flip::train::{Level, Order, Preset, Settings, Surrogate};
use serde::Deserialize;
use serde_json::json;
use std::time::Instant;

/// What this program reads of the document of `flip calibrate`.
#[derive(Deserialize)]
struct Calibrated {
    powders: Vec<Powder>,
}

#[derive(Deserialize)]
struct Powder {
    powder: String,
    target_deg: f64,
    sets: Vec<Set>,
}

#[derive(Deserialize)]
struct Set {
    parameters: ParameterSet,
}

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [sets, rest @ ..] = arguments.as_slice() else {
        anyhow::bail!("tune_schedule SETS.json [CANDIDATES] [SEED] [schedule|pid|fuzzy] [surrogate]");
    };
    let calibrated: Calibrated = serde_json::from_slice(&std::fs::read(sets)?)?;
    let levels: Vec<Level> = calibrated
        .powders
        .into_iter()
        .map(|p| Level {
            powder: p.powder,
            repose_deg: p.target_deg,
            sets: p.sets.into_iter().map(|set| set.parameters).collect(),
        })
        .collect();
    anyhow::ensure!(levels.iter().all(|level| !level.sets.is_empty()), "a powder has no set; see flip calibrate");
    let seed = rest.get(1).map_or(Ok(1), |text| text.parse())?;
    let candidates = rest.first().map_or(Ok(128), |text| text.parse())?;
    let tuning = Tuning { candidates, targets_mg: vec![15.0, 20.0], ..Tuning::new(seed) };

    let started = Instant::now();
    let filling = simulated(&Settings::of(Preset::Flip, Order::Curriculum, seed));
    let (tuned, pours, others_mg) = match rest.get(2).map_or("schedule", String::as_str) {
        "schedule" => {
            let tuned = schedule::tune(&filling, &levels, &tuning);
            let others_mg = schedule::assess(&filling, &levels, &tuning, &tuned.schedule, 10, seed + 1);
            (json!(tuned), tuned.pours, others_mg)
        }
        name => {
            let rival = match name {
                "pid" => Rival::Pid,
                "fuzzy" => Rival::Fuzzy,
                other => anyhow::bail!("`{other}` must be schedule, pid or fuzzy"),
            };
            let tuned = match rest.get(3).map(String::as_str) {
                None => rivals::tune(&filling, &levels, &tuning, rival),
                Some("surrogate") => rivals::tune(&Surrogate { pitch: tuning.rules.pitch }, &levels, &tuning, rival),
                Some(other) => anyhow::bail!("`{other}` must be surrogate, or left out"),
            };
            let others_mg = rivals::assess(&filling, &levels, &tuning, &tuned.controller, 10, seed + 1);
            (json!(tuned), tuned.pours, others_mg)
        }
    };
    eprintln!("{pours} pours and those on other heaps in {:.0} s", started.elapsed().as_secs_f64());
    println!(
        "{}",
        serde_json::to_string(&json!({ "tuning": tuning, "tuned": tuned, "other_heaps_mae_mg": others_mg }))?
    );
    Ok(())
}
