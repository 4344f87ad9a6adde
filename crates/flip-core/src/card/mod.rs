//! The card of a powder: how it leaves a spoon, from all shakes that are known of it.
//!
//! | number | meaning | interval |
//! |---|---|---|
//! | onset | pitch at which the first 0.5 mg of a spoonful, or three SD of the balance, had fallen; 5 deg beyond the last pitch if never | bootstrap over spoonfuls |
//! | curves | mg of one stroke over the pitch, in cells of 4 deg, by the stroke's share of the largest one made | Student's t of the mean of the cell, with the spread pooled over the curve |
//! | slope | increase of ln(mg + 0.3 mg) with the pitch from the onset on, within strokes of one class, until half of the filling has fallen | bootstrap over spoonfuls |
//! | scatter | SD of ln(mg + 0.3 mg) from the onset on, within cells | none |
//! | left | mass that stays in the spoon after 8 full strokes or more at the steepest pitch | bootstrap over spoonfuls |
//!
//! All intervals hold 90 %. The onset is that of the spoon channel of an investigation
//! (`flip_discover`, spoon). Curves, slope and scatter are of readings after a single stroke, and
//! leave out those of a spoon that has released 85 % of its filling, where that is known: they say
//! nothing of the powder. The stroke that spends it counts, as the least that would have fallen.

pub mod cells;

use crate::domain::powder_card::{CardCell, CardCurve, Estimate, Left, PowderCard, StrokeClass};
use crate::domain::shake::{Shake, Spoonful};
use crate::stats::summary::{bootstrap_interval, mean, sd, sd_within_cells};
use std::collections::BTreeMap;

/// Fewest spoonfuls of a card.
pub const CARD_SPOONFULS_MIN: usize = 2;
/// Mass that a stroke can hardly be told from nothing by, mg.
const STEP_MG: f64 = 0.3;
/// Width of a cell, deg: the step of a probing run.
const CELL_DEG: f64 = 4.0;
/// Share of its filling below which a spoon is spent.
const SPENT: f64 = 0.15;
/// The same for the slope: by then what is left changes what a stroke gives, more than the pitch.
const HALF: f64 = 0.5;
/// A pitch this close to the steepest is the steepest, deg.
const STEEPEST_DEG: f64 = 0.5;
/// Full strokes there after which what is left stays.
const LAST_STROKES: u32 = 8;
/// Confidence of the intervals, bootstrap resamples, and their seed.
const LEVEL: f64 = 0.9;
const RESAMPLES: usize = 1000;
const SEED: u64 = 35;

/// A reading after strokes.
#[derive(Debug, Clone, Copy)]
struct Stroke {
    class: Option<StrokeClass>,
    pitch_deg: f64,
    shake_mm: f64,
    mass_mg: f64,
    sd_mg: f64,
    /// At or after the onset.
    flows: bool,
    /// Half of the filling or more is in the spoon, or nobody knows.
    is_full: bool,
}

/// The card of these spoonfuls of one powder.
pub fn card_of(spoonfuls: &[Spoonful]) -> PowderCard {
    let is_stroke = |shake: &&Shake| shake.shake_mm > 0.0;
    let all = || spoonfuls.iter().flat_map(|it| &it.shakes);
    let (n, shakes) = (spoonfuls.len(), all().filter(is_stroke).count());
    let counted = PowderCard { spoonfuls: n, shakes, ..PowderCard::default() };
    if n < CARD_SPOONFULS_MIN {
        let missing = format!("{n} of at least {CARD_SPOONFULS_MIN} spoonfuls: probe the powder");
        return PowderCard { missing: Some(missing), ..counted };
    }
    let longest_mm = all().map(|shake| shake.shake_mm).fold(0.0, f64::max);
    let strokes: Vec<Vec<Stroke>> = spoonfuls.iter().map(|it| strokes(it, longest_mm)).collect();
    let onsets: Vec<f64> = spoonfuls.iter().map(|it| it.onset_deg(&it.fallen())).collect();
    let flat: Vec<Stroke> = strokes.iter().flatten().copied().collect();
    PowderCard {
        onset_deg: estimate(&onsets, mean),
        never_flowed: spoonfuls.iter().filter(|it| it.onset(&it.fallen()).is_none()).count(),
        slope_per_deg: estimate(&strokes, |strokes| slope(&strokes.concat())),
        scatter: scatter(&flat),
        left: left(spoonfuls, longest_mm),
        curves: curves(&flat),
        ..counted
    }
}

