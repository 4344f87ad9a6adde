//! Tuning of controllers with a few parameters: the rivals from other robots, and the shipped
//! rules, on the powders and targets of the schedule.

use super::environment::Filling;
use super::record::Level;
use super::schedule::{self, KEPT, Tuning, errors_mg, halve, mean_error_mg};
use super::spoons::Spoons;
use flip_core::domain::bench::{INCLINE_CHANGE_DEG_MAX, SHAKE_MM_MAX};
use flip_core::domain::seed::derive;
use flip_policy::{Controller, Fuzzy, Gains, Kind, Paced, Pid};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::Serialize;

/// The controller to search for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rival {
    /// [`Pid`]: six gains.
    Pid,
    /// [`Fuzzy`]: five factors.
    Fuzzy,
    /// [`Paced`], FLIP's own: fifteen.
    Paced,
}

/// A tuned rival and its search result.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TunedRival {
    /// Its parameters.
    pub kind: Kind,
    /// Mean absolute error over powders, spoons and targets of its last round, mg, with overdoses
    /// weighted as in the search. It was selected for a small value: expect more on other spoons.
    pub loss_mg: f64,
    /// Number of pours in the search.
    pub pours: u32,
    /// The controller.
    #[serde(skip)]
    pub controller: Controller,
}

