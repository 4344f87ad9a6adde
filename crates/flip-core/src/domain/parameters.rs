//! The nine parameters of a simulated powder, their published bounds, and [`ParameterSet`].

use super::{FieldError, bounded};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

/// One of the nine parameters: key, unit, published bounds, default and what it does in FLIP's
/// simulator.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Parameter {
    /// Key in JSON, in the database and (with dashes) on the command line.
    pub key: &'static str,
    /// Unit of the value; empty if it has none.
    pub unit: &'static str,
    /// Lower published bound, inclusive.
    pub lower: f64,
    /// Upper published bound, inclusive.
    pub upper: f64,
    /// Default value.
    pub default: f64,
    /// Its effect, in one sentence; `sim/mod.rs` has the equation.
    pub meaning: &'static str,
}

/// Number of parameters.
pub const COUNT: usize = 9;

/// The nine parameters in their canonical order, with the bounds of the published calibration.
pub const PARAMETERS: [Parameter; COUNT] = [
    Parameter {
        key: "particle_diameter_mm",
        unit: "mm",
        lower: 0.22,
        upper: 0.32,
        default: 0.27,
        meaning: "grain diameter; attraction over weight falls with its square",
    },
    Parameter {
        key: "adhesion",
        unit: "",
        lower: 0.0,
        upper: 1.3,
        default: 0.0,
        meaning: "attraction of grains to walls, and with the particle adhesion scale between grains",
    },
    Parameter {
        key: "particle_adhesion_scale",
        unit: "",
        lower: 0.0,
        upper: 1.3,
        default: 1.0,
        meaning: "share of adhesion that also acts between grains",
    },
    Parameter {
        key: "adhesion_offset_scale",
        unit: "",
        lower: 0.0,
        upper: 0.000_05,
        default: 0.0,
        meaning: "widens the gap over which attraction acts",
    },
    Parameter {
        key: "friction",
        unit: "",
        lower: 0.0,
        upper: 1.3,
        default: 0.5,
        meaning: "Coulomb friction between grains",
    },
    Parameter {
        key: "gravity_scale",
        unit: "",
        lower: 0.3,
        upper: 1.1,
        default: 1.0,
        meaning: "multiplies standard gravity",
    },
    Parameter {
        key: "damping",
        unit: "1/s",
        lower: 0.0,
        upper: 1.0,
        default: 0.0,
        meaning: "drag: velocity decays at this rate",
    },
    Parameter {
        key: "cohesion",
        unit: "",
        lower: 0.0,
        upper: 1.2,
        default: 0.0,
        meaning: "attraction between grains",
    },
    Parameter {
        key: "particle_mass_ug",
        unit: "ug",
        lower: 13.0,
        upper: 16.5,
        default: 14.75,
        meaning: "mass of a grain; converts counts to milligrams and does nothing else",
    },
];

/// The simulated twin of a powder: one value for each of the nine parameters, each within its
/// published bounds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Values", into = "Values")]
pub struct ParameterSet {
    /// Grain diameter, mm.
    particle_diameter_mm: f64,
    adhesion: f64,
    particle_adhesion_scale: f64,
    adhesion_offset_scale: f64,
    friction: f64,
    gravity_scale: f64,
    /// 1/s.
    damping: f64,
    cohesion: f64,
    /// Micrograms.
    particle_mass_ug: f64,
}

/// The wire form of [`ParameterSet`], before its bounds are checked.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Values {
    particle_diameter_mm: f64,
    adhesion: f64,
    particle_adhesion_scale: f64,
    adhesion_offset_scale: f64,
    friction: f64,
    gravity_scale: f64,
    damping: f64,
    cohesion: f64,
    particle_mass_ug: f64,
}

impl TryFrom<Values> for ParameterSet {
    type Error = FieldError;
    fn try_from(v: Values) -> Result<Self, FieldError> {
        Self::new([
            v.particle_diameter_mm,
            v.adhesion,
            v.particle_adhesion_scale,
            v.adhesion_offset_scale,
            v.friction,
            v.gravity_scale,
            v.damping,
            v.cohesion,
            v.particle_mass_ug,
        ])
    }
}

impl From<ParameterSet> for Values {
    fn from(p: ParameterSet) -> Self {
        Self {
            particle_diameter_mm: p.particle_diameter_mm,
            adhesion: p.adhesion,
            particle_adhesion_scale: p.particle_adhesion_scale,
            adhesion_offset_scale: p.adhesion_offset_scale,
            friction: p.friction,
            gravity_scale: p.gravity_scale,
            damping: p.damping,
            cohesion: p.cohesion,
            particle_mass_ug: p.particle_mass_ug,
        }
    }
}

impl Default for ParameterSet {
    fn default() -> Self {
        Self::new(PARAMETERS.map(|p| p.default)).expect("the defaults are within the bounds")
    }
}

