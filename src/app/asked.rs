//! How often the bench had been stopped when something was asked: a stop that has come since makes void what would let the bench move.
//!
//! A request is asked when its head is there, however late its body comes. Whoever reads heads counts the stops then, and what works on the request does so
//! within [`asked_after`] them. Whoever calls without a request asks when he calls.

use super::{App, Result};

tokio::task_local! {
    static STOPS: u64;
}

/// Work on what was asked after so many stops.
pub async fn asked_after<T>(stops: u64, work: impl Future<Output = T>) -> T {
    STOPS.scope(stops, work).await
}

impl App {
    /// How often the bench was stopped since this process has it; no database is asked. 0 where opened to read.
    pub fn stops(&self) -> u64 {
        self.inner.jobs.as_ref().map_or(0, |jobs| jobs.bench().stops())
    }

    /// The same, when what is worked on now was asked.
    ///
    /// # Errors
    /// `Unavailable` when opened to read.
    pub(super) fn stops_when_asked(&self) -> Result<u64> {
        let bench = self.jobs_or_refuse()?.bench();
        Ok(STOPS.try_with(|stops| *stops).unwrap_or_else(|_| bench.stops()))
    }
}
