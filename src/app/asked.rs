//! How often the bench had been stopped when a request was made: a later stop invalidates any
//! request that would let the bench move.
//!
//! A request counts as made when its head has arrived, however late its body comes. The code that
//! reads heads counts the stops then, and the request is processed within [`asked_after`] with that
//! count. A call outside a request counts as made when it is called.

use super::{App, Result};

tokio::task_local! {
    static STOPS: u64;
}

/// Processes a request that was made after this many stops.
pub async fn asked_after<T>(stops: u64, work: impl Future<Output = T>) -> T {
    STOPS.scope(stops, work).await
}

impl App {
    /// Number of bench stops since this process opened it; no database is queried. 0 if opened
    /// read-only.
    pub fn stops(&self) -> u64 {
        self.inner.jobs.as_ref().map_or(0, |jobs| jobs.bench().stops())
    }

    /// The same at the time the current request was made.
    ///
    /// # Errors
    /// `Unavailable` if opened read-only.
    pub(super) fn stops_when_asked(&self) -> Result<u64> {
        let bench = self.jobs_or_refuse()?.bench();
        Ok(STOPS.try_with(|stops| *stops).unwrap_or_else(|_| bench.stops()))
    }
}
