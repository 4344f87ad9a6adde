//! What a dispenser aims at, and the even numbers that it draws in thought.

use super::response::Response;

/// The `index`-th number of van der Corput's sequence of a base, within 0..1.
pub(super) fn radical_inverse(index: usize, base: usize) -> f64 {
    let (mut rest, mut digit, mut value) = (index, 1.0 / base as f64, 0.0);
    while rest > 0 {
        value += (rest % base) as f64 * digit;
        rest /= base;
        digit /= base as f64;
    }
    value
}

/// Quantile of Student's t with four degrees of freedom, in closed form (Shaw 2006).
pub(super) fn student4(p: f64) -> f64 {
    let root = (4.0 * p * (1.0 - p)).sqrt();
    let q = libm::cos(libm::acos(root) / 3.0) / root;
    (2.0 * (q - 1.0).max(0.0).sqrt()).copysign(p - 0.5)
}

/// The mean to aim at, by steps left and missing mass, if any mean could be had: for masses scattered as [`Response`] says
///
/// ```text
/// V_0(m) = loss(m)     V_k(m) = min(loss(m), min over mu of E V_(k-1)(m - mass(mu)))
/// ```
#[derive(Debug, Clone)]
pub(super) struct Aims {
    /// By steps left, from 1, then by missing mass in steps of [`GRID_MG`].
    table: Vec<Vec<f64>>,
}

/// Step of the table, mg.
const GRID_MG: f64 = 0.1;
/// Missing masses of the table: 0 to 30 mg.
const CELLS: usize = 301;
/// Most steps left that the table tells apart.
const LEFT_MAX: usize = 30;
/// Means that are tried, mg: 0.05 to 25.
const MEANS: usize = 32;
/// Nodes of an expectation.
const NODES: usize = 16;

impl Aims {
    pub fn new(r: &Response) -> Self {
        let nodes: Vec<f64> = (0..NODES).map(|k| student4((k as f64 + 0.5) / NODES as f64)).collect();
        let means: Vec<f64> = (0..MEANS).map(|k| 0.05 * libm::pow(500.0, k as f64 / (MEANS - 1) as f64)).collect();
        let masses: Vec<Vec<f64>> =
            means.iter().map(|mean| nodes.iter().map(|z| r.draw(*mean, *z)).collect()).collect();
        let missing = |cell: usize| cell as f64 * GRID_MG;
        let mut values: Vec<f64> = (0..CELLS).map(|cell| r.loss(missing(cell))).collect();
        let mut table = Vec::new();
        for _ in 0..LEFT_MAX {
            let value = |m: f64| if m < 0.0 { r.loss(m) } else { between(&values, m) };
            let best = |cell: usize| {
                let m = missing(cell);
                let tried = means.iter().zip(&masses).map(|(mean, masses)| {
                    (masses.iter().map(|mass| value(m - mass)).sum::<f64>() / NODES as f64, *mean)
                });
                tried.chain([(r.loss(m), 0.0)]).min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((r.loss(m), 0.0))
            };
            let chosen: Vec<(f64, f64)> = (0..CELLS).map(best).collect();
            table.push(chosen.iter().map(|it| it.1).collect());
            values = chosen.iter().map(|it| it.0).collect();
        }
        Self { table }
    }

    /// The mean to aim at, mg; 0 is to stop.
    pub fn of(&self, left: u32, missing_mg: f64) -> f64 {
        if missing_mg <= 0.0 {
            return 0.0;
        }
        between(&self.table[(left as usize).clamp(1, LEFT_MAX) - 1], missing_mg)
    }
}

/// A value between two cells; beyond the last the last.
fn between(values: &[f64], missing_mg: f64) -> f64 {
    let at = (missing_mg / GRID_MG).min((values.len() - 1) as f64);
    let below = (at as usize).min(values.len() - 2);
    let share = at - below as f64;
    values[below] * (1.0 - share) + values[below + 1] * share
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_of_student_s_t_are_those_of_the_tables() {
        for (p, t) in [(0.5, 0.0), (0.9, 1.533_206), (0.95, 2.131_847), (0.99, 3.746_947), (0.025, -2.776_445)] {
            assert!((student4(p) - t).abs() < 1e-5, "{p}: {} {t}", student4(p));
        }
    }
}
