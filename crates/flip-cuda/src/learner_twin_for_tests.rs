//! The learner's twin: the source of the kernel that updates learners, compiled for this processor
//! as a program.
//!
//! It reads `Sizes`, the number of trainings (i32), and then numbers (f32): the trainings, the batches
//! of all updates, and Adam's sizes and scales. It writes the trainings (f32) and the losses (f64).

use crate::CardError;
use crate::learner_layout::{Layout, losses};
use crate::twin::built;
use flip_core::learner::{Drawn, Learned, Losses, Shape};
use flip_sim::batch::{Batch, Cores, Engine, Failed, Updates};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Trainings after updates, and the losses of these.
pub(crate) type Updated = (Vec<Learned>, Vec<Losses>);

/// Makes updates of these trainings in groups of so many blocks, as many of each, with batches in the
/// order of [`crate::Learners::update`]. None, with the reason printed, where it cannot be compiled.
///
/// # Errors
/// [`CardError::Unfit`] for trainings or batches of another shape.
pub(crate) fn updated(
    layout: Layout,
    blocks: usize,
    trainings: &[Learned],
    batches: &[Drawn],
) -> Option<Result<Updated, CardError>> {
    let program = built("cuda/learner_twin.cpp")?;
    let updates = batches.len() / trainings.len();
    let input = match input(layout, blocks, trainings, batches) {
        Ok(input) => input,
        Err(unfit) => return Some(Err(unfit)),
    };
    let folder = tempfile::tempdir().expect("a folder for the trainings");
    let (from, to) = (folder.path().join("in"), folder.path().join("out"));
    std::fs::write(&from, input).expect("the trainings are written");
    let status = Command::new(program).args([&from, &to]).status().expect("the twin runs");
    assert!(status.success(), "the twin failed: {status}");
    let bytes = std::fs::read(&to).expect("the twin's answer is read");
    let (images, raw) = bytes.split_at(4 * layout.training() * trainings.len());
    let images: Vec<f32> = images.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
    let raw: Vec<f64> = raw.as_chunks().0.iter().map(|b| f64::from_le_bytes(*b)).collect();
    let of = |(image, before): (&[f32], &Learned)| {
        layout.learned_in(image, before.steps.map(|steps| steps + updates as u64))
    };
    let learned = images.chunks(layout.training()).zip(trainings).map(of).collect();
    Some(Ok((learned, losses(&raw))))
}

fn input(
    layout: Layout,
    blocks: usize,
    trainings: &[Learned],
    batches: &[Drawn],
) -> Result<Vec<u8>, CardError> {
    let updates = batches.len() / trainings.len();
    let sizes = layout.sizes(updates, blocks);
    let whole = [sizes.rows, sizes.inputs, sizes.state, sizes.hidden, sizes.updates, sizes.blocks];
    let mut bytes: Vec<u8> = whole.into_iter().flat_map(i32::to_le_bytes).collect();
    bytes.extend(sizes.huber.to_le_bytes());
    bytes.extend([sizes.gamma, sizes.tau].into_iter().flat_map(f32::to_le_bytes));
    bytes.extend(sizes.unused.to_le_bytes());
    bytes.extend(sizes.target_entropy.to_le_bytes());
    bytes.extend((trainings.len() as i32).to_le_bytes());
    let mut numbers = Vec::new();
    for (k, training) in trainings.iter().enumerate() {
        numbers.extend(layout.image(training)?);
        numbers.resize((k + 1) * layout.training(), 0.0);
    }
    for batch in batches {
        layout.add(batch, &mut numbers)?;
    }
    for training in trainings {
        let after = |k: u64| layout.scales(training.steps.map(|steps| steps + k));
        numbers.extend((0..updates as u64).flat_map(after));
    }
    bytes.extend(numbers.iter().flat_map(|x| x.to_le_bytes()));
    Ok(bytes)
}

/// The cores, with updates by the twin in groups of so many blocks.
pub(crate) struct Twin {
    pub(crate) blocks: usize,
    /// Updates made so far.
    pub(crate) made: Arc<AtomicUsize>,
}

struct OfTwin {
    layout: Layout,
    blocks: usize,
    made: Arc<AtomicUsize>,
}

impl Engine for Twin {
    fn name(&self) -> String {
        "the twin".to_owned()
    }

    fn places(&self) -> usize {
        Cores.places()
    }

    fn batch(&self, places: usize) -> Result<Box<dyn Batch>, Failed> {
        Cores.batch(places)
    }

    fn updates(&self, shape: &Shape) -> Result<Option<Box<dyn Updates>>, Failed> {
        let layout = Layout(*shape);
        let Self { blocks, made } = self;
        let of_twin = OfTwin { layout, blocks: *blocks, made: made.clone() };
        Ok(layout.is_served().then(|| Box::new(of_twin) as Box<dyn Updates>))
    }
}

impl Updates for OfTwin {
    fn make(&mut self, of: &mut Learned, with: &[Drawn<'_>]) -> Result<Vec<Losses>, Failed> {
        let updated = updated(self.layout, self.blocks, std::slice::from_ref(of), with);
        let no_compiler = || Failed("there is no g++ to compile the twin with".to_owned());
        let (mut learned, losses) = updated.ok_or_else(no_compiler)??;
        *of = learned.remove(0);
        self.made.fetch_add(with.len(), Ordering::SeqCst);
        Ok(losses)
    }
}
