//! Doses on a graphics card, many side by side, and what can be asked of one.
//!
//! The loop of a weighing is the same as everywhere: each dose runs it on a thread of its own, on a spoon
//! in a place of a batch.

use super::Functions;
use super::evaluate::dose_of;
use super::host::{self, JobError};
use super::runner::{DoseExperiment, Each, HeapExperiment, Run, Runner};
use flip_bench::rig::simulate_from;
use flip_bench::weigh::Event;
use flip_core::domain::FieldError;
use flip_core::domain::device::Device;
use flip_cuda::{Card, GRAINS_MAX};
use flip_learn::calibrate;
use flip_learn::train::evaluate::Dose;
use flip_sim::batch::heaps::{Wanted, pour_on};
use flip_sim::batch::{Engine, Failed, Place, Several, side_by_side};
use flip_sim::dispense;
use flip_sim::repose::{Refusal, Repose};
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Instant;

/// The graphics cards of this process.
pub trait Cards: Send + Sync {
    /// What they are, or why there is none that can be used, in words that end with what to do. Takes no
    /// memory of a card.
    fn found(&self) -> Result<String, String>;

    /// Opens them as one engine, which takes a second for each.
    ///
    /// # Errors
    /// As [`Cards::found`].
    fn open(&self) -> Result<Arc<dyn Engine>, String>;
}

/// All cards of one kind that the driver shows this process (`CUDA_VISIBLE_DEVICES` chooses among them).
#[derive(Debug, Default)]
pub struct AllCards(OnceLock<Result<String, String>>);

impl Cards for AllCards {
    fn found(&self) -> Result<String, String> {
        let look = || {
            let (numbers, kind) = flip_cuda::find_all().map_err(|error| error.to_string())?;
            let many = numbers.len();
            Ok(if many > 1 { format!("{many} × {kind}") } else { kind.to_string() })
        };
        self.0.get_or_init(look).clone()
    }

    fn open(&self) -> Result<Arc<dyn Engine>, String> {
        let (numbers, _) = flip_cuda::find_all().map_err(|error| error.to_string())?;
        let open = |number| Card::open(number).map(|card| Arc::new(card) as Arc<dyn Engine>);
        let cards = numbers.into_iter().map(open).collect::<Result<_, _>>();
        let cards = cards.map_err(|error| error.to_string())?;
        Several::of(cards).ok_or_else(|| "there is no card".to_owned())
    }
}

/// What [`Cards::found`] says, without keeping this thread waiting: a driver that begins may take a while.
pub(super) async fn found(functions: &Functions) -> Result<String, String> {
    let cards = functions.card.clone();
    tokio::task::spawn_blocking(move || cards.found())
        .await
        .unwrap_or_else(|error| Err(format!("the card was not looked for ({error})")))
}

/// Whether a device can compute spoons of these settings.
///
/// # Errors
/// `device`: a spoon has more grains than a card has room for.
pub fn can_compute(device: Device, spoon: &dispense::Settings) -> Result<(), FieldError> {
    if device.is_cpu() { Ok(()) } else { has_room(spoon.particles, "on a spoon") }
}

/// Whether a device can pour the heaps of a calibration.
///
/// # Errors
/// `device`: a heap has more grains than a card has room for.
pub fn can_pour(device: Device, settings: &calibrate::Settings) -> Result<(), FieldError> {
    let particles = settings.particles.max(settings.verify_particles.unwrap_or_default());
    if device.is_cpu() { Ok(()) } else { has_room(particles, "in a heap") }
}

fn has_room(particles: u32, place: &str) -> Result<(), FieldError> {
    match particles as usize <= GRAINS_MAX {
        true => Ok(()),
        false => Err(cannot(&format!("{particles} grains {place}, at most {GRAINS_MAX}"))),
    }
}

fn cannot(what: &str) -> FieldError {
    let advice = format!("`cuda` cannot compute {what}: leave the field out to compute on the CPU");
    FieldError::new("device", advice)
}

