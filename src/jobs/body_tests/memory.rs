//! A job's outside in memory.

use super::super::host::{Checkpoint, Finished, JobError, JobHost, Piece, Result};
use flip_core::domain::job::Progress;
use flip_core::domain::parameters::ParameterSet;
use flip_learn::calibrate::{Probe, Trial};
use flip_learn::train::EpisodeRecord;
use flip_learn::train::evaluate::Dose;
use flip_store::piles::Pile;
use std::collections::HashMap;
use std::ops::ControlFlow;
use std::sync::atomic::AtomicBool;
use std::sync::{Mutex, MutexGuard};

/// What a job has saved, and what it finds.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Kept {
    pub trials: Vec<Trial>,
    pub emulators: HashMap<String, Vec<Trial>>,
    pub probes: HashMap<String, Vec<Probe>>,
    pub episodes: Vec<EpisodeRecord>,
    /// Networks of episodes.
    pub networks: Vec<(u32, Vec<u8>)>,
    pub doses: HashMap<String, Dose>,
    pub piles: Vec<Pile>,
    /// Its bytes, or why they cannot be read.
    pub checkpoint: Option<std::result::Result<Vec<u8>, String>>,
    pub began_again: Option<String>,
    pub files: Vec<Vec<u8>>,
    pub result: Option<String>,
}

/// A job's outside in memory.
#[derive(Default)]
pub struct MemoryHost {
    kept: Mutex<Kept>,
    writes: Mutex<usize>,
    /// Number of writes after which the job is asked to stop.
    stops_after: Option<usize>,
    /// Number of writes after which another attempt has begun.
    lost_after: Option<usize>,
    held: AtomicBool,
}

impl MemoryHost {
    /// The next attempt at a job that has saved this.
    pub fn resuming(kept: Kept) -> Self {
        Self { kept: Mutex::new(kept), ..Self::default() }
    }

    /// A first attempt that is asked to stop after this many writes.
    pub fn stopping_after(writes: usize) -> Self {
        Self { stops_after: Some(writes), ..Self::default() }
    }

    /// A first attempt that has lost its lease after this many writes.
    pub fn losing_its_lease_after(writes: usize) -> Self {
        Self { lost_after: Some(writes), ..Self::default() }
    }

    pub fn kept(&self) -> MutexGuard<'_, Kept> {
        self.kept.lock().unwrap()
    }

    /// Number of writes so far.
    pub fn writes(&self) -> usize {
        *self.writes.lock().unwrap()
    }

    fn write(&self, write: impl FnOnce(&mut Kept)) -> Result<()> {
        let mut writes = self.writes.lock().unwrap();
        if self.lost_after.is_some_and(|most| *writes >= most) {
            return Err(JobError::Stopped);
        }
        *writes += 1;
        write(&mut self.kept());
        Ok(())
    }
}

impl JobHost for MemoryHost {
    fn id(&self) -> &str {
        "j"
    }

    fn flow(&self) -> ControlFlow<()> {
        match self.stops_after.is_some_and(|most| self.writes() >= most) {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        }
    }

    fn trials(&self) -> Result<Vec<Trial>> {
        Ok(self.kept().trials.clone())
    }

    fn emulator_heaps(&self, emulator: &str) -> Result<Vec<Trial>> {
        Ok(self.kept().emulators.get(emulator).cloned().unwrap_or_default())
    }

    fn probes(&self, owner: &str) -> Result<Vec<Probe>> {
        Ok(self.kept().probes.get(owner).cloned().unwrap_or_default())
    }

    fn doses(&self) -> Result<HashMap<String, Dose>> {
        Ok(self.kept().doses.clone())
    }

    fn piles(&self) -> Result<Vec<Pile>> {
        Ok(self.kept().piles.clone())
    }

    fn checkpoint(&self) -> Result<Checkpoint> {
        Ok(match self.kept().checkpoint.clone() {
            None => Checkpoint::None,
            Some(Ok(bytes)) => Checkpoint::Saved(bytes),
            Some(Err(lost)) => Checkpoint::Lost(lost),
        })
    }

    fn policy(&self, _: &str) -> Result<Option<Vec<u8>>> {
        Ok(None)
    }

    fn kept_policy(&self, _: &str) -> Result<Option<Vec<u8>>> {
        Ok(None)
    }

    fn parameter_set(&self, _: &str) -> Result<Option<ParameterSet>> {
        Ok(None)
    }

    fn latch(&self) -> Result<Option<String>> {
        Ok(None)
    }

    fn held(&self) -> &AtomicBool {
        &self.held
    }

    fn report(&self, _: &Progress) -> Result<()> {
        Ok(())
    }

    fn report_meanwhile(&self, progress: &Progress) -> Result<()> {
        self.report(progress)
    }

    fn save(&self, piece: Piece<'_>) -> Result<()> {
        self.write(|kept| match piece {
            Piece::Trial { trial, .. } => kept.trials.push(trial.clone()),
            Piece::EmulatorHeap { emulator, heap, .. } => {
                kept.emulators.entry(emulator.to_owned()).or_default().push(heap.clone());
            }
            Piece::Probe { owner, probe } => {
                kept.probes.entry(owner.to_owned()).or_default().push(probe.clone());
            }
            Piece::Episodes(episodes) => kept.episodes.extend_from_slice(episodes),
            Piece::Kept { episode, policy } => kept.networks.push((episode, policy.to_vec())),
            Piece::CheckpointLost(why) => kept.began_again = Some(why.to_owned()),
            Piece::Dose { key, dose } => {
                let before = kept.doses.insert(key.to_owned(), *dose);
                assert!(before.is_none(), "{key} was weighed twice");
            }
            Piece::Pile { pile, .. } => kept.piles.extend(pile.cloned()),
        })
    }

    fn save_checkpoint(&self, bytes: &[u8]) -> Result<()> {
        self.write(|kept| kept.checkpoint = Some(Ok(bytes.to_vec())))
    }

    fn put(&self, bytes: &[u8]) -> Result<String> {
        self.kept().files.push(bytes.to_vec());
        Ok(format!("file {}", self.kept().files.len()))
    }

    fn finish(&self, finished: &Finished<'_>) -> Result<()> {
        let result = finished.document()?;
        self.write(|kept| kept.result = Some(result))
    }
}
