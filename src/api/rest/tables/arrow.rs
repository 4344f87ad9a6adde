//! Rows as an Arrow file (IPC, also called Feather).

use super::columns::{Column, Kind};
use arrow_array::{ArrayRef, RecordBatch};
use arrow_array::{BooleanArray, Float64Array, Int64Array, StringArray, TimestampMillisecondArray};
use arrow_ipc::writer::FileWriter;
use arrow_schema::{ArrowError, DataType, Field, Schema, TimeUnit};
use serde_json::Value;
use std::sync::Arc;
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

const UTC: &str = "UTC";

/// An Arrow file, taken piece by piece while it is written.
pub struct ArrowFile {
    writer: FileWriter<Vec<u8>>,
    schema: Arc<Schema>,
}

impl ArrowFile {
    /// An empty file with these columns.
    ///
    /// # Errors
    /// Those of the library, which a valid schema does not meet.
    pub fn new(columns: &[Column]) -> Result<Self, ArrowError> {
        let field = |column: &Column| Field::new(&column.name, data_type(column.kind), true);
        let schema = Arc::new(Schema::new(columns.iter().map(field).collect::<Vec<_>>()));
        Ok(Self { writer: FileWriter::try_new(Vec::new(), &schema)?, schema })
    }

    /// Appends rows; returns what can be sent.
    ///
    /// # Errors
    /// As [`ArrowFile::new`].
    pub fn append(&mut self, columns: &[Column], rows: &[Value]) -> Result<Vec<u8>, ArrowError> {
        let arrays = columns.iter().map(|column| array(column, rows)).collect();
        self.writer.write(&RecordBatch::try_new(self.schema.clone(), arrays)?)?;
        Ok(std::mem::take(self.writer.get_mut()))
    }

    /// The end of the file.
    ///
    /// # Errors
    /// As [`ArrowFile::new`].
    pub fn finish(mut self) -> Result<Vec<u8>, ArrowError> {
        self.writer.finish()?;
        self.writer.into_inner()
    }
}

fn data_type(kind: Kind) -> DataType {
    match kind {
        Kind::Number => DataType::Float64,
        Kind::Integer => DataType::Int64,
        Kind::Truth => DataType::Boolean,
        Kind::Time => DataType::Timestamp(TimeUnit::Millisecond, Some(UTC.into())),
        Kind::Text | Kind::Json => DataType::Utf8,
    }
}

fn array(column: &Column, rows: &[Value]) -> ArrayRef {
    let values = rows.iter().map(|row| column.of(row));
    match column.kind {
        Kind::Number => Arc::new(values.map(Value::as_f64).collect::<Float64Array>()),
        Kind::Integer => Arc::new(values.map(Value::as_i64).collect::<Int64Array>()),
        Kind::Truth => Arc::new(values.map(Value::as_bool).collect::<BooleanArray>()),
        Kind::Time => {
            let times = values.map(|it| it.as_str().and_then(unix_ms));
            Arc::new(times.collect::<TimestampMillisecondArray>().with_timezone(UTC))
        }
        Kind::Text => Arc::new(values.map(Value::as_str).collect::<StringArray>()),
        Kind::Json => {
            let texts = values.map(|it| (!it.is_null()).then(|| it.to_string()));
            Arc::new(texts.collect::<StringArray>())
        }
    }
}

fn unix_ms(text: &str) -> Option<i64> {
    let at = OffsetDateTime::parse(text, &Rfc3339).ok()?;
    i64::try_from(at.unix_timestamp_nanos() / 1_000_000).ok()
}
