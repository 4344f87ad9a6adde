//! Days of one campaign lie within ten years: a day outside the ten years that hold most of them
//! has a wrong digit in its year.

use crate::app::csv_file::date::CAMPAIGN_MAX_D;
use crate::app::csv_file::{Refused, at};
use time::Date;

/// Refuses days that do not belong with the others. If no ten years hold half of the cells, all are
/// accepted.
///
/// # Errors
/// Each of them, by row.
pub(super) fn check(days: &[Date], rows: &[usize], texts: &[&str]) -> Refused<()> {
    let numbers: Vec<i32> = days.iter().map(|day| day.to_julian_day()).collect();
    let mut sorted = numbers.clone();
    sorted.sort_unstable();
    let held = |first: i32| {
        sorted.partition_point(|day| day - first <= CAMPAIGN_MAX_D)
            - sorted.partition_point(|day| *day < first)
    };
    // On a tie, the earliest.
    let Some((most, first)) =
        sorted.iter().rev().map(|&first| (held(first), first)).max_by_key(|it| it.0)
    else {
        return Ok(());
    };
    if 2 * most < days.len() {
        return Ok(());
    }
    let is_outside = |day: i32| day < first || day - first > CAMPAIGN_MAX_D;
    let outside = (0..days.len()).filter(|&k| is_outside(numbers[k]));
    let refused = |k: usize| {
        let advice = "is more than ten years away from most sessions of the file, which belong to one campaign: correct its year, or leave the row out";
        at(rows[k], "session", format!("{advice}, got `{}`", texts[k]))
    };
    let refusals: Vec<_> = outside.map(refused).collect();
    if refusals.is_empty() { Ok(()) } else { Err(refusals) }
}
