//! Whether repeats scatter more in some conditions than in others.
//!
//! The n runs of a powder on a day, less the estimated contribution of causes, make n - 1 contrasts
//! (Helmert's):
//!
//! ```text
//! z_k = sqrt(k / (k + 1)) (x_(k+1) - mean of x_1 .. x_k)        k = 1 .. n - 1
//! ```
//!
//! For repeats with one SD these are independent, with mean zero and that SD, however many repeats
//! a day has. The logarithm of their size, in percent, is judged as an angle is. Under the null it
//! is that of a normal deviate, whose left tail is long; campaigns are therefore simulated from
//! normal deviates, and small values are replaced by [`LEAST`], in both.

use crate::data::campaign::{Campaign, Covariate, Quantity, Run, Values, percent};
use crate::judge::noise;
use flip_core::domain::FieldError;
use flip_core::domain::seed::derive;
use flip_core::stats::normal;
use flip_core::stats::summary::mean;
use nalgebra::DMatrix;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use std::collections::BTreeMap;

/// Smallest contrast distinguished from zero, over the root mean square of its powder's: angles are
/// read to some tenths of a degree.
const LEAST: f64 = 0.05;

/// The campaign of the contrasts, of angles less `explained` (degrees, one for each run).
///
/// # Errors
/// Too few repeats to judge: [`Campaign::checked`].
pub(crate) fn scatters(campaign: &Campaign, explained: &[f64]) -> Result<Campaign, FieldError> {
    let mut cells: BTreeMap<(usize, usize), Vec<usize>> = BTreeMap::new();
    let mut runs_of: BTreeMap<u32, usize> = BTreeMap::new();
    campaign.runs.iter().for_each(|run| *runs_of.entry(run.row).or_default() += 1);
    // The runs behind a summary were generated from it.
    let is_single = |run: &Run| run.value.is_some() && runs_of[&run.row] == 1;
    for (i, run) in campaign.runs.iter().enumerate().filter(|(_, run)| is_single(run)) {
        cells.entry((run.session, run.powder)).or_default().push(i);
    }
    let left = |i: usize| campaign.runs[i].value.unwrap_or(0.0) - explained[i];
    let contrast = |runs: &[usize], k: usize| {
        let before = runs[..k].iter().map(|&i| left(i)).sum::<f64>() / k as f64;
        (k as f64 / (k + 1) as f64).sqrt() * (left(runs[k]) - before).abs()
    };
    let cells: Vec<Vec<usize>> = cells.into_values().filter(|runs| runs.len() > 1).collect();
    let contrasts: Vec<(&Vec<usize>, f64)> = cells
        .iter()
        .flat_map(|runs| (1..runs.len()).map(move |k| (runs, contrast(runs, k))))
        .collect();
    let usual: Vec<f64> = (0..campaign.powders.len())
        .map(|powder| {
            let of = contrasts.iter().filter(|(runs, _)| campaign.runs[runs[0]].powder == powder);
            mean(&of.map(|(_, z)| z * z).collect::<Vec<_>>()).unwrap_or(0.0).sqrt()
        })
        .collect();
    let known = contrasts.iter().filter(|(runs, _)| usual[campaign.runs[runs[0]].powder] > 0.0);
    let (of, runs): (Vec<&[usize]>, Vec<Run>) = known
        .map(|(runs, z)| {
            let first = campaign.runs[runs[0]];
            let usual = usual[first.powder];
            (runs.as_slice(), Run { value: Some(percent((z / usual).max(LEAST))), ..first })
        })
        .unzip();
    let covariates = campaign.covariates.iter().map(|covariate| Covariate {
        name: covariate.name.clone(),
        values: of_cells(&covariate.values, &of),
    });
    let quantity = Quantity::Scatter;
    Campaign {
        powders: campaign.powders.clone(),
        covariates: covariates.collect(),
        runs,
        quantity,
        ..Campaign::default()
    }
    .checked()
}

/// The recorded value for each contrast's cell of runs: their mean, or the name they share.
fn of_cells(values: &Values, cells: &[&[usize]]) -> Values {
    match values {
        Values::Numbers(of) => {
            let mean =
                |runs: &&[usize]| mean(&runs.iter().filter_map(|&i| of[i]).collect::<Vec<_>>());
            Values::Numbers(cells.iter().map(mean).collect())
        }
        Values::Levels { names, of } => {
            let shared = |runs: &&[usize]| {
                of[runs[0]].filter(|_| runs.iter().all(|&i| of[i] == of[runs[0]]))
            };
            Values::Levels { names: names.clone(), of: cells.iter().map(shared).collect() }
        }
    }
}