impl Rival {
    /// Ranges of its factors.
    ///
    /// PID rule: P, I and D of the incline, then of the shake, 1/mg; the largest alone would
    /// respond to 10 mg with the full action. Fuzzy rules: medium missing mass in mg, some fall in
    /// mg, tilt of *far* in degrees, gentle and strong shake in mm. Paced rules: medium missing
    /// mass in mg and ratio of large to it; some fall in mg and ratio of much to it; back and on in
    /// degrees and ratio of far to on; gentle shake in mm, and positions of usual and strong
    /// between it and 16 mm; then the rules' own numbers.
    fn ranges(self) -> &'static [[f64; 2]] {
        match self {
            Self::Pid => {
                &[[0.0, 0.1], [-0.02, 0.02], [-0.1, 0.1], [0.0, 0.1], [-0.02, 0.02], [-0.1, 0.1]]
            }
            Self::Fuzzy => &[[3.0, 12.0], [0.5, 5.0], [3.0, 8.0], [0.9, 5.0], [5.5, 16.0]],
            Self::Paced => &[
                [1.5, 8.0],
                [2.0, 8.0],
                [0.05, 1.0],
                [4.0, 16.0],
                [-8.0, -2.0],
                [1.0, 5.0],
                [1.0, 2.0],
                [1.0, 3.0],
                [0.0, 0.5],
                [0.6, 1.0],
                [0.3, 1.5],
                [60.0, 240.0],
                [1.0, 8.0],
                [1.0, 2.5],
                [1.0, 10.0],
            ],
        }
    }

    /// This rival's point in the unit cube, clamped to it; none for another kind of controller.
    fn point(self, controller: &Controller) -> Option<Vec<f64>> {
        let x = match (self, controller) {
            (Self::Pid, Controller::Pid(pid)) => {
                [pid.incline, pid.shake].iter().flat_map(|g| [g.p, g.i, g.d]).collect()
            }
            (Self::Fuzzy, Controller::Fuzzy(f)) => {
                vec![f.missing_mg[1], f.fall_mg[1], f.tilt_deg[3], f.shake_mm[0], f.shake_mm[2]]
            }
            (Self::Paced, Controller::Paced(paced)) => {
                let Fuzzy { missing_mg, fall_mg, tilt_deg, shake_mm } = paced.gentle;
                let share = |mm: f64| (mm / shake_mm[0]).ln() / (SHAKE_MM_MAX / shake_mm[0]).ln();
                vec![
                    missing_mg[1],
                    missing_mg[2] / missing_mg[1],
                    fall_mg[1],
                    fall_mg[2] / fall_mg[1],
                    tilt_deg[0],
                    tilt_deg[2],
                    tilt_deg[3] / tilt_deg[2],
                    shake_mm[0],
                    share(shake_mm[1]),
                    share(shake_mm[2]),
                    paced.pace_mg,
                    paced.climb_deg,
                    paced.first_mm,
                    paced.harder,
                    paced.stuck_mm_per_mg,
                ]
            }
            _ => return None,
        };
        let unit = |(value, [low, high]): (&f64, &[f64; 2])| {
            ((value - low) / (high - low)).clamp(0.0, 1.0)
        };
        Some(x.iter().zip(self.ranges()).map(unit).collect())
    }

    /// The rival at a point of the unit cube.
    fn at(self, point: &[f64]) -> (Kind, Controller) {
        let x: Vec<f64> = self
            .ranges()
            .iter()
            .zip(point)
            .map(|([low, high], u)| low + u * (high - low))
            .collect();
        let round =
            |value: f64, digits: i32| (value * 10f64.powi(digits)).round() / 10f64.powi(digits);
        match self {
            Self::Pid => {
                let gains = |k: usize| Gains {
                    p: round(x[k], 4),
                    i: round(x[k + 1], 4),
                    d: round(x[k + 2], 4),
                };
                let pid = Pid { incline: gains(0), shake: gains(3) };
                (Kind::Pid { gains: pid }, Controller::Pid(pid))
            }
            Self::Fuzzy => {
                let [medium, some, far, gentle, strong] =
                    [x[0], x[1], x[2], x[3], x[4]].map(|value| round(value, 1));
                let half = round(far / 2.0, 2);
                let fuzzy = Fuzzy {
                    missing_mg: [1.0, medium, round(2.5 * medium, 2)],
                    fall_mg: [0.0, some, round(3.0 * some, 2)],
                    tilt_deg: [-half, 0.0, half, far],
                    shake_mm: [gentle, round((gentle * strong).sqrt(), 1), strong],
                };
                (Kind::Fuzzy { fuzzy }, Controller::Fuzzy(fuzzy))
            }
            Self::Paced => {
                let (medium, some, on, gentle) =
                    (round(x[0], 1), round(x[2], 2), round(x[5], 1), round(x[7], 1));
                let between = |share: f64| round(gentle * (SHAKE_MM_MAX / gentle).powf(share), 2);
                let far = round((x[6] * on).min(INCLINE_CHANGE_DEG_MAX), 1).max(on + 0.1);
                let paced = Paced {
                    gentle: Fuzzy {
                        missing_mg: [0.5, medium, round(x[1] * medium, 1)],
                        fall_mg: [0.0, some, round(x[3] * some, 2)],
                        tilt_deg: [round(x[4], 1), 0.0, on, far],
                        shake_mm: [gentle, between(x[8]).max(gentle + 0.01), between(x[9])],
                    },
                    pace_mg: round(x[10], 2),
                    climb_deg: round(x[11], 0),
                    first_mm: round(x[12], 1),
                    harder: round(x[13], 2),
                    stuck_mm_per_mg: round(x[14], 1),
                };
                (Kind::Paced { paced }, Controller::Paced(paced))
            }
        }
    }
}

/// Spoons of each powder for each candidate in the first round of a slow search.
const SLOW_SPOONS: u32 = 2;
/// Candidates of a slow search near previously known ones.
const AROUND_KNOWN: usize = 31;

/// Searches for the rival with the smallest mean absolute error on these powders, as
/// [`super::schedule::tune`] does for the schedule: random points and successive halving, then once
/// more around the best. Each pour serves one target, because these controllers depend on it.
///
/// # Panics
/// Without powders, parameter sets, targets or candidates.
pub fn tune<F: Filling>(
    filling: &F,
    levels: &[Level],
    tuning: &Tuning,
    rival: Rival,
) -> TunedRival {
    let (best, spoons) = search(filling, levels, tuning, rival, KEPT);
    let (loss_mg, point) = &best[0];
    let (kind, controller) = rival.at(point);
    found(kind, controller, *loss_mg, spoons, levels, tuning)
}

