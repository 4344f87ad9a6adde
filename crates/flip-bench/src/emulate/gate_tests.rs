use super::*;
use crate::emulate::port::Port;
use crate::hardware::DeviceError;
use crate::hardware::gate::{Gate, GateStatus, Opening, State};
use crate::hardware::wire::{Direction, Exchange, Tap};
use proptest::prelude::*;

const LONG: Duration = Duration::from_secs(60);

struct Bench {
    slide: Slide,
    port: Port,
    driver: Gate,
    lines: Arc<Mutex<Vec<Exchange>>>,
}

impl Bench {
    fn new() -> Self {
        let settings = Settings { boot: Duration::from_millis(30), ..Settings::default() };
        let slide = Slide::new(settings, Clock::standing());
        let port = Port::pty(EmulatedGate::new(slide.clone())).unwrap();
        let lines = Arc::<Mutex<Vec<Exchange>>>::default();
        let kept = lines.clone();
        let tap = Tap::new(move |exchange| kept.lock().unwrap().push(exchange));
        let driver = Gate::open(port.address(), tap).unwrap();
        Self { slide, port, driver, lines }
    }

    fn open() -> Self {
        let mut bench = Self::new();
        assert_eq!(bench.driver.open_gate(Opening::FULL, LONG).unwrap().state, State::Open);
        assert_eq!(bench.slide.opening(), 1.0);
        bench
    }

    /// How many lines with this word were sent.
    fn sent(&self, word: &str) -> usize {
        let lines = self.lines.lock().unwrap();
        lines
            .iter()
            .filter(|line| line.direction == Direction::Sent && line.text.contains(word))
            .count()
    }

