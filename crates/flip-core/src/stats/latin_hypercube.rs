//! Space-filling designs for a first exploration of a box.

use rand::{Rng, RngExt};

/// Draws `n` points of the unit cube such that each coordinate falls once into each of `n` equal
/// slices of 0..1.
///
/// ```text
/// x[i][k] = (pi_k(i) + u) / n          pi_k a random permutation of 0..n, u uniform on 0..1
/// ```
///
/// Source: McKay, Beckman, Conover, Technometrics 21 (1979) 239.
pub fn latin_hypercube<const D: usize>(n: usize, rng: &mut impl Rng) -> Vec<[f64; D]> {
    let mut points = vec![[0.0; D]; n];
    for k in 0..D {
        for (point, slice) in points.iter_mut().zip(permutation(n, rng)) {
            point[k] = (slice as f64 + rng.random::<f64>()) / n as f64;
        }
    }
    points
}

/// Returns the best of `tries` Latin hypercubes: the one with the largest distance between its two
/// nearest points (maximin).
///
/// Source: Johnson, Moore, Ylvisaker, J. Stat. Plan. Inference 26 (1990) 131, by random search
/// instead of exchange.
pub fn maximin_latin_hypercube<const D: usize>(
    n: usize,
    tries: usize,
    rng: &mut impl Rng,
) -> Vec<[f64; D]> {
    let mut best = latin_hypercube(n, rng);
    let mut widest = nearest_pair(&best);
    for _ in 1..tries {
        let design = latin_hypercube(n, rng);
        let gap = nearest_pair(&design);
        if gap > widest {
            (best, widest) = (design, gap);
        }
    }
    best
}

/// Euclidean distance between two points.
pub fn distance<const D: usize>(a: &[f64; D], b: &[f64; D]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

/// Distance between the two nearest points; infinite with fewer than two.
fn nearest_pair<const D: usize>(points: &[[f64; D]]) -> f64 {
    let pairs = points
        .iter()
        .enumerate()
        .flat_map(|(i, a)| points[..i].iter().map(move |b| distance(a, b)));
    pairs.fold(f64::INFINITY, f64::min)
}

/// A random permutation of `0..n` (Fisher and Yates).
fn permutation(n: usize, rng: &mut impl Rng) -> Vec<usize> {
    let mut order: Vec<usize> = (0..n).collect();
    for last in (1..n).rev() {
        order.swap(last, rng.random_range(0..=last as u64) as usize);
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    #[test]
    fn every_coordinate_visits_every_slice_once() {
        for n in [1, 2, 7, 24] {
            let points: Vec<[f64; 9]> = latin_hypercube(n, &mut Pcg64::seed_from_u64(n as u64));
            for k in 0..9 {
                let mut slices: Vec<usize> =
                    points.iter().map(|p| (p[k] * n as f64) as usize).collect();
                slices.sort_unstable();
                assert_eq!(slices, (0..n).collect::<Vec<_>>());
            }
        }
        assert!(latin_hypercube::<9>(0, &mut Pcg64::seed_from_u64(1)).is_empty());
    }

    #[test]
    fn the_maximin_design_is_wider_than_the_average_one() {
        let mut rng = Pcg64::seed_from_u64(5);
        let average =
            (0..50).map(|_| nearest_pair(&latin_hypercube::<3>(12, &mut rng))).sum::<f64>() / 50.0;
        assert!(nearest_pair(&maximin_latin_hypercube::<3>(12, 50, &mut rng)) > 1.3 * average);
    }
}
