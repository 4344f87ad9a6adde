//! Is the record what was written, and are the results what the record says?
//!
//! A chain alone proves the records, not the rows that lists and tables show. So each weighing's row is compared with the record of its outcome, or
//! while it has none with the record of its intent.

use super::audit::{AuditBreak, AuditVerification, OutcomeRecord, beginning, flaw};
use super::row::Columns;
use super::weighings::{Weighing, WeighingRow, weighing_row};
use super::{Result, Store};
use serde::{Deserialize, Serialize};
use sqlx::sqlite::SqliteRow;
use sqlx::{Sqlite, Transaction};
use std::collections::{HashMap, HashSet};

/// Records read at once.
const BATCH: i64 = 2000;
/// Changed rows that are named; there may be more.
const NAMED_MAX: usize = 100;

/// A weighing's row that is not what the record says.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ChangedRow {
    /// The weighing.
    pub weighing: String,
    /// Position of the record that says otherwise; absent if there is none.
    pub seq: Option<i64>,
    /// What is different.
    pub why: String,
}

/// What was found so far.
#[derive(Default)]
struct Walk {
    records: i64,
    last_hash: String,
    holds: bool,
    /// Weighings whose outcome is not recorded yet: where their intent is, and what it says.
    open: HashMap<String, (i64, String)>,
    /// Weighings that the record knows.
    known: HashSet<String>,
    /// When the record begins.
    since_ms: i64,
    changed: Vec<ChangedRow>,
}

impl Store {
    /// Go through the whole chain and all weighings, as they are at this moment; `wanted` is a hash that the chain should hold.
    pub(crate) async fn verify_audit(&self, wanted: Option<&str>) -> Result<AuditVerification> {
        // One snapshot: a dose that ends meanwhile would look like a changed row.
        let mut tx = self.long.begin().await?;
        let mut walk = Walk { last_hash: beginning(), since_ms: i64::MAX, ..Walk::default() };
        let broken = walk.go_through_records(&mut tx, wanted).await?;
        if broken.is_none() {
            walk.go_through_rows(&mut tx).await?;
        }
        let first = walk.changed.first();
        let by_row = first.map(|it| AuditBreak {
            seq: it.seq.unwrap_or(walk.records),
            why: format!("weighing {}: {}", it.weighing, it.why),
        });
        Ok(AuditVerification {
            records: walk.records,
            last_hash: walk.last_hash,
            broken: broken.or(by_row),
            holds_hash: wanted.map(|_| walk.holds),
            changed: walk.changed,
        })
    }

    /// How a weighing's row differs from what the record says of its outcome. The second is what it says, where it says anything.
    ///
    /// The row of a weighing from before there was a record differs from nothing.
    pub(crate) async fn outcome_on_record(&self, row: &WeighingRow) -> Result<(Option<ChangedRow>, Option<Weighing>)> {
        let id = &row.weighing.id;
        let mut tx = self.long.begin().await?;
        let sql = "SELECT * FROM audit WHERE weighing = ?1 AND kind = 'outcome' ORDER BY seq DESC LIMIT 1";
        let Some(record) = sqlx::query(sql).bind(id).fetch_optional(&mut *tx).await? else {
            let first: Option<i64> =
                sqlx::query_scalar("SELECT at FROM audit ORDER BY seq LIMIT 1").fetch_optional(&mut *tx).await?;
            let is_older = first.is_none_or(|first| row.weighing.created_at.unix_ms() < first);
            let missing =
                ChangedRow { weighing: id.clone(), seq: None, why: "the record has no outcome of it".to_owned() };
            return Ok(((!is_older).then_some(missing), None));
        };
        let seq: i64 = record.plain("seq")?;
        let before: Option<String> =
            sqlx::query_scalar("SELECT hash FROM audit WHERE seq = ?1").bind(seq - 1).fetch_optional(&mut *tx).await?;
        if let Some(why) = flaw(&record, seq, &before.unwrap_or_else(beginning))? {
            return Ok((Some(ChangedRow { weighing: id.clone(), seq: Some(seq), why }), None));
        }
        let body: String = record.plain("body")?;
        let why = differs_from_outcome(row, &body);
        let said = serde_json::from_str::<OutcomeRecord>(&body).ok().map(|said| said.weighing);
        Ok((why.map(|why| ChangedRow { weighing: id.clone(), seq: Some(seq), why }), said))
    }
}

impl Walk {
    /// Go through the chain up to the first record that is not what was written.
    async fn go_through_records(
        &mut self,
        tx: &mut Transaction<'_, Sqlite>,
        wanted: Option<&str>,
    ) -> Result<Option<AuditBreak>> {
        loop {
            let sql = "SELECT * FROM audit WHERE seq > ?1 ORDER BY seq LIMIT ?2";
            let rows = sqlx::query(sql).bind(self.records).bind(BATCH).fetch_all(&mut **tx).await?;
            if rows.is_empty() {
                return Ok(None);
            }
            for row in &rows {
                if let Some(why) = flaw(row, self.records + 1, &self.last_hash)? {
                    return Ok(Some(AuditBreak { seq: row.plain("seq")?, why }));
                }
                self.last_hash = row.plain("hash")?;
                self.holds |= wanted == Some(self.last_hash.as_str());
                self.records += 1;
                self.since_ms = self.since_ms.min(row.plain("at")?);
                self.hear(tx, row).await?;
            }
        }
    }

