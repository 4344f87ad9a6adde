//! How the file of a report was read.

use serde::Serialize;
use utoipa::ToSchema;

/// How a file was read. Two files with the same content in different formats (separators, decimal
/// signs, dates) are read the same.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct FileRead {
    /// `measurements` or `traces`.
    pub file: String,
    /// Rows below the header that are not blank.
    pub rows: u32,
    /// Its columns, in order; those with neither a name nor any cell are dropped.
    pub columns: Vec<ColumnRead>,
    /// Powders given by name, each with the id it is listed under.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub powders: Vec<NamedPowder>,
    /// Rows that were left out.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<LeftOut>,
    /// Further remarks, sentence by sentence.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
}

answer! { flip_discover::reading::FileRead => FileRead {
    file, rows, columns, powders, left_out, notes,
} }

/// How a column was read.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ColumnRead {
    /// Its name.
    pub column: String,
    /// The role it was assigned.
    pub taken_as: TakenAs,
    /// Rows with a value.
    pub filled: u32,
    /// Rows without one: empty cells, `NA` and the like, and limits such as `<5`.
    pub missing: u32,
    /// Further remarks: the days from first to last, why it was left out.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub note: String,
}

answer! { flip_discover::reading::ColumnRead => ColumnRead {
    column, taken_as, filled, missing, note,
} }

/// The role of a column.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum TakenAs {
    /// Names of things: powders, weighings.
    Subject,
    /// The judged quantity.
    Measured,
    /// Days, in the order of time.
    Session,
    /// A numeric condition.
    Numbers,
    /// A named condition.
    Names,
    /// It was left out.
    Nothing,
}

answer! { flip_discover::reading::TakenAs => enum TakenAs {
    Subject, Measured, Session, Numbers, Names, Nothing,
} }

/// A powder given by name.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct NamedPowder {
    /// The name as written.
    pub name: String,
    /// Its id.
    pub id: String,
}

answer! { flip_discover::reading::NamedPowder => NamedPowder { name, id } }

/// Rows that were left out.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct LeftOut {
    /// Rows of the file, the header being row 1.
    pub rows: Vec<u32>,
    /// Why.
    pub reason: String,
}

answer! { flip_discover::reading::LeftOut => LeftOut { rows, reason } }

/// Which measured quantity departs.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Channel {
    /// Angle of repose.
    Repose,
    /// Flow through a hole.
    FlowTime,
    /// Balance readings of weighings.
    Trace,
    /// How far angles scatter.
    Scatter,
}

answer! { flip_discover::campaign::Channel => enum Channel { Repose, FlowTime, Trace, Scatter } }
