//! The simulated equivalent of a measured spoon.
//!
//! ```text
//! k = length width depth / (those of FLIP's own)      or, without a bowl: k = capacity / (what FLIP's own holds)
//! semi-axes: half the length, half the width, the depth;  without a bowl FLIP's own, each times cbrt(k)
//! grains: as many as FLIP's own has, times k; with a capacity: times capacity / (what FLIP's own holds)
//! ```
//!
//! Grains keep their size: a larger spoon holds more of them and takes as much longer to simulate.

use flip_core::domain::FieldError;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::spoon::Spoon;
use flip_sim::dispense::{self, capacity_mg};

/// Fewest and most grains on a simulated spoon: 7 and 180 mg of a powder like sand. More take a
/// minute for each shake.
const GRAINS: std::ops::RangeInclusive<f64> = 500.0..=12_000.0;
/// A bowl of FLIP's own dimensions is full at this multiple of its usual grains.
const FULL: f64 = 1.6;
/// From the tip of the spoon to the axis of the vial's mouth, mm, as with FLIP's own.
const TIP_MM: f64 = 5.0;

/// These settings with this spoon, as given in a request.
///
/// # Errors
/// `spoon.…`: such a spoon is impossible, or the simulator cannot fill it.
pub fn measured(
    spoon: &Spoon,
    usual: dispense::Settings,
) -> Result<dispense::Settings, FieldError> {
    let within =
        |error: FieldError| FieldError::new(format!("spoon.{}", error.field), error.message);
    simulated(&spoon.checked().map_err(within)?, usual)
}

/// These settings with this spoon.
///
/// # Errors
/// `spoon.…`: the simulator cannot fill such a spoon, or the bowl does not hold the stated
/// capacity.
pub(super) fn simulated(
    spoon: &Spoon,
    usual: dispense::Settings,
) -> Result<dispense::Settings, FieldError> {
    let [a, b, c] = usual.semi_axes_mm;
    let fills = spoon.capacity_mg.map(|mg| mg / capacity_mg(&ParameterSet::default(), &usual));
    let bowl = spoon.bowl_mm().map(|[length, width, depth]| [length / 2.0, width / 2.0, depth]);
    let holds = bowl.map(|[x, y, z]| x * y * z / (a * b * c));
    let semi_axes_mm = bowl.unwrap_or([a, b, c].map(|side| side * fills.unwrap_or(1.0).cbrt()));
    if let (Some(fills), Some(holds)) = (fills, holds)
        && fills > FULL * holds
    {
        let most = FULL * holds * capacity_mg(&ParameterSet::default(), &usual);
        let message =
            format!("must be at most {most:.0} mg for a simulated bowl of these measures");
        return Err(FieldError::new("spoon.capacity_mg", message));
    }
    let grains = f64::from(usual.particles) * fills.or(holds).unwrap_or(1.0);
    if !GRAINS.contains(&grains) {
        let field = if fills.is_some() { "spoon.capacity_mg" } else { "spoon.length_mm" };
        let (least, most) = (GRAINS.start(), GRAINS.end());
        let message = format!(
            "must be a spoon of {least} to {most} grains to be simulated, this one has {grains:.0}"
        );
        return Err(FieldError::new(field, message));
    }
    let vial_offset_mm = usual.vial_offset_mm.max(semi_axes_mm[0] + TIP_MM);
    Ok(dispense::Settings {
        particles: grains.round() as u32,
        semi_axes_mm,
        vial_offset_mm,
        ..usual
    })
}

/// Capacity of a user's own spoon, whichever of these sets is the powder, mg: as measured, or as
/// simulated. `None` without sets.
pub fn holds_mg<'a>(spoon: &Spoon, sets: impl Iterator<Item = &'a ParameterSet>) -> Option<f64> {
    let usual = dispense::Settings::default();
    let bowl = Spoon { capacity_mg: None, ..*spoon };
    // A bowl that cannot be simulated can still be used for weighing: its volume counts.
    let scale = bowl.bowl_mm().map_or(1.0, |[length, width, depth]| {
        let [a, b, c] = usual.semi_axes_mm;
        length * width * depth / (4.0 * a * b * c)
    });
    let simulated_mg = sets.map(|set| scale * capacity_mg(set, &usual)).reduce(f64::min)?;
    Some(spoon.capacity_mg.unwrap_or(simulated_mg))
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOWL: Spoon = Spoon {
        capacity_mg: None,
        length_mm: Some(13.0),
        width_mm: Some(9.0),
        depth_mm: Some(2.5),
        filled_by: flip_core::domain::spoon::FilledBy::Arm,
    };

    #[test]
    fn flips_own_measures_are_flips_own_spoon() {
        let usual = dispense::Settings::default();
        let own = Spoon { length_mm: Some(10.0), width_mm: Some(7.0), depth_mm: Some(2.0), ..BOWL };
        assert_eq!(simulated(&own, usual), Ok(usual));
        assert_eq!(simulated(&Spoon::default(), usual), Ok(usual));
    }

    #[test]
    fn a_larger_bowl_has_more_grains_and_its_tip_stays_as_far_from_the_mouths_axis() {
        let usual = dispense::Settings::default();
        let found = simulated(&BOWL, usual).unwrap();
        assert_eq!((found.semi_axes_mm, found.vial_offset_mm), ([6.5, 4.5, 2.5], 11.5));
        assert_eq!(found.particles, (2500.0_f64 * (6.5 * 4.5 * 2.5) / 35.0).round() as u32);
        let filled = simulated(&Spoon { capacity_mg: Some(60.0), ..BOWL }, usual).unwrap();
        assert!((capacity_mg(&ParameterSet::default(), &filled) - 60.0).abs() < 0.01);
    }

    #[test]
    fn what_cannot_be_simulated_is_refused_by_field_and_weighed_with_all_the_same() {
        let usual = dispense::Settings::default();
        let field = |spoon: Spoon| simulated(&spoon, usual).unwrap_err().field;
        assert_eq!(
            field(Spoon { capacity_mg: Some(2000.0), ..Spoon::default() }),
            "spoon.capacity_mg"
        );
        assert_eq!(field(Spoon { capacity_mg: Some(150.0), ..BOWL }), "spoon.capacity_mg");
        assert_eq!(field(Spoon { length_mm: Some(60.0), ..BOWL }), "spoon.length_mm");
        let sets = [ParameterSet::default()];
        let usual_mg = holds_mg(&Spoon::default(), sets.iter()).unwrap();
        assert!(
            (holds_mg(&BOWL, sets.iter()).unwrap() / usual_mg - (6.5 * 4.5 * 2.5) / 35.0).abs()
                < 1e-9
        );
        assert_eq!(
            holds_mg(&Spoon { capacity_mg: Some(2000.0), ..BOWL }, sets.iter()),
            Some(2000.0)
        );
        assert_eq!(
            holds_mg(&Spoon { capacity_mg: Some(2000.0), ..BOWL }, std::iter::empty()),
            None
        );
    }
}
