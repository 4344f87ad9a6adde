//! The searched box: the unit cube of nine coordinates and the corresponding parameter sets; and the
//! part of it that is searched when some parameters are held fixed.

use flip_core::domain::FieldError;
use flip_core::domain::parameters::{COUNT, PARAMETERS, ParameterSet};
use std::collections::BTreeMap;

/// A point of the unit cube, in the order of [`PARAMETERS`].
pub type Point = [f64; COUNT];

/// The parameter set at `point`, each value rounded to at least five significant digits of its
/// range.
///
/// Short decimals are readable and round-trip through JSON unchanged, which a resumed calibration
/// depends on.
pub fn parameters_at(point: &Point) -> ParameterSet {
    let values = ParameterSet::from_unit(*point).values();
    let rounded = std::array::from_fn(|k| {
        let p = &PARAMETERS[k];
        let decimals = (5.0 - (p.upper - p.lower).log10()).ceil() as i32;
        let scale = 10f64.powi(decimals);
        ((values[k] * scale).round() / scale).clamp(p.lower, p.upper)
    });
    ParameterSet::new(rounded).expect("clamped into the bounds")
}

/// The searched part of the box: all of it, or a slice through the values of fixed parameters.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Space {
    /// The value at which each parameter is held, in the order of [`PARAMETERS`].
    fixed: [Option<f64>; COUNT],
}

impl Space {
    /// The slice in which parameters are held at these values, by key.
    ///
    /// # Errors
    /// `fixed.<key>`: not one of the nine parameters, or a value outside its bounds; `fixed`: none
    /// is left to search.
    pub fn of(fixed: &BTreeMap<String, f64>) -> Result<Self, FieldError> {
        let mut space = Self::default();
        for (key, value) in fixed {
            let named = |error: FieldError| FieldError::new(format!("fixed.{key}"), error.message);
            ParameterSet::default().with(key, *value).map_err(named)?;
            if let Some(k) = PARAMETERS.iter().position(|p| p.key == key) {
                space.fixed[k] = Some(*value);
            }
        }
        match space.fixed.iter().all(Option::is_some) {
            true => Err(FieldError::new("fixed", "must leave at least one parameter free")),
            false => Ok(space),
        }
    }

    /// Whether a parameter is held, by its place in [`PARAMETERS`].
    pub(super) fn holds(&self, k: usize) -> bool {
        self.fixed[k].is_some()
    }

    /// The parameter set of the slice at `point`, whose other coordinates are ignored.
    pub(super) fn parameters_at(&self, point: &Point) -> ParameterSet {
        let free = parameters_at(point).values();
        let values = std::array::from_fn(|k| self.fixed[k].unwrap_or(free[k]));
        ParameterSet::new(values).expect("fixed values were checked")
    }

    /// The point of the slice with the free coordinates of `point`.
    pub(super) fn project(&self, point: Point) -> Point {
        std::array::from_fn(|k| match self.fixed[k] {
            Some(value) => {
                let p = &PARAMETERS[k];
                (value - p.lower) / (p.upper - p.lower)
            }
            None => point[k],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flip_core::stats::latin_hypercube::latin_hypercube;
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    #[test]
    fn sets_are_near_their_point_and_survive_json_exactly() {
        for point in latin_hypercube(500, &mut Pcg64::seed_from_u64(1)) {
            let set = parameters_at(&point);
            assert!(set.to_unit().iter().zip(point).all(|(a, b)| (a - b).abs() < 1e-5));
            let back: ParameterSet =
                serde_json::from_str(&serde_json::to_string(&set).unwrap()).unwrap();
            assert_eq!(back, set);
        }
    }

    fn fixed(values: &[(&str, f64)]) -> BTreeMap<String, f64> {
        values.iter().map(|(key, value)| ((*key).to_owned(), *value)).collect()
    }

    #[test]
    fn a_slice_holds_its_values_exactly_and_leaves_the_others_as_they_were() {
        let space = Space::of(&fixed(&[("gravity_scale", 1.0), ("damping", 0.123456789)])).unwrap();
        for point in latin_hypercube(50, &mut Pcg64::seed_from_u64(2)) {
            let (held, free) = (space.parameters_at(&point), parameters_at(&point));
            assert_eq!((held.gravity_scale(), held.damping()), (1.0, 0.123456789));
            assert_eq!(held.friction(), free.friction());
            let there = space.project(point);
            assert!(there.iter().zip(held.to_unit()).all(|(a, b)| (a - b).abs() < 1e-5));
            assert_eq!(Space::default().parameters_at(&point), free);
            assert_eq!(Space::default().project(point), point);
        }
    }

    #[test]
    fn what_cannot_be_fixed_is_refused_by_its_key() {
        let field = |values: &[(&str, f64)]| Space::of(&fixed(values)).unwrap_err();
        assert_eq!(field(&[("gravity", 1.0)]).field, "fixed.gravity");
        let heavy = field(&[("gravity_scale", 2.0)]);
        assert_eq!(heavy.field, "fixed.gravity_scale");
        assert!(heavy.message.contains("0.3 to 1.1"), "{heavy:?}");
        let all: BTreeMap<String, f64> =
            PARAMETERS.iter().map(|p| (p.key.to_owned(), p.default)).collect();
        assert_eq!(Space::of(&all).unwrap_err().field, "fixed");
    }
}
