//! Every fault of the emulator, and how the driver responds.

use super::{Lab, VIAL_MG, calm, is_near, lab, lab_with, tcp, words};
use crate::emulate::balance::{Fault, Settings, Socket};
use crate::hardware::DeviceError;
use crate::hardware::balance::{self as driver, Dialect};
use crate::hardware::clock::Clock;
use crate::hardware::wire::Tap;

#[test]
fn a_balance_that_adjusts_itself_gives_no_reading() {
    for dialect in Dialect::ALL {
        let mut lab = lab(dialect, Socket::Pty);
        lab.balance.inject(Fault::Adjusting);
        for answer in [lab.driver.immediate(), lab.driver.stable(2.0), lab.driver.tare()] {
            match (dialect, answer.unwrap_err()) {
                (Dialect::Sbi, DeviceError::Forbidden { cause, .. }) => {
                    assert!(cause.contains("adjusts itself"))
                }
                (Dialect::Sbi, other) => panic!("{other}"),
                (_, error) => assert!(matches!(error, DeviceError::Faulted { .. }), "{error}"),
            }
        }
    }
}

#[test]
fn a_balance_that_is_busy_for_a_moment_is_asked_again() {
    for dialect in [Dialect::MtSics, Dialect::Sbi, Dialect::Aandd] {
        let mut lab = lab(dialect, Socket::Pty);
        lab.driver.stable(5.0).unwrap();
        lab.balance.inject_for(Fault::NotReady, 2);
        assert!(is_near(lab.driver.immediate().unwrap().mass_mg, VIAL_MG), "{dialect:?}");
    }
}

#[test]
fn in_a_draught_waiting_ends_with_a_reading_that_says_it_is_not_stable() {
    for dialect in Dialect::ALL {
        let mut lab = lab(dialect, Socket::Pty);
        lab.driver.tare().unwrap();
        lab.balance.inject(Fault::Draught);
        let began_s = lab.balance.pan().clock().now_s();
        let sample = lab.driver.stable(4.0).unwrap();
        let waited_s = lab.balance.pan().clock().now_s() - began_s;
        assert!(
            !sample.stable && (4.0..5.0).contains(&waited_s),
            "{dialect:?}: {sample:?} after {waited_s} s"
        );
        let refused = lab.driver.tare().unwrap_err();
        assert!(words(&refused).contains("no stable reading"), "{dialect:?}: {refused}");
    }
}

#[test]
fn damaged_answers_give_no_number_and_one_alone_is_asked_for_again() {
    for dialect in Dialect::ALL {
        let settings = Settings { dialect, ..calm() };
        let mut lab = lab_with(settings, Socket::Pty, |settings| settings.timeout_s = 0.4);
        lab.driver.tare().unwrap();
        for fault in [Fault::PartialLine, Fault::GarbledLine, Fault::NotANumber] {
            lab.balance.inject(fault);
            for _ in 0..4 {
                match lab.driver.immediate() {
                    // A space lost between words changes nothing.
                    Ok(sample) => assert!(
                        fault == Fault::GarbledLine && is_near(sample.mass_mg, 0.0),
                        "{sample:?}"
                    ),
                    Err(DeviceError::Lost { .. }) => {
                        panic!("{dialect:?} {fault:?}: nothing is unplugged")
                    }
                    Err(_) => {}
                }
            }
            lab.balance.clear();
            assert!(
                is_near(lab.driver.stable(5.0).unwrap().mass_mg, 0.0),
                "{dialect:?} after {fault:?}"
            );
        }
        lab.balance.inject_for(Fault::NotANumber, 1);
        assert!(
            is_near(lab.driver.immediate().unwrap().mass_mg, 0.0),
            "{dialect:?}: one damaged answer"
        );
    }
}

#[test]
fn silence_ends_in_time_and_a_pulled_plug_is_a_lost_connection() {
    for socket in [Socket::Pty, tcp()] {
        let settings = calm();
        let mut lab = lab_with(settings, socket, |settings| settings.timeout_s = 0.3);
        lab.driver.immediate().unwrap();
        lab.balance.inject(Fault::Silence);
        for _ in 0..2 {
            assert!(matches!(lab.driver.stable(20.0), Err(DeviceError::Silent { .. })));
        }
        lab.balance.clear();
        assert!(is_near(lab.driver.immediate().unwrap().mass_mg, VIAL_MG));
        lab.balance.inject(Fault::Unplug);
        assert!(matches!(lab.driver.immediate(), Err(DeviceError::Lost { .. })));
        lab.balance.plug_in().unwrap();
        let settings = driver::Settings::new(Dialect::MtSics, lab.balance.address());
        let mut again = driver::Balance::open(&settings, Tap::none(), Clock::standing()).unwrap();
        assert!(is_near(again.immediate().unwrap().mass_mg, VIAL_MG));
    }
}

