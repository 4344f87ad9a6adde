//! The file that defines the devices of a bench.

use crate::engine::{Seen, Target, bounded, outcome};
use flip_bench::hardware::bench_file::BenchFile;

const WORDS: &[&str] = &[
    "[balance]\n",
    "[arm]\n",
    "[gripper]\n",
    "[gate]\n",
    "[readings]\n",
    "[balance.serial]\n",
    "dialect = ",
    "port = ",
    "url = ",
    "readability_mg = ",
    "timeout_s = ",
    "stable_timeout_s = ",
    "stable_by = ",
    "\"window\"",
    "motion_s = ",
    "[spoon]\n",
    "capacity_mg = ",
    "length_mm = ",
    "width_mm = ",
    "depth_mm = ",
    "filled_by = \"hand\"",
    "noise_mg = ",
    "baud = ",
    "data_bits = ",
    "parity = ",
    "\"ohaus\"",
    "\"sbi\"",
    "\"command\"",
    "\"http://\"",
    "\"odd\"",
    "nan",
    "-inf",
    "1979-05-27T07:32:00Z",
    "{",
    "}",
    "[[",
    "]]",
    "\"\"\"",
    "'''",
    "\\u0000",
    "\\U0010FFFF",
    "#",
    "=",
    ".",
];

pub const FILE: Target = Target {
    name: "bench_file",
    check: check_file,
    repair: None,
    words: WORDS,
    bytes_max: 8 << 10,
};

fn check_file(bytes: &[u8]) -> Result<Seen, String> {
    let Ok(text) = std::str::from_utf8(bytes) else { return Ok(Seen::Refused(0)) };
    let file = match bounded(512 * bytes.len() + (64 << 10), || BenchFile::parse(text))? {
        Ok(file) => file,
        Err(error) if error.message.is_empty() => return Err("a refusal without words".to_owned()),
        Err(error) => return Ok(Seen::Refused(outcome(kind(&error.field, &error.message)))),
    };
    let written = toml::to_string(&file).map_err(|error| format!("cannot be written: {error}"))?;
    if BenchFile::parse(&written).as_ref() != Ok(&file) {
        return Err(format!("written again it is another file:\n{written}"));
    }
    let balance = &file.balance;
    let seconds = [
        balance.timeout_s,
        balance.stable_timeout_s,
        file.readings.settle_max_s,
        file.readings.stand_max_s,
    ];
    let is_sound = seconds.iter().all(|seconds| (0.05..=600.0).contains(seconds))
        && (0.0..=100.0).contains(&file.readings.noise_mg)
        && balance.readability_mg.is_none_or(|mg| mg.is_finite() && mg > 0.0)
        && !balance.port.trim().is_empty()
        && file.arm.url.starts_with("http://");
    if !is_sound {
        return Err(format!("a bench with such a file cannot work: {file:?}"));
    }
    let parts = (file.gripper.is_some(), file.gate.is_some(), balance.serial.is_some());
    Ok(Seen::Read(outcome((parts, balance.dialect.name(), balance.readability_mg.is_some()))))
}

/// Field and first words of a TOML error, without the position.
fn kind(field: &str, message: &str) -> (String, String) {
    let words = message
        .lines()
        .last()
        .unwrap_or_default()
        .chars()
        .filter(|c| c.is_ascii_alphabetic())
        .take(12);
    (field.to_owned(), words.collect())
}
