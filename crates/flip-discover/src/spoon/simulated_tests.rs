//! Weighings of FLIP's own spoon, judged by replays of it: the mechanisms themselves, with few
//! grains in a small spoon.

use super::super::*;
use super::BALANCE_SD_MG;
use crate::report::Verdict;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::shake::Shake;
use flip_core::stats::normal;
use flip_sim::dispense;
use flip_sim::replay::{Replay, replay};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use rayon::prelude::*;
use std::collections::HashMap;
use std::sync::Mutex;

/// How large the experiment is.
#[derive(Clone, Copy)]
struct Size {
    grains: u32,
    steps: usize,
    spoonfuls: u64,
}

const SMALL: Size = Size { grains: 200, steps: 6, spoonfuls: 3 };

impl Size {
    /// A spoon that these grains fill as 2500 fill the usual one.
    fn spoon(self) -> dispense::Settings {
        let scale = libm::cbrt(f64::from(self.grains) / 2500.0);
        let usual = dispense::Settings::default();
        let semi_axes_mm = usual.semi_axes_mm.map(|mm| mm * scale);
        dispense::Settings { particles: self.grains, semi_axes_mm, ..usual }
    }

    /// Tips from 8 to 50 deg, with strokes of 4 and 8 mm in turn.
    fn spoonful(self, k: u64) -> Spoonful {
        let pitch = |step: usize| 8.0 + 42.0 * step as f64 / (self.steps - 1) as f64;
        let shake = |step: usize| Shake {
            pitch_deg: pitch(step),
            shake_mm: if step.is_multiple_of(2) { 4.0 } else { 8.0 },
            strokes: 1,
            acceleration_m_s2: None,
            spoon_mg: None,
            fell_mg: 0.0,
            sd_mg: BALANCE_SD_MG,
            since_filled_s: None,
        };
        Spoonful {
            weighing: format!("w{k}"),
            spoonful: 1,
            powder: "salt".to_owned(),
            lot: None,
            session: None,
            readability_mg: Some(0.1),
            shakes: (0..self.steps).map(shake).collect(),
        }
    }

    fn unweighed(self) -> Vec<Spoonful> {
        (0..self.spoonfuls).map(|k| self.spoonful(k)).collect()
    }
}

/// FLIP's spoon and, since no angle is given, no heaps. What was replayed is kept: many campaigns
/// are judged by the same replays.
struct Real {
    size: Size,
    spoonfuls: Vec<Spoonful>,
    kept: Mutex<HashMap<String, Option<Vec<f64>>>>,
}

impl Real {
    fn new(size: Size) -> Self {
        Self { size, spoonfuls: size.unweighed(), kept: Mutex::default() }
    }

    fn fell(&self, of: &SpoonReplay) -> Option<Vec<f64>> {
        let key = format!("{of:?}");
        if let Some(known) = self.kept.lock().unwrap().get(&key) {
            return known.clone();
        }
        let usual = self.size.spoon();
        let settings = dispense::Settings {
            friction: usual.friction + of.change.spoon_friction,
            extensions: usual.extensions.patched(&of.change.patch).unwrap(),
            particles: (f64::from(usual.particles) * of.change.fill) as u32,
            ..usual
        };
        let set = of.change.patch.powder(&of.set);
        let mut job = Replay::of(&set, &settings, &self.spoonfuls[of.spoonful], of.seed);
        job.steps.iter_mut().for_each(|step| step.shake_mm *= of.change.stroke);
        let fell = replay(&job).ok().map(|it| it.fell_mg);
        self.kept.lock().unwrap().insert(key, fell.clone());
        fell
    }

    /// Weighings of a bench with this change, on a balance of 0.1 mg.
    fn weighed(&self, set: &ParameterSet, change: &Change, seed: u64) -> Vec<Spoonful> {
        let of = |k: usize| SpoonReplay {
            set: *set,
            spoonful: k,
            change: change.clone(),
            seed: derive(seed, &[k as u64]),
        };
        let all: Vec<_> = (0..self.spoonfuls.len()).map(of).collect();
        let fell = self.pour(&all);
        let mut weighed = self.spoonfuls.clone();
        for (k, (spoonful, fell)) in weighed.iter_mut().zip(fell).enumerate() {
            let mut rng = Pcg64::seed_from_u64(derive(seed, &[k as u64, 1]));
            let (mut shown, mut mass) = (0.0, 0.0);
            for (shake, mg) in spoonful.shakes.iter_mut().zip(fell.unwrap()) {
                mass += mg;
                let noise = 0.03 * normal::quantile(rng.random_range(1e-9..1.0));
                let now = ((mass + noise) / 0.1).round() * 0.1;
                shake.fell_mg = now - shown;
                shown = now;
            }
        }
        weighed
    }
}

impl Simulator for Real {
    fn pour(&self, replays: &[SpoonReplay]) -> Vec<Option<Vec<f64>>> {
        replays.par_iter().map(|of| self.fell(of)).collect()
    }

    fn heaps(&self, heaps: &[SpoonHeap]) -> Vec<Option<f64>> {
        vec![None; heaps.len()]
    }
}

fn sets() -> Vec<ParameterSet> {
    let set = |friction, cohesion| {
        let set = ParameterSet::default().with("friction", friction).unwrap();
        set.with("cohesion", cohesion).unwrap()
    };
    vec![set(0.6, 0.0), set(0.4, 0.4)]
}

fn judged(real: &Real, weighed: &[Spoonful], causes: &[SpoonCause]) -> PowderReport {
    let salt = Calibrated { powder: "salt".to_owned(), sets: sets(), angle: None };
    let settings = Settings {
        causes: causes.to_vec(),
        replays: 4000,
        campaigns: 39,
        spoonful_sd: 0.0,
        day_sd: 0.0,
        ..Settings::default()
    };
    judge_spoon(weighed, &[salt], &settings, real).unwrap().powders.remove(0)
}

#[test]
fn the_simulated_spoon_departs_from_itself_no_more_than_by_chance_and_a_sticky_one_departs() {
    let real = Real::new(SMALL);
    let causes = [SpoonCause::SpoonAdhesion, SpoonCause::Actuator];
    let p = |seed: u64| {
        let set = sets()[(seed % 2) as usize];
        judged(&real, &real.weighed(&set, &Change::default(), 100 + seed), &causes).p_value
    };
    let plain: Vec<f64> = (0..8).map(p).collect();
    println!("plain {plain:?}");
    // Of eight with a chance of 5 % each, four are found once in three thousand times.
    assert!(plain.iter().filter(|p| **p <= 0.05).count() <= 3, "{plain:?}");
    let sticky = SpoonCause::SpoonAdhesion.change(6.0);
    let found = judged(&real, &real.weighed(&sets()[0], &sticky, 1), &causes);
    println!("{}", found.sentence);
    let first = &found.causes[0];
    assert!(
        found.p_value <= 0.05 && found.verdict != Verdict::NoDiscrepancy,
        "{} {:?}",
        found.p_value,
        found.verdict
    );
    assert!(first.cause == SpoonCause::SpoonAdhesion && first.effect_mg < 0.0, "{first:?}");
}
