//! The response of each powder's spoon, fitted to its own shakes: the law around which shakes are
//! judged.
//!
//! ```text
//! z = asinh(d / w),   w = 2 sqrt(2) s          s: SD of a plateau's level
//! z ~ a_p + b_p ln A + c_p theta + e theta^2    of powder p, amplitude A, pitch theta; columns that did not vary are left out
//! ```
//!
//! A calibrated simulation derives all of these from the powder, so nothing in their span is
//! judged. Without amplitudes there is no response: an operator who shakes less and less mimics any
//! cause of the spoon. Nor is there one without the spoon's fill: a simulated spoon dispenses less
//! as it empties and packs, and nothing in the first shakes of a heap that has not begun to slide,
//! so the expected mass depends on the fill. An unrecorded pitch may have grown from shake to
//! shake: a trend stands for it.

use super::design::Design;
use super::level::Verdict;
use super::noise::{Masses, SCATTERS, ShakeNoise};
use super::readings::Kind;
use super::screen::Unjudged;
use crate::thresholds::trace::{EXPLAINED_MIN, LAWFUL, SPARE_SHAKES_MIN, TIPPED_DEG, TIPPED_SHARE};
use nalgebra::{DMatrix, DVector};

/// Number of sets of simulated doses among which this one would be the first of twenty.
const SETS: usize = 19;
/// SD of a plateau's level that a piece of powder exceeds.
const PIECE_SD: f64 = 3.0;

impl Masses {
    /// Masses as they are judged, around the response.
    pub fn seen(&self, masses_mg: &[f64]) -> Vec<f64> {
        let z = |mg: f64| (mg / self.width_mg).asinh();
        masses_mg.iter().zip(&self.nominal_mg).map(|(&mg, &nominal)| z(mg) - z(nominal)).collect()
    }
}

/// The response; `None` with too few shakes, or without their amplitudes or fills.
pub(super) fn response(design: &Design) -> Option<Masses> {
    if !design.knows(|plateau| plateau.shake_mm) || !is_fill_known(design) {
        return None;
    }
    let masses = design.masses(&design.shown_mg);
    let fixed = columns(design);
    if masses.len() < fixed.ncols() + SPARE_SHAKES_MIN {
        return None;
    }
    let late = |k: usize| design.plateaus[k].readings.len().div_ceil(2) as f64;
    let counts: f64 =
        design.shakes.iter().map(|shake| late(shake.after)).sum::<f64>() / masses.len() as f64;
    // If loads do not move between readings, averaging does not help against a display's steps.
    let shown = design.readability_mg.powi(2) / 12.0;
    let level_sd_mg = (shown + design.reading_sd().powi(2) / counts).sqrt();
    let mut sorted = masses.clone();
    sorted.sort_by(f64::total_cmp);
    let width_mg = (8f64.sqrt() * level_sd_mg).max(0.02 * sorted[sorted.len() / 2].abs()).max(1e-9);
    let z = DVector::from_iterator(masses.len(), masses.iter().map(|mg| (mg / width_mg).asinh()));
    let solved = fixed.clone().svd(true, true).solve(&z, 1e-9).ok()?;
    let fitted = &fixed * solved;
    // A shake is expected to dispense something.
    let nominal_mg = fitted.iter().map(|z| (width_mg * z.sinh()).max(0.2 * width_mg)).collect();
    Some(Masses { width_mg, level_sd_mg, nominal_mg, fixed })
}

/// Whether the fill of the spoon was recorded.
pub(super) fn is_fill_known(design: &Design) -> bool {
    design.knows(|plateau| plateau.fill_mg)
}

/// Why shakes with known amplitudes were not judged when the spoon's fill was not recorded.
pub(super) fn unfilled(design: &Design) -> Option<Unjudged> {
    let is_shaken = design.knows(|plateau| plateau.shake_mm);
    (is_shaken && !is_fill_known(design)).then(|| {
        unjudged(
            design,
            "the spoon's fill was not recorded (spoon_fill_mg), and a simulated spoon empties and packs by itself",
        )
    })
}

/// Why doses that looked for the pitch at which powder flows are not judged: the law has no onset.
/// A simulated spoon has one, and its own doses would depart from the law in every cause at once.
/// The spoon channel replays them instead.
pub(super) fn sought(design: &Design, masses: &Masses) -> Option<Unjudged> {
    let fell = design.masses(&design.shown_mg);
    let doses = design.logs.iter().enumerate().filter(|(_, log)| log.kind == Kind::Dose);
    let tipped = doses.filter(|(log, _)| {
        rise_deg(design, &fell, PIECE_SD * masses.level_sd_mg, *log) >= TIPPED_DEG
    });
    let (tipped, all) =
        (tipped.count(), design.logs.iter().filter(|log| log.kind == Kind::Dose).count());
    (tipped as f64 >= TIPPED_SHARE * all as f64 && tipped > 0).then(|| {
        let why = format!(
            "{tipped} of {all} doses tipped the spoon by {TIPPED_DEG} deg or more before powder fell, and no law of amplitude and pitch has an onset"
        );
        unjudged(design, &why)
    })
}