impl ParameterSet {
    /// Creates a set from values in the order of [`PARAMETERS`].
    ///
    /// # Errors
    /// The first value that is not finite or outside its published bounds, by key.
    pub fn new(values: [f64; COUNT]) -> Result<Self, FieldError> {
        for (parameter, value) in PARAMETERS.iter().zip(values) {
            bounded(parameter.key, value, parameter.lower, parameter.upper, parameter.unit)?;
        }
        let [d, adhesion, scale, offset, friction, gravity, damping, cohesion, mass] = values;
        Ok(Self {
            particle_diameter_mm: d,
            adhesion,
            particle_adhesion_scale: scale,
            adhesion_offset_scale: offset,
            friction,
            gravity_scale: gravity,
            damping,
            cohesion,
            particle_mass_ug: mass,
        })
    }

    /// The values in the order of [`PARAMETERS`].
    pub fn values(&self) -> [f64; COUNT] {
        [
            self.particle_diameter_mm,
            self.adhesion,
            self.particle_adhesion_scale,
            self.adhesion_offset_scale,
            self.friction,
            self.gravity_scale,
            self.damping,
            self.cohesion,
            self.particle_mass_ug,
        ]
    }

    /// Each value as a fraction of its published range, 0 at the lower bound and 1 at the upper.
    pub fn to_unit(&self) -> [f64; COUNT] {
        let values = self.values();
        std::array::from_fn(|k| {
            (values[k] - PARAMETERS[k].lower) / (PARAMETERS[k].upper - PARAMETERS[k].lower)
        })
    }

    /// The inverse of [`ParameterSet::to_unit`]; fractions outside 0..=1 are clamped to the bounds.
    pub fn from_unit(fractions: [f64; COUNT]) -> Self {
        let values = std::array::from_fn(|k| {
            let p = &PARAMETERS[k];
            (p.lower + fractions[k].clamp(0.0, 1.0) * (p.upper - p.lower)).clamp(p.lower, p.upper)
        });
        Self::new(values).expect("clamped into the bounds")
    }

    /// Returns the set with one parameter changed, by key.
    ///
    /// # Errors
    /// An unknown key, or a value outside its bounds.
    pub fn with(&self, key: &str, value: f64) -> Result<Self, FieldError> {
        let index = PARAMETERS
            .iter()
            .position(|p| p.key == key)
            .ok_or_else(|| FieldError::new(key, "is not one of the nine parameters"))?;
        let mut values = self.values();
        values[index] = value;
        Self::new(values)
    }

    /// Content address: `ps-` and the first 16 hexadecimal digits of the SHA-256 of the nine
    /// values.
    pub fn id(&self) -> String {
        let mut hash = Sha256::new();
        for value in self.values() {
            hash.update(value.to_le_bytes());
        }
        format!("ps-{}", &hex::encode(hash.finalize())[..16])
    }

    /// Grain diameter, mm.
    pub fn particle_diameter_mm(&self) -> f64 {
        self.particle_diameter_mm
    }
    /// Wall adhesion, no unit.
    pub fn adhesion(&self) -> f64 {
        self.adhesion
    }
    /// Share of adhesion that acts between grains, no unit.
    pub fn particle_adhesion_scale(&self) -> f64 {
        self.particle_adhesion_scale
    }
    /// Widening of the attraction's reach, no unit.
    pub fn adhesion_offset_scale(&self) -> f64 {
        self.adhesion_offset_scale
    }
    /// Friction, no unit.
    pub fn friction(&self) -> f64 {
        self.friction
    }
    /// Multiple of standard gravity.
    pub fn gravity_scale(&self) -> f64 {
        self.gravity_scale
    }
    /// Drag, 1/s.
    pub fn damping(&self) -> f64 {
        self.damping
    }
    /// Cohesion, no unit.
    pub fn cohesion(&self) -> f64 {
        self.cohesion
    }
    /// Mass of one grain, micrograms.
    pub fn particle_mass_ug(&self) -> f64 {
        self.particle_mass_ug
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_round_trips_exactly_and_refuses_what_is_out_of_bounds() {
        let set = ParameterSet::from_unit([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9]);
        let text = serde_json::to_string(&set).unwrap();
        assert_eq!(serde_json::from_str::<ParameterSet>(&text).unwrap(), set);
        let bad = text.replace(&format!("\"friction\":{}", set.friction()), "\"friction\":1.31");
        assert!(
            serde_json::from_str::<ParameterSet>(&bad)
                .unwrap_err()
                .to_string()
                .contains("friction")
        );
    }

    #[test]
    fn the_unit_cube_maps_onto_the_published_box() {
        assert_eq!(ParameterSet::from_unit([0.0; COUNT]).values(), PARAMETERS.map(|p| p.lower));
        assert_eq!(ParameterSet::from_unit([1.0; COUNT]).values(), PARAMETERS.map(|p| p.upper));
        let unit = [0.11, 0.22, 0.33, 0.44, 0.55, 0.66, 0.77, 0.88, 0.99];
        let back = ParameterSet::from_unit(unit).to_unit();
        assert!(unit.iter().zip(back).all(|(a, b)| (a - b).abs() < 1e-12));
    }

    #[test]
    fn a_value_that_is_not_a_number_is_refused_by_name() {
        let error = ParameterSet::default().with("cohesion", f64::NAN).unwrap_err();
        assert_eq!(error.field, "cohesion");
        assert!(error.message.contains("0 to 1.2"));
    }
}
