//! Formatting of names and numbers in a report.

pub use flip_discover::names::{cause, column, form, level, lower, parameter, with_unit, words};

use flip_discover::numerics::{Dependence, Varied};
use flip_discover::report::Numerics;
use maud::{Markup, html};

/// Capitalizes the first letter, for the start of a sentence.
pub fn upper(phrase: &str) -> String {
    let mut letters = phrase.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// Summary of the numerics check on simulated heaps, on one line.
pub fn numerics(of: &Numerics) -> Markup {
    let told = |it: &Dependence| {
        let (what, per) = match it.varied {
            Varied::SettlingTime => ("settling time", "decade"),
            Varied::Substep => ("substep", "doubling"),
            Varied::Particles => ("grains", "doubling"),
        };
        let verdict = match (it.is_defect, it.varied) {
            (true, Varied::SettlingTime) => ": heaps creep",
            (true, _) => ": a defect",
            (false, _) => "",
        };
        let ends = it.ci99.map(|end| signed(end, 1));
        format!("{what} {}° per {per} [{}, {}]{verdict}", signed(it.slope_deg, 1), ends[0], ends[1])
    };
    let all: Vec<String> = of.dependences.iter().map(told).collect();
    let heaps: u32 = of.dependences.iter().map(|it| it.runs).sum();
    html! {
        (all.join("; ")) " "
        small { (heaps) " heaps of " (of.set.source) ", 99 % intervals" }
    }
}

/// Truncates to at most `most` letters.
pub fn shortened(raw: &str, most: usize) -> String {
    match raw.chars().count() > most {
        true => raw.chars().take(most.max(2) - 1).chain(['…']).collect(),
        false => raw.to_owned(),
    }
}

/// Fixed decimals and a true minus sign; a dash if it is not a number.
pub fn num(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return "–".to_owned();
    }
    let written = format!("{value:.decimals$}");
    match written.parse() == Ok(0.0) {
        true => written.replace('-', ""),
        false => written.replace('-', "−"),
    }
}

/// The same, always with a sign; zero has none.
pub fn signed(value: f64, decimals: usize) -> String {
    let written = num(value, decimals);
    match value > 0.0 && written.contains(|c: char| ('1'..='9').contains(&c)) {
        true => format!("+{written}"),
        false => written,
    }
}

/// `[1.6, 3.1]`.
pub fn interval([low, high]: [f64; 2], decimals: usize) -> String {
    format!("[{}, {}]", num(low, decimals), num(high, decimals))
}

/// Number of decimals for three significant digits.
pub fn decimals_of(value: f64) -> usize {
    match value.abs() {
        size if !size.is_finite() || size == 0.0 => 0,
        size => (2 - size.log10().floor() as i32).clamp(0, 6) as usize,
    }
}

/// A probability with two informative digits.
pub fn chance(p: f64) -> String {
    num(
        p,
        if p >= 0.1 {
            2
        } else if p >= 0.001 {
            3
        } else {
            4
        },
    )
}

/// A share in percent, without the sign; nearly none or nearly all is not rounded to none or all.
pub fn percent(share: f64) -> String {
    match share {
        s if s > 0.0 && s < 0.005 => "< 1".to_owned(),
        s if s < 1.0 && s > 0.995 => "> 99".to_owned(),
        s => num(100.0 * s, 0),
    }
}

/// A duration: `42 s`, `15 min` or `1 h 35 min`.
pub fn duration(seconds: f64) -> String {
    let minutes = (seconds / 60.0).round();
    match minutes {
        _ if seconds < 100.0 => format!("{} s", num(seconds, 0)),
        m if m < 60.0 => format!("{} min", num(m, 0)),
        m => format!("{} h {:02} min", num((m / 60.0).floor(), 0), m % 60.0),
    }
}

/// `Relative humidity (%)`.
pub fn column_with_unit(name: &str) -> String {
    match column(name) {
        (label, "") => label,
        (label, unit) => format!("{label} ({unit})"),
    }
}

/// A range, without the name of the condition that is its heading.
pub fn span<'a>(span: &'a str, label: &str) -> &'a str {
    span.strip_suffix(&lower(label)).map_or(span, str::trim_end)
}

/// `a`, `a and b`, `a, b and c`.
pub fn listed(items: &[String]) -> String {
    match items {
        [] => String::new(),
        [one] => one.clone(),
        [all @ .., last] => format!("{} and {last}", all.join(", ")),
    }
}

/// `1 run`, `12 runs`.
pub fn counted(n: usize, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}
