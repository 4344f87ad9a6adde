//! Properties of the published engine's semantics.

use super::{FRAME_S, ITERATIONS, Law, Solver};
use crate::constraints::{Vector, vector};
use crate::law::GRAVITY;
use crate::repose::{Compat, Settings, repose};
use crate::walls::{Plate, Shape, Wall};
use flip_core::domain::parameters::ParameterSet;

fn set(changes: &[(&str, f64)]) -> ParameterSet {
    changes.iter().fold(ParameterSet::default(), |set, (key, value)| set.with(key, *value).unwrap())
}

fn law(changes: &[(&str, f64)]) -> Law {
    Law::new(&set(changes), FRAME_S, ITERATIONS)
}

fn down(law: &Law) -> Vector {
    vector(0.0, 0.0, -law.gravity)
}

fn solver(grains: &[(Vector, Vector)]) -> Solver {
    let mut solver = Solver::default();
    grains.iter().for_each(|(x, v)| solver.pour(*x, *v));
    solver
}

/// A loose block of 120 grains that collapses on a plate for 60 frames, as text.
fn collapse(law: &Law, wall: &impl Wall) -> String {
    let mut block = Solver::default();
    for k in 0..120u8 {
        let [x, y, z] = [k % 5, k / 5 % 5, k / 25].map(f32::from);
        block.pour(vector(1.05 * x + 0.3 * z, 1.05 * y, 0.6 + 0.97 * z), vector(0.0, 0.0, -0.1));
    }
    for _ in 0..60 {
        block.frame(law, down(law), wall);
    }
    assert_eq!(block.fault(), None);
    format!("{:?} {:?}", block.centres(), block.velocities())
}

fn heap(changes: &[(&str, f64)], settings: &Settings) -> String {
    format!("{:?}", repose(&set(changes), settings, 5).unwrap())
}

/// A small heap that runs quickly.
fn small() -> Settings {
    Settings { compat: Compat::Physx, settle_max_s: 0.05, ..Settings::with_particles(300) }
}

#[test]
fn mass_is_inert() {
    assert_eq!(
        heap(&[("particle_mass_ug", 13.0)], &small()),
        heap(&[("particle_mass_ug", 16.5)], &small())
    );
}

#[test]
fn cohesion_is_inert() {
    assert_eq!(heap(&[("cohesion", 0.0)], &small()), heap(&[("cohesion", 1.2)], &small()));
}

#[test]
fn the_friction_of_the_base_is_inert_because_the_grains_own_holds_there() {
    let smooth = Settings { base_friction: 0.0, ..small() };
    assert_eq!(heap(&[], &small()), heap(&[], &smooth));
    assert_ne!(heap(&[("friction", 0.5)], &small()), heap(&[("friction", 0.6)], &small()));
}

#[test]
fn adhesion_between_grains_is_off_for_every_radius_scale_up_to_one() {
    let plain = law(&[("friction", 0.4)]);
    let alone = collapse(&plain, &Shape::Nowhere);
    for radius_scale in [0.000_05, 0.5, 1.0] {
        let sticky = Law { radius_scale, grain_adhesion: 1.69, ..plain };
        assert_eq!(collapse(&sticky, &Shape::Nowhere), alone, "radius scale {radius_scale}");
        // On a plate too, as long as the wall does not attract.
        assert_eq!(
            collapse(&sticky, &Plate { radius: 20.0 }),
            collapse(&plain, &Plate { radius: 20.0 }),
            "radius scale {radius_scale}"
        );
    }
    assert_ne!(
        collapse(&Law { radius_scale: 1.2, grain_adhesion: 1.69, ..plain }, &Shape::Nowhere),
        alone
    );
}

