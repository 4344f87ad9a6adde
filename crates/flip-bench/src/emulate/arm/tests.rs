//! The client against the emulated driver, over TCP.

use super::*;
use crate::hardware::DeviceError;
use crate::hardware::arm::proto::arm_client::ArmClient;
use crate::hardware::arm::{Arm as Client, Deadlines, Mode};
use crate::hardware::wire::{Exchange, Tap};
use flip_core::domain::parameters::ParameterSet;
use std::net::TcpListener;
use std::time::Instant;

/// A vial of this mass stands on the pan, mg.
const VIAL_MG: f64 = 11_000.0;
/// How long a test waits for something that must come, wall-clock.
const PATIENCE: Duration = Duration::from_secs(20);

/// A dead-man that a busy machine does not trigger by itself.
const PATIENT: Settings = Settings { dead_man_ms: 1500, ..Settings::DEFAULT };
/// The same with stations close together, for motions in wall-clock time.
const NEAR: Settings = Settings { scoop_s: 0.05, approach_s: 0.05, retract_s: 0.05, ..PATIENT };

fn laboratory(settings: Settings, clock: Clock) -> (Arm, Pan) {
    let pan = Pan::holding(VIAL_MG, clock);
    let spoon = Box::new(FormulaSpoon::new(Flow::default(), 1));
    (Arm::start(settings, pan.clone(), spoon).unwrap(), pan)
}

fn client(arm: &Arm) -> Client {
    let deadlines = Deadlines {
        call: Duration::from_secs(5),
        motion: Duration::from_secs(2),
        ..Deadlines::default()
    };
    Client::connect(arm.url(), Tap::none(), deadlines).unwrap()
}

/// Wait until it is so.
fn until(what: &str, mut is_so: impl FnMut() -> bool) {
    let began = Instant::now();
    while !is_so() {
        assert!(began.elapsed() < PATIENCE, "{what} did not come");
        std::thread::sleep(Duration::from_millis(2));
    }
}

fn is_safe(arm: &Arm) -> bool {
    arm.is_level() && arm.is_retracted() && !arm.is_moving()
}

/// Fill the spoon and tilt it over the vial.
fn tilted(arm: &Arm) -> Client {
    let mut client = client(arm);
    client.acquire().unwrap();
    client.scoop().unwrap();
    client.approach().unwrap();
    client.pitch(40.0).unwrap();
    client
}

#[test]
fn a_dose_lands_on_the_pan_and_what_is_left_goes_back() {
    let (arm, pan) = laboratory(PATIENT, Clock::standing());
    let mut client = tilted(&arm);
    let full_mg = arm.spoon_mg();
    let shakes: Vec<_> = (0..5).map(|_| client.shake(8.0).unwrap()).collect();
    let poured_mg = pan.final_load_mg() - VIAL_MG;
    assert!(poured_mg > 1.0 && (full_mg - arm.spoon_mg() - poured_mg).abs() < 1e-9, "{poured_mg}");
    for shake in shakes {
        assert!((shake.amplitude_mm - (0.94 * 8.0 - 0.1)).abs() < 1e-9);
        assert!(
            shake.peak_speed_m_s > 0.0 && shake.peak_speed_m_s < 0.75 && shake.pitch_deg == 40.0
        );
    }
    assert_eq!(client.retract().unwrap().pitch_deg, 0.0);
    client.discard().unwrap();
    assert_eq!((arm.spoon_mg(), is_safe(&arm)), (0.0, true));
    until("the last state", || {
        let state = client.state().unwrap();
        state.mode() == Mode::Ready && state.last_shake.is_some_and(|shake| shake.sequence == 8)
    });
    let logged: f64 = arm.log().iter().map(|event| event.poured_mg).sum();
    assert!((logged - poured_mg).abs() < 1e-9);
}

#[test]
fn powder_that_is_shaken_off_elsewhere_never_reaches_the_pan() {
    let (arm, pan) = laboratory(PATIENT, Clock::standing());
    let mut client = client(&arm);
    client.acquire().unwrap();
    client.scoop().unwrap();
    client.pitch(45.0).unwrap();
    assert!(client.shake(16.0).unwrap().amplitude_mm > 10.0);
    assert!(arm.spoon_mg() < 40.0);
    assert_eq!(pan.final_load_mg(), VIAL_MG);
}

