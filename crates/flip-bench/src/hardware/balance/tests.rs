//! Lines as in manuals and notes, damaged lines, which of several lines is accepted, and settings.

use super::reply::{Condition, Reply, Said, Unreadable};
use super::value::Unit;
use super::{Balance, Dialect, Settings, StableBy};
use crate::emulate::port::{Port, Talker};
use crate::hardware::DeviceError;
use crate::hardware::clock::Clock;
use crate::hardware::line::{Parity, Serial};
use crate::hardware::wire::Tap;
use Dialect::{Aandd, MtSics, Ohaus, Sbi};
use std::sync::{Arc, Mutex};

fn mass(dialect: Dialect, line: &str) -> (f64, bool) {
    match dialect.parse(line.as_bytes()).map(|reply| reply.said) {
        Ok(Said::Weight(weight)) => {
            (weight.number.mg(weight.unit.unwrap_or(Unit::Gram)), weight.stable)
        }
        other => panic!("{line:?} is no mass but {other:?}"),
    }
}

#[test]
fn frames_of_each_dialect_are_read_as_shown() {
    for (dialect, line, mg, stable) in [
        (MtSics, "S S   100.0000 g", 100_000.0, true),
        (MtSics, "S D   100.0003 g", 100_000.3, false),
        (MtSics, "S S     -0.001 g", -1.0, true),
        (MtSics, "S S      -0.00 g", 0.0, true),
        (MtSics, "T S   100.0000 g", 100_000.0, true),
        (MtSics, "TA A   100.0000 g", 100_000.0, true),
        (MtSics, "S S       15.3 mg", 15.3, true),
        (MtSics, "S S   0.015287 kg", 15_287.0, true),
        (Ohaus, "     192.21 g", 192_210.0, true),
        (Ohaus, "       0.01 g ?", 10.0, false),
        (Ohaus, "      0.015 g   NET", 15.0, true),
        (Ohaus, "     -0.015 g ? NET", -15.0, false),
        (Ohaus, "       15.0 mg", 15.0, true),
        (Sbi, "+  52.1873 g  ", 52_187.3, true),
        (Sbi, "N     +  52.1873 g  ", 52_187.3, true),
        (Sbi, "N     -   0.0150 g  ", -15.0, true),
        (Sbi, "N     +  52.1873    ", 52_187.3, false),
        (Sbi, "+     15.3 mg ", 15.3, true),
        (Aandd, "ST,+00123.456  g", 123_456.0, true),
        (Aandd, "US,-00000.015  g", -15.0, false),
        (Aandd, "ST,+00123.45  g", 123_450.0, true),
        (Aandd, "ST,+0015.300 mg", 15.3, true),
        (MtSics, "S S    47,0302 g", 47_030.2, true),
        (MtSics, "S S   47.030[2] g", 47_030.2, true),
        (MtSics, "S D +47.030[2] g", 47_030.2, false),
        (Ohaus, "     47,0302 g ?", 47_030.2, false),
        (Ohaus, "     47.030[2] g", 47_030.2, true),
        (Ohaus, "ST,   47.0302 g", 47_030.2, true),
        (Ohaus, "U      -0.015 g", -15.0, false),
        (Sbi, "+  47,0302 g", 47_030.2, true),
        (Sbi, "N     -47.030[2] g", -47_030.2, true),
        (Sbi, "N     +  47.030[2] g  ", 47_030.2, true),
        (Aandd, "ST,+00047,030  g", 47_030.0, true),
        (Aandd, "ST,+0047.03[2]  g", 47_032.0, true),
        (Aandd, "US,GS,+   47.032kg", 47_032_000.0, false),
        (Aandd, "ST,NT,-   0.0150 g", -15.0, true),
        (Aandd, "U,-00000.015  g", -15.0, false),
    ] {
        assert_eq!(mass(dialect, line), (mg, stable), "{line}");
    }
}

