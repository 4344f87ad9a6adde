//! Recorded balance readings during weighings.

pub use crate::thresholds::trace::READINGS_MIN;
use flip_core::domain::{FieldError, bounded};
use serde::{Deserialize, Serialize};

/// One reading of the balance and the conditions recorded with it; `None` where not recorded.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Reading {
    /// Time since any fixed moment of the weighing, s.
    pub t_s: f64,
    /// Balance reading, mg.
    pub balance_mg: f64,
    /// Whether the balance reported it stable.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stable: Option<bool>,
    /// Shakes so far: readings with the same number follow the same shake.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shake_index: Option<u32>,
    /// Commanded amplitude of that shake, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shake_mm: Option<f64>,
    /// Pitch of the spoon during it, degrees, positive is tip down.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spoon_pitch_deg: Option<f64>,
    /// Powder in the spoon, mg.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spoon_fill_mg: Option<f64>,
    /// Relative humidity, percent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub relative_humidity_pct: Option<f64>,
    /// Vibration of the bench, root mean square acceleration, m/s^2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vibration_rms_m_s2: Option<f64>,
}

/// The load on the pan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// A vial that powder is shaken into.
    Dose,
    /// A constant load: a control of the balance.
    Zero,
    /// A standard mass, perhaps put on during the log.
    Standard,
}

/// The readings of one weighing, or of one control of the balance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Weighing {
    /// Its id in the file.
    pub id: String,
    /// Name of the powder.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub powder: Option<String>,
    /// Day, or another unit over which the balance's state is shared.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub session: Option<String>,
    /// The load on the pan.
    pub kind: Kind,
    /// Target mass, mg.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target_mg: Option<f64>,
    /// In the order of time.
    pub readings: Vec<Reading>,
}

/// Weighings and controls of one bench.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Traces {
    /// In any order.
    pub weighings: Vec<Weighing>,
}

impl Traces {
    /// Returns the traces if they can be judged at all.
    ///
    /// # Errors
    /// Fewer than [`READINGS_MIN`] readings; a number that is not finite; time that runs backwards;
    /// shakes that are uncounted; readings that are all the same.
    pub fn checked(self) -> Result<Self, FieldError> {
        let count: usize = self.weighings.iter().map(|weighing| weighing.readings.len()).sum();
        if count < READINGS_MIN {
            let message =
                format!("{count} readings say nothing: at least {READINGS_MIN} are needed");
            return Err(FieldError::new("traces", message));
        }
        self.weighings.iter().try_for_each(Weighing::check)?;
        let mut shown = self
            .weighings
            .iter()
            .flat_map(|weighing| &weighing.readings)
            .map(|reading| reading.balance_mg);
        let first = shown.next();
        if shown.all(|mg| Some(mg) == first) {
            return Err(FieldError::new(
                "balance_mg",
                "is the same in all readings: nothing was weighed",
            ));
        }
        Ok(self)
    }
}

impl Weighing {
    fn check(&self) -> Result<(), FieldError> {
        let field = |name: &str, k: usize| format!("{}[{k}].{name}", self.id);
        for (k, reading) in self.readings.iter().enumerate() {
            bounded(&field("t_s", k), reading.t_s, -1e12, 1e12, "s")?;
            bounded(&field("balance_mg", k), reading.balance_mg, -1e9, 1e9, "mg")?;
            let optional = [
                ("shake_mm", reading.shake_mm, 0.0, 1e3, "mm"),
                ("spoon_pitch_deg", reading.spoon_pitch_deg, -180.0, 180.0, "deg"),
                ("spoon_fill_mg", reading.spoon_fill_mg, -1e3, 1e9, "mg"),
                ("relative_humidity_pct", reading.relative_humidity_pct, 0.0, 100.0, "%"),
                ("vibration_rms_m_s2", reading.vibration_rms_m_s2, 0.0, 1e4, "m/s^2"),
            ];
            for (name, value, lower, upper, unit) in optional {
                value
                    .map_or(Ok(0.0), |value| bounded(&field(name, k), value, lower, upper, unit))?;
            }
        }
        for (k, pair) in self.readings.windows(2).enumerate() {
            if pair[1].t_s < pair[0].t_s {
                let message = format!("runs backwards, from {} to {} s", pair[0].t_s, pair[1].t_s);
                return Err(FieldError::new(field("t_s", k + 1), message));
            }
            if let (Some(before), Some(after)) = (pair[0].shake_index, pair[1].shake_index)
                && after < before
            {
                let message = format!("falls from {before} to {after}: shakes are counted up");
                return Err(FieldError::new(field("shake_index", k + 1), message));
            }
        }
        Ok(())
    }
}
