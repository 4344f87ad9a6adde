//! Exact laws of one and two grains.

use super::super::constraints::{Vector, dot, vector};
use super::super::grains::Grains;
use super::super::law::{BOND_PER_COHESION, GRAVITY, Law};
use super::super::repose::Settings;
use super::super::scene::{advance, at_rest, down, leaning, threshold};
use super::super::walls::{Plate, Shape};
use super::{Check, Experiment, SMOOTH, Suite};
use flip_core::domain::seed::derive;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

pub(super) const EXPERIMENTS: &[Experiment] = &[
    Experiment { name: "free_fall", checks: &["free_fall"], run: free_fall },
    Experiment { name: "inelastic_drop", checks: &["inelastic_drop"], run: inelastic_drop },
    Experiment { name: "pair_momentum", checks: &["pair_momentum"], run: pair_momentum },
    Experiment {
        name: "incline",
        checks: &["incline_threshold", "incline_acceleration"],
        run: incline,
    },
    Experiment { name: "tetrahedron", checks: &["tetrahedron_escape"], run: tetrahedron },
    Experiment { name: "pendant_pair", checks: &["pendant_pair"], run: pendant_pair },
    Experiment { name: "mass_invariance", checks: &["mass_invariance"], run: mass_invariance },
];

/// Free fall from rest over 0.1 s. Semi-implicit steps of length h fall g t h / 2 further than g
/// t^2 / 2.
fn free_fall(suite: &Suite) -> Vec<Check> {
    let law = suite.law(SMOOTH);
    let mut one = at_rest(&law, [[0.0; 4]]);
    let steps = law.substeps(0.1);
    advance(&mut one, &law, down(&law), &Shape::Nowhere, steps);
    let (h, t) = (law.substep_s, f64::from(steps) * law.substep_s);
    let expected = 0.5 * GRAVITY * t * (t + h) * 1e3;
    let fallen = -f64::from(one.centres()[0][2]) * law.diameter_m * 1e3;
    let source = "Galilei: g t (t + h) / 2 for steps of h; rounding of single precision";
    vec![Check::near("free_fall", fallen, [expected, 1e-4 * expected], "mm", source)]
}

/// Ratio of the speeds after and before the impact of a grain that falls five diameters.
fn inelastic_drop(suite: &Suite) -> Vec<Check> {
    let law = suite.law(SMOOTH);
    let mut one = at_rest(&law, [vector(0.0, 0.0, 5.5)]);
    let (mut fastest, mut rebound) = (0.0f32, 0.0f32);
    for _ in 0..law.substeps(0.2) {
        one.substep(&law, down(&law), &Shape::FLAT);
        let v = one.velocities()[0][2];
        fastest = fastest.max(-v);
        rebound = rebound.max(v);
    }
    let source = "inelastic: less than 1 % of the energy comes back, as in the published engine";
    vec![Check::within("inelastic_drop", f64::from(rebound / fastest), [0.0, 0.1], "", source)]
}

/// Largest change of momentum, relative to the sum of both momenta's magnitudes, in random oblique
/// collisions with friction.
fn pair_momentum(suite: &Suite) -> Vec<Check> {
    let law = suite.law(SMOOTH);
    let mut rng = Pcg64Mcg::seed_from_u64(derive(1, &[2]));
    let mut random = |scale: f32| scale * rng.random_range(-1.0..1.0f32);
    let (mut worst, mut collisions) = (0.0f64, 0);
    for _ in 0..64 {
        let mut pair = Grains::default();
        pair.pour(&law, [0.0; 4], vector(0.05 + random(0.02), random(0.02), random(0.02)));
        pair.pour(
            &law,
            vector(1.3, random(0.5), random(0.5)),
            vector(-0.05 + random(0.02), random(0.02), random(0.02)),
        );
        let before = momentum(&pair);
        let size: f64 = pair.velocities().iter().map(|v| f64::from(dot(*v, *v).sqrt())).sum();
        let mut met = false;
        for _ in 0..60 {
            pair.substep(&law, [0.0; 4], &Shape::Nowhere);
            met |= pair.velocities()[0][3] > 0.0;
        }
        collisions += u32::from(met);
        let after = momentum(&pair);
        let change: f64 = (0..3).map(|k| (after[k] - before[k]).powi(2)).sum();
        worst = worst.max(change.sqrt() / size);
    }
    let measured = if collisions == 64 { worst } else { f64::NAN };
    vec![Check::within(
        "pair_momentum",
        measured,
        [0.0, 1e-6],
        "",
        "Newton's third law, to single precision",
    )]
}

fn momentum(grains: &Grains) -> [f64; 3] {
    std::array::from_fn(|k| grains.velocities().iter().map(|v| f64::from(v[k])).sum())
}

/// Tilts gravity slowly to an angle, starting 2 deg below it.
fn lean(grains: &mut Grains, law: &Law, degrees: f64, wall: &Shape) {
    let steps = law.substeps(0.1);
    for step in 0..steps {
        let short = 2.0 * (1.0 - f64::from(step) / f64::from(steps));
        grains.substep(law, leaning(law, degrees - short), wall);
    }
}

/// Whether a grain on a plane slides at an angle, once the tilt has reached it.
fn slides(law: &Law, degrees: f64) -> bool {
    let mut one = at_rest(law, [vector(0.0, 0.0, 0.5)]);
    lean(&mut one, law, degrees, &Shape::FLAT);
    let before = one.centres()[0][0];
    advance(&mut one, law, leaning(law, degrees), &Shape::FLAT, law.substeps(0.2));
    one.centres()[0][0] - before > 0.1
}

