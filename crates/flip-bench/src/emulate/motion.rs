//! Something that moves at an even speed by the bench's clock.

use crate::hardware::clock::Clock;

/// A way from one position to another; standing where the two are one.
#[derive(Debug, Clone, Copy)]
pub(super) struct Motion {
    /// Where it began.
    pub from: f64,
    /// Where it ends.
    pub to: f64,
    /// Bench time when it began, s.
    pub began_s: f64,
    /// Speed, positions a second.
    pub per_second: f64,
}

impl Motion {
    /// Standing there.
    pub(super) fn standing(at: f64) -> Self {
        Self { from: at, to: at, began_s: 0.0, per_second: 1.0 }
    }

    /// Bench time when it ends, s.
    pub(super) fn ends_s(&self) -> f64 {
        self.began_s + (self.to - self.from).abs() / self.per_second
    }

    /// Where it is at that bench time, s.
    pub(super) fn at(&self, now_s: f64) -> f64 {
        let way = self.to - self.from;
        self.from + (self.per_second * (now_s - self.began_s)).min(way.abs()) * way.signum()
    }
}

/// A standing clock moves only when somebody waits: what goes on until then is seen going on once, then waited out.
pub(super) fn wait_out(clock: &Clock, until_s: f64) {
    let remaining_s = until_s - clock.now_s();
    if matches!(clock, Clock::Virtual(_)) && remaining_s > 0.0 {
        // The clock counts whole microseconds.
        clock.wait_s(remaining_s + 1e-6);
    }
}
