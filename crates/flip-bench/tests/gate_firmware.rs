//! The gate's sketch, compiled for this computer and used by the driver over a pseudo-terminal.
//! Needs `g++`.

use flip_bench::emulate::gate::{EmulatedGate, Settings, Slide};
use flip_bench::emulate::port::Port;
use flip_bench::hardware::DeviceError;
use flip_bench::hardware::clock::Clock;
use flip_bench::hardware::gate::{Gate, Opening, Said, State, Why, framed, parse};
use flip_bench::hardware::line::{Line, Serial};
use flip_bench::hardware::wire::{Direction, Tap};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

const BOOT: Duration = Duration::from_millis(60);
const LONG: Duration = Duration::from_secs(60);

/// The sketch as a program, compiled once.
fn program() -> &'static Path {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(|| {
        let program = Path::new(env!("CARGO_TARGET_TMPDIR")).join("flip_gate");
        let source = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/gate_firmware/host.cpp");
        let mut compiler = Command::new("g++");
        compiler.args(["-std=c++11", "-O1", "-Wall", "-Wextra", "-Wconversion", "-Werror"]);
        // Exits at the first out-of-bounds read or write.
        compiler
            .args(["-fsanitize=address,undefined", "-fno-sanitize-recover=all", source, "-o"])
            .arg(&program);
        let compiled = compiler.output().expect("`make test` needs g++");
        assert!(compiled.status.success(), "{}", String::from_utf8_lossy(&compiled.stderr));
        program
    })
}

/// A board that runs the sketch. It ends when this is dropped.
struct Board {
    process: Child,
    port: String,
}

impl Board {
    fn start(jam: Option<u16>) -> Self {
        let mut process = Command::new(program())
            .args(
                [BOOT.as_millis().to_string()]
                    .into_iter()
                    .chain(jam.map(|permille| permille.to_string())),
            )
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut port = String::new();
        BufReader::new(process.stdout.take().unwrap()).read_line(&mut port).unwrap();
        Self { process, port: port.trim().to_owned() }
    }

