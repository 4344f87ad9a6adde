//! Where a cause enters the simulator.

use serde::{Deserialize, Serialize};

/// Where a cause enters the simulator.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Hook {
    /// An amplitude that is zero in the base simulator.
    Extension(String),
    /// Added to one of the nine parameters. For a cause without a mechanism this is a law on that
    /// parameter, not the cause itself.
    Parameter(String),
    /// Added to a setting of the heap experiment: it moves angles but no dose.
    Heap(String),
    /// Affects readings, not the grains.
    Reading,
}
