//! A job's outside over the store: every write is one transaction that verifies the lease first.

use super::bench::audit_exchanges;
use super::host::{Checkpoint, Finished, JobError, JobHost, NewVersion, Piece, Result};
use super::rows;
use super::stop::StopFlag;
use flip_core::domain::job::Progress;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::powder::Method;
use flip_learn::calibrate::{Probe, Trial};
use flip_learn::train::evaluate::Dose;
use flip_store::audit::About;
use flip_store::jobs::job_topic;
use flip_store::ledger::{Claimed, Lease};
use flip_store::piles::Pile;
use flip_store::powders::Origin;
use flip_store::said::{Row, RowOf};
use flip_store::{self as store, Store, Tx, now};
use serde::Serialize;
use std::collections::HashMap;
use std::ops::{AsyncFnOnce, ControlFlow};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::runtime::Handle;
use tokio::task::JoinHandle;

/// Minimum interval between progress reports.
const REPORT: Duration = Duration::from_millis(250);
/// How long to wait before an artifact that found no room, or no bucket, is tried again.
const AGAIN: Duration = Duration::from_secs(1);
/// How often a job that waits looks whether it was asked to stop.
const LOOK: Duration = Duration::from_millis(100);

impl From<store::Error> for JobError {
    fn from(error: store::Error) -> Self {
        match error {
            // The current holder of the lease will do it.
            store::Error::Fenced => Self::Stopped,
            store::Error::Corrupt(_) | store::Error::UnknownWord { .. } => {
                Self::Fail(error.to_string())
            }
            other => Self::Retry(other.to_string()),
        }
    }
}

/// A job under its lease, as its body sees it from a compute thread.
pub(super) struct LeasedJob {
    store: Store,
    lease: Lease,
    /// SHA-256 of the checkpoint of the attempts before.
    checkpoint: Option<String>,
    /// The bench is held.
    held: Arc<AtomicBool>,
    stop: Arc<StopFlag>,
    runtime: Handle,
    reported: Mutex<Option<Instant>>,
    /// A report in progress that is not awaited.
    reporting: Mutex<Option<JoinHandle<store::Result<()>>>>,
}

impl LeasedJob {
    pub fn new(
        store: Store,
        claimed: &Claimed,
        held: Arc<AtomicBool>,
        stop: Arc<StopFlag>,
        runtime: Handle,
    ) -> Self {
        Self {
            store,
            lease: claimed.lease.clone(),
            checkpoint: claimed.checkpoint.clone(),
            held,
            stop,
            runtime,
            reported: Mutex::default(),
            reporting: Mutex::default(),
        }
    }

    fn read<T>(&self, reading: impl Future<Output = store::Result<T>>) -> Result<T> {
        Ok(self.runtime.block_on(reading)?)
    }

    /// Writes in one transaction that verifies the lease first.
    fn write(&self, write: impl AsyncFnOnce(&mut Tx) -> store::Result<()>) -> Result<()> {
        self.read(async {
            let mut tx = self.store.write().await?;
            tx.prove(&self.lease).await?;
            write(&mut tx).await?;
            tx.commit().await
        })
    }

    fn tell(&self, progress: &Progress) -> impl Future<Output = store::Result<()>> + use<> {
        let (store, lease, progress) = (self.store.clone(), self.lease.clone(), progress.clone());
        async move {
            let mut tx = store.write().await?;
            tx.report(&lease, &progress).await?;
            tx.commit().await
        }
    }

    fn is_due(&self, progress: &Progress) -> bool {
        let mut reported = self.reported.lock().unwrap_or_else(PoisonError::into_inner);
        if reported.is_some_and(|last| last.elapsed() < REPORT) && progress.fraction < 1.0 {
            return false;
        }
        *reported = Some(Instant::now());
        true
    }

    /// Does something with an artifact, as often as it takes until there is room on the disk, or the
    /// bucket is there again: the lease is renewed meanwhile, and what was computed is kept.
    fn patiently<T>(&self, mut attempt: impl FnMut() -> store::Result<T>) -> Result<T> {
        let mut waits = false;
        loop {
            match attempt() {
                Err(error) if error.may_pass() => {
                    if !std::mem::replace(&mut waits, true) {
                        self.say_what_it_waits_for(&error);
                    }
                    self.pause()?;
                }
                done => return Ok(done?),
            }
        }
    }

    fn say_what_it_waits_for(&self, error: &store::Error) {
        tracing::warn!(job = self.id(), %error, "an artifact waits; it is tried again");
        let said = self.runtime.block_on(async {
            let mut tx = self.store.write().await?;
            tx.say(&self.lease, format!("waits: {error}")).await?;
            tx.commit().await
        });
        if let Err(error) = said {
            tracing::warn!(job = self.id(), %error, "could not say what it waits for");
        }
    }

