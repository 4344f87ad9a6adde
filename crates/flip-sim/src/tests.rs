//! Each of the nine parameters has a measurable effect, and the kernel obeys the conservation laws.

use super::constraints::{Vector, dot, vector};
use super::dispense::{self, Dispenser};
use super::grains::Grains;
use super::lanes::Path;
use super::law::{self, Law, SUBSTEP_S};
use super::repose::{self, repose};
use super::walls::{Plate, Shape};
use flip_core::domain::bench::Action;
use flip_core::domain::parameters::ParameterSet;

fn sub(a: Vector, b: Vector) -> Vector {
    std::array::from_fn(|k| a[k] - b[k])
}

/// Number of substeps in a time.
fn substeps(seconds: f64) -> u32 {
    (seconds / SUBSTEP_S).round() as u32
}

fn set(changes: &[(&str, f64)]) -> ParameterSet {
    changes.iter().fold(ParameterSet::default(), |set, (key, value)| set.with(key, *value).unwrap())
}

fn law(changes: &[(&str, f64)]) -> Law {
    Law::new(&set(changes), 0.4, SUBSTEP_S)
}

fn down(law: &Law) -> Vector {
    vector(0.0, 0.0, -law.gravity)
}

fn grains(centres: &[Vector]) -> Grains {
    let mut grains = Grains::default();
    centres.iter().for_each(|x| grains.pour(&law(&[]), *x, [0.0; 4]));
    grains
}

/// Distance fallen from rest in 0.1 s, m.
fn fall_m(changes: &[(&str, f64)]) -> f64 {
    let law = law(changes);
    let mut one = grains(&[[0.0; 4]]);
    (0..substeps(0.1)).for_each(|_| one.substep(&law, down(&law), &Shape::Nowhere));
    -f64::from(one.grain(0).0[2]) * law.diameter_m
}

#[test]
fn gravity_scale_sets_how_far_a_grain_falls() {
    for scale in [0.3, 1.0, 1.1] {
        // Semi-implicit Euler falls g t h / 2 further than g t^2 / 2.
        let expected = 0.5 * scale * law::GRAVITY * 0.1 * (0.1 + SUBSTEP_S);
        assert!((fall_m(&[("gravity_scale", scale)]) / expected - 1.0).abs() < 1e-3);
    }
}

#[test]
fn damping_slows_a_fall_as_an_exponential_does() {
    // z(t) = g/c (t - (1 - exp(-c t)) / c) for drag c per second.
    let (c, t) = (1.0f64, 0.1f64);
    let expected = law::GRAVITY / c * (t - (1.0 - (-c * t).exp()) / c);
    assert!((fall_m(&[("damping", 1.0)]) / expected - 1.0).abs() < 2e-3);
    assert!(fall_m(&[("damping", 1.0)]) < 0.98 * fall_m(&[("damping", 0.0)]));
}

/// How far two grains at a gap of 0.02 diameters have approached after 8 substeps without gravity,
/// in diameters.
fn approach(changes: &[(&str, f64)], gap: f32) -> f32 {
    let law = law(changes);
    let mut pair = grains(&[[0.0; 4], vector(1.0 + gap, 0.0, 0.0)]);
    (0..8).for_each(|_| pair.substep(&law, [0.0; 4], &Shape::Nowhere));
    1.0 + gap - sub(pair.grain(1).0, pair.grain(0).0)[0]
}

#[test]
fn cohesion_pulls_grains_together_in_proportion() {
    let (half, full) = (approach(&[("cohesion", 0.3)], 0.02), approach(&[("cohesion", 0.6)], 0.02));
    assert_eq!(approach(&[("cohesion", 0.0)], 0.02), 0.0);
    assert!((full / half - 2.0).abs() < 0.1, "{full} against {half}");
}

#[test]
fn adhesion_acts_between_grains_as_its_product_with_the_particle_adhesion_scale() {
    let a = approach(&[("adhesion", 0.6), ("particle_adhesion_scale", 1.0)], 0.02);
    let b = approach(&[("adhesion", 1.2), ("particle_adhesion_scale", 0.5)], 0.02);
    assert!(a > 0.0 && (a / b - 1.0).abs() < 1e-4);
    assert_eq!(approach(&[("adhesion", 0.6), ("particle_adhesion_scale", 0.0)], 0.02), 0.0);
}

#[test]
fn the_adhesion_offset_scale_sets_the_gap_over_which_attraction_acts() {
    assert_eq!(approach(&[("cohesion", 1.0), ("adhesion_offset_scale", 0.0)], 0.07), 0.0);
    assert!(approach(&[("cohesion", 1.0), ("adhesion_offset_scale", 0.000_05)], 0.07) > 0.0);
}

