//! Balance checks: does it weigh in the unit and step given in the bench file, quickly and stably?

use super::{Check, Findings, Found};
use crate::hardware::DeviceError;
use crate::hardware::balance::reply::Said;
use crate::hardware::balance::value::{STEPS, is_same};
use crate::hardware::balance::{Balance, Identity, Sample, Settings, StableBy};
use crate::hardware::bench_file::BenchFile;
use crate::hardware::clock::Clock;
use crate::hardware::settle::{Settling, Shown, standing};
use crate::hardware::wire::Tap;
use std::collections::BTreeSet;

/// How long the display is observed, s of bench time.
const WATCH_S: f64 = 6.0;
/// Polling interval while waiting, s of bench time.
const ASK_EVERY_S: f64 = 0.05;
/// Maximum number of readings; more add no information.
const READINGS_MAX: usize = 600;
/// Reading rates, Hz: below the first dosing is slow, below the second it is not acceptable.
const RATE_HZ: [f64; 2] = [4.0, 1.0];
/// Maximum creep of a warmed-up balance in a draught shield, mg/min.
const DRIFT_MG_MIN_MAX: f64 = 2.0;

pub(super) fn check(file: &BenchFile, clock: &Clock, tap: &Tap) -> Vec<Check> {
    let mut found = Findings::of("balance");
    let settings = &file.balance;
    let opened = Balance::open(settings, tap.clone(), clock.clone());
    let opened = opened.map(|balance| balance.with_noise_mg(file.readings.noise_mg));
    let asked = format!("open {}", settings.port);
    let mut balance = match opened {
        Ok(balance) => balance,
        Err(error) => {
            found.add("opens", asked, error.into());
            return found.checks;
        }
    };
    found.add("opens", asked, Found::ok("open"));
    found.add(
        "identity",
        "model, serial number, version of its software",
        identity(balance.identify()),
    );
    let first = balance.immediate();
    found.add("reading", "what the display shows now", reading(settings, &first));
    let Ok(first) = first else {
        found.skip(
            &["stable", "rate", "step", "noise", "drift", "life", "tare"],
            "it gives no reading",
        );
        return found.checks;
    };
    stands(file, &mut balance, clock, &first, &mut found);
    found.add("tare", "tare, then the display", tare(&mut balance));
    found.checks
}

fn identity(told: Result<Identity, DeviceError>) -> Found {
    let note = "some balances tell nothing of themselves: write its serial number down";
    match told {
        Ok(identity) if identity.is_unknown() => {
            Found::warning("it refuses to say who it is: identity unknown", note)
        }
        Ok(Identity { maker, model, serial, software }) => {
            let told = [Some(maker), model, serial.map(|it| format!("serial {it}")), software];
            Found::ok(told.into_iter().flatten().collect::<Vec<_>>().join(", "))
        }
        Err(DeviceError::Silent { .. }) => {
            Found::warning("it does not say who it is: identity unknown", note)
        }
        Err(error) => error.into(),
    }
}

fn reading(settings: &Settings, first: &Result<Sample, DeviceError>) -> Found {
    match first {
        Ok(sample) => Found::ok(format!("{} mg, from `{}`", sample.mass_mg, sample.raw)),
        Err(error @ DeviceError::Garbled { .. }) if settings.readability_mg.is_some() => {
            Found::failed(
                error.to_string(),
                "compare dialect and readability_mg in the bench file with the display",
            )
        }
        Err(error) => error.clone().into(),
    }
}

/// The driver refuses readings whose last place differs from the file's; whether that place steps
/// by 1, 2 or 5 shows in the numbers.
fn step(settings: &Settings, samples: &[Sample]) -> Found {
    let Some((place_mg, step)) = shown_step(settings, samples) else {
        let first = samples.first().map_or("", |sample| &sample.raw);
        return Found::failed(
            format!("`{first}` shows no step"),
            "compare the dialect with the display",
        );
    };
    // Three times a tenth is not 0.3, and 0.5 is written like that.
    let shown_mg = (step.unwrap_or(1) as f64 * place_mg * 1e6).round() / 1e6;
    let shown = match step {
        Some(_) => format!("{shown_mg} mg by the numbers that it showed"),
        None => format!("{shown_mg} mg in the last place, one number shown"),
    };
    match settings.readability_mg {
        Some(step_mg) => Found::judged(
            step.is_none() || is_same(shown_mg, step_mg),
            format!("{shown}, {step_mg} mg in the bench file"),
            format!("write readability_mg = {shown_mg} into the bench file"),
        ),
        None => Found::warning(
            format!("{shown}, nothing in the bench file"),
            format!("write readability_mg = {shown_mg} there, so that damaged readings are known"),
        ),
    }
}

