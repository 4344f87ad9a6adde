//! Errors of the store, distinguished where a person can do something about them.

use sqlx::postgres::PgDatabaseError;
use std::path::PathBuf;

/// Why the store did not carry out a request.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Another process holds the data folder.
    #[error("flip serve holds this database ({0}): stop it, or ask it through its API")]
    Held(PathBuf),
    /// Another process has this bench.
    #[error(
        "bench `{bench}` is served by {machine}, heard of {heard_s} s ago: name another with --bench-name, or end that process first"
    )]
    Served {
        /// The bench.
        bench: String,
        /// The machine of its process.
        machine: String,
        /// How long ago that was last heard of, s.
        heard_s: i64,
    },
    /// This process no longer has the bench.
    #[error(
        "bench `{0}` has changed hands, or was taken for lost: this process records nothing of it any more. See who has it (`flip bench list`), look at spoon, vial and balance, then clear it there"
    )]
    Disowned(String),
    /// One process at a time moves records into archives.
    #[error(
        "another archiving of the audit trail is under way: wait until it has ended, and ask again"
    )]
    Archiving,
    /// Another program's transaction did not end in time.
    #[error(
        "another program holds the database: close it there (a database browser, a backup) and try again"
    )]
    Locked,
    /// Too many requests are already waiting.
    #[error("the database is busy: try again in a moment")]
    Busy,
    /// The disk is full.
    #[error("the disk of the data folder is full: make room there and try again")]
    Full,
    /// The disk fails.
    #[error("the disk does not take it ({0}): make room, or mend it")]
    Disk(String),
    /// The open file is no longer the one at its path.
    #[error(
        "{0} is no longer the database that is being written: it was moved, removed or replaced. Stop FLIP, put it back, and start FLIP again"
    )]
    Gone(PathBuf),
    /// The database's own structure is broken.
    #[error(
        "flip.db is damaged ({0}): nothing was changed. Put a backup in its place (`flip restore BACKUP --data-dir NEW`), or keep the folder and ask for help"
    )]
    Damaged(String),
    /// There is no database, but there are files that only a database can name.
    #[error(
        "{0} holds files but no database (flip.db is missing or empty): a wrong mount, or half of a restore? Put flip.db back (`flip restore` \
         makes a whole folder of a backup), or name another --data-dir; if the database is on a server, name it with --database-url. Nothing was changed"
    )]
    Lost(PathBuf),
    /// A folder for the files of a server's database has a database of its own.
    #[error(
        "{0} holds a database of its own (flip.db): name another --data-dir for the files of the one on the server, or leave --database-url out"
    )]
    Two(PathBuf),
    /// A copy would overwrite something.
    #[error("{0} is there already and not empty: name a folder that is not there yet")]
    Occupied(PathBuf),
    /// A copy would be mixed with rows that are there.
    #[error(
        "the database {database} holds rows already (table {table}): name an empty one, as `CREATE DATABASE` makes it. Nothing was changed"
    )]
    Filled {
        /// The database.
        database: String,
        /// The first table that has rows.
        table: String,
    },
    /// A value that the other database cannot store.
    #[error(
        "table {table}, row {row}: {column} {why}: change it where it is, and copy again. Nothing was copied"
    )]
    Unfit {
        /// The table.
        table: String,
        /// The row's key.
        row: String,
        /// The column.
        column: String,
        /// What is wrong with it.
        why: &'static str,
    },
    /// The store to be copied is not as a start of this program leaves it.
    #[error(
        "{0} is of an older FLIP, or was never started: start this FLIP with it once, and copy again"
    )]
    Unstarted(String),
    /// Workers compute jobs of the store to be copied.
    #[error(
        "workers compute jobs of {0}: stop them (`flip jobs --workers` names them), and copy again"
    )]
    Worked(String),
    /// Nothing to copy.
    #[error("{0} holds no flip.db: name a data folder, or a folder that `flip backup` made")]
    Absent(PathBuf),
    /// Made by a newer FLIP.
    #[error(
        "the database was made by a newer FLIP (it has migration {0}, which this one does not know): use that version, or a backup from before it"
    )]
    Newer(i64),
    /// A server's database that has not been brought to this program's schema.
    #[error(
        "the database was made by an older FLIP, or by none: start `flip serve` of this version on it first"
    )]
    Older,
    /// Another worker has the job, or it has ended.
    #[error("the job has been taken over or has ended")]
    Fenced,
    /// Opened read-only.
    #[error("the database was opened to read only")]
    ReadOnly,
    /// The SQLite in this program predates the fix for the reset of the write-ahead log.
    #[error("SQLite {0} is too old: 3.51.3 or newer is needed")]
    Old(String),
    /// The database's server cannot be used.
    #[error("the server of the database cannot be used: {0}")]
    Server(String),
    /// The connection to the database's server is lost, or there never was one.
    #[error("the server of the database cannot be reached ({0}): FLIP goes on when it is back")]
    Unreachable(String),
    /// Nothing that names a place for artifacts.
    #[error("{0}")]
    NoArtifacts(String),
    /// The place for artifacts is used by another database, or not empty.
    #[error("{0}")]
    ArtifactsTaken(String),
    /// The bucket does not answer, or says that it cannot now.
    #[error(
        "the artifacts in {at} cannot be reached ({why}): is AWS_ENDPOINT the address of their server, and does it run?"
    )]
    ArtifactsAway {
        /// The bucket.
        at: String,
        /// What was said instead.
        why: String,
    },
    /// The bucket refuses, or there is none.
    #[error("the artifacts in {at} cannot be used: {why}")]
    Artifacts {
        /// The bucket.
        at: String,
        /// Why.
        why: String,
    },
    /// A row holds a word that this program does not know: a kind, a state, an outcome.
    #[error(
        "table {table}, row {row}: {column} is `{word}`, which this FLIP does not know: a newer one wrote it, or it was changed outside FLIP"
    )]
    UnknownWord {
        /// The table.
        table: &'static str,
        /// The row's id, or its number if it has none.
        row: String,
        /// The column.
        column: String,
        /// The word.
        word: String,
    },
    /// The data read is not what was written.
    #[error("{0}")]
    Corrupt(String),
    /// An error of the database.
    #[error(transparent)]
    Database(sqlx::Error),
    /// An error of the file system.
    #[error("{path}: {source}")]
    File {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}

