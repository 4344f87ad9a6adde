//! The bytes sent by the emulator, and the probe that receives them.

use super::{VIAL_MG, calm, lab, lab_with, tcp};
use crate::emulate::balance::{Balance, Fault, Settings, Socket};
use crate::emulate::pan::Pan;
use crate::hardware::balance::{Dialect, probe};
use crate::hardware::clock::Clock;
use crate::hardware::line::{Line, Serial};
use crate::hardware::wire::{Direction, Tap};
use std::time::Duration;

#[test]
fn a_probe_names_the_dialect_changes_nothing_and_keeps_what_passed() {
    for dialect in Dialect::ALL {
        let socket = if dialect == Dialect::MtSics { tcp() } else { Socket::Pty };
        let lab = lab_with(Settings { dialect, ..calm() }, socket, |_| {});
        let address = lab.balance.address().to_owned();
        drop(lab.driver);
        let found = probe::probe(&address, &probe::usual_settings(), Tap::none(), |_| {});
        assert_eq!(found.dialect, Some(dialect), "{found:?}");
        assert!(found.identity.is_some_and(|identity| identity.serial.is_some()));
        assert!(
            found.notes.iter().any(|note| note.contains("not verified on a device")),
            "{:?}",
            found.notes
        );
        assert_eq!(lab.balance.tare_mg(), 0.0);
        let harmless = [
            "I4", "I11", "I2", "I3", "SI", "PSN", "V", "IP", "?TN", "?SN", "Q", r"\x1bx1_",
            r"\x1bx2_", r"\x1bx3_", r"\x1bP",
        ];
        for exchange in
            found.transcript.iter().filter(|exchange| exchange.direction == Direction::Sent)
        {
            assert!(harmless.contains(&exchange.text.trim_end_matches(r"\r\n")), "{exchange:?}");
        }
    }
}

#[test]
fn a_probe_of_a_silent_port_keeps_what_it_asked() {
    let lab = lab(Dialect::MtSics, tcp());
    let mut balance = lab.balance;
    drop(lab.driver);
    balance.inject(Fault::Silence);
    let found = probe::probe(balance.address(), &[Serial::default()], Tap::none(), |_| {});
    assert_eq!((found.dialect, found.transcript.len()), (None, 4), "one question in each dialect");
    assert!(found.notes[0].contains("nothing came"));
    let nowhere = probe::probe("/dev/no-such-port", &[Serial::default()], Tap::none(), |_| {});
    assert!(nowhere.notes[0].contains("/dev/no-such-port"), "{:?}", nowhere.notes);
}

/// The lines that a balance sends in reply to these commands.
fn said(settings: Settings, fault: Option<Fault>, commands: &[&str]) -> Vec<String> {
    let pan = Pan::holding(VIAL_MG, Clock::standing());
    for ahead in 0..5 {
        pan.add_at(f64::from(ahead) + 0.5, 1.0);
    }
    let mut balance = Balance::start(settings, pan, tcp()).unwrap();
    if let Some(fault) = fault {
        balance.inject(fault);
    }
    let mut line =
        Line::open("the balance", balance.address(), &Serial::default(), Tap::none()).unwrap();
    let mut lines = Vec::new();
    for command in commands {
        line.send(command.as_bytes()).unwrap();
        if let Ok(answer) = line.receive(Duration::from_millis(500)) {
            lines.push(String::from_utf8(answer).unwrap());
        }
    }
    lines
}

#[test]
fn commands_that_want_a_stable_reading_give_up_after_forty_seconds_in_the_dialects_way() {
    for (dialect, command, answer) in [
        (Dialect::MtSics, "S\r\n", "S I"),
        (Dialect::MtSics, "T\r\n", "T I"),
        (Dialect::Ohaus, "SP\r\n", "ES"),
        (Dialect::Aandd, "S\r\n", "EC,E03"),
    ] {
        let settings = Settings { dialect, ..calm() };
        assert_eq!(said(settings, Some(Fault::Draught), &[command]), [answer], "{dialect:?}");
    }
}

