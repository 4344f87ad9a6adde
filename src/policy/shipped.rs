//! The policy that comes with FLIP.

use super::artifact::{Policy, encode, id};
use super::controller::Controller;
use super::dispenser::Dispenser;
use super::episode::Rules;
use super::manifest::{Kind, Manifest};
use super::response::Response;
use std::sync::LazyLock;

/// A policy in the forms that it is kept in.
#[derive(Debug, Clone)]
pub struct Shipped {
    /// Its content address.
    pub id: String,
    /// The policy.
    pub policy: Policy,
    /// Its bytes.
    pub bytes: Vec<u8>,
}

/// The dispenser with [`Response::FITTED`], which a weighing takes as long as no other policy has shown to be better. Every data folder has it.
pub fn shipped() -> &'static Shipped {
    static SHIPPED: LazyLock<Shipped> = LazyLock::new(|| {
        let manifest = Manifest::of_untrained(Kind::Dispenser { response: Response::FITTED }, Rules::FLIP, 0);
        let policy = Policy { manifest, controller: Controller::Dispenser(Dispenser::new(Response::FITTED)) };
        let bytes = encode(&policy);
        Shipped { id: id(&bytes), policy, bytes }
    });
    &SHIPPED
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::policy::decode;

    #[test]
    fn the_shipped_policy_is_one_that_any_robot_can_read() {
        let shipped = shipped();
        assert_eq!(decode(&shipped.bytes).unwrap(), shipped.policy);
        assert!(shipped.bytes.len() < 4096, "{} bytes", shipped.bytes.len());
    }
}
