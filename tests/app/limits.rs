//! Limits of an arm and a spoon, against the demands of a policy and a request.

use crate::harness::{calibrated, functions, mg, open, training_of};
use flip::app::{Error, EvaluationRequest, Functions, TrainingRequest};
use flip_bench::emulate::arm::{self, Asked, Flow, FormulaSpoon, Spoon};
use flip_bench::emulate::lab::{Laboratory, Settings};
use flip_bench::hardware::bench_file::BenchFile;
use flip_bench::hardware::clock::Clock;
use flip_bench::hardware::station::Station;
use flip_bench::hardware::wire::Tap;
use flip_bench::rig::Devices;
use flip_bench::weigh::{Order, Settings as Weighing, Weighed, weigh};
use flip_core::domain::bench::{PitchLimits, Tick};
use flip_core::domain::spoon::{FilledBy, Spoon as Measured};
use flip_core::domain::weighing::Outcome;
use flip_policy::{Controller, Rules, Schedule, ScheduledStep};
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// A policy that tips the spoon up to 45 deg and shakes it hard.
fn steep() -> Controller {
    let steps = [15.0, 30.0, 45.0].map(|pitch_deg| ScheduledStep { pitch_deg, shake_mm: 12.0 });
    Controller::Schedule(Schedule { steps: steps.to_vec() })
}

fn laboratory(arm: arm::Settings, spoon: FormulaSpoon) -> (Laboratory, Clock) {
    let clock = Clock::standing();
    let settings = Settings { arm, ..Settings::default() };
    (Laboratory::start(settings, clock.clone(), Box::new(spoon)).unwrap(), clock)
}

fn weighed(file: &BenchFile, clock: Clock) -> (Weighed, Station) {
    let mut station = Station::open(file, None, clock, &Tap::none()).unwrap();
    let order = Order {
        target_mg: 20.0,
        tolerance_lower_mg: 2.0,
        tolerance_upper_mg: 2.0,
        readability_mg: 1.0,
    };
    let settings = Weighing { forecast: None, ..Weighing::BENCH };
    let hear = |_: &flip_bench::weigh::Event<'_>| ControlFlow::Continue(());
    let stop = AtomicBool::new(false);
    (weigh(&mut station, &steep(), &Rules::FLIP, &order, &settings, hear, &stop), station)
}

#[test]
fn a_policy_that_pitches_beyond_the_arm_is_not_aborted_in_the_middle() {
    let pitch = PitchLimits { lower_deg: -5.0, upper_deg: 27.5 };
    let arm = arm::Settings { pitch, ..arm::Settings::DEFAULT };
    let (lab, clock) = laboratory(arm, FormulaSpoon::new(Flow::default(), 3));
    let (weighed, _) = weighed(&lab.file(), clock);
    assert_ne!(weighed.outcome, Outcome::Aborted, "{:?}", weighed.cause);
    let highest_deg = weighed.ticks.iter().map(|tick: &Tick| tick.pitch_deg).fold(0.0, f64::max);
    assert_eq!(highest_deg, pitch.upper_deg);
}

#[test]
fn an_arm_that_cannot_scoop_weighs_what_somebody_filled() {
    for (scoops, filled_by) in [(false, FilledBy::Arm), (true, FilledBy::Hand)] {
        let arm = arm::Settings { scoops, ..arm::Settings::DEFAULT };
        let mut spoon = FormulaSpoon::new(Flow::default(), 3);
        spoon.refill();
        let (lab, clock) = laboratory(arm, spoon);
        let mut file = lab.file();
        file.spoon = Measured { filled_by, ..Measured::default() };
        let (weighed, mut station) = weighed(&file, clock);
        assert_ne!(weighed.outcome, Outcome::Aborted, "{:?}", weighed.cause);
        assert!(weighed.reading_mg.is_some_and(|mg| mg > 5.0), "{weighed:?}");
        assert!(!lab.arm.log().iter().any(|event| event.motion == Asked::Scoop));
        assert!(station.devices().unwrap()["spoon"].contains("filled by a person"));
    }
}

/// A devices bench with this spoon, none of whose devices is there.
fn absent(spoon: &str) -> Functions {
    let devices = "[balance]\ndialect = \"sbi\"\nport = \"/dev/no-such-port\"\n[arm]\nurl = \"http://127.0.0.1:9\"\n";
    Functions {
        rig: Arc::new(Devices::new(BenchFile::parse(&format!("{devices}{spoon}")).unwrap())),
        ..functions()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_real_spoon_is_not_measured_by_the_simulated_one() {
    let asked_mg = 60.0;
    for (measured, fits) in [
        ("", false),
        ("capacity_mg = 75\n", true),
        ("capacity_mg = 50\n", false),
        ("length_mm = 16\nwidth_mm = 12\ndepth_mm = 4\n", true),
    ] {
        // An arm that fills its spoon takes several spoonfuls.
        let (_folder, app) = open(absent(&format!("[spoon]\n{measured}"))).await;
        calibrated(&app, "sand").await;
        assert!(app.start_weighing(mg("sand", asked_mg), "key").await.is_ok(), "{measured}");
        assert!(app.start_weighing(mg("sand", 1001.0), "more").await.is_err(), "{measured}");
        app.shutdown().await.unwrap();

        let spoon = &format!("[spoon]\nfilled_by = \"hand\"\n{measured}");
        let (_folder, app) = open(absent(spoon)).await;
        calibrated(&app, "sand").await;
        match app.start_weighing(mg("sand", asked_mg), "key").await {
            Ok(_) => assert!(fits, "{spoon}"),
            Err(Error::Invalid(errors)) => {
                assert!(!fits && errors[0].field == "target.value", "{spoon}: {errors:?}");
                assert_eq!(errors[0].message.contains("[spoon]"), measured.is_empty());
            }
            Err(other) => panic!("{spoon}: {other:?}"),
        }
        app.shutdown().await.unwrap();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn trainings_and_evaluations_dose_with_the_spoon_that_is_given() {
    let (_folder, app) = open(functions()).await;
    calibrated(&app, "sand").await;
    let spoon = Measured { capacity_mg: Some(75.0), ..Measured::default() };
    let asked = |spoon| EvaluationRequest {
        powders: Some(vec!["sand".into()]),
        targets_mg: Some(vec![60.0]),
        repeats: Some(1),
        spoon,
        ..Default::default()
    };
    assert!(
        matches!(app.start_evaluation(asked(None)).await, Err(Error::Invalid(_))),
        "FLIP's own holds 40 mg"
    );
    let (job, _) = app.start_evaluation(asked(Some(spoon))).await.unwrap();
    assert_eq!(app.evaluation(&job.id).await.unwrap().conditions.spoon, spoon);
    let (job, _) = app
        .start_training(TrainingRequest { spoon: Some(spoon), ..training_of("sand", 4) })
        .await
        .unwrap();
    let grains = |settings: &serde_json::Value| settings["spoon"]["particles"].as_u64().unwrap();
    assert!(grains(&app.training(&job.id).await.unwrap().settings) > 4000);
    let wrong = Measured { depth_mm: Some(3.0), ..spoon };
    for refused in [
        app.start_evaluation(asked(Some(wrong))).await.map(drop),
        app.start_training(TrainingRequest { spoon: Some(wrong), ..training_of("sand", 4) })
            .await
            .map(drop),
    ] {
        let Err(Error::Invalid(errors)) = refused else { panic!("{refused:?}") };
        assert_eq!(errors[0].field, "spoon.length_mm");
    }
    app.shutdown().await.unwrap();
}
