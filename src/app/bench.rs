//! The bench: what it is, whether it may be used, who cleared it, and the record of all that happened on it.

use super::check::Check;
use super::{App, Error, Result};
use crate::domain::FieldError;
use crate::domain::bench::BenchKind;
use crate::domain::bench_check::{CheckKind, Repeatability, ShakeCalibration};
use crate::store::audit::{AuditRecord, AuditVerification};
use crate::store::bench::Latch;
use crate::store::now;
use crate::store::page::{LIST_LIMIT_MAX, Page, PageQuery};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Longest name and note of a person.
const WORDS_MAX: usize = 2000;

/// What the bench is and whether it may be used.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct BenchStatus {
    /// What it is made of; absent where another process has it.
    pub kind: Option<BenchKind>,
    /// Devices by role, as they say themselves.
    pub devices: BTreeMap<String, String>,
    /// Why it may not be used, until a person has cleared it.
    pub latch: Option<Latch>,
    /// The weighing that moves.
    pub moving: Option<String>,
    /// The newest check of how well the balance repeats.
    pub repeatability: Option<Repeatability>,
}

/// A person has looked at the bench, and says so.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ClearRequest {
    /// Who looked.
    pub by: String,
    /// What was found and done.
    #[serde(default)]
    pub note: String,
    /// The bench was looked at. Must be true.
    pub looked: bool,
    /// The vial is empty or new, and the balance will be tared. Must be true.
    pub vial_ready: bool,
}

/// Weighings of one test weight.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RepeatabilityRequest {
    /// Readings, the weight put on anew for each, mg; at least ten.
    pub readings_mg: Vec<f64>,
    /// Step of the display, mg.
    pub readability_mg: f64,
}

impl App {
    /// What the bench is and whether it may be used.
    ///
    /// # Errors
    /// `Internal`
    pub async fn bench(&self) -> Result<BenchStatus> {
        let repeatability = self.store().newest_check(CheckKind::Repeatability).await?.map(|it| it.1);
        let latch = self.store().latch().await?;
        let (kind, devices, moving) = match &self.inner.jobs {
            Some(jobs) => (Some(jobs.bench().kind()), jobs.bench().devices(), jobs.bench().moving_weighing()),
            None => (None, BTreeMap::new(), None),
        };
        Ok(BenchStatus { kind, devices, latch, moving, repeatability })
    }

    /// Stop whatever moves on the bench. Not an emergency stop.
    ///
    /// # Errors
    /// `Unavailable` when opened to read.
    pub async fn stop_bench(&self) -> Result<BenchStatus> {
        if let Some(id) = self.jobs_or_refuse()?.bench().stop_moving() {
            let mut tx = self.store().write().await?;
            tx.audit_person(Some(&id), "stop", now()).await?;
            tx.commit().await?;
        }
        self.bench().await
    }

    /// A person has looked: weighings may go on.
    ///
    /// # Errors
    /// `Invalid`; `Conflict` (`bench_not_latched`).
    pub async fn clear_bench(&self, request: ClearRequest) -> Result<BenchStatus> {
        let mut check = Check::default();
        let by = request.by.trim();
        if by.is_empty() || by.len() > WORDS_MAX || by.chars().any(char::is_control) {
            check.refuse("by", "must name the person who looked, in one line".to_owned());
        }
        if request.note.len() > WORDS_MAX {
            check.refuse("note", format!("must be at most {WORDS_MAX} bytes, got {}", request.note.len()));
        }
        if !request.looked {
            check.refuse("looked", "must be true: look at spoon, vial and balance first".to_owned());
        }
        if !request.vial_ready {
            check.refuse("vial_ready", "must be true: empty or exchange the vial first".to_owned());
        }
        check.done()?;
        let jobs = self.jobs_or_refuse()?;
        if self.store().latch().await?.is_some() {
            // Before the latch is gone: a bench whose arm cannot move must not look free.
            jobs.bench().recover(by).await.map_err(|error| Error::conflict("arm_not_recovered", error.to_string()))?;
        }
        let mut tx = self.store().write().await?;
        if tx.clear_latch(by, &request.note, now()).await?.is_none() {
            return Err(Error::conflict("bench_not_latched", "the bench is not latched: there is nothing to clear"));
        }
        tx.commit().await?;
        jobs.bench().wake();
        self.bench().await
    }

