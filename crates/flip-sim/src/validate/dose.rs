//! Does what a spoon gives depend on the substep? Heaps do not (`heap`); spoons that hardly flow
//! do.
//!
//! ```text
//! course   a full spoon; near the onset two strokes of 4 mm, two of 8 mm; the same STEEPER deg on
//! m_h      what two strokes drop into the vial at substep h, mg
//! d_h      m_h - m_finest of the same seed; its mean has a 95 % interval by Student's t
//! goal     SHARE of mean m_finest or LEAST_MG, whichever is larger
//! ```
//!
//! The onset is the pitch at which a 4 mm stroke of a full spoon gives 0.5 mg at the usual substep,
//! in steps of 4 deg (`flip observe shake_mass:pitch_deg=8,shake_mm=4 --friction 0.2`). The finest
//! substep is a quarter of the usual one. It is not the limit: where a dose depends most on the
//! substep, it falls from 8.7 to 7.2 to 5.9 mg.

use super::super::dispense::{Dispenser, Settings};
use super::super::law::SUBSTEP_S;
use super::super::scene::Mean;
use super::engine::On;
use super::{Check, Experiment, Suite};
use flip_core::domain::bench::Action;
use serde::Serialize;

pub(super) const EXPERIMENTS: &[Experiment] = &[
    Experiment { name: "dose_free_flowing", checks: FREE_FLOWING.checks, run: free_flowing },
    Experiment { name: "dose_frictional", checks: FRICTIONAL.checks, run: frictional },
];

/// A powder and its course.
struct Course {
    friction: f64,
    onset_deg: f64,
    /// Names of the checks: 4 and 8 mm near the onset, 4 and 8 mm at the steeper pitch.
    checks: &'static [&'static str; PROBES],
}

const FREE_FLOWING: Course = Course {
    friction: 0.2,
    onset_deg: 8.0,
    checks: &[
        "dose_free_flowing_4mm",
        "dose_free_flowing_8mm",
        "dose_free_flowing_steeper_4mm",
        "dose_free_flowing_steeper_8mm",
    ],
};
const FRICTIONAL: Course = Course {
    friction: 0.6,
    onset_deg: 16.0,
    checks: &[
        "dose_frictional_4mm",
        "dose_frictional_8mm",
        "dose_frictional_steeper_4mm",
        "dose_frictional_steeper_8mm",
    ],
};

/// Probes of a course.
const PROBES: usize = 4;
/// Strokes of a probe.
const STROKES: usize = 2;
/// From the onset to the steeper pitch, degrees.
const STEEPER_DEG: f64 = 16.0;
/// Usual, half and finest substep, s.
const SUBSTEPS_S: [f64; 3] = [SUBSTEP_S, SUBSTEP_S / 2.0, SUBSTEP_S / 4.0];
/// Spoons at each substep.
const SEEDS: u64 = 8;
/// Student's t for 95 % and one degree of freedom less than there are spoons.
const STUDENT: f64 = 2.365;
/// Largest difference from the finest substep, as a share of what falls there.
const SHARE: f64 = 0.03;
/// Smallest goal, mg.
const LEAST_MG: f64 = 0.1;

/// What one probe gave at each substep.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Convergence {
    /// Spoons at each substep; the same seeds at all of them.
    pub spoons: u64,
    /// Mass at each substep, the coarsest first.
    pub substeps: Vec<Level>,
    /// Each substep but the finest, compared with the finest.
    pub differences: Vec<Difference>,
    /// Largest difference allowed, mg: 3 % of what falls at the finest substep, at least 0.1 mg.
    pub goal_mg: f64,
}

/// Mass at one substep.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Level {
    /// Substep, us.
    pub substep_us: u32,
    /// Mean mass in the vial, mg.
    pub mean_mg: f64,
    /// Its standard error, mg.
    pub error_mg: f64,
}

/// Mass at one substep less that at the finest.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Difference {
    /// Substep, us.
    pub substep_us: u32,
    /// Mean over the seeds, mg.
    pub mean_mg: f64,
    /// Its 95 % interval, mg.
    pub interval_mg: [f64; 2],
    /// Is it within the goal?
    pub verdict: Verdict,
}

/// Whether a difference is within the goal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// All of its interval is.
    Met,
    /// None of its interval is.
    Missed,
    /// Part of its interval is; or there is no number.
    Undecided,
}

