//! The load cell and the display behind an emulated balance.

use super::Settings;
use super::fault::{Fault, Faults};
use crate::emulate::pan::Pan;
use crate::hardware::balance::value::Unit;
use flip_core::domain::seed::derive;

/// Creep of a drifting reading, mg/s.
const DRIFT_MG_PER_S: f64 = 0.05;
/// SD of readings in a draught, mg.
const DRAUGHT_MG: f64 = 5.0;
/// Fraction of the capacity within which the zero point can be set, and below which the pan counts
/// as lifted.
const ZERO_RANGE: f64 = 0.02;
/// Reading of a balance that was switched on with a load, mg.
const RESTARTED_MG: f64 = 2.0;
/// mg in an ounce (avoirdupois).
const OUNCE_MG: f64 = 28_349.523_125;

/// The display.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Display {
    Mass { number: String, unit: &'static str, stable: bool },
    Overload,
    Underload,
    NotReady,
    Adjusting,
}

/// State of the wander: its value, when it was updated, and how many times.
#[derive(Debug, Default)]
struct Wander {
    mass_mg: f64,
    at_s: Option<f64>,
    moves: u64,
}

#[derive(Debug)]
pub(super) struct Cell {
    settings: Settings,
    pan: Pan,
    /// Number of frames so far: each has its own noise.
    frames: u64,
    zero_mg: f64,
    tare_mg: f64,
    wander: Wander,
    drifting_since_s: Option<f64>,
    frozen_steps: Option<f64>,
}

impl Cell {
    pub(super) fn new(settings: Settings, pan: Pan) -> Self {
        let wander = Wander::default();
        Self {
            settings,
            pan,
            frames: 0,
            zero_mg: 0.0,
            tare_mg: 0.0,
            wander,
            drifting_since_s: None,
            frozen_steps: None,
        }
    }

    pub(super) fn tare_mg(&self) -> f64 {
        self.tare_mg
    }

    pub(super) fn is_tared(&self) -> bool {
        self.tare_mg != 0.0
    }

    /// Bench time until the next frame is measured, s.
    pub(super) fn until_frame_s(&self) -> f64 {
        let (now_s, frame_s) = (self.pan.clock().now_s(), self.settings.frame_s);
        // The clock counts microseconds: a frame that began less than a thousandth of a frame ago
        // is the last one.
        ((now_s / frame_s + 1e-3).floor() + 1.0) * frame_s - now_s
    }

    /// Start a fault of the cell itself; it ends with the fault.
    pub(super) fn begin(&mut self, fault: Fault) {
        match fault {
            Fault::Drift => self.drifting_since_s = Some(self.pan.clock().now_s()),
            Fault::Stuck => {
                self.go_astray();
                self.frozen_steps = Some(self.steps(false));
            }
            _ => {}
        }
    }

    /// End all of its faults.
    pub(super) fn end_faults(&mut self) {
        (self.drifting_since_s, self.frozen_steps) = (None, None);
    }

    /// Measure the next frame and display it.
    pub(super) fn show(&mut self, faults: &Faults) -> Display {
        self.frames += 1;
        self.go_astray();
        self.drifting_since_s = self.drifting_since_s.filter(|_| faults.has(Fault::Drift));
        self.frozen_steps = self.frozen_steps.filter(|_| faults.has(Fault::Stuck));
        if let Some(display) = self.condition(faults) {
            return display;
        }
        let steps = self.frozen_steps.unwrap_or_else(|| self.steps(faults.has(Fault::Draught)));
        let (mut number, unit) =
            self.number(steps * self.settings.readability_mg, faults.has(Fault::UnitSwitched));
        if faults.has(Fault::NotANumber) {
            number = "NaN".to_owned();
        }
        Display::Mass {
            number,
            unit,
            stable: self.frozen_steps.is_some() || self.is_stable(faults),
        }
    }

    fn condition(&self, faults: &Faults) -> Option<Display> {
        let gross_mg = self.gross_mg();
        let (capacity_mg, slack_mg) =
            (self.settings.capacity_mg, 9.0 * self.settings.readability_mg);
        if faults.has(Fault::Adjusting) {
            Some(Display::Adjusting)
        } else if faults.has(Fault::NotReady) {
            Some(Display::NotReady)
        } else if faults.has(Fault::Overload) || gross_mg > capacity_mg + slack_mg {
            Some(Display::Overload)
        } else if faults.has(Fault::Underload) || gross_mg < -ZERO_RANGE * capacity_mg {
            Some(Display::Underload)
        } else {
            None
        }
    }

