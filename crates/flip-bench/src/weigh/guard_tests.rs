use super::*;
use proptest::prelude::*;

fn limits() -> Limits {
    Limits::new(PitchLimits::PAPER, 10)
}

fn careful() -> Limits {
    Limits { forecast: Some(Forecast::GENERIC), ..limits() }
}

fn reading(mass_mg: f64) -> Reading {
    Reading { mass_mg, stable: true }
}

fn seen(falls: &[Fall]) -> Situation<'_> {
    Situation {
        target_mg: 15.0,
        tolerance_upper_mg: 1.0,
        steps: 3,
        seconds: 20.0,
        moved_s: 19.0,
        read_s: 20.0,
        pitch_deg: 30.0,
        before: reading(4.0),
        now: reading(6.0),
        shaken: true,
        falls,
        unproven: None,
        is_felt: true,
    }
}

fn action(incline_change_deg: f64, shake_mm: f64) -> Action {
    Action::once(incline_change_deg, shake_mm)
}

fn fall(pitch_deg: f64, shake_mm: f64, mass_mg: f64) -> Fall {
    Fall { pitch_deg, shake_mm, strokes: 1, mass_mg }
}

#[test]
fn a_proposal_is_cut_to_the_bounds_of_action_and_spoon() {
    for (proposed, allowed, cut) in [
        (action(4.0, 8.0), action(4.0, 8.0), None),
        (action(90.0, 8.0), action(6.0, 8.0), Some(Cut::Bounds)),
        (action(-90.0, -5.0), action(-8.0, 0.0), Some(Cut::Bounds)),
        (action(0.0, 1e9), action(0.0, 16.0), Some(Cut::Bounds)),
    ] {
        assert_eq!(guard(&limits(), &seen(&[]), proposed), Ok(Allowed { action: allowed, cut }));
    }
}

#[test]
fn nothing_moves_when_something_is_wrong_or_enough_is_in_the_vial() {
    let at = |change: fn(&mut Situation<'_>)| {
        let mut situation = seen(&[]);
        change(&mut situation);
        let limits = Limits { seconds_max: 600.0, ..limits() };
        guard(&limits, &situation, action(1.0, 5.0)).unwrap_err()
    };
    assert_eq!(at(|s| s.now.mass_mg = 15.0), Halt::TargetReached);
    assert_eq!(at(|s| s.now.mass_mg = 40.0), Halt::TargetReached);
    assert_eq!(at(|s| s.steps = 10), Halt::StepsSpent);
    assert_eq!(at(|s| s.seconds = 600.0), Halt::TimeSpent);
    assert_eq!(at(|s| s.now.stable = false), Halt::NotStable);
    assert_eq!(at(|s| s.now.mass_mg = f64::NAN), Halt::NotANumber);
    assert_eq!(at(|s| s.pitch_deg = f64::INFINITY), Halt::NotANumber);
    assert_eq!(at(|s| s.read_s = 18.9), Halt::Stale);
    assert_eq!(at(|s| s.now.mass_mg = 0.0), Halt::VialMoved { fell_mg: 4.0 });
    assert_eq!(at(|s| (s.shaken, s.now.mass_mg) = (false, 8.0)), Halt::Rose { rose_mg: 4.0 });
    assert_eq!(guard(&limits(), &seen(&[]), action(f64::NAN, 5.0)), Err(Halt::NotAnAction));
    assert_eq!(guard(&limits(), &seen(&[]), action(1.0, f64::INFINITY)), Err(Halt::NotAnAction));
}

#[test]
fn a_small_rise_without_a_shake_is_dust_and_a_large_one_with_a_shake_is_powder() {
    let dust = Situation { shaken: false, now: reading(7.0), ..seen(&[]) };
    let powder = Situation { now: reading(14.0), ..seen(&[]) };
    assert!([dust, powder].iter().all(|seen| guard(&limits(), seen, action(1.0, 5.0)).is_ok()));
}

