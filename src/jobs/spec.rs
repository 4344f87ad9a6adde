//! Specifications of jobs: everything that the result depends on, and nothing else.
//!
//! A stored text is a content address, so a specification is written in the lowest version that has
//! its fields, and those of version 1 as they always were: fields that were added to it are omitted
//! where they are usual. Texts of later versions begin with their number, so that a program that
//! does not know them refuses them by it.
//!
//! | version | adds | its absence means |
//! |---|---|---|
//! | 2 | `substep_us` of an evaluation's conditions | the usual substep, 80 us |
//! | 2 | `fixed` of a calibration's settings | all nine parameters are searched |
//! | 2 | `patch` of a calibration | spoons are observed as the base simulates them |
//! | 2 | `shakes` of an investigation | no spoon is judged |
//! | 3 | films | |
//! | 4 | films of heaps | |
//! | 5 | films of a training's episodes | |
//! | 6 | `device` of an evaluation and of a training | the processor |
//! | 6 | `goes_on_from` of a training | it begins at its beginning |
//! | 7 | `gradients` of a training's settings | libtorch |
//! | 8 | `device` of a calibration | the processor |

mod films;

use super::conditions::Conditions;
use flip_bench::hardware::stand::Procedure;
use flip_bench::pile::{Dimensions, Limits};
use flip_core::domain::bench::BenchKind;
use flip_core::domain::conditions::{Patch, Under};
use flip_core::domain::device::Device;
use flip_core::domain::job::{JobKind, Subject};
use flip_core::domain::observable::Observation;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::powder::Flowability;
use flip_core::domain::shake::Spoonful;
use flip_core::domain::spoon::Spoon;
use flip_discover::reading::FileRead;
use flip_discover::spoon::{Calibrated, Settings as SpoonSettings};
use flip_discover::traces::Traces;
use flip_discover::{self as discover, Campaign, FitSet};
use flip_learn::calibrate;
use flip_learn::train::{self, Gradients};
use flip_policy::{Kind, Schedule};
use flip_sim as sim;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

pub use films::{EpisodeFilmSpec, FilmSpec, HeapFilmSpec};

/// Version of this program's simulator. It is part of every specification: results of different
/// versions are never mixed.
pub const SIMULATOR: &str = sim::VERSION;

/// Version of the simulator on a device: a card's kernels have their own.
pub fn simulator_on(device: Device) -> String {
    match device {
        Device::Cpu => SIMULATOR.to_owned(),
        Device::Cuda => format!("{SIMULATOR}+cuda.{}", flip_cuda::VERSION),
    }
}

/// Latest version of the specifications written here; a text without a number is of version 1.
const VERSION: u32 = 9;

/// Why a stored specification cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum Unreadable {
    /// A newer FLIP wrote it.
    #[error(
        "the specification is of version {0}, and this FLIP reads up to {VERSION}: use the program that wrote it"
    )]
    Newer(u32),
    /// It is not of the version that it claims.
    #[error("the specification does not read as one of its version: {0}")]
    Malformed(#[from] serde_json::Error),
}

/// The number of a specification's version.
#[derive(Deserialize)]
struct Numbered {
    #[serde(default = "unnumbered")]
    version: u32,
}

fn unnumbered() -> u32 {
    1
}

/// A specification behind the number of its version.
#[derive(Deserialize)]
struct Versioned {
    #[serde(rename = "version")]
    _version: u32,
    #[serde(flatten)]
    spec: JobSpec,
}

/// Specification of a job. Equal specifications have equal results, so a second request for the
/// same one gets the first's job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JobSpec {
    /// Flowability to parameter sets.
    Calibration(CalibrationSpec),
    /// Parameter sets to a policy.
    Training(TrainingSpec),
    /// A policy's errors.
    Evaluation(EvaluationSpec),
    /// What the simulator gets wrong.
    Investigation(InvestigationSpec),
    /// Piles under a camera.
    Repose(ReposeSpec),
    /// The grains of a spoonful.
    Film(FilmSpec),
    /// The grains of a heap.
    HeapFilm(HeapFilmSpec),
    /// The grains of a dose with the network of a training's episode.
    EpisodeFilm(EpisodeFilmSpec),
}

