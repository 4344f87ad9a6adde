//! An extended version of the simulator: made by an investigation, then used to calibrate, train,
//! evaluate and weigh.

use crate::harness::{
    ToyRig, calibration_of, ended, functions, heap, mg, open, pour, training_of, weigh,
};
use flip::app::{
    App, CalibrationRequest, Error, EvaluationRequest, Functions, InvestigationRequest, Job,
    JobState, Report, TrainingRequest, WeighingRequest,
};
use flip::jobs::{doses_on_cores, heaps_on_cores};
use flip_bench::rig::{OnEvent, Pouring, Simulation, Task};
use flip_core::domain::bench::BenchKind;
use flip_core::domain::conditions::{Condition, Conditions};
use flip_core::domain::parameters::ParameterSet;
use flip_sim::repose::{Repose, Settings};
use serde_json::json;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

const CAMPAIGN: &str = include_str!("../../examples/campaigns/humidity.csv");
/// Degrees that water in the powder adds to the toy's heaps.
const STEEPENS_DEG: f64 = 28.0;

/// Records the toy's heaps and pours.
#[derive(Default)]
struct Seen {
    heaps: AtomicU32,
    /// Humidity of each dose's spoon.
    pours: Mutex<Vec<f64>>,
}

/// The harness's formulas, with heaps and spoons that respond to water.
fn wet(seen: &Arc<Seen>) -> Functions {
    let (of_heaps, of_pours, of_doses) = (seen.clone(), seen.clone(), seen.clone());
    let simulate = move |set: &ParameterSet, settings: &Settings, seed: u64| {
        of_heaps.heaps.fetch_add(1, Ordering::SeqCst);
        let dry = heap(set, settings, seed)?;
        Ok(Repose { tip_deg: dry.tip_deg + STEEPENS_DEG * settings.extensions.humidity, ..dry })
    };
    let pour = move |pouring: &Pouring, on_event: OnEvent<'_>, stop: &AtomicBool| {
        of_pours.pours.lock().unwrap().push(pouring.simulation.spoon.extensions.humidity);
        pour(pouring, on_event, stop)
    };
    let weigh = move |task: &Task, simulation: &Simulation| {
        of_doses.pours.lock().unwrap().push(simulation.spoon.extensions.humidity);
        weigh(task, simulation)
    };
    let rig = ToyRig::of(BenchKind::Simulated, pour);
    Functions {
        simulate: heaps_on_cores(simulate),
        weigh: doses_on_cores(weigh),
        rig,
        ..functions()
    }
}

fn campaign(budget_runs: u32) -> InvestigationRequest {
    InvestigationRequest {
        measurements_csv: Some(CAMPAIGN.to_owned()),
        simulations: Some(99),
        budget_runs: Some(budget_runs),
        seed: Some(1),
        ..InvestigationRequest::default()
    }
}

