//! A training whose doses are simulated side by side on an engine, and its updates made on one.
#![cfg(feature = "libtorch")]

use flip_core::domain::parameters::ParameterSet;
use flip_core::learner::{Drawn, Learned, Losses, Shape};
use flip_learn::train::replay::Batch as Steps;
use flip_learn::train::sac::Learner;
use flip_learn::train::{
    Event, FineTuning, Gradients, Level, Network, Order, Preset, Replayed, Settings, Start,
    TrainError, Trained, train, train_beside,
};
use flip_sim::batch::{Batch, Cores, Engine, Failed, Motion, Stand, Updates};
use flip_sim::dispense::{self, Dispenser};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use std::ops::ControlFlow;
use std::sync::{Arc, Mutex};

fn levels() -> Vec<Level> {
    let set = |friction| ParameterSet::default().with("friction", friction).unwrap();
    let level = |powder: &str, repose_deg, frictions: [f64; 2]| Level {
        powder: powder.into(),
        repose_deg,
        sets: frictions.map(set).to_vec(),
    };
    vec![level("sand", 28.6, [0.3, 0.35]), level("salt", 36.0, [0.65, 0.7])]
}

/// A few doses of 4 mg spoons, the first on the surrogate.
fn small() -> Settings {
    let spoon = dispense::Settings {
        particles: 250,
        semi_axes_mm: [2.4, 1.7, 1.0],
        ..dispense::Settings::default()
    };
    Settings {
        episodes: 14,
        surrogate_episodes: 5,
        episodes_per_round: 3,
        warmup_episodes: 4,
        rounds_per_checkpoint: 1,
        hidden: 8,
        batch: 8,
        updates_per_step: 0.5,
        target_mg_min: 1.0,
        target_mg_max: 3.0,
        relabel_mg_min: 0.5,
        spoon,
        ..Settings::of(Preset::Flip, Order::Curriculum, 3)
    }
}

const GO_ON: fn() -> ControlFlow<()> = || ControlFlow::Continue(());

/// The cores with so many places, which break at a step of the training if they are told to.
struct Places(usize, Option<usize>);

struct Breaking(Box<dyn Batch>, Option<usize>);

impl Engine for Places {
    fn name(&self) -> String {
        "the cores".to_owned()
    }
    fn places(&self) -> usize {
        self.0
    }
    fn batch(&self, places: usize) -> Result<Box<dyn Batch>, Failed> {
        Ok(Box::new(Breaking(Cores.batch(places)?, self.1)))
    }
}

impl Batch for Breaking {
    fn places(&self) -> usize {
        self.0.places()
    }
    fn fill(&mut self, beds: &[(usize, &Dispenser)]) -> Result<(), Failed> {
        self.0.fill(beds)
    }
    fn step(&mut self, motions: &[(usize, Motion)]) -> Result<Vec<Stand>, Failed> {
        if let Some(left) = &mut self.1 {
            *left = left.saturating_sub(1);
            if *left == 0 {
                return Err(Failed("it broke".to_owned()));
            }
        }
        self.0.step(motions)
    }
}

fn on(engine: &dyn Engine, start: Start<'_>) -> Result<(Trained, Vec<Vec<u8>>), TrainError> {
    let mut checkpoints = Vec::new();
    let trained = train_beside(engine, &levels(), &small(), start, &GO_ON, |event| {
        if let Event::Checkpoint(bytes) = event {
            checkpoints.push(bytes);
        }
        ControlFlow::Continue(())
    })?;
    Ok((trained, checkpoints))
}

#[test]
fn a_training_beside_an_engine_of_cores_is_the_training_in_every_bit_and_resumes_on_either() {
    let alone = train(&levels(), &small(), Start::Nothing, &GO_ON, |_| ControlFlow::Continue(()));
    let alone = alone.unwrap();
    for places in [1, 2, 64] {
        assert_eq!(on(&Places(places, None), Start::Nothing).unwrap().0, alone, "{places} places");
    }
    let (_, checkpoints) = on(&Places(4, None), Start::Nothing).unwrap();
    for checkpoint in &checkpoints {
        let start = Start::Checkpoint(checkpoint);
        assert_eq!(on(&Places(2, None), start).unwrap().0, alone);
        let on_cores =
            train(&levels(), &small(), start, &GO_ON, |_| ControlFlow::Continue(())).unwrap();
        assert_eq!(on_cores, alone);
    }
}

#[test]
fn an_engine_that_breaks_leaves_a_checkpoint_from_which_the_cores_go_on_to_the_same_policy() {
    let (whole, _) = on(&Places(3, None), Start::Nothing).unwrap();
    for steps in [1, 9] {
        let broken = on(&Places(3, Some(steps)), Start::Nothing);
        let Err(TrainError::Device { cause, checkpoint }) = broken else { panic!("{broken:?}") };
        assert_eq!(cause, "it broke");
        let start = checkpoint.as_deref().map(Start::Checkpoint).expect("rounds were played");
        let resumed = train(&levels(), &small(), start, &GO_ON, |_| ControlFlow::Continue(()));
        assert_eq!(resumed.unwrap(), whole);
    }
    let stopped = train_beside(
        &Places(3, None),
        &levels(),
        &small(),
        Start::Nothing,
        &|| ControlFlow::Break(()),
        |_| ControlFlow::Continue(()),
    );
    assert!(matches!(stopped, Err(TrainError::Stopped { .. })), "{stopped:?}");
}