#[test]
fn the_particle_adhesion_scale_is_inert_within_the_published_bounds() {
    let sticky = |scale| {
        heap(
            &[
                ("adhesion", 1.3),
                ("adhesion_offset_scale", 0.000_05),
                ("particle_adhesion_scale", scale),
            ],
            &small(),
        )
    };
    assert_eq!(sticky(0.0), sticky(1.3));
    assert_ne!(sticky(1.0), heap(&[], &small()));
}

#[test]
fn adhesion_and_its_particle_scale_act_between_grains_only_as_their_product() {
    let grains = |adhesion, scale| Law {
        radius_scale: 1.3,
        wall_adhesion: 0.0,
        ..law(&[("adhesion", adhesion), ("particle_adhesion_scale", scale)])
    };
    let (a, b) = (grains(0.5, 1.0), grains(1.0, 0.5));
    assert_eq!(a, b);
    assert_ne!(collapse(&a, &Shape::Nowhere), collapse(&grains(1.0, 1.0), &Shape::Nowhere));
    // A wall uses adhesion alone and distinguishes them.
    assert_ne!(law(&[("adhesion", 0.5)]).wall_adhesion, law(&[("adhesion", 1.0)]).wall_adhesion);
}

/// Position and value of the maximum of `pull` among `steps` points up to `end`.
fn peak(end: f32, pull: impl Fn(f32) -> f32) -> (f32, f32) {
    (0..=10_000u16)
        .map(|k| end * f32::from(k) / 10_000.0)
        .map(|e| (e, pull(e)))
        .fold((0.0, 0.0), |top, at| if at.1 > top.1 { at } else { top })
}

#[test]
fn attraction_between_grains_peaks_at_a_ninth_of_the_aura_and_saturates_at_the_gap() {
    for radius_scale in [1.1f32, 1.4] {
        let law = Law { radius_scale, grain_adhesion: 1.0, ..law(&[]) };
        let aura = radius_scale - 1.0;
        let (at, largest) = peak(aura, |e| law.grain_pull(e));
        // d/de (1 - e/aura)^8 e = 0 at aura/9: (8/9)^8 / 9 = 0.0433.
        assert!(
            (at / aura - 1.0 / 9.0).abs() < 1e-3 && (largest / aura - 0.043_30).abs() < 1e-4,
            "{at}, {largest}"
        );
        assert_eq!(law.grain_pull(aura), 0.0);
        // m <= e: a pull of three gaps closes the gap and no more, so two strong adhesions act
        // alike near contact.
        let strong = |grain_adhesion| {
            let law = Law { grain_adhesion, iterations: 1, ..law };
            let mut pair =
                solver(&[([0.0; 4], [0.0; 4]), (vector(1.0 + 0.01 * aura, 0.0, 0.0), [0.0; 4])]);
            pair.frame(&law, [0.0; 4], &Shape::Nowhere);
            format!("{:?}", pair.centres())
        };
        assert_eq!(strong(3.0), strong(30.0));
        assert_ne!(strong(3.0), strong(0.3));
    }
}

#[test]
fn attraction_to_walls_has_its_closed_form_and_grows_again_beyond_the_radius() {
    let law = Law { radius_scale: 1.4, wall_adhesion: 0.7, wall_guard: 1.4 / 0.000_27, ..law(&[]) };
    let radius = 0.2f32;
    let (at, largest) = peak(radius, |sep| law.wall_pull(sep));
    // d/ds (1 - s/R)^4 s = 0 at R/5: (4/5)^4 / 5 = 0.0819.
    assert!(
        (at / radius - 0.2).abs() < 1e-3 && (largest / (0.7 * radius) - 0.081_92).abs() < 1e-4,
        "{at}, {largest}"
    );
    assert!(law.wall_pull(radius) < 1e-6 && law.wall_pull(1.5 * radius) > 0.0);
    assert!(
        law.wall_pull(3.0 * radius) > 10.0 * largest,
        "the even power grows: {}",
        law.wall_pull(3.0 * radius)
    );
    assert_eq!(law.wall_pull(-0.1), 0.0);
}

