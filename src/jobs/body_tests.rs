//! Bodies of jobs without a database: resumed, stopped, and without the right to write.

mod memory;

use super::host::{JobError, JobHost, Result};
use super::runner::{DoseExperiment, doses_on_cores, heaps_on_cores, observables_on_cores};
use super::{CalibrationSpec, Functions, SIMULATOR, TrainingSpec, calibrate, evaluate, train};
use flip_bench::rig::{Simulation, Task};
use flip_bench::weigh::{Accuracy, Order as WeighingOrder};
use flip_core::domain::device::Device;
use flip_core::domain::observable::{Observable, Observation};
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::powder::Flowability;
use flip_learn::calibrate::{Design, Method, Settings};
use flip_learn::train::evaluate::{Contender, Dose, Evaluation, Plan, Subject, Weighing};
use flip_learn::train::{EpisodeRecord, Event, Order, Preset, Start, TrainError};
use flip_policy::{Controller, Episode, Rules, ScheduledStep};
use flip_sim::repose::{Refusal, Repose, Settings as HeapSettings};
use flip_sim::{balance, dispense};
use memory::{Kept, MemoryHost};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

/// Most simulations that a calibration has begun and not saved yet.
const BATCH: usize = 8;

/// A number from -0.5 to 0.5.
fn noise(seed: u64) -> f64 {
    (seed % 1000) as f64 / 1000.0 - 0.5
}

/// A heap whose angle grows with friction and cohesion.
fn heap(set: &ParameterSet, settings: &HeapSettings, seed: u64) -> Repose {
    let tip_deg = 22.0 + 15.0 * set.friction() + 6.0 * set.cohesion() + 0.2 * noise(seed);
    Repose {
        tip_deg,
        tip_sd_deg: (settings.readings > 1).then_some(0.1),
        cone_deg: tip_deg - 2.0,
        creep_deg_per_s: 0.0,
        speed_rms_mm_s: 0.0,
        particles_on_base: settings.particles,
        overlap_mean: 0.0,
        overlap_max: 0.0,
        simulated_s: 1.0,
    }
}

/// Formulas in place of the simulator, and a count of the simulations.
fn formulas() -> (Functions, Arc<AtomicUsize>) {
    let simulated = Arc::<AtomicUsize>::default();
    let counts = [simulated.clone(), simulated.clone()];
    let [heaps, observables] = counts;
    let functions = Functions {
        simulate: heaps_on_cores(move |set, settings, seed| {
            heaps.fetch_add(1, Ordering::SeqCst);
            Ok(heap(set, settings, seed))
        }),
        observe: observables_on_cores(move |_, set, _, seed| {
            observables.fetch_add(1, Ordering::SeqCst);
            Ok::<_, Refusal>(4.0 - set.friction() - 0.5 * set.cohesion() + 0.02 * noise(seed))
        }),
        ..Functions::default()
    };
    (functions, simulated)
}

/// A calibration that searches for itself.
fn alone() -> CalibrationSpec {
    CalibrationSpec {
        powder: Some("sand".into()),
        target: Flowability { repose_deg: 31.4, sd_deg: 1.5, n: 5 },
        observations: Vec::new(),
        patch: Default::default(),
        settings: Settings { sets: 4, seed: 3, ..Settings::default() },
        design: None,
        under: None,
        device: Device::Cpu,
        simulator: SIMULATOR.into(),
    }
}

/// A calibration on an emulator, with one more measurement.
fn emulated() -> CalibrationSpec {
    let drained = Observable::DrainedAngle {};
    CalibrationSpec {
        observations: vec![Observation { observable: drained, mean: 3.6, sd: 0.1, n: 5 }],
        settings: Settings { sets: 2, ..Settings::of(Method::Emulator) },
        design: Some(Design { runs: 40, initial: 30, round: 10, ..Design::with_particles(2000) }),
        ..alone()
    }
}

fn kept_after(host: MemoryHost, functions: &Functions, spec: &CalibrationSpec) -> Result<Kept> {
    calibrate::perform(&host, functions, spec)?;
    Ok(host.kept().clone())
}

