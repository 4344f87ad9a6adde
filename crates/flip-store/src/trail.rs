//! Reading the audit trail: records in the table and in archives, as one sequence.
//!
//! A record of kind `lost` stands in for those in a missing archive, and names it.

use super::archive::{Order, aways, count_records};
use super::audit::{AuditRecord, Written};
use super::audit_search::{AuditFound, AuditWanted};
use super::page::{LONG_BATCH, Window};
use super::sql::Parts;
use super::{Result, Store};
use sqlx::AnyConnection;

impl Store {
    /// The records that match, newest first, and how many they are.
    pub async fn audit_records(&self, wanted: &AuditWanted, window: Window) -> Result<AuditFound> {
        let searches = wanted.may_be_archived() && !wanted.is_plain();
        // One snapshot: records archived meanwhile would be missing, or appear twice. A search of
        // all archives takes its time: others shall not wait for it.
        let pool = if searches { &self.long } else { &self.reader };
        let mut tx = pool.begin().await?;
        let (before, rows) = (window.before(), window.rows());
        let mut sql = Parts::new(self.is_postgres(), "SELECT count(*) FROM audit WHERE ");
        wanted.restrict(&mut sql);
        let mut total: i64 = sql.scalar().fetch_one(&mut *tx).await?;
        let mut sql = Parts::new(self.is_postgres(), "SELECT * FROM audit WHERE ");
        wanted.restrict(&mut sql);
        sql.push(" AND seq < ").push_bind(before).push(" ORDER BY seq DESC LIMIT ").push_bind(rows);
        let mut found = records(&sql.query().fetch_all(&mut *tx).await?)?;
        if searches {
            let (some, count) = self.in_archives(&mut tx, wanted, before, rows).await?;
            found.extend(some);
            total += count;
        } else if wanted.may_be_archived() {
            let is_full = found.len() as i64 == rows;
            let floor = found.last().filter(|_| is_full).map_or(0, |last| last.seq);
            let weighing = wanted.weighing.as_deref();
            let mut taken = 0;
            for away in aways(&mut tx, weighing, (floor, before), Order::Newest, rows).await? {
                let archived = self.archived(&away)?.into_iter().filter(|it| it.seq < before);
                let length = found.len();
                found.extend(archived);
                taken += (found.len() - length) as i64;
                if taken >= rows {
                    break;
                }
            }
            total += count_records(&mut tx, weighing).await?;
        }
        found.sort_by_key(|it| std::cmp::Reverse(it.seq));
        let page = window.page(found.into_iter().map(|it| (it.seq, it)).collect());
        Ok(AuditFound { page, total: total.unsigned_abs() })
    }

    /// The newest records of archives that match, of those before a position, and how many match
    /// wherever they are.
    async fn in_archives(
        &self,
        connection: &mut AnyConnection,
        wanted: &AuditWanted,
        before: i64,
        rows: i64,
    ) -> Result<(Vec<AuditRecord>, i64)> {
        let all = (0, i64::MAX);
        let (mut found, mut total) = (Vec::new(), 0);
        let weighing = wanted.weighing.as_deref();
        for away in aways(connection, weighing, all, Order::Newest, i64::MAX).await? {
            let mut archived = self.archived(&away)?;
            archived.retain(|it| wanted.takes(it));
            total += archived.len() as i64;
            if (found.len() as i64) < rows {
                found.extend(archived.into_iter().filter(|it| it.seq < before));
            }
        }
        Ok((found, total))
    }

    /// The records that match after `after`, oldest first, at most a few thousand.
    pub async fn audit_after(&self, wanted: &AuditWanted, after: i64) -> Result<Vec<AuditRecord>> {
        let mut tx = self.long.begin().await?;
        let mut sql = Parts::new(self.is_postgres(), "SELECT * FROM audit WHERE ");
        wanted.restrict(&mut sql);
        sql.push(" AND seq > ").push_bind(after).push(" ORDER BY seq LIMIT ").push_bind(LONG_BATCH);
        let mut found = records(&sql.query().fetch_all(&mut *tx).await?)?;
        if !wanted.may_be_archived() {
            return Ok(found);
        }
        let is_full = found.len() as i64 == LONG_BATCH;
        let ceiling = found.last().filter(|_| is_full).map_or(i64::MAX, |last| last.seq);
        // Of a search nobody knows how many archives hold a batch.
        let most = if wanted.is_plain() { LONG_BATCH } else { i64::MAX };
        let weighing = wanted.weighing.as_deref();
        let mut taken = 0;
        for away in aways(&mut tx, weighing, (after, ceiling), Order::Oldest, most).await? {
            let before = found.len();
            let archived = self.archived(&away)?.into_iter();
            found.extend(archived.filter(|it| it.seq > after && wanted.takes(it)));
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

fn records(rows: &[sqlx::any::AnyRow]) -> Result<Vec<AuditRecord>> {
    rows.iter().map(|row| Written::of(row)?.record()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;
    use std::time::Duration;

    #[tokio::test]
    async fn long_answers_come_in_parts_and_take_no_reader_from_others() {
        let folder = tempfile::tempdir().unwrap();
        let store = testing::open(folder.path()).await.unwrap();
        let many = "WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM n WHERE k < 5000)
             INSERT INTO audit (seq, at, weighing, kind, body, hash)
             SELECT (SELECT max(seq) FROM audit) + k, 0, NULL, 'reading', '{}', 
                    CAST(10000000 + k AS TEXT) || '00000000000000000000000000000000000000000000000000000000' FROM n";
        sqlx::query(many).execute(store.writer().unwrap()).await.unwrap();
        let mut others = Vec::new();
        while let Some(reader) = store.reader.try_acquire() {
            others.push(reader);
        }
        for _ in others.len()..store.reader.options().get_max_connections() as usize {
            others.push(store.reader.acquire().await.unwrap());
        }
        let long = async {
            assert_eq!(
                store.audit_after(&AuditWanted::default(), 0).await.unwrap().len() as i64,
                LONG_BATCH
            );
            assert!(!store.measurements_after(None, 0).await.unwrap().0.is_empty());
            assert!(store.observations_after(None, 0).await.unwrap().0.is_empty());
        };
        tokio::time::timeout(Duration::from_secs(10), long).await.expect("nobody is waited for");
    }
}