/// A calibration to carry out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CalibrationSpec {
    /// Powder id; none for a bare angle.
    pub powder: Option<String>,
    /// The measurement to meet.
    pub target: Flowability,
    /// Other measurements.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub observations: Vec<Observation>,
    /// What a version changes about spoons: observations of them are simulated with it.
    #[serde(default, skip_serializing_if = "Patch::is_none")]
    pub patch: Patch,
    /// Settings of the search.
    pub settings: calibrate::Settings,
    /// Design of the emulator used; none if the method has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub design: Option<calibrate::Design>,
    /// The extended version whose reference conditions the target refers to; none for the base.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub under: Option<Under>,
    /// What simulates; omitted for the processor, as in older specifications.
    #[serde(default, skip_serializing_if = "Device::is_cpu")]
    pub device: Device,
    /// Version of the simulator: [`simulator_on`] the device.
    pub simulator: String,
}

impl CalibrationSpec {
    /// The same on this device: a card takes as long for one heap as for eighty, so that there heaps
    /// do not wait for what others show.
    #[must_use]
    pub fn on(mut self, device: Device) -> Self {
        let particles = self.settings.particles;
        let (design, tried_first) = match device {
            Device::Cpu => {
                let usual = calibrate::Settings::default();
                (calibrate::Design::with_particles(particles), usual.tried_first)
            }
            Device::Cuda => (calibrate::Design::at_once(particles), 0),
        };
        self.settings.tried_first = tried_first;
        let (design, simulator) = (self.design.map(|_| design), simulator_on(device));
        Self { design, device, simulator, ..self }
    }
}

/// A training to carry out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrainingSpec {
    /// Levels, each with its sets.
    pub levels: Vec<train::Level>,
    /// Every setting.
    pub settings: train::Settings,
    /// What simulates; omitted for the processor, as in older specifications.
    #[serde(default, skip_serializing_if = "Device::is_cpu")]
    pub device: Device,
    /// The checkpoint, by its SHA-256, of the same training on a card that failed: it goes on from
    /// there. None for all others.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub goes_on_from: Option<String>,
    /// Version of the simulator: [`simulator_on`] the device.
    pub simulator: String,
}

/// An evaluation to carry out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EvaluationSpec {
    /// Policy id.
    pub policy: String,
    /// Controllers to compare.
    pub controllers: Vec<String>,
    /// Actions of the controller `schedule`.
    pub schedule: Schedule,
    /// Definitions of the dispenser, the PID and the rules among the controllers; empty in older
    /// specifications, which used this program's.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rivals: Vec<Kind>,
    /// Powders, and the sets that represent them.
    pub powders: Vec<EvaluationPowder>,
    /// Targets, mg.
    pub targets_mg: Vec<f64>,
    /// Weighings in a cell.
    pub repeats: u32,
    /// Step of the balance's display, mg.
    pub readability_mg: f64,
    /// Steps of a weighing.
    pub max_shakes: u32,
    /// What is on the spoon; omitted where it is usual, so that an older evaluation keeps its text.
    #[serde(default, skip_serializing_if = "Conditions::are_usual")]
    pub conditions: Conditions,
    /// The extended version on the bench, and its conditions; none for the base.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub under: Option<Under>,
    /// Seed.
    pub seed: u64,
    /// What simulates; omitted for the processor, as in older specifications.
    #[serde(default, skip_serializing_if = "Device::is_cpu")]
    pub device: Device,
    /// Version of the simulator: [`simulator_on`] the device.
    pub simulator: String,
}

/// A powder of an evaluation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EvaluationPowder {
    /// Powder id.
    pub powder: String,
    /// Ids of the sets that represent it.
    pub sets: Vec<String>,
    /// What the conditions change about it.
    #[serde(default, skip_serializing_if = "Patch::is_none")]
    pub patch: Patch,
}

