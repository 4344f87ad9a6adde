//! A data folder of every schema there has been opens in this program and keeps its rows, and words
//! that the schema no longer lists are checked where they are read.
//!
//! `stored/NNNN.sql` holds rows as they were written under migration NNNN, at noon of day NN. A
//! folder of level N has lived through the migrations up to N, each followed by its rows.
//! `stored/checksums.txt` pins the migrations themselves: a released one never changes.

use flip_core::domain::bench_check::CheckKind;
use flip_core::domain::conditions::{Condition, Under};
use flip_core::domain::job::JobKind;
use flip_store::jobs::JobsWanted;
use flip_store::labels::Shown;
use flip_store::page::Window;
use flip_store::spoonfuls::ShakesWanted;
use flip_store::{Error, Storage, Store, backup, migrate};
use serde_json::Value;
use sqlx::migrate::Migrator;
use sqlx::sqlite::{SqliteConnectOptions, SqlitePoolOptions, SqliteSynchronous};
use sqlx::{AssertSqlSafe, SqlitePool};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Tables to which opening a folder may add rows: rows from before the audit trail go into it.
const GROW: [&str; 2] = ["audit", "stock"];

/// From this level on, the rows stored here say that rows from before the audit trail are in it.
const STOCK_TAKEN: i64 = 20;

/// The migration that removes what a queue library kept in every folder until then.
const QUEUE_GONE: i64 = 23;

fn stored(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/stored").join(name)
}

/// The migrations up to a level.
fn migrations(level: i64) -> Migrator {
    let mut migrations = sqlx::migrate!("../../migrations/sqlite");
    migrations.migrations.to_mut().retain(|migration| migration.version <= level);
    migrations.set_ignore_missing(true);
    migrations
}

/// The levels that have rows of their own, up to the newest.
fn levels() -> Vec<i64> {
    let all = migrations(i64::MAX);
    let has_rows = |level: &i64| stored(&format!("{level:04}.sql")).exists();
    all.iter().map(|migration| migration.version).filter(has_rows).collect()
}

async fn connect(folder: &Path) -> SqlitePool {
    let options = SqliteConnectOptions::new().filename(folder.join("flip.db")).foreign_keys(true);
    let options = options.synchronous(SqliteSynchronous::Off);
    let options = options.create_if_missing(true);
    SqlitePoolOptions::new().max_connections(1).connect_with(options).await.unwrap()
}

async fn run(pool: &SqlitePool, sql: impl Into<String>) {
    let sql: String = sql.into();
    sqlx::raw_sql(AssertSqlSafe(sql.clone()))
        .execute(pool)
        .await
        .unwrap_or_else(|error| panic!("{error}: {sql}"));
}

async fn texts(pool: &SqlitePool, sql: impl Into<String>) -> Vec<String> {
    sqlx::query_scalar(AssertSqlSafe(sql.into())).fetch_all(pool).await.unwrap()
}

/// A data folder of this level, with its rows.
async fn folder_of(level: i64) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let pool = connect(folder.path()).await;
    for migration in migrations(level).iter() {
        let version = migration.version;
        migrations(version).run(&pool).await.unwrap();
        let when =
            format!("UPDATE _sqlx_migrations SET installed_on = '2026-10-{version:02} 00:00:00'");
        run(&pool, format!("{when} WHERE version = {version}")).await;
        if let Ok(rows) = std::fs::read_to_string(stored(&format!("{version:04}.sql"))) {
            run(&pool, rows).await;
        }
    }
    if level < QUEUE_GONE {
        run(&pool, std::fs::read_to_string(stored("queue.sql")).unwrap()).await;
    }
    pool.close().await;
    folder
}

/// Each table's columns, and its rows as SQL literals, which tell 1 from 1.0 and from '1'.
type Rows = BTreeMap<String, (String, BTreeSet<String>)>;

async fn rows(pool: &SqlitePool) -> Rows {
    let tables = "SELECT name FROM sqlite_schema WHERE type = 'table' \
                  AND name NOT IN ('_sqlx_migrations', 'sqlite_sequence', 'Jobs', 'Workers')";
    let mut found = Rows::new();
    for table in texts(pool, tables).await {
        let columns = format!("SELECT 'quote(' || name || ')' FROM pragma_table_info('{table}')");
        let columns = texts(pool, columns).await.join(", ");
        let rows = rows_of(pool, &table, &columns).await;
        found.insert(table, (columns, rows));
    }
    found
}

