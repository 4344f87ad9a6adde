//! The session of each row, numbered in chronological order.
//!
//! | cells | order |
//! |-------|-------|
//! | days, half of them at least ([`date`](crate::app::csv_file::date)) | of time; the others are refused, and days outside the ten years that hold most of them (`years`) |
//! | numbers, more than half | of size, but for those that only a name can be, as 1.1 beside 1.10 (`labels`); where half count days (46056), seconds or milliseconds since 1970, or are digits of a date, the day; the others are refused |
//! | names | in which they first stand in the file |

mod dates;
mod labels;
mod years;

use super::Cell;
use crate::app::csv_file::date::{Count, DateOrder, Written, day, six_digits, time_of};
use crate::app::csv_file::{Refused, Told, at};
use dates::Dates;
use flip_core::domain::powder_name::same_name;
use flip_discover::reading::{ColumnRead, TakenAs};
use std::collections::HashMap;
use time::Date;

/// Note on names.
const NAMES: &str = "names, in the order in which they first stand in the file: only days or numbers tell the order of time";
/// Note on names that look like numbers.
const LABELS: &str = "names such as 1.10, which is another session than 1.1 and comes after 1.9, in the order in which they first stand in the file";

/// Sessions of the rows.
#[derive(Debug)]
pub(super) struct Sessions {
    /// Session of each row.
    pub places: Vec<usize>,
    /// How the column was interpreted; none if there is no such column.
    pub column: Option<ColumnRead>,
}

/// Possible readings of a cell as a session.
enum Read {
    Day(Written),
    Number(f64),
    Name,
}

fn read(cell: &Cell<'_>) -> Read {
    match cell.told {
        Told::Number(number, None) => Read::Number(number),
        _ => day(cell.text).map_or(Read::Name, Read::Day),
    }
}

/// The sessions of rows with these cells and numbers.
///
/// # Errors
/// Cells that are not days in a column of days, or not numbers in a column of numbers; an ambiguous
/// day if `order` is not known.
pub(super) fn sessions(
    cells: &[Cell<'_>],
    rows: &[usize],
    order: Option<DateOrder>,
) -> Refused<Sessions> {
    let filled: Vec<usize> = (0..cells.len()).filter(|&k| cells[k].is_filled()).collect();
    let column = Column {
        rows: filled.iter().map(|&k| rows[k]).collect(),
        texts: filled.iter().map(|&k| cells[k].text).collect(),
        cells: filled.iter().map(|&k| read(&cells[k])).collect(),
    };
    let (known, note) = column.places(order)?;
    // Rows without a session come last, each on its own.
    let mut unnamed = known.iter().max().map_or(0, |last| last + 1)..;
    let mut known = known.into_iter();
    let place = |cell: &Cell<'_>| if cell.is_filled() { known.next() } else { unnamed.next() };
    let missing = cells.len() - filled.len();
    let alone = if missing > 0 && !filled.is_empty() {
        "; a row without is a session of its own: fill merged cells down"
    } else {
        ""
    };
    Ok(Sessions {
        column: (!filled.is_empty()).then(|| ColumnRead {
            column: "session".to_owned(),
            taken_as: TakenAs::Session,
            filled: filled.len() as u32,
            missing: missing as u32,
            note: format!("{note}{alone}"),
        }),
        places: cells.iter().filter_map(place).collect(),
    })
}

/// The filled cells.
struct Column<'a> {
    rows: Vec<usize>,
    texts: Vec<&'a str>,
    cells: Vec<Read>,
}

