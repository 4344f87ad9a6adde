//! The dry test against an emulated laboratory: no complaints when all is well, and the right
//! complaint when it is not.

use super::*;
use crate::emulate::arm::{self as arms, Flow, FormulaSpoon};
use crate::emulate::balance as balances;
use crate::emulate::gate as gates;
use crate::emulate::gripper as grippers;
use crate::emulate::lab::{Laboratory, Settings};
use crate::emulate::port::{Port, Talker};

/// Bounds that even a busy machine can keep.
const PATIENT: Bounds = Bounds {
    stop: Duration::from_millis(2000),
    dead_man: Duration::from_millis(300),
    return_begins: Duration::from_millis(5000),
    states_hz: 20.0,
    ..Bounds::CONTRACT
};

fn laboratory(balance: balances::Settings, speed: f64) -> (Laboratory, Clock) {
    laboratory_with(arms::Settings::DEFAULT.dead_man_ms, balance, speed)
}

fn laboratory_with(
    dead_man_ms: u32,
    balance: balances::Settings,
    speed: f64,
) -> (Laboratory, Clock) {
    let arm =
        arms::Settings { dead_man_ms, approach_s: 0.3, retract_s: 0.3, ..arms::Settings::DEFAULT };
    let clock = Clock::fast(speed);
    let spoon = Box::new(FormulaSpoon::new(Flow { capacity_mg: 0.0, ..Flow::default() }, 1));
    (
        Laboratory::start(Settings { balance, arm, ..Settings::default() }, clock.clone(), spoon)
            .unwrap(),
        clock,
    )
}

fn fine() -> balances::Settings {
    balances::Settings {
        readability_mg: 0.1,
        noise_mg: 0.05,
        wander_mg: 0.02,
        ..balances::Settings::default()
    }
}

/// The checks that failed, by device and name.
fn failed(checks: &[Check]) -> Vec<(&'static str, &'static str)> {
    checks
        .iter()
        .filter(|it| it.verdict == Verdict::Failed)
        .map(|it| (it.device, it.name))
        .collect()
}

#[test]
fn a_sound_laboratory_passes_and_ends_at_home_with_nothing_poured() {
    let (lab, clock) = laboratory(fine(), 1.0);
    let looked = Looked::by("Ada", true, true).unwrap();
    let report = check(&lab.file(), &looked, &PATIENT, &clock, &Tap::none());
    assert!(report.passed, "{:#?}", report.checks);
    assert_eq!(report.count(Verdict::Skipped), 1, "{:#?}", report.checks);
    assert!(lab.arm.is_level() && lab.arm.is_retracted() && lab.arm.latched().is_none());
    assert_eq!((lab.dispensed_mg(), lab.slide.opening()), (0.0, 0.0));
}

#[test]
fn nothing_moves_where_nobody_has_looked() {
    let (lab, clock) = laboratory(fine(), 1.0);
    let report = check(&lab.file(), &Looked::nobody(), &PATIENT, &clock, &Tap::none());
    assert!(report.passed, "{:#?}", report.checks);
    assert!(
        report.count(Verdict::Skipped) > 10
            && lab.arm.log().is_empty()
            && lab.slide.opening() == 0.0
    );
    assert!(Looked::by(" ", true, false).is_err());
}

#[test]
fn what_is_wrong_with_a_balance_is_named() {
    for (fault, named) in [
        (balances::Fault::Drift, "drift"),
        (balances::Fault::Draught, "stable"),
        (balances::Fault::Stuck, "life"),
        (balances::Fault::UnitSwitched, "reading"),
        (balances::Fault::Overload, "reading"),
        (balances::Fault::Unplug, "opens"),
        (balances::Fault::NotANumber, "reading"),
    ] {
        let clock = Clock::standing();
        let arm = arms::Settings { dead_man_ms: 60_000, ..arms::Settings::DEFAULT };
        let spoon = Box::new(FormulaSpoon::new(Flow::default(), 1));
        let settings = Settings { balance: fine(), arm, ..Settings::default() };
        let mut lab = Laboratory::start(settings, clock.clone(), spoon).unwrap();
        lab.balance.inject(fault);
        let found = failed(&balance::check(&lab.file(), &clock, &Tap::none()));
        assert!(found.contains(&("balance", named)), "{fault:?}: {found:?}");
    }
    let (lab, clock) = laboratory(fine(), 1.0);
    let mut file = lab.file();
    file.balance.readability_mg = Some(1.0);
    assert_eq!(failed(&balance::check(&file, &clock, &Tap::none())), [("balance", "reading")]);
}

/// The checks of an MT-SICS balance that answers commands by this function and knows no others;
/// `told` is appended to its bench file.
fn checked(
    told: &str,
    mut answer: impl FnMut(&str) -> Option<String> + Send + 'static,
) -> Vec<Check> {
    struct Answers<F>(F);
    impl<F: FnMut(&str) -> Option<String> + Send + 'static> Talker for Answers<F> {
        fn hear(&mut self, bytes: &[u8], say: &mut dyn FnMut(&[u8])) {
            for command in String::from_utf8_lossy(bytes).split_terminator("\r\n") {
                say(format!("{}\r\n", (self.0)(command).unwrap_or_else(|| "ES".to_owned()))
                    .as_bytes());
            }
        }
    }
    let port = Port::pty(Answers(move |command: &str| answer(command))).unwrap();
    let text = format!(
        "[balance]\ndialect = \"mt_sics\"\nport = \"{}\"\nstable_timeout_s = 4\n{told}\n[arm]\nurl = \"http://h:1\"\n\
         [readings]\nstand_max_s = 4\nlife_s = 2",
        port.address()
    );
    balance::check(&BenchFile::parse(&text).unwrap(), &Clock::fast(4.0), &Tap::none())
}

