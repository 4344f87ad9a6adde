//! The posterior against an enumeration of all models that shares no algebra with it:
//! `tests/reference/discovery.py`.

use super::*;
use crate::data::campaign::Run;
use crate::judge::noise::Noise;
use flip_core::stats::mixed_model::{Group, Whitening};
use serde::Deserialize;

#[derive(Deserialize)]
struct References {
    posterior: Reference,
}

/// Runs of two powders on four days, some without an angle; means and SDs are of each run.
#[derive(Deserialize)]
struct Reference {
    powder: Vec<usize>,
    session: Vec<usize>,
    measured: Vec<usize>,
    weights: Vec<f64>,
    noises: Vec<(f64, f64)>,
    observed: Vec<f64>,
    causes: Vec<ReferenceCause>,
    inclusion: Vec<f64>,
    before: Vec<[f64; 2]>,
    after: Vec<[f64; 2]>,
    effect: ReferenceEffect,
}

#[derive(Deserialize)]
struct ReferenceCause {
    prior: f64,
    features: Vec<Vec<Vec<f64>>>,
}

#[derive(Deserialize)]
struct ReferenceEffect {
    cause: usize,
    low: usize,
    high: usize,
    mean_sd: [f64; 2],
}

impl Reference {
    fn read() -> Self {
        let text = include_str!("../../../../../tests/reference/discovery.json");
        serde_json::from_str::<References>(text).unwrap().posterior
    }

    fn campaign(&self) -> Campaign {
        let run = |i: usize| Run {
            row: i as u32 + 2,
            powder: self.powder[i],
            session: self.session[i],
            value: self.measured.contains(&i).then_some(0.0),
        };
        Campaign {
            powders: vec!["sand".to_owned(), "salt".to_owned()],
            runs: (0..self.powder.len()).map(run).collect(),
            ..Campaign::default()
        }
    }

    fn prepared(&self) -> Prepared {
        let means =
            DMatrix::from_fn(self.powder.len(), 2, |i, k| f64::from(u8::from(self.powder[i] == k)));
        let of =
            |values: &[usize]| -> Vec<usize> { self.measured.iter().map(|&i| values[i]).collect() };
        let (powder, session) = (of(&self.powder), of(&self.session));
        let both: Vec<usize> = powder.iter().zip(&session).map(|(p, day)| 2 * day + p).collect();
        let weights: Vec<f64> = self.measured.iter().map(|&i| self.weights[i]).collect();
        let noise = |&(day, day_powder): &(f64, f64)| {
            let groups =
                [Group { of: &session, ratio: day }, Group { of: &both, ratio: day_powder }];
            let fixed = means.select_rows(&self.measured);
            let (model, factor) = Whitening::with_factor(&weights, &groups, &fixed).unwrap();
            Noise { model, factor, day, day_powder }
        };
        let noises = self.noises.iter().map(noise).collect();
        let matrix =
            |rows: &Vec<Vec<f64>>| DMatrix::from_fn(rows.len(), rows[0].len(), |i, k| rows[i][k]);
        let hypothesis = |(h, cause): (usize, &ReferenceCause)| Hypothesis {
            cause: Cause::Unknown(format!("covariate {h}")),
            features: cause.features.iter().map(matrix).collect(),
            laws: cause.features.iter().map(|_| String::new()).collect(),
            sign: None,
            prior: cause.prior,
        };
        Prepared {
            powder: self.powder.clone(),
            measured: self.measured.clone(),
            weights: self.weights.clone(),
            centres: vec![0.0; 2],
            observed: self.observed.clone(),
            hypotheses: self.causes.iter().enumerate().map(hypothesis).collect(),
            untestable: Vec::new(),
            means,
            noises,
        }
    }
}

fn is_close(one: f64, other: f64) -> bool {
    (one - other).abs() < 1e-8
}

#[test]
fn probabilities_are_those_of_every_model_enumerated() {
    let reference = Reference::read();
    let prepared = reference.prepared();
    let inclusion = Posterior::new(&prepared).inclusion;
    for (ours, theirs) in inclusion.iter().zip(&reference.inclusion) {
        assert!(is_close(*ours, *theirs), "{inclusion:?}, expected {:?}", reference.inclusion);
    }
}

#[test]
fn runs_and_effects_are_predicted_as_by_kriging() {
    let reference = Reference::read();
    let prepared = reference.prepared();
    let posterior = Posterior::new(&prepared);
    let predicted = posterior.predict(&reference.campaign());
    for (row, of_run) in predicted.iter().enumerate() {
        for (ours, theirs) in of_run.iter().zip([reference.before[row], reference.after[row]]) {
            assert!(
                is_close(ours.mean, theirs[0]) && is_close(ours.sd, theirs[1]),
                "run {row}: {ours:?}, expected {theirs:?}"
            );
        }
    }
    let ReferenceEffect { cause, low, high, mean_sd } = reference.effect;
    let effect = posterior.effect(&prepared.hypotheses[cause].cause, &[(low, high)]).unwrap();
    let (mean, sd) = effect.moments();
    assert!(is_close(mean, mean_sd[0]) && is_close(sd, mean_sd[1]), "{mean} {sd}, {mean_sd:?}");
}

#[test]
fn an_interval_holds_its_probability() {
    let student = |location: f64| Student { weight: 0.5, location, scale: 1.0, freedom: 8.0 };
    let mixture = Mixture(vec![student(-3.0), student(3.0)]);
    let [low, high] = mixture.interval(0.9);
    assert!((mixture.below(high) - mixture.below(low) - 0.9).abs() < 1e-9);
    assert!((low + high).abs() < 1e-6 && mixture.below(0.0) == 0.5);
}
