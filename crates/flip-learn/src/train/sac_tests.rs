//! The losses and the update against an independent implementation, finite differences and known limits.

use super::*;
use crate::train::episodes::interleave;
use crate::train::replay::Courses;
use crate::train::settings::{FineTuning, Network, Order, Preset, Replayed};
use flip_core::domain::parameters::COUNT;
use flip_policy::Encoding;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde_json::Value;
use tch::Kind;

/// Each network and loss with its reference, made by `tests/reference/sac_update.py` and `sac_recurrent_update.py`.
fn references() -> Vec<(Network, CriticLoss, Value)> {
    let read = |text: &str| serde_json::from_str::<Value>(text).unwrap();
    let mut recurrent = read(include_str!("../../../../tests/reference/sac_recurrent_update.json"));
    let network = |replayed| Network::Recurrent { replayed };
    vec![
        (Network::FeedForward, CriticLoss::Squared, read(include_str!("../../../../tests/reference/sac_update.json"))),
        (network(Replayed::StoredState), CriticLoss::Huber, recurrent["stored_state"].take()),
        (network(Replayed::Episodes), CriticLoss::Squared, recurrent["episodes"].take()),
    ]
}

fn numbers(value: &Value) -> Vec<f32> {
    value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap() as f32).collect()
}

/// The learner, settings, batch and noise that a reference starts from.
fn start((network, critic_loss, reference): &(Network, CriticLoss, Value)) -> (Learner, Settings, Batch, Vec<f32>) {
    let number = |key: &str| reference[key].as_f64().unwrap();
    let recurrent = *network != Network::FeedForward;
    let settings = Settings {
        network: *network,
        critic_loss: *critic_loss,
        encoding: if recurrent { Encoding::Paper } else { Encoding::Missing },
        hidden: number("hidden") as u32,
        batch: number("batch") as u32,
        gamma: number("gamma"),
        tau: number("tau"),
        learning_rate: number("learning_rate"),
        target_entropy: number("target_entropy"),
        initial_alpha: number("alpha"),
        ..Settings::of(Preset::Flip, Order::Curriculum, 1)
    };
    let mut learner = Learner::new(&settings, &mut Pcg64Mcg::seed_from_u64(1));
    learner.actor = numbers(&reference["actor"]);
    learner.critics = numbers(&reference["critics"]);
    learner.targets = numbers(&reference["targets"]);
    let courses = recurrent.then(|| {
        let courses = &reference["courses"];
        Courses {
            episodes: settings.batch as usize,
            inputs: numbers(&courses["inputs"]),
            at: courses["at"].as_array().unwrap().iter().map(|x| x.as_i64().unwrap()).collect(),
            stored: (!courses["stored"].is_null()).then(|| numbers(&courses["stored"])),
        }
    });
    let batch = Batch {
        now: numbers(&reference["now"]),
        next: numbers(&reference["next"]),
        reward: numbers(&reference["reward"]),
        goes_on: numbers(&reference["goes_on"]),
        courses,
    };
    (learner, settings, batch, numbers(&reference["noise"]))
}

/// f32 against f64: 2e-5 of the size, or of one.
fn assert_close(what: &str, ours: &[f32], expected: &[f32]) {
    assert_eq!(ours.len(), expected.len(), "{what}");
    for (k, (a, b)) in ours.iter().zip(expected).enumerate() {
        assert!((a - b).abs() < 2e-5 * b.abs().max(1.0), "{what}[{k}]: {a}, reference {b}");
    }
}

#[test]
fn one_update_equals_an_independent_implementation() {
    for reference in &references() {
        let expected = &reference.2["expected"];
        let (mut learner, settings, batch, noise) = start(reference);

        let (_, next) = learner.seen(&batch);
        let first = Tensor::from_slice(&noise).view([2, -1, 2]).get(0);
        let y = learner.target(&next, &first, &batch, learner.alpha(), settings.gamma);
        assert_close("y", &Vec::try_from(y).unwrap(), &numbers(&expected["y"]));

        let losses = learner.update(&batch, &noise, &settings);
        let number = |key: &str| expected[key].as_f64().unwrap() as f32;
        assert_close("critic loss", &[losses.critic as f32], &[number("critic_loss")]);
        assert_close("actor loss", &[losses.actor as f32], &[number("actor_loss")]);
        assert_close("entropy", &[losses.entropy as f32], &[number("entropy")]);
        // Adam's first moment after one step is a tenth of the gradient.
        let gradient = |adam: &Adam| adam.m.iter().map(|m| m * 10.0).collect::<Vec<f32>>();
        assert_close("critics' gradient", &gradient(&learner.critics_adam), &numbers(&expected["critic_gradient"]));
        assert_close("actor's gradient", &gradient(&learner.actor_adam), &numbers(&expected["actor_gradient"]));
        assert_close("critics", &learner.critics, &numbers(&expected["critics"]));
        assert_close("actor", &learner.actor, &numbers(&expected["actor"]));
        assert_close("targets", &learner.targets, &numbers(&expected["targets"]));
        assert_close("log alpha", &learner.log_alpha, &[number("log_alpha")]);
    }
}

