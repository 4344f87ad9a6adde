//! Campaigns whose effect is in the grains and in no formula: every angle comes from a heap of
//! springs and dashpots ([`crate::grains`]), poured with the effect of its day's air or its batch
//! on the grains, on a day that shifts all of its readings.
//!
//! Nothing from the crate is used here.

use flip_grains::{Grains, repose_deg};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// The change to the grains.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Contacts attract in humid air.
    Humid,
    /// Batches roll more or less easily.
    Rolling,
    /// Nothing.
    Nothing,
}

impl Kind {
    pub const ALL: [Self; 3] = [Self::Humid, Self::Rolling, Self::Nothing];

    pub fn name(self) -> &'static str {
        match self {
            Self::Humid => "grains_humid",
            Self::Rolling => "grains_rolling",
            Self::Nothing => "grains_nothing",
        }
    }

    /// Its name in the catalogue.
    pub fn mechanism(self) -> Option<&'static str> {
        match self {
            Self::Humid => Some("humidity"),
            Self::Rolling => Some("batch"),
            Self::Nothing => None,
        }
    }
}

/// Friction and rolling resistance of the powders.
const POWDERS: [(&str, f64, f64); 3] =
    [("glass", 0.4, 0.05), ("quartz", 0.5, 0.1), ("alumina", 0.6, 0.12)];
pub const DAYS: u32 = 16;
const REPEATS: u32 = 2;
/// Attraction in the most humid air over the weight of a grain.
const BOND: f64 = 0.5;
/// Grains of a heap: a third of a second.
const COUNT: usize = 250;
/// SD of the day effect on all readings, degrees.
const DAY_DEG: f64 = 0.5;

/// Where a campaign is kept: pouring one takes half a minute.
pub fn file(kind: Kind, seed: u64) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join(format!("tests/discovery/heaps/{}_{seed}.csv", kind.name()))
}

/// The table of a campaign: the kept one, or one that is poured now.
pub fn campaign(kind: Kind, seed: u64) -> String {
    std::fs::read_to_string(file(kind, seed)).unwrap_or_else(|_| poured(kind, seed, DAYS))
}

/// The table of a campaign's first days, every heap of it poured now.
pub fn poured(kind: Kind, seed: u64, days: u32) -> String {
    let mut rng = Pcg64::seed_from_u64(seed ^ 0x6865_6170);
    let mut text = String::from(
        "powder,repose_deg,session,order_in_session,batch,operator,relative_humidity_pct,temperature_c,rest_min\n",
    );
    for day in 0..days {
        let humidity = rng.random_range(28.0..75.0);
        let temperature = rng.random_range(17.0..26.0);
        let shift = DAY_DEG * (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>();
        let mut runs: Vec<usize> =
            (0..POWDERS.len()).flat_map(|powder| [powder; REPEATS as usize]).collect();
        (1..runs.len()).rev().for_each(|k| runs.swap(k, rng.random_range(0..=k as u64) as usize));
        for (place, &powder) in runs.iter().enumerate() {
            let (name, friction, rolling) = POWDERS[powder];
            let (batch, operator) = (rng.random_range(0..2u32), rng.random_range(0..2u32));
            let rest = [1.0, 10.0, 60.0][rng.random_range(0..3u64) as usize];
            let grains = Grains {
                friction,
                rolling: rolling * if kind == Kind::Rolling && batch == 1 { 1.7 } else { 1.0 },
                size_spread: 0.1,
                bond: if kind == Kind::Humid { BOND * isotherm(humidity) } else { 0.0 },
                count: COUNT,
            };
            // A heap that does not cover its plate is poured again.
            let angle = std::iter::repeat_with(|| repose_deg(&grains, rng.random()))
                .take(20)
                .find_map(|angle| angle);
            let angle = angle.expect("one heap of twenty covers its plate") + shift;
            let batch = ["A", "B"][batch as usize];
            let operator = ["Ada", "Ben"][operator as usize];
            writeln!(
                text,
                "{name},{angle:.2},{day},{},{batch},{operator},{humidity:.1},{temperature:.1},{rest}",
                place + 1
            )
            .unwrap();
        }
    }
    text
}

/// Nothing up to 30 %, then ever faster: the film of water between two grains.
fn isotherm(humidity_pct: f64) -> f64 {
    let over = ((humidity_pct - 30.0) / 45.0).clamp(0.0, 1.0);
    over * over * (3.0 - 2.0 * over)
}
