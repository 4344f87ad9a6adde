//! Who may compute a portion, and whose outcome counts.

use super::{CLAIMS_MAX, NewPortion, Portion, Stands};
use crate::ledger::{Claim, Lease};
use crate::workers::Worker;
use crate::{Error, Store, testing};
use flip_core::domain::job::{JobKind, JobState, Subject};
use flip_core::domain::labels::Labels;
use flip_core::domain::timestamp::Timestamp;
use tempfile::TempDir;

fn at(seconds: i64) -> Timestamp {
    Timestamp::from_unix_ms(1_800_000_000_000 + 1000 * seconds)
}

const KINDS: [JobKind; 2] = [JobKind::Calibration, JobKind::Evaluation];

struct Shop {
    store: Store,
    _folder: TempDir,
}

impl Shop {
    /// A calibration that worker `a` computes until 30 s.
    async fn open() -> (Self, Lease) {
        let folder = tempfile::tempdir().unwrap();
        let shop = Self { store: testing::open(folder.path()).await.unwrap(), _folder: folder };
        let lease = shop.job("j", JobKind::Calibration).await;
        (shop, lease)
    }

    async fn job(&self, id: &str, kind: JobKind) -> Lease {
        let mut tx = self.store.write().await.unwrap();
        let spec = ("{}", &[id.len() as u8; 32][..]);
        let labels = Labels::default();
        tx.insert_job(id, kind, spec, &Subject::default(), (None, &labels), at(0)).await.unwrap();
        tx.commit().await.unwrap();
        self.claim_job(id, 0).await
    }

    async fn claim_job(&self, id: &str, now: i64) -> Lease {
        let mut tx = self.store.write().await.unwrap();
        let claim = tx.claim(id, "a", at(now), at(now + 30)).await.unwrap();
        tx.commit().await.unwrap();
        let Claim::Granted(claimed) = claim else { panic!("{claim:?}") };
        claimed.lease
    }

    async fn cut(&self, of: &Lease, numbers: std::ops::Range<i64>) -> Result<(), Error> {
        let portion = |number| NewPortion {
            id: format!("{}{}/{number}", of.job, of.fence),
            number,
            kind: "heap",
            experiments: vec![0xff, number as u8],
        };
        let new: Vec<NewPortion> = numbers.map(portion).collect();
        let mut tx = self.store.write().await?;
        tx.cut_portions(of, &new).await?;
        tx.commit().await
    }

    async fn claim(&self, worker: &str, kinds: &[JobKind], now: i64) -> Option<Portion> {
        let mut tx = self.store.write().await.unwrap();
        let there = self.store.has_portion(worker, kinds, at(now)).await.unwrap();
        let found = tx.claim_portion(worker, kinds, at(now), at(now + 30)).await.unwrap();
        tx.commit().await.unwrap();
        assert_eq!(found.is_some(), there);
        found
    }

    async fn finish(&self, portion: &Portion, worker: &str, outcomes: &[u8]) -> bool {
        let mut tx = self.store.write().await.unwrap();
        let counts = tx.finish_portion(portion, worker, outcomes, at(9)).await.unwrap();
        tx.commit().await.unwrap();
        counts
    }

    async fn stands(&self, of: &Lease, now: i64) -> Vec<Stands> {
        let found = self.store.portions(of, at(now)).await.unwrap();
        found.into_iter().map(|(_, stands)| stands).collect()
    }

    /// How many portions there are.
    async fn count(&self) -> i64 {
        let sql = "SELECT count(*) FROM portion";
        sqlx::query_scalar(sql).fetch_one(&self.store.reader).await.unwrap()
    }
}

#[tokio::test]
async fn portions_are_computed_in_order_by_others_and_only_the_last_claim_counts() {
    let (shop, lease) = Shop::open().await;
    shop.cut(&lease, 0..2).await.unwrap();
    assert_eq!(shop.claim("a", &KINDS, 1).await, None, "its own worker takes portions back");
    assert_eq!(shop.claim("b", &[JobKind::Evaluation], 1).await, None, "another kind of job");
    assert_eq!(shop.claim("b", &[], 1).await, None);
    let first = shop.claim("b", &KINDS, 1).await.unwrap();
    assert_eq!((first.id.as_str(), first.fence, first.kind.as_str()), ("j1/0", 1, "heap"));
    assert_eq!(first.experiments, [0xff, 0]);
    assert_eq!(shop.claim("c", &KINDS, 1).await.unwrap().id, "j1/1");
    assert_eq!(shop.claim("c", &KINDS, 1).await, None);
    assert_eq!(shop.stands(&lease, 1).await, [Stands::Taken, Stands::Taken]);
    // `b` is not heard of any more. The job's own lease is renewed.
    let mut tx = shop.store.write().await.unwrap();
    tx.renew(&lease, at(90)).await.unwrap();
    tx.commit().await.unwrap();
    let again = shop.claim("c", &KINDS, 32).await.unwrap();
    assert_eq!((again.id.as_str(), again.fence), ("j1/0", 2));
    assert!(!shop.finish(&first, "b", b"late").await);
    assert!(!shop.finish(&first, "c", b"late").await);
    assert!(shop.finish(&again, "c", b"in time").await);
    assert!(!shop.finish(&again, "c", b"twice").await);
    assert_eq!(shop.stands(&lease, 32).await, [Stands::Done(b"in time".into()), Stands::Waits]);
}

