use super::*;
use crate::audit::About;
use crate::bench::Latch;
use crate::bench_requests::BenchRequest;
use crate::holds::Held;
use crate::{Storage, testing};
use std::time::Duration;

/// Two processes with a bench each, on one database and with one folder of files; `None`, and why,
/// where there is no server.
async fn two(folder: &std::path::Path) -> Option<(Store, Store)> {
    let cluster = testing::cluster().inspect_err(|why| println!("skipped: {why}")).ok()?;
    let url = cluster.database_of(folder).await;
    let storage = Storage::on_server(&url, folder).unwrap();
    let first = Store::open(&storage).await.unwrap();
    let second = Store::open(storage.with_bench("hall-2")).await.unwrap();
    for store in [&first, &second] {
        store.take_bench().await.unwrap();
    }
    Some((first, second))
}

fn latch(at: Timestamp) -> Latch {
    Latch { at, reason: "a vial fell".into(), weighing: None, bench: Some(BenchKind::Devices) }
}

#[tokio::test]
async fn the_rows_of_a_bench_are_its_own_and_its_records_are_a_chain_of_their_own() {
    let folder = tempfile::tempdir().unwrap();
    let Some((first, second)) = two(folder.path()).await else { return };
    // In the same millisecond, as when somebody stops every bench at once.
    let at = now();
    for store in [&first, &second] {
        let mut tx = store.write_for_bench().await.unwrap();
        tx.latch_bench(&latch(at)).await.unwrap();
        tx.hold_bench(&Held { at, reason: "stop".into(), by: None }).await.unwrap();
        tx.commit().await.unwrap();
    }
    let mut tx = second.write_for_bench().await.unwrap();
    tx.clear_latch("Ada", "", now()).await.unwrap().unwrap();
    assert!(tx.resume_bench("Ada", "", now()).await.unwrap());
    tx.commit().await.unwrap();
    assert_eq!((second.latch().await.unwrap(), second.held().await.unwrap()), (None, None));
    assert!(first.latch().await.unwrap().is_some() && first.held().await.unwrap().is_some());
    let found = first.verify_audit(None).await.unwrap();
    assert_eq!((found.broken, found.records), (None, 2 + 2 + 4));
    assert_eq!(found.chains.len(), 1);
    assert_eq!(found.chains[0].last_seq, (1 << 40) + 4);
    let kept = found.chains[0].last_hash.clone();
    assert_eq!(second.verify_audit(Some(&kept)).await.unwrap().holds_hash, Some(true));
    // A record that is changed breaks its own chain, wherever that begins.
    let trigger = "DROP TRIGGER audit_stays ON audit";
    sqlx::query(trigger).execute(first.writer().unwrap()).await.unwrap();
    let sql = "UPDATE audit SET at = at + 1 WHERE seq = 1099511627778";
    sqlx::query(sql).execute(first.writer().unwrap()).await.unwrap();
    let broken = second.verify_audit(None).await.unwrap().broken.unwrap();
    assert_eq!(broken.seq, (1 << 40) + 2);
}

#[tokio::test]
async fn what_a_dose_records_waits_for_no_other_bench() {
    let folder = tempfile::tempdir().unwrap();
    let Some((first, second)) = two(folder.path()).await else { return };
    let mut heard = first.watch_events();
    let record = async |store: &Store| {
        let mut tx = store.write_record().await.unwrap();
        tx.emit("weighing:w", "tick", &1).await.unwrap();
        tx.audit(About { weighing: Some("w"), kind: "reading" }, &1, now()).await.unwrap();
        tx
    };
    // One that has not ended yet, and one of everything else.
    let open = record(&first).await;
    let other = first.write().await.unwrap();
    let soon = tokio::time::timeout(Duration::from_secs(2), async {
        record(&second).await.commit().await.unwrap();
    });
    soon.await.expect("it waits for nobody");
    drop(other);
    open.commit().await.unwrap();
    heard.borrow_and_update();
    // Events become visible in the order of their numbers.
    let events = first.events_after(Some("weighing:w"), 0, 10).await.unwrap();
    assert!(events.len() == 2 && events[0].seq < events[1].seq);
    assert_eq!(first.verify_audit(None).await.unwrap().broken, None);
}

