//! A batch whose portions somebody else carries out, or does not.

use super::*;
use crate::jobs::runner::{HeapExperiment, HeapRunner, heaps_on_cores};
use crate::jobs::stop::Stop;
use flip_core::domain::job::Subject;
use flip_core::domain::labels::Labels;
use flip_core::domain::parameters::ParameterSet;
use flip_sim::repose::{Refusal, Repose, Settings};
use flip_store::ledger::Claim;
use flip_store::portions::Portion;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, AtomicUsize};
use tempfile::TempDir;

type Outcome = Result<Repose, Refusal>;

/// An angle that shows its seed; every third is no number, and every seventh heap is refused.
fn heap(seed: u64) -> Outcome {
    if seed.is_multiple_of(7) {
        return Err(Refusal::Diverged { at_s: f64::NAN, cause: "the seventh".into() });
    }
    let tip_deg = if seed.is_multiple_of(3) { f64::NAN } else { 30.0 + 1.0 / seed as f64 };
    Ok(Repose {
        tip_deg,
        tip_sd_deg: None,
        cone_deg: f64::NEG_INFINITY,
        creep_deg_per_s: -0.0,
        speed_rms_mm_s: 0.0,
        particles_on_base: 1,
        overlap_mean: 0.0,
        overlap_max: 0.0,
        simulated_s: 1.0,
    })
}

/// Heaps that take so long.
fn heaps_of(one: Duration) -> HeapRunner {
    heaps_on_cores(move |_, _, seed| {
        std::thread::sleep(one);
        heap(seed)
    })
}

fn experiments(count: u64) -> Vec<HeapExperiment> {
    let heap =
        |seed| HeapExperiment { set: ParameterSet::default(), settings: Settings::default(), seed };
    (1..=count).map(heap).collect()
}

/// A calibration that worker `a` computes, with worker `b` beside it.
struct Shop {
    store: Store,
    job: Arc<SharedJob>,
    _folder: TempDir,
}

impl Shop {
    async fn open(portion: Duration, others: &[&str]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).await.unwrap();
        let mut tx = store.write().await.unwrap();
        let (kind, labels) = (JobKind::Calibration, Labels::default());
        let job = ("{}", &[0; 32][..]);
        tx.insert_job("j", kind, job, &Subject::default(), (None, &labels), now()).await.unwrap();
        let until = Timestamp::from_unix_ms(now().unix_ms() + 600_000);
        let Claim::Granted(claimed) = tx.claim("j", "a", now(), until).await.unwrap() else {
            panic!("nobody else has it")
        };
        let worker = |id: &str| Worker {
            id: id.into(),
            name: id.into(),
            version: "1".into(),
            kinds: JobKind::ALL.to_vec(),
            threads: 1,
            serves: false,
            card: None,
            started_at: now(),
            heard_at: now(),
            ended_at: None,
            jobs: Vec::new(),
        };
        for id in others {
            tx.insert_worker(&worker(id)).await.unwrap();
        }
        tx.commit().await.unwrap();
        let job = SharedJob {
            store: store.clone(),
            lease: claimed.lease,
            kind,
            worker: worker("a"),
            portion_s: portion.as_secs_f64(),
            stop: Arc::default(),
            runtime: Handle::current(),
            cut: AtomicI64::default(),
            helpers: Mutex::default(),
            usual_s: Mutex::default(),
        };
        Self { store, job: Arc::new(job), _folder: folder }
    }

    /// Carries out so many heaps, of which each takes so long; the outcomes are in order.
    async fn run(
        &self,
        local: HeapRunner,
        count: u64,
        mut flow: impl FnMut(usize) -> ControlFlow<()> + Send + 'static,
    ) -> Vec<Option<Outcome>> {
        let job = self.job.clone();
        let run = move || {
            let mut outcomes = vec![None; count as usize];
            let mut heard = 0;
            Spread::over(local, &job).run(&experiments(count), &mut |place, run| {
                assert!(outcomes[place].replace(run.outcome).is_none(), "{place} came twice");
                heard += 1;
                flow(heard)
            });
            outcomes
        };
        tokio::task::spawn_blocking(run).await.unwrap()
    }

    /// The next portion, once there is one.
    async fn claim(&self, lease_ms: i64) -> Portion {
        loop {
            let mut tx = self.store.write().await.unwrap();
            let until = Timestamp::from_unix_ms(now().unix_ms() + lease_ms);
            let found = tx.claim_portion("b", &TURNS, now(), until).await.unwrap();
            tx.commit().await.unwrap();
            match found {
                Some(portion) => return portion,
                None => tokio::time::sleep(Duration::from_millis(2)).await,
            }
        }
    }

    async fn finish(&self, portion: &Portion, outcomes: &[u8]) -> bool {
        let mut tx = self.store.write().await.unwrap();
        let counts = tx.finish_portion(portion, "b", outcomes, now()).await.unwrap();
        tx.commit().await.unwrap();
        counts
    }

    async fn rows(&self) -> usize {
        self.store.portions(&self.job.lease, now()).await.unwrap().len()
    }

    fn cut(&self) -> i64 {
        self.job.cut.load(Ordering::Relaxed)
    }
}

fn carried_out(portion: &Portion) -> Vec<u8> {
    let functions = Functions { simulate: heaps_of(Duration::ZERO), ..Functions::default() };
    portion::carry_out(&functions, &portion.kind, &portion.experiments, &|| true).unwrap().unwrap()
}

