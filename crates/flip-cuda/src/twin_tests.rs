//! The kernel's source, compiled for a processor, beside flip-sim.

use super::carry_out;
use crate::Poured;
use crate::layout::{self, Kernel};
use crate::orders::{self, Orders, Task};
use flip_core::domain::bench::Action;
use flip_core::domain::parameters::ParameterSet;
use flip_sim::batch::Motion;
use flip_sim::dispense::outside::{Grain, State};
use flip_sim::dispense::{Dispenser, Settings};
use flip_sim::mechanisms::Extensions;

/// A small spoon, filled and at rest.
pub(crate) fn small(cohesion: f64, friction: f64) -> Dispenser {
    of(Dispenser::new, cohesion, friction, Extensions::default())
}

/// The same of grains that turn, of which some cling, and all are drawn to the spoon.
pub(crate) fn turning(cohesion: f64, friction: f64) -> Dispenser {
    let extensions = Extensions {
        rotation: 1.0,
        rolling_friction: 0.2,
        spoon_adhesion: 0.5,
        hold_up: 0.2,
        charge: 0.3,
        ..Extensions::default()
    };
    of(Dispenser::new, cohesion, friction, extensions)
}

/// The same of grains of unequal size, and nothing else.
pub(crate) fn sizes(cohesion: f64, friction: f64) -> Dispenser {
    let extensions = Extensions { size_spread: 0.25, ..Extensions::default() };
    of(Dispenser::new, cohesion, friction, extensions)
}

/// The same with most other mechanisms.
pub(crate) fn uneven(cohesion: f64, friction: f64) -> Dispenser {
    let extensions = Extensions {
        rotation: 1.0,
        rolling_friction: 0.2,
        size_spread: 0.25,
        consolidation: 1.0,
        humidity: 0.2,
        spoon_adhesion: 0.5,
        charge: 0.3,
        air: 1.0,
        ..Extensions::default()
    };
    of(Dispenser::new, cohesion, friction, extensions)
}

/// The same of grains that age in contact, are wet, and shaken in air.
pub(crate) fn wet(cohesion: f64, friction: f64) -> Dispenser {
    let extensions = Extensions {
        rotation: 1.0,
        rolling_friction: 0.2,
        consolidation: 3.0,
        humidity: 0.8,
        air: 2.0,
        vibration_g: 0.8,
        ..Extensions::default()
    };
    of(Dispenser::new, cohesion, friction, extensions)
}

fn kernel(dispenser: &Dispenser) -> Kernel {
    Kernel::of(&dispenser.spoon())
}

fn image(dispenser: &Dispenser) -> Vec<u32> {
    layout::image(kernel(dispenser), &dispenser.state()).expect("few grains")
}

/// Of its grains, relative to a mean one.
fn mass(dispenser: &Dispenser) -> f64 {
    let spoon = dispenser.spoon();
    dispenser.state().grains.iter().map(|grain| spoon.mass(grain.id)).sum()
}

/// How a spoon is filled: [`Dispenser::new`] or [`Dispenser::loose`].
type Fill = fn(&ParameterSet, &Settings, u64) -> Dispenser;

fn of(fill: Fill, cohesion: f64, friction: f64, extensions: Extensions) -> Dispenser {
    let set = ParameterSet::default()
        .with("cohesion", cohesion)
        .and_then(|set| set.with("friction", friction))
        .and_then(|set| set.with("adhesion", cohesion))
        .expect("they are within their bounds");
    let semi_axes_mm = [2.4, 1.7, 1.0];
    let settings = Settings { particles: 350, semi_axes_mm, extensions, ..Settings::default() };
    fill(&set, &settings, 5)
}

/// What one motion of the twin makes of a spoon.
fn moved(dispenser: &Dispenser, motion: Motion) -> Option<(State, Poured)> {
    let spoon = dispenser.spoon();
    let image = image(dispenser);
    let pitch_deg = dispenser.pitch_deg();
    let (shape, grains) = (&spoon, image[0]);
    let mass = mass(dispenser);
    let tasks = [Task { spoon: 0, law: 0, shape, pitch_deg, motion, grains, mass }];
    let orders = orders::plan(&tasks);
    let (states, raw) = carry_out(&[layout::law(&spoon)], &[image], &orders)?;
    let poured = orders::poured(&tasks, &orders, &raw).expect("it makes sense")[0];
    Some((layout::state(kernel(dispenser), &states[0]), poured))
}