#[test]
fn a_restart_is_told_where_the_dialect_tells_it_and_shows_two_milligrams_where_it_does_not() {
    for dialect in Dialect::ALL {
        let mut lab = lab(dialect, Socket::Pty);
        lab.driver.tare().unwrap();
        lab.balance.pan().add_mg(50.0);
        lab.wait_s(3.0);
        lab.balance.inject(Fault::Restart);
        // Powered down: nothing is received, and nothing waits on the bench clock.
        assert!(lab.driver.immediate().is_err(), "{dialect:?}");
        lab.wait_s(1.0);
        match (dialect, lab.driver.immediate()) {
            (Dialect::MtSics, told) => {
                assert!(words(&told.unwrap_err()).contains("switched on anew"))
            }
            (_, shown) => assert!(is_near(shown.unwrap().mass_mg, 2.0), "{dialect:?}"),
        }
        lab.driver.tare().unwrap();
        assert!(is_near(lab.driver.stable(5.0).unwrap().mass_mg, 0.0), "{dialect:?}");
    }
}

#[test]
fn an_answer_that_comes_too_late_is_never_taken_for_a_later_one() {
    for dialect in Dialect::ALL {
        let settings = Settings { dialect, slow_reply_ms: 450, ..calm() };
        let mut lab = lab_with(settings, Socket::Pty, |settings| settings.timeout_s = 0.4);
        lab.driver.tare().unwrap();
        for (round, slow) in [(1.0, 1), (2.0, 3)] {
            lab.balance.inject_for(Fault::SlowReply, slow);
            assert!(
                matches!(lab.driver.immediate(), Err(DeviceError::Silent { .. })),
                "{dialect:?}"
            );
            lab.balance.pan().add_mg(50.0);
            lab.wait_s(5.0);
            // While replies are late there may be none; the first accepted one must belong to the
            // new load.
            let now = (0..20).find_map(|_| lab.driver.immediate().ok()).unwrap();
            assert!(is_near(now.mass_mg, 50.0 * round), "{dialect:?} {slow}: {now:?}");
        }
    }
}

#[test]
fn lines_that_come_unasked_are_never_taken_for_an_answer() {
    for dialect in Dialect::ALL {
        let mut lab = lab(dialect, Socket::Pty);
        lab.driver.tare().unwrap();
        lab.driver.stable(5.0).unwrap();
        lab.balance.inject(Fault::AutoPrint);
        for step in 1..4 {
            lab.balance.pan().add_mg(20.0);
            lab.wait_s(5.0);
            let now = lab.driver.immediate().unwrap();
            assert!(is_near(now.mass_mg, 20.0 * f64::from(step)), "{dialect:?}: {now:?}");
        }
        assert!(is_near(lab.driver.tare().unwrap().mass_mg, 0.0));
        assert!(lab.driver.identify().unwrap().serial.is_some(), "{dialect:?}");
    }
}

#[test]
fn what_only_the_weighing_can_notice_shows_in_the_readings() {
    let mut lab = lab(Dialect::MtSics, Socket::Pty);
    lab.driver.tare().unwrap();
    lab.pour(30.0);
    let shown = |lab: &mut Lab| lab.driver.stable(10.0).unwrap().mass_mg;
    assert!(is_near(shown(&mut lab), 30.0));

    lab.balance.inject(Fault::Drift);
    lab.wait_s(60.0);
    assert!(is_near(shown(&mut lab), 33.0), "0.05 mg/s for a minute");
    lab.balance.clear();

    lab.balance.inject(Fault::Stuck);
    lab.balance.pan().add_mg(10.0);
    assert!(is_near(shown(&mut lab), 30.0));
    lab.balance.clear();
    assert!(is_near(shown(&mut lab), 40.0));

    lab.balance.inject(Fault::VialLifted);
    assert!(is_near(shown(&mut lab), -VIAL_MG));
    lab.balance.clear();
    assert!(is_near(shown(&mut lab), 40.0));

    lab.balance.inject(Fault::KeypadTare);
    assert!(is_near(shown(&mut lab), 0.0));
}
