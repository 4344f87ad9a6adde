//! Our gradients beside libtorch's, beside finite differences, and beside themselves on other paths.

use super::*;
use crate::train::by_libtorch::ByLibtorch;
use crate::train::episodes::interleave;
use crate::train::networks::Seen;
use crate::train::sac::{Learner, actor_loss, critic_loss, squash};
use crate::train::settings::{Gradients, Network as Kind, Order, Preset, Replayed};
use flip_core::domain::parameters::COUNT;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use tch::Tensor;

/// Everything that the gradients of an update depend on.
struct Case {
    settings: Settings,
    networks: Networks,
    actor: Vec<f32>,
    critics: Vec<f32>,
    targets: Vec<f32>,
    batch: Batch,
    noise: Vec<f32>,
}

fn uniform(count: usize, size: f32, rng: &mut Pcg64Mcg) -> Vec<f32> {
    (0..count).map(|_| size * (2.0 * rng.random::<f32>() - 1.0)).collect()
}

impl Case {
    /// Random weights, as large as a trained network's, and a random batch; of a recurrent network,
    /// `batch` episodes of 1 to `steps` steps.
    fn new(kind: Kind, critic_loss: CriticLoss, (hidden, batch, steps): (u32, u32, usize)) -> Self {
        let mut rng = Pcg64Mcg::seed_from_u64(u64::from(hidden * batch));
        let settings = Settings {
            network: kind,
            critic_loss,
            hidden,
            batch,
            ..Settings::of(Preset::Flip, Order::Curriculum, 1)
        };
        let networks = Networks::new(&settings);
        let (actor, critics) = networks.initialise(&mut rng);
        let size = 1.5 / (hidden as f32).sqrt();
        let [actor, critics, targets] =
            [actor.len(), critics.len(), critics.len()].map(|count| uniform(count, size, &mut rng));
        let batch = random_batch(&settings, steps, &mut rng);
        let noise = (0..4 * batch.reward.len()).map(|_| flip_policy::normal(&mut rng)).collect();
        Self { settings, networks, actor, critics, targets, batch, noise }
    }

    fn blocks(&self) -> Blocks<'_> {
        Blocks { actor: &self.actor, critics: &self.critics, targets: &self.targets }
    }

    fn drawn(&self) -> Drawn<'_> {
        Drawn { batch: &self.batch, noise: &self.noise, alpha: 0.3, settings: &self.settings }
    }

    /// Losses, mean log-probability, and both gradients.
    fn by(&self, what: &mut impl Differentiate) -> ([f64; 3], Vec<f32>, Vec<f32>) {
        let (mut critics, mut actor) = (vec![9.0; 5], vec![9.0; 5]);
        let critic_loss = what.critics(self.blocks(), self.drawn(), &mut critics);
        let (actor_loss, mean) = what.actor(self.blocks(), self.drawn(), Some(&mut actor));
        ([critic_loss, actor_loss, mean], critics, actor)
    }

    fn by_us(&self, path: Path) -> ([f64; 3], Vec<f32>, Vec<f32>) {
        self.by(&mut Fused::on(path, &self.networks))
    }
}

fn random_batch(settings: &Settings, steps: usize, rng: &mut Pcg64Mcg) -> Batch {
    let inputs = settings.encoding.width();
    let recurrent = settings.network != Kind::FeedForward;
    let lengths: Vec<usize> =
        (0..settings.batch).map(|e| if recurrent { 1 + e as usize % steps } else { 1 }).collect();
    let rows = lengths.iter().sum::<usize>();
    let courses = recurrent.then(|| {
        let courses: Vec<Vec<f32>> = lengths
            .iter()
            .map(|length| uniform((length + 1) * (inputs + OUTPUTS), 2.0, rng))
            .collect();
        let state = 2 * settings.hidden as usize * settings.batch as usize;
        let stored = if settings.stores_states() { uniform(state, 0.9, rng) } else { Vec::new() };
        interleave(&courses, inputs + OUTPUTS, stored)
    });
    Batch {
        now: uniform(rows * (inputs + COUNT + OUTPUTS), 1.0, rng),
        next: uniform(rows * (inputs + COUNT), 1.0, rng),
        reward: uniform(rows, 3.0, rng),
        goes_on: (0..rows).map(|row| if row % 5 == 3 { 0.0 } else { 1.0 }).collect(),
        courses,
    }
}

