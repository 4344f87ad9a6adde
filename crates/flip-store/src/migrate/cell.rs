//! One value of a row, the same from both databases, to the bit.

use crate::sql::Number;
use crate::{Error, Result};
use sha2::{Digest, Sha256};
use sqlx::any::{AnyArguments, AnyRow, AnyTypeInfoKind};
use sqlx::{Any, Arguments, Encode, Row, Type, ValueRef};

/// The type of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// Yes or no: a type of its own in PostgreSQL, 1 or 0 in SQLite.
    Flag,
    Integer,
    Real,
    Text,
    Bytes,
}

impl Kind {
    /// Of a type's name in either database; `None` if FLIP has no columns of it.
    pub fn of(name: &str) -> Option<Self> {
        match name {
            "boolean" => Some(Self::Flag),
            "INTEGER" | "bigint" => Some(Self::Integer),
            "REAL" | "double precision" => Some(Self::Real),
            "TEXT" | "text" => Some(Self::Text),
            "BLOB" | "bytea" => Some(Self::Bytes),
            _ => None,
        }
    }
}

/// A value. Yes is 1, no is 0.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Cell {
    Null,
    Integer(i64),
    Real(f64),
    Text(String),
    Bytes(Vec<u8>),
}

impl Cell {
    /// The value in this column of a row.
    ///
    /// # Errors
    /// [`Error::Corrupt`]: of a type that FLIP does not store.
    pub fn of(row: &AnyRow, column: usize) -> Result<Self> {
        let value = row.try_get_raw(column)?;
        if value.is_null() {
            return Ok(Self::Null);
        }
        let kind = value.type_info().kind();
        Ok(match kind {
            AnyTypeInfoKind::Bool => Self::Integer(row.try_get::<bool, _>(column)?.into()),
            AnyTypeInfoKind::Double => Self::Real(row.try_get(column)?),
            AnyTypeInfoKind::Text => Self::Text(row.try_get(column)?),
            AnyTypeInfoKind::Blob => Self::Bytes(row.try_get(column)?),
            kind if kind.is_integer() => Self::Integer(row.try_get(column)?),
            other => return Err(Error::Corrupt(format!("FLIP stores no value of type {other:?}"))),
        })
    }

    /// Add the value to a hash: what it is, how long it is, and its bytes, so that other values
    /// never give the same bytes. Only the sign of zero is not looked at: SQLite stores -0.0 as 0.0.
    pub fn hash(&self, hash: &mut Sha256) {
        match self {
            Self::Null => hash.update([0]),
            Self::Integer(number) => {
                hash.update([1]);
                hash.update(number.to_be_bytes());
            }
            Self::Real(number) => {
                hash.update([2]);
                let negative_zero = (-0.0_f64).to_bits();
                let bits = Some(number.to_bits()).filter(|bits| *bits != negative_zero);
                hash.update(bits.unwrap_or(0).to_be_bytes());
            }
            Self::Text(text) => hash_bytes(hash, 3, text.as_bytes()),
            Self::Bytes(bytes) => hash_bytes(hash, 4, bytes),
        }
    }

    /// About how much memory it takes, bytes.
    pub fn size(&self) -> usize {
        match self {
            Self::Text(text) => text.len() + size_of::<Self>(),
            Self::Bytes(bytes) => bytes.len() + size_of::<Self>(),
            _ => size_of::<Self>(),
        }
    }

