//! Rows from one database into another, and a hash over the rows of each table that is the same in
//! both.

use super::CopyProgress;
use super::catalogue::{Catalogue, Table};
use super::cell::{Cell, Kind, hash_bytes};
use crate::sql::is_postgres;
use crate::{Error, Result};
use serde::Serialize;
use sha2::{Digest, Sha256};
use sqlx::any::{AnyArguments, AnyRow};
use sqlx::{AnyConnection, AssertSqlSafe, Executor};
use std::future::poll_fn;

/// Values in one statement: SQLite takes 32766, PostgreSQL 65535.
const VALUES_MAX: usize = 4000;
/// Memory of one statement's values, bytes; a single row may be larger.
const BYTES_MAX: usize = 4 << 20;

/// The rows of a table, counted and hashed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct TableRows {
    /// The table.
    pub table: String,
    /// How many rows it has.
    pub rows: u64,
    /// SHA-256 of all its rows in the order of its key. The same rows give the same hash in SQLite
    /// and in PostgreSQL.
    pub sha256: String,
}

/// Counts and hashes rows as they pass.
struct Tally {
    hash: Sha256,
    rows: u64,
}

impl Tally {
    fn of(table: &Table) -> Self {
        let mut hash = Sha256::new();
        for name in table.columns.iter().map(|column| &column.name) {
            hash_bytes(&mut hash, 5, name.as_bytes());
        }
        Self { hash, rows: 0 }
    }

    fn take(&mut self, row: &[Cell]) {
        row.iter().for_each(|cell| cell.hash(&mut self.hash));
        self.rows += 1;
    }

    fn end(self, table: &Table) -> TableRows {
        let sha256 = hex::encode(self.hash.finalize());
        TableRows { table: table.name.clone(), rows: self.rows, sha256 }
    }
}

/// Count and hash the rows of a table.
///
/// # Errors
/// [`Error::Database`], [`Error::Corrupt`].
pub(super) async fn tally(connection: &mut AnyConnection, table: &Table) -> Result<TableRows> {
    let mut tally = Tally::of(table);
    let mut rows = connection.fetch(sqlx::query(AssertSqlSafe(table.select())));
    while let Some(row) = poll_fn(|context| rows.as_mut().poll_next(context)).await {
        tally.take(&cells(table, &row.map_err(|error| unread(table, error))?)?);
    }
    Ok(tally.end(table))
}

/// Count and hash the rows of every table, by name.
///
/// # Errors
/// As [`tally`].
pub(super) async fn tallies(connection: &mut AnyConnection) -> Result<Vec<TableRows>> {
    let catalogue = Catalogue::of(connection).await?;
    let mut found = Vec::new();
    for table in catalogue.tables() {
        found.push(tally(connection, table).await?);
    }
    Ok(found)
}

