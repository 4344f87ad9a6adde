//! The causes that balance readings may show, and the possible forms of each.

use super::bench::{Humidity, Sensor, Spoon};
use super::design::Design;
use super::readings::Kind;
use super::shakes::is_fill_known;

/// A cause the simulated bench can be extended by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum TraceMechanism {
    /// The balance's zero drifts at a steady rate, whatever the load.
    BalanceDrift,
    /// The reading lags behind the load.
    BalanceLag,
    /// Powder in the vial takes up water.
    MassUptake,
    /// The contents of the vial evaporate.
    Evaporation,
    /// Charged powder pulls at the pan until the charge has leaked away.
    BalanceStatic,
    /// Readings scatter more where the bench vibrates more.
    VibrationNoise,
    /// The spoon retains the first powder it is given.
    SpoonHoldup,
    /// A fuller spoon dispenses more.
    FillLevel,
    /// Shaken powder packs and dispenses less.
    Densification,
    /// A shake differs in length from the commanded one.
    Actuator,
}

/// The level at which a cause acts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Level {
    /// Readings within plateaus.
    Readings,
    /// Masses of shakes.
    Shakes,
    /// Scatter within plateaus.
    Scatter,
}

/// A form of a cause, and the value of its shape parameter.
pub(super) type Shaped = (Effect, Option<f64>);

/// The effect of a cause, of unit size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Effect {
    Sensor(Sensor),
    Spoon(Spoon),
    /// Rise of the log variance, as log(1 + (v / this)^2), from the 5th to the 95th percentile of
    /// v; this in m/s^2.
    Vibration(f64),
}

/// A cause's parameters as named in reports, for its size and its shape: name and unit.
pub(super) type Names = [(&'static str, &'static str); 2];

impl TraceMechanism {
    /// Every mechanism.
    pub const ALL: [Self; 10] = [
        Self::BalanceDrift,
        Self::BalanceLag,
        Self::MassUptake,
        Self::Evaporation,
        Self::BalanceStatic,
        Self::VibrationNoise,
        Self::SpoonHoldup,
        Self::FillLevel,
        Self::Densification,
        Self::Actuator,
    ];

    /// Name used in reports, and family.
    pub fn name(self) -> (&'static str, &'static str) {
        match self {
            Self::BalanceDrift => ("balance_drift", "sensor"),
            Self::BalanceLag => ("balance_lag", "sensor"),
            Self::MassUptake => ("mass_uptake", "vial_mass"),
            Self::Evaporation => ("evaporation", "vial_mass"),
            Self::BalanceStatic => ("balance_static", "electrostatic"),
            Self::VibrationNoise => ("vibration_noise", "vibration"),
            Self::SpoonHoldup => ("spoon_holdup", "spoon"),
            Self::FillLevel => ("fill_level", "spoon"),
            Self::Densification => ("densification", "consolidation"),
            Self::Actuator => ("actuator", "actuator"),
        }
    }

    pub(super) fn level(self) -> Level {
        match self {
            Self::VibrationNoise => Level::Scatter,
            Self::SpoonHoldup | Self::FillLevel | Self::Densification | Self::Actuator => {
                Level::Shakes
            }
            _ => Level::Readings,
        }
    }

    /// Sign of an effect's size, where physics fixes it.
    pub(super) fn sign(self) -> Option<f64> {
        match self {
            Self::BalanceDrift | Self::BalanceStatic => None,
            Self::Evaporation => Some(-1.0),
            _ => Some(1.0),
        }
    }

    /// Whether powders, or sessions, may differ in it.
    pub(super) fn differs_between(self) -> Option<Differs> {
        match self {
            Self::BalanceDrift => Some(Differs::Sessions),
            Self::BalanceLag | Self::VibrationNoise | Self::Actuator => None,
            _ => Some(Differs::Powders),
        }
    }

