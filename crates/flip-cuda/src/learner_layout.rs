//! How learners and their batches lie on the card: the numbers of `cuda/learner.cuh`.

use crate::Result;
use crate::card::CardError;
use flip_core::learner::{ACTIONS, Drawn, Learned, Losses, Shape};

/// Rows that a block carries together.
pub(crate) const CHUNK: usize = 16;
/// Numbers per update: sizes and scales of Adam's steps, and losses.
pub(crate) const SCALES: usize = 4;
pub(crate) const LOSSES: usize = 4;

/// `Sizes` of `cuda/learner.cuh`.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub(crate) struct Sizes {
    pub(crate) rows: i32,
    pub(crate) inputs: i32,
    pub(crate) state: i32,
    pub(crate) hidden: i32,
    pub(crate) updates: i32,
    pub(crate) blocks: i32,
    pub(crate) huber: i32,
    pub(crate) gamma: f32,
    pub(crate) tau: f32,
    pub(crate) unused: i32,
    pub(crate) target_entropy: f64,
}

#[allow(unsafe_code)]
// SAFETY: plain numbers in C's layout.
unsafe impl cudarc::driver::DeviceRepr for Sizes {}

/// The numbers in four or as many as fill up fours.
fn whole(count: usize) -> usize {
    count.next_multiple_of(4)
}

/// The layout of learners of this shape.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Layout(pub(crate) Shape);

impl Layout {
    /// Whether the kernel is written for learners of this shape.
    pub(crate) fn is_served(&self) -> bool {
        let shape = &self.0;
        shape.hidden > 0
            && shape.hidden.is_multiple_of(16)
            && shape.rows > 0
            && shape.inputs <= shape.state
    }

    /// Numbers of a training on the card, as `training_at` of `cuda/learner.cuh`.
    pub(crate) fn training(&self) -> usize {
        let Shape { rows, hidden, .. } = self.0;
        let layers = 4 * whole(rows * hidden) + 4 * whole(2 * rows * hidden);
        let turned = whole(hidden * hidden) + whole(2 * hidden * hidden);
        let by_row = 3 * whole(2 * rows) + 2 * whole(rows);
        let actions = 2 * whole(rows * 2 * ACTIONS) + 2 * whole(rows * ACTIONS);
        self.learned() + turned + layers + by_row + actions
    }

    /// Those of them that outlast a launch.
    pub(crate) fn learned(&self) -> usize {
        3 * whole(self.0.actor()) + 8 * whole(self.0.critic()) + 4
    }

    /// Bytes of a block's shared memory, as `shared_length`.
    pub(crate) fn shared(&self) -> usize {
        let columns = 2 * (self.0.state + ACTIONS) + 8 * self.0.hidden + 8 * ACTIONS + 6;
        4 * CHUNK * columns
    }

    pub(crate) fn sizes(&self, updates: usize, blocks: usize) -> Sizes {
        let of = &self.0;
        let [rows, inputs, state, hidden, updates, blocks] =
            [of.rows, of.inputs, of.state, of.hidden, updates, blocks].map(|n| n as i32);
        let (huber, gamma, tau) = (i32::from(of.huber), of.gamma, of.tau);
        let target_entropy = of.target_entropy;
        Sizes {
            rows,
            inputs,
            state,
            hidden,
            updates,
            blocks,
            huber,
            gamma,
            tau,
            unused: 0,
            target_entropy,
        }
    }

    /// What outlasts a launch, as it lies at the beginning of a training on the card.
    ///
    /// # Errors
    /// [`CardError::Unfit`] if a length or the width of the layers does not fit.
    pub(crate) fn image(&self, of: &Learned) -> Result<Vec<f32>> {
        let (actor, critic) = (self.0.actor(), self.0.critic());
        let fits = of.actor.iter().all(|block| block.len() == actor)
            && of.critics.iter().chain([&of.targets]).all(|block| block.len() == 2 * critic)
            && self.is_served();
        if !fits {
            return Err(CardError::Unfit("the blocks are not those of a learner of these sizes"));
        }
        let mut image = Vec::with_capacity(self.learned());
        let [critics, m, v] = &of.critics;
        let halves = [critics, &of.targets, m, v].into_iter().flat_map(|all| all.chunks(critic));
        for block in of.actor.iter().map(Vec::as_slice).chain(halves) {
            image.extend(block);
            image.resize(whole(image.len()), 0.0);
        }
        image.extend(of.log_alpha);
        image.resize(self.learned(), 0.0);
        Ok(image)
    }

    /// The reverse of [`Layout::image`].
    pub(crate) fn learned_in(&self, image: &[f32], steps: [u64; 2]) -> Learned {
        let mut rest = image;
        let mut take = |count: usize| {
            let (taken, left) = rest.split_at(whole(count));
            rest = left;
            taken[..count].to_vec()
        };
        let actor = std::array::from_fn(|_| take(self.0.actor()));
        let mut both = || [take(self.0.critic()), take(self.0.critic())].concat();
        let (critics, targets, m, v) = (both(), both(), both(), both());
        let log_alpha = take(3);
        Learned {
            actor,
            critics: [critics, m, v],
            targets,
            log_alpha: [log_alpha[0], log_alpha[1], log_alpha[2]],
            steps,
        }
    }

    /// Adam's sizes and scales of an update, after these numbers of steps.
    pub(crate) fn scales(&self, steps: [u64; 2]) -> [f32; SCALES] {
        let [critics, actor] = steps.map(|before| {
            let t = (before + 1) as f64;
            let correct = |decay: f32| 1.0 - f64::from(decay).powf(t);
            let size = (self.0.learning_rate / correct(0.9)) as f32;
            [size, (1.0 / correct(0.999).sqrt()) as f32]
        });
        [critics[0], critics[1], actor[0], actor[1]]
    }

    /// Adds a batch to those of a launch.
    ///
    /// # Errors
    /// [`CardError::Unfit`] if a length does not fit.
    pub(crate) fn add(&self, batch: &Drawn, to: &mut Vec<f32>) -> Result<()> {
        let lengths = [self.0.state + ACTIONS, self.0.state, 1, 1, 2 * ACTIONS];
        let parts = [batch.now, batch.next, batch.reward, batch.goes_on, batch.noise];
        for (part, length) in parts.into_iter().zip(lengths) {
            if part.len() != self.0.rows * length {
                return Err(CardError::Unfit("a batch is not of the sizes of its learner"));
            }
            to.extend(part);
        }
        Ok(())
    }
}

/// Losses from what the kernel wrote.
pub(crate) fn losses(raw: &[f64]) -> Vec<Losses> {
    let of =
        |&[critic, actor, entropy, alpha]: &[f64; LOSSES]| Losses { critic, actor, entropy, alpha };
    raw.as_chunks().0.iter().map(of).collect()
}
