use super::*;
use flip_core::domain::bench::Moment;

/// A display of this step over a constant mass, from a given time on, s.
fn still(from_s: f64, seconds: f64, mass_mg: f64) -> Rest {
    let seen: Vec<Moment> = (0..=(seconds / 0.4) as u32)
        .map(|k| Moment { t_s: from_s + 0.4 * f64::from(k), mass_mg })
        .collect();
    Rest::of(&seen).unwrap()
}

fn watched(zero: Rest, last: Rest) -> Watched {
    Watched { before: None, zero: Some(zero), last: Some(last) }
}

#[test]
fn where_nothing_was_watched_two_readings_count_with_their_rounding() {
    // 2 sqrt(2 (0.41^2 + 1/12)) = 1.4183; a checked repeatability of 0.6: 2 sqrt(2 (0.36 + 1/12)) =
    // 1.8833.
    assert!((uncertainty_mg(&Watched::default(), None, 1.0) - 1.4183).abs() < 1e-3);
    assert!((uncertainty_mg(&Watched::default(), Some(0.6), 1.0) - 1.8833).abs() < 1e-3);
    assert!((uncertainty_mg(&Watched::default(), None, 0.1) - 0.14183).abs() < 1e-4);
}

#[test]
fn one_digit_in_the_watch_is_no_drift() {
    // The last reading is one digit higher: by least squares a drift of 0.6 to 20 mg/min, which
    // over 100 s was 1 to 33 mg.
    for (seconds, u_mg_max) in [(20.0, 2.0), (10.0, 2.0), (3.0, 3.0)] {
        let mut seen: Vec<Moment> = (0..=(seconds / 0.19) as u32)
            .map(|k| Moment { t_s: 100.0 + 0.19 * f64::from(k), mass_mg: 10.0 })
            .collect();
        seen.last_mut().unwrap().mass_mg = 11.0;
        let watched = watched(still(0.0, 10.0, 0.0), Rest::of(&seen).unwrap());
        let u_mg = uncertainty_mg(&watched, None, 1.0);
        assert!(u_mg < u_mg_max, "{seconds} s: {u_mg}");
        assert_eq!(proven_mg_min(&watched.last.unwrap(), &watched, 1.0), 0.0);
    }
}

#[test]
fn a_drift_that_the_readings_prove_enters_in_full() {
    // 3 mg/min on a display of 0.01 mg that wanders by hundredths: 0.05 mg/s over 100 s.
    let drifting = |from_s: f64| {
        let seen: Vec<Moment> = (0..50)
            .map(|k| from_s + 0.4 * f64::from(k))
            .map(|t_s| Moment {
                t_s,
                mass_mg: ((0.05 * t_s + 0.02 * libm::sin(t_s)) * 100.0).round() / 100.0,
            })
            .collect();
        Rest::of(&seen).unwrap()
    };
    let watched = watched(drifting(0.0), drifting(100.0));
    let u_mg = uncertainty_mg(&watched, None, 0.01);
    assert!((5.0..5.6).contains(&u_mg), "{u_mg}");
    assert!((proven_mg_min(&watched.last.unwrap(), &watched, 0.01) - 3.0).abs() < 0.2);
}

#[test]
fn a_still_display_is_as_sure_as_its_step_and_a_longer_watch_never_makes_it_less_so() {
    let of = |seconds| {
        uncertainty_mg(&watched(still(0.0, seconds, 0.0), still(100.0, seconds, 10.0)), None, 1.0)
    };
    // Rounding alone is 2 sqrt(1/6) = 0.816.
    assert!(
        of(20.0) > 0.816 && of(20.0) < 1.0 && of(10.0) >= of(20.0) && of(3.0) >= of(10.0),
        "{} {}",
        of(20.0),
        of(3.0)
    );
}

#[test]
fn a_display_that_stands_still_for_a_moment_is_not_certain_if_it_wandered_before() {
    // Half of the time one digit up, in turns of six seconds.
    let turning: Vec<Moment> = (0..50)
        .map(|k| Moment { t_s: 0.4 * f64::from(k), mass_mg: f64::from(k / 15 % 2) })
        .collect();
    let wandering = Watched { zero: Rest::of(&turning), ..Watched::default() };
    let still = still(100.0, 10.0, 10.0);
    assert_eq!(of_mean_mg(&still, &Watched::default()), Some(0.0));
    assert!(of_mean_mg(&still, &wandering).unwrap() > 0.25);
}
