//! Each mechanism follows its law where it can be isolated, and is the bitwise identity at zero
//! amplitude.

use super::{Extensions, Site};
use crate::constraints::{Vector, dot, vector};
use crate::dispense::{self, Dispenser};
use crate::grains::Grains;
use crate::lanes::Path;
use crate::law::{GRAVITY, Law, SUBSTEP_S};
use crate::repose::{Settings, repose};
use crate::walls::{Plate, Shape};
use flip_core::domain::bench::Action;
use flip_core::domain::parameters::ParameterSet;

fn set() -> ParameterSet {
    ParameterSet::default().with("friction", 0.5).unwrap()
}

fn with(amplitudes: &[(&str, f64)]) -> Extensions {
    amplitudes
        .iter()
        .fold(Extensions::default(), |all, (name, amplitude)| all.with(name, *amplitude).unwrap())
}

fn law(amplitudes: &[(&str, f64)], site: Site) -> Law {
    Law::new(&set(), 0.4, SUBSTEP_S).extended(&with(amplitudes), &set(), site)
}

fn substeps(seconds: f64) -> u32 {
    (seconds / SUBSTEP_S).round() as u32
}

const LEVEL: Shape = Shape::Plate(Plate { radius: 50.0 });

fn down(law: &Law) -> Vector {
    vector(0.0, 0.0, -law.gravity)
}

/// A block of grains thrown onto a plate, with every bit of its state.
fn thrown(law: &Law, path: Path) -> String {
    let mut grains = Grains::on(path);
    for k in 0..150u8 {
        let [x, y, z] = [k % 5, k / 5 % 5, k / 25].map(f32::from);
        grains.pour(
            law,
            vector(1.1 * x + 0.01 * z, 1.1 * y, 0.6 + 1.1 * z),
            vector(0.0, 0.0, -0.01),
        );
    }
    let plate = Shape::Plate(Plate { radius: 4.0 });
    for _ in 0..1500 {
        grains.substep(law, down(law), &plate);
        grains.take_departed(&plate);
    }
    let bits = |v: &Vector| v.map(f32::to_bits);
    let all = |of: &[Vector]| of.iter().map(bits).collect::<Vec<_>>();
    format!("{:?} {:?}", all(grains.centres()), all(grains.velocities()))
}

#[test]
fn hooks_at_zero_amplitude_leave_every_bit_alone() {
    for site in [Site::Base, Site::Spoon] {
        let set = set().with("cohesion", 0.4).unwrap().with("adhesion", 0.5).unwrap();
        let base = Law::new(&set, 0.4, SUBSTEP_S);
        let hooked = Law { extended: true, ..base.extended(&Extensions::default(), &set, site) };
        for path in Path::available() {
            assert!(thrown(&base, path) == thrown(&hooked, path), "{path:?} {site:?}");
        }
    }
}

#[test]
fn an_amplitude_of_zero_gives_the_bytes_of_the_base_for_every_mechanism() {
    let settings = Settings::with_particles(300);
    let spoon = dispense::Settings { particles: 200, ..Default::default() };
    let outcome = |extensions: Extensions| {
        let heap = repose(&set(), &Settings { extensions, ..settings }, 5);
        let mut dispenser = Dispenser::new(&set(), &dispense::Settings { extensions, ..spoon }, 5);
        let poured = dispenser.step(Action::once(8.0, 6.0));
        format!("{heap:?} {poured:?} {}", dispenser.spoon_mg())
    };
    let base = outcome(Extensions::default());
    for (name, _, upper) in Extensions::default().amplitudes() {
        assert_eq!(outcome(Extensions::default().with(name, 0.0).unwrap()), base, "{name}");
        // Rolling friction without rotation has nothing to act on, and the spoon's mechanisms act
        // only in the spoon.
        if name != "rolling_friction" {
            assert_ne!(
                outcome(Extensions::default().with(name, 0.5 * upper).unwrap()),
                base,
                "{name}"
            );
        }
    }
}

#[test]
fn every_path_gives_the_same_bytes_with_every_mechanism() {
    let mut all = Extensions::default();
    for (_, slot, upper) in all.amplitudes() {
        *slot = 0.3 * upper;
    }
    let law = Law::new(&set(), 0.4, SUBSTEP_S).extended(&all, &set(), Site::Spoon);
    for path in Path::available().skip(1) {
        assert!(thrown(&law, path) == thrown(&law, Path::Portable), "{path:?}");
    }
}

#[test]
fn an_unknown_mechanism_and_an_amplitude_out_of_bounds_are_refused_by_name() {
    let refusal = Extensions::default().with("magnetism", 1.0).unwrap_err();
    assert!(
        refusal.field == "extension" && refusal.message.contains("rotation, rolling_friction"),
        "{refusal:?}"
    );
    assert_eq!(Extensions::default().with("rotation", 1.5).unwrap_err().field, "rotation");
}

