//! The spoonfuls that discovery asks for, replayed on whatever carries out experiments.

use super::Functions;
use super::heaps::{read, under};
use super::host::{JobError, JobHost, Result, go_on};
use super::runner::{HeapExperiment, HeapRunner, Run, SpoonRunner};
use super::spec::SpoonSpec;
use super::spoon::simulated;
use flip_core::domain::job::Progress;
use flip_core::domain::shake::Spoonful;
use flip_discover::spoon::{Simulator, SpoonHeap, SpoonReplay, SpoonReport, judge_spoon};
use flip_sim::dispense::Settings;
use flip_sim::replay::Replay;
use std::cell::{Cell, RefCell};
use std::ops::ControlFlow;

/// Judges the spoonfuls of an investigation, in this share of its progress.
pub(super) fn judged(
    host: &dyn JobHost,
    functions: &Functions,
    spec: &SpoonSpec,
    share: [f64; 2],
) -> Result<SpoonReport> {
    let settings = simulated(&spec.spoon, Settings::default())
        .map_err(|error| JobError::Fail(error.to_string()))?;
    let spoons = Spoons {
        replays: &functions.replay,
        heaps: &functions.simulate,
        settings,
        spoonfuls: &spec.spoonfuls,
    };
    let powders = spec.calibrated.len() as u32;
    let watched = Watched {
        spoons,
        host,
        most: spec.settings.replays.saturating_mul(powders),
        share,
        replayed: Cell::default(),
        unsaved: RefCell::default(),
    };
    let report = judge_spoon(&spec.spoonfuls, &spec.calibrated, &spec.settings, &watched);
    match watched.unsaved.take() {
        Some(error) => Err(error),
        None if host.flow().is_break() => Err(JobError::Stopped),
        None => report.map_err(|error| JobError::Fail(error.to_string())),
    }
}

/// Spoons that report progress. Once the job is to end they pour nothing more.
struct Watched<'a> {
    spoons: Spoons<'a>,
    host: &'a dyn JobHost,
    /// Most replays of the job.
    most: u32,
    share: [f64; 2],
    replayed: Cell<u32>,
    unsaved: RefCell<Option<JobError>>,
}

impl Watched<'_> {
    /// Whether to go on.
    fn goes_on(&self) -> bool {
        self.unsaved.borrow().is_none() && self.host.flow().is_continue()
    }
}

impl Simulator for Watched<'_> {
    fn pour(&self, replays: &[SpoonReplay]) -> Vec<Option<Vec<f64>>> {
        if !self.goes_on() {
            return vec![None; replays.len()];
        }
        let (mut replayed, mut unsaved) = (self.replayed.get(), None);
        // What the runner's threads need of it.
        let (host, most, share) = (self.host, self.most, self.share);
        let fell = self.spoons.replayed(replays, &mut || {
            replayed += 1;
            go_on(host, host.report(&progress(replayed, most, share)), &mut unsaved)
        });
        self.replayed.set(self.replayed.get() + replays.len() as u32);
        *self.unsaved.borrow_mut() = unsaved;
        fell
    }

    fn heaps(&self, heaps: &[SpoonHeap]) -> Vec<Option<f64>> {
        if !self.goes_on() {
            return vec![None; heaps.len()];
        }
        let host = self.host;
        self.spoons.poured(heaps, &mut || host.flow())
    }
}

/// After so many replays of at most so many, in this share of the job.
fn progress(replayed: u32, most: u32, [from, until]: [f64; 2]) -> Progress {
    let most = most.max(1);
    let done = (f64::from(replayed) / f64::from(most)).min(1.0);
    let message = format!("spoonful {replayed} of at most {most} replayed");
    Progress { fraction: from + (until - from) * done, message }
}

/// The simulator as the spoon channel asks it.
pub struct Spoons<'a> {
    /// Replays spoonfuls.
    pub replays: &'a SpoonRunner,
    /// Pours heaps.
    pub heaps: &'a HeapRunner,
    /// Spoon and motion of the bench.
    pub settings: Settings,
    /// What was weighed.
    pub spoonfuls: &'a [Spoonful],
}

impl Spoons<'_> {
    /// The replay of a spoonful; `None` where the change is none that the simulator has.
    fn replay(&self, of: &SpoonReplay) -> Option<Replay> {
        let (change, usual) = (&of.change, self.settings);
        let settings = Settings {
            friction: (usual.friction + change.spoon_friction).max(0.0),
            extensions: usual.extensions.patched(&change.patch).ok()?,
            ..usual
        };
        let set = change.patch.powder(&of.set);
        let mut job = Replay::of(&set, &settings, &self.spoonfuls[of.spoonful], of.seed);
        job.settings.particles =
            ((f64::from(job.settings.particles) * change.fill).round() as u32).max(1);
        job.steps.iter_mut().for_each(|step| step.shake_mm *= change.stroke);
        Some(job)
    }
}

