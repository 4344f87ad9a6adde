//! The spoonfuls that discovery asks for, replayed on whatever carries out experiments.

use super::heaps::{read, under};
use super::runner::{HeapExperiment, HeapRunner, SpoonRunner};
use flip_core::domain::shake::Spoonful;
use flip_discover::spoon::{Simulator, SpoonHeap, SpoonReplay};
use flip_sim::dispense::Settings;
use flip_sim::replay::Replay;

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