/// How far the pitch rose from the first shake of a dose to the first that let fall this mass, deg.
fn rise_deg(design: &Design, fell: &[f64], piece_mg: f64, log: usize) -> f64 {
    let pitch = |k: usize| design.plateaus[design.shakes[k].after].pitch_deg;
    let own: Vec<usize> =
        (0..design.shakes.len()).filter(|&k| design.shakes[k].log == log).collect();
    let first = own.iter().find(|&&k| fell[k] >= piece_mg).or(own.last());
    let rise = || Some(pitch(*first?)? - pitch(*own.first()?)?);
    rise().unwrap_or(0.0)
}

/// Why there is no law around which shakes could be judged, if there is none: they scatter more
/// than any noise considered, or wander more than all but one in twenty sets of simulated shakes,
/// which follow the law, and no cause explains it.
/// `scatter`: of log mass around the response, as returned by [`scatter`].
pub(super) fn unlike(design: &Design, scatter: f64, judged: &Verdict) -> Option<Unjudged> {
    let left = judged.estimates.iter().map(|of| of.left).fold(1.0, f64::min);
    let scatter = scatter * left.sqrt();
    let wander = judged.wander[0];
    let is_caused = || {
        judged
            .causes
            .iter()
            .zip(&judged.estimates)
            .any(|(it, of)| it.1[0] > wander && of.explained >= EXPLAINED_MIN)
    };
    let how = if scatter > SCATTERS[SCATTERS.len() - 1] {
        format!("scatter by a factor of {:.1}", scatter.exp())
    } else if is_rare(&judged.wander) && !is_caused() {
        "wander".to_owned()
    } else {
        return None;
    };
    Some(unjudged(design, &format!("masses of shakes {how} around any law of amplitude and pitch")))
}

/// Whether the first is among the largest, and is evidence at all.
pub(super) fn is_rare(logs: &[f64]) -> bool {
    let as_large = logs.iter().filter(|&&log| log >= logs[0]).count();
    logs[0] > 0.0 && as_large as f64 <= LAWFUL * logs.len() as f64
}

fn unjudged(design: &Design, why: &str) -> Unjudged {
    let doses = (SETS * design.logs.iter().filter(|log| log.kind == Kind::Dose).count()) as u32;
    Unjudged {
        why: format!("{why}; what a simulated spoon would let fall takes {doses} simulated doses"),
        doses,
    }
}

/// Most probable scatter of log mass under plain noise.
pub(super) fn scatter(seen: &[f64], noises: &[ShakeNoise]) -> f64 {
    let seen = DMatrix::from_column_slice(seen.len(), 1, seen);
    let of = |it: &ShakeNoise| {
        let squares = it.noise.model.apply(&seen).norm_squared();
        (it.noise.model.log_null(squares), (squares / it.noise.model.freedom).sqrt())
    };
    let all: Vec<(f64, f64)> = noises.iter().filter(|it| !it.noise.is_wander).map(of).collect();
    let best = all.iter().map(|it| it.0).fold(f64::NEG_INFINITY, f64::max);
    let weight = |log: f64| libm::exp(log - best);
    all.iter().map(|&(log, sd)| weight(log) * sd).sum::<f64>()
        / all.iter().map(|it| weight(it.0)).sum::<f64>()
}

/// Columns of the response in log mass, `[shakes, p]`, each covariate with mean 0 and SD 1.
fn columns(design: &Design) -> DMatrix<f64> {
    let (powders, _) = design.counts();
    let standard = |of: &dyn Fn(usize) -> Option<f64>| -> Option<Vec<f64>> {
        let values: Vec<Option<f64>> = design.shakes.iter().map(|shake| of(shake.after)).collect();
        let known: Vec<f64> = values.iter().flatten().copied().collect();
        let mean = flip_core::stats::summary::mean(&known)?;
        let sd = flip_core::stats::summary::sd(&known).filter(|&sd| sd > 1e-9 * mean.abs())?;
        Some(values.iter().map(|value| value.map_or(0.0, |value| (value - mean) / sd)).collect())
    };
    let plateau = |k: usize| &design.plateaus[k];
    let amplitude = standard(&|k| plateau(k).shake_mm.filter(|&mm| mm > 0.0).map(f64::ln));
    let pitch = standard(&|k| plateau(k).pitch_deg);
    let powder: Vec<usize> =
        design.shakes.iter().map(|shake| design.logs[shake.log].powder).collect();
    let mut columns: Vec<DVector<f64>> = Vec::new();
    for p in 0..powders {
        let of_powder = |values: &dyn Fn(usize) -> f64| {
            DVector::from_fn(powder.len(), |i, _| if powder[i] == p { values(i) } else { 0.0 })
        };
        columns.push(of_powder(&|_| 1.0));
        columns.extend(amplitude.as_ref().map(|values| of_powder(&|i| values[i])));
        columns.extend(pitch.as_ref().map(|values| of_powder(&|i| values[i])));
    }
    columns
        .extend(pitch.map(|values| DVector::from_fn(powder.len(), |i, _| values[i] * values[i])));
    if !design.knows(|plateau| plateau.pitch_deg) {
        columns.push(DVector::from_fn(powder.len(), |i, _| design.shakes[i].number));
    }
    columns.retain(|column| column.norm() > 0.0);
    if columns.is_empty() {
        DMatrix::zeros(powder.len(), 0)
    } else {
        DMatrix::from_columns(&columns)
    }
}
