//! FLIP's balance driver against third-party simulators, and a third-party client against FLIP's
//! emulator.
//!
//! `tests/peers/balance_peers.py` installs them from PyPI under `target/`, once. Without python or
//! a network the tests report why they are skipped.

use flip_bench::emulate::balance::{Balance as Emulated, Fault, Settings as Emulation, Socket};
use flip_bench::emulate::pan::Pan;
use flip_bench::hardware::DeviceError;
use flip_bench::hardware::balance::{Balance, Dialect, Settings, StableBy};
use flip_bench::hardware::clock::Clock;
use flip_bench::hardware::wire::Tap;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::OnceLock;

/// Initial load of their simulators, mg.
const THEIR_LOAD_MG: f64 = 52_187.34;
/// Two display steps of 0.1 mg, and their noise.
const CLOSE_MG: f64 = 0.3;

fn script() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/peers/balance_peers.py")
}

/// The python that has the peers; `None`, with a printed reason, if they cannot be installed.
fn python() -> Option<&'static Path> {
    static PYTHON: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    let installed = PYTHON.get_or_init(|| {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("balance-peers");
        let output = Command::new("python3").arg(script()).arg("install").arg(folder).output();
        let said = output.map_err(|error| format!("python3: {error}"))?.stdout;
        let said = String::from_utf8_lossy(&said).trim().to_owned();
        said.strip_prefix("python ")
            .map(PathBuf::from)
            .ok_or_else(|| said.trim_start_matches("skip ").to_owned())
    });
    match installed {
        Ok(python) => Some(python),
        Err(reason) => {
            // Not println, which is shown for failed tests only.
            let _ = writeln!(std::io::stderr(), "skipped: the peers cannot be installed: {reason}");
            None
        }
    }
}

/// Their simulator on a TCP port.
struct Simulator {
    process: Child,
    orders: ChildStdin,
    words: BufReader<ChildStdout>,
    address: String,
}

impl Simulator {
    fn start(python: &Path, kind: &str) -> Self {
        let mut command = Command::new(python);
        command.arg(script()).args(["serve", kind]).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut process = command.spawn().unwrap();
        let orders = process.stdin.take().unwrap();
        let words = BufReader::new(process.stdout.take().unwrap());
        let mut simulator = Self { process, orders, words, address: String::new() };
        simulator.address = simulator.hear().strip_prefix("listening ").unwrap().to_owned();
        simulator
    }

    fn hear(&mut self) -> String {
        let mut line = String::new();
        self.words.read_line(&mut line).unwrap();
        line.trim().to_owned()
    }

    fn order(&mut self, order: &str) {
        writeln!(self.orders, "{order}").unwrap();
        assert_eq!(self.hear(), "done");
    }
}

impl Drop for Simulator {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn check_driver(kind: &str, dialect: Dialect) {
    let Some(python) = python() else { return };
    let mut simulator = Simulator::start(python, kind);
    // Their MT-SICS simulator flags no immediate reading as stable, so the separate command is
    // used.
    let stable_by = StableBy::Command;
    let settings = Settings {
        stable_by,
        readability_mg: Some(0.1),
        ..Settings::new(dialect, simulator.address.as_str())
    };
    let mut balance = Balance::open(&settings, Tap::none(), Clock::wall()).unwrap();

    let identity = balance.identify().unwrap();
    let serial = if dialect == Dialect::MtSics { "B123456789" } else { "0037402012" };
    assert_eq!(identity.serial.as_deref(), Some(serial));
    assert!(identity.model.is_some() && identity.software.is_some(), "{identity:?}");

    let gross = balance.stable(5.0).unwrap();
    assert!(gross.stable && (gross.mass_mg - THEIR_LOAD_MG).abs() < CLOSE_MG, "{gross:?}");
    let zero = balance.tare().unwrap();
    assert!(zero.mass_mg.abs() < CLOSE_MG, "{zero:?}");
    simulator.order("load 52.20234");
    let net = balance.stable(5.0).unwrap();
    assert!(net.stable && (net.mass_mg - 15.0).abs() < CLOSE_MG, "{net:?}");
    let now = balance.immediate().unwrap();
    assert!((now.mass_mg - 15.0).abs() < CLOSE_MG, "{now:?}");

