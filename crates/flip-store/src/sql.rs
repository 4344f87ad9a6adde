//! What SQLite and PostgreSQL do not have in common, for statements that run on both.
//!
//! Statements are written once, in SQL that both know, with parameters `$1`, `$2`. What only SQLite
//! has built in (`->>` on text, `json_each`, `max` of two numbers) is taught to PostgreSQL by
//! `migrations/postgres`.

use super::Result;
use sqlx::any::{AnyArguments, AnyRow, AnyTypeInfo, AnyTypeInfoKind, AnyValueRef};
use sqlx::encode::IsNull;
use sqlx::error::BoxDynError;
use sqlx::query::{Query, QueryScalar};
use sqlx::{Any, AnyConnection, Arguments, AssertSqlSafe, Database, Decode, Encode, Type};

/// The buffer of arguments.
type Buffer = <Any as Database>::ArgumentBuffer;

/// Yes or no: SQLite answers with 1 or 0, PostgreSQL with a type of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Flag(pub bool);

impl Type<Any> for Flag {
    fn type_info() -> AnyTypeInfo {
        <bool as Type<Any>>::type_info()
    }

    fn compatible(ty: &AnyTypeInfo) -> bool {
        ty.kind() == AnyTypeInfoKind::Bool || ty.kind().is_integer()
    }
}

impl<'r> Decode<'r, Any> for Flag {
    fn decode(value: AnyValueRef<'r>) -> std::result::Result<Self, BoxDynError> {
        let flag = <bool as Decode<Any>>::decode(value.clone());
        let number = |_| <i64 as Decode<Any>>::decode(value).map(|number| number != 0);
        flag.or_else(number).map(Self)
    }
}

/// A number that may be absent, as an argument.
///
/// sqlx 0.9 tells PostgreSQL that an absent `f64` has four bytes and an absent `f32` eight, and
/// keeps the statement for the next call, whose number then has the wrong length. What is no number
/// is stored as absent, which SQLite does by itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Number(pub f64);

impl Type<Any> for Number {
    fn type_info() -> AnyTypeInfo {
        <f32 as Type<Any>>::type_info()
    }
}

impl Encode<'_, Any> for Number {
    fn encode_by_ref(&self, buffer: &mut Buffer) -> std::result::Result<IsNull, BoxDynError> {
        match self.0.is_nan() {
            false => <f64 as Encode<Any>>::encode_by_ref(&self.0, buffer),
            true => <Option<Self> as Encode<Any>>::encode_by_ref(&None, buffer),
        }
    }
}

/// A statement that is put together from parts. The builder of sqlx names parameters `?` here,
/// which PostgreSQL does not know.
pub(super) struct Parts {
    sql: String,
    like: &'static str,
    values: AnyArguments,
}

impl Parts {
    /// A statement that begins like this, for PostgreSQL or SQLite.
    pub fn new(postgres: bool, sql: &str) -> Self {
        let like = if postgres { "ILIKE" } else { "LIKE" };
        Self { sql: sql.to_owned(), like, values: AnyArguments::default() }
    }

    /// Append SQL.
    pub fn push(&mut self, sql: impl AsRef<str>) -> &mut Self {
        self.sql.push_str(sql.as_ref());
        self
    }

    /// Append a parameter with this value.
    pub fn push_bind<'t>(&mut self, value: impl Encode<'t, Any> + Type<Any>) -> &mut Self {
        if let Err(error) = self.values.add(value) {
            unreachable!("text and numbers can be bound: {error}");
        }
        let number = self.values.len();
        self.push(format!("${number}"))
    }

    /// Append the condition that this word, in any case, is somewhere in a text.
    pub fn contains(&mut self, text: &str, word: &str) -> &mut Self {
        // Every character stands for itself.
        let word = word.replace('\\', r"\\").replace('%', r"\%").replace('_', r"\_");
        let like = self.like;
        self.push(format!("{text} {like} ")).push_bind(format!("%{word}%")).push(r" ESCAPE '\'")
    }

    /// The whole as a query.
    pub fn query(self) -> Query<'static, Any, AnyArguments> {
        sqlx::query_with(AssertSqlSafe(self.sql), self.values)
    }

    /// The whole as a query of one value.
    pub fn scalar<T>(self) -> QueryScalar<'static, Any, T, AnyArguments>
    where
        (T,): for<'r> sqlx::FromRow<'r, AnyRow>,
    {
        sqlx::query_scalar_with(AssertSqlSafe(self.sql), self.values)
    }
}

/// Whether this is PostgreSQL.
pub(super) fn is_postgres(connection: &AnyConnection) -> bool {
    connection.backend_name() == "PostgreSQL"
}

/// Whether the database has this table: one of an older FLIP, opened beside the process that holds
/// it, may not.
pub(super) async fn has_table(connection: &mut AnyConnection, name: &str) -> Result<bool> {
    // PostgreSQL came when all of them were there.
    if is_postgres(connection) {
        return Ok(true);
    }
    let sql = "SELECT EXISTS (SELECT 1 FROM sqlite_schema WHERE name = $1)";
    let Flag(has) = sqlx::query_scalar(sql).bind(name).fetch_one(connection).await?;
    Ok(has)
}