#[test]
fn reasons_for_no_number_are_told_apart() {
    let foreign = |unit: &str| Condition::ForeignUnit(unit.to_owned());
    for (dialect, line, condition) in [
        (MtSics, "S I", Condition::NotReady),
        (MtSics, "S +", Condition::Overload),
        (MtSics, "S -", Condition::Underload),
        (MtSics, "Z I", Condition::NotReady),
        (MtSics, "S S Error 10b", Condition::Fault("Error 10b".to_owned())),
        (MtSics, "ES", Condition::Unknown),
        (MtSics, "EL", Condition::Unknown),
        (MtSics, "TA L", Condition::Unknown),
        (MtSics, "S S    0.00053 oz", foreign("oz")),
        (MtSics, "S S        153 PCS", foreign("PCS")),
        (Ohaus, "ES", Condition::Unknown),
        (Ohaus, "Err8.3", Condition::Overload),
        (Ohaus, "Err8.4", Condition::Underload),
        (Ohaus, "Err9.5", Condition::Fault("Err9.5".to_owned())),
        (Ohaus, "      0.075 ct", foreign("ct")),
        (Sbi, "Stat      High      ", Condition::Overload),
        (Sbi, "Stat      Low       ", Condition::Underload),
        (Sbi, "Stat        H       ", Condition::Overload),
        (Sbi, "Stat       Cal.Int. ", Condition::Adjusting),
        (Sbi, "Stat       - -      ", Condition::NotReady),
        (Sbi, "Stat    Err 54      ", Condition::Fault("Err 54".to_owned())),
        (Sbi, "      High    ", Condition::Overload),
        (Sbi, "N     +   0.0750 ct ", foreign("ct")),
        (Aandd, "OL,+9999999E+19", Condition::Overload),
        (Aandd, "OL,-9999999E+19", Condition::Underload),
        (Aandd, "EC,E01", Condition::Unknown),
        (Aandd, "EC,E02", Condition::NotReady),
        (Aandd, "EC,E11", Condition::Fault("EC,E11".to_owned())),
        (Aandd, "ST,+00000.075 ct", foreign("ct")),
        (MtSics, "S D  1:04.30 lb:oz", foreign("lb:oz")),
        (MtSics, "S OFF", Condition::Standby),
        (Ohaus, "   1:04.30 lb:oz ?", foreign("lb:oz")),
        (Ohaus, "STANDBY", Condition::Standby),
        (Sbi, "N     + 1:04.30 lb:oz", foreign("lb:oz")),
        (Sbi, "Stat       OFF      ", Condition::Standby),
        (Sbi, "ES", Condition::Unknown),
        (Aandd, "ST,+1:04.30 lb:oz", foreign("lb:oz")),
        (Aandd, "QT,+00000123 PC", foreign("PC")),
    ] {
        let said = dialect.parse(line.as_bytes()).map(|reply| reply.said);
        assert_eq!(said, Ok(Said::Condition(condition)), "{line}");
    }
}

