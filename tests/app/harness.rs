//! One application per test, and the formulas it computes with.

use flip::app::{
    App, CalibrationMethod, CalibrationRequest, Functions, Job, JobState, Options, Storage, Target,
    Tolerance, Topic, TrainingRequest, WeighingRequest,
};
use flip::jobs::train::Train;
use flip::jobs::{Cards, doses_on_cores, heaps_on_cores, observables_on_cores, spoons_on_cores};
use flip_bench::hardware::DeviceError;
use flip_bench::rig::{OnEvent, Poured, Pouring, Rig, Simulation, Task};
use flip_bench::weigh::{Event, Phase};
use flip_core::domain::bench::{Action, BenchKind, Reading, Tick};
use flip_core::domain::conditions::Patch;
use flip_core::domain::observable::Observable;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::weighing::Outcome;
use flip_learn::train::evaluate::Dose;
use flip_learn::train::formula::Formula;
use flip_learn::train::train_on;
use flip_sim::batch::heaps::Heaps;
use flip_sim::batch::{Batch, Cores, Engine, Failed, Motion, Stand};
use flip_sim::dispense::Dispenser;
use flip_sim::repose::{self, Refusal, Repose};
use futures::StreamExt;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tempfile::TempDir;

/// Longest wait of a test.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// A heap whose angle grows with friction and cohesion, with a little noise by seed.
pub fn heap(set: &ParameterSet, settings: &repose::Settings, seed: u64) -> Result<Repose, Refusal> {
    let noise = (seed % 1000) as f64 / 1000.0 - 0.5;
    let tip_deg = 22.0 + 15.0 * set.friction() + 6.0 * set.cohesion() + 0.2 * noise;
    let (speed_rms_mm_s, particles_on_base, simulated_s) = (0.0, settings.particles, 1.0);
    let (overlap_mean, overlap_max) = (0.0, 0.0);
    let (cone_deg, creep_deg_per_s) = (tip_deg - 2.0, 0.0);
    Ok(Repose {
        tip_deg,
        tip_sd_deg: None,
        cone_deg,
        creep_deg_per_s,
        speed_rms_mm_s,
        particles_on_base,
        overlap_mean,
        overlap_max,
        simulated_s,
    })
}

/// An observable, reduced, that falls with friction and cohesion and knows the diameter.
pub fn observe(_: &Observable, set: &ParameterSet, _: &Patch, seed: u64) -> Result<f64, Refusal> {
    let noise = (seed % 1000) as f64 / 1000.0 - 0.5;
    Ok(4.0 - set.friction() - 0.5 * set.cohesion()
        + 5.0 * (set.particle_diameter_mm() - 0.27)
        + 0.02 * noise)
}

/// A training on spoons that follow a formula.
fn train() -> Train {
    Arc::new(|levels, settings, start, flow, listener| {
        train_on(&Formula { pitch: settings.rules.pitch }, levels, settings, start, flow, listener)
    })
}

/// A rig whose doses are computed by a function.
pub struct ToyRig<P> {
    pub kind: BenchKind,
    pub remembers: bool,
    pub pour: P,
}