/// An investigation to carry out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct InvestigationSpec {
    /// Angles of repose, and what was recorded with them; none if only balance readings are judged.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub campaign: Option<Campaign>,
    /// Balance readings during weighings; omitted if there are none, so that an older specification
    /// keeps its text.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub traces: Option<Traces>,
    /// Shakes of weighings; omitted if there are none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shakes: Option<SpoonSpec>,
    /// How it is judged.
    pub settings: discover::Settings,
    /// Heaps that it may simulate; none: no simulations.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub heaps: Option<Heaps>,
    /// How the files were read; empty in older specifications.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub files: Vec<FileRead>,
    /// Version of the method that judges: [`discover::VERSION`]. Another version may find something
    /// else.
    pub method: u32,
    /// Version of the simulator: [`SIMULATOR`].
    pub simulator: String,
}

/// The shakes of an investigation, and what they are judged with.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SpoonSpec {
    /// What was weighed.
    pub spoonfuls: Vec<Spoonful>,
    /// What calibration says of the powders.
    pub calibrated: Vec<Calibrated>,
    /// How it is judged.
    pub settings: SpoonSettings,
    /// The spoon of the bench.
    #[serde(default, skip_serializing_if = "Spoon::is_usual")]
    pub spoon: Spoon,
}

/// What an investigation simulates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Heaps {
    /// Maximum number of heaps, at least one.
    pub budget_runs: u32,
    /// A set for each powder of the campaign.
    pub sets: Vec<(FitSet, ParameterSet)>,
}

/// A measurement of the angle of repose to carry out on the bench.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ReposeSpec {
    /// Powder id.
    pub powder: String,
    /// Which measurement of this powder it is: repeating a number refers to the same measurement,
    /// not another.
    pub run: u32,
    /// How piles are made and imaged.
    pub procedure: Procedure,
    /// What is known of the rig.
    pub rig: Dimensions,
    /// Requirements on the frames.
    pub limits: Limits,
    /// The bench that makes the piles.
    pub bench: BenchKind,
    /// The simulated powder on an emulated bench; none on devices.
    pub set: Option<ParameterSet>,
}

impl InvestigationSpec {
    /// Name of the simulator version that this investigation creates if its extension wins.
    pub fn version(&self) -> String {
        let text = serde_json::to_string(self)
            .expect("specifications hold only finite numbers, text and lists");
        format!("sv-{}", &hex::encode(Sha256::digest(&text))[..16])
    }
}

impl JobSpec {
    /// The kind of job it creates.
    pub fn kind(&self) -> JobKind {
        match self {
            Self::Calibration(_) => JobKind::Calibration,
            Self::Training(_) => JobKind::Training,
            Self::Evaluation(_) => JobKind::Evaluation,
            Self::Investigation(_) => JobKind::Investigation,
            Self::Repose(_) => JobKind::Repose,
            Self::Film(_) | Self::HeapFilm(_) | Self::EpisodeFilm(_) => JobKind::Film,
        }
    }

    /// What it is about.
    pub fn subject(&self) -> Subject {
        let each_once = |powders: Vec<&String>| {
            let mut once: Vec<String> = Vec::new();
            for powder in powders {
                if !once.contains(powder) {
                    once.push(powder.clone());
                }
            }
            once
        };
        match self {
            Self::Calibration(spec) => Subject {
                powders: spec.powder.iter().cloned().collect(),
                repose_deg: Some(spec.target.repose_deg),
                device: spec.device,
                ..Subject::default()
            },
            Self::Training(spec) => Subject {
                powders: each_once(spec.levels.iter().map(|it| &it.powder).collect()),
                device: spec.device,
                ..Subject::default()
            },
            Self::Evaluation(spec) => Subject {
                powders: each_once(spec.powders.iter().map(|it| &it.powder).collect()),
                policy: Some(spec.policy.clone()),
                device: spec.device,
                ..Subject::default()
            },
            Self::Investigation(spec) => {
                let powders = spec.campaign.as_ref().map(|it| it.powders.clone());
                Subject { powders: powders.unwrap_or_default(), ..Subject::default() }
            }
            Self::Repose(spec) => {
                Subject { powders: vec![spec.powder.clone()], ..Subject::default() }
            }
            Self::Film(_) | Self::HeapFilm(_) | Self::EpisodeFilm(_) => Subject::default(),
        }
    }

