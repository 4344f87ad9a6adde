//! Spoonfuls of the emulated laboratory with a mechanism hidden in them, and the simulator that
//! they are judged with.
//!
//! ```text
//! bench      the emulated laboratory's own spoon (`flip_bench::emulate::hidden`), a fixed course, a balance's display
//! powders    four angles; each calibrated as three sets of that angle, with friction and cohesion traded
//! truth      another set of the angle, its cohesion drawn; with a mechanism that moves heaps, its friction is what keeps the angle
//! ```
//!
//! Courses are fixed, so a replay of a set is the same experiment for every bench: replays and
//! heaps are kept in a file and shared between benches. Of those as calibrated each bench gets
//! others out of a stock; those of a cause are the same for all benches of a powder.

use flip::jobs::replays::Spoons;
use flip::jobs::{HeapRunner, SpoonRunner, heaps_on_cores, spoons_on_cores};
use flip_bench::emulate::hidden::{self, Hidden, Mechanism};
use flip_core::domain::bench::{Action, PitchLimits};
use flip_core::domain::conditions::Patch;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::powder::Flowability;
use flip_core::domain::seed::{derive, index_of};
use flip_core::domain::shake::{Shake, Spoonful};
use flip_core::stats::normal;
use flip_discover::spoon::report::PowderReport;
use flip_discover::spoon::{Calibrated, Settings, Simulator, SpoonHeap, SpoonReplay, judge_spoon};
use flip_sim::dispense;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::cell::RefCell;
use std::collections::HashMap;
use std::io::Write;
use std::path::PathBuf;
use std::sync::Mutex;

/// How large the experiment is.
#[derive(Debug, Clone, Copy)]
pub struct Size {
    pub grains: u32,
    /// Pitches in order; two strokes at each.
    pub pitches_deg: &'static [f64],
    /// Stroke of each spoonful.
    pub strokes_mm: &'static [f64],
}

/// Of the table: a spoonful weighs 7 mg, a fifth of the product's.
pub const WHOLE: Size = Size {
    grains: 300,
    pitches_deg: &[20.0, 28.0, 36.0, 44.0, 52.0, 60.0],
    strokes_mm: &[12.0, 6.0, 3.0, 12.0, 6.0],
};
/// Of a test.
pub const SMALL: Size =
    Size { grains: 200, pitches_deg: &[24.0, 36.0, 48.0, 60.0], strokes_mm: &[8.0, 4.0, 2.0, 8.0] };

/// A balance: step of its display and noise of a reading, mg.
#[derive(Debug, Clone, Copy)]
pub struct Balance {
    pub readability_mg: f64,
    pub noise_mg: f64,
}

pub const BALANCES: [Balance; 2] = [
    Balance { readability_mg: 1.0, noise_mg: 0.2 },
    Balance { readability_mg: 0.1, noise_mg: 0.03 },
];

/// A powder: three sets that pile alike.
#[derive(Debug, Clone)]
pub struct Powder {
    pub angle_deg: f64,
    pub sets: Vec<ParameterSet>,
}

/// Angles of the powders, deg.
pub const ANGLES_DEG: [f64; 4] = [36.0, 40.0, 33.0, 42.0];
const COHESIONS: [f64; 3] = [0.0, 0.25, 0.5];
const FRICTIONS: [f64; 4] = [0.4, 0.7, 1.0, 1.3];
/// Grains of the published box, the largest: few of them weigh most.
const DIAMETER_MM: f64 = 0.32;
/// Heaps of one angle.
const HEAPS: u64 = 3;
/// Replays as calibrated from which a bench gets its own, of each set and spoonful.
const STOCK: u64 = 40;
/// The angle of a truth with a mechanism is within this of the powder's, deg.
const STANDS_DEG: f64 = 0.7;
const ROUNDS: usize = 4;

/// A kept answer.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Kept {
    key: String,
    mg: Option<Vec<f64>>,
}

/// The bench, and the simulator that knows its course.
pub struct Bench {
    pub size: Size,
    replays: SpoonRunner,
    heaps: HeapRunner,
    kept: Mutex<HashMap<String, Option<Vec<f64>>>>,
    file: Option<PathBuf>,
}

/// A bench without anything hidden, or with this.
#[derive(Debug, Clone, Copy)]
pub struct Truth {
    pub hidden: Option<Hidden>,
    pub set: ParameterSet,
    /// Angle of its heaps less the powder's, deg; 0 where the mechanism is none of heaps.
    pub off_deg: f64,
}