#[test]
fn a_calibration_resumed_after_any_number_of_trials_saves_the_same_bytes() {
    let (functions, simulated) = formulas();
    let spec = alone();
    let whole = kept_after(MemoryHost::default(), &functions, &spec).unwrap();
    let all = simulated.swap(0, Ordering::SeqCst);
    assert_eq!(whole.trials.len(), all);
    for saves in [1, all / 2, all - 1] {
        let host = MemoryHost::stopping_after(saves);
        let stopped = calibrate::perform(&host, &functions, &spec);
        assert!(matches!(stopped, Err(JobError::Stopped)), "{stopped:?}");
        let half = host.kept().clone();
        assert!(half.result.is_none() && half.trials == whole.trials[..saves]);
        assert!(simulated.swap(0, Ordering::SeqCst) < saves + BATCH);
        let resumed = kept_after(MemoryHost::resuming(half), &functions, &spec).unwrap();
        assert_eq!(resumed, whole);
        assert_eq!(simulated.swap(0, Ordering::SeqCst), all - saves, "and simulates only the rest");
    }
}

#[test]
fn heaps_and_observations_of_an_emulator_are_saved_as_they_come_and_simulated_once() {
    let (functions, simulated) = formulas();
    let spec = emulated();
    let host = MemoryHost::default();
    calibrate::perform(&host, &functions, &spec).unwrap();
    let (whole, all) = (host.kept().clone(), simulated.swap(0, Ordering::SeqCst));
    assert_eq!(host.writes(), all + 1, "one write each, and the result");
    assert_eq!((whole.emulators.len(), whole.probes.len(), whole.files.len()), (1, 2, 1));
    // In the emulator, in the observations before the search, and in the last check.
    for saves in [25, 100, all - 3] {
        let host = MemoryHost::stopping_after(saves);
        assert!(calibrate::perform(&host, &functions, &spec).is_err());
        simulated.store(0, Ordering::SeqCst);
        let half = host.kept().clone();
        let resumed = kept_after(MemoryHost::resuming(half), &functions, &spec).unwrap();
        assert_eq!(simulated.swap(0, Ordering::SeqCst), all - saves);
        assert_eq!((&resumed.trials, &resumed.probes), (&whole.trials, &whole.probes));
        assert_eq!((&resumed.emulators, &resumed.files), (&whole.emulators, &whole.files));
    }
}

#[test]
fn a_calibration_that_has_lost_its_lease_saves_nothing_more() {
    let (functions, simulated) = formulas();
    let spec = alone();
    let whole = kept_after(MemoryHost::default(), &functions, &spec).unwrap();
    for writes in [0, 5, whole.trials.len()] {
        simulated.store(0, Ordering::SeqCst);
        let host = MemoryHost::losing_its_lease_after(writes);
        let ended = calibrate::perform(&host, &functions, &spec);
        assert!(matches!(ended, Err(JobError::Stopped)), "{ended:?}");
        let saved = Kept { trials: whole.trials[..writes].to_vec(), ..Kept::default() };
        assert_eq!(*host.kept(), saved, "neither a trial nor the result");
        assert!(simulated.load(Ordering::SeqCst) <= writes + BATCH, "nor does it compute on");
    }
}

fn plan() -> Plan {
    let contender = |name: &str| Contender {
        name: name.into(),
        controller: Controller::Fixed(ScheduledStep::FIXED),
    };
    Plan {
        contenders: vec![contender("policy"), contender("fixed")],
        subjects: vec![Subject { powder: "sand".into(), sets: vec![ParameterSet::default()] }],
        targets_mg: vec![15.0, 20.0],
        repeats: 10,
        seed: 3,
    }
}

/// An evaluation by a formula, and how many doses it weighed.
fn evaluated(host: &dyn JobHost, plan: &Plan) -> (Result<Evaluation>, usize) {
    let weighed = Arc::<AtomicUsize>::default();
    let counted = weighed.clone();
    let weigh = doses_on_cores(move |task, simulation| {
        counted.fetch_add(1, Ordering::SeqCst);
        let dispensed_mg = task.order.target_mg + noise(simulation.seed);
        Ok(Dose { dispensed_mg, reading_mg: dispensed_mg.round(), shakes: 5, seconds: 9.0 })
    });
    let experiment = |of: &Weighing<'_>| {
        let order = WeighingOrder {
            target_mg: of.target_mg,
            tolerance_lower_mg: 0.0,
            tolerance_upper_mg: 0.0,
            readability_mg: 1.0,
        };
        let controller = of.contender.controller.clone();
        let (accuracy, rules) = (Accuracy::default(), Rules::FLIP);
        Ok(DoseExperiment {
            task: Arc::new(Task { order, accuracy, controller, rules }),
            simulation: Simulation {
                set: *of.set,
                spoon: dispense::Settings::default(),
                balance: balance::Settings::default(),
                seed: of.seed,
            },
        })
    };
    let doses = |weighings: &[Weighing<'_>]| evaluate::doses(host, weighings, experiment, &weigh);
    let found = flip_learn::train::evaluate::evaluate(plan, doses);
    (found, weighed.load(Ordering::SeqCst))
}

