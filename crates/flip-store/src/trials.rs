//! The trials of calibrations and the episodes of trainings: series that grow while their job runs.

use super::page::{Page, Window};
use super::row::{Columns, json};
use super::{Result, Store, Tx};
use flip_core::domain::parameters::ParameterSet;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// Why a calibration simulated a heap.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TrialPhase {
    /// To find candidates.
    Search,
    /// To check a candidate with a fresh seed.
    Verification,
}

/// One simulated heap of a calibration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Trial {
    /// Position in the calibration, from 0.
    pub index: u32,
    /// Why it was simulated.
    pub phase: TrialPhase,
    /// Index of the search trial with these parameters; its own for a search trial.
    pub candidate: u32,
    /// The nine values.
    pub parameters: ParameterSet,
    /// Seed of the simulation.
    pub seed: u64,
    /// Number of readings of the heap, over which its angles are averaged.
    #[serde(default = "one")]
    pub readings: u32,
    /// Angle of repose by the tip formula, degrees; absent when the heap has none.
    pub tip_deg: Option<f64>,
    /// Standard deviation of that angle over the readings, degrees; absent for one reading.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tip_sd_deg: Option<f64>,
    /// Slope of the fitted cone, degrees.
    pub cone_deg: Option<f64>,
    /// Creep of the resting heap, degrees per second.
    pub creep_deg_per_s: Option<f64>,
    /// Why the heap has no angle.
    pub refusal: Option<String>,
    /// Absolute difference to the target, degrees.
    pub error_deg: Option<f64>,
    /// Wall-clock time of the simulation, s; the only value here that differs between two runs of
    /// the same calibration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seconds: Option<f64>,
}

fn one() -> u32 {
    1
}

/// One simulated dose of a training.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Episode {
    /// Position in the training, from 0.
    pub index: u32,
    /// Curriculum level, from 0.
    pub level: u32,
    /// Powder of the level.
    pub powder: String,
    /// Id of the parameter set it was simulated with.
    pub parameter_set: String,
    /// Target mass, mg.
    pub target_mg: f64,
    /// True mass in the vial at the end, mg.
    pub dispensed_mg: f64,
    /// Absolute difference between target and true mass at the end, mg.
    pub final_error_mg: f64,
    /// Sum of rewards.
    pub reward: f64,
    /// Steps taken.
    pub steps: u32,
    /// Entropy temperature; absent, like the losses, before the first update.
    pub alpha: Option<f64>,
    /// Mean critic loss over the updates that followed its round.
    pub critic_loss: Option<f64>,
    /// Mean actor loss over the updates that followed its round.
    pub actor_loss: Option<f64>,
}

impl Store {
    /// Trials of a calibration, in order.
    pub async fn trials(&self, job: &str, window: Window) -> Result<Page<Trial>> {
        let sql = "SELECT position AS seq, body FROM trial WHERE job = $1 AND position > $2 ORDER BY position LIMIT $3";
        self.series(sql, job, window).await
    }

    /// Every trial of a calibration, in order: the history to resume from.
    pub async fn all_trials(&self, job: &str) -> Result<Vec<Trial>> {
        let rows = sqlx::query("SELECT body FROM trial WHERE job = $1 ORDER BY position").bind(job);
        rows.fetch_all(&self.reader).await?.iter().map(|row| row.json("body")).collect()
    }

    /// Every heap of an emulator so far, in order.
    pub async fn emulator_runs(&self, emulator: &str) -> Result<Vec<Trial>> {
        let rows =
            sqlx::query("SELECT body FROM emulator_run WHERE emulator = $1 ORDER BY position")
                .bind(emulator);
        rows.fetch_all(&self.reader).await?.iter().map(|row| row.json("body")).collect()
    }

    /// Simulations of an observable so far, in order.
    pub async fn probes<T: DeserializeOwned>(&self, owner: &str) -> Result<Vec<T>> {
        let rows =
            sqlx::query("SELECT body FROM probe WHERE owner = $1 ORDER BY position").bind(owner);
        rows.fetch_all(&self.reader).await?.iter().map(|row| row.json("body")).collect()
    }

    /// Episodes of a training, in order.
    pub async fn episodes(&self, job: &str, window: Window) -> Result<Page<Episode>> {
        let sql = "SELECT position AS seq, body FROM episode WHERE job = $1 AND position > $2 ORDER BY position LIMIT $3";
        self.series(sql, job, window).await
    }

    async fn series<T: DeserializeOwned>(
        &self,
        sql: &'static str,
        job: &str,
        window: Window,
    ) -> Result<Page<T>> {
        let rows = sqlx::query(sql)
            .bind(job)
            .bind(window.after())
            .bind(window.rows())
            .fetch_all(&self.reader)
            .await?;
        window.page_of(&rows, |row| row.json("body"))
    }
}

impl Tx {
    /// Append a trial. The key rejects one that is already stored.
    pub async fn insert_trial(&mut self, job: &str, trial: &Trial) -> Result<()> {
        let sql = "INSERT INTO trial (job, position, body) VALUES ($1, $2, $3)";
        sqlx::query(sql)
            .bind(job)
            .bind(i64::from(trial.index))
            .bind(json(trial)?)
            .execute(&mut *self.inner)
            .await?;
        Ok(())
    }

    /// Append a heap to an emulator. The key rejects one that is already stored.
    pub async fn insert_emulator_run(&mut self, emulator: &str, run: &Trial) -> Result<()> {
        let sql = "INSERT INTO emulator_run (emulator, position, body) VALUES ($1, $2, $3)";
        sqlx::query(sql)
            .bind(emulator)
            .bind(i64::from(run.index))
            .bind(json(run)?)
            .execute(&mut *self.inner)
            .await?;
        Ok(())
    }

    /// Append a simulation of an observable. The key rejects one that is already stored.
    pub async fn insert_probe<T: Serialize>(
        &mut self,
        owner: &str,
        position: u32,
        body: &T,
    ) -> Result<()> {
        let sql = "INSERT INTO probe (owner, position, body) VALUES ($1, $2, $3)";
        sqlx::query(sql)
            .bind(owner)
            .bind(i64::from(position))
            .bind(json(body)?)
            .execute(&mut *self.inner)
            .await?;
        Ok(())
    }

    /// Append an episode; `false` if it is already stored, as happens when a training resumes and
    /// replays the episodes after its last checkpoint.
    pub async fn insert_episode(&mut self, job: &str, episode: &Episode) -> Result<bool> {
        let sql =
            "INSERT INTO episode (job, position, body) VALUES ($1, $2, $3) ON CONFLICT DO NOTHING";
        let done = sqlx::query(sql)
            .bind(job)
            .bind(i64::from(episode.index))
            .bind(json(episode)?)
            .execute(&mut *self.inner)
            .await?;
        Ok(done.rows_affected() == 1)
    }
}
