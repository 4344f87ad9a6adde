//! How files were read: what each column was taken as, what was missing, which rows were left out.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// How a file was read. Two files that say the same in other forms (separators, decimal signs, dates) are read the same.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FileRead {
    /// `measurements` or `traces`.
    pub file: String,
    /// Rows below the header that are not blank.
    pub rows: u32,
    /// Its columns, in their order; those without a name and without a cell are none.
    pub columns: Vec<ColumnRead>,
    /// Powders that were written by a name, each with the id that it stands under.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub powders: Vec<NamedPowder>,
    /// Rows that count for nothing.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<LeftOut>,
    /// What else there is to know, sentence by sentence.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
}

/// What became of a column.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ColumnRead {
    /// As it is called.
    pub column: String,
    /// What it was taken as.
    pub taken_as: TakenAs,
    /// Rows in which it says something.
    pub filled: u32,
    /// Rows in which it does not: empty cells, `NA` and the like, and limits such as `<5`.
    pub missing: u32,
    /// What else there is to know of it: the days from first to last, why it was left out.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub note: String,
}

/// What a column may be taken as.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum TakenAs {
    /// Names of things: powders, weighings.
    Subject,
    /// What is judged.
    Measured,
    /// Days, in the order of time.
    Session,
    /// A condition of numbers.
    Numbers,
    /// A condition of names.
    Names,
    /// It was left out.
    Nothing,
}

/// A powder that was written by a name.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct NamedPowder {
    /// As it is written.
    pub name: String,
    /// Its id.
    pub id: String,
}

/// Rows that were left out.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct LeftOut {
    /// Of the file, the header being row 1.
    pub rows: Vec<u32>,
    /// Why.
    pub reason: String,
}
