//! The recurrent network compared with the plain-Rust one.

use super::*;
use crate::train::episodes::interleave;
use flip_policy::{Actor, Encoding, OUTPUTS};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

#[test]
fn the_pure_forward_pass_equals_libtorchs_along_whole_episodes() {
    let mut rng = Pcg64Mcg::seed_from_u64(8);
    for (encoding, hidden) in
        [(Encoding::Paper, 128), (Encoding::Missing, 128), (Encoding::Missing, 7)]
    {
        let inputs = encoding.width();
        let recalled = inputs + OUTPUTS;
        let sizes = Sizes {
            seen: inputs,
            recalled,
            hidden,
            trunk: vec![2 * hidden, hidden, hidden, 2 * OUTPUTS],
        };
        // Weights as large as a trained network's: uniform, not scaled down in the last layer.
        let count = sizes.blocks().iter().sum::<i64>();
        let flat: Vec<f32> = (0..count).map(|_| 0.2 * (2.0 * rng.random::<f32>() - 1.0)).collect();
        let actor = Actor::recurrent(encoding, hidden, &flat).unwrap();
        assert_eq!(actor.to_flat(), flat);

        // Episodes of 30 and 10 steps; the actions do not matter here, only that they are passed
        // on.
        let mut rows = Vec::new();
        let mut pure = Vec::new();
        let mut courses = Vec::new();
        for steps in [30, 10] {
            let mut carried = actor.begin();
            let mut course = Vec::new();
            for step in 0..=steps {
                let x: Vec<f32> = (0..inputs).map(|_| 4.0 * rng.random::<f32>() - 2.0).collect();
                course.extend(&x);
                course.extend(carried.last_action);
                if step < steps {
                    let head = actor.forward(&x, &mut carried);
                    pure.extend(head.mean.iter().chain(&head.log_std).copied());
                    carried.last_action = [rng.random(), -rng.random::<f32>()];
                    rows.extend(x);
                }
            }
            courses.push(course);
        }
        let [now, _] = Course::pair(&interleave(&courses, recalled, Vec::new()), &sizes);
        let rows = Tensor::from_slice(&rows).view([-1, inputs as i64]);
        let torch = forward(&Tensor::from_slice(&flat).unsqueeze(0), &sizes, &rows, &now);
        let torch = Vec::<f32>::try_from(torch.view([-1])).unwrap();
        assert_eq!((torch.len(), pure.len()), (160, 160));
        for (k, (pure, torch)) in pure.iter().zip(torch).enumerate() {
            let torch = if k % 4 < 2 { torch } else { torch.clamp(-20.0, 2.0) };
            assert!((pure - torch).abs() < 1e-5, "{k}: {pure} {torch}");
        }
    }
}
