//! The database that tests run on: the one that `FLIP_TEST_DATABASE` names, `sqlite`, which it is if
//! unset, or `postgres`.
//!
//! PostgreSQL is a private cluster of a test binary, in a temporary folder and without a port. A
//! shell waits for the end of this process, however it ends, then stops the cluster and removes the
//! folder.

pub mod cable;
pub mod disk;
pub mod s3;

use cable::Cable;
use sqlx::any::AnyPoolOptions;
use sqlx::postgres::PgConnection;
use sqlx::{Any, AnyPool, AssertSqlSafe, Connection, Transaction};
use std::collections::HashMap;
use std::io::Write;
use std::net::TcpListener;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Mutex, OnceLock, PoisonError};

/// Whether tests run on PostgreSQL.
///
/// # Panics
/// When `FLIP_TEST_DATABASE` names neither.
pub fn on_postgres() -> bool {
    match std::env::var("FLIP_TEST_DATABASE").as_deref() {
        Err(_) | Ok("" | "sqlite") => false,
        Ok("postgres") => true,
        Ok(other) => panic!("FLIP_TEST_DATABASE is sqlite or postgres, not {other}"),
    }
}

/// Whether a test is skipped, because only SQLite has what it tests.
pub fn only_sqlite_has(what: &str) -> bool {
    let is_skipped = on_postgres();
    if is_skipped {
        println!("skipped: only SQLite has {what}");
    }
    is_skipped
}

/// The address of a folder's database, if tests run on PostgreSQL: each folder has its own, which is
/// made when it is first asked for.
///
/// # Panics
/// When no cluster starts.
pub async fn database_url(data_dir: &Path) -> Option<String> {
    if !on_postgres() {
        return None;
    }
    let cluster = cluster().unwrap_or_else(|why| panic!("{why}"));
    Some(cluster.database_of(data_dir).await)
}

/// The database of a data folder, as anyone who may open it has it.
///
/// # Panics
/// When it cannot be opened.
pub async fn pool(data_dir: &Path) -> AnyPool {
    sqlx::any::install_default_drivers();
    let url = match database_url(data_dir).await {
        Some(url) => url,
        None => format!("sqlite://{}", data_dir.join("flip.db").display()),
    };
    // Writers wait for each other for five seconds, as sqlx has it for SQLite.
    AnyPoolOptions::new().max_connections(2).connect(&url).await.unwrap()
}

/// Choose who computes for TLS in this process: a client of HTTP cannot be made without.
pub fn speak_tls() {
    // A second call changes nothing.
    let _ = rustls::crypto::ring::default_provider().install_default();
}

/// The program to measure: another one, if `FLIP_BIN` names it.
pub fn program(built: &str) -> PathBuf {
    std::env::var_os("FLIP_BIN").map_or_else(|| built.into(), PathBuf::from)
}

/// SQL with bytes as SQLite writes them (`x'00'`, `zeroblob(32)`), for the database that tests run
/// on.
pub fn with_bytes(sql: &str) -> String {
    if !on_postgres() {
        return sql.to_owned();
    }
    sql.replace("zeroblob(32)", "decode(repeat('00', 32), 'hex')")
        .replace("x'00'", "decode('00', 'hex')")
}

/// A transaction that holds the lock of all writers, as another program might.
///
/// # Panics
/// When the database cannot be opened or locked.
pub async fn locked(data_dir: &Path) -> Transaction<'static, Any> {
    let pool = pool(data_dir).await;
    if !on_postgres() {
        return pool.begin_with("BEGIN IMMEDIATE").await.unwrap();
    }
    let mut begun = pool.begin().await.unwrap();
    sqlx::query("SELECT pg_advisory_xact_lock(1179404624)").execute(&mut *begun).await.unwrap();
    begun
}

/// Take a trigger away, as nobody but an administrator of the database can.
///
/// # Panics
/// When there is no such trigger.
pub async fn drop_trigger(pool: &AnyPool, trigger: &str, table: &str) {
    let of = if on_postgres() { format!(" ON {table}") } else { String::new() };
    let sql = AssertSqlSafe(format!("DROP TRIGGER {trigger}{of}"));
    sqlx::query(sql).execute(pool).await.unwrap();
}

/// The cluster that the tests of this binary share, started when it is first asked for.
///
/// # Errors
/// Why there is none.
pub fn cluster() -> Result<&'static Cluster, String> {
    static CLUSTER: OnceLock<Result<Cluster, String>> = OnceLock::new();
    CLUSTER.get_or_init(|| Cluster::start(false)).as_ref().map_err(Clone::clone)
}

/// A running cluster.
#[derive(Debug)]
pub struct Cluster {
    folder: PathBuf,
    programs: PathBuf,
    /// The number of each folder's database.
    databases: Mutex<HashMap<PathBuf, usize>>,
    _ends_with_us: Child,
}

