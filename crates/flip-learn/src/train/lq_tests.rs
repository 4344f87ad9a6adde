//! The learner on a task with a closed-form solution: a linear system with a quadratic cost.
//!
//! ```text
//! x' = A x + b a,   A = [[0.95, 0.2], [-0.2, 0.95]],   r = -(|x|^2 + c |a|^2),   discount g
//! p = 1 + g s p c / (c + g b^2 p),   s = |A|^2         discrete Riccati equation; A turns and shrinks, so P = p I
//! a* = -g b p / M A x,   M = c + g b^2 p               best action; best return from x is -p |x|^2
//! ```
//!
//! With the entropy bonus the best policy is a Gaussian around the same a* with covariance alpha /
//! (2 M) I: it is proportional to exp(Q / alpha) (Haarnoja 2018, eq. 4), and Q is quadratic. The
//! temperature is steered to a target entropy, so the temperature and the cost of its noise are
//! known too:
//!
//! ```text
//! alpha* = 2 M exp(H) / (2 pi e)                       H: target entropy of the two actions, nats
//! M * 2 * alpha* / (2 M) = alpha* a step               alpha* / (1 - g) in all
//! ```
//!
//! The squash has little effect: from the starts |a*| < 0.5, and the noise, 0.09, is small compared
//! with the bend of tanh.

use super::*;
use crate::train::settings::{Order, Preset};
use flip_core::domain::parameters::COUNT;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

const A: [[f64; 2]; 2] = [[0.95, 0.2], [-0.2, 0.95]];
const B: f64 = 0.6;
const C: f64 = 0.5;
const GAMMA: f64 = 0.7;
const ENTROPY: f64 = -2.0;
/// Starts lie on this circle.
const RADIUS: f64 = 0.7;

/// `p` of the best policy.
fn riccati() -> f64 {
    let s = square(A[0]);
    // The iteration contracts: a hundred rounds converge to the last bit.
    (0..100).fold(1.0, |p, _| 1.0 + GAMMA * s * p * C / (C + GAMMA * B * B * p))
}

/// Temperature at which the best policy has the target entropy if the steps after this one cost
/// `p |x|^2`.
fn temperature(p: f64) -> f64 {
    2.0 * (C + GAMMA * B * B * p) * ENTROPY.exp()
        / (2.0 * std::f64::consts::PI * std::f64::consts::E)
}

fn square(v: [f64; 2]) -> f64 {
    v[0] * v[0] + v[1] * v[1]
}

/// The next state and the reward.
fn step(x: [f64; 2], a: [f64; 2]) -> ([f64; 2], f64) {
    let next = std::array::from_fn(|k| A[k][0] * x[0] + A[k][1] * x[1] + B * a[k]);
    (next, -(square(x) + C * square(a)))
}

/// The state as presented to the learner: in the first two inputs, with all others and the nine
/// parameters zero.
fn row(x: [f64; 2], inputs: usize) -> Vec<f32> {
    let mut row = vec![0.0; inputs + COUNT];
    row[..2].copy_from_slice(&x.map(|x| x as f32));
    row
}

/// Discounted return of a policy from `x`; anything after 200 steps has a weight of 1e-31.
fn discounted(mut x: [f64; 2], policy: impl Fn([f64; 2]) -> [f64; 2]) -> f64 {
    let mut sum = 0.0;
    for t in 0..200 {
        let (next, reward) = step(x, policy(x));
        sum += GAMMA.powi(t) * reward;
        x = next;
    }
    sum
}

fn starts() -> impl Iterator<Item = [f64; 2]> {
    (0..16)
        .map(|k| (f64::from(k) * std::f64::consts::PI / 8.0).sin_cos())
        .map(|(s, c)| [RADIUS * c, RADIUS * s])
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let values: Vec<f64> = values.collect();
    values.iter().sum::<f64>() / values.len() as f64
}

