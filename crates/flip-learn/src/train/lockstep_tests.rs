use super::*;
use crate::train::environment::play;
use crate::train::settings::{Order, Preset};

/// Results with room for every row.
struct Results {
    inputs: Vec<f32>,
    rewards: Vec<f64>,
    ended: [Vec<bool>; 2],
    facts: Vec<f64>,
    last_inputs: Vec<f32>,
    last_facts: Vec<f64>,
}

impl Results {
    fn of(doses: &Lockstep) -> Self {
        let (n, wide) = (doses.len(), doses.len() * doses.width());
        let facts = vec![0.0; n * FACTS.len()];
        Self {
            inputs: vec![0.0; wide],
            rewards: vec![0.0; n],
            ended: [vec![false; n], vec![false; n]],
            facts: facts.clone(),
            last_inputs: vec![0.0; wide],
            last_facts: facts,
        }
    }

    fn rows(&mut self) -> Rows<'_> {
        let [terminated, truncated] = &mut self.ended;
        Rows {
            inputs: &mut self.inputs,
            rewards: &mut self.rewards,
            terminated,
            truncated,
            facts: &mut self.facts,
            last_inputs: &mut self.last_inputs,
            last_facts: &mut self.last_facts,
        }
    }

    fn fact(&self, name: &str, dose: usize) -> f64 {
        let place = FACTS.iter().position(|fact| *fact == name).unwrap();
        self.facts[dose * FACTS.len() + place]
    }
}

fn settings(preset: Preset) -> Settings {
    Settings::of(preset, Order::DomainRandomisation, 5)
}

fn lockstep(count: u32, pouring: Pouring, autoreset: Autoreset, settings: &Settings) -> Lockstep {
    Lockstep::new(count, pouring, autoreset, &[], settings).unwrap()
}

/// Actions that depend on dose and step.
fn actions(step: usize, count: usize) -> Vec<[f32; OUTPUTS]> {
    (0..count).map(|k| [((k + step) % 5) as f32 / 4.0, ((k * step) % 7) as f32 / 6.0]).collect()
}

#[test]
fn a_dose_in_lockstep_is_the_episode_that_a_training_plays() {
    for preset in [Preset::Flip, Preset::Paper] {
        let settings = settings(preset);
        let plan = plan_of(77, 0, 0, &[], &settings);
        let mut spoon = plan.surrogate(&settings);
        let mut steps = 0;
        let Settings { rules, balance, .. } = &settings;
        let played = play(&mut spoon, rules, balance, plan.target_mg, plan.seed, |_| {
            steps += 1;
            actions(steps, 1)[0]
        });
        let mut doses = lockstep(1, Pouring::Surrogate, Autoreset::Disabled, &settings);
        let mut seen = Results::of(&doses);
        assert!(doses.step(&[[0.0; 2]], seen.rows()).is_err(), "it was never reset");
        doses.reset(None, &[Some(77)], seen.rows());
        let mut sum = 0.0;
        for (k, step) in played.steps.iter().enumerate() {
            assert_eq!(seen.fact("reading_mg", 0) as f32, step.reading_mg);
            doses.step(&[step.action], seen.rows()).unwrap();
            assert_eq!(seen.fact("true_mg", 0) as f32, step.next_true_mg);
            assert_eq!(seen.fact("pitch_deg", 0) as f32, step.next_pitch_deg);
            sum += seen.fact("published_reward", 0);
            let last = k + 1 == played.steps.len();
            assert_eq!(seen.ended[0][0] || seen.ended[1][0], last);
        }
        assert_eq!((sum, seen.fact("target_mg", 0)), (played.reward, played.target_mg));
        assert_eq!(seen.ended[0][0], played.ending == Episode::Terminated);
        assert!(doses.step(&[[0.0; 2]], seen.rows()).is_err(), "an ended dose is reset first");
    }
}

/// What 200 doses give in 40 steps on this many threads.
fn run(threads: usize, autoreset: Autoreset) -> (Vec<f32>, Vec<f64>) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let mut doses = lockstep(200, Pouring::Surrogate, autoreset, &settings(Preset::Flip));
    let mut seen = Results::of(&doses);
    let (mut inputs, mut rewards) = (Vec::new(), Vec::new());
    pool.install(|| {
        doses.reset(None, &[None; 200], seen.rows());
        for step in 0..40 {
            doses.step(&actions(step, 200), seen.rows()).unwrap();
            inputs.extend(&seen.inputs);
            rewards.extend(&seen.rewards);
        }
    });
    (inputs, rewards)
}

