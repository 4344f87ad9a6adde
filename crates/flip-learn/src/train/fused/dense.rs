//! Fully connected layers, and perceptrons of them.

use super::lanes::Path;
use super::product::{ColumnSums, Finish, Into, Narrow, Panels, Product, View};

/// The path to compute on, and room that every product needs.
#[derive(Debug)]
pub(super) struct Kit {
    pub path: Path,
    pub panels: Panels,
    turned: Vec<f32>,
}

impl Kit {
    pub(super) fn new(path: Path) -> Self {
        Self { path, panels: Panels::default(), turned: Vec::new() }
    }

    /// Computes `left * right`; the sums start from `starts`.
    pub(super) fn multiply(
        &mut self,
        left: View,
        right: View,
        starts: &[&[f32]],
        finish: Finish,
        into: Into,
    ) {
        self.panels.pack(self.path, right, starts);
        Product { left, right: &self.panels, into, finish }.compute(self.path);
    }
}

/// Layers with fewer outputs are computed element by element.
const NARROW: usize = 8;

/// A layer `y = x W + b` within a flat block: weight `[inputs, outputs]` by rows, then bias.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Dense {
    pub inputs: usize,
    pub outputs: usize,
    /// Where its weight begins.
    pub at: usize,
}

impl Dense {
    /// Where its bias ends.
    pub(super) fn end(&self) -> usize {
        self.at + (self.inputs + 1) * self.outputs
    }

    pub(super) fn weight<'a>(&self, flat: &'a [f32]) -> View<'a> {
        View::new(&flat[self.at..], self.inputs, self.outputs)
    }

    fn bias<'a>(&self, flat: &'a [f32]) -> &'a [f32] {
        &flat[self.end() - self.outputs..self.end()]
    }

    /// Outputs for `x` `[rows, inputs]`: `[rows, outputs]`.
    pub(super) fn forward(&self, kit: &mut Kit, flat: &[f32], x: View, relu: bool, into: Into) {
        let (weight, bias) = (self.weight(flat), self.bias(flat));
        if self.outputs < NARROW && !relu {
            kit.turned.clear();
            for j in 0..self.outputs {
                kit.turned.extend((0..self.inputs).map(|i| weight.data[i * self.outputs + j]));
            }
            let right = View::new(&kit.turned, self.outputs, self.inputs);
            kit.path.run(Narrow { left: x, right, starts: Some(bias), into });
        } else {
            let finish = if relu { Finish::Relu } else { Finish::Plain };
            kit.multiply(x, weight, &[bias], finish, into);
        }
    }

    /// Gradient of the loss for its parameters, from that for its outputs, `[rows, outputs]`.
    pub(super) fn gradient(&self, kit: &mut Kit, x: View, dy: View, into: &mut [f32]) {
        let (weight, bias) = into[self.at..self.end()].split_at_mut(self.inputs * self.outputs);
        kit.path.run(ColumnSums { of: dy, into: bias });
        if self.outputs < NARROW {
            // By columns, since a panel would consist of zeros mostly.
            let mut turned = std::mem::take(&mut kit.turned);
            turned.resize(self.inputs * self.outputs, 0.0);
            let columns = Into { data: &mut turned, down: self.inputs };
            kit.multiply(dy.turned(), x, &[], Finish::Plain, columns);
            for (i, row) in weight.chunks_exact_mut(self.outputs).enumerate() {
                for (j, w) in row.iter_mut().enumerate() {
                    *w = turned[j * self.inputs + i];
                }
            }
            kit.turned = turned;
        } else {
            let into = Into { data: weight, down: self.outputs };
            kit.multiply(x.turned(), dy, &[], Finish::Plain, into);
        }
    }

    /// Gradient for some of its inputs, `[rows, count]`.
    pub(super) fn back(
        &self,
        kit: &mut Kit,
        flat: &[f32],
        dy: View,
        (from, count): (usize, usize),
        finish: Finish,
        into: Into,
    ) {
        let weight = self.weight(flat).some_rows(from, count);
        if count < NARROW && matches!(finish, Finish::Plain) {
            kit.path.run(Narrow { left: dy, right: weight, starts: None, into });
        } else {
            kit.multiply(dy, weight.turned(), &[], finish, into);
        }
    }
}

/// Layers one after another, with ReLU between them.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Perceptron {
    pub layers: Vec<Dense>,
}

/// What a perceptron's forward pass leaves for its backward pass.
#[derive(Debug, Default)]
pub(super) struct Passed {
    /// Outputs of each layer, `[rows, outputs]`.
    pub outputs: Vec<Vec<f32>>,
    /// Gradient for the layer that is being passed, and for the next.
    back: [Vec<f32>; 2],
}

impl Passed {
    /// Outputs of the last layer.
    pub(super) fn last(&self) -> &[f32] {
        self.outputs.last().map_or(&[], Vec::as_slice)
    }

    /// Gradient for the first layer's outputs, after a backward pass.
    pub(super) fn first_gradient(&self) -> &[f32] {
        &self.back[0]
    }
}

impl Perceptron {
    /// Layers of these widths, the first at `at`.
    pub(super) fn new(widths: &[usize], mut at: usize) -> Self {
        let mut layers = Vec::new();
        for w in widths.windows(2) {
            let layer = Dense { inputs: w[0], outputs: w[1], at };
            at = layer.end();
            layers.push(layer);
        }
        Self { layers }
    }

    /// Number of the parameter after its last.
    pub(super) fn end(&self) -> usize {
        self.layers.last().map_or(0, Dense::end)
    }

    /// Outputs for `x` `[rows, inputs]`, left in `passed`.
    pub(super) fn forward(&self, kit: &mut Kit, flat: &[f32], x: View, passed: &mut Passed) {
        passed.outputs.resize_with(self.layers.len(), Vec::new);
        for (depth, layer) in self.layers.iter().enumerate() {
            let (before, rest) = passed.outputs.split_at_mut(depth);
            let y = &mut rest[0];
            y.resize(x.rows * layer.outputs, 0.0);
            let x = before.last().map_or(x, |x_here| View::new(x_here, x.rows, layer.inputs));
            let relu = depth + 1 < self.layers.len();
            layer.forward(kit, flat, x, relu, Into { data: y, down: layer.outputs });
        }
    }

    /// Goes back from the gradient for the outputs `[rows, outputs]` to that for the outputs of the
    /// first layer, before its ReLU ([`Passed::first_gradient`]). Writes the gradient for the
    /// parameters if asked for.
    pub(super) fn backward(
        &self,
        kit: &mut Kit,
        flat: &[f32],
        x: View,
        passed: &mut Passed,
        outputs: &[f32],
        mut gradient: Option<&mut [f32]>,
    ) {
        let [now, next] = &mut passed.back;
        now.clear();
        now.extend(outputs);
        for (depth, layer) in self.layers.iter().enumerate().rev() {
            let dy = View::new(now, x.rows, layer.outputs);
            let before =
                depth.checked_sub(1).map(|d| View::new(&passed.outputs[d], x.rows, layer.inputs));
            if let Some(gradient) = gradient.as_deref_mut() {
                layer.gradient(kit, before.unwrap_or(x), dy, gradient);
            }
            if let Some(mask) = before {
                next.resize(x.rows * layer.inputs, 0.0);
                let into = Into { data: next, down: layer.inputs };
                layer.back(kit, flat, dy, (0, layer.inputs), Finish::Where(mask), into);
                std::mem::swap(now, next);
            }
        }
    }
}
