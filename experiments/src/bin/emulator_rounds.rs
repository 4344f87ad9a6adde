//! What an emulator of the angle loses if its heaps are poured in fewer and larger rounds or with fewer
//! readings, as suits a graphics card: its error on heaps that it has not seen, and how long it takes.
//!
//! `cargo experiment emulator_rounds -- 240:64:22:4,240:64:88:4 3 150 cuda`: designs, each its heaps, those
//! of the first round and of each further one, and readings; seeds of each; heaps that it is asked about;
//! `cuda` pours on the cards of this machine, otherwise its cores do.

use flip::app::local_engine;
use flip_core::domain::device::Device;
use flip_core::domain::parameters::ParameterSet;
use flip_core::stats::latin_hypercube::latin_hypercube;
use flip_core::stats::summary;
use flip_learn::calibrate::{Design, Emulator, Heap, Heard, Pour, Simulate, build};
use flip_sim::batch::Engine;
use flip_sim::batch::heaps::{Wanted, pour_on};
use flip_sim::directions;
use flip_sim::repose::{Repose, Settings, repose};
use rand::SeedableRng;
use rand_pcg::Pcg64;
use rayon::prelude::*;
use std::cell::Cell;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Instant;

/// Angles that powders have, degrees: heaps outside are not asked about.
const ASKED: [f64; 2] = [20.0, 52.0];

/// Where heaps are poured: on a card, or on the cores.
#[derive(Clone)]
struct Pours(Option<Arc<dyn Engine>>);

impl Pours {
    fn on(place: Option<&str>) -> Result<Self, Box<dyn std::error::Error>> {
        match place {
            None => Ok(Self(None)),
            Some("cuda") => Ok(Self(local_engine(Device::Cuda)?)),
            Some(other) => Err(format!("`cuda` or nothing, not {other}").into()),
        }
    }

    fn all(&self, pours: &[Pour]) -> Vec<Result<Heap, String>> {
        let settings = |pour: &Pour| Settings {
            readings: pour.readings,
            ..Settings::with_particles(pour.particles)
        };
        let Some(engine) = &self.0 else {
            let one = |pour: &Pour| repose(&pour.parameters, &settings(pour), pour.seed);
            return pours.par_iter().map(|pour| answer(one(pour))).collect();
        };
        let wanted = |pour: &Pour| Wanted {
            set: pour.parameters,
            settings: settings(pour),
            seed: pour.seed,
        };
        let wanted: Vec<Wanted> = pours.iter().map(wanted).collect();
        let mut heaps = vec![Err("the card did not answer".to_owned()); pours.len()];
        let mut each = |k: usize, heap| {
            heaps[k] = answer(heap);
            ControlFlow::Continue(())
        };
        if let Err(failed) = pour_on(&**engine, &wanted, &mut each) {
            panic!("{failed}");
        }
        heaps
    }
}

/// Pours a round as a whole, and adds up how long that takes.
struct Timed<'a> {
    pours: &'a Pours,
    seconds: &'a Cell<f64>,
}

impl Simulate<Pour, Heap> for Timed<'_> {
    fn simulate(&self, round: &[Pour], heard: &mut Heard<'_, Heap>) {
        let begun = Instant::now();
        let heaps = self.pours.all(round);
        self.seconds.set(self.seconds.get() + begun.elapsed().as_secs_f64());
        let _ = heaps.into_iter().try_for_each(heard);
    }
}

fn answer<E: std::fmt::Display>(heap: Result<Repose, E>) -> Result<Heap, String> {
    let heap = heap.map_err(|why| why.to_string())?;
    Ok(Heap {
        tip_deg: heap.tip_deg,
        tip_sd_deg: heap.tip_sd_deg,
        cone_deg: heap.cone_deg,
        creep_deg_per_s: heap.creep_deg_per_s,
    })
}

/// Root-mean-square error of a heap's prediction, degrees, its mean, and the former in standard
/// deviations, the scatter of the heap included.
fn errors(emulator: &Emulator, asked: &[(ParameterSet, Heap)], readings: u32) -> [f64; 3] {
    let of = |(set, heap): &(ParameterSet, Heap)| {
        let expected = emulator.expect(set);
        let error = expected.mean.mean - heap.tip_deg;
        let scatter2 = expected.seed_sd_deg.powi(2) / f64::from(readings);
        [error.powi(2), error, error.powi(2) / (expected.mean.sd.powi(2) + scatter2)]
    };
    let all: Vec<[f64; 3]> = asked.iter().map(of).collect();
    let [square, mean, score2] = [0, 1, 2].map(|k| {
        let each: Vec<f64> = all.iter().map(|it| it[k]).collect();
        summary::mean(&each).unwrap_or(f64::NAN)
    });
    [square.sqrt(), mean, score2.sqrt()]
}

/// Reads `heaps:first:round:readings`.
fn design(text: &str, seed: u64) -> Result<Design, Box<dyn std::error::Error>> {
    let numbers: Vec<u32> = text.split(':').map(str::parse).collect::<Result<_, _>>()?;
    let [runs, initial, round, readings] = numbers[..] else {
        return Err(format!("heaps:first:round:readings, not {text}").into());
    };
    let usual = Design::with_particles(Settings::default().particles);
    Ok(Design { runs, initial, round, readings, seed, ..usual })
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let argument = |k: usize, usual| arguments.get(k).map_or(usual, String::as_str);
    let designs = argument(0, "240:64:22:4,240:64:88:4");
    let (seeds, asked): (u64, usize) = (argument(1, "3").parse()?, argument(2, "150").parse()?);
    let pours = Pours::on(arguments.get(3).map(String::as_str))?;
    let usual = Design::with_particles(Settings::default().particles);
    let points = latin_hypercube(asked, &mut Pcg64::seed_from_u64(20_261_130));
    let question = |(k, point): (usize, &[f64; flip_core::domain::parameters::COUNT])| Pour {
        parameters: ParameterSet::from_unit(*point),
        particles: usual.particles,
        readings: usual.readings,
        seed: 1_000_000 + k as u64,
    };
    let questions: Vec<Pour> = points.iter().enumerate().map(question).collect();
    let heaps = pours.all(&questions);
    let mut unseen: Vec<(ParameterSet, Heap)> = questions
        .iter()
        .zip(heaps)
        .filter_map(|(pour, heap)| Some((pour.parameters, heap.ok()?)))
        .collect();
    unseen.retain(|(_, heap)| (ASKED[0]..=ASKED[1]).contains(&heap.tip_deg));
    println!("{} heaps of {} that were not seen, within {ASKED:?} deg\n", unseen.len(), asked);
    println!(
        "| heaps | first | round | readings | rounds | seed | error deg | mean error deg | in standard deviations | poured s | in all s |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    for text in designs.split(',') {
        for seed in 1..=seeds {
            let design = design(text, seed)?;
            let (begun, poured_s) = (Instant::now(), Cell::new(0.0));
            let all = Timed { pours: &pours, seconds: &poured_s };
            let emulator = build(&design, directions, &[], all, |_, _| ControlFlow::Continue(()))?;
            let all_s = begun.elapsed().as_secs_f64();
            let [error_deg, mean_deg, score] = errors(&emulator, &unseen, usual.readings);
            let Design { runs, initial, round, readings, .. } = design;
            let many = 1 + (runs - initial).div_ceil(round);
            println!(
                "| {runs} | {initial} | {round} | {readings} | {many} | {seed} | {error_deg:.3} | {mean_deg:+.3} | {score:.2} | {:.1} | {all_s:.1} |",
                poured_s.get()
            );
        }
    }
    Ok(())
}