impl Error {
    /// The store has been closed.
    pub fn is_closed(&self) -> bool {
        matches!(self, Self::Database(sqlx::Error::PoolClosed))
    }

    /// What prevents recording, and what a person can do about it.
    pub fn remedy(&self) -> String {
        self.to_string()
    }

    /// Whether bytes named by a row are missing or changed: only that part is lost, nothing else.
    pub fn is_lost_part(&self) -> bool {
        matches!(self, Self::File { .. } | Self::Corrupt(_))
    }

    /// Whether a file found no room on its disk, or in its owner's share of it.
    pub fn is_full(&self) -> bool {
        use std::io::ErrorKind::{QuotaExceeded, StorageFull};
        matches!(self, Self::File { source, .. } if matches!(source.kind(), StorageFull | QuotaExceeded))
    }

    /// Whether an artifact can be written or read as it is once somebody has made room, or a bucket
    /// is there again.
    pub fn may_pass(&self) -> bool {
        self.is_full() || matches!(self, Self::ArtifactsAway { .. })
    }
}

impl From<sqlx::Error> for Error {
    fn from(error: sqlx::Error) -> Self {
        if matches!(error, sqlx::Error::PoolTimedOut) {
            return Self::Busy;
        }
        match &error {
            sqlx::Error::Tls(why) => return Self::Server(why.to_string()),
            // Its certificate is not the one that was expected: waiting mends nothing.
            sqlx::Error::Io(why) if why.kind() == std::io::ErrorKind::InvalidData => {
                return Self::Server(why.to_string());
            }
            sqlx::Error::Io(_) => return Self::Unreachable(error.to_string()),
            _ => {}
        }
        if let Some(state) = state(&error) {
            return Self::of_state(&state, error);
        }
        match primary_code(&error) {
            Some(BUSY | LOCKED) => Self::Locked,
            Some(FULL) => Self::Full,
            Some(INPUT_OUTPUT) => Self::Disk(error.to_string()),
            Some(CORRUPT | NOT_A_DATABASE) => Self::Damaged(error.to_string()),
            _ => Self::Database(error),
        }
    }
}

impl Error {
    /// Of PostgreSQL's SQLSTATE, https://www.postgresql.org/docs/current/errcodes-appendix.html.
    fn of_state(state: &str, error: sqlx::Error) -> Self {
        match state {
            // A lock was not free in time; two transactions were in each other's way.
            "55P03" | "40001" | "40P01" => Self::Locked,
            "53300" => Self::Busy,
            "53100" => Self::Full,
            "58030" => Self::Disk(error.to_string()),
            // The server follows another one.
            "25006" => Self::ReadOnly,
            // It shuts down, starts, or ended the connection.
            "25P03" | "57P01" | "57P02" | "57P03" | "57P05" => Self::Unreachable(error.to_string()),
            _ if state.starts_with("08") => Self::Unreachable(error.to_string()),
            _ => Self::Database(error),
        }
    }
}

/// The SQLSTATE of an error of PostgreSQL.
fn state(error: &sqlx::Error) -> Option<String> {
    let sqlx::Error::Database(database) = error else { return None };
    database.try_downcast_ref::<PgDatabaseError>().map(|error| error.code().to_owned())
}

// Primary result codes, https://www.sqlite.org/rescode.html.
const BUSY: i32 = 5;
const LOCKED: i32 = 6;
const INPUT_OUTPUT: i32 = 10;
const CORRUPT: i32 = 11;
const FULL: i32 = 13;
const NOT_A_DATABASE: i32 = 26;

/// SQLite's primary result code, without the extended part.
fn primary_code(error: &sqlx::Error) -> Option<i32> {
    let sqlx::Error::Database(database) = error else { return None };
    Some(database.code()?.parse::<i32>().ok()? & 0xff)
}

/// Result type of the store.
pub type Result<T> = std::result::Result<T, Error>;