fn free_flowing(suite: &Suite) -> Vec<Check> {
    FREE_FLOWING.probed(suite)
}

fn frictional(suite: &Suite) -> Vec<Check> {
    FRICTIONAL.probed(suite)
}

impl Course {
    fn probed(&self, suite: &Suite) -> Vec<Check> {
        let spoons = |substep_s: f64| -> Vec<[f64; PROBES]> {
            (1..=SEEDS).map(|seed| self.run(suite, substep_s, seed)).collect()
        };
        let doses = match &suite.on {
            None => SUBSTEPS_S.map(spoons),
            Some(on) => self.run_on(suite, on),
        };
        let probe = |k: usize| {
            let of = doses.each_ref().map(|level| level.iter().map(|spoon| spoon[k]).collect());
            let check = check(self.checks[k], Convergence::of(&of));
            if suite.on.is_some() { check.on_an_engine() } else { check }
        };
        (0..PROBES).map(probe).collect()
    }

    /// A spoon without powder.
    fn empty(&self, suite: &Suite, substep_s: f64) -> Dispenser {
        let settings = Settings { substep_s, extensions: suite.extensions, ..Settings::default() };
        let powder = suite.powder(&[("friction", self.friction)]);
        Dispenser::empty(&powder, &settings).revised(suite.revise)
    }

    /// The strokes of all probes, in order.
    fn strokes(&self) -> [Action; PROBES * STROKES] {
        let courses = [(self.onset_deg, 4.0), (0.0, 8.0), (STEEPER_DEG, 4.0), (0.0, 8.0)];
        std::array::from_fn(|n| {
            let (incline_deg, shake_mm) = courses[n / STROKES];
            Action::once(if n % STROKES == 0 { incline_deg } else { 0.0 }, shake_mm)
        })
    }

    /// What each probe drops into the vial, mg; NaN if the solver diverged.
    fn run(&self, suite: &Suite, substep_s: f64, seed: u64) -> [f64; PROBES] {
        let mut spoon = self.empty(suite, substep_s).filled(seed);
        let given = self.strokes().map(|stroke| spoon.step(stroke).vial_mg);
        if spoon.fault().is_some() { [f64::NAN; PROBES] } else { by_probe(&given) }
    }

    /// The same of all spoons side by side, by substep.
    fn run_on(&self, suite: &Suite, on: &On) -> [Vec<[f64; PROBES]>; 3] {
        let empty = SUBSTEPS_S.map(|substep_s| self.empty(suite, substep_s));
        let loose = |spoon: &Dispenser, seed| {
            let mut spoon = spoon.clone();
            spoon.pour(seed);
            spoon
        };
        let spoons: Vec<Dispenser> = empty
            .iter()
            .flat_map(|spoon| (1..=SEEDS).map(move |seed| loose(spoon, seed)))
            .collect();
        let given = on.doses(&spoons, &self.strokes());
        let probes = |given: &Option<Vec<f64>>| {
            given.as_ref().map_or([f64::NAN; PROBES], |given| by_probe(given))
        };
        std::array::from_fn(|level| {
            let first = level * SEEDS as usize;
            given[first..first + SEEDS as usize].iter().map(probes).collect()
        })
    }
}

/// What each probe gave, from its strokes.
fn by_probe(given: &[f64]) -> [f64; PROBES] {
    std::array::from_fn(|k| given[k * STROKES..(k + 1) * STROKES].iter().sum())
}

impl Convergence {
    /// From the doses at each substep, each in the order of their seeds.
    fn of(doses: &[Vec<f64>; 3]) -> Self {
        let us = SUBSTEPS_S.map(|substep_s| (substep_s * 1e6).round() as u32);
        let level = |(substep_us, doses): (u32, &Vec<f64>)| {
            let Mean { mean, error } = Mean::of(doses);
            Level { substep_us, mean_mg: mean, error_mg: error }
        };
        let finest = &doses[doses.len() - 1];
        let goal_mg = (SHARE * Mean::of(finest).mean).max(LEAST_MG);
        let coarser = us.into_iter().zip(doses).take(doses.len() - 1);
        Self {
            spoons: finest.len() as u64,
            substeps: us.into_iter().zip(doses).map(level).collect(),
            differences: coarser.map(|(us, of)| Difference::of(us, of, finest, goal_mg)).collect(),
            goal_mg,
        }
    }
}

