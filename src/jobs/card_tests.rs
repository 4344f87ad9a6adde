use super::*;
use crate::jobs::evaluate::simulated;
use flip_bench::rig::{Simulation, Task};
use flip_bench::weigh::{Accuracy, Order};
use flip_core::domain::parameters::ParameterSet;
use flip_policy::{Controller, Paced, Rules, ScheduledStep};
use flip_sim::balance;
use flip_sim::batch::heaps::{self, Heaps};
use flip_sim::batch::{Batch, Cores, Motion, Stand};
use flip_sim::dispense::Dispenser;
use flip_sim::mechanisms::Extensions;
use flip_sim::repose::{self, repose};
use std::collections::BTreeSet;

/// Small spoons of 4 mg, poured by two controllers from three beds each.
fn experiments() -> Vec<DoseExperiment> {
    let spoon = dispense::Settings {
        particles: 300,
        semi_axes_mm: [2.4, 1.7, 1.0],
        ..dispense::Settings::default()
    };
    let task = |controller| {
        let order = Order {
            target_mg: 2.0,
            tolerance_lower_mg: 0.0,
            tolerance_upper_mg: 0.0,
            readability_mg: 0.1,
        };
        Arc::new(Task { order, accuracy: Accuracy::default(), controller, rules: Rules::FLIP })
    };
    let tasks =
        [task(Controller::Fixed(ScheduledStep::FIXED)), task(Controller::Paced(Paced::CHOSEN))];
    let dose = |(task, seed): (&Arc<Task>, u64)| DoseExperiment {
        task: task.clone(),
        simulation: Simulation {
            set: ParameterSet::default(),
            spoon,
            balance: balance::Settings { readability_mg: 0.1, ..balance::Settings::default() },
            seed,
        },
    };
    tasks.iter().flat_map(|task| [1, 2, 3].map(|seed| (task, seed))).map(dose).collect()
}

/// The cores, so many places at once.
struct Few(usize);

impl Engine for Few {
    fn name(&self) -> String {
        "few".to_owned()
    }
    fn places(&self) -> usize {
        self.0
    }
    fn batch(&self, places: usize) -> Result<Box<dyn Batch>, Failed> {
        assert!(places <= self.0, "{places} places");
        Cores.batch(places)
    }
}

#[test]
fn doses_side_by_side_on_the_cores_are_those_of_one_after_the_other_in_every_bit() {
    let experiments = experiments();
    let alone: Vec<_> =
        experiments.iter().map(|of| simulated(&of.task, &of.simulation).unwrap()).collect();
    let masses: BTreeSet<u64> = alone.iter().map(|dose| dose.dispensed_mg.to_bits()).collect();
    assert!(masses.len() > 3, "doses differ: {alone:?}");
    for places in [1, 4, 50] {
        let runs = SideBySide(Arc::new(Few(places))).run_all(&experiments);
        let found: Vec<Dose> = runs.into_iter().map(|run| run.outcome.unwrap()).collect();
        assert_eq!(found, alone, "{places} places");
    }
    assert!(SideBySide(Arc::new(Few(3))).run_all(&[]).is_empty());
}

/// Cores that break at a step.
struct Breaks(usize);

struct Breaking(Box<dyn Batch>, usize);

impl Engine for Breaks {
    fn name(&self) -> String {
        "it breaks".to_owned()
    }
    fn places(&self) -> usize {
        2
    }
    fn batch(&self, places: usize) -> Result<Box<dyn Batch>, Failed> {
        match self.0 {
            0 => Err(Failed("the card failed: no memory".to_owned())),
            steps => Ok(Box::new(Breaking(Cores.batch(places)?, steps))),
        }
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
        self.1 -= 1;
        match self.1 {
            0 => Err(Failed("the card failed: it was taken away".to_owned())),
            _ => self.0.step(motions),
        }
    }
}

#[test]
fn a_card_that_breaks_says_so_whenever_it_does_and_ends_the_doses() {
    let experiments = experiments();
    for (steps, said) in [(0, "no memory"), (1, "taken away"), (8, "taken away")] {
        let (mut given, mut failed) = (0, Vec::new());
        SideBySide(Arc::new(Breaks(steps))).run(&experiments, &mut |_, run| {
            match run.outcome {
                Ok(_) => given += 1,
                Err(why) => failed.push(why),
            }
            ControlFlow::Continue(())
        });
        assert!((1..=2).contains(&failed.len()) && given < experiments.len(), "{failed:?}");
        assert!(failed.iter().all(|why| why.contains(said)), "{steps} steps: {failed:?}");
    }
}

