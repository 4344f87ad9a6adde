//! Relative humidity as written in files: per cent, or a fraction.

use super::csv_file::{Refused, at};

/// The column.
pub(super) const COLUMN: &str = "relative_humidity_pct";

/// Whether the name of an unknown column means relative humidity.
pub(super) fn is_meant(column: &str) -> bool {
    let column = column.to_lowercase();
    let is_word = |word: &str| word == "rh" || word.contains("humid") || word.contains("feucht");
    column.split(|c: char| !c.is_alphanumeric()).any(is_word)
}

/// Converts values to per cent if all are fractions from 0 to 1; returns the note on the column. A
/// value with its unit is taken at face value.
///
/// # Errors
/// Fractions among percentages, by row: 0.41 next to 41.
pub(super) fn to_percent(
    column: &str,
    values: &mut [Option<f64>],
    has_unit: impl Fn(usize) -> bool,
    row: impl Fn(usize) -> usize,
) -> Refused<Option<&'static str>> {
    let bare: Vec<(usize, f64)> = values
        .iter()
        .enumerate()
        .filter_map(|(k, value)| Some((k, (*value)?)))
        .filter(|(k, _)| !has_unit(*k))
        .collect();
    let low: Vec<usize> =
        bare.iter().filter(|(_, value)| *value > 0.0 && *value < 1.0).map(|(k, _)| *k).collect();
    if low.is_empty() {
        return Ok(None);
    }
    if bare.iter().any(|(_, value)| *value > 1.0) {
        let advice = "is a fraction among percentages: write 41, or 0.41 % if the air is that dry";
        return Err(low.into_iter().map(|k| at(row(k), column, advice)).collect());
    }
    bare.iter().for_each(|(k, value)| values[*k] = Some(100.0 * value));
    Ok(Some("written as fractions, taken as per cent: 0.41 is 41 %"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_humidity_of_fractions_is_taken_as_per_cent_and_a_mixture_is_refused() {
        let of = |values: &[f64], units: &[usize]| {
            let mut values: Vec<Option<f64>> = values.iter().copied().map(Some).collect();
            let said = to_percent(COLUMN, &mut values, |k| units.contains(&k), |k| k + 2)?;
            Ok((values.into_iter().flatten().collect::<Vec<_>>(), said.is_some()))
        };
        assert_eq!(of(&[0.25, 0.5, 1.0, 0.0], &[]), Ok((vec![25.0, 50.0, 100.0, 0.0], true)));
        assert_eq!(of(&[41.0, 0.0, 1.0], &[]), Ok((vec![41.0, 0.0, 1.0], false)));
        assert_eq!(of(&[0.5, 0.8], &[0, 1]), Ok((vec![0.5, 0.8], false)), "0.5 % of a dry box");
        for (column, is_humidity) in [
            ("humidity", true),
            ("RH [%]", true),
            ("rel_humidity", true),
            ("Luftfeuchte", true),
            ("rhodium", false),
            ("rest", false),
        ] {
            assert_eq!(is_meant(column), is_humidity, "{column}");
        }
        let refused: Result<_, Vec<flip_core::domain::FieldError>> = of(&[41.0, 0.41], &[]);
        assert_eq!(refused.unwrap_err()[0].field, "row[3].relative_humidity_pct");
    }
}
