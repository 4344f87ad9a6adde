//! Learning to weigh: from parameter sets to a policy.
//!
//! [`train`] plays episodes on simulated spoons ([`environment`]), stores their steps ([`replay`])
//! or, for a recurrent network, whole [`episodes`], improves a policy by Soft Actor-Critic
//! ([`sac`]) and moves from powder to powder according to a [`curriculum`]. [`evaluate`] measures
//! any controller on doses it was not trained on; [`schedule`] tunes the open-loop rival that a
//! policy has to beat, and [`rivals`] those of other robots. [`lockstep`] is the environment for
//! learners that are not ours.
//!
//! *Reproducible*: the same levels, settings and seed give the same bytes at any number of threads
//! and across any interruption. Episodes are played in rounds of a fixed size, each with its own
//! seed; every random number comes from a stream identified by a counter, so a checkpoint needs no
//! generator state; libtorch runs on one thread. Its bits depend on the kind of processor; those of
//! our own gradients (`fused`, a setting) do not.
//!
//! libtorch is confined to this folder, behind the feature `libtorch`: [`flip_policy`] runs a policy in
//! plain Rust. Without the feature everything but [`train`] and [`train_on`] remains.

#[cfg(feature = "libtorch")]
mod adam;
#[cfg(feature = "libtorch")]
mod by_libtorch;
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
mod fused;
pub mod lockstep;
#[cfg(feature = "libtorch")]
mod networks;
mod plan;
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
mod updates;

#[cfg(feature = "libtorch")]
pub use adam::Adam;
pub use record::{
    EpisodeRecord, Event, Flow, KEPT, Level, Losses, RANDOMISED, Start, TrainError, Trained,
};
pub use settings::{
    CriticLoss, Extended, FineTuning, Gradients, Network, Order, PAPER_LEVELS_DEG, Preset,
    Replayed, Settings,
};
pub use surrogate::Surrogate;
#[cfg(feature = "libtorch")]
pub use training::{train, train_beside, train_on};