/// Whether a grain placed under a plate hangs there for half a second.
fn hangs(changes: &[(&str, f64)]) -> bool {
    let law = law(changes);
    let mut one = grains(&[vector(0.0, 0.0, -0.5)]);
    (0..substeps(0.5))
        .for_each(|_| one.substep(&law, down(&law), &Shape::Plate(Plate { radius: 5.0 })));
    one.grain(0).0[2] > -0.6
}

#[test]
fn a_grain_hangs_from_a_wall_exactly_when_adhesion_exceeds_its_weight() {
    // Bo_w = adhesion (d_ref / d)^2 against gravity_scale.
    assert!(hangs(&[("adhesion", 1.05)]) && !hangs(&[("adhesion", 0.95)]));
    assert!(
        hangs(&[("adhesion", 0.55), ("gravity_scale", 0.5)])
            && !hangs(&[("adhesion", 0.45), ("gravity_scale", 0.5)])
    );
}

#[test]
fn smaller_grains_stick_more() {
    // (0.27 / 0.22)^2 = 1.51 and (0.27 / 0.32)^2 = 0.71.
    assert!(hangs(&[("adhesion", 0.7), ("particle_diameter_mm", 0.22)]));
    assert!(!hangs(&[("adhesion", 1.3), ("particle_diameter_mm", 0.32)]));
}

#[test]
fn mass_converts_counts_to_milligrams_and_does_nothing_else() {
    let settings = repose::Settings::with_particles(300);
    let heap = |mass| repose(&set(&[("particle_mass_ug", mass)]), &settings, 5).unwrap();
    assert_eq!(heap(13.0), heap(16.5));
    let spoon = dispense::Settings { particles: 200, ..Default::default() };
    let filled = |mass| Dispenser::new(&set(&[("particle_mass_ug", mass)]), &spoon, 5).spoon_mg();
    assert!((filled(13.0) - 2.6).abs() < 1e-9 && (filled(16.5) - 3.3).abs() < 1e-9);
}

#[test]
fn friction_makes_a_heap_steeper() {
    let settings = repose::Settings::with_particles(600);
    let mean = |friction| {
        (1..=4)
            .map(|seed| repose(&set(&[("friction", friction)]), &settings, seed).unwrap().tip_deg)
            .sum::<f64>()
            / 4.0
    };
    assert!(mean(1.3) > mean(0.0) + 10.0);
}

/// Speed down a wall inclined by `degrees`, 0.05 s after the tilt of a resting grain, and the
/// distance it has slid between 0.025 s and then, in diameters.
fn slide(degrees: f64) -> [f32; 2] {
    let law = law(&[]);
    let (sin, cos) = degrees.to_radians().sin_cos();
    let incline = Shape::FLAT;
    let mut one = grains(&[vector(0.0, 0.0, 0.5)]);
    (0..substeps(0.01)).for_each(|_| one.substep(&law, down(&law), &incline));
    let tilted = vector(law.gravity * sin as f32, 0.0, -law.gravity * cos as f32);
    (0..substeps(0.025)).for_each(|_| one.substep(&law, tilted, &incline));
    let half_way = one.grain(0).0[0];
    (0..substeps(0.025)).for_each(|_| one.substep(&law, tilted, &incline));
    [one.grain(0).1[0], one.grain(0).0[0] - half_way]
}

#[test]
fn a_grain_slides_down_an_incline_above_atan_mu_and_with_coulombs_acceleration() {
    // mu = 0.4 at the wall: atan 0.4 = 21.80 deg. The tilt is sudden, so the first 0.025 s are
    // skipped as transient.
    let ([_, held], [_, slid]) = (slide(21.7), slide(21.9));
    assert!(held < 0.001 && slid > 0.01, "{held} {slid}");
    let degrees = 30.0f64.to_radians();
    let acceleration = law::GRAVITY * (degrees.sin() - 0.4 * degrees.cos());
    let expected = acceleration * f64::from(substeps(0.05)) * SUBSTEP_S * SUBSTEP_S / 0.27e-3;
    let [speed, _] = slide(30.0);
    assert!((f64::from(speed) / expected - 1.0).abs() < 0.02, "{speed} against {expected}");
}

#[test]
fn a_collision_keeps_momentum() {
    let law = law(&[("cohesion", 0.5), ("friction", 1.0)]);
    let mut cluster = Grains::default();
    for (x, v) in [
        ([0.0, 0.0, 0.0], 0.02),
        ([1.3, 0.3, 0.0], -0.05),
        ([0.4, 1.2, 0.2], 0.01),
        ([0.6, -1.1, 0.4], 0.03),
    ] {
        cluster.pour(&law, vector(x[0], x[1], x[2]), vector(v, -v, 0.5 * v));
    }
    let momentum = |g: &Grains| -> Vector {
        g.velocities()
            .iter()
            .fold([0.0; 4], |sum, v| [sum[0] + v[0], sum[1] + v[1], sum[2] + v[2], 0.0])
    };
    let before = momentum(&cluster);
    (0..400).for_each(|_| cluster.substep(&law, [0.0; 4], &Shape::Nowhere));
    let change = sub(momentum(&cluster), before);
    // Four grains at speeds near 0.05: single precision keeps the sum to 1e-6 of that.
    assert!(dot(change, change).sqrt() < 1e-6, "{change:?}");
}

