//! Processor time, and its spread over repeated windows.

use rustix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};

/// Processor time of this process so far, over all threads, s.
fn processor_s() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// Processor time used by `run`, s, and its result.
pub(super) fn core_s<T>(run: impl FnOnce() -> T) -> (f64, T) {
    let before = processor_s();
    let value = run();
    (processor_s() - before, value)
}

/// Peak memory of this process so far, MiB, where the system reports it.
pub(super) fn rss_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    line.split_whitespace().next()?.parse::<f64>().ok().map(|kb| kb / 1024.0)
}

/// A quantity over windows, which differ in what the scene does during them and in what else the
/// machine does.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Spread {
    pub median: f64,
    pub min: f64,
    pub max: f64,
}

impl Spread {
    /// The spread of at least one value.
    pub(super) fn of(values: &[f64]) -> Self {
        let mut sorted = values.to_vec();
        sorted.sort_unstable_by(f64::total_cmp);
        let n = sorted.len();
        Self {
            median: (sorted[(n - 1) / 2] + sorted[n / 2]) / 2.0,
            min: sorted[0],
            max: sorted[n - 1],
        }
    }

    /// The spread of `windows` runs of `measure`.
    pub(super) fn over(windows: u32, measure: impl FnMut(u32) -> f64) -> Self {
        Self::of(&(0..windows).map(measure).collect::<Vec<_>>())
    }

    /// Multiplies every value by `factor`, which is positive.
    pub(super) fn scaled(self, factor: f64) -> Self {
        Self { median: self.median * factor, min: self.min * factor, max: self.max * factor }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spread_has_the_middle_and_the_ends() {
        assert_eq!(Spread::of(&[3.0, 1.0, 2.0]), Spread { median: 2.0, min: 1.0, max: 3.0 });
        assert_eq!(Spread::of(&[4.0, 1.0, 2.0, 8.0]).median, 3.0);
    }

    #[test]
    fn work_takes_processor_time_and_its_value_comes_back() {
        let (spent, value) =
            core_s(|| (0..20_000_000u64).fold(0, |sum, k| std::hint::black_box(sum + k % 2)));
        assert_eq!(value, 10_000_000);
        assert!(spent > 0.0005, "{spent}");
    }
}
