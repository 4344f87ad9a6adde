//! Weighings: the intent is committed before any motion, the outcome after it; nothing is ever
//! poured twice.

use super::benches::DEFAULT_BENCH;
use super::row::{Columns, json, word};
use super::sql::{Flag, Number};
use super::weighing_rows::{weighing, weighing_row};
use super::{Result, Store, Tx};
use crate::audit::{About, OutcomeRecord};
use flip_core::domain::apparatus::Apparatus;
use flip_core::domain::bench::{BenchKind, Tick};
use flip_core::domain::conditions::{Patch, Under};
use flip_core::domain::labels::Labels;
use flip_core::domain::timestamp::Timestamp;
use flip_core::domain::vial::VialCheck;
use flip_core::domain::weighing::{Asked, MeasuredMass, Outcome, WeighRequest, WeighingState};
use serde::{Deserialize, Serialize};
use sqlx::any::AnyRow;

/// One dose: the order and how it ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Weighing {
    /// Id.
    pub id: String,
    /// Powder id.
    pub powder: String,
    /// Target mass, mg.
    pub target_mg: f64,
    /// Accepted shortfall, mg.
    pub tolerance_lower_mg: f64,
    /// Accepted excess, mg.
    pub tolerance_upper_mg: f64,
    /// Policy id.
    pub policy: String,
    /// The simulated powder on the bench: one of the powder's sets, preferably one that the policy
    /// was not trained on.
    pub parameter_set: String,
    /// Seed of the simulated bench.
    pub seed: u64,
    /// The extended version of the simulator on the bench, and its conditions; absent for the base.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub under: Option<Under>,
    /// Changes of the powder under these conditions.
    #[serde(default, skip_serializing_if = "Patch::is_none")]
    pub patch: Patch,
    /// Other requested options.
    #[serde(default, skip_serializing_if = "Asked::is_nothing")]
    pub asked: Asked,
    /// What the caller wrote on it.
    #[serde(default, skip_serializing_if = "Labels::is_empty")]
    pub labels: Labels,
    /// Whether someone has to confirm that its vial is in; absent for `confirm`.
    #[serde(default, skip_serializing_if = "VialCheck::is_confirm")]
    pub vial_check: VialCheck,
    /// The kind of bench that was armed for it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bench: Option<BenchKind>,
    /// The bench that carries it out; absent for the one named `bench`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bench_name: Option<String>,
    /// Its state.
    pub state: WeighingState,
    /// How it ended.
    pub outcome: Option<Outcome>,
    /// True mass in the vial, mg: known only in simulation, and not used to judge the outcome.
    pub dispensed_mg: Option<f64>,
    /// Final reading of the balance, mg; null if there is none, as for an aborted dose.
    pub reading_mg: Option<f64>,
    /// Reading minus target, mg, on every bench; null if the dose did not run its course.
    pub error_mg: Option<f64>,
    /// Number of shakes.
    pub shakes: Option<u32>,
    /// Bench time, s.
    pub seconds: Option<f64>,
    /// Measurements in addition to the reading.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured: Option<MeasuredMass>,
    /// Display, spoon and strokes with which its shakes were made and read; absent if none was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub apparatus: Option<Apparatus>,
    /// Why it was aborted.
    pub error: Option<String>,
    /// When the intent was committed.
    pub created_at: Timestamp,
    /// When the bench was armed.
    pub started_at: Option<Timestamp>,
    /// When it ended.
    pub finished_at: Option<Timestamp>,
}

impl Weighing {
    /// The name of the bench that carries it out.
    pub fn at_bench(&self) -> &str {
        self.bench_name.as_deref().unwrap_or(DEFAULT_BENCH)
    }
}

/// A weighing waiting for the bench.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Waiting {
    /// Weighing id.
    pub id: String,
    /// Powder id.
    pub powder: String,
    /// Target mass, mg.
    pub target_mg: f64,
    /// Its vial, if it was named.
    pub vial: Option<String>,
    /// `planned` or `awaiting_vial`.
    pub state: WeighingState,
}

