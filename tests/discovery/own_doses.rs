//! Doses of FLIP's own benches: nothing can be wrong with the simulator in its own doses.
//!
//! `own_doses/simulated.csv` and `own_doses/emulated.csv` were returned by `GET
//! /v1/weighings/{id}/trace.csv` for doses of 8 and 15 mg, from `flip weigh --seed 1` on: five
//! powders of the simulated bench, three of the emulated one, each calibrated by `flip calibrate`
//! with default settings. `step` is the count of shakes there.

use crate::judge::Laboratory;
use crate::rates::SIMULATIONS;

const DOSES: [(&str, &str); 2] = [
    ("simulated", include_str!("own_doses/simulated.csv")),
    ("emulated", include_str!("own_doses/emulated.csv")),
];

/// The doses of one powder, or all.
fn of_powder(csv: &str, powder: Option<&str>) -> String {
    let (header, rows) = csv.split_once('\n').unwrap();
    let is_of = |row: &&str| powder.is_none_or(|powder| row.split(',').nth(3) == Some(powder));
    format!("{header}\n{}\n", rows.lines().filter(is_of).collect::<Vec<_>>().join("\n"))
}

#[test]
fn doses_of_the_simulator_are_not_said_to_depart_from_it() {
    let folder = tempfile::tempdir().unwrap();
    let laboratory = Laboratory::new(folder.path());
    for (bench, csv) in DOSES {
        let powders = ["sand", "salt", "semolina", "sugar", "sodium_bicarbonate"].map(Some);
        for powder in powders.into_iter().chain([None]) {
            let doses = of_powder(csv, powder);
            if doses.lines().count() < 60 {
                continue; // The emulated bench weighed three powders.
            }
            let answer = laboratory.discover_traces(&doses, None, SIMULATIONS);
            assert_eq!(answer.verdict, "no_discrepancy", "{bench} {powder:?}: {answer:?}");
            assert!(
                answer.claimed.is_empty() && answer.channels.is_empty(),
                "{bench} {powder:?}: {answer:?}"
            );
            // None of it was judged, and the answer says so.
            assert!(
                answer.sentence.contains("simulated doses"),
                "{bench} {powder:?}: {}",
                answer.sentence
            );
        }
    }
}
