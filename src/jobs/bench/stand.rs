//! Makes piles and takes their pictures when an angle of repose is measured: with devices and
//! uploaded frames, or in an emulated laboratory with its own camera.

use super::apparatus::Wires;
use flip_bench::emulate::arm::{Flow, FormulaSpoon};
use flip_bench::emulate::camera::{Noise, Optics, Pose, Scene, Studio, Surface, frames, upload};
use flip_bench::emulate::lab::{self, Laboratory};
use flip_bench::hardware::DeviceError;
use flip_bench::hardware::bench_file::BenchFile;
use flip_bench::hardware::camera::Upload;
use flip_bench::hardware::clock::Clock;
use flip_bench::hardware::stand::{Procedure, Stand};
use flip_bench::hardware::wire::{Exchange, Tap};
use std::ops::ControlFlow;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Bench seconds per wall-clock second while an emulated gate is open: heartbeats run on wall-clock
/// time, so bench time must not stand still.
const SPEED: f64 = 50.0;
/// Timeout for the frames of a pile at rest.
const FRAMES_MAX: Duration = Duration::from_secs(15 * 60);
/// How often the callback is polled for a stop while waiting for frames.
const ASK_EVERY: Duration = Duration::from_millis(100);

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

/// Makes one pile and waits for its frames. Each step is reported; `Break` ends it with the gate
/// closed.
pub type Heaping = Arc<
    dyn Fn(&Piling<'_>, &mut dyn FnMut(&str) -> ControlFlow<()>) -> Result<Vec<Upload>, Unpiled>
        + Send
        + Sync,
>;

/// The stand where piles are made.
#[derive(Clone)]
pub struct PileStand {
    /// Makes one pile.
    pub heap: Heaping,
    /// Wire traffic since it was last taken.
    pub exchanges: Arc<Mutex<Vec<Exchange>>>,
    /// Inbox for uploaded frames; none if the camera is emulated.
    pub inbox: Option<Arc<Inbox>>,
    /// The pile being made.
    pub making: Making,
}

impl PileStand {
    /// The pile being made: powder may be flowing. None while a pile is at rest and waits for its
    /// frames.
    pub fn piling(&self) -> Option<PileInMaking> {
        self.making.locked().clone()
    }
}

/// A pile that is being made.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize, utoipa::ToSchema)]
pub struct PileInMaking {
    /// The measurement, by its job id.
    pub job: String,
    /// Which pile, from 1.
    pub pile: u32,
}

/// Which pile is being made, for status queries; cheap to clone.
#[derive(Debug, Clone, Default)]
pub struct Making(Arc<Mutex<Option<PileInMaking>>>);

/// Clears the pile being made when dropped, including on a panic.
struct UntilMade<'a>(&'a Making);