impl Cluster {
    /// Start one that waits for the disk, or not.
    ///
    /// # Errors
    /// Why it does not start.
    pub fn start(durable: bool) -> Result<Self, String> {
        Self::start_with(durable, None)
    }

    /// Start one that can also be reached on a port of localhost, encrypted, with the certificate
    /// and the key of these PEM documents; returns the port, too.
    ///
    /// # Errors
    /// Why it does not start.
    pub fn start_encrypted(certificate: &str, key: &str) -> Result<(Self, u16), String> {
        let free = TcpListener::bind("127.0.0.1:0").and_then(|it| it.local_addr());
        let port = free.map_err(|error| error.to_string())?.port();
        Ok((Self::start_with(false, Some((port, certificate, key)))?, port))
    }

    fn start_with(durable: bool, tls: Option<(u16, &str, &str)>) -> Result<Self, String> {
        let programs = programs().ok_or(
            "PostgreSQL is not installed: initdb is neither in FLIP_POSTGRES_BIN nor in PATH nor in /usr/lib/postgresql/*/bin",
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
        let mut settings = format!(
            "-c unix_socket_directories={} -c max_connections=500 -c fsync={fsync} -c full_page_writes={fsync}",
            folder.display()
        );
        if let Some((port, certificate, key)) = tls {
            write_as_other(&data.join("server.crt"), certificate)?;
            write_as_other(&data.join("server.key"), key)?;
            settings += &format!(" -c listen_addresses=127.0.0.1 -c port={port} -c ssl=on");
        } else {
            settings += " -c listen_addresses=";
        }
        let pg_ctl = programs.join("pg_ctl").into_os_string();
        run(as_other(pg_ctl)
            .args(["-w", "-o", &settings, "start", "-l"])
            .arg(folder.join("log"))
            .arg("-D")
            .arg(&data))?;
        Ok(Self { folder, programs, databases: Mutex::default(), _ends_with_us: ends_with_us })
    }

    /// Kill the server as a crash would, and start it again.
    ///
    /// # Panics
    /// When it does not start.
    pub fn crash(&self) {
        self.restarted("immediate");
    }

    /// End the server, which rolls back what is under way, and start it again.
    ///
    /// # Panics
    /// When it does not start.
    pub fn restart(&self) {
        self.restarted("fast");
    }

    fn restarted(&self, mode: &str) {
        let pg_ctl = self.programs.join("pg_ctl").into_os_string();
        let restart = ["-w", "-m", mode, "restart", "-l"];
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

    /// A cable to the server.
    pub fn cable(&self) -> Cable {
        Cable::to(self.folder.join(".s.PGSQL.5432"))
    }

    /// The address of this folder's database, which is made when it is first asked for.
    ///
    /// # Panics
    /// When it cannot be made.
    pub async fn database_of(&self, data_dir: &Path) -> String {
        let name = {
            let mut databases = self.databases.lock().unwrap_or_else(PoisonError::into_inner);
            let next = databases.len();
            format!("flip_{}", databases.entry(data_dir.to_owned()).or_insert(next))
        };
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

/// The folder of PostgreSQL's programs: `FLIP_POSTGRES_BIN`, if set, before all others.
fn programs() -> Option<PathBuf> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let named = std::env::var_os("FLIP_POSTGRES_BIN").map(PathBuf::from);
    let installed = std::fs::read_dir("/usr/lib/postgresql").into_iter().flatten().flatten();
    let mut folders: Vec<_> = installed.map(|version| version.path().join("bin")).collect();
    folders.sort();
    named
        .into_iter()
        .chain(std::env::split_paths(&path))
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

/// Write a file that only the server's user may read.
fn write_as_other(path: &Path, text: &str) -> Result<(), String> {
    let mut writing = as_other("sh")
        .args(["-c", "umask 077; cat > \"$1\"", "sh"])
        .arg(path)
        .stdin(Stdio::piped())
        .spawn()
        .map_err(|error| format!("sh: {error}"))?;
    let written = writing.stdin.take().map(|mut it| it.write_all(text.as_bytes()));
    let done = writing.wait().map_err(|error| error.to_string())?;
    match written {
        Some(Ok(())) if done.success() => Ok(()),
        _ => Err(format!("{}: was not written", path.display())),
    }
}

/// What a command prints.
fn run(command: &mut Command) -> Result<String, String> {
    // The server lives on with the standard error of `pg_ctl`, and would keep a pipe open.
    let name = format!("{command:?}");
    let command = command.stdin(Stdio::null()).stderr(Stdio::null());
    let done = command.output().map_err(|error| format!("{name}: {error}"))?;
    let said = String::from_utf8_lossy(&done.stdout).into_owned();
    if done.status.success() { Ok(said) } else { Err(format!("{name}: {}\n{said}", done.status)) }
}
