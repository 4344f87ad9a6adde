//! Jobs that ask for a graphics card: who may ask, who takes them, and what they say of it.

use crate::harness::{ToyCard, calibrated, ended, functions, open};
use crate::workers::{crew, served};
use flip::app::{
    App, CalibrationMethod, CalibrationRequest, Error, EvaluationRequest, Functions, Gradients,
    Hired, JobKind, JobState, PageQuery, TrainingRequest,
};
use flip_core::domain::device::Device;
use flip_core::domain::observable::{Observable, Observation};
use flip_sim::repose::{Settings, repose};
use std::sync::Arc;
use std::time::Duration;

/// An evaluation of one dose of a small spoonful on a card.
fn on_card() -> EvaluationRequest {
    EvaluationRequest {
        powders: Some(vec!["sand".into()]),
        controllers: Some(vec!["paced".into()]),
        targets_mg: Some(vec![3.0]),
        repeats: Some(1),
        particles: Some(500),
        device: Device::Cuda,
        ..Default::default()
    }
}

fn with_card(card: ToyCard) -> Functions {
    Functions { card: Arc::new(card), ..functions() }
}

async fn refused(app: &App, request: EvaluationRequest) -> (String, String) {
    let Err(Error::Invalid(mut fields)) = app.start_evaluation(request).await else {
        panic!("it was accepted");
    };
    assert_eq!(fields.len(), 1, "{fields:?}");
    let field = fields.remove(0);
    (field.field, field.message)
}