#[test]
fn within_the_published_bounds_the_radius_scale_is_the_range_of_wall_adhesion_in_metres() {
    let law = law(&[("adhesion", 0.5), ("adhesion_offset_scale", 0.000_05)]);
    // 50 micrometres of a grain of 0.27 mm.
    let range = 0.05f32 / 0.27;
    assert!((law.wall_guard - range).abs() < 1e-6);
    assert_eq!(law.wall_pull(1.001 * range), 0.0);
    // Radius -d/2: the pull over the gap grows from A at contact to A (1 + 2 range)^4 at the end,
    // where it exceeds the gap.
    assert!((law.wall_pull(1e-4) / 1e-4 - 0.5).abs() < 1e-3);
    let end = 0.999 * range;
    let expected = 0.5 * (1.0 + 2.0 * end).powi(4);
    assert!((law.wall_pull(end) / end - expected).abs() < 1e-3 && expected > 1.0, "{expected}");
    assert_eq!(Law { radius_scale: 0.0, ..law }.wall_pull(0.01), 0.0);
}

/// Whether a grain placed under a plate hangs there for half a second.
fn hangs(changes: &[(&str, f64)]) -> bool {
    let law = law(changes);
    let mut one = solver(&[(vector(0.0, 0.0, -0.5), [0.0; 4])]);
    (0..500).for_each(|_| one.frame(&law, down(&law), &Plate { radius: 5.0 }));
    one.centres()[0][2] > -0.6
}

#[test]
fn a_grain_hangs_from_a_wall_whatever_its_adhesion_once_the_radius_scale_is_not_zero() {
    assert!(!hangs(&[("adhesion", 1.3)]));
    assert!(!hangs(&[("adhesion_offset_scale", 0.000_05)]));
    for adhesion in [0.2, 1.3] {
        assert!(
            hangs(&[("adhesion", adhesion), ("adhesion_offset_scale", 0.000_05)]),
            "adhesion {adhesion}"
        );
    }
}

#[test]
fn a_grain_falls_as_its_frames_say() {
    for (scale, damping) in [(0.3, 0.0), (1.0, 0.0), (1.0, 1.0)] {
        let law = law(&[("gravity_scale", scale), ("damping", damping)]);
        let mut one = solver(&[([0.0; 4], [0.0; 4])]);
        let (mut v, mut z) = (0.0f64, 0.0f64);
        for _ in 0..100 {
            one.frame(&law, down(&law), &Shape::Nowhere);
            v = (v + scale * GRAVITY * FRAME_S) * (1.0 - damping * FRAME_S);
            z += v * FRAME_S;
        }
        let fallen = -f64::from(one.centres()[0][2]) * law.diameter_m;
        assert!((fallen / z - 1.0).abs() < 1e-5, "{fallen} m for {z} m");
    }
}

#[test]
fn gravity_and_the_frame_act_only_as_gravity_times_frame_squared() {
    // 0.4 (1.5 ms)^2 = 0.9 (1 ms)^2; without damping the rest of a law does not depend on the frame
    // length.
    let friction = |gravity_scale| set(&[("friction", 0.6), ("gravity_scale", gravity_scale)]);
    let (slow, quick) = (Law::new(&friction(0.4), 0.0015, 16), Law::new(&friction(0.9), 0.001, 16));
    assert_eq!(collapse(&slow, &Plate { radius: 4.0 }), collapse(&quick, &Plate { radius: 4.0 }));
    let other = Law::new(&friction(0.4), 0.001, 16);
    assert_ne!(collapse(&slow, &Plate { radius: 4.0 }), collapse(&other, &Plate { radius: 4.0 }));
}