/// A weighing with fields that callers do not see.
#[derive(Debug, Clone)]
pub struct WeighingRow {
    pub weighing: Weighing,
    pub idempotency_key: String,
    pub request_sha256: Vec<u8>,
    /// Its patch is stored in FLIP's own format, in which an empty one is omitted.
    pub patch_is_ours: bool,
    /// SHA-256 of the artifact that holds the ticks.
    pub trace: Option<String>,
}

/// An intent to weigh, validated and with every choice made.
#[derive(Debug, Clone)]
pub struct Intent {
    pub id: String,
    pub idempotency_key: String,
    pub request_sha256: Vec<u8>,
    pub request: WeighRequest,
    pub parameter_set: String,
}

/// Record of an intent.
#[derive(Serialize)]
struct IntentRecord<'a> {
    #[serde(flatten)]
    weighing: &'a Weighing,
    #[serde(flatten)]
    key: RetryKey,
}

/// The fields that identify a retry, as far as a record holds them: with another key it would pour
/// again.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct RetryKey {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub idempotency_key: Option<String>,
    /// In hexadecimal; missing from older records.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub request_sha256: Option<String>,
}

impl RetryKey {
    fn of(idempotency_key: &str, request_sha256: &[u8]) -> Self {
        let (key, sha256) = (idempotency_key.to_owned(), hex::encode(request_sha256));
        Self { idempotency_key: Some(key), request_sha256: Some(sha256) }
    }

    /// The names of fields that differ from a record; fields that it does not hold are not
    /// compared.
    pub(super) fn differs(&self, said: &Self) -> Vec<&'static str> {
        let key = said.idempotency_key.is_some() && said.idempotency_key != self.idempotency_key;
        let sha256 = said.request_sha256.is_some() && said.request_sha256 != self.request_sha256;
        [(key, "idempotency_key"), (sha256, "request_sha256")]
            .into_iter()
            .filter_map(|(is, name)| is.then_some(name))
            .collect()
    }
}

impl WeighingRow {
    pub(super) fn key(&self) -> RetryKey {
        RetryKey::of(&self.idempotency_key, &self.request_sha256)
    }
}

/// How a weighing ended.
#[derive(Debug, Clone)]
pub struct Ending {
    pub state: WeighingState,
    pub outcome: Outcome,
    pub dispensed_mg: Option<f64>,
    pub reading_mg: Option<f64>,
    pub error_mg: Option<f64>,
    pub shakes: Option<u32>,
    pub seconds: Option<f64>,
    pub measured: Option<MeasuredMass>,
    pub apparatus: Option<Apparatus>,
    pub trace: Option<String>,
    pub error: Option<String>,
}

impl Ending {
    /// An end without any measurements.
    pub fn bare(state: WeighingState, outcome: Outcome, error: impl Into<String>) -> Self {
        let error = Some(error.into());
        let (dispensed_mg, reading_mg, error_mg, shakes, seconds) = (None, None, None, None, None);
        let (measured, apparatus, trace) = (None, None, None);
        Self {
            state,
            outcome,
            dispensed_mg,
            reading_mg,
            error_mg,
            shakes,
            seconds,
            measured,
            apparatus,
            trace,
            error,
        }
    }
}

/// Topic of a weighing's events.
pub fn weighing_topic(id: &str) -> String {
    format!("weighing:{id}")
}

impl Store {
    /// One weighing.
    pub async fn weighing(&self, id: &str) -> Result<Option<WeighingRow>> {
        let row = sqlx::query("SELECT * FROM weighing WHERE id = $1")
            .bind(id)
            .fetch_optional(&self.reader)
            .await?;
        row.as_ref().map(weighing_row).transpose()
    }