#[test]
fn what_is_wrong_with_the_reading_counts_before_a_target_that_is_reached() {
    let lifted = Situation { before: reading(50.0), now: reading(20.0), ..seen(&[]) };
    assert_eq!(guard(&limits(), &lifted, action(1.0, 5.0)), Err(Halt::VialMoved { fell_mg: 30.0 }));
    let draught = Situation { shaken: false, now: reading(40.0), ..seen(&[]) };
    assert_eq!(guard(&limits(), &draught, action(1.0, 5.0)), Err(Halt::Rose { rose_mg: 36.0 }));
}

#[test]
fn a_spoon_is_blocked_when_full_strokes_at_the_end_of_the_pitch_give_nothing() {
    let dry = |strokes| Fall { strokes, ..fall(36.0, 16.0, 0.0) };
    let ladder = vec![dry(1), dry(2), dry(4), dry(8)];
    let after = |first: Fall| [vec![first], ladder.clone()].concat();
    let with = |last: Fall| [ladder.clone(), vec![last]].concat();
    for (falls, is_blocked) in [
        (ladder.clone(), true),
        (vec![dry(1); 15], true),
        (vec![dry(1); 14], false),
        (after(fall(36.0, 16.0, 3.0)), true),
        (with(fall(36.0, 16.0, 1.0)), false),
        (with(fall(36.0, 12.0, 0.0)), false),
        (with(fall(30.0, 16.0, 0.0)), false),
        (vec![Fall { mass_mg: 0.4, ..dry(5) }; 3], false),
    ] {
        let found =
            guard(&limits(), &Situation { pitch_deg: 36.0, ..seen(&falls) }, action(0.0, 16.0));
        let halted = matches!(found, Err(Halt::Blocked { .. }));
        assert_eq!(halted, is_blocked, "{falls:?}");
    }
    // The display's noise is no powder.
    let noisy = Limits { readability_mg: 0.1, piece_mg: 0.5, ..limits() };
    let noise: Vec<Fall> =
        [0.2, -0.1, 0.1, -0.2].map(|mass_mg| Fall { mass_mg, ..dry(4) }).to_vec();
    let found = guard(&noisy, &Situation { pitch_deg: 36.0, ..seen(&noise) }, action(0.0, 16.0));
    assert_eq!(found, Err(Halt::Blocked { strokes: 16, pitch_deg: 36.0 }));
}

#[test]
fn what_might_let_too_much_fall_is_made_gentler_then_lower_then_ends_the_dose() {
    // The room is 10 mg; spoons that released little, much, and ever more at 30 deg.
    let calm = [fall(28.0, 2.0, 1.0), fall(30.0, 2.0, 1.0), fall(30.0, 2.0, 1.0)];
    let proposed = action(2.0, 2.0);
    assert_eq!(
        guard(&careful(), &seen(&calm), proposed),
        Ok(Allowed { action: proposed, cut: None })
    );
    let hard = guard(&careful(), &seen(&calm), action(2.0, 16.0)).unwrap();
    assert!(hard.action.incline_change_deg == 2.0 && hard.action.shake_mm < 16.0, "{hard:?}");
    assert!(
        matches!(hard.cut, Some(Cut::Gentler { upper_mg, room_mg }) if upper_mg > room_mg && room_mg == 10.0)
    );

    let near = Situation { before: reading(13.0), now: reading(14.0), ..seen(&calm) };
    let lower = guard(&careful(), &near, proposed).unwrap().action;
    assert!(lower.incline_change_deg < 2.0 && lower.shake_mm == SHAKE_MM_MIN, "{lower:?}");

    let wild = [fall(28.0, 0.9, 6.0), fall(30.0, 0.9, 9.0), fall(30.0, 0.9, 12.0)];
    let halt = guard(
        &careful(),
        &Situation { before: reading(13.0), now: reading(14.0), ..seen(&wild) },
        proposed,
    )
    .unwrap_err();
    assert!(
        matches!(halt, Halt::NoRoom { upper_mg, room_mg: 2.0 } if upper_mg > 2.0)
            && halt.is_expected()
    );
}

