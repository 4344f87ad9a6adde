//! A store comes through a copy unchanged, in either direction, or nothing is copied.

mod buckets;
mod made;

use super::*;
use crate::artifacts::sha256_hex;
use crate::testing::{self, Cluster};
use crate::{Error, backup};
use made::{Dice, EXTREMES, add_extremes, answers, fill, token, work};
use sqlx::postgres::PgConnection;
use sqlx::{Connection, Executor};
use std::sync::atomic::{AtomicBool, Ordering};
use tempfile::TempDir;

/// A cluster, whatever the other tests run on; `None`, and why, where there is none.
fn cluster() -> Option<&'static Cluster> {
    testing::cluster().inspect_err(|why| println!("skipped: {why}")).ok()
}

/// Places for stores.
struct Places {
    folder: TempDir,
    cluster: &'static Cluster,
}

impl Places {
    fn new() -> Option<Self> {
        Some(Self { folder: tempfile::tempdir().unwrap(), cluster: cluster()? })
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn folder(&self, name: &str) -> Storage {
        Storage::in_folder(self.path(name))
    }

    async fn server(&self, name: &str) -> Storage {
        let data_dir = self.path(name);
        Storage::on_server(&self.cluster.database_of(&data_dir).await, data_dir).unwrap()
    }
}

async fn open(side: &Storage) -> Store {
    Store::open(side).await.unwrap()
}

/// The same database, with its files in another folder.
fn elsewhere(side: &Storage, folder: PathBuf) -> Storage {
    Storage::on_server(side.server().unwrap().database_url.as_str(), folder).unwrap()
}

fn quiet(_: CopyProgress<'_>) {}

fn sorted(mut tables: Vec<TableRows>) -> Vec<TableRows> {
    tables.sort_by(|a, b| a.table.cmp(&b.table));
    tables
}

fn assert_same(answers: &[String], before: &[String]) {
    assert_eq!(answers.len(), before.len());
    for (answer, before) in answers.iter().zip(before) {
        assert_eq!(answer, before);
    }
}

async fn url_of(side: &Storage) -> PgConnection {
    PgConnection::connect(side.server().unwrap().database_url.as_str()).await.unwrap()
}

/// Do something asynchronous in the middle of a copy, whose own task waits meanwhile.
fn meanwhile(work: impl Future<Output = ()> + Send) {
    std::thread::scope(|scope| {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        scope.spawn(move || runtime.block_on(work)).join().unwrap();
    });
}

#[tokio::test]
async fn a_laboratory_moves_to_postgresql_and_back_and_answers_the_same() {
    let Some(places) = Places::new() else { return };
    let (first, second, third) =
        (places.folder("first"), places.server("second").await, places.folder("third"));
    let store = open(&first).await;
    let trace = work(&store).await;
    let (before, said) = (sorted(store.table_rows().await.unwrap()), answers(&store).await);
    let whole = store.verify_audit(None).await.unwrap();
    assert_eq!(whole.broken, None);
    let refused = migrate(&first, &second, &quiet).await.unwrap_err();
    assert!(matches!(refused, Error::Held(_)), "{refused}");
    store.close().await;
    drop(store);
    for (from, to) in [(&first, &second), (&second, &third)] {
        let moved = migrate(from, to, &quiet).await.unwrap();
        assert_eq!((moved.files, &moved.lost, &moved.audit_broken), (2, &Vec::new(), &None));
        assert_eq!((moved.records, &moved.last_hash), (whole.records, &whole.last_hash));
        assert_eq!(sorted(moved.tables), before);
        let store = open(to).await;
        assert_eq!(sorted(store.table_rows().await.unwrap()), before, "a start adds nothing");
        assert_same(&answers(&store).await, &said);
        assert_eq!(store.artifacts().get(&trace).await.unwrap(), "ticks of a dose, µ".as_bytes());
        let found = store.verify_audit(Some(&whole.last_hash)).await.unwrap();
        assert_eq!((found.broken, found.holds_hash), (None, Some(true)));
        let held = migrate(to, &places.folder("no"), &quiet).await.unwrap_err();
        assert!(matches!(held, Error::Held(_)), "{held}");
        store.close().await;
    }
}

/// Numbers at the ends of their range, to the bit, except for the sign of zero, which SQLite does not
/// store.
async fn extremes(store: &Store) -> Vec<u64> {
    let reals = "SELECT dispensed_mg FROM weighing WHERE dispensed_mg IS NOT NULL AND id LIKE 'x%' ORDER BY seq";
    let reals: Vec<f64> = sqlx::query_scalar(reals).fetch_all(&store.reader).await.unwrap();
    let found: Vec<_> = reals.into_iter().map(f64::to_bits).collect();
    assert_eq!(found, EXTREMES.map(|it| (it + 0.0).to_bits()));
    let seeds = "SELECT seed FROM weighing WHERE id LIKE 'x%' ORDER BY seq LIMIT 2";
    let seeds: Vec<i64> = sqlx::query_scalar(seeds).fetch_all(&store.reader).await.unwrap();
    assert_eq!(seeds, [i64::MIN, i64::MAX]);
    found
}

#[tokio::test]
async fn every_table_comes_through_both_ways_to_the_bit_and_numbers_go_on() {
    let Some(places) = Places::new() else { return };
    for seed in 0..4 {
        let name = |name: &str| format!("{name} {seed}");
        let first = places.folder(&name("first"));
        let second = places.server(&name("second")).await;
        let third = places.folder(&name("third"));
        let store = open(&first).await;
        let writer = store.writer().unwrap();
        let catalogue = Catalogue::of(&mut writer.acquire().await.unwrap()).await.unwrap();
        let tables = catalogue.matched(&catalogue).unwrap();
        let tables: Vec<_> = tables.into_iter().map(|it| it.0.name.clone()).collect();
        fill(writer, &tables, 12, &mut Dice(seed)).await;
        add_extremes(writer).await;
        let newest = "DELETE FROM event WHERE seq > 520";
        sqlx::query(newest).execute(writer).await.unwrap();
        let before = sorted(store.table_rows().await.unwrap());
        let empty: Vec<_> = before.iter().filter(|it| it.rows == 0).map(|it| &it.table).collect();
        assert!(empty.is_empty(), "no rows are copied of {empty:?}");
        let found = store.verify_audit(None).await.unwrap();
        let extremes = extremes(&store).await;
        store.close().await;
        drop(store);
        for (from, to) in [(&first, &second), (&second, &third)] {
            let moved = migrate(from, to, &quiet).await.unwrap();
            assert_eq!(sorted(moved.tables), before);
            assert_eq!(moved.audit_broken.is_some(), found.broken.is_some());
            let store = open(to).await;
            let again = store.verify_audit(None).await.unwrap();
            assert_eq!((&again.broken, &again.changed), (&found.broken, &found.changed));
            assert_eq!(self::extremes(&store).await, extremes);
            store.close().await;
        }
        for side in [&second, &third] {
            let store = open(side).await;
            let mut tx = store.write().await.unwrap();
            tx.emit("bench", "held", &serde_json::json!({})).await.unwrap();
            tx.insert_powder("new", "New", None).await.unwrap();
            tx.commit().await.unwrap();
            // The last of 12 had number 533 and was deleted; the last powder had 522.
            assert_eq!(store.newest_event().await.unwrap(), 534);
            let seq = "SELECT seq FROM powder WHERE id = 'new'";
            let seq: i64 = sqlx::query_scalar(seq).fetch_one(&store.reader).await.unwrap();
            assert_eq!(seq, 523);
            store.close().await;
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_backup_while_serving_is_of_one_moment() {
    let Some(places) = Places::new() else { return };
    for (from, name) in [(places.folder("folder"), "a"), (places.server("server").await, "b")] {
        let store = open(&from).await;
        work(&store).await;
        let before = sorted(store.table_rows().await.unwrap());
        let (wrote, busy) = (AtomicBool::new(false), store.clone());
        let write = |done: CopyProgress<'_>| {
            if matches!(done, CopyProgress::Files { .. }) && !wrote.swap(true, Ordering::SeqCst) {
                meanwhile(async {
                    let mut tx = busy.write().await.unwrap();
                    tx.insert_powder("later", "Later", None).await.unwrap();
                    tx.insert_token(&token("01")).await.unwrap();
                    tx.emit("bench", "held", &serde_json::json!({})).await.unwrap();
                    tx.commit().await.unwrap();
                });
            }
        };
        let source = Source::beside(&from).await.unwrap();
        let copied = copy(source, &places.folder(name), &write).await.unwrap();
        assert!(wrote.load(Ordering::SeqCst));
        assert_eq!(sorted(copied.tables), before);
        assert_eq!(copied.audit_broken, None);
        assert_ne!(sorted(store.table_rows().await.unwrap()), before, "it was written");
        store.close().await;
    }
}

#[tokio::test]
async fn a_backup_of_a_server_is_a_folder_and_comes_back_held_and_without_tokens() {
    let Some(places) = Places::new() else { return };
    let from = places.server("from").await;
    let store = open(&from).await;
    work(&store).await;
    let kept = places.path("kept");
    let made = backup::copy_of(&from, &kept, &quiet).await.unwrap();
    assert_eq!((made.files, &made.lost, &made.audit_broken), (2, &Vec::new(), &None));
    let again = backup::copy_of(&from, &kept, &quiet).await.unwrap_err();
    assert!(matches!(again, Error::Occupied(_)), "{again}");
    let opened = Store::examine(&kept).await.unwrap().unwrap();
    assert_same(&answers(&opened).await, &answers(&store).await);
    opened.close().await;
    store.close().await;
    for (to, keep) in [(places.server("to").await, false), (places.server("all").await, true)] {
        let back = backup::restore_to(&kept, &to, keep, &quiet).await.unwrap();
        assert_eq!((&back.last_hash, back.records), (&made.last_hash, made.records));
        assert_eq!(back.revoked_tokens, (!keep).then_some(1));
        let store = open(&to).await;
        assert_eq!(store.held().await.unwrap().map(|it| it.reason), back.held);
        let tokens = store.every_token().await.unwrap();
        assert_eq!(
            tokens.iter().filter(|it| it.entry.revoked_at.is_none()).count(),
            usize::from(keep)
        );
        let found = store.verify_audit(Some(&made.last_hash)).await.unwrap();
        assert_eq!((found.broken, found.holds_hash), (None, Some(true)));
        assert!(store.artifacts().get(&sha256_hex("ticks of a dose, µ".as_bytes())).await.is_ok());
        store.close().await;
    }
}

#[tokio::test]
async fn what_is_cut_off_in_the_middle_leaves_nothing_and_can_be_done_again() {
    let Some(places) = Places::new() else { return };
    let (first, second, third) =
        (places.folder("first"), places.server("second").await, places.folder("third"));
    let store = open(&first).await;
    work(&store).await;
    store.close().await;
    drop(store);
    let cut_off = |done: CopyProgress<'_>| {
        if matches!(done, CopyProgress::Rows { table: "weighing", .. }) {
            meanwhile(async {
                let cut = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity \
                           WHERE datname = current_database() AND pid <> pg_backend_pid()";
                url_of(&second).await.execute(cut).await.unwrap();
            });
        }
    };
    let refused = migrate(&first, &second, &cut_off).await.unwrap_err();
    assert!(matches!(refused, Error::Unreachable(_)), "{refused:?}");
    assert!(!places.path("second").exists(), "nor are its files there");
    let mut server = url_of(&second).await;
    for table in ["weighing", "powder", "audit", "event"] {
        let rows = sqlx::AssertSqlSafe(format!("SELECT count(*) FROM {table}"));
        let rows: i64 = sqlx::query_scalar(rows).fetch_one(&mut server).await.unwrap();
        assert_eq!(rows, 0, "{table}");
    }
    let powder = "SELECT pg_sequence_last_value(pg_get_serial_sequence('powder', 'seq')::regclass)";
    let powder: Option<i64> = sqlx::query_scalar(powder).fetch_one(&mut server).await.unwrap();
    assert_eq!(powder, None, "it numbers from 1");
    server.close().await.unwrap();
    migrate(&first, &second, &quiet).await.unwrap();
    let refused = migrate(&second, &third, &cut_off).await.unwrap_err();
    assert!(matches!(refused, Error::Unreachable(_)), "{refused:?}");
    let left: Vec<_> = std::fs::read_dir(places.folder.path()).unwrap().flatten().collect();
    assert_eq!(left.len(), 2, "{left:?}");
    migrate(&second, &third, &quiet).await.unwrap();
}

#[tokio::test]
async fn a_target_that_somebody_used_and_a_source_that_holds_nothing_are_refused() {
    let Some(places) = Places::new() else { return };
    let (first, used) = (places.folder("first"), places.server("used").await);
    open(&first).await.close().await;
    open(&used).await.close().await;
    let refused =
        migrate(&first, &elsewhere(&used, places.path("elsewhere")), &quiet).await.unwrap_err();
    let said = refused.to_string();
    assert!(
        matches!(refused, Error::Filled { .. }) && said.contains("name an empty one"),
        "{said}"
    );
    assert!(!places.path("elsewhere").exists());
    let new = places.server("new").await;
    let no_room = elsewhere(&new, places.path("first"));
    for (from, to) in [(&places.folder("first"), &no_room), (&used, &first)] {
        let refused = migrate(from, to, &quiet).await.unwrap_err();
        let held = matches!(refused, Error::Held(_)) && to.is_on_server();
        assert!(held || matches!(refused, Error::Occupied(_)), "{refused:?}");
    }
    let refused = migrate(&new, &places.folder("nothing"), &quiet).await.unwrap_err();
    assert!(matches!(refused, Error::Unstarted(_) | Error::File { .. }), "{refused:?}");
    let refused = migrate(&places.folder("none"), &new, &quiet).await.unwrap_err();
    assert!(matches!(refused, Error::Absent(_)), "{refused:?}");
    assert!(!places.path("nothing").exists() && !places.path("none").exists());
}

#[tokio::test]
async fn a_negative_zero_of_postgresql_does_not_stop_a_backup() {
    let Some(places) = Places::new() else { return };
    let from = places.server("from").await;
    let store = open(&from).await;
    let sql = "UPDATE measurement SET sd_deg = $1 WHERE seq = 1";
    sqlx::query(sql).bind(-0.0).execute(store.writer().unwrap()).await.unwrap();
    let before = sorted(store.table_rows().await.unwrap());
    let to = places.folder("to");
    let made = copy(Source::beside(&from).await.unwrap(), &to, &quiet).await.unwrap();
    assert_eq!(sorted(made.tables), before);
    let sign = |number: f64| (number == 0.0, number.is_sign_negative());
    for (side, negative) in [(from, true), (to, false)] {
        let store = if negative { store.clone() } else { open(&side).await };
        let sd = sqlx::query_scalar("SELECT sd_deg FROM measurement WHERE seq = 1");
        let sd: f64 = sd.fetch_one(&store.reader).await.unwrap();
        assert_eq!(sign(sd), (true, negative));
        store.close().await;
    }
}

#[tokio::test]
async fn many_rows_and_large_ones_come_through_in_parts() {
    let Some(places) = Places::new() else { return };
    let (first, second, third) =
        (places.folder("first"), places.server("second").await, places.folder("third"));
    let store = open(&first).await;
    let many = "WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM n WHERE k < 5000) \
                INSERT INTO event (topic, kind, data, at) SELECT 'bench', 'held', '{\"k\":' || k || '}', k FROM n";
    sqlx::query(many).execute(store.writer().unwrap()).await.unwrap();
    let mut tx = store.write().await.unwrap();
    for k in 0..3_u8 {
        let bytes: Vec<u8> = (0..3 << 20).map(|it: u32| it.to_le_bytes()[2] ^ k).collect();
        tx.insert_policy(&format!("p-{k}"), "fixed", None, "{}", &bytes).await.unwrap();
    }
    tx.commit().await.unwrap();
    let before = sorted(store.table_rows().await.unwrap());
    store.close().await;
    drop(store);
    for (from, to) in [(&first, &second), (&second, &third)] {
        let steps = std::sync::Mutex::new(Vec::new());
        let note = |step: CopyProgress<'_>| {
            if let CopyProgress::Rows { table, done } = step {
                steps.lock().unwrap().push((table.to_owned(), done));
            }
        };
        let moved = migrate(from, to, &note).await.unwrap();
        assert_eq!(sorted(moved.tables), before);
        let steps = steps.into_inner().unwrap();
        let of = |name: &str| -> Vec<u64> {
            steps.iter().filter(|it| it.0 == name).map(|it| it.1).collect()
        };
        assert!(of("event").len() > 5 && of("event").ends_with(&[4800, 5000]), "{:?}", of("event"));
        assert_eq!(of("policy"), [2, 3]);
    }
}

#[tokio::test]
async fn what_the_other_database_cannot_store_is_named() {
    let Some(places) = Places::new() else { return };
    let long: String = (0..9000_u32).map(|k| sha256_hex(&k.to_le_bytes()).remove(0)).collect();
    let odd = [
        ("powder, row seq", "NUL", "UPDATE powder SET name = 'a' || char(0) WHERE id = 'salt'", ""),
        (
            "table powder",
            "utf-8",
            "UPDATE powder SET name = CAST(x'ff41' AS TEXT) WHERE id = 'salt'",
            "",
        ),
        (
            "table event, one of the rows seq 1 to seq 1",
            "index",
            "INSERT INTO event (topic, kind, data, at) VALUES ($1, '', '{}', 0)",
            &long,
        ),
    ];
    for (k, (place, why, sql, text)) in odd.into_iter().enumerate() {
        let first = places.folder(&format!("first {k}"));
        let second = places.server(&format!("second {k}")).await;
        let store = open(&first).await;
        let changed = sqlx::query(sql).bind(text).execute(store.writer().unwrap()).await.unwrap();
        assert_eq!(changed.rows_affected(), 1);
        store.close().await;
        drop(store);
        let refused = migrate(&first, &second, &quiet).await.unwrap_err();
        let is_unfit = matches!(&refused, Error::Unfit { table, column, .. } if table == "powder" && column == "name");
        let said = refused.to_string();
        assert!(said.contains(place) && said.contains(why) && is_unfit == (why == "NUL"), "{said}");
        assert!(!second.folder().exists());
        let refused = Store::open_to_read(second.folder()).await;
        assert!(refused.is_err(), "nor is there a database");
    }
}

#[tokio::test]
async fn what_comes_back_otherwise_than_it_was_written_is_not_kept() {
    let Some(places) = Places::new() else { return };
    let (first, second) = (places.folder("first"), places.server("second").await);
    open(&first).await.close().await;
    crate::postgres::prepare(second.server().unwrap()).await.unwrap().close().await.unwrap();
    let mut server = url_of(&second).await;
    let change = "CREATE FUNCTION change() RETURNS TRIGGER LANGUAGE plpgsql AS \
                  $$ BEGIN NEW.name = NEW.name || ' '; RETURN NEW; END $$; \
                  CREATE TRIGGER change BEFORE INSERT ON powder FOR EACH ROW EXECUTE FUNCTION change()";
    server.execute(change).await.unwrap();
    let refused = migrate(&first, &second, &quiet).await.unwrap_err();
    let said = refused.to_string();
    assert!(said.contains("powder: 5 rows were copied, and 5 others came back"), "{said}");
    server.execute("DROP TRIGGER change ON powder").await.unwrap();
    migrate(&first, &second, &quiet).await.unwrap();
}

#[tokio::test]
async fn a_damaged_file_is_named_and_the_rest_is_copied() {
    let Some(places) = Places::new() else { return };
    let (first, second) = (places.folder("first"), places.server("second").await);
    let store = open(&first).await;
    let trace = work(&store).await;
    store.close().await;
    drop(store);
    let damaged = places.path("first").join("blobs").join(&trace[..2]).join(&trace);
    std::fs::write(damaged, b"otherwise").unwrap();
    let moved = migrate(&first, &second, &quiet).await.unwrap();
    assert_eq!((moved.files, moved.lost), (1, vec![trace]));
}

#[tokio::test]
async fn a_migration_fills_no_other_table_than_those_that_a_copy_empties() {
    let folder = tempfile::tempdir().unwrap();
    let database = folder.path().join("flip.db");
    std::fs::write(&database, b"").unwrap();
    let file = crate::sqlite::prepared(folder.path()).await.unwrap();
    crate::sqlite::migrations().run(&file).await.unwrap();
    let store = Store::open_to_read(folder.path()).await.unwrap();
    let filled = store.table_rows().await.unwrap().into_iter().filter(|it| it.rows > 0);
    let filled: Vec<_> = filled.map(|it| it.table).collect();
    assert_eq!(filled, target::FILLED_BY_MIGRATIONS);
    let side = Storage::in_folder(folder.path());
    let refused = backup_source(&side).await.unwrap_err();
    assert!(matches!(refused, Error::Unstarted(_)), "{refused:?}");
}

/// What a copy asks a source first.
async fn backup_source(side: &Storage) -> Result<()> {
    Source::beside(side).await?.check_started().await
}
