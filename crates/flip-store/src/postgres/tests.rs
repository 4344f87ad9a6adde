use super::*;
use crate::storage::Storage;
use crate::{Store, now, testing};
use sqlx::{AssertSqlSafe, Row};
use std::collections::BTreeMap;

/// A cluster, whatever the other tests run on; `None`, and why, where there is none.
fn cluster() -> Option<&'static testing::Cluster> {
    testing::cluster().inspect_err(|why| println!("skipped: {why}")).ok()
}

#[tokio::test]
async fn both_databases_have_the_same_tables_columns_and_indexes() {
    let Some(cluster) = cluster() else { return };
    let folder = tempfile::tempdir().unwrap();
    let (ours, theirs) = (folder.path().join("sqlite"), folder.path().join("postgres"));
    let ours = Store::open(&ours).await.unwrap();
    let theirs = testing::open_on(&cluster.database_of(&theirs).await, &theirs).await.unwrap();
    let columns = async |store: &Store, sql: &'static str| -> BTreeMap<String, Vec<String>> {
        let mut found = BTreeMap::<_, Vec<_>>::new();
        for row in sqlx::query(sql).fetch_all(&store.reader).await.unwrap() {
            found.entry(row.get::<String, _>(0)).or_default().push(row.get::<String, _>(1));
        }
        found.values_mut().for_each(|columns| columns.sort());
        found
    };
    let sqlite = "SELECT s.name, c.name FROM sqlite_schema s, pragma_table_info(s.name) c \
                  WHERE s.type IN ('table', 'view') AND s.name NOT LIKE '%sqlite%' AND s.name NOT LIKE '%sqlx%'";
    let postgres = "SELECT table_name::text, column_name::text FROM information_schema.columns \
                    WHERE table_schema = 'public' AND table_name NOT LIKE '%sqlx%'";
    assert_eq!(columns(&ours, sqlite).await, columns(&theirs, postgres).await);
    let sqlite =
        "SELECT tbl_name, name FROM sqlite_schema WHERE type = 'index' AND sql IS NOT NULL";
    let postgres = "SELECT tablename::text, indexname::text FROM pg_indexes WHERE schemaname = 'public' \
                    AND indexname NOT LIKE '%\\_key' AND indexname NOT LIKE '%\\_pkey'";
    assert_eq!(columns(&ours, sqlite).await, columns(&theirs, postgres).await);
}

#[tokio::test]
async fn who_stops_in_the_middle_of_a_transaction_holds_up_the_others_for_seconds_only() {
    let Some(cluster) = cluster() else { return };
    let folder = tempfile::tempdir().unwrap();
    let url = cluster.database_of(folder.path()).await;
    let store = testing::open_on(&url, folder.path()).await.unwrap();
    let elsewhere = tempfile::tempdir().unwrap();
    let beside = Storage::on_server(&url, elsewhere.path()).unwrap();
    let beside = Store::open_beside(beside).await.unwrap();
    // As a process that is stopped, or whose network is cut, in its middle.
    let stopped = beside.write().await.unwrap();
    for _ in 0..2 {
        let mut tx = store.write().await.unwrap();
        tx.emit("bench", "held", &serde_json::json!({})).await.unwrap();
        tx.commit().await.unwrap();
    }
    let error = stopped.commit().await.unwrap_err();
    assert!(matches!(error, Error::Unreachable(_)), "{error}");
    let mut goes_on = beside.write().await.unwrap();
    goes_on.emit("bench", "held", &serde_json::json!({})).await.unwrap();
    goes_on.commit().await.unwrap();
    beside.close().await;
    store.close().await;
}

#[tokio::test]
async fn events_of_other_processes_are_heard_and_a_lock_is_waited_for() {
    let Some(cluster) = cluster() else { return };
    let folder = tempfile::tempdir().unwrap();
    let url = cluster.database_of(folder.path()).await;
    let store = testing::open_on(&url, folder.path()).await.unwrap();
    let mut heard = store.watch_events();
    let mut other = PgConnection::connect(&url).await.unwrap();
    let before = *heard.borrow_and_update();
    for _ in 0..2 {
        let mut tx = other.begin_with(BEGIN).await.unwrap();
        tx.execute("SELECT pg_advisory_xact_lock(1179404624)").await.unwrap();
        let insert = "INSERT INTO event (topic, kind, data, at) VALUES ('bench', 'held', '{}', 0)";
        tx.execute(insert).await.unwrap();
        assert!(!store.health().await.database.ok, "another process writes, and takes its time");
        tx.commit().await.unwrap();
        let soon = tokio::time::timeout(POLL * 5, heard.changed()).await;
        soon.expect("heard").unwrap();
    }
    assert_eq!(*heard.borrow_and_update(), before + 2);
    let elsewhere = tempfile::tempdir().unwrap();
    let second = testing::open_on(&url, elsewhere.path()).await;
    assert!(matches!(second, Err(Error::Served { .. })), "{second:?}");
    let mut tx = other.begin_with(BEGIN).await.unwrap();
    tx.execute("SELECT pg_advisory_xact_lock(1179404624)").await.unwrap();
    sqlx::query("SET lock_timeout = '50ms'").execute(store.writer().unwrap()).await.unwrap();
    assert!(matches!(store.write().await, Err(Error::Locked)));
    tx.rollback().await.unwrap();
    let mut tx = store.write().await.unwrap();
    tx.emit("bench", "held", &serde_json::json!({})).await.unwrap();
    tx.commit().await.unwrap();
    assert!(*heard.borrow_and_update() > before + 2);
    store.close().await;
    let error = store.write().await.unwrap_err();
    assert!(error.is_closed(), "{error}");
}

