//! A probing run: its course, its limit, and that it ends like any dose.

use super::*;
use flip_core::domain::bench::Reach;
use flip_core::domain::weighing::Probe;

const LIMIT: Order =
    Order { target_mg: 120.0, tolerance_lower_mg: 0.0, tolerance_upper_mg: 0.0, ..ORDER };

fn settings(spoonfuls: u32) -> Settings {
    let settings = Settings::for_target(LIMIT.target_mg, Some(30.0));
    Settings { spoon_mg: Some(30.0), probe: Some(Probe { spoonfuls }), ..settings }
}

/// Nothing up to 18 deg, then this from each shake while the spoon of 30 mg has any.
fn flowing(each_mg: f64) -> Scripted {
    let gives_mg = [vec![0.0; 8], vec![each_mg]].concat();
    Scripted { refills: true, spoon_mg: Some([30.0; 2]), ..Scripted::giving(&gives_mg) }
}

fn probed(bench: &mut Scripted, order: &Order, settings: &Settings) -> Weighed {
    let go = AtomicBool::new(false);
    let on = |_: &Event<'_>| ControlFlow::Continue(());
    weigh(bench, &shaker(0.0, 0.0), &Rules::FLIP, order, settings, on, &go)
}

#[test]
fn pitch_rises_by_steps_and_each_spoonful_has_its_stroke_and_begins_below_the_onset() {
    let mut bench = flowing(1.0);
    let weighed = probed(&mut bench, &LIMIT, &settings(3));
    assert_eq!((weighed.outcome, weighed.cause.as_deref()), (Outcome::Probed, None));
    let course = |spoonful: u32| {
        let of = weighed.ticks.iter().filter(|tick| tick.spoonful == spoonful);
        let shaken = of.filter(|tick| tick.action.executed_shake_mm() > 0.0);
        shaken.map(|tick| (tick.pitch_deg, tick.action)).collect::<Vec<_>>()
    };
    for (spoonful, from_deg, shake_mm) in [(1, 6.0, 16.0), (2, 18.0, 8.0), (3, 18.0, 4.0)] {
        let shakes = course(spoonful);
        let (rows, last) = shakes.split_at(shakes.len() - 4);
        assert_eq!((rows[0].0, rows.last().unwrap().0), (from_deg, 50.0), "{spoonful}");
        for (k, (pitch_deg, action)) in rows.iter().enumerate() {
            assert!((pitch_deg - from_deg - 4.0 * (k / 2) as f64).abs() < 1e-9, "{spoonful} {k}");
            assert_eq!((action.shake_mm, action.strokes), (shake_mm, 1), "{spoonful}: {k}");
        }
        let hard = |(pitch_deg, action): &(f64, Action)| {
            (*pitch_deg, action.shake_mm, action.strokes) == (50.0, 16.0, 4)
        };
        assert!(last.iter().all(hard), "{last:?}");
    }
    assert_eq!((bench.count(Call::Approach), bench.count(Call::Tare)), (3, 1));
    assert_eq!((bench.count(Call::Discard), bench.is_safe()), (3, true));
    assert!(weighed.proven.is_none() && !weighed.must_look);
}

#[test]
fn a_spoon_that_is_spent_goes_to_the_last_row_at_once() {
    let mut bench = flowing(10.0);
    let weighed = probed(&mut bench, &LIMIT, &settings(1));
    let shakes = bench.actions.iter().filter(|(_, action)| action.shake_mm > 0.0).count();
    // Four silent pitches, two in which all of it fell, one of silence, the last row.
    assert_eq!(
        (weighed.outcome, shakes, weighed.reading_mg),
        (Outcome::Probed, 8 + 4 + 2 + 4, Some(30.0))
    );
}

#[test]
fn where_a_person_fills_the_spoon_one_spoonful_is_all() {
    let mut bench = Scripted { refills: false, ..flowing(1.0) };
    let weighed = probed(&mut bench, &LIMIT, &settings(3));
    assert_eq!((weighed.outcome, bench.count(Call::Approach)), (Outcome::Probed, 1));
    assert!(weighed.ticks.iter().all(|tick| tick.spoonful == 1) && bench.is_safe());
}

#[test]
fn no_more_falls_than_the_limit_allows_and_a_forecast_keeps_below_it() {
    let order = Order { target_mg: 25.0, ..LIMIT };
    // Without a forecast the shake that passes the limit is the last.
    let blind = Settings { forecast: None, ..settings(3) };
    let mut bench = flowing(4.0);
    let weighed = probed(&mut bench, &order, &blind);
    assert_eq!((weighed.outcome, weighed.reading_mg), (Outcome::Probed, Some(28.0)));
    assert!(weighed.cause.unwrap().contains("the limit of 25 mg"));
    let mut bench = flowing(4.0);
    let weighed = probed(&mut bench, &order, &settings(3));
    assert_eq!(weighed.outcome, Outcome::Probed);
    assert!(weighed.reading_mg.is_some_and(|mg| (8.0..=25.0).contains(&mg)), "{weighed:?}");
    assert!(bench.is_safe() && bench.count(Call::Approach) == 1);
}

