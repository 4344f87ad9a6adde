//! Weighings: committed before they move, never poured twice, stopped, interrupted.

use crate::harness::{ToyRig, calibrated, functions, mg, open, open_in, pour, trained, until};
use flip::app::{
    App, Error, Functions, PageQuery, Target, Tolerance, Topic, Weighing, WeighingRequest,
};
use flip_bench::hardware::DeviceError;
use flip_bench::rig::{OnEvent, Poured, Pouring, Rig};
use flip_bench::weigh::forecast::{Fall, Forecast};
use flip_core::domain::bench::BenchKind;
use flip_core::domain::weighing::{Outcome, WeighingState};
use futures::StreamExt;
use futures::future::join_all;
use std::collections::HashSet;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex};

pub async fn done(app: &App, id: &str) -> Weighing {
    let mut events = app.events(Topic::Weighing(id.into()), 0).await.unwrap();
    let drained = async { while events.next().await.is_some() {} };
    tokio::time::timeout(crate::harness::PATIENCE, drained)
        .await
        .expect("the weighing ends in time");
    app.weighing(id).await.unwrap().weighing
}

/// A bench that blocks until it is released, and counts its pours.
#[derive(Default)]
pub struct Gate {
    open: Mutex<bool>,
    opened: Condvar,
    pub pours: AtomicUsize,
}

impl Gate {
    pub fn functions(self: &Arc<Self>) -> Functions {
        Functions { rig: self.clone(), ..functions() }
    }

    pub fn open(&self) {
        *self.open.lock().unwrap() = true;
        self.opened.notify_all();
    }
}

impl Rig for Gate {
    fn kind(&self) -> BenchKind {
        BenchKind::Simulated
    }

    fn exchanges_vials(&self) -> bool {
        true
    }

    fn pour(&self, pouring: &Pouring, on_event: OnEvent<'_>, stop: &AtomicBool) -> Poured {
        self.pours.fetch_add(1, Ordering::SeqCst);
        let mut open = self.open.lock().unwrap();
        while !*open && !stop.load(Ordering::SeqCst) {
            let wait = std::time::Duration::from_millis(5);
            open = self.opened.wait_timeout(open, wait).unwrap().0;
        }
        drop(open);
        pour(pouring, on_event, stop)
    }

    fn halt(&self) -> Result<(), DeviceError> {
        Ok(())
    }

