//! Is this reading final? A filter over the readings of a balance while it settles.
//!
//! A balance's own stable flag is cautious: on the balance with published step responses it came
//! 1.5 to 2.3 s after a load, when the display had been right for a second. The load cell itself
//! responds within a few tenths of a second, so three criteria decide sooner: is the display
//! constant, does a fitted exponential predict that it stays so, and are there enough readings? The
//! flag is kept alongside the result.
//!
//! ```text
//! m(t) = m_end + a exp(-(t - t_n) / tau)          fitted to the readings of the last window; t_n is the last one's time
//! final:  t_1 >= lag,  t_n - t_1 >= window,  n >= 3,  max - min <= 2 step,  |a| <= step
//! ```
//!
//! | symbol | setting | unit | what |
//! |---|---|---|---|
//! | tau | `tau_s` | s | time constant of the load cell |
//! | step | `step_mg` | mg | step of the display, or the balance's noise where that is larger |
//! | window | `window_s` | s | time over which the display has to stand |
//! | lag | `lag_s` | s | from the end of a motion until the balance can feel what fell; nothing before it counts |
//! | a | | mg | what is still to come by the fit |
//!
//! `cargo experiment settling` tries it on the published step responses.

use flip_core::domain::bench::{Moment, Reading, Standing};
use flip_core::domain::rest::Rest;

/// Fewest readings that allow a verdict.
const READINGS_MIN: usize = 3;

/// Criteria for a final display.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settling {
    /// Step of the display, mg, or the balance's noise where that is larger.
    pub step_mg: f64,
    /// Time constant of the load cell, s. Default 0.16 (A&D balance, 28 steps: 0.16, SD 0.03).
    pub tau_s: f64,
    /// Time over which the display has to be constant, s. Default 0.35, two time constants.
    pub window_s: f64,
    /// From the end of the motion until readings count, s. Default 0.3: powder falls for 0.05 s and
    /// a frame of a slow balance is 0.2 s old.
    pub lag_s: f64,
}

impl Settling {
    /// Default settings for a display step of `step_mg`.
    pub fn new(step_mg: f64) -> Self {
        Self { step_mg, tau_s: 0.16, window_s: 0.35, lag_s: 0.3 }
    }
}

/// The display at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shown {
    /// Since the end of the last motion, s.
    pub t_s: f64,
    /// Displayed mass, mg.
    pub mass_mg: f64,
    /// Its own stable flag.
    pub flag: bool,
}

/// A display that counts as final.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settled {
    /// The last reading, as a person would have read it, mg.
    pub mass_mg: f64,
    /// Limit of the exponential, mg: the better estimate where no multiple of the step is needed.
    pub end_mg: f64,
    /// Since the end of the motion, s.
    pub t_s: f64,
    /// The balance's own flag at that moment.
    pub flag: bool,
}

/// The final display, if the last of these readings qualifies; readings in order of time.
pub fn settled(settling: &Settling, shown: &[Shown]) -> Option<Settled> {
    let last = shown.last()?;
    // A nanosecond of slack: three frames of a tenth of a second are 0.2 s, whatever their sum
    // rounds to.
    let enough =
        |s: &Shown| s.t_s >= settling.lag_s && last.t_s - s.t_s >= settling.window_s - 1e-9;
    let from = shown.iter().rposition(enough)?.min(shown.len().checked_sub(READINGS_MIN)?);
    let window = &shown[from..];
    if window[0].t_s < settling.lag_s || spread_mg(window) > 2.0 * settling.step_mg + 1e-9 {
        return None;
    }
    let (end_mg, still_mg) = exponential(settling.tau_s, window)?;
    let is_final = still_mg.abs() <= settling.step_mg;
    is_final.then_some(Settled { mass_mg: last.mass_mg, end_mg, t_s: last.t_s, flag: last.flag })
}

