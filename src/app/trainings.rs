//! Trainings: from parameter sets to a policy.

use super::check::Check;
use super::jobs::{corrupt, specification, stored};
use super::{App, Error, Result};
use crate::jobs::spoon::measured;
use crate::jobs::train::{
    Extended, Gradients, Level, Order, PAPER_LEVELS_DEG, Preset, SETS_PER_LEVEL, Settings,
    TrainingResult,
};
use crate::jobs::{JobSpec, TrainingSpec, can_compute, simulator_on};
use flip_core::domain::FieldError;
use flip_core::domain::conditions::{Conditions, Patch, Under};
use flip_core::domain::device::Device;
use flip_core::domain::job::JobKind;
use flip_core::domain::labels::Labels;
use flip_core::domain::spoon::Spoon;
use flip_policy as policy;
use flip_store::jobs::{Job, JobRow};
use flip_store::page::{Page, PageQuery, SERIES_LIMIT_MAX};
use flip_store::parameter_sets::CalibratedSet;
use flip_store::trials::Episode;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The powders of the default curriculum, from most to least flowable.
const POWDERS: [&str; 3] = ["sand", "sugar", "salt"];
/// Maximum number of powders in one training.
const POWDERS_MAX: usize = 20;
/// Maximum number of episodes in one training.
const EPISODES_MAX: u32 = 20_000;
/// Number of days in a training under an extended simulator, drawn as seen in its campaign.
const DAYS: usize = 64;
/// Maximum number of episodes that a crash may cost, apart from whole rounds.
const EPISODES_PER_CHECKPOINT: u32 = 4;
/// Episodes of a round on a card: a step of a few doses takes it as long as one of a hundred.
const EPISODES_PER_ROUND_ON_CARD: u32 = 32;

/// What to train. Everything has a default.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainingRequest {
    /// Order of the levels.
    #[serde(default)]
    pub order: Order,
    /// Preset of settings.
    #[serde(default)]
    pub preset: Preset,
    /// Episodes, 1 to 20000; default the preset's: 4800 for `flip`, 4000 for `paper`.
    pub episodes: Option<u32>,
    /// Number of these run first on a fast model of the spoon instead of the simulator, 0 to all;
    /// default four fifths for `flip`, none for `paper`.
    pub surrogate_episodes: Option<u32>,
    /// Powders whose calibrated sets are the levels; default `sand`, `sugar`, `salt`. Not with the
    /// `paper` preset.
    pub powders: Option<Vec<String>>,
    /// Learnt policy of the same preset to continue from, e.g. to adapt it to a simulator version;
    /// default an untrained one. With it the default is 720 episodes, none of them on the
    /// surrogate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from: Option<String>,
    /// What simulates: the processor, or a graphics card of this process or of a worker. The same
    /// training on a card gives another policy: it plays 32 episodes a round instead of 4.
    #[serde(default, skip_serializing_if = "Device::is_cpu")]
    pub device: Device,
    /// What computes the gradients of updates: libtorch, or FLIP's own code, whose bits are the same
    /// on every processor and which on a card makes the updates there. The policies differ. Default
    /// `libtorch` on the processor, `fused` on a card.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gradients: Option<Gradients>,
    /// Seed; default 1.
    pub seed: Option<u64>,
    /// Extended simulator version, `sv-…`; default the base.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub simulator: Option<String>,
    /// Conditions held fixed in every episode; the others are drawn for each as seen in the
    /// version's campaign.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub conditions: Conditions,
    /// Shake as the bench's arm was measured to shake (`flip bench calibrate-shake`); default as in
    /// the simulator. The surrogate ignores it.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub as_calibrated: bool,
    /// The spoon used for dosing; default FLIP's own, which holds about 40 mg. The surrogate
    /// ignores it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spoon: Option<Spoon>,
    /// What the caller writes on it, to find it again.
    #[serde(default, skip_serializing_if = "Labels::is_empty")]
    pub labels: Labels,
}

/// A training: its job, its levels, and its policy once it has succeeded.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Training {
    /// The job; the training has the same id.
    pub job: Job,
    /// Order of the levels.
    pub order: Order,
    /// Preset it started from.
    pub preset: Preset,
    /// Episodes it may use.
    pub episodes: u32,
    /// The levels.
    pub levels: Vec<TrainingLevel>,
    /// The extended simulator version and the conditions given; absent for the base.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub under: Option<Under>,
    /// What it simulates on; absent for the processor.
    #[serde(default, skip_serializing_if = "Device::is_cpu")]
    pub device: Device,
    /// Every setting.
    pub settings: serde_json::Value,
    /// Episodes, from 1, whose network is kept, in order: a film shows a dose with it. The last of a
    /// training that has succeeded is its policy's.
    #[serde(default)]
    pub kept_episodes: Vec<u32>,
    /// Result; absent until it has succeeded.
    pub result: Option<TrainingResult>,
}