impl Bench {
    /// What was simulated is read from this file and added to it.
    pub fn new(size: Size, file: Option<PathBuf>) -> Self {
        let text = file.as_ref().and_then(|file| std::fs::read_to_string(file).ok());
        let text = text.unwrap_or_default();
        let lines = text.lines().filter_map(|line| serde_json::from_str::<Kept>(line).ok());
        Self {
            size,
            replays: spoons_on_cores(flip_sim::replay::replay),
            heaps: heaps_on_cores(flip_sim::repose::repose),
            kept: Mutex::new(lines.map(|it| (it.key, it.mg)).collect()),
            file,
        }
    }

    /// A spoon that these grains fill as 2500 of the usual ones fill the usual one.
    fn spoon(&self) -> dispense::Settings {
        let usual = dispense::Settings::default();
        let set = ParameterSet::default();
        let grains = f64::from(self.size.grains) / f64::from(usual.particles);
        let scale = libm::cbrt(grains) * DIAMETER_MM / set.particle_diameter_mm();
        let semi_axes_mm = usual.semi_axes_mm.map(|mm| mm * scale);
        dispense::Settings {
            particles: self.size.grains,
            semi_axes_mm,
            pitch: PitchLimits::OPEN,
            ..usual
        }
    }

    /// The course, not yet weighed: three spoonfuls on a day.
    fn course(&self, balance: Balance) -> Vec<Spoonful> {
        let Balance { readability_mg, noise_mg } = balance;
        let sd_mg = (2.0 * (noise_mg.powi(2) + readability_mg.powi(2) / 12.0)).sqrt();
        let shake = |pitch_deg: f64, shake_mm: f64| Shake {
            pitch_deg,
            shake_mm,
            strokes: 1,
            acceleration_m_s2: None,
            spoon_mg: None,
            fell_mg: 0.0,
            sd_mg,
            since_filled_s: None,
        };
        let steps = |mm: f64| {
            let twice = self.size.pitches_deg.iter().flat_map(|deg| [*deg, *deg]);
            twice.map(|deg| shake(deg, mm)).collect::<Vec<_>>()
        };
        let spoonful = |(k, mm): (usize, &f64)| Spoonful {
            weighing: format!("w{k}"),
            spoonful: 1,
            powder: "powder".to_owned(),
            lot: None,
            session: Some(format!("day {}", 1 + k / 3)),
            readability_mg: Some(readability_mg),
            shakes: steps(*mm),
        };
        self.size.strokes_mm.iter().enumerate().map(spoonful).collect()
    }

    /// What falls from the emulated laboratory's spoon, `[spoonful][step]`, mg.
    pub fn poured(&self, truth: &Truth, seed: u64) -> Vec<Vec<f64>> {
        let course = self.course(BALANCES[0]);
        let one = |(k, spoonful): (usize, &Spoonful)| {
            let seed = derive(seed, &[k as u64]);
            let mut spoon = hidden::spoon(truth.hidden, &truth.set, &self.spoon(), seed);
            spoon.refill();
            let step = |shake: &Shake| {
                // As an arm does it: the powder rests in between.
                let turn = shake.pitch_deg - spoon.pitch_deg();
                let mut fell_mg = spoon.step(Action::once(turn, 0.0)).mass_mg;
                if shake.shake_mm > 0.0 {
                    fell_mg += spoon.step(Action::once(0.0, shake.shake_mm)).mass_mg;
                }
                fell_mg
            };
            spoonful.shakes.iter().map(step).collect()
        };
        course.par_iter().enumerate().map(one).collect()
    }

    /// What this balance shows of it.
    pub fn weighed(&self, poured: &[Vec<f64>], balance: Balance, seed: u64) -> Vec<Spoonful> {
        let mut course = self.course(balance);
        for (k, (spoonful, poured)) in course.iter_mut().zip(poured).enumerate() {
            let mut rng = Pcg64::seed_from_u64(derive(seed, &[k as u64, 1]));
            let mut shown = |mass: f64| {
                let noise = balance.noise_mg * normal::quantile(rng.random_range(1e-9..1.0));
                ((mass + noise) / balance.readability_mg).round() * balance.readability_mg
            };
            let (mut before, mut mass) = (shown(0.0), 0.0);
            for (shake, mg) in spoonful.shakes.iter_mut().zip(poured) {
                mass += mg;
                let now = shown(mass);
                shake.fell_mg = now - std::mem::replace(&mut before, now);
            }
        }
        course
    }

    /// What the weighings say of the powder.
    pub fn judged(
        &self,
        powder: &Powder,
        angle: bool,
        weighed: &[Spoonful],
        settings: &Settings,
    ) -> PowderReport {
        let angle = angle.then(|| Flowability::new(powder.angle_deg, 1.5, 5).unwrap());
        let calibrated =
            Calibrated { powder: "powder".to_owned(), sets: powder.sets.clone(), angle };
        let asked = Asked { bench: self, seed: settings.seed, seen: RefCell::default() };
        judge_spoon(weighed, &[calibrated], settings, &asked).unwrap().powders.remove(0)
    }

