//! Jobs as seen by callers: created, listed, cancelled. The workers' side is in `ledger.rs`.

use super::labels::shown;
use super::page::{Page, Window};
use super::row::{Columns, json, word};
use super::{Result, Store, Tx, now};
use flip_core::domain::job::{JobKind, JobState, Progress, Subject, seconds_left};
use flip_core::domain::labels::{LabelWanted, Labels};
use flip_core::domain::timestamp::Timestamp;
use serde::{Deserialize, Serialize};
use sqlx::any::AnyRow;
use std::time::Duration;

/// A job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Job {
    /// Id; a calibration, training, evaluation, investigation, film or measurement of the angle of
    /// repose has the id of its job.
    pub id: String,
    /// What it computes.
    pub kind: JobKind,
    /// What it is about.
    #[serde(default)]
    pub subject: Subject,
    /// Its state; one that no worker computes is queued.
    pub state: JobState,
    /// Its progress.
    pub progress: Progress,
    /// Time left at the pace of the present attempt, s; absent until the pace is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub left_s: Option<f64>,
    /// Its place among the jobs that wait for the same slot, 1 being the next; absent unless it
    /// waits.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub place: Option<u32>,
    /// How long it is expected to take once it begins, s: the median of earlier jobs like it;
    /// absent unless it waits, and if there are none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expected_s: Option<f64>,
    /// The failed or cancelled job that it starts again.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub again_of: Option<String>,
    /// What callers wrote on it.
    #[serde(default, skip_serializing_if = "Labels::is_empty")]
    pub labels: Labels,
    /// How often a worker has started or resumed it.
    pub attempts: u32,
    /// A cancellation was requested and has not been carried out yet.
    pub cancelling: bool,
    /// When it was created.
    pub created_at: Timestamp,
    /// When a worker first started it.
    pub started_at: Option<Timestamp>,
    /// When it ended.
    pub finished_at: Option<Timestamp>,
    /// Why it failed, or why its last attempt did.
    pub error: Option<String>,
}

/// A job with its specification and result, as JSON.
#[derive(Debug, Clone)]
pub struct JobRow {
    pub job: Job,
    pub spec: String,
    pub result: Option<String>,
}

/// Which jobs. Empty: all.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct JobsWanted {
    /// Only of this kind.
    pub kind: Option<JobKind>,
    /// Only in this state.
    pub state: Option<JobState>,
    /// Only with this label of a caller.
    pub label: Option<LabelWanted>,
}

/// Jobs that take alike long.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Sort {
    /// Their kind.
    pub kind: JobKind,
    /// The search method of calibrations.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub method: Option<String>,
}

/// Jobs that no worker computes.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Waiting {
    /// How many of each kind wait before the others.
    pub before: Vec<(JobKind, u64)>,
    /// Ids and sorts, the one that has waited longest first.
    pub jobs: Vec<(String, Sort)>,
}

/// That no worker computes a job at a time.
macro_rules! waits {
    ($now:literal) => {
        concat!("state IN ('queued', 'running') AND (state = 'queued' OR lease_until < ", $now, ")")
    };
}

pub(super) use waits;

/// Jobs that are looked back at for how long they took.
const TIMES_MAX: i64 = 500;

/// Topic of a job's events.
pub fn job_topic(id: &str) -> String {
    format!("job:{id}")
}

impl Store {
    /// Jobs, newest first.
    pub async fn jobs(&self, wanted: &JobsWanted, window: Window) -> Result<Page<Job>> {
        let JobsWanted { kind, state, label } = wanted;
        // Without specification and result, which may be half a megabyte each.
        let sql = concat!(
            "SELECT seq, id, kind, subject, state, fraction, message, attempts, cancel_requested, again_of, labels, ",
            "claimed_at, claimed_fraction, lease_until, created_at, started_at, finished_at, error ",
            "FROM job WHERE seq < $1 AND ($3 IS NULL OR kind = $3) AND ($4 IS NULL OR $4 = ",
            "CASE WHEN state = 'running' AND lease_until < $7 THEN 'queued' ELSE state END) AND ",
            "($8 IS NULL OR labels ->> $8 = $9) AND ",
            shown!("job.kind", "job.id", "$5", "$6"),
            " ORDER BY seq DESC LIMIT $2"
        );
        let rows = sqlx::query(sql)
            .bind(window.before())
            .bind(window.rows())
            .bind(kind.as_ref().map(word))
            .bind(state.as_ref().map(word))
            .bind(window.shown.archived())
            .bind(&window.shown.tag)
            .bind(now().unix_ms())
            .bind(label.as_ref().map(|label| path_of(&label.key)))
            .bind(label.as_ref().map(|label| &label.value))
            .fetch_all(&self.reader)
            .await?;
        window.page_of(&rows, job)
    }

