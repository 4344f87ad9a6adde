//! Makes piles and takes their pictures when an angle of repose is measured: with devices and
//! uploaded frames, or in an emulated laboratory with its own camera.

use super::Inbox;
use super::wires::Wires;
use crate::emulate::arm::{Flow, FormulaSpoon};
use crate::emulate::camera::{Noise, Optics, Pose, Scene, Studio, Surface, frames, upload};
use crate::emulate::lab::{self, Laboratory};
use crate::hardware::DeviceError;
use crate::hardware::bench_file::BenchFile;
use crate::hardware::camera::Upload;
use crate::hardware::clock::Clock;
use crate::hardware::stand::{Procedure, Stand};
use crate::hardware::wire::{Exchange, Recorder};
use serde::{Deserialize, Serialize};
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Bench seconds per wall-clock second while an emulated gate is open: heartbeats run on wall-clock
/// time, so bench time must not stand still.
const SPEED: f64 = 50.0;

/// One pile to make.
#[derive(Debug, Clone, Copy)]
pub struct Piling<'a> {
    /// The measurement, by its job id.
    pub job: &'a str,
    /// Which pile, from 1.
    pub number: u32,
    /// The procedure.
    pub procedure: &'a Procedure,
    /// Angle of the powder's cone, degrees, where no real powder is piled.
    pub cone_deg: Option<f64>,
    /// Seed of the emulation.
    pub seed: u64,
}

/// Why there are no frames of a pile.
#[derive(Debug, Clone, PartialEq)]
pub enum Unpiled {
    /// The callback requested a stop.
    Stopped,
    /// Something failed; a person must check the bench before another attempt.
    Failed(String),
}

impl From<DeviceError> for Unpiled {
    fn from(error: DeviceError) -> Self {
        Self::Failed(error.to_string())
    }
}

/// The stand of a rig, where piles are made. Piles and doses take turns.
pub struct PileStand {
    place: Place,
    wires: Arc<Wires>,
    /// Traffic of piles.
    recorder: Recorder,
    making: Mutex<Option<PileInMaking>>,
}

enum Place {
    /// A laboratory for each pile, and a camera over a cone with the powder's angle.
    Emulated(lab::Settings),
    /// Devices; frames are uploaded.
    Devices { file: BenchFile, inbox: Inbox },
}

/// A pile that is being made.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PileInMaking {
    /// The measurement, by its job id.
    pub job: String,
    /// Which pile, from 1.
    pub pile: u32,
}

/// Clears the pile being made when dropped, including on a panic.
struct UntilMade<'a>(&'a PileStand);

impl Drop for UntilMade<'_> {
    fn drop(&mut self) {
        *self.0.making() = None;
    }
}

impl PileStand {
    pub(super) fn emulated(settings: lab::Settings, wires: Arc<Wires>) -> Self {
        Self::at(Place::Emulated(settings), wires)
    }

    pub(super) fn of_devices(file: BenchFile, wires: Arc<Wires>) -> Self {
        Self::at(Place::Devices { file, inbox: Inbox::default() }, wires)
    }

    fn at(place: Place, wires: Arc<Wires>) -> Self {
        Self { place, wires, recorder: Recorder::default(), making: Mutex::default() }
    }

    /// Makes one pile and waits for its frames. `go_on` is called with each step; if it breaks, the
    /// pile ends with the gate closed. A stop of the bench sets `stop` and calls
    /// [`Rig::halt`](super::Rig::halt); while `stop` is set nothing flows.
    ///
    /// # Errors
    /// [`Unpiled`]
    pub fn make(
        &self,
        piling: &Piling<'_>,
        stop: &AtomicBool,
        go_on: &mut dyn FnMut(&str) -> ControlFlow<()>,
    ) -> Result<Vec<Upload>, Unpiled> {
        match &self.place {
            Place::Emulated(settings) => {
                let clock = Clock::fast(SPEED);
                let spoon = Box::new(FormulaSpoon::new(Flow::default(), piling.seed));
                let laboratory = Laboratory::start(settings.clone(), clock.clone(), spoon)
                    .map_err(|error| {
                        let cause = format!("the emulated laboratory cannot be set up: {error}");
                        Unpiled::Failed(cause)
                    })?;
                let _floor = self.wires.floor();
                self.pile(&laboratory.file(), clock, piling, stop, go_on)?;
                photographed(piling)
            }
            Place::Devices { file, inbox } => {
                // Held until the frames have arrived: the arm must not move into the picture.
                let _floor = self.wires.floor();
                self.pile(file, Clock::wall(), piling, stop, go_on)?;
                inbox.collect(piling, go_on)
            }
        }
    }

