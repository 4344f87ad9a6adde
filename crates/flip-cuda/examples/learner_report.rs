//! Updates of Soft Actor-Critic per second on the first card: `cargo run --release -p flip-cuda
//! --example learner_report`.
//!
//! One training and twenty, several widths and batches; each line is the median (least to most) of
//! nine launches of 200 updates, of the launch alone and with the transfer of its batches. The
//! first lines are one training with one block. Without a card it prints why there is nothing to measure.

use flip_core::learner::{Drawn, Learned, Shape};
use flip_cuda::{Card, Learners};
use flip_policy::Encoding;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::time::Instant;

const UPDATES: usize = 200;
const LAUNCHES: usize = 9;
const PARAMETERS: usize = 9;

fn uniform(count: usize, size: f32, rng: &mut Pcg64Mcg) -> Vec<f32> {
    (0..count).map(|_| size * (2.0 * rng.random::<f32>() - 1.0)).collect()
}

/// An untrained learner of this shape.
fn untrained(shape: &Shape, rng: &mut Pcg64Mcg) -> Learned {
    let (actor, critics) = (shape.actor(), 2 * shape.critic());
    let size = 1.0 / (shape.hidden as f32).sqrt();
    let with_means = |count: usize, rng: &mut Pcg64Mcg| {
        [uniform(count, size, rng), vec![0.0; count], vec![0.0; count]]
    };
    let (actor, critics) = (with_means(actor, rng), with_means(critics, rng));
    let targets = critics[0].clone();
    Learned { actor, critics, targets, log_alpha: [-1.6, 0.0, 0.0], steps: [0, 0] }
}

/// Median, least and most of updates per second.
fn rates(updates: usize, mut seconds: Vec<f64>) -> String {
    seconds.sort_unstable_by(f64::total_cmp);
    let rate = |seconds: f64| updates as f64 / seconds;
    let (least, most) = (seconds[seconds.len() - 1], seconds[0]);
    let median = seconds[seconds.len() / 2];
    format!("{:8.0} ({:.0} to {:.0})", rate(median), rate(least), rate(most))
}

fn main() -> flip_cuda::Result<()> {
    let card = match Card::open(0) {
        Ok(card) => card,
        Err(reason) => {
            println!("skipped: {reason}");
            return Ok(());
        }
    };
    println!(
        "{}, {} multiprocessors; updates/s: launch alone, with transfers",
        card.name(),
        card.multiprocessors()
    );
    let inputs = Encoding::Fall.width();
    for (trainings, blocks) in [(1, 1), (1, usize::MAX), (20, usize::MAX)] {
        for (hidden, rows) in [(128, 256), (64, 256), (256, 256), (128, 16)] {
            let shape = Shape {
                rows,
                inputs,
                state: inputs + PARAMETERS,
                hidden,
                huber: false,
                gamma: 0.9,
                tau: 0.005,
                target_entropy: -2.0,
                learning_rate: 3e-4,
            };
            let mut rng = Pcg64Mcg::seed_from_u64(1);
            let states: Vec<Learned> =
                (0..trainings).map(|_| untrained(&shape, &mut rng)).collect();
            let mut learners = Learners::new(&card, shape, &states)?.with_blocks(blocks);
            // One batch for all: what it holds does not matter for the time.
            let (now, next) = (
                uniform(rows * (shape.state + 2), 1.0, &mut rng),
                uniform(rows * shape.state, 1.0, &mut rng),
            );
            let (reward, goes_on) = (uniform(rows, 1.0, &mut rng), vec![1.0; rows]);
            let noise = uniform(rows * 4, 1.7, &mut rng);
            let batch =
                Drawn { now: &now, next: &next, reward: &reward, goes_on: &goes_on, noise: &noise };
            let batches = vec![batch; trainings * UPDATES];
            let (mut alone, mut whole) = (Vec::new(), Vec::new());
            learners.update(&batches)?;
            for _ in 0..LAUNCHES {
                let start = Instant::now();
                learners.update(&batches)?;
                whole.push(start.elapsed().as_secs_f64());
                alone.push(learners.kernel_s());
            }
            let [alone, whole] = [alone, whole].map(|seconds| rates(batches.len(), seconds));
            println!(
                "{trainings:3} trainings, {:2} blocks each, {hidden:3} units, batch {rows:3}: {alone}  {whole}",
                learners.blocks()
            );
        }
    }
    Ok(())
}