#[test]
fn a_lone_grain_rests_on_a_gentle_slope_climbs_a_steeper_one_and_slides_above_the_friction_angle() {
    let law = law(&[("friction", 0.4)]);
    // Downhill speed in diameters per second, and acceleration in units of g cos.
    let slide = |slope: f32| {
        let lean = vector(slope * law.gravity, 0.0, -law.gravity);
        let mut one = solver(&[(vector(0.0, 0.0, 0.5), [0.0; 4])]);
        let mut after = |frames| {
            (0..frames).for_each(|_| one.frame(&law, lean, &Plate { radius: 20.0 }));
            (one.centres()[0][0], one.velocities()[0][0])
        };
        let (before, after) = (after(10), after(20));
        ((after.0 - before.0) * 50.0, (after.1 - before.1) / (20.0 * law.gravity))
    };
    for slope in [0.1, 0.2] {
        assert!(slide(slope).0.abs() < 1e-3, "{} d/s at slope {slope}", slide(slope).0);
    }
    // The tangential sum has no direction: slip to and fro adds up, reaches the cap, and the excess
    // pushes uphill. The rate is from a transcription of the equations for one grain in double
    // precision.
    assert!((slide(0.39).0 + 2.516).abs() < 0.01, "{} d/s", slide(0.39).0);
    for slope in [0.45, 0.5] {
        let acceleration = slide(slope).1;
        assert!(
            (acceleration / (slope - 0.4) - 1.0).abs() < 0.02,
            "{acceleration} at slope {slope}"
        );
    }
}

#[test]
fn no_grain_is_faster_than_the_speed_limit() {
    let law = Law { speed_max: 0.2, ..law(&[]) };
    let mut one = solver(&[([0.0; 4], vector(0.3, 0.0, 0.4))]);
    one.frame(&law, [0.0; 4], &Shape::Nowhere);
    let (x, v) = (one.centres()[0], one.velocities()[0]);
    assert!(
        (v[0] - 0.12).abs() < 1e-6 && (v[2] - 0.16).abs() < 1e-6 && (x[0] - 0.12).abs() < 1e-6,
        "{x:?} {v:?}"
    );
}

#[test]
fn one_iteration_has_its_closed_form_with_sticking_and_slipping_friction() {
    // One iteration: the overlap is the whole normal sum, and the slip of the frame is the relative
    // velocity.
    for (friction, speed) in [(0.5, 0.02f32), (0.5, 0.004), (0.0, 0.02)] {
        let law = Law { friction: friction as f32, ..Law::new(&set(&[]), FRAME_S, 1) };
        let (overlap, relaxation) = (0.01f32, 0.9f32);
        let mut pair = solver(&[
            ([0.0; 4], vector(0.0, speed, 0.0)),
            (vector(1.0 - overlap, speed, 0.0), [0.0; 4]),
        ]);
        pair.frame(&law, [0.0; 4], &Shape::Nowhere);
        let grip = (friction as f32 * overlap).min(speed);
        let [a, b] = [pair.velocities()[0], pair.velocities()[1]];
        assert!((a[0] + 0.5 * relaxation * overlap).abs() < 1e-6, "{a:?}");
        assert!((a[1] - (speed - 0.5 * relaxation * grip)).abs() < 1e-6, "{a:?}");
        // Opposite corrections: total momentum is conserved.
        assert!((a[0] + b[0]).abs() < 1e-7 && (a[1] + b[1] - speed).abs() < 1e-7);
        assert_eq!((a[3], b[3]), (1.0, 1.0));
    }
}

