//! Motion at constant speed, by the bench clock.

use crate::hardware::clock::Clock;

/// A move from one position to another; at rest where the two are equal.
#[derive(Debug, Clone, Copy)]
pub(super) struct Motion {
    /// Start position.
    pub from: f64,
    /// End position.
    pub to: f64,
    /// Bench time of the start, s.
    pub began_s: f64,
    /// Speed, position units per second.
    pub per_second: f64,
}

impl Motion {
    /// At rest at this position.
    pub(super) fn standing(at: f64) -> Self {
        Self { from: at, to: at, began_s: 0.0, per_second: 1.0 }
    }

    /// Bench time of the end, s.
    pub(super) fn ends_s(&self) -> f64 {
        self.began_s + (self.to - self.from).abs() / self.per_second
    }

    /// Position at that bench time, s.
    pub(super) fn at(&self, now_s: f64) -> f64 {
        let way = self.to - self.from;
        self.from + (self.per_second * (now_s - self.began_s)).min(way.abs()) * way.signum()
    }
}

/// A virtual clock advances only while something waits: motion in progress is observed once, then
/// waited out.
pub(super) fn wait_out(clock: &Clock, until_s: f64) {
    let remaining_s = until_s - clock.now_s();
    if matches!(clock, Clock::Virtual(_)) && remaining_s > 0.0 {
        // The clock counts whole microseconds.
        clock.wait_s(remaining_s + 1e-6);
    }
}