fn go_on(_: usize) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// Debug text shows a NaN, too, and the sign of zero.
fn are_all(outcomes: &[Option<Outcome>]) {
    for (outcome, seed) in outcomes.iter().zip(1..) {
        assert_eq!(format!("{outcome:?}"), format!("{:?}", Some(heap(seed))), "{seed}");
    }
}

const QUICK: Duration = Duration::from_millis(2);
const SLOW: Duration = Duration::from_millis(20);

#[tokio::test(flavor = "multi_thread")]
async fn what_others_carry_out_is_received_once_in_its_place_and_in_every_bit() {
    let shop = Arc::new(Shop::open(Duration::from_millis(60), &["b"]).await);
    let ends = Arc::<AtomicBool>::default();
    let (helped, helper) = (Arc::<AtomicUsize>::default(), shop.clone());
    let (count, end) = (helped.clone(), ends.clone());
    let helping = tokio::spawn(async move {
        while !end.load(Ordering::SeqCst) {
            let Ok(portion) =
                tokio::time::timeout(Duration::from_millis(50), helper.claim(60_000)).await
            else {
                continue;
            };
            count.fetch_add(1, Ordering::SeqCst);
            assert!(helper.finish(&portion, &carried_out(&portion)).await);
        }
    });
    let outcomes = shop.run(heaps_of(SLOW), 60, go_on).await;
    ends.store(true, Ordering::SeqCst);
    helping.await.unwrap();
    are_all(&outcomes);
    assert!(helped.load(Ordering::SeqCst) > 5, "{helped:?} portions");
    assert_eq!(shop.rows().await, 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn alone_and_for_what_takes_a_moment_nothing_is_written() {
    let shop = Shop::open(QUICK, &[]).await;
    are_all(&shop.run(heaps_of(QUICK), 40, go_on).await);
    assert_eq!(shop.cut(), 0);
    let shop = Shop::open(Duration::from_secs(60), &["b"]).await;
    shop.job.usual_s.lock().unwrap().insert(HeapExperiment::KIND, 1e-3);
    are_all(&shop.run(heaps_of(Duration::ZERO), 40, go_on).await);
    assert_eq!(shop.cut(), 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn portions_that_nobody_takes_or_whose_worker_died_are_carried_out_here() {
    let shop = Arc::new(Shop::open(Duration::from_millis(60), &["b"]).await);
    are_all(&shop.run(heaps_of(QUICK), 30, go_on).await);
    assert!(shop.cut() > 0);
    assert_eq!(shop.rows().await, 0);
    let (dying, dies) = (shop.clone(), async |shop: &Shop| shop.claim(1).await);
    let died = tokio::spawn(async move { dies(&dying).await });
    are_all(&shop.run(heaps_of(SLOW), 10, go_on).await);
    let portion = died.await.unwrap();
    assert!(!shop.finish(&portion, &carried_out(&portion)).await, "it wakes up late");
    assert_eq!(shop.rows().await, 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_read_is_carried_out_here() {
    let shop = Arc::new(Shop::open(Duration::from_millis(60), &["b"]).await);
    let helper = shop.clone();
    let helping = tokio::spawn(async move {
        let portion = helper.claim(60_000).await;
        helper.finish(&portion, b"\xff").await
    });
    are_all(&shop.run(heaps_of(SLOW), 10, go_on).await);
    assert!(helping.await.unwrap());
    assert_eq!(shop.rows().await, 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn after_a_break_or_a_stop_portions_are_dropped_and_late_outcomes_change_nothing() {
    for stops in [false, true] {
        let shop = Arc::new(Shop::open(Duration::from_millis(60), &["b"]).await);
        let helper = shop.clone();
        let helping = tokio::spawn(async move { helper.claim(60_000).await });
        let stop = shop.job.stop.clone();
        let flow = move |heard| match heard {
            5 if stops => {
                stop.set(Stop::Cancelled);
                ControlFlow::Continue(())
            }
            5 => ControlFlow::Break(()),
            _ => ControlFlow::Continue(()),
        };
        let outcomes = shop.run(heaps_of(SLOW), 100, flow).await;
        let heard = outcomes.iter().flatten().count();
        assert!((5..30).contains(&heard), "{heard} runs");
        assert_eq!(shop.rows().await, 0);
        let portion = helping.await.unwrap();
        assert!(!shop.finish(&portion, &carried_out(&portion)).await);
        assert_eq!(shop.rows().await, 0);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn another_attempt_ends_the_batch_of_this_one() {
    let shop = Arc::new(Shop::open(Duration::from_millis(60), &["b"]).await);
    let other = shop.clone();
    let fencing = tokio::spawn(async move {
        other.claim(60_000).await;
        let mut tx = other.store.write().await.unwrap();
        tx.release(&other.job.lease).await.unwrap();
        tx.commit().await.unwrap();
    });
    let outcomes = shop.run(heaps_of(SLOW), 200, go_on).await;
    fencing.await.unwrap();
    assert!(outcomes.iter().any(Option::is_none));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_panic_of_an_experiment_is_that_of_the_batch() {
    let shop = Shop::open(QUICK, &[]).await;
    let panics = heaps_on_cores(|_, _, seed| {
        assert!(seed != 4, "the fourth");
        heap(seed)
    });
    let job = shop.job.clone();
    let run = move || Spread::over(panics, &job).run(&experiments(9), &mut |_, _| go_on(0));
    let panicked = tokio::task::spawn_blocking(run).await.unwrap_err().into_panic();
    assert!(panicked.downcast_ref::<&str>().is_some_and(|text| text.contains("the fourth")));
}
