//! Soft Actor-Critic with two hidden layers on a card: updates of many trainings at once.
//!
//! A group of blocks makes the updates of one training, several in one launch. Every sum runs over
//! its terms in the order of the code for processors (`flip-learn`, gradients `fused`), so that the
//! results have the same bits as there, on any card, with any number of trainings and blocks.
//!
//! Batches are drawn by the caller. Recurrent networks and a final policy that is a mean are not
//! here.

use crate::Result;
use crate::card::{CardError, wait};
use crate::learner_layout::{CHUNK, LOSSES, Layout, SCALES, losses};
use cudarc::driver::sys::CUdevice_attribute::CU_DEVICE_ATTRIBUTE_MAX_SHARED_MEMORY_PER_BLOCK_OPTIN;
use cudarc::driver::sys::CUfunction_attribute::CU_FUNC_ATTRIBUTE_MAX_DYNAMIC_SHARED_SIZE_BYTES;
use cudarc::driver::{CudaFunction, CudaSlice, CudaStream, LaunchConfig, PushKernelArg};
use flip_core::learner::{Drawn, Learned, Losses, Shape};
use std::sync::Arc;
use std::time::Instant;

/// Threads of a block.
const THREADS: u32 = 512;
/// Blocks of a training with a batch of a few chunks: gradients and steps of parameters are shared
/// out among as many.
const BLOCKS: usize = 16;
/// Bytes of shared memory that the kernel takes for itself, rounded up.
const STATIC: usize = 1024;

/// Trainings on a card: actor, critics, their slow copies, and Adam's means.
#[derive(Debug)]
pub struct Learners {
    stream: Arc<CudaStream>,
    kernel: CudaFunction,
    layout: Layout,
    blocks: usize,
    steps: Vec<[u64; 2]>,
    trainings: CudaSlice<f32>,
    kernel_s: f64,
}

impl Learners {
    /// Whether a card makes updates of learners of this shape: their layers are of a multiple of 16
    /// units, and not too wide for its shared memory.
    ///
    /// # Errors
    /// [`CardError`].
    pub fn serves(card: &crate::Card, shape: &Shape) -> Result<bool> {
        let room = card
            .stream()
            .context()
            .attribute(CU_DEVICE_ATTRIBUTE_MAX_SHARED_MEMORY_PER_BLOCK_OPTIN)?;
        let layout = Layout(*shape);
        Ok(layout.is_served() && layout.shared() + STATIC <= room.max(0) as usize)
    }

    /// Puts these trainings on a card, whose processors they share out.
    ///
    /// # Errors
    /// [`CardError`]; [`CardError::Unfit`] for a shape that the card does not serve, blocks that are
    /// not of it, or more trainings than the card has processors.
    pub fn new(card: &crate::Card, shape: Shape, trainings: &[Learned]) -> Result<Self> {
        let mut learners = Self::empty(card, shape, trainings.len())?;
        for (k, training) in trainings.iter().enumerate() {
            learners.put(k, training)?;
        }
        Ok(learners)
    }

    /// Room for so many trainings.
    ///
    /// # Errors
    /// As [`Learners::new`].
    pub fn empty(card: &crate::Card, shape: Shape, count: usize) -> Result<Self> {
        let most = card.multiprocessors();
        if count == 0 || count > most {
            return Err(CardError::Unfit("a card updates from one training to one a processor"));
        }
        if !Self::serves(card, &shape)? {
            return Err(CardError::Unfit(
                "the layers are not of a multiple of 16 units, or too wide for the card's shared memory",
            ));
        }
        let (stream, kernel, layout) = (card.stream().clone(), card.learners()?, Layout(shape));
        kernel.set_attribute(
            CU_FUNC_ATTRIBUTE_MAX_DYNAMIC_SHARED_SIZE_BYTES,
            layout.shared() as i32,
        )?;
        let blocks = (most / count).min(BLOCKS.max(shape.rows.div_ceil(CHUNK)));
        let trainings = stream.alloc_zeros(count * layout.training())?;
        let steps = vec![[0; 2]; count];
        Ok(Self { stream, kernel, layout, blocks, steps, trainings, kernel_s: 0.0 })
    }

    /// Replaces the state of a training.
    ///
    /// # Errors
    /// [`CardError`]; [`CardError::Unfit`] for blocks of another shape.
    pub fn put(&mut self, training: usize, state: &Learned) -> Result<()> {
        let (image, count) = (self.layout.image(state)?, self.steps.len());
        let no_such = CardError::NoSuch { number: training, count };
        let steps = self.steps.get_mut(training).ok_or(no_such)?;
        let from = training * self.layout.training();
        let mut place = self.trainings.slice_mut(from..from + image.len());
        self.stream.memcpy_htod(&image, &mut place)?;
        // The copy reads `image` until then.
        self.stream.synchronize()?;
        *steps = state.steps;
        Ok(())
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
        let mut drawn = Vec::with_capacity(batches.len() * self.layout.0.drawn());
        let mut scales = Vec::with_capacity(batches.len() * SCALES);
        for (k, batch) in batches.iter().enumerate() {
            self.layout.add(batch, &mut drawn)?;
            let later = (k % updates) as u64;
            scales.extend(self.layout.scales(self.steps[k / updates].map(|steps| steps + later)));
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
            shared_mem_bytes: self.layout.shared() as u32,
        };
        let sizes = self.layout.sizes(updates, self.blocks);
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
        wait(&self.stream)?;
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
        let from = training * self.layout.training();
        let image = self.trainings.slice(from..from + self.layout.learned());
        let image = self.stream.clone_dtoh(&image)?;
        self.stream.synchronize()?;
        Ok(self.layout.learned_in(&image, steps))
    }
}

#[cfg(test)]
#[path = "learner_tests.rs"]
mod tests;
