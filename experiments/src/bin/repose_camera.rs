//! How well a depth camera measures known angles of repose: rendered piles, drawn at random,
//! measured by both estimators.
//!
//! `cargo experiment repose_camera [piles of each angle] [seed]`

use flip_bench::emulate::camera::{Studio, frames};
use flip_bench::pile::{Dimensions, Lengths, Limits, Measurement, Refusal, measure};
use std::time::Instant;

/// Angles of the piles, degrees.
const ANGLES_DEG: [f64; 6] = [25.0, 30.0, 35.0, 40.0, 45.0, 50.0];
/// Frames of each pile.
const FRAMES: usize = 10;

/// One estimator, and the truth it is compared with.
struct Estimator {
    name: &'static str,
    lengths: Lengths,
    read: fn(&Measurement, &Studio) -> [f64; 3],
}

fn tip(measured: &Measurement, studio: &Studio) -> [f64; 3] {
    [measured.tip.deg - studio.cone.tip_deg, measured.tip.u_deg, measured.tip.u_frames_deg]
}

fn cone(measured: &Measurement, studio: &Studio) -> [f64; 3] {
    [measured.cone.deg - studio.cone.cone_deg(), measured.cone.u_deg, measured.cone.u_frames_deg]
}

const ESTIMATORS: [Estimator; 3] = [
    Estimator { name: "tip", lengths: Lengths::ByTipHeight, read: tip },
    Estimator { name: "tip, lengths as stated", lengths: Lengths::Stated, read: tip },
    Estimator { name: "cone", lengths: Lengths::ByTipHeight, read: cone },
];

/// The rig as recorded by an operator with this ruler.
fn written(studio: &Studio, lengths: Lengths) -> Dimensions {
    let rig = Dimensions::default();
    Dimensions {
        tip_height_mm: rig.tip_height_mm + studio.ruler_mm[0],
        base_diameter_mm: rig.base_diameter_mm + studio.ruler_mm[1],
        base_height_mm: rig.base_height_mm + studio.ruler_mm[2],
        lengths,
        ..rig
    }
}

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let piles: u64 = arguments.next().map_or(Ok(10), |text| text.parse())?;
    let seed: u64 = arguments.next().map_or(Ok(1), |text| text.parse())?;
    println!("{piles} piles of each angle, {FRAMES} frames of each, seeds from {seed}\n");
    println!(
        "| estimator | AoR deg | refused | bias deg | SD deg | stated u deg | of it frames deg | within 2 u % |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    let (mut seconds, mut measured) = (0.0, 0);
    let mut refusals = Vec::new();
    let mut rows = vec![Vec::new(); ESTIMATORS.len()];
    for deg in ANGLES_DEG {
        let mut found = vec![Vec::new(); ESTIMATORS.len()];
        for pile in 0..piles {
            let studio = Studio::drawn(deg, seed + pile);
            let taken = frames(
                &studio.scene,
                &studio.pose,
                &studio.optics,
                &studio.noise,
                seed + pile,
                FRAMES,
            );
            for (estimator, found) in ESTIMATORS.iter().zip(&mut found) {
                let began = Instant::now();
                let result =
                    measure(&taken, &written(&studio, estimator.lengths), &Limits::default());
                (seconds, measured) = (seconds + began.elapsed().as_secs_f64(), measured + 1);
                found.push(result.map(|m| (estimator.read)(&m, &studio)));
            }
        }
        for ((estimator, found), row) in ESTIMATORS.iter().zip(&found).zip(&mut rows) {
            row.push(line(estimator.name, &format!("{deg}"), found));
            let refused = found.iter().filter_map(|result| result.as_ref().err());
            refusals
                .extend(refused.map(|refusal| format!("{}, {deg} deg: {refusal}", estimator.name)));
        }
    }
    rows.iter().flatten().for_each(|row| println!("{row}"));
    refusals.iter().for_each(|refusal| println!("\nrefused: {refusal}"));
    println!(
        "\n{:.3} s for a measurement of {FRAMES} frames, mean of {measured}",
        seconds / f64::from(measured)
    );
    Ok(())
}

fn line(name: &str, deg: &str, found: &[Result<[f64; 3], Refusal>]) -> String {
    let known: Vec<[f64; 3]> = found.iter().filter_map(|r| r.as_ref().ok().copied()).collect();
    let n = known.len() as f64;
    let mean = |of: fn(&[f64; 3]) -> f64| known.iter().map(of).sum::<f64>() / n;
    let bias = mean(|k| k[0]);
    let sd = (known.iter().map(|k| (k[0] - bias).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
    let within = 100.0 * mean(|k| f64::from(u8::from(k[0].abs() <= 2.0 * k[1])));
    let (u, frames) = (mean(|k| k[1] * k[1]).sqrt(), mean(|k| k[2] * k[2]).sqrt());
    let refused = found.len() - known.len();
    format!(
        "| {name} | {deg} | {refused} | {bias:+.2} | {sd:.2} | {u:.2} | {frames:.2} | {within:.0} |"
    )
}