#[test]
fn words_and_acknowledgements_are_told_from_readings() {
    let text = |words: &str| Said::Text(words.to_owned());
    for (dialect, line, to, said) in [
        (MtSics, r#"I4 A "B123456789""#, Some("I4"), text("B123456789")),
        (MtSics, r#"I1 A "0123" "2.30" "2.20" "" """#, Some("I1"), text("0123 2.30 2.20")),
        (MtSics, "Z A", Some("Z"), Said::Done),
        (MtSics, "ZI D", Some("ZI"), Said::Done),
        (Ohaus, "OK!", None, Said::Done),
        (Ohaus, "Explorer Sr 2.01", None, text("Explorer Sr 2.01")),
        (Sbi, "QUINTIX224-1S", None, text("QUINTIX224-1S")),
        (Sbi, "0037402012", None, text("0037402012")),
        (Aandd, "\x06", None, Said::Done),
        (Aandd, "TN,FX-300i", None, text("FX-300i")),
    ] {
        assert_eq!(
            dialect.parse(line.as_bytes()),
            Ok(Reply { to: to.map(str::to_owned), said }),
            "{line}"
        );
    }
}

#[test]
fn damaged_lines_give_no_number() {
    for (dialect, line) in [
        (MtSics, "S S   100.000 g"),
        (MtSics, "S S   100.0000"),
        (MtSics, "S S   100.0000 "),
        (MtSics, "S S        NaN g"),
        (MtSics, "S S   100.0#00 g"),
        (MtSics, "S X   100.0000 g"),
        (MtSics, "S S"),
        (MtSics, "ET"),
        (MtSics, ""),
        (MtSics, "   100.0000 g"),
        (Ohaus, "192.21 g"),
        (Ohaus, "        NaN g"),
        (Ohaus, "     192.21"),
        (Ohaus, "     192.21 g * N"),
        (Ohaus, "     192.21 g   T"),
        (Ohaus, "     1 2.21 g"),
        (Sbi, "+  52.1873"),
        (Sbi, "N     +12.00[01] g"),
        (MtSics, "S S   1,234.5 g"),
        (Sbi, "N     +  52.187 g  "),
        (Sbi, "N     +      NaN g  "),
        (Sbi, "+ 52.1873  g  "),
        (Aandd, "ST,+00123.456"),
        (Aandd, "ST,00123.4567  g"),
        (Aandd, "ST,+0000 3.456  g"),
        (Aandd, "OL,+999"),
    ] {
        let said = dialect.parse(line.as_bytes());
        assert_eq!(said, Err(Unreadable), "{line:?}");
    }
}

#[test]
fn no_bytes_make_a_parser_panic_and_no_frame_that_lost_some_gives_another_number() {
    // Bytes from SplitMix64, half of them from the alphabet of frames, so that lines come close to
    // being frames.
    let alphabet = b"STUSNZIDEOL +-.,0123456789 gmkg\"?";
    let mut drawn = 0_u64;
    let mut draw = |below: u64| {
        drawn += 1;
        flip_core::domain::seed::derive(7, &[drawn]) % below
    };
    for _ in 0..40_000 {
        let length = draw(24);
        let line: Vec<u8> = (0..length)
            .map(|_| {
                if draw(8) == 0 {
                    draw(256) as u8
                } else {
                    alphabet[draw(alphabet.len() as u64) as usize]
                }
            })
            .collect();
        for dialect in Dialect::ALL {
            let _ = dialect.parse(&line);
        }
    }
    for (dialect, frame) in [(MtSics, "S S   100.0003 g"), (Sbi, "N     +  52.1873 g  ")] {
        let whole = mass(dialect, frame).0;
        for place in 0..frame.len() {
            let mut line = frame.as_bytes().to_vec();
            line.remove(place);
            if let Ok(Reply { said: Said::Weight(weight), .. }) = dialect.parse(&line) {
                assert_eq!(
                    weight.number.mg(weight.unit.unwrap_or(Unit::Gram)),
                    whole,
                    "without byte {place}"
                );
            }
        }
    }
    for (dialect, frame) in
        [(MtSics, "S S   100.0003 g"), (Sbi, "N     +  52.1873 g  "), (Aandd, "ST,+00123.456  g")]
    {
        let whole = mass(dialect, frame).0;
        for end in 0..frame.len() {
            if let Ok(Reply { said: Said::Weight(weight), .. }) =
                dialect.parse(&frame.as_bytes()[..end])
            {
                // Trailing spaces carry no information.
                let read = weight.number.mg(weight.unit.unwrap_or(Unit::Gram));
                assert!(
                    read == whole && weight.stable,
                    "{:?} is read as {weight:?}, whole it is {whole}",
                    &frame[..end]
                );
            }
        }
    }
}

/// A balance that answers requests for readings with these lines in turn, repeating the last
/// forever.
struct Scripted(std::collections::VecDeque<&'static str>);

impl Talker for Scripted {
    fn hear(&mut self, bytes: &[u8], say: &mut dyn FnMut(&[u8])) {
        let line = match bytes {
            b"V\r\n" => "words",
            b"\x1bx1_\r\n" => "words",
            b"I4\r\n" => "I4 A \"words\"",
            _ if self.0.len() > 1 => self.0.pop_front().unwrap(),
            _ => self.0[0],
        };
        say(format!("{line}\r\n").as_bytes());
    }
}

/// What the driver makes of these replies: up to `count` readings, mg, or the first error.
fn readings(
    dialect: Dialect,
    lines: &[&'static str],
    count: usize,
) -> Result<Vec<f64>, DeviceError> {
    let port = Port::pty(Scripted(lines.iter().copied().collect())).unwrap();
    let settings = Settings { timeout_s: 0.4, ..Settings::new(dialect, port.address()) };
    let mut balance = Balance::open(&settings, Tap::none(), Clock::standing()).unwrap();
    (0..count).map(|_| balance.immediate().map(|sample| sample.mass_mg)).collect()
}

#[test]
fn a_frame_that_lost_a_digit_is_refused_however_often_it_comes() {
    for (dialect, whole, short) in
        [(Ohaus, "     12.345 g", "     2.345 g"), (Aandd, "ST,+00012.345  g", "ST,+0002.345  g")]
    {
        assert_eq!(readings(dialect, &[whole], 2), Ok(vec![12_345.0; 2]));
        let refused = readings(dialect, &[whole, whole, short], 2);
        assert!(matches!(refused, Err(DeviceError::Garbled { .. })), "{refused:?}");
        let once = readings(dialect, &[whole, whole, short, whole], 2);
        assert_eq!(once, Ok(vec![12_345.0; 2]), "one damaged frame is asked for again");
    }
}

#[test]
fn another_unit_is_believed_when_it_comes_twice_and_never_once() {
    let (grams, milligrams) = ("S S      0.015 g", "S S         15 mg");
    assert_eq!(readings(MtSics, &[grams, grams, milligrams], 3), Ok(vec![15.0; 3]));
    // A frame that lost the m of its unit, between two that did not.
    let lost = "S S         15 g";
    assert_eq!(readings(MtSics, &[milligrams, milligrams, lost, milligrams], 3), Ok(vec![15.0; 3]));
}

#[test]
fn a_moving_mass_without_a_unit_has_that_of_the_last_frame_or_none() {
    let (still, moving, other) =
        ("N     +    0.015 g  ", "N     +    0.012    ", "N     +   0.0120    ");
    assert_eq!(readings(Sbi, &[still, still, moving], 2), Ok(vec![15.0, 12.0]));
    for unknown in [&[moving][..], &[still, still, other]] {
        let refused = readings(Sbi, unknown, 2).unwrap_err();
        assert!(refused.to_string().contains("not ready"), "{refused}");
    }
}

/// A balance with a tare that can be power-cycled and swapped.
#[derive(Clone)]
struct Switched {
    serial: Arc<Mutex<&'static str>>,
    /// It identifies itself before the next reading, or after it.
    tells: Arc<Mutex<Option<bool>>>,
}

impl Switched {
    fn new() -> (Self, Port, Balance) {
        let device = Self { serial: Arc::new(Mutex::new("1")), tells: Arc::default() };
        let port = Port::pty(device.clone()).unwrap();
        let balance =
            Balance::open(&Settings::new(MtSics, port.address()), Tap::none(), Clock::standing())
                .unwrap();
        (device, port, balance)
    }
}

impl Talker for Switched {
    fn hear(&mut self, bytes: &[u8], say: &mut dyn FnMut(&[u8])) {
        let who = format!("I4 A \"{}\"\r\n", self.serial.lock().unwrap());
        let tells = if bytes == b"SI\r\n" { self.tells.lock().unwrap().take() } else { None };
        let line = match bytes {
            b"I4\r\n" => who.as_str(),
            b"T\r\n" => "T S     12.000 g\r\n",
            _ => "S S      0.000 g\r\n",
        };
        let parts = match tells {
            None => vec![line],
            Some(true) => vec![who.as_str(), line],
            Some(false) => vec![line, who.as_str()],
        };
        say(parts.concat().as_bytes());
    }
}

#[test]
fn a_balance_that_was_switched_on_anew_after_the_tare_gives_no_number_until_it_is_tared_again() {
    for before in [true, false] {
        let (device, _port, mut balance) = Switched::new();
        *device.tells.lock().unwrap() = Some(before);
        assert_eq!(balance.immediate().map(|it| it.mass_mg), Ok(0.0), "nothing is tared yet");
        balance.tare().unwrap();
        assert_eq!(
            (balance.is_the_same(), balance.immediate().map(|it| it.mass_mg)),
            (Ok(()), Ok(0.0))
        );
        *device.tells.lock().unwrap() = Some(before);
        // What it sends after a reply may be received with that reply or before the next request.
        let told = balance.immediate().and_then(|_| balance.immediate()).unwrap_err();
        assert!(told.to_string().contains("switched on anew"), "{told}");
        assert!(balance.stable(1.0).is_err() && balance.is_the_same().is_err(), "and it stays so");
        balance.tare().unwrap();
        assert_eq!(balance.immediate().map(|it| it.mass_mg), Ok(0.0));
    }
}

#[test]
fn another_balance_than_the_one_that_was_tared_is_told_by_its_serial_number() {
    let (device, _port, mut balance) = Switched::new();
    balance.tare().unwrap();
    *device.serial.lock().unwrap() = "2";
    let told = balance.is_the_same().unwrap_err().to_string();
    assert!(told.contains("serial number 2") && told.contains("weigh the vial"), "{told}");
}

#[test]
fn settings_have_the_factorys_port_and_are_checked_by_field() {
    let settings: Settings =
        serde_json::from_str(r#"{"dialect": "aandd", "port": "/dev/ttyUSB0"}"#).unwrap();
    assert_eq!(settings, Settings::new(Aandd, "/dev/ttyUSB0"));
    assert_eq!(Aandd.factory_serial(), Serial { baud: 2400, data_bits: 7, parity: Parity::Even });
    assert!(
        serde_json::from_str::<Settings>(r#"{"dialect": "ohaus", "port": "p", "speed": 1}"#)
            .is_err()
    );
    assert_eq!("sbi".parse(), Ok(Sbi));
    assert_eq!("kern".parse::<Dialect>().unwrap_err().field, "dialect");

    let good = Settings {
        readability_mg: Some(0.1),
        stable_by: StableBy::Command,
        ..Settings::new(MtSics, "tcp://h:1")
    };
    assert_eq!(good.clone().checked(), Ok(good.clone()));
    for (field, change) in [
        ("port", (|s| s.port = " ".to_owned()) as fn(&mut Settings)),
        ("baud", |s| s.serial = Some(Serial { baud: 1, ..Serial::default() })),
        ("readability_mg", |s| s.readability_mg = Some(0.0)),
        ("timeout_s", |s| s.timeout_s = f64::NAN),
        ("stable_timeout_s", |s| s.stable_timeout_s = 1e9),
    ] {
        let mut settings = good.clone();
        change(&mut settings);
        assert_eq!(settings.checked().unwrap_err().field, field);
    }
}
