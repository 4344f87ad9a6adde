//! How large a cause is over the covariate it goes with: the change of its signature from the
//! lowest to the highest tenth of that, whose middles are the 5th and the 95th percentile.

use super::catalogue::{Level, TraceMechanism};
use super::design::{Design, Plateau};
use super::readings::Kind;

/// The covariate a cause goes with, one value for each row of its level; `None` where the cause
/// does not act.
pub(super) struct Along {
    /// Column of the file.
    pub covariate: &'static str,
    pub at: Vec<Option<f64>>,
}

impl Along {
    /// The covariate `mechanism` goes with; `scattered` are the plateaus of the level of scatter.
    pub fn of(mechanism: TraceMechanism, design: &Design, scattered: &[usize]) -> Self {
        let plateau = |row: &super::design::Row| &design.plateaus[row.plateau];
        let rows =
            |of: &dyn Fn(&super::design::Row) -> Option<f64>| design.rows.iter().map(of).collect();
        let is_dose = |plateau: &Plateau| design.logs[plateau.log].kind == Kind::Dose;
        let is_step =
            |row: &super::design::Row| design.logs[plateau(row).log].plateaus.start != row.plateau;
        let shakes = |of: &dyn Fn(&super::design::Shake) -> Option<f64>| {
            design.shakes.iter().map(of).collect::<Vec<_>>()
        };
        let (covariate, at) = match mechanism {
            TraceMechanism::BalanceDrift => ("t_s", rows(&|row| Some(row.t_s))),
            TraceMechanism::MassUptake | TraceMechanism::Evaporation => {
                ("t_s", rows(&|row| is_dose(plateau(row)).then_some(row.t_s)))
            }
            TraceMechanism::BalanceLag | TraceMechanism::BalanceStatic => {
                ("t_s", rows(&|row| is_step(row).then(|| row.t_s - plateau(row).step_s)))
            }
            TraceMechanism::VibrationNoise => (
                "vibration_rms_m_s2",
                scattered.iter().map(|&k| design.plateaus[k].vibration).collect(),
            ),
            TraceMechanism::SpoonHoldup | TraceMechanism::Densification => {
                ("shake_index", shakes(&|shake| Some(shake.number)))
            }
            TraceMechanism::FillLevel => {
                let fill = |k: usize| design.plateaus[k].fill_mg;
                (
                    "spoon_fill_mg",
                    shakes(&|shake| shake.before.and_then(fill).or(fill(shake.after))),
                )
            }
            TraceMechanism::Actuator => {
                ("shake_mm", shakes(&|shake| design.plateaus[shake.after].shake_mm))
            }
        };
        Self { covariate, at }
    }

    /// The 5th and the 95th percentile; `None` if no values are known.
    pub fn ends(&self) -> Option<[f64; 2]> {
        let mut known: Vec<f64> = self.at.iter().flatten().copied().collect();
        known.sort_by(f64::total_cmp);
        let at = |share: f64| {
            known.get(((known.len().max(1) - 1) as f64 * share).round() as usize).copied()
        };
        Some([at(0.05)?, at(0.95)?])
    }

    /// Mean of a signature over the highest tenth less that over the lowest; 0 if no values are
    /// known.
    pub fn span(&self, signature: &[f64]) -> f64 {
        let mut known: Vec<(f64, f64)> =
            self.at.iter().zip(signature).filter_map(|(at, &of)| at.map(|at| (at, of))).collect();
        known.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (Some(first), Some(last)) =
            (known.get(known.len() / 10), known.get(known.len() - 1 - known.len() / 10))
        else {
            return 0.0;
        };
        let mean = |kept: &dyn Fn(f64) -> bool| {
            let kept: Vec<f64> =
                known.iter().filter(|(at, _)| kept(*at)).map(|(_, of)| *of).collect();
            kept.iter().sum::<f64>() / kept.len() as f64
        };
        mean(&|at| at >= last.0) - mean(&|at| at <= first.0)
    }
}

impl TraceMechanism {
    /// Converts an effect on this level to the unit of the document: mg, or percent of a shake's
    /// mass or of a reading's SD.
    pub(super) fn in_unit(self, effect: f64) -> f64 {
        match self.level() {
            Level::Readings => effect,
            Level::Shakes => 100.0 * libm::expm1(effect),
            Level::Scatter => 100.0 * libm::expm1(effect / 2.0),
        }
    }

    /// That unit.
    pub(super) fn unit(self) -> &'static str {
        match self.level() {
            Level::Readings => "mg",
            Level::Shakes | Level::Scatter => "%",
        }
    }

    /// What changes, and between which values: `a shake's mass, from shake 1 to shake 14`.
    pub(super) fn between(self, covariate: &str, [from, to]: [f64; 2]) -> String {
        let number = |x: f64| {
            let decimals = (2.0 - x.abs().max(1e-9).log10().floor()).clamp(0.0, 4.0) as usize;
            let text = format!("{x:.decimals$}");
            if text.contains('.') {
                text.trim_end_matches('0').trim_end_matches('.').to_owned()
            } else {
                text
            }
        };
        let (from, to) = (number(from), number(to));
        match self {
            Self::BalanceDrift | Self::MassUptake | Self::Evaporation => {
                format!("from {from} to {to} s of a weighing")
            }
            Self::BalanceLag | Self::BalanceStatic => {
                format!("from {from} to {to} s after a shake")
            }
            Self::VibrationNoise => format!("from {from} to {to} m/s2 of vibration"),
            _ if covariate == "shake_index" => format!("from shake {from} to shake {to}"),
            Self::Actuator => format!("from {from} to {to} mm of amplitude"),
            _ => format!("from {from} to {to} mg in the spoon"),
        }
    }
}
