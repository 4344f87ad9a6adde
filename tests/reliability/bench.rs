//! One weighing in an emulated laboratory, with a fault that begins at a given moment.

use crate::cases::{Case, Course, Fault, When};
use crate::record::{Entry, Record};
use flip_bench::emulate::arm::{self, Flow, FormulaSpoon, Pour, Spoon};
use flip_bench::emulate::balance;
use flip_bench::emulate::lab::{self, Laboratory};
use flip_bench::hardware::arm::Deadlines;
use flip_bench::hardware::clock::Clock;
use flip_bench::hardware::station::Station;
use flip_bench::hardware::wire::{Direction, Exchange, Tap};
use flip_bench::weigh::{Order, Phase, Settings, Weighed, weigh};
use flip_core::domain::bench::{Action, PitchLimits};
use flip_policy::{Controller, Ending, Paced, Rules};
use std::ops::ControlFlow;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, Weak};
use std::time::{Duration, Instant};

/// Late in a dose: this share of the target lies in the vial.
const LATE_SHARE: f64 = 0.6;
/// Longest time for an answer of the balance, and delay of a slow one, s.
const ANSWER_S: f64 = 0.9;
const SLOW_REPLY_MS: u64 = 1000;
/// Longer than a busy machine delays a thread, so that no case has an unplanned fault.
const DEAD_MAN_MS: u32 = 1200;
/// Longest time for the arm to come to rest once nobody controls it.
const REST: Duration = Duration::from_secs(8);
const RULES: Rules = Rules { steps_max: 30, ending: Ending::OnTarget, pitch: PitchLimits::WIDE };

/// A dose to weigh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dose {
    pub target_mg: f64,
    pub seed: u64,
}

impl Dose {
    /// Target and accepted excess, mg.
    pub fn limit_mg(&self) -> f64 {
        self.order().target_mg + self.order().tolerance_upper_mg
    }

    fn order(&self) -> Order {
        Order {
            target_mg: self.target_mg,
            tolerance_lower_mg: 1.0,
            tolerance_upper_mg: 1.0,
            readability_mg: 1.0,
        }
    }
}

/// The result of a run.
#[derive(Debug)]
pub struct Ran {
    /// The weighing, or why the bench could not be opened.
    pub weighed: Result<Weighed, String>,
    pub record: Record,
    /// Mass that fell into the vial, mg.
    pub vial_mg: f64,
    pub is_level: bool,
    pub is_retracted: bool,
    pub latched: Option<&'static str>,
}

/// Runs a weighing, with this fault if there is one.
pub fn run(dose: Dose, case: Option<Case>) -> Ran {
    let clock = Clock::standing();
    let bell = Bell::default();
    let spoon = Probe { spoon: FormulaSpoon::new(Flow::default(), dose.seed), bell: bell.clone() };
    let settings = lab::Settings {
        balance: balance::Settings {
            seed: dose.seed,
            slow_reply_ms: SLOW_REPLY_MS,
            ..Default::default()
        },
        arm: arm::Settings { dead_man_ms: DEAD_MAN_MS, ..Default::default() },
        ..Default::default()
    };
    let laboratory =
        Laboratory::start(settings, clock.clone(), Box::new(spoon)).expect("a laboratory");
    let mut file = laboratory.file();
    file.balance.timeout_s = ANSWER_S;
    let watcher = Arc::new(Watcher::new(dose, case, laboratory));
    let _ = bell.0.set(Arc::downgrade(&watcher));
    watcher.opening();
    let hearing = watcher.clone();
    let tap = Tap::new(move |exchange| hearing.passed(exchange));
    let weighed = match Station::open_within(deadlines(), &file, None, clock, &tap) {
        Ok(mut station) => Ok(dosed(&mut station, dose, &watcher)),
        Err(error) => Err(error.to_string()),
    };
    watcher.ended(weighed)
}

fn deadlines() -> Deadlines {
    Deadlines { motion: Duration::from_millis(1500), ..Deadlines::default() }
}

