//! Consistent copies of a data folder: the database at one moment, the files it names, and all of
//! it read back.
//!
//! A backup is an ordinary data folder, and restoring is the same procedure in reverse. Neither
//! overwrites anything: the copy is made next to its destination under another name, verified, and
//! renamed in one step.

use super::artifacts::Artifacts;
use super::holds::Held;
use super::migrate::files::{self, Beside};
use super::migrate::source::Source;
use super::migrate::target::or_discard;
use super::migrate::{self, CopyProgress, Migrated};
use super::open::{archives, artifacts};
use super::sqlite::{self, DATABASE};
use super::{Error, Result, Storage, Store, now, sound};
use flip_core::domain::timestamp::Timestamp;
use serde::Serialize;
use std::fs::{self, File, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;
use tempfile::TempDir;

/// Contents of a copy, as read back.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Copied {
    /// The copy.
    pub folder: PathBuf,
    /// Size of its database.
    pub database_bytes: u64,
    /// Files next to the database, including archives of the audit trail, verified by their hashes.
    pub files: usize,
    /// Files named by the database that are missing or damaged in the original, by SHA-256, or by
    /// name for an archive: their contents are lost, and nothing else.
    pub lost: Vec<String>,
    /// The damaged archives among them: they were copied as they are, and their other parts can
    /// still be read.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub damaged: Vec<String>,
    /// Records of the audit trail.
    pub records: i64,
    /// Hash of the last one, for `flip audit verify --hash`.
    pub last_hash: String,
    /// Why the audit trail is not what was written, if so: the copy keeps it as it is.
    pub audit_broken: Option<String>,
    /// Why the bench of a restored folder is held, which adds one record.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub held: Option<String>,
    /// Tokens of the backup that were revoked in the restored data folder.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub revoked_tokens: Option<usize>,
}

/// Holder of the bench of a restored folder.
const RESTORE: &str = "flip restore";

/// Copy the data folder `from`, even while another process writes to it, to `to`, which must be
/// missing or empty.
///
/// # Errors
/// [`Error::Occupied`], [`Error::Absent`]; [`Error::Damaged`], [`Error::Newer`] of the database;
/// [`Error::Full`], [`Error::File`]. Nothing is left behind.
pub async fn copy(from: &Path, to: &Path) -> Result<Copied> {
    copy_folder(&from.into(), to).await
}

/// As [`copy()`], with artifacts from wherever they are.
async fn copy_folder(from: &Storage, to: &Path) -> Result<Copied> {
    let (beside, made) = copy_beside(from, &to.into()).await?;
    beside.put_in_place(to)?;
    Ok(Copied { folder: to.to_owned(), ..made })
}

/// As [`copy()`], from a backup to a data folder that is going to be served, including migration.
/// The database does not know what was poured since the backup, so its bench is held until a person
/// has checked; and a token that was revoked since would be valid again, so all are revoked unless
/// `keep_tokens` is set.
///
/// # Errors
/// As [`copy()`].
pub async fn restore(backup: &Path, to: &Path, keep_tokens: bool) -> Result<Copied> {
    restore_folder(backup, &to.into(), keep_tokens).await
}

/// As [`restore()`], with artifacts to wherever they shall be.
async fn restore_folder(backup: &Path, to: &Storage, keep_tokens: bool) -> Result<Copied> {
    let new = to.artifacts().check_new(&artifacts(backup)).await?;
    let restored = async {
        let (beside, made) = copy_beside(&backup.into(), to).await?;
        let (held, revoked_tokens) = make_safe(&beside.folder, backup, keep_tokens).await?;
        beside.put_in_place(to.folder())?;
        let folder = to.folder().to_owned();
        Ok(Copied { folder, held: Some(held), revoked_tokens, ..made })
    };
    or_discard(restored.await, new.as_ref()).await
}

