//! Seed files of each target: messages as shown in notes and manuals, hostile ones, and inputs that
//! once failed.

use crate::engine::outcome;
use std::fs;
use std::path::PathBuf;

/// Contents of a target's files, ordered by name.
pub fn read(target: &str) -> Vec<Vec<u8>> {
    let mut paths: Vec<PathBuf> = match fs::read_dir(folder(target)) {
        Ok(entries) => entries.map(|entry| entry.unwrap().path()).collect(),
        Err(error) => panic!("{}: {error}", folder(target).display()),
    };
    paths.sort();
    assert!(!paths.is_empty(), "{} is empty", folder(target).display());
    paths.iter().map(|path| fs::read(path).unwrap()).collect()
}

/// Saves an input that failed; returns its path.
pub fn keep(target: &str, input: &[u8]) -> PathBuf {
    let path = folder(target).join(format!("found-{:016x}", outcome(input)));
    fs::write(&path, input).unwrap();
    path
}

fn folder(target: &str) -> PathBuf {
    [env!("CARGO_MANIFEST_DIR"), "tests", "fuzz", "corpus", target].iter().collect()
}