async fn rows_of(pool: &SqlitePool, table: &str, columns: &str) -> BTreeSet<String> {
    let rows = texts(pool, format!("SELECT concat_ws(', ', {columns}) FROM {table}")).await;
    rows.into_iter().collect()
}

/// What this program reads from a folder: how many rows of each table.
async fn readable(store: &Store) -> Vec<(&'static str, usize)> {
    let all = || Window { limit: 200, ..Window::default() };
    let mut jobs = store.jobs(&JobsWanted::default(), all()).await.unwrap().items;
    jobs.retain(|job| job.kind != JobKind::Investigation);
    let investigations = store.whole_jobs(JobKind::Investigation, all()).await.unwrap().items;
    let (observations, _) = store.observations_after(None, 0).await.unwrap();
    let mut trials = store.all_trials("c-1").await.unwrap();
    trials.extend(store.trials("c-2", all()).await.unwrap().items);
    let wanted = ShakesWanted::default();
    let spoonfuls = store.imported_spoonfuls(&wanted, all()).await.unwrap();
    store.shaken(&wanted, all()).await.unwrap();
    let mut checks = 0;
    for kind in [CheckKind::Repeatability, CheckKind::Shakes, CheckKind::Conformance] {
        checks += usize::from(store.newest_check::<Value>(kind).await.unwrap().is_some());
    }
    store.counts().await.unwrap();
    store.pan().await.unwrap();
    store.waiting_weighings().await.unwrap();
    store.interrupted_weighings().await.unwrap();
    vec![
        ("powder", store.powders(all()).await.unwrap().items.len()),
        ("measurement", store.all_measurements(None).await.unwrap().len()),
        ("job", jobs.len() + investigations.len()),
        ("trial", trials.len()),
        ("episode", store.episodes("t-1", all()).await.unwrap().items.len()),
        ("parameter_set", store.parameter_sets(None, all()).await.unwrap().items.len()),
        ("policy", store.policies(all()).await.unwrap().items.len()),
        ("dose", store.doses::<Value>("e-1").await.unwrap().len()),
        (
            "weighing",
            store.weighings_wanted(&Default::default(), all()).await.unwrap().page.items.len(),
        ),
        ("token", store.tokens(all()).await.unwrap().items.len()),
        ("emulator_run", store.emulator_runs("em-0123456789abcdef").await.unwrap().len()),
        ("observation", observations.len()),
        ("probe", store.probes::<Value>("em-0123456789abcdef").await.unwrap().len()),
        ("simulator_version", store.simulators(all()).await.unwrap().items.len()),
        ("current_simulator", store.simulator_choices().await.unwrap().len()),
        ("bench_check", checks),
        ("event", store.events_after(None, 0, 200).await.unwrap().len()),
        ("pile", store.piles("r-1").await.unwrap().len()),
        ("spoonful", spoonfuls.len()),
        ("forgotten", store.forgotten().await.unwrap().len()),
        ("bench_reservation", usize::from(store.reservation().await.unwrap().is_some())),
    ]
}

/// Columns, references, indexes, triggers and views; not the CHECKs.
async fn structure(pool: &SqlitePool) -> BTreeSet<String> {
    let columns = "SELECT concat_ws(' ', t.name, c.cid, c.name, c.type, c.[notnull], c.dflt_value, \
                   c.pk) FROM sqlite_schema t, pragma_table_info(t.name) c WHERE t.type = 'table'";
    let references = "SELECT concat_ws(' ', t.name, f.[from], f.[table], f.[to], f.on_delete) FROM \
                      sqlite_schema t, pragma_foreign_key_list(t.name) f WHERE t.type = 'table'";
    let unique = "SELECT concat_ws(' ', t.name, i.[unique], i.origin, c.name) FROM sqlite_schema t, \
                  pragma_index_list(t.name) i, pragma_index_info(i.name) c WHERE t.type = 'table'";
    let others = "SELECT concat_ws(' ', type, tbl_name, sql) FROM sqlite_schema \
                  WHERE type <> 'table' AND sql IS NOT NULL";
    let strict = "SELECT concat_ws(' ', name, type, wr, strict) FROM pragma_table_list";
    let mut found = BTreeSet::new();
    for sql in [columns, references, unique, others, strict] {
        found.extend(texts(pool, sql).await);
    }
    found
}

