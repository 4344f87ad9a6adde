//! The angle of repose as a property of the powder, and heaps at rest.

use super::super::batch::heaps::Wanted;
use super::super::law::{BOND_PER_COHESION, DIAMETER_REFERENCE_MM, SUBSTEP_S};
use super::super::repose::{Repose, Settings};
use super::super::scene::Mean;
use super::{Check, Experiment, Suite};
use flip_core::domain::parameters::ParameterSet;

pub(super) const EXPERIMENTS: &[Experiment] = &[
    Experiment { name: "repose_size", checks: &["repose_size"], run: size },
    Experiment {
        name: "repose_substep",
        checks: &["repose_substep", "repose_substep_error"],
        run: substep,
    },
    Experiment {
        name: "repose_funnel",
        checks: &["repose_funnel", "repose_funnel_scatter"],
        run: funnel,
    },
    Experiment {
        name: "repose_friction",
        checks: &["repose_friction", "repose_friction_rise"],
        run: friction,
    },
    Experiment {
        name: "repose_cohesion",
        checks: &["repose_cohesion", "repose_cohesion_rise"],
        run: cohesion,
    },
    Experiment {
        name: "repose_base_friction",
        checks: &["repose_base_friction"],
        run: base_friction,
    },
    Experiment {
        name: "rest_free_flowing",
        checks: &["rest_creep", "rest_speed", "rest_overlap_mean", "rest_overlap_max"],
        run: rest_free_flowing,
    },
    Experiment {
        name: "rest_cohesive",
        checks: &["rest_cohesive_creep", "rest_cohesive_speed"],
        run: rest_cohesive,
    },
];

/// Two means count as different if they differ by more than this many standard errors of the
/// difference.
const SIGNIFICANT: f64 = 2.0;
/// Source of the requirements on every heap.
const ZHOU: &str =
    "Zhou et al. 2001, Phys. Rev. E 64, 021301: friction decides, within two standard errors";

/// Heaps that differ only by their seed; none for those without an angle.
fn heaps(
    suite: &Suite,
    powder: &ParameterSet,
    settings: &Settings,
    seeds: u64,
) -> Vec<Option<Repose>> {
    match &suite.on {
        None => (1..=seeds).map(|seed| suite.heap(powder, settings, seed).ok()).collect(),
        Some(on) => {
            let settings = Settings { extensions: suite.extensions, ..*settings };
            let wanted = |seed| Wanted { set: *powder, settings, seed };
            on.heaps(&(1..=seeds).map(wanted).collect::<Vec<_>>())
        }
    }
}

/// Mean tip angle.
pub(super) fn angle(suite: &Suite, powder: &ParameterSet, settings: &Settings, seeds: u64) -> Mean {
    let tip = |heap: Option<Repose>| heap.map_or(f64::NAN, |heap| heap.tip_deg);
    Mean::of(&heaps(suite, powder, settings, seeds).into_iter().map(tip).collect::<Vec<_>>())
}

/// The larger of two numbers, NaN if either is.
fn worse(a: f64, b: f64) -> f64 {
    if a.is_nan() || b.is_nan() { f64::NAN } else { a.max(b) }
}

/// Largest decrease from one mean to the next, in standard errors; zero if all rise.
fn fall(means: &[Mean]) -> f64 {
    means.windows(2).fold(0.0, |worst, pair| worse(worst, pair[0].above(&pair[1])))
}

