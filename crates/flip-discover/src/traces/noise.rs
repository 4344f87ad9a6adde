//! The noise of readings, masses of shakes and scatter when nothing is wrong, and noise that
//! wanders.
//!
//! ```text
//! row of n readings            V = diag(1 / n) + r K                                       unit: variance of a reading
//! mass of a shake              V = A A^T o (I + w 1 1^T + r min(i, j)) + (s / c)^2 J D D^T J    unit: c^2
//! scatter of a plateau         V = I + w 1 1^T                                             unit: its own
//! ```
//!
//! | symbol | name |
//! |---|---|
//! | K | correlation in time within a weighing: exp(-x / L), or (1 + x / L) exp(-x / L) |
//! | r | variance of what wanders; plain noise has none but what the balance's own filter of 0.1 to 0.4 s makes |
//! | w | variance of what a weighing's shakes, or plateaus, have in common |
//! | c, s | scatter of log mass; SD of a plateau's level, mg |
//! | A, J | dz / d log d and dz / d d of the transformed mass z = asinh(d / 2 s) of a shake |
//! | D | each mass is the difference of two levels |

use super::design::Design;
use super::evidence::Whitening;
use super::level::Noise;
use nalgebra::DMatrix;
use std::ops::Range;

/// Noise correlated by a balance's own filter: its variance over that of white noise, 0 being white
/// alone, and the filter's time, s.
pub(super) const FILTERED: [(f64, f64); 10] = [
    (0.0, 0.2),
    (0.3, 0.1),
    (1.0, 0.1),
    (4.0, 0.1),
    (0.3, 0.2),
    (1.0, 0.2),
    (4.0, 0.2),
    (0.3, 0.4),
    (1.0, 0.4),
    (4.0, 0.4),
];
/// Time constant of the simulated balance's own filter, s: its response to a step is not a
/// discrepancy.
const NOMINAL_LAG_S: f64 = 0.16;
/// Fewest rows of a plateau that can spare one for it.
const NOMINAL_ROWS_MIN: usize = 4;
/// Kinds of wander: the time, s, and whether it is smooth.
const WANDERS: [(f64, bool); 5] =
    [(1.0, false), (5.0, false), (30.0, false), (2.0, true), (8.0, true)];
/// Variance of a wander over that of a reading.
const WANDER_RATIOS: [f64; 4] = [0.1, 1.0, 10.0, 100.0];
/// Scatter of the log of a shake's mass.
pub(super) const SCATTERS: [f64; 4] = [0.1, 0.2, 0.4, 0.8];
/// Variance common to the shakes of a weighing over that of one shake.
pub(super) const WEIGHING_RATIOS: [f64; 3] = [0.0, 0.1, 0.5];
/// Variance of the change from each shake to all after it; plain noise has none if the pitch is
/// known.
const STEP_RATIOS: [f64; 3] = [0.0, 0.05, 0.3];

/// Runs of equal neighbours.
fn runs(of: impl Iterator<Item = usize>) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    let mut last = None;
    for (i, group) in of.enumerate() {
        match runs.last_mut() {
            Some(run) if last == Some(group) => run.end = i + 1,
            _ => runs.push(i..i + 1),
        }
        last = Some(group);
    }
    runs
}

/// Noises of the rows of readings around each plateau's own level and, after a step of the load,
/// its own approach to it through the simulated balance's filter: exp(-x / 0.16 s) has the same
/// shape whenever the step was, so its size is free. Plateaus of few rows cannot spare that.
pub(super) fn of_readings(design: &Design) -> Vec<Noise> {
    let rows = &design.rows;
    let blocks = runs(rows.iter().map(|row| design.plateaus[row.plateau].log));
    let mut of_plateau = vec![0; design.plateaus.len()];
    rows.iter().for_each(|row| of_plateau[row.plateau] += 1);
    let own = |b: usize| {
        let block = blocks[b].clone();
        let first = rows[block.start].plateau;
        let plateaus = rows[block.end - 1].plateau - first + 1;
        DMatrix::from_fn(block.len(), 2 * plateaus, |i, k| {
            let (row, plateau) = (&rows[block.start + i], first + k % plateaus);
            let is_settled =
                k < plateaus || plateau == first || of_plateau[plateau] < NOMINAL_ROWS_MIN;
            match (row.plateau == plateau, k < plateaus) {
                (true, true) => 1.0,
                (true, false) if !is_settled => {
                    let from = design.times_s[design.plateaus[plateau].readings.start];
                    let behind = |t: &f64| (-(t - from) / NOMINAL_LAG_S).exp();
                    design.times_s[row.readings.clone()].iter().map(behind).sum::<f64>()
                        / row.readings.len() as f64
                }
                _ => 0.0,
            }
        })
    };
    let length = |i: usize| {
        design.times_s[rows[i].readings.end - 1] - design.times_s[rows[i].readings.start]
    };
    // The part of a correlated noise that remains in its mean over a row.
    let left = |i: usize, scale_s: f64| {
        let x = length(i) / scale_s;
        if x < 1e-3 { 1.0 } else { (2.0 / x * (1.0 - (1.0 - (-x).exp()) / x)).sqrt() }
    };
    let kernel = |b: usize, scale_s: f64, is_smooth: bool| {
        let block = blocks[b].clone();
        DMatrix::from_fn(block.len(), block.len(), |i, j| {
            let (i, j) = (block.start + i, block.start + j);
            let x = (rows[i].t_s - rows[j].t_s).abs() / scale_s;
            let correlation = if is_smooth { (1.0 + x) * (-x).exp() } else { (-x).exp() };
            left(i, scale_s) * left(j, scale_s) * correlation
        })
    };
    let white = |b: usize| {
        let counts = blocks[b].clone().map(|i| 1.0 / rows[i].readings.len() as f64);
        DMatrix::from_diagonal(&nalgebra::DVector::from_iterator(blocks[b].len(), counts))
    };
    let fixed = DMatrix::zeros(rows.len(), 0);
    let noise = |scale_s: f64, is_smooth: bool, ratio: f64| {
        Whitening::new(&blocks, |b| white(b) + ratio * kernel(b, scale_s, is_smooth), own, &fixed)
    };
    // A display hides anything smaller than its steps, so a load that shows no noise is known no
    // better than one step.
    let steps = design.readability_mg.powi(2) / 12.0;
    let finish = |model: Whitening, is_wander: bool| Noise {
        floor: steps * model.trace(white),
        model,
        is_wander,
    };
    let plain = FILTERED
        .iter()
        .filter_map(|&(ratio, filter_s)| noise(filter_s, false, ratio))
        .map(|model| finish(model, false));
    let wanders = WANDERS.iter().flat_map(|&(scale_s, is_smooth)| {
        WANDER_RATIOS.map(move |ratio| (scale_s, is_smooth, ratio))
    });
    let wanders =
        wanders.filter_map(|(scale_s, is_smooth, ratio)| noise(scale_s, is_smooth, ratio));
    plain.chain(wanders.map(|model| finish(model, true))).collect()
}