/// One job for each spoon: `bodies` of its own, without rest.
fn driven(spoons: usize, bodies: &[Vec<[f32; 2]>]) -> Orders {
    let mut orders = Orders::default();
    for (place, bodies) in bodies.iter().enumerate().take(spoons) {
        orders.jobs.extend([place, 0, place, 1, place, 0, 0].map(|number| number as u32));
        orders.parts.extend([(orders.bodies.len() / 2) as u32, bodies.len() as u32, 0, 0, 0]);
        orders.bodies.extend(bodies.iter().flatten());
    }
    orders
}

/// Largest differences between two states, grain by grain: centres, velocities, wall anchors, pair
/// anchors, spins, stretches of rolling; and how many contacts were decided otherwise: they closed, slipped, or kept a liquid
/// bridge in one only, or are older there, because they were within rounding of doing so. (A contact that begins to slip takes the damping
/// into its anchor, which jumps.)
fn differences(a: &State, b: &State) -> ([f32; 6], usize) {
    let sorted = |state: &State| {
        let turning = state.turning.iter().map(|it| Some(*it)).chain(std::iter::repeat(None));
        let mut grains: Vec<_> = state.grains.iter().copied().zip(turning).collect();
        grains.sort_unstable_by_key(|(grain, _)| grain.id);
        grains
    };
    let stuck = |state: &State| {
        let rolls = state.rolls.iter().copied().chain(std::iter::repeat([0.0; 3]));
        let ages = state.ages.iter().copied().chain(std::iter::repeat(0.0));
        let all = state.stuck.iter().zip(rolls.zip(ages)).map(|((ends, anchor), (roll, age))| {
            let [i, j] = ends.map(|end| state.grains[end as usize].id);
            let sign = if i < j { 1.0 } else { -1.0 };
            ((i.min(j), i.max(j)), ([*anchor, roll].map(|it| it.map(|x| sign * x)), age))
        });
        all.collect::<std::collections::BTreeMap<_, _>>()
    };
    let (mine, theirs) = (sorted(a), sorted(b));
    assert_eq!(mine.len(), theirs.len());
    let apart =
        |x: [f32; 3], y: [f32; 3]| (0..3).fold(0.0, |most: f32, k| most.max((x[k] - y[k]).abs()));
    // An anchor's part along the normal has no effect, and a slip at exactly the limit resets it.
    let aside = |x: [f32; 3], y: [f32; 3]| {
        let (off, of) = ([0, 1, 2].map(|k| x[k] - y[k]), |k: usize| x[k]);
        let along = (0..3).map(|k| off[k] * of(k)).sum::<f32>()
            / (0..3).map(|k| of(k) * of(k)).sum::<f32>();
        (0..3).map(|k| (off[k] - along * of(k)).powi(2)).sum::<f32>().sqrt()
    };
    let (mut largest, mut single) = ([0.0f32; 6], 0);
    let mut raise = |k: usize, by: f32| largest[k] = largest[k].max(by);
    // One that rolls at exactly the limit takes the damping into its stretch.
    let rolled = |x: [f32; 3], y: [f32; 3]| Some(apart(x, y)).filter(|by| *by < 1e-5);
    for ((x, turns), (y, turned)) in mine.iter().zip(&theirs) {
        assert_eq!((x.id, x.radius), (y.id, y.radius));
        assert_eq!(turns.map(|it| it.clings), turned.map(|it| it.clings));
        if let (Some(turns), Some(turned)) = (turns, turned) {
            raise(4, apart(turns.spin, turned.spin));
            if x.wall_anchor.is_some() && y.wall_anchor.is_some() {
                match rolled(turns.wall_stretch, turned.wall_stretch) {
                    Some(by) => raise(5, by),
                    None => single += 1,
                }
            }
        }
        // Far from the spoon a float resolves less.
        if x.x.iter().all(|k| k.abs() < 16.0) {
            raise(0, apart(x.x, y.x));
        }
        raise(1, apart(x.v, y.v));
        match (x.wall_anchor, y.wall_anchor) {
            (Some(p), Some(q)) => raise(2, apart(p, q)),
            (None, None) => (),
            _ => single += 1,
        }
    }
    let bridged = |state: &State| {
        let id = |end: u32| state.grains[end as usize].id;
        let pairs = state.bridged.iter().map(|&[i, j]| (id(i).min(id(j)), id(i).max(id(j))));
        pairs.collect::<std::collections::BTreeSet<_>>()
    };
    single += bridged(a).symmetric_difference(&bridged(b)).count();
    let (mine, theirs) = (stuck(a), stuck(b));
    for (pair, ([anchor, roll], age)) in &mine {
        match theirs.get(pair) {
            Some(([other, stretch], other_age)) if aside(*anchor, *other) < 1e-5 => {
                single += usize::from(age != other_age);
                raise(3, aside(*anchor, *other));
                match rolled(*roll, *stretch) {
                    Some(by) => raise(5, by),
                    None => single += 1,
                }
            }
            Some(_) | None => single += 1,
        }
    }
    single += theirs.keys().filter(|pair| !mine.contains_key(pair)).count();
    (largest, single)
}

