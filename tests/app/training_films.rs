//! A training as films: the networks it kept, and a dose with each of them.

use crate::harness::{calibrated, ended, functions, open, training_of};
use flip::app::{App, Error, Film, FilmRequest, FilmsAsked, Functions, JobState, PageQuery};
use flip::jobs::train::Train;
use flip_learn::train::TrainError;
use flip_learn::train::environment::play;
use flip_policy::{Rules, decode};
use flip_sim::balance;
use flip_sim::dispense::{self, Dispenser};
use std::path::Path;
use std::sync::Arc;

/// A training on sand that goes on after its warm-up of 16 episodes; its id.
async fn trained_on_sand(app: &App) -> String {
    calibrated(app, "sand").await;
    let (job, _) = app.start_training(training_of("sand", 24)).await.unwrap();
    let job = ended(app, &job.id).await;
    assert_eq!(job.state, JobState::Succeeded, "{:?}", job.error);
    job.id
}

fn of(training: &str, episode: u32) -> FilmRequest {
    FilmRequest {
        training: Some(training.to_owned()),
        episode: Some(episode),
        ..FilmRequest::default()
    }
}

async fn filmed(app: &App, training: &str, episode: u32) -> Film {
    let (job, _) = app.start_film(of(training, episode)).await.unwrap();
    let job = ended(app, &job.id).await;
    assert_eq!(job.state, JobState::Succeeded, "{:?}", job.error);
    app.film(&job.id).await.unwrap()
}

async fn forget_networks(folder: &Path) {
    let database = flip_testing::pool(folder).await;
    sqlx::query("DELETE FROM kept_policy").execute(&database).await.unwrap();
    database.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_film_shows_the_dose_that_the_network_of_its_episode_gives() {
    let (folder, app) = open(functions()).await;
    let id = trained_on_sand(&app).await;
    let training = app.training(&id).await.unwrap();
    assert_eq!(training.kept_episodes, [1, 10, 24]);
    let listed = app.trainings(PageQuery::first(5)).await.unwrap().items;
    assert_eq!(listed[0].kept_episodes, training.kept_episodes);

    let last = filmed(&app, &id, 24).await;
    assert_eq!((last.training.as_deref(), last.episode), (Some(id.as_str()), Some(24)));
    assert_eq!((last.target_mg, last.seed, last.weighing), (Some(10.0), Some(1), None));
    assert_eq!(last.set.as_ref(), Some(&training.levels[0].sets[0]));
    // The same dose without a film: the finished policy on the same spoon and the same balance.
    let bytes = app.policy_bytes(&training.result.unwrap().policy).await.unwrap();
    let policy = decode(&bytes).unwrap();
    let set = policy.manifest.levels[0].sets[0].parameters;
    let settings = dispense::Settings { pitch: Rules::FLIP.pitch, ..Default::default() };
    let mut spoon = Dispenser::new(&set, &settings, 1);
    let mut dosing = policy.controller.begin(&Rules::FLIP, 1.0);
    let played = play(&mut spoon, &Rules::FLIP, &balance::Settings::default(), 10.0, 1, |seen| {
        dosing.propose(seen).to_unit().map(|output| output as f32)
    });
    let head = last.result.as_ref().unwrap().head.clone().unwrap();
    // A step for each action, and the way back to level.
    assert_eq!(head.steps.len(), played.steps.len() + 1);
    assert_eq!(head.steps[played.steps.len() - 1].vial_mg, played.dispensed_mg);

    // The first episode's network is another one, so its dose differs step by step.
    let first = filmed(&app, &id, 1).await;
    let untrained = first.result.as_ref().unwrap().head.clone().unwrap();
    assert_ne!(untrained.steps[0].shake_mm, head.steps[0].shake_mm);
    assert_eq!(untrained.filled_mg, head.filled_mg, "the same filling");
    let of_it = FilmsAsked { training: Some(&id), ..FilmsAsked::default() };
    let films = app.films(of_it, PageQuery::first(9)).await.unwrap().items;
    assert_eq!(films.iter().map(|film| film.episode).collect::<Vec<_>>(), [Some(1), Some(24)]);
    let (again, is_new) = app.start_film(of(&id, 1)).await.unwrap();
    assert_eq!((again.id, is_new), (first.job.id, false));

    // The same training elsewhere gives the same films.
    let (_elsewhere, other) = open(functions()).await;
    let same = trained_on_sand(&other).await;
    let second = filmed(&other, &same, 1).await;
    assert_eq!(second.result.unwrap().sha256, first.result.unwrap().sha256);
    other.shutdown().await.unwrap();

    // A training of before FLIP kept networks still has its policy.
    forget_networks(folder.path()).await;
    assert_eq!(app.training(&id).await.unwrap().kept_episodes, [24]);
    let refused = app.start_film(of(&id, 1)).await.unwrap_err().to_string();
    assert!(refused.contains("this training ended before FLIP kept others"), "{refused}");
    assert!(app.start_film(of(&id, 24)).await.is_ok());
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_film_of_an_episode_is_refused_where_no_network_is_kept() {
    let (_folder, app) = open(functions()).await;
    let id = trained_on_sand(&app).await;
    let both = FilmRequest { weighing: Some("w".to_owned()), ..of(&id, 1) };
    let unnamed = FilmRequest { episode: None, ..of(&id, 1) };
    let alone = FilmRequest { training: None, ..of(&id, 1) };
    for (request, field, advice) in [
        (of(&id, 7), "episode", "must be one whose network is kept, 1, 10, 24, got 7"),
        (unnamed, "episode", "must be given with `training`; kept are the networks of 1, 10, 24"),
        (alone, "episode", "must be left out without `training`"),
        (of("t-none", 1), "training", "there is no training `t-none`"),
        (both, "training", "must be left out with `weighing`"),
    ] {
        let Error::Invalid(error) = app.start_film(request).await.unwrap_err() else {
            panic!("{field}: {advice}");
        };
        let said = format!("{error:?}");
        assert!(said.contains(field) && said.contains(advice), "{said}");
    }
    app.shutdown().await.unwrap();

    let train: Train = Arc::new(|_, _, _, _, _| Err(TrainError::Unavailable));
    let (_folder, app) = open(Functions { train, ..functions() }).await;
    calibrated(&app, "sand").await;
    let (job, _) = app.start_training(training_of("sand", 24)).await.unwrap();
    assert_eq!(ended(&app, &job.id).await.state, JobState::Failed);
    assert!(app.training(&job.id).await.unwrap().kept_episodes.is_empty());
    let refused = app.start_film(of(&job.id, 1)).await.unwrap_err();
    let said = refused.to_string();
    assert!(
        matches!(refused, Error::Conflict { .. }) && said.contains("kept no network"),
        "{said}"
    );
    app.shutdown().await.unwrap();
}