#[test]
fn without_a_forecast_eight_shakes_that_should_give_and_do_not_end_a_dose() {
    let limits = Limits::new(PitchLimits::PAPER, 30);
    let silent = |n: usize, pitch_deg: f64, shake_mm: f64| vec![fall(pitch_deg, shake_mm, 0.0); n];
    let strokes = |strokes| vec![Fall { strokes, ..fall(20.0, 4.0, 0.0) }];
    for (falls, expected) in [
        (silent(12, 20.0, 4.0), false),
        ([vec![fall(20.0, 4.0, 2.0)], silent(7, 20.0, 4.0)].concat(), false),
        ([vec![fall(20.0, 4.0, 2.0)], silent(8, 20.0, 4.0)].concat(), true),
        ([vec![fall(20.0, 4.0, 2.0)], strokes(7)].concat(), false),
        ([vec![fall(20.0, 4.0, 2.0)], strokes(8)].concat(), true),
        // Gentler ones, or ones at a lower pitch, may well release nothing.
        ([vec![fall(20.0, 4.0, 2.0)], silent(12, 20.0, 2.0)].concat(), false),
        ([vec![fall(20.0, 4.0, 2.0)], silent(12, 16.0, 4.0)].concat(), false),
        (
            [vec![fall(20.0, 4.0, 2.0)], silent(8, 20.0, 4.0), vec![fall(24.0, 4.0, 1.0)]].concat(),
            false,
        ),
    ] {
        let situation = Situation { steps: 20, ..seen(&falls) };
        let at = |limits: &Limits| guard(limits, &situation, action(0.0, 4.0));
        let halted = matches!(at(&limits), Err(Halt::Deaf { .. }));
        assert_eq!(halted, expected, "{falls:?}");
        assert!(at(&Limits { hangs: 0.1, ..limits }).is_ok(), "a powder that hangs may be silent");
    }
}

#[test]
fn a_spoon_that_is_silent_after_its_first_piece_is_tried_further() {
    // Three doses that were given up with nearly all powder in the spoon: after a first piece come
    // shakes that release nothing, steeper and harder ones too, and a display of 0.1 mg flickers.
    let given_up: [(f64, &[[f64; 3]]); 3] = [
        (1.0, &[[12.2, 3.33, 1.0], [15.4, 11.77, 0.0], [19.8, 11.77, 0.0]]),
        (
            0.1,
            &[
                [4.4, 3.33, -0.4],
                [8.9, 3.33, 0.5],
                [12.6, 3.33, -0.3],
                [17.0, 3.33, 0.0],
                [21.5, 3.33, -0.1],
                [25.9, 3.33, 0.4],
            ],
        ),
        (0.1, &[[26.8, 3.0, 3.7], [27.5, 3.76, -0.1], [31.5, 5.39, 0.0], [35.5, 5.39, 0.3]]),
    ];
    for (readability_mg, steps) in given_up {
        let falls: Vec<Fall> = steps.iter().map(|&[deg, mm, mg]| fall(deg, mm, mg)).collect();
        let pitch_deg = falls.last().unwrap().pitch_deg;
        let mass_mg: f64 = falls.iter().map(|fall| fall.mass_mg).sum();
        let limits = Limits { readability_mg, steps_max: 30, ..careful() };
        let now = reading(mass_mg);
        let situation =
            Situation { steps: 7, target_mg: 20.0, before: now, now, pitch_deg, ..seen(&falls) };
        let allowed = guard(&limits, &situation, action(4.0, 3.0));
        assert!(allowed.is_ok(), "{allowed:?}");
    }
}