/// Runs [`tune`] on a fast spoon, then successive halving on a slow one among its best, the
/// previously `known` ones, and variants of those with a third of their numbers changed.
///
/// # Panics
/// Without powders, parameter sets, targets or candidates.
pub fn tune_twice<F: Filling, G: Filling>(
    fast: &F,
    slow: &G,
    levels: &[Level],
    tuning: &Tuning,
    rival: Rival,
    known: &[Controller],
) -> TunedRival {
    let (best, _) = search(fast, levels, tuning, rival, 4 * KEPT);
    let spoons = Spoons::new(slow, derive(tuning.seed, &[5]));
    let score = |of: &(Kind, Controller), doses| loss_mg(&of.1, levels, tuning, &spoons, doses);
    let mut rng = Pcg64Mcg::seed_from_u64(derive(tuning.seed, &[6]));
    let mut aside = |from: &Vec<f64>| -> Vec<f64> {
        let moved = |u: &f64| {
            if rng.random_bool(1.0 / 3.0) { u + rng.random_range(-0.15..0.15) } else { *u }
        };
        from.iter().map(moved).map(|u| u.clamp(0.0, 1.0)).collect()
    };
    let known: Vec<Vec<f64>> =
        known.iter().filter_map(|controller| rival.point(controller)).collect();
    let around: Vec<Vec<f64>> = known.iter().cycle().take(AROUND_KNOWN).map(&mut aside).collect();
    let field = known
        .iter()
        .chain(&around)
        .chain(best.iter().map(|(_, point)| point))
        .map(|p| rival.at(p))
        .collect();
    let (best, poured) = halve(field, SLOW_SPOONS, KEPT, score);
    let (loss_mg, (kind, controller)) = best.into_iter().next().expect("a field is not empty");
    found(kind, controller, loss_mg, poured, levels, tuning)
}

/// [`schedule::search`] in the unit cube of this rival.
fn search<F: Filling>(
    filling: &F,
    levels: &[Level],
    tuning: &Tuning,
    rival: Rival,
    kept: usize,
) -> (Vec<(f64, Vec<f64>)>, u32) {
    let draw = |rng: &mut Pcg64Mcg| -> Vec<f64> {
        rival.ranges().iter().map(|_| rng.random_range(0.0..1.0)).collect()
    };
    let aside = |from: &Vec<f64>, rng: &mut Pcg64Mcg| -> Vec<f64> {
        from.iter().map(|u| (u + rng.random_range(-0.15..0.15)).clamp(0.0, 1.0)).collect()
    };
    let score = |point: &Vec<f64>, spoons: &Spoons<&F>, doses| {
        loss_mg(&rival.at(point).1, levels, tuning, spoons, doses)
    };
    schedule::search(filling, levels, tuning, kept, draw, aside, score)
}

fn found(
    kind: Kind,
    controller: Controller,
    loss_mg: f64,
    spoons: u32,
    levels: &[Level],
    tuning: &Tuning,
) -> TunedRival {
    let pours = spoons * (levels.len() * tuning.targets_mg.len()) as u32;
    TunedRival { kind, loss_mg, pours, controller }
}

/// Mean absolute error of a controller on `doses` spoons of each powder, filled with a seed not
/// used in the search, mg.
pub fn assess<F: Filling>(
    filling: &F,
    levels: &[Level],
    tuning: &Tuning,
    controller: &Controller,
    doses: u32,
    seed: u64,
) -> f64 {
    loss_mg(controller, levels, &tuning.plain(), &Spoons::new(filling, derive(seed, &[4])), doses)
}

