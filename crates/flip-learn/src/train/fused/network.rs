//! Networks of both kinds, forward and back.

use super::dense::{Dense, Kit, Passed, Perceptron};
use super::memory::{Lstm, Memory};
use super::product::{Finish, Into, View};
use crate::train::recurrent::Sizes;

/// An actor's or a critic's network within a flat block.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Network {
    /// A perceptron.
    FeedForward(Perceptron),
    /// Two branches, one with memory, and a trunk after they merge.
    Recurrent(Recurrent),
}

/// The prior work's network, see [`crate::train::recurrent`].
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Recurrent {
    seen: Dense,
    recalled: Dense,
    lstm: Lstm,
    trunk: Perceptron,
}

/// The episodes that a batch's rows belong to, as [`crate::train::replay::Courses`].
#[derive(Debug, Clone, Copy)]
pub(super) struct Episodes<'a> {
    /// Inputs of the branch with memory, `[(steps + 1) * episodes, recalled]`.
    pub inputs: View<'a>,
    /// Number of episodes.
    pub count: usize,
    /// State from which the next observations start after the first step, `[episodes, 2 * hidden]`.
    pub stored: Option<View<'a>>,
    /// Place of each of the batch's rows in `[steps, episodes]`.
    pub at: &'a [i64],
}

/// Which observations of a batch a network sees: those before its steps, or those after.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum When {
    Before,
    After,
}

impl<'a> Episodes<'a> {
    /// The inputs that lead to these observations, the state before them, and by how much their
    /// places differ from [`Episodes::at`].
    fn course(&self, when: When) -> (View<'a>, Option<View<'a>>, usize) {
        let steps = self.inputs.rows - self.count;
        match (when, self.stored) {
            (When::Before, _) => (self.inputs.some_rows(0, steps), None, 0),
            (When::After, None) => (self.inputs, None, self.count),
            (When::After, stored) => (self.inputs.some_rows(self.count, steps), stored, 0),
        }
    }
}

/// What the branch with memory leaves for its backward pass.
#[derive(Debug, Default)]
pub(super) struct Recalled {
    /// Outputs of its first layer, `[steps * episodes, hidden]`.
    layer: Vec<f32>,
    lstm: Memory,
    /// Gradient for the outputs of its first layer.
    back: Vec<f32>,
}

/// What the rest leaves.
#[derive(Debug, Default)]
pub(super) struct Head {
    /// Both branches' outputs, `[rows, 2 * hidden]`; unused by a perceptron.
    merged: Vec<f32>,
    passed: Passed,
    /// Gradient for either branch's outputs, `[rows, hidden]`.
    seen_back: Vec<f32>,
    recalled_back: Vec<f32>,
}

impl Head {
    /// The network's outputs, `[rows, outputs]`.
    pub(super) fn outputs(&self) -> &[f32] {
        self.passed.last()
    }
}

const COURSES: &str = "a recurrent network is given courses";

impl Network {
    pub(super) fn feed_forward(widths: &[usize]) -> Self {
        Self::FeedForward(Perceptron::new(widths, 0))
    }

    pub(super) fn recurrent(sizes: &Sizes) -> Self {
        let h = sizes.hidden;
        let seen = Dense { inputs: sizes.seen, outputs: h, at: 0 };
        let recalled = Dense { inputs: sizes.recalled, outputs: h, at: seen.end() };
        let lstm = Lstm { hidden: h, at: recalled.end() };
        let trunk = Perceptron::new(&sizes.trunk, lstm.end());
        Self::Recurrent(Recurrent { seen, recalled, lstm, trunk })
    }

    /// Number of its parameters.
    pub(super) fn parameters(&self) -> usize {
        match self {
            Self::FeedForward(perceptron) => perceptron.end(),
            Self::Recurrent(net) => net.trunk.end(),
        }
    }

