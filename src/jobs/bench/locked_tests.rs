//! A stop while another program holds the database: the spoon returns although nothing can be
//! recorded.

use super::{Bench, Change};
use flip_bench::emulate::arm::{self, Flow, FormulaSpoon};
use flip_bench::emulate::lab::{self, Laboratory};
use flip_bench::hardware::DeviceError;
use flip_bench::hardware::clock::Clock;
use flip_bench::hardware::wire::Exchange;
use flip_bench::rig::{Devices, OnEvent, Poured, Pouring, Rig};
use flip_bench::weigh::Event;
use flip_core::domain::bench::BenchKind;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::vial::VialCheck;
use flip_core::domain::weighing::{Outcome, WeighRequest};
use flip_policy::shipped;
use flip_store::audit_search::AuditWanted;
use flip_store::weighings::Intent;
use flip_store::{Store, now};
use sqlx::SqlitePool;
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{Sqlite, Transaction};
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::Duration;
use tokio::runtime::Handle;

/// Longest wait in the test: the store would wait for the lock ten times as long.
const PATIENCE: Duration = Duration::from_secs(60);
/// Number of a dose's events, from the first, at which stop is pressed.
const MOMENTS: usize = 10;

/// When to press stop, and what was found.
#[derive(Default)]
struct Trial {
    /// Before the event of this number is on record, from 1.
    at: Mutex<usize>,
    /// While its record waits for the lock, rather than before.
    waits: Mutex<bool>,
    held: Mutex<Option<Transaction<'static, Sqlite>>>,
    bench: OnceLock<Arc<Bench>>,
}

impl Trial {
    /// Takes the lock, and presses stop.
    fn begin(&self, store: &Store, other: &SqlitePool, runtime: &Handle) {
        *self.held.lock().unwrap() =
            Some(runtime.block_on(other.begin_with("BEGIN IMMEDIATE")).unwrap());
        let bench = self.bench.get().unwrap().clone();
        if !*self.waits.lock().unwrap() {
            bench.halt(None);
            return;
        }
        let store = store.clone();
        std::thread::spawn(move || {
            // The only writer connection is taken: the record waits.
            while store.writer().unwrap().num_idle() > 0 {
                std::thread::yield_now();
            }
            bench.halt(None);
        });
    }
}

/// A store with a powder's set and the shipped policy, which waits for a lock indefinitely.
async fn store(folder: &Path) -> (Store, ParameterSet) {
    let store = Store::open(folder).await.unwrap();
    let (set, shipped) = (ParameterSet::from_unit([0.5; 9]), shipped());
    let mut tx = store.write().await.unwrap();
    let manifest = serde_json::to_string(&shipped.policy.manifest).unwrap();
    tx.insert_policy(
        &shipped.id,
        shipped.policy.manifest.kind.name(),
        None,
        &manifest,
        &shipped.bytes,
    )
    .await
    .unwrap();
    tx.commit().await.unwrap();
    let writer = store.writer().unwrap();
    let job = "INSERT INTO job (id, kind, spec, spec_sha256, state, created_at) \
               VALUES ('c', 'calibration', '{}', zeroblob(32), 'queued', 0)";
    sqlx::query(job).execute(writer).await.unwrap();
    let row = "INSERT INTO parameter_set (id, powder, calibration, position, parameters, repose_deg, runs, error_deg, created_at) \
               VALUES (?1, 'sand', 'c', 0, ?2, 36, 1, 0, 0)";
    let values = serde_json::to_string(&set).unwrap();
    sqlx::query(row).bind(set.id()).bind(values).execute(writer).await.unwrap();
    sqlx::query("PRAGMA busy_timeout = 600000").execute(writer).await.unwrap();
    (store, set)
}

async fn ask(store: &Store, bench: &Bench, set: &ParameterSet, id: &str) {
    let request = WeighRequest {
        powder: "sand".into(),
        target_mg: 12.0,
        tolerance_lower_mg: 1.0,
        tolerance_upper_mg: 1.0,
        policy: shipped().id.clone(),
        seed: 1,
        under: None,
        patch: Default::default(),
        asked: Default::default(),
        labels: Default::default(),
        vial_check: VialCheck::Skip,
    };
    let key = id.to_owned();
    let intent = Intent {
        id: id.into(),
        idempotency_key: key,
        request_sha256: vec![0; 32],
        request,
        parameter_set: set.id(),
    };
    let mut tx = store.write().await.unwrap();
    tx.insert_weighing(&intent, now()).await.unwrap();
    tx.commit().await.unwrap();
    bench.planned().await;
}