impl<P> ToyRig<P>
where
    P: Fn(&Pouring, OnEvent<'_>, &AtomicBool) -> Poured + Send + Sync + 'static,
{
    pub fn of(kind: BenchKind, pour: P) -> Arc<dyn Rig> {
        Arc::new(Self { kind, remembers: false, pour })
    }
}

impl<P> Rig for ToyRig<P>
where
    P: Fn(&Pouring, OnEvent<'_>, &AtomicBool) -> Poured + Send + Sync,
{
    fn kind(&self) -> BenchKind {
        self.kind
    }

    fn exchanges_vials(&self) -> bool {
        true
    }

    fn pour(&self, pouring: &Pouring, on_event: OnEvent<'_>, stop: &AtomicBool) -> Poured {
        (self.pour)(pouring, on_event, stop)
    }

    fn halt(&self) -> Result<(), DeviceError> {
        Ok(())
    }

    fn readability_mg(&self) -> Option<f64> {
        Some(1.0)
    }

    fn remembers(&self) -> bool {
        self.remembers
    }
}

/// A dose of three ticks that overdoses by 0.25 mg; it stops when requested to.
pub fn pour(pouring: &Pouring, on_event: OnEvent<'_>, stop: &AtomicBool) -> Poured {
    let _recorded = on_event(&Event::Phase(Phase::Dosing));
    let mut ticks = Vec::new();
    let end_mg = pouring.task.order.target_mg + 0.25;
    for step in 0..3u32 {
        if stop.load(Ordering::SeqCst) {
            break;
        }
        let mass_mg = end_mg * f64::from(step) / 2.0;
        let reading = Reading { mass_mg, stable: true };
        let tick = Tick {
            step,
            t_s: f64::from(step),
            pitch_deg: 10.0,
            action: Action::default(),
            reading,
            spoonful: 1,
        };
        let _recorded = on_event(&Event::Tick(&tick));
        ticks.push(tick);
    }
    let reading_mg = ticks.last().map_or(0.0, |tick| tick.reading.mass_mg);
    let outcome = if ticks.len() == 3 { Outcome::Within } else { Outcome::Stopped };
    Poured {
        outcome,
        dispensed_mg: Some(reading_mg),
        reading_mg: Some(reading_mg),
        measured: None,
        shakes: 2,
        seconds: 2.0,
        ticks,
        stroke: None,
        error: None,
        must_look: None,
    }
}

/// The same dose, as evaluations weigh it.
pub fn weigh(task: &Task, _: &Simulation) -> Result<Dose, String> {
    let mg = task.order.target_mg + 0.25;
    Ok(Dose { dispensed_mg: mg, reading_mg: mg, shakes: 2, seconds: 2.0 })
}

/// A machine without a card.
pub struct NoCard;

impl Cards for NoCard {
    fn found(&self) -> Result<String, String> {
        Err("there is no driver in this test; use the CPU".to_owned())
    }
    fn open(&self) -> Result<Arc<dyn Engine>, String> {
        self.found().map(|_| unreachable!("none is found"))
    }
}

/// A card whose batches are those of the cores; one that breaks does so at a step of each batch.
#[derive(Default, Clone, Copy)]
pub struct ToyCard {
    pub breaks_at: Option<usize>,
}

impl Cards for ToyCard {
    fn found(&self) -> Result<String, String> {
        Ok(self.name())
    }
    fn open(&self) -> Result<Arc<dyn Engine>, String> {
        Ok(Arc::new(*self))
    }
}

impl Engine for ToyCard {
    fn name(&self) -> String {
        "a toy card".to_owned()
    }
    fn places(&self) -> usize {
        Cores.places()
    }
    fn batch(&self, places: usize) -> Result<Box<dyn Batch>, Failed> {
        let batch = Cores.batch(places)?;
        Ok(match self.breaks_at {
            Some(steps) => Box::new(Breaking { batch, steps }),
            None => batch,
        })
    }
    fn heaps(&self, places: usize) -> Result<Option<Box<dyn Heaps>>, Failed> {
        match self.breaks_at {
            Some(_) => Err(Failed("the toy card was taken away".to_owned())),
            None => Cores.heaps(places),
        }
    }
}

struct Breaking {
    batch: Box<dyn Batch>,
    /// Steps until it breaks.
    steps: usize,
}

impl Batch for Breaking {
    fn places(&self) -> usize {
        self.batch.places()
    }
    fn fill(&mut self, beds: &[(usize, &Dispenser)]) -> Result<(), Failed> {
        self.batch.fill(beds)
    }
    fn step(&mut self, motions: &[(usize, Motion)]) -> Result<Vec<Stand>, Failed> {
        self.steps = self.steps.saturating_sub(1);
        match self.steps {
            0 => Err(Failed("the toy card was taken away".to_owned())),
            _ => self.batch.step(motions),
        }
    }
}

/// The formulas.
pub fn functions() -> Functions {
    Functions {
        simulate: heaps_on_cores(heap),
        observe: observables_on_cores(observe),
        replay: spoons_on_cores(|_| panic!("this test replays no spoonful")),
        train: train(),
        weigh: doses_on_cores(weigh),
        rig: ToyRig::of(BenchKind::Simulated, pour),
        card: Arc::new(NoCard),
    }
}

/// A fresh data folder, opened with workers.
pub async fn open(functions: Functions) -> (TempDir, App) {
    let folder = tempfile::tempdir().unwrap();
    let app = open_in(folder.path(), functions).await;
    (folder, app)
}

/// Where the data folder's database is, on the database that tests run on.
pub async fn storage(folder: &Path) -> Storage {
    match flip_testing::database_url(folder).await {
        Some(url) => Storage::on_server(&url, folder).unwrap(),
        None => folder.into(),
    }
}

/// A data folder, opened with workers.
pub async fn open_in(folder: &Path, functions: Functions) -> App {
    App::open(storage(folder).await, Options { functions, ..Options::default() }).await.unwrap()
}

/// A calibration of a powder to three sets.
pub fn calibration_of(powder: &str, seed: u64) -> CalibrationRequest {
    let method = Some(CalibrationMethod::Sequential);
    CalibrationRequest {
        powder: Some(powder.into()),
        method,
        sets: Some(3),
        seed: Some(seed),
        ..Default::default()
    }
}

/// The job once it has ended.
pub async fn ended(app: &App, id: &str) -> Job {
    let mut events = app.events(Topic::Job(id.into()), 0).await.unwrap();
    let drained = async { while events.next().await.is_some() {} };
    tokio::time::timeout(PATIENCE, drained).await.expect("the job ends in time");
    let job = app.job(id).await.unwrap();
    assert!(job.state.is_terminal());
    job
}

/// Calibrates a powder and returns the job.
pub async fn calibrated(app: &App, powder: &str) -> Job {
    let (job, _) = app.start_calibration(calibration_of(powder, 1)).await.unwrap();
    let job = ended(app, &job.id).await;
    assert_eq!(job.state, JobState::Succeeded, "{:?}", job.error);
    job
}

/// A training of a few random episodes on one powder.
pub fn training_of(powder: &str, episodes: u32) -> TrainingRequest {
    TrainingRequest {
        powders: Some(vec![powder.into()]),
        episodes: Some(episodes),
        ..Default::default()
    }
}

/// Calibrates a powder, trains on it, and returns the policy's id.
pub async fn trained(app: &App, powder: &str) -> String {
    calibrated(app, powder).await;
    let (job, _) = app.start_training(training_of(powder, 8)).await.unwrap();
    let job = ended(app, &job.id).await;
    assert_eq!(job.state, JobState::Succeeded, "{:?}", job.error);
    app.training(&job.id).await.unwrap().result.unwrap().policy
}

/// Waits until `test` holds.
pub async fn until<F: Future<Output = bool>>(what: &str, mut test: impl FnMut() -> F) {
    let deadline = tokio::time::Instant::now() + PATIENCE;
    while !test().await {
        assert!(tokio::time::Instant::now() < deadline, "{what}: not in time");
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
}

/// A request for this mass of a powder, within a milligram.
pub fn mg(powder: &str, value: f64) -> WeighingRequest {
    WeighingRequest {
        bench_name: None,
        powder: powder.into(),
        target: Target { value, unit: "mg".into() },
        tolerance: Tolerance { lower: 1.0, upper: 1.0, unit: "mg".into() },
        policy: None,
        seed: None,
        simulator: None,
        conditions: Default::default(),
        asked: Default::default(),
        vial_check: Default::default(),
        reservation: None,
        labels: Default::default(),
    }
}
