//! Balances that know less, report less or format differently than most of their dialect.

use super::probe::{self, Probe};
use super::{Balance, Dialect, Settings, StableBy};
use crate::emulate::port::{Port, Talker};
use crate::hardware::DeviceError;
use crate::hardware::clock::Clock;
use crate::hardware::line::Serial;
use crate::hardware::wire::Tap;
use Dialect::{Aandd, MtSics, Ohaus, Sbi};
use rustix::fs::{Mode, OFlags};
use std::sync::{Arc, OnceLock};

/// A balance that answers whole commands, without their terminators, by a function.
struct Terse<F>(F);

impl<F: FnMut(&str) -> Option<String> + Send + 'static> Talker for Terse<F> {
    fn hear(&mut self, bytes: &[u8], say: &mut dyn FnMut(&[u8])) {
        for command in String::from_utf8_lossy(bytes).split_terminator("\r\n") {
            if let Some(line) = self.0(command) {
                say(format!("{line}\r\n").as_bytes());
            }
        }
    }
}

fn driver(port: &Port, dialect: Dialect, change: impl FnOnce(&mut Settings)) -> Balance {
    let mut settings = Settings {
        timeout_s: 0.25,
        stable_timeout_s: 8.0,
        ..Settings::new(dialect, port.address())
    };
    change(&mut settings);
    Balance::open(&settings, Tap::none(), Clock::fast(4.0)).unwrap()
}

/// A balance with the minimum of its dialect: reading, tare and zero. `other` is its answer to
/// everything else.
fn least(dialect: Dialect, other: Option<&'static str>) -> Port {
    let (gross, mut tare) = (15_000_i64, 0);
    Port::pty(Terse(move |command: &str| {
        let number = |mg: i64| format!("{}.{:03}", mg / 1000, mg % 1000);
        match (dialect, command) {
            (MtSics, "SI") => Some(format!("S S {:>10} g", number(gross - tare))),
            (MtSics, "T") => {
                tare = gross;
                Some(format!("T S {:>10} g", number(tare)))
            }
            (Ohaus, "IP") => Some(format!("{:>11} g", number(gross - tare))),
            (Sbi, "\u{1b}P") => Some(format!("+{:>9} g  ", number(gross - tare))),
            (Aandd, "Q") => Some(format!("ST,+{:0>9}  g", number(gross - tare))),
            (Ohaus | Aandd, "T") | (Sbi, "\u{1b}T") => {
                tare = gross;
                None
            }
            _ => other.map(str::to_owned),
        }
    }))
    .unwrap()
}

#[test]
fn a_balance_that_refuses_or_ignores_every_optional_command_weighs_and_tares() {
    for (dialect, other) in [
        (MtSics, Some("ES")),
        (MtSics, Some("I4 L")),
        (MtSics, None),
        (Ohaus, Some("ES")),
        (Ohaus, None),
        (Sbi, Some("Stat    Err 01      ")),
        (Sbi, None),
        (Aandd, Some("EC,E01")),
        (Aandd, None),
    ] {
        let port = least(dialect, other);
        let mut balance = driver(&port, dialect, |_| {});
        let before = balance.immediate().map(|sample| sample.mass_mg);
        assert_eq!(before, Ok(15_000.0), "{dialect:?} {other:?}");
        let told = balance.identify();
        assert!(
            told.as_ref().map_or(other.is_none(), |it| it.is_unknown()),
            "{dialect:?} {other:?}: {told:?}"
        );
        assert_eq!(balance.tare().map(|sample| sample.mass_mg), Ok(0.0), "{dialect:?} {other:?}");
    }
}

#[test]
fn a_probe_finds_a_balance_with_the_least_of_its_dialect() {
    for (dialect, other) in
        [(MtSics, Some("ES")), (Ohaus, None), (Sbi, None), (Aandd, Some("EC,E01"))]
    {
        let port = least(dialect, other);
        let found = probe::probe(port.address(), &[Serial::default()], Tap::none(), |_| {});
        assert_eq!(found.dialect, Some(dialect), "{found:?}");
        assert!(found.identity.is_some_and(|it| it.is_unknown()));
    }
}

