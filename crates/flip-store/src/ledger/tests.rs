//! The ledger's guarantees, under a clock controlled by the test.

use super::{Claim, Claimed, DEATHS_MAX, FAILURES_MAX};
use crate::jobs::Job;
use crate::{Error, Result, Store, testing};
use flip_core::domain::device::Device;
use flip_core::domain::job::{JobKind, JobState, Progress, Subject};
use flip_core::domain::labels::Labels;
use flip_core::domain::timestamp::Timestamp;
use tempfile::TempDir;

/// A store, one queued job, and a clock that only the test moves.
struct Ledger {
    store: Store,
    job: String,
    _folder: TempDir,
}

fn at(seconds: i64) -> Timestamp {
    Timestamp::from_unix_ms(1_800_000_000_000 + 1000 * seconds)
}

/// Lease duration in these tests, s.
const LEASE: i64 = 30;

impl Ledger {
    async fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let store = testing::open(folder.path()).await.unwrap();
        let mut tx = store.write().await.unwrap();
        let (job, created) = tx
            .insert_job(
                "job",
                JobKind::Calibration,
                ("{}", &[7; 32]),
                &Subject::default(),
                (None, &Labels::default()),
                at(0),
            )
            .await
            .unwrap();
        tx.commit().await.unwrap();
        assert!(created);
        Self { store, job: job.id, _folder: folder }
    }

    async fn claim(&self, owner: &str, seconds: i64) -> Claim {
        let mut tx = self.store.write().await.unwrap();
        let claim = tx.claim(&self.job, owner, at(seconds), at(seconds + LEASE)).await.unwrap();
        tx.commit().await.unwrap();
        claim
    }

    async fn granted(&self, owner: &str, seconds: i64) -> Claimed {
        match self.claim(owner, seconds).await {
            Claim::Granted(claimed) => claimed,
            other => panic!("{other:?}"),
        }
    }

    async fn write<T>(&self, write: impl AsyncFnOnce(&mut crate::Tx) -> Result<T>) -> Result<T> {
        let mut tx = self.store.write().await?;
        let written = write(&mut tx).await?;
        tx.commit().await?;
        Ok(written)
    }

    async fn job(&self) -> Job {
        self.store.job(&self.job).await.unwrap().unwrap().job
    }
}

fn fenced<T: std::fmt::Debug>(result: Result<T>) -> bool {
    matches!(result, Err(Error::Fenced))
}

#[tokio::test]
async fn a_job_has_one_worker_until_its_lease_ends() {
    let ledger = Ledger::new().await;
    let first = ledger.granted("a", 0).await;
    assert_eq!(ledger.claim("b", 10).await, Claim::Held(at(LEASE)));
    ledger.write(async |tx| tx.renew(&first.lease, at(60)).await).await.unwrap();
    assert_eq!(ledger.claim("b", 59).await, Claim::Held(at(60)));
    let second = ledger.granted("b", 61).await;
    assert_eq!((first.lease.fence, second.lease.fence), (1, 2));
}

#[tokio::test]
async fn nothing_that_a_zombie_writes_is_kept() {
    let ledger = Ledger::new().await;
    let zombie = ledger.granted("zombie", 0).await.lease;
    let heir = ledger.granted("heir", LEASE + 1).await.lease;
    let progress = Progress { fraction: 0.9, message: "from beyond".into() };
    assert!(fenced(ledger.write(async |tx| tx.renew(&zombie, at(999)).await).await));
    assert!(fenced(ledger.write(async |tx| tx.report(&zombie, &progress).await).await));
    assert!(fenced(ledger.write(async |tx| tx.advance(&zombie).await).await));
    assert!(fenced(
        ledger.write(async |tx| tx.set_checkpoint(&zombie, &"a".repeat(64)).await).await
    ));
    assert!(fenced(ledger.write(async |tx| tx.succeed(&zombie, "{}", at(40)).await).await));
    assert!(fenced(
        ledger.write(async |tx| tx.end(&zombie, JobState::Failed, Some("no"), at(40)).await).await
    ));
    assert!(fenced(ledger.write(async |tx| tx.retry(&zombie, "no", at(40)).await).await));
    assert!(fenced(ledger.write(async |tx| tx.release(&zombie).await).await));
    let job = ledger.job().await;
    assert_eq!((job.state, job.progress.fraction, job.error), (JobState::Running, 0.0, None));
    ledger.write(async |tx| tx.succeed(&heir, "{}", at(50)).await).await.unwrap();
    assert!(
        fenced(ledger.write(async |tx| tx.succeed(&heir, "{}", at(51)).await).await),
        "and nobody succeeds twice"
    );
    assert_eq!(ledger.claim("late", 60).await, Claim::Ended);
}