/// All networks, losses, and sizes that are and are not multiples of a vector's; the largest of
/// each as shipped.
fn cases() -> Vec<Case> {
    let recurrent = |replayed| Kind::Recurrent { replayed };
    vec![
        Case::new(Kind::FeedForward, CriticLoss::Squared, (7, 5, 1)),
        Case::new(Kind::FeedForward, CriticLoss::Huber, (33, 70, 1)),
        Case::new(Kind::FeedForward, CriticLoss::Squared, (128, 256, 1)),
        Case::new(recurrent(Replayed::Episodes), CriticLoss::Squared, (6, 3, 1)),
        Case::new(recurrent(Replayed::Episodes), CriticLoss::Squared, (9, 5, 4)),
        Case::new(recurrent(Replayed::StoredState), CriticLoss::Huber, (20, 7, 5)),
        Case::new(recurrent(Replayed::StoredState), CriticLoss::Huber, (128, 16, 10)),
        Case::new(recurrent(Replayed::Episodes), CriticLoss::Huber, (128, 16, 10)),
    ]
}

/// Largest difference, as a share of the largest number.
fn distance(ours: &[f32], theirs: &[f32]) -> f32 {
    assert_eq!(ours.len(), theirs.len());
    let largest = |numbers: &mut dyn Iterator<Item = f32>| numbers.fold(0.0, f32::max);
    let apart = largest(&mut ours.iter().zip(theirs).map(|(a, b)| (a - b).abs()));
    apart / largest(&mut theirs.iter().map(|x| x.abs()))
}

#[test]
fn gradients_and_losses_are_libtorchs_up_to_rounding() {
    for case in cases() {
        let ours = case.by_us(Path::best());
        let mut torch = ByLibtorch::new(&case.networks, &case.batch, &case.noise);
        let theirs = case.by(&mut torch);
        let name = format!("{:?}, {} units", case.settings.network, case.settings.hidden);
        // A sum of n terms in f32 is rounded by about sqrt(n) 6e-8 of its terms; the longest has
        // 512. That is 1.4e-6, and libtorch's is rounded too.
        for (a, b) in ours.0.iter().zip(theirs.0) {
            assert!((a - b).abs() < 3e-6 * b.abs().max(1.0), "{name}: {a}, libtorch {b}");
        }
        let apart = [distance(&ours.1, &theirs.1), distance(&ours.2, &theirs.2)];
        println!("{name}: critics {:.1e}, actor {:.1e}", apart[0], apart[1]);
        assert!(apart.iter().all(|apart| *apart < 3e-6), "{name}: {apart:?}");
    }
}

#[test]
fn gradients_are_finite_differences_of_the_losses() {
    let double = |numbers: &[f32]| {
        Tensor::from_slice(&numbers.iter().map(|x| f64::from(*x)).collect::<Vec<_>>())
    };
    let kind = tch::Kind::Double;
    // The small ones: in f64, by libtorch's forward pass alone.
    for case in cases().into_iter().filter(|case| case.settings.hidden < 21) {
        let (_, critics, actor) = case.by_us(Path::best());
        let torch = ByLibtorch::new(&case.networks, &case.batch, &case.noise);
        let y = torch.target(case.blocks(), case.drawn()).to_kind(kind);
        let now = Seen {
            rows: torch.now.rows.to_kind(kind),
            course: torch.now.course.as_ref().map(|course| course.to_kind(kind)),
        };
        let (action, noise) = (torch.action.to_kind(kind), torch.noise.get(1).to_kind(kind));
        let of_critics = |flat: &Tensor| {
            let q = case.networks.values(&flat.view([2, -1]), &now, &action);
            critic_loss(&q, &y, case.settings.critic_loss)
        };
        let fixed = double(&case.critics).view([2, -1]);
        let of_actor = |flat: &Tensor| {
            let (action, log_prob) = squash(&case.networks.head(flat, &now), &noise);
            actor_loss(&case.networks.values(&fixed, &now, &action), &log_prob, 0.3)
        };
        check_differences("critics", &double(&case.critics), &critics, of_critics);
        check_differences("actor", &double(&case.actor), &actor, of_actor);
    }
}