/// Places for heaps that break at a step.
struct BreakingHeaps(Box<dyn Heaps>, usize);

impl Heaps for BreakingHeaps {
    fn places(&self) -> usize {
        self.0.places()
    }
    fn room(&self) -> u32 {
        self.0.room()
    }
    fn carry_out(&mut self, orders: &[(usize, heaps::Order)]) -> Result<Vec<heaps::Stand>, Failed> {
        self.1 = self.1.checked_sub(1).ok_or_else(|| Failed("it was taken away".to_owned()))?;
        self.0.carry_out(orders)
    }
}

#[test]
fn heaps_by_an_engine_are_those_of_the_runner_on_cores_and_a_failure_is_remembered() {
    let settings = repose::Settings::with_particles(120);
    let heap = |seed| HeapExperiment { set: ParameterSet::default(), settings, seed };
    let experiments: Vec<HeapExperiment> = (0..3).map(heap).collect();
    let angles = |runs: Vec<Run<Result<Repose, Refusal>>>| {
        assert!(runs.iter().all(|run| run.seconds > 0.0));
        runs.into_iter().map(|run| run.outcome.unwrap().cone_deg).collect::<Vec<f64>>()
    };
    let cores = HeapsByCard::of(Arc::new(Cores));
    let theirs = experiments.iter().map(|of| repose(&of.set, &of.settings, of.seed).unwrap());
    let theirs: Vec<f64> = theirs.map(|heap| heap.cone_deg).collect();
    assert_eq!(angles(cores.run_all(&experiments)), theirs);
    assert_eq!(cores.failed(), None);
    for (steps, said) in [(None, "no heaps"), (Some(0), "taken away"), (Some(5), "taken away")] {
        let card = HeapsByCard::of(Arc::new(Fails(steps)));
        let mut given = 0;
        card.run(&experiments, &mut |_, run| {
            run.outcome.unwrap();
            given += 1;
            ControlFlow::Continue(())
        });
        assert!(given < experiments.len(), "{given} heaps before step {steps:?}");
        assert!(card.failed().unwrap().contains(said), "{steps:?}");
    }
}

/// Cores with heaps that break at a step, or without heaps.
struct Fails(Option<usize>);

impl Engine for Fails {
    fn name(&self) -> String {
        "it fails".to_owned()
    }
    fn places(&self) -> usize {
        2
    }
    fn batch(&self, places: usize) -> Result<Box<dyn Batch>, Failed> {
        Cores.batch(places)
    }
    fn heaps(&self, places: usize) -> Result<Option<Box<dyn Heaps>>, Failed> {
        let heaps = Cores.heaps(places)?.expect("cores pour heaps");
        Ok(self.0.map(|steps| Box::new(BreakingHeaps(heaps, steps)) as Box<dyn Heaps>))
    }
}

#[test]
fn what_a_card_has_no_room_for_is_refused_with_its_number() {
    let usual = dispense::Settings::default();
    let extensions = Extensions { rotation: 1.0, size_spread: 0.2, ..Extensions::default() };
    assert_eq!(can_compute(Device::Cuda, &usual), Ok(()));
    assert_eq!(can_compute(Device::Cuda, &dispense::Settings { extensions, ..usual }), Ok(()));
    let many = dispense::Settings { particles: 4000, ..usual };
    assert_eq!(can_compute(Device::Cpu, &many), Ok(()));
    let refused = can_compute(Device::Cuda, &many).unwrap_err();
    let says = |refused: FieldError| {
        let said = ["4000 grains", "2560"].iter().all(|it| refused.message.contains(it));
        assert!(refused.field == "device" && said, "{}", refused.message);
    };
    says(refused);
    let usual = calibrate::Settings::default();
    let verified = |count| calibrate::Settings { verify_particles: Some(count), ..usual.clone() };
    let larger = calibrate::Settings { particles: 4000, ..usual.clone() };
    assert_eq!(can_pour(Device::Cuda, &verified(2560)), Ok(()));
    assert_eq!(can_pour(Device::Cpu, &larger), Ok(()));
    says(can_pour(Device::Cuda, &larger).unwrap_err());
    says(can_pour(Device::Cuda, &verified(4000)).unwrap_err());
}

#[test]
fn the_first_card_is_looked_for_once_and_opened_or_refused_in_words() {
    let card = AllCards::default();
    match card.found() {
        Ok(name) => println!("skipped: there is {name}"),
        Err(why) => {
            assert!(why.ends_with("use the CPU"), "{why}");
            assert_eq!(card.open().err(), Some(why.clone()));
            assert_eq!(card.found(), Err(why));
        }
    }
}