/// One level of a training.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrainingLevel {
    /// Powder id, or `repose_<angle>` for a bare angle.
    pub powder: String,
    /// Angle of repose the sets are calibrated to, degrees.
    pub repose_deg: f64,
    /// Ids of the parameter sets.
    pub sets: Vec<String>,
}

impl App {
    /// Queues a training. `false`: the same one was requested before, and this is its job.
    ///
    /// # Errors
    /// `Invalid`; `Conflict` (`calibration_missing`) if a level has no parameter sets yet.
    pub async fn start_training(&self, request: TrainingRequest) -> Result<(Job, bool)> {
        let mut settings = settings_of(&request)?;
        if let Some(from) = &request.from {
            self.check_predecessor(from, &settings).await?;
        }
        if let Some(spoon) = &request.spoon {
            settings.spoon = measured(spoon, settings.spoon)?;
        }
        if request.as_calibrated {
            settings.spoon = settings.spoon.as_executed(&self.shakes().await?);
        }
        // Before anybody calibrates for what would be refused then.
        can_compute(request.device, &settings.spoon)?;
        self.check_device(JobKind::Training, request.device).await?;
        let extended = self.extended(request.simulator.as_deref(), &request.conditions).await?;
        let simulator = extended.as_ref().map(|(under, _)| under.simulator.as_str());
        let levels = match (settings.order, settings.preset) {
            // Draws from the whole published box: there are no levels.
            (Order::DomainRandomisation, _) => Vec::new(),
            (_, Preset::Flip) => {
                self.levels_of_powders(request.powders.as_deref(), simulator).await?
            }
            (_, Preset::Paper) => self.published_levels().await?,
        };
        if let Some((under, extended)) = extended {
            let days =
                extended.days(&under.conditions, DAYS, settings.seed).map_err(Error::Invalid)?;
            let of = |powder: Option<&str>| -> Result<Vec<Patch>> {
                days.iter().map(|day| extended.at(powder, day).map_err(Error::Invalid)).collect()
            };
            let own =
                levels.iter().map(|level| Ok((level.powder.clone(), of(Some(&level.powder))?)));
            settings.extended =
                Some(Extended { days: of(None)?, powders: own.collect::<Result<_>>()?, under });
            settings = settings.checked()?;
        }
        let (device, simulator) = (request.device, simulator_on(request.device));
        let spec = TrainingSpec { levels, settings, device, goes_on_from: None, simulator };
        self.queue(JobSpec::Training(spec), request.labels).await
    }

    /// Refuses a policy that this training cannot continue from before it waits in the queue.
    async fn check_predecessor(&self, id: &str, settings: &Settings) -> Result<()> {
        let refuse = |message: String| Error::from(FieldError::new("from", message));
        let found = self.policy_bytes(id).await;
        let bytes = found.map_err(|error| match error {
            Error::NotFound { .. } => refuse(format!("there is no policy `{id}`")),
            error => error,
        })?;
        let policy = policy::decode(&bytes).map_err(|error| Error::Internal(error.into()))?;
        if policy.manifest.kind == settings.policy_kind() {
            Ok(())
        } else {
            Err(refuse(format!(
                "`{id}` must be a policy trained with the same preset; it is {}",
                policy.manifest.kind.name()
            )))
        }
    }

    async fn levels_of_powders(
        &self,
        powders: Option<&[String]>,
        simulator: Option<&str>,
    ) -> Result<Vec<Level>> {
        let powders = match powders {
            Some(powders) => powders.to_vec(),
            None => POWDERS.map(str::to_owned).to_vec(),
        };
        let mut levels = Vec::new();
        for (k, id) in powders.iter().enumerate() {
            let powder = self.powder_of(&format!("powders[{k}]"), id).await?;
            let sets = self.calibrated_sets(Some(id), 0.0, simulator).await?.ok_or_else(|| {
                let advice = format!(
                    "powder {} or POST /v1/calibrations, and train when it has succeeded",
                    without_sets(id, simulator)
                );
                Error::conflict("calibration_missing", advice)
            })?;
            // Under an extended version the sets are those of its reference conditions, not of the
            // day of the measurement.
            let measured = powder.flowability.filter(|_| simulator.is_none()).map(|f| f.repose_deg);
            levels.push(level(powder.id, measured, &sets));
        }
        Ok(levels)
    }