#[tokio::test]
async fn a_folder_of_every_schema_opens_with_all_its_rows_and_reads() {
    let fresh = tempfile::tempdir().unwrap();
    Store::open(fresh.path()).await.unwrap().close().await;
    let schema = "SELECT concat_ws(' ', type, name, tbl_name, sql) FROM sqlite_schema ORDER BY 1";
    let newest = texts(&connect(fresh.path()).await, schema).await;
    for level in levels() {
        let folder = folder_of(level).await;
        let pool = connect(folder.path()).await;
        let before = rows(&pool).await;
        pool.close().await;
        // A row about archived records needs their file; the tests of archives have it.
        let is_filled = |(table, (_, rows)): (&String, &(String, BTreeSet<String>))| {
            !rows.is_empty() || table == "audit_away"
        };
        assert!(before.iter().all(is_filled), "{level}: a table has no row");

        let store = Store::open(folder.path()).await.unwrap();
        let pool = connect(folder.path()).await;
        for (table, (columns, rows)) in &before {
            let now = rows_of(&pool, table, columns).await;
            let grows = GROW.contains(&table.as_str()) && now.is_superset(rows);
            assert!(grows || now == *rows, "{level}, {table}:\n{rows:#?}\n{now:#?}");
        }
        assert_eq!(texts(&pool, schema).await, newest, "{level}");
        let foreign = "SELECT description FROM _sqlx_migrations WHERE version > 9999";
        assert!(texts(&pool, foreign).await.is_empty(), "{level}");
        assert_eq!(texts(&pool, "PRAGMA integrity_check").await, ["ok"], "{level}");
        let strays = "SELECT \"table\" FROM pragma_foreign_key_check";
        assert!(texts(&pool, strays).await.is_empty(), "{level}");

        for (table, read) in readable(&store).await {
            let kept = before.get(table).map_or(0, |(_, rows)| rows.len());
            assert_eq!(read, kept, "{level}: {table}");
        }
        let whole = store.verify_audit(None).await.unwrap();
        assert_eq!(whole.broken, None, "{level}");
        let latched = store.latch().await.unwrap().map(|latch| latch.reason);
        assert_eq!(latched.as_deref(), (level >= 16).then_some("a vial fell"), "{level}");
        assert_eq!(store.held().await.unwrap().is_some(), level >= 16, "{level}");
        store.close().await;
    }
}

#[tokio::test]
async fn the_policy_that_weighs_is_the_best_under_the_same_version_of_the_simulator() {
    let folder = folder_of(25).await;
    let store = Store::open(folder.path()).await.unwrap();
    let under = |humidity: Option<f64>| Under {
        simulator: "sv-0123456789abcdef".to_owned(),
        conditions: humidity
            .map(|it| ("relative_humidity_pct".to_owned(), Condition::Number(it)))
            .into_iter()
            .collect(),
    };
    let best = async |under: Option<&Under>| store.best_policy("salt", under, "p-1").await.unwrap();
    assert_eq!(best(None).await.as_deref(), Some("p-1"));
    assert_eq!(best(Some(&under(None))).await.as_deref(), Some("p-2"));
    assert_eq!(best(Some(&under(Some(65.0)))).await, None, "nothing was weighed in such air");
    let evaluated = store.policy("p-2").await.unwrap().unwrap().evaluated;
    assert!(evaluated.is_empty(), "in the base it was not: {evaluated:?}");
    store.close().await;
}