#[test]
fn frames_have_the_bytes_that_the_notes_show() {
    let quiet = |dialect| Settings { dialect, noise_mg: 0.0, ..calm() };
    for (dialect, command, answer) in [
        (Dialect::MtSics, "SI\r\n", "S S     12.346 g"),
        (Dialect::MtSics, "X9\r\n", "ES"),
        (Dialect::MtSics, "I4\r\n", r#"I4 A "E000000001""#),
        (Dialect::Ohaus, "IP\r\n", "     12.346 g"),
        (Dialect::Sbi, "\x1bP", "N     +   12.346 g  "),
        (Dialect::Sbi, "\x1bx2_\r\n", "0000000001"),
        (Dialect::Aandd, "Q\r\n", "ST,+00012.346  g"),
    ] {
        assert_eq!(said(quiet(dialect), None, &[command]), [answer], "{dialect:?}");
    }
}

#[test]
fn equal_questions_get_equal_answers_under_a_standing_clock() {
    let questions = ["SI\r\n", "SI\r\n", "S\r\n", "T\r\n", "SI\r\n", "S\r\n", "TA\r\n"];
    let noisy = |seed| Settings { readability_mg: 0.1, seed, ..calm() };
    let first = said(noisy(3), None, &questions);
    assert_eq!(first.len(), questions.len());
    assert_eq!(first, said(noisy(3), None, &questions));
    assert_ne!(first, said(noisy(4), None, &questions));
}

#[test]
fn readings_wander_as_those_of_an_enclosed_balance_and_no_further() {
    let settings = Settings { readability_mg: 0.1, seed: 5, ..Settings::default() };
    let (noise_mg, wander_mg, wander_s) =
        (settings.noise_mg, settings.wander_mg, settings.wander_s);
    let mut lab = lab_with(settings, tcp(), |_| {});
    let mut shown = Vec::new();
    let began_s = lab.balance.pan().clock().now_s();
    for _ in 0..2000 {
        lab.wait_s(0.4);
        shown.push(lab.driver.immediate().unwrap().mass_mg - VIAL_MG);
    }
    // A request waits for the next frame.
    let step_s = (lab.balance.pan().clock().now_s() - began_s) / shown.len() as f64;
    let rms = |values: &mut dyn Iterator<Item = f64>| {
        let (n, sum) = values.fold((0.0, 0.0), |(n, sum), it| (n + 1.0, sum + it * it));
        (sum / n).sqrt()
    };
    // Rounded to 0.1 mg; bounds are three standard errors or more for 1100 s with a correlation
    // time of 6 s.
    let expected = (noise_mg.powi(2) + wander_mg.powi(2) + 0.01 / 12.0).sqrt();
    let found = rms(&mut shown.iter().copied());
    assert!((found / expected - 1.0).abs() < 0.3, "SD {found} mg, {expected}");
    for (lag, bound) in [(1, 0.1), (5, 0.15), (10, 0.2)] {
        let kept = (-step_s * lag as f64 / wander_s).exp();
        let expected =
            (2.0 * (noise_mg.powi(2) + wander_mg.powi(2) * (1.0 - kept)) + 0.01 / 6.0).sqrt();
        let found = rms(&mut shown.windows(lag + 1).map(|window| window[lag] - window[0]));
        assert!(
            (found / expected - 1.0).abs() < bound,
            "over {lag} readings {found} mg, {expected}"
        );
    }
}

#[test]
fn faults_and_settings_are_named_as_the_command_line_names_them() {
    for fault in Fault::ALL {
        assert_eq!(fault.name().parse(), Ok(fault));
        assert_eq!(serde_json::to_value(fault).unwrap(), fault.name());
    }
    assert_eq!("gremlin".parse::<Fault>().unwrap_err().field, "fault");
    let bad = Settings { flag_after_s: [2.0, 1.0], ..calm() };
    assert_eq!(bad.checked().unwrap_err().field, "flag_after_s");
}