impl Column<'_> {
    /// The session of each cell, and the note on them.
    fn places(&self, order: Option<DateOrder>) -> Refused<(Vec<usize>, String)> {
        let days = self.cells.iter().filter(|cell| matches!(cell, Read::Day(_))).count();
        let numbers = self.cells.iter().filter(|cell| matches!(cell, Read::Number(_))).count();
        if days > 0 && 2 * days >= self.cells.len() {
            let days = self.days(order)?;
            return self.of_days(&days);
        }
        if 2 * numbers > self.cells.len() {
            return self.counted(order);
        }
        Ok(of_names(&self.texts, NAMES))
    }

    /// For mostly numeric cells: days if the numbers count days, else plain numbers.
    fn counted(&self, order: Option<DateOrder>) -> Refused<(Vec<usize>, String)> {
        let numbers = self.numbers()?;
        if let Some(count) = Count::of(&numbers) {
            let days = self.each(|cell| {
                match cell {
                    Read::Number(number) => count.day(*number),
                    _ => None,
                }
                .ok_or_else(|| {
                    "must count days, as most sessions of the file do: correct it, or leave it empty"
                        .to_owned()
                })
            });
            return self.of_days(&days?);
        }
        let six: Option<Vec<Read>> =
            self.texts.iter().map(|text| six_digits(text).map(Read::Day)).collect();
        if let Some(cells) = six {
            let written = Self { rows: self.rows.clone(), texts: self.texts.clone(), cells };
            return written.of_days(&written.days(order)?);
        }
        Ok(match labels::are_labels(&self.texts) {
            true => of_names(&self.texts, LABELS),
            false => of_numbers(&numbers),
        })
    }

    fn of_days(&self, days: &[Date]) -> Refused<(Vec<usize>, String)> {
        years::check(days, &self.rows, &self.texts)?;
        let (places, order) = ranked(days, Date::cmp);
        let several = match self.days_of_several_times(days) {
            0 => String::new(),
            days => format!(
                "; {days} of them have runs at several times of day, which are one session: name sessions to keep them apart, 2026-02-03 a"
            ),
        };
        Ok((places, span("days", &order) + &several))
    }

    fn numbers(&self) -> Refused<Vec<f64>> {
        self.each(|cell| match cell {
            Read::Number(number) => Ok(*number),
            _ => Err(
                "must be a number, as most sessions of the file are: correct it, or leave it empty"
                    .to_owned(),
            ),
        })
    }

    /// Applies `of` to every cell; returns the results, or all its refusals.
    fn each<T>(
        &self,
        mut of: impl FnMut(&Read) -> std::result::Result<T, String>,
    ) -> Refused<Vec<T>> {
        let (mut all, mut refusals) = (Vec::new(), Vec::new());
        for ((cell, row), text) in self.cells.iter().zip(&self.rows).zip(&self.texts) {
            match of(cell) {
                Ok(value) => all.push(value),
                Err(message) => {
                    refusals.push(at(*row, "session", format!("{message}, got `{text}`")))
                }
            }
        }
        if refusals.is_empty() { Ok(all) } else { Err(refusals) }
    }

    fn days(&self, order: Option<DateOrder>) -> Refused<Vec<Date>> {
        let order = match order {
            Some(order) => Some(order),
            None => self.order()?,
        };
        self.each(|cell| match cell {
            Read::Day(Written::Unclear(why)) => Err(format!("{why}: write dates as 2026-02-03")),
            Read::Day(written) => written.day(order).ok_or_else(|| {
                let first = order.map_or("nothing", DateOrder::first);
                format!("is not a date with {first} first, as the others are read")
            }),
            _ => Err(
                "must be a date, as most sessions of the file are: correct it, or leave it empty"
                    .to_owned(),
            ),
        })
    }

    /// The only possible order of the column's dates. None if no cell needs one.
    fn order(&self) -> Refused<Option<DateOrder>> {
        let cells = self.cells.iter().zip(&self.rows).zip(&self.texts);
        let written = cells.filter_map(|((cell, row), text)| match cell {
            Read::Day(written @ Written::By(_)) if written.day(None).is_none() => {
                Some((written, *row, *text))
            }
            _ => None,
        });
        Dates(written.collect()).order()
    }

    /// Number of days with runs at several times of day, `days` being those of the cells.
    fn days_of_several_times(&self, days: &[Date]) -> usize {
        let mut times: Vec<(Date, String)> = days
            .iter()
            .zip(&self.cells)
            .zip(&self.texts)
            .map(|((day, cell), text)| match cell {
                Read::Number(number) => (*day, number.to_string()),
                _ => (*day, time_of(text).to_owned()),
            })
            .collect();
        times.sort_unstable();
        times.dedup();
        let several = times.chunk_by(|a, b| a.0 == b.0).filter(|times| times.len() > 1);
        several.count()
    }
}

fn of_numbers(numbers: &[f64]) -> (Vec<usize>, String) {
    let (places, order) = ranked(numbers, f64::total_cmp);
    (places, span("sessions", &order))
}

fn span(what: &str, order: &[impl std::fmt::Display]) -> String {
    match order {
        [] => String::new(),
        [first, ..] => format!("{} {what}, {first} to {}", order.len(), order[order.len() - 1]),
    }
}

fn of_names(names: &[&str], note: &str) -> (Vec<usize>, String) {
    let mut known: HashMap<String, usize> = HashMap::new();
    let places: Vec<usize> = names
        .iter()
        .map(|name| {
            let next = known.len();
            *known.entry(same_name(name)).or_insert(next)
        })
        .collect();
    (places, format!("{} {note}", known.len()))
}

/// The rank of each value among the distinct values, and these in order.
fn ranked<T: Copy>(
    values: &[T],
    compare: impl Fn(&T, &T) -> std::cmp::Ordering,
) -> (Vec<usize>, Vec<T>) {
    let mut order = values.to_vec();
    order.sort_unstable_by(|a, b| compare(a, b));
    order.dedup_by(|a, b| compare(a, b).is_eq());
    let places = values
        .iter()
        .map(|value| order.partition_point(|other| compare(other, value).is_lt()))
        .collect();
    (places, order)
}
