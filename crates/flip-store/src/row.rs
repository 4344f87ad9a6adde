//! Reading columns as FLIP's types.

use super::sql::Flag;
use super::{Error, Result};
use flip_core::domain::timestamp::Timestamp;
use serde::Serialize;
use serde::de::{DeserializeOwned, IntoDeserializer};
use sqlx::any::AnyRow;
use sqlx::{Any, Row, Type};

/// Typed access to the columns of a row.
pub(super) trait Columns {
    /// A column of a plain type.
    fn plain<'r, T: sqlx::Decode<'r, Any> + Type<Any>>(&'r self, column: &str) -> Result<T>;
    /// A column of a plain type; `None` too where an older schema lacks it.
    fn maybe_plain<'r, T: sqlx::Decode<'r, Any> + Type<Any>>(&'r self, column: &str) -> Option<T>;
    /// Yes or no.
    fn flag(&self, column: &str) -> Result<bool>;
    /// A count.
    fn count(&self, column: &str) -> Result<u32>;
    /// A time.
    fn time(&self, column: &str) -> Result<Timestamp>;
    /// An optional time.
    fn maybe_time(&self, column: &str) -> Result<Option<Timestamp>>;
    /// An enum, by its name; the schema does not list the names. `table` is where the row is from.
    ///
    /// # Errors
    /// [`Error::UnknownWord`]
    fn word<T: DeserializeOwned>(&self, table: &'static str, column: &str) -> Result<T>;
    /// An optional enum.
    fn maybe_word<T: DeserializeOwned>(
        &self,
        table: &'static str,
        column: &str,
    ) -> Result<Option<T>>;
    /// A JSON document.
    fn json<T: DeserializeOwned>(&self, column: &str) -> Result<T>;
    /// An optional JSON document.
    fn maybe_json<T: DeserializeOwned>(&self, column: &str) -> Result<Option<T>>;
}

impl Columns for AnyRow {
    fn plain<'r, T: sqlx::Decode<'r, Any> + Type<Any>>(&'r self, column: &str) -> Result<T> {
        Ok(self.try_get(column)?)
    }

    fn maybe_plain<'r, T: sqlx::Decode<'r, Any> + Type<Any>>(&'r self, column: &str) -> Option<T> {
        self.try_get(column).ok()
    }

    fn flag(&self, column: &str) -> Result<bool> {
        let Flag(flag) = self.plain(column)?;
        Ok(flag)
    }

    fn count(&self, column: &str) -> Result<u32> {
        let value: i64 = self.plain(column)?;
        value.try_into().map_err(|_| Error::Corrupt(format!("{column}: {value} is no count")))
    }

    fn time(&self, column: &str) -> Result<Timestamp> {
        Ok(Timestamp::from_unix_ms(self.plain(column)?))
    }

    fn maybe_time(&self, column: &str) -> Result<Option<Timestamp>> {
        Ok(self.plain::<Option<i64>>(column)?.map(Timestamp::from_unix_ms))
    }

    fn word<T: DeserializeOwned>(&self, table: &'static str, column: &str) -> Result<T> {
        self.maybe_word(table, column)?.ok_or_else(|| Error::Corrupt(format!("{column} is empty")))
    }

    fn maybe_word<T: DeserializeOwned>(
        &self,
        table: &'static str,
        column: &str,
    ) -> Result<Option<T>> {
        let Some(word) = self.plain::<Option<String>>(column)? else { return Ok(None) };
        let unknown = |word: String| Error::UnknownWord {
            table,
            row: name(self),
            column: column.to_owned(),
            word,
        };
        T::deserialize(word.as_str().into_deserializer())
            .map(Some)
            .map_err(|_: serde::de::value::Error| unknown(word))
    }

    fn json<T: DeserializeOwned>(&self, column: &str) -> Result<T> {
        self.maybe_json(column)?.ok_or_else(|| Error::Corrupt(format!("{column} is empty")))
    }

    fn maybe_json<T: DeserializeOwned>(&self, column: &str) -> Result<Option<T>> {
        let text: Option<String> = self.plain(column)?;
        let read = |text: String| serde_json::from_str(&text);
        text.map(read).transpose().map_err(|error| Error::Corrupt(format!("{column}: {error}")))
    }
}

/// What a row is called: its id, or its number.
fn name(row: &AnyRow) -> String {
    let number = |_| row.try_get::<i64, _>("seq").map(|seq| seq.to_string());
    row.try_get("id").or_else(number).unwrap_or_default()
}

/// The name of an enum's variant, as in JSON.
pub(super) fn word<T: Serialize>(value: &T) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(name)) => name,
        other => unreachable!("stored enums are written as one name, not {other:?}"),
    }
}

/// A JSON document.
pub(super) fn json<T: Serialize>(value: &T) -> Result<String> {
    serde_json::to_string(value)
        .map_err(|error| Error::Corrupt(format!("cannot be written as JSON: {error}")))
}
