//! What travels to a worker that helps, and back: experiments and their runs, in CBOR. It keeps every bit
//! of a number, also of those that are none.

use super::Functions;
use super::runner::{DoseExperiment, HeapExperiment, ObservableExperiment, Run, Runner};
use flip_bench::rig::{Simulation, Task};
use flip_sim::replay::Replay;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::sync::Arc;

/// Why something cannot be sent or read.
pub(super) type Result<T> = std::result::Result<T, String>;

/// An experiment that another worker can carry out.
pub(super) trait Portable: Sized {
    /// Its kind, as it is stored.
    const KIND: &'static str;

    /// Bytes of these experiments.
    fn packed(experiments: &[Self]) -> Result<Vec<u8>>;

    /// The experiments of such bytes.
    fn unpacked(bytes: &[u8]) -> Result<Vec<Self>>;
}

/// Experiments that are written down as they are.
macro_rules! portable {
    ($experiment:ty, $kind:literal) => {
        impl Portable for $experiment {
            const KIND: &'static str = $kind;

            fn packed(experiments: &[Self]) -> Result<Vec<u8>> {
                packed(&experiments)
            }

            fn unpacked(bytes: &[u8]) -> Result<Vec<Self>> {
                unpacked(bytes)
            }
        }
    };
}

portable!(HeapExperiment, "heap");
portable!(ObservableExperiment, "observable");
portable!(Replay, "replay");

impl Portable for DoseExperiment {
    const KIND: &'static str = "dose";

    /// Each task once: a network has many numbers.
    fn packed(experiments: &[Self]) -> Result<Vec<u8>> {
        let mut tasks: Vec<&Arc<Task>> = Vec::new();
        let mut doses: Vec<(usize, &Simulation)> = Vec::with_capacity(experiments.len());
        for Self { task, simulation } in experiments {
            let known = tasks.iter().position(|it| Arc::ptr_eq(it, task));
            doses.push((known.unwrap_or(tasks.len()), simulation));
            if known.is_none() {
                tasks.push(task);
            }
        }
        let tasks: Vec<&Task> = tasks.into_iter().map(|task| &**task).collect();
        packed(&(tasks, doses))
    }

    fn unpacked(bytes: &[u8]) -> Result<Vec<Self>> {
        let (tasks, doses): (Vec<Task>, Vec<(usize, Simulation)>) = unpacked(bytes)?;
        let tasks: Vec<Arc<Task>> = tasks.into_iter().map(Arc::new).collect();
        let dose = |(task, simulation): (usize, Simulation)| {
            let task = tasks.get(task).ok_or("a dose without its task")?.clone();
            Ok(Self { task, simulation })
        };
        doses.into_iter().map(dose).collect()
    }
}

fn packed(of: &impl Serialize) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    ciborium::into_writer(of, &mut bytes).map_err(|error| error.to_string())?;
    Ok(bytes)
}

fn unpacked<T: DeserializeOwned>(bytes: &[u8]) -> Result<T> {
    ciborium::from_reader(bytes).map_err(|error| error.to_string())
}

/// The runs that a portion of so many experiments gave.
pub(super) fn runs<O: DeserializeOwned>(bytes: &[u8], experiments: usize) -> Result<Vec<Run<O>>> {
    let runs: Vec<Run<O>> = unpacked(bytes)?;
    match runs.len() == experiments {
        true => Ok(runs),
        false => Err(format!("{} runs of {experiments} experiments", runs.len())),
    }
}

/// Carries out the experiments of a portion one after another, and returns their runs as bytes. `None`:
/// `goes_on` has said no between two of them.
///
/// # Errors
/// Why this program cannot carry them out.
pub(super) fn carry_out(
    functions: &Functions,
    kind: &str,
    experiments: &[u8],
    goes_on: &dyn Fn() -> bool,
) -> Result<Option<Vec<u8>>> {
    let Functions { simulate, observe, replay, weigh, .. } = functions;
    match kind {
        HeapExperiment::KIND => carry_out_on(&**simulate, experiments, goes_on),
        ObservableExperiment::KIND => carry_out_on(&**observe, experiments, goes_on),
        Replay::KIND => carry_out_on(&**replay, experiments, goes_on),
        DoseExperiment::KIND => carry_out_on(&**weigh, experiments, goes_on),
        other => Err(format!("experiments of kind `{other}` are not known here")),
    }
}

fn carry_out_on<E: Portable, O: Serialize + Send>(
    runner: &dyn Runner<E, O>,
    experiments: &[u8],
    goes_on: &dyn Fn() -> bool,
) -> Result<Option<Vec<u8>>> {
    let mut runs = Vec::new();
    for one in E::unpacked(experiments)?.chunks(1) {
        if !goes_on() {
            return Ok(None);
        }
        runs.extend(runner.run_all(one));
    }
    packed(&runs).map(Some)
}

#[cfg(test)]
mod tests {
    use super::super::runner::heaps_on_cores;
    use super::*;
    use flip_bench::weigh::{Accuracy, Order};
    use flip_core::domain::conditions::Patch;
    use flip_core::domain::observable::Observable;
    use flip_core::domain::parameters::ParameterSet;
    use flip_policy::{Controller, Dispenser, Response, Rules};
    use flip_sim::replay::Step;
    use flip_sim::repose::{self, Refusal};
    use flip_sim::{balance, dispense};