/// Speed along x, and spin about y times radius, of a grain that slides onto a plate at `speed`,
/// after `seconds`.
fn slid(amplitudes: &[(&str, f64)], speed: f32, seconds: f64) -> [f32; 2] {
    let law = law(amplitudes, Site::Base);
    let mut one = Grains::default();
    one.pour(&law, vector(0.0, 0.0, 0.5), vector(speed, 0.0, 0.0));
    (0..substeps(seconds)).for_each(|_| one.substep(&law, down(&law), &LEVEL));
    [one.grain(0).1[0], 0.5 * one.spin(0)[1]]
}

#[test]
fn a_sliding_sphere_ends_rolling_with_five_sevenths_of_its_speed() {
    // Momentum about a point of the plate is conserved: v_end = v / (1 + 2/5), for any friction.
    let [v, surface] = slid(&[("rotation", 1.0)], 0.02, 0.1);
    assert!((v / 0.02 - 5.0 / 7.0).abs() < 0.01, "{v}");
    assert!((surface / v - 1.0).abs() < 0.01, "it rolls without slipping: {surface} {v}");
    assert_eq!(slid(&[], 0.02, 0.1)[1], 0.0, "without rotation nothing spins");
}

#[test]
fn rolling_friction_slows_a_rolling_sphere_with_its_own_acceleration() {
    // a = mu_r g r^2 / (r^2 + I/m) = 5/7 mu_r g for a solid sphere.
    let amplitudes = [("rotation", 1.0), ("rolling_friction", 0.05)];
    let speed = |seconds| f64::from(slid(&amplitudes, 0.02, seconds)[0]);
    let acceleration = (speed(0.06) - speed(0.1)) / f64::from(substeps(0.1) - substeps(0.06));
    let expected = 5.0 / 7.0 * 0.05 * GRAVITY * SUBSTEP_S * SUBSTEP_S / 0.27e-3;
    assert!((acceleration / expected - 1.0).abs() < 0.03, "{acceleration} against {expected}");
}

#[test]
fn two_spinning_grains_keep_momentum_and_angular_momentum_in_an_oblique_collision() {
    let law = law(&[("rotation", 1.0)], Site::Base);
    let mut pair = Grains::default();
    pair.pour(&law, vector(0.0, 0.0, 0.0), vector(0.004, 0.0, 0.0));
    pair.pour(&law, vector(1.0, 0.6, 0.0), vector(-0.004, 0.0, 0.0));
    let angular = |g: &Grains| -> f64 {
        let one = |id| {
            let (x, v) = g.grain(id);
            f64::from(x[0] * v[1] - x[1] * v[0]) + 0.4 * 0.25 * f64::from(g.spin(id)[2])
        };
        one(0) + one(1)
    };
    let before = angular(&pair);
    (0..300).for_each(|_| pair.substep(&law, [0.0; 4], &Shape::Nowhere));
    assert!(pair.spin(0)[2].abs() > 3e-4, "the collision was oblique");
    let (a, b) = (pair.grain(0).1, pair.grain(1).1);
    assert!((a[0] + b[0]).abs() < 1e-6 && (a[1] + b[1]).abs() < 1e-6);
    // The corrections act at the predicted positions, so angular momentum is conserved to the order
    // of one substep's path.
    assert!((angular(&pair) / before - 1.0).abs() < 0.01, "{} {before}", angular(&pair));
}

#[test]
fn radii_have_the_spread_that_was_asked_for_and_the_mean_volume_of_equal_grains() {
    let sizes = law(&[("size_spread", 0.2)], Site::Base).mechanisms.sizes;
    let radii: Vec<f64> = (0..20_000).map(|id| f64::from(sizes.radius(id))).collect();
    let mean =
        |of: fn(f64) -> f64| radii.iter().map(|r| of(2.0 * r)).sum::<f64>() / radii.len() as f64;
    let log = mean(f64::ln);
    let spread = mean(|r| r.ln() * r.ln()) - log * log;
    // Cutting at 2.5 standard deviations removes 2 % of the spread and of the largest volumes.
    assert!((spread.sqrt() / 0.2 - 1.0).abs() < 0.03, "{}", spread.sqrt());
    assert!((mean(|r| r * r * r) - 1.0).abs() < 0.02, "{}", mean(|r| r * r * r));
}