    /// Makes the pile; the devices are released once it is at rest.
    fn pile(
        &self,
        file: &BenchFile,
        clock: Clock,
        piling: &Piling<'_>,
        stop: &AtomicBool,
        go_on: &mut dyn FnMut(&str) -> ControlFlow<()>,
    ) -> Result<(), Unpiled> {
        let _under_way = self.begin(piling);
        let mut stand = Stand::open(file, clock, &self.recorder.tap())?;
        self.wires.opened(stand.devices(), stand.stopper()?);
        // A stop may have come while the floor was taken, or be over already.
        let is_stopped = || self.wires.was_halted() || stop.load(Ordering::SeqCst);
        let poured = stand.pour(piling.procedure, &mut |what| match is_stopped() {
            true => ControlFlow::Break(()),
            false => go_on(what),
        });
        self.wires.closed();
        match (poured, is_stopped()) {
            (Ok(true), _) => Ok(()),
            (_, true) => {
                Err(Unpiled::Failed("stopped at the bench: the gate is closed".to_owned()))
            }
            (Ok(false), false) => Err(Unpiled::Stopped),
            (Err(error), false) => Err(error.into()),
        }
    }

    /// The pile being made: powder may be flowing. None while a pile is at rest and waits for its
    /// frames.
    pub fn piling(&self) -> Option<PileInMaking> {
        self.making().clone()
    }

    /// Takes the wire traffic of piles since the last call.
    pub fn exchanges(&self) -> Vec<Exchange> {
        self.recorder.take()
    }

    /// Where frames are uploaded; none if the camera is emulated.
    pub fn inbox(&self) -> Option<&Inbox> {
        match &self.place {
            Place::Emulated(_) => None,
            Place::Devices { inbox, .. } => Some(inbox),
        }
    }

    fn begin(&self, piling: &Piling<'_>) -> UntilMade<'_> {
        *self.making() = Some(PileInMaking { job: piling.job.to_owned(), pile: piling.number });
        UntilMade(self)
    }

    fn making(&self) -> MutexGuard<'_, Option<PileInMaking>> {
        self.making.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn photographed(piling: &Piling<'_>) -> Result<Vec<Upload>, Unpiled> {
    let none = || Unpiled::Failed("nothing says how steep the emulated powder piles".to_owned());
    let cone = Studio::drawn(piling.cone_deg.ok_or_else(none)?, piling.seed).cone;
    let scene = Scene::of(Surface::Cone(cone));
    let count = piling.procedure.frames as usize;
    let taken =
        frames(&scene, &Pose::default(), &Optics::default(), &Noise::default(), piling.seed, count);
    let uploads: Result<Vec<Upload>, _> = taken.iter().map(upload).collect();
    uploads.map_err(|error| Unpiled::Failed(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pile_that_waited_for_its_turn_while_stop_was_pressed_is_not_made() {
        let clock = Clock::standing();
        let spoon = Box::new(FormulaSpoon::new(Flow::default(), 1));
        let laboratory = Laboratory::start(lab::Settings::default(), clock, spoon).unwrap();
        let wires = Arc::<Wires>::default();
        let stand = PileStand::of_devices(laboratory.file(), wires.clone());
        let stop = AtomicBool::new(false);
        let floor = wires.floor();
        let (made, told) = std::thread::scope(|scope| {
            let making = scope.spawn(|| {
                let procedure = Procedure::default();
                let piling =
                    Piling { job: "m", number: 1, procedure: &procedure, cone_deg: None, seed: 1 };
                let mut told = 0;
                let made = stand.make(&piling, &stop, &mut |_| {
                    told += 1;
                    ControlFlow::Break(())
                });
                (made, told)
            });
            // As a stop does.
            stop.store(true, Ordering::SeqCst);
            wires.halt().unwrap();
            drop(floor);
            making.join().unwrap()
        });
        assert!(
            matches!(&made, Err(Unpiled::Failed(why)) if why.starts_with("stopped at the bench")),
            "{made:?}"
        );
        assert_eq!((told, laboratory.slide.opening()), (0, 0.0));
    }
}