#[test]
fn the_actor_that_comes_out_is_the_mean_of_what_it_was_or_the_last_one() {
    let (mut learner, settings, batch, noise) = start(&references()[0]);
    let from = |averaged_updates| FineTuning { policy: "p".into(), held_updates: 2, averaged_updates };
    let averaging = Settings { from: Some(from(4)), ..settings.clone() };
    learner.take(learner.actor.clone());
    let mut actors = vec![learner.actor.clone()];
    for _ in 0..6 {
        learner.update(&batch, &noise, &averaging);
        actors.push(learner.actor.clone());
    }
    // Held for two updates; each of the other four counts for a quarter of what is left.
    assert!(actors[0] == actors[2] && actors[2] != actors[3]);
    let weights = [0.75f64.powi(4), 0.25 * 0.75f64.powi(3), 0.25 * 0.75f64.powi(2), 0.25 * 0.75, 0.25];
    let mean =
        |k: usize| weights.iter().zip(&actors[2..]).map(|(w, actor)| w * f64::from(actor[k])).sum::<f64>() as f32;
    assert_close("averaged", &learner.averaged, &(0..learner.actor.len()).map(mean).collect::<Vec<_>>());
    for last in [Settings { from: Some(from(0)), ..settings.clone() }, settings] {
        learner.update(&batch, &noise, &last);
        assert_eq!(learner.averaged, learner.actor);
    }
}

#[test]
fn gradients_equal_finite_differences_of_the_losses() {
    // In f64, so that differences of 1e-6 are not drowned in rounding.
    let double = |values: &[f32]| Tensor::from_slice(&values.iter().map(|&x| f64::from(x)).collect::<Vec<_>>());
    for reference in &references() {
        let (learner, _, batch, noise) = start(reference);
        let ((now, action), _) = learner.seen(&batch);
        let action = action.to_kind(Kind::Double);
        let now = Seen { rows: now.rows.to_kind(Kind::Double), course: now.course.map(|c| c.to_kind(Kind::Double)) };
        let noise = double(&noise).view([2, -1, 2]).get(1);
        let y = double(&numbers(&reference.2["expected"]["y"]));
        let critics = double(&learner.critics).view([2, -1]);
        let of_critics =
            |flat: &Tensor| critic_loss(&learner.networks.values(&flat.view([2, -1]), &now, &action), &y, reference.1);
        let of_actor = |flat: &Tensor| {
            let (action, log_prob) = squash(&learner.networks.head(flat, &now), &noise);
            actor_loss(&learner.networks.values(&critics, &now, &action), &log_prob, 0.3)
        };
        check_gradient("critics", &double(&learner.critics), of_critics);
        check_gradient("actor", &double(&learner.actor), of_actor);
    }
}

fn check_gradient(what: &str, at: &Tensor, loss: impl Fn(&Tensor) -> Tensor) {
    let block = at.copy().set_requires_grad(true);
    let gradient = Vec::<f64>::try_from(&Tensor::run_backward(&[loss(&block)], &[&block], false, false)[0]).unwrap();
    let step = 1e-6;
    for k in (0..gradient.len()).step_by(7) {
        let value = |offset: f64| {
            let moved = at.copy();
            let _ = moved.get(k as i64).g_add_scalar_(offset);
            loss(&moved).double_value(&[])
        };
        let numeric = (value(step) - value(-step)) / (2.0 * step);
        assert!((numeric - gradient[k]).abs() < 1e-5, "{what}[{k}]: {numeric} {}", gradient[k]);
    }
}

