//! A dose that is stopped, cannot be recorded, or may not begin.

use super::*;

#[test]
fn a_stop_is_obeyed_before_the_next_motion_wherever_it_comes() {
    // Pressed at the n-th event: no more acts than had been carried out by then.
    for n in 0..13 {
        let mut bench = Scripted::giving(&[2.0]);
        let (stop, mut heard, mut acts) = (AtomicBool::new(false), 0, 0);
        let press = |event: &Event<'_>| {
            acts += u32::from(matches!(event, Event::Tick(tick) if tick.step > 0 && heard <= n));
            stop.store(heard >= n, Ordering::SeqCst);
            heard += 1;
            ControlFlow::Continue(())
        };
        let weighed = hear(&mut bench, &Rules::FLIP, &BLIND, press, &stop);
        assert_eq!(
            (weighed.outcome, bench.count(Call::Act), bench.count(Call::Discard)),
            (Outcome::Stopped, acts, 0),
            "{n}"
        );
        assert!(bench.is_safe() && bench.count(Call::Retract) == 1, "{n}");
    }
}

#[test]
fn a_stop_that_arrives_during_the_return_does_not_leave_the_spoon_where_it_is() {
    for call in [Call::Level, Call::Retract] {
        let mut bench = Scripted::with(call, 0, Fault::Ended);
        let (stop, mut heard) = (AtomicBool::new(false), 0);
        let press = |_: &Event<'_>| {
            heard += 1;
            stop.store(heard > 5, Ordering::SeqCst);
            ControlFlow::Continue(())
        };
        let weighed = hear(&mut bench, &Rules::FLIP, &BLIND, press, &stop);
        assert_eq!((weighed.outcome, weighed.must_look), (Outcome::Stopped, false), "{call:?}");
        assert!(bench.is_safe() && bench.count(call) == 2, "{call:?}");
        // Without a stop it is a fault of the arm.
        let mut bench = Scripted::with(call, 0, Fault::Ended);
        let go_on = |_: &Event<'_>| ControlFlow::Continue(());
        let weighed = hear(&mut bench, &Rules::FLIP, &BLIND, go_on, &AtomicBool::new(false));
        assert_eq!((weighed.outcome, weighed.must_look), (Outcome::Aborted, true), "{call:?}");
    }
}

#[test]
fn what_cannot_be_recorded_does_not_move_and_neither_does_what_panics() {
    for panics in [false, true] {
        for n in 0..14 {
            let mut bench = Scripted::giving(&[2.0]);
            let (mut heard, mut acts) = (0, 0);
            let refuse = |event: &Event<'_>| {
                acts +=
                    u32::from(matches!(event, Event::Tick(tick) if tick.step > 0 && heard <= n));
                heard += 1;
                assert!(!panics || heard <= n, "a bug");
                if heard > n { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
            };
            let weighed = hear(&mut bench, &Rules::FLIP, &BLIND, refuse, &AtomicBool::new(false));
            assert_eq!((weighed.outcome, bench.count(Call::Act)), (Outcome::Aborted, acts), "{n}");
            assert_eq!(
                (bench.is_safe(), bench.count(Call::Retract), bench.count(Call::Discard)),
                (true, 1, 0),
                "{n}"
            );
        }
    }
}

proptest! {
    #[test]
    fn over_spoons_with_heavy_tails_no_shake_is_let_through_that_might_pass_the_tolerance(
        gives in prop::collection::vec((0.0..1.0f64, 0.3..3.0f64), 30), target_mg in 3.0..20.0f64, tolerance_mg in 0.0..2.0f64, pitch_deg in 5.0..50.0f64, shake_mm in 0.9..16.0f64, fault_at in 0u32..60,
    ) {
        // A Pareto tail of exponent 1.2: falls are often small and sometimes an avalanche.
        let gives_mg: Vec<f64> = gives.iter().map(|(u, scale)| scale * (1.0 - 0.999 * u).powf(-1.0 / 1.2) - scale).collect();
        let mut bench = Scripted { fault: Some((Call::Read, fault_at, Fault::Unstable)), ..Scripted::giving(&gives_mg) };
        let order = Order { target_mg, tolerance_lower_mg: tolerance_mg, tolerance_upper_mg: tolerance_mg, readability_mg: 1.0 };
        let rules = Rules { steps_max: 30, ..Rules::FLIP };
        let (mut falls, mut last, mut halted, mut broken) = (Vec::<Fall>::new(), (0.0, 0.0), false, None);
        let mut acts = 0;
        let watch = |event: &Event<'_>| {
            match event {
                Event::Decision(Decision { allowed: Some(action), .. }) => {
                    let (pitch_deg, shake_mm) = (last.1 + action.incline_change_deg, action.executed_shake_mm());
                    let upper_mg = Forecast::GENERIC.upper_mg(&falls, 1.0, Shaking::once(pitch_deg, shake_mm));
                    let room_mg = target_mg + tolerance_mg - last.0;
                    if halted || upper_mg > room_mg + 1e-6 {
                        broken = Some(format!("{action:?} may give {upper_mg} mg, room {room_mg} mg"));
                    }
                }
                Event::Decision(_) => halted = true,
                Event::Tick(tick) => {
                    if tick.action.executed_shake_mm() > 0.0 {
                        let mass_mg = tick.reading.mass_mg - last.0;
                        falls.push(Fall { pitch_deg: tick.pitch_deg, shake_mm: tick.action.shake_mm, strokes: 1, mass_mg });
                    }
                    acts += u32::from(tick.step > 0);
                    if halted {
                        broken = Some("it acted after it was halted".to_owned());
                    }
                    last = (tick.reading.mass_mg, tick.pitch_deg);
                }
                Event::Phase(_) | Event::Pan(_) => {}
            }
            ControlFlow::Continue(())
        };
        let go = AtomicBool::new(false);
        let weighed = weigh(&mut bench, &shaker(pitch_deg, shake_mm), &rules, &order, &Settings::BENCH, watch, &go);
        prop_assert_eq!(broken, None);
        prop_assert!(bench.is_safe() && bench.count(Call::Act) == acts && !weighed.must_look);
        prop_assert!(fault_at > acts || weighed.outcome == Outcome::NotStable, "{:?}", weighed.outcome);
    }
}

#[test]
fn a_pan_that_does_not_show_what_it_must_is_not_poured_into_and_nothing_was_scooped() {
    use flip_core::domain::vial::{Band, PanCheck};
    let before = Some(Band { lower_mg: 11_998.0, upper_mg: 12_003.0 });
    let settings = Settings { pan: PanCheck { before, ..PanCheck::NONE }, ..BLIND };
    let (mut bench, mut flaws) = (Scripted::giving(&[2.0]), 0);
    let note = |event: &Event<'_>| {
        flaws += u32::from(matches!(event, Event::Pan(_)));
        ControlFlow::Continue(())
    };
    let weighed = hear(&mut bench, &Rules::FLIP, &settings, note, &AtomicBool::new(false));
    assert_eq!((weighed.outcome, weighed.must_look, flaws), (Outcome::Aborted, false, 1));
    assert!(weighed.cause.unwrap().contains("still on the pan"));
    assert_eq!(bench.calls, [Call::Stand, Call::Level, Call::Retract]);
}
