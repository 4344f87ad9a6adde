//! When is a client dead? By wall-clock time, like a moving robot.
//!
//! An emulated arm often shares its machine with its client, and with trainings and calibrations
//! running next to both. While the driver itself got no CPU time, its client had none to renew
//! either, so such time is forgiven. A check that runs on schedule shows that the machine had time
//! for everyone.

use std::time::{Duration, Instant};

/// How often the lease is checked.
pub(super) const LOOK: Duration = Duration::from_millis(5);
/// A check later than this after the one before was delayed.
const ON_TIME: Duration = Duration::from_millis(10);
/// This many checks after a delayed one do not count either: the client that has to renew was
/// delayed as well.
const AFTERWARDS: u32 = 3;
/// Maximum time forgiven.
const FORGIVEN_MAX: Duration = Duration::from_millis(2700);

/// How long a lease lives without renewal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct DeadMan {
    pub limit: Duration,
    /// Time in which the driver was delayed does not count.
    pub forgives: bool,
}

/// Time since a lease was last renewed.
#[derive(Debug)]
pub(super) struct Unrenewed {
    since: Instant,
    looked: Instant,
    counted: Duration,
    /// Checks that do not count.
    forgiven: u32,
}

impl Unrenewed {
    /// Renewed at `now`.
    pub(super) fn since(now: Instant) -> Self {
        Self { since: now, looked: now, counted: Duration::ZERO, forgiven: 0 }
    }

    /// Whether the lease has expired by now.
    pub(super) fn is_over(&mut self, dead_man: DeadMan, now: Instant) -> bool {
        let passed = now - self.looked;
        self.looked = now;
        if passed > ON_TIME {
            self.forgiven = AFTERWARDS;
        } else if self.forgiven > 0 {
            self.forgiven -= 1;
        } else {
            self.counted += passed;
        }
        let (counted, limit) = match dead_man.forgives {
            false => (now - self.since, dead_man.limit),
            true if now - self.since > dead_man.limit + FORGIVEN_MAX => return true,
            true => (self.counted, dead_man.limit),
        };
        counted > limit
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT: Duration = Duration::from_millis(300);

    /// The number of checks, ms apart, after which the lease expires.
    fn ends(forgives: bool, apart_ms: impl Iterator<Item = u64>) -> Option<u64> {
        let mut now = Instant::now();
        let (began, mut lease) = (now, Unrenewed::since(now));
        for ms in apart_ms {
            now += Duration::from_millis(ms);
            if lease.is_over(DeadMan { limit: LIMIT, forgives }, now) {
                return Some((now - began).as_millis() as u64);
            }
        }
        None
    }

    #[test]
    fn a_driver_that_was_held_up_forgives_its_client_and_a_robots_does_not() {
        let busy = || std::iter::repeat_n(90, 30);
        assert_eq!((ends(true, busy()), ends(false, busy())), (None, Some(360)));
        let calm = || std::iter::repeat_n(5, 100);
        assert_eq!((ends(true, calm()), ends(false, calm())), (Some(305), Some(305)));
    }

    #[test]
    fn what_was_held_up_once_still_ends_and_no_lease_lives_for_ever() {
        let once = [250].into_iter().chain(std::iter::repeat_n(5, 100));
        assert_eq!(ends(true, once), Some(250 + 15 + 305));
        assert_eq!(ends(true, std::iter::repeat(90)), Some(3060));
    }
}
