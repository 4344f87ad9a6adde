//! A level against a computation that shares no algebra with it: `tests/reference/discovery.py`.

use super::*;
use serde::Deserialize;

#[derive(Deserialize)]
struct References {
    level: Reference,
}

/// Twelve rows of three weighings; noises are given by ratio, length and whether they wander.
#[derive(Deserialize)]
struct Reference {
    noises: Vec<(f64, f64, bool)>,
    group: Vec<usize>,
    observed: Vec<f64>,
    courses: Vec<Vec<f64>>,
    scales: Vec<f64>,
    differ: Vec<f64>,
    white: f64,
    log_cause: f64,
    log_wander: f64,
    size: [f64; 3],
    gained_only: f64,
    explained: f64,
    left: f64,
}

impl Reference {
    fn judge(&self, white: Option<f64>) -> Verdict {
        let blocks = [0..4, 4..8, 8..12];
        let noise = |&(ratio, length, is_wander): &(f64, f64, bool)| {
            let covariance = |_: usize| {
                DMatrix::from_fn(4, 4, |i, j| {
                    let own = if i == j { 1.0 } else { 0.0 };
                    own + ratio * (-(i.abs_diff(j) as f64) / length).exp()
                })
            };
            let level = |_: usize| DMatrix::from_element(4, 1, 1.0);
            let model = Whitening::new(&blocks, covariance, level, &DMatrix::zeros(12, 0)).unwrap();
            Noise { model, is_wander, floor: 0.0 }
        };
        let noises: Vec<Noise> = self.noises.iter().map(noise).collect();
        let form = |(course, &scale): (&Vec<f64>, &f64)| Form {
            course: course.clone(),
            scale,
            shape: None,
            span: 2.0,
        };
        let hypothesis = Hypothesis {
            mechanism: TraceMechanism::BalanceDrift,
            forms: self.courses.iter().zip(&self.scales).map(form).collect(),
            group: self.group.clone(),
            differ: self.differ.iter().copied().map(Some).collect(),
        };
        let observed = DMatrix::from_column_slice(12, 1, &self.observed);
        judge(&noises, &[hypothesis], &observed, white)
    }
}

#[test]
fn evidence_size_and_share_explained_are_those_of_dense_covariances() {
    let text = include_str!("../../../../../tests/reference/discovery.json");
    let References { level: reference } = serde_json::from_str(text).unwrap();
    let verdict = reference.judge(Some(reference.white));
    let estimate = &verdict.estimates[0];
    let [size, effect] = [estimate.size(), estimate.effect()];
    let pairs = [
        (verdict.causes[0].1[0], reference.log_cause),
        (verdict.wander[0], reference.log_wander),
        (size[0], reference.size[0]),
        (size[1], reference.size[1]),
        (size[2], reference.size[2]),
        (effect[0], 2.0 * reference.size[0]),
        (estimate.left, reference.left),
        (estimate.explained, reference.explained),
        // Without a known noise the squares say nothing, and less is explained.
        (reference.judge(None).estimates[0].explained, reference.gained_only),
    ];
    for (k, (ours, theirs)) in pairs.into_iter().enumerate() {
        assert!((ours - theirs).abs() < 1e-8, "{k}: {ours}, expected {theirs}");
    }
    assert!(estimate.shape().is_none() && reference.explained < 1.0);
}