/// MT-SICS readings that stay within 0.2 mg and are never flagged stable; `at_once`: it can tare
/// immediately.
fn unflagged(at_once: bool) -> Port {
    let (mut asked, mut tare) = (0, 0);
    Port::pty(Terse(move |command: &str| {
        asked += 1;
        let tenths = 84_000 - tare + asked % 3;
        let number = format!("{}.{:04}", tenths / 10_000, tenths % 10_000);
        match command {
            "I4" => Some("I4 A \"77\"".to_owned()),
            "SI" => Some(format!("S D {number:>10} g")),
            // It waits for a stable reading, which never comes.
            "T" if at_once => Some("T I".to_owned()),
            "T" | "TI" if at_once || command == "T" => {
                tare = 84_000;
                Some(format!("{command} D     8.4000 g"))
            }
            _ => Some("ES".to_owned()),
        }
    }))
    .unwrap()
}

#[test]
fn a_balance_that_never_flags_stable_says_what_to_set() {
    let port = unflagged(true);
    let refused = driver(&port, MtSics, |_| {}).tare().unwrap_err().to_string();
    assert!(
        refused.contains("never flags") && refused.contains("stable_by = \"window\""),
        "{refused}"
    );
}

#[test]
fn a_balance_that_never_flags_stable_is_tared_by_our_own_window() {
    for at_once in [true, false] {
        let port = unflagged(at_once);
        let mut balance = driver(&port, MtSics, |settings| settings.stable_by = StableBy::Window);
        let zero = balance.tare().unwrap();
        assert!(zero.stable && zero.mass_mg.abs() <= 0.2, "{zero:?}");
    }
}

#[test]
fn a_balance_that_leaves_out_the_unit_for_ever_is_read_by_its_step_or_says_what_to_set() {
    let mut tare = 0;
    let port = Port::pty(Terse(move |command: &str| {
        if command == "\u{1b}T" {
            tare = 84_000;
        }
        let shown = 84_000 - tare;
        (command == "\u{1b}P").then(|| {
            format!("N     +{:>9}    ", format!("{}.{:04}", shown / 10_000, shown % 10_000))
        })
    }))
    .unwrap();
    let refused = driver(&port, Sbi, |_| {}).tare().unwrap_err().to_string();
    assert!(refused.contains("stable_by = \"window\""), "{refused}");
    let by_window = |settings: &mut Settings| {
        (settings.stable_by, settings.readability_mg) = (StableBy::Window, Some(0.1));
    };
    let mut balance = driver(&port, Sbi, by_window);
    assert_eq!(balance.immediate().map(|sample| sample.mass_mg), Ok(8400.0));
    assert_eq!(balance.tare().map(|sample| sample.mass_mg), Ok(0.0));
}

#[test]
fn our_own_window_holds_no_display_that_creeps_for_one_that_stands() {
    let mut asked = 0;
    let port = Port::pty(Terse(move |command: &str| {
        asked += 1;
        // 1 mg more with each frame, however slowly they are requested.
        (command != "I4").then(|| format!("S D {:>10} g", format!("8.{asked:03}0")))
    }))
    .unwrap();
    let mut balance = driver(&port, MtSics, |settings| settings.stable_by = StableBy::Window);
    let refused = balance.tare().unwrap_err().to_string();
    assert!(refused.contains("never stand"), "{refused}");
}

#[test]
fn our_own_command_that_comes_back_is_no_answer() {
    for dialect in Dialect::ALL {
        let echoing = |command: &str| {
            let answer = match command {
                "I4" => "I4 A \"77\"",
                "SI" => "S S      8.400 g",
                "IP" => "      8.400 g",
                "Q" => "ST,+00008.400  g",
                "\u{1b}P" => "+    8.400 g  ",
                _ => return Some(command.to_owned()),
            };
            Some(format!("{command}\r\n{answer}"))
        };
        let port = Port::pty(Terse(echoing)).unwrap();
        let read = driver(&port, dialect, |_| {}).immediate().map(|sample| sample.mass_mg);
        assert_eq!(read, Ok(8400.0), "{dialect:?}");
        let found = probe::probe(port.address(), &[Serial::default()], Tap::none(), |_| {});
        assert_eq!(found.dialect, Some(MtSics), "{:?}", found.notes);
    }
}