#[tokio::test]
async fn a_folder_of_an_older_schema_moves_with_all_its_rows_or_is_to_be_started_first() {
    for level in [1, STOCK_TAKEN - 2, STOCK_TAKEN, 25] {
        let folder = folder_of(level).await;
        let pool = connect(folder.path()).await;
        let (before, marked) = (rows(&pool).await, level >= STOCK_TAKEN);
        pool.close().await;
        let there = tempfile::tempdir().unwrap();
        let (from, to) = (folder.path().into(), Storage::in_folder(there.path().join("to")));
        if !marked {
            let refused = migrate::migrate(&from, &to, &|_| {}).await.unwrap_err();
            assert!(matches!(refused, Error::Unstarted(_)), "{level}: {refused:?}");
            assert!(!to.folder().exists(), "{level}");
            Store::open(folder.path()).await.unwrap().close().await;
        }
        let moved = migrate::migrate(&from, &to, &|_| {}).await.unwrap();
        assert_eq!(moved.audit_broken, None, "{level}");
        let pool = connect(to.folder()).await;
        for (table, (columns, rows)) in &before {
            let now = rows_of(&pool, table, columns).await;
            let grows = GROW.contains(&table.as_str()) && now.is_superset(rows);
            assert!(grows || now == *rows, "{level}, {table}:\n{rows:#?}\n{now:#?}");
        }
        pool.close().await;
        let left = connect(folder.path()).await;
        assert!(rows(&left).await.len() >= before.len(), "{level}: it is left as it was");
        left.close().await;
    }
}

#[tokio::test]
async fn a_folder_of_every_schema_is_examined_and_backed_up_as_it_is() {
    for level in levels() {
        let folder = folder_of(level).await;
        let pool = connect(folder.path()).await;
        let before = (rows(&pool).await, structure(&pool).await);
        pool.close().await;

        let store = Store::examine(folder.path()).await.unwrap().unwrap();
        for (table, read) in readable(&store).await {
            let kept = before.0.get(table).map_or(0, |(_, rows)| rows.len());
            assert_eq!(read, kept, "{level}: {table}");
        }
        let found = store.verify_audit(None).await.unwrap();
        assert_eq!(found.broken, None, "{level}");
        assert!(matches!(store.write().await.unwrap_err(), Error::ReadOnly), "{level}");
        store.close().await;

        let kept = tempfile::tempdir().unwrap();
        let made = backup::copy(folder.path(), kept.path()).await.unwrap();
        let records = before.0.get("audit").map_or(0, |(_, rows)| rows.len());
        assert_eq!((made.audit_broken, made.records), (None, records as i64), "{level}");
        // Neither is migrated: the way back to the older program is its backup.
        for unchanged in [folder.path(), kept.path()] {
            let pool = connect(unchanged).await;
            assert_eq!((rows(&pool).await, structure(&pool).await), before, "{level}");
            pool.close().await;
        }

        let back = kept.path().with_extension("back");
        backup::restore(kept.path(), &back, false).await.unwrap();
        let store = Store::open(&back).await.unwrap();
        assert_eq!(store.verify_audit(None).await.unwrap().broken, None, "{level}");
        store.close().await;
        std::fs::remove_dir_all(back).unwrap();
    }
}

#[tokio::test]
async fn words_leave_the_schema_and_nothing_else_does() {
    let folder = folder_of(21).await;
    let pool = connect(folder.path()).await;
    let before = structure(&pool).await;
    migrations(22).run(&pool).await.unwrap();
    let after = structure(&pool).await;
    let changed: Vec<_> = after.symmetric_difference(&before).collect();
    assert!(changed.is_empty(), "{changed:#?}");
}

#[tokio::test]
async fn jobs_of_an_older_folder_have_the_method_and_the_device_of_their_specifications() {
    let folder = folder_of(42).await;
    let pool = connect(folder.path()).await;
    run(
        &pool,
        "UPDATE job SET subject = '{\"powders\":[],\"device\":\"cuda\"}' WHERE kind = 'training'",
    )
    .await;
    migrations(i64::MAX).run(&pool).await.unwrap();
    let all = "SELECT DISTINCT concat_ws(' ', kind, method, device) FROM job ORDER BY 1";
    let found = texts(&pool, all).await;
    assert!(found.contains(&"training cuda".to_owned()), "{found:?}");
    assert!(found.contains(&"evaluation cpu".to_owned()), "{found:?}");
    assert!(found.contains(&"calibration sequential cpu".to_owned()), "{found:?}");
}

#[test]
fn released_migrations_stay_as_they_were() {
    let pinned = std::fs::read_to_string(stored("checksums.txt")).unwrap();
    let today: Vec<String> = migrations(i64::MAX)
        .iter()
        .map(|it| format!("{:04} {}", it.version, hex::encode(&it.checksum)))
        .collect();
    for line in pinned.lines() {
        assert!(today.iter().any(|it| it == line), "{line}");
    }
    assert!(levels().iter().all(|level| pinned.contains(&format!("{level:04} "))));
}