    fn driver(&self) -> Gate {
        Gate::open(&self.port, Tap::none()).unwrap()
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

#[test]
fn the_sketch_says_hello_opens_and_closes() {
    let board = Board::start(None);
    let mut gate = board.driver();
    assert_eq!(gate.status().unwrap().closed_for, Some(Why::Reset));
    let open = gate.open_gate(Opening::FULL, LONG).unwrap();
    assert_eq!(
        (open.state, open.opening_permille, open.open_stop, open.closed_for),
        (State::Open, 1000, true, None)
    );
    let part = gate.open_gate(Opening::fraction(0.3).unwrap(), LONG).unwrap();
    assert_eq!((part.state, part.opening_permille, part.closed_stop), (State::Open, 300, false));
    let closed = gate.close().unwrap();
    assert_eq!(
        (closed.state, closed.closed_stop, closed.closed_for),
        (State::Closed, true, Some(Why::Asked))
    );
}

#[test]
fn the_sketch_stays_open_with_heartbeats_and_closes_without() {
    let board = Board::start(None);
    let mut gate = board.driver();
    let opened = Instant::now();
    gate.open_gate(Opening::FULL, Duration::from_millis(900)).unwrap();
    while gate.status().unwrap().closed_for.is_none() {
        assert!(opened.elapsed() < Duration::from_secs(4), "the gate is still open");
        std::thread::sleep(Duration::from_millis(20));
    }
    assert!(opened.elapsed() > Duration::from_millis(900));
    assert_eq!(gate.close().unwrap().closed_for, Some(Why::Beats));
}

#[test]
fn opening_the_port_again_resets_the_board() {
    let board = Board::start(None);
    let mut gate = board.driver();
    gate.open_gate(Opening::FULL, LONG).unwrap();
    drop(gate);
    // A board detects a closed port only if it stays closed for a moment.
    std::thread::sleep(Duration::from_millis(50));
    assert_eq!(board.driver().status().unwrap().closed_for, Some(Why::Reset));
}

#[test]
fn a_slide_that_jams_never_presses_its_end_stop() {
    let board = Board::start(Some(500));
    let error = board.driver().open_gate(Opening::FULL, LONG).unwrap_err();
    assert!(
        matches!(&error, DeviceError::Faulted { cause, .. } if cause.contains("does not open")),
        "{error}"
    );
}

#[test]
fn a_board_that_is_gone_is_told() {
    let board = Board::start(None);
    let mut gate = board.driver();
    gate.open_gate(Opening::FULL, LONG).unwrap();
    drop(board);
    assert!(matches!(gate.close(), Err(DeviceError::Lost { .. } | DeviceError::Silent { .. })));
}

#[test]
fn the_record_has_every_line_both_ways() {
    static SENT: AtomicUsize = AtomicUsize::new(0);
    static RECEIVED: AtomicUsize = AtomicUsize::new(0);
    let board = Board::start(None);
    let tap = Tap::new(|exchange| {
        let count = if exchange.direction == Direction::Sent { &SENT } else { &RECEIVED };
        count.fetch_add(1, Ordering::SeqCst);
    });
    let mut gate = Gate::open(&board.port, tap).unwrap();
    gate.status().unwrap();
    // Greeting and question; hello, its answer and the answer.
    assert_eq!((SENT.load(Ordering::SeqCst), RECEIVED.load(Ordering::SeqCst)), (2, 3));
}

#[test]
fn noise_does_not_break_the_sketch() {
    let board = Board::start(None);
    let serial = Serial { baud: 115_200, ..Serial::default() };
    let mut line = Line::open("gate", &board.port, &serial, Tap::none()).unwrap();
    line.receive(Duration::from_secs(5)).unwrap();
    let mut state = 1_u32;
    for _ in 0..200 {
        // Bytes of a linear congruential generator, rich in line ends and stars.
        let noise = (0..97).map(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            match (state >> 24) as u8 {
                0..30 => b'\n',
                30..60 => b'*',
                byte => byte,
            }
        });
        let noise: Vec<u8> = noise.collect();
        line.send(&noise).unwrap();
        line.discard_input().unwrap();
    }
    line.send(b"\n").unwrap();
    line.discard_input().unwrap();
    line.send(framed("1 HELLO").as_bytes()).unwrap();
    let reply = parse(&line.receive(Duration::from_secs(2)).unwrap()).unwrap();
    assert!(
        matches!(reply.said, Said::Hi(_, status) if status.state == State::Closed),
        "{reply:?}"
    );
}

/// A board's replies to these lines, each with a number for whether it stands or moves.
fn transcript(port: &str, lines: &[&str]) -> Vec<String> {
    let serial = Serial { baud: 115_200, ..Serial::default() };
    let mut line = Line::open("gate", port, &serial, Tap::none()).unwrap();
    let hello = line.receive(Duration::from_secs(5)).unwrap();
    assert!(matches!(parse(&hello).unwrap().said, Said::Hi(..)));
    let mut ask = |request: &&str| {
        line.send(request.as_bytes()).unwrap();
        let reply = line.receive(Duration::from_secs(2)).unwrap();
        parse(&reply).unwrap_or_else(|error| panic!("{request}: {error}"));
        String::from_utf8(reply).unwrap()
    };
    lines.iter().map(&mut ask).collect()
}

/// The emulated board and the sketch are two programs of one protocol.
#[test]
fn the_emulated_board_and_the_sketch_answer_alike() {
    let requests = [
        "1 STATUS",
        "1 OPEN 1000",
        "5 HELLO",
        "5 STATUS",
        "4 OPEN 1000",
        "6 STATUS",
        "6 OPEN 1000",
        "7 CLOSE",
        "8 BEAT",
        "9 FLY",
        "9 STATUS",
        "10 OPEN",
        "11 OPEN ",
        "12 OPEN 0",
        "13 OPEN 1001",
        "14 OPEN 99999999999",
        "15 OPEN -1",
        "16 OPEN 1 2",
        "17  STATUS",
        "17",
        "0 CLOSE",
        "x CLOSE",
        "70000 CLOSE",
        "32784 STATUS",
        "65535 STATUS",
        "2 STATUS",
        "65535 STATUS",
        "3 OPEN 1000",
        "4 CLOSE",
    ];
    let mut lines: Vec<String> = requests.iter().map(|request| framed(request)).collect();
    lines.extend(
        ["5 CLOSE*0000\n", "5 CLOSE\n", "*FFFF\n", "5 CLOSE*48e9\n", "\r\n\n*\n"]
            .map(str::to_owned),
    );
    lines.push(framed(&format!("5 OPEN {}", "0".repeat(80))));
    lines.push(framed("6 CLOSE"));
    let lines: Vec<&str> = lines.iter().map(String::as_str).collect();

    let board = Board::start(None);
    let settings = Settings { boot: BOOT, ..Settings::default() };
    let emulated = Port::pty(EmulatedGate::new(Slide::new(settings, Clock::wall()))).unwrap();
    let (sketch, emulated) =
        (transcript(&board.port, &lines), transcript(emulated.address(), &lines));
    for ((line, sketch), emulated) in lines.iter().zip(&sketch).zip(&emulated) {
        // Intermediate positions, and whether a moment was enough to arrive, depend on the machine.
        let without_time = |reply: &str| match parse(reply.as_bytes()).unwrap().said {
            Said::Ok(status) => {
                format!("{:?} {:?}", parse(reply.as_bytes()).unwrap().seq, status.closed_for)
            }
            _ => reply.to_owned(),
        };
        assert_eq!(without_time(sketch), without_time(emulated), "{line}");
    }
}
