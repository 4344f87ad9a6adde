//! A small disk of its own that can be full.

use std::fs::{self, File};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Its size.
const SIZE: &str = "size=64m";
/// How much is written at a time to fill it, bytes.
const CHUNK: usize = 1 << 16;

/// A disk of memory, mounted at a folder until it is dropped.
#[derive(Debug)]
pub struct Disk {
    folder: PathBuf,
    ballast: Option<File>,
}

impl Disk {
    /// Mount one at this folder.
    ///
    /// # Errors
    /// Why there is none: only root may mount, and not everywhere.
    pub fn mounted(folder: &Path) -> Result<Self, String> {
        fs::create_dir_all(folder).map_err(|error| error.to_string())?;
        let mut mount = Command::new("mount");
        mount.args(["-t", "tmpfs", "-o", SIZE, "flip-disk"]).arg(folder);
        let said = mount.output().map_err(|error| format!("mount: {error}"))?;
        match said.status.success() {
            true => Ok(Self { folder: folder.to_owned(), ballast: None }),
            false => Err(String::from_utf8_lossy(&said.stderr).trim().to_owned()),
        }
    }

    /// Take all the room that there is, to the last byte. What somebody frees later is free again
    /// until this is called once more.
    ///
    /// # Errors
    /// Anything but a full disk.
    pub fn fill(&mut self) -> io::Result<()> {
        let ballast = match &mut self.ballast {
            Some(ballast) => ballast,
            none => none.insert(File::create(self.folder.join("ballast"))?),
        };
        for chunk in [CHUNK, 1] {
            loop {
                match ballast.write(&vec![0; chunk]) {
                    Ok(_) => {}
                    Err(error) if error.kind() == ErrorKind::StorageFull => break,
                    Err(error) => return Err(error),
                }
            }
        }
        Ok(())
    }

    /// Free what was taken.
    ///
    /// # Errors
    /// The file cannot be removed.
    pub fn make_room(&mut self) -> io::Result<()> {
        match self.ballast.take() {
            Some(_) => fs::remove_file(self.folder.join("ballast")),
            None => Ok(()),
        }
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        // Lazily: a file that is still open somewhere holds up nothing.
        let _ = Command::new("umount").arg("--lazy").arg(&self.folder).status();
    }
}
