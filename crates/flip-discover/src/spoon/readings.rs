//! From what a simulated spoon lets fall to what a balance would have shown of it.
//!
//! ```text
//! r_0 = s e_0     r_k = round(f (m_1 + .. + m_k) + s e_k)     fell_k = r_k - r_(k-1)
//! ln f = c_w e_w + c_d e_d        2 (s^2 + step^2 / 12) = sd_k^2
//! ```
//!
//! with the scatter c_w between spoonfuls and c_d between days that no simulator has, the recorded
//! standard uncertainty sd of each step, and the display's step.

use flip_core::domain::seed::{derive, index_of};
use flip_core::domain::shake::Spoonful;
use flip_core::stats::normal;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// Seed indices.
const DAY: u64 = 1;
const SPOONFUL: u64 = 2;

/// Scatter of masses that is the bench's own.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scatter {
    /// SD of the logarithm between spoonfuls.
    pub spoonful: f64,
    /// The same between days.
    pub day: f64,
}

/// The day of a spoonful, or its weighing where no day was recorded.
pub(super) fn day(spoonful: &Spoonful) -> &str {
    spoonful.session.as_deref().unwrap_or(&spoonful.weighing)
}

fn standard(rng: &mut Pcg64) -> f64 {
    normal::quantile(rng.random::<f64>().max(f64::EPSILON))
}

/// What a balance shows of the steps of a spoonful that let fall `mg`; `at` is its place.
pub(super) fn shown(
    spoonful: &Spoonful,
    mg: &[f64],
    scatter: Scatter,
    seed: u64,
    at: usize,
) -> Vec<f64> {
    let mut of_day = Pcg64::seed_from_u64(derive(seed, &[DAY, index_of(day(spoonful))]));
    let mut rng = Pcg64::seed_from_u64(derive(seed, &[SPOONFUL, at as u64]));
    let factor =
        (scatter.day * standard(&mut of_day) + scatter.spoonful * standard(&mut rng)).exp();
    let step = spoonful.readability_mg.unwrap_or(0.0);
    let read = |mass: f64| if step > 0.0 { (mass / step).round() * step } else { mass };
    let first = spoonful.shakes.first().map_or(0.0, |shake| noise(shake.sd_mg, step));
    let (mut before, mut mass) = (read(first * standard(&mut rng)), 0.0);
    let shakes = spoonful.shakes.iter().zip(mg);
    shakes
        .map(|(shake, fell)| {
            mass += factor * fell;
            let now = read(mass + noise(shake.sd_mg, step) * standard(&mut rng));
            now - std::mem::replace(&mut before, now)
        })
        .collect()
}

/// SD of one reading before rounding, where differences of two have this standard uncertainty.
fn noise(sd_mg: f64, step_mg: f64) -> f64 {
    (sd_mg * sd_mg / 2.0 - step_mg * step_mg / 12.0).max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use flip_core::domain::shake::Shake;
    use flip_core::stats::summary::{mean, sd};

    #[test]
    fn differences_of_readings_scatter_as_the_balance_was_said_to_and_days_are_shared() {
        let shake = Shake {
            pitch_deg: 30.0,
            shake_mm: 4.0,
            strokes: 1,
            acceleration_m_s2: None,
            spoon_mg: None,
            fell_mg: 0.0,
            sd_mg: 0.5,
            since_filled_s: None,
        };
        let spoonful = |session: &str| Spoonful {
            weighing: "w".to_owned(),
            spoonful: 1,
            powder: "salt".to_owned(),
            lot: None,
            session: Some(session.to_owned()),
            readability_mg: Some(1.0),
            shakes: vec![shake; 4000],
        };
        let fell: Vec<f64> = (0..4000).map(|k| f64::from(k % 7) * 0.37).collect();
        let none = Scatter { spoonful: 0.0, day: 0.0 };
        let seen = shown(&spoonful("a"), &fell, none, 3, 0);
        assert!(seen.iter().all(|mg| (mg - mg.round()).abs() < 1e-9));
        let errors: Vec<f64> = seen.iter().zip(&fell).map(|(seen, fell)| seen - fell).collect();
        // 4000 differences, each sharing a reading with the next: 4 standard errors of the SD.
        assert!((sd(&errors).unwrap() - 0.5).abs() < 0.04, "{:?}", sd(&errors));
        assert!(mean(&errors).unwrap().abs() < 1e-3);
        let days = Scatter { spoonful: 0.0, day: 0.2 };
        let mass = |session: &str, at: usize| {
            shown(&spoonful(session), &fell, days, 3, at).iter().sum::<f64>()
        };
        assert!((mass("a", 0) - mass("a", 1)).abs() <= 4.0, "one day, one factor");
        assert!((mass("a", 0) - mass("b", 0)).abs() > 20.0);
    }
}
