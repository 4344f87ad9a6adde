//! `flip backup` and `flip restore`: complete copies of a data folder, even while a server runs.

use super::Common;
use super::failure::Failure;
use super::session::runtime;
use crate::app::{BackupError, Copied, Who, acting, back_up, restore};
use std::path::PathBuf;

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
    /// be empty.
    #[arg(value_name = "BACKUP")]
    from: PathBuf,
    /// Keep the tokens as they are in the backup, even those revoked since. Without it all are
    /// revoked; `flip token create` makes new ones.
    #[arg(long)]
    keep_tokens: bool,
}

/// Copies the data folder.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    let made = runtime()?.block_on(back_up(&common.data_dir, &arguments.to))?;
    common.print(&made, || text(&made))
}

/// Restores a data folder from a backup.
pub(super) fn run_restore(common: &Common, arguments: &RestoreArguments) -> Result<(), Failure> {
    let restored = restore(&arguments.from, &common.data_dir, arguments.keep_tokens);
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
