//! Serialisation of a training to bytes and back.
//!
//! One safetensors file: flat weights, optimiser moments and replay steps as tensors, everything
//! else as JSON in its metadata. There is no generator state to save: every random number comes
//! from a stream identified by a counter.

use super::adam::Adam;
use super::curriculum::Curriculum;
use super::record::Level;
use super::replay::{Remembered, Replay};
use super::sac::Learner;
use super::settings::Settings;
use super::training::{Progress, State};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::HashMap;

/// The only metadata key: the format does not preserve the order of several.
const KEY: &str = "flip.training";
/// Incremented when the layout changes, so that an older checkpoint is rejected, not misread.
const VERSION: u32 = 5;

#[derive(Serialize, Deserialize)]
struct Header {
    version: u32,
    /// SHA-256 of settings and levels: a checkpoint resumes only the training it came from.
    training: String,
    curriculum: Curriculum,
    progress: Progress,
    /// Step counts of the three optimisers.
    adam_steps: [u64; 3],
    /// Position of the oldest stored step or episode.
    oldest: usize,
    /// Steps of each stored episode; empty if single steps are stored.
    lengths: Vec<u32>,
}

fn fingerprint(levels: &[Level], settings: &Settings) -> String {
    let text = serde_json::to_vec(&(settings, levels, flip_sim::VERSION)).expect("plain data");
    hex::encode(Sha256::digest(text))
}

/// The learner's blocks with their names.
fn blocks(learner: &Learner) -> [(&'static str, &[f32]); 11] {
    let l = learner;
    [
        ("actor", &l.actor),
        ("actor_adam.m", &l.actor_adam.m),
        ("actor_adam.v", &l.actor_adam.v),
        ("averaged", &l.averaged),
        ("critics", &l.critics),
        ("critics_adam.m", &l.critics_adam.m),
        ("critics_adam.v", &l.critics_adam.v),
        ("log_alpha", &l.log_alpha),
        ("log_alpha_adam.m", &l.alpha_adam.m),
        ("log_alpha_adam.v", &l.alpha_adam.v),
        ("targets", &l.targets),
    ]
}

/// Serialises this state.
pub(super) fn encode(state: &State, levels: &[Level], settings: &Settings) -> Vec<u8> {
    let Remembered { rows, lengths, states, oldest } = state.replay.to_plain();
    let learner = &state.learner;
    let header = Header {
        version: VERSION,
        training: fingerprint(levels, settings),
        curriculum: state.curriculum.clone(),
        progress: state.progress.clone(),
        adam_steps: [learner.actor_adam.t, learner.critics_adam.t, learner.alpha_adam.t],
        oldest,
        lengths,
    };
    let bytes: Vec<(&str, Vec<u8>)> = blocks(learner)
        .into_iter()
        .chain([("replay", rows.as_slice()), ("replay.states", states.as_slice())])
        .map(|(name, block)| (name, block.iter().flat_map(|x| x.to_le_bytes()).collect()))
        .collect();
    let views = bytes.iter().map(|(name, b)| {
        (
            *name,
            TensorView::new(Dtype::F32, vec![b.len() / 4], b).expect("the shape is the block's"),
        )
    });
    let text = serde_json::to_string(&header).expect("plain data");
    safetensors::serialize(views, Some(HashMap::from([(KEY.to_owned(), text)])))
        .expect("names differ, the header is small")
}

/// Restores the state from a checkpoint of this training.
///
/// # Errors
/// The problem, as readable text.
pub(super) fn decode(bytes: &[u8], levels: &[Level], settings: &Settings) -> Result<State, String> {
    let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(|e| e.to_string())?;
    let text =
        metadata.metadata().as_ref().and_then(|m| m.get(KEY)).ok_or("it holds no training")?;
    let header: Header = serde_json::from_str(text).map_err(|e| e.to_string())?;
    if header.version != VERSION {
        return Err(format!("it has layout {}, this version reads {VERSION}", header.version));
    }
    if header.training != fingerprint(levels, settings) {
        return Err(
            "it belongs to another training: levels, settings or simulator differ".to_owned()
        );
    }
    let tensors = SafeTensors::deserialize(bytes).map_err(|e| e.to_string())?;
    let read = |name: &str| -> Result<Vec<f32>, String> {
        let tensor = tensors.tensor(name).map_err(|_| format!("`{name}` is missing"))?;
        match tensor.dtype() {
            Dtype::F32 => Ok(tensor
                .data()
                .chunks_exact(4)
                .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
                .collect()),
            other => Err(format!("`{name}` is {other:?}, not F32")),
        }
    };
    let mut learner = Learner::new(settings, &mut Pcg64Mcg::seed_from_u64(0));
    for (name, like) in blocks(&learner) {
        if read(name)?.len() != like.len() {
            return Err(format!("`{name}` must hold {} numbers", like.len()));
        }
    }
    let adam = |name: &str, t: u64| -> Result<Adam, String> {
        Ok(Adam { m: read(&format!("{name}_adam.m"))?, v: read(&format!("{name}_adam.v"))?, t })
    };
    learner.actor_adam = adam("actor", header.adam_steps[0])?;
    learner.critics_adam = adam("critics", header.adam_steps[1])?;
    learner.alpha_adam = adam("log_alpha", header.adam_steps[2])?;
    learner.actor = read("actor")?;
    learner.averaged = read("averaged")?;
    learner.critics = read("critics")?;
    learner.targets = read("targets")?;
    learner.log_alpha = read("log_alpha")?;
    let plain = Remembered {
        rows: read("replay")?,
        lengths: header.lengths,
        states: read("replay.states")?,
        oldest: header.oldest,
    };
    let replay = Replay::from_plain(&plain, settings)
        .ok_or("`replay` does not fit its capacity or its network")?;
    Ok(State { learner, replay, curriculum: header.curriculum, progress: header.progress })
}