#[test]
fn the_simulators_powder_doses_the_same_every_time() {
    let dose = || {
        let pan = Pan::holding(VIAL_MG, Clock::standing());
        let grains = flip_sim::dispense::Settings { particles: 300, ..Default::default() };
        let spoon = Box::new(GrainsSpoon::new(&ParameterSet::default(), &grains, 5));
        let arm =
            Arm::start(Settings { dead_man_ms: 60_000, ..Settings::DEFAULT }, pan.clone(), spoon)
                .unwrap();
        let deadlines = Deadlines {
            motion: Duration::from_secs(120),
            idle: PATIENCE * 20,
            ..Deadlines::default()
        };
        let mut client = Client::connect(arm.url(), Tap::none(), deadlines).unwrap();
        client.acquire().unwrap();
        client.scoop().unwrap();
        client.approach().unwrap();
        client.pitch(45.0).unwrap();
        for _ in 0..2 {
            client.shake(14.0).unwrap();
        }
        client.retract().unwrap();
        (pan.final_load_mg() - VIAL_MG, arm.spoon_mg(), pan.clock().now_s())
    };
    let (first, second) = (dose(), dose());
    assert_eq!(first, second);
    assert!(first.0 > 0.0 && first.1 > 0.0, "{first:?}");
}

#[test]
fn an_owner_that_goes_gives_control_back_with_a_level_retracted_spoon() {
    let (arm, _) = laboratory(PATIENT, Clock::standing());
    drop(tilted(&arm));
    assert!(is_safe(&arm) && arm.latched().is_none());
    let mut next = client(&arm);
    next.acquire().unwrap();
    let last = *arm.log().last().unwrap();
    assert_eq!((last.motion, last.why, last.ended), (Asked::Retract, Why::Released, None));
}

#[test]
fn a_client_that_dies_without_a_word_sets_off_the_dead_man() {
    let (arm, _) = laboratory(Settings::DEFAULT, Clock::standing());
    let url = arm.url().to_owned();
    std::thread::spawn(move || {
        raw(&url, |mut driver| async move { raw_tilted(&mut driver).await })
    })
    .join()
    .unwrap();
    until("the dead-man", || is_safe(&arm) && arm.latched().is_some());
    let mut client = client(&arm);
    let refusal = client.acquire().unwrap_err().to_string();
    assert!(refusal.contains("nobody renewed"), "{refusal}");
    assert_eq!(client.describe().unwrap().latch_cause, "nobody renewed the lease in time");
    client.recover("Ada").unwrap();
    client.acquire().unwrap();
    assert_eq!(arm.log().iter().filter(|event| event.why == Why::DeadMan).count(), 1);
}

#[test]
fn a_busy_machine_ends_no_lease_of_an_emulated_arm() {
    let (arm, _) = laboratory(Settings::DEFAULT, Clock::standing());
    let mut client = tilted(&arm);
    for _ in 0..3 {
        arm.driver.hold_up(Duration::from_millis(500));
        client.shake(8.0).unwrap();
    }
    assert_eq!(arm.latched(), None);
}

#[test]
fn after_the_dead_man_the_cause_is_told_and_not_the_next_step() {
    let (arm, _) =
        laboratory(Settings { dead_man_ms: 100, ..Settings::DEFAULT }, Clock::standing());
    let mut client = tilted(&arm);
    arm.inject(Fault::CommunicationLoss);
    until("the dead-man", || is_safe(&arm) && arm.latched().is_some());
    arm.clear();
    until("the connection", || client.describe().is_ok());
    let latched = |error: DeviceError| match error {
        DeviceError::Latched { cause, .. } => cause,
        other => panic!("{other}"),
    };
    assert_eq!(latched(client.retract().unwrap_err()), "nobody renewed the lease in time");
    assert_eq!(latched(client.acquire().unwrap_err()), "nobody renewed the lease in time");
}

#[test]
fn a_latched_arm_is_told_from_a_busy_one() {
    let (arm, _) = laboratory(PATIENT, Clock::standing());
    let mut second = client(&arm);
    let mut first = tilted(&arm);
    assert!(matches!(second.acquire(), Err(DeviceError::Forbidden { .. })));
    arm.inject(Fault::UserStop);
    assert!(
        matches!(first.shake(8.0), Err(DeviceError::Latched { cause, .. }) if cause.contains("user stop"))
    );
    assert!(matches!(second.acquire(), Err(DeviceError::Latched { .. })));
}

