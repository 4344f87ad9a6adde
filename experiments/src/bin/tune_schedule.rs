//! The best fixed schedule, the open-loop rival that `flip evaluate` compares policies with; the
//! best gains and breakpoints of the rivals from other robots; and the rules that ship.
//!
//! ```text
//! flip calibrate --powder all --sets 10 --seed 1 --json > sets.json
//! cargo experiment tune_schedule -- sets.json [candidates] [seed] [schedule|pid|fuzzy|paced] [surrogate|both]
//! ```
//!
//! The rules that ship (`paced`) are tuned as they are used, at most 30 steps and a 0.1 mg balance,
//! on sand, sugar and salt alone, with the seven sets of each that a training sees; an overdose
//! counts four times. A rival gets every advantage: it is tuned on all five powders, not on three,
//! and for the targets of the evaluation, 15 and 20 mg. Only the heaps differ. With `surrogate`
//! they are searched on the surrogate spoon, where a pour takes microseconds; with `both`, the best
//! sixteen of that again in the simulator, along with the built-in ones and others around them. The
//! error on other heaps comes from the simulator either way. Prints the rival, its error in the
//! search (optimistic: it was chosen for being small), and its error on heaps that the search did
//! not see.

use flip_experiments::calibrated::Calibrated;
use flip_learn::train::environment::simulated;
use flip_learn::train::rivals::{self, Rival};
use flip_learn::train::schedule::{self, Tuning};
use flip_learn::train::{Level, Order, Preset, Settings, Surrogate};
use flip_policy::{Controller, Fuzzy, Paced, Pid, Rules};
use flip_sim::balance;
use serde_json::json;
use std::time::Instant;

/// Powders, and sets of each, used in our own trainings.
const TRAINED: [&str; 3] = ["sand", "sugar", "salt"];
const SETS: usize = 7;

/// The values set by hand before; for the paced rules, this search only moved the peaks of the
/// missing mass.
fn known(rival: Rival) -> Controller {
    match rival {
        Rival::Pid => Controller::Pid(Pid::CHOSEN),
        Rival::Fuzzy => Controller::Fuzzy(Fuzzy::CHOSEN),
        Rival::Paced => {
            let gentle = Fuzzy { missing_mg: [0.5, 4.0, 24.0], ..Paced::CHOSEN.gentle };
            Controller::Paced(Paced { gentle, ..Paced::CHOSEN })
        }
    }
}

/// Search settings for the rules that ship.
fn as_shipped(tuning: Tuning) -> Tuning {
    let rules = Rules { steps_max: 30, ..tuning.rules };
    let balance = balance::Settings { readability_mg: 0.1, noise_mg: 0.1, ..tuning.balance };
    Tuning {
        overdose_factor: 4.0,
        targets_mg: vec![5.0, 10.0, 15.0, 20.0],
        rules,
        balance,
        ..tuning
    }
}

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [sets, rest @ ..] = arguments.as_slice() else {
        anyhow::bail!(
            "tune_schedule SETS.json [CANDIDATES] [SEED] [schedule|pid|fuzzy|paced] [surrogate|both]"
        );
    };
    let calibrated: Calibrated = serde_json::from_slice(&std::fs::read(sets)?)?;
    let mut levels: Vec<Level> = calibrated
        .powders
        .into_iter()
        .map(|p| Level {
            powder: p.powder,
            repose_deg: p.target_deg,
            sets: p.sets.into_iter().map(|set| set.parameters).collect(),
        })
        .collect();
    anyhow::ensure!(
        levels.iter().all(|level| !level.sets.is_empty()),
        "a powder has no set; see flip calibrate"
    );
    let seed = rest.get(1).map_or(Ok(1), |text| text.parse())?;
    let candidates = rest.first().map_or(Ok(128), |text| text.parse())?;
    let mut tuning = Tuning { candidates, targets_mg: vec![15.0, 20.0], ..Tuning::new(seed) };

    let started = Instant::now();
    let filling = simulated(&Settings::of(Preset::Flip, Order::Curriculum, seed));
    let (tuned, pours, others_mg) = match rest.get(2).map_or("schedule", String::as_str) {
        "schedule" => {
            let tuned = schedule::tune(&filling, &levels, &tuning);
            let others_mg =
                schedule::assess(&filling, &levels, &tuning, &tuned.schedule, 10, seed + 1);
            (json!(tuned), tuned.pours, others_mg)
        }
        name => {
            let rival = match name {
                "pid" => Rival::Pid,
                "fuzzy" => Rival::Fuzzy,
                "paced" => Rival::Paced,
                other => anyhow::bail!("`{other}` must be schedule, pid, fuzzy or paced"),
            };
            if rival == Rival::Paced {
                tuning = as_shipped(tuning);
                levels.retain(|level| TRAINED.contains(&level.powder.as_str()));
                levels.iter_mut().for_each(|level| level.sets.truncate(SETS));
            }
            let fast = Surrogate::new(tuning.rules.pitch);
            let tuned = match rest.get(3).map(String::as_str) {
                None => rivals::tune(&filling, &levels, &tuning, rival),
                Some("surrogate") => rivals::tune(&fast, &levels, &tuning, rival),
                Some("both") => {
                    rivals::tune_twice(&fast, &filling, &levels, &tuning, rival, &[known(rival)])
                }
                Some(other) => anyhow::bail!("`{other}` must be surrogate or both, or left out"),
            };
            let others_mg =
                rivals::assess(&filling, &levels, &tuning, &tuned.controller, 10, seed + 1);
            (json!(tuned), tuned.pours, others_mg)
        }
    };
    eprintln!("{pours} pours and those on other heaps in {:.0} s", started.elapsed().as_secs_f64());
    println!(
        "{}",
        serde_json::to_string(
            &json!({ "tuning": tuning, "tuned": tuned, "other_heaps_mae_mg": others_mg })
        )?
    );
    Ok(())
}