fn check_differences(what: &str, at: &Tensor, ours: &[f32], loss: impl Fn(&Tensor) -> Tensor) {
    let largest = ours.iter().fold(0.0f32, |most, x| most.max(x.abs()));
    let step = 1e-6;
    for k in (0..ours.len()).step_by(5) {
        let value = |offset: f64| {
            let moved = at.copy();
            let _ = moved.get(k as i64).g_add_scalar_(offset);
            loss(&moved).double_value(&[])
        };
        let numeric = (value(step) - value(-step)) / (2.0 * step);
        let apart = (numeric - f64::from(ours[k])).abs();
        assert!(apart < 1e-5 * f64::from(largest), "{what}[{k}]: {numeric} {}", ours[k]);
    }
}

#[test]
fn every_path_gives_the_same_bits() {
    for case in cases().iter().filter(|case| case.settings.hidden < 128) {
        let expected = case.by_us(Path::Portable);
        for (name, path) in Path::available() {
            assert!(case.by_us(path) == expected, "{name}, {} units", case.settings.hidden);
        }
    }
}

#[test]
fn room_that_was_used_before_changes_nothing() {
    let pairs = [(0, 2), (2, 0), (4, 7), (7, 4), (6, 7)];
    let cases = cases();
    for (first, second) in pairs.map(|(a, b)| (&cases[a], &cases[b])) {
        if first.settings.hidden == second.settings.hidden {
            let mut used = Fused::new(&first.networks);
            first.by(&mut used);
            assert!(second.by(&mut used) == second.by_us(Path::best()));
        }
        // The same networks on a batch of another size, and back.
        let mut used = Fused::new(&second.networks);
        let settings = Settings { batch: 3, ..second.settings.clone() };
        let batch = random_batch(&settings, 2, &mut Pcg64Mcg::seed_from_u64(1));
        let noise = vec![0.5; 4 * batch.reward.len()];
        let drawn = Drawn { batch: &batch, noise: &noise, alpha: 0.3, settings: &settings };
        used.critics(second.blocks(), drawn, &mut Vec::new());
        used.actor(second.blocks(), drawn, Some(&mut Vec::new()));
        assert!(second.by(&mut used) == second.by_us(Path::best()));
    }
}

#[test]
fn a_hundred_updates_stay_beside_libtorchs_and_repeat_bit_for_bit() {
    let recurrent = Kind::Recurrent { replayed: Replayed::StoredState };
    for network in [Kind::FeedForward, recurrent] {
        let base = Settings {
            network,
            hidden: 24,
            batch: 12,
            ..Settings::of(Preset::Flip, Order::Curriculum, 1)
        };
        let after = |gradients: Gradients| {
            let mut rng = Pcg64Mcg::seed_from_u64(4);
            let settings = Settings { gradients, ..base.clone() };
            let mut learner = Learner::new(&settings, &mut rng);
            for _ in 0..100 {
                let batch = random_batch(&settings, 6, &mut rng);
                let noise: Vec<f32> =
                    (0..4 * batch.reward.len()).map(|_| flip_policy::normal(&mut rng)).collect();
                learner.update(&batch, &noise, &settings);
            }
            learner
        };
        let (ours, theirs) = (after(Gradients::Fused), after(Gradients::Libtorch));
        // A step of Adam moves a parameter by up to 3e-4, whichever way a gradient near zero is
        // rounded; a hundred steps that did not agree would be apart by more than 1e-2.
        let apart =
            [distance(&ours.actor, &theirs.actor), distance(&ours.critics, &theirs.critics)];
        println!("{network:?}: {apart:?}");
        assert!(apart.iter().all(|apart| *apart < 1e-4), "{apart:?}");
        assert!(ours == after(Gradients::Fused));
    }
}
