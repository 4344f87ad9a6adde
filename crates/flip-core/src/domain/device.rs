//! What a job computes on.

use serde::{Deserialize, Serialize};

/// What a job computes on. It is one of the job's inputs: a card's numbers have the statistics of
/// the processor's and not their bytes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Device {
    /// The cores of a processor, any number of them.
    #[default]
    Cpu,
    /// A graphics card.
    Cuda,
}

impl Device {
    /// Whether it is the processor, which what is stored does not mention.
    pub fn is_cpu(&self) -> bool {
        *self == Self::Cpu
    }
}
