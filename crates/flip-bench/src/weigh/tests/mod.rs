//! Does it stop, and is the spoon level and away afterwards? A scripted bench fails in every way at
//! every call.

mod halted;
mod hard;
mod probing;
mod scripted;
mod truth;

use super::forecast::{Fall, Forecast, Shaking};
use super::*;
use flip_core::domain::bench::{Action, PitchLimits};
use flip_policy::{Schedule, ScheduledStep};
use proptest::prelude::*;
use scripted::{Call, Display, EXCHANGED_MG, Fault, Scripted};

fn shaker(pitch_deg: f64, shake_mm: f64) -> Controller {
    Controller::Schedule(Schedule { steps: vec![ScheduledStep { pitch_deg, shake_mm }] })
}

const ORDER: Order = Order {
    target_mg: 10.0,
    tolerance_lower_mg: 1.0,
    tolerance_upper_mg: 1.0,
    readability_mg: 1.0,
};
/// Forecasts have their own tests: here the scripted falls must happen.
const BLIND: Settings = Settings { forecast: None, ..Settings::BENCH };

fn weigh_on(bench: &mut Scripted, rules: &Rules) -> Weighed {
    hear(bench, rules, &BLIND, |_| ControlFlow::Continue(()), &AtomicBool::new(false))
}

fn hear(
    bench: &mut Scripted,
    rules: &Rules,
    settings: &Settings,
    on_event: impl FnMut(&Event<'_>) -> ControlFlow<()>,
    stop: &AtomicBool,
) -> Weighed {
    weigh(bench, &shaker(8.0, 5.0), rules, &ORDER, settings, on_event, stop)
}

#[test]
fn a_dose_keeps_within_what_the_arm_can_do_and_the_policy_was_made_for() {
    let mut bench = Scripted::giving(&[2.0]);
    bench.reach =
        Reach { pitch: PitchLimits { lower_deg: -20.0, upper_deg: 5.0 }, shake_mm_max: 4.0 };
    let weighed = weigh_on(&mut bench, &Rules::FLIP);
    assert_eq!((weighed.outcome, weighed.cause), (Outcome::Within, None));
    let highest = |of: fn(&Tick) -> f64| weighed.ticks.iter().map(of).fold(0.0, f64::max);
    assert_eq!((highest(|tick| tick.pitch_deg), highest(|tick| tick.action.shake_mm)), (5.0, 4.0));
}

#[test]
fn where_arm_and_policy_have_no_range_in_common_nothing_moves_and_the_ranges_are_told() {
    for reach in [
        Reach { pitch: PitchLimits { lower_deg: -20.0, upper_deg: 0.0 }, ..Reach::FULL },
        Reach { pitch: PitchLimits { lower_deg: -30.0, upper_deg: -15.0 }, ..Reach::FULL },
        Reach { shake_mm_max: 0.5, ..Reach::FULL },
    ] {
        let mut bench = Scripted::giving(&[2.0]);
        bench.reach = reach;
        let weighed = weigh_on(&mut bench, &Rules::FLIP);
        let cause = weighed.cause.unwrap_or_default();
        assert_eq!(
            (weighed.outcome, weighed.must_look, bench.calls.len()),
            (Outcome::Aborted, false, 0),
            "{cause}"
        );
        assert!(
            cause.contains("the arm tilts its spoon from") && cause.contains("-10 to 50 deg"),
            "{cause}"
        );
    }
}

#[test]
fn a_dose_goes_through_its_phases_and_its_result_is_complete() {
    use Call::*;
    let mut bench = Scripted::giving(&[2.0]);
    let mut told = Vec::new();
    let note = |event: &Event<'_>| {
        told.push(match event {
            Event::Phase(phase) => format!("{phase:?}"),
            Event::Pan(flaw) => flaw.to_string(),
            Event::Decision(decision) => format!("decision {}", decision.step),
            Event::Tick(tick) => format!("tick {}", tick.step),
        });
        ControlFlow::Continue(())
    };
    let weighed = hear(&mut bench, &Rules::FLIP, &BLIND, note, &AtomicBool::new(false));
    let (steps, rest) = ([Act, Read].repeat(5), [Watch].repeat(11));
    let begun = [&[Stand, Approach, Tare], &rest[..], &[Read, Read]].concat();
    let ended = [&rest[..], &[Read, Level, Retract, Stand], &rest[..], &[Same, Discard]].concat();
    assert_eq!(bench.calls, [begun, steps, ended].concat());
    assert_eq!(told[..4], ["Armed", "Dosing", "tick 0", "decision 1"]);
    assert_eq!(told[told.len() - 3..], ["tick 5", "decision 6", "Settling"]);
    assert_eq!(
        (weighed.outcome, weighed.reading_mg, weighed.shakes),
        (Outcome::Within, Some(10.0), 5)
    );
    assert_eq!((weighed.tare_mg, weighed.gross_mg), (Some(12_000.0), Some(12_010.0)));
    assert_eq!((weighed.stable_by_flag, weighed.stable_by_window), (Some(true), Some(true)));
    assert_eq!((weighed.drift_before_mg_min, weighed.drift_after_mg_min), (Some(0.0), Some(0.0)));
    assert_eq!((weighed.zero_mg, weighed.proven), (Some(0.0), Some(true)));
    assert_eq!(
        (weighed.in_flight_mg, weighed.cause.clone(), weighed.must_look),
        (Some(0.0), None, false)
    );
    assert!(
        weighed.below_minimum_weight && weighed.below_class_minimum_weight,
        "no 10 mg on a balance of 1 mg"
    );
    assert!(
        (0.8..1.0).contains(&weighed.uncertainty_mg)
            && weighed.seconds > 10.0
            && weighed.ticks.len() == 6
    );
    assert!(bench.is_safe());
}

