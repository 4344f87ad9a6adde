//! `flip backup` and `flip restore`: complete copies of what is stored, even while a server runs;
//! `flip migrate` to another database.

use super::Common;
use super::failure::Failure;
use super::session::runtime;
use super::with_artifacts;
use crate::app::{
    BackupError, Copied, CopyProgress, Migrated, Storage, Who, acting, back_up, move_store, restore,
};
use flip_core::domain::FieldError;
use std::io::Write;
use std::path::PathBuf;
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// Arguments of `flip backup`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Folder to create; must not exist yet, or be empty.
    #[arg(value_name = "DIR")]
    to: PathBuf,
}

/// Arguments of `flip restore`.
#[derive(Debug, clap::Args)]
pub(super) struct RestoreArguments {
    /// Backup made by `flip backup`. It is restored to `--data-dir`, which must not exist yet, or
    /// be empty; and to the database of `--database-url` and the place of `--artifacts` if there is
    /// one, which must be empty.
    #[arg(value_name = "BACKUP")]
    from: PathBuf,
    /// Keep the tokens as they are in the backup, even those revoked since. Without it all are
    /// revoked; `flip token create` makes new ones.
    #[arg(long)]
    keep_tokens: bool,
}

/// Arguments of `flip migrate`.
#[derive(Debug, clap::Args)]
pub(super) struct MigrateArguments {
    /// A data folder, or a database such as postgres://flip@db.lab/flip, that nobody serves.
    #[arg(long, value_name = "DIR|URL")]
    from: String,
    /// An empty database, or a folder that must not exist yet, or be empty.
    #[arg(long, value_name = "DIR|URL")]
    to: String,
    /// Where the artifacts of the side that is a folder are, if not in it: a path, file:///path or
    /// s3://bucket/prefix, as `--artifacts` is for the side on a server. If both name the same, they
    /// stay there and are read once.
    #[arg(long, value_name = "DIR|URL")]
    folder_artifacts: Option<String>,
}

impl MigrateArguments {
    /// Both sides. The files of the one on a server are in the data folder, or where `--artifacts`
    /// says.
    fn sides(&self, common: &Common) -> Result<(Storage, Storage), Failure> {
        let is_url = |side: &str| side.contains("://");
        let (artifacts, folder_artifacts) =
            (common.artifacts.as_deref(), self.folder_artifacts.as_deref());
        let side = |field: &'static str, side: &str| match is_url(side) {
            true => {
                let storage = Storage::on_server(side, &common.data_dir)
                    .map_err(|error| FieldError::new(field, error.to_string()))?;
                with_artifacts(storage, "artifacts", artifacts)
            }
            false => with_artifacts(Storage::in_folder(side), "folder_artifacts", folder_artifacts),
        };
        if is_url(&self.from) == is_url(&self.to) {
            let why = "one side is a data folder, the other a database on a server; `flip backup` and `flip restore` copy between two of a kind";
            return Err(FieldError::new("to", why).into());
        }
        Ok((side("from", &self.from)?, side("to", &self.to)?))
    }
}

/// Moves what is stored between a data folder and a server.
pub(super) fn run_migrate(common: &Common, arguments: &MigrateArguments) -> Result<(), Failure> {
    let (from, to) = arguments.sides(common)?;
    let told = Told::default();
    let tell = |progress: CopyProgress<'_>| told.tell(progress);
    let made = runtime()?.block_on(move_store(&from, &to, &tell))?;
    common.print(&made, || migrated_text(&made, &to))
}

fn migrated_text(made: &Migrated, to: &Storage) -> String {
    let rows: u64 = made.tables.iter().map(|table| table.rows).sum();
    let mut text = format!(
        "{to} holds all of it: {rows} rows of {} tables, {} files, {} records, as read back\nlast hash {}",
        made.tables.len(),
        made.files,
        made.records,
        made.last_hash
    );
    if !made.lost.is_empty() {
        text += &format!("\nfiles already lost before: {}", made.lost.join(", "));
    }
    if let Some(why) = &made.audit_broken {
        text += &format!("\nits audit trail is kept as it is, and is not what was written: {why}");
    }
    text
}

/// Says on stderr how far a long copy is.
#[derive(Default)]
struct Told(Mutex<Option<Instant>>);