#[tokio::test]
async fn a_record_survives_a_writer_that_is_cut_off_and_a_newer_database_is_refused() {
    let Some(cluster) = cluster() else { return };
    let folder = tempfile::tempdir().unwrap();
    let url = cluster.database_of(folder.path()).await;
    let store = testing::open_on(&url, folder.path()).await.unwrap();
    let mut other = PgConnection::connect(&url).await.unwrap();
    let cut = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity \
               WHERE datname = current_database() AND pid <> pg_backend_pid()";
    let mut tx = store.write().await.unwrap();
    tx.audit_person(None, "looked", now()).await.unwrap();
    other.execute(cut).await.unwrap();
    let refused = tx.commit().await.unwrap_err();
    assert!(matches!(refused, Error::Unreachable(_)), "{refused:?}");
    let mut tx = store.write().await.unwrap();
    tx.audit_person(None, "looked again", now()).await.unwrap();
    tx.commit().await.unwrap();
    let found = store.verify_audit(None).await.unwrap();
    assert_eq!((found.records, found.broken), (3, None));
    store.close().await;
    drop(store);
    let newer = "INSERT INTO _sqlx_migrations (version, description, success, checksum, execution_time) \
                 VALUES (99, 'later', true, ''::bytea, 0)";
    other.execute(newer).await.unwrap();
    let refused = testing::open_on(&url, folder.path()).await.err();
    assert!(matches!(refused, Some(Error::Newer(99))), "{refused:?}");
    let refused = testing::open_on("mysql://root@localhost/x", folder.path()).await.err();
    assert!(matches!(refused, Some(Error::Server(_))), "{refused:?}");
}

#[tokio::test]
async fn a_committed_transaction_is_on_the_disk() {
    let Some(cluster) = cluster() else { return };
    let folder = tempfile::tempdir().unwrap();
    let url = cluster.database_of(folder.path()).await;
    let mut other = PgConnection::connect(&url).await.unwrap();
    let name: String =
        sqlx::query_scalar("SELECT current_database()::text").fetch_one(&mut other).await.unwrap();
    let careless = format!("ALTER DATABASE {name} SET synchronous_commit = off");
    other.execute(AssertSqlSafe(careless)).await.unwrap();
    // A service opens it on whatever thread is free.
    let path = folder.path().to_owned();
    let opened = tokio::spawn(async move { testing::open_on(&url, &path).await });
    let store = opened.await.unwrap().unwrap();
    let set: String = sqlx::query_scalar("SELECT current_setting('synchronous_commit')")
        .fetch_one(store.writer().unwrap())
        .await
        .unwrap();
    assert_eq!(set, "on");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_committed_is_there_after_a_crash_of_the_server_and_work_goes_on() {
    if cluster().is_none() {
        return;
    }
    let cluster = std::sync::Arc::new(testing::Cluster::start(true).unwrap());
    let folder = tempfile::tempdir().unwrap();
    let url = cluster.database_of(folder.path()).await;
    let store = testing::open_on(&url, folder.path()).await.unwrap();
    let mut heard = store.watch_events();
    let record = async || {
        let mut tx = store.write().await?;
        tx.audit_person(None, "looked", now()).await?;
        tx.emit("bench", "held", &serde_json::json!({})).await?;
        tx.commit().await
    };
    let (mut committed, mut failed) = (0, 0);
    for _ in 0..2 {
        let crashing = cluster.clone();
        let crash = tokio::task::spawn_blocking(move || crashing.crash());
        let mut after = 0;
        while after < 10 {
            after += i32::from(crash.is_finished());
            match record().await {
                Ok(()) => committed += 1,
                Err(Error::Unreachable(_) | Error::Busy) => {
                    failed += 1;
                    tokio::time::sleep(POLL / 20).await;
                }
                Err(other) => panic!("{other:?}"),
            }
        }
        crash.await.unwrap();
    }
    assert!(committed >= 20, "{committed} were committed, {failed} failed");
    // Of one that failed nobody knows, but no other is missing.
    let found = store.verify_audit(None).await.unwrap();
    let expected = committed + 2..=committed + failed + 2;
    assert!(expected.contains(&found.records), "{} of {expected:?}", found.records);
    assert_eq!(found.broken, None);
    let health = store.health().await;
    assert!(health.lock.ok && health.database.ok, "{health:?}");
    let elsewhere = tempfile::tempdir().unwrap();
    let second = testing::open_on(&url, elsewhere.path()).await;
    assert!(matches!(second, Err(Error::Served { .. })), "{second:?}");
    // And events of others are heard again.
    heard.borrow_and_update();
    let mut other = PgConnection::connect(&url).await.unwrap();
    let insert = "INSERT INTO event (topic, kind, data, at) VALUES ('bench', 'held', '{}', 0)";
    other.execute(insert).await.unwrap();
    tokio::time::timeout(POLL * 5, heard.changed()).await.expect("heard").unwrap();
}
