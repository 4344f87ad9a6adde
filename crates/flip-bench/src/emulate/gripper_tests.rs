use super::*;
use crate::emulate::port::Port;
use crate::hardware::DeviceError;
use crate::hardware::gripper::{Effort, Gripper, NoSpoon, Object};
use crate::hardware::wire::{Direction, Exchange, Tap};
use proptest::prelude::*;

struct Bench {
    fingers: Fingers,
    port: Port,
    driver: Gripper,
    frames: Arc<Mutex<Vec<Exchange>>>,
}

impl Bench {
    fn new(clock: Clock) -> Self {
        let fingers = Fingers::new(clock);
        let port = Port::pty(EmulatedGripper::new(fingers.clone())).unwrap();
        let frames = Arc::<Mutex<Vec<Exchange>>>::default();
        let kept = frames.clone();
        let tap = Tap::new(move |exchange| kept.lock().unwrap().push(exchange));
        let driver = Gripper::open(port.address(), tap).unwrap();
        Self { fingers, port, driver, frames }
    }

    fn active() -> Self {
        let mut bench = Self::new(Clock::standing());
        assert!(bench.driver.activate(no_spoon()).unwrap().activated);
        bench
    }

    fn holding() -> Self {
        let mut bench = Self::active();
        bench.fingers.set_at_rack(true);
        assert!(bench.driver.grip(Effort::FULL).unwrap().holds());
        bench
    }

    fn sent(&self) -> Vec<String> {
        let frames = self.frames.lock().unwrap();
        frames
            .iter()
            .filter(|frame| frame.direction == Direction::Sent)
            .map(|frame| frame.text.clone())
            .collect()
    }

    fn writes(&self) -> usize {
        self.sent().iter().filter(|frame| frame.starts_with("09 10")).count()
    }
}

fn no_spoon() -> NoSpoon {
    NoSpoon::seen_by("a person").unwrap()
}

fn bytes(text: &str) -> Vec<u8> {
    text.split(' ').map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect()
}

#[test]
fn the_frames_of_the_manual_pass_both_ways() {
    let mut bench = Bench::holding();
    bench.driver.release(Effort::FULL).unwrap();
    let sent = bench.sent();
    for golden in [
        "09 10 03 E8 00 03 06 00 00 00 00 00 00 73 30",
        "09 10 03 E8 00 03 06 01 00 00 00 00 00 72 E1",
        "09 03 07 D0 00 01 85 CF",
        "09 10 03 E8 00 03 06 09 00 00 FF FF FF 42 29",
        "09 03 07 D0 00 03 04 0E",
        "09 10 03 E8 00 03 06 09 00 00 00 FF FF 72 19",
    ] {
        assert!(sent.iter().any(|frame| frame == golden), "{golden} is not among {sent:#?}");
        assert!(parse(&bytes(golden)).is_ok(), "{golden}");
    }
    let received: String = {
        let frames = bench.frames.lock().unwrap();
        let received = frames.iter().filter(|frame| frame.direction == Direction::Received);
        received.map(|frame| frame.text.clone()).collect::<Vec<_>>().join(" ")
    };
    for golden in [
        "09 10 03 E8 00 03 01 30",
        "09 03 02 11 00 55 D5",
        "09 03 02 31 00 4C 15",
        "09 03 06 B9 00 00 FF BD 00 1D 7C",
    ] {
        assert!(received.contains(golden), "{golden} is not in {received}");
    }
}

#[test]
fn the_replies_of_the_manual_have_its_checksums_and_its_meaning() {
    let check = |golden: &str, object, position, current_ma, moving| {
        let frame = bytes(golden);
        assert_eq!(framed(&frame[..frame.len() - 2]), frame, "{golden}");
        let status = crate::hardware::gripper::parse(&frame[3..frame.len() - 2]).unwrap();
        assert!(status.activated && status.follows);
        assert_eq!(
            (status.object, status.position, status.current_ma, status.moving),
            (object, position, current_ma, moving)
        );
    };
    check("09 03 06 39 00 00 FF 0E 0A F7 8B", Object::None, 14, 100, true);
    check("09 03 06 B9 00 00 FF BD 00 1D 7C", Object::Closing, 189, 0, false);
    check("09 03 06 F9 00 00 00 0D 00 56 4C", Object::AtPosition, 13, 0, false);
}

#[test]
fn a_spoon_is_gripped_carried_and_put_back() {
    let mut bench = Bench::holding();
    bench.fingers.set_at_rack(false);
    assert!(bench.driver.holds_spoon().unwrap());
    assert_eq!(bench.fingers.spoon(), Spoon::Held);
    bench.fingers.set_at_rack(true);
    let open = bench.driver.release(Effort { speed: 40, force: 0 }).unwrap();
    assert_eq!((open.object, bench.fingers.spoon()), (Object::AtPosition, Spoon::InRack));
    bench.fingers.set_at_rack(false);
    let empty = bench.driver.grip(Effort::FULL).unwrap();
    assert_eq!(
        (empty.object, empty.holds(), bench.fingers.spoon()),
        (Object::AtPosition, false, Spoon::Away)
    );
}

