//! Reading the audit trail: records in the table and in archives, as one sequence.
//!
//! A record of kind `lost` stands in for those in a missing archive, and names it.

use super::archive::{Order, aways};
use super::audit::{AuditRecord, Written};
use super::page::{LONG_BATCH, Page, Window};
use super::{Result, Store};

impl Store {
    /// Records, newest first; of one weighing if given.
    pub async fn audit_records(
        &self,
        weighing: Option<&str>,
        window: Window,
    ) -> Result<Page<AuditRecord>> {
        // One snapshot: records archived meanwhile would be missing, or appear twice.
        let mut tx = self.reader.begin().await?;
        let sql = "SELECT * FROM audit WHERE seq < ?1 AND (?3 IS NULL OR weighing = ?3) ORDER BY seq DESC LIMIT ?2";
        let query = sqlx::query(sql).bind(window.before()).bind(window.rows()).bind(weighing);
        let mut found = records(&query.fetch_all(&mut *tx).await?)?;
        let is_full = found.len() as i64 == window.rows();
        let floor = found.last().filter(|_| is_full).map_or(0, |last| last.seq);
        let aways =
            aways(&mut tx, weighing, (floor, window.before()), Order::Newest, window.rows())
                .await?;
        let mut taken = 0;
        for away in aways {
            let archived = self.archived(&away)?.into_iter().filter(|it| it.seq < window.before());
            let before = found.len();
            found.extend(archived);
            taken += (found.len() - before) as i64;
            if taken >= window.rows() {
                break;
            }
        }
        found.sort_by_key(|it| std::cmp::Reverse(it.seq));
        Ok(window.page(found.into_iter().map(|it| (it.seq, it)).collect()))
    }

    /// Every record after `after`, oldest first, at most a few thousand; of one weighing if given.
    pub async fn audit_after(
        &self,
        weighing: Option<&str>,
        after: i64,
    ) -> Result<Vec<AuditRecord>> {
        let mut tx = self.long.begin().await?;
        let sql = "SELECT * FROM audit WHERE seq > ?1 AND (?3 IS NULL OR weighing = ?3) ORDER BY seq LIMIT ?2";
        let query = sqlx::query(sql).bind(after).bind(LONG_BATCH).bind(weighing);
        let mut found = records(&query.fetch_all(&mut *tx).await?)?;
        let is_full = found.len() as i64 == LONG_BATCH;
        let ceiling = found.last().filter(|_| is_full).map_or(i64::MAX, |last| last.seq);
        let aways = aways(&mut tx, weighing, (after, ceiling), Order::Oldest, LONG_BATCH).await?;
        let mut taken = 0;
        for away in aways {
            let before = found.len();
            found.extend(self.archived(&away)?.into_iter().filter(|it| it.seq > after));
            taken += (found.len() - before) as i64;
            if taken >= LONG_BATCH {
                break;
            }
        }
        found.sort_by_key(|it| it.seq);
        found.truncate(LONG_BATCH as usize);
        Ok(found)
    }
}

fn records(rows: &[sqlx::sqlite::SqliteRow]) -> Result<Vec<AuditRecord>> {
    rows.iter().map(|row| Written::of(row)?.record()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[tokio::test]
    async fn long_answers_come_in_parts_and_take_no_reader_from_others() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).await.unwrap();
        let many = "WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM n WHERE k < 5000)
             INSERT INTO audit (seq, at, weighing, kind, body, hash)
             SELECT (SELECT max(seq) FROM audit) + k, 0, NULL, 'reading', '{}', printf('%064d', k) FROM n";
        sqlx::query(many).execute(store.writer().unwrap()).await.unwrap();
        let mut others = Vec::new();
        while let Some(reader) = store.reader.try_acquire() {
            others.push(reader);
        }
        for _ in others.len()..store.reader.options().get_max_connections() as usize {
            others.push(store.reader.acquire().await.unwrap());
        }
        let long = async {
            assert_eq!(store.audit_after(None, 0).await.unwrap().len() as i64, LONG_BATCH);
            assert!(!store.measurements_after(None, 0).await.unwrap().0.is_empty());
            assert!(store.observations_after(None, 0).await.unwrap().0.is_empty());
        };
        tokio::time::timeout(Duration::from_secs(10), long).await.expect("nobody is waited for");
    }
}
