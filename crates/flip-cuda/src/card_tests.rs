//! What only a card can show. Each test prints why it is skipped where there is none.

use crate::orders::{self, Task};
use crate::twin::{self, tests::small, tests::turning, tests::uneven, tests::wet};
use crate::{Bed, Card, CardError, Poured, Result, Spoons};
use flip_core::domain::bench::Action;
use flip_sim::dispense::Dispenser;
use flip_sim::dispense::outside::State;

/// The first card; none, with the reason printed, where it cannot be opened.
pub(crate) fn card(open: fn(usize) -> Result<Card>) -> Option<Card> {
    match open(0) {
        Ok(card) => Some(card),
        Err(reason) => {
            println!("skipped: {reason}");
            None
        }
    }
}

const ACTIONS: [Action; 3] =
    [Action::once(8.0, 0.0), Action::once(8.0, 8.0), Action::once(8.0, 12.0)];

fn beds() -> Vec<Bed> {
    of(&[small(0.0, 0.4), small(0.6, 0.5), small(0.2, 0.9)])
}

/// The same of grains that turn, of some that are wet, and of unequal ones.
fn turning_beds() -> Vec<Bed> {
    of(&[turning(0.0, 0.4), wet(0.2, 0.4), uneven(0.3, 0.6)])
}

fn of(spoons: &[Dispenser]) -> Vec<Bed> {
    spoons.iter().map(|spoon| Bed::of(spoon).expect("a card knows its mechanisms")).collect()
}

/// Carries out the actions on `count` spoons; what the last one poured and the state of each.
fn run(card: &Card, beds: Vec<Bed>, count: usize) -> Result<(Vec<Poured>, Vec<State>)> {
    let mut spoons = Spoons::new(card, beds, count)?;
    let mut poured = Vec::new();
    for action in ACTIONS {
        let all: Vec<_> = (0..count).map(|spoon| (spoon, action)).collect();
        poured = spoons.step(&all)?;
    }
    let states = (0..count).map(|spoon| spoons.state(spoon)).collect::<Result<_>>()?;
    Ok((poured, states))
}

#[test]
fn without_a_driver_a_card_is_an_error_and_no_panic() {
    match Card::open(99) {
        Ok(_) => panic!("there is no hundredth card"),
        Err(error) => assert!(matches!(
            error,
            CardError::NoDriver | CardError::NoCard { number: 99, .. } | CardError::BadDriver(_)
        )),
    }
}

#[test]
fn the_exact_kernel_on_a_card_is_the_twin_in_every_bit() {
    let Some(card) = card(Card::open_exact) else { return };
    let beds = beds();
    let mut images: Vec<Vec<u32>> = beds.iter().map(|bed| bed.image.clone()).collect();
    let laws: Vec<Vec<u32>> = beds.iter().map(|bed| bed.law.clone()).collect();
    let mut spoons = Spoons::new(&card, beds.clone(), beds.len()).expect("the card works");
    let mut last: Vec<(f64, u32, f64)> =
        beds.iter().map(|bed| (0.0, bed.grains, bed.mass)).collect();
    for action in ACTIONS {
        let tasks: Vec<Task> = (0..beds.len())
            .map(|k| Task {
                spoon: k,
                law: k,
                shape: &beds[k].shape,
                pitch_deg: last[k].0,
                motion: action.into(),
                grains: last[k].1,
                mass: last[k].2,
            })
            .collect();
        let orders = orders::plan(&tasks);
        let Some((states, raw)) = twin::carry_out(&laws, &images, &orders) else { return };
        let expected = orders::poured(&tasks, &orders, &raw).expect("it makes sense");
        let found = spoons.step(&[(0, action), (1, action), (2, action)]).expect("the card works");
        assert_eq!(found, expected);
        for (k, state) in states.iter().enumerate() {
            let on_card = spoons.state(k).expect("the card works");
            assert_eq!(on_card, crate::layout::state(beds[k].kernel(), state), "spoon {k}");
        }
        last = found.iter().map(|it| (it.pitch_deg, it.kept, it.kept_mass)).collect();
        images = states;
    }
}

#[test]
fn repeats_other_spoons_threads_and_the_small_kernel_give_the_same_bytes() {
    for beds in [beds(), turning_beds()] {
        same_bytes(&beds);
    }
}

fn same_bytes(beds: &[Bed]) {
    let Some(card) = card(Card::open) else { return };
    let (poured, states) = run(&card, beds.to_vec(), 3).expect("the card works");
    assert!(poured.iter().any(|it| it.vial_mg > 0.0) && poured.iter().all(|it| it.fault.is_none()));
    let same = |what: &str, card: &Card, count: usize| {
        let (again, others) = run(card, beds.to_vec(), count).expect("the card works");
        assert_eq!(poured, again[..3], "{what}");
        assert_eq!(states, others[..3], "{what}");
    };
    same("a repeat", &card, 3);
    same("a larger batch", &card, 150);
    for threads in [32, 256, 512, 768, 896] {
        same("another number of threads", &card.clone().with_threads(threads), 3);
    }
    same("the small kernel", &Card::open_small(0).expect("it was opened before"), 3);
}

/// Short enough for a tool that watches every access.
#[test]
fn a_short_action_ends_at_rest_without_a_fault() {
    let Some(card) = card(Card::open) else { return };
    let mut spoons = Spoons::new(&card, beds(), 3).expect("the card works");
    let all: Vec<_> = (0..3).map(|spoon| (spoon, Action::once(0.5, 0.0))).collect();
    for poured in spoons.step(&all).expect("the card works") {
        assert_eq!((poured.fault, poured.vial_mg), (None, 0.0));
        assert!(poured.substeps >= 250 && poured.rebuilds >= 1);
    }
}

#[test]
fn powders_that_turn_and_others_have_tables_of_their_own() {
    let Some(card) = card(Card::open) else { return };
    let mixed = [beds(), turning_beds()].concat();
    assert!(matches!(Spoons::new(&card, mixed, 6), Err(CardError::Unfit(_))));
    let mut spoons = Spoons::new(&card, turning_beds(), 2).expect("the card works");
    assert!(matches!(spoons.put(0, beds().remove(0)), Err(CardError::Unfit(_))));
}

#[test]
fn a_spoon_is_filled_again_named_once_and_must_exist() {
    let Some(card) = card(Card::open) else { return };
    let mut spoons = Spoons::new(&card, beds(), 2).expect("the card works");
    let full = spoons.state(1).expect("the card works");
    let poured =
        spoons.step(&[(1, Action::once(8.0, 16.0)), (0, ACTIONS[0])]).expect("the card works");
    let seen = spoons.snapshot(1).expect("the card works");
    assert_eq!(seen.grains.len() as u32, poured[0].kept);
    assert!(seen.time_s > 0.0);
    assert_ne!(spoons.state(1).expect("the card works"), full);
    spoons.fill(1, 1).expect("the card works");
    assert_eq!(spoons.state(1).expect("the card works"), full);
    let twice = [(0, ACTIONS[0]), (0, ACTIONS[0])];
    assert_eq!(spoons.step(&twice), Err(CardError::Twice(0)));
    assert!(spoons.step(&[(2, ACTIONS[0])]).is_err());
    assert!(spoons.step(&[]).expect("nothing to do").is_empty());
}
