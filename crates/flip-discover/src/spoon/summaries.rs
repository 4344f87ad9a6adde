//! What spoonfuls say of a powder, in a dozen numbers.
//!
//! | number | meaning | scale |
//! |---|---|---|
//! | onset | pitch at which the first 0.5 mg, or three SD of the balance, had fallen; beyond the last pitch by 5 deg if never | mean, deg |
//! | total | mass of a spoonful at its end | mean ln(m + 1 mg) |
//! | early | share of it that fell in the first half of the steps | ratio of sums |
//! | scatter | SD of ln(m + 0.3 mg) over the steps from the onset on | pooled |
//! | of a cell | mass of a step in a cell of pitch (10 deg) and stroke (none, short, long) | ln(mean m + 0.3 mg) |
//!
//! Masses below the constants beside them are what a display of 1 mg cannot tell after ten steps.
//! The cells are those of the steps that were made, so that they are the same for every replay.

use flip_core::domain::shake::{Shake, Spoonful};
use flip_core::stats::summary::{mean, sd_within_cells};
use serde::{Deserialize, Serialize};

/// Least mass that counts as flowing, mg.
const PIECE_MG: f64 = 0.5;
/// The same in standard uncertainties of the balance.
const PIECE_SD: f64 = 3.0;
/// Onset of a spoonful that never flowed, beyond its last pitch, deg.
const BEYOND_DEG: f64 = 5.0;
/// Mass that a step can hardly be told from nothing by, mg.
const STEP_MG: f64 = 0.3;
/// The same for a spoonful, mg.
const SPOONFUL_MG: f64 = 1.0;
/// Width of a cell, deg.
const CELL_DEG: f64 = 10.0;
/// Fewest steps of a cell.
const CELL_STEPS: usize = 3;
/// What the solver's substep alone moves: a tenth of a mass, half a degree of the onset
/// (`docs/validation.md`); no scatter counts as smaller.
const NUMERICAL: [f64; 2] = [0.5, 0.1];

/// Steps of one range of pitch and stroke.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Cell {
    /// From and to, deg.
    pub pitch_deg: [f64; 2],
    /// Above and up to, mm; both zero where the step only changed the pitch.
    pub stroke_mm: [f64; 2],
    /// Number of steps.
    pub steps: usize,
}

/// The spoonfuls of one powder as a frame in which what fell is summed up.
#[derive(Debug, Clone)]
pub(super) struct Frame<'a> {
    pub spoonfuls: Vec<&'a Spoonful>,
    pub cells: Vec<Cell>,
    /// Cell of each step of each spoonful.
    of: Vec<Vec<Option<usize>>>,
}

/// Numbers before those of the cells.
pub(super) const WHOLE: usize = 4;

impl<'a> Frame<'a> {
    /// The frame of these spoonfuls.
    pub fn of(spoonfuls: Vec<&'a Spoonful>) -> Self {
        let middle = middle_mm(&spoonfuls);
        let of = |shake: &Shake| {
            let low = (shake.pitch_deg / CELL_DEG).floor() * CELL_DEG;
            let (above, to) = stroke(shake.shake_mm, middle);
            Cell { pitch_deg: [low, low + CELL_DEG], stroke_mm: [above, to], steps: 0 }
        };
        let mut cells: Vec<Cell> = Vec::new();
        for shake in spoonfuls.iter().flat_map(|spoonful| &spoonful.shakes) {
            let own = of(shake);
            match cells.iter_mut().find(|cell| is_same(cell, &own)) {
                Some(cell) => cell.steps += 1,
                None => cells.push(Cell { steps: 1, ..own }),
            }
        }
        cells.retain(|cell| cell.steps >= CELL_STEPS);
        cells.sort_by(|a, b| {
            a.pitch_deg[0]
                .total_cmp(&b.pitch_deg[0])
                .then(a.stroke_mm[1].total_cmp(&b.stroke_mm[1]))
        });
        let place = |shake: &Shake| cells.iter().position(|cell| is_same(cell, &of(shake)));
        let of = spoonfuls.iter().map(|it| it.shakes.iter().map(place).collect()).collect();
        Self { spoonfuls, cells, of }
    }

    /// Number of summaries.
    pub fn len(&self) -> usize {
        WHOLE + self.cells.len()
    }