impl Difference {
    fn of(substep_us: u32, doses: &[f64], finest: &[f64], goal_mg: f64) -> Self {
        let each: Vec<f64> = doses.iter().zip(finest).map(|(dose, finest)| dose - finest).collect();
        let Mean { mean, error } = Mean::of(&each);
        let interval_mg = [mean - STUDENT * error, mean + STUDENT * error];
        let verdict = Verdict::of(interval_mg, goal_mg);
        Self { substep_us, mean_mg: mean, interval_mg, verdict }
    }

    /// The end of the interval that is farther from zero, mg.
    fn far_mg(&self) -> f64 {
        let [low, high] = self.interval_mg;
        if low.abs() > high.abs() { low } else { high }
    }
}

impl Verdict {
    fn of([low, high]: [f64; 2], goal_mg: f64) -> Self {
        if low >= -goal_mg && high <= goal_mg {
            Self::Met
        } else if low > goal_mg || high < -goal_mg {
            Self::Missed
        } else {
            Self::Undecided
        }
    }
}

/// The check of the usual substep: it passes if all of the interval is within the goal.
fn check(name: &'static str, convergence: Convergence) -> Check {
    let (far_mg, goal_mg) = (convergence.differences[0].far_mg(), convergence.goal_mg);
    let source = "a dose converges in the substep: far end of the 95 % interval of the difference from a quarter of it, within 3 % or 0.1 mg";
    let check = Check::near(name, far_mg, [0.0, goal_mg], "mg", source);
    Check { convergence: Some(convergence), ..check }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Doses that scatter by one at each substep, alike in all.
    fn doses(means: [f64; 3]) -> [Vec<f64>; 3] {
        means.map(|mean| (0..SEEDS).map(|k| mean + if k % 2 == 0 { 1.0 } else { -1.0 }).collect())
    }

    #[test]
    fn a_difference_is_within_the_goal_beyond_it_or_not_known_by_its_interval() {
        let of = |means: [f64; 3]| Convergence::of(&doses(means));
        let found = of([11.0, 10.2, 10.0]);
        assert_eq!(found.substeps.iter().map(|it| it.substep_us).collect::<Vec<_>>(), [80, 40, 20]);
        assert!((found.substeps[0].error_mg - (8.0f64 / 7.0 / 8.0).sqrt()).abs() < 1e-12);
        // Spoons of one seed scatter alike, so that their difference is exact.
        let verdicts: Vec<Verdict> = found.differences.iter().map(|it| it.verdict).collect();
        assert_eq!((found.goal_mg, verdicts), (0.3, vec![Verdict::Missed, Verdict::Met]));
        assert_eq!(of([1.0, 1.0, 1.0]).goal_mg, 0.1, "3 % of a milligram is nothing to weigh by");
        assert_eq!(Verdict::of([-0.1, 0.4], 0.3), Verdict::Undecided);
        assert_eq!(Verdict::of([f64::NAN, 0.1], 0.3), Verdict::Undecided);
    }

    #[test]
    fn the_interval_of_a_difference_has_students_width() {
        let finest = vec![0.0; 8];
        let found = Difference::of(80, &[1.0, 3.0, 1.0, 3.0, 1.0, 3.0, 1.0, 3.0], &finest, 0.1);
        // SD sqrt(8/7), standard error sqrt(1/7), t 2.365 for seven degrees of freedom.
        let half = 2.365 / 7.0f64.sqrt();
        assert!((found.interval_mg[0] - (2.0 - half)).abs() < 1e-12, "{found:?}");
        assert!((found.far_mg() - (2.0 + half)).abs() < 1e-12);
    }

    #[test]
    fn a_check_passes_if_all_of_the_interval_is_within_the_goal() {
        let of = |means| check("free_fall", Convergence::of(&doses(means)));
        assert!(of([10.2, 10.0, 10.0]).passed);
        let missed = of([9.0, 10.0, 10.0]);
        assert!(!missed.passed && !missed.is_accounted_for());
        assert!((missed.measured + 1.0).abs() < 1e-12 && (missed.miss() - 0.7).abs() < 1e-12);
        assert!(!of([f64::NAN, 10.0, 10.0]).is_accounted_for());
    }
}
