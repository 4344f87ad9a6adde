//! Films a dose with the network of a training's episode: what it had learned by then.
//!
//! The dose is played first, with the centre of the network's policy in place of exploration, and its
//! steps are then made again by the spoon that records its grains.

use super::film::finish;
use super::host::{JobError, JobHost, Result, go_on};
use super::spec::EpisodeFilmSpec;
use flip_core::domain::FieldError;
use flip_core::domain::bench::Action;
use flip_core::domain::job::Progress;
use flip_core::domain::parameters::ParameterSet;
use flip_learn::train::environment::{Filling, Simulated, Spoon, play};
use flip_learn::train::{Level, Settings};
use flip_policy::{Controller, Rules};
use flip_sim::balance;
use flip_sim::dispense::{self, Dispenser};
use flip_sim::film::{Moves, Scene, film};
use flip_sim::replay::{Replay, Step};
use serde::{Deserialize, Serialize};

/// A dose to play with a network, the same for all episodes of a training.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EpisodeScene {
    /// The powder, with its conditions.
    pub set: ParameterSet,
    /// The spoon.
    pub settings: dispense::Settings,
    /// The balance.
    pub balance: balance::Settings,
    /// When the dose ends.
    pub rules: Rules,
    /// Target, mg.
    pub target_mg: f64,
    /// The powder's angle of repose, for networks that see it, degrees.
    pub repose_deg: Option<f64>,
    /// Seed of the filling and of the balance: the training's.
    pub seed: u64,
}

/// The dose that the films of a training show, and the set it is made of: the first set of the first
/// level, in the first of its days, to the middle of the targets. A training without levels has the
/// default set.
///
/// # Errors
/// A mechanism of the conditions is unknown.
pub fn scene(
    levels: &[Level],
    settings: &Settings,
) -> std::result::Result<(ParameterSet, EpisodeScene), FieldError> {
    let level = levels.first();
    let set = level.and_then(|level| level.sets.first()).copied().unwrap_or_default();
    let day = settings.extended.as_ref().and_then(|extended| {
        let own = level.and_then(|level| extended.powders.get(&level.powder));
        own.and_then(|days| days.first()).or_else(|| extended.days.first())
    });
    let patch = day.cloned().unwrap_or_default();
    let spoon = dispense::Settings {
        pitch: settings.rules.pitch,
        extensions: settings.spoon.extensions.patched(&patch)?,
        ..settings.spoon
    };
    let scene = EpisodeScene {
        set: patch.powder(&set),
        settings: spoon,
        balance: settings.balance,
        rules: settings.rules,
        target_mg: f64::midpoint(settings.target_mg_min, settings.target_mg_max),
        repose_deg: level.map(|level| level.repose_deg),
        seed: settings.seed,
    };
    Ok((set, scene))
}

/// A spoon that notes its steps.
#[derive(Clone)]
struct Noting {
    spoon: Dispenser,
    steps: Vec<Step>,
}

impl Spoon for Noting {
    fn step(&mut self, action: Action) {
        self.spoon.step(action);
        self.steps.push(Step {
            pitch_deg: self.spoon.pitch_deg(),
            shake_mm: action.executed_shake_mm(),
            strokes: action.strokes,
            acceleration_m_s2: None,
        });
    }
    fn pitch_deg(&self) -> f64 {
        self.spoon.pitch_deg()
    }
    fn vial_mg(&self) -> f64 {
        self.spoon.vial_mg()
    }
    fn has_failed(&self) -> bool {
        self.spoon.fault().is_some()
    }
}

/// Plays the dose; its steps.
fn played(controller: &Controller, of: &EpisodeScene) -> Vec<Step> {
    let spoon = Simulated { settings: of.settings }.fill(&of.set, of.seed);
    let mut spoon = Noting { spoon, steps: Vec::new() };
    let mut dosing = controller.begin(&of.rules, of.balance.readability_mg).knowing(of.repose_deg);
    play(&mut spoon, &of.rules, &of.balance, of.target_mg, of.seed, |seen| {
        dosing.propose(seen).to_unit().map(|output| output as f32)
    });
    spoon.steps
}

pub(super) fn perform(host: &dyn JobHost, spec: &EpisodeFilmSpec) -> Result<()> {
    let id = &spec.policy;
    let bytes = match host.kept_policy(id)? {
        Some(bytes) => Some(bytes),
        None => host.policy(id)?,
    };
    let bytes = bytes.ok_or_else(|| JobError::Fail(format!("there is no policy `{id}`")))?;
    let policy = flip_policy::decode(&bytes).map_err(|error| JobError::Fail(error.to_string()))?;
    host.report(&Progress { fraction: 0.0, message: "doses".to_owned() })?;
    let of = &spec.scene;
    let steps = played(&policy.controller, of);
    let replay = Replay { set: of.set, settings: of.settings, steps, seed: of.seed };
    let mut unsaved = None;
    let filmed = film(&Scene { replay, moves: Moves::AtOnce }, &mut |done, all| {
        // Playing it took about as long as filming it does.
        let fraction = 0.5 + 0.5 * done as f64 / all as f64;
        let message = format!("films step {} of {all}", (done + 1).min(all));
        go_on(host, host.report(&Progress { fraction, message }), &mut unsaved)
    });
    match unsaved {
        Some(error) => Err(error),
        None => finish(host, filmed),
    }
}
