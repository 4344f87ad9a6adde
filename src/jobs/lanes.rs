//! Concurrency of jobs: trainings run alongside everything, jobs that wait for a bench too, films one
//! after another, and all others one at a time.
//!
//! The steps of a training are sequential, so a single training leaves cores idle. A calibration,
//! an evaluation or an investigation fills every core by itself, and a calibration leaves an
//! emulator that the next one needs. A film takes seconds of one core, and somebody waits for it.

use flip_core::domain::job::JobKind;
use std::sync::Arc;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// The kinds of jobs that fill a machine, one at a time, and with which others may help.
pub(super) const TURNS: [JobKind; 3] =
    [JobKind::Calibration, JobKind::Evaluation, JobKind::Investigation];

/// Which slots a job takes. Jobs of one lane start in the order in which they were requested.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lane {
    /// One job at a time, on all cores.
    Turns,
    /// Trainings.
    Trainings,
    /// Measurements on the bench.
    Bench,
    /// Films, one at a time.
    Films,
}

/// The lane of a kind of job.
pub fn lane_of(kind: JobKind) -> Lane {
    match kind {
        JobKind::Training => Lane::Trainings,
        JobKind::Repose => Lane::Bench,
        JobKind::Film => Lane::Films,
        JobKind::Calibration | JobKind::Evaluation | JobKind::Investigation => Lane::Turns,
    }
}

/// Slots for computing.
pub(super) struct Lanes {
    /// The kinds of jobs that are taken.
    kinds: Vec<JobKind>,
    turns: Arc<Semaphore>,
    trainings: Arc<Semaphore>,
    /// Maximum concurrent trainings: as many as there are cores, and at least two.
    trainings_max: u32,
    /// Slot for measurements on the bench.
    bench: Arc<Semaphore>,
    films: Arc<Semaphore>,
}

/// A slot, freed when dropped.
pub(super) type Place = OwnedSemaphorePermit;

impl Lanes {
    /// All slots free, for jobs of these kinds on so many threads.
    pub fn new(kinds: Vec<JobKind>, threads: u32) -> Self {
        let trainings_max = threads.max(2);
        let free = |places: u32| Arc::new(Semaphore::new(places as usize));
        Self {
            kinds,
            turns: free(1),
            trainings: free(trainings_max),
            trainings_max,
            bench: free(1),
            films: free(1),
        }
    }

    /// Takes a slot for a job of this kind; `None` if all are taken, or if it is none of ours.
    pub fn take(&self, kind: JobKind) -> Option<Place> {
        if !self.kinds.contains(&kind) {
            return None;
        }
        self.of(kind).clone().try_acquire_owned().ok()
    }

    /// Those of these kinds that are taken.
    pub fn kinds_among(&self, kinds: &[JobKind]) -> Vec<JobKind> {
        kinds.iter().copied().filter(|kind| self.kinds.contains(kind)).collect()
    }

    fn of(&self, kind: JobKind) -> &Arc<Semaphore> {
        match lane_of(kind) {
            Lane::Trainings => &self.trainings,
            Lane::Bench => &self.bench,
            Lane::Turns => &self.turns,
            Lane::Films => &self.films,
        }
    }

    /// Waits until nothing is computing.
    pub async fn all_free(&self) {
        // The semaphores are never closed, so all are granted.
        let _ = self.turns.acquire().await;
        let _ = self.bench.acquire().await;
        let _ = self.films.acquire().await;
        let _ = self.trainings.acquire_many(self.trainings_max).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn trainings_compute_beside_everything_and_the_rest_takes_turns() {
        let lanes = Lanes::new(JobKind::ALL.to_vec(), 3);
        let calibration = lanes.take(JobKind::Calibration).unwrap();
        assert!(lanes.take(JobKind::Evaluation).is_none());
        assert!(lanes.take(JobKind::Investigation).is_none());
        let measurement = lanes.take(JobKind::Repose).unwrap();
        assert!(lanes.take(JobKind::Repose).is_none());
        let film = lanes.take(JobKind::Film).unwrap();
        assert!(lanes.take(JobKind::Film).is_none());
        let trainings: Vec<Place> = std::iter::from_fn(|| lanes.take(JobKind::Training)).collect();
        assert_eq!(trainings.len() as u32, lanes.trainings_max);
        drop(calibration);
        assert!(lanes.take(JobKind::Evaluation).is_some());
        let waiting =
            tokio::time::timeout(std::time::Duration::from_millis(20), lanes.all_free()).await;
        assert!(waiting.is_err(), "trainings still compute");
        drop((trainings, measurement, film));
        lanes.all_free().await;
        assert!(lanes.take(JobKind::Training).is_some());
    }

    #[test]
    fn a_job_of_another_kind_is_left_for_others() {
        let lanes = Lanes::new(vec![JobKind::Calibration], 1);
        assert!(lanes.take(JobKind::Training).is_none());
        assert!(lanes.take(JobKind::Calibration).is_some());
    }
}