#[tokio::test(flavor = "multi_thread")]
async fn without_a_card_it_is_refused_at_once_with_what_was_found_and_what_to_do() {
    let (_folder, app) = open(functions()).await;
    calibrated(&app, "sand").await;
    let (field, message) = refused(&app, on_card()).await;
    assert_eq!(field, "device");
    for said in ["no driver in this test", "leaving this field out"] {
        assert!(message.contains(said), "{message}");
    }
    let training = TrainingRequest {
        powders: Some(vec!["sand".into()]),
        device: Device::Cuda,
        ..Default::default()
    };
    let Err(Error::Invalid(fields)) = app.start_training(training).await else {
        panic!("it was accepted");
    };
    assert_eq!(fields[0].field, "device");
    let jobs = app.jobs(Default::default(), Default::default()).await.unwrap().items;
    assert!(jobs.iter().all(|job| job.kind == JobKind::Calibration), "{jobs:?}");
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn an_evaluation_on_a_card_is_another_job_names_the_card_and_is_no_evidence() {
    let (_folder, app) = open(with_card(ToyCard::default())).await;
    calibrated(&app, "sand").await;
    let usual = EvaluationRequest { particles: None, max_shakes: Some(30), ..on_card() };
    let (job, _) = app.start_evaluation(usual.clone()).await.unwrap();
    assert_eq!(job.subject.device, Device::Cuda);
    let job = ended(&app, &job.id).await;
    assert_eq!(job.state, JobState::Succeeded, "{:?}", job.error);
    let found = app.evaluation(&job.id).await.unwrap();
    assert_eq!(found.device, Device::Cuda);
    assert_eq!(found.result.unwrap().card.as_deref(), Some("a toy card"));
    let evidence = async || app.policy(&flip_policy::shipped().id).await.unwrap().evaluated.len();
    assert_eq!(evidence().await, 0);
    let (same, created) = app.start_evaluation(usual.clone()).await.unwrap();
    assert!(!created && same.id == job.id);
    let on_cpu = EvaluationRequest { device: Device::Cpu, ..usual };
    let (other, created) = app.start_evaluation(on_cpu).await.unwrap();
    assert!(created && other.id != job.id);
    assert_eq!(ended(&app, &other.id).await.state, JobState::Succeeded);
    let found = app.evaluation(&other.id).await.unwrap();
    let text = serde_json::to_string(&found).unwrap();
    assert!(!text.contains("device") && !text.contains("card"), "{text}");
    assert_eq!(evidence().await, 1);
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn grains_that_a_card_has_no_room_for_are_refused_with_their_number() {
    let (_folder, app) = open(with_card(ToyCard::default())).await;
    calibrated(&app, "sand").await;
    let many = EvaluationRequest { particles: Some(3000), ..on_card() };
    let (field, message) = refused(&app, many).await;
    assert!(field == "device" && message.contains("3000 grains"), "{message}");
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_card_that_breaks_is_a_failed_job_that_says_so_and_the_next_job_runs() {
    let (_folder, app) = open(with_card(ToyCard { breaks_at: Some(2) })).await;
    calibrated(&app, "sand").await;
    let (job, _) = app.start_evaluation(on_card()).await.unwrap();
    let job = ended(&app, &job.id).await;
    assert_eq!((job.state, job.attempts), (JobState::Failed, 1));
    let error = job.error.unwrap();
    assert!(error.contains("the toy card was taken away"), "{error}");
    let on_cpu = EvaluationRequest { device: Device::Cpu, ..on_card() };
    let (job, _) = app.start_evaluation(on_cpu).await.unwrap();
    assert_eq!(ended(&app, &job.id).await.state, JobState::Succeeded);
    app.shutdown().await.unwrap();
}

/// A calibration of one set to within 5 deg, with heaps that take milliseconds.
fn calibration_on_card() -> CalibrationRequest {
    CalibrationRequest {
        repose_deg: Some(28.0),
        method: Some(CalibrationMethod::Sequential),
        sets: Some(1),
        tolerance_deg: Some(5.0),
        particles: Some(200),
        trials_max: Some(40),
        device: Device::Cuda,
        ..Default::default()
    }
}

async fn no_calibration(app: &App, request: CalibrationRequest) -> String {
    let Err(Error::Invalid(fields)) = app.start_calibration(request).await else {
        panic!("it was accepted");
    };
    assert_eq!((fields.len(), fields[0].field.as_str()), (1, "device"), "{fields:?}");
    fields[0].message.clone()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_calibration_pours_its_heaps_on_a_card_and_one_that_breaks_is_said() {
    let (_folder, app) = open(with_card(ToyCard::default())).await;
    let (job, _) = app.start_calibration(calibration_on_card()).await.unwrap();
    assert_eq!(job.subject.device, Device::Cuda);
    let job = ended(&app, &job.id).await;
    assert_eq!(job.state, JobState::Succeeded, "{:?}", job.error);
    let found = app.calibration(&job.id).await.unwrap();
    assert_eq!(found.device, Device::Cuda);
    // The card of this test pours true heaps; the runner on its cores has a formula.
    let poured = app.trials(&job.id, PageQuery::default()).await.unwrap().items;
    let first = poured.iter().find(|trial| trial.tip_deg.is_some()).unwrap();
    let settings = Settings { readings: first.readings, ..Settings::with_particles(200) };
    let alone = repose(&first.parameters, &settings, first.seed).unwrap();
    assert!((first.tip_deg.unwrap() - alone.tip_deg).abs() < 0.01, "{first:?} {alone:?}");
    let on_cpu = CalibrationRequest { device: Device::Cpu, ..calibration_on_card() };
    let (other, created) = app.start_calibration(on_cpu).await.unwrap();
    assert!(created && other.id != job.id);
    let large =
        CalibrationRequest { verify_particles: Some(4000), method: None, ..calibration_on_card() };
    assert!(no_calibration(&app, large).await.contains("4000 grains in a heap"));
    app.shutdown().await.unwrap();

    let (_folder, app) = open(functions()).await;
    assert!(no_calibration(&app, calibration_on_card()).await.contains("no driver in this test"));
    app.shutdown().await.unwrap();

    let (_folder, app) = open(with_card(ToyCard { breaks_at: Some(1) })).await;
    let (job, _) = app.start_calibration(calibration_on_card()).await.unwrap();
    let failed = ended(&app, &job.id).await;
    assert_eq!((failed.state, failed.attempts), (JobState::Failed, 1));
    let error = failed.error.unwrap();
    assert!(
        error.contains("the toy card was taken away") && error.contains("device: cpu"),
        "{error}"
    );
    assert!(app.trials(&job.id, PageQuery::default()).await.unwrap().items.is_empty());
    let (again, _) = app.start_again(&job.id, Some(Device::Cpu)).await.unwrap();
    assert_eq!(ended(&app, &again.id).await.state, JobState::Succeeded);
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn other_measurements_are_for_the_processor() {
    let (_folder, app) = open(with_card(ToyCard::default())).await;
    let drained =
        Observation { observable: Observable::DrainedAngle {}, mean: 33.6, sd: 0.1, n: 5 };
    let request = CalibrationRequest {
        observations: Some(vec![drained]),
        method: Some(CalibrationMethod::Emulator),
        ..calibration_on_card()
    };
    assert!(no_calibration(&app, request).await.contains("other measurements"));
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_training_whose_card_breaks_goes_on_from_its_checkpoint_on_the_processor() {
    let (_folder, app) = open(with_card(ToyCard { breaks_at: Some(2) })).await;
    calibrated(&app, "sand").await;
    let request = TrainingRequest {
        powders: Some(vec!["sand".into()]),
        episodes: Some(6),
        surrogate_episodes: Some(2),
        device: Device::Cuda,
        ..Default::default()
    };
    let (job, _) = app.start_training(request).await.unwrap();
    let failed = ended(&app, &job.id).await;
    assert_eq!((failed.state, failed.attempts), (JobState::Failed, 1));
    let error = failed.error.unwrap();
    for said in ["the toy card was taken away", "device: cpu"] {
        assert!(error.contains(said), "{error}");
    }
    let episodes = async |id: &str| {
        let all = app.training_episodes(id, PageQuery::default()).await.unwrap().items;
        all.iter().map(|it| (it.index, it.dispensed_mg.to_bits())).collect::<Vec<_>>()
    };
    let before = episodes(&job.id).await;
    assert_eq!(before.len(), 2, "the surrogate's were saved");
    let (again, created) = app.start_again(&job.id, Some(Device::Cpu)).await.unwrap();
    assert!(created && again.again_of.as_deref() == Some(job.id.as_str()));
    assert_eq!(again.subject.device, Device::Cpu);
    let done = ended(&app, &again.id).await;
    assert_eq!(done.state, JobState::Succeeded, "{:?}", done.error);
    // Those before the checkpoint were not played again.
    let indices: Vec<u32> = episodes(&again.id).await.iter().map(|it| it.0).collect();
    assert_eq!(indices, [2, 3, 4, 5]);
    let result = app.training(&again.id).await.unwrap().result.unwrap();
    assert_eq!((result.episodes, result.card.as_deref()), (6, Some("a card, until it failed")));
    // Asked for once more, it is the same job; a card is not forced upon what was for the processor.
    let (same, created) = app.start_again(&job.id, Some(Device::Cpu)).await.unwrap();
    assert!(!created && same.id == again.id);
    let (job, _) = app.start_evaluation(on_card()).await.unwrap();
    assert_eq!(ended(&app, &job.id).await.state, JobState::Failed);
    let (again, _) = app.start_again(&job.id, Some(Device::Cpu)).await.unwrap();
    assert_eq!(ended(&app, &again.id).await.state, JobState::Succeeded);
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_training_has_our_own_gradients_on_a_card_and_libtorchs_elsewhere_unless_it_says() {
    let (_folder, app) = open(with_card(ToyCard::default())).await;
    calibrated(&app, "sand").await;
    let request = |device, gradients| TrainingRequest {
        powders: Some(vec!["sand".into()]),
        episodes: Some(4),
        surrogate_episodes: Some(4),
        device,
        gradients,
        ..Default::default()
    };
    let begun =
        async |device, gradients| app.start_training(request(device, gradients)).await.unwrap();
    let (libtorch, fused) = (Some(Gradients::Libtorch), Some(Gradients::Fused));
    let mut ids = std::collections::HashSet::new();
    for (device, usual, other) in [(Device::Cpu, libtorch, fused), (Device::Cuda, fused, libtorch)]
    {
        let (job, created) = begun(device, None).await;
        assert!(created && ids.insert(job.id.clone()));
        let (same, created) = begun(device, usual).await;
        assert!(!created && same.id == job.id, "{device:?}");
        let (another, created) = begun(device, other).await;
        assert!(created && ids.insert(another.id.clone()), "{device:?}");
        for (id, gradients) in [(job.id, usual), (another.id, other)] {
            let job = ended(&app, &id).await;
            assert_eq!(job.state, JobState::Succeeded, "{:?}", job.error);
            let settings = app.training(&id).await.unwrap().settings;
            let said = (gradients == fused).then_some("fused");
            assert_eq!(settings["gradients"].as_str(), said, "{device:?}");
        }
    }
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_for_a_card_waits_for_a_worker_with_one_and_holds_up_nobody() {
    let Some((_folder, storage, app, pool)) = served().await else { return };
    // Nobody has a card yet.
    let without = Hired::start(&storage, crew("without"), functions()).await.unwrap();
    calibrated(&app, "sand").await;
    let (field, message) = refused(&app, on_card()).await;
    assert!(field == "device" && message.contains("flip worker"), "{message}");
    // One is said to have a card, and has none.
    let told = "UPDATE worker SET card = 'a card' WHERE name = 'without'";
    sqlx::query(told).execute(&pool).await.unwrap();
    let (job, _) = app.start_evaluation(on_card()).await.unwrap();
    // A later one for the processor overtakes it.
    let (other, _) =
        app.start_evaluation(EvaluationRequest { device: Device::Cpu, ..on_card() }).await.unwrap();
    assert_eq!(ended(&app, &other.id).await.state, JobState::Succeeded);
    tokio::time::sleep(Duration::from_millis(300)).await;
    assert_eq!(app.job(&job.id).await.unwrap().state, JobState::Queued);
    let card = with_card(ToyCard::default());
    let with = Hired::start(&storage, crew("with"), card).await.unwrap();
    assert_eq!(with.card(), Some("a toy card"));
    let done = ended(&app, &job.id).await;
    assert_eq!(done.state, JobState::Succeeded, "{:?}", done.error);
    let workers = app.workers().await.unwrap();
    let with_id = with.id();
    let of = |id: &str| workers.iter().find(|it| it.id == id).unwrap().card.clone();
    assert_eq!(of(with_id).as_deref(), Some("a toy card"));
    for worker in [without, with] {
        worker.shutdown().await;
    }
    app.shutdown().await.unwrap();
}