/// Devices whose doses are stopped as the trial specifies. Reports whether the spoon was level when
/// stop was pressed, and the outcome once it had returned.
struct Stopped {
    devices: Devices,
    laboratory: Arc<Laboratory>,
    trial: Arc<Trial>,
    store: Store,
    other: SqlitePool,
    runtime: Handle,
    say: Mutex<Sender<(bool, Outcome)>>,
}

impl Rig for Stopped {
    fn kind(&self) -> BenchKind {
        self.devices.kind()
    }

    fn exchanges_vials(&self) -> bool {
        self.devices.exchanges_vials()
    }

    fn pour(&self, pouring: &Pouring, on_event: OnEvent<'_>, stop: &AtomicBool) -> Poured {
        let (mut events, mut was_level) = (0, true);
        let mut listening = |event: &Event<'_>| {
            events += 1;
            if events == *self.trial.at.lock().unwrap() {
                was_level = self.laboratory.arm.is_level();
                self.trial.begin(&self.store, &self.other, &self.runtime);
            }
            on_event(event)
        };
        let poured = self.devices.pour(pouring, &mut listening, stop);
        self.say.lock().unwrap().send((was_level, poured.outcome)).unwrap();
        poured
    }

    fn halt(&self) -> Result<(), DeviceError> {
        self.devices.halt()
    }

    fn exchanges(&self) -> Vec<Exchange> {
        self.devices.exchanges()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_at_any_moment_of_a_dose_brings_the_spoon_back_although_another_program_holds_the_database()
 {
    let folder = tempfile::tempdir().unwrap();
    let (store, set) = store(folder.path()).await;
    let other = SqlitePool::connect_with(
        SqliteConnectOptions::new().filename(folder.path().join("flip.db")),
    );
    let clock = Clock::standing();
    let arm = arm::Settings { dead_man_ms: 20_000, ..Default::default() };
    let settings = lab::Settings { arm, ..lab::Settings::default() };
    let spoon = || Box::new(FormulaSpoon::new(Flow::default(), 1));
    let laboratory = Arc::new(Laboratory::start(settings, clock.clone(), spoon()).unwrap());
    let trial = Arc::new(Trial::default());
    let (say, hear) = channel();
    let rig = Stopped {
        devices: Devices::with_clock(laboratory.file(), clock),
        laboratory: laboratory.clone(),
        trial: trial.clone(),
        store: store.clone(),
        other: other.await.unwrap(),
        runtime: Handle::current(),
        say: Mutex::new(say),
    };
    let bench = Bench::open(store.clone(), Arc::new(rig), Arc::default()).await.unwrap();
    let bench = Arc::new(bench);
    assert!(trial.bench.set(bench.clone()).is_ok());
    bench.start().await.unwrap();
    let (hear, mut tilted) = (Arc::new(Mutex::new(hear)), 0);
    for (at, waits) in (1..=MOMENTS).flat_map(|at| [(at, false), (at, true)]) {
        (*trial.at.lock().unwrap(), *trial.waits.lock().unwrap()) = (at, waits);
        laboratory.prepare(spoon());
        let id = format!("w-{at}-{waits}");
        ask(&store, &bench, &set, &id).await;
        let hear = hear.clone();
        let ended =
            tokio::task::spawn_blocking(move || hear.lock().unwrap().recv_timeout(PATIENCE))
                .await
                .unwrap();
        let (was_level, outcome) = ended.expect("the spoon comes back while the lock is held");
        assert_eq!(outcome, Outcome::Stopped, "{id}");
        assert!(laboratory.arm.is_level() && laboratory.arm.is_retracted(), "{id}");
        tilted += usize::from(!was_level);

        let held = trial.held.lock().unwrap().take().expect("the lock was held until here");
        held.rollback().await.unwrap();
        let mut ended = store.weighing(&id).await.unwrap().unwrap().weighing;
        while ended.outcome.is_none() {
            tokio::task::yield_now().await;
            ended = store.weighing(&id).await.unwrap().unwrap().weighing;
        }
        assert_eq!((ended.outcome, ended.error), (Some(Outcome::Stopped), None), "{id}");
        // Events that could not be written when they happened are on record, in order.
        let records = store.audit_after(&AuditWanted::of(&id), 0).await.unwrap();
        let kinds: Vec<&str> =
            records.iter().map(|record| &*record.kind).filter(|kind| *kind != "sent").collect();
        assert_eq!(
            (kinds.first(), kinds.iter().filter(|kind| **kind == "outcome").count()),
            (Some(&"intent"), 1)
        );
        assert_eq!(bench.resume("Ada", "", bench.stops()).await.unwrap(), Change::Made, "{id}");
    }
    assert!(tilted > 1, "no moment with a tilted spoon was among them");
    assert_eq!(store.verify_audit(None).await.unwrap().broken, None);
    bench.shutdown().await;
}
