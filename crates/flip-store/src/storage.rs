//! Where everything is stored.

use super::artifacts::{Artifacts, Patience};
use super::benches::DEFAULT_BENCH;
use super::{Result, open, postgres};
use sqlx::any::AnyConnectOptions;
use std::fmt;
use std::path::{Path, PathBuf};

/// Where everything is stored: a folder for files, and a database in it or on a server of
/// PostgreSQL.
#[derive(Clone)]
pub struct Storage {
    folder: PathBuf,
    server: Option<AnyConnectOptions>,
    /// `None`: in the folder.
    artifacts: Option<Artifacts>,
    /// The bench that a process serves there; `None`: the one that needs no name.
    bench: Option<String>,
}

impl Storage {
    /// All in one folder.
    pub fn in_folder(folder: impl Into<PathBuf>) -> Self {
        Self { folder: folder.into(), server: None, artifacts: None, bench: None }
    }

    /// A database at an address like `postgres://user@host/flip`; files in the folder.
    ///
    /// # Errors
    /// [`Error::Server`](super::Error::Server) if this is no such address.
    pub fn on_server(database_url: &str, folder: impl Into<PathBuf>) -> Result<Self> {
        let server = Some(postgres::address(database_url)?);
        Ok(Self { folder: folder.into(), server, artifacts: None, bench: None })
    }

    /// As it is, with artifacts in another folder (a path, or `file:///srv/flip`), or in a bucket
    /// (`s3://bucket/prefix`) whose server and keys the environment names as for Amazon's own
    /// programs: `AWS_ENDPOINT`, `AWS_REGION`, `AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY` and
    /// others. Nothing is read or written yet.
    ///
    /// # Errors
    /// [`Error::NoArtifacts`](super::Error::NoArtifacts) if this is no such place;
    /// [`Error::Artifacts`](super::Error::Artifacts) if a variable is wrong or missing.
    pub fn with_artifacts(self, address: &str) -> Result<Self> {
        // Others than those in UTF-8 are no settings of S3.
        let variables = std::env::vars_os().filter_map(|(name, value)| {
            Some((name.into_string().ok()?, value.into_string().ok()?))
        });
        let artifacts = Artifacts::at(address, variables, Patience::default())?;
        Ok(self.with_artifacts_in(artifacts))
    }

    pub(super) fn with_artifacts_in(self, artifacts: Artifacts) -> Self {
        Self { artifacts: Some(artifacts), ..self }
    }

    /// Whether artifacts are elsewhere than in the folder.
    pub fn has_artifacts_elsewhere(&self) -> bool {
        self.artifacts.is_some()
    }

    /// Where the artifacts are.
    pub fn artifacts(&self) -> Artifacts {
        self.artifacts_beside(&self.folder)
    }

    /// As [`Self::artifacts`], while the data folder is at another path.
    pub(super) fn artifacts_beside(&self, folder: &Path) -> Artifacts {
        self.artifacts.clone().unwrap_or_else(|| open::artifacts(folder))
    }

    /// The same, served with the bench of this name.
    pub fn with_bench(self, name: impl Into<String>) -> Self {
        Self { bench: Some(name.into()), ..self }
    }

    /// The name of the bench that a process serves there.
    pub fn bench(&self) -> &str {
        self.bench.as_deref().unwrap_or(DEFAULT_BENCH)
    }

    /// The folder for files.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Whether the database is on a server.
    pub fn is_on_server(&self) -> bool {
        self.server.is_some()
    }

    /// Whether the database is on a server and has this program's schema.
    ///
    /// # Errors
    /// [`Error::Server`](super::Error::Server), [`Error::Newer`](super::Error::Newer),
    /// [`Error::Unreachable`](super::Error::Unreachable).
    pub async fn is_served_ready(&self) -> Result<bool> {
        match &self.server {
            Some(address) => postgres::has_schema(address).await,
            None => Ok(false),
        }
    }

    pub(super) fn server(&self) -> Option<&AnyConnectOptions> {
        self.server.as_ref()
    }
}

impl From<&Path> for Storage {
    fn from(folder: &Path) -> Self {
        Self::in_folder(folder)
    }
}

impl From<&PathBuf> for Storage {
    fn from(folder: &PathBuf) -> Self {
        Self::in_folder(folder)
    }
}

impl From<&Storage> for Storage {
    fn from(storage: &Storage) -> Self {
        storage.clone()
    }
}

impl fmt::Display for Storage {
    /// The folder, or the address of the database without its options, which may hold a password.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(server) = &self.server else { return self.folder.display().fmt(f) };
        let mut url = server.database_url.clone();
        // Of an address that can have none.
        let _ = url.set_password(None);
        url.set_query(None);
        url.fmt(f)
    }
}

impl fmt::Debug for Storage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.artifacts {
            None => write!(f, "Storage({self})"),
            Some(artifacts) => write!(f, "Storage({self}, {artifacts})"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Error, Store};
    use flip_testing::Cluster;

    #[test]
    fn a_password_is_never_shown_and_another_database_is_refused() {
        let url = "postgres://flip:secret@db.lab:5433/flip?password=secret&sslmode=require";
        let storage = Storage::on_server(url, "files").unwrap();
        for shown in [storage.to_string(), format!("{storage:?}")] {
            assert!(shown.contains("postgres://flip@db.lab:5433/flip"), "{shown}");
            assert!(!shown.contains("secret"), "{shown}");
        }
        for none in ["mysql://root@localhost/x", "flip.db", "postgres//x", ""] {
            let refused = Storage::on_server(none, "files");
            assert!(matches!(refused, Err(Error::Server(_))), "{none}: {refused:?}");
        }
    }

    #[tokio::test]
    async fn a_connection_is_encrypted_and_a_server_with_another_certificate_is_refused() {
        let made = || rcgen::generate_simple_self_signed(vec!["localhost".to_owned()]).unwrap();
        let (ours, other) = (made(), made());
        let key = ours.signing_key.serialize_pem();
        let started = Cluster::start_encrypted(&ours.cert.pem(), &key);
        let (_cluster, port) = match started {
            Ok(started) => started,
            Err(why) => return println!("skipped: {why}"),
        };
        let folder = tempfile::tempdir().unwrap();
        let on = async |name: &str, certificate: &str| {
            let file = folder.path().join(name);
            std::fs::write(&file, certificate).unwrap();
            let url = format!(
                "postgres://flip@localhost:{port}/postgres?sslmode=verify-full&sslrootcert={}",
                file.display()
            );
            let storage = Storage::on_server(&url, folder.path().join("data")).unwrap();
            Store::open(storage).await
        };
        let refused = on("other.pem", &other.cert.pem()).await.err();
        assert!(matches!(refused, Some(Error::Server(_))), "{refused:?}");
        let store = on("ours.pem", &ours.cert.pem()).await.unwrap();
        let sql = "SELECT ssl FROM pg_stat_ssl WHERE pid = pg_backend_pid()";
        let encrypted: bool =
            sqlx::query_scalar(sql).fetch_one(store.writer().unwrap()).await.unwrap();
        assert!(encrypted);
    }
}
