//! Shakes of weighings as observations for a calibration: the mean mass of a stroke from a nearly
//! full spoon, at a pitch and an amplitude.
//!
//! An observation of a shake's mass means shakes of a *full* spoon
//! ([`Observable::ShakeMass`]), and a weighing rises through pitches while its spoon empties. So
//! only shakes before which little had fallen count. Pitches and amplitudes close to each other are
//! one cell, which stands at its mean pitch and amplitude.

use crate::domain::observable::{Observable, Observation, SD_MIN};
use crate::domain::shake::{Shake, Spoonful};
use crate::stats::summary::{mean, sd};
use std::collections::BTreeMap;

/// Most cells: each costs minutes of simulation.
const CELLS_MAX: usize = 3;
/// Fewest shakes of a cell.
const SHAKES_MIN: usize = 3;
/// Width of a cell in pitch, deg.
const PITCH_DEG: f64 = 4.0;
/// Amplitudes of cells, mm; a shake belongs to the nearest by its logarithm.
const SHAKE_MM: [f64; 4] = [2.0, 4.0, 8.0, 16.0];
/// Share of a filling that may have fallen before a shake of a full spoon.
const SPENT_SHARE: f64 = 1.0 / 3.0;
/// The same where the filling is unknown, mg: a third of FLIP's own spoon.
const SPENT_MG: f64 = 12.0;
/// Largest pitch of an observation, deg.
const PITCH_DEG_MAX: f64 = 50.0;
/// Amplitudes of an observation, mm.
const SHAKE_MM_RANGE: [f64; 2] = [0.9, 16.0];

/// The cells with the most shakes, in order of pitch; none where no cell has enough.
pub fn cells(spoonfuls: &[Spoonful]) -> Vec<Observation> {
    let mut all: BTreeMap<(i64, usize), Vec<&Shake>> = BTreeMap::new();
    for shake in spoonfuls.iter().flat_map(from_full) {
        let place = (shake.pitch_deg / PITCH_DEG).round() as i64;
        all.entry((place, nearest(shake.shake_mm))).or_default().push(shake);
    }
    let mut found: Vec<Vec<&Shake>> =
        all.into_values().filter(|shakes| shakes.len() >= SHAKES_MIN).collect();
    // Stable: of equally many, the lower pitch.
    found.sort_by_key(|shakes| std::cmp::Reverse(shakes.len()));
    found.truncate(CELLS_MAX);
    let mut cells: Vec<Observation> = found.iter().filter_map(|it| observation(it)).collect();
    let pitch = |it: &Observation| match it.observable {
        Observable::ShakeMass { pitch_deg, .. } => pitch_deg,
        _ => 0.0,
    };
    cells.sort_by(|a, b| pitch(a).total_cmp(&pitch(b)));
    cells
}

/// The shakes of a spoonful before which little had fallen.
fn from_full(spoonful: &Spoonful) -> impl Iterator<Item = &Shake> {
    let filled_mg = spoonful.shakes.first().and_then(|shake| shake.spoon_mg);
    let most_mg = filled_mg.map_or(SPENT_MG, |mg| SPENT_SHARE * mg);
    let mut fallen_mg = 0.0;
    let is_full = move |shake: &&Shake| {
        let before_mg = fallen_mg;
        fallen_mg += shake.fell_mg;
        let is_possible = (0.0..=PITCH_DEG_MAX).contains(&shake.pitch_deg)
            && (SHAKE_MM_RANGE[0]..=SHAKE_MM_RANGE[1]).contains(&shake.shake_mm);
        before_mg <= most_mg && is_possible
    };
    spoonful.shakes.iter().filter(is_full)
}

fn nearest(shake_mm: f64) -> usize {
    let apart = |of: f64| (shake_mm / of).ln().abs();
    let by = |a: &usize, b: &usize| apart(SHAKE_MM[*a]).total_cmp(&apart(SHAKE_MM[*b]));
    (0..SHAKE_MM.len()).min_by(by).unwrap_or(0)
}

