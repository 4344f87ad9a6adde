//! The bench after a stop: it starts nothing until a person resumes, and a stop does not wait for a
//! database.

use crate::harness::{calibrated, mg, open, open_in, until};
use crate::weighing::{Gate, done};
use flip::app::{
    App, AuditAsked, ClearRequest, Error, PageQuery, ReservationRequest, ResumeRequest,
};
use flip_core::domain::weighing::{Outcome, WeighingState};
use std::sync::Arc;
use std::sync::atomic::Ordering;

pub fn code<T: std::fmt::Debug>(answer: Result<T, Error>) -> &'static str {
    match answer {
        Err(Error::Conflict { code, .. }) => code,
        other => panic!("{other:?}"),
    }
}

pub fn resume() -> ResumeRequest {
    ResumeRequest { by: "Ada".into(), note: "looked".into() }
}

pub fn clear(resume: bool) -> ClearRequest {
    ClearRequest {
        by: "Ada".into(),
        note: "vial exchanged".into(),
        looked: true,
        vial_ready: true,
        resume,
    }
}

/// What people did to the bench, oldest first.
async fn persons(app: &App) -> Vec<String> {
    let records = app.audit(AuditAsked::default(), PageQuery::first(200)).await.unwrap().page.items;
    let said = records.into_iter().rev().filter(|record| record.kind == "person");
    let deeds = said.map(|record| record.body["action"].as_str().unwrap().to_owned());
    deeds.filter(|deed| deed != "start calibration").collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn after_a_stop_the_next_queued_dose_begins_only_when_a_person_resumes() {
    let gate = Arc::new(Gate::default());
    let (_folder, app) = open(gate.functions()).await;
    calibrated(&app, "sand").await;
    let moving = app.start_weighing(mg("sand", 5.0), "moving").await.unwrap().0.id;
    let waiting = app.start_weighing(mg("sand", 6.0), "waiting").await.unwrap().0.id;
    until("the first moves", async || gate.pours.load(Ordering::SeqCst) == 1).await;
    let held = app.stop_bench().await.unwrap();
    assert!(held.held.as_ref().unwrap().reason.contains(&moving), "{held:?}");
    assert_eq!(
        held.waiting.iter().map(|it| (it.id.as_str(), it.target_mg)).collect::<Vec<_>>(),
        [(&*waiting, 6.0)]
    );
    assert_eq!(done(&app, &moving).await.outcome, Some(Outcome::Stopped));
    gate.open();
    // The lane has polled since: it finds the waiting one at once, and polls again for this one.
    let third = app.start_weighing(mg("sand", 7.0), "third").await.unwrap().0.id;
    until("the stop is on record", async || persons(&app).await == ["stop"]).await;
    assert_eq!(app.weighing(&waiting).await.unwrap().weighing.state, WeighingState::Planned);
    assert_eq!(gate.pours.load(Ordering::SeqCst), 1);
    let resumed = app.resume_bench(resume()).await.unwrap();
    assert_eq!(resumed.held, None);
    assert_eq!(done(&app, &waiting).await.outcome, Some(Outcome::Within));
    assert_eq!(done(&app, &third).await.outcome, Some(Outcome::Within));
    assert_eq!(code(app.resume_bench(resume()).await), "bench_not_held");
    assert_eq!(persons(&app).await, ["stop", "resume"]);
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_while_nothing_moves_holds_too_also_over_a_restart() {
    let gate = Arc::new(Gate::default());
    gate.open();
    let folder = tempfile::tempdir().unwrap();
    let app = open_in(folder.path(), gate.functions()).await;
    calibrated(&app, "sand").await;
    app.stop_bench().await.unwrap();
    let waiting = app.start_weighing(mg("sand", 6.0), "waiting").await.unwrap().0.id;
    let stopped = app.start_weighing(mg("sand", 6.0), "stopped").await.unwrap().0.id;
    assert_eq!(app.stop_weighing(&stopped).await.unwrap().0.outcome, Some(Outcome::Stopped));
    let before = app.bench().await.unwrap().held;
    app.shutdown().await.unwrap();
    drop(app);
    let app = open_in(folder.path(), gate.functions()).await;
    let found = app.bench().await.unwrap();
    assert_eq!((found.held, found.waiting.len()), (before, 1));
    assert_eq!(gate.pours.load(Ordering::SeqCst), 0);
    app.resume_bench(resume()).await.unwrap();
    assert_eq!(done(&app, &waiting).await.outcome, Some(Outcome::Within));
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_is_answered_from_memory_while_another_program_holds_the_database_and_recorded_later()
 {
    let gate = Arc::new(Gate::default());
    let (folder, app) = open(gate.functions()).await;
    calibrated(&app, "sand").await;
    let moving = app.start_weighing(mg("sand", 5.0), "moving").await.unwrap().0.id;
    until("the dose moves", async || gate.pours.load(Ordering::SeqCst) == 1).await;
    let holding = flip_testing::locked(folder.path()).await;
    let stopping = tokio::time::timeout(std::time::Duration::from_secs(1), async {
        let weighing = app.stop_weighing(&moving).await.unwrap().0;
        (weighing, app.stop_bench().await.unwrap())
    });
    let (weighing, held) = stopping.await.expect("nothing waits for the other program");
    assert_eq!((weighing.id, held.held.is_some()), (moving.clone(), true));
    assert_eq!(persons(&app).await, Vec::<String>::new());
    holding.rollback().await.unwrap();
    until("both are on record", async || persons(&app).await == ["stop", "stop"]).await;
    assert_eq!(done(&app, &moving).await.outcome, Some(Outcome::Stopped));
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn two_clients_do_not_mix_while_one_has_reserved_the_bench() {
    let gate = Arc::new(Gate::default());
    gate.open();
    let folder = tempfile::tempdir().unwrap();
    let app = open_in(folder.path(), gate.functions()).await;
    calibrated(&app, "sand").await;
    let asked =
        |seconds: u32, id: Option<String>| ReservationRequest { owner: "Ada".into(), seconds, id };
    assert!(matches!(app.reserve_bench(asked(0, None)).await, Err(Error::Invalid(_))));
    let reserved = app.reserve_bench(asked(600, None)).await.unwrap();
    assert!(reserved.id.starts_with("rs-"));
    assert_eq!(code(app.reserve_bench(asked(600, None)).await), "bench_reserved");
    assert_eq!(code(app.start_weighing(mg("sand", 5.0), "other").await), "bench_reserved");
    let mut own = mg("sand", 5.0);
    own.reservation = Some(reserved.id.clone());
    let own_id = app.start_weighing(own.clone(), "own").await.unwrap().0.id;
    assert_eq!(done(&app, &own_id).await.outcome, Some(Outcome::Within));
    assert!(
        app.start_weighing(own.clone(), "own").await.unwrap().1,
        "a repeated request is no new one"
    );
    app.shutdown().await.unwrap();
    drop(app);
    // It survives a restart, because others would not know that it was lost.
    let app = open_in(folder.path(), gate.functions()).await;
    assert_eq!(app.bench().await.unwrap().reservation, Some(reserved.clone()));
    let longer = app.reserve_bench(asked(1, Some(reserved.id.clone()))).await.unwrap();
    until("it ends by itself", async || app.bench().await.unwrap().reservation.is_none()).await;
    assert!(longer.until < reserved.until);
    assert_eq!(code(app.start_weighing(own, "late").await), "reservation_ended");
    let other = app.start_weighing(mg("sand", 5.0), "other").await.unwrap().0.id;
    assert_eq!(done(&app, &other).await.outcome, Some(Outcome::Within));
    assert!(matches!(app.release_bench("rs-none").await, Err(Error::NotFound { .. })));
    let again = app.reserve_bench(asked(600, None)).await.unwrap();
    app.release_bench(&again.id).await.unwrap();
    assert_eq!(app.bench().await.unwrap().reservation, None);
    app.shutdown().await.unwrap();
}