/// Copy every row of a table, a few at a time.
///
/// # Errors
/// [`Error::Unfit`] of the first value that cannot be stored there; [`Error::Database`] and others.
pub(super) async fn copy(
    (from, here): (&mut AnyConnection, &Table),
    (to, there): (&mut AnyConnection, &Table),
    progress: &(dyn Fn(CopyProgress<'_>) + Sync),
) -> Result<TableRows> {
    let mut tally = Tally::of(here);
    let mut batch = Batch::into(there, is_postgres(to))?;
    let mut rows = from.fetch(sqlx::query(AssertSqlSafe(here.select())));
    while let Some(row) = poll_fn(|context| rows.as_mut().poll_next(context)).await {
        let row = cells(here, &row.map_err(|error| unread(here, error))?)?;
        tally.take(&row);
        batch.add(row)?;
        if batch.is_full() {
            batch.write(to).await?;
            progress(CopyProgress::Rows { table: &there.name, done: tally.rows });
        }
    }
    batch.write(to).await?;
    progress(CopyProgress::Rows { table: &there.name, done: tally.rows });
    Ok(tally.end(there))
}

fn cells(table: &Table, row: &AnyRow) -> Result<Vec<Cell>> {
    (0..table.columns.len()).map(|column| Cell::of(row, column)).collect()
}

/// What stops the reading of a table: the driver itself names no table.
fn unread(table: &Table, error: sqlx::Error) -> Error {
    match error {
        sqlx::Error::Decode(why) => Error::Corrupt(format!("table {}: {why}", table.name)),
        other => other.into(),
    }
}

/// Rows that are written with one statement.
struct Batch<'a> {
    table: &'a Table,
    kinds: Vec<Kind>,
    postgres: bool,
    rows: Vec<Vec<Cell>>,
    bytes: usize,
}

impl<'a> Batch<'a> {
    fn into(table: &'a Table, postgres: bool) -> Result<Self> {
        let kind = |column: &super::catalogue::Column| {
            let why = || format!("{}.{} is of a type that FLIP has not", table.name, column.name);
            column.kind.ok_or_else(|| Error::Corrupt(why()))
        };
        let kinds = table.columns.iter().map(kind).collect::<Result<_>>()?;
        Ok(Self { table, kinds, postgres, rows: Vec::new(), bytes: 0 })
    }

    fn add(&mut self, row: Vec<Cell>) -> Result<()> {
        for (k, (cell, kind)) in row.iter().zip(&self.kinds).enumerate() {
            if let Some(why) = cell.unfit(*kind, self.postgres) {
                let (table, column) = (self.table.name.clone(), self.table.columns[k].name.clone());
                return Err(Error::Unfit { table, row: self.key_of(&row), column, why });
            }
        }
        self.bytes += row.iter().map(Cell::size).sum::<usize>();
        self.rows.push(row);
        Ok(())
    }

    fn is_full(&self) -> bool {
        self.bytes >= BYTES_MAX || (self.rows.len() + 1) * self.kinds.len() > VALUES_MAX
    }

    /// The key of a row, for people.
    fn key_of(&self, row: &[Cell]) -> String {
        let is_key = |name: &String| self.table.key.contains(name);
        let columns = self.table.columns.iter().zip(row).filter(|(column, _)| is_key(&column.name));
        let said = columns.map(|(column, cell)| match cell {
            Cell::Text(text) => format!("{} {text:?}", column.name),
            Cell::Integer(number) => format!("{} {number}", column.name),
            other => format!("{} {other:?}", column.name),
        });
        said.collect::<Vec<_>>().join(", ")
    }

    async fn write(&mut self, to: &mut AnyConnection) -> Result<()> {
        let (Some(first), Some(last)) = (self.rows.first(), self.rows.last()) else {
            return Ok(());
        };
        let which = format!("{} to {}", self.key_of(first), self.key_of(last));
        let mut sql = self.table.insert();
        let mut arguments = AnyArguments::default();
        let mut number = 0;
        for (k, row) in self.rows.drain(..).enumerate() {
            sql.push_str(if k == 0 { "(" } else { "), (" });
            for (column, (cell, kind)) in row.into_iter().zip(&self.kinds).enumerate() {
                number += 1;
                sql.push_str(if column == 0 { "$" } else { ", $" });
                sql.push_str(&number.to_string());
                cell.bind(*kind, &mut arguments);
            }
        }
        sql.push(')');
        self.bytes = 0;
        let written = sqlx::query_with(AssertSqlSafe(sql), arguments).execute(to).await;
        written.map_err(|error| unwritten(self.table, &which, error.into()))?;
        Ok(())
    }
}

/// What stops the writing of rows: a rule of the other database that these do not meet is named with
/// them.
fn unwritten(table: &Table, rows: &str, error: Error) -> Error {
    match error {
        Error::Database(sqlx::Error::Database(why)) => {
            Error::Corrupt(format!("table {}, one of the rows {rows}: {why}", table.name))
        }
        other => other,
    }
}
