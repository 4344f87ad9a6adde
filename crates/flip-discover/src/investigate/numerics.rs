//! Finds what is wrong with the simulator without any data: an angle of repose must not depend on
//! how it is computed.
//!
//! Heaps are poured with one computational setting varied at a time, and the angle is regressed on
//! its logarithm:
//!
//! ```text
//! angle = a + b log10(settling time)   or   a + b log2(substep)   or   a + b log2(grains),      b +- t_0.995 SE(b)
//! ```
//!
//! with one a per powder, and for the settling time one per seed too: a heap at rest stays the same
//! however long the wait.
//!
//! Settling time: a heap that keeps creeping grows flatter with it, and calibration would
//! compensate with friction or cohesion that the powder does not have. It is a defect from
//! [`CREEP_DEG`] a decade; substep and grains from [`STEP_DEG`] a doubling. A slope counts if its
//! 99 % interval excludes zero and its size exceeds the bound.
//!
//! Source: least squares of a line, textbook.

use crate::judge::claim::{self, Proposal};
use crate::report::names;
use crate::report::printed::is_told;
use crate::report::{CauseReport, Numerics, ParameterReport, Report, Verdict};
pub use crate::report::{Dependence, Varied};
pub use crate::thresholds::{CREEP_DEG, STEP_DEG};
use flip_core::domain::seed::derive;
use flip_core::stats::normal;
use statrs::distribution::{ContinuousCDF, StudentsT};
use std::collections::BTreeMap;

/// Factors tried on each setting.
const FACTORS: [(Varied, &[f64]); 3] = [
    (Varied::SettlingTime, &[0.3, 1.0, 3.0]),
    (Varied::Substep, &[0.5, 1.0]),
    (Varied::Particles, &[0.5, 1.0, 2.0]),
];

/// A heap to simulate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VariedHeap {
    /// Index of its powder.
    pub powder: usize,
    /// The varied setting.
    pub varied: Varied,
    /// Its value over the usual one.
    pub factor: f64,
    /// Seed.
    pub seed: u64,
}

/// Pours heaps of `powders` sets with `repeats` seeds for every factor, and returns how the angle
/// depends on each setting.
///
/// `pour` returns the angles of a batch of heaps in the same order, degrees; `None` where a heap
/// has none. It must be pure.
pub fn criticise(
    powders: usize,
    repeats: u32,
    seed: u64,
    pour: impl Fn(&[VariedHeap]) -> Vec<Option<f64>>,
) -> Vec<Dependence> {
    let of = |&(varied, factors): &(Varied, &[f64])| {
        let heaps: Vec<(usize, f64, u64)> = (0..powders)
            .flat_map(|powder| {
                factors
                    .iter()
                    .flat_map(move |&f| (0..repeats).map(move |k| (powder, f, u64::from(k))))
            })
            .collect();
        // The same seed at every factor: the computation is the only difference.
        let heap = |&(powder, factor, k): &(usize, f64, u64)| VariedHeap {
            powder,
            varied,
            factor,
            seed: derive(seed, &[powder as u64, k]),
        };
        let angles = pour(&heaps.iter().map(heap).collect::<Vec<_>>());
        let point = |(&(powder, factor, k), angle): (&(usize, f64, u64), Option<f64>)| {
            let base = if varied == Varied::SettlingTime { 10.0 } else { 2.0 };
            // With another substep or other grains the same seed makes a different heap.
            let alike = if varied == Varied::SettlingTime {
                powder * repeats as usize + k as usize
            } else {
                powder
            };
            Some((alike, factor.log(base), angle?))
        };
        let points: Vec<(usize, f64, f64)> = heaps.iter().zip(angles).filter_map(point).collect();
        let (slope_deg, ci99) = slope(&points);
        let bound = if varied == Varied::SettlingTime { CREEP_DEG } else { STEP_DEG };
        let is_defect = slope_deg.abs() > bound && ci99[0] * ci99[1] > 0.0;
        Dependence { varied, slope_deg, ci99, is_defect, runs: heaps.len() as u32 }
    };
    FACTORS.iter().map(of).collect()
}

/// Slope common to all points, with one mean per group, and its 99 % interval; without degrees of
/// freedom, the whole line.
fn slope(points: &[(usize, f64, f64)]) -> (f64, [f64; 2]) {
    let mut groups: BTreeMap<usize, Vec<(f64, f64)>> = BTreeMap::new();
    points.iter().for_each(|&(alike, x, y)| groups.entry(alike).or_default().push((x, y)));
    let mut centred = Vec::new();
    for of in groups.values() {
        let mean =
            |value: fn(&(f64, f64)) -> f64| of.iter().map(value).sum::<f64>() / of.len() as f64;
        let (x, y) = (mean(|p| p.0), mean(|p| p.1));
        centred.extend(of.iter().map(|p| (p.0 - x, p.1 - y)));
    }
    let squares: f64 = centred.iter().map(|(x, _)| x * x).sum();
    let freedom = centred.len() as f64 - groups.len() as f64 - 1.0;
    if squares <= 0.0 || freedom < 1.0 {
        return (0.0, [f64::NEG_INFINITY, f64::INFINITY]);
    }
    let slope = centred.iter().map(|(x, y)| x * y).sum::<f64>() / squares;
    let left: f64 = centred.iter().map(|(x, y)| (y - slope * x).powi(2)).sum();
    let error = (left / freedom / squares).sqrt();
    let t = StudentsT::new(0.0, 1.0, freedom).map_or(f64::INFINITY, |t| t.inverse_cdf(0.995));
    (slope, [slope - t * error, slope + t * error])
}