#[test]
fn a_display_that_is_all_but_surely_stuck_ends_the_dose_however_much_room_there_is() {
    let falls = |silent: usize| {
        let gave = [18.0, 20.0, 22.0].map(|deg| fall(deg, 4.0, 2.0));
        let silent = (0..silent).map(|k| fall(24.0 + k as f64, 4.0, 0.0));
        gave.into_iter().chain(silent).collect::<Vec<_>>()
    };
    let limits = Limits { steps_max: 30, ..careful() };
    let halted = |silent: usize, limits: &Limits| {
        let falls = falls(silent);
        let now = reading(6.0);
        let situation = Situation {
            steps: 9,
            target_mg: 1000.0,
            before: now,
            now,
            pitch_deg: 40.0,
            ..seen(&falls)
        };
        guard(limits, &situation, action(0.0, 4.0)) == Err(Halt::Deaf { shakes: silent })
    };
    let ends = (1..16).find(|&silent| halted(silent, &limits)).expect("it ends");
    assert!((4..12).contains(&ends), "{ends} silent shakes");
    let fine = Limits { readability_mg: 0.1, ..limits };
    assert!((1..=ends).any(|silent| halted(silent, &fine)), "a finer display says it no later");
    let known = Limits { silent_share: Some(0.6), ..limits };
    assert!(!halted(ends, &known), "this powder was often silent");
    assert!(!halted(15, &Limits { hangs: 0.1, ..limits }));
}

#[test]
fn what_a_standing_display_may_hide_is_no_room_for_more_and_its_dose_does_not_end_as_if_it_were_known()
 {
    let gave: Vec<Fall> = (0..3).map(|k| fall(16.0 + 2.0 * f64::from(k), 4.0, 2.0)).collect();
    let silent = |n: usize| {
        [gave.clone(), (0..n).map(|k| fall(22.0 + k as f64, 4.0, 0.0)).collect()].concat()
    };
    let doubting = Limits { readability_mg: 0.1, ..careful() };
    let at = |limits: &Limits, falls: &[Fall], steps: u32| {
        let pitch_deg = falls.last().map_or(0.0, |fall| fall.pitch_deg);
        let situation =
            Situation { steps, before: reading(6.0), now: reading(6.0), pitch_deg, ..seen(falls) };
        guard(limits, &situation, action(1.0, 4.0))
    };
    let as_proposed = Ok(Allowed { action: action(1.0, 4.0), cut: None });
    assert_eq!(at(&doubting, &silent(0), 3), as_proposed);
    // One unseen shake of 2 mg, plus another, fit into 10 mg.
    assert_eq!(at(&doubting, &silent(1), 4), as_proposed);
    let ends = (1..12)
        .find(|n| at(&doubting, &silent(*n), 4).is_err())
        .expect("it does not go on for ever");
    assert!((3..8).contains(&ends), "{ends} shakes of 2 mg and more");
    assert_eq!(at(&doubting, &silent(ends), 4), Err(Halt::Deaf { shakes: ends }));
    assert_eq!(
        at(&doubting, &silent(ends), 10),
        Err(Halt::Deaf { shakes: ends }),
        "its steps are not merely spent"
    );
    // A powder that hangs may be silent for long on a display that is alive.
    let hanging = Limits { hangs: 0.3, ..doubting };
    assert!(at(&hanging, &silent(ends), 4).is_ok());
    assert_eq!(at(&hanging, &silent(ends), 10), Err(Halt::StepsSpent));
    assert_eq!(at(&doubting, &silent(0), 10), Err(Halt::StepsSpent));
    let believing = Limits { stands_still: 0.0, ..doubting };
    assert_eq!(at(&believing, &silent(ends), 4), as_proposed);
}

#[test]
fn no_shake_follows_one_that_a_display_was_silent_through_before_it_shows_another_number() {
    let quiet = [fall(4.0, 1.0, 0.0)];
    let at = |unproven, proposed| {
        let situation = Situation {
            steps: 1,
            before: reading(0.0),
            now: reading(0.0),
            pitch_deg: 4.0,
            unproven,
            ..seen(&quiet)
        };
        guard(&careful(), &situation, proposed).map(|allowed| allowed.action)
    };
    let gentle = action(2.0, 1.0);
    assert_eq!(at(Some(0), gentle), Ok(gentle));
    assert_eq!(at(Some(1), gentle), Err(Halt::Unproven), "however little it may give");
    assert_eq!(at(Some(1), action(2.0, 0.0)), Ok(action(2.0, 0.0)), "an incline pours nothing");
    assert_eq!(at(None, gentle), Ok(gentle), "who has nothing to wait for does not wait");
}