    pub(super) fn numbers(self) -> Names {
        match self {
            Self::BalanceDrift => [("rate", "mg/s"), ("ends", "s")],
            Self::BalanceLag => [("share", "1"), ("time_constant", "s")],
            Self::MassUptake => [("rate_at_60_pct", "1/s"), ("ends", "s")],
            Self::Evaporation => [("rate_at_20_pct", "1/s"), ("ends", "s")],
            Self::BalanceStatic => [("amplitude_at_20_pct", "mg"), ("decay", "s")],
            Self::VibrationNoise => [("log_variance_rise", "1"), ("onset", "m/s^2")],
            Self::SpoonHoldup => [("share_of_first_shake", "1"), ("lasts", "shakes or mg")],
            Self::FillLevel => [("exponent", "1"), ("", "")],
            Self::Densification => [("log_mass_fall_by_shake_10", "1"), ("shakes", "1")],
            Self::Actuator => [("log_mass_bend", "1"), ("backlash", "mm")],
        }
    }

    /// The possible forms in this design, each with the value of its shape parameter.
    ///
    /// # Errors
    /// Why the design cannot tell.
    pub(super) fn effects(self, design: &Design) -> Result<Vec<Shaped>, String> {
        self.recorded(design)?;
        let sensor =
            |effect, shape: f64| (Effect::Sensor(effect), shape.is_finite().then_some(shape));
        let spoon = |effect, shape| (Effect::Spoon(effect), shape);
        let is_humidity_known = varies(design, |plateau| plateau.humidity_pct).is_ok();
        let humid = |known: &[Humidity]| {
            let known = known.iter().copied().filter(|_| is_humidity_known);
            std::iter::once(Humidity::Any).chain(known).collect::<Vec<Humidity>>()
        };
        let both = |humidities: Vec<Humidity>, times: &[f64]| -> Vec<(Humidity, f64)> {
            humidities
                .iter()
                .flat_map(|&humidity| times.iter().map(move |&time| (humidity, time)))
                .collect()
        };
        let uptake = |(humidity, ends_s)| sensor(Sensor::Uptake { humidity, ends_s }, ends_s);
        Ok(match self {
            Self::BalanceDrift => [f64::INFINITY, 300.0, 60.0]
                .iter()
                .map(|&ends_s| sensor(Sensor::Drift { ends_s }, ends_s))
                .collect(),
            Self::BalanceLag => {
                let filters =
                    [0.25, 0.5, 1.0, 2.0, 4.0].map(|tau_s| sensor(Sensor::Lag { tau_s }, tau_s));
                let averages =
                    [1.0, 3.0].map(|window_s| sensor(Sensor::Average { window_s }, window_s / 2.0));
                [&filters[..], &averages[..]].concat()
            }
            Self::MassUptake => {
                let humidities = humid(&[Humidity::Humid(1), Humidity::Humid(3), Humidity::Above]);
                both(humidities, &[f64::INFINITY, 30.0]).into_iter().map(uptake).collect()
            }
            Self::Evaporation => both(humid(&[Humidity::Dry]), &[f64::INFINITY, 30.0])
                .into_iter()
                .map(uptake)
                .collect(),
            Self::BalanceStatic => {
                let humidities =
                    humid(&[Humidity::Dry, Humidity::Charged(1), Humidity::Charged(2)]);
                let decays = both(humidities, &[0.7, 1.5, 3.0, 6.0, 15.0]).into_iter();
                decays
                    .map(|(humidity, decay_s)| {
                        sensor(Sensor::Static { humidity, decay_s }, decay_s)
                    })
                    .collect()
            }
            Self::VibrationNoise => {
                let mut known: Vec<f64> =
                    design.plateaus.iter().filter_map(|plateau| plateau.vibration).collect();
                known.sort_by(f64::total_cmp);
                let at = |share: f64| {
                    known[((known.len() - 1) as f64 * share) as usize]
                        .max(1e-6 * known[known.len() - 1])
                };
                [at(0.1), at(0.5), 2.0 * at(1.0)]
                    .map(|onset| (Effect::Vibration(onset), Some(onset)))
                    .to_vec()
            }
            Self::SpoonHoldup => {
                let shakes = [0.5, 1.0, 2.0, 4.0]
                    .map(|lasts| spoon(Spoon::HoldupShakes { lasts }, Some(lasts)));
                let masses = [0.7, 2.0]
                    .map(|lasts_mg| spoon(Spoon::HoldupMass { lasts_mg }, Some(lasts_mg)));
                [&shakes[..], &masses[..]].concat()
            }
            Self::FillLevel => vec![spoon(Spoon::Fill, None)],
            Self::Densification => {
                let slowing = [2.0, 8.0, 30.0]
                    .map(|shakes| spoon(Spoon::Densification { shakes }, Some(shakes)));
                [&slowing[..], &[spoon(Spoon::DensificationSteady, None)]].concat()
            }
            Self::Actuator => {
                let least = design
                    .plateaus
                    .iter()
                    .filter_map(|plateau| plateau.shake_mm)
                    .filter(|&mm| mm > 0.0);
                let least = least.fold(f64::INFINITY, f64::min);
                let backlash = |share: f64| {
                    spoon(Spoon::Backlash { backlash_mm: share * least }, Some(share * least))
                };
                vec![backlash(0.3), backlash(0.6), backlash(0.9), spoon(Spoon::Saturation, None)]
            }
        })
    }

