//! The end of a dose is kept until it is written down, whatever happens to the database.

use crate::bench::clear;
use crate::harness::{ToyRig, calibrated, functions, mg, open_in, pour, until};
use crate::weighing::done;
use flip::app::{App, Functions, Weighing};
use flip_bench::rig::{OnEvent, Pouring};
use flip_core::domain::bench::BenchKind;
use flip_core::domain::weighing::{Outcome, WeighingState};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, mpsc};

/// A bench that has devices, on which `happens` is called after the last reading of the first dose.
fn at_the_end(happens: impl Fn() + Send + Sync + 'static) -> (Functions, Arc<AtomicUsize>) {
    let pours = Arc::new(AtomicUsize::new(0));
    let counted = pours.clone();
    let pour = move |pouring: &Pouring, on_event: OnEvent<'_>, stop: &AtomicBool| {
        let poured = pour(pouring, on_event, stop);
        if counted.fetch_add(1, Ordering::SeqCst) == 0 {
            happens();
        }
        poured
    };
    let rig = ToyRig::of(BenchKind::Emulated, pour);
    (Functions { rig, ..functions() }, pours)
}

async fn two(app: &App) -> (String, String) {
    let first = app.start_weighing(mg("sand", 15.0), "first").await.unwrap().0.id;
    let second = app.start_weighing(mg("sand", 7.0), "second").await.unwrap().0.id;
    (first, second)
}

async fn why(app: &App) -> String {
    app.bench().await.unwrap().unwritten.map_or_else(String::new, |it| it.why)
}

#[tokio::test(flavor = "multi_thread")]
async fn an_ending_that_cannot_be_written_is_kept_and_written_when_it_can_be() {
    let folder = tempfile::tempdir().unwrap();
    let (say, hear) = mpsc::channel();
    let (go, gone) = mpsc::channel::<()>();
    let (say, gone) = (Mutex::new(say), Mutex::new(gone));
    let (functions, pours) = at_the_end(move || {
        say.lock().unwrap().send(()).unwrap();
        gone.lock().unwrap().recv().unwrap();
    });
    let app = open_in(folder.path(), functions).await;
    calibrated(&app, "sand").await;
    let (first, second) = two(&app).await;
    tokio::task::spawn_blocking(move || hear.recv().unwrap()).await.unwrap();
    let holding = flip_testing::locked(folder.path()).await;
    go.send(()).unwrap();
    // Longer than the store waits for a lock.
    until("it is told what is in the way", async || {
        why(&app).await.contains("another program holds the database")
    })
    .await;
    let found = app.bench().await.unwrap();
    assert_eq!((found.unwritten.unwrap().weighing, found.moving), (first.clone(), None));
    assert_eq!(pours.load(Ordering::SeqCst), 1, "nothing begins meanwhile");
    let told = app.readiness().await.checks.bench.why.unwrap();
    assert!(told.contains(&first) && told.contains("could not be recorded"), "{told}");
    holding.rollback().await.unwrap();
    let weighing: Weighing = done(&app, &first).await;
    assert_eq!((weighing.outcome, weighing.reading_mg), (Some(Outcome::Within), Some(15.25)));
    assert_eq!(done(&app, &second).await.outcome, Some(Outcome::Within));
    assert_eq!(app.bench().await.unwrap().unwritten, None);
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn an_ending_that_is_never_written_is_unknown_and_latched_at_the_next_start_and_no_process_is_said_to_have_died()
 {
    if flip_testing::only_sqlite_has("a file") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let away = folder.path().join("away");
    let (from, to) = (data.clone(), away.clone());
    let (functions, _) = at_the_end(move || std::fs::rename(&from, &to).unwrap());
    let app = open_in(&data, functions.clone()).await;
    calibrated(&app, "sand").await;
    let (first, second) = two(&app).await;
    until("it is told that the database is gone", async || why(&app).await.contains("no longer"))
        .await;
    let latch = app.bench().await.unwrap().latch.expect("a person must look");
    assert!(latch.reason.contains("flip.db"), "{}", latch.reason);
    app.shutdown().await.unwrap();
    drop(app);
    assert!(!data.exists(), "nothing was made in its place");
    std::fs::rename(&away, &data).unwrap();
    let app = open_in(&data, functions).await;
    let weighing = app.weighing(&first).await.unwrap().weighing;
    assert_eq!(
        (weighing.state, weighing.outcome),
        (WeighingState::Unknown, Some(Outcome::Unknown))
    );
    let words = weighing.error.unwrap();
    assert!(words.contains("not on record") && words.contains("or a write failed"), "{words}");
    assert!(app.bench().await.unwrap().latch.is_some());
    app.clear_bench(clear(true)).await.unwrap();
    assert_eq!(done(&app, &second).await.outcome, Some(Outcome::Within));
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_trace_that_cannot_be_stored_loses_neither_the_ending_nor_the_ticks() {
    let folder = tempfile::tempdir().unwrap();
    let blobs = folder.path().join("blobs");
    let place = blobs.clone();
    let (functions, _) = at_the_end(move || block(&place));
    let app = open_in(folder.path(), functions).await;
    calibrated(&app, "sand").await;
    let id = app.start_weighing(mg("sand", 15.0), "first").await.unwrap().0.id;
    let weighing = done(&app, &id).await;
    assert_eq!((weighing.outcome, weighing.reading_mg), (Some(Outcome::Within), Some(15.25)));
    assert!(weighing.error.unwrap().contains("the trace was not stored"));
    assert_eq!(app.weighing(&id).await.unwrap().ticks.len(), 3);
    app.shutdown().await.unwrap();
}

/// Blocks any further writes to this folder.
fn block(blobs: &Path) {
    let aside: PathBuf = blobs.with_extension("aside");
    std::fs::create_dir_all(blobs).unwrap();
    std::fs::rename(blobs, aside).unwrap();
    std::fs::write(blobs, "no folder").unwrap();
}
