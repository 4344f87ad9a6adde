//! Verification: is the record what was written, and do the rows match the record?
//!
//! A chain alone proves the records, not the rows shown in lists and tables. So each weighing's row
//! is compared with the record of its outcome, or, until it has one, with the record of its intent;
//! the fields that identify a retry are always compared with the latter. `said.rs` compares other
//! rows. A row that no record knows was inserted from outside, whatever creation time it claims:
//! rows that predate the record are in the record of the stock-taking (`stock.rs`).

use super::archive::{self, Archives, Away, LostArchive, Named, Order, aways, hash_at, why_lost};
use super::audit::{
    AuditBreak, AuditChain, AuditVerification, OutcomeRecord, Written, beginning, chain_start,
};
use super::page::LONG_BATCH;
use super::said::{ChangedOther, Said};
use super::stock::{Stock, found_weighing, rows_of, stock};
use super::weighing_rows::weighing_row;
use super::weighings::{Weighing, WeighingRow};
use super::{Error, Result, Store};
use serde::{Deserialize, Serialize};
use sqlx::{Any, Transaction};
use std::collections::HashMap;

/// Maximum number of changed rows listed; there may be more.
const NAMED_MAX: usize = 100;

/// A weighing's row that does not match the record.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChangedRow {
    /// The weighing.
    pub weighing: String,
    /// Position of the record that contradicts it; absent if there is none.
    pub seq: Option<i64>,
    /// What differs.
    pub why: String,
}

/// Findings so far.
struct Walk<'a> {
    files: &'a Archives,
    wanted: Option<&'a str>,
    records: i64,
    /// Position and hash of the last record seen.
    last: i64,
    last_hash: String,
    /// The last records of the chains before the one that is being verified.
    ends: Vec<AuditChain>,
    holds: bool,
    /// Weighings whose outcome is not recorded yet: position and content of their intent.
    open: HashMap<String, (i64, Intent)>,
    /// Weighings known to the record.
    known: std::collections::HashSet<String>,
    /// When the record begins.
    since_ms: i64,
    changed: Vec<ChangedRow>,
    /// The recorded state of other rows.
    said: Said,
    others: Vec<ChangedOther>,
    archives: Vec<LostArchive>,
    /// Archive members verified.
    members: i64,
}

/// Record of a weighing that has no recorded outcome.
enum Intent {
    /// The record of its intent.
    Asked(String),
    /// As found by the stock-taking.
    Found(Box<OutcomeRecord>),
}

impl Intent {
    /// The names of retry-identifying fields in which the row differs.
    fn key_differs(&self, row: &WeighingRow) -> Vec<&'static str> {
        let said = match self {
            Self::Asked(body) => serde_json::from_str(body).unwrap_or_default(),
            Self::Found(found) => found.key.clone(),
        };
        row.key().differs(&said)
    }
}

impl Store {
    /// Verify the whole chain and all rows, as of this moment; `wanted` is a hash that the chain
    /// should hold.
    pub async fn verify_audit(&self, wanted: Option<&str>) -> Result<AuditVerification> {
        // One snapshot: a dose that ends meanwhile would look like a changed row.
        let mut tx = self.long.begin().await?;
        verified(&mut tx, &self.archives, wanted).await
    }

    /// How a weighing's row differs from the record of its outcome. The second value is the
    /// recorded outcome, if any.
    ///
    /// The row of a weighing that predates the record must be as found by the stock-taking.
    pub async fn outcome_on_record(
        &self,
        row: &WeighingRow,
    ) -> Result<(Option<ChangedRow>, Option<Weighing>)> {
        let id = &row.weighing.id;
        let mut tx = self.long.begin().await?;
        let sql = "SELECT * FROM audit WHERE weighing = $1 AND kind = 'outcome' ORDER BY seq DESC LIMIT 1";
        let Some(record) = sqlx::query(sql).bind(id).fetch_optional(&mut *tx).await? else {
            return Ok((not_as_found(&mut tx, row).await?, None));
        };
        let record = Written::of(&record)?;
        let differs = |why| ChangedRow { weighing: id.clone(), seq: Some(record.seq), why };
        let before = hash_at(&mut tx, record.seq - 1).await?;
        if let Some(why) = record.flaw(record.seq, &before.unwrap_or_else(beginning)) {
            return Ok((Some(differs(why)), None));
        }
        let why = differs_from_outcome(row, &record.body);
        let said =
            serde_json::from_str::<OutcomeRecord>(&record.body).ok().map(|said| said.weighing);
        Ok((why.map(differs), said))
    }
}

