//! Is anything wrong: weighings among replays of them.
//!
//! ```text
//! x_0 measured, x_1 .. x_B: the same steps replayed, each time with a set drawn from the powder's
//! z   = (x - mean) / sd                      over all B + 1, summary by summary
//! T_i = mean distance of z_i to its 5 nearest
//! p   = (1 + number of b with T_b >= T_0) / (1 + B)
//! ```
//!
//! If the bench is the simulator with one of the sets, all B + 1 are exchangeable and every number
//! above treats them alike: p is exact, whatever the distribution (Besag and Clifford 1989). The
//! nearest neighbours let each set have a spoon of its own.
//!
//! Of several powders, each has its T in units of its own scatter; a powder's corrected p counts
//! the replays of which *any* powder lies as far out (Westfall and Young 1993).

use flip_core::stats::summary::{mean, sd};

/// Neighbours of a distance: fewer than the replays of one set of a few.
const NEIGHBOURS: usize = 5;

/// Judgement of one powder.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Screened {
    /// Distance of the measured from the replayed, and of each replay from the others.
    pub distance: f64,
    pub null: Vec<f64>,
    /// Chance of as much, alone.
    pub p_value: f64,
    /// The same for any powder.
    pub p_corrected: f64,
}

/// Judges powders by the summaries of each, `[powder][measured, then replays][summary]`; every
/// powder has as many replays.
pub(super) fn screen(powders: &[Vec<Vec<f64>>]) -> Vec<Screened> {
    let distances: Vec<Vec<f64>> = powders.iter().map(|rows| distances(rows)).collect();
    let scaled: Vec<Vec<f64>> = distances.iter().map(|of| standardised(of)).collect();
    let replays = distances.first().map_or(0, Vec::len);
    let most: Vec<f64> = (1..replays)
        .map(|i| scaled.iter().map(|of| of[i]).fold(f64::NEG_INFINITY, f64::max))
        .collect();
    let judged = distances.iter().zip(&scaled).map(|(distances, scaled)| Screened {
        distance: distances[0],
        null: distances[1..].to_vec(),
        p_value: rank(distances[0], &distances[1..]),
        p_corrected: rank(scaled[0], &most),
    });
    judged.collect()
}

/// Share of all that lie as far out, itself included.
fn rank(measured: f64, null: &[f64]) -> f64 {
    let beyond = null.iter().filter(|of| **of >= measured).count();
    (1 + beyond) as f64 / (1 + null.len()) as f64
}

fn standardised(values: &[f64]) -> Vec<f64> {
    let logs: Vec<f64> = values.iter().map(|of| of.max(f64::MIN_POSITIVE).ln()).collect();
    let (middle, scale) = (mean(&logs).unwrap_or(0.0), sd(&logs).unwrap_or(0.0));
    logs.iter().map(|log| if scale > 0.0 { (log - middle) / scale } else { 0.0 }).collect()
}

/// Mean distance of each row to its nearest others, in units of each column's scatter.
fn distances(rows: &[Vec<f64>]) -> Vec<f64> {
    let columns: Vec<Vec<f64>> = (0..rows.first().map_or(0, Vec::len))
        .map(|k| rows.iter().map(|row| row[k]).collect())
        .collect();
    let scales: Vec<f64> = columns.iter().filter_map(|column| sd(column)).collect();
    let apart = |a: &[f64], b: &[f64]| {
        let squares = a.iter().zip(b).zip(&scales).filter(|(_, sd)| **sd > 0.0);
        squares.map(|((x, y), sd)| ((x - y) / sd).powi(2)).sum::<f64>().sqrt()
    };
    let nearest = |i: usize| {
        let others = rows.iter().enumerate().filter(|(j, _)| *j != i);
        let mut all: Vec<f64> = others.map(|(_, row)| apart(&rows[i], row)).collect();
        all.sort_unstable_by(f64::total_cmp);
        all.truncate(NEIGHBOURS);
        mean(&all).unwrap_or(0.0)
    };
    (0..rows.len()).map(nearest).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(first: f64) -> Vec<Vec<f64>> {
        let replay = |i: u32| vec![f64::from(i % 7), f64::from(i % 5)];
        std::iter::once(vec![first, 2.0]).chain((0..39).map(replay)).collect()
    }

    #[test]
    fn what_lies_outside_all_replays_has_the_smallest_p_and_what_lies_inside_a_large_one() {
        let alone = |first| screen(&[rows(first)]).remove(0);
        assert_eq!((alone(40.0).p_value, alone(40.0).p_corrected), (0.025, 0.025));
        assert!(alone(3.0).p_value > 0.3, "{}", alone(3.0).p_value);
    }

    #[test]
    fn beside_other_powders_a_powder_has_to_lie_further_out() {
        let both = screen(&[rows(40.0), rows(3.0)]);
        assert!(both.iter().all(|it| it.p_corrected >= it.p_value), "{both:?}");
        assert!(both[0].p_corrected <= 0.05 && both[1].p_corrected > 0.3);
    }
}