    /// Keep a check of how well the balance repeats.
    ///
    /// # Errors
    /// `Invalid`
    pub async fn check_repeatability(&self, request: RepeatabilityRequest) -> Result<Repeatability> {
        let RepeatabilityRequest { readings_mg, readability_mg } = request;
        if !(readability_mg.is_finite() && (1e-4..=1000.0).contains(&readability_mg)) {
            let advice = format!("must be from 0.0001 to 1000 mg, got {readability_mg}");
            return Err(FieldError::new("readability_mg", advice).into());
        }
        let found = Repeatability::of(readings_mg, readability_mg)?;
        self.keep_check(CheckKind::Repeatability, &found).await?;
        Ok(found)
    }

    /// What the arm makes of a commanded shake, as it was measured last.
    ///
    /// # Errors
    /// `Conflict` (`shakes_not_calibrated`).
    pub(super) async fn shakes(&self) -> Result<ShakeCalibration> {
        let measured: Option<(_, ShakeCalibration)> = self.store().newest_check(CheckKind::Shakes).await?;
        let advice = "the arm's shakes were not measured yet: run `flip bench calibrate-shake` first";
        measured.map(|(_, calibration)| calibration).ok_or_else(|| Error::conflict("shakes_not_calibrated", advice))
    }

    /// Keep what the arm makes of commanded shakes; weighings command accordingly from now on.
    ///
    /// # Errors
    /// `Unavailable` when opened to read.
    pub async fn keep_shakes(&self, found: &ShakeCalibration) -> Result<()> {
        self.keep_check(CheckKind::Shakes, found).await
    }

    /// Keep a dry test of the devices, whatever it found.
    ///
    /// # Errors
    /// `Unavailable` when opened to read.
    pub async fn keep_conformance(&self, found: &impl Serialize) -> Result<()> {
        self.keep_check(CheckKind::Conformance, found).await
    }

    async fn keep_check(&self, kind: CheckKind, found: &impl Serialize) -> Result<()> {
        self.jobs_or_refuse()?;
        let mut tx = self.store().write().await?;
        tx.insert_check(kind, found, now()).await?;
        tx.commit().await?;
        Ok(())
    }

    /// Records of the audit trail, newest first; of one weighing when named.
    ///
    /// # Errors
    /// `Invalid`
    pub async fn audit(&self, weighing: Option<&str>, page: PageQuery) -> Result<Page<AuditRecord>> {
        Ok(self.store().audit_records(weighing, page.window(LIST_LIMIT_MAX)?).await?)
    }

    /// Hand every record to `take`, oldest first; of one weighing when named.
    ///
    /// # Errors
    /// `Internal`
    pub async fn export_audit(&self, weighing: Option<&str>, mut take: impl FnMut(&AuditRecord)) -> Result<()> {
        let mut after = 0;
        loop {
            let records = self.store().audit_after(weighing, after).await?;
            let Some(last) = records.last() else { return Ok(()) };
            after = last.seq;
            records.iter().for_each(&mut take);
        }
    }

    /// Whether the audit trail is whole, and holds a hash that somebody kept.
    ///
    /// # Errors
    /// `Invalid`
    pub async fn verify_audit(&self, hash: Option<&str>) -> Result<AuditVerification> {
        let is_hash = |text: &str| text.len() == 64 && text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'));
        if hash.is_some_and(|hash| !is_hash(hash)) {
            let advice = "must be 64 hexadecimal digits in lower case, as a certificate prints them";
            return Err(FieldError::new("hash", advice).into());
        }
        Ok(self.store().verify_audit(hash).await?)
    }
}

/// A record as a line of CSV; [`AUDIT_CSV_HEADER`] is the first.
pub fn audit_csv(record: &AuditRecord) -> String {
    let quoted = |text: &str| format!("\"{}\"", text.replace('"', "\"\""));
    let weighing = record.weighing.as_deref().unwrap_or_default();
    let body = quoted(&record.body.to_string());
    format!("{},{},{weighing},{},{body},{}\n", record.seq, record.at, record.kind, record.hash)
}

/// Header of the audit trail's CSV.
pub const AUDIT_CSV_HEADER: &str = "seq,at,weighing,kind,body,hash\n";
