//! The policy file format: safetensors with the manifest in its metadata.

use super::actor::{Actor, Malformed, OUTPUTS};
use super::controller::{Controller, ScheduledStep};
use super::dispenser::Dispenser;
use super::manifest::{Kind, Manifest};
use flip_core::domain::bench::SHAKE_MM_MAX;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use sha2::{Digest, Sha256};
use std::collections::HashMap;

/// Largest policy file accepted, bytes.
pub const SIZE_MAX: usize = 16 << 20;
/// Metadata key of the manifest. It is the only key: the format does not preserve the order of
/// several, and the bytes are hashed.
const MANIFEST_KEY: &str = "flip.policy";

/// A controller and its origin.
#[derive(Debug, Clone, PartialEq)]
pub struct Policy {
    /// Its origin.
    pub manifest: Manifest,
    /// The controller.
    pub controller: Controller,
}

/// Why bytes are not a valid policy.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ArtifactError {
    /// More bytes than a policy may have.
    #[error("a policy has at most {SIZE_MAX} bytes, this file has {0}")]
    TooLarge(usize),
    /// Not a safetensors file.
    #[error("this is not a safetensors file: {0}")]
    NotSafetensors(String),
    /// The manifest is missing or cannot be read.
    #[error("the manifest cannot be read: {0}")]
    Manifest(String),
    /// The tensors do not match the controller named in the manifest.
    #[error("the tensors do not fit the manifest: {0}")]
    Tensors(String),
}

/// The policy's id: `p-` and the first 16 hexadecimal digits of the SHA-256 of its bytes.
pub fn id(bytes: &[u8]) -> String {
    format!("p-{}", &hex::encode(Sha256::digest(bytes))[..16])
}

/// Serialises a policy. The same policy always produces the same bytes.
///
/// A learned policy has the tensors of its kind ([`Kind::tensors`]), f32.
pub fn encode(policy: &Policy) -> Vec<u8> {
    let mut blocks: Vec<(String, Vec<usize>, Vec<u8>)> = Vec::new();
    if let Controller::Learned(actor) = &policy.controller {
        let flat = actor.to_flat();
        let mut rest = flat.as_slice();
        for (name, shape) in actor.kind().tensors() {
            let (block, others) = rest.split_at(shape.iter().product());
            rest = others;
            blocks.push((name, shape, block.iter().flat_map(|w| w.to_le_bytes()).collect()));
        }
    }
    let views = blocks.iter().map(|(name, shape, bytes)| {
        (
            name.as_str(),
            TensorView::new(Dtype::F32, shape.clone(), bytes).expect("the shape is the block's"),
        )
    });
    let manifest = serde_json::to_string(&policy.manifest).expect("a manifest is plain data");
    safetensors::serialize(views, Some(HashMap::from([(MANIFEST_KEY.to_owned(), manifest)])))
        .expect("names differ and the header is small")
}

/// Parses a policy.
///
/// # Errors
/// [`ArtifactError`]: bytes from outside are never trusted.
pub fn decode(bytes: &[u8]) -> Result<Policy, ArtifactError> {
    if bytes.len() > SIZE_MAX {
        return Err(ArtifactError::TooLarge(bytes.len()));
    }
    let broken = |e: safetensors::SafeTensorError| ArtifactError::NotSafetensors(e.to_string());
    let (_, header) = SafeTensors::read_metadata(bytes).map_err(broken)?;
    let text = header.metadata().as_ref().and_then(|m| m.get(MANIFEST_KEY));
    let text = text.ok_or_else(|| {
        ArtifactError::Manifest(format!("the metadata has no key `{MANIFEST_KEY}`"))
    })?;
    let manifest: Manifest =
        serde_json::from_str(text).map_err(|e| ArtifactError::Manifest(e.to_string()))?;
    check_rules(&manifest)?;
    let tensors = SafeTensors::deserialize(bytes).map_err(broken)?;
    let controller = match &manifest.kind {
        kind @ Kind::Learned { encoding, widths } => {
            learned(Actor::from_flat(*encoding, widths, &flatten(&tensors, kind)?))?
        }
        kind @ Kind::Recurrent { encoding, hidden } => {
            learned(Actor::recurrent(*encoding, *hidden, &flatten(&tensors, kind)?))?
        }
        Kind::Fixed { step } => Controller::Fixed(checked(step)?),
        Kind::Schedule { schedule } => {
            if schedule.steps.is_empty() || schedule.steps.len() > 1000 {
                return Err(ArtifactError::Manifest("a schedule has 1 to 1000 steps".into()));
            }
            schedule.steps.iter().try_for_each(|step| checked(step).map(|_| ()))?;
            Controller::Schedule(schedule.clone())
        }
        Kind::Dispenser { response } => {
            let checked = response.checked().map_err(|e| ArtifactError::Manifest(e.to_string()))?;
            Controller::Dispenser(Dispenser::new(checked))
        }
        Kind::Pid { gains } => {
            Controller::Pid(gains.checked().map_err(|e| ArtifactError::Manifest(e.to_string()))?)
        }
        Kind::Fuzzy { fuzzy } => {
            Controller::Fuzzy(fuzzy.checked().map_err(|e| ArtifactError::Manifest(e.to_string()))?)
        }
        Kind::Paced { paced } => {
            Controller::Paced(paced.checked().map_err(|e| ArtifactError::Manifest(e.to_string()))?)
        }
    };
    Ok(Policy { manifest, controller })
}

