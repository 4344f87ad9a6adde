//! What a spoon let fall, shake by shake: the measurements that a weighing makes of its powder.

use super::apparatus::{Apparatus, Executed};
use super::bench::Tick;
use super::{FieldError, bounded};
use serde::{Deserialize, Serialize};

/// Largest mass of a spoonful, mg.
pub const SPOONFUL_MG_MAX: f64 = 1e5;

/// One step of a spoonful: the pitch it went to, then the shake made there.
///
/// A reading may be below zero and a shake may give nothing: both are measurements.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shake {
    /// Pitch of the spoon during the shake, degrees; positive is tip down.
    pub pitch_deg: f64,
    /// Amplitude as executed, mm; 0 where the step only changed the pitch.
    pub shake_mm: f64,
    /// How often it was made before the reading.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub strokes: u32,
    /// Largest acceleration of the stroke, m/s^2; `None` if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acceleration_m_s2: Option<f64>,
    /// Powder in the spoon before the step, mg: filled less fallen; `None` if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spoon_mg: Option<f64>,
    /// Mass that fell during the step, by the balance, mg.
    pub fell_mg: f64,
    /// Its standard uncertainty, mg.
    pub sd_mg: f64,
    /// Time from filling the spoon to the end of the step, s; `None` if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub since_filled_s: Option<f64>,
}

fn one() -> u32 {
    1
}

fn is_one(strokes: &u32) -> bool {
    *strokes == 1
}

/// Of which powder, where and when shakes were made.
#[derive(Debug, Clone, PartialEq)]
pub struct ShakesOf {
    /// Id of the weighing.
    pub weighing: String,
    /// Powder, by id.
    pub powder: String,
    /// Lot of the powder; `None` if unknown.
    pub lot: Option<String>,
    /// Day, or another unit over which powder and bench are alike.
    pub session: Option<String>,
}

/// Least mass that counts as flowing, mg.
const PIECE_MG: f64 = 0.5;
/// The same in standard uncertainties of the balance.
const PIECE_SD: f64 = 3.0;
/// Onset of a spoonful that never flowed, beyond its steepest pitch, deg.
const BEYOND_DEG: f64 = 5.0;

/// The steps of one filling of the spoon, in order, and what it was filled with.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Spoonful {
    /// Id of the weighing, or of the run in a file.
    pub weighing: String,
    /// Which spoonful of the weighing; the first is 1.
    pub spoonful: u32,
    /// Powder, by id.
    pub powder: String,
    /// Lot of the powder; `None` if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lot: Option<String>,
    /// Day, or another unit over which powder and bench are alike.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub session: Option<String>,
    /// Step of the balance's display, mg; `None` if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub readability_mg: Option<f64>,
    /// In the order in which they were made.
    pub shakes: Vec<Shake>,
}

impl Shake {
    /// Validates the numbers.
    ///
    /// # Errors
    /// The first field that is not a number within its bounds.
    pub fn checked(self) -> Result<Self, FieldError> {
        bounded("pitch_deg", self.pitch_deg, -90.0, 180.0, "deg")?;
        bounded("shake_mm", self.shake_mm, 0.0, 100.0, "mm")?;
        bounded("fell_mg", self.fell_mg, -SPOONFUL_MG_MAX, SPOONFUL_MG_MAX, "mg")?;
        bounded("sd_mg", self.sd_mg, 1e-4, 1e3, "mg")?;
        bounded("strokes", f64::from(self.strokes), 1.0, 1000.0, "")?;
        let optional = [
            ("acceleration_m_s2", self.acceleration_m_s2, 0.0, 1e3, "m/s^2"),
            ("spoon_mg", self.spoon_mg, -SPOONFUL_MG_MAX, SPOONFUL_MG_MAX, "mg"),
            ("since_filled_s", self.since_filled_s, 0.0, 1e7, "s"),
        ];
        for (name, value, lower, upper, unit) in optional {
            value.map_or(Ok(0.0), |value| bounded(name, value, lower, upper, unit))?;
        }
        Ok(self)
    }
}