async fn succeeded(app: &App, job: &Job) {
    // An investigation takes longer than anything else tests wait for.
    for _ in 0..1200 {
        if app.job(&job.id).await.unwrap().state.is_terminal() {
            break;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    let job = ended(app, &job.id).await;
    assert_eq!(job.state, JobState::Succeeded, "{:?}", job.error);
}

async fn investigated(app: &App, budget_runs: u32) -> (Report, String) {
    let (job, _) = app.start_investigation(campaign(budget_runs)).await.unwrap();
    succeeded(app, &job).await;
    let report = app.investigation(&job.id).await.unwrap().report.unwrap();
    let version = report.simulator_version.extended.clone().expect("the extension is accepted");
    (report, version)
}

fn humid(percent: f64) -> Conditions {
    [("relative_humidity_pct".to_owned(), Condition::Number(percent))].into()
}

fn refused<T>(answer: Result<T, Error>) -> String {
    match answer {
        Err(Error::Invalid(errors)) => {
            errors.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")
        }
        Err(other) => panic!("{other:?}"),
        Ok(_) => panic!("it was accepted"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_an_investigation_accepts_is_calibrated_weighed_evaluated_and_trained_on() {
    let seen = Arc::new(Seen::default());
    let (_folder, app) = open(wet(&seen)).await;
    let (report, version) = investigated(&app, 60).await;
    assert!(report.simulator_version.verified, "{:?}", report.simulator_version);
    assert!(
        report.simulator_runs <= 60 && report.simulator_runs == seen.heaps.load(Ordering::SeqCst)
    );
    let numerics = report.numerics.unwrap();
    assert!(
        numerics.dependences.iter().all(|it| !it.is_defect)
            && numerics.set.source.starts_with("uncalibrated")
    );
    let (again, created) = app.start_investigation(campaign(60)).await.unwrap();
    assert!(
        !created,
        "the same investigation is the same job, and {} simulates nothing more",
        again.id
    );

    let body = app.simulator(&version).await.unwrap().body;
    let humidity = &body["extensions"][0];
    assert_eq!(
        (&humidity["mechanism"], &humidity["hook"]),
        (&json!("humidity"), &json!({"extension": "humidity"}))
    );
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    // The toy's heaps move by 28 deg per unit amplitude.
    let expected = number(&humidity["effect_deg"]) / STEEPENS_DEG;
    assert!((number(&humidity["amplitude"]["value"]) / expected - 1.0).abs() < 0.15, "{humidity}");
    assert_eq!(humidity["fit"]["verified"], json!(true));
    let driest = number(&humidity["through"][0]["reference"]);

    // Calibrated at the reference; the base has none of these sets.
    let request =
        CalibrationRequest { simulator: Some(version.clone()), ..calibration_of("sand", 1) };
    let (job, _) = app.start_calibration(request).await.unwrap();
    succeeded(&app, &job).await;
    let calibration = app.calibration(&job.id).await.unwrap();
    let sand =
        body["powders"].as_array().unwrap().iter().find(|it| it["powder"] == "sand").unwrap();
    assert_eq!(calibration.target.repose_deg, number(&sand["repose"]["repose_deg"]));
    assert_eq!(calibration.under.unwrap().simulator, version);
    let sets = app.powder("sand").await.unwrap().sets;
    assert!(
        !sets.is_empty()
            && sets.iter().all(|set| set.simulator.as_deref() == Some(version.as_str()))
    );
    let base = app.start_weighing(mg("sand", 10.0), "on-the-base").await;
    assert!(matches!(base, Err(Error::Conflict { code: "calibration_missing", .. })), "{base:?}");

    // Weighed under two conditions.
    let weighing = |percent: f64| WeighingRequest {
        simulator: Some(version.clone()),
        conditions: humid(percent),
        seed: Some(1),
        ..mg("sand", 10.0)
    };
    for (key, percent) in [("dry", driest), ("wet", driest + 20.0)] {
        let (weighing, _) = app.start_weighing(weighing(percent), key).await.unwrap();
        assert_eq!(weighing.under.unwrap().conditions, humid(percent));
        crate::harness::until("the dose is there", async || {
            app.weighing(&weighing.id).await.unwrap().weighing.outcome.is_some()
        })
        .await;
    }
    let pours = std::mem::take(&mut *seen.pours.lock().unwrap());
    assert!(pours.len() == 2 && pours[0] == 0.0 && pours[1] > 0.02, "{pours:?}");

    let request = EvaluationRequest {
        powders: Some(vec!["sand".into()]),
        targets_mg: Some(vec![10.0]),
        controllers: Some(vec!["policy".into()]),
        repeats: Some(2),
        simulator: Some(version.clone()),
        conditions: humid(driest + 20.0),
        ..Default::default()
    };
    let (job, _) = app.start_evaluation(request).await.unwrap();
    succeeded(&app, &job).await;
    let evaluation = app.evaluation(&job.id).await.unwrap();
    assert_eq!(evaluation.under.unwrap().simulator, version);
    assert_eq!(*seen.pours.lock().unwrap(), [pours[1]; 2]);
    let policy = app.policy(&evaluation.policy).await.unwrap();
    assert!(
        policy.evaluated.is_empty(),
        "doses on another bench are no evidence about weighings on the base"
    );

    let request = TrainingRequest {
        simulator: Some(version.clone()),
        surrogate_episodes: Some(0),
        ..training_of("sand", 8)
    };
    let (job, _) = app.start_training(request).await.unwrap();
    succeeded(&app, &job).await;
    let training = app.training(&job.id).await.unwrap();
    let policy = app.policy(&training.result.unwrap().policy).await.unwrap();
    let extended = &policy.manifest["settings"]["extended"];
    assert_eq!(
        (&extended["under"]["simulator"], training.under.unwrap().simulator),
        (&json!(version), version)
    );
    let days = extended["powders"]["sand"].as_array().unwrap();
    let wettest =
        days.iter().filter_map(|day| day["amplitudes"]["humidity"].as_f64()).fold(0.0, f64::max);
    assert!(days.len() == 64 && wettest > pours[1] * 0.9, "{wettest}");
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn without_a_budget_nothing_is_simulated_and_what_cannot_be_simulated_is_refused() {
    let seen = Arc::new(Seen::default());
    let (_folder, app) = open(wet(&seen)).await;
    let (report, version) = investigated(&app, 0).await;
    assert!(
        !report.simulator_version.verified
            && report.simulator_runs == 0
            && report.numerics.is_none()
    );
    assert_eq!(seen.heaps.load(Ordering::SeqCst), 0);
    assert!(app.simulator(&version).await.unwrap().body["extensions"][0]["fit"].is_null());

    let calibrate = async |simulator: &str, powder: &str, conditions: Conditions| {
        let request = CalibrationRequest {
            simulator: Some(simulator.to_owned()),
            conditions,
            ..calibration_of(powder, 1)
        };
        refused(app.start_calibration(request).await)
    };
    assert!(
        calibrate("sv-0", "sand", Conditions::new())
            .await
            .starts_with("simulator: there is no version `sv-0`")
    );
    assert!(
        calibrate("base", "sand", humid(50.0))
            .await
            .starts_with("conditions: are those of an extended version")
    );
    let outside = calibrate(&version, "sand", humid(99.0)).await;
    assert!(
        outside.starts_with("conditions.relative_humidity_pct: must be a number from "),
        "{outside}"
    );
    let bare = CalibrationRequest {
        repose_deg: Some(33.0),
        simulator: Some(version.clone()),
        ..CalibrationRequest { powder: None, ..calibration_of("sand", 1) }
    };
    assert!(
        refused(app.start_calibration(bare).await)
            .contains("say under which conditions it was measured")
    );
    let weighing = WeighingRequest { simulator: Some(version.clone()), ..mg("sand", 10.0) };
    let missing = refused(app.start_weighing(weighing, "k").await);
    assert!(missing.contains("conditions.relative_humidity_pct: is missing"), "{missing}");
    let evaluation = EvaluationRequest { conditions: humid(50.0), ..Default::default() };
    assert!(refused(app.start_evaluation(evaluation).await).contains("name it with `simulator`"));
    let too_many = InvestigationRequest { budget_runs: Some(10_001), ..campaign(0) };
    assert!(refused(app.start_investigation(too_many).await).contains("budget_runs"));
    app.shutdown().await.unwrap();
}