#[test]
fn fingers_that_hold_a_spoon_from_the_start_say_so() {
    let port = Port::pty(EmulatedGripper::new(Fingers::holding(Clock::standing()))).unwrap();
    let mut driver = Gripper::open(port.address(), Tap::none()).unwrap();
    assert!(driver.holds_spoon().unwrap());
    assert!(matches!(driver.activate(no_spoon()), Err(DeviceError::Forbidden { .. })));
}

#[test]
fn fingers_take_their_time_by_the_clock_of_the_room() {
    let mut bench = Bench::new(Clock::fast(20.0));
    bench.driver.activate(no_spoon()).unwrap();
    let before = Instant::now();
    let closed = bench.driver.grip(Effort { speed: 0, force: 0 }).unwrap();
    // 225 counts at 60 per second, twenty times as fast.
    assert!(before.elapsed() > Duration::from_millis(150) && closed.object == Object::AtPosition);
}

#[test]
fn activation_is_refused_while_a_spoon_is_held_and_nothing_is_sent_that_moves() {
    let refused = |bench: &mut Bench| {
        let before = bench.writes();
        let error = bench.driver.activate(no_spoon()).unwrap_err();
        assert!(
            matches!(&error, DeviceError::Forbidden { cause, .. } if cause.contains("hold a spoon")),
            "{error}"
        );
        assert_eq!((bench.writes(), bench.fingers.spoon()), (before, Spoon::Held));
    };
    refused(&mut Bench::holding());
    // Power was lost: it knows of no spoon, but the driver does.
    let mut bench = Bench::holding();
    bench.fingers.cause(Fault::Unplug, 0);
    bench.fingers.plug_in();
    refused(&mut bench);
    assert!(!bench.driver.status().unwrap().activated);
    assert!(matches!(bench.driver.grip(Effort::FULL), Err(DeviceError::Forbidden { .. })));
    bench.driver.taken_out(no_spoon());
    assert!(bench.driver.activate(no_spoon()).unwrap().activated);
}

#[test]
fn nobody_activates_without_a_name_and_an_active_gripper_is_left_alone() {
    assert_eq!(NoSpoon::seen_by("  ").unwrap_err().field, "seen_by");
    let mut bench = Bench::active();
    let before = bench.writes();
    assert!(bench.driver.activate(no_spoon()).unwrap().activated);
    assert_eq!(bench.writes(), before);
}

#[test]
fn a_read_is_repeated_once() {
    for fault in
        [Fault::CrcError, Fault::WrongSlave, Fault::LostFrame, Fault::LostRequest, Fault::SlowReply]
    {
        let mut bench = Bench::holding();
        bench.fingers.cause(fault, 1);
        assert!(bench.driver.holds_spoon().unwrap(), "{fault:?}");
        bench.fingers.cause(fault, 2);
        match (fault, bench.driver.status()) {
            (Fault::LostFrame | Fault::LostRequest, Err(DeviceError::Silent { .. })) => {}
            (Fault::CrcError | Fault::WrongSlave, Err(DeviceError::Garbled { .. })) => {}
            // The first slow reply arrives while the second is waited for, to the same request.
            (Fault::SlowReply, Ok(status)) => assert!(status.holds()),
            (_, other) => panic!("{fault:?}: {other:?}"),
        }
        assert!(bench.driver.holds_spoon().unwrap(), "{fault:?}");
    }
}

#[test]
fn a_motion_is_never_sent_twice_and_goes_on_if_it_was_heard() {
    for (fault, is_heard) in [
        (Fault::CrcError, true),
        (Fault::WrongSlave, true),
        (Fault::LostFrame, true),
        (Fault::SlowReply, true),
        (Fault::LostRequest, false),
    ] {
        let mut bench = Bench::active();
        bench.fingers.set_at_rack(true);
        let before = bench.writes();
        // The frame before the motion requests the state.
        let fingers = bench.fingers.clone();
        fingers.cause_after(1, fault);
        let gripped = bench.driver.grip(Effort::FULL);
        assert_eq!(bench.writes(), before + 1, "{fault:?}");
        match gripped {
            Ok(status) => assert!(is_heard && status.holds(), "{fault:?}"),
            Err(DeviceError::Faulted { cause, .. }) => {
                assert!(!is_heard && cause.contains("order"), "{fault:?}: {cause}")
            }
            Err(other) => panic!("{fault:?}: {other}"),
        }
    }
}

#[test]
fn a_fault_code_stops_every_motion_until_it_is_activated_again() {
    let mut bench = Bench::active();
    bench.fingers.cause(Fault::FaultCode, 0);
    let error = bench.driver.grip(Effort::FULL).unwrap_err();
    assert!(
        matches!(&error, DeviceError::Faulted { cause, .. } if cause.contains("0x0e")),
        "{error}"
    );
    assert!(bench.driver.activate(no_spoon()).unwrap().activated);
    assert!(bench.driver.grip(Effort::FULL).is_ok());
}

