//! The losses and the update against an independent implementation, finite differences and known limits.

use super::*;
use crate::train::settings::{Order, Preset};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde_json::Value;
use tch::Kind;

/// Made by `tests/reference/sac_update.py`.
fn reference() -> Value {
    serde_json::from_str(include_str!("../../tests/reference/sac_update.json")).unwrap()
}

fn numbers(value: &Value) -> Vec<f32> {
    value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap() as f32).collect()
}

/// The learner, settings, batch and noise that the reference starts from.
fn start(reference: &Value) -> (Learner, Settings, Batch, Vec<f32>) {
    let number = |key: &str| reference[key].as_f64().unwrap();
    let settings = Settings {
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
    let batch = Batch {
        now: numbers(&reference["now"]),
        next: numbers(&reference["next"]),
        reward: numbers(&reference["reward"]),
        goes_on: numbers(&reference["goes_on"]),
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
    let reference = reference();
    let expected = &reference["expected"];
    let (mut learner, settings, batch, noise) = start(&reference);

    let next = Tensor::from_slice(&batch.next).view([i64::from(settings.batch), -1]);
    let first = Tensor::from_slice(&noise).view([2, i64::from(settings.batch), 2]).get(0);
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

#[test]
fn gradients_equal_finite_differences_of_the_losses() {
    // In f64, so that differences of 1e-6 are not drowned in rounding.
    let double = |values: &Value| {
        Tensor::from_slice(&values.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect::<Vec<_>>())
    };
    let r = reference();
    let (learner, settings, ..) = start(&r);
    let (n, state) = (i64::from(settings.batch), 13);
    let now = double(&r["now"]).view([n, -1]);
    let noise = double(&r["noise"]).view([2, n, 2]).get(1);
    let y = double(&r["expected"]["y"]);
    let critics = double(&r["critics"]).view([2, -1]);
    let of_critics = |flat: &Tensor| critic_loss(&forward_twins(&flat.view([2, -1]), &learner.critic_widths, &now), &y);
    let of_actor = |flat: &Tensor| {
        let head = forward(flat, &learner.actor_widths, &now.narrow(1, 0, learner.actor_widths[0] as i64));
        let (action, log_prob) = squash(&head, &noise);
        let q = forward_twins(&critics, &learner.critic_widths, &Tensor::cat(&[now.narrow(1, 0, state), action], 1));
        actor_loss(&q, &log_prob, 0.3)
    };
    check_gradient("critics", &double(&r["critics"]), of_critics);
    check_gradient("actor", &double(&r["actor"]), of_actor);
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
        let noise: Vec<f32> = (0..4 * settings.batch).map(|_| crate::policy::normal(&mut rng)).collect();
        learner.update(&batch, &noise, &settings);
    }
    let head = learner.snapshot(&settings).unwrap().forward(&vec![0.5; inputs]);
    assert!(head.mean.iter().all(|m| (m.tanh() - 0.5).abs() < 0.1), "{:?}", head.mean.map(f32::tanh));
}
