//! Learning to weigh: parameter sets in, a policy out.
//!
//! [`train`] plays episodes on simulated spoons ([`environment`]), remembers their steps ([`replay`]) or, for a recurrent network,
//! whole [`episodes`], improves a policy by Soft Actor-Critic ([`sac`]) and moves from powder to powder as a [`curriculum`] says.
//! [`evaluate`] measures any controller on doses it never practised; [`schedule`] tunes the open-loop rival that a policy has to beat,
//! and [`rivals`] those of other robots.
//!
//! *Reproducible*: the same levels, settings and seed give the same bytes at any number of threads and across any
//! interruption. Episodes are played in rounds of a fixed number, each with a seed of its own; every random number comes
//! from a stream named by a counter, so a checkpoint needs no generator's state; libtorch runs on one thread.
//!
//! libtorch stays in this folder, behind the feature `libtorch`: a policy is run by [`flip_policy`], in plain Rust. Without the
//! feature there is everything but [`train`] and [`train_on`].

#[cfg(feature = "libtorch")]
mod adam;
#[cfg(feature = "libtorch")]
mod checkpoint;
#[cfg(feature = "libtorch")]
mod collect;
pub mod curriculum;
pub mod environment;
#[cfg(feature = "libtorch")]
pub mod episodes;
pub mod evaluate;
pub mod formula;
#[cfg(feature = "libtorch")]
mod networks;
mod record;
#[cfg(feature = "libtorch")]
mod recurrent;
#[cfg(feature = "libtorch")]
pub mod replay;
pub mod rivals;
#[cfg(feature = "libtorch")]
pub mod sac;
pub mod schedule;
mod settings;
mod spoons;
mod surrogate;
#[cfg(feature = "libtorch")]
mod training;

#[cfg(feature = "libtorch")]
pub use adam::Adam;
pub use record::{EpisodeRecord, Event, Flow, Level, Losses, RANDOMISED, Start, TrainError, Trained};
pub use settings::{CriticLoss, Extended, FineTuning, Network, Order, PAPER_LEVELS_DEG, Preset, Replayed, Settings};
pub use surrogate::Surrogate;
#[cfg(feature = "libtorch")]
pub use training::{train, train_on};