fn class(shake_mm: f64, longest_mm: f64) -> Option<StrokeClass> {
    match shake_mm / longest_mm {
        share if share > 0.5f64.sqrt() => Some(StrokeClass::Full),
        share if share > 0.125f64.sqrt() => Some(StrokeClass::Half),
        share if share > 0.03125f64.sqrt() => Some(StrokeClass::Quarter),
        _ => None,
    }
}

/// The strokes of a spoonful until it is spent.
fn strokes(of: &Spoonful, longest_mm: f64) -> Vec<Stroke> {
    let onset = of.onset(&of.fallen()).unwrap_or(usize::MAX);
    let filled_mg = of.shakes.first().and_then(|shake| shake.spoon_mg);
    let is_below = |shake: &Shake, share: f64| {
        shake.spoon_mg.zip(filled_mg).is_some_and(|(left_mg, mg)| left_mg < share * mg)
    };
    let stroke = |(k, shake): (usize, &Shake)| Stroke {
        class: class(shake.shake_mm, longest_mm),
        pitch_deg: shake.pitch_deg,
        shake_mm: shake.shake_mm,
        mass_mg: shake.fell_mg,
        sd_mg: shake.sd_mg,
        flows: k >= onset,
        is_full: !is_below(shake, HALF),
    };
    let live = of.shakes.iter().enumerate().take_while(|(_, shake)| !is_below(shake, SPENT));
    live.filter(|(_, shake)| shake.shake_mm > 0.0 && shake.strokes == 1).map(stroke).collect()
}

fn ln_mg(stroke: &Stroke) -> f64 {
    (stroke.mass_mg.max(0.0) + STEP_MG).ln()
}

/// Strokes of a class by cell of the pitch.
fn cells(strokes: &[Stroke]) -> BTreeMap<(StrokeClass, i64), Vec<Stroke>> {
    let mut cells: BTreeMap<_, Vec<Stroke>> = BTreeMap::new();
    for stroke in strokes {
        let Some(class) = stroke.class else { continue };
        let cell = (stroke.pitch_deg / CELL_DEG).floor() as i64;
        cells.entry((class, cell)).or_default().push(*stroke);
    }
    cells
}

/// Slope of ln mass over pitch of what flows, about the means of each class.
///
/// ```text
/// b = sum (x - mean x of its class) (y - mean y of its class) / sum (x - mean x of its class)^2
/// ```
fn slope(strokes: &[Stroke]) -> Option<f64> {
    let (mut products, mut squares) = (0.0, 0.0);
    for class in [StrokeClass::Full, StrokeClass::Half, StrokeClass::Quarter] {
        let own = || strokes.iter().filter(|it| it.flows && it.is_full && it.class == Some(class));
        let (x, y): (Vec<f64>, Vec<f64>) = own().map(|it| (it.pitch_deg, ln_mg(it))).unzip();
        let (Some(mean_x), Some(mean_y)) = (mean(&x), mean(&y)) else { continue };
        products += x.iter().zip(&y).map(|(x, y)| (x - mean_x) * (y - mean_y)).sum::<f64>();
        squares += x.iter().map(|x| (x - mean_x).powi(2)).sum::<f64>();
    }
    (squares > 1e-9).then(|| products / squares)
}

fn scatter(strokes: &[Stroke]) -> Option<f64> {
    let flowing: Vec<Stroke> = strokes.iter().filter(|it| it.flows).copied().collect();
    let logs: Vec<Vec<f64>> =
        cells(&flowing).values().map(|own| own.iter().map(ln_mg).collect()).collect();
    sd_within_cells(logs.iter().map(Vec::as_slice))
}

fn curves(strokes: &[Stroke]) -> Vec<CardCurve> {
    let cells = cells(strokes);
    let curve = |class: StrokeClass| {
        let own = || cells.iter().filter(|((of, _), _)| *of == class).map(|(_, own)| own);
        let lengths: Vec<f64> = own().flatten().map(|it| it.shake_mm).collect();
        let shake_mm = mean(&lengths)?;
        let spread = pooled(&own().map(Vec::as_slice).collect::<Vec<_>>());
        let cells = own().map(|own| cell(own, spread)).collect();
        Some(CardCurve { stroke: class, shake_mm, cells })
    };
    [StrokeClass::Full, StrokeClass::Half, StrokeClass::Quarter]
        .into_iter()
        .filter_map(curve)
        .collect()
}