    /// What it computes on.
    pub fn device(&self) -> Device {
        match self {
            Self::Calibration(spec) => spec.device,
            Self::Training(spec) => spec.device,
            Self::Evaluation(spec) => spec.device,
            _ => Device::Cpu,
        }
    }

    /// The same on the processor; a training goes on from this checkpoint, if there is one.
    #[must_use]
    pub fn on_cpu(self, checkpoint: Option<String>) -> Self {
        match self {
            Self::Training(spec) if !spec.device.is_cpu() => {
                let (device, goes_on_from) = (Device::Cpu, checkpoint);
                let simulator = simulator_on(device);
                Self::Training(TrainingSpec { device, goes_on_from, simulator, ..spec })
            }
            Self::Calibration(spec) if !spec.device.is_cpu() => {
                Self::Calibration(spec.on(Device::Cpu))
            }
            Self::Evaluation(spec) => {
                let (device, simulator) = (Device::Cpu, simulator_on(Device::Cpu));
                Self::Evaluation(EvaluationSpec { device, simulator, ..spec })
            }
            other => other,
        }
    }

    /// The version of the simulator that it is for; none if it simulates nothing.
    pub fn simulator(&self) -> Option<&str> {
        match self {
            Self::Calibration(spec) => Some(&spec.simulator),
            Self::Training(spec) => Some(&spec.simulator),
            Self::Evaluation(spec) => Some(&spec.simulator),
            Self::Investigation(spec) => Some(&spec.simulator),
            Self::Film(spec) => Some(&spec.simulator),
            Self::HeapFilm(spec) => Some(&spec.simulator),
            Self::EpisodeFilm(spec) => Some(&spec.simulator),
            Self::Repose(_) => None,
        }
    }

    /// A stored specification, of any version so far.
    ///
    /// # Errors
    /// [`Unreadable`]
    pub fn read(text: &str) -> Result<Self, Unreadable> {
        match serde_json::from_str::<Numbered>(text)?.version {
            1 => Ok(serde_json::from_str(text)?),
            2..=VERSION => Ok(serde_json::from_str::<Versioned>(text)?.spec),
            other => Err(Unreadable::Newer(other)),
        }
    }

    /// The lowest version that has the fields of this specification.
    fn version(&self) -> u32 {
        let is_new = match self {
            Self::Film(_) => return 3,
            Self::HeapFilm(_) => return 4,
            Self::EpisodeFilm(_) => return 5,
            Self::Calibration(spec) if !spec.settings.tries_as_usual() => return 9,
            Self::Calibration(spec) if !spec.device.is_cpu() => return 8,
            Self::Evaluation(spec) if !spec.device.is_cpu() => return 6,
            Self::Training(spec) if spec.settings.gradients != Gradients::Libtorch => return 7,
            Self::Training(spec) if !spec.device.is_cpu() || spec.goes_on_from.is_some() => {
                return 6;
            }
            Self::Evaluation(spec) => spec.conditions.substep_us.is_some(),
            Self::Calibration(spec) => !spec.settings.fixed.is_empty() || !spec.patch.is_none(),
            Self::Investigation(spec) => spec.shakes.is_some(),
            _ => false,
        };
        if is_new { 2 } else { unnumbered() }
    }

    /// Its canonical text and the text's SHA-256. Fields are written in the order of their
    /// definition, so equal values give equal text.
    pub(super) fn canonical(&self) -> (String, Vec<u8>) {
        let text = serde_json::to_string(self)
            .expect("specifications hold only finite numbers, text and lists");
        let text = match self.version() {
            1 => text,
            later => text.replacen('{', &format!("{{\"version\":{later},"), 1),
        };
        let sha256 = Sha256::digest(&text).to_vec();
        (text, sha256)
    }
}

#[cfg(test)]
mod tests;
