//! From which number on a database numbers new rows: never one that a row had before the copy.

use super::catalogue::{Table, quoted};
use crate::Result;
use crate::sql::is_postgres;
use sqlx::{AnyConnection, AssertSqlSafe, Executor};

/// The last number that a table gave, also to a row that is gone; `None` if it gives the number
/// after that of its last row.
pub(super) async fn last(connection: &mut AnyConnection, table: &Table) -> Result<Option<i64>> {
    let Some(column) = &table.numbered else { return Ok(None) };
    if is_postgres(connection) {
        let of = "SELECT pg_get_serial_sequence($1, $2)";
        let of = sqlx::query_scalar(of).bind(quoted(&table.name)).bind(column);
        let of: String = of.fetch_one(&mut *connection).await?;
        // One that is set to go on at a number has not given it yet.
        let sql =
            format!("SELECT CASE WHEN is_called THEN last_value ELSE last_value - 1 END FROM {of}");
        return Ok(Some(sqlx::query_scalar(AssertSqlSafe(sql)).fetch_one(connection).await?));
    }
    let sql = "SELECT seq FROM sqlite_sequence WHERE name = $1";
    Ok(sqlx::query_scalar(sql).bind(&table.name).fetch_optional(connection).await?)
}

/// Let a table go on after this number and after its own last row. What is set is part of the
/// transaction: of a copy that fails nothing is left.
pub(super) async fn go_on(
    connection: &mut AnyConnection,
    table: &Table,
    last: Option<i64>,
) -> Result<()> {
    let Some(column) = &table.numbered else { return Ok(()) };
    let (name, column) = (quoted(&table.name), quoted(column));
    let newest = AssertSqlSafe(format!("SELECT coalesce(max({column}), 0) FROM {name}"));
    let newest: i64 = sqlx::query_scalar(newest).fetch_one(&mut *connection).await?;
    let last = last.unwrap_or(0).max(newest);
    if last < 1 {
        return Ok(());
    }
    if is_postgres(connection) {
        // Unlike `setval`, this is undone with the transaction.
        let next = last.saturating_add(1);
        let sql = format!("ALTER TABLE {name} ALTER COLUMN {column} RESTART WITH {next}");
        connection.execute(AssertSqlSafe(sql)).await?;
        return Ok(());
    }
    let counted = sqlx::query("UPDATE sqlite_sequence SET seq = $1 WHERE name = $2");
    let counted = counted.bind(last).bind(&table.name).execute(&mut *connection).await?;
    if counted.rows_affected() == 0 {
        let sql = "INSERT INTO sqlite_sequence (name, seq) VALUES ($1, $2)";
        sqlx::query(sql).bind(&table.name).bind(last).execute(connection).await?;
    }
    Ok(())
}