fn dosed(station: &mut Station, dose: Dose, watcher: &Watcher) -> Weighed {
    let controller = Controller::Paced(Paced::CHOSEN);
    let hear = |event: &flip_bench::weigh::Event<'_>| {
        watcher.heard(event);
        ControlFlow::Continue(())
    };
    weigh(
        station,
        &controller,
        &RULES,
        &dose.order(),
        &Settings::BENCH,
        hear,
        &AtomicBool::new(false),
    )
}

/// Rings when a shake has begun.
#[derive(Clone, Default)]
struct Bell(Arc<OnceLock<Weak<Watcher>>>);

/// A spoon that reports when its powder comes loose.
struct Probe {
    spoon: FormulaSpoon,
    bell: Bell,
}

impl Spoon for Probe {
    fn step(&mut self, action: Action) -> Pour {
        if action.shake_mm > 0.0
            && let Some(watcher) = self.bell.0.get().and_then(Weak::upgrade)
        {
            watcher.pouring();
        }
        self.spoon.step(action)
    }

    fn keep(&mut self, mass_mg: f64) {
        self.spoon.keep(mass_mg);
    }

    fn refill(&mut self) {
        self.spoon.refill();
    }

    fn empty(&mut self) {
        self.spoon.empty();
    }

    fn pitch_deg(&self) -> f64 {
        self.spoon.pitch_deg()
    }

    fn held_mg(&self) -> f64 {
        self.spoon.held_mg()
    }
}

/// Keeps the record and lets the fault begin and end at its moment.
struct Watcher {
    dose: Dose,
    case: Option<Case>,
    state: Mutex<State>,
}

struct State {
    laboratory: Laboratory,
    record: Record,
    shakes: u32,
    /// Queries to the balance in this phase, and since the last shake.
    questions: u32,
    since_shake: u32,
    injected: bool,
    /// Messages to the device until a passing fault is over.
    passes_in: Option<u32>,
}

impl Watcher {
    fn new(dose: Dose, case: Option<Case>, laboratory: Laboratory) -> Self {
        let state = State {
            laboratory,
            record: Record::default(),
            shakes: 0,
            questions: 0,
            since_shake: 0,
            injected: false,
            passes_in: None,
        };
        Self { dose, case, state: Mutex::new(state) }
    }

    fn locked(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn opening(&self) {
        self.inject_if(&mut self.locked(), |when| when == When::Opening);
    }

    fn heard(&self, event: &flip_bench::weigh::Event<'_>) {
        let mut state = self.locked();
        let vial_mg = state.vial_mg();
        state.record.hear(event, vial_mg);
        if matches!(event, flip_bench::weigh::Event::Phase(_)) {
            state.questions = 0;
        }
    }

    fn pouring(&self) {
        let mut state = self.locked();
        let course = state.course(&self.dose);
        let is_first = state.shakes == 1;
        self.inject_if(&mut state, |when| match when {
            When::Pouring(Course::Early) => is_first,
            When::Pouring(Course::Late) => course == Course::Late,
            _ => false,
        });
    }

    fn passed(&self, exchange: Exchange) {
        let mut state = self.locked();
        let sent = (exchange.direction == Direction::Sent)
            .then(|| (exchange.device.clone(), exchange.text.clone()));
        state.record.entries.push(Entry::Passed(exchange));
        if let Some((device, text)) = sent {
            state.count(&device, &text);
            self.pass(&mut state, &device);
            let (phase, course) = (state.record.phase(), state.course(&self.dose));
            let State { shakes, questions, since_shake, .. } = *state;
            let moment = Moment {
                device: &device,
                text: &text,
                phase,
                course,
                shakes,
                questions,
                since_shake,
            };
            self.inject_if(&mut state, |when| moment.is(when));
        }
    }

    fn inject_if(&self, state: &mut State, is_now: impl Fn(When) -> bool) {
        let Some(case) = self.case.filter(|case| !state.injected && is_now(case.when)) else {
            return;
        };
        let vial_mg = state.vial_mg();
        state.record.entries.push(Entry::Injected { vial_mg });
        state.injected = true;
        state.passes_in = (!case.lasting).then(|| case.fault.answers());
        let answers = if case.lasting { u32::MAX } else { case.fault.answers() };
        match case.fault {
            // Faults that do not affect answers end with a message, below.
            Fault::Balance(balance::Fault::VialLifted) => {
                state.laboratory.balance.inject(balance::Fault::VialLifted)
            }
            Fault::Balance(fault) => state.laboratory.balance.inject_for(fault, answers),
            Fault::Arm(fault) => state.laboratory.arm.inject(fault),
            Fault::Gripper(fault) => state.laboratory.fingers.cause(fault, answers),
        }
    }

    /// Counts one message towards the end of a passing fault.
    fn pass(&self, state: &mut State, device: &str) {
        let Some(case) = self.case.filter(|case| case.fault.device() == device) else { return };
        state.passes_in = match state.passes_in {
            Some(1) => {
                match case.fault {
                    Fault::Balance(balance::Fault::VialLifted) => state.laboratory.balance.clear(),
                    Fault::Arm(_) => state.laboratory.arm.clear(),
                    _ => {}
                }
                None
            }
            left => left.map(|left| left - 1),
        };
    }

    /// Waits until the arm rests, and returns the final state.
    fn ended(&self, weighed: Result<Weighed, String>) -> Ran {
        let began = Instant::now();
        let rests = |state: &State| {
            let arm = &state.laboratory.arm;
            !arm.is_moving() && ((arm.is_level() && arm.is_retracted()) || arm.latched().is_some())
        };
        while !rests(&self.locked()) && began.elapsed() < REST {
            std::thread::sleep(Duration::from_millis(5));
        }
        let mut state = self.locked();
        let arm = &state.laboratory.arm;
        let (is_level, is_retracted, latched) = (arm.is_level(), arm.is_retracted(), arm.latched());
        let vial_mg = state.vial_mg();
        Ran {
            weighed,
            record: std::mem::take(&mut state.record),
            vial_mg,
            is_level,
            is_retracted,
            latched,
        }
    }
}

impl State {
    /// Mass that has fallen into the vial, mg, wherever the vial is now.
    fn vial_mg(&self) -> f64 {
        self.laboratory.arm.log().iter().map(|event| event.poured_mg).sum()
    }

