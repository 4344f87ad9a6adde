//! The record of everything that happened, and whether it is intact.

use super::{Answer, Timestamp};
use serde::Serialize;
use utoipa::ToSchema;

/// An archive that is missing or damaged.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct LostArchive {
    /// The file, in the data folder.
    pub file: String,
    /// Position of the first of its records.
    pub first: i64,
    /// Position of the last.
    pub last: i64,
    /// What is wrong with it.
    pub why: String,
}

answer! { flip_store::archive::LostArchive => LostArchive { file, first, last, why } }

/// Type of a row.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum RowOf {
    /// A token, except when it was last used.
    Token,
    /// A powder.
    Powder,
    /// A measurement of an angle of repose.
    Measurement,
    /// An observation other than the angle.
    Observation,
    /// A check of the bench.
    Check,
    /// A latch of the bench: whether it is open.
    Latch,
    /// A hold of the bench: whether it is open.
    Hold,
    /// The current version of the simulator.
    Simulator,
    /// A calibrated set, whose id derives from its values.
    ParameterSet,
    /// A spoonful that was imported.
    Spoonful,
    /// Up to when shakes of a powder are forgotten.
    Forgotten,
    /// The name, note and tags of something, and whether it is archived.
    Label,
    /// That a measurement or an observation no longer counts.
    Withdrawal,
    /// The mark that a stock-taking of rows without a record was done, and when.
    Stock,
}

answer! { flip_store::said::RowOf => enum RowOf {
    Token, Powder, Measurement, Observation, Check, Latch, Hold, Simulator, ParameterSet, Spoonful,
    Forgotten, Label, Withdrawal, Stock,
} }

/// A row that does not match the record.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ChangedOther {
    /// Its type.
    pub what: RowOf,
    /// Its id.
    pub id: String,
    /// Position of the record that contradicts it; absent if there is none.
    pub seq: Option<i64>,
    /// What differs.
    pub why: String,
}

answer! { flip_store::said::ChangedOther => ChangedOther { what, id, seq, why } }

/// A weighing's row that does not match the record.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ChangedRow {
    /// The weighing.
    pub weighing: String,
    /// Position of the record that contradicts it; absent if there is none.
    pub seq: Option<i64>,
    /// What differs.
    pub why: String,
}

answer! { flip_store::verify::ChangedRow => ChangedRow { weighing, seq, why } }

/// One record of the audit trail.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct AuditRecord {
    /// Position; without gaps.
    pub seq: i64,
    /// When.
    pub at: Timestamp,
    /// The weighing it belongs to.
    pub weighing: Option<String>,
    /// `intent`, `state`, `sent`, `received`, `reading`, `decision`, `outcome`, `person`, `latch`,
    /// `hold`, `check`, `pile`, `rows` (rows as written) or `stock`; `lost` stands for records of
    /// an archive that is gone.
    pub kind: String,
    /// Contents: for a `state` its name, else an object whose fields depend on the kind.
    #[schema(value_type = serde_json::Value)]
    pub body: serde_json::Value,
    /// Hash of this record and, through the previous one, of all before.
    pub hash: String,
}

answer! { flip_store::audit::AuditRecord => AuditRecord { seq, at, weighing, kind, body, hash } }

/// A page of the records that match, and how many match.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct AuditFound {
    /// The records, newest first.
    pub items: Vec<AuditRecord>,
    /// Pass it as `after` to read on; absent on the last page.
    pub next: Option<String>,
    /// How many match in all.
    pub total: u64,
}

impl Answer for flip_store::audit_search::AuditFound {
    type Wire = AuditFound;
    fn wire(self) -> AuditFound {
        let flip_store::page::Page { items, next } = self.page;
        AuditFound { items: items.wire(), next, total: self.total }
    }
}

/// Whether the audit trail is intact.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct AuditVerification {
    /// Records checked.
    pub records: i64,
    /// Hash of the last record; 64 zeros if there is none. Of the first chain, if there are several
    /// benches.
    pub last_hash: String,
    /// The first record that is not what was written, and why.
    pub broken: Option<AuditBreak>,
    /// Whether the requested hash is in the chain.
    pub holds_hash: Option<bool>,
    /// Weighings whose rows do not match the record, at most a hundred; the first of them is in
    /// `broken` too.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub changed: Vec<ChangedRow>,
    /// Other rows that do not match the record (tokens, measurements, state of the bench), at most
    /// a hundred; the first of all is in `broken` too.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub others: Vec<ChangedOther>,
    /// Archives that are missing or damaged: their records are lost, and nothing else. The first of
    /// them is in `broken` too.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub archives: Vec<LostArchive>,
    /// The chains of further benches: absent where there is one bench.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub chains: Vec<AuditChain>,
}

/// One further chain of records.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct AuditChain {
    /// Position of its last record.
    pub last_seq: i64,
    /// Hash of its last record.
    pub last_hash: String,
}

answer! { flip_store::audit::AuditChain => AuditChain { last_seq, last_hash } }

answer! { flip_store::audit::AuditVerification => AuditVerification {
    records, last_hash, broken, holds_hash, changed, others, archives, chains,
} }

/// Where an audit trail is broken.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct AuditBreak {
    /// Position of the record.
    pub seq: i64,
    /// What is wrong with it.
    pub why: String,
}

answer! { flip_store::audit::AuditBreak => AuditBreak { seq, why } }