#[test]
fn unequal_grains_keep_momentum_and_rest_on_each_other_surface_to_surface() {
    let law = law(&[("size_spread", 0.3)], Site::Base);
    let mut pair = Grains::default();
    pair.pour(&law, vector(0.0, 0.0, 0.0), vector(0.02, 0.0, 0.0));
    pair.pour(&law, vector(1.6, 0.2, 0.0), vector(-0.02, 0.0, 0.0));
    let momentum = |g: &Grains| -> f64 {
        [0, 1]
            .iter()
            .map(|&id| f64::from(g.grain(id).0[3]).powi(3) * f64::from(g.grain(id).1[0]))
            .sum()
    };
    let before = momentum(&pair);
    (0..200).for_each(|_| pair.substep(&law, [0.0; 4], &Shape::Nowhere));
    assert!((momentum(&pair) - before).abs() < 1e-6 * 0.02, "{} {before}", momentum(&pair));
    let mut one = Grains::default();
    one.pour(&law, vector(0.0, 0.0, 1.0), [0.0; 4]);
    (0..substeps(0.3)).for_each(|_| one.substep(&law, down(&law), &LEVEL));
    let x = one.grain(0).0;
    assert!((x[2] - x[3]).abs() < 0.01 && (x[3] - 0.5).abs() > 0.02, "{x:?}");
}

/// Largest separating pull, as a bond number, under which a grain below a fixed one stays for
/// `seconds` after hanging for `wait`.
fn strength(amplitudes: &[(&str, f64)], wait: f64, seconds: f64) -> f64 {
    // Only a law with mechanisms supports fixed grains.
    let law = Law { extended: true, ..law(amplitudes, Site::Base) };
    let holds = |bond: f64| {
        let mut pair = Grains::default();
        pair.fix(vector(0.0, 0.0, 0.0));
        pair.pour(&law, vector(0.0, 0.0, -0.999), [0.0; 4]);
        // Held against the fixed grain by an upward weight.
        (0..substeps(wait))
            .for_each(|_| pair.substep(&law, vector(0.0, 0.0, law.gravity), &Shape::Nowhere));
        // Ramped slowly, because a sudden pull overshoots by up to a factor of two.
        for substep in 0..substeps(seconds) {
            let share = (2.0 * f64::from(substep) / f64::from(substeps(seconds))).min(1.0);
            pair.substep(
                &law,
                vector(0.0, 0.0, -law.gravity * (share * bond) as f32),
                &Shape::Nowhere,
            );
        }
        pair.grain(1).0[2] > -1.2
    };
    let (mut low, mut high) = (0.0, 20.0);
    while high - low > 0.02 {
        let middle = 0.5 * (low + high);
        match holds(middle) {
            true => low = middle,
            false => high = middle,
        }
    }
    0.5 * (low + high)
}

#[test]
fn a_contact_grows_stronger_with_its_age() {
    // Bo(t) = 4 t / (t + 0.1 s), and the pull reaches its full size 0.01 s after the wait.
    let strengths = [0.02, 0.1, 0.9].map(|wait| strength(&[("consolidation", 4.0)], wait, 0.02));
    for (strength, expected) in strengths.into_iter().zip([0.92, 2.10, 3.60]) {
        assert!((strength / expected - 1.0).abs() < 0.06, "{strengths:?}");
    }
    assert!(strength(&[], 0.1, 0.05) < 0.05);
}

#[test]
fn a_bridge_of_water_holds_its_bond_number_and_forms_only_on_touch() {
    let held = strength(&[("humidity", 1.0)], 0.02, 0.2);
    assert!((held - 2.0).abs() < 0.15, "{held}");
    // An approaching pair feels nothing; a pair that has touched is held at the same gap.
    let law = law(&[("humidity", 1.0)], Site::Base);
    let mut apart = Grains::default();
    apart.pour(&law, vector(0.0, 0.0, 0.0), [0.0; 4]);
    apart.pour(&law, vector(1.05, 0.0, 0.0), [0.0; 4]);
    (0..200).for_each(|_| apart.substep(&law, [0.0; 4], &Shape::Nowhere));
    assert_eq!(apart.grain(1).0[0], 1.05);
    let mut met = Grains::default();
    met.pour(&law, vector(0.0, 0.0, 0.0), [0.0; 4]);
    met.pour(&law, vector(0.985, 0.0, 0.0), vector(0.006, 0.0, 0.0));
    let mut widest = 0.0f32;
    for _ in 0..3000 {
        met.substep(&law, [0.0; 4], &Shape::Nowhere);
        widest = widest.max(met.grain(1).0[0] - met.grain(0).0[0]);
    }
    let end = met.grain(1).0[0] - met.grain(0).0[0];
    assert!(widest > 1.001 && end < 1.0, "the bridge brought it back: {widest} {end}");
    // A faster pair ruptures at a gap of (0.008)^(1/3) / 2 = 0.1 d.
    let mut torn = Grains::default();
    torn.pour(&law, vector(0.0, 0.0, 0.0), [0.0; 4]);
    torn.pour(&law, vector(0.95, 0.0, 0.0), vector(0.04, 0.0, 0.0));
    (0..3000).for_each(|_| torn.substep(&law, [0.0; 4], &Shape::Nowhere));
    assert!(torn.grain(1).0[0] - torn.grain(0).0[0] > 2.0);
}