/// Campaigns of the same design whose repeats have one SD: `[contrasts, simulations]`.
pub(crate) fn simulated(campaign: &Campaign, seed: u64, simulations: u32) -> DMatrix<f64> {
    let mut all = DMatrix::zeros(campaign.runs.len(), simulations as usize);
    let mut one = campaign.clone();
    for (k, mut column) in all.column_iter_mut().enumerate() {
        let mut rng = Pcg64::seed_from_u64(derive(seed, &[0x5343_4154, k as u64]));
        for run in &mut one.runs {
            let z = normal::quantile(rng.random::<f64>().max(f64::EPSILON)).abs();
            run.value = Some(percent(z.max(LEAST)));
        }
        column.copy_from_slice(&noise::drawn_in(&one).0);
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::judge::prepared::Prepared;
    use crate::judge::screen::screen_among;
    use crate::{Responses, Settings};
    use std::ops::ControlFlow;

    /// Thirty days, three runs of two powders each, whose SD is `sd` of the day's humidity.
    fn campaign(seed: u64, sd: impl Fn(f64) -> f64) -> Campaign {
        let mut rng = Pcg64::seed_from_u64(seed);
        let humidity: Vec<f64> = (0..30).map(|_| rng.random_range(20.0..70.0)).collect();
        let runs: Vec<Run> = (0..180)
            .map(|k| {
                let (session, powder) = (k / 6, k % 2);
                let noise = normal::quantile(rng.random::<f64>().max(f64::EPSILON));
                let angle = 30.0 + 5.0 * powder as f64 + sd(humidity[session]) * noise;
                Run { row: k as u32 + 2, powder, session, value: Some(angle) }
            })
            .collect();
        let values = Values::Numbers(runs.iter().map(|run| Some(humidity[run.session])).collect());
        let covariates = vec![Covariate { name: "relative_humidity_pct".to_owned(), values }];
        Campaign {
            powders: vec!["sand".into(), "salt".into()],
            runs,
            covariates,
            ..Campaign::default()
        }
    }

    fn p_value(campaign: &Campaign) -> f64 {
        let scatters = scatters(campaign, &vec![0.0; campaign.runs.len()]).unwrap();
        let prepared = Prepared::new(&scatters, &Responses::new()).unwrap();
        let Settings { seed, simulations } = Settings { seed: 1, simulations: 99 };
        let null = simulated(&scatters, seed, simulations);
        screen_among(&prepared, &[null], |_| ControlFlow::Continue(())).unwrap().p_value
    }

    #[test]
    fn contrasts_are_helmerts() {
        let mut three = campaign(1, |_| 1.0);
        let angles = [31.0, 32.0, 36.0];
        for run in three.runs.iter_mut().filter(|run| run.session == 0 && run.powder == 0) {
            run.value = Some(angles[run.row as usize / 2 - 1]);
        }
        let explained = vec![0.0; 180];
        let made = scatters(&three, &explained).unwrap();
        assert_eq!(made.runs.len(), 120, "two of three runs of a cell");
        // z1 = (32 - 31) / sqrt 2, z2 = sqrt(2 / 3) (36 - 31.5): the difference of their logarithms
        // is known whatever the powder's usual scatter.
        let [a, b] = [0, 1].map(|k| made.runs[k].value.unwrap());
        let expected = 100.0 * ((2.0f64 / 3.0).sqrt() * 4.5 * 2.0f64.sqrt()).ln();
        assert!((b - a - expected).abs() < 1e-9, "{a} {b} {expected}");
        // A shift of all runs of a cell changes nothing.
        let moved: Vec<f64> = three.runs.iter().map(|run| 3.0 * run.session as f64).collect();
        let again = scatters(&three, &moved).unwrap();
        assert!(
            made.runs
                .iter()
                .zip(&again.runs)
                .all(|(a, b)| { (a.value.unwrap() - b.value.unwrap()).abs() < 1e-6 })
        );
    }

    #[test]
    fn scatter_that_grows_is_seen_and_scatter_that_does_not_is_not() {
        let alarms = (0..40).filter(|&seed| p_value(&campaign(seed, |_| 1.5)) <= 0.05).count();
        // Two are expected; seven or more have a chance of 1 in 300 (binomial, 40 at 5 %).
        assert!(alarms <= 6, "{alarms} false alarms of 40");
        let found = (0..10)
            .filter(|&seed| p_value(&campaign(seed, |h| 0.5 * (h / 20.0).exp2())) <= 0.05)
            .count();
        assert!(found >= 7, "{found} of 10 found");
    }
}