/// The accelerations of an incline and a shake.
fn bodies(dispenser: &Dispenser) -> Vec<[f32; 2]> {
    let spoon = dispenser.spoon();
    let plan = spoon.plan(30.0, Action::once(8.0, 12.0));
    plan.parts.iter().flat_map(|part| part.body.clone()).collect()
}

#[test]
fn one_substep_of_the_twin_is_one_of_flip_sim_to_float_rounding() {
    let (mut substeps, mut single, mut largest) = (0, 0, [0.0f32; 6]);
    let turning = [turning(0.0, 0.5), turning(0.8, 0.9), wet(0.0, 0.5), wet(0.8, 0.9)];
    let turning = turning.into_iter().chain([sizes(0.8, 0.9), uneven(0.3, 0.6)]);
    for mut dispenser in [small(0.0, 0.5), small(0.8, 0.9)].into_iter().chain(turning) {
        let bodies = bodies(&dispenser);
        let law = layout::law(&dispenser.spoon());
        // In flow and shaken: 320 substeps in ten stretches over the whole motion.
        for stretch in 0..10 {
            let begin = stretch * (bodies.len() - 40) / 10;
            let (mut before, mut after) = (Vec::new(), Vec::new());
            for body in &bodies[begin..begin + 32] {
                before.push(image(&dispenser));
                dispenser.drive(&[*body]);
                after.push(dispenser.state());
            }
            dispenser.drive(&bodies[begin + 32..(stretch + 1) * (bodies.len() - 40) / 10]);
            let each: Vec<Vec<[f32; 2]>> =
                bodies[begin..begin + 32].iter().map(|body| vec![*body]).collect();
            let orders = driven(before.len(), &each);
            let Some((states, _)) = carry_out(std::slice::from_ref(&law), &before, &orders) else {
                return;
            };
            for (state, after) in states.iter().zip(&after) {
                let (apart, alone) = differences(&layout::state(kernel(&dispenser), state), after);
                substeps += 1;
                single += alone;
                for k in 0..6 {
                    largest[k] = largest[k].max(apart[k]);
                }
            }
        }
    }
    println!(
        "{substeps} substeps: largest differences {largest:?} diameters, {single} contacts decided otherwise"
    );
    // Centres to two units in the last place of 10 diameters, velocities to what gaps and anchors
    // rounded so change (the largest share, 0.6, of 1e-6), anchors to a velocity so rounded times the
    // looseness of 20 that turns it into a stretch.
    assert!(largest[0] < 2e-6 && largest[1] < 6e-7, "{largest:?}");
    assert!(largest[2] < 1e-5 && largest[3] < 1e-5, "{largest:?}");
    // Spins to ten of such velocities (5/2 over a radius squared), which stretches add up.
    assert!(largest[4] < 6e-6 && largest[5] < 1e-5, "{largest:?}");
    // Of about 900 contacts in each, fewer than one in two thousand: a rounding of 1e-6 against gaps
    // and slips of 1e-3 and more.
    assert!(single * 2 < substeps, "{single} contacts decided otherwise");
}

#[test]
fn the_twin_has_every_mechanism_that_flip_sim_has() {
    let names = Extensions::default().amplitudes().map(|(name, _, most)| (name, 0.5 * most));
    for (name, amplitude) in names {
        // Rolling resists nothing where grains do not turn.
        let turning = Extensions { rotation: 1.0, ..Extensions::default() };
        let extensions = turning.with(name, amplitude).expect("half of the largest");
        let mut dispenser = of(Dispenser::new, 0.3, 0.6, extensions);
        let bodies = bodies(&dispenser);
        dispenser.drive(&bodies[..200]);
        let law = layout::law(&dispenser.spoon());
        let orders = driven(1, &[bodies[200..201].to_vec()]);
        let Some((states, _)) = carry_out(&[law], &[image(&dispenser)], &orders) else { return };
        dispenser.drive(&bodies[200..201]);
        let (apart, _) =
            differences(&layout::state(kernel(&dispenser), &states[0]), &dispenser.state());
        println!("{name}: {apart:?}");
        assert!(apart[1] < 6e-7 && apart[4] < 6e-6, "{name}: {apart:?}");
    }
}