/// The last place of the display, mg, and its step in that place; `None` for the latter where too
/// few different numbers were shown to tell.
fn shown_step(settings: &Settings, samples: &[Sample]) -> Option<(f64, Option<i64>)> {
    let places: Vec<(f64, i64)> =
        samples.iter().filter_map(|sample| in_last_places(settings, sample)).collect();
    let place_mg = places.first()?.0;
    let numbers: Vec<i64> = places.iter().filter(|it| it.0 == place_mg).map(|it| it.1).collect();
    let changes = numbers.windows(2).filter(|pair| pair[0] != pair[1]).count();
    let distinct: BTreeSet<i64> = numbers.iter().copied().collect();
    let step =
        STEPS.into_iter().rev().find(|step| numbers.iter().all(|number| number % step == 0))?;
    // By chance one number in five has a last digit that fits a step of five, two in succession one
    // time in 25.
    let is_known = distinct.len() >= 2 && (step == 1 || distinct.len() >= 3 || changes >= 3);
    Some((place_mg, Some(step).filter(|_| is_known)))
}

/// The last place of the display, mg, and the number in units of it.
fn in_last_places(settings: &Settings, sample: &Sample) -> Option<(f64, i64)> {
    match settings.dialect.parse(sample.raw.as_bytes()).ok()?.said {
        Said::Weight(weight) => {
            Some((weight.number.last_place_mg(weight.unit?), weight.number.in_last_places()))
        }
        _ => None,
    }
}

/// Becomes stable in time; is then observed for a while: reading rate, step, scatter, creep.
fn stands(
    file: &BenchFile,
    balance: &mut Balance,
    clock: &Clock,
    first: &Sample,
    found: &mut Findings,
) {
    found.add(
        "stable",
        format!("a stable reading within {} s", file.readings.stand_max_s),
        stable(file, balance, clock),
    );
    let (mut samples, failures) = watch(balance, clock);
    let shown: Vec<Shown> = samples
        .iter()
        .map(|it| Shown { t_s: it.t_s, mass_mg: it.mass_mg, flag: it.stable })
        .collect();
    samples.push(first.clone());
    let step_mg = file.balance.readability_mg.unwrap_or(1.0);
    let asked = format!("readings for {WATCH_S} s, nothing moving");
    found.add("rate", asked.clone(), rate(&shown, failures.as_ref()));
    found.add("step", asked.clone(), step(&file.balance, &samples));
    match standing(&Settling::new(step_mg), &shown) {
        Some(stood) => {
            found.add(
                "noise",
                asked.clone(),
                noise(file.readings.noise_mg, step_mg, stood.scatter_mg),
            );
            found.add("drift", asked, drift(step_mg, stood.drift_mg_min, stood.seconds));
        }
        None => found.skip(&["noise", "drift"], "there were too few readings"),
    }
    let life_s = file.readings.life_s;
    found.add(
        "life",
        format!("another number within {life_s} s, nothing moving"),
        life(life_s, &shown, balance, clock),
    );
}

fn stable(file: &BenchFile, balance: &mut Balance, clock: &Clock) -> Found {
    let began_s = clock.now_s();
    let sample = match balance.stable(file.readings.stand_max_s) {
        Ok(sample) => sample,
        Err(error) => return error.into(),
    };
    let by = if file.balance.stable_by == StableBy::Window { ", by FLIP's own window" } else { "" };
    Found::judged(
        sample.stable,
        format!("stable: {}{by}, after {:.1} s", sample.stable, clock.now_s() - began_s),
        balance.why_unstable(),
    )
}