#[test]
fn even_a_policy_that_never_ends_early_adds_nothing_once_the_target_shows() {
    let mut bench = Scripted::giving(&[2.0]);
    let weighed = weigh_on(&mut bench, &Rules::PAPER);
    assert_eq!((weighed.reading_mg, bench.count(Call::Act)), (Some(10.0), 5));
}

#[test]
fn masses_decide_how_a_dose_ends() {
    for (gives_mg, outcome, acts) in [
        // Three times the steps used up, an avalanche, a late one, and just enough.
        (vec![0.1], Outcome::Under, 30),
        (vec![13.0], Outcome::Over, 1),
        (vec![2.0, 2.0, 2.0, 9.0], Outcome::Over, 4),
        (vec![5.0, 6.0], Outcome::Within, 2),
    ] {
        let mut bench = Scripted::giving(&gives_mg);
        let weighed = weigh_on(&mut bench, &Rules::FLIP);
        assert_eq!((weighed.outcome, bench.count(Call::Act)), (outcome, acts), "{gives_mg:?}");
        assert!(
            bench.is_safe() && !weighed.must_look && bench.count(Call::Discard) == 1,
            "{gives_mg:?}"
        );
    }
}

#[test]
fn a_display_that_dies_hides_one_shake_and_a_person_is_called() {
    for dies_at in 0..5 {
        let mut bench =
            Scripted { display: Display::dying_at(dies_at), ..Scripted::giving(&[2.0]) };
        let weighed = weigh_on(&mut bench, &Rules::PAPER);
        assert_eq!((weighed.outcome, weighed.must_look), (Outcome::Aborted, true), "{dies_at}");
        let cause = weighed.cause.unwrap();
        assert!(bench.is_safe() && cause.contains("the same number"), "{dies_at}");
        // The fifth shake would have been the last: its dose is not reported as within just because
        // nothing shows otherwise.
        assert_eq!((weighed.reading_mg, bench.mass_mg), (None, 2.0 * f64::from(dies_at + 1)));
        assert!(cause.contains(&format!("last showed {} mg", 2 * dies_at)), "{cause}");
        assert!(
            (60..63).contains(&bench.count(Call::Life)) && bench.count(Call::Discard) == 0,
            "{dies_at}"
        );
    }
}

