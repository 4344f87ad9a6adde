//! Events of a weighing, each sent before the motion that follows it.

use super::guard::{Allowed, Halt};
use flip_core::domain::bench::{Action, Tick};
use flip_core::domain::vial::VialFlaw;
use serde::Serialize;

/// Phase of a weighing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// The bench is about to move.
    Armed,
    /// Powder is about to fall.
    Dosing,
    /// Dosing is over; the spoon is about to be levelled and taken away.
    Settling,
}

/// Decision of the guard on a proposal.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Decision {
    /// The step, from 1.
    pub step: u32,
    /// What the policy proposed.
    pub proposed: Action,
    /// The action about to be carried out; `None`: nothing more is carried out.
    pub allowed: Option<Action>,
    /// Why it differs from the proposal, if it does.
    pub reason: Option<String>,
}

/// An event, sent before the motion that follows it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Event<'a> {
    /// A phase begins.
    Phase(Phase),
    /// Nothing is poured into the vessel on the pan.
    Pan(&'a VialFlaw),
    /// The guard has decided.
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