#[test]
fn a_dropped_spoon_is_seen() {
    let mut bench = Bench::holding();
    bench.fingers.cause(Fault::DroppedSpoon, 0);
    bench.driver.status().unwrap();
    let status = bench.driver.status().unwrap();
    assert_eq!(
        (status.object, status.holds(), bench.fingers.spoon()),
        (Object::AtPosition, false, Spoon::Dropped)
    );
}

#[test]
fn a_gripper_without_supply_is_silent_and_one_without_a_wire_is_lost() {
    let mut bench = Bench::holding();
    bench.fingers.cause(Fault::Unplug, 0);
    assert_eq!(bench.driver.status(), Err(DeviceError::Silent { device: "the gripper" }));
    assert!(matches!(bench.driver.release(Effort::FULL), Err(DeviceError::Silent { .. })));
    assert_eq!(bench.fingers.spoon(), Spoon::Held);
    bench.port.unplug();
    assert!(matches!(bench.driver.status(), Err(DeviceError::Lost { .. })));
    assert!(matches!(
        Gripper::open("/dev/no-such-port", Tap::none()),
        Err(DeviceError::Lost { .. })
    ));
}

#[test]
fn a_gripper_behind_a_serial_server_is_the_same() {
    let fingers = Fingers::new(Clock::standing());
    let port = Port::tcp("127.0.0.1:0".parse().unwrap(), EmulatedGripper::new(fingers)).unwrap();
    let mut driver = Gripper::open(port.address(), Tap::none()).unwrap();
    assert!(driver.activate(no_spoon()).unwrap().activated);
}

/// Answers every request with the same bytes.
struct Parrot(Vec<u8>);

impl Talker for Parrot {
    fn hear(&mut self, _: &[u8], say: &mut dyn FnMut(&[u8])) {
        say(&self.0);
    }
}

#[test]
fn replies_that_do_not_fit_are_refused_and_break_nothing() {
    let check = |reply: Vec<u8>, is_right: fn(&DeviceError) -> bool| {
        let port = Port::pty(Parrot(reply.clone())).unwrap();
        let error = Gripper::open(port.address(), Tap::none()).unwrap().status().unwrap_err();
        assert!(is_right(&error), "{reply:02X?}: {error}");
    };
    for body in [
        &[9, 0x03, 0][..],
        &[9, 0x03, 2, 0x31, 0],
        &[9, 0x03, 3, 0x31, 0, 0],
        &[9, 0x03, 8, 0x31, 0, 0, 0, 0, 0, 0, 0],
        &[9, 0x03, 6, 0x21, 0, 0, 0, 0, 0],
        &[9, 0x04, 6, 0x31, 0, 0, 0, 0, 0],
        &[9, 0x10, 0x03, 0xE8, 0, 3],
        &[9, 0x84, 2],
        &[9, 0x64, 1, 2, 3],
        &[9, 0x2B, 0x0E, 1, 1, 0, 0, 255],
        &[9, 0x11, 1, 0],
        &[0, 0, 0, 0],
    ] {
        check(framed(body), |error| matches!(error, DeviceError::Garbled { .. }));
    }
    check(vec![0xFF; 400], |error| matches!(error, DeviceError::Garbled { .. }));
    for code in [1, 2, 6, 0x55] {
        check(framed(&[9, 0x83, code]), |error| {
            !matches!(error, DeviceError::Silent { .. } | DeviceError::Lost { .. })
        });
    }
}

#[test]
fn what_the_gripper_does_not_have_is_an_exception() {
    let mut gripper = EmulatedGripper::new(Fingers::new(Clock::standing()));
    let mut check = |request: &[u8], reply: &[u8]| {
        let mut said = Vec::new();
        gripper.hear(&framed(request), &mut |bytes| said.extend_from_slice(bytes));
        assert_eq!(said, framed(reply));
    };
    check(&[9, 0x03, 0, 0, 0, 1], &[9, 0x83, 2]);
    check(&[9, 0x03, 0x07, 0xD0, 0, 4], &[9, 0x83, 2]);
    check(&[9, 0x06, 0x03, 0xE8, 0, 1], &[9, 0x86, 1]);
    check(&[9, 0x10, 0x03, 0xE9, 0, 1, 2, 0, 1], &[9, 0x90, 2]);
    check(&[9, 0x04, 0x07, 0xD0, 0, 1], &[9, 0x04, 2, 0, 0]);
}

#[test]
fn every_fault_has_a_name() {
    for fault in Fault::ALL {
        assert_eq!(fault.name().parse(), Ok(fault));
        assert_eq!(serde_json::to_value(fault).unwrap(), fault.name());
    }
    assert!("fire".parse::<Fault>().unwrap_err().message.contains("dropped-spoon"));
}

proptest! {
    #[test]
    fn no_bytes_break_the_readers(bytes: Vec<u8>) {
        let _ = parse(&bytes);
        let _ = parse(&framed(&bytes));
        let _ = crate::hardware::gripper::parse(&bytes);
        let mut gripper = EmulatedGripper::new(Fingers::new(Clock::standing()));
        gripper.hear(&bytes, &mut |_| {});
        gripper.hear(&framed(&bytes), &mut |_| {});
    }
}
