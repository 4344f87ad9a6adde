//! The procedure on a solver outside, which is the product's own here.

use super::*;
use crate::constraints::Contact;
use crate::dispense::outside::Grain;
use crate::engine::Physical;
use crate::mechanisms::Mechanisms;
use crate::repose::repose;
use crate::walls::{Plate, Shape};

/// The product's own solver behind the interface; after so many steps it fails.
struct Outside {
    heaps: Vec<Option<Physical>>,
    steps_left: usize,
}

fn contact(of: &Strengths) -> Contact {
    let Strengths { normal, tangential, normal_damping, tangential_damping, .. } = *of;
    let Strengths { friction, attraction, onset, reach, .. } = *of;
    Contact {
        normal,
        tangential,
        normal_damping,
        tangential_damping,
        friction,
        attraction,
        onset,
        reach,
    }
}

fn begun(ground: &Ground) -> Physical {
    let law = Law {
        gravity: ground.gravity,
        drag: ground.drag,
        grain: contact(&ground.grain),
        wall: contact(&ground.wall),
        mechanisms: Mechanisms::default(),
        extended: false,
        diameter_m: 1.0,
        substep_s: 1.0,
    };
    let mut engine = Physical::under(law, &Settings::default());
    engine.plate = Shape::Plate(Plate { radius: ground.radius });
    engine
}

impl Heaps for Outside {
    fn places(&self) -> usize {
        self.heaps.len()
    }
    fn room(&self) -> u32 {
        2560
    }
    fn carry_out(&mut self, orders: &[(usize, Order)]) -> Result<Vec<Stand>, Failed> {
        if self.steps_left == 0 {
            return Err(Failed("it was taken away".to_owned()));
        }
        self.steps_left -= 1;
        let mut stands = Vec::new();
        for (place, order) in orders {
            if let Some(ground) = &order.begin {
                self.heaps[*place] = Some(begun(ground));
            }
            let heap = self.heaps[*place].as_mut().expect("it was begun");
            for [x, v] in &order.pour {
                heap.pour(vector(x[0], x[1], x[2]), vector(v[0], v[1], v[2]));
            }
            heap.advance(order.substeps);
            let grain = |x: &Vector| Grain {
                id: 0,
                x: [x[0], x[1], x[2]],
                v: [0.0; 3],
                contacts: 0.0,
                wall_anchor: None,
            };
            let grains = heap.heap().iter().map(grain).collect();
            stands.push(Stand {
                apex: heap.apex(),
                speed_rms: heap.speed_rms(),
                state: order.look.then_some(State { grains, stuck: Vec::new() }),
                fault: heap.fault(),
            });
        }
        Ok(stands)
    }
}

fn outside(places: usize, steps_left: usize) -> Outside {
    Outside { heaps: (0..places).map(|_| None).collect(), steps_left }
}

fn wanted(count: u64) -> Vec<Wanted> {
    let one = |seed| Wanted {
        set: ParameterSet::default(),
        settings: Settings { readings: 1 + seed as u32 % 2, ..Settings::with_particles(120) },
        seed,
    };
    (0..count).map(one).collect()
}

#[test]
fn a_heap_poured_outside_is_that_of_the_product_whoever_is_beside_it() {
    let all = wanted(5);
    let mut found = vec![None; 5];
    pour(&mut outside(2, usize::MAX), &all, &mut |place, outcome| {
        assert!(found[place].replace(outcome).is_none(), "heap {place} came twice");
        ControlFlow::Continue(())
    })
    .unwrap();
    for (mine, it) in found.into_iter().zip(&all) {
        let (mine, theirs) =
            (mine.unwrap().unwrap(), repose(&it.set, &it.settings, it.seed).unwrap());
        // Overlaps are summed in another order.
        let overlap_mean = theirs.overlap_mean;
        assert!((mine.overlap_mean - overlap_mean).abs() < 1e-6, "{mine:?} {theirs:?}");
        assert!((mine.overlap_max - theirs.overlap_max).abs() < 1e-6);
        let overlap_max = theirs.overlap_max;
        assert_eq!(Repose { overlap_mean, overlap_max, ..mine }, theirs);
    }
}

#[test]
fn a_solver_that_fails_and_a_break_end_it_and_what_had_ended_was_told() {
    let all = wanted(6);
    let mut told = 0;
    let mut count = |_, outcome: Result<Repose, Refusal>| {
        outcome.unwrap();
        told += 1;
        ControlFlow::Continue(())
    };
    let failed = pour(&mut outside(2, 100), &all, &mut count).unwrap_err();
    assert_eq!(failed.to_string(), "it was taken away");
    assert!(told < 6, "{told}");

    let mut told = 0;
    pour(&mut outside(1, usize::MAX), &all, &mut |_, _| {
        told += 1;
        ControlFlow::Break(())
    })
    .unwrap();
    assert_eq!(told, 1);
    pour(&mut outside(2, 0), &[], &mut |_, _| ControlFlow::Continue(())).unwrap();
}

#[test]
fn what_only_cores_compute_is_named() {
    let one = wanted(1)[0];
    let with = |settings| Wanted { settings, ..one }.fits(2560).unwrap_err().to_string();
    let usual = one.settings;
    assert!(with(Settings { rough_base: true, ..usual }).contains("rough base"));
    assert!(with(Settings { compat: Compat::Physx, ..usual }).contains("physx"));
    assert!(with(Settings { particles: 3000, ..usual }).contains("2560"));
    let mut mechanisms = usual;
    mechanisms.extensions.rotation = 1.0;
    assert!(with(mechanisms).contains("mechanisms"));
    one.fits(2560).unwrap();
}
