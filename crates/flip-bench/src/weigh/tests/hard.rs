//! Powders that do not flow, and targets that one spoonful does not hold.

use super::*;
use flip_core::domain::bench::Reach;
use flip_policy::Paced;

const RULES: Rules = Rules { steps_max: 30, ..Rules::FLIP };

fn weigh_hard(bench: &mut Scripted, order: &Order, settings: &Settings) -> (Weighed, Vec<String>) {
    let mut said = Vec::new();
    let note = |event: &Event<'_>| {
        if let Event::Decision(Decision { reason: Some(reason), .. }) = event {
            said.push(reason.clone());
        }
        ControlFlow::Continue(())
    };
    let go = AtomicBool::new(false);
    let weighed = weigh(bench, &shaker(50.0, 16.0), &RULES, order, settings, note, &go);
    (weighed, said)
}

/// Strokes at the end of the pitch, step by step.
fn strokes(bench: &Scripted) -> Vec<u32> {
    let shaken = bench.actions.iter().filter(|(_, action)| action.shake_mm > 0.0);
    shaken.map(|(_, action)| action.strokes).collect()
}

#[test]
fn every_rung_is_tried_before_a_spoon_is_blocked_and_what_is_left_is_said() {
    let mut bench = Scripted::giving(&[0.0]);
    let settings = Settings { spoon_mg: Some(37.0), ..BLIND };
    let (weighed, said) = weigh_hard(&mut bench, &ORDER, &settings);
    // Ever more strokes; eight on the level spoon; and the same again.
    assert_eq!(strokes(&bench), [1, 2, 4, 8, 8, 1, 2, 4, 8]);
    assert_eq!(said.iter().filter(|it| it.contains("loosen")).count(), 1);
    assert_eq!(weighed.outcome, Outcome::Blocked);
    let cause = weighed.cause.unwrap();
    assert!(cause.contains("blocked") && cause.contains("about 37 mg"), "{cause}");
    assert!(bench.is_safe() && !weighed.must_look && bench.count(Call::Approach) == 1);
}

#[test]
fn an_arm_that_fills_its_spoon_tries_a_new_spoonful_and_no_more_than_allowed() {
    let mut bench = Scripted { refills: true, ..Scripted::giving(&[0.0]) };
    let (weighed, said) = weigh_hard(&mut bench, &ORDER, &BLIND);
    assert_eq!((weighed.outcome, bench.count(Call::Approach)), (Outcome::Blocked, 3));
    assert_eq!(said.iter().filter(|it| it.contains("filled anew")).count(), 2);
    assert_eq!(weighed.ticks.last().map(|tick| tick.spoonful), Some(3));
    // The vial is tared once, whatever the number of spoonfuls.
    assert!(bench.is_safe() && bench.count(Call::Tare) == 1);
}

#[test]
fn a_powder_that_comes_in_pieces_gets_a_new_spoonful_once_it_is_silent() {
    // A powder of which a steep spoon may be shaken at once.
    let known = Forecast { level: -6.0, level_sd: 0.3, ..Forecast::GENERIC.in_pieces() };
    let settings = Settings { forecast: Some(known), ..BLIND };
    let mut bench = Scripted { refills: true, ..Scripted::giving(&[0.0]) };
    let (weighed, said) = weigh_hard(&mut bench, &ORDER, &settings);
    assert_eq!(said.iter().filter(|it| it.contains("filled anew")).count(), 2, "{said:?}");
    let shakes_of = |spoonful: u32| {
        let of = weighed.ticks.iter().filter(|tick| tick.spoonful == spoonful);
        of.filter(|tick| tick.action.executed_shake_mm() > 0.0 && tick.pitch_deg > 49.0).count()
    };
    assert_eq!([1, 2].map(shakes_of), [6, 6]);
    assert!(shakes_of(3) > 6, "the last one is tried like any other");
    assert!(weighed.outcome != Outcome::Within && bench.count(Call::Approach) == 3);
    // A bench that cannot fill its spoon goes on gently while a piece might exceed the room, and up
    // the ladder where none would.
    let loosened = |target_mg: f64| {
        let order = Order { target_mg, ..ORDER };
        let (_, said) = weigh_hard(&mut Scripted::giving(&[0.0]), &order, &settings);
        said.iter().filter(|it| it.contains("loosen")).count()
    };
    assert_eq!([10.0, 60.0].map(loosened), [0, 1]);
}

/// What shakes at 50 deg give: the spoon takes six steps there.
fn after_the_way_up(gives_mg: &[f64]) -> Vec<f64> {
    [&[0.0; 6], gives_mg].concat()
}