#[tokio::test]
async fn a_transaction_that_a_zombie_loses_half_way_leaves_nothing() {
    let ledger = Ledger::new().await;
    let zombie = ledger.granted("zombie", 0).await.lease;
    ledger.granted("heir", LEASE + 1).await;
    let lost = ledger.write(async |tx| {
        tx.emit("job:job", "trial", &"half").await?;
        tx.prove(&zombie).await.map(drop)
    });
    assert!(fenced(lost.await));
    let events = ledger.store.events_after(Some("job:job"), 0, 100).await.unwrap();
    assert!(events.iter().all(|event| event.kind == "state"));
}

#[tokio::test]
async fn an_error_is_tried_again_until_the_third_which_is_final() {
    let ledger = Ledger::new().await;
    for attempt in 1..=FAILURES_MAX {
        let lease = ledger.granted("worker", i64::from(attempt)).await.lease;
        ledger.write(async |tx| tx.retry(&lease, "the disk is full", at(0)).await).await.unwrap();
        let job = ledger.job().await;
        let expected = if attempt < FAILURES_MAX { JobState::Queued } else { JobState::Failed };
        assert_eq!((job.state, job.attempts), (expected, attempt));
    }
    assert!(ledger.job().await.error.unwrap().contains("after 3 attempts"));
    assert_eq!(ledger.claim("worker", 99).await, Claim::Ended);
}

#[tokio::test]
async fn a_job_that_ends_its_process_every_time_is_given_up_and_one_that_saves_is_not() {
    for (saves, gives_up) in [(false, true), (true, false)] {
        let ledger = Ledger::new().await;
        let mut now = 0;
        for _ in 0..DEATHS_MAX {
            let lease = ledger.granted("worker", now).await.lease;
            if saves {
                ledger.write(async |tx| tx.advance(&lease).await).await.unwrap();
            }
            now += LEASE + 1;
        }
        let last = ledger.claim("worker", now).await;
        assert_eq!(last == Claim::Ended, gives_up);
        assert_eq!(
            ledger.job().await.state,
            if gives_up { JobState::Failed } else { JobState::Running }
        );
    }
}

#[tokio::test]
async fn a_released_job_waits_as_if_nobody_had_touched_it() {
    let ledger = Ledger::new().await;
    for round in 0..10 {
        let lease = ledger.granted("worker", round).await.lease;
        ledger.write(async |tx| tx.release(&lease).await).await.unwrap();
    }
    let job = ledger.job().await;
    assert_eq!((job.state, job.attempts), (JobState::Queued, 0));
    assert_eq!(ledger.store.claimable(at(0)).await.unwrap().len(), 1);
}

#[tokio::test]
async fn a_cancelled_job_is_not_claimed_again_after_its_worker_died() {
    let ledger = Ledger::new().await;
    let lease = ledger.granted("worker", 0).await.lease;
    ledger.write(async |tx| tx.request_cancel("job", at(1)).await).await.unwrap().unwrap();
    assert!(
        ledger.write(async |tx| tx.renew(&lease, at(40)).await).await.unwrap(),
        "the worker hears of it"
    );
    assert_eq!(ledger.claim("next", 99).await, Claim::Ended);
    assert_eq!(ledger.job().await.state, JobState::Cancelled);
}

#[tokio::test]
async fn leases_of_a_process_that_is_gone_end_at_the_next_start() {
    let ledger = Ledger::new().await;
    ledger.granted("gone", 0).await;
    assert!(ledger.store.claimable(at(1)).await.unwrap().is_empty());
    ledger.store.end_leases().await.unwrap();
    assert_eq!(ledger.store.claimable(at(1)).await.unwrap().len(), 1);
    assert_eq!(ledger.granted("next", 1).await.lease.fence, 2);
}

#[tokio::test]
async fn a_job_that_nobody_computes_after_a_restart_is_not_said_to_run() {
    let ledger = Ledger::new().await;
    let lease = ledger.granted("gone", 0).await.lease;
    let progress = Progress { fraction: 0.9, message: "heap 9 of 10".into() };
    ledger.write(async |tx| tx.report(&lease, &progress).await).await.unwrap();
    let before = ledger.store.newest_event().await.unwrap();
    ledger.store.end_leases().await.unwrap();
    let job = ledger.job().await;
    assert_eq!((job.state, job.progress.fraction), (JobState::Queued, 0.9));
    assert!(job.progress.message.contains("the process ended"), "{}", job.progress.message);
    let told = ledger.store.events_after(Some("job:job"), before, 10).await.unwrap();
    assert_eq!(
        told.iter().map(|event| event.data["state"].as_str().unwrap()).collect::<Vec<_>>(),
        ["queued"]
    );
    // An ended process still counts against a job that ends it every time.
    for _ in 1..DEATHS_MAX {
        ledger.granted("next", 1).await;
        ledger.store.end_leases().await.unwrap();
    }
    assert_eq!(ledger.claim("next", 1).await, Claim::Ended);
    assert_eq!(ledger.job().await.state, JobState::Failed);
}

