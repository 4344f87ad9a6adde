//! Days as laboratories write them; a time of day and a zone may follow, and the day is taken as
//! written.
//!
//! | written | read |
//! |---------|------|
//! | `2026-02-03`, `2026/2/3`, `2026.02.03`, `2026-02-03T09:30:00+01:00` | year, month, day |
//! | `3.2.2026`, `3.2.26` | dots: day, month, year |
//! | `2/3/2026`, `2-3-2026`, `2/3/26` | day or month first: a day above 12 in the column decides, else whoever sends the file ([`DateOrder`]) |
//! | `26/02/21`, `26.02.21`, `26-02-21` | the year may also stand first: the column decides, else whoever sends the file |
//! | `03-Feb-26`, `3 Feb 2026`, `Feb 3, 2026`, `Tuesday, 3 February 2026 2:30 PM` | month by name, also in German and French |

use serde::{Deserialize, Serialize};
use time::{Date, Month};

/// Order of day, month and year in a date such as 2/3/2026.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DateOrder {
    /// 2 March.
    DayFirst,
    /// 3 February.
    MonthFirst,
    /// With two-digit years: 26/02/21 is 21 February 2026.
    YearFirst,
}

impl DateOrder {
    /// All of them, in the order of [`Written::By`].
    pub const ALL: [Self; 3] = [Self::DayFirst, Self::MonthFirst, Self::YearFirst];

    /// Name of the first component.
    pub fn first(self) -> &'static str {
        match self {
            Self::DayFirst => "the day",
            Self::MonthFirst => "the month",
            Self::YearFirst => "the year",
        }
    }
}

/// A cell that contains a day.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Written {
    Day(Date),
    /// Read day first, month first and year first; some of them may not be valid.
    By([Option<Date>; 3]),
    /// A day that cannot be determined, and why.
    Unclear(&'static str),
}

impl Written {
    /// The only possible order, if any.
    pub fn order(&self) -> Option<DateOrder> {
        let Self::By(days) = self else { return None };
        let mut possible =
            DateOrder::ALL.into_iter().filter(|order| days[*order as usize].is_some());
        possible.next().filter(|_| possible.next().is_none())
    }

    /// The day, in a column whose dates have this order; `None` if the order is needed but not
    /// known, or gives no valid day.
    pub fn day(&self, order: Option<DateOrder>) -> Option<Date> {
        match self {
            Self::Day(day) => Some(*day),
            Self::By([day, month, None]) if day == month => *day,
            Self::By(days) => order.and_then(|order| days[order as usize]),
            Self::Unclear(_) => None,
        }
    }
}

/// The day of a single date, as `2026-02-03`.
///
/// # Errors
/// Why it is none, or which of several it might be.
pub fn day_of(text: &str) -> std::result::Result<String, String> {
    let day = day(text).and_then(|written| written.day(None));
    day.map(|day| day.to_string())
        .ok_or_else(|| format!("must be one day, as 2026-02-03, got `{text}`"))
}

/// The day in a cell, if it contains one.
pub fn day(text: &str) -> Option<Written> {
    let date = without_weekday(without_time(text.trim())?);
    let is_mark = |c: char| c.is_whitespace() || "-./,".contains(c);
    let parts: Vec<&str> = date.split(is_mark).filter(|part| !part.is_empty()).collect();
    let mark = date.chars().find(|c| is_mark(*c))?;
    match parts.as_slice() {
        [a, b, c] => three(a, b, c, mark),
        // A named month, or the dots of 3.2., show that a date is meant.
        [a, b]
            if month(a).is_some() && number(b, 2).is_some()
                || month(b).is_some() && number(a, 2).is_some() =>
        {
            Some(Written::Unclear("has no year"))
        }
        [a, b] if date.ends_with('.') && number(a, 2).is_some() && number(b, 2).is_some() => {
            Some(Written::Unclear("has no year"))
        }
        _ => None,
    }
}

fn three(a: &str, b: &str, c: &str, mark: char) -> Option<Written> {
    let short = |text: &str| number(text, 2);
    if let (Some(year), Some(day)) = (full_year(a), short(c)) {
        let month = month(b).or(short(b))?;
        return date(year, month, day).map(Written::Day);
    }
    if let (Some(day), Some(month), Some(year)) = (ordinal(a), month(b), year(c)) {
        return date(year, month, day).map(Written::Day);
    }
    if let (Some(month), Some(day), Some(year)) = (month(a), ordinal(b), year(c)) {
        return date(year, month, day).map(Written::Day);
    }
    let (first, second) = (short(a)?, short(b)?);
    let (day_first, month_first) = match year(c) {
        Some(year) => (date(year, second, first), date(year, first, second)),
        None => (None, None),
    };
    // `26/2/3` may be a day, `10-2-3` and `10.2.3` are names.
    let year_first = || {
        date(
            year(a).filter(|_| a.len() == 2)?,
            second,
            short(c).filter(|_| mark == '/' || c.len() == 2)?,
        )
    };
    let days = match mark {
        // With dots the month never comes first.
        '.' => [day_first, day_first, year_first()],
        '/' | '-' => [day_first, month_first, year_first()],
        _ => return None,
    };
    match days {
        [None, None, None] => None,
        [Some(day), _, None] if mark == '.' => Some(Written::Day(day)),
        days => Some(Written::By(days)),
    }
}

