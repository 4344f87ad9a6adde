//! The tables of a database, their columns, keys and references, as the database itself lists them:
//! a later migration is copied without a change here.

use super::cell::Kind;
use crate::sql::is_postgres;
use crate::{Error, Result};
use sqlx::AnyConnection;
use std::collections::{BTreeMap, BTreeSet};

/// Table, column, type, place in the primary key (0: not in it), and whether the database numbers
/// its rows.
const SQLITE: &str = "SELECT t.name, c.name, c.type, c.pk, c.pk = 1 AND t.sql LIKE '%AUTOINCREMENT%' \
    FROM sqlite_schema t, pragma_table_info(t.name) c WHERE t.type = 'table' \
    AND t.name NOT LIKE 'sqlite\\_%' ESCAPE '\\' AND t.name <> '_sqlx_migrations'";
const POSTGRES: &str = "SELECT t.relname::text, c.attname::text, format_type(c.atttypid, NULL)::text, \
    coalesce(array_position(string_to_array(k.indkey::text, ' '), c.attnum::text), 0)::bigint, \
    (c.attidentity <> '')::int::bigint \
    FROM pg_class t JOIN pg_attribute c ON c.attrelid = t.oid AND c.attnum > 0 AND NOT c.attisdropped \
    LEFT JOIN pg_index k ON k.indrelid = t.oid AND k.indisprimary \
    WHERE t.relkind = 'r' AND t.relnamespace = current_schema()::regnamespace AND t.relname <> '_sqlx_migrations'";
const SQLITE_REFERENCES: &str = "SELECT t.name, f.\"table\" FROM sqlite_schema t, pragma_foreign_key_list(t.name) f \
    WHERE t.type = 'table'";
const POSTGRES_REFERENCES: &str = "SELECT t.relname::text, o.relname::text FROM pg_constraint f \
    JOIN pg_class t ON t.oid = f.conrelid JOIN pg_class o ON o.oid = f.confrelid \
    WHERE f.contype = 'f' AND t.relnamespace = current_schema()::regnamespace";

/// A column; its kind is `None` where FLIP has no columns of its type.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Column {
    pub name: String,
    pub kind: Option<Kind>,
}

/// A table.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Table {
    pub name: String,
    /// By name: the order in the database depends on the migrations that made it.
    pub columns: Vec<Column>,
    /// The columns of the primary key, in its order.
    pub key: Vec<String>,
    /// The column in which the database numbers rows from where it was, whatever was deleted.
    pub numbered: Option<String>,
    /// Tables whose rows must be there first.
    references: BTreeSet<String>,
}

impl Table {
    /// Every row, in the order of the key, which is the same in both databases: text is compared
    /// byte by byte.
    pub fn select(&self) -> String {
        let columns = list(self.columns.iter().map(|column| column.name.as_str()));
        let key = list(self.key.iter().map(String::as_str));
        format!("SELECT {columns} FROM {} ORDER BY {key}", quoted(&self.name))
    }

    /// The beginning of an insertion.
    pub fn insert(&self) -> String {
        let columns = list(self.columns.iter().map(|column| column.name.as_str()));
        format!("INSERT INTO {} ({columns}) VALUES ", quoted(&self.name))
    }

    fn names(&self) -> Vec<&str> {
        self.columns.iter().map(|column| column.name.as_str()).collect()
    }
}

/// The tables of a database, by name.
#[derive(Debug)]
pub(super) struct Catalogue(BTreeMap<String, Table>);

impl Catalogue {
    /// Of the database of a connection.
    pub async fn of(connection: &mut AnyConnection) -> Result<Self> {
        let (columns, references) = match is_postgres(connection) {
            true => (POSTGRES, POSTGRES_REFERENCES),
            false => (SQLITE, SQLITE_REFERENCES),
        };
        let columns: Vec<(String, String, String, i64, i64)> =
            sqlx::query_as(columns).fetch_all(&mut *connection).await?;
        let references: Vec<(String, String)> =
            sqlx::query_as(references).fetch_all(connection).await?;
        let mut tables = BTreeMap::<String, Table>::new();
        let mut keys = BTreeMap::<String, BTreeMap<i64, String>>::new();
        for (table, name, of, position, numbered) in columns {
            let it = tables.entry(table.clone()).or_default();
            it.name.clone_from(&table);
            it.columns.push(Column { name: name.clone(), kind: Kind::of(&of) });
            if numbered != 0 {
                it.numbered = Some(name.clone());
            }
            if position > 0 {
                keys.entry(table).or_default().insert(position, name);
            }
        }
        for (name, table) in &mut tables {
            table.columns.sort_by(|a, b| a.name.cmp(&b.name));
            table.key = keys.remove(name).unwrap_or_default().into_values().collect();
        }
        for (table, other) in references.into_iter().filter(|(table, other)| table != other) {
            tables.entry(table).or_default().references.insert(other);
        }
        Ok(Self(tables))
    }