impl Making {
    fn begin(&self, piling: &Piling<'_>) -> UntilMade<'_> {
        *self.locked() = Some(PileInMaking { job: piling.job.to_owned(), pile: piling.number });
        UntilMade(self)
    }

    fn locked(&self) -> MutexGuard<'_, Option<PileInMaking>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for UntilMade<'_> {
    fn drop(&mut self) {
        *self.0.locked() = None;
    }
}

/// A laboratory for each pile, and a camera over a cone with the powder's angle.
pub(super) fn emulated(settings: lab::Settings, wires: Wires) -> PileStand {
    let (exchanges, tap) = recorder();
    let making = Making::default();
    let told = making.clone();
    let heap: Heaping = Arc::new(move |piling, go_on| {
        let clock = Clock::fast(SPEED);
        let spoon = Box::new(FormulaSpoon::new(Flow::default(), piling.seed));
        let laboratory =
            Laboratory::start(settings.clone(), clock.clone(), spoon).map_err(|error| {
                Unpiled::Failed(format!("the emulated laboratory cannot be set up: {error}"))
            })?;
        let _floor = wires.floor();
        let under_way = told.begin(piling);
        made(&wires, &tap, &laboratory.file(), clock, piling, go_on)?;
        drop(under_way);
        photographed(piling)
    });
    PileStand { heap, exchanges, inbox: None, making }
}

/// Buffer of exchanges, and the tap that fills it.
fn recorder() -> (Arc<Mutex<Vec<Exchange>>>, Tap) {
    let exchanges: Arc<Mutex<Vec<Exchange>>> = Arc::default();
    let hearing = exchanges.clone();
    (
        exchanges,
        Tap::new(move |exchange| {
            hearing.lock().unwrap_or_else(PoisonError::into_inner).push(exchange)
        }),
    )
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

/// The devices of this bench file; frames are uploaded.
pub(super) fn devices(file: BenchFile, wires: Wires) -> PileStand {
    let (exchanges, tap) = recorder();
    let inbox = Arc::new(Inbox::default());
    let arriving = inbox.clone();
    let making = Making::default();
    let told = making.clone();
    let heap: Heaping = Arc::new(move |piling, go_on| {
        // Held until the frames have arrived: the arm must not move into the picture.
        let _floor = wires.floor();
        let under_way = told.begin(piling);
        made(&wires, &tap, &file, Clock::wall(), piling, go_on)?;
        drop(under_way);
        arriving.collect(piling, go_on)
    });
    PileStand { heap, exchanges, inbox: Some(inbox), making }
}

/// Makes the pile; the devices are released once it is at rest.
fn made(
    wires: &Wires,
    tap: &Tap,
    file: &BenchFile,
    clock: Clock,
    piling: &Piling<'_>,
    go_on: &mut dyn FnMut(&str) -> ControlFlow<()>,
) -> Result<(), Unpiled> {
    let mut stand = Stand::open(file, clock, tap)?;
    wires.opened(stand.devices(), stand.stopper()?);
    let is_stopped = || wires.was_halted() || wires.is_held();
    let poured = stand.pour(piling.procedure, &mut |what| match is_stopped() {
        true => ControlFlow::Break(()),
        false => go_on(what),
    });
    wires.closed();
    match (poured, is_stopped()) {
        (Ok(true), _) => Ok(()),
        (_, true) => Err(Unpiled::Failed("stopped at the bench: the gate is closed".to_owned())),
        (Ok(false), false) => Err(Unpiled::Stopped),
        (Err(error), false) => Err(error.into()),
    }
}

/// Receives frames while a pile waits for them.
#[derive(Default)]
pub struct Inbox {
    waiting: Mutex<Option<Waiting>>,
    arrived: Condvar,
}

struct Waiting {
    job: String,
    number: u32,
    wanted: usize,
    uploads: Vec<Upload>,
}

/// The pile waiting for frames, and how many it has and needs.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize, utoipa::ToSchema,
)]
pub struct Awaited {
    /// Which pile, from 1.
    pub pile: u32,
    /// Frames received.
    pub have: u32,
    /// Frames needed.
    pub wanted: u32,
}

impl Inbox {
    /// The pile of this measurement that is waiting for frames.
    pub fn awaits(&self, job: &str) -> Option<Awaited> {
        self.locked().as_ref().filter(|it| it.job == job).map(Waiting::awaited)
    }

    /// Adds a frame; returns the pile's new count. `None`: no pile of this measurement is waiting
    /// for one.
    pub fn add(&self, job: &str, frame: Upload) -> Option<Awaited> {
        let mut waiting = self.locked();
        let open = waiting.as_mut().filter(|it| it.job == job && it.uploads.len() < it.wanted)?;
        open.uploads.push(frame);
        self.arrived.notify_all();
        Some(open.awaited())
    }

    fn collect(
        &self,
        piling: &Piling<'_>,
        go_on: &mut dyn FnMut(&str) -> ControlFlow<()>,
    ) -> Result<Vec<Upload>, Unpiled> {
        let wanted = piling.procedure.frames as usize;
        let job = piling.job.to_owned();
        *self.locked() = Some(Waiting { job, number: piling.number, wanted, uploads: Vec::new() });
        let until = Instant::now() + FRAMES_MAX;
        let collected = loop {
            let have = self.locked().as_ref().map_or(0, |it| it.uploads.len());
            let ended = match () {
                () if have >= wanted => Some(Ok(())),
                () if go_on(&format!("waits for frames, {have} of {wanted} have come"))
                    .is_break() =>
                {
                    Some(Err(Unpiled::Stopped))
                }
                () if Instant::now() >= until => {
                    let minutes = FRAMES_MAX.as_secs() / 60;
                    let cause = format!(
                        "{have} of {wanted} frames came within {minutes} minutes: is the camera's program running?"
                    );
                    Some(Err(Unpiled::Failed(cause)))
                }
                () => None,
            };
            if let Some(ended) = ended {
                break ended;
            }
            let waiting = self.locked();
            drop(self.arrived.wait_timeout(waiting, ASK_EVERY));
        };
        let waited = self.locked().take();
        collected.map(|()| waited.map_or_else(Vec::new, |it| it.uploads))
    }