    simulator.order("load 300");
    let refused = balance.stable(5.0).unwrap_err();
    assert!(refused.to_string().contains("overload"), "{refused}");
    simulator.order("load 0.001");
    let zero = balance.zero().unwrap();
    assert!(zero.mass_mg.abs() < CLOSE_MG, "{zero:?}");
}

#[test]
fn the_driver_reads_an_independent_mt_sics_balance() {
    check_driver("mt_sics", Dialect::MtSics);
}

#[test]
fn the_driver_reads_an_independent_sbi_balance_with_either_frame() {
    check_driver("sbi", Dialect::Sbi);
    check_driver("sbi16", Dialect::Sbi);
}

#[test]
fn an_independent_sbi_balance_that_moves_underloads_or_adjusts_itself_is_understood() {
    let Some(python) = python() else { return };
    let mut simulator = Simulator::start(python, "sbi");
    let settings = Settings::new(Dialect::Sbi, simulator.address.as_str());
    let mut balance = Balance::open(&settings, Tap::none(), Clock::wall()).unwrap();
    balance.stable(5.0).unwrap();
    simulator.order("load 60");
    let moving = balance.immediate().unwrap();
    assert!(!moving.stable && (moving.mass_mg - 60_000.0).abs() < 10.0, "{moving:?}");
    simulator.order("load -10");
    assert!(balance.immediate().unwrap_err().to_string().contains("underload"));
    simulator.order("adjust");
    assert!(matches!(balance.immediate(), Err(DeviceError::Forbidden { .. })));
}

/// FLIP's emulator with a load of 52.187 g, and their client's name for the dialect.
fn emulated(dialect: Dialect, fault: Option<Fault>) -> (&'static str, Emulated) {
    let settings = Emulation { dialect, noise_mg: 0.0, ..Emulation::default() };
    // Ten times real time, so the stable flag comes quickly.
    let pan = Pan::holding(52_187.0, Clock::fast(10.0));
    let mut balance =
        Emulated::start(settings, pan, Socket::Tcp(([127, 0, 0, 1], 0).into())).unwrap();
    if let Some(fault) = fault {
        balance.inject(fault);
    }
    (if dialect == Dialect::Sbi { "sbi" } else { "mt_sics" }, balance)
}

/// Results of their client for each of these balances.
fn their_client(python: &Path, balances: &[(&'static str, Emulated)]) -> Vec<serde_json::Value> {
    let arguments = balances.iter().flat_map(|(kind, balance)| [*kind, balance.address()]);
    let output = Command::new(python).arg(script()).arg("client").args(arguments).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let lines = String::from_utf8(output.stdout).unwrap();
    lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn an_independent_client_weighs_and_tares_on_the_emulator() {
    let Some(python) = python() else { return };
    let balances = [Dialect::MtSics, Dialect::Sbi].map(|dialect| emulated(dialect, None));
    let found = their_client(python, &balances);
    assert_eq!(found.len(), 2);
    for found in found {
        let reading = |value: f64| serde_json::json!({"value": value, "unit": "g", "stable": true});
        assert_eq!(found["gross"], reading(52.187), "{found}");
        assert_eq!((&found["net"], &found["now"]), (&reading(0.0), &reading(0.0)), "{found}");
        assert_eq!(found["identity"]["model"], "FLIP-E223", "{found}");
    }
}

#[test]
fn an_independent_client_hears_the_emulators_refusals() {
    let Some(python) = python() else { return };
    let cases = [
        (Dialect::MtSics, Fault::Overload, "overload"),
        (Dialect::MtSics, Fault::Underload, "underload"),
        (Dialect::MtSics, Fault::NotReady, "not executable"),
        (Dialect::MtSics, Fault::Draught, "not executable"),
        (Dialect::Sbi, Fault::Overload, "overload"),
        (Dialect::Sbi, Fault::Underload, "underload"),
    ];
    let balances = cases.map(|(dialect, fault, _)| emulated(dialect, Some(fault)));
    let found = their_client(python, &balances);
    assert_eq!(found.len(), cases.len());
    for ((dialect, fault, words), found) in cases.iter().zip(found) {
        let error = found["error"].as_str().unwrap_or_default();
        assert!(error.contains(words), "{dialect:?} {fault:?}: {found}");
    }
}