#[test]
fn a_display_that_was_not_seen_to_come_to_rest_may_hide_as_much_again() {
    let gave = [fall(20.0, 2.0, 3.0), fall(20.0, 2.0, 3.0)];
    let at = |now_mg: f64, is_felt| {
        let situation = Situation {
            before: reading(now_mg - 3.0),
            now: reading(now_mg),
            pitch_deg: 20.0,
            unproven: Some(0),
            is_felt,
            ..seen(&gave)
        };
        let upper_mg = Forecast::GENERIC.upper_mg(&gave, 1.0, Shaking::once(20.0, 2.0));
        (
            guard(&careful(), &situation, action(0.0, 2.0)).map(|allowed| allowed.action),
            16.0 - now_mg - upper_mg,
        )
    };
    // There is room for the shake and 3 mg more, then for the shake alone.
    let ((far, spare_mg), (near, left_mg)) = (at(3.0, false), at(6.0, false));
    assert!(spare_mg > 3.0 && (0.0..3.0).contains(&left_mg), "{spare_mg} {left_mg}");
    assert_eq!(
        (far, near, at(6.0, true).0),
        (Ok(action(0.0, 2.0)), Err(Halt::Unproven), Ok(action(0.0, 2.0)))
    );
}

#[test]
fn where_signs_of_life_are_waited_for_a_silent_spoon_is_believed() {
    let gave = [18.0, 20.0, 22.0].map(|deg| fall(deg, 4.0, 2.0));
    let silent = (0..12).map(|k| fall(24.0 + f64::from(k), 4.0, 0.0));
    let falls: Vec<Fall> = gave.into_iter().chain(silent).collect();
    let limits = Limits { steps_max: 30, ..careful() };
    let at = |unproven| {
        guard(&limits, &Situation { steps: 20, unproven, ..seen(&falls) }, action(0.0, 4.0))
    };
    assert_eq!(at(None), Err(Halt::Deaf { shakes: 12 }));
    assert!(at(Some(0)).is_ok());
}

#[test]
fn an_incline_without_a_shake_needs_no_room() {
    let wild = [fall(30.0, 0.9, 12.0); 3];
    let near = Situation { before: reading(13.0), now: reading(14.0), ..seen(&wild) };
    assert!(guard(&careful(), &near, action(-8.0, 0.0)).is_ok());
}

prop_compose! {
    fn any_falls()(falls in prop::collection::vec((-10.0..36.0, 0.9..16.0, -1.0..40.0), 0..12)) -> Vec<Fall> {
        falls.into_iter().map(|(pitch_deg, shake_mm, mass_mg)| fall(pitch_deg, shake_mm, mass_mg)).collect()
    }
}

proptest! {
    #[test]
    fn whatever_was_read_and_proposed_the_action_is_within_bounds_and_its_forecast_within_the_room(
        falls in any_falls(), pitch_deg in -10.0..36.0, now_mg in 0.0..30.0, change in -20.0..20.0, shake_mm in -1.0..30.0, readability_mg in 0.1..1.0,
    ) {
        let limits = Limits { readability_mg, ..careful() };
        let seen = Situation { pitch_deg, before: reading(now_mg), now: reading(now_mg), ..seen(&falls) };
        if let Ok(Allowed { action, cut }) = guard(&limits, &seen, action(change, shake_mm)) {
            let pitch_deg = pitch_deg + action.incline_change_deg;
            prop_assert!((-10.0 - 1e-9..=36.0 + 1e-9).contains(&pitch_deg) && action.incline_change_deg.abs() <= 8.0 + 1e-9);
            prop_assert!((0.0..=16.0).contains(&action.shake_mm) && action.shake_mm <= shake_mm.max(SHAKE_MM_MIN));
            let shake = Shaking { pitch_deg, ..Shaking::of(0.0, &action) };
            let upper_mg = Forecast::GENERIC.upper_mg(&falls, readability_mg, shake);
            prop_assert!(now_mg + upper_mg <= 16.0 + 1e-6, "{upper_mg} mg on {now_mg} mg");
            prop_assert!(cut.is_some() || action.shake_mm == shake_mm);
        }
    }
}
