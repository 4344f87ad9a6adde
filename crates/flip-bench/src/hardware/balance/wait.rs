//! Time limits for waiting.

use crate::hardware::clock::Clock;
use std::time::{Duration, Instant};

/// A limit in bench time; where the bench clock stands still because nobody waits, wall-clock time
/// ends it as well.
pub(super) struct Patience {
    clock: Clock,
    until_s: f64,
    until: Instant,
}

impl Patience {
    pub(super) fn new(clock: &Clock, limit_s: f64) -> Self {
        let limit = Duration::try_from_secs_f64(limit_s).unwrap_or(Duration::ZERO);
        Self {
            clock: clock.clone(),
            until_s: clock.now_s() + limit_s,
            until: Instant::now() + limit,
        }
    }

    pub(super) fn is_spent(&self) -> bool {
        self.until_s.is_nan() || self.clock.now_s() >= self.until_s || Instant::now() >= self.until
    }
}
