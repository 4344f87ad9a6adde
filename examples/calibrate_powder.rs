//! The story of one calibration: a measured angle of repose goes in, ten simulated powders that
//! pile like it come out.
//!
//! `cargo run --release --example calibrate_powder
//! [sand|sugar|salt|semolina|sodium_bicarbonate|all] [seed]`

use flip_core::domain::powder::{PUBLISHED, Published};
use flip_learn::calibrate::{Calibration, Error, Heap, Outcome, Phase, Pour, Settings, calibrate};
use flip_sim::repose::{Settings as HeapSettings, repose};
use rayon::prelude::*;
use std::ops::ControlFlow;
use std::time::Instant;

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let wanted = arguments.next().unwrap_or_else(|| "salt".to_owned());
    let settings = Settings {
        seed: arguments.next().map_or(Ok(1), |text| text.parse())?,
        ..Settings::default()
    };
    for powder in PUBLISHED.iter().filter(|p| wanted == "all" || p.id == wanted) {
        let start = Instant::now();
        match search(powder, &settings) {
            Ok(found) => report(powder, &found, start.elapsed().as_secs_f64()),
            Err(error) => println!("{}: {error}", powder.id),
        }
    }
    Ok(())
}

fn search(powder: &Published, settings: &Settings) -> Result<Calibration, Error> {
    let heap_settings = HeapSettings::with_particles(settings.particles);
    let heap = |pour: &Pour| {
        let pile = repose(&pour.parameters, &heap_settings, pour.seed)
            .map_err(|refusal| refusal.to_string())?;
        let (tip_deg, cone_deg, creep_deg_per_s) =
            (pile.tip_deg, pile.cone_deg, pile.creep_deg_per_s);
        Ok(Heap { tip_deg, tip_sd_deg: None, cone_deg, creep_deg_per_s })
    };
    // A batch of heaps at a time: here on all cores.
    let simulate = |pours: &[Pour]| pours.par_iter().map(heap).collect::<Vec<_>>();
    calibrate(&powder.automated, settings, None, &[], simulate, |trial, progress| {
        let phase = if trial.phase == Phase::Search { "search" } else { "verify" };
        match &trial.outcome {
            Outcome::Heap(heap) => {
                eprintln!("{}: {phase} {:.2} deg", progress.message, heap.tip_deg)
            }
            Outcome::Refused(reason) => {
                eprintln!("{}: {phase} refused, {reason}", progress.message)
            }
        }
        ControlFlow::Continue(())
    })
}

fn report(powder: &Published, found: &Calibration, wall_s: f64) {
    println!(
        "{}: {} sets at {:.2} deg in {} evaluations and {} verification runs, mean error {:.2} deg, {wall_s:.1} s",
        powder.id,
        found.sets.len(),
        powder.automated.repose_deg,
        found.evaluations,
        found.verification_runs,
        found.mean_error_deg.unwrap_or(f64::NAN),
    );
    for set in &found.sets {
        let p = &set.parameters;
        println!(
            "  {:.2} deg: friction {:.3}, cohesion {:.3}, adhesion {:.3}, gravity {:.3}, diameter {:.3} mm",
            set.repose_deg,
            p.friction(),
            p.cohesion(),
            p.adhesion(),
            p.gravity_scale(),
            p.particle_diameter_mm(),
        );
    }
}
