//! Archiving the audit trail.

use super::{App, Result};
use flip_core::domain::FieldError;
use flip_core::domain::timestamp::Timestamp;
use flip_store::archiving::Archived;
use serde::Deserialize;

impl App {
    /// Moves the records of weighings that ended before a day, or a point in time, into files of
    /// the data folder. Intents, outcomes and people's actions stay in the database; certificates,
    /// listings and verification read the files.
    ///
    /// # Errors
    /// `Invalid`: `before` is neither a day such as `2026-11-26` (its start, UTC) nor RFC 3339;
    /// `Unavailable`: another archiving is in progress; `Internal`, `Unavailable`: what was already
    /// moved is in files named by the record, and everything else is where it was.
    pub async fn archive_audit(&self, before: &str) -> Result<Archived> {
        let before = point_in_time(before)?;
        Ok(self.store().archive_audit(before).await?)
    }
}

fn point_in_time(text: &str) -> std::result::Result<Timestamp, FieldError> {
    let whole = if text.len() == "2026-11-26".len() {
        format!("{text}T00:00:00Z")
    } else {
        text.to_owned()
    };
    let read = Timestamp::deserialize(serde_json::Value::String(whole));
    read.map_err(|_| {
        let advice = format!(
            "must be a day such as 2026-11-26, or a time such as 2026-11-26T08:00:00Z, got `{text}`"
        );
        FieldError::new("before", advice)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_day_begins_at_midnight_utc_and_what_is_no_day_is_refused() {
        let read = |text| point_in_time(text).map(|at| at.to_string());
        assert_eq!(read("2026-11-26").unwrap(), "2026-11-26T00:00:00Z");
        assert_eq!(read("2026-11-26T08:00:00+01:00").unwrap(), "2026-11-26T07:00:00Z");
        for text in ["", "26.11.2026", "2026-13-01", "yesterday", "2026-11-26T"] {
            assert_eq!(read(text).unwrap_err().field, "before", "{text}");
        }
    }
}