fn date(year: u16, month: u16, day: u16) -> Option<Date> {
    let month = Month::try_from(u8::try_from(month).ok()?).ok()?;
    Date::from_calendar_date(i32::from(year), month, u8::try_from(day).ok()?).ok()
}

/// A day in six digits, in any order: 260221 or 210226.
pub fn six_digits(text: &str) -> Option<Written> {
    let are_digits = text.len() == 6 && text.bytes().all(|byte| byte.is_ascii_digit());
    if are_digits { three(&text[..2], &text[2..4], &text[4..], '/') } else { None }
}

/// Digits, at most `most` of them.
fn number(text: &str, most: usize) -> Option<u16> {
    let is_number =
        (1..=most).contains(&text.len()) && text.bytes().all(|byte| byte.is_ascii_digit());
    is_number.then(|| text.parse().ok()).flatten()
}

fn full_year(text: &str) -> Option<u16> {
    number(text, 4).filter(|year| text.len() == 4 && (1900..2200).contains(year))
}

/// A year in four digits, or in two: up to 69 in this century, as in POSIX.
fn year(text: &str) -> Option<u16> {
    let short = || number(text, 2).filter(|_| text.len() == 2);
    full_year(text)
        .or_else(|| short().map(|year| if year < 70 { 2000 + year } else { 1900 + year }))
}

/// A day of the month, `3` or `3rd`.
fn ordinal(text: &str) -> Option<u16> {
    let text = ["st", "nd", "rd", "th"]
        .iter()
        .find_map(|ending| text.strip_suffix(ending))
        .unwrap_or(text);
    number(text, 2)
}

/// Months in English, German and French, in full or abbreviated to three letters or more.
fn month(text: &str) -> Option<u16> {
    const NAMES: [&[&str]; 12] = [
        &["january", "januar", "jänner", "janvier"],
        &["february", "februar", "février", "fevrier"],
        &["march", "märz", "maerz", "mrz", "mars"],
        &["april", "avril"],
        &["may", "mai"],
        &["june", "juni", "juin"],
        &["july", "juli", "juillet"],
        &["august", "août", "aout"],
        &["september", "septembre"],
        &["october", "oktober", "octobre"],
        &["november", "novembre"],
        &["december", "dezember", "décembre", "decembre"],
    ];
    let text = text.to_lowercase();
    let names = |names: &&[&str]| {
        text.chars().count() >= 3 && names.iter().any(|name| name.starts_with(&text))
    };
    let mut months = (1..).zip(&NAMES).filter(|(_, of)| names(of)).map(|(month, _)| month);
    // `jui` is June or July.
    months.next().filter(|_| months.next().is_none())
}

/// The text without a leading weekday.
fn without_weekday(text: &str) -> &str {
    const NAMES: [&str; 21] = [
        "monday",
        "tuesday",
        "wednesday",
        "thursday",
        "friday",
        "saturday",
        "sunday",
        "montag",
        "dienstag",
        "mittwoch",
        "donnerstag",
        "freitag",
        "samstag",
        "sonntag",
        "lundi",
        "mardi",
        "mercredi",
        "jeudi",
        "vendredi",
        "samedi",
        "dimanche",
    ];
    let end = text.find(|c: char| !c.is_alphabetic()).unwrap_or(text.len());
    let word = text[..end].to_lowercase();
    let is_weekday = word.len() >= 2
        && month(&word).is_none()
        && NAMES.iter().any(|name| name.starts_with(&word));
    if is_weekday { text[end..].trim_start_matches(['.', ',', ' ']) } else { text }
}

/// The time of day at the end of a text; empty if there is none.
pub fn time_of(text: &str) -> &str {
    let Some(colon) = text.find(':') else { return "" };
    text[text[..colon].trim_end_matches(|c: char| c.is_ascii_digit()).len()..]
        .trim_start_matches('0')
}

