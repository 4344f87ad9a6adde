//! Soft Actor-Critic with two hidden layers on a card: updates of many trainings at once.
//!
//! The state of each training stays on the card: actor, critics, their slow copies, and Adam's means.
//! A group of blocks makes the updates of one training, several in one launch. Every sum runs over
//! its terms in the order of the code for processors (`flip-learn`, gradients `fused`), so that the
//! results have the same bits as there, on any card, with any number of trainings and blocks.
//!
//! Batches are drawn by the caller. Recurrent networks and a final policy that is a mean are not
//! here.

use crate::Result;
use crate::card::CardError;
use cudarc::driver::sys::CUdevice_attribute::CU_DEVICE_ATTRIBUTE_MAX_SHARED_MEMORY_PER_BLOCK_OPTIN;
use cudarc::driver::sys::CUfunction_attribute::CU_FUNC_ATTRIBUTE_MAX_DYNAMIC_SHARED_SIZE_BYTES;
use cudarc::driver::{CudaFunction, CudaSlice, CudaStream, LaunchConfig, PushKernelArg};
use std::sync::Arc;
use std::time::Instant;

/// Threads of a block.
const THREADS: u32 = 512;
/// Rows that a block carries together.
const CHUNK: usize = 16;
const ACTIONS: usize = 2;
/// Blocks of a training with a batch of a few chunks: gradients and steps of parameters are shared
/// out among as many.
const BLOCKS: usize = 16;
/// Numbers per update: sizes and scales of Adam's steps, and losses.
const SCALES: usize = 4;
const LOSSES: usize = 4;

/// Sizes and rates that all trainings share.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shape {
    /// Steps in a batch.
    pub rows: usize,
    /// Numbers that the actor sees.
    pub inputs: usize,
    /// Numbers that the critics see beside the actions, which begin with those.
    pub state: usize,
    /// Units in each hidden layer; a multiple of 16.
    pub hidden: usize,
    /// Whether the critics' loss is Huber's; else it is the squared difference.
    pub huber: bool,
    /// Discount per step.
    pub gamma: f32,
    /// Share of a critic that its slow copy takes over in an update.
    pub tau: f32,
    /// Target entropy of the temperature, nats.
    pub target_entropy: f64,
    /// Adam's step size.
    pub learning_rate: f64,
}

/// The learnable state of one training, in the layout of `flip-learn`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Learned {
    /// Actor's parameters, and Adam's two means of their gradient.
    pub actor: [Vec<f32>; 3],
    /// Both critics' parameters, one after the other, likewise.
    pub critics: [Vec<f32>; 3],
    /// The slow copies of the critics.
    pub targets: Vec<f32>,
    /// Logarithm of the temperature, likewise.
    pub log_alpha: [f32; 3],
    /// Steps of Adam so far: of the critics, and of actor and temperature.
    pub steps: [u64; 2],
}

/// The batch of one update.
#[derive(Debug, Clone, Copy)]
pub struct Drawn<'a> {
    /// `[rows, state + 2]`: observations, parameters, actions.
    pub now: &'a [f32],
    /// `[rows, state]`: next observations and parameters.
    pub next: &'a [f32],
    /// `[rows]`.
    pub reward: &'a [f32],
    /// `[rows]`: 0 where the episode ended.
    pub goes_on: &'a [f32],
    /// `[2, rows, 2]` standard normal numbers: for the next actions, then for the present ones.
    pub noise: &'a [f32],
}

/// Losses of one update.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Losses {
    /// Loss of both critics.
    pub critic: f64,
    /// Loss of the actor.
    pub actor: f64,
    /// Entropy of the policy, nats.
    pub entropy: f64,
    /// Temperature before the update.
    pub alpha: f64,
}

/// `Sizes` of `cuda/learner.cuh`.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub(crate) struct Sizes {
    rows: i32,
    inputs: i32,
    state: i32,
    hidden: i32,
    updates: i32,
    blocks: i32,
    huber: i32,
    gamma: f32,
    tau: f32,
    unused: i32,
    target_entropy: f64,
}

#[allow(unsafe_code)]
// SAFETY: plain numbers in C's layout.
unsafe impl cudarc::driver::DeviceRepr for Sizes {}

/// The numbers in four or as many as fill up fours.
fn whole(count: usize) -> usize {
    count.next_multiple_of(4)
}

impl Shape {
    fn actor(&self) -> usize {
        (self.inputs + 1) * self.hidden + (self.hidden + 1) * (self.hidden + 2 * ACTIONS)
    }

    fn critic(&self) -> usize {
        (self.state + ACTIONS + 1) * self.hidden + (self.hidden + 1) * (self.hidden + 1)
    }

    /// Numbers of a batch.
    fn drawn(&self) -> usize {
        self.rows * (2 * self.state + ACTIONS + 2 + 2 * ACTIONS)
    }