#[tokio::test]
async fn a_portion_is_given_back_taken_back_and_claimed_a_few_times_only() {
    let (shop, lease) = Shop::open().await;
    shop.cut(&lease, 0..1).await.unwrap();
    for _ in 0..CLAIMS_MAX {
        let portion = shop.claim("b", &KINDS, 1).await.unwrap();
        let mut tx = shop.store.write().await.unwrap();
        assert!(!tx.take_portion_back(&portion.id, at(1)).await.unwrap(), "it is computed");
        tx.release_portion(&portion, "c").await.unwrap();
        assert!(shop.stands(&lease, 1).await == [Stands::Taken]);
        tx.release_portion(&portion, "b").await.unwrap();
        tx.commit().await.unwrap();
        assert!(!shop.finish(&portion, "b", b"late").await);
    }
    assert_eq!(shop.claim("b", &KINDS, 1).await, None, "it may be what ends them");
    let mut tx = shop.store.write().await.unwrap();
    assert!(tx.take_portion_back("j1/0", at(1)).await.unwrap());
    assert!(!tx.take_portion_back("j1/0", at(1)).await.unwrap());
    tx.commit().await.unwrap();
    assert_eq!(shop.count().await, 0);
}

#[tokio::test]
async fn the_portions_of_an_attempt_end_with_it() {
    let (shop, lease) = Shop::open().await;
    shop.cut(&lease, 0..1).await.unwrap();
    let held = shop.claim("b", &KINDS, 1).await.unwrap();
    let of_b = async |now| shop.store.portions_of("b", at(now)).await.unwrap();
    assert_eq!(of_b(1).await, [("j1/0".to_owned(), 1)]);
    // The worker of the job is not heard of any more.
    assert!(of_b(31).await.is_empty());
    assert_eq!(shop.claim("c", &KINDS, 31).await, None);
    let next = shop.claim_job("j", 31).await;
    assert_eq!(shop.count().await, 0);
    assert!(!shop.finish(&held, "b", b"late").await);
    assert!(matches!(shop.cut(&lease, 1..2).await, Err(Error::Fenced)));
    shop.cut(&next, 0..3).await.unwrap();
    shop.claim("b", &KINDS, 32).await.unwrap();
    let mut tx = shop.store.write().await.unwrap();
    tx.drop_portion("j2/2").await.unwrap();
    tx.request_cancel("j", at(33)).await.unwrap();
    tx.commit().await.unwrap();
    assert!(of_b(33).await.is_empty(), "nobody wants it any more");
    assert_eq!(shop.claim("c", &KINDS, 33).await, None);
    assert_eq!(shop.count().await, 2);
    let mut tx = shop.store.write().await.unwrap();
    tx.end(&next, JobState::Cancelled, None, at(34)).await.unwrap();
    tx.commit().await.unwrap();
    assert_eq!(shop.count().await, 0);
}

#[tokio::test]
async fn a_worker_that_helps_is_listed_with_the_job_and_one_that_is_busy_is_no_help() {
    let (shop, lease) = Shop::open().await;
    let worker = |id: &str| Worker {
        id: id.into(),
        name: id.into(),
        version: "1".into(),
        kinds: KINDS.to_vec(),
        threads: 4,
        serves: false,
        card: None,
        started_at: at(0),
        heard_at: at(1),
        ended_at: None,
        jobs: Vec::new(),
    };
    let mut tx = shop.store.write().await.unwrap();
    let old = Worker { version: "0".into(), ..worker("old") };
    let films = Worker { kinds: vec![JobKind::Film], ..worker("films") };
    for worker in [&worker("a"), &worker("b"), &old, &films] {
        tx.insert_worker(worker).await.unwrap();
    }
    tx.commit().await.unwrap();
    shop.cut(&lease, 0..2).await.unwrap();
    let helpers = async |ours: &str, heard_after| -> Vec<String> {
        let kind = JobKind::Calibration;
        let found = shop.store.helpers(&worker(ours), kind, &KINDS, at(heard_after)).await;
        found.unwrap().into_iter().map(|it| it.id).collect()
    };
    assert_eq!(helpers("a", 0).await, ["b"]);
    assert!(helpers("a", 1).await.is_empty());
    assert!(helpers("b", 0).await.is_empty(), "`a` has a job of its own");
    for _ in 0..2 {
        shop.claim("b", &KINDS, 1).await.unwrap();
    }
    let workers = shop.store.workers().await.unwrap();
    let of_b = workers.iter().find(|it| it.id == "b").unwrap();
    assert_eq!(of_b.jobs, ["j"]);
    let mut tx = shop.store.write().await.unwrap();
    tx.release_portions("b").await.unwrap();
    tx.commit().await.unwrap();
    assert!(
        shop.store.workers().await.unwrap().iter().all(|it| it.id == "a" || it.jobs.is_empty())
    );
}