/// Summary of a balance observed for a while with nothing moving; `None` if there are too few
/// readings.
///
/// `rest` uses the clock of the readings. `still` applies the criteria of [`settled`] to the last
/// window alone: a slow drift does not make it restless, but shows in its slope.
pub fn standing(settling: &Settling, shown: &[Shown]) -> Option<Standing> {
    let (first, last) = (shown.first()?, shown.last()?);
    let (slope_mg_s, scatter_mg) = line(shown)?;
    // Less than half a step over the whole time is rounding, not drift.
    let is_rounding = slope_mg_s.abs() * (last.t_s - first.t_s) <= settling.step_mg / 2.0;
    let slope_mg_s = if is_rounding { 0.0 } else { slope_mg_s };
    let seen: Vec<Moment> =
        shown.iter().map(|one| Moment { t_s: one.t_s, mass_mg: one.mass_mg }).collect();
    Some(Standing {
        reading: Reading { mass_mg: last.mass_mg, stable: last.flag },
        still: settled(&Settling { lag_s: f64::NEG_INFINITY, ..*settling }, shown).is_some(),
        drift_mg_min: 60.0 * slope_mg_s,
        scatter_mg,
        seconds: last.t_s - first.t_s,
        rest: Rest::of(&seen)?,
    })
}

/// Largest minus smallest; infinite if one of them is not a number.
fn spread_mg(shown: &[Shown]) -> f64 {
    if shown.iter().any(|s| !s.mass_mg.is_finite()) {
        return f64::INFINITY;
    }
    let (low, high) = shown.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), s| {
        (low.min(s.mass_mg), high.max(s.mass_mg))
    });
    high - low
}

/// Limit and remaining amplitude of an exponential with this time constant, fitted to the readings
/// by least squares.
fn exponential(tau_s: f64, shown: &[Shown]) -> Option<(f64, f64)> {
    let last_s = shown.last()?.t_s;
    let [end, a] = least_squares(shown, |t_s| libm::exp((last_s - t_s) / tau_s))?;
    Some((end, a))
}

/// Slope, mg/s, and standard deviation of the readings about the fitted line.
fn line(shown: &[Shown]) -> Option<(f64, f64)> {
    let [offset, slope] = least_squares(shown, |t_s| t_s)?;
    let squares: f64 = shown.iter().map(|s| (s.mass_mg - offset - slope * s.t_s).powi(2)).sum();
    Some((slope, (squares / (shown.len() - 2) as f64).sqrt()))
}