    /// Numbers of a training on the card, as `training_at` of `cuda/learner.cuh`.
    pub(crate) fn training(&self) -> usize {
        let layer = whole(self.rows * self.hidden);
        let layers = 4 * layer + 4 * whole(2 * self.rows * self.hidden);
        let turned = whole(self.hidden * self.hidden) + whole(2 * self.hidden * self.hidden);
        let by_row = 3 * whole(2 * self.rows) + 2 * whole(self.rows);
        let actions = 2 * whole(self.rows * 2 * ACTIONS) + 2 * whole(self.rows * ACTIONS);
        self.learned() + turned + layers + by_row + actions
    }

    /// Those of them that outlast a launch.
    fn learned(&self) -> usize {
        3 * whole(self.actor()) + 8 * whole(self.critic()) + 4
    }

    /// Bytes of a block's shared memory, as `shared_length`.
    fn shared(&self) -> usize {
        let columns = 2 * (self.state + ACTIONS) + 8 * self.hidden + 8 * ACTIONS + 6;
        4 * CHUNK * columns
    }

    pub(crate) fn sizes(&self, updates: usize, blocks: usize) -> Sizes {
        let [rows, inputs, state, hidden, updates, blocks] =
            [self.rows, self.inputs, self.state, self.hidden, updates, blocks].map(|n| n as i32);
        let (huber, gamma, tau) = (i32::from(self.huber), self.gamma, self.tau);
        let target_entropy = self.target_entropy;
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

    /// A training as it begins on the card.
    ///
    /// # Errors
    /// [`CardError::Unfit`] if a length or the width of the layers does not fit.
    pub(crate) fn image(&self, of: &Learned) -> Result<Vec<f32>> {
        let (actor, critic) = (self.actor(), self.critic());
        let fits = of.actor.iter().all(|block| block.len() == actor)
            && of.critics.iter().chain([&of.targets]).all(|block| block.len() == 2 * critic)
            && self.hidden.is_multiple_of(16)
            && self.rows > 0
            && self.inputs <= self.state;
        if !fits {
            return Err(CardError::Unfit("the blocks are not those of a learner of these sizes"));
        }
        let mut image = Vec::with_capacity(self.training());
        for block in &of.actor {
            image.extend(block);
            image.resize(image.len().next_multiple_of(4), 0.0);
        }
        let [critics, m, v] = &of.critics;
        for block in [critics, &of.targets, m, v].into_iter().flat_map(|all| all.chunks(critic)) {
            image.extend(block);
            image.resize(image.len().next_multiple_of(4), 0.0);
        }
        image.extend(of.log_alpha);
        image.resize(self.training(), 0.0);
        Ok(image)
    }

    /// The reverse of [`Shape::image`].
    pub(crate) fn learned_in(&self, image: &[f32], steps: [u64; 2]) -> Learned {
        let mut rest = image;
        let mut take = |count: usize| {
            let (taken, left) = rest.split_at(whole(count));
            rest = left;
            taken[..count].to_vec()
        };
        let actor = std::array::from_fn(|_| take(self.actor()));
        let mut both = || [take(self.critic()), take(self.critic())].concat();
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
            let size = (self.learning_rate / correct(0.9)) as f32;
            [size, (1.0 / correct(0.999).sqrt()) as f32]
        });
        [critics[0], critics[1], actor[0], actor[1]]
    }

    /// Adds a batch to those of a launch.
    ///
    /// # Errors
    /// [`CardError::Unfit`] if a length does not fit.
    pub(crate) fn add(&self, batch: &Drawn, to: &mut Vec<f32>) -> Result<()> {
        let lengths = [self.state + ACTIONS, self.state, 1, 1, 2 * ACTIONS];
        let parts = [batch.now, batch.next, batch.reward, batch.goes_on, batch.noise];
        for (part, length) in parts.into_iter().zip(lengths) {
            if part.len() != self.rows * length {
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

/// The trainings on a card.
#[derive(Debug)]
pub struct Learners {
    stream: Arc<CudaStream>,
    kernel: CudaFunction,
    shape: Shape,
    blocks: usize,
    steps: Vec<[u64; 2]>,
    trainings: CudaSlice<f32>,
    kernel_s: f64,
}

impl Learners {
    /// Puts these trainings on a card, whose processors they share out.
    ///
    /// # Errors
    /// [`CardError`]; [`CardError::Unfit`] for blocks that are not of this shape, or more trainings
    /// than the card has processors.
    pub fn new(card: &crate::Card, shape: Shape, trainings: &[Learned]) -> Result<Self> {
        let stream = card.stream().clone();
        let kernel = card.learners()?;
        let most = card.multiprocessors();
        if trainings.is_empty() || trainings.len() > most {
            return Err(CardError::Unfit("a card updates from one training to one a processor"));
        }
        let room =
            stream.context().attribute(CU_DEVICE_ATTRIBUTE_MAX_SHARED_MEMORY_PER_BLOCK_OPTIN)?;
        // The kernel has a kilobyte of its own.
        if shape.shared() + 1024 > room as usize {
            return Err(CardError::Unfit("the layers are too wide for the card's shared memory"));
        }
        kernel.set_attribute(
            CU_FUNC_ATTRIBUTE_MAX_DYNAMIC_SHARED_SIZE_BYTES,
            shape.shared() as i32,
        )?;
        let mut images = Vec::new();
        for training in trainings {
            images.extend(shape.image(training)?);
        }
        let blocks = (most / trainings.len()).min(BLOCKS.max(shape.rows.div_ceil(CHUNK)));
        let steps = trainings.iter().map(|training| training.steps).collect();
        let trainings = stream.clone_htod(&images)?;
        Ok(Self { stream, kernel, shape, blocks, steps, trainings, kernel_s: 0.0 })
    }

    /// The same trainings with another number of blocks for each, as far as the card has
    /// processors. Results do not depend on it.
    #[must_use]
    pub fn with_blocks(self, blocks: usize) -> Self {
        Self { blocks: blocks.clamp(1, self.blocks), ..self }
    }

    /// Makes updates of every training, one launch for all of them: `batches` holds as many for the
    /// first training as for each of the others, one after the other. Returns their losses in the
    /// same order.
    ///
    /// # Errors
    /// [`CardError`].
    pub fn update(&mut self, batches: &[Drawn]) -> Result<Vec<Losses>> {
        let trainings = self.steps.len();
        let updates = batches.len() / trainings;
        if updates == 0 || updates * trainings != batches.len() {
            return Err(CardError::Unfit("every training is given as many batches, one or more"));
        }
        let mut drawn = Vec::with_capacity(batches.len() * self.shape.drawn());
        let mut scales = Vec::with_capacity(batches.len() * SCALES);
        for (k, batch) in batches.iter().enumerate() {
            self.shape.add(batch, &mut drawn)?;
            let later = (k % updates) as u64;
            scales.extend(self.shape.scales(self.steps[k / updates].map(|steps| steps + later)));
        }
        let (drawn, scales) = (self.stream.clone_htod(&drawn)?, self.stream.clone_htod(&scales)?);
        let raw = self.launch(updates, &drawn, &scales)?;
        self.steps.iter_mut().flatten().for_each(|steps| *steps += updates as u64);
        Ok(losses(&raw))
    }

    /// Runs the kernel on what lies on the card.
    fn launch(
        &mut self,
        updates: usize,
        drawn: &CudaSlice<f32>,
        scales: &CudaSlice<f32>,
    ) -> Result<Vec<f64>> {
        let trainings = self.steps.len();
        let mut out = self.stream.alloc_zeros::<f64>(trainings * updates * LOSSES)?;
        let mut counts = self.stream.alloc_zeros::<u32>(trainings)?;
        let config = LaunchConfig {
            grid_dim: ((trainings * self.blocks) as u32, 1, 1),
            block_dim: (THREADS, 1, 1),
            shared_mem_bytes: self.shape.shared() as u32,
        };
        let sizes = self.shape.sizes(updates, self.blocks);
        let mut launch = self.stream.launch_builder(&self.kernel);
        launch.arg(&sizes).arg(&mut self.trainings).arg(drawn).arg(scales);
        launch.arg(&mut out).arg(&mut counts);
        self.stream.synchronize()?;
        let start = Instant::now();
        #[allow(unsafe_code)]
        // SAFETY: the arguments are those of the kernel, in its order; every table has the length
        // that the sizes name; a cooperative launch is refused unless all blocks fit on the card
        // together, so those of a group can wait for each other.
        unsafe {
            launch.launch_cooperative(config)?;
        }
        self.stream.synchronize()?;
        self.kernel_s = start.elapsed().as_secs_f64();
        let out = self.stream.clone_dtoh(&out)?;
        self.stream.synchronize()?;
        Ok(out)
    }

    /// Seconds that the last launch took, without the transfers.
    pub fn kernel_s(&self) -> f64 {
        self.kernel_s
    }

    /// Blocks for each training.
    pub fn blocks(&self) -> usize {
        self.blocks
    }

    /// The state of a training.
    ///
    /// # Errors
    /// [`CardError`].
    pub fn learned(&self, training: usize) -> Result<Learned> {
        let count = self.steps.len();
        let no_such = CardError::NoSuch { number: training, count };
        let steps = *self.steps.get(training).ok_or(no_such)?;
        let from = training * self.shape.training();
        let image = self.trainings.slice(from..from + self.shape.learned());
        let image = self.stream.clone_dtoh(&image)?;
        self.stream.synchronize()?;
        Ok(self.shape.learned_in(&image, steps))
    }
}

#[cfg(test)]
#[path = "learner_tests.rs"]
mod tests;
