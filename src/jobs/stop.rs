//! Why a running job should stop, as a flag that its loop polls.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicU8, Ordering};

/// Why a running job should stop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub(super) enum Stop {
    /// The process is shutting down: save a checkpoint and return to the queue.
    Shutdown = 1,
    /// It was cancelled on request.
    Cancelled = 2,
    /// The lease is lost: another worker computes this job, nothing may be written.
    Fenced = 3,
}

/// The flag. A weightier reason replaces a lighter one, never the other way round.
#[derive(Debug, Default)]
pub(super) struct StopFlag(AtomicU8);

impl StopFlag {
    /// Requests a stop.
    pub fn set(&self, reason: Stop) {
        self.0.fetch_max(reason as u8, Ordering::SeqCst);
    }

    /// The reason, if there is one.
    pub fn get(&self) -> Option<Stop> {
        match self.0.load(Ordering::SeqCst) {
            0 => None,
            1 => Some(Stop::Shutdown),
            2 => Some(Stop::Cancelled),
            _ => Some(Stop::Fenced),
        }
    }

    /// Whether a loop should continue.
    pub fn flow(&self) -> ControlFlow<()> {
        match self.get() {
            None => ControlFlow::Continue(()),
            Some(_) => ControlFlow::Break(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lost_lease_outweighs_a_cancellation_and_that_a_shutdown() {
        let flag = StopFlag::default();
        assert_eq!(flag.flow(), ControlFlow::Continue(()));
        flag.set(Stop::Cancelled);
        flag.set(Stop::Shutdown);
        assert_eq!(flag.get(), Some(Stop::Cancelled));
        flag.set(Stop::Fenced);
        flag.set(Stop::Cancelled);
        assert_eq!((flag.get(), flag.flow()), (Some(Stop::Fenced), ControlFlow::Break(())));
    }
}
