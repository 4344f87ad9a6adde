use super::*;
use crate::dispense::Settings;
use flip_core::domain::parameters::ParameterSet;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

/// Filled spoons of two powders, small enough to pour in milliseconds; the last one is loose.
fn beds() -> Vec<Arc<Dispenser>> {
    let bed = |friction: f64, seed, fill: fn(&ParameterSet, &Settings, u64) -> Dispenser| {
        let set = ParameterSet::default().with("friction", friction).unwrap();
        let settings =
            Settings { particles: 200, semi_axes_mm: [2.4, 1.7, 1.0], ..Settings::default() };
        Arc::new(fill(&set, &settings, seed))
    };
    let loose = Dispenser::loose;
    vec![bed(0.3, 1, Dispenser::new), bed(0.6, 2, Dispenser::new), bed(0.3, 3, loose)]
}

/// Three engines as one.
fn three() -> Arc<dyn Engine> {
    let cores: Arc<dyn Engine> = Arc::new(Cores);
    Several::of(vec![cores.clone(), cores.clone(), cores]).unwrap()
}

#[test]
fn engines_as_one_have_the_places_of_all_and_one_alone_stays_itself() {
    assert!(Several::of(Vec::new()).is_none());
    assert_eq!(Several::of(vec![Arc::new(Cores)]).unwrap().name(), Cores.name());
    assert_eq!(three().name(), "3 × the processor");
    assert_eq!(three().places(), 3 * Cores.places());
    // A batch of fewer places than engines leaves some of them out.
    for places in [1, 2, 3, 5] {
        assert_eq!(three().batch(places).unwrap().places(), places);
    }
    let broken = |place: usize| {
        let beds = beds();
        let mut batch = three().batch(5).unwrap();
        let all: Vec<_> = (0..5).map(|k| (k, &*beds[k % 2])).collect();
        batch.fill(&all).unwrap();
        batch.step(&[(place, motions(0)[0]), (5, motions(0)[0])]).unwrap_err()
    };
    assert!(broken(4).0.contains("place 5 was named, and there are 5"));
}

/// The motions of spoon `k`: it settles if it is loose, then as many actions as its number and three.
fn motions(k: usize) -> Vec<Motion> {
    let act = |n: usize| Motion::Act(Action::once(8.0, (2 * n + k % 3) as f64));
    let settle = (k % 3 == 2).then_some(Motion::Settle);
    settle.into_iter().chain((0..3 + k % 3).map(act)).chain([Motion::Level]).collect()
}

/// What a spoon gives when its motions are carried out on it alone.
fn alone(bed: &Dispenser, k: usize) -> Vec<Stand> {
    let mut spoon = bed.clone();
    let mut given = Vec::new();
    for motion in motions(k) {
        let duration_s = match motion {
            Motion::Act(action) => spoon.step(action).duration_s,
            Motion::Level => spoon.level().duration_s,
            Motion::Settle => spoon.settle(),
        };
        given.push(Stand::of(&spoon, duration_s));
    }
    given
}

#[test]
fn a_batch_on_cores_gives_the_bytes_of_each_spoon_alone_on_any_number_of_threads() {
    let beds = beds();
    let expected: Vec<Vec<Stand>> = (0..3).map(|k| alone(&beds[k], k)).collect();
    assert!(expected.iter().all(|of| of.last().unwrap().vial_mg > 0.0), "nothing was poured");
    for threads in [1, 2, 5] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            for mut batch in [Cores.batch(4).unwrap(), three().batch(4).unwrap()] {
                // Filled again: what was poured before does not count.
                batch.fill(&[(3, &beds[1]), (0, &beds[0]), (1, &beds[2])]).unwrap();
                batch.step(&[(1, motions(0)[1])]).unwrap();
                batch.fill(&[(1, &beds[1]), (3, &beds[2])]).unwrap();
                let places = [0, 1, 3];
                let mut given: Vec<Vec<Stand>> = vec![Vec::new(); 3];
                for step in 0..7 {
                    let still = |k: &usize| step < motions(*k).len();
                    // From the last to the first: answers are in the order of the motions.
                    let asked: Vec<usize> = (0..3).rev().filter(still).collect();
                    let all: Vec<_> =
                        asked.iter().map(|k| (places[*k], motions(*k)[step])).collect();
                    for (k, stand) in asked.into_iter().zip(batch.step(&all).unwrap()) {
                        given[k].push(stand);
                    }
                }
                assert_eq!(given, expected);
            }
        });
    }
}

#[test]
fn a_loose_heap_that_settles_is_a_filled_spoon() {
    let settings = Settings { particles: 200, ..Settings::default() };
    let of = |fill: fn(&ParameterSet, &Settings, u64) -> Dispenser| {
        fill(&ParameterSet::default(), &settings, 4)
    };
    let (mut loose, filled) = (of(Dispenser::loose), of(Dispenser::new));
    assert_ne!(loose.snapshot(), filled.snapshot());
    assert!(loose.settle() > 0.0);
    assert_eq!(loose.snapshot(), filled.snapshot());
}