    fn readability_mg(&self) -> Option<f64> {
        Some(1.0)
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_weighing_ends_with_its_outcome_and_its_trace() {
    let (_folder, app) = open(functions()).await;
    // Nothing was trained: the shipped policy weighs.
    calibrated(&app, "sand").await;
    let (weighing, replayed) = app.start_weighing(mg("sand", 15.0), "key-1").await.unwrap();
    assert!(!replayed && weighing.policy == flip_policy::shipped().id);
    let weighing = done(&app, &weighing.id).await;
    assert_eq!((weighing.state, weighing.outcome), (WeighingState::Done, Some(Outcome::Within)));
    assert_eq!(
        (weighing.dispensed_mg, weighing.error_mg, weighing.shakes),
        (Some(15.25), Some(0.25), Some(2))
    );
    let detail = app.weighing(&weighing.id).await.unwrap();
    assert_eq!(detail.ticks.iter().map(|tick| tick.step).collect::<Vec<_>>(), [0, 1, 2]);
    let events: Vec<_> = app
        .events(Topic::Weighing(weighing.id), 0)
        .await
        .unwrap()
        .map(Result::unwrap)
        .collect()
        .await;
    let told: Vec<String> = events
        .iter()
        .map(|event| {
            event.data.get("state").and_then(|s| s.as_str()).unwrap_or(&event.kind).to_owned()
        })
        .collect();
    assert_eq!(told, ["planned", "armed", "dosing", "tick", "tick", "tick", "done"]);
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn the_error_is_that_of_the_reading_and_a_dose_that_was_not_weighed_has_none() {
    let ends = [
        (15.0, Outcome::Within, Some(0.25)),
        (14.0, Outcome::Over, Some(0.25)),
        (13.0, Outcome::NotStable, None),
        (12.0, Outcome::Stopped, None),
    ];
    let pours = move |pouring: &Pouring, on_event: OnEvent<'_>, stop: &AtomicBool| {
        let end = ends.iter().find(|it| it.0 == pouring.task.order.target_mg).unwrap();
        let poured = pour(pouring, on_event, stop);
        // The balance shows another mass than the one that fell.
        Poured { outcome: end.1, dispensed_mg: Some(1.0), ..poured }
    };
    let rig = ToyRig::of(BenchKind::Simulated, pours);
    let (_folder, app) = open(Functions { rig, ..functions() }).await;
    calibrated(&app, "sand").await;
    for (target_mg, outcome, error_mg) in ends {
        let key = target_mg.to_string();
        let id = app.start_weighing(mg("sand", target_mg), &key).await.unwrap().0.id;
        let weighing = done(&app, &id).await;
        assert_eq!((weighing.outcome, weighing.error_mg), (Some(outcome), error_mg));
    }
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_hundred_parallel_requests_with_one_key_make_one_weighing_and_one_pour() {
    let gate = Arc::new(Gate::default());
    let (_folder, app) = open(gate.functions()).await;
    trained(&app, "sand").await;
    let answers = join_all((0..100).map(|_| {
        let app = app.clone();
        tokio::spawn(async move { app.start_weighing(mg("sand", 12.0), "one key").await })
    }));
    // A key with a space is refused; the hundred requests use one without.
    assert!(
        answers.await.into_iter().all(|answer| matches!(answer.unwrap(), Err(Error::Invalid(_))))
    );
    let answers = join_all((0..100).map(|_| {
        let app = app.clone();
        tokio::spawn(async move { app.start_weighing(mg("sand", 12.0), "one-key").await.unwrap() })
    }));
    let answers: Vec<(Weighing, bool)> = answers.await.into_iter().map(Result::unwrap).collect();
    assert_eq!(answers.iter().filter(|(_, replayed)| !replayed).count(), 1);
    assert!(answers.iter().all(|(weighing, _)| weighing.id == answers[0].0.id));
    gate.open();
    done(&app, &answers[0].0.id).await;
    assert_eq!(
        app.weighings(Default::default(), PageQuery::default()).await.unwrap().page.items.len(),
        1
    );
    let other = app.start_weighing(mg("sand", 13.0), "one-key").await;
    assert!(
        matches!(other, Err(Error::Unprocessable { weighing, .. }) if weighing == answers[0].0.id)
    );
    assert!(
        app.start_weighing(mg("sand", 12.0), "one-key").await.unwrap().1,
        "also long after it has ended"
    );
    assert_eq!(gate.pours.load(Ordering::SeqCst), 1);
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn weighings_wait_in_order_and_the_sixty_sixth_is_told_to_come_back() {
    let gate = Arc::new(Gate::default());
    let (_folder, app) = open(gate.functions()).await;
    trained(&app, "sand").await;
    let first = app.start_weighing(mg("sand", 5.0), "first").await.unwrap().0;
    until("the first moves", async || gate.pours.load(Ordering::SeqCst) == 1).await;
    let mut waiting = Vec::new();
    for k in 0..64 {
        waiting
            .push(app.start_weighing(mg("sand", 5.0), &format!("waiting-{k}")).await.unwrap().0.id);
    }
    assert!(matches!(
        app.start_weighing(mg("sand", 5.0), "one-too-many").await,
        Err(Error::Busy(_))
    ));
    assert!(
        app.start_weighing(mg("sand", 5.0), "waiting-0").await.unwrap().1,
        "a repeated request is no new one"
    );
    gate.open();
    done(&app, waiting.last().unwrap()).await;
    let all = app.weighings(Default::default(), PageQuery::first(200)).await.unwrap().page.items;
    let mut by_start: Vec<&Weighing> = all.iter().collect();
    by_start.sort_by_key(|weighing| (weighing.started_at, weighing.id.clone()));
    let order: Vec<&str> = by_start.iter().map(|weighing| weighing.id.as_str()).collect();
    let mut asked = vec![first.id.as_str()];
    asked.extend(waiting.iter().map(String::as_str));
    assert_eq!(order, asked);
    assert_eq!(gate.pours.load(Ordering::SeqCst), 65);
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_ends_a_waiting_weighing_at_once_and_a_moving_one_at_its_next_tick() {
    let gate = Arc::new(Gate::default());
    let (_folder, app) = open(gate.functions()).await;
    trained(&app, "sand").await;
    let moving = app.start_weighing(mg("sand", 5.0), "moving").await.unwrap().0.id;
    let waiting = app.start_weighing(mg("sand", 5.0), "waiting").await.unwrap().0.id;
    until("the first moves", async || gate.pours.load(Ordering::SeqCst) == 1).await;
    let stopped = app.stop_weighing(&waiting).await.unwrap().0;
    assert_eq!((stopped.state, stopped.outcome), (WeighingState::Aborted, Some(Outcome::Stopped)));
    assert_eq!(app.bench().await.unwrap().held, None, "what did not move needs nobody to look");
    app.stop_weighing(&moving).await.unwrap();
    assert!(app.bench().await.unwrap().held.is_some());
    let stopped = done(&app, &moving).await;
    assert_eq!((stopped.state, stopped.outcome), (WeighingState::Aborted, Some(Outcome::Stopped)));
    assert_eq!(
        app.stop_weighing(&moving).await.unwrap(),
        (stopped, false),
        "as often as anybody likes"
    );
    assert!(matches!(app.stop_weighing("none").await, Err(Error::NotFound { .. })));
    assert_eq!(gate.pours.load(Ordering::SeqCst), 1);
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn shutting_down_stops_what_moves_and_keeps_what_waits() {
    let gate = Arc::new(Gate::default());
    let folder = tempfile::tempdir().unwrap();
    let app = open_in(folder.path(), gate.functions()).await;
    trained(&app, "sand").await;
    let moving = app.start_weighing(mg("sand", 5.0), "moving").await.unwrap().0.id;
    let waiting = app.start_weighing(mg("sand", 5.0), "waiting").await.unwrap().0.id;
    until("the first moves", async || gate.pours.load(Ordering::SeqCst) == 1).await;
    app.shutdown().await.unwrap();
    assert!(matches!(
        app.start_weighing(mg("sand", 5.0), "late").await,
        Err(Error::Unavailable(_))
    ));
    drop(app);
    let app = open_in(folder.path(), functions()).await;
    assert_eq!(app.weighing(&moving).await.unwrap().weighing.outcome, Some(Outcome::Stopped));
    assert_eq!(done(&app, &waiting).await.outcome, Some(Outcome::Within));
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_pour_that_panics_is_recorded_and_the_next_one_goes_on() {
    let frail = |pouring: &Pouring, on_event: OnEvent<'_>, stop: &AtomicBool| {
        assert!(pouring.task.order.target_mg > 6.0, "the bench is broken");
        pour(pouring, on_event, stop)
    };
    let rig = ToyRig::of(BenchKind::Simulated, frail);
    let (_folder, app) = open(Functions { rig, ..functions() }).await;
    trained(&app, "sand").await;
    let broken = app.start_weighing(mg("sand", 5.0), "broken").await.unwrap().0.id;
    let whole = app.start_weighing(mg("sand", 7.0), "whole").await.unwrap().0.id;
    let broken = done(&app, &broken).await;
    assert_eq!((broken.state, broken.outcome), (WeighingState::Aborted, Some(Outcome::Aborted)));
    assert!(broken.error.unwrap().contains("the bench is broken"));
    assert_eq!(done(&app, &whole).await.outcome, Some(Outcome::Within));
    app.shutdown().await.unwrap();
}

/// Forecasts used by successive doses, on a bench where one shake of 4 mm dispenses half of the
/// dose.
async fn forecasts(remembers: bool) -> Vec<Forecast> {
    let seen = Arc::new(Mutex::new(Vec::new()));
    let told = seen.clone();
    let pour = move |pouring: &Pouring, on_event: OnEvent<'_>, stop: &AtomicBool| {
        told.lock().unwrap().push(pouring.expected.forecast);
        let mut poured = pour(pouring, on_event, stop);
        poured.ticks[1..].iter_mut().for_each(|tick| tick.action.shake_mm = 4.0);
        // The third one did not run its course: its results must not be used.
        if pouring.task.order.target_mg == 9.0 {
            poured.outcome = Outcome::NotStable;
        }
        poured
    };
    let rig = Arc::new(ToyRig { kind: BenchKind::Emulated, remembers, pour });
    let (_folder, app) = open(Functions { rig, ..functions() }).await;
    calibrated(&app, "sand").await;
    calibrated(&app, "sugar").await;
    for (key, (powder, target_mg)) in
        [("sand", 15.0), ("sugar", 15.0), ("sand", 9.0), ("sand", 5.0)].into_iter().enumerate()
    {
        let weighing =
            app.start_weighing(mg(powder, target_mg), &format!("dose-{key}")).await.unwrap().0;
        done(&app, &weighing.id).await;
    }
    app.shutdown().await.unwrap();
    seen.lock().unwrap().clone()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_bench_that_remembers_expects_of_a_powder_what_it_did_before() {
    let shake = |mass_mg: f64| Fall { pitch_deg: 10.0, shake_mm: 4.0, strokes: 1, mass_mg };
    let known = Forecast::GENERIC.informed(&[vec![shake(7.625), shake(7.625)]], 1.0);
    assert_ne!(known, Forecast::GENERIC);
    assert_eq!(forecasts(true).await, [Forecast::GENERIC, Forecast::GENERIC, known, known]);
    assert_eq!(forecasts(false).await, [Forecast::GENERIC; 4]);
}

/// Number of different sets with which these doses, each a lot and a seed, were simulated.
async fn sets_of(app: &App, doses: &[(Option<&str>, u64)]) -> usize {
    let mut sets = HashSet::new();
    for (k, (lot, seed)) in doses.iter().enumerate() {
        let mut request = WeighingRequest { seed: Some(*seed), ..mg("sand", 15.0) };
        request.asked.lot = lot.map(str::to_owned);
        let key = format!("{}-{seed}-{k}", lot.unwrap_or("none"));
        let weighing = app.start_weighing(request, &key).await.unwrap().0;
        sets.insert(done(app, &weighing.id).await.parameter_set);
    }
    sets.len()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_simulated_lot_is_one_powder_in_all_its_doses() {
    let (_folder, app) = open(functions()).await;
    calibrated(&app, "sand").await;
    let lots = ["a", "b", "c", "d", "e", "f"];
    let one_lot: Vec<_> = (1..7).map(|seed| (Some("a"), seed)).collect();
    let each_its_own: Vec<_> = lots.map(|lot| (Some(lot), 1)).into();
    let no_lot: Vec<_> = (1..7).map(|seed| (None, seed)).collect();
    assert_eq!(sets_of(&app, &one_lot).await, 1);
    assert!(sets_of(&app, &each_its_own).await > 1 && sets_of(&app, &no_lot).await > 1);
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn masses_are_read_in_their_units() {
    let (_folder, app) = open(functions()).await;
    trained(&app, "sand").await;
    let request = WeighingRequest {
        target: Target { value: 0.015, unit: "g".into() },
        tolerance: Tolerance { lower: 10.0, upper: 20.0, unit: "%".into() },
        ..mg("sand", 1.0)
    };
    let weighing = app.start_weighing(request, "in-grams").await.unwrap().0;
    let near = |value: f64, expected: f64| (value - expected).abs() < 1e-9;
    assert!(near(weighing.target_mg, 15.0), "{}", weighing.target_mg);
    assert!(near(weighing.tolerance_lower_mg, 1.5) && near(weighing.tolerance_upper_mg, 3.0));
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn requests_that_cannot_be_met_are_refused_and_store_nothing() {
    let (_folder, app) = open(functions()).await;
    let code = |error: Error| match error {
        Error::Conflict { code, .. } => code.to_owned(),
        Error::Invalid(fields) => {
            fields.iter().map(|f| f.field.as_str()).collect::<Vec<_>>().join(" ")
        }
        other => panic!("{other:?}"),
    };
    let refused = async |request: WeighingRequest, key: &str| {
        code(app.start_weighing(request, key).await.unwrap_err())
    };
    assert_eq!(refused(mg("sand", 15.0), "k").await, "calibration_missing");
    calibrated(&app, "sand").await;
    assert_eq!(refused(mg("sand", 15.0), "").await, "Idempotency-Key");
    assert_eq!(refused(mg("sand", 15.0), &"k".repeat(256)).await, "Idempotency-Key");
    assert_eq!(refused(mg("flour", 15.0), "k").await, "powder");
    assert_eq!(refused(mg("sand", -15.0), "k").await, "target.value");
    assert_eq!(refused(mg("sand", f64::NAN), "k").await, "target.value");
    assert_eq!(refused(mg("sand", 500.0), "k").await, "target.value");
    let unit = |unit: &str| Target { value: 15.0, unit: unit.into() };
    assert_eq!(
        refused(WeighingRequest { target: unit("kg"), ..mg("sand", 1.0) }, "k").await,
        "target.unit"
    );
    let tolerance = |lower: f64, unit: &str| Tolerance { lower, upper: 1.0, unit: unit.into() };
    let with = |tolerance: Tolerance| WeighingRequest { tolerance, ..mg("sand", 15.0) };
    assert_eq!(refused(with(tolerance(-1.0, "mg")), "k").await, "tolerance.lower");
    assert_eq!(refused(with(tolerance(f64::INFINITY, "%")), "k").await, "tolerance.lower");
    assert_eq!(refused(with(tolerance(101.0, "%")), "k").await, "tolerance.lower");
    assert_eq!(refused(with(tolerance(1.0, "ml")), "k").await, "tolerance.unit");
    let narrow = Tolerance { lower: 0.1, upper: 0.1, unit: "mg".into() };
    assert_eq!(refused(with(narrow), "k").await, "tolerance.upper", "the display steps by 1 mg");
    let unknown = WeighingRequest { policy: Some("p-0".into()), ..mg("sand", 15.0) };
    assert_eq!(refused(unknown, "k").await, "policy");
    assert!(
        app.weighings(Default::default(), PageQuery::default())
            .await
            .unwrap()
            .page
            .items
            .is_empty()
    );
    app.shutdown().await.unwrap();
}