/// The first note of a probe, and the result.
fn noted(answer: impl FnMut(&str) -> Option<String> + Send + 'static) -> (String, Probe) {
    let port = Port::pty(Terse(answer)).unwrap();
    let found = probe::probe(port.address(), &[Serial::default()], Tap::none(), |_| {});
    (found.notes[0].clone(), found)
}

#[test]
fn a_probe_that_hears_nothing_names_what_was_tried_and_an_echo_or_a_sleeper_is_told_as_such() {
    let (silent, found) = noted(|_| None);
    assert!(
        silent.contains("9600 bits/s 8N1") && silent.contains("--baud") && found.dialect.is_none(),
        "{silent}"
    );
    let (echo, _) = noted(|command| Some(command.to_owned()));
    assert!(echo.contains("nothing but our own questions"), "{echo}");
    let (asleep, _) = noted(|_| Some("OFF".to_owned()));
    assert!(asleep.contains("standby"), "{asleep}");
}

#[test]
fn a_port_that_cannot_be_opened_is_told_with_its_own_advice() {
    let note = |port: &str| {
        probe::probe(port, &probe::usual_settings(), Tap::none(), |_| {}).notes.join("\n")
    };
    let nowhere = note("/dev/no-such-port");
    assert!(nowhere.contains("no such port") && !nowhere.contains("cable,"), "{nowhere}");
    // Bound and dropped: nothing listens there.
    let closed = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let refused = note(&format!("tcp://{closed}"));
    assert!(refused.contains("nothing listens") && refused.lines().count() == 1, "{refused}");
}

#[test]
fn a_balance_that_hears_one_usual_speed_alone_is_found_at_it() {
    let path: Arc<OnceLock<String>> = Arc::default();
    let told = path.clone();
    let port = Port::pty(Terse(move |command: &str| {
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
        let terminal = rustix::fs::open(told.get()?.as_str(), flags, Mode::empty()).ok()?;
        let speed = rustix::termios::tcgetattr(&terminal).ok()?.output_speed();
        (speed == 38_400 && command == "IP").then(|| "      8.400 g".to_owned())
    }))
    .unwrap();
    path.set(port.address().to_owned()).unwrap();
    let mut attempts = 0;
    let found =
        probe::probe(port.address(), &probe::usual_settings(), Tap::none(), |_| attempts += 1);
    assert_eq!(found.serial.map(|serial| serial.baud), Some(38_400), "{:?}", found.notes);
    assert!(found.dialect == Some(Ohaus) && attempts > 1);
}

#[test]
fn a_balance_in_standby_and_one_in_another_unit_are_told_as_such() {
    for (answer, words) in [
        ("S I", "standby"),
        ("OFF", "switch it on"),
        ("S D 08:03.20 lb:oz", "it shows lb:oz: set its unit to g or mg"),
        ("S S      129.6 GN", "it shows GN"),
    ] {
        let port = Port::pty(Terse(move |command: &str| {
            Some(if command == "I4" { "ES" } else { answer }.to_owned())
        }));
        let port = port.unwrap();
        let refused = driver(&port, MtSics, |_| {}).immediate().unwrap_err();
        assert!(
            matches!(refused, DeviceError::Faulted { .. }) && refused.to_string().contains(words),
            "{refused}"
        );
    }
}

#[test]
fn a_display_that_steps_by_five_is_read_and_a_number_between_its_steps_is_damaged() {
    let shows = |number: &'static str, step_mg: f64| {
        let line = format!("S S {number:>10} g");
        let port = Port::pty(Terse(move |command: &str| {
            Some(if command == "I4" { "ES".into() } else { line.clone() })
        }));
        driver(&port.unwrap(), MtSics, |settings| settings.readability_mg = Some(step_mg))
            .immediate()
    };
    assert_eq!(shows("8.4005", 0.5).map(|sample| sample.mass_mg), Ok(8400.5));
    assert_eq!(shows("8.4004", 0.2).map(|sample| sample.mass_mg), Ok(8400.4));
    for (number, step_mg, words) in
        [("8.4003", 0.5, "step by 0.5 mg"), ("8.400", 0.5, "last place should be 0.5 mg")]
    {
        let refused = shows(number, step_mg).unwrap_err().to_string();
        assert!(refused.contains(words), "{refused}");
    }
}
