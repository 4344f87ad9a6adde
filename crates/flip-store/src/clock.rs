//! The time that records carry: that of the database's server if it is on one, so that machines
//! whose clocks differ agree on when a lease ends and in which order things happened.

use flip_core::domain::timestamp::Timestamp;
use sqlx::AnyPool;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::{SystemTime, UNIX_EPOCH};

/// How far the server's clock is ahead of this machine's, ms; one for the whole process, which
/// works on one database.
static AHEAD_MS: AtomicI64 = AtomicI64::new(0);

/// The present time.
pub fn now() -> Timestamp {
    Timestamp::from_unix_ms(here_ms() + AHEAD_MS.load(Ordering::Relaxed))
}

fn here_ms() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_millis() as i64
}

/// Compare this machine's clock with the server's, and go by the server's from here on.
pub(super) async fn set(server: &AnyPool) -> sqlx::Result<()> {
    let before = here_ms();
    let sql = "SELECT CAST(extract(epoch FROM clock_timestamp()) * 1000 AS BIGINT)";
    let there: i64 = sqlx::query_scalar(sql).fetch_one(server).await?;
    let ahead = ahead_ms(before, there, here_ms());
    if AHEAD_MS.swap(ahead, Ordering::Relaxed).abs_diff(ahead) > 1000 {
        tracing::warn!(ahead_ms = ahead, "this machine's clock differs from the database server's");
    }
    Ok(())
}

/// How far a clock is ahead that said `there` between `before` and `after`: as little as fits.
fn ahead_ms(before: i64, there: i64, after: i64) -> i64 {
    (there - after).max(0) + (there - before).min(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_is_ahead_by_as_little_as_explains_its_answer() {
        for (there, ahead) in [(100, 0), (103, 0), (110, 0), (111, 1), (99, -1), (600_105, 599_995)]
        {
            assert_eq!(ahead_ms(100, there, 110), ahead, "{there}");
        }
    }
}
