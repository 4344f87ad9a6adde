//! The audit trail: found by what a person remembers of it, exported, and verified.

use super::check::Check;
use super::nearest::did_you_mean;
use super::weighing_search::{check_text, period};
use super::{App, Error, Result};
use flip_core::domain::FieldError;
use flip_store::audit::{AuditRecord, AuditVerification};
use flip_store::audit_search::{AuditFound, AuditWanted};
use flip_store::page::{LIST_LIMIT_MAX, PageQuery};
use futures::StreamExt;
use futures::stream::{self, BoxStream};

/// Every kind of record.
const KINDS: [&str; 14] = [
    "intent", "state", "sent", "received", "reading", "decision", "outcome", "person", "latch",
    "hold", "check", "pile", "rows", "stock",
];

/// Which records, with times as a person writes them.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct AuditAsked {
    /// What they have in common. Its times are set by those below.
    pub wanted: AuditWanted,
    /// On this day (UTC) or later, `2026-11-24`, or from this time on, `2026-11-24T08:00:00+01:00`.
    pub since: Option<String>,
    /// On this day (UTC) or earlier, or before this time.
    pub until: Option<String>,
}

impl App {
    /// The records that match, newest first, and how many match.
    ///
    /// # Errors
    /// `Invalid`: an unknown kind, a time that is none, an end before its beginning, too long a
    /// text, a wrong page.
    pub async fn audit(&self, asked: AuditAsked, page: PageQuery) -> Result<AuditFound> {
        let window = page.window(LIST_LIMIT_MAX)?;
        Ok(self.store().audit_records(&wanted(asked)?, window).await?)
    }

    /// Passes every record that matches to `take`, oldest first.
    ///
    /// # Errors
    /// As [`App::audit`].
    pub async fn export_audit(
        &self,
        asked: AuditAsked,
        mut take: impl FnMut(&AuditRecord),
    ) -> Result<()> {
        let wanted = wanted(asked)?;
        let mut after = 0;
        loop {
            let records = self.store().audit_after(&wanted, after).await?;
            let Some(last) = records.last() else { return Ok(()) };
            after = last.seq;
            records.iter().for_each(&mut take);
        }
    }

    /// The records that match, oldest first. The first batch may be empty, no other is.
    ///
    /// # Errors
    /// As [`App::audit`].
    pub fn audit_trail(
        &self,
        asked: AuditAsked,
    ) -> Result<BoxStream<'static, Result<Vec<AuditRecord>>>> {
        let (app, wanted) = (self.clone(), wanted(asked)?);
        let next = move |after: Option<i64>| {
            let (app, wanted) = (app.clone(), wanted.clone());
            async move { app.trail_after(&wanted, after?).await }
        };
        Ok(stream::unfold(Some(0), next).boxed())
    }

    /// One batch, and where the next one starts.
    async fn trail_after(
        &self,
        wanted: &AuditWanted,
        after: i64,
    ) -> Option<(Result<Vec<AuditRecord>>, Option<i64>)> {
        let records = self.store().audit_after(wanted, after).await.map_err(Error::from);
        let last = records.as_ref().ok().and_then(|records| records.last()).map(|last| last.seq);
        (after == 0 || last.is_some() || records.is_err()).then_some((records, last))
    }

    /// Whether the audit trail is intact and contains a hash that was kept elsewhere.
    ///
    /// # Errors
    /// `Invalid`
    pub async fn verify_audit(&self, hash: Option<&str>) -> Result<AuditVerification> {
        let is_hash = |text: &str| {
            text.len() == 64 && text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'))
        };
        if hash.is_some_and(|hash| !is_hash(hash)) {
            let advice = "must be 64 hexadecimal digits in lower case, as printed on a certificate";
            return Err(FieldError::new("hash", advice).into());
        }
        Ok(self.store().verify_audit(hash).await?)
    }
}

impl AuditAsked {
    /// Every record of one weighing.
    pub fn of(weighing: &str) -> Self {
        Self { wanted: AuditWanted::of(weighing), ..Self::default() }
    }
}

fn wanted(asked: AuditAsked) -> Result<AuditWanted> {
    let AuditAsked { mut wanted, since, until } = asked;
    let mut check = Check::default();
    (wanted.since, wanted.before) = period(&mut check, since.as_deref(), until.as_deref());
    if let Some(kind) = wanted.kind.as_deref().filter(|kind| !KINDS.contains(kind)) {
        let meant = did_you_mean(kind, KINDS);
        check.refuse(
            "kind",
            format!("is not a kind of record{meant}; the kinds are: {}", KINDS.join(", ")),
        );
    }
    check_text(&mut check, "person", wanted.person.as_deref());
    check_text(&mut check, "q", wanted.text.as_deref());
    check.done()?;
    Ok(wanted)
}

/// A record as a CSV line; [`AUDIT_CSV_HEADER`] is the first line.
pub fn audit_csv(record: &AuditRecord) -> String {
    let quoted = |text: &str| format!("\"{}\"", text.replace('"', "\"\""));
    let weighing = record.weighing.as_deref().unwrap_or_default();
    let body = quoted(&record.body.to_string());
    format!("{},{},{weighing},{},{body},{}\n", record.seq, record.at, record.kind, record.hash)
}

/// Header of the audit trail as CSV.
pub const AUDIT_CSV_HEADER: &str = "seq,at,weighing,kind,body,hash\n";
