//! The policy shipped with FLIP.

use super::artifact::{Policy, encode, id};
use super::controller::Controller;
use super::episode::Rules;
use super::manifest::{Kind, Manifest};
use super::paced::Paced;
use flip_core::domain::bench::PitchLimits;
use std::sync::LazyLock;

/// A policy in its various forms.
#[derive(Debug, Clone)]
pub struct Shipped {
    /// Its content address.
    pub id: String,
    /// The policy.
    pub policy: Policy,
    /// Its bytes.
    pub bytes: Vec<u8>,
}

/// The rules of [`Paced::CHOSEN`], in at most 30 steps and as far as the arm pitches: the default for a weighing until another
/// policy has proved better. Present in every data folder.
pub fn shipped() -> &'static Shipped {
    static SHIPPED: LazyLock<Shipped> = LazyLock::new(|| {
        let rules = Rules { steps_max: 30, pitch: PitchLimits::OPEN, ..Rules::FLIP };
        let manifest = Manifest::of_untrained(Kind::Paced { paced: Paced::CHOSEN }, rules, 0);
        let policy = Policy { manifest, controller: Controller::Paced(Paced::CHOSEN) };
        let bytes = encode(&policy);
        Shipped { id: id(&bytes), policy, bytes }
    });
    &SHIPPED
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::decode;

    #[test]
    fn the_shipped_policy_is_one_that_any_robot_can_read() {
        let shipped = shipped();
        assert_eq!(decode(&shipped.bytes).unwrap(), shipped.policy);
        assert!(shipped.bytes.len() < 4096, "{} bytes", shipped.bytes.len());
    }
}