/// Ratio of the speeds after and before the impact of a grain that falls five diameters onto a
/// plate.
fn wall_restitution(law: &Law) -> f32 {
    let mut one = grains(&[vector(0.0, 0.0, 5.5)]);
    let (mut fastest, mut rebound) = (0.0f32, 0.0f32);
    for _ in 0..substeps(0.2) {
        one.substep(law, down(law), &Shape::Plate(Plate { radius: 5.0 }));
        let (x, v) = one.grain(0);
        fastest = fastest.max(-v[2]);
        rebound = if x[2] < 0.5 { rebound.max(v[2]) } else { rebound };
    }
    assert!((one.grain(0).0[2] - 0.5).abs() < 0.01, "it rests on the plate");
    rebound / fastest
}

/// Ratio of the speeds at which two grains separate and meet.
fn pair_restitution(law: &Law) -> f32 {
    let mut pair = Grains::default();
    pair.pour(law, vector(0.0, 0.0, 0.0), vector(0.02, 0.0, 0.0));
    pair.pour(law, vector(1.5, 0.0, 0.0), vector(-0.03, 0.0, 0.0));
    (0..200).for_each(|_| pair.substep(law, [0.0; 4], &Shape::Nowhere));
    (pair.grain(1).1[0] - pair.grain(0).1[0]) / 0.05
}

#[test]
fn impacts_are_inelastic() {
    // The published engine's collisions are perfectly inelastic. With a ratio below a tenth, an
    // impact keeps less than 1 % of its energy.
    let law = law(&[]);
    assert!(wall_restitution(&law) < 0.1, "{}", wall_restitution(&law));
    let pair = pair_restitution(&law);
    assert!((0.0..0.1).contains(&pair), "{pair}");
}

#[test]
fn a_heap_rests_with_and_without_cohesion() {
    // The parameter box ends near bond number 3; cohesion 1.2 at gravity_scale 0.3 gives 1.6.
    for (changes, creep_max, speed_max) in [
        (vec![("friction", 0.8)], 0.02, 0.05),
        (vec![("friction", 0.3), ("cohesion", 1.2), ("gravity_scale", 0.3)], 0.1, 0.3),
    ] {
        let heap = repose(&set(&changes), &repose::Settings::default(), 3).unwrap();
        assert!(
            heap.creep_deg_per_s.abs() < creep_max && heap.speed_rms_mm_s < speed_max,
            "{heap:?}"
        );
        assert!(heap.overlap_mean < 0.005 && heap.overlap_max < 0.05, "{heap:?}");
    }
}

#[test]
fn every_path_gives_the_same_bytes() {
    let law = law(&[("friction", 0.5), ("cohesion", 0.4)]);
    let run = |path| {
        let mut grains = Grains::on(path);
        for k in 0..200u8 {
            let [x, y, z] = [k % 5, k / 5 % 5, k / 25].map(f32::from);
            grains.pour(&law, vector(1.1 * x + 0.01 * z, 1.1 * y, 0.6 + 1.1 * z), [0.0; 4]);
        }
        for _ in 0..800 {
            grains.substep(&law, down(&law), &Shape::Plate(Plate { radius: 4.0 }));
            grains.take_departed(&Shape::Plate(Plate { radius: 4.0 }));
        }
        format!("{:?} {:?}", grains.centres(), grains.velocities())
    };
    for path in Path::available().skip(1) {
        assert!(run(path) == run(Path::Portable), "{path:?}");
    }
}

#[test]
fn a_level_spoon_keeps_its_powder_and_a_steep_shaken_one_gives_it_up() {
    let settings =
        dispense::Settings { particles: 900, semi_axes_mm: [3.4, 2.4, 1.4], ..Default::default() };
    let full = Dispenser::new(&set(&[("friction", 0.6)]), &settings, 2);
    let total = full.spoon_mg();
    let mut level = full.clone();
    assert_eq!(level.step(Action::default()), dispense::Poured::default());
    let mut steep = full.clone();
    let mut poured = 0.0;
    for _ in 0..6 {
        poured += steep.step(Action::once(8.0, 8.0)).vial_mg;
    }
    assert!(poured > 0.3 * total, "{poured} of {total}");
    let accounted = steep.vial_mg() + steep.spilled_mg() + steep.spoon_mg();
    assert!((accounted - total).abs() < 1e-6, "{accounted} of {total}");
    assert_eq!(steep.fault(), None);
}
