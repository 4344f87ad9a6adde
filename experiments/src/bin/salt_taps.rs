//! An external check of the spoon: mass per shake against the pitch, compared with measured taps of
//! salt.
//!
//! ```text
//! cargo experiment salt_taps -- ../shared/data/derived/salt_tap_vs_tilt.csv
//! ```
//!
//! The file has a line for each tilt: `tilt_deg,n_taps,mean_mg_per_tap,sd_mg`. Its taps are those
//! of a solenoid on an auger's tube, not shakes of a spoon: the shape is compared, not the mass.

use flip_core::domain::conditions::Patch;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use flip_sim::observe::shakes;
use rayon::prelude::*;

/// Spoons at each pitch and shakes of each.
const SPOONS: u64 = 12;
const SHAKES: u32 = 5;
/// Amplitude of a shake, mm.
const SHAKE_MM: f64 = 2.0;

fn main() -> anyhow::Result<()> {
    let file =
        std::env::args().nth(1).ok_or_else(|| anyhow::anyhow!("name the file of measured taps"))?;
    let measured = read(&std::fs::read_to_string(&file)?)?;
    // A set that was calibrated to salt, 36 deg.
    let mut salt = ParameterSet::default();
    for (key, value) in [
        ("friction", 0.65831),
        ("cohesion", 0.09759),
        ("adhesion", 0.47341),
        ("gravity_scale", 0.893013),
    ] {
        salt = salt.with(key, value)?;
    }
    println!("tilt deg | tap mg   CV | shake mg   CV");
    let (mut taps, mut pours) = (Vec::new(), Vec::new());
    for (tilt_deg, mean, sd) in measured.into_iter().filter(|row| row.0 <= 60.0) {
        let grains = (0..SPOONS).into_par_iter().map(|spoon| {
            shakes(&salt, &Patch::default(), [tilt_deg, SHAKE_MM], SHAKES, derive(1, &[spoon]))
        });
        let spoons: Vec<Vec<f64>> = grains.collect::<Result<_, _>>()?;
        let mg: Vec<f64> = spoons
            .concat()
            .iter()
            .map(|grains| grains * salt.particle_mass_ug() / 1000.0)
            .collect();
        let shake = mg.iter().sum::<f64>() / mg.len() as f64;
        let spread =
            (mg.iter().map(|x| (x - shake).powi(2)).sum::<f64>() / (mg.len() - 1) as f64).sqrt();
        let scatter = if shake > 0.0 { format!("{:.2}", spread / shake) } else { "-".to_owned() };
        println!("{tilt_deg:8} | {mean:6.2} {:4.2} | {shake:8.2} {scatter:>4}", sd / mean);
        taps.push([tilt_deg, mean.ln()]);
        if shake > 0.0 {
            pours.push([tilt_deg, shake.ln()]);
        }
    }
    for (what, points) in [("taps", &taps), ("shakes that let something fall", &pours)] {
        let [slope, r2] = line(points);
        println!(
            "{what}: a factor of e in {:.1} deg, log-linear with R2 {r2:.2}, n {}",
            1.0 / slope,
            points.len()
        );
    }
    Ok(())
}

/// Tilt, mean and standard deviation of each line.
fn read(text: &str) -> anyhow::Result<Vec<(f64, f64, f64)>> {
    let number = |cells: &[&str], k: usize| -> anyhow::Result<f64> {
        Ok(cells.get(k).copied().unwrap_or("").parse()?)
    };
    let row = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        Ok((number(&cells, 0)?, number(&cells, 2)?, number(&cells, 3)?))
    };
    text.lines().skip(1).map(row).collect()
}

/// Slope of a least-squares line and its coefficient of determination.
fn line(points: &[[f64; 2]]) -> [f64; 2] {
    let n = points.len() as f64;
    let mean = |k: usize| points.iter().map(|p| p[k]).sum::<f64>() / n;
    let sum = |i: usize, j: usize| {
        points.iter().map(|p| (p[i] - mean(i)) * (p[j] - mean(j))).sum::<f64>()
    };
    [sum(0, 1) / sum(0, 0), sum(0, 1).powi(2) / (sum(0, 0) * sum(1, 1))]
}
