//! The load on the balance's pan over time: powder that lands, a vial that is lifted.

use crate::hardware::clock::Clock;
use std::sync::{Arc, Mutex, PoisonError};

/// A change of the load: when, and by how much.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Change {
    /// Bench time, s.
    pub at_s: f64,
    /// Mass added, mg; negative where something was removed.
    pub mass_mg: f64,
}

/// The pan of one bench, shared by everything that adds to it or weighs it.
#[derive(Debug, Clone)]
pub struct Pan {
    clock: Clock,
    changes: Arc<Mutex<Vec<Change>>>,
}

impl Pan {
    /// A pan that has always held this mass, mg (a vial).
    pub fn holding(mass_mg: f64, clock: Clock) -> Self {
        let first = Change { at_s: f64::NEG_INFINITY, mass_mg };
        Self { clock, changes: Arc::new(Mutex::new(vec![first])) }
    }

    /// The bench's clock.
    pub fn clock(&self) -> &Clock {
        &self.clock
    }

    /// Let this mass land on the pan now, mg; negative: it is removed.
    pub fn add_mg(&self, mass_mg: f64) {
        self.add_at(self.clock.now_s(), mass_mg);
    }

    /// Let this mass land on the pan at that bench time, s, which may be in the future (powder
    /// falls for a few hundredths of a second).
    pub fn add_at(&self, at_s: f64, mass_mg: f64) {
        if mass_mg != 0.0 {
            self.locked().push(Change { at_s, mass_mg });
        }
    }

    /// True load now, mg.
    pub fn load_mg(&self) -> f64 {
        let now = self.clock.now_s();
        self.locked().iter().filter(|change| change.at_s <= now).map(|change| change.mass_mg).sum()
    }

    /// True load once everything has landed, mg.
    pub fn final_load_mg(&self) -> f64 {
        self.locked().iter().map(|change| change.mass_mg).sum()
    }

    /// Current reading of a load cell with this time constant, mg: each change contributes its own
    /// exponential.
    ///
    /// ```text
    /// m(t) = sum over changes before t of m_i (1 - exp(-(t - t_i) / tau))
    /// ```
    pub fn felt_mg(&self, tau_s: f64) -> f64 {
        let now = self.clock.now_s();
        let felt =
            |change: &Change| change.mass_mg * (1.0 - libm::exp(-(now - change.at_s) / tau_s));
        self.locked().iter().filter(|change| change.at_s <= now).map(felt).sum()
    }

    /// Seconds since the load last changed.
    pub fn quiet_s(&self) -> f64 {
        let now = self.clock.now_s();
        let last = self
            .locked()
            .iter()
            .map(|change| change.at_s)
            .filter(|at| *at <= now)
            .fold(f64::NEG_INFINITY, f64::max);
        now - last
    }

    fn locked(&self) -> std::sync::MutexGuard<'_, Vec<Change>> {
        self.changes.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_load_cell_follows_each_change_by_its_own_exponential() {
        let pan = Pan::holding(1000.0, Clock::standing());
        pan.add_mg(10.0);
        pan.clock().wait_s(0.16);
        assert!((pan.felt_mg(0.16) - (1000.0 + 10.0 * (1.0 - (-1.0f64).exp()))).abs() < 1e-9);
        pan.add_at(1.0, 5.0);
        assert_eq!((pan.load_mg(), pan.final_load_mg()), (1010.0, 1015.0));
        assert!((pan.quiet_s() - 0.16).abs() < 1e-9);
    }
}