#[test]
fn a_spoon_too_lively_for_what_is_missing_is_filled_anew_unless_it_is_so_at_once() {
    // Neither the pitch nor the stroke makes it gentler.
    let lively = Forecast { per_deg: 0.0, per_ln_mm: 0.0, first_chance: 0.0, ..Forecast::GENERIC };
    // 9 mg is at the tolerance: wander may hide on which side, so another spoonful follows.
    for (level, outcome, expected) in [(-4.0, Outcome::Within, 2), (-1.0, Outcome::Under, 1)] {
        let settings = Settings { forecast: Some(Forecast { level, ..lively }), ..BLIND };
        let mut bench =
            Scripted { refills: true, ..Scripted::giving(&after_the_way_up(&[8.0, 1.0])) };
        let (weighed, said) = weigh_hard(&mut bench, &ORDER, &settings);
        let refills = said.iter().filter(|it| it.contains("begins gently")).count();
        assert_eq!((weighed.outcome, refills), (outcome, expected), "{said:?}");
        assert!(!said.iter().any(|it| it.contains("lowered")) && bench.is_safe(), "{said:?}");
    }
}

#[test]
fn a_spoon_too_lively_at_its_pitch_is_lowered_without_a_shake_once_for_each_shake() {
    let known = Forecast { level: -7.0, per_ln_mm: 0.0, first_chance: 0.0, ..Forecast::GENERIC };
    let settings = Settings { forecast: Some(known), ..BLIND };
    let mut bench = Scripted::giving(&after_the_way_up(&[8.0, 0.0]));
    let (weighed, said) = weigh_hard(&mut bench, &ORDER, &settings);
    // This policy raises it again and again.
    let lowered = said.iter().filter(|it| it.contains("lowered, without a shake")).count();
    let shakes = bench.actions.iter().filter(|(_, action)| action.shake_mm > 0.0).count();
    assert!((1..=shakes).contains(&lowered) && weighed.reading_mg == Some(8.0), "{said:?}");
    let shaken = bench.actions.iter().position(|(_, action)| action.shake_mm > 0.0).unwrap();
    let after = &bench.actions[shaken + 1..];
    let down = after.iter().take_while(|(_, action)| action.incline_change_deg < 0.0).count();
    let (lowest_deg, _) = after[down - 1];
    assert!((-10.0..42.0).contains(&lowest_deg) && bench.is_safe(), "{after:?}");
}

#[test]
fn a_known_powder_led_to_where_there_is_no_room_is_lowered_before_its_first_shake() {
    let known = Forecast { level: -0.5, level_sd: 0.3, first_chance: 0.0, ..Forecast::GENERIC };
    let settings = Settings { forecast: Some(known), onset_deg: Some(45.0), ..BLIND };
    let mut bench = Scripted::giving(&[[0.0; 12].as_slice(), &[2.0]].concat());
    let (controller, go) = (Controller::Paced(Paced::CHOSEN), AtomicBool::new(false));
    let on_event = |_: &Event<'_>| ControlFlow::Continue(());
    let weighed = weigh(&mut bench, &controller, &RULES, &ORDER, &settings, on_event, &go);
    let led_deg = bench.actions.iter().map(|it| it.0).fold(0.0, f64::max);
    let shaken = bench.actions.iter().find(|it| it.1.shake_mm > 0.0);
    assert!(led_deg > 35.0 && shaken.is_some_and(|it| it.0 < 25.0), "{:?}", bench.actions);
    assert!(weighed.outcome == Outcome::Within && bench.is_safe(), "{weighed:?}");
}

#[test]
fn steps_begin_anew_while_powder_falls_and_a_silent_spoon_is_filled_anew() {
    // Below the end of the pitch, where a silent spoon does not count as blocked.
    let controller = shaker(20.0, 5.0);
    let order = Order { target_mg: 8.0, ..ORDER };
    let weighed = |gives_mg: &[f64]| {
        let mut bench = Scripted { refills: true, ..Scripted::giving(gives_mg) };
        let (mut said, go) = (Vec::new(), AtomicBool::new(false));
        let note = |event: &Event<'_>| {
            if let Event::Decision(Decision { reason: Some(reason), .. }) = event {
                said.push(reason.clone());
            }
            ControlFlow::Continue(())
        };
        let weighed = weigh(&mut bench, &controller, &RULES, &order, &BLIND, note, &go);
        let times = |what| said.iter().filter(|it| it.contains(what)).count();
        (weighed.outcome, times("begin anew"), times("filled anew"))
    };
    assert_eq!(weighed(&[0.2]), (Outcome::Within, 1, 0));
    let once = [vec![0.0; 10], vec![3.0], vec![0.0; 25], vec![1.0]].concat();
    assert_eq!(weighed(&once), (Outcome::Within, 0, 1));
}

#[test]
fn a_powder_that_flows_after_a_rung_is_weighed() {
    // Nothing for the first four shakes at the end, then a piece.
    let gives_mg = [vec![0.0; 10], vec![4.0, 0.0, 3.0, 3.0]].concat();
    let mut bench = Scripted::giving(&gives_mg);
    let (weighed, _) = weigh_hard(&mut bench, &ORDER, &BLIND);
    assert_eq!((weighed.outcome, weighed.reading_mg), (Outcome::Within, Some(10.0)));
}