#[test]
fn an_evaluation_gives_the_same_bytes_on_any_number_of_threads_and_weighs_no_dose_twice() {
    let plan = plan();
    let (whole, all) = evaluated(&MemoryHost::default(), &plan);
    let whole = serde_json::to_string(&whole.unwrap()).unwrap();
    assert_eq!(all, 40);
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let host = MemoryHost::stopping_after(17);
        let (stopped, _) = pool.install(|| evaluated(&host, &plan));
        assert!(matches!(stopped, Err(JobError::Stopped)), "{stopped:?}");
        let half = host.kept().clone();
        // Doses that other threads had begun by then are saved too.
        let saved = half.doses.len();
        assert!((17..17 + threads).contains(&saved), "{saved} doses");
        let host = MemoryHost::resuming(half);
        let (resumed, weighed) = pool.install(|| evaluated(&host, &plan));
        assert_eq!(
            (serde_json::to_string(&resumed.unwrap()).unwrap(), weighed),
            (whole.clone(), 40 - saved)
        );
        let lost = MemoryHost::losing_its_lease_after(4);
        assert!(matches!(evaluated(&lost, &plan).0, Err(JobError::Stopped)));
        assert_eq!(lost.kept().doses.len(), 4);
    }
}

fn episode(index: u32) -> EpisodeRecord {
    EpisodeRecord {
        index,
        level: 0,
        powder: "sand".into(),
        parameter_set: ParameterSet::default().id(),
        target_mg: 15.0,
        dispensed_mg: 14.0,
        final_error_mg: 1.0,
        reward: 1.0,
        steps: 9,
        ending: Episode::Running,
        losses: None,
    }
}

/// A training that plays three episodes and is stopped; records what it began from.
fn stopped_training(began: &Arc<Mutex<Vec<Vec<u8>>>>) -> Functions {
    let began = began.clone();
    let train: train::Train = Arc::new(move |_, _, start, _, listener| {
        let from = match start {
            Start::Checkpoint(bytes) => bytes.to_vec(),
            _ => b"nothing".to_vec(),
        };
        began.lock().unwrap().push(from);
        (0..3).for_each(|index| _ = listener(Event::Episode(Box::new(episode(index)))));
        Err(TrainError::Stopped { checkpoint: b"three episodes".to_vec() })
    });
    Functions { train, ..Functions::default() }
}

#[test]
fn a_training_goes_on_from_its_checkpoint_and_starts_over_if_that_is_lost() {
    let began = Arc::default();
    let functions = stopped_training(&began);
    let settings = train::Settings::of(Preset::Flip, Order::Curriculum, 1);
    let spec = TrainingSpec {
        levels: Vec::new(),
        settings,
        device: Device::Cpu,
        goes_on_from: None,
        simulator: SIMULATOR.into(),
    };
    let attempt = |kept: Kept| {
        let host = MemoryHost::resuming(kept);
        let ended = train::perform(&host, &functions, &spec);
        assert!(matches!(ended, Err(JobError::Stopped)), "{ended:?}");
        host.kept().clone()
    };
    let first = attempt(Kept::default());
    assert_eq!(first.checkpoint, Some(Ok(b"three episodes".to_vec())));
    assert_eq!(first.episodes, [0, 1, 2].map(episode), "also of a round that is not full");
    attempt(first);
    let lost = Some(Err("it is damaged".to_owned()));
    let third = attempt(Kept { checkpoint: lost, ..Kept::default() });
    assert!(third.began_again.unwrap().contains("it is damaged"));
    assert_eq!(*began.lock().unwrap(), [&b"nothing"[..], b"three episodes", b"nothing"]);
}