    /// Waits for a moment, unless it is asked to stop.
    fn pause(&self) -> Result<()> {
        let since = Instant::now();
        while since.elapsed() < AGAIN {
            if self.flow().is_break() {
                return Err(JobError::Stopped);
            }
            std::thread::sleep(LOOK);
        }
        Ok(())
    }

    /// Publishes an event about the job, within `tx`.
    async fn emit(&self, tx: &mut Tx, kind: &str, data: &impl Serialize) -> store::Result<()> {
        tx.emit(&job_topic(self.id()), kind, data).await
    }

    /// Inserts a piece; returns whether it was new: if so, the attempt was not fruitless.
    async fn insert(&self, tx: &mut Tx, piece: Piece<'_>) -> store::Result<bool> {
        let job = self.id();
        match piece {
            Piece::Trial { trial, seconds } => {
                let row = rows::trial(trial, seconds);
                tx.insert_trial(job, &row).await?;
                self.emit(tx, "trial", &row).await?;
            }
            Piece::EmulatorHeap { emulator, heap, seconds } => {
                tx.insert_emulator_run(emulator, &rows::trial(heap, seconds)).await?;
            }
            Piece::Probe { owner, probe } => tx.insert_probe(owner, probe.index, probe).await?,
            Piece::Episodes(records) => {
                let mut any_new = false;
                for episode in records.iter().map(rows::episode) {
                    if tx.insert_episode(job, &episode).await? {
                        self.emit(tx, "episode", &episode).await?;
                        any_new = true;
                    }
                }
                return Ok(any_new);
            }
            Piece::Kept { episode, policy } => {
                return tx.insert_kept(job, episode, &flip_policy::id(policy), policy).await;
            }
            Piece::CheckpointLost(why) => {
                self.emit(tx, "checkpoint_lost", &serde_json::json!({ "why": why })).await?;
                return Ok(false);
            }
            Piece::Dose { key, dose } => tx.insert_dose(job, key, dose).await?,
            Piece::Pile { powder, exchanges, pile } => {
                audit_exchanges(tx, None, exchanges, now()).await?;
                let Some(pile) = pile else { return Ok(false) };
                let said =
                    serde_json::json!({ "measurement": job, "powder": powder, "pile": pile });
                tx.audit(About { weighing: None, kind: "pile" }, &said, now()).await?;
                tx.insert_pile(job, pile).await?;
                self.emit(tx, "pile", pile).await?;
            }
        }
        Ok(true)
    }

    /// Inserts what is stored with a result.
    async fn insert_finished(&self, tx: &mut Tx, finished: &Finished<'_>) -> store::Result<()> {
        let job = self.id();
        match finished {
            Finished::Calibration { spec, result } => {
                let simulator = spec.under.as_ref().map(|under| under.simulator.as_str());
                for (position, set) in (0..).zip(&result.sets) {
                    let set = rows::set(set, simulator);
                    tx.insert_parameter_set(job, spec.powder.as_deref(), position, &set).await?;
                }
            }
            Finished::Training { result, trained } => {
                let manifest = serde_json::to_string(&trained.manifest)
                    .map_err(|error| store::Error::Corrupt(error.to_string()))?;
                let kind = trained.manifest.kind.name();
                let id = &result.policy;
                tx.insert_policy(id, kind, Some(job), &manifest, &trained.artifact).await?;
            }
            Finished::Evaluation { result, evidence, under } => {
                for ((position, row), policy) in (0..).zip(&result.rows).zip(*evidence) {
                    tx.insert_evaluation_row(job, position, *policy, *under, row).await?;
                }
            }
            Finished::Investigation { version, .. } => {
                if let Some(NewVersion { id, base, body }) = version {
                    tx.insert_simulator(id, base, job, body).await?;
                }
            }
            Finished::Repose { spec, result, source } if result.registered => {
                let (powder, angle) = (&spec.powder, result.repeats.tip);
                let made = tx
                    .insert_measurement(powder, Method::Automated, angle, &Origin::undated(source))
                    .await?;
                tx.audit_rows(vec![Row::of(RowOf::Measurement, &made.id, &made)]).await?;
            }
            Finished::Repose { .. } | Finished::Film { .. } => {}
        }
        Ok(())
    }
}

impl JobHost for LeasedJob {
    fn id(&self) -> &str {
        &self.lease.job
    }

    fn flow(&self) -> ControlFlow<()> {
        self.stop.flow()
    }

    fn trials(&self) -> Result<Vec<Trial>> {
        let rows = self.read(self.store.all_trials(self.id()))?;
        Ok(rows.into_iter().map(rows::trial_of).collect())
    }