#[tokio::test]
async fn a_second_owner_is_refused_and_one_that_lost_its_bench_can_record_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let Some((first, second)) = two(folder.path()).await else { return };
    let storage = async || {
        let url = testing::cluster().unwrap().database_of(folder.path()).await;
        Storage::on_server(&url, folder.path()).unwrap().with_bench("hall-2")
    };
    let refused = Store::open(storage().await).await.unwrap_err();
    assert!(refused.to_string().contains("bench `hall-2` is served by"), "{refused}");
    second.renew_bench(BenchKind::Emulated).await.unwrap();
    let there = first.at_bench("hall-2").await.unwrap().unwrap();
    let mut tx = there.write().await.unwrap();
    assert!(!tx.take_from_lost_owner(now()).await.unwrap(), "it was heard of");
    drop(tx);
    // A record that is being written when the bench is taken comes before, or not at all.
    let late = second.write_record().await.unwrap();
    let lost = Timestamp::from_unix_ms(now().unix_ms() + 2 * LEASE_MS);
    let taking = tokio::spawn(async move {
        let mut tx = there.write().await.unwrap();
        let taken = tx.take_from_lost_owner(lost).await.unwrap();
        tx.commit().await.unwrap();
        taken
    });
    tokio::time::sleep(Duration::from_millis(100)).await;
    assert!(!taking.is_finished());
    late.commit().await.unwrap();
    assert!(taking.await.unwrap());
    for refused in [second.write_record().await.err(), second.write_for_bench().await.err()] {
        assert!(matches!(refused, Some(Error::Disowned(_))), "{refused:?}");
    }
    second.write().await.unwrap().commit().await.unwrap();
    let row = &first.benches().await.unwrap()[1];
    assert_eq!((row.name.as_str(), row.served, &row.owner), ("hall-2", false, &None));
    // It learns of it, and has the bench again, because nobody else took it.
    let told = second.renew_bench(BenchKind::Emulated).await.unwrap_err();
    assert!(matches!(told, Error::Disowned(_)));
    second.renew_bench(BenchKind::Emulated).await.unwrap();
    second.write_record().await.unwrap().commit().await.unwrap();
    second.close().await;
    drop(second);
    let again = Store::open(storage().await).await.unwrap();
    again.take_bench().await.unwrap();
    assert!(again.benches().await.unwrap().iter().all(|row| row.served));
}

#[tokio::test]
async fn a_request_to_a_bench_is_answered_once_and_a_container_holds_one_powder() {
    let folder = tempfile::tempdir().unwrap();
    let store = testing::open(folder.path()).await.unwrap();
    let request = BenchRequest { id: "br-1".to_owned(), body: "stop".to_owned(), until: now() };
    let loaded = Loaded { powder: "salt".into(), lot: Some("L".into()), at: now() };
    let mut tx = store.write().await.unwrap();
    tx.ask_bench(&request, now()).await.unwrap();
    tx.load_bench(Some(&loaded), now()).await.unwrap();
    tx.commit().await.unwrap();
    assert_eq!(store.open_bench_requests::<String>().await.unwrap(), [request]);
    assert_eq!(store.benches().await.unwrap()[0].holds, Some(loaded));
    let mut tx = store.write().await.unwrap();
    assert!(tx.answer_bench_request("br-1", &"done", now()).await.unwrap());
    assert!(!tx.answer_bench_request("br-1", &"again", now()).await.unwrap());
    tx.load_bench(None, now()).await.unwrap();
    tx.commit().await.unwrap();
    let answer: Option<String> = store.bench_answer("br-1").await.unwrap();
    assert_eq!(answer.as_deref(), Some("done"));
    assert!(store.open_bench_requests::<String>().await.unwrap().is_empty());
    assert_eq!(store.benches().await.unwrap()[0].holds, None);
    assert_eq!(store.verify_audit(None).await.unwrap().broken, None);

    // The answer is kept for a day after the request's last moment.
    let hours = |hours: i64| Timestamp::from_unix_ms(now().unix_ms() + hours * 3_600_000);
    for (id, at, kept) in [("br-2", hours(23), true), ("br-3", hours(25), false)] {
        let next = BenchRequest { id: id.to_owned(), body: "stop".to_owned(), until: at };
        let mut tx = store.write().await.unwrap();
        tx.ask_bench(&next, at).await.unwrap();
        tx.commit().await.unwrap();
        let answer: Option<String> = store.bench_answer("br-1").await.unwrap();
        assert_eq!(answer.is_some(), kept, "{id}");
    }
}
