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
        let onsets: Vec<f64> = pairs().map(|(of, fell)| of.onset_deg(fell)).collect();
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
            let from = of.onset(fell).unwrap_or(fell.len());
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

#[cfg(test)]
mod tests {
    use super::*;

    fn spoonful(steps: &[(f64, f64)]) -> Spoonful {
        let shake = |&(pitch_deg, shake_mm): &(f64, f64)| Shake {
            pitch_deg,
            shake_mm,
            strokes: 1,
            acceleration_m_s2: None,
            spoon_mg: None,
            fell_mg: 0.0,
            sd_mg: 0.4,
            since_filled_s: None,
        };
        Spoonful {
            weighing: "w".to_owned(),
            spoonful: 1,
            powder: "salt".to_owned(),
            lot: None,
            session: None,
            readability_mg: None,
            shakes: steps.iter().map(shake).collect(),
        }
    }

    #[test]
    fn flow_begins_beyond_the_noise_of_the_balance_or_beyond_the_last_pitch() {
        let tipped = spoonful(&[(10.0, 4.0), (20.0, 4.0), (30.0, 4.0), (40.0, 4.0)]);
        // Three SD are 1.2 mg: what a display of 1 mg shows by chance is no powder.
        assert_eq!(tipped.onset_deg(&[1.0, -1.0, 1.5, 4.0]), 30.0);
        assert_eq!(tipped.onset_deg(&[0.7, 0.7, 0.0, 0.0]), 20.0);
        assert_eq!(tipped.onset_deg(&[0.0, 0.5, 0.0, 0.0]), 45.0);
    }

    #[test]
    fn cells_are_those_of_the_steps_made_and_hold_their_means() {
        let steps = [(12.0, 2.0), (14.0, 2.0), (16.0, 2.0), (18.0, 9.0), (33.0, 9.0), (34.0, 9.0)];
        let mut steps = steps.to_vec();
        steps.extend([(36.0, 9.0), (44.0, 2.0), (45.0, 2.0)]);
        let one = spoonful(&steps);
        let frame = Frame::of(vec![&one]);
        let fell: &[f64] = &[0.0, 1.0, 2.0, 50.0, 4.0, 5.0, 6.0, 0.0, 0.0];
        // One long stroke below 20 deg and two beyond 40 are no cells.
        assert_eq!(frame.cells.iter().map(|cell| cell.steps).collect::<Vec<_>>(), [3, 3]);
        assert_eq!([frame.cell_mg(0, &[fell]), frame.cell_mg(1, &[fell])], [1.0, 5.0]);
        let all = frame.summed(&[fell]);
        assert_eq!((all.len(), frame.floors().len()), (frame.len(), frame.len()));
        assert!((all[1] - 69f64.ln()).abs() < 1e-12 && (all[2] - 53.0 / 69.0).abs() < 1e-12);
        assert!((all[4] - 1.3f64.ln()).abs() < 1e-12 && (all[5] - 5.3f64.ln()).abs() < 1e-12);
    }
}