    fn emulator_heaps(&self, emulator: &str) -> Result<Vec<Trial>> {
        let rows = self.read(self.store.emulator_runs(emulator))?;
        Ok(rows.into_iter().map(rows::trial_of).collect())
    }

    fn probes(&self, owner: &str) -> Result<Vec<Probe>> {
        self.read(self.store.probes(owner))
    }

    fn doses(&self) -> Result<HashMap<String, Dose>> {
        self.read(self.store.doses(self.id()))
    }

    fn piles(&self) -> Result<Vec<Pile>> {
        self.read(self.store.piles(self.id()))
    }

    fn checkpoint(&self) -> Result<Checkpoint> {
        let Some(sha256) = &self.checkpoint else { return Ok(Checkpoint::None) };
        self.patiently(|| match self.runtime.block_on(self.store.artifacts().get(sha256)) {
            Ok(bytes) => Ok(Checkpoint::Saved(bytes)),
            Err(error) if error.is_lost_part() => Ok(Checkpoint::Lost(error.to_string())),
            Err(error) => Err(error),
        })
    }

    fn policy(&self, id: &str) -> Result<Option<Vec<u8>>> {
        self.read(self.store.policy_bytes(id))
    }

    fn kept_policy(&self, id: &str) -> Result<Option<Vec<u8>>> {
        self.read(self.store.kept_policy(id))
    }

    fn parameter_set(&self, id: &str) -> Result<Option<ParameterSet>> {
        Ok(self.read(self.store.parameter_set(id))?.map(|set| set.parameters))
    }

    fn latch(&self) -> Result<Option<String>> {
        Ok(self.read(self.store.latch())?.map(|latch| latch.reason))
    }

    fn held(&self) -> &AtomicBool {
        &self.held
    }

    fn report(&self, progress: &Progress) -> Result<()> {
        if self.is_due(progress) { self.read(self.tell(progress)) } else { Ok(()) }
    }

    fn report_meanwhile(&self, progress: &Progress) -> Result<()> {
        let mut reporting = self.reporting.lock().unwrap_or_else(PoisonError::into_inner);
        if reporting.as_ref().is_some_and(|task| !task.is_finished()) {
            return Ok(());
        }
        if let Some(Ok(told)) = reporting.take().map(|task| self.runtime.block_on(task)) {
            told?;
        }
        if self.is_due(progress) {
            *reporting = Some(self.runtime.spawn(self.tell(progress)));
        }
        Ok(())
    }

    fn save(&self, piece: Piece<'_>) -> Result<()> {
        self.write(async |tx| {
            if self.insert(tx, piece).await? {
                tx.advance(&self.lease).await?;
            }
            Ok(())
        })
    }

    /// First the file, then the row that refers to it.
    fn save_checkpoint(&self, bytes: &[u8]) -> Result<()> {
        let sha256 = self.put(bytes)?;
        self.write(async |tx| tx.set_checkpoint(&self.lease, &sha256).await)
    }

    fn put(&self, bytes: &[u8]) -> Result<String> {
        self.patiently(|| self.runtime.block_on(self.store.artifacts().put(bytes)))
    }