impl Spoonful {
    /// The spoonfuls of a weighing, from its readings and actions. Every step counts: one that only
    /// changes the pitch, and one after which the balance shows less than before.
    ///
    /// The first tick of a spoonful is a reading before its first motion. The time since filling
    /// counts from the tare, which follows the first filling, or from that reading of a later one. A
    /// spoonful without a step is left out.
    pub fn of(ticks: &[Tick], apparatus: &Apparatus, of: &ShakesOf) -> Vec<Self> {
        let is_same = |tick: &Tick, next: &Tick| next.step > 0 && next.spoonful == tick.spoonful;
        let fillings = ticks.chunk_by(is_same).filter(|ticks| ticks.len() > 1);
        let spoonful = |(k, ticks): (usize, &[Tick])| Self {
            weighing: of.weighing.clone(),
            spoonful: k as u32 + 1,
            powder: of.powder.clone(),
            lot: of.lot.clone(),
            session: of.session.clone(),
            readability_mg: Some(apparatus.readability_mg),
            shakes: shakes(ticks, if k == 0 { 0.0 } else { ticks[0].t_s }, apparatus),
        };
        fillings.enumerate().map(spoonful).collect()
    }

    /// Mass that fell over all steps, mg.
    pub fn fell_mg(&self) -> f64 {
        self.shakes.iter().map(|shake| shake.fell_mg).sum()
    }

    /// What fell in each step, mg.
    pub fn fallen(&self) -> Vec<f64> {
        self.shakes.iter().map(|shake| shake.fell_mg).collect()
    }

    /// First step after which a piece of powder had fallen, if these masses, mg, fell in its steps: 0.5
    /// mg in all, or three standard uncertainties of the balance if they are more.
    pub fn onset(&self, fell_mg: &[f64]) -> Option<usize> {
        let mut fallen_mg = 0.0;
        self.shakes.iter().zip(fell_mg).position(|(shake, mg)| {
            fallen_mg += mg;
            fallen_mg >= (PIECE_SD * shake.sd_mg).max(PIECE_MG)
        })
    }

    /// Pitch of that step, deg; 5 deg beyond the steepest if nothing fell.
    pub fn onset_deg(&self, fell_mg: &[f64]) -> f64 {
        let steepest = self.shakes.iter().map(|shake| shake.pitch_deg).fold(f64::MIN, f64::max);
        self.onset(fell_mg).map_or(steepest + BEYOND_DEG, |k| self.shakes[k].pitch_deg)
    }
}

/// The steps of one filling, which was made at this time.
fn shakes(ticks: &[Tick], filled_s: f64, apparatus: &Apparatus) -> Vec<Shake> {
    let sd_mg = apparatus.difference_sd_mg();
    let shown_mg = |tick: &Tick| tick.reading.mass_mg;
    let shake = |pair: &[Tick]| {
        let (before, after) = (&pair[0], &pair[1]);
        let Executed { shake_mm, acceleration_m_s2 } = apparatus.executed(&after.action);
        let fallen_mg = shown_mg(before) - shown_mg(&ticks[0]);
        Shake {
            pitch_deg: after.pitch_deg,
            shake_mm,
            strokes: after.action.strokes,
            acceleration_m_s2,
            spoon_mg: apparatus.capacity_mg.map(|capacity_mg| capacity_mg - fallen_mg),
            fell_mg: shown_mg(after) - shown_mg(before),
            sd_mg,
            since_filled_s: Some(after.t_s - filled_s),
        }
    };
    ticks.windows(2).map(shake).collect()
}

/// Steps of displays, mg, from the coarsest.
const DISPLAY_STEPS_MG: [f64; 16] =
    [100.0, 50.0, 20.0, 10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001];