/// As [`Store::verify_audit`], within a transaction and with these archives.
pub(super) async fn verified(
    tx: &mut Transaction<'_, Any>,
    archives: &Archives,
    wanted: Option<&str>,
) -> Result<AuditVerification> {
    let mut walk = Walk::new(archives, wanted);
    let mut broken = walk.go_through_records(tx).await?;
    if broken.is_none() {
        broken = walk.go_through_rows(tx).await?;
    }
    walk.end_chain();
    let mut chains = std::mem::take(&mut walk.ends);
    // The first may be empty.
    let first = chains.first().is_some_and(|it| chain_start(it.last_seq) == 0);
    let last_hash = if first { chains.remove(0).last_hash } else { beginning() };
    Ok(AuditVerification {
        broken: broken.or_else(|| walk.first_flaw()),
        records: walk.records,
        last_hash,
        chains,
        holds_hash: wanted.map(|_| walk.holds),
        changed: walk.changed,
        others: walk.others,
        archives: walk.archives,
    })
}

/// How the row of a weighing without a recorded outcome differs from the one found by the
/// stock-taking.
async fn not_as_found(
    tx: &mut Transaction<'_, Any>,
    row: &WeighingRow,
) -> Result<Option<ChangedRow>> {
    let id = &row.weighing.id;
    let missing = || ChangedRow {
        weighing: id.clone(),
        seq: None,
        why: "the record has no outcome of it".to_owned(),
    };
    if let Some((seq, found)) = found_weighing(tx, id).await? {
        let why = differs_from(row, &found);
        return Ok(why.map(|why| ChangedRow { weighing: id.clone(), seq: Some(seq), why }));
    }
    if stock(tx).await? != Stock::NotTaken {
        return Ok(Some(missing()));
    }
    let first: Option<i64> = sqlx::query_scalar("SELECT at FROM audit ORDER BY seq LIMIT 1")
        .fetch_optional(&mut **tx)
        .await?;
    let is_older = first.is_none_or(|first| row.weighing.created_at.unix_ms() < first);
    Ok((!is_older).then(missing))
}

impl<'a> Walk<'a> {
    fn new(files: &'a Archives, wanted: Option<&'a str>) -> Self {
        Self {
            files,
            wanted,
            records: 0,
            last: 0,
            last_hash: beginning(),
            ends: Vec::new(),
            holds: false,
            open: HashMap::new(),
            known: Default::default(),
            since_ms: i64::MAX,
            changed: Vec::new(),
            said: Said::default(),
            others: Vec::new(),
            archives: Vec::new(),
            members: 0,
        }
    }

    /// Verify the chain up to the first record that is not what was written; nothing is known about
    /// records in lost archives.
    async fn go_through_records(
        &mut self,
        tx: &mut Transaction<'_, Any>,
    ) -> Result<Option<AuditBreak>> {
        loop {
            let sql = "SELECT * FROM audit WHERE seq > $1 ORDER BY seq LIMIT $2";
            let rows =
                sqlx::query(sql).bind(self.last).bind(LONG_BATCH).fetch_all(&mut **tx).await?;
            if rows.is_empty() {
                return Ok(None);
            }
            for row in &rows {
                let record = Written::of(row)?;
                // A position is from 1 in its chain.
                let start = chain_start(record.seq - 1);
                if start > self.last {
                    self.end_chain();
                    (self.last, self.last_hash) = (start, beginning());
                }
                self.go_through_archived(tx, record.seq).await?;
                if let Some(why) = record.flaw(self.last + 1, &self.last_hash) {
                    return Ok(Some(AuditBreak { seq: record.seq, why }));
                }
                self.take(&record);
                self.hear(tx, record).await?;
            }
        }
    }

    /// Process archived records before this position.
    async fn go_through_archived(
        &mut self,
        tx: &mut Transaction<'_, Any>,
        before: i64,
    ) -> Result<()> {
        while before > self.last + 1 {
            let next = aways(tx, None, (self.last, self.last + 2), Order::Oldest, 1)
                .await?
                .into_iter()
                .next();
            match next.filter(|away| away.first == self.last + 1 && away.before == self.last_hash) {
                Some(away) => self.go_through_member(&away)?,
                None => return Ok(()),
            }
        }
        Ok(())
    }

    fn go_through_member(&mut self, away: &Away) -> Result<()> {
        self.members += 1;
        match self.files.read(away) {
            Ok(records) => records.iter().for_each(|record| self.take(record)),
            Err(error) if error.is_lost_part() => {
                self.lose(&away.file, (away.first, away.last), &error);
                self.records += away.last - away.first + 1;
                (self.last, self.last_hash) = (away.last, away.hash.clone());
                self.holds |= self.wanted == Some(away.hash.as_str());
            }
            Err(error) => return Err(error),
        }
        Ok(())
    }

    /// Remember where the chain ended that was gone through.
    fn end_chain(&mut self) {
        if self.last_hash != beginning() {
            let (last_seq, last_hash) = (self.last, self.last_hash.clone());
            self.ends.push(AuditChain { last_seq, last_hash });
        }
    }

