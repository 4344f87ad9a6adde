//! What a weighing tells whoever listens, each before the motion that follows it.

use super::guard::{Allowed, Halt};
use flip_core::domain::bench::{Action, Tick};
use flip_core::domain::vial::VialFlaw;
use serde::Serialize;

/// Where a weighing has come to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// The bench is about to move.
    Armed,
    /// Powder is about to fall.
    Dosing,
    /// No more powder is asked for; the spoon is about to be levelled and taken away.
    Settling,
}

/// What the guard made of a proposal.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Decision {
    /// The step that it is about, from 1.
    pub step: u32,
    /// What the policy proposed.
    pub proposed: Action,
    /// What is about to be carried out; none: nothing any more.
    pub allowed: Option<Action>,
    /// Why it is not what was proposed, if it is not.
    pub reason: Option<String>,
}

/// What whoever listens hears, each before the motion that follows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Event<'a> {
    /// A phase begins.
    Phase(Phase),
    /// Nothing is poured into what stands on the pan.
    Pan(&'a VialFlaw),
    /// The guard decided.
    Decision(&'a Decision),
    /// A step was carried out and its reading is known.
    Tick(&'a Tick),
}

impl Decision {
    pub(super) fn new(step: u32, proposed: Action, allowed: &Result<Allowed, Halt>) -> Self {
        let (action, reason) = match allowed {
            Ok(allowed) => (Some(allowed.action), allowed.cut.map(|cut| cut.to_string())),
            Err(halt) => (None, Some(halt.to_string())),
        };
        Self { step, proposed, allowed: action, reason }
    }
}