    /// Jobs of one kind, newest first, with all their data.
    pub async fn whole_jobs(&self, kind: JobKind, window: Window) -> Result<Page<JobRow>> {
        let sql = concat!(
            "SELECT * FROM job WHERE seq < $1 AND kind = $3 AND ",
            shown!("job.kind", "job.id", "$4", "$5"),
            " ORDER BY seq DESC LIMIT $2"
        );
        let rows = sqlx::query(sql)
            .bind(window.before())
            .bind(window.rows())
            .bind(word(&kind))
            .bind(window.shown.archived())
            .bind(&window.shown.tag)
            .fetch_all(&self.reader)
            .await?;
        window.page_of(&rows, job_row)
    }

    /// Films, newest first, with all their data; of one weighing, of the heaps of one parameter
    /// set, or of the episodes of one training, if given.
    pub async fn films(
        &self,
        weighing: Option<&str>,
        set: Option<&str>,
        training: Option<&str>,
        window: Window,
    ) -> Result<Page<JobRow>> {
        let sql = "SELECT * FROM job WHERE seq < $1 AND kind = 'film' \
                   AND ($3 IS NULL OR spec ->> '$.film.weighing' = $3) \
                   AND ($4 IS NULL OR spec ->> '$.heap_film.set' = $4) \
                   AND ($5 IS NULL OR spec ->> '$.episode_film.training' = $5) ORDER BY seq DESC LIMIT $2";
        let rows = sqlx::query(sql)
            .bind(window.before())
            .bind(window.rows())
            .bind(weighing)
            .bind(set)
            .bind(training)
            .fetch_all(&self.reader)
            .await?;
        window.page_of(&rows, job_row)
    }

    /// One job.
    pub async fn job(&self, id: &str) -> Result<Option<JobRow>> {
        let row = sqlx::query("SELECT * FROM job WHERE id = $1")
            .bind(id)
            .fetch_optional(&self.reader)
            .await?;
        row.as_ref().map(job_row).transpose()
    }

    /// The jobs that no worker computes, around these two: a queue of thousands is counted, not read.
    pub async fn waiting_jobs(&self, around: [&str; 2]) -> Result<Waiting> {
        // All that have not ended, of which the index alone knows how many; those that are computed are few.
        let unfinished = "SELECT kind, count(*) AS many FROM job WHERE state IN ('queued', 'running') \
                          AND seq < (SELECT min(seq) FROM job WHERE id IN ($1, $2)) GROUP BY kind";
        let computed = "SELECT kind, count(*) AS many FROM job WHERE state = 'running' AND lease_until >= $3 \
                        AND seq < (SELECT min(seq) FROM job WHERE id IN ($1, $2)) GROUP BY kind";
        let rows = concat!(
            "SELECT id, kind, method FROM job WHERE ",
            waits!("$3"),
            " AND seq BETWEEN (SELECT min(seq) FROM job WHERE id IN ($1, $2)) AND (SELECT max(seq) FROM job WHERE id IN ($1, $2)) ORDER BY seq"
        );
        let (at, asked) = (now().unix_ms(), |sql| sqlx::query(sql).bind(around[0]).bind(around[1]));
        // A kind that is not known here waits for a program that knows it.
        let count = |row: &AnyRow| {
            let kind = row.word("job", "kind").ok()?;
            Some(row.plain("many").map(|many: i64| (kind, many.cast_unsigned())))
        };
        let known = |row: &AnyRow| Some((row.plain("id"), sort(row).ok()?));
        let before = asked(unfinished).fetch_all(&self.reader).await?;
        let mut before: Vec<_> = before.iter().filter_map(count).collect::<Result<_>>()?;
        let computed = asked(computed).bind(at).fetch_all(&self.reader).await?;
        let computed: Vec<_> = computed.iter().filter_map(count).collect::<Result<_>>()?;
        for (kind, many) in &mut before {
            let busy = computed.iter().filter(|(other, _)| other == kind).map(|(_, many)| many);
            *many = many.saturating_sub(busy.sum());
        }
        let rows = asked(rows).bind(at).fetch_all(&self.reader).await?;
        let jobs = rows
            .iter()
            .filter_map(known)
            .map(|(id, sort)| Ok((id?, sort)))
            .collect::<Result<_>>()?;
        Ok(Waiting { before, jobs })
    }