impl Told {
    fn tell(&self, progress: CopyProgress<'_>) {
        const EVERY: Duration = Duration::from_secs(2);
        let Ok(mut last) = self.0.lock() else { return };
        let last = last.get_or_insert_with(Instant::now);
        if last.elapsed() < EVERY {
            return;
        }
        *last = Instant::now();
        let said = match progress {
            CopyProgress::Files { done, of } => format!("{done} of {of} files"),
            CopyProgress::Rows { table, done } => format!("{done} rows of {table}"),
            CopyProgress::ReadingBack => "reading all of it back".to_owned(),
        };
        // Nobody who reads it is no reason to stop.
        drop(writeln!(std::io::stderr(), "{said}"));
    }
}

/// Copies the data folder.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    let storage = common.storage()?;
    let told = Told::default();
    let tell = |progress: CopyProgress<'_>| told.tell(progress);
    let copied = back_up(&storage, &arguments.to, &tell);
    let made = runtime()?.block_on(copied)?;
    common.print(&made, || text(&made))
}

/// Restores a data folder, or a database on a server, from a backup.
pub(super) fn run_restore(common: &Common, arguments: &RestoreArguments) -> Result<(), Failure> {
    let storage = common.storage()?;
    let told = Told::default();
    let tell = |progress: CopyProgress<'_>| told.tell(progress);
    let restored = restore(&arguments.from, &storage, arguments.keep_tokens, &tell);
    let made = runtime()?.block_on(acting(Who::command_line(), restored))?;
    common.print(&made, || text(&made))
}

fn text(made: &Copied) -> String {
    let Copied {
        folder,
        database_bytes,
        files,
        lost,
        damaged,
        records,
        last_hash,
        audit_broken,
        held,
        revoked_tokens,
    } = made;
    let is_intact = lost.is_empty() && audit_broken.is_none();
    let copy = if is_intact { "an intact copy" } else { "a copy of what is no longer intact" };
    let mut text = format!(
        "{} holds {copy}: {database_bytes} bytes of database, {files} files, {records} records\nlast hash {last_hash}",
        folder.display()
    );
    let gone: Vec<&str> =
        lost.iter().filter(|file| !damaged.contains(file)).map(String::as_str).collect();
    if !gone.is_empty() {
        text += &format!(
            "\n{} files that it names were already lost in the original: {}",
            gone.len(),
            gone.join(", ")
        );
    }
    if !damaged.is_empty() {
        text += &format!(
            "\n{} archives were already damaged in the original and were copied as they are: {}",
            damaged.len(),
            damaged.join(", ")
        );
    }
    if let Some(why) = audit_broken {
        text += &format!("\nits audit trail is kept as it is, and is not what was written: {why}");
    }
    if let Some(why) = held {
        text += &format!(
            "\nthe bench is held, {why} (`flip bench resume`, after a look at `flip bench status`)"
        );
    }
    match revoked_tokens {
        Some(0) | None => {}
        Some(count) => {
            text += &format!(
                "\n{count} tokens of the backup are revoked, because it does not know which were revoked since it was made: `flip token create` makes new \
                 ones (--keep-tokens leaves them)"
            );
        }
    }
    text
}

impl From<BackupError> for Failure {
    fn from(error: BackupError) -> Self {
        match error {
            BackupError::Refused(message) => Self::NotNow(message),
            BackupError::Failed(message) => Self::Failed(anyhow::anyhow!(message)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_copy_of_what_is_damaged_or_gone_is_not_called_intact() {
        let intact = Copied {
            folder: "kept".into(),
            database_bytes: 4096,
            files: 1,
            lost: Vec::new(),
            damaged: Vec::new(),
            records: 9,
            last_hash: "00".into(),
            audit_broken: None,
            held: None,
            revoked_tokens: None,
        };
        assert!(text(&intact).starts_with("kept holds an intact copy"), "{}", text(&intact));
        let (gone, bad) = ("audit/1.jsonl.gz".to_owned(), "audit/2.jsonl.gz".to_owned());
        let poorer = text(&Copied { lost: vec![gone, bad.clone()], damaged: vec![bad], ..intact });
        assert!(!poorer.contains("an intact copy"), "{poorer}");
        assert!(
            poorer.contains(
                "1 files that it names were already lost in the original: audit/1.jsonl.gz\n"
            ),
            "{poorer}"
        );
        assert!(
            poorer.contains(
                "already damaged in the original and were copied as they are: audit/2.jsonl.gz"
            ),
            "{poorer}"
        );
    }
}