    /// Checks that everything it needs was recorded.
    fn recorded(self, design: &Design) -> Result<(), String> {
        let has_dose = design.logs.iter().any(|log| log.kind == Kind::Dose);
        let has_step = design.logs.iter().any(|log| log.plateaus.len() > 1);
        let counted = match (design.uncounted, has_dose) {
            (0, false) => Err("no dose was weighed".to_owned()),
            (count, false) => Err(format!("shake_index was not recorded in {count} doses")),
            _ => Ok(()),
        };
        let counted = match self.level() == Level::Shakes && !design.shakes.is_empty() {
            // A controller shakes less and less on the way to the target: unrecorded, that looks
            // like every cause of the spoon.
            true if !design.knows(|plateau| plateau.shake_mm) => {
                Err("shake_mm was not recorded".to_owned())
            }
            // And a spoon empties, in the simulator too.
            true if !is_fill_known(design) => Err("spoon_fill_mg was not recorded".to_owned()),
            _ => counted,
        };
        let most = design.plateaus.iter().map(|plateau| plateau.readings.len()).max().unwrap_or(0);
        let least = match self.level() {
            Level::Readings => 2,
            Level::Scatter => 3,
            Level::Shakes => 1,
        };
        if most < least {
            return Err(format!("fewer than {least} readings follow each shake"));
        }
        let shaken = || match design.shakes.len() {
            0 => Err("no two shakes in turn were counted".to_owned()),
            _ => Ok(()),
        };
        match self {
            Self::BalanceDrift => Ok(()),
            Self::BalanceLag if has_step => Ok(()),
            Self::BalanceLag => counted.and(Err("the load never changed".to_owned())),
            Self::MassUptake | Self::Evaporation | Self::BalanceStatic => counted,
            Self::VibrationNoise => varies(design, |plateau| plateau.vibration)
                .map_err(|how| format!("vibration_rms_m_s2 {how}")),
            Self::FillLevel => counted.and_then(|()| shaken()).and_then(|()| {
                varies(design, |plateau| plateau.fill_mg)
                    .map_err(|how| format!("spoon_fill_mg {how}"))
            }),
            Self::SpoonHoldup | Self::Densification => counted.and_then(|()| shaken()),
            Self::Actuator => counted.and_then(|()| shaken()).and_then(|()| {
                varies(design, |plateau| plateau.shake_mm)
                    .map_err(|how| format!("shake_mm {how}"))?;
                let mut all: Vec<f64> =
                    design.plateaus.iter().filter_map(|plateau| plateau.shake_mm).collect();
                all.sort_by(f64::total_cmp);
                all.dedup_by(|a, b| (*a - *b).abs() < 1e-3);
                match all.len() {
                    ..3 => {
                        Err("shake_mm had but two values, which a powder's own response explains"
                            .to_owned())
                    }
                    _ => Ok(()),
                }
            }),
        }
    }
}

/// The grouping within which a cause may differ.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Differs {
    Powders,
    Sessions,
}

/// Checks that a covariate was recorded in at least half of the plateaus and varies; the error
/// states why not.
fn varies(
    design: &Design,
    of: impl Fn(&super::design::Plateau) -> Option<f64>,
) -> Result<(), String> {
    let known: Vec<f64> = design.plateaus.iter().filter_map(of).collect();
    let (missing, count) = (design.plateaus.len() - known.len(), design.plateaus.len());
    match known.first() {
        None => Err("was not recorded".to_owned()),
        Some(_) if 2 * missing > count => {
            Err(format!("is missing after {missing} of {count} shakes"))
        }
        Some(first) if known.iter().all(|value| value == first) => {
            Err("was the same in all readings".to_owned())
        }
        _ => Ok(()),
    }
}