/// Heaps that keep moving, as named in documents.
pub const CREEP: &str = "creep";

/// Adds to a document how heaps depend on the computation. Creep becomes its first cause:
/// discrepancies blamed on powders may be the simulator's own.
pub fn tell(document: &mut Report, numerics: Numerics) {
    let creep = numerics
        .dependences
        .iter()
        .find(|it| it.varied == Varied::SettlingTime && it.is_defect)
        .cloned();
    document.numerics = Some(numerics);
    let Some(Dependence { slope_deg, ci99, .. }) = creep else { return };
    // A normal deviate is within 2.576 on either side in 99 % of cases, within 1.96 in 95 %.
    let sd = ((ci99[1] - ci99[0]) / (2.0 * 2.576)).max(1e-9);
    let within =
        normal::cdf((CREEP_DEG - slope_deg) / sd) - normal::cdf((-CREEP_DEG - slope_deg) / sd);
    let ci95 = [slope_deg - 1.96 * sd, slope_deg + 1.96 * sd];
    document.sentence = format!(
        "{} makes angles change by {slope_deg:+.1}° [{:.1}, {:.1}] with every tenfold of the time that heaps are given to settle; what is said of powders \
         may be the simulator's own, until that is mended. {}",
        names::cause(CREEP),
        ci95[0],
        ci95[1],
        document.sentence
    );
    let slope = ParameterReport {
        name: "creep_deg_per_decade".to_owned(),
        value: slope_deg,
        ci95,
        unit: "deg".to_owned(),
    };
    let creep = CauseReport {
        mechanism: CREEP.to_owned(),
        family: "numerical".to_owned(),
        inclusion_probability: 1.0 - within,
        // The settling time was changed, and the angle with it.
        confidence_level: 3,
        parameters: vec![slope],
        powders: Vec::new(),
    };
    document.causes.insert(0, creep);
    if matches!(document.verdict, Verdict::NoDiscrepancy | Verdict::Hint) {
        // Fresh heaps had the longer time: they are the left-out data.
        document.verdict = claim::verdict(Proposal::Cause, is_told(ci95, "deg"), true);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 35 deg with a seed noise of 1 deg.
    fn heap(seed: u64) -> f64 {
        35.0 + normal::quantile((seed % 9973) as f64 / 9973.0 * 0.98 + 0.01)
    }

    fn each(
        one: impl Fn(&VariedHeap) -> Option<f64>,
    ) -> impl Fn(&[VariedHeap]) -> Vec<Option<f64>> {
        move |all| all.iter().map(&one).collect()
    }

    fn of(found: &[Dependence], varied: Varied) -> &Dependence {
        found.iter().find(|it| it.varied == varied).unwrap()
    }

    #[test]
    fn heaps_that_creep_are_told_from_heaps_that_rest() {
        let rests = criticise(3, 4, 1, each(|it| Some(heap(it.seed) + it.powder as f64)));
        assert!(rests.iter().all(|it| !it.is_defect && it.slope_deg.abs() < 1e-9), "{rests:?}");
        let creeps = |&VariedHeap { powder, varied, factor, seed }: &VariedHeap| {
            let crept = if varied == Varied::SettlingTime { -0.8 * factor.log10() } else { 0.0 };
            Some(heap(seed) + powder as f64 + crept)
        };
        let found = criticise(3, 4, 1, each(creeps));
        let time = of(&found, Varied::SettlingTime);
        assert!(time.is_defect && (time.slope_deg + 0.8).abs() < 1e-9, "{time:?}");
        assert!(!of(&found, Varied::Substep).is_defect && !of(&found, Varied::Particles).is_defect);
    }

    #[test]
    fn heaps_that_differ_much_and_creep_little_are_told_by_their_own_course() {
        // Seeds differ by a degree and each creeps by 0.3 deg a decade, give or take 0.05.
        let creeps = |&VariedHeap { varied, factor, seed, .. }: &VariedHeap| {
            let own = if varied == Varied::SettlingTime {
                0.05 * heap(seed ^ factor.to_bits())
            } else {
                0.0
            };
            Some(heap(seed) + own - 0.3 * factor.log10())
        };
        let found = criticise(1, 3, 1, each(creeps));
        assert!(of(&found, Varied::SettlingTime).is_defect, "{found:?}");
    }

    #[test]
    fn the_interval_is_that_of_a_line_by_hand() {
        // y = 1 + 2 x + (0.1, -0.2, 0.1): slope 2, residual 0.06, one degree of freedom, sum of
        // squares 2, t_0.995 = 63.657.
        let (slope, ci99) = slope(&[(0, -1.0, -0.9), (0, 0.0, 0.8), (0, 1.0, 3.1)]);
        let half = 63.657 * (0.06f64 / 2.0).sqrt();
        assert!(
            (slope - 2.0).abs() < 1e-12 && (ci99[1] - 2.0 - half).abs() < 1e-3,
            "{slope} {ci99:?}"
        );
    }

    #[test]
    fn heaps_that_fail_leave_the_rest() {
        let fails = |&VariedHeap { varied, factor, seed, .. }: &VariedHeap| {
            (varied != Varied::Particles || factor < 2.0).then(|| heap(seed) - 2.0 * factor.log2())
        };
        let found = criticise(1, 4, 1, each(fails));
        assert!(of(&found, Varied::Particles).is_defect);
        let none = criticise(1, 2, 1, each(|_| None));
        assert!(none.iter().all(|it| !it.is_defect));
    }
}