    /// What the last jobs that succeeded at the first attempt were, and how long each took, s.
    pub async fn times_taken(&self) -> Result<Vec<(Sort, f64)>> {
        let sql = "SELECT kind, method, CAST(finished_at - started_at AS DOUBLE PRECISION) / 1000 AS seconds FROM job \
                   WHERE state = 'succeeded' AND attempts = 1 ORDER BY seq DESC LIMIT $1";
        let rows = sqlx::query(sql).bind(TIMES_MAX).fetch_all(&self.reader).await?;
        rows.iter().map(|row| Ok((sort(row)?, row.plain("seconds")?))).collect()
    }

    /// The oldest calibration of a powder that waits or runs, under this version of the simulator,
    /// `None` being the base.
    pub async fn calibration_under_way(
        &self,
        powder: &str,
        simulator: Option<&str>,
    ) -> Result<Option<String>> {
        let sql = "SELECT id FROM job WHERE kind = 'calibration' AND state IN ('queued', 'running') \
                   AND spec ->> '$.calibration.powder' = $1 \
                   AND spec ->> '$.calibration.under.simulator' IS NOT DISTINCT FROM $2 ORDER BY seq LIMIT 1";
        let query = sqlx::query_scalar(sql).bind(powder).bind(simulator);
        Ok(query.fetch_optional(&self.reader).await?)
    }

    /// The latest successful calibration of a powder, or of a bare angle (exactly), under this
    /// version of the simulator, `None` being the base.
    pub async fn newest_calibration(
        &self,
        powder: Option<&str>,
        repose_deg: f64,
        simulator: Option<&str>,
    ) -> Result<Option<String>> {
        let sql = "SELECT id FROM job WHERE kind = 'calibration' AND state = 'succeeded' \
                   AND spec ->> '$.calibration.powder' IS NOT DISTINCT FROM $1 \
                   AND ($1 IS NOT NULL OR CAST(spec ->> '$.calibration.target.repose_deg' AS DOUBLE PRECISION) = $2) \
                   AND spec ->> '$.calibration.under.simulator' IS NOT DISTINCT FROM $3 ORDER BY seq DESC LIMIT 1";
        let query = sqlx::query_scalar(sql).bind(powder).bind(repose_deg).bind(simulator);
        Ok(query.fetch_optional(&self.reader).await?)
    }
}

impl Tx {
    /// Queue a job. `false`: a job with the same specification is queued, running or has succeeded,
    /// and that one is returned, with these labels too.
    pub async fn insert_job(
        &mut self,
        id: &str,
        kind: JobKind,
        (spec, spec_sha256): (&str, &[u8]),
        subject: &Subject,
        (again_of, labels): (Option<&str>, &Labels),
        now: Timestamp,
    ) -> Result<(Job, bool)> {
        let labels = Some(labels).filter(|labels| !labels.is_empty()).map(json).transpose()?;
        let sql =
            "SELECT * FROM job WHERE spec_sha256 = $1 AND state NOT IN ('failed', 'cancelled')";
        if let Some(row) =
            sqlx::query(sql).bind(spec_sha256).fetch_optional(&mut *self.inner).await?
        {
            let job = job(&row)?;
            return match labels {
                Some(labels) => Ok((self.label_job(&job.id, &labels).await?, false)),
                None => Ok((job, false)),
            };
        }
        let sql = "INSERT INTO job (id, kind, spec, spec_sha256, state, message, created_at, subject, again_of, labels, method, device) \
                   VALUES ($1, $2, $3, $4, 'queued', 'waits for a worker', $5, $6, $7, $8, \
                   CAST($3 AS TEXT) ->> '$.calibration.settings.method', $9) RETURNING *";
        let row = sqlx::query(sql)
            .bind(id)
            .bind(word(&kind))
            .bind(spec)
            .bind(spec_sha256)
            .bind(now.unix_ms())
            .bind(json(subject)?)
            .bind(again_of)
            .bind(labels)
            .bind(word(&subject.device))
            .fetch_one(&mut *self.inner)
            .await?;
        Ok((self.announce_job(&row).await?, true))
    }