#[test]
fn the_arm_and_the_policy_bound_the_pitch_and_the_stroke() {
    let pitch = |upper_deg| PitchLimits { lower_deg: -10.0, upper_deg };
    for (arm_deg, policy_deg, end_deg) in [(60.0, 50.0, 50.0), (33.0, 90.0, 33.0)] {
        let reach = Reach { pitch: pitch(arm_deg), shake_mm_max: 10.0 };
        let mut bench = Scripted { reach, ..flowing(1.0) };
        let rules = Rules { pitch: pitch(policy_deg), ..Rules::FLIP };
        let (go, on) = (AtomicBool::new(false), |_: &Event<'_>| ControlFlow::Continue(()));
        weigh(&mut bench, &shaker(0.0, 0.0), &rules, &LIMIT, &settings(2), on, &go);
        let highest =
            |of: fn(&(f64, Action)) -> f64| bench.actions.iter().map(of).fold(0.0, f64::max);
        assert!((highest(|it| it.0) - end_deg).abs() < 1e-9, "{end_deg}");
        assert_eq!(highest(|it| it.1.shake_mm), 10.0);
    }
}

#[test]
fn a_powder_that_never_flows_is_a_result_that_says_what_else_it_may_be() {
    let mut bench = Scripted { refills: true, ..Scripted::giving(&[0.0]) };
    let weighed = probed(&mut bench, &LIMIT, &settings(3));
    assert_eq!((weighed.outcome, weighed.reading_mg), (Outcome::Probed, Some(0.0)));
    assert!(weighed.cause.unwrap().contains("nothing fell"));
    // Spoonfuls after one that never flowed begin near the end of the pitch.
    let second = weighed.ticks.iter().find(|tick| tick.spoonful == 2 && tick.action.shake_mm > 0.0);
    assert_eq!(second.map(|tick| tick.pitch_deg), Some(46.0));
}

#[test]
fn a_stop_or_an_unrecorded_event_ends_it_wherever_it_comes() {
    let count = {
        let (mut bench, mut n) = (flowing(2.0), 0);
        let count = |_: &Event<'_>| {
            n += 1;
            ControlFlow::Continue(())
        };
        let go = AtomicBool::new(false);
        weigh(&mut bench, &shaker(0.0, 0.0), &Rules::FLIP, &LIMIT, &settings(3), count, &go);
        n
    };
    assert!(count > 60, "{count}");
    for (n, stops) in (0..count - 1).flat_map(|n| [(n, true), (n, false)]) {
        let (mut bench, stop) = (flowing(2.0), AtomicBool::new(false));
        let (mut heard, mut acts) = (0, 0);
        let on = |event: &Event<'_>| {
            let is_act = matches!(event, Event::Decision(it) if it.reason.is_none());
            acts += u32::from(is_act && heard < n);
            heard += 1;
            stop.store(stops && heard > n, Ordering::SeqCst);
            if heard > n && !stops { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        let weighed =
            weigh(&mut bench, &shaker(0.0, 0.0), &Rules::FLIP, &LIMIT, &settings(3), on, &stop);
        let outcome = if stops { Outcome::Stopped } else { Outcome::Aborted };
        assert_eq!((weighed.outcome, bench.count(Call::Act)), (outcome, acts), "{n} {stops}");
        assert!(bench.is_safe(), "{n} {stops}");
    }
}

#[test]
fn a_device_that_fails_at_any_call_aborts_it_and_a_person_is_called() {
    let calls = {
        let mut bench = flowing(2.0);
        probed(&mut bench, &LIMIT, &settings(2));
        bench.calls
    };
    for call in [Call::Approach, Call::Tare, Call::Read, Call::Act, Call::Level, Call::Retract] {
        let times = calls.iter().filter(|it| **it == call).count() as u32;
        assert!(times > u32::from(call != Call::Tare), "{call:?}");
        for at in 0..times {
            let mut bench = Scripted { fault: Some((call, at, Fault::Silent)), ..flowing(2.0) };
            let weighed = probed(&mut bench, &LIMIT, &settings(2));
            let case = format!("{call:?} {at}");
            assert_eq!((weighed.outcome, weighed.must_look), (Outcome::Aborted, true), "{case}");
            assert_eq!(weighed.reading_mg, None, "{case}");
        }
    }
    let mut bench = Scripted { fault: Some((Call::Read, 30, Fault::VialLifted)), ..flowing(2.0) };
    let weighed = probed(&mut bench, &LIMIT, &settings(2));
    assert!(weighed.outcome == Outcome::Aborted && bench.is_safe());
}

#[test]
fn a_display_that_stops_is_noticed() {
    // By its signs of life, before the next shake.
    let display = Display::dying_at(12);
    let mut bench = Scripted { display, ..flowing(2.0) };
    let weighed = probed(&mut bench, &LIMIT, &settings(3));
    assert_eq!((weighed.outcome, weighed.must_look), (Outcome::Aborted, true));
    assert!(bench.count(Call::Act) < 16 && weighed.cause.unwrap().contains("the same number"));
    // Where a sound display stands for minutes, by a spoonful of silence after one that flowed.
    let still = Settings { life_s: 0.0, ..settings(3) };
    let mut bench = Scripted { display, ..flowing(2.0) };
    let weighed = probed(&mut bench, &LIMIT, &still);
    assert_eq!((weighed.outcome, weighed.must_look), (Outcome::Aborted, true));
    assert!(bench.count(Call::Approach) == 2 && weighed.cause.unwrap().contains("stands still"));
    let mut bench = Scripted { display: Display::dying_at(999), ..flowing(2.0) };
    assert_eq!(probed(&mut bench, &LIMIT, &still).outcome, Outcome::Probed);
}
