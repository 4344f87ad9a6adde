//! Bench requests made before a stop, and simultaneous requests: checked when they are written, not
//! before.

use crate::bench::{clear, code, resume};
use crate::harness::{calibrated, functions, mg, open, open_in, pour, storage, until};
use crate::vials::{asked, dead_client, laboratory, said, until_awaiting};
use crate::weighing::{Gate, done};
use flip::app::{App, Functions, ReservationRequest, back_up, restore};
use flip_bench::hardware::DeviceError;
use flip_bench::rig::{OnEvent, Poured, Pouring, Rig};
use flip_core::domain::bench::BenchKind;
use flip_core::domain::weighing::{Outcome, WeighingState};
use futures::future::join_all;
use futures::poll;
use std::pin::pin;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};

/// Longer than a busy machine delays a thread.
const PATIENT_MS: u32 = 20_000;

/// A rig whose arm stays latched until it is recovered, which calls this.
struct Latched<F> {
    is_latched: AtomicBool,
    recovered: Arc<AtomicUsize>,
    recovering: F,
}

impl<F: Fn() + Send + Sync> Rig for Latched<F> {
    fn kind(&self) -> BenchKind {
        BenchKind::Emulated
    }

    fn exchanges_vials(&self) -> bool {
        true
    }

    fn pour(&self, pouring: &Pouring, on_event: OnEvent<'_>, stop: &AtomicBool) -> Poured {
        pour(pouring, on_event, stop)
    }

    fn halt(&self) -> Result<(), DeviceError> {
        Ok(())
    }

    fn arm_latch(&self) -> Result<Option<String>, DeviceError> {
        Ok(self.is_latched.load(Ordering::SeqCst).then(|| "its reflex".to_owned()))
    }

    fn recover(&self, _person: &str) -> Result<(), DeviceError> {
        self.recovered.fetch_add(1, Ordering::SeqCst);
        (self.recovering)();
        self.is_latched.store(false, Ordering::SeqCst);
        Ok(())
    }

    fn readability_mg(&self) -> Option<f64> {
        Some(1.0)
    }
}

fn latched(recovering: impl Fn() + Send + Sync + 'static) -> (Functions, Arc<AtomicUsize>) {
    let recovered = Arc::<AtomicUsize>::default();
    let is_latched = AtomicBool::new(true);
    let rig = Arc::new(Latched { is_latched, recovered: recovered.clone(), recovering });
    (Functions { rig, ..functions() }, recovered)
}

