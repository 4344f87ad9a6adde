//! When is a client dead? By the clock of the room, where a robot moves.
//!
//! An emulated arm often shares its machine with whoever uses it, with trainings and calibrations beside both. Where the driver itself got no processor time
//! its client had none to renew either: such time is forgiven. A look that comes when it should says that the machine had time for everybody.

use std::time::{Duration, Instant};

/// Between two looks at whether the lease was renewed.
pub(super) const LOOK: Duration = Duration::from_millis(5);
/// A look that comes later than this after the one before was held up.
const ON_TIME: Duration = Duration::from_millis(10);
/// So many looks after one that was held up do not count either: whoever has to renew was held up as well.
const AFTERWARDS: u32 = 3;
/// So much is forgiven at most.
const FORGIVEN_MAX: Duration = Duration::from_millis(2700);

/// How long a lease lives without renewal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct DeadMan {
    pub limit: Duration,
    /// Time in which the driver was held up does not count.
    pub forgives: bool,
}

/// How long a lease has not been renewed.
#[derive(Debug)]
pub(super) struct Unrenewed {
    since: Instant,
    looked: Instant,
    counted: Duration,
    /// Looks that do not count.
    forgiven: u32,
}

impl Unrenewed {
    /// It was renewed now.
    pub(super) fn since(now: Instant) -> Self {
        Self { since: now, looked: now, counted: Duration::ZERO, forgiven: 0 }
    }

    /// The lease has ended by now.
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

    /// After how many of these looks, ms apart, the lease ends.
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