/// SD of a stroke about the mean of its cell, mg, and its degrees of freedom; never less than the
/// balance's.
fn pooled(cells: &[&[Stroke]]) -> Option<(f64, usize)> {
    let masses: Vec<Vec<f64>> =
        cells.iter().map(|own| own.iter().map(|it| it.mass_mg).collect()).collect();
    let sd_mg = sd_within_cells(masses.iter().map(Vec::as_slice))?;
    let balance: Vec<f64> = cells.iter().flat_map(|own| own.iter()).map(|it| it.sd_mg).collect();
    let freedom = masses.iter().map(|own| own.len() - 1).sum();
    Some((sd_mg.max(mean(&balance).unwrap_or(0.0)), freedom))
}

/// The mean of a cell, with the spread of its curve.
fn cell(own: &[Stroke], spread: Option<(f64, usize)>) -> CardCell {
    let of = |value: fn(&Stroke) -> f64| own.iter().map(value).collect::<Vec<f64>>();
    let (masses, n) = (of(|it| it.mass_mg), own.len());
    let mean_mg = mean(&masses).unwrap_or(0.0);
    let band_mg = spread.map(|(sd_mg, freedom)| {
        let half_mg = student_95(freedom) * sd_mg / (n as f64).sqrt();
        [mean_mg - half_mg, mean_mg + half_mg]
    });
    let pitch_deg = mean(&of(|it| it.pitch_deg)).unwrap_or(0.0);
    CardCell { pitch_deg, n, mean_mg, sd_mg: sd(&masses), band_mg }
}

fn left(spoonfuls: &[Spoonful], longest_mm: f64) -> Option<Left> {
    let pitches = spoonfuls.iter().flat_map(|it| &it.shakes).map(|shake| shake.pitch_deg);
    let steepest_deg = pitches.fold(f64::MIN, f64::max);
    let is_last = |shake: &&Shake| {
        shake.pitch_deg >= steepest_deg - STEEPEST_DEG
            && class(shake.shake_mm, longest_mm) == Some(StrokeClass::Full)
    };
    let stays = |of: &Spoonful| {
        let strokes: u32 = of.shakes.iter().rev().take_while(is_last).map(|it| it.strokes).sum();
        let (first, last) = (of.shakes.first()?, of.shakes.last()?);
        let (filled_mg, left_mg) = (first.spoon_mg?, last.spoon_mg? - last.fell_mg);
        (strokes >= LAST_STROKES && filled_mg > 0.0).then_some([left_mg, left_mg / filled_mg])
    };
    let found: Vec<[f64; 2]> = spoonfuls.iter().filter_map(stays).collect();
    let of = |k: usize| estimate(&found.iter().map(|it| it[k]).collect::<Vec<_>>(), mean);
    Some(Left { spoonfuls: found.len(), mass_mg: of(0)?, share: of(1)? })
}

/// A statistic with its bootstrap interval.
fn estimate<T: Clone>(all: &[T], statistic: impl Fn(&[T]) -> Option<f64>) -> Option<Estimate> {
    let mean = statistic(all)?;
    let [low, high] = bootstrap_interval(all, statistic, LEVEL, RESAMPLES, SEED)?;
    Some(Estimate { mean, low, high })
}

/// 95 % point of Student's t.
///
/// From three degrees of freedom by the expansion about the normal one, to 0.3 % of it. Source:
/// Abramowitz, Stegun, Handbook of Mathematical Functions (1964), 26.7.5 and table 26.10.
fn student_95(freedom: usize) -> f64 {
    const Z: f64 = 1.644_854;
    let n = freedom as f64;
    match freedom {
        0 => f64::INFINITY,
        1 => 6.314,
        2 => 2.920,
        _ => {
            let [z3, z5, z7] = [3, 5, 7].map(|power| Z.powi(power));
            Z + (z3 + Z) / (4.0 * n)
                + (5.0 * z5 + 16.0 * z3 + 3.0 * Z) / (96.0 * n.powi(2))
                + (3.0 * z7 + 19.0 * z5 + 17.0 * z3 - 15.0 * Z) / (384.0 * n.powi(3))
        }
    }
}

#[cfg(test)]
mod tests;