/// Does a display at rest ever change? If so, it can prove that it is not stuck.
fn life(life_s: f64, shown: &[Shown], balance: &mut Balance, clock: &Clock) -> Found {
    if life_s <= 0.0 {
        return Found::warning(
            "readings.life_s = 0: nobody waits for it".to_owned(),
            "a display that is stuck is then known by what a spoon should have given, too late for some doses",
        );
    }
    let Some(first) = shown.first() else { return Found::skipped("no reading came") };
    let began_s = clock.now_s();
    let mut changes = shown.windows(2).filter(|pair| pair[0].mass_mg != pair[1].mass_mg).count();
    while changes == 0 && clock.now_s() - began_s < life_s {
        match balance.immediate() {
            Ok(sample) => changes += usize::from(sample.mass_mg != first.mass_mg),
            Err(error) => return error.into(),
        }
        clock.wait_s(ASK_EVERY_S);
    }
    match changes {
        0 => Found::failed(
            format!("{} mg for {life_s} s and longer", first.mass_mg),
            "is the display stuck? Else switch zero tracking off, which hides slow powder too, or weigh with a finer display; where neither can be had write \
             readings.life_s = 0, or doses end for want of a sign of life",
        ),
        changes => Found::ok(format!("it changed {changes} times")),
    }
}

/// Readings as fast as they arrive, and the last failure.
fn watch(balance: &mut Balance, clock: &Clock) -> (Vec<Sample>, Option<DeviceError>) {
    let began_s = clock.now_s();
    let (mut samples, mut failure, mut failures) = (Vec::new(), None, 0);
    while clock.now_s() - began_s < WATCH_S && samples.len() < READINGS_MAX && failures < 3 {
        match balance.immediate() {
            Ok(sample) => samples.push(sample),
            Err(error) => {
                failure = Some(error);
                failures += 1;
            }
        }
    }
    (samples, failure)
}

fn rate(shown: &[Shown], failure: Option<&DeviceError>) -> Found {
    if let Some(error) = failure {
        let came = format!("{} readings, then: {error}", shown.len());
        return Found::failed(
            came,
            "every question must be answered: check cable, speed and parity",
        );
    }
    let (Some(first), Some(last)) = (shown.first(), shown.last()) else {
        return Found::skipped("no reading came");
    };
    let hz = (shown.len() - 1) as f64 / (last.t_s - first.t_s).max(1e-3);
    let came = format!("{hz:.1} readings in a second");
    match hz {
        hz if hz < RATE_HZ[1] => {
            Found::failed(came, "raise the balance's display rate or the port's speed")
        }
        hz if hz < RATE_HZ[0] => {
            Found::warning(came, "doses take longer: raise the balance's display rate")
        }
        _ => Found::ok(came),
    }
}

fn noise(told_mg: f64, step_mg: f64, scatter_mg: f64) -> Found {
    // Half a step: a display that flips between two numbers is at rest.
    let limit_mg = 2.0 * told_mg.max(0.5 * step_mg);
    Found::judged(
        scatter_mg <= limit_mg,
        format!("SD {scatter_mg:.3} mg; up to {limit_mg:.3} mg by readings.noise_mg = {told_mg}"),
        "close the draught shield and keep the table still, or write the noise that is measured into the bench file",
    )
}

fn drift(step_mg: f64, drift_mg_min: f64, seconds: f64) -> Found {
    let change_mg = drift_mg_min.abs() * seconds / 60.0;
    // A display that flips once looks like a slope.
    let is_real = change_mg > 2.0 * step_mg;
    Found::judged(
        drift_mg_min.abs() <= DRIFT_MG_MIN_MAX || !is_real,
        format!("{drift_mg_min:.2} mg/min over {seconds:.1} s"),
        "let the balance warm up, level it, and keep sun, draught and static charge away",
    )
}

fn tare(balance: &mut Balance) -> Found {
    match balance.tare() {
        Ok(sample) => Found::ok(format!("{} mg, stable", sample.mass_mg)),
        Err(error) => Found::failed(
            error.to_string(),
            "nothing can be weighed without: do first what it says",
        ),
    }
}