/// Says after each run whether to go on.
type GoesOn<'a> = dyn FnMut() -> ControlFlow<()> + Send + 'a;

impl Spoons<'_> {
    /// What fell in each replay, mg for each step.
    fn replayed(&self, replays: &[SpoonReplay], goes_on: &mut GoesOn<'_>) -> Vec<Option<Vec<f64>>> {
        let (places, known) = known(replays.iter().map(|of| self.replay(of)));
        let mut fell = vec![None; replays.len()];
        self.replays.run(&known, &mut |k, Run { outcome, .. }| {
            fell[places[k]] = outcome.ok().map(|it| it.fell_mg);
            goes_on()
        });
        fell
    }

    /// The angle of each heap, degrees.
    fn poured(&self, heaps: &[SpoonHeap], goes_on: &mut GoesOn<'_>) -> Vec<Option<f64>> {
        let heap = |of: &SpoonHeap| {
            let (set, settings) = under(&of.set, &of.patch)?;
            Some(read(HeapExperiment { set, settings, seed: of.seed }))
        };
        let (places, known) = known(heaps.iter().map(heap));
        let mut angles = vec![None; heaps.len()];
        self.heaps.run(&known, &mut |k, Run { outcome, .. }| {
            angles[places[k]] = outcome.ok().map(|it| it.tip_deg);
            goes_on()
        });
        angles
    }
}

impl Simulator for Spoons<'_> {
    fn pour(&self, replays: &[SpoonReplay]) -> Vec<Option<Vec<f64>>> {
        self.replayed(replays, &mut || ControlFlow::Continue(()))
    }

    fn heaps(&self, heaps: &[SpoonHeap]) -> Vec<Option<f64>> {
        self.poured(heaps, &mut || ControlFlow::Continue(()))
    }
}

/// The experiments that there are, and the place of each.
fn known<E>(all: impl Iterator<Item = Option<E>>) -> (Vec<usize>, Vec<E>) {
    all.enumerate().filter_map(|(place, of)| Some((place, of?))).unzip()
}

#[cfg(test)]
mod tests {
    use super::super::runner::{heaps_on_cores, spoons_on_cores};
    use super::*;
    use flip_core::domain::parameters::ParameterSet;
    use flip_core::domain::shake::Shake;
    use flip_discover::spoon::SpoonCause;
    use flip_sim::replay::Replayed;

    /// A spoon that shows what it was asked.
    fn asked(job: &Replay) -> Replayed {
        let step = job.steps[0];
        let fell_mg = vec![
            step.pitch_deg,
            step.shake_mm,
            f64::from(job.settings.particles),
            job.settings.friction,
            job.settings.extensions.spoon_adhesion,
            job.set.friction(),
        ];
        Replayed { filled_mg: 0.0, fell_mg, spilled_mg: 0.0 }
    }

    #[test]
    fn each_change_reaches_the_replay_and_an_unknown_one_has_no_result() {
        let shake = Shake {
            pitch_deg: 60.0,
            shake_mm: 8.0,
            strokes: 1,
            acceleration_m_s2: None,
            spoon_mg: None,
            fell_mg: 0.0,
            sd_mg: 0.4,
            since_filled_s: None,
        };
        let spoonfuls = [Spoonful {
            weighing: "w".to_owned(),
            spoonful: 1,
            powder: "salt".to_owned(),
            lot: None,
            session: None,
            readability_mg: None,
            shakes: vec![shake],
        }];
        let replays = spoons_on_cores(|job| Ok(asked(job)));
        let heaps = heaps_on_cores(flip_sim::repose::repose);
        let spoons = Spoons {
            replays: &replays,
            heaps: &heaps,
            settings: Settings::default(),
            spoonfuls: &spoonfuls,
        };
        let replay = |cause: Option<SpoonCause>, amplitude: f64| {
            let change = cause.map(|it| it.change(amplitude)).unwrap_or_default();
            SpoonReplay { set: ParameterSet::default(), spoonful: 0, change, seed: 1 }
        };
        let mut unknown = replay(None, 0.0);
        unknown.change.patch.amplitudes.insert("wind".to_owned(), 1.0);
        let all = spoons.pour(&[
            replay(None, 0.0),
            unknown,
            replay(Some(SpoonCause::Actuator), 0.5),
            replay(Some(SpoonCause::FillLevel), 0.2),
            replay(Some(SpoonCause::SpoonFriction), 0.4),
            replay(Some(SpoonCause::SpoonAdhesion), 3.0),
        ]);
        let usual = vec![60.0, 8.0, 2500.0, 0.4, 0.0, 0.5];
        let with = |k: usize, value: f64| {
            let mut changed = usual.clone();
            changed[k] = value;
            Some(changed)
        };
        let expected = vec![
            Some(usual.clone()),
            None,
            with(1, 4.0),
            with(2, 2000.0),
            with(3, 0.8),
            with(4, 3.0),
        ];
        assert_eq!(all, expected);
    }
}
