//! Whether a reading can show at all that a dose meets its request.

use super::Result;
use super::check::Check;

/// Refuses a request that no reading with this display step, mg, can prove to be met; if the step
/// is not known in advance, nothing is refused.
///
/// # Errors
/// `Invalid`: `tolerance.lower` if an empty vial would be right, `tolerance.upper` if both are 0 or
/// narrower than a step, `target.value` below a step.
pub(super) fn check(
    target_mg: f64,
    (lower_mg, upper_mg): (f64, f64),
    step_mg: Option<f64>,
) -> Result<()> {
    let mut check = Check::default();
    if lower_mg >= target_mg {
        let advice = format!(
            "must be less than the target, {target_mg} mg, or an empty vial would be within tolerance; got {lower_mg} mg"
        );
        check.refuse("tolerance.lower", advice);
    }
    let band_mg = lower_mg + upper_mg;
    match step_mg {
        _ if band_mg <= 0.0 => {
            check.refuse(
                "tolerance.upper",
                "must be above 0 if the lower tolerance is 0: no balance shows a mass exactly",
            );
        }
        Some(step_mg) if band_mg < step_mg * (1.0 - 1e-9) => {
            let advice = format!(
                "must be at least {} mg with the lower one of {lower_mg} mg: the balance's display has steps of {step_mg} mg, and none may lie within; widen the \
                 tolerance or use a finer balance, got {upper_mg} mg",
                step_mg - lower_mg
            );
            check.refuse("tolerance.upper", advice);
        }
        _ => {}
    }
    if let Some(step_mg) = step_mg.filter(|step_mg| target_mg < step_mg * (1.0 - 1e-9)) {
        let advice = format!(
            "must be at least {step_mg} mg, one step of the balance's display: ask for more or use a finer balance, got {target_mg} mg"
        );
        check.refuse("target.value", advice);
    }
    check.done()
}

#[cfg(test)]
mod tests {
    use super::super::Error;
    use super::*;

    fn refused(target_mg: f64, tolerance_mg: (f64, f64), step_mg: Option<f64>) -> Vec<String> {
        match check(target_mg, tolerance_mg, step_mg) {
            Err(Error::Invalid(errors)) => errors.into_iter().map(|error| error.field).collect(),
            _ => Vec::new(),
        }
    }

    #[test]
    fn a_tolerance_that_makes_an_empty_vial_right_is_refused() {
        assert_eq!(refused(10.0, (10.0, 10.0), Some(1.0)), ["tolerance.lower"]);
        assert_eq!(refused(10.0, (10.0, 0.0), None), ["tolerance.lower"]);
        assert!(refused(10.0, (9.9, 10.0), Some(1.0)).is_empty());
    }

    #[test]
    fn what_a_display_of_one_milligram_cannot_show_is_refused_and_on_a_finer_one_it_is_not() {
        assert_eq!(
            refused(0.1, (0.1, 0.1), Some(1.0)),
            ["tolerance.lower", "tolerance.upper", "target.value"]
        );
        assert_eq!(refused(10.0, (0.1, 0.1), Some(1.0)), ["tolerance.upper"]);
        assert_eq!(refused(0.9, (0.5, 0.5), Some(1.0)), ["target.value"]);
        assert!(
            refused(10.0, (0.1, 0.1), Some(0.1)).is_empty()
                && refused(10.0, (0.1, 0.1), None).is_empty()
        );
        assert!(
            refused(10.0, (0.5, 0.5), Some(1.0)).is_empty()
                && refused(10.0, (0.0, 1.0), Some(1.0)).is_empty()
        );
    }

    #[test]
    fn a_tolerance_of_nothing_is_refused() {
        assert_eq!(refused(10.0, (0.0, 0.0), Some(0.01)), ["tolerance.upper"]);
        assert_eq!(refused(10.0, (0.0, 0.0), None), ["tolerance.upper"]);
    }
}