/// The coarsest step of a display, 1, 2 or 5 times a power of ten, that shows all these readings,
/// mg; `None` if the finest, 1 ug, does not, or if all are zero.
///
/// For readings whose display is not on record. A step is never guessed too fine, but too coarse
/// where few readings happen to be multiples of a larger one.
pub fn display_step_mg(readings_mg: impl Iterator<Item = f64> + Clone) -> Option<f64> {
    // A multiple in decimals is one up to the rounding of binary numbers.
    let shows = |step: f64, mg: f64| ((mg / step) - (mg / step).round()).abs() < 1e-6;
    let mut known = readings_mg.filter(|mg| *mg != 0.0).peekable();
    known.peek()?;
    DISPLAY_STEPS_MG.into_iter().find(|step| known.clone().all(|mg| shows(*step, mg)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::bench::{Action, Reading};

    #[test]
    fn a_reading_below_zero_is_a_measurement_and_a_number_out_of_bounds_is_named() {
        let shake = Shake {
            pitch_deg: 40.0,
            shake_mm: 0.0,
            strokes: 1,
            acceleration_m_s2: None,
            spoon_mg: Some(-0.5),
            fell_mg: -1.0,
            sd_mg: 0.4,
            since_filled_s: None,
        };
        assert_eq!(shake.checked(), Ok(shake));
        let field = |bad: Shake| bad.checked().unwrap_err().field;
        assert_eq!(field(Shake { fell_mg: f64::NAN, ..shake }), "fell_mg");
        assert_eq!(field(Shake { sd_mg: 0.0, ..shake }), "sd_mg");
        assert_eq!(field(Shake { since_filled_s: Some(-1.0), ..shake }), "since_filled_s");
        let spoonful = Spoonful {
            weighing: "w".to_owned(),
            spoonful: 1,
            powder: "salt".to_owned(),
            lot: None,
            session: None,
            readability_mg: None,
            shakes: vec![shake, Shake { fell_mg: 3.5, ..shake }],
        };
        assert_eq!(spoonful.fell_mg(), 2.5);
    }

    fn of() -> ShakesOf {
        let (weighing, powder) = ("w".to_owned(), "salt".to_owned());
        ShakesOf { weighing, powder, lot: Some("L1".to_owned()), session: None }
    }

    fn tick(step: u32, t_s: f64, pitch_deg: f64, shake_mm: f64, mass_mg: f64) -> Tick {
        let action = Action::once(4.0, shake_mm);
        let reading = Reading { mass_mg, stable: true };
        Tick { step, t_s, pitch_deg, action, reading, spoonful: 1 }
    }

    const APPARATUS: Apparatus = Apparatus {
        readability_mg: 1.0,
        repeatability_mg: None,
        capacity_mg: Some(36.0),
        stroke: None,
    };

    #[test]
    fn every_step_is_a_measurement_also_without_a_shake_and_below_zero() {
        let ticks = [
            tick(0, 2.0, 0.0, 0.0, 1.0),
            tick(1, 4.0, 4.0, 0.0, 0.0),
            tick(2, 7.0, 8.0, 3.0, 6.0),
            tick(3, 9.0, 8.0, 0.5, 6.0),
        ];
        let found = Spoonful::of(&ticks, &APPARATUS, &of());
        let [spoonful] = &found[..] else { panic!("{found:?}") };
        let seen: Vec<_> = spoonful
            .shakes
            .iter()
            .map(|it| (it.pitch_deg, it.shake_mm, it.fell_mg, it.spoon_mg.unwrap()))
            .collect();
        assert_eq!(seen, [(4.0, 0.0, -1.0, 36.0), (8.0, 3.0, 6.0, 37.0), (8.0, 0.0, 0.0, 31.0)]);
        assert_eq!(spoonful.fell_mg(), 6.0 - 1.0);
        assert_eq!(spoonful.shakes[2].since_filled_s, Some(9.0));
        assert_eq!((spoonful.lot.as_deref(), spoonful.readability_mg), (Some("L1"), Some(1.0)));
        assert!(spoonful.shakes.iter().all(|shake| shake.checked().is_ok()));
    }

    #[test]
    fn each_filling_is_a_spoonful_and_one_without_a_step_is_none() {
        let strokes = |action: Action| Action { strokes: 4, ..action };
        let second = |tick: Tick| Tick { spoonful: 2, action: strokes(tick.action), ..tick };
        let ticks = [
            tick(0, 1.0, 0.0, 0.0, 0.0),
            tick(1, 3.0, 40.0, 3.0, 20.0),
            second(tick(2, 60.0, 0.0, 0.0, 21.0)),
            second(tick(3, 64.0, 40.0, 3.0, 30.0)),
        ];
        let found = Spoonful::of(&ticks, &APPARATUS, &of());
        let seen: Vec<_> = found
            .iter()
            .map(|it| (it.spoonful, it.shakes[0].spoon_mg, it.shakes[0].since_filled_s))
            .collect();
        assert_eq!(seen, [(1, Some(36.0), Some(3.0)), (2, Some(36.0), Some(4.0))]);
        assert_eq!((found[1].fell_mg(), found[1].shakes[0].strokes), (9.0, 4));
        assert_eq!(Spoonful::of(&ticks[..1], &APPARATUS, &of()), []);
        assert_eq!(Spoonful::of(&[], &APPARATUS, &of()), []);
    }

    #[test]
    fn a_display_is_known_by_the_numbers_that_it_shows() {
        let step = |readings: &[f64]| display_step_mg(readings.iter().copied());
        assert_eq!(step(&[0.0, -1.0, 7.0]), Some(1.0));
        assert_eq!(step(&[0.1, 0.30000000000000004, 20.2]), Some(0.1));
        assert_eq!(step(&[0.0, 12.5]), Some(0.5));
        assert_eq!(step(&[0.0, 0.0]), None);
        assert_eq!(step(&[std::f64::consts::PI]), None);
    }
}
