//! The clocks of machines, which can be set.

use anyhow::{Context, Result};
use std::fs;
use std::io::ErrorKind;
use std::path::PathBuf;
use std::process::Command;

/// Clocks of machines, each with a process of FLIP, by the name of its bench or worker.
#[derive(Clone)]
pub(super) struct Clocks {
    library: PathBuf,
    folder: PathBuf,
}

impl Clocks {
    /// Fails with the reason where libfaketime is missing.
    pub fn in_folder(folder: PathBuf) -> Result<Self> {
        let found = fs::read_dir("/usr/lib").into_iter().flatten().flatten();
        let library = found
            .map(|it| it.path().join("faketime/libfaketimeMT.so.1"))
            .find(|it| it.exists())
            .context("libfaketime is not installed (the package faketime)")?;
        fs::create_dir_all(&folder)?;
        Ok(Self { library, folder })
    }

    fn file(&self, machine: &str) -> PathBuf {
        self.folder.join(machine)
    }

    /// How far a machine's clock is ahead, s.
    pub fn ahead_s(&self, machine: &str) -> Result<i64> {
        match fs::read_to_string(self.file(machine)) {
            Ok(said) => Ok(said.trim().parse()?),
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(0),
            Err(error) => Err(error.into()),
        }
    }

    /// Sets a machine's clock, whose processes notice it within a second.
    pub fn set(&self, machine: &str, ahead_s: i64) -> Result<()> {
        let (file, new) = (self.file(machine), self.folder.join("new"));
        fs::write(&new, format!("{ahead_s:+}\n"))?;
        Ok(fs::rename(new, file)?)
    }

    /// Lets a process go by its machine's clock. Its steady clock goes on as it does, and files
    /// have the time of the machine that keeps them.
    pub fn give(&self, machine: &str, process: &mut Command) -> Result<()> {
        self.set(machine, self.ahead_s(machine)?)?;
        process
            .env("LD_PRELOAD", &self.library)
            .env("FAKETIME_TIMESTAMP_FILE", self.file(machine))
            .env("FAKETIME_CACHE_DURATION", "1")
            .env("FAKETIME_DONT_FAKE_MONOTONIC", "1")
            .env("NO_FAKE_STAT", "1");
        Ok(())
    }
}
