//! Readiness: whether FLIP could weigh now, for monitoring.

use super::App;
use flip_store::health::{Check, Health};
use serde::Serialize;
use std::time::{Duration, Instant};
use tokio::sync::Mutex;

/// Minimum interval between checks, however many requests there are.
const LOOKS_APART: Duration = Duration::from_secs(1);

/// Whether a weighing requested now would be started and recorded, and what prevents it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Readiness {
    /// Nothing is in the way.
    pub ready: bool,
    /// The individual checks.
    pub checks: Checks,
}

/// Each check by name.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Checks {
    /// Space on the disk of the data folder.
    pub disk: Check,
    /// The database is writable: it is intact and no other program holds it.
    pub database: Check,
    /// The data folder is where it was when FLIP started.
    pub folder: Check,
    /// The lock that keeps a second FLIP out is in place.
    pub lock: Check,
    /// The bench is not latched, and no ending of a dose waits to be recorded.
    pub bench: Check,
}

impl Checks {
    /// All checks but the bench: those that matter to users who never weigh.
    pub fn store_is_ready(&self) -> bool {
        [&self.disk, &self.database, &self.folder, &self.lock].iter().all(|check| check.ok)
    }

    /// For callers who may not read: results, but not reasons.
    pub fn without_reasons(mut self) -> Self {
        for check in
            [&mut self.disk, &mut self.database, &mut self.folder, &mut self.lock, &mut self.bench]
        {
            check.why = None;
        }
        self
    }
}

/// The last result, and its time.
pub(super) type LastLook = Mutex<Option<(Instant, Readiness)>>;

impl App {
    /// Whether FLIP could weigh now. Checked at most once a second, however many requests there
    /// are.
    pub async fn readiness(&self) -> Readiness {
        let mut last = self.inner.readiness.lock().await;
        if let Some((at, found)) = &*last
            && at.elapsed() < LOOKS_APART
        {
            return found.clone();
        }
        let found = self.look_whether_ready().await;
        *last = Some((Instant::now(), found.clone()));
        found
    }

    async fn look_whether_ready(&self) -> Readiness {
        let Health { disk, database, folder, lock } = self.store().health().await;
        let checks = Checks {
            disk,
            database,
            folder,
            lock,
            bench: Check::of(self.bench_is_in_the_way().await),
        };
        Readiness { ready: checks.store_is_ready() && checks.bench.ok, checks }
    }

    async fn bench_is_in_the_way(&self) -> Option<String> {
        let standing =
            self.inner.jobs.as_ref().map(|jobs| jobs.bench().standing()).unwrap_or_default();
        if let Some(it) = standing.unwritten {
            let since = it.since;
            return Some(format!(
                "the end of weighing {} could not be recorded since {since}: {}",
                it.weighing, it.why
            ));
        }
        let latch = match standing.latch {
            Some(latch) => Ok(Some(latch)),
            None => self.store().latch_apart().await,
        };
        match latch {
            Ok(latch) => latch.map(|latch| format!("latched since {}: {}", latch.at, latch.reason)),
            Err(error) => Some(format!("whether it is latched is not known: {error}")),
        }
    }
}