const JOB: &str = "INSERT INTO job (id, kind, spec, spec_sha256, state, owner, lease_until, result, \
                   created_at, finished_at) \
                   VALUES ('new', ?1, '{}', randomblob(32), ?2, ?3, ?4, ?5, 0, ?6)";

/// Inserts a job; `leased`, `result` and `ended` say which columns are filled.
async fn insert_job(pool: &SqlitePool, (kind, state): (&str, &str), filled: [bool; 3]) -> bool {
    let [leased, result, ended] = filled;
    let query = sqlx::query(JOB).bind(kind).bind(state);
    let query = query.bind(leased.then_some("flip-a")).bind(leased.then_some(1));
    let query = query.bind(result.then_some("{}")).bind(ended.then_some(1));
    query.execute(pool).await.is_ok()
}

#[tokio::test]
async fn what_a_known_state_says_about_its_row_is_still_enforced() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(folder.path()).await.unwrap();
    let pool = connect(folder.path()).await;
    let fits = [
        ("queued", [false, false, false]),
        ("running", [true, false, false]),
        ("succeeded", [false, true, true]),
        ("failed", [false, false, true]),
        ("cancelled", [false, false, true]),
    ];
    for (state, right) in fits {
        for bits in 0..8 {
            let filled = [bits & 1 != 0, bits & 2 != 0, bits & 4 != 0];
            let took = insert_job(&pool, ("training", state), filled).await;
            assert_eq!(took, filled == right, "{state} {filled:?}");
            run(&pool, "DELETE FROM job WHERE id = 'new'").await;
            assert!(insert_job(&pool, ("seance", "adjourned"), filled).await, "{filled:?}");
            run(&pool, "DELETE FROM job WHERE id = 'new'").await;
        }
    }
    // References are enforced too.
    let orphan = "INSERT INTO trial (job, position, body) VALUES ('x', 0, '{}')";
    assert!(sqlx::query(orphan).execute(&pool).await.is_err());
    store.close().await;
}

#[tokio::test]
async fn a_word_that_is_not_known_is_named_with_its_table_and_row() {
    let folder = folder_of(20).await;
    let store = Store::open(folder.path()).await.unwrap();
    let pool = connect(folder.path()).await;
    run(&pool, "UPDATE measurement SET method = 'oracle' WHERE id = 'm-5'").await;
    run(&pool, "UPDATE job SET kind = 'seance' WHERE id = 'c-3'").await;
    run(&pool, "UPDATE weighing SET outcome = 'perhaps' WHERE id = 'w-6'").await;
    run(&pool, "UPDATE token SET role = 'ghost' WHERE id = 'tk-4'").await;
    run(&pool, "UPDATE latch SET bench = 'dreamt' WHERE seq = 2").await;
    let all = || Window { after: None, limit: 200, shown: Shown::default() };
    let errors = [
        ("measurement m-5 method oracle", store.all_measurements(None).await.unwrap_err()),
        ("job c-3 kind seance", store.jobs(&JobsWanted::default(), all()).await.unwrap_err()),
        ("job c-3 kind seance", store.job("c-3").await.unwrap_err()),
        ("weighing w-6 outcome perhaps", store.weighing("w-6").await.unwrap_err()),
        ("token tk-4 role ghost", store.tokens(all()).await.unwrap_err()),
        ("latch 2 bench dreamt", store.latch().await.unwrap_err()),
        ("job 7 kind seance", store.counts().await.unwrap_err()),
    ];
    for (said, error) in errors {
        let text = error.to_string();
        let Error::UnknownWord { table, row, column, word } = error else { panic!("{text}") };
        assert_eq!(format!("{table} {row} {column} {word}"), said);
        assert!([table, &row, &column, &word].iter().all(|part| text.contains(*part)), "{text}");
    }
    // The rest stays readable.
    assert_eq!(store.job("c-1").await.unwrap().unwrap().job.kind, JobKind::Calibration);
    let whole = store.verify_audit(None).await.unwrap();
    assert!(whole.changed.iter().any(|changed| changed.weighing == "w-6"), "{whole:?}");
}
