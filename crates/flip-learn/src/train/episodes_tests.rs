//! Drawn episodes compared with the ones played.

use super::*;
use crate::train::environment::Step;
use crate::train::replay::{Remembered, Replay};
use crate::train::settings::{Network, Order, Preset, Replayed};
use flip_core::domain::parameters::COUNT;
use flip_policy::{Encoding, Observation};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

/// An episode with a target of 12 mg and these readings, in mg.
fn episode(readings: &[f32]) -> Vec<Memory> {
    let step = |(k, w): (usize, &[f32])| Memory {
        step: Step {
            fell_mg: 0.0,
            reading_mg: w[0],
            pitch_deg: k as f32,
            action: [0.1 * k as f32, -0.5],
            next_reading_mg: w[1],
            next_pitch_deg: k as f32 + 1.0,
            next_true_mg: w[1],
        },
        target_mg: 12.0,
        repose_deg: 0.0,
        parameters: [0.5; COUNT],
    };
    readings.windows(2).enumerate().map(step).collect()
}

fn settings(replayed: Replayed, preset: Preset, relabel_share: f64) -> Settings {
    let network = Network::Recurrent { replayed };
    let of = Settings::of(preset, Order::Random, 1);
    Settings { network, batch: 300, relabel_share, hidden: 4, replay_capacity: 30, ..of }
}

#[test]
fn episodes_are_given_back_whole_and_side_by_side() {
    let settings = settings(Replayed::StoredState, Preset::Paper, 0.0);
    let mut replay = Replay::new(&settings);
    let actor = Actor::untrained(Encoding::Paper, &[4], &mut Pcg64Mcg::seed_from_u64(1));
    replay.push(Episode::new(Vec::new(), &actor, &settings));
    replay.push(Episode { steps: episode(&[0.0, 3.0]), state: vec![1.0; 8] });
    replay.push(Episode { steps: episode(&[0.0, 2.0, 5.0]), state: vec![2.0; 8] });
    let batch = replay.draw(&settings, &mut Pcg64Mcg::seed_from_u64(1));
    let courses = batch.courses.unwrap();
    assert_eq!((courses.episodes, courses.inputs.len()), (300, 3 * 300 * 5));
    // The rows of an episode are consecutive: two steps for one of the longer kind.
    let mut rows = courses
        .at
        .iter()
        .zip(batch.now.chunks_exact(3 + COUNT + 2))
        .zip(batch.next.chunks_exact(3 + COUNT));
    let stored = courses.stored.unwrap();
    for (e, state) in stored.chunks_exact(8).enumerate() {
        let steps = state[0] as usize;
        let mut last_action = [0.0; 2];
        for step in 0..steps {
            let ((&at, now), next) = rows.next().unwrap();
            assert_eq!(at as usize, step * 300 + e);
            let course = |step: usize| &courses.inputs[(step * 300 + e) * 5..][..5];
            assert_eq!(course(step), [&now[..3], &last_action].concat());
            last_action = [0.1 * step as f32, -0.5];
            assert_eq!(now[3 + COUNT..], last_action);
            assert_eq!(course(step + 1), [&next[..3], &last_action].concat());
        }
    }
    assert!(rows.next().is_none());
    // 150 of each kind; 4 SD are 35.
    assert!((115..=185).contains(&stored.chunks_exact(8).filter(|state| state[0] == 1.0).count()));
}

#[test]
fn an_episode_asked_about_another_target_ends_where_it_would_have_ended() {
    let settings = settings(Replayed::Episodes, Preset::Flip, 1.0);
    let mut replay = Replay::new(&settings);
    replay.push(Episode { steps: episode(&[0.0, 4.0, 8.0, 11.5]), state: Vec::new() });
    let batch = replay.draw(&settings, &mut Pcg64Mcg::seed_from_u64(1));
    let courses = batch.courses.unwrap();
    assert_eq!(courses.stored, None);
    let mut lengths = [0; 3];
    let mut row = 0;
    for e in 0..300 {
        let first = row;
        // The first input is the missing mass over 10 mg, which reveals the target used.
        let target_mg = batch.now[first * (settings.encoding.width() + COUNT + 2)] * 10.0;
        assert!((2.0..15.0).contains(&target_mg));
        let expected = if target_mg < 5.0 {
            1
        } else if target_mg < 9.0 {
            2
        } else {
            3
        };
        while row < batch.reward.len() && courses.at[row] as usize % 300 == e {
            let ends = row - first + 1 == expected && target_mg < 12.5;
            assert_eq!(
                batch.goes_on[row],
                if ends { 0.0 } else { 1.0 },
                "step {} of {target_mg} mg",
                row - first
            );
            row += 1;
        }
        assert_eq!(row - first, expected, "{target_mg} mg");
        lengths[expected - 1] += 1;
    }
    // Targets are uniform over 2 to 15 mg: 3/13, 4/13 and 6/13 of 300; 4 SD are 35.
    assert!(
        lengths
            .iter()
            .zip([69, 92, 138])
            .all(|(n, expected): (&i32, i32)| (n - expected).abs() <= 35),
        "{lengths:?}"
    );
}

#[test]
fn the_stored_state_is_the_actors_after_the_first_step() {
    let settings = settings(Replayed::StoredState, Preset::Paper, 0.0);
    let count = 4 * 4 + 6 * 4 + 2 * 5 * 16 + 9 * 4 + 5 * 4 + 5 * 4;
    let flat: Vec<f32> = (0..count).map(|k| (k as f32).sin()).collect();
    let actor = Actor::recurrent(Encoding::Paper, 4, &flat).unwrap();
    let steps = episode(&[0.25, 3.0, 4.0]);
    let mut carried = actor.begin();
    let seen = Observation { reading_mg: 0.25, target_mg: 12.0, pitch_deg: 0.0 };
    actor.act(&seen, &mut carried);
    let stored = Episode::new(steps.clone(), &actor, &settings).state;
    assert_eq!(stored, carried.to_flat());
    assert!(stored.len() == 8 && stored.iter().all(|x| *x != 0.0));
    let replayed = self::settings(Replayed::Episodes, Preset::Paper, 0.0);
    assert!(Episode::new(steps, &actor, &replayed).state.is_empty());
}

#[test]
fn the_oldest_episode_is_forgotten_first_and_plain_numbers_bring_everything_back() {
    // A capacity of 30 steps is three episodes of at most ten.
    let settings = settings(Replayed::StoredState, Preset::Paper, 0.0);
    let mut replay = Replay::new(&settings);
    for k in 1..=4 {
        let readings: Vec<f32> = (0..=k).map(|r| r as f32).collect();
        replay.push(Episode { steps: episode(&readings), state: vec![k as f32; 8] });
    }
    let plain = replay.to_plain();
    assert_eq!((plain.lengths.clone(), plain.oldest), (vec![4, 2, 3], 1));
    assert_eq!(plain.states.chunks_exact(8).map(|s| s[0]).collect::<Vec<_>>(), [4.0, 2.0, 3.0]);
    assert_eq!(Replay::from_plain(&plain, &settings), Some(replay));
    let spoilt = [
        Remembered { lengths: vec![5, 2, 3], ..plain.clone() },
        Remembered { lengths: vec![4, 0, 5], ..plain.clone() },
        Remembered { lengths: vec![u32::MAX; 3], ..plain.clone() },
        Remembered { states: plain.states[1..].to_vec(), ..plain.clone() },
        Remembered { oldest: 3, ..plain },
    ];
    assert!(spoilt.iter().all(|plain| Replay::from_plain(plain, &settings).is_none()));
}