    fn take(&mut self, record: &Written) {
        self.records += 1;
        (self.last, self.last_hash) = (record.seq, record.hash.clone());
        self.holds |= self.wanted == Some(record.hash.as_str());
        self.since_ms = self.since_ms.min(record.at);
    }

    /// Note a missing or damaged archive; each is listed once.
    fn lose(&mut self, file: &str, (first, last): (i64, i64), error: &Error) {
        match self.archives.iter_mut().find(|lost| lost.file == file) {
            Some(lost) => (lost.first, lost.last) = (lost.first.min(first), lost.last.max(last)),
            None => self.archives.push(LostArchive {
                file: file.to_owned(),
                first,
                last,
                why: why_lost(file, error),
            }),
        }
    }

    /// Process a record about a weighing, another row, or an archive.
    async fn hear(&mut self, tx: &mut Transaction<'_, Any>, record: Written) -> Result<()> {
        self.said.hear(&record);
        self.look_at_archive(tx, &record).await?;
        if let Some(found) = rows_of(&record) {
            self.find(record.seq, found.weighings);
        }
        let Some(id) = record.weighing else { return Ok(()) };
        match record.kind.as_str() {
            "intent" => {
                self.known.insert(id.clone());
                self.open.insert(id, (record.seq, Intent::Asked(record.body)));
            }
            "outcome" => {
                self.known.insert(id.clone());
                let asked = self.open.remove(&id);
                let row = row_of(tx, &id).await?;
                let why =
                    row.as_ref().map_or_else(gone, |row| differs_from_outcome(row, &record.body));
                self.note(id.clone(), Some(record.seq), why);
                if let (Some(row), Some((seq, said))) = (row, asked) {
                    self.note(id, Some(seq), changed(&named(said.key_differs(&row))));
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// Note weighings found by the stock-taking.
    fn find(&mut self, seq: i64, weighings: Vec<OutcomeRecord>) {
        for found in weighings {
            let id = found.weighing.id.clone();
            self.known.insert(id.clone());
            self.open.insert(id, (seq, Intent::Found(Box::new(found))));
        }
    }

    /// Check that a file named by a record is what was archived, byte for byte, and that the
    /// table's entry for it matches the record.
    async fn look_at_archive(
        &mut self,
        tx: &mut Transaction<'_, Any>,
        record: &Written,
    ) -> Result<()> {
        if record.kind != "person" || !record.body.contains(archive::DEED) {
            return Ok(());
        }
        let Ok(named) = serde_json::from_str::<Named>(&record.body) else { return Ok(()) };
        match self.files.get(&named.file, &named.sha256) {
            Err(error) if error.is_lost_part() => {
                self.lose(&named.file, (named.first, named.last), &error)
            }
            found => drop(found?),
        }
        if let Some(error) = archive::not_as_named(tx, record.seq, &named).await? {
            self.lose(&named.file, (named.first, named.last), &error);
            self.say_too(&named.file, &why_lost(&named.file, &error));
        }
        Ok(())
    }

    /// Add another problem of an archive.
    fn say_too(&mut self, file: &str, why: &str) {
        let lost = self.archives.iter_mut().find(|lost| lost.file == file && lost.why != why);
        if let Some(lost) = lost {
            lost.why = format!("{}; {why}", lost.why);
        }
    }

    /// Check weighings that have not ended, rows that the record does not know, and rows of other
    /// types.
    async fn go_through_rows(
        &mut self,
        tx: &mut Transaction<'_, Any>,
    ) -> Result<Option<AuditBreak>> {
        let stock = stock(tx).await?;
        if stock == Stock::Gone {
            let why = "the record of the rows that were there before each had one is gone: records were cut off";
            return Ok(Some(AuditBreak { seq: self.records, why: why.to_owned() }));
        }
        if archive::count(tx).await? != self.members {
            let why = "the table of archives names parts that are not in the chain: it was changed outside FLIP";
            return Ok(Some(AuditBreak { seq: self.records, why: why.to_owned() }));
        }
        for (id, (seq, said)) in std::mem::take(&mut self.open) {
            let row = row_of(tx, &id).await?;
            self.note(id, Some(seq), row.map_or_else(gone, |row| differs_from_intent(&row, &said)));
        }
        // Before a stock-taking, weighings that predate the record are in no record.
        let since_ms = if stock == Stock::Taken { 0 } else { self.since_ms };
        let sql = "SELECT id FROM weighing WHERE created_at >= $1 ORDER BY seq";
        let ids: Vec<String> = sqlx::query_scalar(sql).bind(since_ms).fetch_all(&mut **tx).await?;
        for id in ids.into_iter().filter(|id| !self.known.contains(id)).collect::<Vec<_>>() {
            self.note(id, None, Some("the record has no intent of it".to_owned()));
        }
        self.changed.sort_by(|a, b| (a.seq, &a.weighing).cmp(&(b.seq, &b.weighing)));
        if stock == Stock::Taken {
            self.others = self.said.compare(tx, NAMED_MAX).await?;
        }
        Ok(None)
    }

    fn note(&mut self, weighing: String, seq: Option<i64>, why: Option<String>) {
        if let Some(why) = why
            && self.changed.len() < NAMED_MAX
        {
            self.changed.push(ChangedRow { weighing, seq, why });
        }
    }

    /// The first mismatch with the record, if the chain itself is intact.
    fn first_flaw(&self) -> Option<AuditBreak> {
        let lost =
            |it: &LostArchive| (Some(it.first), format!("archive {} is lost: {}", it.file, it.why));
        let row = |it: &ChangedRow| (it.seq, format!("weighing {}: {}", it.weighing, it.why));
        let other =
            |it: &ChangedOther| (it.seq, format!("{} {}: {}", it.what.name(), it.id, it.why));
        let first = self.archives.first().map(lost).or_else(|| self.changed.first().map(row));
        let (seq, why) = first.or_else(|| self.others.first().map(other))?;
        Some(AuditBreak { seq: seq.unwrap_or(self.records), why })
    }
}

async fn row_of(tx: &mut Transaction<'_, Any>, id: &str) -> Result<Option<WeighingRow>> {
    let row = sqlx::query("SELECT * FROM weighing WHERE id = $1")
        .bind(id)
        .fetch_optional(&mut **tx)
        .await?;
    // A row that can no longer be parsed as a weighing counts as gone.
    Ok(row.as_ref().and_then(|row| weighing_row(row).ok()))
}

fn gone() -> Option<String> {
    Some("its row is gone, or does not read as a weighing".to_owned())
}

/// How a row differs from the record of its outcome.
fn differs_from_outcome(row: &WeighingRow, body: &str) -> Option<String> {
    let Ok(said) = serde_json::from_str::<OutcomeRecord>(body) else {
        return Some("the record of its outcome does not read as one".to_owned());
    };
    differs_from(row, &said)
}

/// How a row differs from a record of it.
fn differs_from(row: &WeighingRow, said: &OutcomeRecord) -> Option<String> {
    let other_trace = said.trace.is_some() && said.trace != row.trace;
    let mut others = row.key().differs(&said.key);
    others.extend(other_trace.then_some("trace"));
    others.extend((!row.patch_is_ours).then_some("patch"));
    different(&row.weighing, &said.weighing, others)
}

/// How the row of a weighing that has not ended differs from the record of its intent.
fn differs_from_intent(row: &WeighingRow, said: &Intent) -> Option<String> {
    let key = said.key_differs(row);
    let said = match said {
        Intent::Asked(body) => serde_json::from_str::<Weighing>(body),
        Intent::Found(found) if found.weighing.outcome.is_some() => {
            return differs_from(row, found);
        }
        Intent::Found(found) => Ok(found.weighing.clone()),
    };
    let Ok(said) = said else {
        return Some("the record of its intent does not read as one".to_owned());
    };
    let mut others = key;
    others.extend((!row.patch_is_ours).then_some("patch"));
    // State that changes before it ends.
    let row = &row.weighing;
    let said = Weighing { state: row.state, bench: row.bench, started_at: row.started_at, ..said };
    different(row, &said, others)
}

/// The names of differing fields, with both values.
fn different(row: &Weighing, said: &Weighing, others: Vec<&str>) -> Option<String> {
    let fields = |weighing| match serde_json::to_value(weighing) {
        Ok(serde_json::Value::Object(fields)) => fields,
        _ => serde_json::Map::new(),
    };
    let (row, said) = (fields(row), fields(said));
    let names: std::collections::BTreeSet<_> = row.keys().chain(said.keys()).collect();
    let null = serde_json::Value::Null;
    let one = |name: &&String| {
        let (row, said) =
            (row.get(name.as_str()).unwrap_or(&null), said.get(name.as_str()).unwrap_or(&null));
        (row != said).then(|| format!("{name} is {row}, {said} was recorded"))
    };
    let mut found: Vec<String> = names.iter().filter_map(one).collect();
    found.extend(named(others));
    changed(&found)
}

/// The differing fields, where the values mean little to a person.
fn named(others: Vec<&str>) -> Vec<String> {
    others.into_iter().map(|name| format!("{name} is another than was recorded")).collect()
}

fn changed(found: &[String]) -> Option<String> {
    (!found.is_empty()).then(|| format!("its row was changed outside FLIP: {}", found.join("; ")))
}