#[test]
fn log_probabilities_stay_finite_and_right_where_tanh_saturates() {
    let head = |mean: f32, log_std: f32| Tensor::from_slice(&[mean, mean, log_std, log_std]).view([1, 4]);
    let log_prob = |mean: f32, log_std: f32, noise: f32| {
        let (action, log_prob) = squash(&head(mean, log_std), &Tensor::from_slice(&[noise, noise]).view([1, 2]));
        assert!(f64::try_from(action.abs().max()).unwrap() <= 1.0);
        f64::try_from(log_prob).unwrap()
    };
    // At the centre: two densities of N(0, 1) at 0, slope of tanh is 1.
    assert!((log_prob(0.0, 0.0, 0.0) + (2.0 * std::f64::consts::PI).ln()).abs() < 1e-5);
    // Far out ln(1 - tanh(u)^2) tends to 2 ln 2 - 2 |u|: the naive form is -inf beyond |u| = 9 in f32.
    for u in [50.0f32, -50.0, 1000.0] {
        let expected =
            -(2.0 * std::f64::consts::PI).ln() - 2.0 * (2.0 * std::f64::consts::LN_2 - 2.0 * f64::from(u).abs());
        assert!((log_prob(u, 0.0, 0.0) / expected - 1.0).abs() < 1e-5);
    }
    for (mean, log_std, noise) in [(0.0, -100.0, 3.0), (0.0, 100.0, -5.0), (1e6, 2.0, 6.0), (-1e6, -20.0, -6.0)] {
        assert!(log_prob(mean, log_std, noise).is_finite(), "{mean} {log_std} {noise}");
    }
}

#[test]
fn probabilities_of_the_squashed_gaussian_sum_to_one() {
    // Integrate exp(log pi) over the action by the change of variables a = tanh(mean + std * noise), one dimension at a time.
    let (mean, log_std) = (0.4f32, -0.3f32);
    let grid: Vec<f32> = (0..4000).map(|k| -0.99975 + 0.0005 * k as f32).collect();
    let std = log_std.exp();
    let noise: Vec<f32> = grid.iter().flat_map(|a| [(a.atanh() - mean) / std, 0.0]).collect();
    let n = grid.len() as i64;
    let head = Tensor::from_slice(&[mean, 0.0, log_std, 0.0]).expand([n, 4], false);
    let (_, log_prob) = squash(&head, &Tensor::from_slice(&noise).view([n, 2]));
    // The second dimension sits at its centre with density 1 / sqrt(2 pi) on either side of the product.
    let sum = f64::try_from(log_prob.exp().sum(Kind::Double)).unwrap() * 0.0005 * (2.0 * std::f64::consts::PI).sqrt();
    assert!((sum - 1.0).abs() < 2e-3, "{sum}");
}

#[test]
fn a_time_out_is_bootstrapped_and_a_termination_is_not() {
    let next_q = Tensor::from_slice(&[5.0f32, 5.0, 7.0, 4.0]).view([2, 2]);
    let (reward, goes_on) = (Tensor::from_slice(&[1.0f32, 1.0]), Tensor::from_slice(&[0.0f32, 1.0]));
    let y = td_target(&reward, &goes_on, &next_q, &Tensor::from_slice(&[-1.0f32, -1.0]), 0.5, 0.9);
    // The smaller twin's 4, half a nat of bonus, discounted.
    assert_eq!(Vec::<f32>::try_from(y).unwrap(), [1.0, 1.0 + 0.9 * 4.5]);
}

#[test]
fn the_temperature_rises_when_the_policy_is_too_sure() {
    // Entropy 1 nat below its target: log-probability is above minus the target.
    assert!(temperature_gradient(0.2, 3.0, -2.0) < 0.0);
    assert!(temperature_gradient(0.2, 1.0, -2.0) > 0.0);
    assert_eq!(temperature_gradient(0.2, 2.0, -2.0), 0.0);
}

#[test]
fn a_bandit_with_a_known_answer_is_solved() {
    // One state, reward -(a - 0.5)^2 in both actions, every step ends: the centre of the policy goes to 0.5.
    let settings =
        Settings { hidden: 32, batch: 64, learning_rate: 3e-3, ..Settings::of(Preset::Flip, Order::Curriculum, 1) };
    let mut rng = Pcg64Mcg::seed_from_u64(2);
    let mut learner = Learner::new(&settings, &mut rng);
    let inputs = settings.encoding.width();
    for _ in 0..600 {
        let mut batch = Batch::default();
        for _ in 0..settings.batch {
            let action: [f32; 2] = std::array::from_fn(|_| 2.0 * rng.random::<f32>() - 1.0);
            batch.now.extend(vec![0.5; inputs + COUNT]);
            batch.now.extend(action);
            batch.next.extend(vec![0.5; inputs + COUNT]);
            batch.reward.push(-3.0 * action.iter().map(|a| (a - 0.5).powi(2)).sum::<f32>());
            batch.goes_on.push(0.0);
        }
        let noise: Vec<f32> = (0..4 * settings.batch).map(|_| flip_policy::normal(&mut rng)).collect();
        learner.update(&batch, &noise, &settings);
    }
    let actor = learner.snapshot(&settings).unwrap();
    let head = actor.forward(&vec![0.5; inputs], &mut actor.begin());
    assert!(head.mean.iter().all(|m| (m.tanh() - 0.5).abs() < 0.1), "{:?}", head.mean.map(f32::tanh));
}