/// `[c, b]` of m = c + b x(t); `None` for fewer than three readings, for readings at a single time,
/// and where one is not a number.
fn least_squares(shown: &[Shown], x: impl Fn(f64) -> f64) -> Option<[f64; 2]> {
    if shown.len() < READINGS_MIN {
        return None;
    }
    let n = shown.len() as f64;
    let mean_x = shown.iter().map(|s| x(s.t_s)).sum::<f64>() / n;
    let mean_m = shown.iter().map(|s| s.mass_mg).sum::<f64>() / n;
    let xx: f64 = shown.iter().map(|s| (x(s.t_s) - mean_x).powi(2)).sum();
    let xm: f64 = shown.iter().map(|s| (x(s.t_s) - mean_x) * (s.mass_mg - mean_m)).sum();
    let b = xm / xx;
    b.is_finite().then_some([mean_m - b * mean_x, b])
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME_S: f64 = 0.1;
    const ONE_MG: f64 = 1.0;

    /// A display in whole milligrams over five seconds, and the first reading that counts as final.
    fn watch(mass_mg: impl Fn(f64) -> f64) -> Option<Settled> {
        let shown: Vec<Shown> = (0..50)
            .map(|k| f64::from(k) * FRAME_S)
            .map(|t_s| Shown { t_s, mass_mg: mass_mg(t_s).round(), flag: t_s > 1.5 })
            .collect();
        (1..=shown.len()).find_map(|n| settled(&Settling::new(ONE_MG), &shown[..n]))
    }

    fn step(size_mg: f64) -> impl Fn(f64) -> f64 {
        move |t_s| size_mg * (1.0 - libm::exp(-t_s / 0.16))
    }

    #[test]
    fn a_dose_is_final_in_well_under_a_second_and_right() {
        for size_mg in [0.0, 1.0, 5.0, 20.0, 100.0, 2000.0] {
            let found = watch(step(size_mg)).unwrap();
            // Seven time constants past the window for the largest step; there was no need to wait
            // for the flag.
            assert!(
                found.t_s < if size_mg > 100.0 { 1.6 } else { 1.2 },
                "{size_mg}: {}",
                found.t_s
            );
            assert!((found.mass_mg - size_mg).abs() <= ONE_MG, "{size_mg}: {found:?}");
            assert!((found.end_mg - size_mg).abs() <= ONE_MG, "{size_mg}: {found:?}");
        }
        assert!(watch(step(20.0)).unwrap().t_s < 1.0 && !watch(step(20.0)).unwrap().flag);
    }

    #[test]
    fn a_slow_cell_that_still_creeps_is_not_final_and_its_end_is_foreseen() {
        // Six readings of 20 mg at a time constant of a second span less than two steps from 1.6 s
        // on; a step is left to come at 3 s, and that decides.
        let settling = Settling { tau_s: 1.0, ..Settling::new(ONE_MG) };
        let shown: Vec<Shown> = (0..50)
            .map(|k| f64::from(k) * FRAME_S)
            .map(|t_s| Shown { t_s, mass_mg: 20.0 * (1.0 - libm::exp(-t_s)), flag: false })
            .collect();
        let found = (1..=shown.len()).find_map(|n| settled(&settling, &shown[..n])).unwrap();
        assert!((20f64.ln()..20f64.ln() + FRAME_S).contains(&found.t_s), "{found:?}");
        assert!((found.end_mg - 20.0).abs() < 1e-9 && found.mass_mg > 19.0, "{found:?}");
    }

    #[test]
    fn an_impact_is_waited_for() {
        // 80 mg of impact that decays in 0.1 s, on top of a dose of 20 mg.
        let found = watch(|t_s| step(20.0)(t_s) + 80.0 * libm::exp(-t_s / 0.1)).unwrap();
        assert!((found.mass_mg - 20.0).abs() <= ONE_MG, "{found:?}");
    }

    #[test]
    fn drift_and_noise_of_a_quiet_room_do_not_hold_a_reading_up() {
        // 4 mg/min and 0.15 mg of noise, the worst of an enclosed balance.
        let noise = |t_s: f64| 0.15 * libm::sin(71.0 * t_s);
        let found = watch(|t_s| step(10.0)(t_s) + 4.0 / 60.0 * t_s + noise(t_s)).unwrap();
        assert!(found.t_s < 1.0 && (found.mass_mg - 10.0).abs() <= ONE_MG, "{found:?}");
    }

    #[test]
    fn a_draught_and_a_balance_without_numbers_never_settle() {
        assert_eq!(watch(|t_s| 10.0 + 4.0 * libm::sin(9.0 * t_s)), None);
        assert_eq!(watch(|t_s| 10.0 + 25.0 * t_s), None, "somebody leans on the table");
        assert_eq!(watch(|_| f64::NAN), None);
    }

    #[test]
    fn a_display_that_has_not_felt_the_fall_yet_is_not_final() {
        // Powder that lands 0.25 s after the end of the motion: the display shows zero before.
        let found = watch(|t_s| if t_s < 0.25 { 0.0 } else { step(12.0)(t_s - 0.25) }).unwrap();
        assert!((found.mass_mg - 12.0).abs() <= ONE_MG, "{found:?}");
    }

    #[test]
    fn two_readings_or_a_short_look_are_not_enough() {
        let at = |t_s: f64| Shown { t_s, mass_mg: 5.0, flag: true };
        let settling = Settling::new(ONE_MG);
        assert_eq!(settled(&settling, &[]), None);
        assert_eq!(settled(&settling, &[at(0.4), at(2.0)]), None);
        assert_eq!(settled(&settling, &[at(0.4), at(0.5), at(0.6)]), None);
        assert!(settled(&settling, &[at(0.4), at(0.6), at(0.75)]).is_some());
    }

    #[test]
    fn a_standing_balance_says_how_it_drifts() {
        let shown: Vec<Shown> = (0..60)
            .map(|k| Shown {
                t_s: f64::from(k) * 0.2,
                mass_mg: 3.0 + 0.05 * f64::from(k) * 0.2,
                flag: true,
            })
            .collect();
        let found = standing(&Settling::new(ONE_MG), &shown).unwrap();
        assert!((found.drift_mg_min - 3.0).abs() < 1e-9 && found.scatter_mg < 1e-9);
        assert!(found.still && found.reading.stable && (found.seconds - 11.8).abs() < 1e-9);
        let restless: Vec<Shown> =
            shown.iter().map(|s| Shown { mass_mg: 9.0 * libm::sin(3.0 * s.t_s), ..*s }).collect();
        assert!(!standing(&Settling::new(ONE_MG), &restless).unwrap().still);
        assert_eq!(standing(&Settling::new(ONE_MG), &shown[..2]), None);
    }
}
