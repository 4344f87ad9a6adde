use super::*;
use time::macros::date;

const THIRD: Date = date!(2026 - 02 - 03);

#[test]
fn numbers_spread_over_a_century_count_no_days_and_one_typo_among_days_changes_nothing() {
    // Fibonacci hashing: 32-bit values, all different, three in four of them seconds to a day
    // of this century.
    let hashes: Vec<f64> =
        (0..60u64).map(|k| (k.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32) as f64).collect();
    assert!(hashes.iter().filter(|it| Count::Seconds.day(**it).is_some()).count() > 30);
    assert_eq!(Count::of(&hashes), None);
    let mut days: Vec<f64> = (0..9).map(|k| 1_770_111_000.0 + 86_400.0 * f64::from(k)).collect();
    days.push(17_701_110.0);
    assert_eq!(Count::of(&days), Some(Count::Seconds));
    assert_eq!(Count::of(&[]), None);
}

#[test]
fn one_day_in_every_form_is_that_day() {
    for text in [
        "2026-02-03",
        "2026/2/3",
        "2026.02.03",
        "2026-02-03T09:30:00+01:00",
        "2026-02-03 09:30",
        "2026-02-03T23:59:59.999Z",
        "3.2.2026",
        "03.02.2026",
        "3.2.26",
        "3. 2. 2026",
        "3.2.2026 14:05",
        "03-Feb-26",
        "3-Feb-2026",
        "3 Feb 2026",
        "3 February 2026",
        "3rd February 2026",
        "Feb 3, 2026",
        "February 3, 2026 2:30 PM",
        "Tue, 3 Feb 2026",
        "Tuesday, February 3, 2026",
        "3. Februar 2026",
        "Di, 3.2.2026",
        "3 févr. 2026",
        "2026-Feb-03",
        "13/2/2026".replace("13", "3").as_str(),
    ] {
        let read = day(text).unwrap_or_else(|| panic!("{text}"));
        assert_eq!(read.day(Some(DateOrder::DayFirst)), Some(THIRD), "{text}");
    }
}

#[test]
fn slashes_are_read_in_the_order_that_is_known() {
    let read = day("2/3/2026").unwrap();
    assert_eq!((read.order(), read.day(None)), (None, None));
    assert_eq!(read.day(Some(DateOrder::MonthFirst)), Some(THIRD));
    assert_eq!(read.day(Some(DateOrder::DayFirst)), Some(date!(2026 - 03 - 02)));
    assert_eq!(day("15/2/2026 9:30").unwrap().order(), Some(DateOrder::DayFirst));
    assert_eq!(day("2-15-2026").unwrap().order(), Some(DateOrder::MonthFirst));
    assert_eq!(day("15/2/2026").unwrap().day(Some(DateOrder::MonthFirst)), None);
    assert_eq!(
        day("2/2/2026").unwrap().day(None),
        Some(date!(2026 - 02 - 02)),
        "the same either way"
    );
    assert_eq!(day("3.2."), Some(Written::Unclear("has no year")));
    assert_eq!(day("3 Feb"), Some(Written::Unclear("has no year")));
}

#[test]
fn a_year_of_two_digits_may_stand_first_or_last() {
    let (first, last) = (date!(2026 - 02 - 21), date!(2021 - 02 - 26));
    for text in ["26/02/21", "26.02.21", "26-02-21", "26/02/21 09:30", "26. 02. 21"] {
        let read = day(text).unwrap();
        assert_eq!((read.day(None), read.order()), (None, None), "{text}");
        assert_eq!(read.day(Some(DateOrder::YearFirst)), Some(first), "{text}");
        assert_eq!(read.day(Some(DateOrder::DayFirst)), Some(last), "{text}");
    }
    assert_eq!(day("26/2/3").unwrap().order(), Some(DateOrder::YearFirst));
    assert_eq!(day("45/12/30").unwrap().order(), Some(DateOrder::YearFirst));
    assert_eq!(day("31.12.45"), Some(Written::Day(date!(2045 - 12 - 31))), "2031-12-45 is none");
    assert_eq!(day("3.2.26"), Some(Written::Day(THIRD)), "a year has two digits");
    assert_eq!(day("15/2/26").unwrap().order(), None, "15 February 2026 or 26 February 2015");
    assert_eq!(day("26/02/2021").unwrap().order(), Some(DateOrder::DayFirst));
    assert_eq!([day("10-2-3"), day("10.2.3")], [None, None]);
    assert_eq!(six_digits("260221"), day("26/02/21"));
    assert_eq!(
        [six_digits("26022"), six_digits("269921"), six_digits("26é21")],
        [None, None, None]
    );
}

#[test]
fn what_is_no_day_is_none() {
    for text in [
        "",
        "Monday",
        "day 3",
        "2026-02-30",
        "2026-13-01",
        "2/30/2026",
        "15.15.2026",
        "2.15.2026",
        "2026-02-03 b",
        "2026-02-03 25:00",
        "2026-02-03T9",
        "12:30",
        "1/2",
        "3.2",
        "a.b.2026",
        "2026",
        "1-2-3",
        "20260203",
        "2026-02-3x",
        "3 Jui 2026",
        "2026-02",
    ] {
        assert_eq!(day(text), None, "{text}");
    }
}

#[test]
fn the_time_of_day_is_what_stands_behind_the_day() {
    for (text, time) in
        [("2026-02-03", ""), ("2026-02-03T09:30Z", "9:30Z"), ("3.2.26 14:05", "14:05")]
    {
        assert_eq!(time_of(text), time, "{text}");
    }
}

#[test]
fn numbers_count_days_if_most_of_them_do() {
    let of = |numbers: &[f64]| Count::of(numbers).and_then(|count| count.day(numbers[0]));
    assert_eq!(of(&[46_056.0, 46_057.4]), Some(THIRD));
    assert_eq!(of(&[46_056.9]), Some(THIRD), "whatever the hour");
    assert_eq!(of(&[1_770_076_800.0, 1_770_163_199.0]), Some(THIRD));
    assert_eq!(of(&[1_770_163_199_000.0]), Some(THIRD));
    assert_eq!(of(&[20_260_203.0]), Some(THIRD));
    assert_eq!(of(&[202_602_030_930.0]), Some(THIRD));
    assert_eq!(of(&[20_260_203_093_059.0]), Some(THIRD));
    assert_eq!(
        Count::of(&[46_056.0, 46_057.0, 4_605.0]),
        Some(Count::Serial),
        "a digit is missing"
    );
    for numbers in
        [&[1.0, 2.0] as &[f64], &[46_056.0, 3.0, 4.0], &[20_261_503.0], &[202_602_032_530.0], &[]]
    {
        assert_eq!(Count::of(numbers), None, "{numbers:?}");
    }
}