    /// The powder of this angle.
    pub fn powder(&self, angle_deg: f64) -> Powder {
        let grid = self.grid();
        let sets = COHESIONS.iter().map(|cohesion| grid.set(angle_deg, *cohesion)).collect();
        Powder { angle_deg, sets }
    }

    /// A truth of this angle.
    pub fn truth(&self, mechanism: Option<Mechanism>, angle_deg: f64, seed: u64) -> Truth {
        let grid = self.grid();
        let mut rng = Pcg64::seed_from_u64(derive(seed, &[0x7207]));
        let set = grid.set(angle_deg, rng.random_range(0.0..COHESIONS[2]));
        let hidden = mechanism.map(|mechanism| Hidden::of(mechanism, seed));
        let truth = Truth { hidden, set, off_deg: 0.0 };
        match mechanism {
            Some(mechanism) if is_of_heaps(mechanism) => self.standing(truth, angle_deg),
            _ => truth,
        }
    }

    /// The same with the friction that keeps the angle, and less of the mechanism where friction
    /// cannot.
    fn standing(&self, truth: Truth, angle_deg: f64) -> Truth {
        let Truth { hidden: Some(mut hidden), mut set, .. } = truth else { return truth };
        let mut nearest = truth;
        let mut least = f64::INFINITY;
        for _ in 0..ROUNDS {
            let Some(angle) = self.angle_deg(&set, &hidden.grains()) else { break };
            let off_deg = angle - angle_deg;
            if off_deg.abs() < least {
                least = off_deg.abs();
                nearest = Truth { hidden: Some(hidden), set, off_deg };
            }
            if least <= STANDS_DEG {
                break;
            }
            let wanted = set.friction() - off_deg / SLOPE_DEG;
            set = set.with("friction", wanted.clamp(0.0, 1.3)).unwrap();
            if !(0.0..=1.3).contains(&wanted) || hidden.grains().powder(&set).friction() == 0.0 {
                hidden.size *= 0.7;
            }
        }
        nearest
    }

    /// Mean angle of heaps.
    fn angle_deg(&self, set: &ParameterSet, patch: &Patch) -> Option<f64> {
        let heap = SpoonHeap { set: *set, patch: patch.clone(), seed: 0 };
        let asked = Asked { bench: self, seed: 0, seen: RefCell::default() };
        let heaps = asked.heaps(&vec![heap; HEAPS as usize]);
        let all: Vec<f64> = heaps.into_iter().flatten().collect();
        flip_core::stats::summary::mean(&all)
    }

    fn grid(&self) -> Grid {
        let set = |friction: f64, cohesion: f64| of(friction, cohesion);
        let angles_deg = COHESIONS.map(|cohesion| {
            FRICTIONS.map(|friction| {
                self.angle_deg(&set(friction, cohesion), &Patch::default()).unwrap_or(50.0)
            })
        });
        Grid { angles_deg }
    }

    /// Answers that were kept, and the others, which are computed and kept.
    fn answers<T: Clone>(
        &self,
        asked: &[(String, T)],
        compute: impl Fn(&[(String, T)]) -> Vec<Option<Vec<f64>>>,
    ) -> Vec<Option<Vec<f64>>> {
        let mut kept = self.kept.lock().unwrap();
        let mut missing: Vec<(String, T)> =
            asked.iter().filter(|it| !kept.contains_key(&it.0)).cloned().collect();
        missing.sort_by(|a, b| a.0.cmp(&b.0));
        missing.dedup_by(|a, b| a.0 == b.0);
        // Some at a time: what was computed is kept if the run is stopped.
        for some in missing.chunks(20) {
            for ((key, _), mg) in some.iter().zip(compute(some)) {
                self.write(&Kept { key: key.clone(), mg: mg.clone() });
                kept.insert(key.clone(), mg);
            }
        }
        asked.iter().map(|(key, _)| kept[key].clone()).collect()
    }

    fn write(&self, kept: &Kept) {
        let Some(file) = &self.file else { return };
        let mut out = std::fs::OpenOptions::new().create(true).append(true).open(file).unwrap();
        writeln!(out, "{}", serde_json::to_string(kept).unwrap()).unwrap();
    }
}

/// Change of an angle by friction that is assumed to find a friction, deg per unit.
const SLOPE_DEG: f64 = 14.0;

