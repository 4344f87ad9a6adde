//! The card and the cores through the interface that both have.

use crate::card_tests::card;
use crate::orders::on_all;
use crate::twin::tests::{small, turning};
use crate::{Bed, Card};
use flip_core::domain::bench::Action;
use flip_core::domain::parameters::ParameterSet;
use flip_sim::batch::{Cores, Engine, Failed, Filled, Motion, Place, side_by_side};
use flip_sim::dispense::{Dispenser, Settings};
use flip_sim::mechanisms::Extensions;
use std::ops::ControlFlow;
use std::sync::Arc;

/// Spoons of each powder: with 192 an engine that is the same fails a test once in a thousand times.
const RUNS: u64 = 192;
/// The 95 % quantile of Student's t for two samples of 192.
const T: f64 = 1.649;

/// Two powders, a third whose grains turn and are drawn to the spoon, and a wet one of unequal grains that ages.
fn powders() -> [(ParameterSet, Settings); 4] {
    let turning = Extensions {
        rotation: 1.0,
        rolling_friction: 0.2,
        spoon_adhesion: 0.5,
        hold_up: 0.1,
        ..Extensions::default()
    };
    let wet = Extensions {
        consolidation: 0.3,
        humidity: 0.1,
        air: 1.0,
        size_spread: 0.15,
        vibration_g: 0.2,
        ..Extensions::default()
    };
    let none = Extensions::default();
    [(0.3, 0.0, none), (0.6, 0.5, none), (0.5, 0.0, turning), (0.3, 0.0, wet)].map(
        |(friction, cohesion, extensions)| {
            let set =
                ParameterSet::default().with("friction", friction).expect("within its bounds");
            let set = set.with("cohesion", cohesion).expect("within its bounds");
            (set, Settings { extensions, ..Settings::default() })
        },
    )
}

/// What every spoon has poured after a tilt, and after a shake there, mg.
fn poured(engine: &dyn Engine, beds: &[Dispenser]) -> Result<Vec<[f64; 2]>, Failed> {
    let mut batch = engine.batch(beds.len())?;
    let filled: Vec<_> = beds.iter().enumerate().collect();
    batch.fill(&filled)?;
    let mut all = |motion: Motion| -> Result<Vec<f64>, Failed> {
        let motions: Vec<_> = (0..beds.len()).map(|place| (place, motion)).collect();
        let stands = batch.step(&motions)?;
        assert!(stands.iter().all(|it| it.fault.is_none()));
        Ok(stands.iter().map(|it| it.vial_mg).collect())
    };
    for _ in 0..3 {
        all(Motion::Act(Action::once(8.0, 0.0)))?;
    }
    let tilted = all(Motion::Act(Action::once(8.0, 0.0)))?;
    let shaken = all(Motion::Act(Action::once(0.0, 8.0)))?;
    let level = all(Motion::Level)?;
    assert!(level.iter().zip(&shaken).all(|(after, before)| after >= before));
    Ok(tilted.into_iter().zip(shaken).map(|(a, b)| [a, b]).collect())
}

/// Two one-sided tests at 5 %: the means differ by less than half of the scatter of one run.
fn are_equivalent(cpu: &[f64], card: &[f64]) -> bool {
    let n = cpu.len() as f64;
    let moments = |values: &[f64]| {
        let mean = values.iter().sum::<f64>() / n;
        (mean, values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0))
    };
    let ((a, va), (b, vb)) = (moments(cpu), moments(card));
    println!("{a:.3} +- {:.3} and {b:.3} +- {:.3} mg", va.sqrt(), vb.sqrt());
    (va == 0.0 && vb == 0.0 && a == b)
        || (b - a).abs() + T * ((va + vb) / n).sqrt() < 0.5 * va.sqrt()
}

#[test]
fn a_card_pours_what_the_cores_pour_within_half_of_the_scatter_of_one_run() {
    let Some(card) = card(Card::open) else { return };
    for (set, settings) in powders() {
        let seeds: Vec<u64> = (0..RUNS).collect();
        let beds = on_all(&seeds, |_, seed| Dispenser::new(&set, &settings, *seed));
        let cpu = poured(&Cores, &beds).expect("the cores compute");
        let on_card = poured(&card, &beds).expect("the card computes");
        for what in [0, 1] {
            let of = |all: &[[f64; 2]]| all.iter().map(|it| it[what]).collect::<Vec<_>>();
            assert!(are_equivalent(&of(&cpu), &of(&on_card)), "{set:?}, {settings:?}: {what}");
        }
    }
}

#[test]
fn a_place_on_a_card_is_filled_again_with_another_powder_and_counts_from_then() {
    let Some(card) = card(Card::open) else { return };
    let (easy, hard) = (small(0.0, 0.3), turning(0.6, 0.9));
    let act = Motion::Act(Action::once(8.0, 12.0));
    let fresh = |bed: &Dispenser| {
        let mut batch = card.batch(1).expect("it has memory");
        batch.fill(&[(0, bed)]).expect("it computes");
        batch.step(&[(0, act)]).expect("it computes")
    };
    let mut batch = card.batch(3).expect("it has memory");
    batch.fill(&[(1, &easy), (2, &hard)]).expect("it computes");
    batch.step(&[(2, act), (1, act)]).expect("it computes");
    batch.fill(&[(1, &hard), (2, &easy)]).expect("it computes");
    let both = batch.step(&[(1, act), (2, act)]).expect("it computes");
    assert_eq!(both[..1], fresh(&hard)[..]);
    assert_eq!(both[1..], fresh(&easy)[..]);
    assert!(batch.step(&[(0, act)]).unwrap_err().0.contains("empty"));
    assert!(batch.step(&[(1, act), (1, act)]).unwrap_err().0.contains("twice"));
    assert!(batch.fill(&[(3, &easy)]).is_err());
}

#[test]
fn procedures_side_by_side_on_a_card_are_the_same_bytes_whoever_is_beside_them() {
    let Some(card) = card(Card::open) else { return };
    let beds = [small(0.0, 0.4), turning(0.6, 0.5)].map(Arc::new);
    let poured = |places: usize| {
        let mut batch = card.batch(places).expect("it has memory");
        let mut given = vec![0; 12];
        let procedure = |k: usize, place: &mut Place| {
            let mut seat = place.fill(&beds[k % 2]).expect("it computes");
            for shake in 0..2 + k % 3 {
                seat.carry_out(Motion::Act(Action::once(8.0, 3.0 * shake as f64)));
            }
            seat.carry_out(Motion::Level);
            assert_eq!(seat.fault(), None);
            seat.vial_mg().to_bits()
        };
        let mut each = |k: usize, bits| {
            given[k] = bits;
            ControlFlow::Continue(())
        };
        side_by_side(&mut *batch, 12, procedure, &mut each).expect("it computes");
        given
    };
    let one = poured(1);
    assert!(one.iter().any(|bits| f64::from_bits(*bits) > 0.0), "nothing was poured");
    assert_eq!(poured(5), one);
    assert_eq!(poured(12), one);
}

#[test]
fn what_a_card_cannot_compute_is_refused_in_words() {
    let settings = Settings { particles: 2600, ..Settings::default() };
    let full = Dispenser::loose(&ParameterSet::default(), &settings, 1);
    let refused = Bed::of(&full).expect_err("there is no room for its grains");
    assert!(refused.to_string().contains("2600 grains"), "{refused}");
}