/// Coulomb: slides iff tan(theta) > mu, at g (sin - mu cos).
fn incline(suite: &Suite) -> Vec<Check> {
    let law = suite.law(SMOOTH);
    let angle = threshold([10.0, 35.0], 12, |degrees| slides(&law, degrees));
    let steep = 30.0f64;
    let mut one = at_rest(&law, [vector(0.0, 0.0, 0.5)]);
    lean(&mut one, &law, steep, &Shape::FLAT);
    let before = one.velocities()[0][0];
    let steps = law.substeps(0.1);
    advance(&mut one, &law, leaning(&law, steep), &Shape::FLAT, steps);
    let gained = law.speed_m_s(one.velocities()[0][0] - before);
    let (sin, cos) = steep.to_radians().sin_cos();
    let expected = GRAVITY * (sin - SMOOTH * cos);
    let acceleration = gained / (f64::from(steps) * law.substep_s);
    let source = "Coulomb friction, coefficient 0.4";
    vec![
        Check::near("incline_threshold", angle, [SMOOTH.atan().to_degrees(), 0.2], "deg", source),
        Check::near(
            "incline_acceleration",
            acceleration,
            [expected, 0.02 * expected],
            "m/s^2",
            source,
        ),
    ]
}

/// Tilt at which a frictionless grain leaves its seat on three fixed grains through the saddle
/// between two of them.
///
/// The saddle lies 1 / (2 sqrt 3) to the side of the seat, sqrt(2/3) below it: atan of their ratio
/// is 19.47 deg. Over a sphere it would be 35.26. The lower three are glued to a plane by a contact
/// of a hundred weights; the contacts of the fourth are those between grains.
fn tetrahedron(suite: &Suite) -> Vec<Check> {
    let mut law = suite.law(SMOOTH);
    law.grain.friction = 0.0;
    law.wall.friction = 100.0;
    law.wall = law.wall.attracted(100.0 * law.gravity);
    let aside = 0.75f32.sqrt();
    // Arranged around the axis, with the saddle towards +x between the first two.
    let seat = [[aside / 3.0, 0.5], [aside / 3.0, -0.5], [-2.0 * aside / 3.0, 0.0]];
    let lower = seat.map(|[x, y]| vector(x, y, 0.5));
    let upper = vector(0.0, 0.0, 0.5 + (2.0f32 / 3.0).sqrt());
    let leaves = |degrees: f64| {
        let mut four = at_rest(&law, lower.into_iter().chain([upper]));
        lean(&mut four, &law, degrees, &Shape::FLAT);
        advance(&mut four, &law, leaning(&law, degrees), &Shape::FLAT, law.substeps(0.3));
        four.centres().iter().all(|x| x[2] < 1.0)
    };
    let source = "geometry: atan((1 / sqrt 12) / sqrt(2 / 3))";
    vec![Check::near(
        "tetrahedron_escape",
        threshold([10.0, 30.0], 10, leaves),
        [19.471, 0.2],
        "deg",
        source,
    )]
}

/// Attraction over weight at which a grain no longer falls off another that hangs from a plate.
fn pendant_pair(suite: &Suite) -> Vec<Check> {
    let gravity_scale = 0.3;
    let holds = |cohesion: f64| {
        // The upper grain must bear both: adhesion 1.2 is four weights here, and none of it acts
        // between the grains.
        let changes = [
            ("gravity_scale", gravity_scale),
            ("adhesion", 1.2),
            ("particle_adhesion_scale", 0.0),
            ("cohesion", cohesion),
        ];
        let law = suite.law_of(&suite.powder(&changes), SMOOTH);
        let plate = Shape::Plate(Plate { radius: 5.0 });
        let mut pair = at_rest(&law, [vector(0.0, 0.0, -0.5), vector(0.0, 0.0, -1.5)]);
        let steps = law.substeps(0.1);
        for step in 1..=steps {
            let share = f64::from(step) / f64::from(steps);
            pair.substep(&law, vector(0.0, 0.0, -law.gravity * share as f32), &plate);
        }
        advance(&mut pair, &law, down(&law), &plate, law.substeps(0.2));
        let lowest = pair.centres().iter().fold(0.0f32, |low, x: &Vector| low.min(x[2]));
        lowest > -1.6
    };
    let cohesion = threshold([0.3, 1.2], 10, holds);
    let bond = BOND_PER_COHESION * cohesion / gravity_scale;
    let source = "statics: attraction equals weight";
    vec![Check::near("pendant_pair", bond, [1.0, 0.02], "weights", source)]
}

/// Change of a heap's angles with heavier grains.
fn mass_invariance(suite: &Suite) -> Vec<Check> {
    let angles = |mass: f64| {
        let heap = suite.heap(
            &suite.powder(&[("particle_mass_ug", mass)]),
            &Settings::with_particles(300),
            5,
        );
        heap.map_or([f64::NAN; 2], |heap| [heap.tip_deg, heap.cone_deg])
    };
    let ([tip, cone], [heavy_tip, heavy_cone]) = (angles(13.0), angles(16.5));
    let change = (tip - heavy_tip).abs().max((cone - heavy_cone).abs());
    vec![Check::near("mass_invariance", change, [0.0, 0.0], "deg", "equal masses cancel")]
}