/// A cell's shakes as one observation of a single stroke.
fn observation(shakes: &[&Shake]) -> Option<Observation> {
    let of = |number: &dyn Fn(&Shake) -> f64| -> Vec<f64> {
        shakes.iter().map(|shake| number(shake)).collect()
    };
    let half = |value: f64| (2.0 * value).round() / 2.0;
    let pitch_deg = half(mean(&of(&|it| it.pitch_deg))?).clamp(0.0, PITCH_DEG_MAX);
    let [least, most] = SHAKE_MM_RANGE;
    let shake_mm = half(mean(&of(&|it| it.shake_mm))?).clamp(least, most);
    let masses = of(&|it| it.fell_mg / f64::from(it.strokes));
    let display_mg = mean(&of(&|it| it.sd_mg / f64::from(it.strokes)))?;
    // A mean below zero is a spoon that gives nothing, within what the display resolves.
    let observation = Observation {
        observable: Observable::ShakeMass { pitch_deg, shake_mm },
        mean: mean(&masses)?.max(0.0),
        sd: sd(&masses)?.max(display_mg).max(SD_MIN),
        n: shakes.len() as u32,
    };
    observation.checked().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shake(pitch_deg: f64, shake_mm: f64, strokes: u32, fell_mg: f64) -> Shake {
        Shake {
            pitch_deg,
            shake_mm,
            strokes,
            acceleration_m_s2: None,
            spoon_mg: None,
            fell_mg,
            sd_mg: 0.4,
            since_filled_s: None,
        }
    }

    fn spoonful(shakes: Vec<Shake>) -> Spoonful {
        Spoonful {
            weighing: "w".into(),
            spoonful: 1,
            powder: "sand".into(),
            lot: None,
            session: None,
            readability_mg: Some(1.0),
            shakes,
        }
    }

    #[test]
    fn strokes_of_a_full_spoon_are_counted_by_pitch_and_amplitude_and_later_ones_are_not() {
        let course = |more: f64| {
            spoonful(vec![
                shake(20.0, 8.0, 2, -0.5),
                shake(28.5, 8.0, 2, 6.0 + more),
                shake(27.5, 8.0, 1, 4.0 - more),
                shake(28.0, 8.0, 1, 9.0),
                shake(60.0, 8.0, 1, 1.0),
                // Of a spoon that 19 mg have left.
                shake(36.0, 8.0, 1, 9.0),
            ])
        };
        let all = cells(&[course(0.2), course(0.0), course(-0.2)]);
        let observable = |pitch_deg| Observable::ShakeMass { pitch_deg, shake_mm: 8.0 };
        assert_eq!(
            all.iter().map(|it| it.observable).collect::<Vec<_>>(),
            [observable(20.0), observable(28.0)]
        );
        assert_eq!((all[0].mean, all[0].n), (0.0, 3), "nothing below zero");
        assert!(all[0].sd >= 0.2, "no better than the display: {}", all[0].sd);
        // (3 + 4 + 9) / 3 of three spoonfuls.
        assert!((all[1].mean - 16.0 / 3.0).abs() < 1e-9 && all[1].n == 9, "{:?}", all[1]);
    }

    #[test]
    fn a_filling_that_was_weighed_says_what_is_a_third_of_it() {
        let weighed = |mg: f64| {
            let mut all = vec![shake(30.0, 8.0, 1, 5.0); 6];
            all[0].spoon_mg = Some(mg);
            spoonful(all)
        };
        // Before them 0, 5, 10, .. mg had fallen.
        assert_eq!(cells(&[weighed(30.0)])[0].n, 3);
        assert_eq!(cells(&[weighed(90.0)])[0].n, 6);
        assert!(cells(&[spoonful(vec![shake(30.0, 8.0, 1, 5.0); 2])]).is_empty());
    }
}