    fn finish(&self, finished: &Finished<'_>) -> Result<()> {
        let result = finished.document()?;
        self.write(async |tx| {
            self.insert_finished(tx, finished).await?;
            tx.succeed(&self.lease, &result, now()).await
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::evaluate::EvaluationResult;
    use super::super::stop::Stop;
    use super::*;
    use flip_core::domain::job::{JobKind, JobState, Subject};
    use flip_core::domain::labels::Labels;
    use flip_core::domain::timestamp::Timestamp;
    use flip_store::ledger::Claim;

    fn leased(store: &Store, lease: Lease) -> LeasedJob {
        let (kind, spec) = (JobKind::Evaluation, String::new());
        let claimed = Claimed { lease, kind, spec, checkpoint: None };
        LeasedJob::new(store.clone(), &claimed, Arc::default(), Arc::default(), Handle::current())
    }

    async fn queue(store: &Store, job: &str) {
        let (subject, labels) = (Subject::default(), Labels::default());
        let mut tx = store.write().await.unwrap();
        let of = (None, &labels);
        tx.insert_job(job, JobKind::Evaluation, ("{}", &[0; 32]), &subject, of, now())
            .await
            .unwrap();
        tx.commit().await.unwrap();
    }

    async fn claim(store: &Store, job: &str, at: i64) -> Lease {
        let [at, until] = [at, at + 10].map(Timestamp::from_unix_ms);
        let mut tx = store.write().await.unwrap();
        let claim = tx.claim(job, "a worker", at, until).await.unwrap();
        tx.commit().await.unwrap();
        let Claim::Granted(claimed) = claim else { panic!("{claim:?}") };
        claimed.lease
    }

    /// One call of every method that writes a row.
    fn write_all(job: &LeasedJob) -> [Result<()>; 4] {
        let dose = Dose { dispensed_mg: 15.0, reading_mg: 15.0, shakes: 3, seconds: 9.0 };
        let result = EvaluationResult { rows: Vec::new(), summary: Vec::new(), card: None };
        [
            job.save(Piece::Dose { key: "a dose", dose: &dose }),
            job.save_checkpoint(b"a checkpoint"),
            job.report(&Progress { fraction: 1.0, message: "dose 1 of 1".into() }),
            job.finish(&Finished::Evaluation { result: &result, evidence: &[], under: None }),
        ]
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn without_its_lease_an_attempt_changes_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).await.unwrap();
        queue(&store, "j").await;
        let late = leased(&store, claim(&store, "j", 0).await);
        let current = leased(&store, claim(&store, "j", 100).await);
        let before = store.job("j").await.unwrap().unwrap().job;
        let (late, written) = tokio::task::spawn_blocking(move || {
            let written = write_all(&late);
            (late, written)
        })
        .await
        .unwrap();
        assert!(written.iter().all(|it| matches!(it, Err(JobError::Stopped))), "{written:?}");
        assert_eq!(store.job("j").await.unwrap().unwrap().job, before);
        tokio::task::spawn_blocking(move || {
            assert!(late.doses().unwrap().is_empty());
            assert!(write_all(&current).iter().all(Result::is_ok));
            assert_eq!(late.doses().unwrap().len(), 1);
        })
        .await
        .unwrap();
        assert_eq!(store.job("j").await.unwrap().unwrap().job.state, JobState::Succeeded);
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_job_goes_on_until_its_flag_is_set() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).await.unwrap();
        let job = leased(&store, Lease { job: "j".into(), fence: 1 });
        assert!(job.flow().is_continue());
        job.stop.set(Stop::Cancelled);
        assert!(job.flow().is_break());
    }

    /// A file that found no room.
    fn full() -> store::Error {
        let source = std::io::Error::from(std::io::ErrorKind::StorageFull);
        store::Error::File { path: "blobs/ab/abcd".into(), source }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn an_artifact_waits_for_room_and_a_job_that_is_asked_to_stop_does_not() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).await.unwrap();
        queue(&store, "j").await;
        // A lease that lasts as long as the test.
        let job = leased(&store, claim(&store, "j", now().unix_ms() + 60_000).await);
        let waited = move || {
            job.report(&Progress { fraction: 0.5, message: "half".into() }).unwrap();
            let mut tries = 0;
            let stored = job.patiently(|| {
                tries += 1;
                if tries < 3 { Err(full()) } else { Ok("abcd") }
            });
            let refused: Result<()> = job.patiently(|| Err(store::Error::Corrupt("it".into())));
            let stopped: Result<()> = job.patiently(|| {
                job.stop.set(Stop::Shutdown);
                Err(full())
            });
            (stored, tries, refused, stopped)
        };
        let (stored, tries, refused, stopped) = tokio::task::spawn_blocking(waited).await.unwrap();
        assert_eq!((stored.unwrap(), tries), ("abcd", 3));
        assert!(matches!(refused, Err(JobError::Fail(_))), "{refused:?}");
        assert!(matches!(stopped, Err(JobError::Stopped)), "{stopped:?}");
        let told = store.job("j").await.unwrap().unwrap().job.progress;
        assert_eq!(told.fraction, 0.5);
        assert!(told.message.starts_with("waits: blobs/ab/abcd"), "{}", told.message);
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_report_that_waits_for_another_program_holds_up_no_open_gate() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).await.unwrap();
        let other =
            sqlx::sqlite::SqliteConnectOptions::new().filename(folder.path().join("flip.db"));
        let other = sqlx::SqlitePool::connect_with(other).await.unwrap();
        let held = other.begin_with("BEGIN IMMEDIATE").await.unwrap();
        sqlx::query("PRAGMA busy_timeout = 1").execute(store.writer().unwrap()).await.unwrap();
        let job = leased(&store, Lease { job: "j".into(), fence: 1 });
        let told = move || {
            let progress = Progress { fraction: 0.0, message: "the powder runs out".into() };
            let now = job.report_meanwhile(&progress);
            while job.reporting.lock().unwrap().as_ref().is_some_and(|task| !task.is_finished()) {
                std::thread::yield_now();
            }
            (now, job.report_meanwhile(&progress))
        };
        let (now, later) = tokio::task::spawn_blocking(told).await.unwrap();
        assert!(now.is_ok(), "nobody waits: {now:?}");
        let Err(JobError::Retry(cause)) = later else { panic!("it is not forgotten: {later:?}") };
        assert_eq!(cause, store::Error::Locked.to_string());
        held.rollback().await.unwrap();
    }
}
