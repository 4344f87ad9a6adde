//! The whole table of rates, as printed by `make discovery-report`: hundreds of hidden effects,
//! each written down once scored, so the run can be stopped and resumed. `NULLS` campaigns of each
//! kind without an effect, `EFFECTS` of each kind with one and solvers of each kind, `WHOLE`
//! campaigns with simulated heaps, seeds from `FIRST` on; a single part with `ONLY=angles`,
//! `solvers`, `campaigns`, `traces` or `spoon` (on the first `POWDERS` of four powders, each cause
//! replayed `REPEATS` times at each amplitude).

mod campaigns;
mod heaps;
mod judge;
mod rates;
mod solver;
mod spoon_rates;
// The test uses more of it.
#[allow(dead_code)]
mod spoon_truth;
// Its own tests use more of it.
mod trace_rates;
#[allow(dead_code)]
mod trace_truth;
#[allow(dead_code)]
mod truth;

use rates::{
    LARGE_DEG, MEDIUM_DEG, SIMULATIONS, scored, table, wanted, wanted_heaps, wanted_without_days,
};
use solver::Defect;
use trace_truth::TraceFamily;
use truth::Family;

fn main() {
    let count = |name: &str, usual: u64| {
        std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(usual)
    };
    let (nulls, effects, whole) = (count("NULLS", 70), count("EFFECTS", 10), count("WHOLE", 10));
    let only = std::env::var("ONLY").ok();
    let is_asked = |part: &str| only.as_deref().is_none_or(|only| only == part);
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("target/discovery");
    std::fs::create_dir_all(&folder).unwrap();
    // Seeds from 1000 on are used in no test and no tuning; anyone changing the detector looks at
    // others.
    let first = count("FIRST", 1000);
    let (null_seeds, seeds) = (first..first + nulls, first..first + effects);
    if is_asked("angles") {
        let mut all = wanted(&Family::NULLS, LARGE_DEG, null_seeds);
        all.extend(wanted_without_days(&[Family::NullRestless], seeds.clone()));
        all.extend(wanted(&Family::SINGLES, LARGE_DEG, seeds.clone()));
        all.extend(wanted(&[Family::Humidity, Family::RestTime], MEDIUM_DEG, seeds.clone()));
        all.extend(wanted(&Family::OTHERS, LARGE_DEG, seeds.clone()));
        all.extend(wanted_heaps(seeds.clone()));
        print!("{}", table(&scored(&folder, &all, SIMULATIONS)));
    }
    if is_asked("solvers") {
        print!(
            "{}",
            solver::table(&solver::criticised(
                &folder,
                &solver::wanted(&Defect::ALL, seeds.clone())
            ))
        );
    }
    if is_asked("campaigns") {
        let wanted = campaigns::wanted(whole, first);
        print!("{}", campaigns::table(&campaigns::campaigns(&folder, &wanted, SIMULATIONS)));
    }
    if is_asked("traces") {
        let mut benches =
            trace_rates::wanted(&TraceFamily::NULLS, first..first + nulls.div_ceil(2));
        benches.extend(trace_rates::wanted(&TraceFamily::SINGLES, seeds.clone()));
        benches.extend(trace_rates::wanted(&TraceFamily::OTHERS, seeds));
        println!("{}", trace_rates::table(&trace_rates::scored(&folder, &benches, SIMULATIONS)));
    }
    if is_asked("spoon") {
        let wanted = spoon_rates::wanted(first..first + nulls, first..first + effects);
        print!(
            "{}",
            spoon_rates::table(&spoon_rates::scored(
                &folder,
                &wanted,
                count("POWDERS", 4),
                count("REPEATS", 1) as u32
            ))
        );
    }
}