    fn wait_until_closed(&self, within: Duration) {
        let until = Instant::now() + within;
        while self.slide.opening() > 0.0 {
            assert!(Instant::now() < until, "the gate is still open");
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

fn is_fault(error: &DeviceError, word: &str) -> bool {
    matches!(error, DeviceError::Faulted { cause, .. } if cause.contains(word))
}

/// A board without a wire, past its start.
fn board() -> EmulatedGate {
    let settings = Settings { boot: Duration::ZERO, ..Settings::default() };
    let mut gate = EmulatedGate::new(Slide::new(settings, Clock::standing()));
    gate.idle(&mut |_| {});
    gate
}

fn told(gate: &mut EmulatedGate, bytes: &[u8]) -> String {
    let mut said = String::new();
    gate.hear(bytes, &mut |bytes| said.push_str(std::str::from_utf8(bytes).unwrap()));
    said
}

#[test]
fn lines_are_what_the_protocol_says() {
    let mut gate = board();
    for (request, reply) in [
        ("1 STATUS*7D7D\n", "1 ERR HELLO*417D\n"),
        ("1 HELLO*7DF0\n", "1 HI 1 CLOSED 0 C RESET*3EE0\n"),
        ("2 OPEN 1000*546D\n", "2 OK MOVING 0 C -*8D77\n"),
        ("3 STATUS*F2DB\n", "3 OK MOVING 0 C -*9D95\n"),
        ("4 STATUS*35C3\n", "4 OK OPEN 1000 O -*D6FA\n"),
        ("5 CLOSE*48E9\n", "5 OK MOVING 1000 O ASKED*544D\n"),
        ("5 CLOSE*48E8\n", "0 ERR CHECKSUM*9B0B\n"),
        ("\r\n\n", ""),
    ] {
        assert_eq!(told(&mut gate, request.as_bytes()), reply, "{request}");
    }
}

#[test]
fn a_line_that_comes_again_is_answered_again_and_obeyed_once() {
    let mut gate = board();
    let slide = gate.slide.clone();
    let mut tell = |text: &str| told(&mut gate, framed(text).as_bytes());
    tell("1 HELLO");
    let opened = tell("2 OPEN 500");
    tell("3 STATUS");
    let closed = tell("4 CLOSE");
    tell("5 STATUS");
    assert_eq!(slide.opening(), 0.0);
    // An opening command that was delayed for long, and the newest line once more.
    assert_eq!(tell("2 OPEN 500"), framed("2 ERR OLD"));
    assert_eq!(tell("5 OPEN 500"), framed("5 OK MOVING 500 - ASKED"));
    assert_eq!(slide.opening(), 0.0);
    assert!(
        opened.starts_with("2 OK MOVING 0 C -") && closed.starts_with("4 OK MOVING 500 - ASKED")
    );
    // Numbers wrap around.
    assert!(tell("32772 STATUS").starts_with("32772 OK"));
    assert!(tell("65535 STATUS").starts_with("65535 OK"));
    assert!(tell("1 STATUS").starts_with("1 OK"));
    assert_eq!(tell("65535 STATUS"), framed("65535 ERR OLD"));
}

#[test]
fn what_cannot_be_obeyed_is_refused() {
    let mut gate = board();
    told(&mut gate, framed("1 HELLO").as_bytes());
    for (request, reply) in [
        ("0 CLOSE", "0 ERR FORM"),
        ("CLOSE", "0 ERR FORM"),
        ("-2 CLOSE", "0 ERR FORM"),
        ("70000 CLOSE", "0 ERR FORM"),
        ("2 FLY", "2 ERR COMMAND"),
        ("3 OPEN", "3 ERR COMMAND"),
        ("4 OPEN 0", "4 ERR ARGUMENT"),
        ("5 OPEN 1001", "5 ERR ARGUMENT"),
        ("6 OPEN 1 2", "6 ERR ARGUMENT"),
    ] {
        assert_eq!(told(&mut gate, framed(request).as_bytes()), framed(reply), "{request}");
    }
    let long = format!("7 OPEN {}", "0".repeat(60));
    assert_eq!(told(&mut gate, framed(&long).as_bytes()), framed("0 ERR CHECKSUM"));
}

#[test]
fn the_gate_opens_as_far_as_asked_and_closes() {
    let mut bench = Bench::open();
    assert_eq!(bench.driver.status().unwrap().closed_for, None);
    let part = bench.driver.open_gate(Opening::fraction(0.25).unwrap(), LONG).unwrap();
    assert_eq!((part.opening_permille, part.state, part.open_stop), (250, State::Open, false));
    let closed = bench.driver.close().unwrap();
    let expected = GateStatus {
        state: State::Closed,
        opening_permille: 0,
        closed_stop: true,
        open_stop: false,
        closed_for: Some(Why::Asked),
    };
    assert_eq!((closed, bench.slide.opening()), (expected, 0.0));
    assert_eq!(Opening::fraction(f64::NAN).unwrap_err().field, "opening");
    assert!(Opening::fraction(0.0).is_err() && Opening::fraction(1.1).is_err());
}

#[test]
fn heartbeats_keep_it_open_and_their_end_closes_it() {
    let mut bench = Bench::new();
    let opened = Instant::now();
    bench.driver.open_gate(Opening::FULL, Duration::from_millis(700)).unwrap();
    bench.wait_until_closed(Duration::from_secs(2));
    // Six heartbeats and the half second after the last, if none is late.
    assert!(opened.elapsed() >= Duration::from_millis(800) && bench.sent("BEAT") >= 3);
    assert_eq!(bench.driver.status().unwrap().closed_for, Some(Why::Beats));
    assert_eq!(bench.driver.close().unwrap().closed_for, Some(Why::Beats));
}

#[test]
fn a_silent_wire_closes_the_gate_and_the_driver_tells() {
    let mut bench = Bench::open();
    bench.slide.cause(Fault::Silence, 0);
    bench.wait_until_closed(Duration::from_secs(1));
    assert_eq!(bench.driver.status(), Err(DeviceError::Silent { device: "the gate" }));
    bench.slide.repair();
    // The next heartbeat is answered, and the answer says why the gate is closed.
    let until = Instant::now() + LONG;
    let told = loop {
        match bench.driver.status() {
            Ok(status) => assert_eq!(status.closed_for, Some(Why::Beats)),
            Err(error) => break error,
        }
        assert!(Instant::now() < until, "the driver does not tell");
        std::thread::sleep(Duration::from_millis(20));
    };
    assert!(is_fault(&told, "Beats"), "{told}");
    assert_eq!(bench.driver.close().unwrap().state, State::Closed);
}

#[test]
fn dropping_the_driver_closes_the_gate() {
    let Bench { slide, port, driver, .. } = Bench::open();
    drop(driver);
    assert_eq!(slide.opening(), 0.0);
    // A board that was not reset sends nothing unsolicited, and is queried.
    let mut again =
        Gate::open_within(port.address(), Duration::from_millis(20), Tap::none()).unwrap();
    assert_eq!(again.status().unwrap().closed_for, Some(Why::Asked));
}

#[test]
fn a_line_that_is_lost_or_spoilt_is_sent_again_and_obeyed_once() {
    for fault in [Fault::LostLine, Fault::GarbledLine, Fault::ChecksumError] {
        let mut bench = Bench::new();
        bench.slide.cause(fault, 2);
        assert_eq!(
            bench.driver.open_gate(Opening::FULL, LONG).unwrap().state,
            State::Open,
            "{fault:?}"
        );
        assert_eq!(bench.sent("OPEN"), 3, "{fault:?}");
        bench.slide.cause(fault, 30);
        let error = bench.driver.status().unwrap_err();
        let is_named = match error {
            DeviceError::Silent { .. } => fault == Fault::LostLine,
            DeviceError::Garbled { .. } => fault != Fault::LostLine,
            _ => false,
        };
        assert!(is_named, "{fault:?}: {error}");
    }
}

#[test]
fn a_slide_that_jams_is_told_and_told_again_when_it_does_not_close() {
    let mut bench = Bench::new();
    bench.slide.cause(Fault::StuckHalfOpen, 0);
    let error = bench.driver.open_gate(Opening::FULL, LONG).unwrap_err();
    assert!(is_fault(&error, "does not open, it is 500 of 1000 open"), "{error}");
    assert!(is_fault(&bench.driver.close().unwrap_err(), "does not close"));
    assert_eq!(bench.slide.opening(), 0.5);
    bench.slide.repair();
    assert_eq!(bench.driver.close().unwrap().state, State::Closed);
}

#[test]
fn a_board_that_is_reset_closes_and_opens_only_when_asked_anew() {
    let mut bench = Bench::open();
    bench.slide.cause(Fault::Reset, 0);
    assert_eq!(bench.slide.opening(), 0.0);
    std::thread::sleep(Duration::from_millis(300));
    assert!(is_fault(&bench.driver.status().unwrap_err(), "was reset"));
    assert_eq!(bench.slide.opening(), 0.0);
    assert_eq!(bench.driver.close().unwrap().closed_for, Some(Why::Reset));
    assert_eq!(bench.driver.open_gate(Opening::FULL, LONG).unwrap().state, State::Open);
}

#[test]
fn a_board_without_supply_is_silent_closed_by_its_spring_and_found_again() {
    let mut bench = Bench::open();
    bench.slide.cause(Fault::Unplug, 0);
    assert_eq!(bench.slide.opening(), 0.0);
    assert!(matches!(bench.driver.close(), Err(DeviceError::Silent { .. })));
    bench.slide.repair();
    std::thread::sleep(Duration::from_millis(100));
    assert_eq!(bench.driver.close().unwrap().state, State::Closed);
    bench.port.unplug();
    assert!(matches!(bench.driver.status(), Err(DeviceError::Lost { .. })));
}

#[test]
fn each_connection_over_tcp_resets_the_board() {
    let settings = Settings { boot: Duration::from_millis(30), ..Settings::default() };
    let slide = Slide::new(settings, Clock::standing());
    let port = Port::tcp("127.0.0.1:0".parse().unwrap(), EmulatedGate::new(slide.clone())).unwrap();
    let mut driver = Gate::open(port.address(), Tap::none()).unwrap();
    driver.open_gate(Opening::FULL, LONG).unwrap();
    drop(driver);
    let mut driver = Gate::open(port.address(), Tap::none()).unwrap();
    assert_eq!(driver.status().unwrap().closed_for, Some(Why::Reset));
}

#[test]
fn a_port_without_a_gate_is_silent() {
    struct Nobody;
    impl Talker for Nobody {
        fn hear(&mut self, _: &[u8], _: &mut dyn FnMut(&[u8])) {}
    }
    let port = Port::pty(Nobody).unwrap();
    let opened = Gate::open_within(port.address(), Duration::from_millis(20), Tap::none());
    assert!(matches!(opened.err(), Some(DeviceError::Silent { device: "the gate" })));
}

#[test]
fn every_fault_has_a_name() {
    for fault in Fault::ALL {
        assert_eq!(fault.name().parse(), Ok(fault));
        assert_eq!(serde_json::to_value(fault).unwrap(), fault.name());
    }
    assert!("fire".parse::<Fault>().unwrap_err().message.contains("stuck-half-open"));
}

proptest! {
    #[test]
    fn no_bytes_break_the_readers(bytes: Vec<u8>, text in "[0-9]{1,6} (HELLO|OPEN|CLOSE|BEAT|OK|ERR|HI|[A-Z]{1,9})( [-A-Z0-9]{1,6}){0,5}") {
        let _ = (parse(&bytes), crate::hardware::gate::parse(&bytes));
        let line = framed(&text);
        let _ = (parse(line.trim_end().as_bytes()), crate::hardware::gate::parse(line.trim_end().as_bytes()));
        let mut gate = board();
        gate.hear(&bytes, &mut |_| {});
        gate.hear(line.as_bytes(), &mut |_| {});
    }
}
