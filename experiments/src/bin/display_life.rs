//! How long does the display of a sound balance stand still? `cargo experiment
//! display_life`.
//!
//! Published readings of an enclosed analytical balance with nothing moving (0.1 mg, two streams of
//! 578 s; SOURCES.md next to the data names their owners) are compared with an emulated balance,
//! both as they are and rounded to 1 mg: root mean square of the difference of two readings, and
//! how long one number stood. `Readings::life_s` and the wander of emulated balances were derived
//! from it. The data are not part of FLIP: `FLIP_DATA` names the folder; without it the example
//! reports so and prints the emulated balance alone.

use anyhow::Context;
use flip_bench::emulate::balance::{Balance, Settings, Socket};
use flip_bench::emulate::pan::Pan;
use flip_bench::hardware::balance as driver;
use flip_bench::hardware::clock::Clock;
use flip_bench::hardware::wire::Tap;
use std::path::{Path, PathBuf};

const ENCLOSED: [&str; 2] =
    ["2026-08-19_balance-enclosed-drift-8min.csv", "2026-08-19_balance-enclosed-noise-window1.csv"];
const LAGS_S: [f64; 5] = [0.3, 1.0, 2.0, 4.0, 8.0];
const EMULATED_S: f64 = 1200.0;
const VIAL_MG: f64 = 12_000.0;

/// Time, s, and displayed value, mg.
type Shown = Vec<(f64, f64)>;

fn main() -> anyhow::Result<()> {
    println!(
        "| balance | s | rms of differences over 0.3, 1, 2, 4, 8 s, mg | display mg | longest stand s | stood 5 s | 10 s | 20 s |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    let root =
        std::env::var("FLIP_DATA").map_or_else(|_| PathBuf::from("../shared/data"), PathBuf::from);
    let folder = root.join("powder-doser/docs/rig-checks/data");
    for name in ENCLOSED {
        match folder.join(name) {
            path if path.exists() => tell(name, &published(&path)?),
            path => println!(
                "skipped: there is no {}; FLIP_DATA names the folder that holds the data",
                path.display()
            ),
        }
    }
    tell("emulated", &emulated(0.1)?);
    Ok(())
}

fn published(path: &Path) -> anyhow::Result<Shown> {
    let text = std::fs::read_to_string(path)?;
    let row = |line: &str| -> anyhow::Result<(f64, f64)> {
        let fields: Vec<&str> = line.split(',').collect();
        let [t_ms, _, grams] = fields[..] else { anyhow::bail!("not a reading: {line}") };
        Ok((t_ms.parse::<f64>()? * 1e-3, grams.parse::<f64>()? * 1e3))
    };
    text.lines().skip(1).map(|line| row(line).with_context(|| path.display().to_string())).collect()
}

fn emulated(readability_mg: f64) -> anyhow::Result<Shown> {
    let clock = Clock::standing();
    let settings = Settings { readability_mg, seed: 1, ..Settings::default() };
    let dialect = settings.dialect;
    let balance = Balance::start(settings, Pan::holding(VIAL_MG, clock.clone()), Socket::Pty)?;
    let settings = driver::Settings::new(dialect, balance.address());
    let mut driver = driver::Balance::open(&settings, Tap::none(), clock.clone())?;
    let mut shown = Vec::new();
    while clock.now_s() < EMULATED_S {
        let sample = driver.immediate()?;
        shown.push((sample.t_s, sample.mass_mg));
        clock.wait_s(0.28);
    }
    Ok(shown)
}

fn tell(name: &str, shown: &Shown) {
    let seconds = shown.last().map_or(0.0, |last| last.0 - shown[0].0);
    let rms: Vec<String> =
        LAGS_S.iter().map(|lag_s| format!("{:.2}", rms_mg(shown, *lag_s))).collect();
    for step_mg in [0.1, 1.0] {
        let numbers: Vec<(f64, i64)> =
            shown.iter().map(|(t_s, mass_mg)| (*t_s, (mass_mg / step_mg).round() as i64)).collect();
        let stood = |for_s: f64| format!("{:.1} %", 100.0 * stood(&numbers, for_s));
        println!(
            "| {name} | {seconds:.0} | {} | {step_mg} | {:.1} | {} | {} | {} |",
            rms.join(", "),
            longest_s(&numbers),
            stood(5.0),
            stood(10.0),
            stood(20.0)
        );
    }
}

/// For readings this far apart, and up to 0.8 s further.
fn rms_mg(shown: &Shown, lag_s: f64) -> f64 {
    let pair = |(k, (t_s, mass_mg)): (usize, &(f64, f64))| {
        let later = shown[k..].iter().find(|(later_s, _)| later_s - t_s >= lag_s)?;
        (later.0 - t_s < lag_s + 0.8).then(|| (later.1 - mass_mg).powi(2))
    };
    let squares: Vec<f64> = shown.iter().enumerate().filter_map(pair).collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

/// From the first to the last reading of one number.
fn longest_s(numbers: &[(f64, i64)]) -> f64 {
    numbers
        .chunk_by(|a, b| a.1 == b.1)
        .map(|run| run[run.len() - 1].0 - run[0].0)
        .fold(0.0, f64::max)
}

/// Share of times from which one number stood this long.
fn stood(numbers: &[(f64, i64)], for_s: f64) -> f64 {
    let end_s = numbers.last().map_or(0.0, |last| last.0 - for_s);
    let from: Vec<usize> = (0..numbers.len()).filter(|k| numbers[*k].0 <= end_s).collect();
    let stands = |k: &&usize| {
        let (t_s, number) = numbers[**k];
        numbers[**k..]
            .iter()
            .take_while(|later| later.0 <= t_s + for_s)
            .all(|later| later.1 == number)
    };
    from.iter().filter(stands).count() as f64 / from.len() as f64
}
