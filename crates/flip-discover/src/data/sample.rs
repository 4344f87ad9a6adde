//! A small campaign for unit tests: known conditions, seeded noise, one effect.

use super::campaign::{Campaign, Covariate, Run, Values};
use flip_core::stats::normal;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// The conditions of one run.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Setting {
    /// Index: sand, salt.
    pub powder: usize,
    /// Relative humidity of the day, percent, 20 to 64 in steps of 4.
    pub humidity: f64,
    /// Index: Ada, Ben.
    pub operator: usize,
    /// A covariate that no cause acts through, V.
    pub supply: f64,
}

/// Twelve days, two runs of each of two powders a day, with an effect in degrees and repeats of an
/// SD of 0.5 deg.
pub(crate) fn campaign(seed: u64, effect_deg: impl Fn(&Setting) -> f64) -> Campaign {
    let mut rng = Pcg64::seed_from_u64(seed);
    let settings: Vec<Setting> = (0..48)
        .map(|i| Setting {
            powder: i % 2,
            humidity: 20.0 + 4.0 * f64::from((i as u32 / 4 * 7) % 12),
            operator: (i / 2 + i / 8) % 2,
            supply: rng.random_range(210.0..240.0),
        })
        .collect();
    let mut run = |(i, at): (usize, &Setting)| {
        let noise = 0.5 * normal::quantile(rng.random::<f64>().clamp(1e-12, 1.0 - 1e-12));
        let angle = 30.0 + 5.0 * at.powder as f64 + effect_deg(at) + noise;
        Run { row: i as u32 + 2, powder: at.powder, session: i / 4, value: Some(angle) }
    };
    let runs = settings.iter().enumerate().map(&mut run).collect();
    let numbers = |name: &str, of: fn(&Setting) -> f64| Covariate {
        name: name.to_owned(),
        values: Values::Numbers(settings.iter().map(|at| Some(of(at))).collect()),
    };
    let operator = Values::Levels {
        names: ["Ada", "Ben"].map(str::to_owned).to_vec(),
        of: settings.iter().map(|at| Some(at.operator)).collect(),
    };
    Campaign {
        powders: ["sand", "salt"].map(str::to_owned).to_vec(),
        runs,
        covariates: vec![
            numbers("relative_humidity_pct", |at| at.humidity),
            numbers("supply_v", |at| at.supply),
            Covariate { name: "operator".to_owned(), values: operator },
        ],
        ..Campaign::default()
    }
}