    /// Outputs for `rows` `[rows, inputs]`, left in the head.
    ///
    /// # Panics
    /// If a recurrent network is not given the preceding steps.
    pub(super) fn forward(
        &self,
        kit: &mut Kit,
        flat: &[f32],
        (rows, when): (View, When),
        episodes: Option<Episodes>,
        (recalled, head): (&mut Recalled, &mut Head),
    ) {
        match self {
            Self::FeedForward(net) => net.forward(kit, flat, rows, &mut head.passed),
            Self::Recurrent(net) => {
                let episodes = episodes.expect(COURSES);
                let (inputs, start, later) = episodes.course(when);
                net.recall(kit, flat, inputs, recalled);
                net.lstm.run(kit, flat, episodes.count, start, &mut recalled.lstm);
                net.conclude(kit, flat, rows, (&recalled.lstm.hidden, episodes.at, later), head);
            }
        }
    }

    /// Outputs for the observations before the steps and for those after, of the same network. The
    /// inputs of the branch with memory are the same but for the first step or the last, so they
    /// are passed once; and so is all of the branch if no states were stored.
    ///
    /// # Panics
    /// As [`Network::forward`].
    pub(super) fn forward_both(
        &self,
        kit: &mut Kit,
        flat: &[f32],
        [before, after]: [View; 2],
        episodes: Option<Episodes>,
        ([now, next], [head, next_head]): (&mut [Recalled; 2], &mut [Head; 2]),
    ) {
        let Self::Recurrent(net) = self else {
            self.forward(kit, flat, (before, When::Before), None, (now, head));
            self.forward(kit, flat, (after, When::After), None, (next, next_head));
            return;
        };
        let episodes = episodes.expect(COURSES);
        let (count, at) = (episodes.count, episodes.at);
        let (_, start, later) = episodes.course(When::After);
        net.recall(kit, flat, episodes.inputs, now);
        if start.is_some() {
            let step = 4 * net.lstm.hidden * count;
            next.lstm.gates.clear();
            next.lstm.gates.extend(&now.lstm.gates[step..]);
            now.lstm.gates.truncate(next.lstm.gates.len());
            net.lstm.run(kit, flat, count, start, &mut next.lstm);
        }
        net.lstm.run(kit, flat, count, None, &mut now.lstm);
        net.conclude(kit, flat, before, (&now.lstm.hidden, at, 0), head);
        let hidden = if start.is_some() { &next.lstm.hidden } else { &now.lstm.hidden };
        net.conclude(kit, flat, after, (hidden, at, later), next_head);
    }

    /// Gradient for the parameters, from that for the outputs of the observations before the steps,
    /// `[rows, outputs]`.
    ///
    /// # Panics
    /// As [`Network::forward`].
    pub(super) fn backward(
        &self,
        kit: &mut Kit,
        flat: &[f32],
        rows: View,
        episodes: Option<Episodes>,
        (recalled, head): (&mut Recalled, &mut Head),
        (outputs, gradient): (&[f32], &mut [f32]),
    ) {
        match self {
            Self::FeedForward(net) => {
                net.backward(kit, flat, rows, &mut head.passed, outputs, Some(gradient));
            }
            Self::Recurrent(net) => {
                net.back_to_branches(kit, flat, head, outputs, Some(gradient));
                let episodes = episodes.expect(COURSES);
                let (inputs, ..) = episodes.course(When::Before);
                let h = net.lstm.hidden;
                let dy = View::new(&head.seen_back, rows.rows, h);
                net.seen.gradient(kit, rows, dy, gradient);
                recalled.lstm.back.clear();
                recalled.lstm.back.resize(inputs.rows * h, 0.0);
                for (&at, row) in episodes.at.iter().zip(head.recalled_back.chunks_exact(h)) {
                    recalled.lstm.back[at as usize * h..][..h].copy_from_slice(row);
                }
                let Recalled { layer, lstm, back } = recalled;
                let x = View::new(layer, inputs.rows, h);
                net.lstm.backward(kit, flat, (x, episodes.count), lstm, gradient, back);
                net.recalled.gradient(kit, inputs, View::new(back, inputs.rows, h), gradient);
            }
        }
    }

