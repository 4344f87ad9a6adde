//! Choosing the next action: observations in, actions out, in plain Rust.
//!
//! A [`Policy`] is a file that any robot can load: a [`Controller`] and the [`Manifest`] that
//! records its origin. Nothing here needs libtorch; `train` produces the weights, [`Actor`] runs
//! them.

mod actor;
mod artifact;
mod controller;
mod dispenser;
mod episode;
mod fuzzy;
mod manifest;
mod observation;
mod paced;
mod pid;
mod recurrent;
mod response;
mod shipped;

pub use actor::{Actor, Carried, Head, LOG_STD_MAX, LOG_STD_MIN, Malformed, OUTPUTS, normal};
pub use artifact::{ArtifactError, Policy, decode, encode, id};
pub use controller::{Controller, Done, Dosing, Schedule, ScheduledStep};
pub use dispenser::Dispenser;
pub use episode::{Ending, Episode, ON_TARGET_MG, Rules, is_on_target, on_target_mg};
pub use fuzzy::Fuzzy;
pub use manifest::{Kind, LevelManifest, Manifest, SetManifest, Switch, SwitchReason};
pub use observation::{Encoding, Known, Observation};
pub use paced::Paced;
pub use pid::{Gains, Pid};
pub use response::{Response, Spoonful};
pub use shipped::{Shipped, all_shipped, shipped};