/// Whether a grain under a plate stays there for half a second.
fn hangs(amplitudes: &[(&str, f64)], site: Site, gap: f32) -> bool {
    let law = law(amplitudes, site);
    let mut one = Grains::default();
    one.pour(&law, vector(0.0, 0.0, -0.5 - gap), [0.0; 4]);
    (0..substeps(0.5)).for_each(|_| one.substep(&law, down(&law), &LEVEL));
    one.grain(0).0[2] > -0.6
}

#[test]
fn a_spoon_holds_grains_when_its_adhesion_exceeds_their_weight_and_a_base_does_not() {
    let amplitude = |bond| [("spoon_adhesion", bond)];
    assert!(hangs(&amplitude(1.1), Site::Spoon, 0.0) && !hangs(&amplitude(0.9), Site::Spoon, 0.0));
    assert!(!hangs(&amplitude(5.0), Site::Base, 0.0));
}

#[test]
fn charge_holds_grains_to_any_wall_and_reaches_beyond_contact() {
    let amplitude = |bond| [("charge", bond)];
    assert!(hangs(&amplitude(1.1), Site::Base, 0.0) && !hangs(&amplitude(0.9), Site::Base, 0.0));
    // At a gap of one radius the image is twice as far away: a quarter of the pull.
    assert!(hangs(&amplitude(4.4), Site::Base, 0.5) && !hangs(&amplitude(3.6), Site::Base, 0.5));
}

#[test]
fn an_emptied_spoon_keeps_a_film_of_the_share_that_was_asked_for() {
    let left = |hold_up: f64| {
        let extensions = Extensions { hold_up, ..Extensions::default() };
        let settings = dispense::Settings {
            particles: 900,
            semi_axes_mm: [3.4, 2.4, 1.4],
            friction: 0.2,
            extensions,
            ..Default::default()
        };
        let mut spoon = Dispenser::new(&set(), &settings, 2);
        let full = spoon.spoon_mg();
        let actions = [8.0, 8.0, 8.0, 8.0, 8.0, 8.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        for incline_change_deg in actions {
            spoon.step(Action::once(incline_change_deg, 10.0));
        }
        assert_eq!(spoon.fault(), None);
        spoon.spoon_mg() / full
    };
    let [none, some, more] = [0.0, 0.2, 0.4].map(left);
    assert!(none < 0.02 && some > none + 0.02 && more > some + 0.02, "{none} {some} {more}");
}

#[test]
fn a_vibrating_base_throws_grains_from_one_g_on() {
    let lifts = |peak: f64| {
        let law = law(&[("vibration_g", peak)], Site::Base);
        let mut one = Grains::default();
        one.pour(&law, vector(0.0, 0.0, 0.5), [0.0; 4]);
        let mut highest = 0.0f32;
        for _ in 0..substeps(0.2) {
            one.substep(&law, down(&law), &LEVEL);
            highest = highest.max(one.grain(0).0[2]);
        }
        highest - 0.5
    };
    assert!(lifts(0.9) < 0.002 && lifts(1.3) > 0.01, "{} {}", lifts(0.9), lifts(1.3));
}

#[test]
fn air_gives_a_falling_grain_its_terminal_velocity() {
    // a v (1 + b v) = g with a = 18 eta / (rho d^2) and b = 0.4 rho_air d / (24 eta).
    let (d, mass) = (0.27e-3, 14.25e-9);
    let density = mass / (std::f64::consts::PI / 6.0 * d * d * d);
    let eta = 10.0 * 1.82e-5;
    let (a, b) = (18.0 * eta / (density * d * d), 0.4 * 1.204 * d / (24.0 * eta));
    let terminal = ((1.0 + 4.0 * b * GRAVITY / a).sqrt() - 1.0) / (2.0 * b);
    let set = ParameterSet::default().with("particle_mass_ug", 14.25).unwrap();
    let law = Law::new(&set, 0.4, SUBSTEP_S).extended(&with(&[("air", 10.0)]), &set, Site::Base);
    let mut one = Grains::default();
    one.pour(&law, [0.0; 4], [0.0; 4]);
    (0..substeps(0.5)).for_each(|_| one.substep(&law, down(&law), &Shape::Nowhere));
    let speed = law.speed_m_s(dot(one.grain(0).1, one.grain(0).1).sqrt());
    assert!((speed / terminal - 1.0).abs() < 0.01, "{speed} against {terminal}");
}