#[tokio::test]
async fn the_oldest_of_each_kind_is_next_whatever_else_waits_or_runs() {
    let ledger = Ledger::new().await;
    let more = [("calibration 2", JobKind::Calibration), ("training", JobKind::Training)];
    for (n, (id, kind)) in more.into_iter().enumerate() {
        let sha256 = [n as u8; 32];
        ledger
            .write(async |tx| {
                tx.insert_job(
                    id,
                    kind,
                    ("{}", &sha256),
                    &Subject::default(),
                    (None, &Labels::default()),
                    at(0),
                )
                .await
            })
            .await
            .unwrap();
    }
    // Of a newer program, and older than any other.
    let foreign = "INSERT INTO job (seq, id, kind, spec, spec_sha256, state, created_at) \
                   VALUES (-1, 'foreign', 'seance', '{}', $1, 'queued', 0)";
    sqlx::query(foreign).bind(vec![8; 32]).execute(ledger.store.writer().unwrap()).await.unwrap();
    let next = async |seconds| -> Vec<String> {
        let claimable = ledger.store.claimable(at(seconds)).await.unwrap();
        claimable.into_iter().map(|it| it.job).collect()
    };
    assert_eq!(next(0).await, ["job", "training"]);
    // A job for a card holds up no other of its kind, and neither does one for an unknown device.
    for (id, device) in [("on a card", "cuda"), ("elsewhere", "abacus")] {
        let older = "INSERT INTO job (seq, id, kind, spec, spec_sha256, state, created_at, device) \
                     VALUES ($1, $2, 'calibration', '{}', $3, 'queued', 0, $4)";
        let older = sqlx::query(older).bind(-2 - i64::from(device != "cuda")).bind(id);
        let older = older.bind(vec![id.as_bytes()[0]; 32]).bind(device);
        older.execute(ledger.store.writer().unwrap()).await.unwrap();
    }
    let claimable = ledger.store.claimable(at(0)).await.unwrap();
    let found: Vec<_> = claimable.iter().map(|it| (it.job.as_str(), it.device)).collect();
    let expected = [("on a card", Device::Cuda), ("job", Device::Cpu), ("training", Device::Cpu)];
    assert_eq!(found, expected);
    let gone = "DELETE FROM job WHERE seq < -1";
    sqlx::query(gone).execute(ledger.store.writer().unwrap()).await.unwrap();
    ledger.granted("worker", 0).await;
    assert_eq!(next(LEASE).await, ["calibration 2", "training"]);
    assert_eq!(next(LEASE + 1).await, ["job", "training"]);
}

#[tokio::test]
async fn a_job_whose_device_failed_keeps_its_checkpoint_from_which_another_begins() {
    let ledger = Ledger::new().await;
    let lease = ledger.granted("worker", 0).await.lease;
    let sha256 = "a".repeat(64);
    ledger.write(async |tx| tx.set_checkpoint(&lease, &sha256).await).await.unwrap();
    ledger
        .write(async |tx| tx.fail_keeping_checkpoint(&lease, "the card was taken", at(1)).await)
        .await
        .unwrap();
    let job = ledger.job().await;
    assert_eq!((job.state, job.error.as_deref()), (JobState::Failed, Some("the card was taken")));
    let kept = ledger.store.checkpoint_of("job").await.unwrap();
    assert_eq!(kept.as_ref(), Some(&sha256));
    // Nobody goes on with the failed one, and its old worker writes nothing more.
    assert_eq!(ledger.claim("next", 99).await, Claim::Ended);
    let late = ledger.write(async |tx| tx.set_checkpoint(&lease, &"b".repeat(64)).await).await;
    assert!(matches!(late, Err(Error::Fenced)), "{late:?}");
    let claim = ledger
        .write(async |tx| {
            let subject = Subject::default();
            let of = (Some("job"), &Labels::default());
            tx.insert_job("other", JobKind::Training, ("{}", &[9; 32]), &subject, of, at(2))
                .await?;
            tx.begin_from("other", &sha256).await?;
            tx.claim("other", "next", at(3), at(33)).await
        })
        .await
        .unwrap();
    let Claim::Granted(claimed) = claim else { panic!("{claim:?}") };
    assert_eq!(claimed.checkpoint, Some(sha256));
    // Without a checkpoint there is none to keep.
    let lease = claimed.lease;
    ledger.write(async |tx| tx.end(&lease, JobState::Failed, None, at(4)).await).await.unwrap();
    assert_eq!(ledger.store.checkpoint_of("other").await.unwrap(), None);
}
