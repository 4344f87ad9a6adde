//! Calibrations: requested twice, resumed, cancelled, refused.

use crate::harness::{
    PATIENCE, calibrated, calibration_of, ended, functions, heap, open, open_in, storage, until,
};
use flip::app::{App, CalibrationMethod, CalibrationRequest};
use flip::app::{
    Error, Functions, JobState, JobsWanted, PageQuery, SERIES_LIMIT_MAX, Topic, Trial,
};
use flip::jobs::heaps_on_cores;
use flip_core::domain::observable::{Observable, Observation};
use futures::StreamExt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

async fn all_trials(app: &App, id: &str) -> Vec<Trial> {
    let trials = app.trials(id, PageQuery::first(SERIES_LIMIT_MAX)).await.unwrap().items;
    assert!(trials.iter().all(|trial| trial.seconds.is_some_and(|seconds| seconds >= 0.0)));
    trials.into_iter().map(|trial| Trial { seconds: None, ..trial }).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_powder_is_calibrated_and_its_sets_are_stored() {
    let (_folder, app) = open(functions()).await;
    let job = calibrated(&app, "salt").await;
    let calibration = app.calibration(&job.id).await.unwrap();
    let result = calibration.result.unwrap();
    assert_eq!((calibration.powder.as_deref(), result.sets.len()), (Some("salt"), 3));
    assert!(result.sets.iter().all(|set| set.error_deg <= 1.5));
    let powder = app.powder("salt").await.unwrap();
    let mut stored: Vec<String> = powder.sets.iter().map(|set| set.id.clone()).collect();
    let mut kept: Vec<String> = result.sets.iter().map(|set| set.id.clone()).collect();
    stored.sort();
    kept.sort();
    assert_eq!(stored, kept);
    let trials = all_trials(&app, &job.id).await;
    assert_eq!(trials.len() as u32, result.evaluations + result.verification_runs);
    assert!(trials.iter().enumerate().all(|(k, trial)| trial.index as usize == k));
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn asking_again_finds_the_job_that_did_it_and_a_failed_one_is_done_anew() {
    let (_folder, app) = open(functions()).await;
    let job = calibrated(&app, "sand").await;
    let (again, created) = app.start_calibration(calibration_of("sand", 1)).await.unwrap();
    assert_eq!((again.id, again.state, created), (job.id.clone(), JobState::Succeeded, false));
    let (other, created) = app.start_calibration(calibration_of("sand", 2)).await.unwrap();
    assert!(created && other.id != job.id);
    // Ten trials cannot find a hundred sets.
    let hopeless =
        CalibrationRequest { sets: Some(100), trials_max: Some(10), ..calibration_of("sand", 1) };
    let (failing, _) = app.start_calibration(hopeless.clone()).await.unwrap();
    let failed = ended(&app, &failing.id).await;
    assert_eq!(failed.state, JobState::Failed);
    assert!(failed.error.unwrap().contains("of 100 sets"));
    assert!(app.start_calibration(hopeless).await.unwrap().1);
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_shut_down_calibration_resumes_and_ends_as_if_it_had_never_stopped() {
    let (_folder, undisturbed) = open(functions()).await;
    let whole = calibrated(&undisturbed, "sugar").await;
    let whole_result = undisturbed.calibration(&whole.id).await.unwrap().result.unwrap();

    let folder = tempfile::tempdir().unwrap();
    let simulated = Arc::new(AtomicUsize::new(0));
    let counted = simulated.clone();
    let slow = Functions {
        simulate: heaps_on_cores(move |set, settings, seed| {
            counted.fetch_add(1, Ordering::SeqCst);
            std::thread::sleep(Duration::from_millis(20));
            heap(set, settings, seed)
        }),
        ..functions()
    };
    let app = open_in(folder.path(), slow.clone()).await;
    let (job, _) = app.start_calibration(calibration_of("sugar", 1)).await.unwrap();
    until("five trials", async || all_trials(&app, &job.id).await.len() >= 5).await;
    app.shutdown().await.unwrap();
    drop(app);

    let app = open_in(folder.path(), slow).await;
    let job = ended(&app, &job.id).await;
    assert_eq!((job.state, job.attempts), (JobState::Succeeded, 1), "a shutdown burns no attempt");
    assert_eq!(app.calibration(&job.id).await.unwrap().result.unwrap(), whole_result);
    assert_eq!(all_trials(&app, &job.id).await, all_trials(&undisturbed, &whole.id).await);
    let repeated = simulated.load(Ordering::SeqCst) - all_trials(&app, &job.id).await.len();
    assert!(
        repeated <= 4,
        "{repeated} trials were simulated twice; only a batch that was not saved may be"
    );
    app.shutdown().await.unwrap();
    undisturbed.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_running_calibration_is_cancelled_between_two_trials_and_a_waiting_one_at_once() {
    let slow = Functions {
        simulate: heaps_on_cores(|set, settings, seed| {
            std::thread::sleep(Duration::from_millis(30));
            heap(set, settings, seed)
        }),
        ..functions()
    };
    let (_folder, app) = open(slow).await;
    let (running, _) = app.start_calibration(calibration_of("sand", 1)).await.unwrap();
    let (waiting, _) = app.start_calibration(calibration_of("salt", 1)).await.unwrap();
    until("a trial", async || !all_trials(&app, &running.id).await.is_empty()).await;
    assert_eq!(app.cancel_job(&waiting.id).await.unwrap().state, JobState::Cancelled);
    assert!(app.cancel_job(&running.id).await.unwrap().cancelling);
    assert_eq!(ended(&app, &running.id).await.state, JobState::Cancelled);
    assert!(matches!(
        app.cancel_job(&running.id).await,
        Err(Error::Conflict { code: "job_finished", .. })
    ));
    assert!(matches!(
        app.cancel_job("no-such-job").await,
        Err(Error::NotFound { what: "job", .. })
    ));
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn followers_hear_every_trial_once_and_resume_where_they_stopped() {
    let (_folder, app) = open(functions()).await;
    let job = calibrated(&app, "sand").await;
    let events: Vec<_> = app
        .events(Topic::Job(job.id.clone()), 0)
        .await
        .unwrap()
        .map(Result::unwrap)
        .collect()
        .await;
    assert!(events.windows(2).all(|pair| pair[0].seq < pair[1].seq));
    let trials = events.iter().filter(|event| event.kind == "trial").count();
    assert_eq!(trials, all_trials(&app, &job.id).await.len());
    assert_eq!(
        events.iter().filter(|event| event.kind == "progress").count(),
        1,
        "only the newest progress is kept"
    );
    let states: Vec<&str> = events
        .iter()
        .filter(|e| e.kind == "state")
        .map(|e| e.data["state"].as_str().unwrap())
        .collect();
    assert_eq!(states, ["queued", "running", "succeeded"]);
    let middle = events[events.len() / 2].seq;
    let rest: Vec<_> =
        app.events(Topic::Job(job.id), middle).await.unwrap().map(Result::unwrap).collect().await;
    assert_eq!(rest, events[events.len() / 2 + 1..]);
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn requests_that_cannot_be_met_name_the_field_and_store_nothing() {
    let (_folder, app) = open(functions()).await;
    let refused = async |request: CalibrationRequest| match app.start_calibration(request).await {
        Err(Error::Invalid(fields)) => fields[0].field.clone(),
        other => panic!("{other:?}"),
    };
    assert_eq!(refused(calibration_of("flour", 1)).await, "powder");
    assert_eq!(refused(calibration_of("../etc", 1)).await, "powder");
    assert_eq!(refused(CalibrationRequest::default()).await, "powder");
    assert_eq!(
        refused(CalibrationRequest { repose_deg: Some(30.0), ..calibration_of("sand", 1) }).await,
        "powder"
    );
    assert_eq!(
        refused(CalibrationRequest { repose_deg: Some(f64::NAN), ..Default::default() }).await,
        "repose_deg"
    );
    assert_eq!(
        refused(CalibrationRequest { sets: Some(0), ..calibration_of("sand", 1) }).await,
        "sets"
    );
    let bad_tolerance =
        CalibrationRequest { tolerance_deg: Some(f64::INFINITY), ..calibration_of("sand", 1) };
    assert_eq!(refused(bad_tolerance).await, "tolerance_deg");
    let stray = CalibrationRequest { sd_deg: Some(1.0), ..calibration_of("sand", 1) };
    assert_eq!(refused(stray).await, "sd_deg", "a powder has its own");
    let bare = CalibrationRequest { repose_deg: Some(30.0), ..Default::default() };
    assert_eq!(refused(CalibrationRequest { n: Some(0), ..bare.clone() }).await, "n");
    assert_eq!(refused(CalibrationRequest { sd_deg: Some(-1.0), ..bare.clone() }).await, "sd_deg");
    assert_eq!(
        refused(CalibrationRequest { readings: Some(65), ..bare.clone() }).await,
        "readings"
    );
    let fixed = [("gravity_scale".to_owned(), 2.0)].into();
    assert_eq!(refused(CalibrationRequest { fixed, ..bare }).await, "fixed.gravity_scale");
    assert!(app.jobs(JobsWanted::default(), PageQuery::default()).await.unwrap().items.is_empty());
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn gravity_that_is_fixed_is_that_of_every_set_and_another_calibration() {
    let (_folder, app) = open(functions()).await;
    let free = calibrated(&app, "sand").await;
    let fixed = [("gravity_scale".to_owned(), 1.0)].into();
    let (held, created) = app
        .start_calibration(CalibrationRequest { fixed, ..calibration_of("sand", 1) })
        .await
        .unwrap();
    assert!(created && held.id != free.id);
    assert_eq!(ended(&app, &held.id).await.state, JobState::Succeeded);
    let free = app.calibration(&free.id).await.unwrap();
    let held = app.calibration(&held.id).await.unwrap();
    assert!(free.settings.get("fixed").is_none());
    assert_eq!(held.settings["fixed"]["gravity_scale"], 1.0);
    let sets = held.result.unwrap().sets;
    assert!(sets.len() == 3 && sets.iter().all(|set| set.parameters.gravity_scale() == 1.0));
    app.shutdown().await.unwrap();
}

/// A calibration with the shared emulator.
fn emulated(powder: &str) -> CalibrationRequest {
    CalibrationRequest { method: Some(CalibrationMethod::Emulator), ..calibration_of(powder, 1) }
}

/// As [`ended`], with a longer timeout for the fits of an emulator of 240 heaps.
async fn ended_in_time(app: &App, id: &str) -> JobState {
    let deadline = tokio::time::Instant::now() + Duration::from_secs(300);
    loop {
        let state = app.job(id).await.unwrap().state;
        if state.is_terminal() {
            return state;
        }
        assert!(tokio::time::Instant::now() < deadline, "the calibration does not end");
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "takes a minute and a half of a core; `make test-long` runs it"]
async fn calibrations_share_one_emulator_that_is_built_once_also_when_it_is_interrupted() {
    let folder = tempfile::tempdir().unwrap();
    let simulated = Arc::new(AtomicUsize::new(0));
    let counted = simulated.clone();
    let counting = Functions {
        simulate: heaps_on_cores(move |set, settings, seed| {
            counted.fetch_add(1, Ordering::SeqCst);
            std::thread::sleep(Duration::from_millis(2));
            heap(set, settings, seed)
        }),
        ..functions()
    };
    let app = open_in(folder.path(), counting.clone()).await;
    let (sand, _) = app.start_calibration(emulated("sand")).await.unwrap();
    until("some heaps", async || simulated.load(Ordering::SeqCst) >= 40).await;
    app.shutdown().await.unwrap();
    drop(app);
    let before = simulated.load(Ordering::SeqCst);
    assert!(before < 240, "the build was to be interrupted");

    let app = open_in(folder.path(), counting).await;
    let (sugar, _) = app.start_calibration(emulated("sugar")).await.unwrap();
    for job in [&sand.id, &sugar.id] {
        assert_eq!(ended_in_time(&app, job).await, JobState::Succeeded);
    }
    let [sand, sugar] = [&sand.id, &sugar.id].map(|id| id.clone());
    let [of_sand, of_sugar] =
        [app.calibration(&sand).await.unwrap(), app.calibration(&sugar).await.unwrap()];
    let (first, second) = (of_sand.result.unwrap(), of_sugar.result.unwrap());
    let (built, shared) = (first.emulator.unwrap(), second.emulator.unwrap());
    assert_eq!((built.id, built.sha256), (shared.id, shared.sha256));
    assert!(
        built.built < 240 && shared.built == 0 && shared.runs == 240,
        "{} {}",
        built.built,
        shared.built
    );
    assert!(first.reached && first.sets.len() == 3 && second.sets.len() == 3);
    let trials = all_trials(&app, &sand).await.len() + all_trials(&app, &sugar).await.len();
    let repeated = simulated.load(Ordering::SeqCst) - 240 - trials;
    assert!(
        repeated <= 8,
        "{repeated} heaps were simulated twice; only a batch that was not saved may be"
    );

    let posterior = app.posterior(&sugar).await.unwrap();
    assert_eq!((posterior.draws.len(), posterior.parameters.len()), (400, 9));
    assert!(posterior.repose_deg.iter().all(|deg| (25.0..38.0).contains(deg)));
    // The next start removes files that no row names.
    app.shutdown().await.unwrap();
    drop(app);
    let app = open_in(folder.path(), functions()).await;
    assert_eq!(app.posterior(&sugar).await.unwrap(), posterior);
    let without = calibrated(&app, "salt").await;
    assert!(matches!(
        app.posterior(&without.id).await,
        Err(Error::Conflict { code: "posterior_missing", .. })
    ));

    // Other measurements count, are simulated once for all calibrations, and are evaluated again in
    // the sets.
    let shake = |mean| Observation {
        observable: Observable::ShakeMass { pitch_deg: 30.0, shake_mm: 4.0 },
        mean,
        sd: 0.02,
        n: 5,
    };
    let joint = |powder, mean| CalibrationRequest {
        observations: Some(vec![shake(mean)]),
        verify_particles: Some(4000),
        ..emulated(powder)
    };
    let observed = async |request| {
        let (job, created) = app.start_calibration(request).await.unwrap();
        assert!(created);
        assert_eq!(ended_in_time(&app, &job.id).await, JobState::Succeeded);
        (app.calibration(&job.id).await.unwrap(), app.posterior(&job.id).await.unwrap())
    };
    let (of_sugar, posterior) = observed(joint("sugar", 0.42)).await;
    assert_eq!(of_sugar.observations, [shake(0.42)]);
    let result = of_sugar.result.unwrap();
    let made_of = &result.observed[0];
    assert_eq!((made_of.built, made_of.sets.len(), made_of.sets[0].runs), (128, 3, 4));
    // The formula has no grains.
    assert!(
        result.size_shift_deg.is_some_and(|shift| shift.abs() < 0.5),
        "{:?}",
        result.size_shift_deg
    );
    assert!(made_of.agrees && (made_of.mean.unwrap() - 0.42).abs() < 0.03, "{made_of:?}");
    assert!(!posterior.parameters[8].inert, "a shake weighs grains");
    let (of_sand, _) = observed(joint("sand", 0.47)).await;
    let result = of_sand.result.unwrap();
    assert_eq!((result.observed[0].built, &result.observed[0].sha256), (0, &made_of.sha256));
    // No set of the formula dispenses so little.
    let (of_salt, _) = observed(joint("salt", 20.0)).await;
    assert!(!of_salt.result.unwrap().observed[0].agrees);

    // Beyond the range of the formula, 22 to 49 deg: explained, not failed.
    let bare = CalibrationRequest {
        repose_deg: Some(70.0),
        sd_deg: Some(2.0),
        n: Some(5),
        sets: Some(3),
        ..Default::default()
    };
    let (beyond, _) = app.start_calibration(bare).await.unwrap();
    assert_eq!(ended_in_time(&app, &beyond.id).await, JobState::Succeeded);
    let result = app.calibration(&beyond.id).await.unwrap().result.unwrap();
    let shortfall = result.shortfall.unwrap();
    assert!(!result.reached && result.sets.is_empty());
    // This formula's steepest heap has 48.7 deg; it does not follow the five numbers of the
    // emulator, which sees its maximum only with noise.
    assert!((45.0..49.0).contains(&shortfall.nearest_repose_deg), "{shortfall:?}");
    assert!(["friction", "cohesion"].contains(&shortfall.limiting_parameter.unwrap().as_str()));
    app.shutdown().await.unwrap();
}

/// A heap that does not end while the gate is shut.
fn gated(gate: &Arc<AtomicBool>) -> Functions {
    let gate = gate.clone();
    Functions {
        simulate: heaps_on_cores(move |set, settings, seed| {
            while !gate.load(Ordering::SeqCst) {
                std::thread::sleep(Duration::from_millis(5));
            }
            heap(set, settings, seed)
        }),
        ..functions()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn jobs_begin_in_the_order_in_which_they_were_asked_for() {
    let gate = Arc::new(AtomicBool::new(false));
    let (_folder, app) = open(gated(&gate)).await;
    let mut asked = Vec::new();
    for powder in ["sand", "sugar", "salt", "semolina", "sodium_bicarbonate"] {
        for seed in [1, 2] {
            asked.push(app.start_calibration(calibration_of(powder, seed)).await.unwrap().0.id);
        }
    }
    gate.store(true, Ordering::SeqCst);
    let mut begun = Vec::new();
    for id in &asked {
        begun.push(ended(&app, id).await.started_at.unwrap());
    }
    assert!(begun.is_sorted(), "{begun:?}");
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_heap_that_does_not_end_does_not_hold_up_the_end_of_the_service() {
    let gate = Arc::new(AtomicBool::new(false));
    let (folder, app) = open(gated(&gate)).await;
    let (job, _) = app.start_calibration(calibration_of("sand", 1)).await.unwrap();
    until("it runs", async || app.job(&job.id).await.unwrap().state == JobState::Running).await;
    let ended = tokio::time::timeout(PATIENCE, app.shutdown()).await;
    gate.store(true, Ordering::SeqCst);
    ended.expect("nobody waits for the heap").unwrap();
    let reader = App::open_to_read(storage(folder.path()).await).await.unwrap();
    let job = reader.job(&job.id).await.unwrap();
    assert_eq!((job.state, job.attempts), (JobState::Queued, 0), "a shutdown burns no attempt");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_follower_with_a_number_from_a_former_life_hears_what_happens_now() {
    let (_folder, app) = open(functions()).await;
    let mut all = app.events(Topic::All, 1_000_000).await.unwrap();
    let job = crate::harness::calibrated(&app, "sand").await;
    let heard = tokio::time::timeout(PATIENCE, all.next())
        .await
        .expect("something is heard")
        .unwrap()
        .unwrap();
    assert_eq!(heard.topic, format!("job:{}", job.id));
    let of_the_job = app.events(Topic::Job(job.id), 1_000_000).await.unwrap();
    let first = of_the_job.map(Result::unwrap).collect::<Vec<_>>().await;
    assert_eq!(first[0].data["state"], "queued");
    app.shutdown().await.unwrap();
}
