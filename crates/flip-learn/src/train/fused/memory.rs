//! An LSTM along episodes, forward and back through time.
//!
//! ```text
//! (i, f, g, o) = x W' + h' U' + b + d        x, h': the layer's input, and its output before
//! c = sigmoid(f) c' + sigmoid(i) tanh(g),    h = sigmoid(o) tanh(c)
//! ```
//!
//! What belongs to one step lies together, one row for each episode.
#![allow(clippy::inline_always)] // See `lanes`.

use super::curves::{sigmoid, tanh};
use super::dense::Kit;
use super::lanes::{Lanes, Task, put, take, vectors};
use super::product::{ColumnSums, Finish, Into, Product, View};

/// The layer within a flat block, with libtorch's order: `W` and `U` `[4 hidden, hidden]` by rows,
/// the biases `b` and `d`; gates i, f, g, o.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Lstm {
    pub hidden: usize,
    /// Where its parameters begin.
    pub at: usize,
}

/// What the layer computed, and room for its gradients.
#[derive(Debug, Default)]
pub(super) struct Memory {
    /// Gates after their curves, `[steps, episodes, 4 hidden]`; before a run what they get from the
    /// inputs, after a backward pass the gradient for their sums.
    pub gates: Vec<f32>,
    /// `c`, `[steps, episodes, hidden]`.
    cells: Vec<f32>,
    /// tanh(c).
    curved: Vec<f32>,
    /// `h`.
    pub hidden: Vec<f32>,
    /// Gradient for `h`: for each step as an output, to which a backward pass adds its part in the
    /// next step.
    pub back: Vec<f32>,
    /// Gradient for `c` of the step that is being passed.
    back_cells: Vec<f32>,
}

impl Lstm {
    fn parts(&self) -> [(usize, usize); 4] {
        let (h, gates) = (self.hidden, 4 * self.hidden);
        let [w, u, b] = [self.at, self.at + gates * h, self.at + 2 * gates * h];
        [(w, u), (u, b), (b, b + gates), (b + gates, b + 2 * gates)]
    }

    /// Where its parameters end.
    pub(super) fn end(&self) -> usize {
        self.parts()[3].1
    }

    fn matrix<'a>(&self, flat: &'a [f32], part: usize) -> View<'a> {
        let (from, to) = self.parts()[part];
        View::new(&flat[from..to], 4 * self.hidden, self.hidden)
    }

    /// Adds up what the gates get from the inputs `x` `[steps * episodes, hidden]`.
    pub(super) fn see(&self, kit: &mut Kit, flat: &[f32], x: View, memory: &mut Memory) {
        let gates = 4 * self.hidden;
        memory.gates.resize(x.rows * gates, 0.0);
        let [.., b, d] = self.parts().map(|(from, to)| &flat[from..to]);
        let into = Into { data: &mut memory.gates, down: gates };
        kit.multiply(x, self.matrix(flat, 0).turned(), &[b, d], Finish::Plain, into);
    }

    /// Runs along the episodes after [`Lstm::see`], from a state `[episodes, 2 hidden]` of `h` and
    /// `c`, or from zero.
    pub(super) fn run(
        &self,
        kit: &mut Kit,
        flat: &[f32],
        episodes: usize,
        start: Option<View>,
        memory: &mut Memory,
    ) {
        let (h, step) = (self.hidden, episodes * self.hidden);
        let Memory { gates, cells, curved, hidden, .. } = memory;
        for block in [&mut *cells, &mut *curved, &mut *hidden] {
            block.resize(gates.len() / 4, 0.0);
        }
        kit.panels.pack(kit.path, self.matrix(flat, 1).turned(), &[]);
        for (t, gates) in gates.chunks_exact_mut((4 * step).max(1)).enumerate() {
            let (hidden_before, hidden) = hidden.split_at_mut(t * step);
            let (cells_before, cells) = cells.split_at_mut(t * step);
            let before = |past: &'_ [f32]| past.len().checked_sub(step);
            let last = before(hidden_before).zip(before(cells_before));
            let [h_before, c_before] = match last {
                Some((from, _)) => [&*hidden_before, &*cells_before]
                    .map(|past| Some(View::new(&past[from..], episodes, h))),
                None => [0, h].map(|from| start.map(|state| state.some_columns(from, h))),
            };
            if let Some(left) = h_before {
                let into = Into { data: gates, down: 4 * h };
                let product = Product { left, right: &kit.panels, into, finish: Finish::Onto };
                product.compute(kit.path);
            }
            kit.path.run(Step {
                hidden: h,
                episodes,
                gates,
                before: c_before,
                cells,
                curved: &mut curved[t * step..],
                out: hidden,
            });
        }
    }

    /// Goes back along the episodes from [`Memory::back`], after a run from zero. Writes the
    /// gradient for the parameters, and that for the inputs `x`, which are outputs of a ReLU, to
    /// `inputs` `[steps * episodes, hidden]`.
    pub(super) fn backward(
        &self,
        kit: &mut Kit,
        flat: &[f32],
        (x, episodes): (View, usize),
        memory: &mut Memory,
        gradient: &mut [f32],
        inputs: &mut Vec<f32>,
    ) {
        let (h, step) = (self.hidden, episodes * self.hidden);
        let length = x.rows * h;
        let Memory { gates, cells, curved, hidden, back, back_cells } = memory;
        back_cells.clear();
        back_cells.resize(step, 0.0);
        kit.panels.pack(kit.path, self.matrix(flat, 1), &[]);
        for at in (0..length).step_by(step.max(1)).rev() {
            let gates = &mut gates[4 * at..4 * (at + step)];
            let (earlier, present) = back.split_at_mut(at);
            let before = at.checked_sub(step);
            kit.path.run(StepBack {
                hidden: h,
                episodes,
                gates,
                before: before.map(|from| View::new(&cells[from..], episodes, h)),
                curved: &curved[at..],
                back: &present[..step],
                back_cells,
            });
            if let Some(from) = before {
                let left = View::new(gates, episodes, 4 * h);
                let into = Into { data: &mut earlier[from..], down: h };
                let product = Product { left, right: &kit.panels, into, finish: Finish::Onto };
                product.compute(kit.path);
            }
        }
        let gates = View::new(gates, x.rows, 4 * h);
        let [w, u, b, d] = self.parts();
        let into = Into { data: &mut gradient[w.0..w.1], down: h };
        kit.multiply(gates.turned(), x, &[], Finish::Plain, into);
        let later = x.rows.saturating_sub(episodes);
        let before = View::new(hidden, later, h);
        let into = Into { data: &mut gradient[u.0..u.1], down: h };
        let left = gates.some_rows(x.rows - later, later).turned();
        kit.multiply(left, before, &[], Finish::Plain, into);
        kit.path.run(ColumnSums { of: gates, into: &mut gradient[b.0..b.1] });
        gradient.copy_within(b.0..b.1, d.0);
        inputs.resize(length, 0.0);
        let into = Into { data: inputs, down: h };
        kit.multiply(gates, self.matrix(flat, 0), &[], Finish::Where(x), into);
    }
}