#[test]
fn an_owner_that_hangs_counts_as_dead() {
    let (arm, _) = laboratory(Settings::DEFAULT, Clock::standing());
    let deadlines = Deadlines { idle: Duration::from_millis(200), ..Deadlines::default() };
    let mut client = Client::connect(arm.url(), Tap::none(), deadlines).unwrap();
    client.acquire().unwrap();
    client.approach().unwrap();
    until("the dead-man", || is_safe(&arm) && arm.latched().is_some());
    assert!(client.pitch(10.0).unwrap_err().to_string().contains("nobody attended"));
}

#[test]
fn stop_ends_a_motion_under_way_and_the_weighing_with_it() {
    let (arm, pan) = laboratory(Settings { approach_s: 1.5, ..NEAR }, Clock::wall());
    let mut client = client(&arm);
    let stopper = client.stopper().unwrap();
    client.acquire().unwrap();
    let began = Instant::now();
    let stopped = std::thread::scope(|scope| {
        let motion = scope.spawn(|| client.approach());
        until("the motion", || arm.is_moving());
        stopper.stop("a test").unwrap();
        let answered = began.elapsed();
        (motion.join().unwrap(), answered)
    });
    assert!(stopped.0.unwrap_err().to_string().contains("stopped"));
    assert!(stopped.1 < Duration::from_millis(1400), "it takes 1.5 s to complete");
    assert!(!arm.is_retracted(), "it stands where it was");
    assert!(client.pitch(5.0).unwrap_err().to_string().contains("was stopped"));
    client.retract().unwrap();
    assert!(is_safe(&arm) && pan.final_load_mg() == VIAL_MG);
    assert!(
        matches!(client.approach(), Err(DeviceError::Forbidden { .. })),
        "a new lease is needed"
    );
    client.release().unwrap();
    client.acquire().unwrap();
}

#[test]
fn a_motion_whose_answer_does_not_come_is_stopped() {
    let (arm, _) = laboratory(Settings { approach_s: 30.0, ..NEAR }, Clock::wall());
    let deadlines = Deadlines { motion: Duration::from_millis(300), ..Deadlines::default() };
    let mut client = Client::connect(arm.url(), Tap::none(), deadlines).unwrap();
    client.acquire().unwrap();
    assert!(matches!(client.approach(), Err(DeviceError::Silent { .. })));
    assert!(!arm.is_retracted());
    client.retract().unwrap();
    assert!(is_safe(&arm));
}

#[test]
fn after_stop_has_answered_nothing_more_falls() {
    let (arm, pan) = laboratory(NEAR, Clock::wall());
    let mut client = tilted(&arm);
    let stopper = client.stopper().unwrap();
    let (load, held) = std::thread::scope(|scope| {
        let shake = scope.spawn(|| client.shake(16.0));
        until("powder", || pan.final_load_mg() > VIAL_MG);
        stopper.stop("a test").unwrap();
        let load = pan.final_load_mg();
        assert!(shake.join().unwrap().is_err());
        (load, arm.spoon_mg())
    });
    client.retract().unwrap();
    assert_eq!(pan.final_load_mg(), load);
    assert!((held + load - VIAL_MG - 40.0).abs() < 1e-9, "what did not fall is in the spoon");
    assert!(is_safe(&arm));
}

