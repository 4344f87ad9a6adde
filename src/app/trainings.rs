//! Trainings: from parameter sets to a policy.

use super::check::Check;
use super::jobs::{corrupt, stored};
use super::{App, Error, Result};
use crate::domain::job::JobKind;
use crate::jobs::train::{Level, Order, PAPER_LEVELS_DEG, Preset, SETS_PER_LEVEL, Settings, TrainingResult};
use crate::jobs::{JobSpec, SIMULATOR, TrainingSpec};
use crate::store::jobs::{Job, JobRow};
use crate::store::page::{Page, PageQuery, SERIES_LIMIT_MAX};
use crate::store::parameter_sets::CalibratedSet;
use crate::store::trials::Episode;
use serde::{Deserialize, Serialize};

/// The powders of the default curriculum, from the most to the least flowable.
const POWDERS: [&str; 3] = ["sand", "sugar", "salt"];
/// Most powders in one training.
const POWDERS_MAX: usize = 20;
/// Most episodes in one training.
const EPISODES_MAX: u32 = 20_000;
/// Most episodes that a crash may cost, whole rounds apart.
const EPISODES_PER_CHECKPOINT: u32 = 4;

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
    /// Episodes, 1 to 20000; default the preset's: 4800 of ours, 4000 of the paper's.
    pub episodes: Option<u32>,
    /// Of these, the first on a fast model of the spoon instead of the simulator, 0 to all; default four fifths of ours, none of the paper's.
    pub surrogate_episodes: Option<u32>,
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

impl App {
    /// Queue a training. `false`: the same one was asked for before, and this is its job.
    ///
    /// # Errors
    /// `Invalid`; `Conflict` (`calibration_missing`) when a level has no parameter sets yet.
    pub async fn start_training(&self, request: TrainingRequest) -> Result<(Job, bool)> {
        let settings = settings_of(&request)?;
        let levels = match (settings.order, settings.preset) {
            // Draws from the whole published box: there are no levels.
            (Order::DomainRandomisation, _) => Vec::new(),
            (_, Preset::Flip) => self.levels_of_powders(request.powders.as_deref()).await?,
            (_, Preset::Paper) => self.published_levels().await?,
        };
        let spec = TrainingSpec { levels, settings, simulator: SIMULATOR.to_owned() };
        Ok(self.jobs_or_refuse()?.enqueue(&JobSpec::Training(spec)).await?)
    }

    async fn levels_of_powders(&self, powders: Option<&[String]>) -> Result<Vec<Level>> {
        let powders = match powders {
            Some(powders) => powders.to_vec(),
            None => POWDERS.map(str::to_owned).to_vec(),
        };
        let mut levels = Vec::new();
        for (k, id) in powders.iter().enumerate() {
            let powder = self.powder_of(&format!("powders[{k}]"), id).await?;
            let sets = self.calibrated_sets(Some(id), 0.0).await?.ok_or_else(|| {
                let advice = format!(
                    "powder `{id}` has no parameter set: run `flip calibrate --powder {id}` or POST /v1/calibrations, \
                     and train when it has succeeded"
                );
                Error::conflict("calibration_missing", advice)
            })?;
            let measured = powder.flowability.map(|f| f.repose_deg);
            levels.push(level(powder.id, measured, &sets));
        }
        Ok(levels)
    }

    /// Levels at bare angles: the paper's curriculum is not of powders.
    async fn published_levels(&self) -> Result<Vec<Level>> {
        let mut levels = Vec::new();
        for repose_deg in PAPER_LEVELS_DEG {
            let sets = self.calibrated_sets(None, repose_deg).await?.ok_or_else(|| {
                let advice = format!(
                    "the `paper` preset trains at {repose_deg} deg, and nothing is calibrated to that: \
                     POST /v1/calibrations {{\"repose_deg\": {repose_deg}}}, or let `flip train --preset paper` do it"
                );
                Error::conflict("calibration_missing", advice)
            })?;
            levels.push(level(format!("repose_{repose_deg}"), Some(repose_deg), &sets));
        }
        Ok(levels)
    }