/// The cores, with updates by a learner of their own, which fails at a launch if it is told to.
struct Learning {
    settings: Settings,
    /// Updates of each launch.
    launches: Arc<Mutex<Vec<usize>>>,
    fails_at: Option<usize>,
}

impl Learning {
    fn of(settings: &Settings, fails_at: Option<usize>) -> Self {
        Self { settings: settings.clone(), launches: Arc::default(), fails_at }
    }

    fn trained(&self, start: Start<'_>) -> Result<Trained, TrainError> {
        train_beside(self, &levels(), &self.settings, start, &GO_ON, |_| GO_ON())
    }
}

impl Engine for Learning {
    fn name(&self) -> String {
        "the cores".to_owned()
    }
    fn places(&self) -> usize {
        Cores.places()
    }
    fn batch(&self, places: usize) -> Result<Box<dyn Batch>, Failed> {
        Cores.batch(places)
    }
    fn updates(&self, shape: &Shape) -> Result<Option<Box<dyn Updates>>, Failed> {
        assert_eq!(Some(*shape), Learner::shape(&self.settings));
        let Self { settings, launches, fails_at } = self;
        let (settings, launches) = (settings.clone(), launches.clone());
        Ok(Some(Box::new(Self { settings, launches, fails_at: *fails_at })))
    }
}

impl Updates for Learning {
    fn make(&mut self, of: &mut Learned, with: &[Drawn<'_>]) -> Result<Vec<Losses>, Failed> {
        let mut launches = self.launches.lock().unwrap();
        launches.push(with.len());
        if Some(launches.len()) == self.fails_at {
            return Err(Failed("it broke".to_owned()));
        }
        let mut learner = Learner::new(&self.settings, &mut Pcg64Mcg::seed_from_u64(1));
        learner.put(of.clone());
        let update = |drawn: &Drawn<'_>| {
            let batch = Steps {
                now: drawn.now.to_vec(),
                next: drawn.next.to_vec(),
                reward: drawn.reward.to_vec(),
                goes_on: drawn.goes_on.to_vec(),
                courses: None,
            };
            learner.update(&batch, drawn.noise, &self.settings)
        };
        let losses = with.iter().map(update).collect();
        *of = learner.learned();
        Ok(losses)
    }
}

/// Batches of which thirteen fill a piece; rounds on the surrogate have more.
fn with_large_batches() -> Settings {
    let gradients = Gradients::Fused;
    Settings { gradients, batch: 8192, episodes: 16, surrogate_episodes: 10, ..small() }
}

#[test]
fn updates_made_on_an_engine_piece_by_piece_give_the_bytes_of_those_on_cores() {
    let settings = with_large_batches();
    let alone = train(&levels(), &settings, Start::Nothing, &GO_ON, |_| GO_ON()).unwrap();
    assert_eq!(alone.manifest.settings["gradients"], "fused");
    let engine = Learning::of(&settings, None);
    assert_eq!(engine.trained(Start::Nothing).unwrap(), alone);
    let launches = engine.launches.lock().unwrap().clone();
    assert_eq!(launches.iter().max(), Some(&13), "{launches:?}");
    assert!(launches.iter().any(|updates| *updates < 13), "{launches:?}");

    // One that fails leaves a round that is learned from to its end, and a checkpoint after it.
    for launch in [1, 2] {
        let broken = Learning::of(&settings, Some(launch)).trained(Start::Nothing);
        let Err(TrainError::Device { cause, checkpoint }) = broken else {
            panic!("launch {launch} of {launches:?} did not fail");
        };
        assert_eq!(cause, "it broke");
        let start = checkpoint.as_deref().map(Start::Checkpoint).expect("a round was played");
        assert_eq!(Learning::of(&settings, None).trained(start).unwrap(), alone);
    }
    // In the last round nothing is left to do elsewhere.
    let last = Learning::of(&settings, Some(launches.len()));
    assert_eq!(last.trained(Start::Nothing).unwrap(), alone);
}

#[test]
fn an_engine_is_asked_for_updates_of_perceptrons_from_the_beginning_with_our_own_gradients() {
    let fused = Settings { gradients: Gradients::Fused, ..small() };
    let from = FineTuning { policy: "p-1".into(), held_updates: 0, averaged_updates: 0 };
    let replayed = Replayed::Episodes;
    let others = [
        small(),
        Settings { from: Some(from), ..fused.clone() },
        Settings { network: Network::Recurrent { replayed }, ..fused.clone() },
    ];
    assert!(Learner::shape(&fused).is_some());
    for settings in others {
        let engine = Learning::of(&settings, None);
        let alone = train(&levels(), &settings, Start::Nothing, &GO_ON, |_| GO_ON()).unwrap();
        assert_eq!(engine.trained(Start::Nothing).unwrap(), alone);
        assert!(engine.launches.lock().unwrap().is_empty());
    }
}
