//! Rate-limited complaints: logged often enough to be noticed and seldom enough not to fill a disk.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Minimum time between two log lines about the same thing.
const QUIET: Duration = Duration::from_secs(10);

/// One recurring complaint.
#[derive(Debug, Default)]
pub struct Complaint {
    heard: Mutex<Heard>,
}

#[derive(Debug, Default)]
struct Heard {
    last: Option<Instant>,
    /// Occurrences suppressed since the last line.
    quiet: u64,
}

impl Complaint {
    /// Records `times` more occurrences: calls `log` with the number since its last call, at most
    /// once per [`QUIET`].
    pub fn happened(&self, times: u64, log: impl FnOnce(u64)) {
        if let Some(times) = self.due(times, Instant::now()) {
            log(times);
        }
    }

    fn due(&self, times: u64, now: Instant) -> Option<u64> {
        let mut heard = self.heard.lock().unwrap_or_else(PoisonError::into_inner);
        heard.quiet += times;
        if heard.last.is_some_and(|last| now.duration_since(last) < QUIET) {
            return None;
        }
        heard.last = Some(now);
        Some(std::mem::take(&mut heard.quiet))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flood_is_one_line_that_counts_it() {
        let (complaint, start) = (Complaint::default(), Instant::now());
        assert_eq!(complaint.due(1, start), Some(1));
        assert_eq!(complaint.due(3, start + QUIET / 2), None);
        assert_eq!(complaint.due(1, start + QUIET), Some(4));
    }
}
