//! One job on several workers: the result is the same in every byte, whoever helps, dies or wakes up late.

use crate::harness::{calibration_of, ended, functions, heap, open, until, weigh};
use crate::spoons::{replay, request, shakes};
use crate::workers::{crew, served};
use flip::app::{
    App, Crew, EvaluationRequest, Functions, Hired, InvestigationRequest, Job, JobKind, JobState,
    Storage,
};
use flip::jobs::{DoseExperiment, Run, Runner, doses_on_cores, heaps_on_cores, spoons_on_cores};
use flip_bench::rig::{Simulation, Task};
use flip_learn::train::evaluate::Dose;
use sqlx::{AnyPool, AssertSqlSafe};
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

/// How long an experiment takes here.
const TAKES: Duration = Duration::from_millis(4);

/// Doses that differ, as the simulator's do.
fn dose(task: &Task, simulation: &Simulation) -> Result<Dose, String> {
    let mut dose = weigh(task, simulation)?;
    dose.dispensed_mg += (simulation.seed % 1000) as f64 / 3000.0;
    Ok(dose)
}

/// The formulas, each of which takes so long and is counted.
fn counted(count: &Arc<AtomicUsize>, one: Duration) -> Functions {
    let takes = |count: &Arc<AtomicUsize>| {
        let count = count.clone();
        move || {
            count.fetch_add(1, Ordering::SeqCst);
            std::thread::sleep(one);
        }
    };
    let (heaps, doses, spoons) = (takes(count), takes(count), takes(count));
    Functions {
        simulate: heaps_on_cores(move |set, settings, seed| {
            heaps();
            heap(set, settings, seed)
        }),
        weigh: doses_on_cores(move |task, simulation| {
            doses();
            dose(task, simulation)
        }),
        replay: spoons_on_cores(move |of| {
            spoons();
            Ok(replay(of))
        }),
        ..functions()
    }
}

/// A worker whose portions last some of these experiments.
fn quick(name: &str) -> Crew {
    Crew { portion: 20 * TAKES, threads: 1, ..crew(name) }
}

/// So many workers, each with its count of experiments.
async fn hire(storage: &Storage, many: usize) -> Vec<(Hired, Arc<AtomicUsize>)> {
    let mut hired = Vec::new();
    for name in ["one", "two", "three"].into_iter().take(many) {
        let count = Arc::<AtomicUsize>::default();
        let worker = Hired::start(storage, quick(name), counted(&count, TAKES)).await.unwrap();
        hired.push((worker, count));
    }
    hired
}

async fn succeeds(app: &App, job: &Job) {
    let job = ended(app, &job.id).await;
    assert_eq!((job.state, job.attempts), (JobState::Succeeded, 1), "{:?}", job.error);
}

fn evaluation(repeats: u32) -> EvaluationRequest {
    EvaluationRequest {
        powders: Some(vec!["sand".into()]),
        controllers: Some(["untrained", "fixed", "dispenser", "paced"].map(String::from).to_vec()),
        repeats: Some(repeats),
        ..Default::default()
    }
}

fn investigation() -> InvestigationRequest {
    request(shakes(0.8))
}

/// The results of the three kinds of jobs, as JSON without the times of day.
async fn results(app: &App) -> [String; 3] {
    let (calibration, _) = app.start_calibration(calibration_of("sand", 1)).await.unwrap();
    succeeds(app, &calibration).await;
    let (evaluation, _) = app.start_evaluation(evaluation(5)).await.unwrap();
    succeeds(app, &evaluation).await;
    let (investigation, _) = app.start_investigation(investigation()).await.unwrap();
    succeeds(app, &investigation).await;
    let calibration = app.calibration(&calibration.id).await.unwrap().result.unwrap();
    let evaluation = app.evaluation(&evaluation.id).await.unwrap().result.unwrap();
    let mut report = app.investigation(&investigation.id).await.unwrap().report.unwrap();
    report.wall_s = 0.0;
    [
        serde_json::to_string(&calibration).unwrap(),
        serde_json::to_string(&evaluation).unwrap(),
        serde_json::to_string(&report).unwrap(),
    ]
}