    pub fn tables(&self) -> impl Iterator<Item = &Table> {
        self.0.values()
    }

    /// The tables as they are here, where they are copied from, and there; each after those that its
    /// rows refer to.
    ///
    /// # Errors
    /// [`Error::Corrupt`]: a table or a column is only on one side, or a table has no key.
    pub fn matched<'a>(&'a self, there: &'a Self) -> Result<Vec<(&'a Table, &'a Table)>> {
        let wrong = |table: &str, why| Err(Error::Corrupt(format!("the table {table} {why}")));
        let one_sided = self.0.keys().find(|name| !there.0.contains_key(*name));
        if let Some(name) =
            one_sided.or_else(|| there.0.keys().find(|it| !self.0.contains_key(*it)))
        {
            return wrong(name, "is on one side only: it is not FLIP's, move it elsewhere");
        }
        let mut found = Vec::new();
        for other in there.in_order()? {
            let table = &self.0[&other.name];
            if table.names() != other.names() {
                return wrong(&table.name, "has other columns than those that FLIP made");
            }
            if table.key != other.key || table.key.is_empty() {
                return wrong(&table.name, "has another key than the one that FLIP made, or none");
            }
            found.push((table, other));
        }
        Ok(found)
    }

    /// Each table after those that its rows refer to.
    fn in_order(&self) -> Result<Vec<&Table>> {
        let (mut done, mut found) = (BTreeSet::new(), Vec::new());
        while found.len() < self.0.len() {
            let is_next =
                |table: &&Table| !done.contains(&table.name) && table.references.is_subset(&done);
            let Some(next) = self.tables().find(is_next) else {
                let why = "tables refer to each other in a circle: no order of rows is right";
                return Err(Error::Corrupt(why.to_owned()));
            };
            done.insert(next.name.clone());
            found.push(next);
        }
        Ok(found)
    }
}

/// A name as it stands in a statement: some of FLIP's are words of SQL.
pub(super) fn quoted(name: &str) -> String {
    format!("\"{}\"", name.replace('"', "\"\""))
}

fn list<'a>(names: impl Iterator<Item = &'a str>) -> String {
    names.map(quoted).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn catalogue(tables: &[(&str, &[&str])]) -> Catalogue {
        let table = |(name, references): &(&str, &[&str])| {
            let column = Column { name: "id".into(), kind: Some(Kind::Text) };
            let references = references.iter().map(|it| (*it).to_owned()).collect();
            let (columns, key) = (vec![column], vec!["id".to_owned()]);
            let name = (*name).to_owned();
            (name.clone(), Table { name, columns, key, references, numbered: None })
        };
        Catalogue(tables.iter().map(table).collect())
    }

    #[test]
    fn a_table_comes_after_those_that_its_rows_refer_to() {
        let all = catalogue(&[("a", &["b", "c"]), ("b", &["c"]), ("c", &[]), ("d", &["a"])]);
        let order: Vec<_> = all.matched(&all).unwrap().into_iter().map(|it| &it.0.name).collect();
        assert_eq!(order, ["c", "b", "a", "d"]);
        let circle = catalogue(&[("a", &["b"]), ("b", &["a"])]);
        assert!(circle.matched(&circle).unwrap_err().to_string().contains("circle"));
    }

    #[test]
    fn a_table_that_is_on_one_side_only_or_differs_is_named() {
        let (more, fewer) = (catalogue(&[("a", &[]), ("theirs", &[])]), catalogue(&[("a", &[])]));
        for (here, there) in [(&more, &fewer), (&fewer, &more)] {
            let refused = here.matched(there).unwrap_err().to_string();
            assert!(refused.contains("theirs is on one side only"), "{refused}");
        }
        let mut other = catalogue(&[("a", &[])]);
        other.0.get_mut("a").unwrap().key.clear();
        assert!(other.matched(&fewer).unwrap_err().to_string().contains("key"));
        other.0.get_mut("a").unwrap().columns.clear();
        assert!(other.matched(&fewer).unwrap_err().to_string().contains("columns"));
    }
}
