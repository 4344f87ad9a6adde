//! Weighings found by what a person remembers of them.

use super::check::Check;
use super::{App, Result};
use flip_core::domain::FieldError;
use flip_core::domain::timestamp::Timestamp;
use flip_store::page::{LIST_LIMIT_MAX, PageQuery};
use flip_store::weighing_search::{WeighingsFound, WeighingsWanted};
use time::format_description::well_known::Rfc3339;
use time::macros::format_description;
use time::{Date, OffsetDateTime};

/// Most characters of a text that is searched for.
const TEXT_MAX: usize = 200;

/// Which weighings, with times as a person writes them.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct WeighingsAsked {
    /// What they have in common. Its times are set by those below.
    pub wanted: WeighingsWanted,
    /// Requested on this day (UTC) or later, `2026-11-24`, or from this time on,
    /// `2026-11-24T08:00:00+01:00`.
    pub since: Option<String>,
    /// Requested on this day (UTC) or earlier, or before this time.
    pub until: Option<String>,
}

impl App {
    /// A page of the weighings that match, the newest first unless asked otherwise, and how many
    /// match.
    ///
    /// # Errors
    /// `Invalid`: a time that is none, an end before its beginning, too long a text, a wrong page.
    pub async fn weighings(
        &self,
        asked: WeighingsAsked,
        page: PageQuery,
    ) -> Result<WeighingsFound> {
        let window = page.window(LIST_LIMIT_MAX)?;
        Ok(self.store().weighings_wanted(&wanted(asked)?, window).await?)
    }
}

fn wanted(asked: WeighingsAsked) -> Result<WeighingsWanted> {
    let WeighingsAsked { mut wanted, since, until } = asked;
    let mut check = Check::default();
    (wanted.since, wanted.before) = period(&mut check, since.as_deref(), until.as_deref());
    check_text(&mut check, "q", wanted.text.as_deref());
    check.done()?;
    Ok(wanted)
}

/// From when, and before when: each a day, the last one included, or a time.
pub(super) fn period(
    check: &mut Check,
    since: Option<&str>,
    until: Option<&str>,
) -> (Option<Timestamp>, Option<Timestamp>) {
    let mut at = |field, text: Option<&str>, days| {
        text.and_then(|text| check.keep(moment(field, text.trim(), days)))
    };
    let (since, before) = (at("since", since, 0), at("until", until, 1));
    if let (Some(since), Some(before)) = (since, before)
        && since >= before
    {
        check.refuse("until", "must not be earlier than `since`".to_owned());
    }
    (since, before)
}

/// Words that are searched for.
pub(super) fn check_text(check: &mut Check, field: &str, text: Option<&str>) {
    let long = text.map_or(0, |text| text.chars().count());
    if long > TEXT_MAX {
        check.refuse(field, format!("must be at most {TEXT_MAX} characters, got {long}"));
    }
}

/// The beginning of a day, so many days later, or a time.
fn moment(field: &str, text: &str, days: i64) -> std::result::Result<Timestamp, FieldError> {
    let day = format_description!("[year]-[month]-[day]");
    let of_day = Date::parse(text, day).ok().map(|day| {
        let start = day.midnight().assume_utc().saturating_add(time::Duration::days(days));
        start.unix_timestamp() * 1000
    });
    // A plus sign in an address is a space.
    let of_time = || OffsetDateTime::parse(&text.replace(' ', "+"), &Rfc3339).ok();
    let unix_ms = of_day
        .or_else(|| of_time().map(|at| (at.unix_timestamp_nanos() / 1_000_000) as i64))
        .ok_or_else(|| {
            let message = format!(
                "must be a day such as 2026-11-24 or a time such as 2026-11-24T08:00:00Z, got `{text}`"
            );
            FieldError::new(field, message)
        })?;
    Ok(Timestamp::from_unix_ms(unix_ms))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(since: &str, until: &str) -> WeighingsAsked {
        let text = |text: &str| (!text.is_empty()).then(|| text.to_owned());
        WeighingsAsked { since: text(since), until: text(until), ..WeighingsAsked::default() }
    }

    fn times(since: &str, until: &str) -> (Option<String>, Option<String>) {
        let found = wanted(asked(since, until)).unwrap();
        (found.since.map(|it| it.to_string()), found.before.map(|it| it.to_string()))
    }

    #[test]
    fn a_day_is_included_and_a_time_is_that_instant() {
        let some = |text: &str| Some(text.to_owned());
        assert_eq!(
            times("2026-11-24", "2026-11-24"),
            (some("2026-11-24T00:00:00Z"), some("2026-11-25T00:00:00Z"))
        );
        assert_eq!(times("2026-11-24T08:00:00 01:00", ""), (some("2026-11-24T07:00:00Z"), None));
        assert_eq!(times("", "2026-11-24T08:00:00Z"), (None, some("2026-11-24T08:00:00Z")));
    }

    #[test]
    fn what_is_no_time_and_an_end_before_the_beginning_are_refused_by_name() {
        let refused = |since, until| match wanted(asked(since, until)).unwrap_err() {
            super::super::Error::Invalid(errors) => errors[0].field.clone(),
            other => panic!("{other}"),
        };
        assert_eq!(refused("tuesday", ""), "since");
        assert_eq!(refused("", "2026-13-01"), "until");
        assert_eq!(refused("2026-11-25", "2026-11-24"), "until");
    }
}