    /// What a record says of a weighing.
    async fn hear(&mut self, tx: &mut Transaction<'_, Sqlite>, record: &SqliteRow) -> Result<()> {
        let Some(id) = record.plain::<Option<String>>("weighing")? else { return Ok(()) };
        let (seq, body): (i64, String) = (record.plain("seq")?, record.plain("body")?);
        match record.plain::<String>("kind")?.as_str() {
            "intent" => {
                self.known.insert(id.clone());
                self.open.insert(id, (seq, body));
            }
            "outcome" => {
                self.known.insert(id.clone());
                self.open.remove(&id);
                let row = row_of(tx, &id).await?;
                self.note(id, Some(seq), row.map_or_else(gone, |row| differs_from_outcome(&row, &body)));
            }
            _ => {}
        }
        Ok(())
    }

    /// Weighings that have not ended, and rows that the record does not know.
    async fn go_through_rows(&mut self, tx: &mut Transaction<'_, Sqlite>) -> Result<()> {
        for (id, (seq, body)) in std::mem::take(&mut self.open) {
            let row = row_of(tx, &id).await?;
            self.note(id, Some(seq), row.map_or_else(gone, |row| differs_from_intent(&row, &body)));
        }
        // Those from before there was a record are in no record.
        let sql = "SELECT id FROM weighing WHERE created_at >= ?1 ORDER BY seq";
        let ids: Vec<String> = sqlx::query_scalar(sql).bind(self.since_ms).fetch_all(&mut **tx).await?;
        for id in ids.into_iter().filter(|id| !self.known.contains(id)).collect::<Vec<_>>() {
            self.note(id, None, Some("the record has no intent of it".to_owned()));
        }
        self.changed.sort_by(|a, b| (a.seq, &a.weighing).cmp(&(b.seq, &b.weighing)));
        Ok(())
    }

    fn note(&mut self, weighing: String, seq: Option<i64>, why: Option<String>) {
        if let Some(why) = why
            && self.changed.len() < NAMED_MAX
        {
            self.changed.push(ChangedRow { weighing, seq, why });
        }
    }
}

async fn row_of(tx: &mut Transaction<'_, Sqlite>, id: &str) -> Result<Option<WeighingRow>> {
    let row = sqlx::query("SELECT * FROM weighing WHERE id = ?1").bind(id).fetch_optional(&mut **tx).await?;
    // What does not read as a weighing any more is gone as well.
    Ok(row.as_ref().and_then(|row| weighing_row(row).ok()))
}

fn gone() -> Option<String> {
    Some("its row is gone, or does not read as a weighing".to_owned())
}

/// What a row has otherwise than the record of its outcome.
fn differs_from_outcome(row: &WeighingRow, body: &str) -> Option<String> {
    let Ok(said) = serde_json::from_str::<OutcomeRecord>(body) else {
        return Some("the record of its outcome does not read as one".to_owned());
    };
    let other_trace = said.trace.is_some() && said.trace != row.trace;
    different(&row.weighing, &said.weighing, other_trace.then_some("trace"))
}

/// What the row of a weighing that has not ended has otherwise than the record of its intent.
fn differs_from_intent(row: &WeighingRow, body: &str) -> Option<String> {
    let Ok(said) = serde_json::from_str::<Weighing>(body) else {
        return Some("the record of its intent does not read as one".to_owned());
    };
    // What becomes of it before it ends.
    let row = &row.weighing;
    let said = Weighing { state: row.state, bench: row.bench, started_at: row.started_at, ..said };
    different(row, &said, None)
}

/// The names of what differs, with both values.
fn different(row: &Weighing, said: &Weighing, also: Option<&str>) -> Option<String> {
    let fields = |weighing| match serde_json::to_value(weighing) {
        Ok(serde_json::Value::Object(fields)) => fields,
        _ => serde_json::Map::new(),
    };
    let (row, said) = (fields(row), fields(said));
    let names: std::collections::BTreeSet<_> = row.keys().chain(said.keys()).collect();
    let null = serde_json::Value::Null;
    let one = |name: &&String| {
        let (row, said) = (row.get(name.as_str()).unwrap_or(&null), said.get(name.as_str()).unwrap_or(&null));
        (row != said).then(|| format!("{name} is {row}, {said} was recorded"))
    };
    let mut found: Vec<String> = names.iter().filter_map(|name| one(name)).collect();
    found.extend(also.map(|name| format!("{name} is another than was recorded")));
    (!found.is_empty()).then(|| format!("its row was changed outside FLIP: {}", found.join("; ")))
}