#[test]
fn hubers_loss_is_linear_beyond_a_difference_of_one() {
    // Differences 0.5 and -3 in each twin: (0.125 + 2.5) / 2 for one, twice that for both; squared (0.125 + 4.5) / 2.
    let (q, y) = (Tensor::from_slice(&[1.5f32, 1.0, 1.5, 1.0]).view([2, 2]), Tensor::from_slice(&[1.0f32, 4.0]));
    assert!((critic_loss(&q, &y, CriticLoss::Huber).double_value(&[]) - 2.625).abs() < 1e-6);
    assert!((critic_loss(&q, &y, CriticLoss::Squared).double_value(&[]) - 4.625).abs() < 1e-6);
}

/// How strongly a cue shows.
const CUE: f32 = 3.0;

/// Three steps: a cue of -1 or 1 at the first, nothing to be seen later, and at the others a reward of `-3 sum (a - 0.6 cue)^2`.
fn push_cued_episode(batch: &mut Batch, courses: &mut Vec<Vec<f32>>, inputs: usize, rng: &mut Pcg64Mcg) {
    let cue = if rng.random::<bool>() { 1.0 } else { -1.0 };
    let seen = |step: u32| vec![if step == 0 { CUE * cue } else { 0.0 }; inputs];
    let mut course = [seen(0), vec![0.0; OUTPUTS]].concat();
    for step in 0..3 {
        let action: [f32; OUTPUTS] = std::array::from_fn(|_| 2.0 * rng.random::<f32>() - 1.0);
        batch.now.extend([seen(step), vec![0.5; COUNT], action.to_vec()].concat());
        batch.next.extend([seen(step + 1), vec![0.5; COUNT]].concat());
        let error: f32 = action.iter().map(|a| (a - 0.6 * cue).powi(2)).sum();
        batch.reward.push(if step > 0 { -3.0 * error } else { 0.0 });
        batch.goes_on.push(if step == 2 { 0.0 } else { 1.0 });
        course.extend([seen(step + 1), action.to_vec()].concat());
    }
    courses.push(course);
}

/// Mean absolute distance of the last action from the right one after this many updates.
fn error_after_a_cue(network: Network, updates: u32) -> f32 {
    let settings = Settings {
        network,
        hidden: 32,
        batch: 32,
        learning_rate: 3e-3,
        gamma: 0.5,
        ..Settings::of(Preset::Flip, Order::Curriculum, 1)
    };
    let mut rng = Pcg64Mcg::seed_from_u64(7);
    let mut learner = Learner::new(&settings, &mut rng);
    let inputs = settings.encoding.width();
    for _ in 0..updates {
        let (mut batch, mut courses) = (Batch::default(), Vec::new());
        (0..settings.batch).for_each(|_| push_cued_episode(&mut batch, &mut courses, inputs, &mut rng));
        batch.courses = Some(interleave(&courses, inputs + OUTPUTS, Vec::new()));
        let noise: Vec<f32> = (0..4 * batch.reward.len()).map(|_| flip_policy::normal(&mut rng)).collect();
        learner.update(&batch, &noise, &settings);
    }
    let actor = learner.snapshot(&settings).unwrap();
    let off = |cue: f32| {
        let mut carried = actor.begin();
        let mut centre = |seen: f32| actor.forward(&vec![seen; inputs], &mut carried).mean.map(f32::tanh);
        let [_, _, last] = [CUE * cue, 0.0, 0.0].map(&mut centre);
        last.iter().map(|a| (a - 0.6 * cue).abs()).sum::<f32>() / 2.0
    };
    (off(1.0) + off(-1.0)) / 2.0
}

#[test]
fn what_was_seen_two_steps_ago_decides_and_only_the_recurrent_learner_knows_it() {
    let recurrent = error_after_a_cue(Network::Recurrent { replayed: Replayed::Episodes }, 1500);
    let feed_forward = error_after_a_cue(Network::FeedForward, 1500);
    println!("recurrent {recurrent:.3}, feed-forward {feed_forward:.3}");
    assert!(recurrent < 0.15, "{recurrent}");
    // Whatever it does, it does for both cues: 0.6 off on average, or more.
    assert!(feed_forward > 0.59, "{feed_forward}");
}
