//! The procedure on a solver outside, which is the product's own here.

use super::*;
use crate::batch::{self, Batch, Cores, Several};
use crate::mechanisms::Extensions;
use crate::repose::repose;
use std::sync::Arc;

/// The cores, which fail after so many steps.
struct Outside {
    heaps: Box<dyn Heaps>,
    steps_left: usize,
}

impl Heaps for Outside {
    fn places(&self) -> usize {
        self.heaps.places()
    }
    fn room(&self) -> u32 {
        2560
    }
    fn carry_out(&mut self, orders: &[(usize, Order)]) -> Result<Vec<Stand>, Failed> {
        if self.steps_left == 0 {
            return Err(Failed("it was taken away".to_owned()));
        }
        self.steps_left -= 1;
        self.heaps.carry_out(orders)
    }
}

fn on_cores(places: usize) -> Box<dyn Heaps> {
    batch::Engine::heaps(&Cores, places).unwrap().unwrap()
}

fn outside(places: usize, steps_left: usize) -> Outside {
    Outside { heaps: on_cores(places), steps_left }
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
    let mut all = wanted(7);
    all[5].settings.extensions = Extensions { size_spread: 0.2, ..Extensions::default() };
    let every = Extensions {
        rotation: 0.8,
        rolling_friction: 0.2,
        size_spread: 0.1,
        consolidation: 1.0,
        humidity: 0.4,
        spoon_adhesion: 1.0,
        hold_up: 0.5,
        vibration_g: 0.01,
        charge: 0.5,
        air: 1.0,
    };
    all[6].settings.extensions = every;
    let mut found = vec![None; all.len()];
    pour(&mut [&mut outside(2, usize::MAX)], &all, &mut |place, outcome| {
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
    let failed = pour(&mut [&mut outside(2, 100)], &all, &mut count).unwrap_err();
    assert_eq!(failed.to_string(), "it was taken away");
    assert!(told < 6, "{told}");

    let mut told = 0;
    pour(&mut [&mut outside(1, usize::MAX)], &all, &mut |_, _| {
        told += 1;
        ControlFlow::Break(())
    })
    .unwrap();
    assert_eq!(told, 1);
    pour(&mut [&mut outside(2, 0)], &[], &mut |_, _| ControlFlow::Continue(())).unwrap();
}

/// Two places alone, with heaps or without.
struct Two(bool);

impl batch::Engine for Two {
    fn name(&self) -> String {
        "two places".to_owned()
    }
    fn places(&self) -> usize {
        2
    }
    fn batch(&self, places: usize) -> Result<Box<dyn Batch>, Failed> {
        batch::Engine::batch(&Cores, places)
    }
    fn heaps(&self, places: usize) -> Result<Option<Box<dyn Heaps>>, Failed> {
        Ok(self.0.then(|| on_cores(places)))
    }
}

fn several(with_heaps: [bool; 3]) -> Arc<dyn batch::Engine> {
    Several::of(with_heaps.map(|it| Arc::new(Two(it)) as Arc<dyn batch::Engine>).into()).unwrap()
}

#[test]
fn heaps_dealt_out_to_several_engines_are_those_of_one() {
    let all = wanted(7);
    let poured = |heaps: &mut dyn Heaps| {
        let mut found = vec![None; all.len()];
        pour(&mut [heaps], &all, &mut |place, outcome| {
            found[place] = Some(outcome);
            ControlFlow::Continue(())
        })
        .unwrap();
        found
    };
    let alone = poured(&mut *on_cores(7));
    assert!(alone.iter().all(|it| matches!(it, Some(Ok(_)))));
    // Fewer places than engines leave some of them out.
    for places in [2, 5] {
        let mut heaps = several([true; 3]).heaps(places).unwrap().unwrap();
        assert_eq!((heaps.places(), heaps.room()), (places, on_cores(1).room()));
        assert_eq!(poured(&mut *heaps), alone, "{places} places");
    }
    assert!(several([true, false, true]).heaps(5).unwrap().is_none());
}

#[test]
fn places_for_heaps_exist_and_are_named_once_and_begun() {
    let first = || {
        let ground = Some(wanted(1)[0].ground());
        Order { begin: ground, pour: Vec::new(), substeps: 0, look: false }
    };
    let on = Order { begin: None, ..first() };
    for mut heaps in [on_cores(5), several([true; 3]).heaps(5).unwrap().unwrap()] {
        let mut said = |orders: &[(usize, Order)]| heaps.carry_out(orders).unwrap_err().0;
        assert!(said(&[(4, first()), (5, first())]).contains("place 5 was named, and there are 5"));
        assert!(said(&[(3, first()), (3, first())]).contains("place 3 is named twice"));
        assert!(said(&[(2, on.clone())]).contains("is empty"));
        assert_eq!(heaps.carry_out(&[(4, first()), (1, first())]).unwrap().len(), 2);
    }
}

#[test]
fn what_only_cores_compute_is_named() {
    let one = wanted(1)[0];
    let with = |settings| Wanted { settings, ..one }.fits(2560).unwrap_err().to_string();
    let usual = one.settings;
    assert!(with(Settings { rough_base: true, ..usual }).contains("rough base"));
    assert!(with(Settings { compat: Compat::Physx, ..usual }).contains("physx"));
    assert!(with(Settings { particles: 3000, ..usual }).contains("2560"));
    one.fits(2560).unwrap();
}