#[test]
fn lockstep_gives_the_same_bits_on_any_number_of_threads_and_inputs_stay_within_bounds() {
    let one = run(1, Autoreset::NextStep);
    assert_eq!(one, run(3, Autoreset::NextStep));
    let doses = lockstep(1, Pouring::Surrogate, Autoreset::NextStep, &settings(Preset::Flip));
    let [low, high] = doses.bounds();
    for seen in one.0.chunks(doses.width()) {
        assert!((0..seen.len()).all(|k| low[k] <= seen[k] && seen[k] <= high[k]), "{seen:?}");
    }
    assert!(low.iter().chain(&high).all(|x| x.is_finite() && x.abs() < 10.0));
}

#[test]
fn the_next_episode_begins_when_the_mode_says() {
    let settings = settings(Preset::Paper);
    let play = |autoreset| {
        let mut doses = lockstep(1, Pouring::Surrogate, autoreset, &settings);
        let mut seen = Results::of(&doses);
        doses.reset(None, &[None], seen.rows());
        let mut course = Vec::new();
        for _ in 0..12 {
            doses.step(&[[1.0, 1.0]], seen.rows()).unwrap();
            course.push((seen.fact("step", 0), seen.ended[1][0], seen.rewards[0] == 0.0));
        }
        (course, seen)
    };
    // The published episodes have exactly ten steps.
    let (next, _) = play(Autoreset::NextStep);
    assert_eq!(next[9].0, 10.0);
    assert_eq!(
        next[9..].iter().map(|it| (it.0, it.1)).collect::<Vec<_>>(),
        [(10.0, true), (0.0, false), (1.0, false)]
    );
    assert!(next[10].2, "beginning is not rewarded");
    let (same, seen) = play(Autoreset::SameStep);
    assert_eq!(
        same[9..].iter().map(|it| (it.0, it.1)).collect::<Vec<_>>(),
        [(0.0, true), (1.0, false), (2.0, false)]
    );
    assert_eq!(seen.last_facts[5], 10.0, "the last step of the episode that ended");
}

#[test]
fn targets_levels_and_spoons_of_the_simulator_are_as_asked_for() {
    let level = |powder: &str, repose_deg, friction| Level {
        powder: powder.to_owned(),
        repose_deg,
        sets: vec![ParameterSet::default().with("friction", friction).unwrap()],
    };
    let levels = [level("steep", 38.0, 0.9), level("flat", 28.0, 0.2)];
    let settings = Settings {
        box_share: 0.0,
        spoon: flip_sim::dispense::Settings { particles: 600, ..Default::default() },
        ..Settings::of(Preset::Flip, Order::Curriculum, 3)
    };
    let (mode, from) = (Autoreset::NextStep, Pouring::Simulator);
    let mut doses = Lockstep::new(2, from, mode, &levels, &settings).unwrap();
    let mut seen = Results::of(&doses);
    doses.set_level(1).unwrap();
    // More than 600 grains weigh, so that no dose ends early.
    doses.set_target_mg(Some(14.0)).unwrap();
    assert!(doses.set_level(2).is_err() && doses.set_target_mg(Some(-1.0)).is_err());
    doses.reset(None, &[Some(1), Some(1)], seen.rows());
    assert_eq!((seen.fact("target_mg", 0), seen.fact("level", 1)), (14.0, 1.0));
    let friction = doses.parameters()[0][4];
    assert!((friction - 0.9 / 1.3).abs() < 1e-6, "levels go from flat to steep");
    doses.set_level(0).unwrap();
    doses.reset(None, &[Some(1), Some(1)], seen.rows());
    (0..4).for_each(|_| doses.step(&[[1.0, 1.0]; 2], seen.rows()).unwrap());
    assert!(seen.fact("true_mg", 0) > 0.0);
    assert_eq!(seen.fact("true_mg", 0), seen.fact("true_mg", 1), "the same seed is the same dose");
    let none = Lockstep::new(2, from, mode, &[], &settings);
    assert_eq!(none.err().unwrap().field, "levels");
}