fn learned(actor: Result<Actor, Malformed>) -> Result<Controller, ArtifactError> {
    actor.map(Controller::Learned).map_err(|e| ArtifactError::Tensors(e.to_string()))
}

/// Concatenates the tensors of a network.
fn flatten(tensors: &SafeTensors, kind: &Kind) -> Result<Vec<f32>, ArtifactError> {
    let expected = kind.tensors();
    if tensors.len() != expected.len() {
        return Err(ArtifactError::Tensors(format!(
            "{} tensors expected, found {}",
            expected.len(),
            tensors.len()
        )));
    }
    let mut flat = Vec::new();
    for (name, shape) in expected {
        let tensor = tensors
            .tensor(&name)
            .map_err(|_| ArtifactError::Tensors(format!("`{name}` is missing")))?;
        if tensor.dtype() != Dtype::F32 || tensor.shape() != shape {
            return Err(ArtifactError::Tensors(format!("`{name}` must be F32 of shape {shape:?}")));
        }
        flat.extend(
            tensor.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])),
        );
    }
    Ok(flat)
}

fn check_rules(manifest: &Manifest) -> Result<(), ArtifactError> {
    let refuse = |text: &str| Err(ArtifactError::Manifest(text.to_owned()));
    let pitch = manifest.rules.pitch;
    if !(1..=1000).contains(&manifest.rules.steps_max) {
        return refuse("`steps_max` must be from 1 to 1000");
    }
    if !(pitch.lower_deg >= -90.0 && pitch.upper_deg <= 90.0 && pitch.lower_deg < pitch.upper_deg) {
        return refuse("the pitch limits must rise and lie within -90 to 90 deg");
    }
    if let Kind::Learned { widths, .. } = &manifest.kind
        && widths.last() != Some(&(2 * OUTPUTS))
    {
        return refuse("`widths` must end with 4");
    }
    if let Kind::Recurrent { hidden, .. } = &manifest.kind
        && !(1..=4096).contains(hidden)
    {
        return refuse("`hidden` must be from 1 to 4096");
    }
    Ok(())
}

