//! Vials on a bench that cannot exchange them: a person confirms that one is in, and the balance is
//! checked too.

use crate::bench::{clear, code, resume};
use crate::harness::{calibrated, functions, mg, open, open_in, until};
use crate::weighing::done;
use flip::app::{App, BenchStatus, Error, Functions, VialCheck, VialReadyRequest, Weighing};
use flip_bench::emulate::arm::{self, Flow, FormulaSpoon};
use flip_bench::emulate::lab::{self, Laboratory};
use flip_bench::hardware::arm::{Arm, Deadlines};
use flip_bench::hardware::clock::Clock;
use flip_bench::hardware::wire::Tap;
use flip_bench::rig::Devices;
use flip_core::domain::vial::EmptyVial;
use flip_core::domain::weighing::{Outcome, WeighingState};
use std::sync::Arc;

fn spoon(seed: u64) -> Box<FormulaSpoon> {
    Box::new(FormulaSpoon::new(Flow::default(), seed))
}

/// A laboratory whose vial a person exchanges, with a clock of its own.
pub fn laboratory(dead_man_ms: u32) -> (Laboratory, Functions) {
    let clock = Clock::standing();
    let settings = lab::Settings {
        arm: arm::Settings { dead_man_ms, ..Default::default() },
        ..lab::Settings::default()
    };
    let laboratory = Laboratory::start(settings, clock.clone(), spoon(1)).unwrap();
    let rig = Arc::new(Devices::with_clock(laboratory.file(), clock));
    (laboratory, Functions { rig, ..functions() })
}

/// Longer than a busy machine delays a thread.
const PATIENT_MS: u32 = 20_000;

pub async fn asked(app: &App, vial: &str) -> String {
    let mut request = mg("sand", 12.0);
    request.asked.vial = Some(vial.into());
    app.start_weighing(request, vial).await.unwrap().0.id
}

pub async fn until_awaiting(app: &App, id: &str) {
    until("it is its turn", async || {
        app.weighing(id).await.unwrap().weighing.state == WeighingState::AwaitingVial
    })
    .await;
}

pub fn said(vial: &str) -> VialReadyRequest {
    VialReadyRequest { by: Some("Ada".into()), vial: Some(vial.into()) }
}

/// The vial on the pan: its name, and whether it holds this mass.
fn holds(found: &BenchStatus, name: &str, mass_mg: f64) -> bool {
    let vial = found.vial.as_ref().expect("a vial is known");
    vial.name.as_deref() == Some(name)
        && vial.holds_mg.is_some_and(|mg| (mg - mass_mg).abs() <= 3.0)
}

