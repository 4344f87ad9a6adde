//! The policies shipped with FLIP.

use super::artifact::{Policy, encode, id};
use super::controller::Controller;
use super::dispenser::Dispenser;
use super::episode::Rules;
use super::manifest::{Kind, Manifest};
use super::paced::Paced;
use super::response::Response;
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

/// The rules of [`Paced::CHOSEN`], in at most 30 steps and as far as the arm pitches: the default for
/// a weighing until another policy has proved better. Present in every data folder.
pub fn shipped() -> &'static Shipped {
    all_shipped()[0]
}

/// The shipped policies, the default first: beside it the dispenser with its fitted prior, in as
/// many steps, which weighs where evaluations say that it is the better one.
pub fn all_shipped() -> [&'static Shipped; 2] {
    static SHIPPED: LazyLock<[Shipped; 2]> = LazyLock::new(|| {
        let response = Response::FITTED;
        [
            of(Kind::Paced { paced: Paced::CHOSEN }, Controller::Paced(Paced::CHOSEN)),
            of(Kind::Dispenser { response }, Controller::Dispenser(Dispenser::new(response))),
        ]
    });
    SHIPPED.each_ref()
}

fn of(kind: Kind, controller: Controller) -> Shipped {
    let rules = Rules { steps_max: 30, pitch: PitchLimits::OPEN, ..Rules::FLIP };
    let policy = Policy { manifest: Manifest::of_untrained(kind, rules, 0), controller };
    let bytes = encode(&policy);
    Shipped { id: id(&bytes), policy, bytes }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::decode;

    #[test]
    fn the_shipped_policies_are_two_that_any_robot_can_read() {
        for shipped in all_shipped() {
            assert_eq!(decode(&shipped.bytes).unwrap(), shipped.policy);
            assert!(shipped.bytes.len() < 4096, "{} bytes", shipped.bytes.len());
        }
        assert_ne!(all_shipped()[0].id, all_shipped()[1].id);
    }
}
