//! The spoonfuls that discovery asks for, replayed on whatever carries out experiments.

use super::Functions;
use super::heaps::{read, under};
use super::host::{JobError, JobHost, Result, go_on};
use super::runner::{HeapExperiment, HeapRunner, SpoonRunner};
use super::spec::SpoonSpec;
use super::spoon::simulated;
use flip_core::domain::job::Progress;
use flip_core::domain::shake::Spoonful;
use flip_discover::spoon::{Simulator, SpoonHeap, SpoonReplay, SpoonReport, judge_spoon};
use flip_sim::dispense::Settings;
use flip_sim::replay::Replay;
use std::cell::{Cell, RefCell};

/// Replays between two looks at whether the job is to end.
const BATCH: usize = 16;

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
    /// Whether to go on after so many more replays.
    fn goes_on(&self, more: usize) -> bool {
        self.replayed.set(self.replayed.get() + more as u32);
        let (replayed, most) = (self.replayed.get(), self.most.max(1));
        let done = (f64::from(replayed) / f64::from(most)).min(1.0);
        let message = format!("spoonful {replayed} of at most {most} replayed");
        let [from, until] = self.share;
        let progress = Progress { fraction: from + (until - from) * done, message };
        let unsaved = &mut *self.unsaved.borrow_mut();
        unsaved.is_none() && go_on(self.host, self.host.report(&progress), unsaved).is_continue()
    }
}

impl Simulator for Watched<'_> {
    fn pour(&self, replays: &[SpoonReplay]) -> Vec<Option<Vec<f64>>> {
        let mut all = Vec::with_capacity(replays.len());
        for batch in replays.chunks(BATCH) {
            match self.goes_on(batch.len()) {
                true => all.extend(self.spoons.pour(batch)),
                false => all.extend(batch.iter().map(|_| None)),
            }
        }
        all
    }

    fn heaps(&self, heaps: &[SpoonHeap]) -> Vec<Option<f64>> {
        match self.goes_on(0) {
            true => self.spoons.heaps(heaps),
            false => vec![None; heaps.len()],
        }
    }
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

impl Simulator for Spoons<'_> {
    fn pour(&self, replays: &[SpoonReplay]) -> Vec<Option<Vec<f64>>> {
        let jobs: Vec<Option<Replay>> = replays.iter().map(|of| self.replay(of)).collect();
        let known: Vec<Replay> = jobs.iter().flatten().cloned().collect();
        let mut runs = self.replays.run_all(&known).into_iter();
        jobs.iter()
            .map(|job| runs_of(job.is_some(), &mut runs)?.outcome.ok().map(|it| it.fell_mg))
            .collect()
    }

    fn heaps(&self, heaps: &[SpoonHeap]) -> Vec<Option<f64>> {
        let heap = |of: &SpoonHeap| {
            let (set, settings) = under(&of.set, &of.patch)?;
            Some(read(HeapExperiment { set, settings, seed: of.seed }))
        };
        let jobs: Vec<Option<HeapExperiment>> = heaps.iter().map(heap).collect();
        let known: Vec<HeapExperiment> = jobs.iter().flatten().copied().collect();
        let mut runs = self.heaps.run_all(&known).into_iter();
        jobs.iter()
            .map(|job| runs_of(job.is_some(), &mut runs)?.outcome.ok().map(|it| it.tip_deg))
            .collect()
    }
}

/// The next run, for a job that there was.
fn runs_of<T>(is_known: bool, runs: &mut impl Iterator<Item = T>) -> Option<T> {
    if is_known { runs.next() } else { None }
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
