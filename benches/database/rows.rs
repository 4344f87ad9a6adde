//! Rows as processes write them, by the store's own calls, as fast as the database takes them.

use super::quantile;
use super::service::Dose;
use anyhow::Context;
use flip_core::domain::bench::BenchKind;
use flip_core::domain::job::{JobKind, Subject};
use flip_core::domain::labels::Labels;
use flip_core::domain::timestamp::Timestamp;
use flip_core::domain::weighing::{Outcome, WeighingState};
use flip_store::audit::About;
use flip_store::ledger::Claim;
use flip_store::weighings::{Ending, Intent};
use flip_store::{Storage, Store, now};
use flip_testing::Cluster;
use serde_json::json;
use std::time::{Duration, Instant};

/// Processes that write at the same time.
const WRITERS: [usize; 3] = [1, 4, 16];

/// What a writer does again and again.
#[derive(Clone, Copy)]
enum Work {
    Job,
    Event,
    Dose,
}

/// One table: each kind of work by 1, 4 and 16 writers, each with a store and a bench of its own.
pub async fn print(cluster: &Cluster, lasting: Duration, dose: &Dose) -> anyhow::Result<()> {
    println!("| what | writers | a second | median ms | 99 % ms |");
    println!("|---|---|---|---|---|");
    for (work, name) in [
        (Work::Job, "jobs: asked for, claimed, succeeded"),
        (Work::Event, "events"),
        (Work::Dose, "records of a dose, written at once"),
    ] {
        for writers in WRITERS {
            let place = tempfile::tempdir()?;
            let url = cluster.database_of(place.path()).await;
            let mut all = tokio::task::JoinSet::new();
            for k in 0..writers {
                let storage = Storage::on_server(&url, place.path())?.with_bench(format!("b{k}"));
                let store = Store::open(storage).await?;
                if k == 0 {
                    prepare(&url).await?;
                }
                store.take_bench().await?;
                let dose = *dose;
                all.spawn(async move { writes(&store, k, work, lasting, &dose).await });
            }
            let mut took_ms = Vec::new();
            while let Some(done) = all.join_next().await {
                took_ms.extend(done??);
            }
            took_ms.sort_by(f64::total_cmp);
            let many = match work {
                Work::Dose => took_ms.len() as u64 * dose.records,
                Work::Job | Work::Event => took_ms.len() as u64,
            };
            println!(
                "| {name} | {writers} | {:.0} | {:.1} | {:.1} |",
                many as f64 / lasting.as_secs_f64(),
                quantile(&took_ms, 0.5),
                quantile(&took_ms, 0.99)
            );
        }
    }
    Ok(())
}

/// The rows that a weighing refers to.
async fn prepare(url: &str) -> anyhow::Result<()> {
    let pool = sqlx::PgPool::connect(url).await?;
    for row in [
        "INSERT INTO job (id, kind, spec, spec_sha256, state, created_at) VALUES ('c', 'calibration', '{}', decode(repeat('00', 32), 'hex'), 'queued', 0)",
        "INSERT INTO parameter_set (id, powder, calibration, position, parameters, repose_deg, runs, error_deg, created_at) \
         VALUES ('ps-1', 'sand', 'c', 0, '{}', 36, 1, 0, 0)",
        "INSERT INTO policy (id, kind, manifest, bytes, sha256, created_at) VALUES ('p-1', 'fixed', '{}', '\\x00', repeat('0', 64), 0)",
    ] {
        sqlx::query(row).execute(&pool).await.context(row)?;
    }
    Ok(())
}

/// Does it until the time is over; how long each took, ms.
async fn writes(
    store: &Store,
    writer: usize,
    work: Work,
    lasting: Duration,
    dose: &Dose,
) -> anyhow::Result<Vec<f64>> {
    let (begun, mut took_ms) = (Instant::now(), Vec::new());
    while begun.elapsed() < lasting {
        let (id, one) = (format!("{writer}-{}", took_ms.len()), Instant::now());
        match work {
            Work::Job => job(store, &id).await?,
            Work::Event => {
                let mut tx = store.write().await?;
                tx.emit("bench", "tick", &json!({ "step": took_ms.len() })).await?;
                tx.commit().await?;
            }
            Work::Dose => weighing(store, &id, dose).await?,
        }
        took_ms.push(1000.0 * one.elapsed().as_secs_f64());
    }
    store.close().await;
    Ok(took_ms)
}

async fn job(store: &Store, id: &str) -> anyhow::Result<()> {
    let (subject, labels) = (Subject::default(), Labels::default());
    let mut tx = store.write().await?;
    let mut sha256 = [0; 32];
    sha256[..id.len()].copy_from_slice(id.as_bytes());
    let spec = ("{}", &sha256[..]);
    tx.insert_job(id, JobKind::Calibration, spec, &subject, (None, &labels), now()).await?;
    tx.commit().await?;
    let until = Timestamp::from_unix_ms(now().unix_ms() + 30_000);
    let mut tx = store.write().await?;
    let Claim::Granted(claimed) = tx.claim(id, "w", now(), until).await? else {
        anyhow::bail!("nobody else has it")
    };
    tx.commit().await?;
    let mut tx = store.write().await?;
    tx.succeed(&claimed.lease, "{}", now()).await?;
    Ok(tx.commit().await?)
}

/// The records of a dose in as many commits as it had, without what it waits for.
async fn weighing(store: &Store, id: &str, dose: &Dose) -> anyhow::Result<()> {
    let request = json!({ "powder": "sand", "target_mg": 10.0, "tolerance_lower_mg": 1.0,
        "tolerance_upper_mg": 1.0, "policy": "p-1", "seed": 1, "asked": {} });
    let intent = Intent {
        id: id.to_owned(),
        idempotency_key: id.to_owned(),
        request_sha256: vec![0; 32],
        request: serde_json::from_value(request)?,
        parameter_set: "ps-1".to_owned(),
    };
    let mut tx = store.write().await?;
    tx.insert_weighing(&intent, now()).await?;
    tx.commit().await?;
    let mut tx = store.write_for_bench().await?;
    tx.arm_weighing(id, BenchKind::Emulated, now()).await?;
    tx.commit().await?;
    let commits = dose.commits.saturating_sub(3).max(1);
    for k in 0..commits {
        let mut tx = store.write_record().await?;
        for _ in 0..(dose.records / commits).max(1) {
            let said = json!({ "device": "balance", "text": format!("S S {k:10}.1 mg") });
            tx.audit(About { weighing: Some(id), kind: "received" }, &said, now()).await?;
        }
        tx.commit().await?;
    }
    let mut tx = store.write_for_bench().await?;
    tx.end_weighing(id, &Ending::bare(WeighingState::Done, Outcome::Within, ""), now()).await?;
    Ok(tx.commit().await?)
}