#[test]
fn a_repeated_number_moves_nothing_and_answers_as_before() {
    let (arm, pan) = laboratory(Settings { dead_man_ms: 60_000, ..PATIENT }, Clock::standing());
    let url = arm.url().to_owned();
    raw(&url, |mut driver| async move {
        let lease_id = raw_tilted(&mut driver).await;
        let ticket =
            |sequence| Some(proto::Ticket { lease_id: lease_id.clone(), sequence, deadline_ms: 0 });
        let shake =
            |sequence, amplitude_mm| proto::ShakeRequest { ticket: ticket(sequence), amplitude_mm };
        let first = driver.shake(shake(9, 8.0)).await.unwrap().into_inner();
        assert_eq!(driver.shake(shake(9, 8.0)).await.unwrap().into_inner(), first);
        for again in [shake(9, 8.5), shake(8, 8.0)] {
            assert_eq!(driver.shake(again).await.unwrap_err().code(), tonic::Code::AlreadyExists);
        }
        for wrong in [shake(10, f64::NAN), shake(10, 16.5), shake(10, -1.0), shake(0, 1.0)] {
            assert_eq!(driver.shake(wrong).await.unwrap_err().code(), tonic::Code::InvalidArgument);
        }
        let stranger = proto::ShakeRequest {
            ticket: Some(proto::Ticket {
                lease_id: "another".to_owned(),
                sequence: 10,
                deadline_ms: 0,
            }),
            amplitude_mm: 8.0,
        };
        assert_eq!(driver.shake(stranger).await.unwrap_err().code(), tonic::Code::PermissionDenied);
    });
    let shakes: Vec<_> =
        arm.log().into_iter().filter(|event| matches!(event.motion, Asked::Shake(_))).collect();
    assert_eq!(shakes.len(), 1);
    assert!((pan.final_load_mg() - VIAL_MG - shakes[0].poured_mg).abs() < 1e-9);
}

#[test]
fn a_motion_whose_connection_breaks_is_asked_for_again_and_made_once() {
    let (arm, pan) = laboratory(NEAR, Clock::wall());
    let mut client = tilted(&arm);
    let shaken = std::thread::scope(|scope| {
        let shake = scope.spawn(|| client.shake(16.0));
        until("powder", || pan.final_load_mg() > VIAL_MG);
        arm.inject(Fault::CommunicationLoss);
        arm.clear();
        shake.join().unwrap().unwrap()
    });
    let shakes: Vec<_> =
        arm.log().into_iter().filter(|event| matches!(event.motion, Asked::Shake(_))).collect();
    assert_eq!((shakes.len(), shakes[0].amplitude_mm), (1, shaken.amplitude_mm));
    client.retract().unwrap();
}

#[test]
fn one_client_has_control_at_a_time() {
    let (arm, _) = laboratory(PATIENT, Clock::standing());
    let (mut first, mut second) = (client(&arm), client(&arm));
    first.acquire().unwrap();
    assert!(second.acquire().unwrap_err().to_string().contains("somebody else has control"));
    assert!(second.approach().unwrap_err().to_string().contains("acquire the arm first"));
    first.release().unwrap();
    second.acquire().unwrap();
}

#[test]
fn every_fault_ends_with_a_safe_spoon_or_a_latched_arm() {
    for fault in Fault::ALL {
        let (arm, pan) = laboratory(PATIENT, Clock::standing());
        let mut client = tilted(&arm);
        arm.inject(fault);
        let before_mg = pan.final_load_mg();
        if fault == Fault::StateStreamLost {
            until("the end of the states", || client.state().is_err());
        }
        let shaken = client.shake(8.0);
        let way_out = client.retract();
        let is_fatal = !matches!(fault, Fault::SlowReply(_) | Fault::ShakeTooLarge(_));
        assert_eq!(
            shaken.is_err() || way_out.is_err(),
            is_fatal,
            "{fault:?}: {shaken:?} {way_out:?}"
        );
        if let (Fault::ShakeTooLarge(factor), Ok(shake)) = (fault, &shaken) {
            assert!((shake.amplitude_mm - factor * 7.42).abs() < 1e-9);
        }
        drop(client);
        until(fault.name(), || !arm.is_moving() && (is_safe(&arm) || arm.latched().is_some()));
        assert!(pan.final_load_mg() - before_mg < 20.0, "{fault:?}");
        recovers(&arm, fault);
    }
}

/// Once the fault is gone and a person has checked the arm, it works again.
fn recovers(arm: &Arm, fault: Fault) {
    if fault == Fault::UserStop {
        assert!(client(arm).recover("Ada").unwrap_err().to_string().contains("still pressed"));
    }
    arm.clear();
    let mut client = client(arm);
    client.recover("Ada").unwrap();
    assert!(is_safe(arm) && arm.latched().is_none(), "{fault:?}");
    client.acquire().unwrap();
    client.scoop().unwrap();
}

