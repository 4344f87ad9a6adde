//! The contract of a rig, held by all three.

use super::*;
use crate::emulate::arm::{self, Fault, Flow, FormulaSpoon};
use crate::emulate::lab::{self, Laboratory};
use crate::hardware::clock::Clock;
use crate::weigh::earlier::Expected;
use crate::weigh::{Accuracy, Order};
use flip_core::domain::apparatus::Apparatus;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use flip_core::domain::shake::{ShakesOf, Spoonful};
use flip_core::domain::vial::PanCheck;
use flip_core::domain::weighing::Outcome;
use flip_policy::{Controller, Rules, ScheduledStep};
use flip_sim::film::{Moves, Scene, film};
use flip_sim::replay::{Replay, replay};
use flip_sim::{balance, dispense};
use std::sync::atomic::Ordering;
use std::sync::{Arc, mpsc};
use std::time::Duration;

/// A stop that takes longer waits for something.
const PATIENCE: Duration = Duration::from_secs(20);

/// A rig, and the laboratory around it where there is one to look at.
struct Case {
    rig: Arc<dyn Rig>,
    laboratory: Option<Laboratory>,
}

/// One of each kind.
fn cases() -> [Case; 3] {
    let clock = Clock::standing();
    let spoon = Box::new(FormulaSpoon::new(Flow::default(), 1));
    let laboratory = Laboratory::start(lab::Settings::default(), clock.clone(), spoon).unwrap();
    let devices = Devices::with_clock(laboratory.file(), clock);
    [
        Case { rig: Arc::new(Simulated), laboratory: None },
        Case { rig: Arc::new(Emulated::new(lab::Settings::default())), laboratory: None },
        Case { rig: Arc::new(devices), laboratory: Some(laboratory) },
    ]
}

impl Case {
    fn pour(&self, on_event: OnEvent<'_>, stop: &AtomicBool) -> Poured {
        self.rig.pour(&pouring(), on_event, stop)
    }

    /// A dose that nothing disturbs.
    fn undisturbed(&self) -> Poured {
        self.pour(&mut |_| ControlFlow::Continue(()), &AtomicBool::new(false))
    }

    /// Nothing has to be checked, and where the arm can be seen, it is out of the way.
    fn assert_safe(&self, poured: &Poured) {
        let kind = self.rig.kind();
        assert_eq!(poured.must_look, None, "{kind:?}");
        if let Some(laboratory) = &self.laboratory {
            assert!(laboratory.arm.is_level() && laboratory.arm.is_retracted(), "{kind:?}");
        }
    }
}

fn pouring() -> Pouring {
    let step = ScheduledStep { pitch_deg: 30.0, shake_mm: 4.0 };
    Pouring {
        task: Task {
            order: Order {
                target_mg: 12.0,
                tolerance_lower_mg: 1.0,
                tolerance_upper_mg: 1.0,
                readability_mg: 1.0,
            },
            accuracy: Accuracy::default(),
            controller: Controller::Fixed(step),
            rules: Rules::FLIP,
        },
        simulation: Simulation {
            set: ParameterSet::default(),
            // Few grains, for speed.
            spoon: dispense::Settings { particles: 600, ..Default::default() },
            balance: balance::Settings::default(),
            seed: 1,
        },
        shakes: None,
        expected: Expected::NOTHING,
        spoon_mg: None,
        pan: PanCheck::NONE,
        probe: None,
    }
}

#[test]
fn a_dose_runs_its_course_names_its_devices_and_leaves_its_traffic() {
    for case in cases() {
        let (rig, kind) = (&case.rig, case.rig.kind());
        assert!(rig.devices().is_empty() && rig.exchanges().is_empty(), "{kind:?}");
        let poured = case.undisturbed();
        assert!(poured.reading_mg.is_some_and(|mg| mg > 1.0), "{kind:?}: {poured:?}");
        case.assert_safe(&poured);
        let devices = rig.devices();
        let named: Vec<&str> = devices.keys().map(String::as_str).collect();
        let expected: &[&str] =
            if kind.has_devices() { &["arm", "balance", "gripper"] } else { &[] };
        assert_eq!(named, expected, "{kind:?}");
        assert!(devices.values().all(|name| !name.is_empty()), "{devices:?}");
        assert_eq!(rig.exchanges().is_empty(), !kind.has_devices(), "{kind:?}");
        assert!(rig.exchanges().is_empty(), "{kind:?}: it was taken");
        assert_eq!(rig.arm_latch().unwrap(), None, "{kind:?}");
    }
}

/// A dose that is stopped where a second spoonful would be poured from.
fn first_spoonful_of(rig: &dyn Rig, pouring: &Pouring) -> Poured {
    let stop = AtomicBool::new(false);
    let mut watch = |event: &Event<'_>| {
        let is_second = matches!(event, Event::Tick(tick) if tick.spoonful > 1);
        stop.fetch_or(is_second, Ordering::SeqCst);
        ControlFlow::Continue(())
    };
    rig.pour(pouring, &mut watch, &stop)
}

