//! Does it stop, and is the spoon level afterwards? A scripted bench misbehaves in every way it can.

use super::*;
use crate::policy::{Schedule, ScheduledStep};

/// What goes wrong, and at which call.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fault {
    None,
    TareFails,
    ReadFails(u32),
    ActFails(u32),
    LevelFails,
    NotANumber(u32),
    Unstable(u32),
    VialLifted(u32),
}

/// Every shake gives 2 mg, unless something is wrong.
struct Scripted {
    fault: Fault,
    pitch_deg: f64,
    mass_mg: f64,
    per_shake_mg: f64,
    reads: u32,
    acts: u32,
    levelled: bool,
}

impl Scripted {
    fn new(fault: Fault) -> Self {
        Self { fault, pitch_deg: 0.0, mass_mg: 0.0, per_shake_mg: 2.0, reads: 0, acts: 0, levelled: false }
    }
}

const SILENT: DeviceError = DeviceError::Silent { device: "the scripted device" };

impl Bench for Scripted {
    fn tare(&mut self) -> Result<(), DeviceError> {
        if self.fault == Fault::TareFails { Err(SILENT) } else { Ok(()) }
    }
    fn read(&mut self) -> Result<Reading, DeviceError> {
        let read = self.reads;
        self.reads += 1;
        match self.fault {
            Fault::ReadFails(at) if at == read => Err(SILENT),
            Fault::NotANumber(at) if at == read => Ok(Reading { mass_mg: f64::NAN, stable: true }),
            Fault::Unstable(at) if at == read => Ok(Reading { mass_mg: self.mass_mg, stable: false }),
            Fault::VialLifted(at) if at == read => Ok(Reading { mass_mg: -20_000.0, stable: true }),
            _ => Ok(Reading { mass_mg: self.mass_mg, stable: true }),
        }
    }
    fn act(&mut self, action: Action) -> Result<(), DeviceError> {
        let act = self.acts;
        self.acts += 1;
        self.levelled = false;
        if self.fault == Fault::ActFails(act) {
            return Err(SILENT);
        }
        self.pitch_deg += action.incline_change_deg;
        if action.executed_shake_mm() > 0.0 {
            self.mass_mg += self.per_shake_mg;
        }
        Ok(())
    }
    fn level(&mut self) -> Result<(), DeviceError> {
        if self.fault == Fault::LevelFails {
            return Err(SILENT);
        }
        self.pitch_deg = 0.0;
        self.levelled = true;
        Ok(())
    }
    fn pitch_deg(&self) -> f64 {
        self.pitch_deg
    }
    fn elapsed_s(&self) -> f64 {
        f64::from(self.reads)
    }
}

fn shaker() -> Controller {
    Controller::Schedule(Schedule { steps: vec![ScheduledStep { pitch_deg: 8.0, shake_mm: 5.0 }] })
}

const ORDER: Order = Order { target_mg: 10.0, tolerance_lower_mg: 1.0, tolerance_upper_mg: 1.0, readability_mg: 1.0 };

fn weigh_on(bench: &mut Scripted, rules: &Rules) -> Weighed {
    weigh(bench, &shaker(), rules, &ORDER, |_| {}, &AtomicBool::new(false))
}

#[test]
fn a_dose_ends_on_target_with_a_level_spoon_and_one_tick_for_each_step() {
    let mut bench = Scripted::new(Fault::None);
    let mut heard = 0;
    let weighed = weigh(&mut bench, &shaker(), &Rules::FLIP, &ORDER, |_| heard += 1, &AtomicBool::new(false));
    assert_eq!((weighed.outcome, weighed.reading_mg, weighed.shakes), (Outcome::Within, 10.0, 5));
    assert_eq!((weighed.ticks.len(), heard), (6, 6));
    assert!(bench.levelled && bench.pitch_deg == 0.0);
}

#[test]
fn even_a_policy_that_never_ends_early_adds_nothing_once_the_target_shows() {
    let mut bench = Scripted::new(Fault::None);
    let weighed = weigh_on(&mut bench, &Rules::PAPER);
    assert_eq!((weighed.reading_mg, bench.acts), (10.0, 5));
}

#[test]
fn an_order_that_the_steps_cannot_fill_ends_under() {
    let mut bench = Scripted { per_shake_mg: 0.1, ..Scripted::new(Fault::None) };
    let weighed = weigh_on(&mut bench, &Rules::FLIP);
    assert_eq!((weighed.outcome, weighed.shakes, bench.acts), (Outcome::Under, 10, 10));
    assert!(bench.levelled);
}

#[test]
fn an_avalanche_ends_over_and_nothing_more_is_poured() {
    let mut bench = Scripted { per_shake_mg: 13.0, ..Scripted::new(Fault::None) };
    let weighed = weigh_on(&mut bench, &Rules::FLIP);
    assert_eq!((weighed.outcome, bench.acts), (Outcome::Over, 1));
}

#[test]
fn every_fault_aborts_names_its_cause_and_levels_the_spoon() {
    for fault in [
        Fault::TareFails,
        Fault::ReadFails(0),
        Fault::ReadFails(3),
        Fault::ActFails(0),
        Fault::ActFails(2),
        Fault::NotANumber(2),
        Fault::Unstable(1),
        Fault::VialLifted(2),
    ] {
        let mut bench = Scripted::new(fault);
        let weighed = weigh_on(&mut bench, &Rules::FLIP);
        assert_eq!(weighed.outcome, Outcome::Aborted, "{fault:?}");
        assert!(weighed.cause.as_deref().is_some_and(|cause| cause.len() > 10), "{fault:?}");
        assert!(bench.levelled && weighed.reading_mg.is_finite(), "{fault:?}");
    }
}

#[test]
fn a_spoon_that_cannot_be_levelled_is_said_so() {
    let mut bench = Scripted::new(Fault::LevelFails);
    let weighed = weigh_on(&mut bench, &Rules::FLIP);
    assert_eq!(weighed.outcome, Outcome::Aborted);
    assert!(weighed.cause.unwrap().contains("could not be levelled"));
}

#[test]
fn a_stop_is_obeyed_before_the_next_motion() {
    let mut bench = Scripted::new(Fault::None);
    let stop = AtomicBool::new(false);
    let press = |tick: &Tick| stop.store(tick.step == 2, Ordering::SeqCst);
    let weighed = weigh(&mut bench, &shaker(), &Rules::FLIP, &ORDER, press, &stop);
    assert_eq!((weighed.outcome, bench.acts), (Outcome::Stopped, 2));
    assert!(bench.levelled);
}

#[test]
fn a_controller_that_panics_leaves_a_level_spoon() {
    let mut bench = Scripted::new(Fault::None);
    let panic = |tick: &Tick| assert!(tick.step < 2, "a bug");
    let weighed = weigh(&mut bench, &shaker(), &Rules::FLIP, &ORDER, panic, &AtomicBool::new(false));
    assert_eq!(weighed.outcome, Outcome::Aborted);
    assert!(bench.levelled);
}

#[test]
fn tolerances_are_judged_by_the_reading_on_either_side() {
    let order = Order { target_mg: 15.0, tolerance_lower_mg: 2.0, tolerance_upper_mg: 0.1, readability_mg: 1.0 };
    for (reading, outcome) in
        [(12.9, Outcome::Under), (13.0, Outcome::Within), (15.1, Outcome::Within), (15.2, Outcome::Over)]
    {
        assert_eq!(judge(&order, reading), outcome, "{reading}");
    }
}