#[test]
fn a_broken_connection_sets_off_the_dead_man() {
    let (arm, _) = laboratory(Settings::DEFAULT, Clock::standing());
    let mut client = tilted(&arm);
    arm.inject(Fault::CommunicationLoss);
    assert!(matches!(client.shake(8.0), Err(DeviceError::Lost { .. })));
    until("the dead-man", || is_safe(&arm) && arm.latched().is_some());
    arm.clear();
    until("the connection", || client.describe().is_ok());
    assert!(!client.description().latch_cause.is_empty());
}

#[test]
fn states_show_a_motion_while_it_lasts() {
    let (arm, _) = laboratory(NEAR, Clock::wall());
    let mut client = tilted(&arm);
    let url = arm.url().to_owned();
    let shown = std::thread::spawn(move || {
        raw(&url, |mut driver| async move {
            let mut states =
                driver.stream_state(proto::StreamStateRequest {}).await.unwrap().into_inner();
            let mut furthest_mm = 0.0f64;
            while let Some(state) = states.message().await.unwrap() {
                furthest_mm = furthest_mm.max(state.shake_displacement_mm);
                if let Some(shake) = state.last_shake {
                    return (furthest_mm, shake.amplitude_mm);
                }
            }
            (0.0, 0.0)
        })
    });
    std::thread::sleep(Duration::from_millis(100));
    client.shake(16.0).unwrap();
    let (furthest_mm, executed_mm) = shown.join().unwrap();
    assert!(
        furthest_mm > 0.5 * executed_mm && furthest_mm <= executed_mm,
        "{furthest_mm} of {executed_mm}"
    );
}

#[test]
fn every_call_and_answer_is_heard_by_the_tap() {
    let (arm, _) = laboratory(PATIENT, Clock::standing());
    let heard = Arc::new(Mutex::new(Vec::<Exchange>::new()));
    let hearing = heard.clone();
    let tap = Tap::new(move |exchange| hearing.lock().unwrap().push(exchange));
    let mut client = Client::connect(arm.url(), tap, Deadlines::default()).unwrap();
    client.acquire().unwrap();
    client.pitch(12.5).unwrap();
    assert!(
        client.scoop().is_ok() && client.shake(99.0).is_err(),
        "what is refused here is not sent"
    );
    drop(client);
    let texts: Vec<String> =
        heard.lock().unwrap().iter().map(|exchange| exchange.text.clone()).collect();
    let sent: Vec<&str> = texts.iter().step_by(2).map(String::as_str).collect();
    assert_eq!(sent, ["Describe", "Acquire", "1 Pitch to 12.5 deg", "2 Scoop", "Release"]);
    assert!(texts[5].contains("pitch_deg: 12.5"), "{}", texts[5]);
}

#[test]
fn nothing_that_listens_is_no_arm() {
    let port = TcpListener::bind(("127.0.0.1", 0)).unwrap().local_addr().unwrap();
    for url in [format!("http://{port}"), "no address".to_owned()] {
        assert!(matches!(
            Client::connect(&url, Tap::none(), Deadlines::default()),
            Err(DeviceError::Lost { .. })
        ));
    }
}

type Driver = ArmClient<tonic::transport::Channel>;

/// Call a driver directly, as only a test should.
fn raw<A, F: Future<Output = A>>(url: &str, talk: impl FnOnce(Driver) -> F) -> A {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async { talk(ArmClient::connect(url.to_owned()).await.unwrap()).await })
}

/// Take control, fill the spoon and tilt it over the vial, with sequence numbers 1 to 3; returns
/// the lease.
async fn raw_tilted(driver: &mut Driver) -> String {
    let lease = driver
        .acquire(proto::AcquireRequest { client: "test".to_owned() })
        .await
        .unwrap()
        .into_inner();
    let ticket = |sequence| {
        Some(proto::Ticket { lease_id: lease.lease_id.clone(), sequence, deadline_ms: 0 })
    };
    driver.scoop(proto::ScoopRequest { ticket: ticket(1) }).await.unwrap();
    driver.approach(proto::ApproachRequest { ticket: ticket(2) }).await.unwrap();
    driver.pitch(proto::PitchRequest { ticket: ticket(3), pitch_deg: 40.0 }).await.unwrap();
    lease.lease_id
}