/// Whether a heap knows of a mechanism.
pub fn is_of_heaps(mechanism: Mechanism) -> bool {
    let hidden = Hidden::of(mechanism, 1);
    mechanism != Mechanism::SpoonAdhesion && !hidden.grains().is_none()
}

/// A powder of the largest grains.
pub fn of(friction: f64, cohesion: f64) -> ParameterSet {
    let set = ParameterSet::default().with("particle_diameter_mm", DIAMETER_MM).unwrap();
    set.with("friction", friction).unwrap().with("cohesion", cohesion).unwrap()
}

/// Angles over friction and cohesion, deg.
struct Grid {
    angles_deg: [[f64; 4]; 3],
}

impl Grid {
    /// The set of this angle and cohesion.
    fn set(&self, angle_deg: f64, cohesion: f64) -> ParameterSet {
        // Angles grow with friction, so halving finds the one friction.
        let (mut low, mut high) = (FRICTIONS[0] - 0.3, FRICTIONS[3]);
        for _ in 0..40 {
            let middle = (low + high) / 2.0;
            if self.at(middle, cohesion) < angle_deg { low = middle } else { high = middle }
        }
        of((low + high) / 2.0, cohesion)
    }

    fn at(&self, friction: f64, cohesion: f64) -> f64 {
        let along = |grid: &[f64], x: f64| {
            let k = grid[1..grid.len() - 1].iter().filter(|edge| **edge <= x).count();
            (k, (x - grid[k]) / (grid[k + 1] - grid[k]))
        };
        let ((i, s), (j, t)) = (along(&COHESIONS, cohesion), along(&FRICTIONS, friction));
        let row = |i: usize| self.angles_deg[i][j] * (1.0 - t) + self.angles_deg[i][j + 1] * t;
        row(i) * (1.0 - s) + row(i + 1) * s
    }
}

/// The simulator for one bench: replays of its own, as far as they are as calibrated.
struct Asked<'a> {
    bench: &'a Bench,
    seed: u64,
    /// How often each experiment was asked for.
    seen: RefCell<HashMap<String, u64>>,
}

impl Asked<'_> {
    /// The experiment's name, with its number among those alike.
    fn key(&self, name: String, is_plain: bool) -> String {
        let mut seen = self.seen.borrow_mut();
        let nth = seen.entry(name.clone()).or_default();
        let first = derive(self.seed, &[index_of(&name)]) % STOCK;
        let own = if is_plain && *nth < STOCK { (first + *nth) % STOCK } else { *nth };
        *nth += 1;
        format!("{name} {own}")
    }

    fn spoons<'a>(&'a self, spoonfuls: &'a [Spoonful]) -> Spoons<'a> {
        let Bench { replays, heaps, .. } = self.bench;
        Spoons { replays, heaps, settings: self.bench.spoon(), spoonfuls }
    }
}

impl Simulator for Asked<'_> {
    fn pour(&self, replays: &[SpoonReplay]) -> Vec<Option<Vec<f64>>> {
        let course = self.bench.course(BALANCES[0]);
        let named = |of: &SpoonReplay| {
            let change = serde_json::to_string(&of.change).unwrap();
            let is_plain = of.change == flip_discover::spoon::Change::default();
            // Spoonfuls of one stroke are one experiment.
            let stroke = course[of.spoonful].shakes[0].shake_mm;
            let key = self.key(format!("spoon {} {stroke} {change}", of.set.id()), is_plain);
            (key.clone(), SpoonReplay { seed: index_of(&key), ..of.clone() })
        };
        let asked: Vec<(String, SpoonReplay)> = replays.iter().map(named).collect();
        let compute = |some: &[(String, SpoonReplay)]| {
            let all: Vec<SpoonReplay> = some.iter().map(|it| it.1.clone()).collect();
            self.spoons(&course).pour(&all)
        };
        self.bench.answers(&asked, compute)
    }

    fn heaps(&self, heaps: &[SpoonHeap]) -> Vec<Option<f64>> {
        let named = |of: &SpoonHeap| {
            let patch = serde_json::to_string(&of.patch).unwrap();
            let key = self.key(format!("heap {} {patch}", of.set.id()), false);
            (key.clone(), SpoonHeap { seed: index_of(&key), ..of.clone() })
        };
        let asked: Vec<(String, SpoonHeap)> = heaps.iter().map(named).collect();
        let compute = |some: &[(String, SpoonHeap)]| {
            let all: Vec<SpoonHeap> = some.iter().map(|it| it.1.clone()).collect();
            self.spoons(&[]).heaps(&all).into_iter().map(|deg| deg.map(|deg| vec![deg])).collect()
        };
        let answers = self.bench.answers(&asked, compute);
        answers.into_iter().map(|it| it.map(|one| one[0])).collect()
    }
}