/// A learner after its updates on random states within 1 and random actions. Its learning rate
/// falls to zero, so that it converges.
fn learned(settings: &Settings) -> Learner {
    const UPDATES: u32 = 1500;
    let mut rng = Pcg64Mcg::seed_from_u64(settings.seed);
    let mut learner = Learner::new(settings, &mut rng);
    let inputs = settings.encoding.width();
    let uniform = |rng: &mut Pcg64Mcg| -> [f64; 2] {
        std::array::from_fn(|_| 2.0 * rng.random::<f64>() - 1.0)
    };
    for update in 0..UPDATES {
        let mut batch = Batch::default();
        for _ in 0..settings.batch {
            let (x, a) = (uniform(&mut rng), uniform(&mut rng));
            let (next, reward) = step(x, a);
            batch.now.extend(row(x, inputs));
            batch.now.extend(a.map(|a| a as f32));
            batch.next.extend(row(next, inputs));
            batch.reward.push(reward as f32);
            batch.goes_on.push(1.0);
        }
        let noise: Vec<f32> =
            (0..4 * settings.batch).map(|_| flip_policy::normal(&mut rng)).collect();
        let rate = settings.learning_rate * (1.0 - f64::from(update) / f64::from(UPDATES));
        learner.update(&batch, &noise, &Settings { learning_rate: rate, ..settings.clone() });
    }
    learner
}

#[test]
fn the_riccati_gain_is_the_best_of_its_neighbours() {
    let p = riccati();
    let gain = GAMMA * B * p / (C + GAMMA * B * B * p);
    let of = |factor: f64| {
        let policy = |x: [f64; 2]| {
            std::array::from_fn(|k| -factor * gain * (A[k][0] * x[0] + A[k][1] * x[1]))
        };
        mean(starts().map(|x| discounted(x, policy)))
    };
    assert!((of(1.0) + p * RADIUS * RADIUS).abs() < 1e-9, "{} {}", of(1.0), -p * RADIUS * RADIUS);
    assert!(of(0.95) < of(1.0) && of(1.05) < of(1.0));
}

#[test]
fn a_linear_system_with_quadratic_cost_is_controlled_as_the_riccati_equation_says() {
    let p = riccati();
    // Cost of the target entropy's noise for the best policy: the learner trades returns below this
    // for entropy.
    let margin = temperature(p) / (1.0 - GAMMA);
    let best = -p * RADIUS * RADIUS;
    let idle = mean(starts().map(|x| discounted(x, |_| [0.0, 0.0])));
    assert!(
        best - idle > 10.0 * margin,
        "the task is too easy: {idle} without any action, {best} with the best"
    );
    // Temperatures of a policy that ignores the future, and of one that expects to do nothing after
    // this step.
    let temperatures = temperature(0.0)..temperature(-idle / (RADIUS * RADIUS));
    let by = [Gradients::Libtorch, Gradients::Fused];
    for (gradients, seed) in by.into_iter().flat_map(|by| (1..=5).map(move |seed| (by, seed))) {
        let settings = Settings {
            hidden: 64,
            batch: 64,
            learning_rate: 3e-3,
            gamma: GAMMA,
            tau: 0.05,
            target_entropy: ENTROPY,
            initial_alpha: 0.02,
            gradients,
            ..Settings::of(Preset::Flip, Order::Curriculum, seed)
        };
        let learner = learned(&settings);
        let actor = learner.snapshot(&settings).unwrap();
        let policy = |x: [f64; 2]| {
            let inputs = &row(x, settings.encoding.width())[..settings.encoding.width()];
            actor.forward(inputs, &mut actor.begin()).mean.map(|u| f64::from(u).tanh())
        };
        let reached = mean(starts().map(|x| discounted(x, policy)));
        println!(
            "{gradients:?}, seed {seed}: {reached:.4}, best {best:.4}, margin {margin:.4}, temperature {:.4}",
            learner.alpha()
        );
        assert!(reached > best - margin, "seed {seed}: {reached}, best {best}, margin {margin}");
        assert!(
            temperatures.contains(&learner.alpha()),
            "seed {seed}: {} not in {temperatures:?}",
            learner.alpha()
        );
    }
}