    /// The weighing with this key.
    pub async fn weighing_by_key(&self, key: &str) -> Result<Option<WeighingRow>> {
        let sql = "SELECT * FROM weighing WHERE idempotency_key = $1";
        let row = sqlx::query(sql).bind(key).fetch_optional(&self.reader).await?;
        row.as_ref().map(weighing_row).transpose()
    }

    /// The ticks of a weighing that has no trace yet, from its events.
    pub async fn live_ticks(&self, id: &str) -> Result<Vec<Tick>> {
        let sql = "SELECT data FROM event WHERE topic = $1 AND kind = 'tick' ORDER BY seq";
        let rows = sqlx::query(sql).bind(weighing_topic(id)).fetch_all(&self.reader).await?;
        rows.iter().map(|row| row.json("data")).collect()
    }

    /// The next weighing in turn.
    pub async fn next_weighing(&self) -> Result<Option<Weighing>> {
        let sql = "SELECT * FROM weighing WHERE state IN ('planned', 'awaiting_vial') AND bench_name = $1 ORDER BY seq LIMIT 1";
        let row = sqlx::query(sql).bind(self.bench_name());
        row.fetch_optional(&self.reader).await?.as_ref().map(weighing).transpose()
    }

    /// Weighings waiting for the bench, in order.
    pub async fn waiting_weighings(&self) -> Result<Vec<Waiting>> {
        let sql = "SELECT * FROM weighing WHERE state IN ('planned', 'awaiting_vial') AND bench_name = $1 ORDER BY seq";
        let rows = sqlx::query(sql).bind(self.bench_name()).fetch_all(&self.reader).await?;
        let waiting = |row: &AnyRow| {
            let Weighing { id, powder, target_mg, asked, state, .. } = weighing(row)?;
            Ok(Waiting { id, powder, target_mg, vial: asked.vial, state })
        };
        rows.iter().map(waiting).collect()
    }

    /// Weighings that were moving when the process ended: the contents of their vials are unknown.
    pub async fn interrupted_weighings(&self) -> Result<Vec<(String, BenchKind)>> {
        let sql = "SELECT id, coalesce(bench, 'simulated') AS bench FROM weighing WHERE state IN ('armed', 'dosing', 'settling') AND bench_name = $1";
        let rows = sqlx::query(sql).bind(self.bench_name()).fetch_all(&self.reader).await?;
        rows.iter().map(|row| Ok((row.plain("id")?, row.word("weighing", "bench")?))).collect()
    }
}

impl Tx {
    /// The weighing with this key, as seen inside the transaction.
    pub async fn weighing_by_key(&mut self, key: &str) -> Result<Option<WeighingRow>> {
        let sql = "SELECT * FROM weighing WHERE idempotency_key = $1";
        let row = sqlx::query(sql).bind(key).fetch_optional(&mut *self.inner).await?;
        row.as_ref().map(weighing_row).transpose()
    }

    /// Number of weighings waiting for the bench.
    pub async fn planned_weighings(&mut self) -> Result<i64> {
        let sql = "SELECT count(*) FROM weighing WHERE state IN ('planned', 'awaiting_vial') AND bench_name = $1";
        let count = sqlx::query_scalar(sql).bind(&*self.store.bench.name);
        Ok(count.fetch_one(&mut *self.inner).await?)
    }

    /// Whether a weighing belongs to a list of this name.
    pub async fn is_list(&mut self, name: &str) -> Result<bool> {
        let sql = "SELECT EXISTS (SELECT 1 FROM weighing WHERE asked ->> 'list' = $1)";
        let Flag(is) = sqlx::query_scalar(sql).bind(name).fetch_one(&mut *self.inner).await?;
        Ok(is)
    }