    /// Levels at bare angles: the paper's curriculum does not consist of powders.
    async fn published_levels(&self) -> Result<Vec<Level>> {
        let mut levels = Vec::new();
        for repose_deg in PAPER_LEVELS_DEG {
            let sets = self.calibrated_sets(None, repose_deg, None).await?.ok_or_else(|| {
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

    /// The sets from the newest successful calibration of a powder, or of a bare angle; under a
    /// simulator version, `None` being the base. None, too, if that calibration reached its target with
    /// no set: there is then nothing to train on or to weigh.
    pub(super) async fn calibrated_sets(
        &self,
        powder: Option<&str>,
        repose_deg: f64,
        simulator: Option<&str>,
    ) -> Result<Option<Vec<CalibratedSet>>> {
        let newest = self.store().newest_calibration(powder, repose_deg, simulator).await?;
        let Some(calibration) = newest else { return Ok(None) };
        let sets = self.store().sets_of_calibration(&calibration).await?;
        Ok((!sets.is_empty()).then_some(sets))
    }

    /// One training.
    pub async fn training(&self, id: &str) -> Result<Training> {
        let row = self.store().job(id).await?.filter(|row| row.job.kind == JobKind::Training);
        let row = self.placed(row.ok_or_else(|| Error::not_found("training", id))?).await?;
        let mut trainings = [training(row)?];
        self.add_kept(&mut trainings).await?;
        let [training] = trainings;
        Ok(training)
    }

    /// Adds the episodes whose networks were kept to what the trainings are.
    async fn add_kept(&self, trainings: &mut [Training]) -> Result<()> {
        let ids: Vec<&str> = trainings.iter().map(|it| it.job.id.as_str()).collect();
        let kept = self.store().kept_episodes(&ids).await?;
        for training in trainings {
            let own = kept.iter().filter(|(of, ..)| *of == training.job.id);
            let last = training.result.as_ref().map(|result| result.episodes);
            training.kept_episodes = own.map(|(_, episode, _)| *episode).chain(last).collect();
        }
        Ok(())
    }

    /// Trainings, newest first.
    pub async fn trainings(&self, page: PageQuery) -> Result<Page<Training>> {
        let mut found = self.jobs_as(JobKind::Training, page, training).await?;
        self.add_kept(&mut found.items).await?;
        Ok(found)
    }

    /// Episodes of a training in order; up to 5000 per page.
    pub async fn training_episodes(
        &self,
        training: &str,
        page: PageQuery,
    ) -> Result<Page<Episode>> {
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
                format!(
                    "must name 1 to {POWDERS_MAX} powders, each once; leave it out for the default"
                ),
            );
        }
        if request.preset == Preset::Paper || request.order == Order::DomainRandomisation {
            check.refuse(
                "powders",
                "cannot be given with the `paper` preset or `domain-randomisation`: leave it out",
            );
        }
    }
    check.done()?;
    let mut settings = Settings::of(request.preset, request.order, request.seed.unwrap_or(1));
    if let Some(from) = &request.from {
        settings = settings.going_on_from(from.clone());
    }
    settings.episodes = request.episodes.unwrap_or(settings.episodes);
    if !request.device.is_cpu() && settings.preset == Preset::Flip {
        settings.episodes_per_round = EPISODES_PER_ROUND_ON_CARD;
    }
    settings.gradients = request.gradients.unwrap_or(match request.device {
        // What stored trainings were made with.
        Device::Cpu => Gradients::Libtorch,
        Device::Cuda => Gradients::Fused,
    });
    settings.surrogate_episodes =
        request.surrogate_episodes.unwrap_or_else(|| settings.surrogate_by_default());
    // Episodes take seconds of work, a checkpoint a fraction of one.
    let rounds = (EPISODES_PER_CHECKPOINT / settings.episodes_per_round).max(1);
    settings.rounds_per_checkpoint = settings.rounds_per_checkpoint.min(rounds);
    Ok(settings.checked()?)
}

/// The error for a powder without sets, with the command that finds some.
pub(super) fn without_sets(powder: &str, simulator: Option<&str>) -> String {
    let (of, with) = simulator
        .map_or_else(Default::default, |id| (format!(" under {id}"), format!(" --simulator {id}")));
    format!("`{powder}` has no parameter set{of}: run `flip calibrate --powder {powder}{with}`")
}

fn level(powder: String, repose_deg: Option<f64>, sets: &[CalibratedSet]) -> Level {
    let mean = sets.iter().map(|set| set.repose_deg).sum::<f64>() / sets.len().max(1) as f64;
    let sets = sets.iter().take(SETS_PER_LEVEL).map(|set| set.parameters).collect();
    Level { powder, repose_deg: repose_deg.unwrap_or(mean), sets }
}

fn training(row: JobRow) -> Result<Training> {
    let JobSpec::Training(spec) = specification(&row)? else {
        return Err(corrupt("a training's specification"));
    };
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
        device: spec.device,
        under: spec.settings.extended.as_ref().map(|extended| extended.under.clone()),
        settings: serde_json::to_value(spec.settings)
            .map_err(|error| Error::Internal(error.into()))?,
        kept_episodes: Vec::new(),
        result: row.result.as_deref().map(stored).transpose()?,
    })
}
