//! How well each cause explains what fell: a synthetic likelihood of the summaries.
//!
//! ```text
//! S      = covariance of summaries of replays with one set and one change, pooled, and shrunk by a fifth to its diagonal
//! x | c  ~ t_nu(m_c(u), (1 + 1/R) S)          u: amplitude, m_c(u) between the means of R replays at simulated amplitudes
//! angle  ~ N(angle_c(u), s^2)                 s^2 = SD^2 / n + a day's and a heap's 1 deg each
//! x | ?  ~ t_nu(m, (1 + 1/R) S + D)           D: mean square of what the causes of the catalogue change, each number by itself
//! ```
//!
//! after Wood (2010); t, since S is estimated (Price et al. 2018). Evidence is the mean likelihood
//! over amplitudes and sets; causes, and one that is not in the catalogue, are equally probable.

use super::causes::{AMPLITUDES, SpoonCause};
use super::field::{Fell, Field, Node};
use super::summaries::{Frame, total};
use crate::thresholds::SETTLED_DEG;
use flip_core::domain::powder::Flowability;
use flip_core::stats::mixed_model::log_mean_exp;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Weight of the diagonal.
const SHRINK: f64 = 0.2;
/// Amplitudes between two simulated ones.
const FINE: usize = 4;
/// What a powder without an angle counts as, deg from the measured one.
const NO_ANGLE_DEG: f64 = 10.0;

/// A cause with one set and amplitude, and how well it explains what fell.
#[derive(Debug, Clone)]
pub(super) struct Point {
    pub cause: SpoonCause,
    pub set: usize,
    /// In units of the grid: 1 is the first amplitude.
    pub u: f64,
    pub log_likelihood: f64,
    /// Mass of each spoonful, also of those left out, mg.
    pub totals_mg: Vec<f64>,
    /// What it changes, in units of the scatter.
    pub shift: DVector<f64>,
    pub angle_deg: Option<f64>,
}

/// A set without any cause.
#[derive(Debug, Clone)]
pub(super) struct Plain {
    pub set: usize,
    pub log_likelihood: f64,
    pub totals_mg: Vec<f64>,
}

/// What spoonfuls say of every cause.
#[derive(Debug, Clone)]
pub(super) struct Weighed {
    pub plain: Vec<Plain>,
    pub points: Vec<Point>,
    pub log_unknown: f64,
}

/// Replays at one amplitude, summed up.
struct At {
    u: f64,
    summary: DVector<f64>,
    totals_mg: Vec<f64>,
    angle_deg: Option<f64>,
}

struct Student {
    cholesky: Cholesky<f64, Dyn>,
    freedom: f64,
}

impl Student {
    fn new(covariance: DMatrix<f64>, freedom: f64) -> Option<Self> {
        Some(Self { cholesky: Cholesky::new(covariance)?, freedom })
    }

    fn whitened(&self, of: &DVector<f64>) -> DVector<f64> {
        self.cholesky.l().solve_lower_triangular(of).unwrap_or_else(|| of.clone())
    }

    /// Log density up to a constant of the dimension.
    fn log(&self, residual: &DVector<f64>) -> f64 {
        let square = self.whitened(residual).norm_squared();
        let log_det = self.cholesky.l().diagonal().map(f64::ln).sum();
        -log_det - 0.5 * (self.freedom + residual.len() as f64) * (1.0 + square / self.freedom).ln()
    }
}

/// Weighs every cause by the spoonfuls at these places.
pub(super) fn weigh(
    field: &Field<'_>,
    nodes: &[Node],
    used: &[usize],
    keep: &[usize],
    angle: Option<Flowability>,
) -> Option<Weighed> {
    let frame = field.frame(keep);
    let sum = |fell: &Fell| summed(&frame, fell, keep);
    let (covariance, freedom) = scatter(field, nodes, &frame, &sum);
    let repeats = nodes.first().map_or(1, |node| node.replays.len());
    let student = Student::new(covariance.clone() * (1.0 + 1.0 / repeats as f64), freedom)?;
    let measured = sum(&field.measured);
    let bases: Vec<At> = used.iter().map(|&set| base(field, set, &sum)).collect();
    let of_angle = |deg: Option<f64>| angle.map_or(0.0, |angle| log_angle(angle, deg));
    let plain: Vec<Plain> = used
        .iter()
        .zip(&bases)
        .map(|(&set, at)| Plain {
            set,
            log_likelihood: student.log(&(&measured - &at.summary)) + of_angle(at.angle_deg),
            totals_mg: at.totals_mg.clone(),
        })
        .collect();
    let mut points = Vec::new();
    for (&set, at) in used.iter().zip(&bases) {
        for (cause, at) in courses(nodes, set, at, &sum) {
            let residual = &measured - &at.summary;
            let base = &bases[used.iter().position(|other| *other == set)?];
            points.push(Point {
                cause,
                set,
                u: at.u,
                log_likelihood: student.log(&residual) + of_angle(at.angle_deg),
                shift: student.whitened(&(&at.summary - &base.summary)),
                totals_mg: at.totals_mg,
                angle_deg: at.angle_deg,
            });
        }
    }
    let broad =
        Student::new(broad(&covariance, repeats, field, nodes, used, &bases, &sum), freedom)?;
    let unknown =
        bases.iter().map(|at| broad.log(&(&measured - &at.summary)) + of_angle(at.angle_deg));
    let log_unknown = log_mean_exp(&unknown.collect::<Vec<_>>());
    Some(Weighed { plain, points, log_unknown })
}

