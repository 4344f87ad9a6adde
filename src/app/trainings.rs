//! Trainings: from parameter sets to a policy.

use super::{App, Result};
use crate::store::jobs::Job;
use crate::store::page::{Page, PageQuery};
use crate::store::trials::Episode;
use serde::{Deserialize, Serialize};

/// In which order a training meets the powders.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Order {
    /// From the lowest angle of repose to the highest, moving on when the errors are small.
    #[default]
    Curriculum,
    /// Levels shuffled once.
    Random,
    /// From the highest angle to the lowest.
    Reverse,
    /// A level drawn anew for every episode.
    DomainRandomisation,
}

/// Which collection of settings a training starts from.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// FLIP's own: episodes end near the target.
    #[default]
    Flip,
    /// As published: exactly ten steps, levels at 28, 33 and 37 degrees.
    Paper,
}

/// What to train. Everything has a default.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct TrainingRequest {
    /// Order of the levels.
    #[serde(default)]
    pub order: Order,
    /// Collection of settings.
    #[serde(default)]
    pub preset: Preset,
    /// Episodes, 1 to 20000; default 4000 (the full budget).
    pub episodes: Option<u32>,
    /// Powders whose calibrated sets are the levels; default `sand`, `sugar`, `salt`. Not with the `paper` preset.
    pub powders: Option<Vec<String>>,
    /// Seed; default 1.
    pub seed: Option<u64>,
}

/// A training: its job, its levels, and once it has succeeded its policy.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Training {
    /// The job; the training has the same id.
    pub job: Job,
    /// Order of the levels.
    pub order: Order,
    /// Collection of settings it started from.
    pub preset: Preset,
    /// Episodes it may use.
    pub episodes: u32,
    /// The levels.
    pub levels: Vec<TrainingLevel>,
    /// Every setting.
    #[schema(value_type = Object)]
    pub settings: serde_json::Value,
    /// What came out; absent until it has succeeded.
    pub result: Option<TrainingResult>,
}

/// One level of a training.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct TrainingLevel {
    /// Powder id, or `repose_<angle>` for a bare angle.
    pub powder: String,
    /// Angle of repose the sets are calibrated to, degrees.
    pub repose_deg: f64,
    /// Ids of the parameter sets.
    pub sets: Vec<String>,
}

/// What a training produced.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct TrainingResult {
    /// Policy id.
    pub policy: String,
    /// Episodes used.
    pub episodes: u32,
    /// Mean absolute error of the last 20 episodes, mg.
    pub final_error_mg: f64,
    /// Curriculum history: one entry for each level that was entered.
    #[schema(value_type = Vec<Object>)]
    pub levels: Vec<serde_json::Value>,
}

impl App {
    /// Queue a training. `false`: the same one was asked for before, and this is its job.
    pub async fn start_training(&self, _request: TrainingRequest) -> Result<(Job, bool)> {
        self.stub()
    }

    /// One training.
    pub async fn training(&self, _id: &str) -> Result<Training> {
        self.stub()
    }

    /// Trainings, newest first.
    pub async fn trainings(&self, _page: PageQuery) -> Result<Page<Training>> {
        self.stub()
    }

    /// Episodes of a training in order; pages of up to 5000.
    pub async fn training_episodes(&self, _training: &str, _page: PageQuery) -> Result<Page<Episode>> {
        self.stub()
    }
}
