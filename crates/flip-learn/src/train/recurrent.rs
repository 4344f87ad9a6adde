//! The prior work's recurrent network on flat blocks: the same as in [`flip_policy`], with
//! gradients.
//!
//! Actor and critics have the same two branches, one for the present and one with memory, and
//! differ in their inputs and in the layers after the branches merge:
//!
//! | network | first branch sees                   | second branch sees       | widths after the branches |
//! |---------|-------------------------------------|--------------------------|---------------------------|
//! | actor   | observation                         | observation, last action | `2 h, h, h, 4`            |
//! | critic  | observation, nine parameters, action | observation, last action | `2 h, h, 1`               |
//!
//! Source: the public code of Kadokawa et al., IROS 2023
//! (github.com/omron-sinicx/robotic-powder-weighing), `SAC/`.

use super::networks::{blocks, bounds, perceptrons};
use super::replay::Courses;
use tch::Tensor;

/// Sizes of one network.
#[derive(Debug, Clone, PartialEq)]
pub struct Sizes {
    /// Inputs of the first branch.
    pub seen: usize,
    /// Inputs of the second branch.
    pub recalled: usize,
    /// Units of each branch.
    pub hidden: usize,
    /// Widths from where the branches merge to the outputs.
    pub trunk: Vec<usize>,
}

impl Sizes {
    /// Lengths of the blocks: both branches, the LSTM's four, the trunk.
    fn blocks(&self) -> Vec<i64> {
        let (h, gates) = (self.hidden as i64, 4 * self.hidden as i64);
        let branches = [self.seen as i64 * h, h, self.recalled as i64 * h, h];
        [&branches[..], &[gates * h, gates * h, gates, gates], &blocks(&self.trunk)].concat()
    }

    /// Counts of parameters with the bounds within which they are initially drawn.
    pub fn bounds(&self, last_bound: f32) -> Vec<(usize, f32)> {
        let h = self.hidden;
        let lstm = (2 * (h + 1) * 4 * h, 1.0 / (h as f32).sqrt());
        let branch = |inputs: usize| ((inputs + 1) * h, 1.0 / (inputs as f32).sqrt());
        let mut all = vec![branch(self.seen), branch(self.recalled), lstm];
        all.extend(bounds(&self.trunk, last_bound));
        all
    }
}

/// The episodes leading to a batch, and the steps to evaluate.
#[derive(Debug)]
pub struct Course {
    /// Inputs of the second branch: `[steps, episodes, recalled]`.
    inputs: Tensor,
    /// State before the first of these steps, hidden and cell, `[1, episodes, hidden]`; zero if
    /// absent.
    start: Option<[Tensor; 2]>,
    /// Index of each row within `steps * episodes`: `[rows]`.
    at: Tensor,
}

impl Course {
    /// Returns the courses that lead to a batch's rows, and those that lead to the following
    /// observations.
    ///
    /// The first start at the beginnings of the episodes with a zero state. So do the second, which
    /// go one step further; if states were stored, they start from these after the first step
    /// instead.
    pub fn pair(courses: &Courses, sizes: &Sizes) -> [Self; 2] {
        let (episodes, hidden) = (courses.episodes as i64, sizes.hidden as i64);
        let all = Tensor::from_slice(&courses.inputs).view([-1, episodes, sizes.recalled as i64]);
        let at = Tensor::from_slice(&courses.at);
        let steps = all.size()[0] - 1;
        let next = match &courses.stored {
            None => Self { inputs: all.shallow_clone(), start: None, at: &at + episodes },
            Some(states) => {
                let states = Tensor::from_slice(states).view([1, episodes, 2 * hidden]);
                let part = |k: i64| states.narrow(2, k * hidden, hidden).contiguous();
                Self {
                    inputs: all.narrow(0, 1, steps),
                    start: Some([part(0), part(1)]),
                    at: at.shallow_clone(),
                }
            }
        };
        [Self { inputs: all.narrow(0, 0, steps), start: None, at }, next]
    }

    /// Converts to another precision.
    #[cfg(test)]
    pub(super) fn to_kind(&self, kind: tch::Kind) -> Self {
        let start =
            self.start.as_ref().map(|start| start.each_ref().map(|part| part.to_kind(kind)));
        Self { inputs: self.inputs.to_kind(kind), start, at: self.at.shallow_clone() }
    }
}

/// Evaluates `n` networks at once: `flat` `[n, parameters]`, `rows` `[rows, seen]` ->
/// `[n, rows, outputs]`.
pub fn forward(flat: &Tensor, sizes: &Sizes, rows: &Tensor, course: &Course) -> Tensor {
    let parts = flat.split_with_sizes(sizes.blocks(), 1);
    let n = flat.size()[0];
    let branch = |k: usize, inputs: usize, x: &Tensor| {
        let x = x.unsqueeze(0).expand([n, -1, -1], false);
        perceptrons(&parts[k..k + 2], &[inputs, sizes.hidden], x).relu_()
    };
    let seen = branch(0, sizes.seen, rows);
    let recalled = branch(2, sizes.recalled, &course.inputs.view([-1, sizes.recalled as i64]));
    let remembered: Vec<Tensor> = (0..n)
        .map(|k| remember(&recalled.get(k), &parts[4..8], k, sizes.hidden as i64, course))
        .collect();
    perceptrons(&parts[8..], &sizes.trunk, Tensor::cat(&[seen, Tensor::stack(&remembered, 0)], 2))
}

/// Runs the `k`-th network's LSTM along the courses: its inputs `[steps * episodes, hidden]` -> its
/// outputs at the rows, `[rows, hidden]`.
///
/// Uses libtorch's own LSTM with its gates i, f, g, o: with gradients it takes half the time of the
/// same computation written as batched products over both critics.
fn remember(x: &Tensor, lstm: &[Tensor], k: i64, hidden: i64, course: &Course) -> Tensor {
    let [w, u] = [0, 1].map(|part: usize| lstm[part].get(k).view([4 * hidden, hidden]));
    let [b, d] = [2, 3].map(|part: usize| lstm[part].get(k));
    let steps_episodes = &course.inputs.size()[..2];
    let x = x.view([steps_episodes[0], steps_episodes[1], hidden]);
    let start = course
        .start
        .as_ref()
        .map(|start| start.each_ref().map(Tensor::shallow_clone))
        .unwrap_or_else(|| {
            let zeros = || Tensor::zeros([1, steps_episodes[1], hidden], (x.kind(), x.device()));
            [zeros(), zeros()]
        });
    let (y, _, _) = x.lstm(&start, &[w, u, b, d], true, 1, 0.0, true, false, false);
    y.view([-1, hidden]).index_select(0, &course.at)
}

#[cfg(test)]
#[path = "recurrent_tests.rs"]
mod tests;
