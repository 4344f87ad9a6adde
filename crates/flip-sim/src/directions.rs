//! The combinations of the nine parameters that a heap depends on.
//!
//! With lengths in diameters d and times in sqrt(d / g), g = gravity_scale * 9.81 m/s^2, a heap
//! depends on five numbers,
//!
//! ```text
//! mu                                    friction between grains
//! Bo   / gravity_scale                  attraction between grains over their weight
//! Bo_w / gravity_scale                  attraction to walls over the weight of a grain
//! reach                                 gap at which attraction ends, diameters
//! damping * sqrt(d / gravity_scale)     loss of speed in the time of a fall of one diameter
//! ```
//!
//! (mu, Bo, Bo_w and reach as in [`super::law`]) and, weakly, on the substep. Hence particle_mass
//! has no effect, adhesion and its scale act between grains as a product, and cohesion, that
//! product, diameter and gravity trade off against each other.

use super::law::{BOND_PER_COHESION, BOND_PER_PARTICLE_ADHESION, DIAMETER_REFERENCE_MM};
use flip_core::domain::parameters::{PARAMETERS, ParameterSet};

/// Number of directions a heap depends on.
pub const DIRECTIONS: usize = 5;

/// The five numbers of a set, each increasing from 0 to 1 over the published box. The attractions
/// enter by their square root: small grains under low gravity stretch their range far beyond where
/// most sets, and most of their effect, lie.
pub fn directions(set: &ParameterSet) -> [f64; DIRECTIONS] {
    let of = numbers(set);
    let strongest = ParameterSet::new(PARAMETERS.map(|p| match p.key {
        "particle_diameter_mm" | "gravity_scale" => p.lower,
        _ => p.upper,
    }));
    let slowest = ParameterSet::new(
        PARAMETERS.map(|p| if p.key == "gravity_scale" { p.lower } else { p.upper }),
    );
    let [mu, bond, wall_bond, reach, _] = numbers(&strongest.expect("bounds are within bounds"));
    let [.., loss] = numbers(&slowest.expect("bounds are within bounds"));
    [of[0] / mu, (of[1] / bond).sqrt(), (of[2] / wall_bond).sqrt(), of[3] / reach, of[4] / loss]
}

/// The five numbers, up to constant factors and shifts.
fn numbers(set: &ParameterSet) -> [f64; DIRECTIONS] {
    let small = (DIAMETER_REFERENCE_MM / set.particle_diameter_mm()).powi(2) / set.gravity_scale();
    let product = set.adhesion() * set.particle_adhesion_scale();
    [
        set.friction(),
        (BOND_PER_COHESION * set.cohesion() + BOND_PER_PARTICLE_ADHESION * product) * small,
        set.adhesion() * small,
        set.adhesion_offset_scale(),
        set.damping() * (set.particle_diameter_mm() / set.gravity_scale()).sqrt(),
    ]
}

#[cfg(test)]
mod tests {
    use super::super::law::{Law, SUBSTEP_S};
    use super::*;
    use flip_core::domain::parameters::COUNT;

    fn set(changes: &[(&str, f64)]) -> ParameterSet {
        changes
            .iter()
            .fold(ParameterSet::default(), |set, (key, value)| set.with(key, *value).unwrap())
    }

    #[test]
    fn every_number_runs_from_nothing_to_one_over_the_box() {
        for corner in 0..1u32 << COUNT {
            let at = ParameterSet::from_unit(std::array::from_fn(|k| f64::from(corner >> k & 1)));
            assert!(directions(&at).iter().all(|x| (0.0..=1.0 + 1e-12).contains(x)), "{at:?}");
        }
        let largest = (0..1u32 << COUNT).map(|corner| {
            directions(&ParameterSet::from_unit(std::array::from_fn(|k| {
                f64::from(corner >> k & 1)
            })))
        });
        let largest =
            largest.fold([0.0f64; DIRECTIONS], |a, b| std::array::from_fn(|k| a[k].max(b[k])));
        assert!(largest.iter().all(|x| (x - 1.0).abs() < 1e-12), "{largest:?}");
        assert_eq!(directions(&ParameterSet::from_unit([0.0; COUNT])), [0.0; DIRECTIONS]);
    }

    #[test]
    fn sets_with_the_same_numbers_have_the_same_dimensionless_law() {
        let ours = set(&[
            ("cohesion", 0.4),
            ("adhesion", 0.5),
            ("particle_adhesion_scale", 0.8),
            ("damping", 0.6),
        ]);
        // 0.4 * 0.4 + 0.1 * 0.5 * 0.8 = 0.4 * 0.35 + 0.1 * 0.5 * 1.2, at another gravity, diameter
        // and mass.
        let small = |d: f64, g: f64| (0.27f64 / d).powi(2) / g;
        let scale = small(0.27, 1.0) / small(0.24, 1.1);
        let others = set(&[
            ("particle_diameter_mm", 0.24),
            ("gravity_scale", 1.1),
            ("adhesion", 0.5 * scale),
            ("particle_adhesion_scale", 1.2),
            ("cohesion", 0.35 * scale),
            ("damping", 0.6 / (0.24f64 / 0.27 / 1.1).sqrt()),
            ("particle_mass_ug", 16.0),
        ]);
        for (a, b) in directions(&ours).iter().zip(directions(&others)) {
            assert!((a - b).abs() < 1e-12, "{ours:?} {others:?}");
        }
        // The same substep in units of sqrt(d / g).
        let substep = SUBSTEP_S * (0.24f64 / 0.27 / 1.1).sqrt();
        let [a, b] = [Law::new(&ours, 0.8, SUBSTEP_S), Law::new(&others, 0.8, substep)];
        let close = |a: f32, b: f32| (a / b - 1.0).abs() < 2e-5;
        assert!(close(a.gravity, b.gravity) && close(a.grain.attraction, b.grain.attraction));
        assert!(close(a.wall.attraction, b.wall.attraction) && close(a.grain.reach, b.grain.reach));
        assert!(close(1.0 - a.drag, 1.0 - b.drag) && a.grain.friction == b.grain.friction);
    }
}