    /// What the newest successful calibration of a powder, or of a bare angle, kept.
    pub(super) async fn calibrated_sets(
        &self,
        powder: Option<&str>,
        repose_deg: f64,
    ) -> Result<Option<Vec<CalibratedSet>>> {
        let Some(calibration) = self.store().newest_calibration(powder, repose_deg).await? else { return Ok(None) };
        Ok(Some(self.store().sets_of_calibration(&calibration).await?))
    }

    /// One training.
    pub async fn training(&self, id: &str) -> Result<Training> {
        let row = self.store().job(id).await?.filter(|row| row.job.kind == JobKind::Training);
        training(row.ok_or_else(|| Error::not_found("training", id))?)
    }

    /// Trainings, newest first.
    pub async fn trainings(&self, page: PageQuery) -> Result<Page<Training>> {
        self.jobs_as(JobKind::Training, page, training).await
    }

    /// Episodes of a training in order; pages of up to 5000.
    pub async fn training_episodes(&self, training: &str, page: PageQuery) -> Result<Page<Episode>> {
        self.training(training).await?;
        Ok(self.store().episodes(training, page.window(SERIES_LIMIT_MAX)?).await?)
    }
}

fn settings_of(request: &TrainingRequest) -> Result<Settings> {
    let mut check = Check::default();
    if let Some(episodes) = request.episodes {
        check.count("episodes", episodes, 1, EPISODES_MAX);
    }
    if let Some(powders) = &request.powders {
        let mut unique = powders.clone();
        unique.sort();
        unique.dedup();
        if powders.is_empty() || powders.len() > POWDERS_MAX || unique.len() < powders.len() {
            check.refuse(
                "powders",
                format!("must name 1 to {POWDERS_MAX} powders, each once; leave it out for the default"),
            );
        }
        if request.preset == Preset::Paper || request.order == Order::DomainRandomisation {
            check.refuse("powders", "does not go with the `paper` preset or `domain-randomisation`: leave it out");
        }
    }
    check.done()?;
    let mut settings = Settings::of(request.preset, request.order, request.seed.unwrap_or(1));
    settings.episodes = request.episodes.unwrap_or(settings.episodes);
    settings.surrogate_episodes = request.surrogate_episodes.unwrap_or_else(|| settings.surrogate_by_default());
    // Episodes are seconds of work, a checkpoint is a fraction of one.
    let rounds = (EPISODES_PER_CHECKPOINT / settings.episodes_per_round).max(1);
    settings.rounds_per_checkpoint = settings.rounds_per_checkpoint.min(rounds);
    Ok(settings.checked()?)
}

fn level(powder: String, repose_deg: Option<f64>, sets: &[CalibratedSet]) -> Level {
    let mean = sets.iter().map(|set| set.repose_deg).sum::<f64>() / sets.len().max(1) as f64;
    let sets = sets.iter().take(SETS_PER_LEVEL).map(|set| set.parameters).collect();
    Level { powder, repose_deg: repose_deg.unwrap_or(mean), sets }
}

fn training(row: JobRow) -> Result<Training> {
    let JobSpec::Training(spec) = stored(&row.spec)? else { return Err(corrupt("a training's specification")) };
    let level = |level: Level| TrainingLevel {
        powder: level.powder,
        repose_deg: level.repose_deg,
        sets: level.sets.iter().map(|set| set.id()).collect(),
    };
    Ok(Training {
        job: row.job,
        order: spec.settings.order,
        preset: spec.settings.preset,
        episodes: spec.settings.episodes,
        levels: spec.levels.into_iter().map(level).collect(),
        settings: serde_json::to_value(spec.settings).map_err(|error| Error::Internal(error.into()))?,
        result: row.result.as_deref().map(stored).transpose()?,
    })
}
