//! Numbers as documents print them: what prints as zero counts as zero.

/// Decimals used when printing values of this unit in sentences.
pub(crate) fn decimals(unit: &str) -> usize {
    match unit {
        "%" => 0,
        "mg" => 2,
        _ => 1,
    }
}

/// Whether an interval, as printed, excludes zero.
pub fn is_told(ci95: [f64; 2], unit: &str) -> bool {
    ci95[0] * ci95[1] > 0.0 && ci95.iter().all(|&end| is_shown(end, decimals(unit)))
}

/// Whether a number prints as something other than zero.
pub(crate) fn is_shown(value: f64, decimals: usize) -> bool {
    format!("{:.decimals$}", value.abs()).contains(|digit| ('1'..='9').contains(&digit))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interval_is_told_from_zero_as_it_is_printed() {
        for (ci95, unit, expected) in [
            ([0.1, 0.4], "deg", true),
            ([-0.4, -0.06], "deg", true),
            ([0.04, 0.4], "deg", false),
            ([-1.4, 0.4], "deg", false),
            ([-0.01, 0.0], "deg", false),
            ([0.4, 9.0], "%", false),
            ([0.6, 9.0], "%", true),
            ([0.006, 0.2], "mg", true),
        ] {
            assert_eq!(is_told(ci95, unit), expected, "{ci95:?} {unit}");
        }
    }
}