    fn locked(&self) -> MutexGuard<'_, Option<Waiting>> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Waiting {
    fn awaited(&self) -> Awaited {
        Awaited { pile: self.number, have: self.uploads.len() as u32, wanted: self.wanted as u32 }
    }
}

#[cfg(test)]
mod tests {
    use super::super::apparatus::Pour;
    use super::*;
    use flip_core::domain::bench::BenchKind;
    use std::sync::atomic::Ordering;

    #[test]
    fn a_pile_that_waited_for_its_turn_while_stop_was_pressed_is_not_made() {
        let clock = Clock::standing();
        let spoon = Box::new(FormulaSpoon::new(Flow::default(), 1));
        let laboratory = Laboratory::start(lab::Settings::default(), clock, spoon).unwrap();
        let wires = Wires::default();
        let stand = devices(laboratory.file(), wires.clone());
        let pour: Pour = Arc::new(|_, _, _| unreachable!("nothing pours here"));
        let bench = wires.clone().apparatus(BenchKind::Devices, pour, Arc::new(|_| Ok(())), None);
        let floor = wires.floor();
        let making = std::thread::spawn(move || {
            let procedure = Procedure::default();
            let piling =
                Piling { job: "m", number: 1, procedure: &procedure, cone_deg: None, seed: 1 };
            let mut told = 0;
            let made = (stand.heap)(&piling, &mut |_| {
                told += 1;
                ControlFlow::Break(())
            });
            (made, told)
        });
        // As a stop does.
        bench.held.store(true, Ordering::SeqCst);
        (bench.halt)();
        drop(floor);
        let (made, told) = making.join().unwrap();
        assert!(
            matches!(&made, Err(Unpiled::Failed(why)) if why.starts_with("stopped at the bench")),
            "{made:?}"
        );
        assert_eq!((told, laboratory.slide.opening()), (0, 0.0));
    }

    fn frame(k: u8) -> Upload {
        Upload { depth: vec![k], colour: vec![], description: vec![] }
    }

    #[test]
    fn frames_are_taken_while_a_pile_waits_for_them_and_not_one_more() {
        let inbox = Arc::new(Inbox::default());
        assert_eq!(inbox.add("m", frame(0)), None);
        let procedure = Procedure { frames: 3, ..Procedure::default() };
        let waits = inbox.clone();
        let waiting = std::thread::spawn(move || {
            let piling =
                Piling { job: "m", number: 2, procedure: &procedure, cone_deg: None, seed: 1 };
            waits.collect(&piling, &mut |_| ControlFlow::Continue(()))
        });
        while inbox.awaits("m").is_none() {
            std::thread::yield_now();
        }
        assert_eq!((inbox.awaits("other"), inbox.add("other", frame(9))), (None, None));
        for k in 1..=3 {
            assert_eq!(
                inbox.add("m", frame(k)),
                Some(Awaited { pile: 2, have: u32::from(k), wanted: 3 })
            );
        }
        assert_eq!(inbox.add("m", frame(4)), None);
        assert_eq!(waiting.join().unwrap(), Ok(vec![frame(1), frame(2), frame(3)]));
        assert_eq!(inbox.awaits("m"), None);
    }

    #[test]
    fn whoever_stops_waiting_leaves_no_pile_that_waits() {
        let inbox = Inbox::default();
        let procedure = Procedure::default();
        let piling = Piling { job: "m", number: 1, procedure: &procedure, cone_deg: None, seed: 1 };
        assert_eq!(inbox.collect(&piling, &mut |_| ControlFlow::Break(())), Err(Unpiled::Stopped));
        assert_eq!(inbox.awaits("m"), None);
    }
}