#[test]
fn the_friction_of_a_frame_stays_below_coulombs_cap_and_reaches_it_in_slip() {
    let law = law(&[("friction", 0.4)]);
    let plate = Plate { radius: 20.0 };
    // Sliding at first, and resting on friction at half of its capacity.
    for (speed, lean, slips) in [(0.2, 0.0, true), (0.0, 0.2, false)] {
        let mut one = solver(&[(vector(0.0, 0.0, 0.5), vector(speed, 0.0, 0.0))]);
        for _ in 0..5 {
            one.frame(&law, vector(lean * law.gravity, 0.0, -law.gravity), &plate);
            let contact = one.contacts()[0];
            let cap = 0.4 * contact.pressed;
            assert!(contact.held > 0.1 * cap && contact.held <= 1.000_01 * cap, "{contact:?}");
            assert_eq!(contact.held > 0.99 * cap, slips, "{contact:?}");
        }
        let sliding = one.velocities()[0][0];
        let expected = if slips { speed - 5.0 * 0.4 * law.gravity } else { 0.0 };
        assert!(
            (sliding - expected).abs() < 0.05 * 5.0 * 0.4 * law.gravity,
            "{sliding} for {expected}"
        );
    }
}

/// Relative velocity after a head-on impact at closing speed `closing`, over that speed; 100
/// frames, for one of 20 first gaps.
fn restitution(law: &Law, closing: f32, phase: u8) -> f32 {
    let gap = closing * f32::from(phase) / 20.0;
    let mut pair = solver(&[
        ([0.0; 4], vector(0.5 * closing, 0.0, 0.0)),
        (vector(1.0 + gap, 0.0, 0.0), vector(-0.5 * closing, 0.0, 0.0)),
    ]);
    (0..100).for_each(|_| pair.frame(law, [0.0; 4], &Shape::Nowhere));
    let [a, b] = [pair.velocities()[0], pair.velocities()[1]];
    assert!((a[0] + b[0]).abs() < 1e-6);
    (b[0] - a[0]) / closing
}

#[test]
fn an_impact_keeps_what_the_rest_of_its_frame_leaves_undone() {
    // With beta = 1/2 an iteration multiplies (e, h u), gap and closing step, by [[1/2, 1/2],
    // [-1/2, 1/2]]: eigenvalues of modulus 1/sqrt(2). The sums that pull a separating pair back end
    // with the frame, so the grains keep the remainder.
    let law = law(&[]);
    assert_eq!((law.iterations, law.relaxation), (16, 0.5));
    for phase in 0..20u8 {
        let kept = restitution(&law, 0.2, phase);
        let left = 16 - (16 * i32::from(phase) + 19) / 20;
        let bound = 0.5f32.powf(0.5 * left as f32);
        assert!((-1e-4..=1.01 * bound).contains(&kept), "{kept} for {bound} at phase {phase}");
    }
    // A whole frame leaves nothing; with four iterations to go, a quarter remains.
    assert!(restitution(&law, 0.2, 0) < 0.004 && restitution(&law, 0.2, 15) > 0.2);
}

#[test]
fn equal_inputs_give_equal_bytes() {
    let law = law(&[("friction", 0.5), ("adhesion", 1.0), ("adhesion_offset_scale", 0.000_02)]);
    assert_eq!(collapse(&law, &Plate { radius: 3.0 }), collapse(&law, &Plate { radius: 3.0 }));
}

#[test]
fn a_heap_creeps_where_the_physical_one_rests() {
    let creep = |compat| {
        let settings = Settings { compat, ..Settings::with_particles(600) };
        let heap = repose(&set(&[("friction", 0.8)]), &settings, 3).unwrap();
        println!("{compat:?}: {:.3} deg/s, {:.2} mm/s", heap.creep_deg_per_s, heap.speed_rms_mm_s);
        heap.creep_deg_per_s.abs()
    };
    let (physical, physx) = (creep(Compat::Physical), creep(Compat::Physx));
    assert!(physical < 0.02 && physx > 0.02, "{physical} deg/s and {physx} deg/s");
}

#[test]
fn settings_of_before_are_read_as_the_physical_semantics() {
    let stored: Settings =
        serde_json::from_str(r#"{"particles": 300, "substep_s": 0.0001}"#).unwrap();
    assert_eq!(stored.compat, Compat::Physical);
    assert!(serde_json::to_string(&small()).unwrap().contains(r#""compat":"physx""#));
}