#[tokio::test(flavor = "multi_thread")]
async fn three_weighings_for_three_named_vials_do_not_go_into_one() {
    let (laboratory, functions) = laboratory(PATIENT_MS);
    let (_folder, app) = open(functions).await;
    calibrated(&app, "sand").await;
    let [a, b, c] = [asked(&app, "A").await, asked(&app, "B").await, asked(&app, "C").await];
    until_awaiting(&app, &a).await;
    assert_eq!(laboratory.dispensed_mg(), 0.0);
    assert_eq!(code(app.vial_ready(&b, said("B")).await), "not_its_turn");
    assert_eq!(code(app.vial_ready(&a, said("B")).await), "vial_differs");
    assert!(matches!(app.vial_ready("none", said("B")).await, Err(Error::NotFound { .. })));
    app.vial_ready(&a, said("A")).await.unwrap();
    let first: Weighing = done(&app, &a).await;
    assert_eq!(first.state, WeighingState::Done, "{first:?}");
    assert_eq!(code(app.vial_ready(&a, said("A")).await), "weighing_finished");
    let poured_mg = laboratory.dispensed_mg();
    assert!(poured_mg > 5.0, "{first:?}");

    // Confirmed although nobody has exchanged it.
    until_awaiting(&app, &b).await;
    let found = app.bench().await.unwrap();
    assert!(holds(&found, "A", poured_mg) && found.exchanges_vials == Some(false), "{found:?}");
    app.vial_ready(&b, said("B")).await.unwrap();
    let second = done(&app, &b).await;
    assert_eq!((second.state, second.outcome), (WeighingState::Aborted, Some(Outcome::Aborted)));
    let words = second.error.unwrap();
    assert!(
        ["vial `B`", "vial `A`", "still on the pan", "Nothing was poured"]
            .iter()
            .all(|it| words.contains(it)),
        "{words}"
    );
    assert_eq!(laboratory.dispensed_mg(), poured_mg);

    // The bench is not latched, and the next dose has its vial.
    until_awaiting(&app, &c).await;
    let found = app.bench().await.unwrap();
    assert!(
        found.latch.is_none() && found.held.is_none() && holds(&found, "A", poured_mg),
        "{found:?}"
    );
    laboratory.prepare(spoon(3));
    app.vial_ready(&c, said("C")).await.unwrap();
    let third = done(&app, &c).await;
    assert_eq!(third.state, WeighingState::Done, "{third:?}");
    assert!(laboratory.dispensed_mg() > 5.0, "{third:?}");
    assert!(holds(&app.bench().await.unwrap(), "C", laboratory.dispensed_mg()));
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_skips_the_vial_is_not_asked_dose_after_dose_and_the_pan_is_still_known() {
    let (laboratory, functions) = laboratory(PATIENT_MS);
    let (_folder, app) = open(functions).await;
    calibrated(&app, "sand").await;
    for key in ["first", "second"] {
        let mut request = mg("sand", 12.0);
        request.vial_check = VialCheck::Skip;
        let id = app.start_weighing(request, key).await.unwrap().0.id;
        let weighing = done(&app, &id).await;
        assert_eq!(weighing.state, WeighingState::Done, "{weighing:?}");
    }
    let found = app.bench().await.unwrap();
    let holds_mg = found.vial.unwrap().holds_mg.unwrap();
    assert!((holds_mg - laboratory.dispensed_mg()).abs() <= 4.0 && holds_mg > 15.0, "{holds_mg}");
    // A query does not find it empty.
    let id = asked(&app, "B").await;
    until_awaiting(&app, &id).await;
    app.vial_ready(&id, said("B")).await.unwrap();
    assert_eq!(done(&app, &id).await.outcome, Some(Outcome::Aborted));
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_said_of_a_vial_is_void_after_a_stop_and_after_a_restart() {
    let (laboratory, functions) = laboratory(PATIENT_MS);
    let folder = tempfile::tempdir().unwrap();
    let app = open_in(folder.path(), functions.clone()).await;
    calibrated(&app, "sand").await;
    let a = asked(&app, "A").await;
    until_awaiting(&app, &a).await;
    app.stop_bench().await.unwrap();
    app.vial_ready(&a, said("A")).await.unwrap();
    // Anyone who stops again may take the vial away.
    app.stop_bench().await.unwrap();
    app.resume_bench(resume()).await.unwrap();
    until("the lane has looked", async || {
        app.weighing(&a).await.unwrap().weighing.state == WeighingState::AwaitingVial
    })
    .await;
    app.stop_bench().await.unwrap();
    app.vial_ready(&a, said("A")).await.unwrap();
    app.shutdown().await.unwrap();
    drop(app);
    let app = open_in(folder.path(), functions).await;
    app.resume_bench(resume()).await.unwrap();
    until_awaiting(&app, &a).await;
    assert_eq!(
        (laboratory.arm.log().len(), laboratory.dispensed_mg()),
        (0, 0.0),
        "nothing has moved"
    );
    app.vial_ready(&a, said("A")).await.unwrap();
    assert_eq!(done(&app, &a).await.state, WeighingState::Done);
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_vial_that_is_not_empty_by_the_bench_file_is_refused_at_the_first_dose() {
    for (empty_mg, fits) in [(11_950.0, false), (12_000.0, true)] {
        let clock = Clock::standing();
        let settings = lab::Settings {
            arm: arm::Settings { dead_man_ms: PATIENT_MS, ..Default::default() },
            ..Default::default()
        };
        let laboratory = Laboratory::start(settings, clock.clone(), spoon(1)).unwrap();
        let mut file = laboratory.file();
        file.vial = Some(EmptyVial { empty_mg, spread_mg: 20.0 });
        let rig = Arc::new(Devices::with_clock(file, clock));
        let (_folder, app) = open(Functions { rig, ..functions() }).await;
        calibrated(&app, "sand").await;
        let id = asked(&app, "A").await;
        until_awaiting(&app, &id).await;
        app.vial_ready(&id, said("A")).await.unwrap();
        let weighing = done(&app, &id).await;
        assert_eq!(weighing.state == WeighingState::Done, fits, "{weighing:?}");
        assert_eq!(laboratory.dispensed_mg() > 0.0, fits);
        let words = weighing.error.unwrap_or_default();
        assert_eq!(words.contains("more than the heaviest empty vial"), !fits, "{words}");
        app.shutdown().await.unwrap();
    }
}

/// A client that has control of the arm and no longer renews it.
pub fn abandoned(laboratory: &Laboratory) -> Arm {
    let client = Arm::connect(
        laboratory.arm.url(),
        Tap::none(),
        Deadlines { idle: std::time::Duration::ZERO, ..Deadlines::default() },
    );
    let mut client = client.unwrap();
    client.acquire().unwrap();
    client
}

/// A client that takes control of the arm and goes silent, until the arm has latched itself.
pub async fn dead_client(laboratory: &Laboratory) {
    let _client = abandoned(laboratory);
    until("the dead-man", async || laboratory.arm.latched().is_some()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_arm_that_is_latched_latches_the_bench_says_why_and_a_person_clears_both() {
    let (laboratory, functions) = laboratory(300);
    let (_folder, app) = open(functions).await;
    calibrated(&app, "sand").await;
    assert_eq!(code(app.clear_bench(clear(false)).await), "bench_not_latched");
    dead_client(&laboratory).await;
    // Before any weighing: the arm alone is latched.
    let cleared = app.clear_bench(clear(false)).await.unwrap();
    assert_eq!((cleared.latch, cleared.held, laboratory.arm.latched()), (None, None, None));

    dead_client(&laboratory).await;
    let (a, b) = (asked(&app, "A").await, asked(&app, "B").await);
    until_awaiting(&app, &a).await;
    app.vial_ready(&a, said("A")).await.unwrap();
    let words = done(&app, &a).await.error.unwrap();
    assert!(
        words.contains("nobody renewed the lease in time") && !words.contains("acquire"),
        "{words}"
    );
    let latch = app.bench().await.unwrap().latch.expect("the bench is latched too");
    assert!(latch.reason.contains("nobody renewed the lease in time"), "{}", latch.reason);
    let cleared = app.clear_bench(clear(false)).await.unwrap();
    assert_eq!((cleared.latch, laboratory.arm.latched()), (None, None));
    // A dose waits: it is named, and does not begin by itself.
    assert_eq!((cleared.held.is_some(), cleared.waiting[0].id == b), (true, true));
    app.shutdown().await.unwrap();
}