/// Mean cost of the errors over powders, spoons and targets, mg.
fn loss_mg<F: Filling>(
    controller: &Controller,
    levels: &[Level],
    tuning: &Tuning,
    spoons: &Spoons<&F>,
    doses: u32,
) -> f64 {
    mean_error_mg(levels, tuning.seed, spoons, doses, |spoon, seed| {
        let pour = |&target_mg: &f64| {
            errors_mg(controller, spoon.clone(), tuning, &[target_mg], target_mg, seed)
        };
        tuning.targets_mg.iter().flat_map(pour).collect()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::formula::Formula;
    use flip_core::domain::bench::PitchLimits;
    use flip_core::domain::parameters::ParameterSet;

    fn levels() -> Vec<Level> {
        let level = |powder: &str, friction| Level {
            powder: powder.into(),
            repose_deg: 30.0,
            sets: vec![ParameterSet::default().with("friction", friction).unwrap()],
        };
        vec![level("easy", 0.3), level("hard", 0.6)]
    }

    #[test]
    fn every_point_of_the_cube_is_a_rival_within_its_bounds() {
        for rival in [Rival::Pid, Rival::Fuzzy, Rival::Paced] {
            let size = rival.ranges().len();
            for corner in 0..1u32 << size {
                let point: Vec<f64> = (0..size).map(|k| f64::from(corner >> k & 1)).collect();
                match rival.at(&point).1 {
                    Controller::Pid(pid) => assert_eq!(pid.checked(), Ok(pid)),
                    Controller::Fuzzy(fuzzy) => assert_eq!(fuzzy.checked(), Ok(fuzzy)),
                    Controller::Paced(paced) => assert_eq!(paced.checked(), Ok(paced)),
                    other => panic!("{other:?} is no rival"),
                }
            }
        }
    }

    #[test]
    fn a_rival_is_found_again_at_its_point() {
        for (rival, known) in [
            (Rival::Pid, Controller::Pid(Pid::CHOSEN)),
            (Rival::Fuzzy, Controller::Fuzzy(Fuzzy::CHOSEN)),
            (Rival::Paced, Controller::Paced(Paced::CHOSEN)),
        ] {
            let found = rival.at(&rival.point(&known).unwrap()).1;
            let twice = rival.at(&rival.point(&found).unwrap()).1;
            assert_eq!(found, twice, "{rival:?}");
        }
        let paced = Controller::Paced(Paced::CHOSEN);
        assert_eq!(
            Rival::Paced.at(&Rival::Paced.point(&paced).unwrap()).1,
            paced,
            "the shipped rules are within the search"
        );
        assert_eq!(Rival::Pid.point(&paced), None);
    }

    #[test]
    fn a_search_finds_a_better_rival_than_chance_and_finds_it_again() {
        let formula = Formula { pitch: PitchLimits::WIDE };
        let tuning = Tuning { candidates: 32, ..Tuning::new(1) };
        for rival in [Rival::Pid, Rival::Fuzzy, Rival::Paced] {
            let tuned = tune(&formula, &levels(), &tuning, rival);
            let on_others =
                |controller: &Controller| assess(&formula, &levels(), &tuning, controller, 20, 99);
            let mut rng = Pcg64Mcg::seed_from_u64(5);
            let mut drawn =
                || rival.ranges().iter().map(|_| rng.random_range(0.0..1.0)).collect::<Vec<f64>>();
            let theirs = (0..20).map(|_| on_others(&rival.at(&drawn()).1)).sum::<f64>() / 20.0;
            let ours = on_others(&tuned.controller);
            assert!(ours < theirs, "{rival:?}: tuned {ours}, drawn {theirs}");
            assert_eq!(tune(&formula, &levels(), &tuning, rival), tuned);
            let twice = tune_twice(&formula, &formula, &levels(), &tuning, rival, &[]);
            assert!(
                on_others(&twice.controller) < theirs,
                "{rival:?}: searched twice {twice:?}, drawn {theirs}"
            );
            // A hopeless search still keeps a previously good controller.
            let (hopeless, known) =
                (Tuning { candidates: 1, ..tuning.clone() }, [tuned.controller]);
            let kept = tune_twice(&formula, &formula, &levels(), &hopeless, rival, &known);
            assert!(
                on_others(&kept.controller) < theirs,
                "{rival:?}: kept {kept:?}, drawn {theirs}"
            );
        }
    }
}
