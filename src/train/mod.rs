//! Learning to weigh: from parameter sets to a policy.
//!
//! [`train`] plays episodes on simulated spoons ([`environment`]), stores their steps ([`replay`])
//! or, for a recurrent network, whole [`episodes`], improves a policy by Soft Actor-Critic
//! ([`sac`]) and moves from powder to powder according to a [`curriculum`]. [`evaluate`] measures
//! any controller on doses it was not trained on; [`schedule`] tunes the open-loop rival that a
//! policy has to beat, and [`rivals`] those of other robots.
//!
//! *Reproducible*: the same levels, settings and seed give the same bytes at any number of threads
//! and across any interruption. Episodes are played in rounds of a fixed size, each with its own
//! seed; every random number comes from a stream identified by a counter, so a checkpoint needs no
//! generator state; libtorch runs on one thread.
//!
//! libtorch is confined to this folder: [`crate::policy`] runs a policy in plain Rust.

mod adam;
mod checkpoint;
mod collect;
pub mod curriculum;
pub mod environment;
pub mod episodes;
pub mod evaluate;
pub mod formula;
mod networks;
mod recurrent;
pub mod replay;
pub mod rivals;
pub mod sac;
pub mod schedule;
mod settings;
mod spoons;
mod surrogate;
mod training;

pub use adam::Adam;
pub use settings::{CriticLoss, Extended, FineTuning, Network, Order, PAPER_LEVELS_DEG, Preset, Replayed, Settings};
pub use surrogate::Surrogate;
pub use training::{EpisodeRecord, Event, Flow, Level, RANDOMISED, Start, TrainError, Trained, train, train_on};
