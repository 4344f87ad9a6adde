//! Stock-taking of rows that predate their own records: the first startup that compares rows with
//! the record writes the rows it finds into the record, once.
//!
//! From then on, a row without a record was inserted from outside.

use super::audit::{About, OutcomeRecord, Written};
use super::page::LONG_BATCH;
use super::row::Columns;
use super::said::{Row, Said, every_row};
use super::sql::{Flag, has_table};
use super::weighing_rows::weighing_row;
use super::{Result, Store, Tx, now};
use flip_core::domain::timestamp::Timestamp;
use serde::{Deserialize, Serialize};
use sqlx::AnyConnection;

/// Kind of the record that ends the stock-taking.
const STOCK: &str = "stock";
/// Kind of records that hold rows.
const ROWS: &str = "rows";
/// Maximum number of rows in a record.
const ROWS_MAX: usize = 200;

/// Contents of a record of kind `rows`.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Rows {
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub weighings: Vec<OutcomeRecord>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rows: Vec<Row>,
}

/// Whether each row has a record, according to the database and its record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Stock {
    /// Not done: an older database, opened read-only.
    NotTaken,
    Taken,
    /// It was done, and its record is gone.
    Gone,
}

impl Store {
    /// Record rows that no record knows, the first time.
    pub(super) async fn take_stock(&self) -> Result<()> {
        let mut tx = self.write().await?;
        let Flag(marked) = sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM stock)")
            .fetch_one(&mut *tx.inner)
            .await?;
        if marked {
            return Ok(());
        }
        if !is_recorded(&mut tx.inner).await? {
            tx.record_stock(now()).await?;
        }
        let mark = "INSERT INTO stock (one, at) SELECT 1, at FROM audit WHERE weighing IS NULL AND kind = 'stock' ORDER BY seq LIMIT 1";
        sqlx::query(mark).execute(&mut *tx.inner).await?;
        tx.commit().await
    }
}

impl Tx {
    async fn record_stock(&mut self, at: Timestamp) -> Result<()> {
        let mut said = Said::default();
        let mut after = 0;
        loop {
            let sql = "SELECT * FROM audit WHERE seq > $1 ORDER BY seq LIMIT $2";
            let rows =
                sqlx::query(sql).bind(after).bind(LONG_BATCH).fetch_all(&mut *self.inner).await?;
            let Some(last) = rows.last() else { break };
            after = last.plain("seq")?;
            rows.iter().try_for_each(|row| Written::of(row).map(|record| said.hear(&record)))?;
        }
        let found = every_row(&mut self.inner).await?.into_iter();
        let unsaid = found.filter_map(|(what, id, row)| said.unsaid(what, &id, row.ok()?));
        let unsaid: Vec<Row> = unsaid.collect();
        let weighings = self.unrecorded_weighings().await?;
        let count = (weighings.len(), unsaid.len());
        let mut weighings = weighings.into_iter().peekable();
        while weighings.peek().is_some() {
            let weighings = weighings.by_ref().take(ROWS_MAX).collect();
            self.audit_found(&Rows { weighings, rows: Vec::new() }).await?;
        }
        self.audit_rows(unsaid).await?;
        let body = serde_json::json!({ "weighings": count.0, "rows": count.1, "at": at });
        self.audit(About { weighing: None, kind: STOCK }, &body, at).await
    }

    /// Record rows as written: for an action that makes many, or none.
    pub async fn audit_rows(&mut self, rows: Vec<Row>) -> Result<()> {
        let mut rows = rows.into_iter().peekable();
        while rows.peek().is_some() {
            let rows = rows.by_ref().take(ROWS_MAX).collect();
            self.audit_found(&Rows { rows, weighings: Vec::new() }).await?;
        }
        Ok(())
    }

    async fn audit_found(&mut self, rows: &Rows) -> Result<()> {
        self.audit(About { weighing: None, kind: ROWS }, rows, now()).await
    }