/// The engine of a job on this device; none for the processor, which the job's functions compute on.
pub(super) fn engine_of(
    cards: &dyn Cards,
    device: Device,
) -> host::Result<Option<Arc<dyn Engine>>> {
    match device {
        Device::Cpu => Ok(None),
        Device::Cuda => cards.open().map(Some).map_err(JobError::Device),
    }
}

/// What this computer's cards are, or why there is none that can be used.
pub fn local_cards() -> Result<String, String> {
    AllCards::default().found()
}

/// This computer's cards, for what is computed without a job; none for the processor.
///
/// # Errors
/// `device`: what was found instead of a card, and what to do.
pub fn local_engine(device: Device) -> Result<Option<Arc<dyn Engine>>, FieldError> {
    engine_of(&AllCards::default(), device).map_err(|found| {
        let advice = format!("no graphics card can be used: {found}, by leaving this field out");
        FieldError::new("device", advice)
    })
}

/// Weighs doses side by side on an engine.
pub struct SideBySide(pub Arc<dyn Engine>);

impl Runner<DoseExperiment, Result<Dose, String>> for SideBySide {
    fn run(&self, experiments: &[DoseExperiment], each: &mut Each<'_, Result<Dose, String>>) {
        let procedure = |n: usize, place: &mut Place| {
            let (begun, experiment) = (Instant::now(), &experiments[n]);
            let DoseExperiment { task, simulation } = experiment;
            let outcome = match place.settle(simulation.loose(&task.rules)) {
                Err(Failed(why)) => Err(why),
                Ok(seat) => {
                    let mut go_on = |_: &Event<'_>| ControlFlow::Continue(());
                    let stop = AtomicBool::new(false);
                    dose_of(simulate_from(seat, task, simulation, &mut go_on, &stop))
                }
            };
            Run { outcome, seconds: begun.elapsed().as_secs_f64() }
        };
        let heard = AtomicBool::new(false);
        let mut each = |n: usize, run| {
            heard.store(true, Ordering::SeqCst);
            each(n, run)
        };
        let ran = self.0.batch(self.0.places().min(experiments.len())).and_then(|mut batch| {
            side_by_side(&mut *batch, experiments.len(), procedure, &mut each)
        });
        // A dose under way was told so; without one, the first is.
        if let Err(Failed(why)) = ran
            && !heard.load(Ordering::SeqCst)
        {
            let _ = each(0, Run { outcome: Err(why), seconds: 0.0 });
        }
    }
}

/// Pours heaps side by side on an engine.
pub struct HeapsByCard {
    card: Arc<dyn Engine>,
    failed: Mutex<Option<String>>,
}

impl HeapsByCard {
    /// With all the places of an engine.
    pub fn of(card: Arc<dyn Engine>) -> Self {
        Self { card, failed: Mutex::default() }
    }

    /// Why it ended early, if the engine failed.
    pub fn failed(&self) -> Option<String> {
        self.failed.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Runner<HeapExperiment, Result<Repose, Refusal>> for HeapsByCard {
    fn run(&self, experiments: &[HeapExperiment], each: &mut Each<'_, Result<Repose, Refusal>>) {
        let wanted = |of: &HeapExperiment| {
            let &HeapExperiment { set, settings, seed } = of;
            Wanted { set, settings, seed }
        };
        let wanted: Vec<Wanted> = experiments.iter().map(wanted).collect();
        let begun = Instant::now();
        let mut ended = 0;
        // They end together: each has its share of the time.
        let mut each = |n: usize, outcome| {
            ended += 1;
            let seconds = begun.elapsed().as_secs_f64() / f64::from(ended);
            each(n, Run { outcome, seconds })
        };
        if let Err(Failed(why)) = pour_on(&*self.card, &wanted, &mut each) {
            *self.failed.lock().unwrap_or_else(PoisonError::into_inner) = Some(why);
        }
    }
}

#[cfg(test)]
#[path = "card_tests.rs"]
mod tests;