#[test]
fn a_sound_display_is_waited_for_where_a_shake_changed_nothing_on_it_and_only_there() {
    for (gives_mg, waits) in
        [(&[2.0][..], 0), (&[0.1, 0.1, 3.0, 0.1, 7.0][..], 3), (&[0.0][..], 10)]
    {
        let mut bench = Scripted { display: Display::dying_at(99), ..Scripted::giving(gives_mg) };
        let weighed = weigh_on(&mut bench, &Rules::FLIP);
        assert_eq!((bench.count(Call::Life), weighed.must_look), (waits, false), "{gives_mg:?}");
        assert!(
            matches!(weighed.outcome, Outcome::Within | Outcome::Under),
            "{:?}",
            weighed.outcome
        );
    }
    // No waiting where a display stays constant for minutes when all is well.
    let mut bench = Scripted { display: Display::dying_at(2), ..Scripted::giving(&[2.0]) };
    let settings = Settings { life_s: 0.0, ..BLIND };
    hear(
        &mut bench,
        &Rules::FLIP,
        &settings,
        |_| ControlFlow::Continue(()),
        &AtomicBool::new(false),
    );
    assert_eq!((bench.count(Call::Life), bench.count(Call::Act)), (0, 10));
}

#[test]
fn a_display_that_changed_before_the_cell_felt_all_of_a_shake_is_waited_for() {
    // It changes at the reading, one call after the shake.
    let lives = |call_s| {
        let display = Display::dying_at(99);
        let mut bench = Scripted { display, call_s, ..Scripted::giving(&[2.0]) };
        let (hard, go) = (shaker(30.0, 16.0), AtomicBool::new(false));
        let on = |_: &Event<'_>| ControlFlow::Continue(());
        weigh(&mut bench, &hard, &Rules::FLIP, &ORDER, &Settings::BENCH, on, &go);
        assert!(bench.count(Call::Act) > 3, "{:?}", bench.calls);
        bench.count(Call::Life)
    };
    assert_eq!(lives(0.65), 0);
    assert!(lives(0.55) > 0);
}

#[test]
fn what_a_shake_gave_is_not_forgotten_where_an_incline_came_before_the_sign_of_life() {
    // 6 mg from the first shake, then an incline, and the display is waited for before the second
    // shake.
    let early = Display { is_early: true, ..Display::dying_at(99).unwrap() };
    let mut bench = Scripted { display: Some(early), ..Scripted::giving(&[6.0, 0.0, 0.0]) };
    let order = Order { target_mg: 20.0, ..ORDER };
    let steps = [8.0, 24.0].map(|pitch_deg| ScheduledStep { pitch_deg, shake_mm: 16.0 });
    let controller = Controller::Schedule(Schedule { steps: steps.to_vec() });
    let settings = Settings {
        forecast: Some(Forecast { first_chance: 0.0, ..Forecast::GENERIC }),
        ..Settings::BENCH
    };
    let (mut second, mut pitch_deg) = (None, 0.0);
    let watch = |event: &Event<'_>| {
        match event {
            Event::Decision(Decision { step: 3, allowed: Some(action), .. }) => {
                second = Some(*action)
            }
            Event::Tick(tick) if tick.step == 2 => pitch_deg = tick.pitch_deg,
            _ => {}
        }
        ControlFlow::Continue(())
    };
    weigh(&mut bench, &controller, &Rules::FLIP, &order, &settings, watch, &AtomicBool::new(false));
    let (second, first) =
        (second.unwrap(), Fall { pitch_deg: 8.0, shake_mm: 16.0, strokes: 1, mass_mg: 6.0 });
    assert!(bench.count(Call::Life) > 0 && pitch_deg == 16.0, "{:?}", bench.calls);
    let upper_mg = |falls: &[Fall]| {
        let pitch_deg = pitch_deg + second.incline_change_deg;
        settings.forecast.unwrap().upper_mg(
            falls,
            1.0,
            Shaking::once(pitch_deg, second.executed_shake_mm()),
        )
    };
    assert!(upper_mg(&[first]) <= 15.0, "{second:?} may give {} mg", upper_mg(&[first]));
}