/// Readings of a balance with this step in its last place of 0.1 mg, going up and down by one, and
/// its tare.
fn weighs_in(step: i64, status: char) -> impl FnMut(&str) -> Option<String> + Send {
    let (mut asked, mut tare) = (0, 0);
    move |command: &str| {
        asked += 1;
        let gross = 91_000 + step * [0, 1, 0, -1][asked % 4];
        let number = |tenths: i64| {
            format!(
                "{:>10}",
                format!(
                    "{}{}.{:04}",
                    if tenths < 0 { "-" } else { "" },
                    tenths.abs() / 10_000,
                    tenths.abs() % 10_000
                )
            )
        };
        match command {
            "SI" => Some(format!("S {status} {} g", number(gross - tare))),
            "T" => {
                tare = 91_000;
                Some(format!("T S {} g", number(tare)))
            }
            _ => None,
        }
    }
}

fn named<'a>(checks: &'a [Check], name: &str) -> &'a Check {
    checks.iter().find(|check| check.name == name).unwrap()
}

#[test]
fn a_balance_with_the_least_of_mt_sics_passes_and_its_identity_is_a_warning() {
    let checks = checked("readability_mg = 0.1", weighs_in(1, 'S'));
    assert_eq!(failed(&checks), [], "{checks:#?}");
    assert_eq!(named(&checks, "identity").verdict, Verdict::Warning);
    assert_eq!(named(&checks, "tare").verdict, Verdict::Ok);
}

#[test]
fn a_display_that_steps_by_five_is_seen_by_its_numbers() {
    let wrong = checked("readability_mg = 0.1", weighs_in(5, 'S'));
    let step = named(&wrong, "step");
    assert!(step.verdict == Verdict::Failed && step.came.starts_with("0.5 mg"), "{step:?}");
    assert!(step.advice.as_ref().unwrap().contains("readability_mg = 0.5"), "{step:?}");
    let right = checked("readability_mg = 0.5", weighs_in(5, 'S'));
    assert_eq!(named(&right, "step").verdict, Verdict::Ok, "{right:#?}");
    assert_eq!(named(&right, "reading").verdict, Verdict::Ok);
}

#[test]
fn a_balance_that_never_flags_stable_is_told_as_such_and_passes_by_our_own_window() {
    let without = checked("readability_mg = 0.1", weighs_in(1, 'D'));
    for name in ["stable", "tare"] {
        let check = named(&without, name);
        let words = format!("{} {}", check.came, check.advice.clone().unwrap_or_default());
        assert!(
            check.verdict == Verdict::Failed && words.contains("stable_by = \"window\""),
            "{check:?}"
        );
    }
    let with = checked("readability_mg = 0.1\nstable_by = \"window\"", weighs_in(1, 'D'));
    assert_eq!(failed(&with), [], "{with:#?}");
}

#[test]
fn what_is_wrong_with_gripper_and_gate_is_named() {
    let (lab, _) = laboratory(fine(), 100.0);
    let file = lab.file();
    let (gripper, gate) = (file.gripper.unwrap().port, file.gate.unwrap().port);
    lab.fingers.cause(grippers::Fault::DroppedSpoon, 1);
    // They close on nothing first, and a finger that moves by itself deserves a complaint as well.
    let spoon = || fingers::check(&gripper, &Tap::none()).pop().map(|it| it.verdict);
    let began = std::time::Instant::now();
    while spoon() != Some(Verdict::Warning) {
        assert!(began.elapsed() < Duration::from_secs(10), "{:?}", spoon());
    }
    lab.fingers.cause(grippers::Fault::FaultCode, 1);
    assert!(failed(&fingers::check(&gripper, &Tap::none())).contains(&("gripper", "activated")));
    lab.slide.cause(gates::Fault::StuckHalfOpen, 1);
    let looked = Looked::by("Ada", false, true).unwrap();
    assert!(failed(&gate::check(&gate, &looked, &Tap::none())).contains(&("gate", "opens")));
    lab.slide.repair();
    lab.slide.cause(gates::Fault::Silence, 1);
    assert_eq!(failed(&gate::check(&gate, &looked, &Tap::none())), [("gate", "hello")]);
}

#[test]
fn what_is_wrong_with_an_arm_is_named() {
    let looked = Looked::by("Ada", true, false).unwrap();
    for (fault, named) in [
        (arms::Fault::ShakeTooLarge(1.5), "shake"),
        (arms::Fault::StateStreamLost, "state"),
        (arms::Fault::UserStop, "state"),
        (arms::Fault::CommunicationLoss, "describe"),
        (arms::Fault::Reflex, "pitch"),
        (arms::Fault::LevelFails, "shake"),
    ] {
        let (lab, _) = laboratory(fine(), 1.0);
        lab.arm.inject(fault);
        let found = failed(&arm::check(lab.arm.url(), &looked, &PATIENT, &Tap::none()));
        assert!(found.contains(&("arm", named)), "{fault:?}: {found:?}");
    }
}

#[test]
fn an_arm_with_another_or_too_slow_a_dead_man_or_too_few_states_does_not_keep_the_contract() {
    let (lab, _) = laboratory_with(1500, fine(), 1.0);
    let looked = Looked::by("Ada", true, false).unwrap();
    let quick = Duration::from_millis(300);
    let strict = Bounds { dead_man: quick, return_begins: 2 * quick, states_hz: 1e4, ..PATIENT };
    let found = failed(&arm::check(lab.arm.url(), &looked, &strict, &Tap::none()));
    assert_eq!(found, [("arm", "control"), ("arm", "state rate"), ("arm", "dead-man")]);
}
