//! Trainings and evaluations: from calibrated sets to a policy and its errors.

use crate::harness::{
    calibrated, ended, functions, mg, open, open_in, trained, training_of, until, weigh,
};
use flip::app::{
    App, Episode, Error, EvaluationRequest, Functions, JobState, PageQuery, SERIES_LIMIT_MAX,
};
use flip::app::{Preset, Topic, TrainingRequest};
use flip::jobs::doses_on_cores;
use flip_bench::rig::{Simulation, Task};
use flip_core::domain::bench_check::{ExecutedShake, ShakeCalibration};
use flip_core::domain::motion::{MotionLimits, Move};
use flip_learn::train::evaluate::Dose;
use flip_policy::{self as policy, Controller};
use futures::StreamExt;
use std::sync::{Arc, Mutex};
use std::time::Duration;

async fn all_episodes(app: &App, id: &str) -> Vec<Episode> {
    app.training_episodes(id, PageQuery::first(SERIES_LIMIT_MAX)).await.unwrap().items
}

#[tokio::test(flavor = "multi_thread")]
async fn a_training_stores_its_episodes_and_a_policy_that_can_be_downloaded() {
    let (_folder, app) = open(functions()).await;
    let id = trained(&app, "sand").await;
    let card = app.policy(&id).await.unwrap();
    let bytes = app.policy_bytes(&id).await.unwrap();
    assert_eq!(
        (policy::id(&bytes), bytes.len() as u64, card.kind.as_str()),
        (id, card.size_bytes, "learned")
    );
    assert_eq!(policy::decode(&bytes).unwrap().manifest.episodes, 8);
    let training = app.training(&card.training.unwrap()).await.unwrap();
    assert_eq!((training.episodes, training.levels[0].powder.as_str()), (8, "sand"));
    assert_eq!(training.levels[0].sets.len(), 3);
    let episodes = all_episodes(&app, &training.job.id).await;
    assert!(
        episodes.len() == 8
            && episodes.iter().enumerate().all(|(k, episode)| episode.index as usize == k)
    );
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_powder_whose_calibration_found_no_set_is_refused_before_anything_is_computed() {
    let (folder, app) = open(functions()).await;
    calibrated(&app, "sand").await;
    // As an emulator leaves it whose simulator cannot reach the powder's angle.
    let database = flip_testing::pool(folder.path()).await;
    sqlx::query("DELETE FROM parameter_set").execute(&database).await.unwrap();
    database.close().await;
    let powders = Some(vec!["sand".to_owned()]);
    let evaluation = EvaluationRequest {
        powders: powders.clone(),
        controllers: Some(vec!["paced".into()]),
        ..Default::default()
    };
    let refused = app.start_evaluation(evaluation).await.unwrap_err().to_string();
    assert!(refused.contains("`sand` has no parameter set: run `flip calibrate"), "{refused}");
    let training = TrainingRequest { powders, ..Default::default() };
    let refused = app.start_training(training).await.unwrap_err().to_string();
    assert!(refused.contains("`sand` has no parameter set: run `flip calibrate"), "{refused}");
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_shut_down_training_resumes_and_ends_with_the_same_policy() {
    assert_eq!(events_of_a_resumed_training(|_| {}).await, 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_training_whose_checkpoint_is_lost_begins_again_says_so_and_ends_with_the_same_policy() {
    assert_eq!(events_of_a_resumed_training(|file| std::fs::remove_file(file).unwrap()).await, 1);
    assert_eq!(
        events_of_a_resumed_training(|file| std::fs::write(file, b"half").unwrap()).await,
        1
    );
}

/// How often a training that was shut down reports that its checkpoint is lost, after this damage
/// to the file.
async fn events_of_a_resumed_training(damage: impl Fn(&std::path::Path)) -> usize {
    let request = TrainingRequest { episodes: Some(40), ..training_of("sand", 40) };
    let (_folder, undisturbed) = open(functions()).await;
    calibrated(&undisturbed, "sand").await;
    let whole = undisturbed.start_training(request.clone()).await.unwrap().0;
    ended(&undisturbed, &whole.id).await;
    let whole_result = undisturbed.training(&whole.id).await.unwrap().result.unwrap();

    let folder = tempfile::tempdir().unwrap();
    let quick = functions();
    let slow_train = quick.train.clone();
    let slow = Functions {
        train: Arc::new(move |levels, settings, resume, flow, listener| {
            slow_train(levels, settings, resume, flow, &mut |event| {
                std::thread::sleep(Duration::from_millis(20));
                listener(event)
            })
        }),
        ..quick
    };
    let app = open_in(folder.path(), slow).await;
    calibrated(&app, "sand").await;
    let job = app.start_training(request).await.unwrap().0;
    until("eight episodes", async || all_episodes(&app, &job.id).await.len() >= 8).await;
    app.shutdown().await.unwrap();
    drop(app);
    walk(folder.path().join("blobs")).iter().for_each(|file| damage(file));

    let app = open_in(folder.path(), functions()).await;
    let job = ended(&app, &job.id).await;
    assert_eq!((job.state, job.attempts), (JobState::Succeeded, 1), "{:?}", job.error);
    assert_eq!(app.training(&job.id).await.unwrap().result.unwrap(), whole_result);
    assert_eq!(all_episodes(&app, &job.id).await, all_episodes(&undisturbed, &whole.id).await);
    // It is deleted after the job is reported as ended, not before: a row must never name a missing
    // file.
    until("no checkpoint", async || walk(folder.path().join("blobs")).is_empty()).await;
    let events: Vec<_> = app.events(Topic::Job(job.id.clone()), 0).await.unwrap().collect().await;
    app.shutdown().await.unwrap();
    undisturbed.shutdown().await.unwrap();
    events
        .iter()
        .filter(|event| event.as_ref().is_ok_and(|event| event.kind == "checkpoint_lost"))
        .count()
}

#[tokio::test(flavor = "multi_thread")]
async fn trainings_run_side_by_side_and_end_as_they_do_alone() {
    let (_folder, alone) = open(functions()).await;
    let (folder, quick) = (tempfile::tempdir().unwrap(), functions());
    // Each continues only when the other has begun: run sequentially they would wait forever.
    let (meeting, train) = (Arc::new(std::sync::Barrier::new(2)), quick.train.clone());
    let together = Functions {
        train: Arc::new(move |levels, settings, resume, flow, listener| {
            meeting.wait();
            train(levels, settings, resume, flow, listener)
        }),
        ..quick
    };
    let app = open_in(folder.path(), together).await;
    let mut found = Vec::new();
    for app in [&alone, &app] {
        calibrated(app, "sand").await;
        let mut jobs = Vec::new();
        for seed in [1, 2] {
            let request = TrainingRequest { seed: Some(seed), ..training_of("sand", 12) };
            jobs.push(app.start_training(request).await.unwrap().0);
        }
        let mut policies = Vec::new();
        for job in jobs {
            assert_eq!(ended(app, &job.id).await.state, JobState::Succeeded);
            policies.push(app.training(&job.id).await.unwrap().result.unwrap().policy);
        }
        found.push(policies);
    }
    assert_eq!(found[0], found[1]);
    assert_ne!(found[0][0], found[0][1]);
    app.shutdown().await.unwrap();
    alone.shutdown().await.unwrap();
}

fn walk(folder: std::path::PathBuf) -> Vec<std::path::PathBuf> {
    let entries =
        std::fs::read_dir(folder).into_iter().flatten().map(|entry| entry.unwrap().path());
    entries.flat_map(|path| if path.is_dir() { walk(path) } else { vec![path] }).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn an_evaluation_fills_the_table_and_decides_which_policy_weighs() {
    let worse = doses_on_cores(|task: &Task, simulation: &Simulation| {
        let dose = weigh(task, simulation)?;
        let more_mg = if matches!(task.controller, Controller::Paced(_)) { 0.25 } else { 0.0 };
        Ok(Dose { dispensed_mg: dose.dispensed_mg + more_mg, ..dose })
    });
    let (_folder, app) = open(Functions { weigh: worse, ..functions() }).await;
    let policy = trained(&app, "sand").await;
    calibrated(&app, "salt").await;
    let weighing = app.start_weighing(mg("sand", 15.0), "before-the-evaluation").await.unwrap().0;
    assert_eq!(weighing.policy, flip_policy::shipped().id, "a training alone is no evidence");
    let request = EvaluationRequest {
        powders: Some(vec!["sand".into(), "salt".into()]),
        controllers: Some(vec!["policy".into(), "fixed".into()]),
        repeats: Some(2),
        ..Default::default()
    };
    let (job, _) = app.start_evaluation(request.clone()).await.unwrap();
    let job = ended(&app, &job.id).await;
    assert_eq!(job.state, JobState::Succeeded, "{:?}", job.error);
    let evaluation = app.evaluation(&job.id).await.unwrap();
    assert!(evaluation.conditions.are_usual());
    let usual = request.clone();
    let unseen = EvaluationRequest {
        particles: Some(3000),
        extensions: [("rotation".to_owned(), 1.0)].into(),
        ..request
    };
    let (other, created) = app.start_evaluation(unseen).await.unwrap();
    assert!(created && other.id != job.id);
    assert_eq!(ended(&app, &other.id).await.state, JobState::Succeeded);
    let conditions = app.evaluation(&other.id).await.unwrap().conditions;
    assert_eq!((conditions.particles, conditions.extensions.rotation), (3000, 1.0));
    // Nor is a dose on a finer balance, or with more steps than a weighing has, evidence.
    for (readability_mg, max_shakes) in [(Some(0.1), None), (None, Some(30))] {
        let other = EvaluationRequest { readability_mg, max_shakes, ..usual.clone() };
        let (job, created) = app.start_evaluation(other).await.unwrap();
        assert!(created);
        assert_eq!(ended(&app, &job.id).await.state, JobState::Succeeded);
    }
    let result = evaluation.result.unwrap();
    assert_eq!(
        (evaluation.policy, result.rows.len(), result.summary.len()),
        (policy.clone(), 8, 2)
    );
    assert!(result.rows.iter().all(|row| row.n == 2 && (row.mae_mg - 0.25).abs() < 1e-9));
    let evaluated = app.policy(&policy).await.unwrap().evaluated;
    let powders: Vec<(&str, u32)> = evaluated.iter().map(|e| (e.powder.as_str(), e.n)).collect();
    assert_eq!(powders, [("salt", 4), ("sand", 4)]);
    let weighing = app.start_weighing(mg("sand", 15.0), "after-the-evaluation").await.unwrap().0;
    assert_eq!(
        weighing.policy,
        flip_policy::shipped().id,
        "it was not compared with the shipped one"
    );
    // In the shipped policy's own thirty steps.
    let both = Some(vec!["policy".into(), "paced".into()]);
    let compared = EvaluationRequest { controllers: both, max_shakes: Some(30), ..usual };
    let (job, _) = app.start_evaluation(compared).await.unwrap();
    assert_eq!(ended(&app, &job.id).await.state, JobState::Succeeded);
    let weighing = app.start_weighing(mg("sand", 15.0), "after-the-comparison").await.unwrap().0;
    assert_eq!(weighing.policy, policy, "it errs by 0.25 mg, the shipped one by 0.5 mg");
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_dose_is_simulated_at_the_substep_asked_for_and_is_then_no_evidence() {
    let seen = Arc::new(Mutex::new(Vec::new()));
    let kept = seen.clone();
    let watched = doses_on_cores(move |task: &Task, simulation: &Simulation| {
        kept.lock().unwrap().push(simulation.spoon.substep_s);
        weigh(task, simulation)
    });
    let (_folder, app) = open(Functions { weigh: watched, ..functions() }).await;
    calibrated(&app, "sand").await;
    let usual = EvaluationRequest {
        powders: Some(vec!["sand".into()]),
        controllers: Some(vec!["paced".into()]),
        repeats: Some(1),
        max_shakes: Some(30),
        ..Default::default()
    };
    let evaluated = async |substep_us| {
        let (job, created) =
            app.start_evaluation(EvaluationRequest { substep_us, ..usual.clone() }).await.unwrap();
        assert_eq!(ended(&app, &job.id).await.state, JobState::Succeeded);
        let substeps = std::mem::take(&mut *seen.lock().unwrap());
        (app.evaluation(&job.id).await.unwrap().conditions.substep_us, substeps, created)
    };
    let evidence = async || app.policy(&flip_policy::shipped().id).await.unwrap().evaluated.len();
    assert_eq!(evaluated(Some(20)).await, (Some(20), vec![20e-6; 2], true));
    assert_eq!(evidence().await, 0, "another solver is not the bench of weighings");
    assert_eq!(evaluated(None).await, (None, vec![80e-6; 2], true));
    assert_eq!(evidence().await, 1);
    assert_eq!(evaluated(Some(80)).await, (None, vec![], false), "the usual one is the same");
    for wrong in [9, 161] {
        let request = EvaluationRequest { substep_us: Some(wrong), ..usual.clone() };
        let Err(Error::Invalid(fields)) = app.start_evaluation(request).await else {
            panic!("{wrong} us were accepted");
        };
        assert_eq!(fields[0].field, "substep_us");
        assert!(fields[0].message.contains("from 10 to 160 us"), "{fields:?}");
    }
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_policy_that_is_asked_for_weighs_beside_its_rivals() {
    let (_folder, app) = open(functions()).await;
    let policy = trained(&app, "sand").await;
    for (asked, named, who) in [
        (None, &["pid", "fuzzy"][..], &["pid", "fuzzy"][..]),
        (Some(&policy), &["pid", "fuzzy"], &["policy", "pid", "fuzzy"]),
        (Some(&policy), &["pid", "policy"], &["pid", "policy"]),
    ] {
        let request = EvaluationRequest {
            policy: asked.cloned(),
            powders: Some(vec!["sand".into()]),
            controllers: Some(named.iter().map(|&name| name.to_owned()).collect()),
            repeats: Some(1),
            ..Default::default()
        };
        let (job, _) = app.start_evaluation(request).await.unwrap();
        assert_eq!(ended(&app, &job.id).await.state, JobState::Succeeded);
        let summary = app.evaluation(&job.id).await.unwrap().result.unwrap().summary;
        assert_eq!(
            summary.iter().map(|row| row.controller.as_str()).collect::<Vec<_>>(),
            who,
            "{asked:?} and {named:?}"
        );
    }
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn what_simple_controllers_come_to_does_not_depend_on_a_policy_that_does_not_weigh() {
    let (_folder, app) = open(functions()).await;
    calibrated(&app, "sand").await;
    let request = EvaluationRequest {
        powders: Some(vec!["sand".into()]),
        controllers: Some(vec!["paced".into(), "pid".into()]),
        repeats: Some(1),
        ..Default::default()
    };
    let (before, _) = app.start_evaluation(request.clone()).await.unwrap();
    assert_eq!(ended(&app, &before.id).await.state, JobState::Succeeded);
    // A policy trained on sets of sand, and the newest from now on.
    trained(&app, "sand").await;
    let (after, created) = app.start_evaluation(request).await.unwrap();
    assert!(!created && after.id == before.id, "the same evaluation is asked for");
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn missing_prerequisites_are_conflicts_that_name_the_command() {
    let (_folder, app) = open(functions()).await;
    let conflict = |result: Result<_, Error>| match result {
        Err(Error::Conflict { code, message }) => (code, message),
        Err(other) => panic!("{other:?}"),
        Ok(((), false | true)) => panic!("accepted"),
    };
    let train = async |request| {
        conflict(app.start_training(request).await.map(|(_, created)| ((), created)))
    };
    let (code, message) = train(TrainingRequest::default()).await;
    assert!(
        code == "calibration_missing" && message.contains("flip calibrate --powder sand"),
        "{message}"
    );
    let shaken = TrainingRequest { as_calibrated: true, ..Default::default() };
    let (code, message) = train(shaken).await;
    assert!(
        code == "shakes_not_calibrated" && message.contains("flip bench calibrate-shake"),
        "{message}"
    );
    let (code, message) =
        train(TrainingRequest { preset: Preset::Paper, ..Default::default() }).await;
    assert!(code == "calibration_missing" && message.contains("28 deg"), "{message}");
    let evaluate = app.start_evaluation(EvaluationRequest::default()).await;
    let (code, message) = conflict(evaluate.map(|(_, created)| ((), created)));
    assert!(
        code == "calibration_missing" && message.contains("flip calibrate --powder sand"),
        "{message}"
    );
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_training_shakes_as_the_arm_was_measured_to() {
    let (_folder, app) = open(functions()).await;
    calibrated(&app, "sand").await;
    let velocity = async |as_calibrated| {
        let request = TrainingRequest { as_calibrated, ..training_of("sand", 8) };
        let (job, _) = app.start_training(request).await.unwrap();
        ended(&app, &job.id).await;
        app.training(&job.id).await.unwrap().settings["spoon"]["shake"]["velocity_m_s"]
            .as_f64()
            .unwrap()
    };
    let usual = velocity(false).await;
    // Half as fast as planned.
    let shake = |commanded_mm: f64| {
        let top_mm_s = 1e3 * Move::new(commanded_mm * 1e-3, MotionLimits::BRISK).top_m_s();
        ExecutedShake {
            commanded_mm,
            executed_mm: commanded_mm,
            planned_mm_s: top_mm_s,
            peak_mm_s: top_mm_s / 2.0,
        }
    };
    app.keep_shakes(&ShakeCalibration::of([2.0, 4.0, 8.0].map(shake).to_vec()).unwrap())
        .await
        .unwrap();
    assert!((velocity(true).await / usual - 0.5).abs() < 1e-9);
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn requests_that_cannot_be_met_name_every_wrong_field() {
    let (_folder, app) = open(functions()).await;
    let policy = trained(&app, "sand").await;
    let fields = |error: Error| match error {
        Error::Invalid(fields) => fields.into_iter().map(|f| f.field).collect::<Vec<_>>(),
        other => panic!("{other:?}"),
    };
    let bad = EvaluationRequest {
        controllers: Some(vec!["policy".into(), "magic".into()]),
        targets_mg: Some(vec![15.0, f64::NAN, -1.0]),
        repeats: Some(0),
        particles: Some(6000),
        extensions: [("rotation".to_owned(), -1.0), ("wind".to_owned(), 1.0)].into(),
        ..Default::default()
    };
    let named = fields(app.start_evaluation(bad).await.unwrap_err());
    let conditions = ["particles", "extensions.rotation", "extensions.wind"];
    assert_eq!(
        named,
        [&["repeats", "controllers[1]", "targets_mg[1]", "targets_mg[2]"][..], &conditions]
            .concat()
    );
    // Half the grains are half the mass: a dose that the usual spoon holds is refused.
    let too_few = EvaluationRequest {
        policy: Some(policy.clone()),
        powders: Some(vec!["sand".into()]),
        targets_mg: Some(vec![20.0]),
        particles: Some(500),
        ..Default::default()
    };
    assert_eq!(fields(app.start_evaluation(too_few).await.unwrap_err()), ["targets_mg[0]"]);
    let too_much = EvaluationRequest {
        policy: Some(policy),
        powders: Some(vec!["sand".into()]),
        targets_mg: Some(vec![10.0, 500.0]),
        ..Default::default()
    };
    assert_eq!(fields(app.start_evaluation(too_much).await.unwrap_err()), ["targets_mg[1]"]);
    let unknown = EvaluationRequest { policy: Some("p-0".into()), ..Default::default() };
    assert_eq!(fields(app.start_evaluation(unknown).await.unwrap_err()), ["policy"]);
    let twice = TrainingRequest { episodes: Some(0), ..training_of("sand", 0) };
    let twice = TrainingRequest { powders: Some(vec!["sand".into(), "sand".into()]), ..twice };
    assert_eq!(fields(app.start_training(twice).await.unwrap_err()), ["episodes", "powders"]);
    let unknown = app.start_training(training_of("flour", 8)).await.unwrap_err();
    assert_eq!(fields(unknown), ["powders[0]"]);
    app.shutdown().await.unwrap();
}
