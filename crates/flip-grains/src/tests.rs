//! The code against closed forms, and heaps against what moves them.

use super::*;

/// Grains that only touch: no bond, no resistance to rolling.
const SMOOTH: Grains =
    Grains { friction: 0.5, rolling: 0.0, size_spread: 0.0, bond: 0.0, count: 500 };

#[test]
fn an_impact_gives_back_the_speed_of_a_damped_oscillator() {
    let expected = (-PI * DAMPING / (1.0 - DAMPING * DAMPING).sqrt()).exp();
    for (radius, share, tolerance) in [(0.5, 40.0, 0.005), (0.3, 40.0, 0.005), (0.5, 1.0, 0.05)] {
        let ahead = thrown(V3::ZERO, V3::ZERO, 0.5);
        let behind = thrown(V3(0.0, 0.0, 1.01), V3(0.0, 0.0, -1.0), radius);
        let mut world = World { gravity: V3::ZERO, ..World::new(&SMOOTH, vec![ahead, behind]) };
        (0..(400.0 * share) as usize).for_each(|_| world.step(step_time(radius) / share));
        let restitution = world.spheres[1].velocity.2 - world.spheres[0].velocity.2;
        assert!((restitution - expected).abs() < tolerance, "{restitution} is not {expected}");
    }
}

#[test]
fn grains_that_collide_keep_their_momentum_and_angular_momentum() {
    let grains = Grains { rolling: 0.2, bond: 1.0, ..SMOOTH };
    let spinning = Sphere { spin: V3(3.0, -1.0, 2.0), ..thrown(V3::ZERO, V3(0.5, 0.0, 0.2), 0.5) };
    let meeting = thrown(V3(0.4, 0.3, 0.9), V3(0.0, 0.0, -2.0), 0.4);
    let mut world = World { gravity: V3::ZERO, ..World::new(&grains, vec![spinning, meeting]) };
    let momenta = |world: &World| {
        world.spheres.iter().fold((V3::ZERO, V3::ZERO), |(linear, angular), it| {
            let momentum = it.velocity * (1.0 / it.lightness);
            (
                linear + momentum,
                angular + it.at.cross(momentum) + it.spin * (it.gyration() / it.lightness),
            )
        })
    };
    let before = momenta(&world);
    (0..1000).for_each(|_| world.step(step_time(0.4)));
    let after = momenta(&world);
    assert!(world.spheres[1].spin.norm() > 0.1, "the grains never rubbed");
    assert!(
        (after.0 - before.0).norm() < 1e-12 && (after.1 - before.1).norm() < 1e-12,
        "{before:?} became {after:?}"
    );
}

/// A sphere placed on a slope of this tangent has this acceleration after a while.
fn expect_down_a_slope(grains: &Grains, tangent: f64, expected: f64) {
    let slope = tangent.atan();
    // A glued sphere of this radius is a plane.
    let plane = Sphere::new(V3(0.0, 0.0, -1e6), 1e6, Role::Glued);
    let sphere = thrown(V3(0.0, 0.0, 0.5 - (slope.cos() + grains.bond) / STIFFNESS), V3::ZERO, 0.5);
    let gravity = V3(slope.sin(), 0.0, -slope.cos());
    let mut world = World { gravity, ..World::new(grains, vec![plane, sphere]) };
    let (steps, dt) = (1500, step_time(0.5));
    let mut speed_later = || {
        (0..steps).for_each(|_| world.step(dt));
        world.spheres[1].velocity.0
    };
    let before = speed_later();
    let acceleration = (speed_later() - before) / (f64::from(steps) * dt);
    assert!(
        (acceleration - expected).abs() < 1e-3,
        "{acceleration} is not {expected} on {tangent}, {grains:?}"
    );
}

#[test]
fn a_sphere_on_a_slope_rolls_at_five_sevenths_of_gravity_or_slides_against_friction() {
    for (friction, tangent) in [(0.5, 0.2), (0.5, 1.0), (0.1, 0.3)] {
        let rolling = 5.0 / 7.0 * f64::sin(f64::atan(tangent));
        expect_down_a_slope(&Grains { friction, ..SMOOTH }, tangent, rolling);
    }
    // Rolling needs a friction of 2/7 of the tangent. A bond loads the contact as weight does.
    let slope = f64::atan(1.5);
    for bond in [0.0, 0.7] {
        let sliding = slope.sin() - 0.1 * (slope.cos() + bond);
        expect_down_a_slope(&Grains { friction: 0.1, bond, ..SMOOTH }, 1.5, sliding);
    }
}

#[test]
fn a_sphere_stands_on_slopes_flatter_than_its_rolling_resistance_and_rolls_down_steeper_ones() {
    let grains = Grains { rolling: 0.2, ..SMOOTH };
    expect_down_a_slope(&grains, 0.195, 0.0);
    for tangent in [0.21, 0.4] {
        let slope = f64::atan(tangent);
        expect_down_a_slope(&grains, tangent, 5.0 / 7.0 * (slope.sin() - 0.2 * slope.cos()));
    }
}

#[test]
fn a_cone_reads_as_its_slope() {
    for slope_deg in [15.0_f64, 30.0, 50.0] {
        let height = |x: f64, y: f64| (8.0 - x.hypot(y)) * slope_deg.to_radians().tan();
        let places =
            (0..81 * 81).map(|i| (f64::from(i % 81) * 0.2 - 8.0, f64::from(i / 81) * 0.2 - 8.0));
        let cone: Vec<Sphere> =
            places.map(|(x, y)| Sphere::new(V3(x, y, height(x, y)), 0.5, Role::Free)).collect();
        let read = flank_deg(&cone, 8.0).unwrap();
        assert!((read - slope_deg).abs() < 0.5, "{read} is not {slope_deg}");
    }
    assert_eq!(flank_deg(&plate_of_grains(8.0, &mut Pcg64::seed_from_u64(1)), 8.0), None);
}

#[test]
fn the_same_seed_pours_the_same_heap_in_every_bit() {
    let grains = Grains { rolling: 0.1, size_spread: 0.1, count: 300, ..SMOOTH };
    let heap = |seed| repose_deg(&grains, seed).map(f64::to_bits);
    assert!(heap(1).is_some() && heap(1) == heap(1));
    assert_ne!(heap(1), heap(2));
}

/// Prints mean angles of powders over seeds; each must be steeper than the one before by this much.
fn expect_steeper(powders: &[Grains], least_deg: f64) {
    let angle = |grains: &Grains| {
        let angles: Vec<f64> = (1..=3).filter_map(|seed| repose_deg(grains, seed)).collect();
        println!("{grains:?}: {angles:.1?} deg");
        assert!(angles.len() >= 2, "{grains:?} gives no heap");
        angles.iter().sum::<f64>() / angles.len() as f64
    };
    let means: Vec<f64> = powders.iter().map(angle).collect();
    assert!(means.windows(2).all(|pair| pair[1] > pair[0] + least_deg), "{means:?}");
}

#[test]
fn more_rolling_resistance_makes_a_steeper_heap() {
    expect_steeper(&[0.0, 0.1, 0.3].map(|rolling| Grains { rolling, ..SMOOTH }), 3.0);
}

#[test]
fn a_stronger_bond_makes_a_steeper_heap() {
    expect_steeper(&[0.0, 0.3, 1.0].map(|bond| Grains { rolling: 0.1, bond, ..SMOOTH }), 2.0);
}