#[test]
fn the_twin_stays_beside_flip_sim_for_hundreds_of_substeps() {
    for dispenser in [small(0.3, 0.6), turning(0.3, 0.6), wet(0.3, 0.6), uneven(0.3, 0.6)] {
        stays_beside(dispenser);
    }
}

fn stays_beside(mut dispenser: Dispenser) {
    let bodies = bodies(&dispenser);
    let law = layout::law(&dispenser.spoon());
    let start = image(&dispenser);
    let lengths = [1, 25, 100, 300];
    let each: Vec<Vec<[f32; 2]>> = lengths.iter().map(|n| bodies[..*n].to_vec()).collect();
    let orders = driven(lengths.len(), &each);
    let images = vec![start; lengths.len()];
    let Some((states, _)) = carry_out(&[law], &images, &orders) else { return };
    let mut done = 0;
    for (state, length) in states.iter().zip(lengths) {
        dispenser.drive(&bodies[done..length]);
        done = length;
        let (apart, single) =
            differences(&layout::state(kernel(&dispenser), state), &dispenser.state());
        println!("{length} substeps: {apart:?} diameters, {single} contacts decided otherwise");
        // A pile of grains multiplies differences from substep to substep, so the first hundred
        // are compared: in them a wrong force of a hundredth of the weight moves a grain by 0.01.
        assert!(apart[0] < if length > 100 { 0.1 } else { 1e-3 }, "{apart:?} after {length}");
    }
}

#[test]
fn a_whole_action_of_the_twin_pours_about_what_flip_sim_pours_and_loses_no_grain() {
    let dispensers =
        [small(0.0, 0.4), small(0.5, 0.6), turning(0.3, 0.6), wet(0.0, 0.4), sizes(0.0, 0.4)];
    for mut dispenser in dispensers {
        let spoon = dispenser.spoon();
        let mut image = image(&dispenser);
        let law = layout::law(&spoon);
        let (mut pitch_deg, mut grains, mut mass) = (0.0, image[0], mass(&dispenser));
        let (mut mine, mut theirs) = (0.0, 0.0);
        for action in [Action::once(8.0, 0.0), Action::once(8.0, 8.0), Action::once(8.0, 12.0)] {
            let tasks = [Task {
                spoon: 0,
                law: 0,
                shape: &spoon,
                pitch_deg,
                motion: action.into(),
                grains,
                mass,
            }];
            let orders = orders::plan(&tasks);
            let Some((states, raw)) = carry_out(std::slice::from_ref(&law), &[image], &orders)
            else {
                return;
            };
            let poured = orders::poured(&tasks, &orders, &raw).expect("it makes sense")[0];
            assert_eq!(poured.fault, None);
            let before = mass * spoon.grain_mg;
            let after = poured.vial_mg + poured.spilled_mg + poured.spoon_mg;
            assert!((before - after).abs() < 1e-9);
            let there = layout::state(kernel(&dispenser), &states[0]);
            let there = there.grains.iter().map(|grain| spoon.mass(grain.id)).sum::<f64>();
            assert!((poured.spoon_mg - there * spoon.grain_mg).abs() < 1e-9);
            let expected = dispenser.step(action);
            println!("{poured:?}\n{expected:?}");
            (mine, theirs) = (mine + poured.vial_mg, theirs + expected.vial_mg);
            pitch_deg = poured.pitch_deg;
            (grains, mass) = (poured.kept, poured.kept_mass);
            image = states[0].clone();
        }
        // Two runs that differ by rounding scatter like two seeds: a tenth of the spoon at most.
        assert!((mine - theirs).abs() < 0.1 * dispenser.spoon_mg().max(theirs), "{mine} {theirs}");
    }
}