    /// Weighings that predate the record: made after the database was, and before the migration
    /// that introduced the record (14).
    async fn unrecorded_weighings(&mut self) -> Result<Vec<OutcomeRecord>> {
        let sql = "SELECT * FROM weighing WHERE id NOT IN \
                   (SELECT weighing FROM audit WHERE weighing IS NOT NULL AND kind IN ('intent', 'outcome')) \
                   AND created_at >= 1000 * (SELECT min(unixepoch(installed_on)) FROM _sqlx_migrations) \
                   AND created_at < 1000 * (SELECT 1 + unixepoch(installed_on) FROM _sqlx_migrations WHERE version = 14) ORDER BY seq";
        // A database on PostgreSQL is younger than the record.
        if self.store.is_postgres() {
            return Ok(Vec::new());
        }
        let rows = sqlx::query(sql).fetch_all(&mut *self.inner).await?;
        // A row that cannot be parsed as a weighing has no place in a record of weighings.
        let found = rows.iter().filter_map(|row| weighing_row(row).ok());
        Ok(found
            .map(|it| OutcomeRecord { key: it.key(), weighing: it.weighing, trace: it.trace })
            .collect())
    }
}

/// Whether the record contains a stock-taking.
pub(super) async fn is_recorded(connection: &mut AnyConnection) -> Result<bool> {
    let sql = "SELECT EXISTS (SELECT 1 FROM audit WHERE weighing IS NULL AND kind = 'stock')";
    let Flag(is) = sqlx::query_scalar(sql).fetch_one(connection).await?;
    Ok(is)
}

/// State of the stock-taking in this database.
pub(super) async fn stock(connection: &mut AnyConnection) -> Result<Stock> {
    if is_recorded(connection).await? {
        return Ok(Stock::Taken);
    }
    if !has_table(connection, "stock").await? {
        return Ok(Stock::NotTaken);
    }
    let Flag(marked) =
        sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM stock)").fetch_one(connection).await?;
    Ok(if marked { Stock::Gone } else { Stock::NotTaken })
}

/// A weighing as found by the stock-taking, and the record that holds it.
pub(super) async fn found_weighing(
    connection: &mut AnyConnection,
    id: &str,
) -> Result<Option<(i64, OutcomeRecord)>> {
    let sql = "SELECT * FROM audit WHERE weighing IS NULL AND kind = 'rows' ORDER BY seq";
    for row in sqlx::query(sql).fetch_all(connection).await? {
        let record = Written::of(&row)?;
        let Some(found) = rows_of(&record) else { continue };
        if let Some(found) = found.weighings.into_iter().find(|it| it.weighing.id == id) {
            return Ok(Some((record.seq, found)));
        }
    }
    Ok(None)
}

