//! The whole table of rates, as `make discovery-report` prints it: hundreds of hidden effects, each written down as it is scored, so that it can be stopped
//! and goes on. `NULLS` campaigns of each kind without an effect, `EFFECTS` of each kind with one.

mod judge;
mod rates;
// Its own tests ask for more of it.
#[allow(dead_code)]
mod truth;

use judge::Laboratory;
use rates::{LARGE_DEG, MEDIUM_DEG, SIMULATIONS, scored, table, wanted};
use truth::Family;

fn main() {
    let count = |name: &str, usual: u64| std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(usual);
    let (nulls, effects) = (count("NULLS", 70), count("EFFECTS", 10));
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("target/discovery");
    let laboratory = Laboratory::new(&folder);
    // Seeds that no test and no tuning has.
    let mut all = wanted(&Family::NULLS, LARGE_DEG, 1000..1000 + nulls);
    all.extend(wanted(&Family::SINGLES, LARGE_DEG, 1000..1000 + effects));
    all.extend(wanted(&[Family::Humidity, Family::RestTime], MEDIUM_DEG, 1000..1000 + effects));
    all.extend(wanted(&Family::OTHERS, LARGE_DEG, 1000..1000 + effects));
    println!("{}", table(&scored(&laboratory, &folder.join("scored.jsonl"), &all, SIMULATIONS)));
}