    /// Whether the load has been at rest for as long as the balance requires, a time drawn for each
    /// load between two bounds.
    pub(super) fn is_stable(&self, faults: &Faults) -> bool {
        let quiet_s = self.pan.quiet_s();
        if quiet_s.is_infinite() || faults.has(Fault::Draught) {
            return !faults.has(Fault::Draught);
        }
        let changed_at_ms = ((self.pan.clock().now_s() - quiet_s) * 1e3).round() as u64;
        let [least_s, most_s] = self.settings.flag_after_s;
        quiet_s
            >= least_s
                + (most_s - least_s) * uniform(derive(self.settings.seed, &[1, changed_at_ms]))
    }

    /// Tare; returns the tare as the display writes it.
    pub(super) fn tare(&mut self) -> (String, &'static str) {
        self.go_astray();
        self.tare_mg = self.gross_mg();
        self.number(
            (self.tare_mg / self.settings.readability_mg).round() * self.settings.readability_mg,
            false,
        )
    }

    pub(super) fn tare_text(&self) -> (String, &'static str) {
        self.number(
            (self.tare_mg / self.settings.readability_mg).round() * self.settings.readability_mg,
            false,
        )
    }

    pub(super) fn clear_tare(&mut self) {
        self.tare_mg = 0.0;
    }

    /// Set the zero point; `false` if the load is too large for it.
    pub(super) fn zero(&mut self) -> bool {
        self.go_astray();
        let felt_mg = self.gross_mg() + self.zero_mg;
        if felt_mg.abs() > ZERO_RANGE * self.settings.capacity_mg {
            return false;
        }
        (self.zero_mg, self.tare_mg) = (felt_mg, 0.0);
        true
    }

    /// Switched on with a load on the pan: the zero is near it, and there is no tare.
    pub(super) fn restart(&mut self) {
        self.go_astray();
        (self.zero_mg, self.tare_mg) = (self.gross_mg() + self.zero_mg - RESTARTED_MG, 0.0);
    }

    /// Update the wander to now; the first value is drawn from its stationary distribution.
    fn go_astray(&mut self) {
        let &Settings { wander_mg, wander_s, seed, .. } = &self.settings;
        let now_s = self.pan.clock().now_s();
        let kept = self.wander.at_s.map_or(0.0, |at_s| libm::exp(-(now_s - at_s) / wander_s));
        if kept < 1.0 {
            let new_mg = wander_mg
                * (1.0 - kept * kept).sqrt()
                * normal(derive(seed, &[2, self.wander.moves]));
            let mass_mg = kept * self.wander.mass_mg + new_mg;
            self.wander = Wander { mass_mg, at_s: Some(now_s), moves: self.wander.moves + 1 };
        }
    }

    fn gross_mg(&self) -> f64 {
        let drift_mg = self
            .drifting_since_s
            .map_or(0.0, |since_s| DRIFT_MG_PER_S * (self.pan.clock().now_s() - since_s));
        self.pan.felt_mg(self.settings.settling_tau_s) + self.wander.mass_mg + drift_mg
            - self.zero_mg
    }

    /// Net mass in steps of the display.
    fn steps(&self, draughty: bool) -> f64 {
        let noise_mg = if draughty { DRAUGHT_MG } else { self.settings.noise_mg };
        let noise_mg = noise_mg * normal(derive(self.settings.seed, &[0, self.frames]));
        ((self.gross_mg() - self.tare_mg + noise_mg) / self.settings.readability_mg).round()
    }

    fn number(&self, mass_mg: f64, in_ounces: bool) -> (String, &'static str) {
        let (unit_mg, unit) = match self.settings.unit {
            Unit::Milligram => (1.0, "mg"),
            Unit::Gram => (1e3, "g"),
            Unit::Kilogram => (1e6, "kg"),
        };
        let decimals = decimals(self.settings.readability_mg / unit_mg);
        if in_ounces {
            return (format!("{:.*}", decimals + 2, mass_mg / OUNCE_MG + 0.0), "oz");
        }
        // Adding zero prevents -0 from being shown.
        (format!("{:.*}", decimals, mass_mg / unit_mg + 0.0), unit)
    }
}

/// Digits after the decimal point needed to show this step.
fn decimals(step: f64) -> usize {
    (0..10).find(|&places| (step * 10f64.powi(places)).round() >= 1.0).unwrap_or(9) as usize
}

fn uniform(bits: u64) -> f64 {
    ((bits >> 11) as f64 + 0.5) / (1u64 << 53) as f64
}

/// A standard normal deviate (Box and Muller 1958).
fn normal(seed: u64) -> f64 {
    let (radius, angle) = (uniform(derive(seed, &[0])), uniform(derive(seed, &[1])));
    (-2.0 * libm::log(radius)).sqrt() * libm::cos(std::f64::consts::TAU * angle)
}
