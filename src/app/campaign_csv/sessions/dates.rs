//! Which component comes first in the dates of a column: among the orders in which every date is
//! valid, those under which the campaign lasts at most ten years, if these agree; otherwise the
//! user is asked.

use crate::app::csv_file::date::{CAMPAIGN_MAX_D, DateOrder, Written};
use crate::app::csv_file::{Refused, at};
use flip_core::domain::FieldError;
use time::Date;

/// Dates that need an order, each with its row and its text.
pub(super) struct Dates<'a>(pub Vec<(&'a Written, usize, &'a str)>);

impl Dates<'_> {
    /// The order; none if no date needs one.
    ///
    /// # Errors
    /// Dates that contradict each other; a date that may be two different days.
    pub fn order(&self) -> Refused<Option<DateOrder>> {
        if self.0.is_empty() {
            return Ok(None);
        }
        let possible: Vec<(DateOrder, Vec<Date>)> = DateOrder::ALL
            .into_iter()
            .filter_map(|order| Some((order, self.read(order)?)))
            .collect();
        if possible.is_empty() {
            return Err(self.contradictions());
        }
        let mut left: Vec<&(DateOrder, Vec<Date>)> =
            possible.iter().filter(|(_, days)| lasts(days) <= CAMPAIGN_MAX_D).collect();
        if left.is_empty() {
            left = possible.iter().collect();
        }
        match left.iter().all(|(_, days)| *days == left[0].1) {
            true => Ok(Some(left[0].0)),
            false => Err(vec![self.asked(&left)]),
        }
    }

    /// All of them in one order; `None` if one of them is not a valid day then.
    fn read(&self, order: DateOrder) -> Option<Vec<Date>> {
        self.0.iter().map(|(written, ..)| written.day(Some(order))).collect()
    }

    /// Dates whose first component is not that of the first unambiguous date.
    fn contradictions(&self) -> Vec<FieldError> {
        let shown = || {
            self.0.iter().filter_map(|(written, row, text)| Some((written.order()?, *row, *text)))
        };
        let Some((first, from, _)) = shown().next() else {
            let (_, row, text) = self.0[0];
            let advice = format!(
                "`{text}` and the other dates have no one order of day and month: write dates as 2026-02-03"
            );
            return vec![at(row, "session", advice)];
        };
        let other = |(order, row, text): (DateOrder, usize, &str)| {
            let advice = format!(
                "`{text}` has {} first where row {from} has {}: write dates as 2026-02-03",
                order.first(),
                first.first()
            );
            (order != first).then(|| at(row, "session", advice))
        };
        let others: Vec<FieldError> = shown().filter_map(other).collect();
        // No two of them need be at odds: each of the others may rule out another order.
        let is_no_day =
            |(written, ..): &&(&Written, usize, &str)| written.day(Some(first)).is_none();
        let all = || {
            self.0.iter().filter(is_no_day).map(|(_, row, text)| {
                at(
                    *row,
                    "session",
                    format!(
                        "`{text}` is not a date with {} first, as row {from} is: write dates as 2026-02-03",
                        first.first()
                    ),
                )
            })
        };
        if others.is_empty() { all().collect() } else { others }
    }

    /// The first date that the orders read as different days.
    fn asked(&self, orders: &[&(DateOrder, Vec<Date>)]) -> FieldError {
        let days = |k: usize| {
            let mut days: Vec<Date> = orders.iter().map(|(_, days)| days[k]).collect();
            days.dedup();
            days
        };
        let k = (0..self.0.len()).find(|&k| days(k).len() > 1).unwrap_or(0);
        let (_, row, text) = self.0[k];
        let days: Vec<String> = days(k).iter().map(Date::to_string).collect();
        let advice = format!(
            "`{text}` may be {}, and no other cell of the column tells: say what stands first with `dates`, day_first, month_first or year_first \
             (`flip discover --dates day-first`), or write days as 2026-02-03",
            days.join(" or ")
        );
        at(row, "session", advice)
    }
}

/// Days from the first to the last.
fn lasts(days: &[Date]) -> i32 {
    let of = |pick: fn(i32, i32) -> i32| {
        days.iter().map(|day| day.to_julian_day()).reduce(pick).unwrap_or(0)
    };
    of(i32::max) - of(i32::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::csv_file::date::day;

    fn order(texts: &[&str]) -> Result<Option<DateOrder>, Vec<String>> {
        let written: Vec<Written> = texts.iter().map(|text| day(text).unwrap()).collect();
        let cells =
            written.iter().zip(2..).zip(texts).map(|((written, row), text)| (written, row, *text));
        Dates(cells.collect()).order().map_err(|all| all.into_iter().map(|it| it.field).collect())
    }

    #[test]
    fn a_year_of_two_digits_that_stands_first_is_not_the_day() {
        use DateOrder::{DayFirst, MonthFirst, YearFirst};
        // Read day first, these would span 2003 to 2028.
        assert_eq!(order(&["26/02/03", "26/02/28", "26/03/15"]), Ok(Some(YearFirst)));
        assert_eq!(order(&["26.02.03", "26.02.28"]), Ok(Some(YearFirst)));
        // And these, read year first, 2003 to 2028.
        assert_eq!(order(&["03/02/26", "28/02/26"]), Ok(Some(DayFirst)));
        assert_eq!(order(&["02-03-26", "02-28-26"]), Ok(Some(MonthFirst)));
        // A few consecutive days are ambiguous.
        assert_eq!(
            order(&["26/02/19", "26/02/20", "26/02/21"]),
            Err(vec!["row[2].session".to_owned()])
        );
        assert_eq!(order(&["26.02.21"]), Err(vec!["row[2].session".to_owned()]));
        // A single unambiguous date decides.
        assert_eq!(order(&["26/02/21", "32/02/21"]), Ok(Some(YearFirst)));
        assert_eq!(order(&["26/02/21", "3/2/21"]), Ok(Some(DayFirst)));
    }

    #[test]
    fn dates_that_contradict_each_other_are_named() {
        assert_eq!(order(&["15/2/2026", "2/15/2026"]), Err(vec!["row[3].session".to_owned()]));
        assert_eq!(order(&["15/2/2026", "45/12/30"]), Err(vec!["row[3].session".to_owned()]));
        assert_eq!(order(&[]), Ok(None));
    }
}