    fn course(&self, dose: &Dose) -> Course {
        if self.vial_mg() >= LATE_SHARE * dose.target_mg { Course::Late } else { Course::Early }
    }

    fn count(&mut self, device: &str, text: &str) {
        match device {
            "the balance" => {
                (self.questions, self.since_shake) = (self.questions + 1, self.since_shake + 1)
            }
            _ if text.contains("Shake by") => {
                (self.shakes, self.since_shake) = (self.shakes + 1, 0)
            }
            _ => {}
        }
    }
}

/// A message that is about to be sent, and how far the weighing has come.
struct Moment<'a> {
    device: &'a str,
    text: &'a str,
    phase: Option<Phase>,
    course: Course,
    shakes: u32,
    questions: u32,
    since_shake: u32,
}

impl Moment<'_> {
    fn is(&self, when: When) -> bool {
        let asks = |phase| self.device == "the balance" && self.phase == Some(phase);
        let moves = |phase, motion: &str| {
            self.device == "the arm" && self.phase == Some(phase) && self.text.contains(motion)
        };
        let is_at = |course, first| {
            if course == Course::Late { self.course == course } else { self.shakes <= first }
        };
        match when {
            When::Opening | When::Pouring(_) => false,
            When::StandBefore => asks(Phase::Armed) && self.questions == 2,
            When::Scoop => moves(Phase::Armed, "Scoop"),
            When::Approach => moves(Phase::Armed, "Approach"),
            When::Tare => asks(Phase::Armed) && self.text.starts_with('T'),
            When::FirstRead => asks(Phase::Dosing) && self.questions == 1,
            When::Incline(course) => moves(Phase::Dosing, "Pitch to") && is_at(course, 0),
            When::Shake(course) => moves(Phase::Dosing, "Shake by") && is_at(course, 1),
            When::Read(course) => {
                asks(Phase::Dosing) && self.shakes > 0 && self.since_shake == 1 && is_at(course, 1)
            }
            When::Level => moves(Phase::Settling, "Pitch to 0 deg"),
            When::Retract => moves(Phase::Settling, "Retract"),
            When::FinalStand => asks(Phase::Settling) && self.questions == 3,
            When::Discard => moves(Phase::Settling, "Discard"),
            When::Release => moves(Phase::Settling, "Release"),
        }
    }
}