    /// Write labels on a job that another request made; of equal keys the last one counts.
    async fn label_job(&mut self, id: &str, labels: &str) -> Result<Job> {
        let sql = "UPDATE job SET labels = json_patch(coalesce(labels, '{}'), $2) WHERE id = $1 RETURNING *";
        job(&sqlx::query(sql).bind(id).bind(labels).fetch_one(&mut *self.inner).await?)
    }

    /// Request that a job end: a queued one is cancelled at once, a running one once its worker
    /// notices. `None`: it has already ended, or never existed.
    pub async fn request_cancel(&mut self, id: &str, now: Timestamp) -> Result<Option<Job>> {
        let sql = "UPDATE job SET cancel_requested = TRUE,
                       finished_at = CASE state WHEN 'queued' THEN $2 END,
                       state = CASE state WHEN 'queued' THEN 'cancelled' ELSE state END
                   WHERE id = $1 AND state IN ('queued', 'running') RETURNING *";
        let row =
            sqlx::query(sql).bind(id).bind(now.unix_ms()).fetch_optional(&mut *self.inner).await?;
        match row {
            Some(row) => Ok(Some(self.announce_job(&row).await?)),
            None => Ok(None),
        }
    }

    /// Notify followers of a job's new state.
    pub(super) async fn announce_job(&mut self, row: &AnyRow) -> Result<Job> {
        let job = job(row)?;
        self.emit(&job_topic(&job.id), "state", &job).await?;
        Ok(job)
    }
}

/// Where the database finds the label with this key, which has no quotation marks.
pub(super) fn path_of(key: &str) -> String {
    format!("$.\"{key}\"")
}

fn sort(row: &AnyRow) -> Result<Sort> {
    Ok(Sort { kind: row.word("job", "kind")?, method: row.plain("method")? })
}

fn job_row(row: &AnyRow) -> Result<JobRow> {
    Ok(JobRow { job: job(row)?, spec: row.plain("spec")?, result: row.plain("result")? })
}

pub(super) fn job(row: &AnyRow) -> Result<Job> {
    let mut state: JobState = row.word("job", "state")?;
    let mut message: String = row.plain("message")?;
    let lease_until: Option<i64> = row.plain("lease_until")?;
    if state == JobState::Running && lease_until.is_some_and(|until| until < now().unix_ms()) {
        state = JobState::Queued;
        "waits to go on: nothing computes it".clone_into(&mut message);
    }
    Ok(Job {
        id: row.plain("id")?,
        kind: row.word("job", "kind")?,
        subject: row.maybe_json("subject")?.unwrap_or_default(),
        state,
        progress: Progress { fraction: row.plain("fraction")?, message },
        left_s: if state == JobState::Running { left_s(row)? } else { None },
        place: None,
        expected_s: None,
        again_of: row.plain("again_of")?,
        labels: row.maybe_json("labels")?.unwrap_or_default(),
        attempts: row.count("attempts")?,
        cancelling: row.flag("cancel_requested")? && !state.is_terminal(),
        created_at: row.time("created_at")?,
        started_at: row.maybe_time("started_at")?,
        finished_at: row.maybe_time("finished_at")?,
        error: row.plain("error")?,
    })
}

/// Time left at the pace since the present attempt was claimed, s.
pub(super) fn left_s(row: &AnyRow) -> Result<Option<f64>> {
    let Some(claimed_at) = row.plain::<Option<i64>>("claimed_at")? else { return Ok(None) };
    let (now_at, began): (f64, Option<f64>) =
        (row.plain("fraction")?, row.plain("claimed_fraction")?);
    let elapsed = Duration::from_millis((now().unix_ms() - claimed_at).max(0).unsigned_abs());
    Ok(seconds_left(now_at - began.unwrap_or(0.0), 1.0 - now_at, elapsed))
}