#[test]
fn a_stop_is_heard_while_a_sign_of_life_is_waited_for() {
    static STOP: AtomicBool = AtomicBool::new(false);
    let display = Display::dying_at(0);
    let mut bench = Scripted { display, stops_in_life: Some(&STOP), ..Scripted::giving(&[2.0]) };
    let weighed = hear(&mut bench, &Rules::FLIP, &BLIND, |_| ControlFlow::Continue(()), &STOP);
    assert_eq!(
        (weighed.outcome, bench.count(Call::Life), bench.is_safe()),
        (Outcome::Stopped, 1, true)
    );
}

/// A fault at a call: the spoon is level and away or a person is called, and nothing acts after it.
fn check(call: Call, at: u32, fault: Fault) -> Weighed {
    let mut bench = Scripted::with(call, at, fault);
    let weighed = weigh_on(&mut bench, &Rules::FLIP);
    let case = format!("{fault:?} at {call:?} {at}");
    let mut seen = 0;
    let hit = bench.calls.iter().position(|it| {
        seen += u32::from(*it == call);
        *it == call && seen == at + 1
    });
    let hit = hit.unwrap_or_else(|| panic!("{case}: never came to it"));
    let motions = [Call::Act, Call::Approach, Call::Tare, Call::Discard];
    assert!(
        bench.calls[hit + 1..].iter().all(|it| !motions.contains(it)),
        "{case}: {:?}",
        bench.calls
    );
    assert_eq!(
        (bench.count(Call::Level), bench.calls.contains(&Call::Retract)),
        (1, call != Call::Level),
        "{case}"
    );
    assert!(bench.is_safe() || weighed.must_look, "{case}");
    assert!(weighed.cause.as_deref().is_some_and(|cause| cause.len() > 10), "{case}");
    assert!(
        weighed.reading_mg.is_none_or(f64::is_finite) && weighed.uncertainty_mg.is_finite(),
        "{case}"
    );
    let has_none = weighed.outcome == Outcome::Aborted || weighed.ticks.is_empty();
    assert_eq!(weighed.reading_mg.is_none(), has_none, "{case}: {:?}", weighed.reading_mg);
    weighed
}

#[test]
fn a_device_that_fails_at_any_call_aborts_and_a_person_is_called() {
    use Call::*;
    for call in [Stand, Approach, Tare, Watch, Read, Act, Level, Retract, Same, Discard] {
        let times = match call {
            Call::Act => 5,
            Call::Read => 8,
            Call::Stand => 2,
            Call::Watch => 33,
            _ => 1,
        };
        for at in 0..times {
            for fault in [Fault::Silent, Fault::Panics] {
                let weighed = check(call, at, fault);
                // Powder that cannot be returned does not change the dose.
                let outcome =
                    if call == Call::Discard { Outcome::Within } else { Outcome::Aborted };
                assert_eq!(weighed.outcome, outcome, "{fault:?} at {call:?} {at}");
                let looks = fault == Fault::Silent
                    || matches!(call, Call::Level | Call::Retract | Call::Discard);
                assert_eq!(weighed.must_look, looks, "{fault:?} at {call:?} {at}");
            }
        }
    }
}

