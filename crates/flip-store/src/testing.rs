//! A store for a test, on the database that `FLIP_TEST_DATABASE` names: `sqlite`, which it is if
//! unset, or `postgres`.
//!
//! PostgreSQL is a private cluster of this test binary, in a temporary folder and without a port. A
//! shell waits for the end of this process, however it ends, then stops the cluster and removes the
//! folder.

use super::{Result, Store};
use sqlx::postgres::PgConnection;
use sqlx::{AssertSqlSafe, Connection};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;

/// Whether tests run on PostgreSQL.
pub(super) fn on_postgres() -> bool {
    match std::env::var("FLIP_TEST_DATABASE").as_deref() {
        Err(_) | Ok("" | "sqlite") => false,
        Ok("postgres") => true,
        Ok(other) => panic!("FLIP_TEST_DATABASE is sqlite or postgres, not {other}"),
    }
}

/// Whether a test is left out, because only SQLite has what it tests.
pub(super) fn only_sqlite_has(what: &str) -> bool {
    let left_out = on_postgres();
    if left_out {
        println!("left out on PostgreSQL: only SQLite has {what}");
    }
    left_out
}

/// Open the store of this data folder; on PostgreSQL each folder has a database of its own.
pub(super) async fn open(data_dir: &Path) -> Result<Store> {
    if !on_postgres() {
        return Store::open(data_dir).await;
    }
    let cluster = cluster().unwrap_or_else(|why| panic!("{why}"));
    Store::open_on(&cluster.database_of(data_dir).await, data_dir).await
}

/// Take a trigger away, as nobody but an administrator of the database can.
pub(super) async fn drop_trigger(store: &Store, trigger: &str, table: &str) {
    let of = if on_postgres() { format!(" ON {table}") } else { String::new() };
    let sql = AssertSqlSafe(format!("DROP TRIGGER {trigger}{of}"));
    sqlx::query(sql).execute(store.writer().unwrap()).await.unwrap();
}

/// The cluster that the tests of this binary share, started when it is first asked for.
///
/// # Errors
/// Why there is none.
pub(super) fn cluster() -> std::result::Result<&'static Cluster, String> {
    static CLUSTER: OnceLock<std::result::Result<Cluster, String>> = OnceLock::new();
    CLUSTER.get_or_init(|| Cluster::start(false)).as_ref().map_err(Clone::clone)
}

/// A running cluster.
pub(super) struct Cluster {
    folder: PathBuf,
    programs: PathBuf,
    _ends_with_us: Child,
}

impl Cluster {
    /// Start one that waits for the disk, or not.
    ///
    /// # Errors
    /// Why it does not start.
    pub fn start(durable: bool) -> std::result::Result<Self, String> {
        let programs = programs().ok_or(
            "PostgreSQL is not installed: initdb is neither in PATH nor in /usr/lib/postgresql/*/bin",
        )?;
        let made = run(as_other("mktemp").args(["-d", "/tmp/flip-postgres-XXXXXX"]))?;
        let folder = PathBuf::from(made.trim());
        let data = folder.join("data");
        // The shell first: whatever fails from here on leaves nothing behind.
        let ends_with_us = as_other("sh")
            .arg("-c")
            .arg("read -r _; \"$1/pg_ctl\" -D \"$2/data\" -m immediate stop; rm -rf \"$2\"")
            .arg("sh")
            .args([&programs, &folder])
            // Not stopped by the Ctrl-C that stops the tests.
            .process_group(0)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .map_err(|error| format!("sh: {error}"))?;
        let initdb = programs.join("initdb").into_os_string();
        let options = ["-U", "flip", "-A", "trust", "-E", "UTF8", "--locale=C", "--no-sync", "-D"];
        run(as_other(initdb).args(options).arg(&data))?;
        let fsync = if durable { "on" } else { "off" };
        let settings = format!(
            "-c listen_addresses= -c unix_socket_directories={} -c max_connections=500 \
             -c fsync={fsync} -c full_page_writes={fsync}",
            folder.display()
        );
        let pg_ctl = programs.join("pg_ctl").into_os_string();
        run(as_other(pg_ctl)
            .args(["-w", "-o", &settings, "start", "-l"])
            .arg(folder.join("log"))
            .arg("-D")
            .arg(&data))?;
        Ok(Self { folder, programs, _ends_with_us: ends_with_us })
    }

    /// Kill the server as a crash would, and start it again.
    pub fn crash(&self) {
        let pg_ctl = self.programs.join("pg_ctl").into_os_string();
        let restart = ["-w", "-m", "immediate", "restart", "-l"];
        run(as_other(pg_ctl)
            .args(restart)
            .arg(self.folder.join("log"))
            .arg("-D")
            .arg(self.folder.join("data")))
        .unwrap();
    }

    /// The address of a database.
    pub fn address(&self, database: &str) -> String {
        format!("postgres://flip@localhost/{database}?host={}", self.folder.display())
    }

    /// The address of this folder's database, which is made when it is first asked for.
    pub async fn database_of(&self, data_dir: &Path) -> String {
        let hash = super::artifacts::sha256_hex(data_dir.as_os_str().as_encoded_bytes());
        let name = format!("flip_{}", &hash[..32]);
        let mut server = PgConnection::connect(&self.address("postgres")).await.unwrap();
        let there = "SELECT EXISTS (SELECT 1 FROM pg_database WHERE datname = $1)";
        let there: bool =
            sqlx::query_scalar(there).bind(&name).fetch_one(&mut server).await.unwrap();
        if !there {
            let made = sqlx::query(AssertSqlSafe(format!("CREATE DATABASE {name}")));
            made.execute(&mut server).await.unwrap();
        }
        server.close().await.unwrap();
        self.address(&name)
    }
}

/// The folder of PostgreSQL's programs.
fn programs() -> Option<PathBuf> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let installed = std::fs::read_dir("/usr/lib/postgresql").into_iter().flatten().flatten();
    let mut folders: Vec<_> = installed.map(|version| version.path().join("bin")).collect();
    folders.sort();
    std::env::split_paths(&path)
        .chain(folders.into_iter().rev())
        .find(|folder| folder.join("initdb").exists() && folder.join("pg_ctl").exists())
}

/// A command that does not run as root, which PostgreSQL refuses.
fn as_other(program: impl AsRef<std::ffi::OsStr>) -> Command {
    let mut command;
    if rustix::process::geteuid().is_root() {
        command = Command::new("runuser");
        command.args(["-u", "postgres", "--"]).arg(program);
    } else {
        command = Command::new(program);
    }
    command.current_dir("/tmp");
    command
}

/// What a command prints.
fn run(command: &mut Command) -> std::result::Result<String, String> {
    // The server lives on with the standard error of `pg_ctl`, and would keep a pipe open.
    let name = format!("{command:?}");
    let command = command.stdin(Stdio::null()).stderr(Stdio::null());
    let done = command.output().map_err(|error| format!("{name}: {error}"))?;
    let said = String::from_utf8_lossy(&done.stdout).into_owned();
    if done.status.success() { Ok(said) } else { Err(format!("{name}: {}\n{said}", done.status)) }
}
