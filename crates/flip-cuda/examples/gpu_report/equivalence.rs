//! Doses of the CPU against doses of the card, cell by cell: two one-sided tests.
//!
//! A cell is a powder, a pitch and a stroke. Measured are the mass poured on the way to the pitch
//! and the mass of one shake there. Margin: half of the scatter of one run on the CPU. Both start
//! from the same beds, which can only make them more alike than independent runs: the tests treat
//! them as independent.

use crate::powders::{filled, on_all, powder};
use flip_core::domain::bench::Action;
use flip_core::domain::parameters::ParameterSet;
use flip_cuda::{Bed, Card, Result, Spoons};
use flip_sim::dispense::{Dispenser, Settings};

const FRICTIONS: [f64; 2] = [0.2, 0.6];
const COHESIONS: [f64; 2] = [0.0, 0.6];
const PITCHES_DEG: [u32; 3] = [24, 32, 40];
const STROKES_MM: [f64; 3] = [4.0, 8.0, 16.0];
/// Runs of each cell on each side.
const RUNS: usize = 128;
/// Pitch of one step, degrees.
const STEP_DEG: u32 = 8;
/// The 95 % quantile of Student's t for two samples of 128.
const T: f64 = 1.65;

/// Masses by pitch: poured on the way there, and by a shake of each stroke.
type Doses = Vec<(f64, Vec<f64>)>;

/// Prints the table.
pub fn report(card: &Card) -> Result<()> {
    let powders: Vec<ParameterSet> =
        FRICTIONS.iter().flat_map(|f| COHESIONS.map(|c| powder(*f, c))).collect();
    let spoons = filled(RUNS * powders.len(), &powders, &Settings::default());
    let start = std::time::Instant::now();
    let cpu = on_all(spoons.len(), |k| on_core(&spoons[k]));
    let cpu_s = start.elapsed().as_secs_f64();
    let start = std::time::Instant::now();
    let gpu = on_card(card, &spoons)?;
    let gpu_s = start.elapsed().as_secs_f64();
    println!(
        "\ndoses, mg, mean +- scatter of one run, n = {RUNS} each; cores {cpu_s:.1} s, card {gpu_s:.1} s"
    );
    println!(
        "| friction | cohesion | pitch | what | CPU | card | difference, scatters | equivalent |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    let (mut cells, mut equivalent) = (0, 0);
    for (k, (f, c)) in FRICTIONS.iter().flat_map(|f| COHESIONS.map(|c| (f, c))).enumerate() {
        let of_powder = |doses: &[Doses], pick: &dyn Fn(&Doses) -> f64| -> Vec<f64> {
            doses.iter().skip(k).step_by(powders.len()).map(pick).collect()
        };
        for (p, pitch) in PITCHES_DEG.iter().enumerate() {
            let poured = |doses: &Doses| doses[p].0;
            let pair = (of_powder(&cpu, &poured), of_powder(&gpu, &poured));
            let mut rows = vec![("poured".to_owned(), pair)];
            for (s, stroke) in STROKES_MM.iter().enumerate() {
                let shaken = |doses: &Doses| doses[p].1[s];
                let pair = (of_powder(&cpu, &shaken), of_powder(&gpu, &shaken));
                rows.push((format!("{stroke} mm"), pair));
            }
            for (what, (cpu, gpu)) in rows {
                let test = Test::of(&cpu, &gpu);
                cells += 1;
                equivalent += usize::from(test.is_equivalent);
                println!("| {f} | {c} | {pitch} | {what} | {test} |");
            }
        }
    }
    println!("{equivalent} of {cells} cells equivalent");
    Ok(())
}

fn on_core(spoon: &Dispenser) -> Doses {
    let mut spoon = spoon.clone();
    let (mut pitch, mut poured) = (0, 0.0);
    let mut doses = Vec::new();
    for until in PITCHES_DEG {
        while pitch < until {
            poured += spoon.step(Action::once(f64::from(STEP_DEG), 0.0)).vial_mg;
            pitch += STEP_DEG;
        }
        let shaken = STROKES_MM.map(|mm| spoon.clone().step(Action::once(0.0, mm)).vial_mg);
        doses.push((poured, shaken.to_vec()));
    }
    doses
}

/// The same on the card: a spoon of its own for each stroke and pitch, as it cannot be cloned.
fn on_card(card: &Card, spoons: &[Dispenser]) -> Result<Vec<Doses>> {
    let beds: Vec<Bed> = spoons.iter().map(Bed::of).collect::<std::result::Result<_, _>>()?;
    let mut doses = vec![Doses::new(); spoons.len()];
    let branches = STROKES_MM.len() * spoons.len();
    for until in PITCHES_DEG {
        let mut batch = Spoons::new(card, beds.clone(), branches)?;
        let mut poured = vec![0.0; branches];
        for _ in 0..until / STEP_DEG {
            let all: Vec<_> =
                (0..branches).map(|k| (k, Action::once(f64::from(STEP_DEG), 0.0))).collect();
            for (sum, poured) in poured.iter_mut().zip(batch.step(&all)?) {
                *sum += poured.vial_mg;
            }
        }
        let shakes: Vec<_> =
            (0..branches).map(|k| (k, Action::once(0.0, STROKES_MM[k / spoons.len()]))).collect();
        let shaken = batch.step(&shakes)?;
        for (k, doses) in doses.iter_mut().enumerate() {
            let each = (0..STROKES_MM.len()).map(|s| shaken[s * spoons.len() + k].vial_mg);
            doses.push((poured[k], each.collect()));
        }
    }
    Ok(doses)
}

struct Test {
    cpu: [f64; 2],
    gpu: [f64; 2],
    difference: f64,
    is_equivalent: bool,
}

fn mean_and_scatter(values: &[f64]) -> [f64; 2] {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0);
    [mean, variance.sqrt()]
}

impl Test {
    fn of(cpu: &[f64], gpu: &[f64]) -> Self {
        let (a, b) = (mean_and_scatter(cpu), mean_and_scatter(gpu));
        let difference = b[0] - a[0];
        let error = (a[1] * a[1] / cpu.len() as f64 + b[1] * b[1] / gpu.len() as f64).sqrt();
        let margin = 0.5 * a[1];
        // Where no run of either side pours anything else, there is nothing to tell apart.
        let is_constant = difference == 0.0 && error == 0.0;
        let is_equivalent = is_constant || margin - difference.abs() > T * error;
        Self {
            cpu: a,
            gpu: b,
            difference: if is_constant { 0.0 } else { difference / a[1] },
            is_equivalent,
        }
    }
}

impl std::fmt::Display for Test {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { cpu, gpu, difference, is_equivalent } = self;
        write!(
            f,
            "{:.3} +- {:.3} | {:.3} +- {:.3} | {difference:+.2} | ",
            cpu[0], cpu[1], gpu[0], gpu[1]
        )?;
        f.write_str(if *is_equivalent { "yes" } else { "no" })
    }
}