    /// Gradient for `count` of the inputs from the one at `from`, `[rows, count]`, from that for
    /// the outputs.
    pub(super) fn back_to_inputs(
        &self,
        kit: &mut Kit,
        flat: &[f32],
        rows: View,
        head: &mut Head,
        (outputs, into): (&[f32], &mut [f32]),
        (from, count): (usize, usize),
    ) {
        let into = Into { data: into, down: count };
        match self {
            Self::FeedForward(net) => {
                net.backward(kit, flat, rows, &mut head.passed, outputs, None);
                let first = &net.layers[0];
                let dy = View::new(head.passed.first_gradient(), rows.rows, first.outputs);
                first.back(kit, flat, dy, (from, count), Finish::Plain, into);
            }
            Self::Recurrent(net) => {
                net.back_to_branches(kit, flat, head, outputs, None);
                let dy = View::new(&head.seen_back, rows.rows, net.lstm.hidden);
                net.seen.back(kit, flat, dy, (from, count), Finish::Plain, into);
            }
        }
    }
}

impl Recurrent {
    /// Width of the inputs of the branch with memory.
    pub(super) fn recalls(&self) -> usize {
        self.recalled.inputs
    }

    /// The first layer of the branch with memory, and what its gates get from it.
    fn recall(&self, kit: &mut Kit, flat: &[f32], inputs: View, recalled: &mut Recalled) {
        let h = self.lstm.hidden;
        recalled.layer.resize(inputs.rows * h, 0.0);
        let into = Into { data: &mut recalled.layer, down: h };
        self.recalled.forward(kit, flat, inputs, true, into);
        let x = View::new(&recalled.layer, inputs.rows, h);
        self.lstm.see(kit, flat, x, &mut recalled.lstm);
    }

    /// The branch without memory, and the trunk; `hidden` holds the outputs of the other branch,
    /// those of the rows `later` after the places `at`.
    fn conclude(
        &self,
        kit: &mut Kit,
        flat: &[f32],
        rows: View,
        (hidden, at, later): (&[f32], &[i64], usize),
        head: &mut Head,
    ) {
        let h = self.lstm.hidden;
        head.merged.resize(rows.rows * 2 * h, 0.0);
        self.seen.forward(kit, flat, rows, true, Into { data: &mut head.merged, down: 2 * h });
        for (&at, row) in at.iter().zip(head.merged.chunks_exact_mut(2 * h)) {
            row[h..].copy_from_slice(&hidden[(at as usize + later) * h..][..h]);
        }
        let x = View::new(&head.merged, rows.rows, 2 * h);
        self.trunk.forward(kit, flat, x, &mut head.passed);
    }

    /// Goes back to the outputs of the branches; to that with memory only with the gradient for the
    /// parameters, which it needs.
    fn back_to_branches(
        &self,
        kit: &mut Kit,
        flat: &[f32],
        head: &mut Head,
        outputs: &[f32],
        gradient: Option<&mut [f32]>,
    ) {
        let (h, first) = (self.lstm.hidden, &self.trunk.layers[0]);
        let rows = head.merged.len() / (2 * h);
        let x = View::new(&head.merged, rows, 2 * h);
        let to_memory = gradient.is_some();
        self.trunk.backward(kit, flat, x, &mut head.passed, outputs, gradient);
        let dy = View::new(head.passed.first_gradient(), rows, first.outputs);
        head.seen_back.resize(rows * h, 0.0);
        let into = Into { data: &mut head.seen_back, down: h };
        first.back(kit, flat, dy, (0, h), Finish::Where(x.some_columns(0, h)), into);
        if to_memory {
            head.recalled_back.resize(rows * h, 0.0);
            let into = Into { data: &mut head.recalled_back, down: h };
            first.back(kit, flat, dy, (h, h), Finish::Plain, into);
        }
    }
}