/// The date in a text that may end in a time of day; `None` if the end is not a time.
fn without_time(text: &str) -> Option<&str> {
    let Some(colon) = text.find(':') else { return Some(text) };
    let hour = text[..colon].trim_end_matches(|c: char| c.is_ascii_digit());
    let date = hour.strip_suffix(['T', 't', ' '])?;
    is_time(&text[hour.len()..]).then(|| date.trim_end_matches([',', ' ']))
}

/// `9:30`, `09:30:15.250`, `2:30 PM`, `09:30Z`, `09:30+01:00`.
fn is_time(text: &str) -> bool {
    let clock_end =
        text.find(|c: char| !c.is_ascii_digit() && c != ':' && c != '.').unwrap_or(text.len());
    let (clock, rest) = text.split_at(clock_end);
    let (clock, fraction) = clock.split_once('.').unwrap_or((clock, "0"));
    let parts: Vec<Option<u16>> = clock.split(':').map(|part| number(part, 2)).collect();
    let is_clock = match parts.as_slice() {
        [Some(hour), Some(minute)] => *hour < 24 && *minute < 60,
        [Some(hour), Some(minute), Some(second)] => *hour < 24 && *minute < 60 && *second <= 60,
        _ => false,
    };
    let is_fraction = !fraction.is_empty() && fraction.bytes().all(|byte| byte.is_ascii_digit());
    is_clock && is_fraction && is_zone(rest.trim())
}

fn is_zone(text: &str) -> bool {
    let text = text.to_ascii_lowercase();
    let offset = text.strip_prefix("utc").unwrap_or(&text).strip_prefix(['+', '-']);
    let is_offset = |it: &str| {
        (2..=5).contains(&it.len()) && it.bytes().all(|byte| byte.is_ascii_digit() || byte == b':')
    };
    ["", "z", "utc", "gmt", "am", "pm", "a.m.", "p.m."].contains(&text.as_str())
        || offset.is_some_and(is_offset)
}

/// Maximum duration of a campaign, days: mistaking the year for the day of the month would make it
/// last decades.
pub const CAMPAIGN_MAX_D: i32 = 3653;

/// What the numbers in a column of days count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Count {
    /// Days, as a spreadsheet counts them: 46056 is 2026-02-03.
    Serial,
    /// Seconds since 1970, UTC.
    Seconds,
    /// Milliseconds since 1970, UTC.
    Milliseconds,
    /// Digits of year, month and day, optionally followed by those of a time: 20260203,
    /// 202602030930.
    Digits,
}

impl Count {
    /// What at least half of these numbers count, as days of one campaign; `None` if they are
    /// numbers of another kind. Any number between 0.9 and 4.1 thousand million is seconds to some
    /// day of this century.
    pub fn of(numbers: &[f64]) -> Option<Self> {
        let are_days = |count: &Self| {
            let mut days: Vec<i32> = numbers
                .iter()
                .filter_map(|number| count.day(*number))
                .map(Date::to_julian_day)
                .collect();
            days.sort_unstable();
            let half = numbers.len().div_ceil(2);
            half > 0 && days.windows(half).any(|some| some[half - 1] - some[0] <= CAMPAIGN_MAX_D)
        };
        [Self::Serial, Self::Seconds, Self::Milliseconds, Self::Digits].into_iter().find(are_days)
    }

    /// The day of a number, within the years 2000 to 2099.
    pub fn day(self, number: f64) -> Option<Date> {
        const DAY_S: f64 = 86_400.0;
        // Julian days of 1970-01-01 and of day 0 of spreadsheets.
        const EPOCH: f64 = 2_440_588.0;
        const SPREADSHEET: f64 = 2_415_019.0;
        let date = match self {
            Self::Serial => julian(SPREADSHEET + number),
            Self::Seconds => julian(EPOCH + (number / DAY_S).floor()),
            Self::Milliseconds => julian(EPOCH + (number / (1000.0 * DAY_S)).floor()),
            Self::Digits => digits(number),
        };
        date.filter(|date| (2000..2100).contains(&date.year()))
    }
}

fn julian(day: f64) -> Option<Date> {
    // Far beyond any date, and within the range of an integer.
    (day.abs() < 1e8).then(|| Date::from_julian_day(day.floor() as i32).ok()).flatten()
}

fn digits(number: f64) -> Option<Date> {
    let text = format!("{number}");
    let time = match text.len() {
        8 => "0000",
        12 | 14 => text.get(8..12)?,
        _ => return None,
    };
    let is_time = time[..2].parse().is_ok_and(|hour: u8| hour < 24)
        && time[2..].parse().is_ok_and(|it: u8| it < 60);
    let part = |from: usize, to: usize| text.get(from..to)?.parse::<u16>().ok();
    date(part(0, 4)?, part(4, 6)?, part(6, 8)?).filter(|_| is_time)
}

#[cfg(test)]
mod tests;