/// Why the bench is held, if it is.
async fn held(app: &App) -> Option<String> {
    app.bench().await.unwrap().held.map(|held| held.reason)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_clear_without_resume_leaves_the_hold_of_a_stop_where_nothing_waits() {
    let (laboratory, functions) = laboratory(300);
    let folder = tempfile::tempdir().unwrap();
    let app = open_in(folder.path(), functions.clone()).await;
    app.stop_bench().await.unwrap();
    dead_client(&laboratory).await;
    let cleared = app.clear_bench(clear(false)).await.unwrap();
    assert_eq!((cleared.latch, laboratory.arm.latched()), (None, None));
    assert_eq!(cleared.held.map(|it| it.reason), Some("stop was pressed".to_owned()));
    app.shutdown().await.unwrap();
    drop(app);
    let app = open_in(folder.path(), functions).await;
    assert_eq!(held(&app).await.as_deref(), Some("stop was pressed"), "also over a restart");
    dead_client(&laboratory).await;
    assert_eq!(app.clear_bench(clear(true)).await.unwrap().held, None);
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_vial_that_was_said_to_be_in_before_a_stop_is_not_poured_into_after_it() {
    let (laboratory, functions) = laboratory(PATIENT_MS);
    let (folder, app) = open(functions).await;
    calibrated(&app, "sand").await;
    let id = asked(&app, "A").await;
    until_awaiting(&app, &id).await;
    let holding = flip_testing::locked(folder.path()).await;
    let mut ready = pin!(app.vial_ready(&id, said("A")));
    assert!(poll!(&mut ready).is_pending(), "it waits for the other program");
    app.stop_bench().await.unwrap();
    holding.rollback().await.unwrap();
    assert_eq!(code(ready.await), "stopped_meanwhile");
    app.resume_bench(resume()).await.unwrap();
    // The lane has polled since: it finds another one waiting.
    let _second = asked(&app, "B").await;
    assert_eq!(app.weighing(&id).await.unwrap().weighing.state, WeighingState::AwaitingVial);
    assert_eq!(
        (laboratory.arm.log().len(), laboratory.dispensed_mg()),
        (0, 0.0),
        "nothing has moved"
    );
    app.vial_ready(&id, said("A")).await.unwrap();
    assert_eq!(done(&app, &id).await.state, WeighingState::Done);
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_resume_that_was_asked_before_a_stop_does_not_undo_it_in_memory_or_in_the_store() {
    let folder = tempfile::tempdir().unwrap();
    let app = open_in(folder.path(), functions()).await;
    app.stop_bench().await.unwrap();
    let holding = flip_testing::locked(folder.path()).await;
    let mut resumed = Box::pin(app.resume_bench(resume()));
    assert!(poll!(&mut resumed).is_pending());
    app.stop_bench().await.unwrap();
    holding.rollback().await.unwrap();
    assert_eq!(code(resumed.await), "stopped_meanwhile");
    assert!(held(&app).await.is_some());
    app.shutdown().await.unwrap();
    drop(app);
    let app = open_in(folder.path(), functions()).await;
    assert!(held(&app).await.is_some(), "also over a restart");
    assert_eq!(app.resume_bench(resume()).await.unwrap().held, None);
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_while_a_clear_is_under_way_wins() {
    let pressing: Arc<OnceLock<App>> = Arc::default();
    let stops = pressing.clone();
    let (functions, recovered) = latched(move || {
        stops.get().unwrap().halt(Some("Ada")).unwrap();
    });
    let (folder, app) = open(functions).await;
    assert!(pressing.set(app.clone()).is_ok());
    // While its arm comes back.
    assert_eq!(code(app.clear_bench(clear(true)).await), "stopped_meanwhile");
    assert_eq!((held(&app).await.is_some(), recovered.load(Ordering::SeqCst)), (true, 1));
    app.resume_bench(resume()).await.unwrap();

    // While it waits for the database, before its arm moves.
    let other = flip_testing::pool(folder.path()).await;
    latch(&other).await;
    let mut cleared = pin!(app.clear_bench(clear(true)));
    assert!(poll!(&mut cleared).is_pending());
    app.stop_bench().await.unwrap();
    assert_eq!(code(cleared.await), "stopped_meanwhile");
    assert_eq!(recovered.load(Ordering::SeqCst), 1, "its arm is not asked");
    assert!(held(&app).await.is_some() && app.bench().await.unwrap().latch.is_some());
    assert_eq!(app.clear_bench(clear(true)).await.unwrap().held, None);
    app.shutdown().await.unwrap();
}

/// Latches the bench in the store, without the knowledge of the process that serves it.
async fn latch(other: &sqlx::AnyPool) {
    let sql =
        "INSERT INTO latch (at, reason, bench) VALUES (0, 'a dose was interrupted', 'emulated')";
    sqlx::query(sql).execute(other).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_latch_that_the_store_alone_knows_is_cleared() {
    let (folder, app) = open(functions()).await;
    assert_eq!(code(app.clear_bench(clear(false)).await), "bench_not_latched");
    latch(&flip_testing::pool(folder.path()).await).await;
    assert_eq!(app.bench().await.unwrap().latch, None, "the lane has not heard of it");
    app.clear_bench(clear(false)).await.unwrap();
    assert_eq!(code(app.clear_bench(clear(false)).await), "bench_not_latched");
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_clear_waits_for_an_abandoned_arm_that_has_not_latched_itself_yet() {
    let (laboratory, functions) = laboratory(1000);
    let (_folder, app) = open(functions).await;
    let client = crate::vials::abandoned(&laboratory);
    assert_eq!(laboratory.arm.latched(), None);
    let cleared = app.clear_bench(clear(false)).await.unwrap();
    assert_eq!((cleared.latch, laboratory.arm.latched()), (None, None));
    drop(client);
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn of_two_who_clear_at_once_one_does() {
    let (functions, recovered) = latched(|| {});
    let (_folder, app) = open(functions).await;
    let answers = join_all((0..8).map(|_| {
        let app = app.clone();
        tokio::spawn(async move { app.clear_bench(clear(false)).await })
    }));
    let answers: Vec<_> = answers.await.into_iter().map(Result::unwrap).collect();
    assert_eq!(answers.iter().filter(|answer| answer.is_ok()).count(), 1, "{answers:?}");
    let refused = answers.into_iter().filter(Result::is_err).map(code);
    assert!(refused.into_iter().all(|code| code == "bench_not_latched"));
    assert_eq!(recovered.load(Ordering::SeqCst), 1, "the arm comes back once");
    app.shutdown().await.unwrap();
}

fn reservation(owner: &str) -> ReservationRequest {
    ReservationRequest { owner: owner.into(), seconds: 600, id: None }
}

#[tokio::test(flavor = "multi_thread")]
async fn of_two_who_reserve_at_once_one_has_the_bench() {
    let (folder, app) = open(functions()).await;
    let holding = flip_testing::locked(folder.path()).await;
    let (mut ada, mut bob) =
        (pin!(app.reserve_bench(reservation("Ada"))), pin!(app.reserve_bench(reservation("Bob"))));
    assert!(
        poll!(&mut ada).is_pending() && poll!(&mut bob).is_pending(),
        "both wait for the other program"
    );
    holding.rollback().await.unwrap();
    let (ada, bob) = tokio::join!(ada, bob);
    assert_eq!(code(bob), "bench_reserved");
    assert_eq!(app.bench().await.unwrap().reservation, Some(ada.unwrap()));
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_weighing_and_a_reservation_that_are_asked_at_once_are_not_both_taken() {
    let gate = Arc::new(Gate::default());
    gate.open();
    let (_folder, app) = open(gate.functions()).await;
    calibrated(&app, "sand").await;
    for k in 0..20 {
        let key = format!("w-{k}");
        let (weighing, reserved) = tokio::join!(
            app.start_weighing(mg("sand", 5.0), &key),
            app.reserve_bench(reservation("Ada"))
        );
        match (weighing, reserved) {
            (Ok((weighing, _)), refused) => {
                // The weighing may have ended before anyone looked.
                let ended = done(&app, &weighing.id).await;
                match refused {
                    Ok(reserved) => {
                        assert!(
                            ended.finished_at.unwrap().unix_ms()
                                <= reserved.until.unix_ms() - 600_000,
                            "{k}"
                        );
                        app.release_bench(&reserved.id).await.unwrap();
                    }
                    refused => assert_eq!(code(refused), "bench_in_use"),
                }
            }
            (refused, Ok(reserved)) => {
                assert_eq!(code(refused), "bench_reserved");
                app.release_bench(&reserved.id).await.unwrap();
            }
            (weighing, reserved) => panic!("{k}: {weighing:?}, {reserved:?}"),
        }
    }
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_restored_folder_begins_none_of_its_planned_doses_before_a_person_resumes() {
    let gate = Arc::new(Gate::default());
    let folder = tempfile::tempdir().unwrap();
    let [data, kept, back] = ["data", "kept", "back"].map(|name| folder.path().join(name));
    let app = open_in(&data, gate.functions()).await;
    calibrated(&app, "sand").await;
    let _moving = app.start_weighing(mg("sand", 5.0), "moving").await.unwrap();
    until("the first moves", async || gate.pours.load(Ordering::SeqCst) == 1).await;
    let planned = app.start_weighing(mg("sand", 6.0), "planned").await.unwrap().0.id;
    back_up(storage(&data).await, &kept, &|_| {}).await.unwrap();
    gate.open();
    // It is poured after the backup, which does not contain it.
    assert_eq!(done(&app, &planned).await.outcome, Some(Outcome::Within));
    app.shutdown().await.unwrap();

    let made = restore(&kept, storage(&back).await, false, &|_| {}).await.unwrap();
    let app = open_in(&back, gate.functions()).await;
    let found = app.bench().await.unwrap();
    let why = found.held.expect("a person must look").reason;
    assert!(
        why.starts_with("restored from a backup of ") && why.contains("look before resuming"),
        "{why}"
    );
    assert_eq!((made.held, found.waiting.len()), (Some(why), 1));
    // The lane has polled since: it finds this one at once.
    let later = app.start_weighing(mg("sand", 7.0), "later").await.unwrap().0.id;
    assert_eq!(app.weighing(&planned).await.unwrap().weighing.state, WeighingState::Planned);
    assert_eq!(gate.pours.load(Ordering::SeqCst), 2);
    assert!(matches!(app.stop_weighing(&planned).await.unwrap().0.outcome, Some(Outcome::Stopped)));
    app.resume_bench(resume()).await.unwrap();
    assert_eq!(done(&app, &later).await.outcome, Some(Outcome::Within));
    app.shutdown().await.unwrap();
}