/// The shakes of a dose, as they are kept.
fn only_spoonful(poured: &Poured) -> Spoonful {
    let apparatus = Apparatus {
        readability_mg: 1.0,
        repeatability_mg: None,
        capacity_mg: None,
        stroke: poured.stroke,
    };
    let (weighing, powder) = ("w".to_owned(), "salt".to_owned());
    let of = ShakesOf { weighing, powder, lot: None, session: None };
    let mut found = Spoonful::of(&poured.ticks, &apparatus, &of);
    assert_eq!(found.len(), 1, "{found:?}");
    found.remove(0)
}

#[test]
fn the_powder_on_an_emulated_bench_is_shaken_as_its_arm_says_it_moves() {
    // An arm that executes what it is told, but for its speed.
    let arm = arm::Settings { shake_gain: 1.0, shake_loss_mm: 0.0, ..Default::default() };
    let emulated = Emulated::new(lab::Settings { arm, ..Default::default() });
    let mut pouring = pouring();
    pouring.simulation.spoon.semi_axes_mm = [2.8, 2.0, 1.2];
    let poured = first_spoonful_of(&emulated, &pouring);
    let Simulation { set, spoon, seed, .. } = &pouring.simulation;
    // What is on record of the dose makes the dose again.
    let again = Replay::of(set, spoon, &only_spoonful(&poured), derive(*seed, &[0]));
    let fell_mg = |of: &Replay| replay(of).unwrap().fell_mg.iter().sum::<f64>();
    let (fell, again_mg) = (poured.dispensed_mg.unwrap(), fell_mg(&again));
    assert!(fell > 1.0 && (again_mg - fell).abs() < 0.02 * fell, "{fell} {again_mg}");
    // The published arm's gentler strokes would not.
    let mut gentle = again;
    gentle.steps.iter_mut().for_each(|step| step.acceleration_m_s2 = Some(1.1));
    assert!(fell_mg(&gentle) < 0.8 * fell, "{fell} {}", fell_mg(&gentle));
}

#[test]
fn a_film_of_a_simulated_dose_drops_what_the_dose_dropped() {
    let pouring = pouring();
    let poured = first_spoonful_of(&Simulated, &pouring);
    let Simulation { set, spoon, seed, .. } = &pouring.simulation;
    let replay = Replay {
        set: *set,
        settings: *spoon,
        steps: only_spoonful(&poured).shakes.iter().map(Into::into).collect(),
        seed: derive(*seed, &[0]),
    };
    let scene = Scene { replay, moves: Moves::AtOnce };
    let film = film(&scene, &mut |_, _| ControlFlow::Continue(())).unwrap();
    assert!(film.head.vial_mg > 1.0);
    assert_eq!(Some(film.head.vial_mg), poured.dispensed_mg, "to the last grain");
}

#[test]
fn the_shakes_of_a_dose_add_up_to_what_the_display_shows_and_are_what_the_arm_makes() {
    for case in cases() {
        let (kind, poured) = (case.rig.kind(), first_spoonful_of(&*case.rig, &pouring()));
        let stroke = poured.stroke.unwrap();
        // Calibrated shakes are corrected; those of a simulated spoon need no correction.
        assert_eq!(stroke.response.is_some(), kind == BenchKind::Emulated, "{kind:?}: {stroke:?}");
        let spoonful = only_spoonful(&poured);
        let mut shown = poured.ticks.iter().filter(|tick| tick.spoonful == 1);
        let ends = [shown.next_back(), shown.next()].map(|tick| tick.unwrap().reading.mass_mg);
        let shown_mg = ends[0] - ends[1];
        assert!((spoonful.fell_mg() - shown_mg).abs() < 1e-9, "{kind:?}");
        let reading_mg = poured.reading_mg.unwrap();
        let sd_mg = spoonful.shakes[0].sd_mg;
        assert!((spoonful.fell_mg() - reading_mg).abs() < 4.0 * sd_mg, "{kind:?}: {reading_mg}");
        let strokes = spoonful.shakes.iter().filter(|shake| shake.shake_mm > 0.0);
        assert_eq!(strokes.clone().count() as u32, poured.shakes, "{kind:?}");
        // The guard may have made them gentler than the controller asked for.
        for (shake, tick) in spoonful.shakes.iter().zip(&poured.ticks[1..]) {
            let asked_mm = tick.action.executed_shake_mm();
            assert!((shake.shake_mm - asked_mm).abs() < 1e-9, "{kind:?}: {shake:?}");
        }
        let most = stroke.limits.acceleration_m_s2 + 1e-9;
        let mut accelerations = strokes.map(|shake| shake.acceleration_m_s2.unwrap());
        assert!(accelerations.all(|it| it > 0.1 && it <= most), "{kind:?}: {spoonful:?}");
    }
}