fn summed(frame: &Frame<'_>, fell: &Fell, keep: &[usize]) -> DVector<f64> {
    let own: Vec<&[f64]> = keep.iter().map(|&k| fell[k].as_slice()).collect();
    DVector::from_vec(frame.summed(&own))
}

/// Means over replays.
fn averaged(replays: &[&Fell], sum: &dyn Fn(&Fell) -> DVector<f64>) -> (DVector<f64>, Vec<f64>) {
    let count = replays.len().max(1) as f64;
    let summaries: Vec<DVector<f64>> = replays.iter().map(|fell| sum(fell)).collect();
    let summary = summaries.iter().skip(1).fold(summaries[0].clone(), |all, one| all + one) / count;
    let spoonfuls = replays[0].len();
    let totals = (0..spoonfuls)
        .map(|j| replays.iter().map(|fell| total(&fell[j])).sum::<f64>() / count)
        .collect();
    (summary, totals)
}

fn base(field: &Field<'_>, set: usize, sum: &dyn Fn(&Fell) -> DVector<f64>) -> At {
    let own: Vec<&Fell> = field.base.iter().filter(|it| it.set == set).map(|it| &it.fell).collect();
    let (summary, totals_mg) = averaged(&own, sum);
    At { u: 0.0, summary, totals_mg, angle_deg: field.angles_deg.get(set).copied().flatten() }
}

/// Every cause of a set at each fine amplitude, from the simulated ones.
fn courses(
    nodes: &[Node],
    set: usize,
    base: &At,
    sum: &dyn Fn(&Fell) -> DVector<f64>,
) -> Vec<(SpoonCause, At)> {
    let mut all = Vec::new();
    let mut causes: Vec<SpoonCause> = nodes.iter().map(|node| node.cause).collect();
    causes.dedup();
    for cause in causes {
        let own = nodes.iter().filter(|node| node.cause == cause && node.set == set);
        let ends: Vec<At> = own.map(|node| at(node, sum)).collect();
        let between = |(k, end): (usize, &At)| {
            let before = if k == 0 { base } else { &ends[k - 1] };
            let fine = if cause.is_continuous() { 1..=FINE } else { FINE..=FINE };
            fine.map(|step| mixed(before, end, step as f64 / FINE as f64)).collect::<Vec<_>>()
        };
        all.extend(ends.iter().enumerate().flat_map(between).map(|at| (cause, at)));
    }
    all
}

fn at(node: &Node, sum: &dyn Fn(&Fell) -> DVector<f64>) -> At {
    let (summary, totals_mg) = averaged(&node.replays.iter().collect::<Vec<_>>(), sum);
    At { u: (node.place + 1) as f64, summary, totals_mg, angle_deg: node.angle_deg }
}

fn mixed(a: &At, b: &At, share: f64) -> At {
    let mix = |a: f64, b: f64| a + share * (b - a);
    At {
        u: mix(a.u, b.u),
        summary: &a.summary + share * (&b.summary - &a.summary),
        totals_mg: a.totals_mg.iter().zip(&b.totals_mg).map(|(a, b)| mix(*a, *b)).collect(),
        angle_deg: a.angle_deg.zip(b.angle_deg).map(|(a, b)| mix(a, b)),
    }
}