/// Bring a copied database to this program's schema, hold its bench and revoke its tokens; returns
/// why it is held and how many were revoked.
async fn make_safe(
    folder: &Path,
    backup: &Path,
    keep_tokens: bool,
) -> Result<(String, Option<usize>)> {
    let written_at = written_at(&backup.join(DATABASE))?;
    let store = Store::open(folder).await?;
    let held = hold(&store, written_at).await?;
    let revoked = match keep_tokens {
        true => None,
        false => Some(revoke_tokens(&store).await?),
    };
    store.close().await;
    Ok((held, revoked))
}

/// As [`copy()`], of a store on either database; what is made of one on a server is an ordinary data
/// folder too, with SQLite.
///
/// # Errors
/// As [`copy()`]; [`Error::Unstarted`], [`Error::Unreachable`] and others of the server. Nothing is
/// left behind.
pub async fn copy_of(
    from: &Storage,
    to: &Path,
    progress: &(dyn Fn(CopyProgress<'_>) + Sync),
) -> Result<Copied> {
    if !from.is_on_server() {
        return copy_folder(from, to).await;
    }
    Ok(migrate::copy(Source::beside(from).await?, &to.into(), progress).await?.into())
}

/// As [`restore()`], to either database. That of a server must have no rows; they come there in one
/// transaction, with the bench held and the tokens revoked.
///
/// # Errors
/// As [`restore()`]; [`Error::Filled`], [`Error::Held`], [`Error::Unfit`], and those of the server.
/// Nothing is left behind.
pub async fn restore_to(
    backup: &Path,
    to: &Storage,
    keep_tokens: bool,
    progress: &(dyn Fn(CopyProgress<'_>) + Sync),
) -> Result<Copied> {
    if !to.is_on_server() {
        return restore_folder(backup, to, keep_tokens).await;
    }
    // Without its files, which go to their place directly.
    let temporary = std::env::temp_dir();
    let failed = |source| Error::File { path: temporary.clone(), source };
    let folder = TempDir::with_prefix("flip-").map_err(failed)?;
    let mut rows = copy_database(backup, folder.path()).await?;
    rows.archives = archives(backup);
    let found = rows.verify_audit(None).await?;
    rows.close().await;
    let (held, revoked_tokens) = make_safe(folder.path(), backup, keep_tokens).await?;
    let mut source = Source::alone(&folder.path().into()).await?;
    (source.artifacts, source.archives) = (artifacts(backup), archives(backup));
    let made = Copied::from(migrate::copy(source, to, progress).await?);
    Ok(Copied {
        held: Some(held),
        revoked_tokens,
        records: found.records,
        last_hash: found.last_hash,
        audit_broken: found.broken.map(|broken| format!("record {}: {}", broken.seq, broken.why)),
        ..made
    })
}

impl From<Migrated> for Copied {
    fn from(made: Migrated) -> Self {
        Self {
            folder: made.folder,
            database_bytes: made.database_bytes,
            files: made.files,
            lost: made.lost,
            damaged: made.damaged,
            records: made.records,
            last_hash: made.last_hash,
            audit_broken: made.audit_broken,
            held: None,
            revoked_tokens: None,
        }
    }
}

/// Revoke every token that is still valid; returns how many.
async fn revoke_tokens(store: &Store) -> Result<usize> {
    let tokens = store.every_token().await?.into_iter().map(|token| token.entry);
    let open: Vec<_> = tokens.filter(|token| token.revoked_at.is_none()).collect();
    let mut tx = store.write().await?;
    for token in &open {
        tx.revoke_token(&token.id, now()).await?;
    }
    tx.commit().await?;
    Ok(open.len())
}

async fn copy_beside(from: &Storage, to: &Storage) -> Result<(Beside, Copied)> {
    let beside = Beside::for_new(to.folder())?;
    let to_artifacts = to.artifacts_beside(&beside.folder);
    let made = fill(from, &beside.folder, &to_artifacts).await?;
    Ok((beside, made))
}

/// When a backup's database was written, according to its file.
fn written_at(database: &Path) -> Result<Timestamp> {
    let modified = fs::metadata(database).and_then(|it| it.modified());
    let modified = modified.map_err(|source| Error::File { path: database.to_owned(), source })?;
    let since_1970 = modified.duration_since(UNIX_EPOCH).unwrap_or_default();
    Ok(Timestamp::from_unix_ms(since_1970.as_millis() as i64))
}

/// Hold the bench, replacing an earlier hold; returns the reason.
async fn hold(store: &Store, backup: Timestamp) -> Result<String> {
    let mut reason = format!("restored from a backup of {backup}: look before resuming");
    if let Some(before) = store.held().await? {
        reason = format!("{reason}. It was held before: {}", before.reason);
    }
    let mut tx = store.write().await?;
    tx.resume_bench(RESTORE, "held anew", now()).await?;
    tx.hold_bench(&Held { at: now(), reason: reason.clone(), by: Some(RESTORE.to_owned()) })
        .await?;
    tx.commit().await?;
    Ok(reason)
}

/// Copy the database, check the copy and open it to read.
async fn copy_database(from: &Path, folder: &Path) -> Result<Store> {
    if !fs::metadata(from.join(DATABASE)).is_ok_and(|it| it.len() > 0) {
        return Err(Error::Absent(from.to_owned()));
    }
    let database = folder.join(DATABASE);
    let original = sqlite::to_read(from).await?;
    sqlite::copy_database(&original, &database).await?;
    original.close().await;
    let failed = |source| Error::File { path: database.clone(), source };
    fs::set_permissions(&database, Permissions::from_mode(0o600)).map_err(failed)?;
    File::open(&database).and_then(|file| file.sync_all()).map_err(failed)?;
    sound::check(&database).await?;
    Store::open_to_read(folder).await
}

/// Database first: every file it names already exists then.
async fn fill(from: &Storage, folder: &Path, to: &Artifacts) -> Result<Copied> {
    let copy = copy_database(from.folder(), folder).await?;
    from.artifacts().are_of(&copy.installation().await?).await?;
    let database = folder.join(DATABASE);
    let failed = |source| Error::File { path: database.clone(), source };
    let mut reader = copy.reader.acquire().await?;
    let from = (&from.artifacts(), &archives(from.folder()));
    let files = files::copy(&mut reader, from, (to, &archives(folder)), &|_| {}).await?;
    drop(reader);
    let found = copy.verify_audit(None).await?;
    copy.close().await;
    Ok(Copied {
        folder: folder.to_owned(),
        database_bytes: fs::metadata(&database).map_err(failed)?.len(),
        files: files.whole,
        lost: files.lost,
        damaged: files.damaged,
        records: found.records,
        last_hash: found.last_hash,
        audit_broken: found.broken.map(|broken| format!("record {}: {}", broken.seq, broken.why)),
        held: None,
        revoked_tokens: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;
    use crate::tokens::{HashedToken, Role, TokenEntry};

    async fn with_powders(folder: &Path, n: i64) -> Store {
        let store = Store::open(folder).await.unwrap();
        for k in 0..n {
            let mut tx = store.write().await.unwrap();
            tx.insert_powder(&format!("powder_{k}"), "Powder", None).await.unwrap();
            let said =
                serde_json::json!({ "powder": { "id": format!("powder_{k}"), "name": "Powder" } });
            tx.audit_deed(None, "new powder", said, Timestamp::from_unix_ms(k)).await.unwrap();
            tx.commit().await.unwrap();
        }
        store
    }

    #[tokio::test]
    async fn a_backup_while_serving_holds_every_committed_row_and_comes_back() {
        if testing::only_sqlite_has("copies of its file") {
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        let (data, kept, back) =
            (folder.path().join("data"), folder.path().join("kept"), folder.path().join("back"));
        // Open, so that everything may still be in the write-ahead log: a copy of flip.db alone had
        // 0 of 20.
        let store = with_powders(&data, 20).await;
        let made = copy(&data, &kept).await.unwrap();
        let again = copy(&kept, &back).await.unwrap();
        // Including the records of the published powders it began with.
        assert_eq!((made.records, &made.audit_broken, &made.lost), (22, &None, &Vec::new()));
        assert_eq!((&again.last_hash, again.records), (&made.last_hash, 22));
        let restored = Store::open(&back).await.unwrap();
        let count = "SELECT count(*) FROM powder WHERE id LIKE 'powder_%'";
        assert_eq!(
            sqlx::query_scalar::<_, i64>(count).fetch_one(&restored.reader).await.unwrap(),
            20
        );
        store.close().await;
        for path in [&kept, &back] {
            assert_eq!(fs::metadata(path).unwrap().permissions().mode() & 0o777, 0o700);
            assert_eq!(
                fs::metadata(path.join(DATABASE)).unwrap().permissions().mode() & 0o777,
                0o600
            );
        }
    }

    #[tokio::test]
    async fn a_restored_folder_holds_its_bench_until_a_person_resumes_and_the_backup_stays_as_it_is()
     {
        if testing::only_sqlite_has("copies of its file") {
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        let (data, kept) = (folder.path().join("data"), folder.path().join("kept"));
        let store = with_powders(&data, 3).await;
        copy(&data, &kept).await.unwrap();
        let mut tx = store.write().await.unwrap();
        tx.hold_bench(&Held { at: now(), reason: "stop was pressed".into(), by: None })
            .await
            .unwrap();
        tx.commit().await.unwrap();
        let (stopped, before) =
            (folder.path().join("stopped"), fs::read(kept.join(DATABASE)).unwrap());
        copy(&data, &stopped).await.unwrap();
        for (backup, also) in [(&kept, ""), (&stopped, "It was held before: stop was pressed")] {
            let back = folder.path().join("back").join(backup.file_name().unwrap());
            let made = restore(backup, &back, false).await.unwrap();
            let restored = Store::open(&back).await.unwrap();
            let held = restored.held().await.unwrap().expect("held");
            let at = written_at(&backup.join(DATABASE)).unwrap().to_string();
            assert!(
                held.reason.starts_with(&format!("restored from a backup of {at}: look")),
                "{}",
                held.reason
            );
            assert!(
                held.reason.ends_with(also) && made.held == Some(held.reason),
                "{:?}",
                made.held
            );
            // The hash noted at the backup is in the chain, and the hold comes after it.
            let verified = restored.verify_audit(Some(&made.last_hash)).await.unwrap();
            assert_eq!((verified.broken, verified.holds_hash), (None, Some(true)));
            assert!(verified.records > made.records);
        }
        assert_eq!(fs::read(kept.join(DATABASE)).unwrap(), before);
    }

    #[tokio::test]
    async fn a_token_that_was_revoked_after_the_backup_does_not_live_again_in_the_restored_folder()
    {
        if testing::only_sqlite_has("copies of its file") {
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let store = Store::open(&path("data")).await.unwrap();
        let mut tx = store.write().await.unwrap();
        for id in ["00", "01"] {
            let (name, role, created_at) =
                ("Ada".to_owned(), Role::Admin, Timestamp::from_unix_ms(1));
            let (expires_at, revoked_at, last_used_at) = (None, None, None);
            let id = id.to_owned();
            let entry = TokenEntry {
                id,
                name,
                role,
                may_clear: true,
                created_at,
                expires_at,
                revoked_at,
                last_used_at,
                issuer: None,
                subject: None,
            };
            tx.insert_token(&HashedToken { entry, sha256: vec![7; 32] }).await.unwrap();
        }
        tx.revoke_token("01", now()).await.unwrap();
        tx.commit().await.unwrap();
        copy(&path("data"), &path("kept")).await.unwrap();
        let mut tx = store.write().await.unwrap();
        tx.revoke_token("00", now()).await.unwrap();
        tx.commit().await.unwrap();

        let restored = restore(&path("kept"), &path("back"), false).await.unwrap();
        let as_it_was = restore(&path("kept"), &path("as_it_was"), true).await.unwrap();
        assert_eq!(
            (restored.revoked_tokens, as_it_was.revoked_tokens),
            (Some(1), None),
            "one was revoked before"
        );
        let log = fs::metadata(path("back").join("flip.db-wal")).map_or(0, |it| it.len());
        assert_eq!(log, 0, "nothing is left in a log beside the database");
        for (name, left) in [("back", 0), ("as_it_was", 1)] {
            let store = Store::open(&path(name)).await.unwrap();
            let open = store
                .every_token()
                .await
                .unwrap()
                .into_iter()
                .filter(|it| it.entry.revoked_at.is_none());
            assert_eq!(open.count(), left, "{name}");
            let found = store.verify_audit(Some(&restored.last_hash)).await.unwrap();
            assert_eq!(
                (found.broken, found.others, found.holds_hash),
                (None, Vec::new(), Some(true)),
                "{name}"
            );
        }
    }

    #[tokio::test]
    async fn a_file_that_is_gone_or_damaged_is_named_and_the_others_are_copied() {
        if testing::only_sqlite_has("copies of its file") {
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let store = Store::open(&path("data")).await.unwrap();
        let mut blobs = Vec::new();
        for text in ["whole", "damaged", "gone"] {
            let sha256 = store.artifacts().put(text.as_bytes()).await.unwrap();
            blobs.push((path("data").join("blobs").join(&sha256[..2]).join(&sha256), sha256));
        }
        let insert = "INSERT INTO job (id, kind, spec, spec_sha256, state, created_at, checkpoint) \
                      VALUES ($1, 'training', '{}', randomblob(32), 'queued', 0, $1)";
        let writer = store.writer().unwrap();
        for (_, sha256) in &blobs {
            sqlx::query(insert).bind(sha256).execute(writer).await.unwrap();
        }
        fs::write(&blobs[1].0, b"otherwise").unwrap();
        fs::remove_file(&blobs[2].0).unwrap();
        let mut made = copy(&path("data"), &path("kept")).await.unwrap();
        let mut lost = vec![blobs[1].1.clone(), blobs[2].1.clone()];
        made.lost.sort();
        lost.sort();
        assert_eq!((made.files, made.lost), (1, lost));
    }

    #[tokio::test]
    async fn nothing_is_written_over_and_nothing_is_left_behind_where_there_is_nothing_to_copy() {
        if testing::only_sqlite_has("copies of its file") {
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        let data = folder.path().join("data");
        with_powders(&data, 1).await.close().await;
        let before = fs::read(data.join(DATABASE)).unwrap();
        assert!(matches!(copy(&data, &data).await, Err(Error::Occupied(_))));
        assert_eq!(fs::read(data.join(DATABASE)).unwrap(), before);
        let none = copy(&folder.path().join("none"), &folder.path().join("copy")).await;
        assert!(matches!(none, Err(Error::Absent(_))), "{none:?}");
        fs::write(folder.path().join("file"), b"x").unwrap();
        assert!(matches!(copy(&data, &folder.path().join("file")).await, Err(Error::Occupied(_))));
        let names: Vec<_> =
            fs::read_dir(folder.path()).unwrap().map(|it| it.unwrap().file_name()).collect();
        assert_eq!(names.len(), 2, "{names:?}");
    }

    #[tokio::test]
    async fn a_damaged_database_is_not_restored() {
        if testing::only_sqlite_has("copies of its file") {
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        let data = folder.path().join("data");
        with_powders(&data, 50).await.close().await;
        let path = data.join(DATABASE);
        let mut bytes = fs::read(&path).unwrap();
        // The second half, except the last page: trees point to pages that no longer exist.
        let (from, to) = (bytes.len() / 2, bytes.len() - 4096);
        bytes[from..to].fill(0x5a);
        fs::write(&path, bytes).unwrap();
        let refused = copy(&data, &folder.path().join("copy")).await.unwrap_err();
        assert!(matches!(refused, Error::Damaged(_)), "{refused}");
        assert!(!folder.path().join("copy").exists());
    }
}