/// Masses of shakes as they are judged: z = asinh(d / w), near log d where the balance resolves it
/// and linear where it does not.
pub(super) struct Masses {
    /// w, mg.
    pub width_mg: f64,
    /// SD of a plateau's level, mg.
    pub level_sd_mg: f64,
    /// Mass dispensed by each powder's own response, mg.
    pub nominal_mg: Vec<f64>,
    /// Columns of the response, `[shakes, p]`.
    pub fixed: DMatrix<f64>,
}

impl Masses {
    /// dz / d log d.
    pub fn log_slope(&self, i: usize) -> f64 {
        self.nominal_mg[i] * self.slope(i)
    }

    /// dz / d d, 1/mg.
    fn slope(&self, i: usize) -> f64 {
        1.0 / self.nominal_mg[i].hypot(self.width_mg)
    }
}

/// A noise of shakes; relative to the square of its scatter of log mass, the part common to a
/// weighing and the change from each shake to all after it.
pub(super) struct ShakeNoise {
    pub noise: Noise,
    pub weighing: f64,
    pub step: f64,
}

/// Noises of the masses of shakes. An unrecorded pitch may go up and down: then the change from
/// shake to shake is plain noise.
pub(super) fn of_shakes(design: &Design, masses: &Masses) -> Vec<ShakeNoise> {
    let is_pitch_known = design.knows(|plateau| plateau.pitch_deg);
    let shakes = &design.shakes;
    let blocks = runs(shakes.iter().map(|shake| shake.log));
    let fixed = DMatrix::from_fn(shakes.len(), masses.fixed.ncols(), |i, k| {
        masses.log_slope(i) * masses.fixed[(i, k)]
    });
    let levels = |i: usize, j: usize| {
        let both = |i: usize| [(shakes[i].before, -1.0), (Some(shakes[i].after), 1.0)];
        let shared = |a: (Option<usize>, f64)| {
            both(j).iter().filter(|b| b.0.is_some() && b.0 == a.0).map(|b| a.1 * b.1).sum::<f64>()
        };
        both(i).into_iter().map(shared).sum::<f64>()
    };
    let noise = |scatter: f64, weighing: f64, step: f64| {
        let covariance = |b: usize| {
            let start = blocks[b].start;
            DMatrix::from_fn(blocks[b].len(), blocks[b].len(), |i, j| {
                let own = if i == j { 1.0 } else { 0.0 };
                let common = own + weighing + step * (i.min(j) + 1) as f64;
                let (i, j) = (start + i, start + j);
                let shown = (masses.level_sd_mg / scatter).powi(2)
                    * masses.slope(i)
                    * masses.slope(j)
                    * levels(i, j);
                // A small addition to the diagonal: masses that are all noise have no slope.
                masses.log_slope(i) * masses.log_slope(j) * common + shown + 1e-3 * own
            })
        };
        Whitening::new(&blocks, covariance, |b| DMatrix::zeros(blocks[b].len(), 0), &fixed)
    };
    let mut noises = Vec::new();
    for scatter in SCATTERS {
        for weighing in WEIGHING_RATIOS {
            for step in STEP_RATIOS {
                let is_wander = step > 0.0 && is_pitch_known;
                let of = |model| ShakeNoise {
                    noise: Noise { model, is_wander, floor: 0.0 },
                    weighing,
                    step,
                };
                noises.extend(noise(scatter, weighing, step).map(of));
            }
        }
    }
    noises
}

/// Noises of the scatter of plateaus, `log` of each.
pub(super) fn of_scatter(log: &[usize], fixed: &DMatrix<f64>) -> Vec<Noise> {
    let blocks = runs(log.iter().copied());
    let noise = |weighing: f64| {
        let covariance = |b: usize| {
            let n = blocks[b].len();
            DMatrix::from_fn(n, n, |i, j| weighing + if i == j { 1.0 } else { 0.0 })
        };
        Whitening::new(&blocks, covariance, |b| DMatrix::zeros(blocks[b].len(), 0), fixed)
    };
    let ratios = [0.0, 0.1, 0.4, 1.5];
    ratios
        .into_iter()
        .filter_map(noise)
        .map(|model| Noise { model, is_wander: false, floor: 0.0 })
        .collect()
}