#[test]
fn a_reading_that_cannot_be_trusted_ends_the_dose_by_its_name() {
    for at in 0..5 {
        for (fault, outcome) in [
            (Fault::NotANumber, Outcome::Aborted),
            (Fault::Unstable, Outcome::NotStable),
            (Fault::VialLifted, Outcome::Aborted),
        ] {
            let weighed = check(Call::Read, at, fault);
            assert_eq!((weighed.outcome, weighed.must_look), (outcome, false), "{fault:?} at {at}");
            assert_eq!(
                check(Call::Stand, 1, fault).outcome,
                outcome,
                "{fault:?} at the final reading"
            );
        }
    }
}

#[test]
fn a_vial_exchanged_between_the_watch_and_the_tare_is_not_poured_into() {
    let weighed = check(Call::Tare, 0, Fault::Exchanged);
    let halt = Halt::VialMoved { fell_mg: EXCHANGED_MG };
    assert_eq!((weighed.outcome, weighed.must_look), (Outcome::Aborted, false));
    assert_eq!((weighed.cause, weighed.reading_mg), (Some(halt.to_string()), None));
}

#[test]
fn a_balance_that_began_anew_in_the_dose_is_not_believed() {
    // The vial on the display again, at the first reading and after any shake; and a balance that
    // turns out at the end to be another one.
    for at in 1..7 {
        let weighed = check(Call::Read, at, Fault::Untared);
        assert_eq!(
            (weighed.outcome, weighed.must_look, weighed.reading_mg),
            (Outcome::Aborted, true, None),
            "{at}"
        );
        assert!(weighed.cause.unwrap().contains("restarted"), "{at}");
    }
    let weighed = check(Call::Same, 0, Fault::Untared);
    assert_eq!(
        (weighed.outcome, weighed.must_look, weighed.reading_mg),
        (Outcome::Aborted, true, None)
    );
}

#[test]
fn a_display_that_went_back_to_nothing_is_told_from_one_that_wanders() {
    let shown = |mass_mg: f64| Reading { mass_mg, stable: true };
    for (before_mg, now_mg, step_mg, is) in [
        (2.0, 0.0, 1.0, true),
        (1.5, 0.0, 0.1, true),
        (2.0, 1.0, 1.0, false),
        (1.0, 0.0, 1.0, false),
        (0.5, -0.2, 0.01, false),
        (3.0, -1.0, 1.0, false),
        (20.0, 5.0, 5.0, false),
        (10.0, 0.0, 5.0, true),
    ] {
        let found = closer::is_zeroed(shown(before_mg), shown(now_mg), step_mg);
        assert_eq!(found, is, "{before_mg} to {now_mg} mg in steps of {step_mg} mg");
    }
}

#[test]
fn mass_that_comes_without_a_shake_aborts() {
    let mut bench = Scripted::with(Call::Read, 2, Fault::Draught);
    let go = AtomicBool::new(false);
    // Two inclines before the first shake.
    let weighed = weigh(
        &mut bench,
        &shaker(16.0, 5.0),
        &Rules::FLIP,
        &ORDER,
        &BLIND,
        |_| ControlFlow::Continue(()),
        &go,
    );
    assert_eq!(
        (weighed.outcome, bench.count(Call::Act), bench.is_safe()),
        (Outcome::Aborted, 1, true)
    );
    assert!(weighed.cause.unwrap().contains("without a shake"));
}

#[test]
fn a_balance_that_is_restless_before_the_dose_does_not_hold_it_up() {
    let mut bench = Scripted::with(Call::Stand, 0, Fault::Unstable);
    assert_eq!(
        weigh_on(&mut bench, &Rules::FLIP).outcome,
        Outcome::Within,
        "the guard asks for each reading of the dose"
    );
}

#[test]
fn what_falls_while_the_spoon_is_levelled_is_told_and_judged() {
    let mut bench = Scripted { late_mg: 4.0, ..Scripted::giving(&[2.0]) };
    let weighed = weigh_on(&mut bench, &Rules::FLIP);
    assert_eq!(
        (weighed.outcome, weighed.reading_mg, weighed.in_flight_mg),
        (Outcome::Over, Some(14.0), Some(4.0))
    );
}