/// How many portions there are.
async fn portions(pool: &AnyPool, which: &str) -> i64 {
    let sql = format!("SELECT count(*) FROM portion WHERE {which}");
    sqlx::query_scalar(AssertSqlSafe(sql)).fetch_one(pool).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn three_kinds_of_jobs_give_the_same_bytes_on_one_worker_and_on_three() {
    let mut all = Vec::new();
    for many in [1, 3] {
        let Some((_folder, storage, app, pool)) = served().await else { return };
        let hired = hire(&storage, many).await;
        all.push(results(&app).await);
        assert_eq!(portions(&pool, "true").await, 0);
        for (worker, count) in hired {
            let count = count.load(Ordering::SeqCst);
            assert!(count > 10, "one of {many} workers carried out {count} experiments");
            worker.shutdown().await;
        }
        app.shutdown().await.unwrap();
    }
    assert_eq!(all[0], all[1]);
}

/// Doses on the thread that asks for them, as all tests share the threads for cores: all of them, or
/// the first alone, stand still until they are let go.
struct Standing {
    all: bool,
    stood: AtomicBool,
    gate: Arc<AtomicBool>,
    made: AtomicUsize,
}

impl Standing {
    fn still(all: bool) -> Arc<Self> {
        let (stood, gate, made) = Default::default();
        Arc::new(Self { all, stood, gate, made })
    }
}

impl Runner<DoseExperiment, Result<Dose, String>> for Standing {
    fn run(
        &self,
        experiments: &[DoseExperiment],
        each: &mut (dyn FnMut(usize, Run<Result<Dose, String>>) -> ControlFlow<()> + Send + '_),
    ) {
        for (place, of) in experiments.iter().enumerate() {
            let stands = self.all || !self.stood.swap(true, Ordering::SeqCst);
            while stands && !self.gate.load(Ordering::SeqCst) {
                std::thread::sleep(Duration::from_millis(5));
            }
            self.made.fetch_add(1, Ordering::SeqCst);
            let outcome = dose(&of.task, &of.simulation);
            if each(place, Run { outcome, seconds: TAKES.as_secs_f64() }).is_break() {
                return;
            }
        }
    }
}

/// An evaluation at worker `first`, with a portion at `second` that stands still until the gate opens.
struct Stuck {
    app: App,
    pool: AnyPool,
    job: Job,
    gate: Arc<AtomicBool>,
    first: Hired,
    second: Hired,
    _folder: tempfile::TempDir,
}

async fn stuck() -> Option<Stuck> {
    let (folder, storage, app, pool) = served().await?;
    // The job must not end before the second is there.
    let slow = counted(&Arc::default(), 5 * TAKES);
    let first = Hired::start(&storage, quick("first"), slow).await.unwrap();
    let (job, _) = app.start_calibration(calibration_of("sand", 1)).await.unwrap();
    succeeds(&app, &job).await;
    let weigh = Standing::still(true);
    let gate = weigh.gate.clone();
    let (job, _) = app.start_evaluation(evaluation(40)).await.unwrap();
    until("it runs", async || app.job(&job.id).await.unwrap().state == JobState::Running).await;
    let helps = Functions { weigh, ..functions() };
    let second = Hired::start(&storage, quick("second"), helps).await.unwrap();
    until("the second helps", async || portions(&pool, "owner IS NOT NULL").await > 0).await;
    let workers = app.workers().await.unwrap();
    assert!(workers.iter().all(|it| it.jobs == [job.id.as_str()]), "{workers:?}");
    Some(Stuck { app, pool, job, gate, first, second, _folder: folder })
}

/// The evaluation has the result that one process alone finds.
async fn is_as_alone(app: &App, evaluated: &Job) {
    let (_folder, alone) = open(counted(&Arc::default(), Duration::ZERO)).await;
    let (job, _) = alone.start_calibration(calibration_of("sand", 1)).await.unwrap();
    succeeds(&alone, &job).await;
    let (job, _) = alone.start_evaluation(evaluation(40)).await.unwrap();
    succeeds(&alone, &job).await;
    let [found, expected] = [
        app.evaluation(&evaluated.id).await.unwrap().result.unwrap(),
        alone.evaluation(&job.id).await.unwrap().result.unwrap(),
    ]
    .map(|result| serde_json::to_string(&result).unwrap());
    assert_eq!(found, expected);
    alone.shutdown().await.unwrap();
}

/// Ends all leases of portions, again and again.
async fn half_a_minute_passes(pool: &AnyPool) {
    let lapse = "UPDATE portion SET lease_until = 0 WHERE owner IS NOT NULL AND done_at IS NULL";
    loop {
        sqlx::query(lapse).execute(pool).await.unwrap();
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_portion_of_a_worker_that_died_is_taken_again_and_nothing_of_it_counts_later() {
    let Some(stuck) = stuck().await else { return };
    tokio::select! {
        () = succeeds(&stuck.app, &stuck.job) => {}
        () = half_a_minute_passes(&stuck.pool) => {}
    }
    let before = stuck.app.job(&stuck.job.id).await.unwrap();
    stuck.gate.store(true, Ordering::SeqCst);
    stuck.second.shutdown().await;
    assert_eq!(stuck.app.job(&stuck.job.id).await.unwrap(), before);
    is_as_alone(&stuck.app, &stuck.job).await;
    assert_eq!(portions(&stuck.pool, "true").await, 0);
    stuck.first.shutdown().await;
    stuck.app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_thread_that_finds_no_portion_waits_for_one_while_another_stands_still() {
    let Some((_folder, storage, app, pool)) = served().await else { return };
    let slow = counted(&Arc::default(), 5 * TAKES);
    let first = Hired::start(&storage, quick("first"), slow).await.unwrap();
    let (job, _) = app.start_calibration(calibration_of("sand", 1)).await.unwrap();
    succeeds(&app, &job).await;
    let stands = Standing::still(false);
    let helps = Functions { weigh: stands.clone(), ..functions() };
    let two = Crew { threads: 2, ..quick("second") };
    let (job, _) = app.start_evaluation(evaluation(40)).await.unwrap();
    until("it runs", async || app.job(&job.id).await.unwrap().state == JobState::Running).await;
    let second = Hired::start(&storage, two, helps).await.unwrap();
    // A worker that died: another takes the portion that stands still.
    tokio::select! {
        () = succeeds(&app, &job) => {}
        () = half_a_minute_passes(&pool) => {}
    }
    // Time to find that no portion is left.
    tokio::time::sleep(Duration::from_millis(300)).await;
    let before = stands.made.load(Ordering::SeqCst);
    let (job, _) = app.start_evaluation(evaluation(41)).await.unwrap();
    succeeds(&app, &job).await;
    let made = stands.made.load(Ordering::SeqCst);
    assert!(made > before, "the other thread helped no more");
    stands.gate.store(true, Ordering::SeqCst);
    for worker in [first, second] {
        worker.shutdown().await;
    }
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_that_is_stopped_gives_its_portion_back() {
    let Some(stuck) = stuck().await else { return };
    let stopping = tokio::spawn(stuck.second.shutdown());
    tokio::time::sleep(Duration::from_millis(100)).await;
    stuck.gate.store(true, Ordering::SeqCst);
    stopping.await.unwrap();
    succeeds(&stuck.app, &stuck.job).await;
    is_as_alone(&stuck.app, &stuck.job).await;
    stuck.first.shutdown().await;
    stuck.app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cancelled_job_is_cancelled_though_a_portion_of_it_stands_still() {
    let Some(stuck) = stuck().await else { return };
    stuck.app.cancel_job(&stuck.job.id).await.unwrap();
    assert_eq!(ended(&stuck.app, &stuck.job.id).await.state, JobState::Cancelled);
    assert_eq!(portions(&stuck.pool, "true").await, 0);
    stuck.gate.store(true, Ordering::SeqCst);
    stuck.second.shutdown().await;
    assert_eq!(portions(&stuck.pool, "true").await, 0);
    stuck.first.shutdown().await;
    stuck.app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_for_other_kinds_of_jobs_does_not_help() {
    let Some((_folder, storage, app, _pool)) = served().await else { return };
    let usual = counted(&Arc::default(), TAKES);
    let first = Hired::start(&storage, quick("first"), usual).await.unwrap();
    let other = Arc::<AtomicUsize>::default();
    let kinds = vec![JobKind::Evaluation];
    let second = Crew { kinds, ..quick("second") };
    let second = Hired::start(&storage, second, counted(&other, TAKES)).await.unwrap();
    let (job, _) = app.start_calibration(calibration_of("sand", 1)).await.unwrap();
    succeeds(&app, &job).await;
    assert_eq!(other.load(Ordering::SeqCst), 0);
    second.shutdown().await;
    first.shutdown().await;
    app.shutdown().await.unwrap();
}