#[test]
fn a_target_above_what_a_spoon_holds_takes_several() {
    let order = Order { target_mg: 100.0, ..ORDER };
    let spoon_mg = Some(30.0);
    let settings = Settings { forecast: None, ..Settings::for_target(100.0, spoon_mg) };
    let settings = Settings { spoon_mg, ..settings };
    let mut bench =
        Scripted { refills: true, spoon_mg: Some([30.0; 2]), ..Scripted::giving(&[10.0]) };
    let (weighed, _) = weigh_hard(&mut bench, &order, &settings);
    assert_eq!((weighed.outcome, weighed.reading_mg), (Outcome::Within, Some(100.0)));
    assert_eq!((bench.count(Call::Approach), bench.count(Call::Tare)), (4, 1));
    let spoonfuls: Vec<u32> = weighed.ticks.iter().map(|tick| tick.spoonful).collect();
    assert!(spoonfuls.is_sorted() && spoonfuls.last() == Some(&4));
    // A spoonful that has released its portion is neither shaken further nor loosened.
    assert!(strokes(&bench).iter().all(|strokes| *strokes == 1), "{:?}", strokes(&bench));
}

#[test]
fn a_portion_that_was_spilled_is_made_up_for_by_more_spoonfuls() {
    // Half of what leaves the spoon misses the vial.
    let order = Order { target_mg: 60.0, ..ORDER };
    let spoon_mg = Some(30.0);
    let settings = Settings { forecast: None, spoon_mg, ..Settings::for_target(60.0, spoon_mg) };
    let mut bench =
        Scripted { refills: true, spoon_mg: Some([15.0; 2]), ..Scripted::giving(&[5.0]) };
    let (weighed, said) = weigh_hard(&mut bench, &order, &settings);
    assert_eq!((weighed.outcome, weighed.reading_mg), (Outcome::Within, Some(60.0)));
    assert_eq!(bench.count(Call::Approach), 4);
    // Only the last spoonful, of which all is needed, may be loosened.
    assert!(said.iter().filter(|it| it.contains("loosen")).count() <= 1, "{said:?}");
}

#[test]
fn where_the_arm_does_not_fill_its_spoon_one_spoonful_is_all() {
    let mut bench = Scripted { spoon_mg: Some([30.0; 2]), ..Scripted::giving(&[10.0]) };
    let settings = Settings { spoon_mg: Some(30.0), ..BLIND };
    let (weighed, _) = weigh_hard(&mut bench, &Order { target_mg: 100.0, ..ORDER }, &settings);
    assert_eq!((weighed.outcome, weighed.reading_mg), (Outcome::Blocked, Some(30.0)));
    assert!(!weighed.cause.unwrap().contains("still in"));
}

#[test]
fn the_pitch_goes_as_far_as_arm_and_policy_both_allow() {
    for (arm_deg, policy_deg, end_deg) in
        [(60.0, 90.0, 60.0), (60.0, 50.0, 50.0), (40.0, 90.0, 40.0)]
    {
        let reach =
            Reach { pitch: PitchLimits { lower_deg: -10.0, upper_deg: arm_deg }, ..Reach::FULL };
        let mut bench = Scripted { reach, ..Scripted::giving(&[0.0]) };
        let pitch = PitchLimits { lower_deg: -10.0, upper_deg: policy_deg };
        let rules = Rules { pitch, ..RULES };
        let go = AtomicBool::new(false);
        let note = |_: &Event<'_>| ControlFlow::Continue(());
        weigh(&mut bench, &shaker(90.0, 16.0), &rules, &ORDER, &BLIND, note, &go);
        let highest = bench.actions.iter().map(|(pitch_deg, _)| *pitch_deg).fold(0.0, f64::max);
        assert!((highest - end_deg).abs() < 1e-9, "{highest}");
    }
}

#[test]
fn a_stop_while_the_spoon_is_loosened_or_filled_leaves_it_level_and_away() {
    for word in ["loosen", "filled anew"] {
        let mut bench = Scripted { refills: true, ..Scripted::giving(&[0.0]) };
        let stop = AtomicBool::new(false);
        let press = |event: &Event<'_>| {
            let is_it = matches!(event, Event::Decision(Decision { reason: Some(reason), .. }) if reason.contains(word));
            if is_it {
                stop.store(true, Ordering::SeqCst);
            }
            ControlFlow::Continue(())
        };
        let weighed = weigh(&mut bench, &shaker(50.0, 16.0), &RULES, &ORDER, &BLIND, press, &stop);
        assert_eq!(weighed.outcome, Outcome::Stopped, "{word}");
        assert!(bench.is_safe() && bench.count(Call::Approach) == 1, "{word}");
    }
}
