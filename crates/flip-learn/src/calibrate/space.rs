//! The searched box: the unit cube of nine coordinates and the corresponding parameter sets.

use flip_core::domain::parameters::{COUNT, PARAMETERS, ParameterSet};

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
}