/// The rows held by a record, if any.
pub(super) fn rows_of(record: &Written) -> Option<Rows> {
    (record.kind == ROWS).then(|| serde_json::from_str(&record.body).ok()).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;
    use crate::verify::ChangedRow;

    const WEIGHING: &str = "INSERT INTO weighing (id, idempotency_key, request_sha256, powder, target_mg, tolerance_lower_mg, tolerance_upper_mg, policy, \
         parameter_set, seed, state, outcome, reading_mg, created_at, finished_at) \
         VALUES ($1, $1, zeroblob(32), 'salt', 10, 1, 1, 'p-1', 'ps-1', 1, 'done', 'within', 10.2, 1000, 2000)";

    /// A folder from before each row had a record: the record is empty, and these weighings and a
    /// token exist.
    async fn from_before(folder: &std::path::Path, weighings: usize) {
        let store = Store::open(folder).await.unwrap();
        let writer = store.writer().unwrap();
        for sql in [
            "DROP TRIGGER audit_keeps",
            "DELETE FROM audit",
            "DELETE FROM stock",
            "INSERT INTO policy (id, kind, manifest, bytes, sha256, created_at) VALUES ('p-1', 'fixed', '{}', x'00', hex(zeroblob(32)), 0)",
            "INSERT INTO token (id, name, role, sha256, created_at) VALUES ('aa', 'Ada', 'operator', zeroblob(32), 1)",
            // Made at 1970-01-01 00:00:01; the record was introduced a minute later.
            "UPDATE _sqlx_migrations SET installed_on = '1970-01-01 00:00:01' WHERE version < 14",
            "UPDATE _sqlx_migrations SET installed_on = '1970-01-01 00:01:01' WHERE version = 14",
        ] {
            sqlx::query(sql).execute(writer).await.unwrap();
        }
        for k in 0..weighings {
            sqlx::query(WEIGHING).bind(format!("w-{k}")).execute(writer).await.unwrap();
        }
        store.close().await;
    }

    async fn after(store: &Store, sql: &'static str) -> (Vec<ChangedRow>, Vec<String>) {
        sqlx::query(sql).execute(store.writer().unwrap()).await.unwrap();
        let found = store.verify_audit(None).await.unwrap();
        assert_eq!(
            found.broken.is_some(),
            !(found.changed.is_empty() && found.others.is_empty()),
            "{found:?}"
        );
        (
            found.changed,
            found.others.into_iter().map(|it| format!("{} {}", it.what.name(), it.id)).collect(),
        )
    }

    #[tokio::test]
    async fn rows_from_before_the_record_are_in_it_from_the_first_start_on_and_a_row_that_comes_later_is_not()
     {
        if testing::only_sqlite_has("folders from before the record") {
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        from_before(folder.path(), 250).await;
        let store = Store::open(folder.path()).await.unwrap();
        let whole = store.verify_audit(None).await.unwrap();
        assert_eq!(
            (&whole.broken, whole.records),
            (&None, 4),
            "two of weighings, one of other rows, and that it was done"
        );
        let (changed, _) =
            after(&store, "UPDATE weighing SET reading_mg = 9.9 WHERE id = 'w-7'").await;
        assert!(
            changed[0].weighing == "w-7"
                && changed[0].why.contains("reading_mg is 9.9, 10.2 was recorded"),
            "{changed:?}"
        );
        let row = store.weighing("w-7").await.unwrap().unwrap();
        assert!(store.outcome_on_record(&row).await.unwrap().0.is_some(), "nor is it certified");
        let row = store.weighing("w-8").await.unwrap().unwrap();
        assert_eq!(store.outcome_on_record(&row).await.unwrap(), (None, None));
        let (changed, others) =
            after(&store, "UPDATE weighing SET reading_mg = 10.2 WHERE id = 'w-7'").await;
        assert_eq!((changed.len(), others.len()), (0, 0));
        let (_, others) = after(&store, "UPDATE token SET role = 'admin'").await;
        assert_eq!(others, ["token aa"]);
        after(&store, "UPDATE token SET role = 'operator'").await;
        sqlx::query(WEIGHING).bind("forged").execute(store.writer().unwrap()).await.unwrap();
        let (changed, _) =
            after(&store, "UPDATE weighing SET created_at = 1 WHERE id = 'forged'").await;
        assert_eq!(changed[0].weighing, "forged");
        store.close().await;
        drop(store);
        // Another startup does not repeat the stock-taking, whatever the mark next to the record
        // states.
        let store = Store::open(folder.path()).await.unwrap();
        let (changed, _) = after(&store, "DELETE FROM stock").await;
        assert_eq!(changed[0].weighing, "forged");
        store.close().await;
        drop(store);
        let store = Store::open(folder.path()).await.unwrap();
        assert_eq!(store.verify_audit(None).await.unwrap().changed[0].weighing, "forged");
    }

    #[tokio::test]
    async fn a_row_that_is_older_than_its_database_or_younger_than_the_record_is_not_one_from_before_it()
     {
        if testing::only_sqlite_has("folders from before the record") {
            return;
        }
        for created_at in [999, 62_000] {
            let folder = tempfile::tempdir().unwrap();
            from_before(folder.path(), 1).await;
            let options =
                sqlx::sqlite::SqliteConnectOptions::new().filename(folder.path().join("flip.db"));
            let pool = sqlx::SqlitePool::connect_with(options).await.unwrap();
            let moved = sqlx::query("UPDATE weighing SET created_at = $1").bind(created_at);
            assert_eq!(moved.execute(&pool).await.unwrap().rows_affected(), 1);
            pool.close().await;
            let store = Store::open(folder.path()).await.unwrap();
            let found = store.verify_audit(None).await.unwrap().changed;
            assert!(
                found[0].weighing == "w-0" && found[0].seq.is_none(),
                "{created_at}: {found:?}"
            );
        }
    }

    #[tokio::test]
    async fn a_record_that_was_emptied_does_not_make_every_row_one_from_before_it() {
        let folder = tempfile::tempdir().unwrap();
        let store = testing::open(folder.path()).await.unwrap();
        testing::drop_trigger(&store, "audit_keeps", "audit").await;
        sqlx::query("DELETE FROM audit").execute(store.writer().unwrap()).await.unwrap();
        let found = store.verify_audit(None).await.unwrap();
        assert!(found.broken.is_some_and(|it| it.why.contains("cut off")));
    }
}