fn checked(step: &ScheduledStep) -> Result<ScheduledStep, ArtifactError> {
    let ok = step.pitch_deg.abs() <= 90.0 && (0.0..=SHAKE_MM_MAX).contains(&step.shake_mm);
    match ok {
        true => Ok(*step),
        false => Err(ArtifactError::Manifest(
            "a step needs a pitch within 90 deg and a shake from 0 to 16 mm".into(),
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Encoding;
    use crate::Response;
    use crate::controller::Schedule;
    use crate::episode::Rules;
    use crate::fuzzy::Fuzzy;
    use crate::paced::Paced;
    use crate::pid::{Gains, Pid};
    use proptest::prelude::*;

    fn learned() -> Policy {
        let controller = Controller::untrained(5);
        let Controller::Learned(actor) = &controller else { unreachable!() };
        Policy { manifest: Manifest::of_untrained(actor.kind(), Rules::FLIP, 5), controller }
    }

    /// Four hidden units with weights of various sizes.
    fn recurrent() -> Policy {
        let kind = Kind::Recurrent { encoding: Encoding::Paper, hidden: 4 };
        let count = kind.tensors().iter().map(|(_, shape)| shape.iter().product::<usize>()).sum();
        let flat: Vec<f32> = (0..count).map(|k| (k as f32 * 0.7).sin()).collect();
        let controller = Controller::Learned(Actor::recurrent(Encoding::Paper, 4, &flat).unwrap());
        Policy { manifest: Manifest::of_untrained(kind, Rules::PAPER, 0), controller }
    }

    fn scheduled() -> Policy {
        let schedule =
            Schedule { steps: vec![ScheduledStep { pitch_deg: 24.5, shake_mm: 6.25 }; 3] };
        let kind = Kind::Schedule { schedule: schedule.clone() };
        Policy {
            manifest: Manifest::of_untrained(kind, Rules::PAPER, 0),
            controller: Controller::Schedule(schedule),
        }
    }

    fn dispensing() -> Policy {
        let kind = Kind::Dispenser { response: Response::FITTED };
        let controller = Controller::Dispenser(Dispenser::new(Response::FITTED));
        Policy { manifest: Manifest::of_untrained(kind, Rules::FLIP, 0), controller }
    }

    fn rivals() -> [Policy; 3] {
        let policy = |kind, controller| Policy {
            manifest: Manifest::of_untrained(kind, Rules::FLIP, 0),
            controller,
        };
        [
            policy(Kind::Pid { gains: Pid::CHOSEN }, Controller::Pid(Pid::CHOSEN)),
            policy(Kind::Fuzzy { fuzzy: Fuzzy::CHOSEN }, Controller::Fuzzy(Fuzzy::CHOSEN)),
            policy(Kind::Paced { paced: Paced::CHOSEN }, Controller::Paced(Paced::CHOSEN)),
        ]
    }

    #[test]
    fn a_policy_reads_back_exactly_and_its_id_is_its_content() {
        for policy in
            [learned(), recurrent(), scheduled(), dispensing()].into_iter().chain(rivals())
        {
            let bytes = encode(&policy);
            assert_eq!(decode(&bytes).unwrap(), policy);
            assert_eq!(encode(&policy), bytes);
            assert!(id(&bytes).starts_with("p-") && id(&bytes).len() == 18);
        }
        assert_ne!(id(&encode(&learned())), id(&encode(&scheduled())));
    }

    #[test]
    fn a_manifest_that_does_not_fit_its_tensors_is_refused() {
        let mut policy = learned();
        policy.manifest.kind =
            Kind::Learned { encoding: crate::Encoding::Missing, widths: vec![4, 64, 4] };
        assert!(matches!(decode(&encode(&policy)), Err(ArtifactError::Tensors(_))));
        let refusal = |hidden| {
            let mut policy = recurrent();
            policy.manifest.kind = Kind::Recurrent { encoding: Encoding::Paper, hidden };
            decode(&encode(&policy)).unwrap_err().to_string()
        };
        assert!(refusal(5).contains("`seen.weight` must be F32 of shape [3, 5]"), "{}", refusal(5));
        assert!(refusal(0).contains("`hidden`") && refusal(usize::MAX).contains("`hidden`"));
        let mut policy = recurrent();
        policy.manifest.kind = learned().manifest.kind;
        assert!(
            decode(&encode(&policy))
                .unwrap_err()
                .to_string()
                .contains("6 tensors expected, found 14")
        );
        let mut policy = scheduled();
        policy.manifest.kind = Kind::Schedule { schedule: Schedule { steps: vec![] } };
        assert!(matches!(decode(&encode(&policy)), Err(ArtifactError::Manifest(_))));
        let mut policy = dispensing();
        policy.manifest.kind =
            Kind::Dispenser { response: Response { bend: -1.0, ..Response::FITTED } };
        assert!(decode(&encode(&policy)).unwrap_err().to_string().contains("bend"));
        let [mut pid, mut fuzzy, mut paced] = rivals();
        pid.manifest.kind =
            Kind::Pid { gains: Pid { shake: Gains { p: 11.0, i: 0.0, d: 0.0 }, ..Pid::CHOSEN } };
        assert!(decode(&encode(&pid)).unwrap_err().to_string().contains("shake.p"));
        fuzzy.manifest.kind =
            Kind::Fuzzy { fuzzy: Fuzzy { missing_mg: [3.0, 2.0, 4.0], ..Fuzzy::CHOSEN } };
        assert!(decode(&encode(&fuzzy)).unwrap_err().to_string().contains("missing_mg"));
        paced.manifest.kind = Kind::Paced { paced: Paced { pace_mg: -1.0, ..Paced::CHOSEN } };
        assert!(decode(&encode(&paced)).unwrap_err().to_string().contains("pace_mg"));
        let mut policy = scheduled();
        policy.manifest.rules.steps_max = 0;
        assert!(decode(&encode(&policy)).unwrap_err().to_string().contains("steps_max"));
    }

    #[test]
    fn text_and_truncated_files_are_refused_with_the_reason() {
        let bytes = encode(&learned());
        for cut in [0, 7, 100, bytes.len() - 1] {
            assert!(
                matches!(decode(&bytes[..cut]), Err(ArtifactError::NotSafetensors(_))),
                "cut at {cut}"
            );
        }
        assert!(decode(b"not a policy, only text").is_err());
        let foreign = safetensors::serialize(Vec::<(&str, TensorView)>::new(), None).unwrap();
        assert!(decode(&foreign).unwrap_err().to_string().contains("flip.policy"));
    }

    proptest! {
        #[test]
        fn damaged_bytes_never_panic_and_never_act_out_of_range(at in 0usize..8000, value: u8, noise in proptest::collection::vec(any::<u8>(), 0..200)) {
            prop_assert!(decode(&noise).is_err());
            for policy in [scheduled(), recurrent()] {
                let mut bytes = encode(&policy);
                let at = at % bytes.len();
                bytes[at] = value;
                if let Ok(policy) = decode(&bytes) {
                    let mut dosing = policy.controller.begin(&policy.manifest.rules, 1.0);
                    for reading_mg in [0.0, 5.0] {
                        let seen = crate::Observation { reading_mg, target_mg: 10.0, pitch_deg: 0.0 };
                        let action = dosing.propose(&seen);
                        prop_assert!(action.incline_change_deg.abs() <= 8.0 && (0.0..=16.0).contains(&action.shake_mm));
                    }
                }
            }
        }
    }
}