#[test]
fn places_are_named_once_and_exist_and_hold_a_spoon() {
    for batch in [Cores.batch(2).unwrap(), three().batch(2).unwrap()] {
        are_named_once_and_exist_and_hold_a_spoon(batch);
    }
}

fn are_named_once_and_exist_and_hold_a_spoon(mut batch: Box<dyn Batch>) {
    let beds = beds();
    let act = motions(0)[0];
    assert!(batch.fill(&[(2, &beds[0])]).unwrap_err().0.contains("there are 2"));
    assert!(batch.step(&[(0, act)]).unwrap_err().0.contains("place 0 is empty"));
    batch.fill(&[(0, &beds[0])]).unwrap();
    assert!(batch.step(&[(0, act), (0, act)]).unwrap_err().0.contains("named twice"));
    assert!(batch.step(&[(5, act)]).unwrap_err().0.contains("place 5"));
    assert_eq!(batch.step(&[]), Ok(Vec::new()));
}

/// What procedures 0 to `count` give: all stands of a spoon of bed `k % 3`, which pours as often as
/// [`motions`] says.
fn procedures(places: usize, count: usize) -> Vec<Vec<Stand>> {
    let beds = beds();
    let mut batch = Cores.batch(places).unwrap();
    let mut given = vec![Vec::new(); count];
    let procedure = |k: usize, place: &mut Place| {
        let mut seat = place.fill(&beds[k % 3]).unwrap();
        let mut stands = Vec::new();
        for motion in motions(k) {
            let duration_s = seat.carry_out(motion);
            assert_eq!(duration_s, seat.stand().duration_s);
            stands.push(seat.stand().clone());
        }
        stands
    };
    let mut each = |k: usize, stands| {
        given[k] = stands;
        ControlFlow::Continue(())
    };
    side_by_side(&mut *batch, count, procedure, &mut each).unwrap();
    given
}

#[test]
fn procedures_side_by_side_see_what_they_see_alone_however_many_places_there_are() {
    let beds = beds();
    let expected: Vec<Vec<Stand>> = (0..8).map(|k| alone(&beds[k % 3], k)).collect();
    for places in [1, 3, 8, 20] {
        assert_eq!(procedures(places, 8), expected, "{places} places");
    }
    assert!(procedures(2, 0).is_empty());
}

#[test]
fn after_a_break_no_further_procedure_begins() {
    let beds = beds();
    let begun = AtomicUsize::new(0);
    let mut batch = Cores.batch(2).unwrap();
    let procedure = |_: usize, place: &mut Place| {
        begun.fetch_add(1, Ordering::SeqCst);
        place.fill(&beds[0]).unwrap().carry_out(Motion::Level)
    };
    let mut heard = 0;
    let mut each = |_, _| {
        heard += 1;
        if heard < 3 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    };
    side_by_side(&mut *batch, 100, procedure, &mut each).unwrap();
    assert!((3..=4).contains(&begun.into_inner()), "one more may have begun beside the third");
}

/// Fails at the third step.
struct Frail(Box<dyn Batch>, usize);

impl Batch for Frail {
    fn places(&self) -> usize {
        self.0.places()
    }
    fn fill(&mut self, beds: &[(usize, &Dispenser)]) -> Result<(), Failed> {
        self.0.fill(beds)
    }
    fn step(&mut self, motions: &[(usize, Motion)]) -> Result<Vec<Stand>, Failed> {
        self.1 += 1;
        if self.1 == 3 { Err(Failed("it broke".to_owned())) } else { self.0.step(motions) }
    }
}

#[test]
fn a_batch_that_fails_is_a_fault_of_every_spoon_and_an_error_and_nobody_waits_for_ever() {
    let beds = beds();
    let mut batch = Frail(Cores.batch(3).unwrap(), 0);
    let faults = Mutex::new(Vec::new());
    let procedure = |k: usize, place: &mut Place| {
        let Ok(mut seat) = place.fill(&beds[k % 3]) else { return };
        for motion in motions(2) {
            seat.carry_out(motion);
        }
        faults.lock().unwrap().push(seat.fault().map(str::to_owned));
    };
    let mut each = |_, ()| ControlFlow::Continue(());
    let ended = side_by_side(&mut batch, 50, procedure, &mut each);
    assert_eq!(ended, Err(Failed("it broke".to_owned())));
    let faults = faults.into_inner().unwrap();
    assert!(
        (1..=3).contains(&faults.len())
            && faults.iter().all(|it| it.as_deref() == Some("it broke")),
        "{faults:?}"
    );
}

#[test]
#[should_panic(expected = "the fourth")]
fn a_panic_of_a_procedure_goes_on_in_the_caller() {
    let beds = beds();
    let mut batch = Cores.batch(2).unwrap();
    let procedure = |k: usize, place: &mut Place| {
        let mut seat = place.fill(&beds[0]).unwrap();
        assert!(k != 3, "the fourth");
        seat.carry_out(Motion::Level);
    };
    let mut each = |_, ()| ControlFlow::Continue(());
    let _ = side_by_side(&mut *batch, 6, procedure, &mut each);
}