    /// Store an intent, for the bench that the store speaks for.
    pub async fn insert_weighing(&mut self, intent: &Intent, now: Timestamp) -> Result<Weighing> {
        let sql = "INSERT INTO weighing (id, idempotency_key, request_sha256, powder, target_mg, tolerance_lower_mg, \
                   tolerance_upper_mg, policy, parameter_set, seed, state, created_at, under, patch, asked, vial_check, labels, bench_name) \
                   VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, 'planned', $11, $12, $13, $14, $15, $16, $17) RETURNING *";
        let request = &intent.request;
        let row = sqlx::query(sql)
            .bind(&intent.id)
            .bind(&intent.idempotency_key)
            .bind(&intent.request_sha256)
            .bind(&request.powder)
            .bind(request.target_mg)
            .bind(request.tolerance_lower_mg)
            .bind(request.tolerance_upper_mg)
            .bind(&request.policy)
            .bind(&intent.parameter_set)
            .bind(request.seed.cast_signed())
            .bind(now.unix_ms())
            .bind(request.under.as_ref().map(json).transpose()?)
            .bind(Some(&request.patch).filter(|patch| !patch.is_none()).map(json).transpose()?)
            .bind(Some(&request.asked).filter(|asked| !asked.is_nothing()).map(json).transpose()?)
            .bind(word(&request.vial_check))
            .bind(Some(&request.labels).filter(|labels| !labels.is_empty()).map(json).transpose()?)
            .bind(&*self.store.bench.name)
            .fetch_one(&mut *self.inner)
            .await?;
        let weighing = self.announce_weighing(&row).await?;
        let key = RetryKey::of(&intent.idempotency_key, &intent.request_sha256);
        let said = IntentRecord { weighing: &weighing, key };
        self.audit_weighing(&weighing, "intent", &said, now).await?;
        Ok(weighing)
    }

    /// Arm a weighing: the bench is about to move. `None`: it no longer waits (stopped before its
    /// turn).
    pub async fn arm_weighing(
        &mut self,
        id: &str,
        bench: BenchKind,
        now: Timestamp,
    ) -> Result<Option<Weighing>> {
        let sql = "UPDATE weighing SET state = 'armed', started_at = $2, bench = $3 \
                   WHERE id = $1 AND state IN ('planned', 'awaiting_vial') RETURNING *";
        let row = sqlx::query(sql)
            .bind(id)
            .bind(now.unix_ms())
            .bind(word(&bench))
            .fetch_optional(&mut *self.inner)
            .await?;
        let Some(row) = row else { return Ok(None) };
        let weighing = self.announce_weighing(&row).await?;
        self.audit_weighing(&weighing, "state", &WeighingState::Armed, now).await?;
        Ok(Some(weighing))
    }

    /// A weighing's turn has come, and someone has to confirm that its vial is in. `false`: it no
    /// longer waits, or already waits for its vial.
    pub async fn await_vial(&mut self, id: &str, now: Timestamp) -> Result<bool> {
        let sql = "UPDATE weighing SET state = 'awaiting_vial' WHERE id = $1 AND state = 'planned' RETURNING *";
        let Some(row) = sqlx::query(sql).bind(id).fetch_optional(&mut *self.inner).await? else {
            return Ok(false);
        };
        let weighing = self.announce_weighing(&row).await?;
        self.audit_weighing(&weighing, "state", &WeighingState::AwaitingVial, now).await?;
        Ok(true)
    }

    /// Whether a weighing waits for its vial, as seen inside the transaction.
    pub async fn awaits_vial(&mut self, id: &str) -> Result<bool> {
        let sql =
            "SELECT EXISTS (SELECT 1 FROM weighing WHERE id = $1 AND state = 'awaiting_vial')";
        let Flag(is) = sqlx::query_scalar(sql).bind(id).fetch_one(&mut *self.inner).await?;
        Ok(is)
    }

    /// Statements about vials hold until the process ends: weighings waiting for a vial wait for
    /// their turn again.
    pub async fn forget_vials(&mut self, now: Timestamp) -> Result<()> {
        let sql = "UPDATE weighing SET state = 'planned' WHERE state = 'awaiting_vial' AND bench_name = $1 RETURNING *";
        let rows = sqlx::query(sql).bind(&*self.store.bench.name);
        for row in rows.fetch_all(&mut *self.inner).await? {
            let weighing = self.announce_weighing(&row).await?;
            self.audit_weighing(&weighing, "state", &WeighingState::Planned, now).await?;
        }
        Ok(())
    }