#[test]
fn a_loose_heap_settles_on_the_twin_into_the_bed_of_flip_sim() {
    for (cohesion, friction) in [(0.0, 0.4), (0.5, 0.6)] {
        let mut dispenser = of(Dispenser::loose, cohesion, friction, Extensions::default());
        let Some((state, poured)) = moved(&dispenser, Motion::Settle) else { return };
        let duration_s = dispenser.settle();
        let expected = dispenser.state();
        assert_eq!(poured.fault, None);
        // Each grain lies on some other, so that all beds of a powder are about as high.
        let height = |state: &State| {
            let heights = state.grains.iter().map(|grain| f64::from(grain.x[2]));
            heights.sum::<f64>() / state.grains.len() as f64
        };
        let (mine, theirs) = (height(&state), height(&expected));
        let contacts = [&state, &expected].map(|it| it.stuck.len() as f64);
        println!(
            "{mine:.3} and {theirs:.3} diameters, {contacts:?} contacts; {poured:?} and {duration_s} s"
        );
        assert!((mine - theirs).abs() < 0.05, "{mine} and {theirs}");
        assert!((contacts[0] / contacts[1] - 1.0).abs() < 0.05, "{contacts:?}");
        let lost = [&state, &expected].map(|it| 350 - it.grains.len());
        assert!(lost.iter().all(|lost| *lost < 18), "{lost:?} of 350 grains rolled off");
        // It fell as long, and rested within the same time.
        let fastest =
            state.grains.iter().flat_map(|grain| grain.v).fold(0.0, |a: f32, b| a.max(b.abs()));
        let spoon = dispenser.spoon();
        assert!(fastest < spoon.rest_speed || poured.duration_s > 1.0, "{fastest}");
        assert!((poured.duration_s - duration_s).abs() < 0.5);
    }
}

#[test]
fn grains_need_not_be_in_order_and_a_spoon_that_fell_apart_is_a_fault() {
    let dispenser = small(0.0, 0.5);
    let law = layout::law(&dispenser.spoon());
    let mut state = dispenser.state();
    state.grains.push(Grain {
        id: 9999,
        radius: 0.5,
        x: [0.0, 0.0, 3.0],
        v: [0.0, 0.0, 1.5],
        contacts: 0.0,
        wall_anchor: None,
    });
    let image = layout::image(Kernel::Base, &state).expect("few grains");
    let orders = driven(1, &[vec![[0.0, -2e-4]; 32]]);
    let Some((_, raw)) = carry_out(&[law], &[image], &orders) else { return };
    let outcome = layout::outcome(&raw.outcomes);
    assert_eq!(outcome.fault, Some(crate::Fault::TooFast));
    assert_eq!(outcome.substeps, 8, "it is given up at the first check");
}

/// This state, in which the lowest grains also remember that they touched each of these, far above.
fn with_distant(state: &State, lowest: usize, partners: impl Fn(usize) -> Vec<usize>) -> State {
    let mut by_height: Vec<usize> = (0..state.grains.len()).collect();
    by_height.sort_by(|a, b| state.grains[*a].x[2].total_cmp(&state.grains[*b].x[2]));
    let mut with = state.clone();
    for (number, low) in by_height[..lowest].iter().enumerate() {
        for partner in partners(number) {
            let high = by_height[by_height.len() - 1 - partner];
            let off: [f32; 3] =
                [0, 1, 2].map(|k| state.grains[*low].x[k] - state.grains[high].x[k]);
            let apart2 = off.iter().map(|x| x * x).sum::<f32>();
            assert!(apart2 > 4.0, "they may touch");
            with.stuck.push(([*low as u32, high as u32], off));
        }
    }
    with
}

#[test]
fn grains_with_more_touching_neighbours_than_there_is_room_for_move_like_the_others() {
    let dispenser = small(0.8, 0.9);
    let law = layout::law(&dispenser.spoon());
    let state = dispenser.state();
    let cases = [
        // One grain too many, then twice the room.
        with_distant(&state, 1, |_| (0..11).collect()),
        with_distant(&state, 1, |_| (0..20).collect()),
        // Many grains that each have partners of their own, or all have the same.
        with_distant(&state, 8, |number| (0..14).map(|k| 14 * number + k).collect()),
        with_distant(&state, 8, |_| (0..14).collect()),
    ];
    let images = [vec![state], cases.into()].concat();
    let images: Vec<_> = images
        .iter()
        .map(|state| layout::image(Kernel::Base, state).expect("few grains"))
        .collect();
    let bodies = vec![bodies(&dispenser)[..40].to_vec(); images.len()];
    let Some((states, raw)) = carry_out(&[law], &images, &driven(images.len(), &bodies)) else {
        return;
    };
    let mut after = states.iter().map(|words| {
        let mut state = layout::state(Kernel::Base, words);
        state.stuck.sort_by_key(|(pair, _)| *pair);
        state
    });
    let expected = after.next().expect("the state as it was");
    for (case, state) in after.enumerate() {
        assert!(state == expected, "case {case} moved otherwise");
    }
    let outcomes = raw.outcomes.chunks(raw.outcomes.len() / images.len());
    for outcome in outcomes {
        assert_eq!(layout::outcome(outcome).fault, None);
    }
}