/// One step of all episodes, from the sums of the gates.
struct Step<'a> {
    hidden: usize,
    episodes: usize,
    gates: &'a mut [f32],
    before: Option<View<'a>>,
    cells: &'a mut [f32],
    curved: &'a mut [f32],
    out: &'a mut [f32],
}

impl Task for Step<'_> {
    #[inline(always)]
    fn with<L: Lanes>(self) {
        let h = self.hidden;
        for e in 0..self.episodes {
            for (at, count) in vectors(h) {
                let (row, place) = (4 * e * h + at, e * h + at);
                let i: L = sigmoid(take(self.gates, row, count));
                let f: L = sigmoid(take(self.gates, row + h, count));
                let g: L = tanh(take(self.gates, row + 2 * h, count));
                let o: L = sigmoid(take(self.gates, row + 3 * h, count));
                let mut cell = i.times(g);
                if let Some(before) = self.before {
                    cell = f.times_plus(take(before.data, e * before.down + at, count), cell);
                }
                let curved = tanh(cell);
                put(i, self.gates, row, count);
                put(f, self.gates, row + h, count);
                put(g, self.gates, row + 2 * h, count);
                put(o, self.gates, row + 3 * h, count);
                put(cell, self.cells, place, count);
                put(curved, self.curved, place, count);
                put(o.times(curved), self.out, place, count);
            }
        }
    }
}

/// One step back: from the gradients for `h` and `c` to those for the sums of the gates, which take
/// the gates' place, and for the `c` before.
struct StepBack<'a> {
    hidden: usize,
    episodes: usize,
    gates: &'a mut [f32],
    before: Option<View<'a>>,
    curved: &'a [f32],
    back: &'a [f32],
    back_cells: &'a mut [f32],
}

impl Task for StepBack<'_> {
    #[inline(always)]
    fn with<L: Lanes>(self) {
        let h = self.hidden;
        let one = L::splat(1.0);
        for e in 0..self.episodes {
            for (at, count) in vectors(h) {
                let (row, place) = (4 * e * h + at, e * h + at);
                let i: L = take(self.gates, row, count);
                let f: L = take(self.gates, row + h, count);
                let g: L = take(self.gates, row + 2 * h, count);
                let o: L = take(self.gates, row + 3 * h, count);
                let curved: L = take(self.curved, place, count);
                let back: L = take(self.back, place, count);
                let through = back.times(o).times(one.minus(curved.times(curved)));
                let cell = through.plus(take(self.back_cells, place, count));
                let to_f = match self.before {
                    Some(before) => cell.times(take(before.data, e * before.down + at, count)),
                    None => L::splat(0.0),
                };
                let slope = |y: L| y.times(one.minus(y));
                put(cell.times(g).times(slope(i)), self.gates, row, count);
                put(to_f.times(slope(f)), self.gates, row + h, count);
                let to_g = cell.times(i).times(one.minus(g.times(g)));
                put(to_g, self.gates, row + 2 * h, count);
                put(back.times(curved).times(slope(o)), self.gates, row + 3 * h, count);
                put(cell.times(f), self.back_cells, place, count);
            }
        }
    }
}