#[test]
fn a_halt_during_a_dose_returns_before_it_and_ends_it() {
    for case in cases() {
        let kind = case.rig.kind();
        let (stop, mut ticks) = (AtomicBool::new(false), 0);
        let poured = case.pour(
            &mut |event| {
                ticks += u32::from(matches!(event, Event::Tick(_)));
                if ticks == 2 && !stop.swap(true, Ordering::SeqCst) {
                    // The dose waits here until the halt has returned.
                    let ((say, hear), rig) = (mpsc::channel(), case.rig.clone());
                    std::thread::spawn(move || say.send(rig.halt()).unwrap());
                    hear.recv_timeout(PATIENCE).expect("it waits for the dose").unwrap();
                }
                ControlFlow::Continue(())
            },
            &stop,
        );
        assert_eq!((poured.outcome, ticks), (Outcome::Stopped, 2), "{kind:?}: {poured:?}");
        case.assert_safe(&poured);
        let is_told = case.rig.exchanges().iter().any(|exchange| exchange.text.contains("Stop"));
        assert_eq!(is_told, kind.has_devices(), "{kind:?}: the arm itself");
    }
}

#[test]
fn a_halt_before_a_dose_returns_at_once_and_only_the_flag_keeps_the_dose_from_beginning() {
    for case in cases() {
        let kind = case.rig.kind();
        case.rig.halt().unwrap();
        let poured = case.pour(&mut |_| ControlFlow::Continue(()), &AtomicBool::new(true));
        assert_eq!(poured.outcome, Outcome::Stopped, "{kind:?}");
        assert_eq!((poured.shakes, poured.ticks.len()), (0, 0), "{kind:?}: {poured:?}");
        case.assert_safe(&poured);
        if let Some(laboratory) = &case.laboratory {
            assert_eq!(laboratory.dispensed_mg(), 0.0);
        }
        // It was for what moved then.
        assert_ne!(case.undisturbed().outcome, Outcome::Stopped, "{kind:?}");
    }
}

#[test]
fn what_may_not_be_recorded_does_not_move() {
    for case in cases() {
        let poured = case.pour(&mut |_| ControlFlow::Break(()), &AtomicBool::new(false));
        assert_eq!((poured.outcome, poured.shakes), (Outcome::Aborted, 0), "{poured:?}");
        case.assert_safe(&poured);
    }
}

#[test]
fn a_rig_that_cannot_exchange_vials_says_so_and_tares_the_same_vial_again() {
    for case in cases() {
        let kind = case.rig.kind();
        assert_eq!(case.rig.exchanges_vials(), kind != BenchKind::Devices);
        let (first, second) = (case.undisturbed(), case.undisturbed());
        let tare_mg = |poured: &Poured| poured.measured.as_ref().and_then(|it| it.tare_mg);
        if let Some((first_mg, second_mg)) = tare_mg(&first).zip(tare_mg(&second)) {
            // The display still counts from the first tare.
            let expected_mg =
                if case.rig.exchanges_vials() { first_mg } else { first.reading_mg.unwrap() };
            assert!((second_mg - expected_mg).abs() <= 2.0, "{kind:?}: {second_mg} mg");
        }
        if case.rig.exchanges_vials() {
            assert_eq!(first, second, "{kind:?}: a dose follows from its seed");
        }
    }
}

#[test]
fn an_arm_that_latched_itself_is_for_a_person_until_it_is_recovered() {
    let [simulated, emulated, devices] = cases();
    for case in [simulated, emulated] {
        case.rig.recover("Ada").unwrap();
        assert_eq!(case.rig.arm_latch().unwrap(), None);
    }
    let laboratory = devices.laboratory.as_ref().unwrap();
    let mut ticks = 0;
    let poured = devices.pour(
        &mut |event| {
            ticks += u32::from(matches!(event, Event::Tick(_)));
            if ticks == 2 {
                laboratory.arm.inject(Fault::UserStop);
            }
            ControlFlow::Continue(())
        },
        &AtomicBool::new(false),
    );
    let cause = devices.rig.arm_latch().unwrap().expect("it is latched");
    assert!(poured.must_look.as_ref().is_some_and(|why| why.contains(&cause)), "{poured:?}");
    assert_eq!(poured.outcome, Outcome::Aborted);
    laboratory.arm.clear();
    devices.rig.recover("Ada").unwrap();
    assert_eq!(devices.rig.arm_latch().unwrap(), None);
    assert!(laboratory.arm.is_level() && laboratory.arm.is_retracted());
}

#[test]
fn a_bench_whose_devices_are_not_there_moves_nothing_and_has_no_reading() {
    let laboratory = cases().into_iter().find_map(|case| case.laboratory).unwrap();
    let file = laboratory.file();
    drop(laboratory);
    let rig = Devices::new(file);
    let poured = rig.pour(&pouring(), &mut |_| ControlFlow::Continue(()), &AtomicBool::new(false));
    let expected = Poured { error: poured.error.clone(), ..Poured::not_begun(String::new()) };
    assert_eq!(poured, expected);
    assert!(poured.error.is_some_and(|why| !why.is_empty()));
    rig.halt().unwrap();
    assert!(rig.arm_latch().is_err() && rig.recover("Ada").is_err());
}