    /// Why it cannot be stored in a column of this kind, if so.
    pub fn unfit(&self, kind: Kind, postgres: bool) -> Option<&'static str> {
        match (self, kind) {
            (Self::Text(text), Kind::Text) if postgres && text.contains('\0') => {
                Some("holds a character of number 0 (NUL), which PostgreSQL does not store")
            }
            (Self::Real(number), Kind::Real) if !postgres && number.is_nan() => {
                Some("is not a number (NaN), which SQLite does not store")
            }
            (Self::Integer(0 | 1), Kind::Flag)
            | (Self::Null, _)
            | (Self::Integer(_), Kind::Integer)
            | (Self::Real(_), Kind::Real)
            | (Self::Text(_), Kind::Text)
            | (Self::Bytes(_), Kind::Bytes) => None,
            (_, Kind::Flag) => Some("is neither 0 nor 1"),
            _ => Some("is of another type than its column"),
        }
    }

    /// Add it to the arguments of a statement, for a column that it fits.
    pub fn bind(self, kind: Kind, arguments: &mut AnyArguments) {
        match (self, kind) {
            (Self::Null, Kind::Flag) => add(arguments, None::<bool>),
            (Self::Null, Kind::Integer) => add(arguments, None::<i64>),
            (Self::Null, Kind::Real) => add(arguments, None::<Number>),
            (Self::Null, Kind::Text) => add(arguments, None::<String>),
            (Self::Null, Kind::Bytes) => add(arguments, None::<Vec<u8>>),
            (Self::Integer(number), Kind::Flag) => add(arguments, number != 0),
            (Self::Integer(number), _) => add(arguments, number),
            (Self::Real(number), _) => add(arguments, number),
            (Self::Text(text), _) => add(arguments, text),
            (Self::Bytes(bytes), _) => add(arguments, bytes),
        }
    }
}

fn add<'t>(arguments: &mut AnyArguments, value: impl Encode<'t, Any> + Type<Any>) {
    if let Err(error) = arguments.add(value) {
        unreachable!("text, bytes and numbers can be bound: {error}");
    }
}

/// Add bytes to a hash, after what they are and how many.
pub(super) fn hash_bytes(hash: &mut Sha256, what: u8, bytes: &[u8]) {
    hash.update([what]);
    hash.update((bytes.len() as u64).to_be_bytes());
    hash.update(bytes);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hashed(cells: &[Cell]) -> Vec<u8> {
        let mut hash = Sha256::new();
        cells.iter().for_each(|cell| cell.hash(&mut hash));
        hash.finalize().to_vec()
    }

    #[test]
    fn other_values_have_another_hash() {
        let text = |text: &str| Cell::Text(text.to_owned());
        let rows = [
            vec![Cell::Null],
            vec![Cell::Null, Cell::Null],
            vec![Cell::Integer(0)],
            vec![Cell::Real(0.0)],
            vec![Cell::Real(5e-324)],
            vec![Cell::Real(-5e-324)],
            vec![text("")],
            vec![Cell::Bytes(Vec::new())],
            vec![text("ab"), text("c")],
            vec![text("a"), text("bc")],
            vec![text("abc"), text("")],
        ];
        for (k, row) in rows.iter().enumerate() {
            assert_eq!(hashed(row), hashed(&row.clone()));
            for other in &rows[k + 1..] {
                assert_ne!(hashed(row), hashed(other), "{row:?} and {other:?}");
            }
        }
    }

    #[test]
    fn numbers_have_the_same_hash_only_to_the_bit_except_for_the_sign_of_zero() {
        let same = |a: f64, b: f64| hashed(&[Cell::Real(a)]) == hashed(&[Cell::Real(b)]);
        assert!(same(0.0, -0.0) && same(f64::INFINITY, f64::INFINITY));
        for number in [1.0_f64, -1e308, 0.1, 5e-324, 2.2e-308] {
            for next in [number.next_up(), number.next_down(), -number] {
                assert!(same(number, number) && !same(number, next), "{number} and {next}");
            }
        }
    }

    #[test]
    fn what_the_other_database_would_change_or_refuse_is_unfit() {
        let text = Cell::Text("a\0b".to_owned());
        assert!(text.unfit(Kind::Text, true).unwrap().contains("NUL"));
        assert_eq!(text.unfit(Kind::Text, false), None);
        assert!(Cell::Real(f64::NAN).unfit(Kind::Real, false).unwrap().contains("NaN"));
        assert_eq!(Cell::Real(f64::NAN).unfit(Kind::Real, true), None);
        assert!(Cell::Integer(2).unfit(Kind::Flag, true).is_some());
        assert!(Cell::Integer(2).unfit(Kind::Real, false).is_some());
        for kind in [Kind::Flag, Kind::Integer, Kind::Real, Kind::Text, Kind::Bytes] {
            assert_eq!(Cell::Null.unfit(kind, true), None);
        }
    }
}