    /// The least scatter of each summary: the simulator's own error.
    pub fn floors(&self) -> Vec<f64> {
        let [onset, rest] = NUMERICAL;
        (0..self.len()).map(|k| if k == 0 { onset } else { rest }).collect()
    }

    /// The summaries of what fell, `[spoonful][step]`, mg.
    pub fn summed(&self, fell: &[&[f64]]) -> Vec<f64> {
        let pairs = || self.spoonfuls.iter().zip(fell);
        let onsets: Vec<f64> = pairs().map(|(of, fell)| onset_deg(of, fell)).collect();
        let totals: Vec<f64> = fell.iter().map(|fell| total(fell)).collect();
        let logs = totals.iter().map(|mg| (mg.max(0.0) + SPOONFUL_MG).ln()).collect::<Vec<_>>();
        let mut all = vec![mean(&onsets).unwrap_or(0.0), mean(&logs).unwrap_or(0.0)];
        let halves: f64 = fell.iter().map(|fell| total(&fell[..fell.len() / 2])).sum();
        all.push(halves / (totals.iter().sum::<f64>() + SPOONFUL_MG * fell.len() as f64).max(1.0));
        all.push(self.scatter(fell));
        all.extend((0..self.cells.len()).map(|c| ln_step(self.cell_mg(c, fell))));
        all
    }

    /// Mean mass of a step of a cell, mg.
    pub fn cell_mg(&self, cell: usize, fell: &[&[f64]]) -> f64 {
        let steps = self.of.iter().zip(fell).flat_map(|(of, fell)| of.iter().zip(*fell));
        let own: Vec<f64> = steps.filter(|(of, _)| **of == Some(cell)).map(|(_, mg)| *mg).collect();
        mean(&own).unwrap_or(0.0)
    }

    /// SD of the logarithm of steps from the onset on, within spoonfuls.
    pub fn scatter(&self, fell: &[&[f64]]) -> f64 {
        let flowing = |(of, fell): (&&Spoonful, &&[f64])| {
            let from = onset(of, fell).unwrap_or(fell.len());
            fell[from..].iter().map(|mg| ln_step(*mg)).collect::<Vec<f64>>()
        };
        let cells: Vec<Vec<f64>> = self.spoonfuls.iter().zip(fell).map(flowing).collect();
        sd_within_cells(cells.iter().map(Vec::as_slice)).unwrap_or(0.0)
    }
}

fn ln_step(mg: f64) -> f64 {
    (mg.max(0.0) + STEP_MG).ln()
}

pub(super) fn total(fell: &[f64]) -> f64 {
    fell.iter().sum()
}

/// First step after which a piece of powder had fallen.
fn onset(of: &Spoonful, fell: &[f64]) -> Option<usize> {
    let mut mass = 0.0;
    of.shakes.iter().zip(fell).position(|(shake, fell)| {
        mass += fell;
        mass >= (PIECE_SD * shake.sd_mg).max(PIECE_MG)
    })
}

/// Pitch at which powder began to fall, deg.
pub(super) fn onset_deg(of: &Spoonful, fell: &[f64]) -> f64 {
    let steepest = of.shakes.iter().map(|shake| shake.pitch_deg).fold(f64::MIN, f64::max);
    onset(of, fell).map_or(steepest + BEYOND_DEG, |k| of.shakes[k].pitch_deg)
}

fn is_same(one: &Cell, other: &Cell) -> bool {
    one.pitch_deg == other.pitch_deg && one.stroke_mm == other.stroke_mm
}

/// The middle of the strokes made, mm.
fn middle_mm(spoonfuls: &[&Spoonful]) -> f64 {
    let shakes = spoonfuls.iter().flat_map(|spoonful| &spoonful.shakes);
    let mut strokes: Vec<f64> = shakes.map(|it| it.shake_mm).filter(|mm| *mm > 0.0).collect();
    strokes.sort_unstable_by(f64::total_cmp);
    strokes.get(strokes.len() / 2).copied().unwrap_or(0.0)
}

/// Above and up to which amplitude strokes like this one were, mm.
fn stroke(mm: f64, middle: f64) -> (f64, f64) {
    match (mm > 0.0, mm <= middle) {
        (false, _) => (0.0, 0.0),
        (true, true) => (0.0, middle),
        (true, false) => (middle, 100.0),
    }
}
