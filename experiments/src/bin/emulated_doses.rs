//! Doses through the true protocols of an emulated laboratory, compared with the same doses at the
//! published robot's wait of 4 s and others that are forecast from earlier ones: `cargo experiment emulated_doses [repeats] [seed] [first table] [longest watch, s] [tables]`.
//!
//! Five published powders, 15 and 20 mg, a balance that reads 1 mg, the policy that ships. A dose
//! is a weighing like any other: intent, guard, audit trail. The output depends on the code and the
//! seed alone.

use flip::app::{
    App, CalibrationRequest, Functions, JobState, LaboratorySettings, Options, Target, Tolerance,
    Weighing, WeighingRequest,
};
use flip_bench::hardware::bench_file::Readings;
use flip_bench::rig::Emulated;
use flip_core::domain::powder::PUBLISHED;
use flip_core::domain::weighing::Outcome;
use flip_core::stats::summary::{mean, sd};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

const TARGETS_MG: [f64; 2] = [15.0, 20.0];
const TOLERANCE_MG: f64 = 1.0;

#[tokio::main]
async fn main() -> anyhow::Result<()> {
    let numbers: Vec<u64> = std::env::args().skip(1).filter_map(|text| text.parse().ok()).collect();
    let (repeats, seed) =
        (numbers.first().copied().unwrap_or(5), numbers.get(1).copied().unwrap_or(1));
    let first = numbers.get(2).copied().unwrap_or(1) as usize;
    let stand_max_s =
        numbers.get(3).map_or(Readings::default().stand_max_s, |seconds| *seconds as f64);
    let tables = numbers.get(4).copied().unwrap_or(3) as usize;
    let folder = Path::new("target").join(format!("emulated-doses-{first}-{stand_max_s}"));
    for (name, fixed_wait_s, remembers) in [
        ("settling filter", None, false),
        ("fixed wait of 4 s", Some(4.0), false),
        ("settling filter, other spoonfuls, a powder's last twenty doses known", None, true),
    ]
    .into_iter()
    .skip(first.saturating_sub(1))
    .take(tables)
    {
        let readings = Readings { fixed_wait_s, stand_max_s, ..Readings::default() };
        let laboratory =
            LaboratorySettings { readings, remembers, ..LaboratorySettings::default() };
        let functions =
            Functions { rig: Arc::new(Emulated::new(laboratory)), ..Functions::default() };
        let app = App::open(&folder, Options { functions, ..Options::default() }).await?;
        calibrate(&app, seed).await?;
        println!(
            "\n{name}\n\n| powder | target mg | errors mg | mean absolute error mg | shakes | bench s |\n|---|---|---|---|---|---|"
        );
        let mut all = Vec::new();
        let mut within_cells = Vec::new();
        for (number, powder) in (0..).zip(PUBLISHED) {
            for target_mg in TARGETS_MG {
                let mut doses = Vec::new();
                for repeat in 0..repeats {
                    // Each dose has its own spoonful, and a balance with its own wander; remembered
                    // doses use a different spoonful.
                    let path = [repeat, number, target_mg as u64, remembers.into()];
                    let seed = flip_core::domain::seed::derive(seed, &path) >> 11;
                    doses.push(dose(&app, powder.id, target_mg, seed).await?);
                }
                tell(powder.id, target_mg, &doses);
                within_cells.extend(sd(&errors(&doses)));
                all.append(&mut doses);
            }
        }
        summary(&all, &within_cells);
        app.shutdown().await?;
    }
    Ok(())
}

async fn calibrate(app: &App, seed: u64) -> anyhow::Result<()> {
    for powder in PUBLISHED {
        let request = CalibrationRequest {
            powder: Some(powder.id.to_owned()),
            seed: Some(seed),
            ..CalibrationRequest::default()
        };
        let (job, _) = app.start_calibration(request).await?;
        loop {
            match app.job(&job.id).await?.state {
                JobState::Succeeded => break,
                JobState::Failed | JobState::Cancelled => {
                    anyhow::bail!("the calibration of {} failed", powder.id)
                }
                _ => tokio::time::sleep(Duration::from_millis(100)).await,
            }
        }
    }
    Ok(())
}

async fn dose(app: &App, powder: &str, target_mg: f64, seed: u64) -> anyhow::Result<Weighing> {
    let request = WeighingRequest {
        powder: powder.to_owned(),
        target: Target { value: target_mg, unit: "mg".into() },
        tolerance: Tolerance { lower: TOLERANCE_MG, upper: TOLERANCE_MG, unit: "mg".into() },
        policy: None,
        seed: Some(seed),
        simulator: None,
        conditions: Default::default(),
        asked: Default::default(),
        vial_check: Default::default(),
        reservation: None,
        labels: Default::default(),
        bench_name: None,
    };
    let (weighing, _) = app.start_weighing(request, &format!("{}", uuid::Uuid::now_v7())).await?;
    loop {
        let now = app.weighing(&weighing.id).await?.weighing;
        if now.outcome.is_some() {
            anyhow::ensure!(now.dispensed_mg.is_some(), "weighing {}: {:?}", now.id, now.error);
            return Ok(now);
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// Errors of the true mass.
fn errors(doses: &[Weighing]) -> Vec<f64> {
    doses.iter().filter_map(|dose| Some(dose.dispensed_mg? - dose.target_mg)).collect()
}

fn absolute(doses: &[Weighing]) -> f64 {
    mean(&errors(doses).iter().map(|error| error.abs()).collect::<Vec<_>>()).unwrap_or(f64::NAN)
}

fn tell(powder: &str, target_mg: f64, doses: &[Weighing]) {
    let listed =
        errors(doses).iter().map(|error| format!("{error:+.2}")).collect::<Vec<_>>().join(", ");
    let of = |value: fn(&Weighing) -> f64| {
        mean(&doses.iter().map(value).collect::<Vec<_>>()).unwrap_or(f64::NAN)
    };
    let shakes = of(|dose| f64::from(dose.shakes.unwrap_or(0)));
    let seconds = of(|dose| dose.seconds.unwrap_or(f64::NAN));
    println!(
        "| {powder} | {target_mg} | {listed} | {:.2} | {shakes:.1} | {seconds:.0} |",
        absolute(doses)
    );
}

fn summary(doses: &[Weighing], within_cells: &[f64]) {
    let all = errors(doses);
    let share = |outcome: Outcome| {
        100.0 * doses.iter().filter(|dose| dose.outcome == Some(outcome)).count() as f64
            / doses.len() as f64
    };
    let seconds =
        mean(&doses.iter().filter_map(|dose| dose.seconds).collect::<Vec<_>>()).unwrap_or(f64::NAN);
    println!(
        "\n{} doses: mean absolute error {:.2} mg, SD over doses {:.2}, mean SD within cells {:.2}, bias {:+.2}; within {:.0} %, over {:.0} %, under {:.0} %; {seconds:.0} s on the bench",
        doses.len(),
        absolute(doses),
        sd(&all).unwrap_or(f64::NAN),
        mean(within_cells).unwrap_or(f64::NAN),
        mean(&all).unwrap_or(f64::NAN),
        share(Outcome::Within),
        share(Outcome::Over),
        share(Outcome::Under),
    );
}
