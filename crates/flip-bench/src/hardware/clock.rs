//! Bench time: wall-clock time, or that of an emulated laboratory, which passes only while
//! something waits.
//!
//! A virtual clock makes an emulated dose quick and reproducible: the bench thread is the only one
//! that waits, motions and replies take their time from it, and nothing depends on the speed of the
//! machine. Timeouts and dead-men use wall-clock time: they guard against things that do not
//! answer.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// A clock shared by the drivers and emulators of one bench. Clones show the same time.
#[derive(Debug, Clone)]
pub enum Clock {
    /// Wall-clock time; `speed` bench seconds pass per second, 1 on a real bench.
    Wall {
        /// When the clock read zero.
        began: Instant,
        /// Bench seconds per wall-clock second.
        speed: f64,
    },
    /// Microseconds waited so far.
    Virtual(Arc<AtomicU64>),
}

impl Clock {
    /// A wall clock.
    pub fn wall() -> Self {
        Self::fast(1.0)
    }

    /// A wall clock that runs this many times as fast: for emulated laboratories only.
    pub fn fast(speed: f64) -> Self {
        Self::Wall { began: Instant::now(), speed }
    }

    /// A clock that stands still except while something waits.
    pub fn standing() -> Self {
        Self::Virtual(Arc::default())
    }

    /// Seconds since the clock was made.
    pub fn now_s(&self) -> f64 {
        match self {
            Self::Wall { began, speed } => began.elapsed().as_secs_f64() * speed,
            Self::Virtual(passed_us) => passed_us.load(Ordering::SeqCst) as f64 * 1e-6,
        }
    }

    /// Let this much bench time pass.
    pub fn wait_s(&self, seconds: f64) {
        let seconds = seconds.max(0.0);
        match self {
            Self::Wall { speed, .. } => {
                std::thread::sleep(Duration::from_secs_f64(seconds / speed))
            }
            Self::Virtual(passed_us) => {
                passed_us.fetch_add((seconds * 1e6).round() as u64, Ordering::SeqCst);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_standing_clock_moves_by_what_is_waited_and_clones_show_the_same() {
        let clock = Clock::standing();
        let other = clock.clone();
        clock.wait_s(1.25);
        other.wait_s(0.000_001);
        assert_eq!((clock.now_s(), other.now_s()), (1.250_001, 1.250_001));
    }
}