/// Checks that means never decrease, and that the whole rise is at least three standard errors, so
/// that no change at all does not pass.
fn monotone([never_less, rise]: [&'static str; 2], means: &[Mean]) -> Vec<Check> {
    let (first, last) = (&means[0], &means[means.len() - 1]);
    let (whole, rise_min) = (last.mean - first.mean, 3.0 * last.error.hypot(first.error));
    vec![
        Check::within(never_less, fall(means), [0.0, SIGNIFICANT], "errors", ZHOU),
        Check::within(rise, whole, [rise_min, 90.0], "deg", ZHOU),
    ]
}

fn over(suite: &Suite, key: &str, values: &[f64]) -> Vec<Mean> {
    let settings = Settings::with_particles(1000);
    values.iter().map(|value| angle(suite, &suite.powder(&[(key, *value)]), &settings, 5)).collect()
}

fn friction(suite: &Suite) -> Vec<Check> {
    let means = over(suite, "friction", &[0.0, 0.4, 0.8, 1.3]);
    monotone(["repose_friction", "repose_friction_rise"], &means)
}

fn cohesion(suite: &Suite) -> Vec<Check> {
    let means = over(suite, "cohesion", &[0.0, 0.4, 0.8, 1.2]);
    monotone(["repose_cohesion", "repose_cohesion_rise"], &means)
}

fn base_friction(suite: &Suite) -> Vec<Check> {
    let rough = |base_friction: f64| {
        let settings = Settings { base_friction, ..Settings::with_particles(1000) };
        angle(suite, &suite.powder, &settings, 5)
    };
    let means: Vec<Mean> = [0.2, 0.4, 0.8, 1.2].map(rough).to_vec();
    vec![Check::within("repose_base_friction", fall(&means), [0.0, SIGNIFICANT], "errors", ZHOU)]
}

/// Largest difference between mean angles with its standard error, degrees.
fn difference(means: &[Mean]) -> [f64; 2] {
    let mut largest = [0.0f64; 2];
    for (i, a) in means.iter().enumerate() {
        for b in &means[..i] {
            let [degrees, error] = [(a.mean - b.mean).abs(), a.error.hypot(b.error)];
            if degrees.is_nan() || degrees > largest[0] {
                largest = [degrees, error];
            }
        }
    }
    largest
}

/// Does the angle depend on the drop height? Checked on the means of many heaps, and, from their
/// scatter, whether two heaps could show a difference.
fn funnel(suite: &Suite) -> Vec<Check> {
    const HEAPS: u64 = 48;
    let at = |clearance: f64| {
        let settings = Settings { funnel_clearance_diameters: clearance, ..Settings::default() };
        angle(suite, &suite.powder, &settings, HEAPS)
    };
    let means = [2.0, 3.0, 5.0].map(at);
    let [degrees, error] = difference(&means);
    // The standard error of a mean of n is the scatter of one heap over the root of n.
    let scatter = means.iter().map(|mean| mean.error * mean.error * HEAPS as f64).sum::<f64>()
        / means.len() as f64;
    let source = "an angle of repose belongs to the powder, within two standard errors";
    let one = "an angle of repose belongs to the powder, within the scatter of one heap";
    vec![
        Check::near("repose_funnel", degrees, [0.0, SIGNIFICANT * error], "deg", source),
        Check::near("repose_funnel_scatter", degrees, [0.0, scatter.sqrt()], "deg", one),
    ]
}

fn size(suite: &Suite) -> Vec<Check> {
    let of = |particles: u32, seeds: u64| {
        angle(suite, &suite.powder, &Settings::with_particles(particles), seeds)
    };
    // Enough heaps for a standard error of about 0.2 deg each.
    let means = [of(2000, 32), of(4000, 16), of(8000, 10)];
    let [degrees, _] = difference(&means);
    vec![Check::near(
        "repose_size",
        degrees,
        [0.0, 1.5],
        "deg",
        "an angle of repose belongs to the powder",
    )]
}

fn substep(suite: &Suite) -> Vec<Check> {
    let of = |substep_s: f64| {
        angle(suite, &suite.powder, &Settings { substep_s, ..Settings::default() }, 12)
    };
    let (whole, half) = (of(SUBSTEP_S), of(0.5 * SUBSTEP_S));
    let source = "converged in the substep: half of it, mean of 12 heaps each";
    vec![
        Check::near("repose_substep", half.mean - whole.mean, [0.0, 1.0], "deg", source),
        Check::within(
            "repose_substep_error",
            whole.error.hypot(half.error),
            [0.0, 0.5],
            "deg",
            "its standard error",
        ),
    ]
}

/// The worst of a few heaps by one criterion.
fn worst(heaps: &[Option<Repose>], of: fn(&Repose) -> f64) -> f64 {
    heaps.iter().fold(0.0, |most, heap| worse(most, heap.as_ref().map_or(f64::NAN, of)))
}

const CREEP: fn(&Repose) -> f64 = |heap| heap.creep_deg_per_s.abs();
const SPEED: fn(&Repose) -> f64 = |heap| heap.speed_rms_mm_s;
const REST: &str = "a heap at rest stays at rest; worst of three";

fn rest_free_flowing(suite: &Suite) -> Vec<Check> {
    let heaps = heaps(suite, &suite.powder, &Settings::default(), 3);
    let hard = "grains are hard; worst of three";
    vec![
        Check::within("rest_creep", worst(&heaps, CREEP), [0.0, 0.02], "deg/s", REST),
        Check::within("rest_speed", worst(&heaps, SPEED), [0.0, 0.05], "mm/s", REST),
        Check::within(
            "rest_overlap_mean",
            worst(&heaps, |heap| 100.0 * heap.overlap_mean),
            [0.0, 0.5],
            "% of d",
            hard,
        ),
        Check::within(
            "rest_overlap_max",
            worst(&heaps, |heap| 100.0 * heap.overlap_max),
            [0.0, 5.0],
            "% of d",
            hard,
        ),
    ]
}

/// At bond number 2: the strongest cohesion between the smallest grains, under the gravity that
/// yields it.
fn rest_cohesive(suite: &Suite) -> Vec<Check> {
    let (cohesion, diameter, bond) = (1.2, 0.22, 2.0);
    let gravity_scale =
        BOND_PER_COHESION * cohesion * (DIAMETER_REFERENCE_MM / diameter).powi(2) / bond;
    let powder = suite.powder(&[
        ("cohesion", cohesion),
        ("particle_diameter_mm", diameter),
        ("gravity_scale", gravity_scale),
    ]);
    let heaps = heaps(suite, &powder, &Settings::default(), 3);
    vec![
        Check::within("rest_cohesive_creep", worst(&heaps, CREEP), [0.0, 0.1], "deg/s", REST),
        Check::within("rest_cohesive_speed", worst(&heaps, SPEED), [0.0, 0.3], "mm/s", REST),
    ]
}
