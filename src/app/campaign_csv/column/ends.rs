//! Ends of a sensor's range, which loggers write when they have no reading: 0 or 100 % humidity; 0,
//! -40 or 85 deg C.

use crate::app::csv_file::{Refused, at};
use crate::app::humidity;

/// Relative humidity, per cent.
const OF_HUMIDITY: [f64; 2] = [0.0, 100.0];
/// Temperature, deg C: no signal, and the lowest and highest values that common sensors read, or
/// return before their first conversion.
const OF_TEMPERATURE: [f64; 9] = [0.0, -40.0, -45.0, -46.85, -127.0, 85.0, 125.0, 127.0, 130.0];
/// Minimum distance of every other value from an end that was not measured, per cent or degrees.
const FAR: f64 = 10.0;

fn of_column(column: &str) -> (&'static [f64], &'static str) {
    let name = column.to_lowercase();
    let is_temperature = |word: &str| word == "temp" || word.starts_with("temperatur");
    if column == humidity::COLUMN || humidity::is_meant(column) {
        (&OF_HUMIDITY, "%")
    } else if name.split(|c: char| !c.is_alphanumeric()).any(is_temperature) {
        (&OF_TEMPERATURE, "°C")
    } else {
        (&[], "")
    }
}

/// Refuses ends of the sensor's range in fewer than half of the filled cells if no other value is
/// within [`FAR`] of them. A value with its unit is taken at face value.
///
/// # Errors
/// Each of these cells, by row.
pub(super) fn check(
    column: &str,
    values: &[Option<f64>],
    has_unit: impl Fn(usize) -> bool,
    row: impl Fn(usize) -> usize,
) -> Refused<()> {
    let (ends, unit) = of_column(column);
    let filled: Vec<(usize, f64)> =
        values.iter().enumerate().filter_map(|(k, value)| Some((k, (*value)?))).collect();
    let is_end = |it: &(usize, f64)| ends.contains(&it.1) && !has_unit(it.0);
    let (at_end, others): (Vec<_>, Vec<_>) = filled.iter().copied().partition(is_end);
    let is_far = |end: f64| others.iter().all(|(_, other)| (other - end).abs() >= FAR);
    if 2 * at_end.len() >= filled.len() {
        return Ok(());
    }
    let refused = |(k, end): (usize, f64)| {
        let advice = format!(
            "is {end}, an end of the sensor's range, and no other value is within {FAR} of it, as when a logger has no reading: leave the cell empty, or write {end} {unit} if it was measured"
        );
        at(row(k), column, advice)
    };
    let refusals: Vec<_> = at_end.into_iter().filter(|it| is_far(it.1)).map(refused).collect();
    if refusals.is_empty() { Ok(()) } else { Err(refusals) }
}
