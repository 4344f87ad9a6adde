//! The time that records carry: that of the database's server if it is on one, so that machines
//! whose clocks differ agree on when a lease ends and in which order things happened.
//!
//! Between two comparisons the server's time goes on as this machine's steady clock does: whoever
//! sets this machine's clock while a process runs neither ends nor prolongs a lease. A machine that
//! has slept is behind until the next comparison; what it then writes late is refused by its fence.

use flip_core::domain::timestamp::Timestamp;
use sqlx::AnyPool;
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{PoisonError, RwLock};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// The server's clock as this process knows it: one for the whole process, which works on one
/// database.
static SERVER: RwLock<Option<Known>> = RwLock::new(None);
/// How far the server's clock was ahead of this machine's when that was last told, ms.
static TOLD_MS: AtomicI64 = AtomicI64::new(0);

/// What a clock said, and when.
#[derive(Debug, Clone, Copy)]
struct Known {
    ms: i64,
    at: Instant,
}

impl Known {
    fn ms_at(self, then: Instant) -> i64 {
        self.ms + then.saturating_duration_since(self.at).as_millis() as i64
    }
}

/// The present time.
pub fn now() -> Timestamp {
    let known = *SERVER.read().unwrap_or_else(PoisonError::into_inner);
    Timestamp::from_unix_ms(known.map_or_else(here_ms, |known| known.ms_at(Instant::now())))
}

fn here_ms() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_millis() as i64
}

/// Ask the server for its time, and go by it from here on.
pub(super) async fn set(server: &AnyPool) -> sqlx::Result<()> {
    let asked = Instant::now();
    let sql = "SELECT CAST(extract(epoch FROM clock_timestamp()) * 1000 AS BIGINT)";
    let said: i64 = sqlx::query_scalar(sql).fetch_one(server).await?;
    let (at, here) = (Instant::now(), here_ms());
    let mut server = SERVER.write().unwrap_or_else(PoisonError::into_inner);
    let ours = server.map_or(here, |known| known.ms_at(at));
    let known = Known { ms: set_by(ours, said, at - asked), at };
    *server = Some(known);
    drop(server);
    let ahead = known.ms - here;
    if TOLD_MS.load(Ordering::Relaxed).abs_diff(ahead) > 1000 {
        TOLD_MS.store(ahead, Ordering::Relaxed);
        tracing::warn!(ahead_ms = ahead, "this machine's clock differs from the database server's");
    }
    Ok(())
}

/// The time of a server that said `said` at some moment of the wait that has just ended: as little
/// from ours as fits.
fn set_by(ours: i64, said: i64, wait: Duration) -> i64 {
    // Each of the three is cut to milliseconds.
    ours.clamp(said, said + wait.as_millis() as i64 + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_is_set_by_as_little_as_explains_the_servers_answer() {
        let wait = Duration::from_millis(10);
        for (ours, set) in
            [(99, 100), (100, 100), (105, 105), (111, 111), (112, 111), (600_000, 111)]
        {
            assert_eq!(set_by(ours, 100, wait), set, "{ours}");
        }
    }

    #[test]
    fn between_comparisons_the_time_goes_on_whatever_this_machines_clock_says() {
        let known = Known { ms: 1000, at: Instant::now() };
        assert_eq!(known.ms_at(known.at + Duration::from_secs(9)), 10_000);
        assert_eq!(known.ms_at(known.at - Duration::from_secs(1)), 1000, "it never goes back");
    }
}