    /// Advance a moving weighing to its next state; no change if it is there already.
    pub async fn advance_weighing(
        &mut self,
        id: &str,
        state: WeighingState,
        now: Timestamp,
    ) -> Result<()> {
        let sql = "UPDATE weighing SET state = $2 WHERE id = $1 AND state <> $2 AND outcome IS NULL RETURNING *";
        let row =
            sqlx::query(sql).bind(id).bind(word(&state)).fetch_optional(&mut *self.inner).await?;
        let Some(row) = row else { return Ok(()) };
        let weighing = self.announce_weighing(&row).await?;
        self.audit_weighing(&weighing, "state", &state, now).await
    }

    /// Store the action and reading of a step.
    pub async fn insert_tick(&mut self, id: &str, tick: &Tick) -> Result<()> {
        self.emit(&weighing_topic(id), "tick", tick).await
    }

    /// End a waiting weighing before its turn. `None`: it does not wait.
    pub async fn end_planned_weighing(
        &mut self,
        id: &str,
        ending: &Ending,
        now: Timestamp,
    ) -> Result<Option<Weighing>> {
        let sql = "SELECT EXISTS (SELECT 1 FROM weighing WHERE id = $1 AND state IN ('planned', 'awaiting_vial'))";
        let Flag(waits) = sqlx::query_scalar(sql).bind(id).fetch_one(&mut *self.inner).await?;
        if waits { self.end_weighing(id, ending, now).await } else { Ok(None) }
    }

    /// End a weighing; only one that has not ended yet can be.
    pub async fn end_weighing(
        &mut self,
        id: &str,
        ending: &Ending,
        now: Timestamp,
    ) -> Result<Option<Weighing>> {
        let sql = "UPDATE weighing SET state = $2, outcome = $3, dispensed_mg = $4, reading_mg = $5, error_mg = $6, \
                   shakes = $7, seconds = $8, trace = $9, error = $10, finished_at = $11, measured = $12, apparatus = $13 \
                   WHERE id = $1 AND outcome IS NULL RETURNING *";
        let row = sqlx::query(sql)
            .bind(id)
            .bind(word(&ending.state))
            .bind(word(&ending.outcome))
            .bind(ending.dispensed_mg.map(Number))
            .bind(ending.reading_mg.map(Number))
            .bind(ending.error_mg.map(Number))
            .bind(ending.shakes.map(i64::from))
            .bind(ending.seconds.map(Number))
            .bind(&ending.trace)
            .bind(&ending.error)
            .bind(now.unix_ms())
            .bind(ending.measured.as_ref().map(json).transpose()?)
            .bind(ending.apparatus.as_ref().map(json).transpose()?)
            .fetch_optional(&mut *self.inner)
            .await?;
        let Some(row) = row else { return Ok(None) };
        let weighing = self.announce_weighing(&row).await?;
        let said =
            OutcomeRecord { weighing, trace: ending.trace.clone(), key: RetryKey::default() };
        self.audit_weighing(&said.weighing, "outcome", &said, now).await?;
        Ok(Some(said.weighing))
    }

    /// Append a record of a weighing to the chain of its bench.
    async fn audit_weighing(
        &mut self,
        weighing: &Weighing,
        kind: &str,
        said: &impl Serialize,
        now: Timestamp,
    ) -> Result<()> {
        let chain = self.chain_of(weighing.at_bench()).await?;
        let about = About { weighing: Some(&weighing.id), kind };
        self.audit_in(chain, about, said, now).await.map(drop)
    }

    async fn announce_weighing(&mut self, row: &AnyRow) -> Result<Weighing> {
        let weighing = weighing(row)?;
        self.emit(&weighing_topic(&weighing.id), "state", &weighing).await?;
        Ok(weighing)
    }
}