/// Covariance of the summaries of replays that differ in the seed alone, and its freedom.
fn scatter(
    field: &Field<'_>,
    nodes: &[Node],
    frame: &Frame<'_>,
    sum: &dyn Fn(&Fell) -> DVector<f64>,
) -> (DMatrix<f64>, f64) {
    let sets = field.base.iter().map(|it| it.set).max().unwrap_or(0);
    let of_set = |set| field.base.iter().filter(move |it| it.set == set).map(|it| &it.fell);
    let groups = (0..=sets).map(|set| of_set(set).collect::<Vec<_>>());
    let groups = groups.chain(nodes.iter().map(|node| node.replays.iter().collect()));
    let d = frame.len();
    let (mut squares, mut freedom) = (DMatrix::zeros(d, d), 0usize);
    for group in groups.filter(|group| group.len() > 1) {
        let rows: Vec<DVector<f64>> = group.iter().map(|fell| sum(fell)).collect();
        let centre = rows.iter().fold(DVector::zeros(d), |all, row| all + row) / rows.len() as f64;
        rows.iter().for_each(|row| squares += (row - &centre) * (row - &centre).transpose());
        freedom += group.len() - 1;
    }
    let mut covariance = squares / freedom.max(1) as f64;
    for (i, floor) in frame.floors().into_iter().enumerate() {
        let own = covariance[(i, i)];
        (0..d).filter(|j| *j != i).for_each(|j| covariance[(i, j)] *= 1.0 - SHRINK);
        covariance[(i, i)] = own + floor * floor;
    }
    (covariance, freedom.max(3) as f64)
}

/// Covariance of what fell with a cause that is not in the catalogue.
fn broad(
    covariance: &DMatrix<f64>,
    repeats: usize,
    field: &Field<'_>,
    nodes: &[Node],
    used: &[usize],
    bases: &[At],
    sum: &dyn Fn(&Fell) -> DVector<f64>,
) -> DMatrix<f64> {
    let mut all = covariance * (1.0 + 1.0 / repeats as f64);
    let base = |set: usize| used.iter().position(|other| *other == set).map(|k| &bases[k]);
    let shifts: Vec<DVector<f64>> = nodes
        .iter()
        .filter_map(|node| Some(at(node, sum).summary - &base(node.set)?.summary))
        .collect();
    let d = sum(&field.measured).len();
    for k in 0..d {
        let squares: f64 = shifts.iter().map(|shift| shift[k] * shift[k]).sum();
        all[(k, k)] += squares / shifts.len().max(1) as f64;
    }
    all
}

/// Log likelihood of the measured angle.
fn log_angle(measured: Flowability, simulated: Option<f64>) -> f64 {
    let variance = measured.sd_deg.powi(2) / f64::from(measured.n) + 2.0 * SETTLED_DEG.powi(2);
    let off = simulated.map_or(NO_ANGLE_DEG, |deg| measured.repose_deg - deg);
    -0.5 * off * off / variance
}

impl Weighed {
    /// Log evidence of a cause.
    pub fn log_evidence(&self, cause: SpoonCause) -> f64 {
        let own: Vec<f64> = self.of(cause).map(|point| point.log_likelihood).collect();
        if own.is_empty() { f64::NEG_INFINITY } else { log_mean_exp(&own) }
    }

    /// Log evidence of nothing being wrong.
    pub fn log_plain(&self) -> f64 {
        log_mean_exp(&self.plain.iter().map(|it| it.log_likelihood).collect::<Vec<_>>())
    }

    /// The points of a cause.
    pub fn of(&self, cause: SpoonCause) -> impl Iterator<Item = &Point> {
        self.points.iter().filter(move |point| point.cause == cause)
    }

    /// Place of a set among those used.
    pub fn place(&self, set: usize) -> usize {
        self.plain.iter().position(|plain| plain.set == set).unwrap_or(0)
    }

    /// Causes in the order judged.
    pub fn causes(&self) -> Vec<SpoonCause> {
        SpoonCause::ALL.into_iter().filter(|cause| self.of(*cause).next().is_some()).collect()
    }
}

/// Amplitude at a place of the grid.
pub(super) fn amplitude(cause: SpoonCause, u: f64) -> f64 {
    let grid = cause.amplitudes();
    if !cause.is_continuous() {
        return grid[(u.round() as usize).clamp(1, AMPLITUDES) - 1];
    }
    let below = u.floor().clamp(0.0, (AMPLITUDES - 1) as f64);
    let at = |k: usize| if k == 0 { 0.0 } else { grid[k - 1] };
    let k = below as usize;
    at(k) + (u - below) * (at(k + 1) - at(k))
}