    #[test]
    fn numbers_come_back_in_every_bit_also_those_that_are_none() {
        let odd = [
            f64::NAN,
            f64::from_bits(0x7ff0_0000_0000_0001),
            f64::from_bits(0xfff8_dead_beef_0001),
            f64::INFINITY,
            f64::NEG_INFINITY,
            -0.0,
            5e-324,
            f64::MAX,
            0.1,
            1.0 / 3.0,
            f64::from(0.1f32),
        ];
        let runs: Vec<Run<std::result::Result<f64, Refusal>>> =
            odd.iter().map(|x| Run { outcome: Ok(*x), seconds: *x }).collect();
        let back: Vec<Run<std::result::Result<f64, Refusal>>> =
            super::runs(&packed(&runs).unwrap(), odd.len()).unwrap();
        let bits = |run: &Run<std::result::Result<f64, Refusal>>| {
            [run.outcome.clone().unwrap().to_bits(), run.seconds.to_bits()]
        };
        assert_eq!(
            back.iter().map(bits).collect::<Vec<_>>(),
            runs.iter().map(bits).collect::<Vec<_>>()
        );
        assert!(super::runs::<f64>(&packed(&runs).unwrap(), 11).is_err(), "other outcomes");
        let few: Result<Vec<Run<std::result::Result<f64, Refusal>>>> =
            super::runs(&packed(&runs).unwrap(), 12);
        assert_eq!(few.unwrap_err(), "11 runs of 12 experiments");
    }

    /// What comes back, as it is written down: equal bytes, equal experiments.
    fn returns<E: Portable>(experiments: &[E]) {
        let bytes = E::packed(experiments).unwrap();
        let back = E::unpacked(&bytes).unwrap();
        assert_eq!(back.len(), experiments.len());
        assert_eq!(E::packed(&back).unwrap(), bytes);
    }

    #[test]
    fn every_kind_of_experiment_comes_back() {
        let set = ParameterSet::default();
        let patch =
            Patch { amplitudes: [("humidity".to_owned(), 1.0 / 3.0)].into(), ..Patch::default() };
        let extensions = repose::Settings::default().extensions.patched(&patch).unwrap();
        let settings = repose::Settings { extensions, readings: 4, ..repose::Settings::default() };
        returns(&[HeapExperiment { set, settings, seed: u64::MAX }]);
        let observable = Observable::FlowTime { orifice_mm: 4.0, mass_g: 1.0 };
        returns(&[ObservableExperiment { observable, set, patch: patch.clone(), seed: 1 }]);
        let step = Step { pitch_deg: 40.0, shake_mm: 4.0, strokes: 2, acceleration_m_s2: None };
        let spoon = dispense::Settings::default();
        returns(&[Replay { set, settings: spoon, steps: vec![step; 3], seed: 2 }]);
        let task = |controller: Controller| {
            Arc::new(Task {
                order: Order {
                    target_mg: 10.1,
                    tolerance_lower_mg: 0.0,
                    tolerance_upper_mg: 0.0,
                    readability_mg: 1.0,
                },
                accuracy: Accuracy::default(),
                controller,
                rules: Rules::FLIP,
            })
        };
        let network = task(Controller::untrained(3));
        let dispenser = task(Controller::Dispenser(Dispenser::new(Response::FITTED)));
        let dose = |task: &Arc<Task>, seed| DoseExperiment {
            task: task.clone(),
            simulation: Simulation { set, spoon, balance: balance::Settings::default(), seed },
        };
        let doses = [dose(&network, 1), dose(&dispenser, 2), dose(&network, 3)];
        returns(&doses);
        let alone = DoseExperiment::packed(&doses[..1]).unwrap().len();
        let all = DoseExperiment::packed(&doses).unwrap().len();
        assert!(all < alone + 5000, "{all} bytes: the network travels once, in {alone}");
        let back = DoseExperiment::unpacked(&DoseExperiment::packed(&doses).unwrap()).unwrap();
        for (back, sent) in back.iter().zip(&doses) {
            assert_eq!(back.task.controller, sent.task.controller);
        }
    }

    #[test]
    fn a_portion_is_carried_out_to_its_end_or_not_at_all() {
        let functions = Functions {
            simulate: heaps_on_cores(|_, _, seed| {
                Err(Refusal::Diverged { at_s: seed as f64, cause: "seven".into() })
            }),
            ..Functions::default()
        };
        let heap = |seed| HeapExperiment {
            set: ParameterSet::default(),
            settings: repose::Settings::default(),
            seed,
        };
        let bytes = HeapExperiment::packed(&[heap(1), heap(2)]).unwrap();
        let done = carry_out(&functions, "heap", &bytes, &|| true).unwrap().unwrap();
        let runs: Vec<Run<std::result::Result<repose::Repose, Refusal>>> =
            super::runs(&done, 2).unwrap();
        assert_eq!(runs[1].outcome, Err(Refusal::Diverged { at_s: 2.0, cause: "seven".into() }));
        assert_eq!(carry_out(&functions, "heap", &bytes, &|| false), Ok(None));
        assert!(carry_out(&functions, "wind", &bytes, &|| true).unwrap_err().contains("`wind`"));
        assert!(carry_out(&functions, "heap", b"\xff", &|| true).is_err());
    }
}
