//! How a report writes names and numbers. Everything that comes from a file passes through [`text`].

/// Text as HTML: nothing in it is markup, and no control character is left.
pub fn text(raw: &str) -> String {
    let mut out = String::with_capacity(raw.len());
    for c in raw.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            '\n' | '\t' => out.push(' '),
            c if c.is_control() => out.push(char::REPLACEMENT_CHARACTER),
            c => out.push(c),
        }
    }
    out
}

/// At most so many letters.
pub fn shortened(raw: &str, most: usize) -> String {
    match raw.chars().count() > most {
        true => raw.chars().take(most.max(2) - 1).chain(['…']).collect(),
        false => raw.to_owned(),
    }
}

/// Fixed decimals and a true minus; a dash for what is no number.
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

/// As many decimals as three significant digits need.
pub fn decimals_of(value: f64) -> usize {
    match value.abs() {
        size if !size.is_finite() || size == 0.0 => 0,
        size => (2 - size.log10().floor() as i32).clamp(0, 6) as usize,
    }
}

/// A chance: two digits that say something.
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

/// A share as `93 %`; what is nearly none or nearly all is not rounded to it.
pub fn percent(share: f64) -> String {
    match share {
        s if s > 0.0 && s < 0.005 => "&lt; 1 %".to_owned(),
        s if s < 1.0 && s > 0.995 => "&gt; 99 %".to_owned(),
        s => format!("{} %", num(100.0 * s, 0)),
    }
}

/// Degrees stand at their number, other units after a space. `unit` is HTML.
pub fn with_unit(number: &str, unit: &str) -> String {
    match unit {
        "" | "1" => number.to_owned(),
        "deg" | "°" => format!("{number}°"),
        unit => format!("{number} {unit}"),
    }
}

/// Seconds, or minutes, or hours.
pub fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 100.0 => format!("{} s", num(s, 0)),
        s if s < 7200.0 => format!("{} min", num(s / 60.0, 0)),
        s => format!("{} h", num(s / 3600.0, 1)),
    }
}

/// `sodium_bicarbonate` as words; not escaped yet.
pub fn words(name: &str) -> String {
    let spaced = name.replace(['_', '-'], " ");
    let mut letters = spaced.chars();
    match letters.next() {
        Some(first) => first.to_uppercase().chain(letters).collect(),
        None => spaced,
    }
}

/// Endings of columns, longest first, and their units.
const UNITS: [(&str, &str); 18] = [
    ("_m_s2", "m/s²"),
    ("_pct", "%"),
    ("_deg", "°"),
    ("_min", "min"),
    ("_hpa", "hPa"),
    ("_kpa", "kPa"),
    ("_mm", "mm"),
    ("_um", "µm"),
    ("_mg", "mg"),
    ("_ms", "ms"),
    ("_pa", "Pa"),
    ("_hz", "Hz"),
    ("_c", "°C"),
    ("_d", "d"),
    ("_g", "g"),
    ("_h", "h"),
    ("_s", "s"),
    ("_v", "V"),
];

/// Columns whose names are not the words that a chemist would use.
const COLUMNS: [(&str, &str); 6] = [
    ("rest_min", "Time at rest"),
    ("container_age_d", "Time since opening"),
    ("vibration_rms_m_s2", "Vibration (rms)"),
    ("plate", "Base plate"),
    ("ioniser_on", "Ioniser"),
    ("method", "Method of measuring"),
];

/// What a column holds, and in which unit; not escaped yet.
pub fn column(name: &str) -> (String, &'static str) {
    let unit = UNITS.iter().find(|(ending, _)| name.len() > ending.len() && name.ends_with(ending));
    let stem = unit.map_or(name, |(ending, _)| name.strip_suffix(ending).unwrap_or(name));
    let label =
        COLUMNS.iter().find(|(column, _)| *column == name).map_or_else(|| words(stem), |(_, it)| (*it).to_owned());
    (label, unit.map_or("", |(_, unit)| unit))
}

/// `Relative humidity (%)`; not escaped yet.
pub fn column_with_unit(name: &str) -> String {
    match column(name) {
        (label, "") => label,
        (label, unit) => format!("{label} ({unit})"),
    }
}

/// Causes whose names are not the words that a chemist would use.
const CAUSES: [(&str, &str); 14] = [
    ("rest_time", "Consolidation at rest"),
    ("densification", "Densification by shaking"),
    ("humid_ageing", "Ageing at rest in humid air"),
    ("container_age", "Ageing since opening"),
    ("batch", "Batch or grain size"),
    ("polydispersity", "Spread of grain sizes"),
    ("rolling_resistance", "Grain shape (rolling resistance)"),
    ("charge", "Electrostatic charge"),
    ("balance_static", "Charge at the balance"),
    ("spoon_holdup", "Powder held up on the spoon"),
    ("method_bias", "Bias of the measuring method"),
    ("operator", "Operator"),
    ("base_friction", "Friction of the base plate"),
    ("order", "Order in the session"),
];

/// A cause in words; not escaped yet.
pub fn cause(name: &str) -> String {
    if let Some(covariate) = name.strip_prefix("unknown: ") {
        return format!("Unknown cause, with {}", lower(&column(covariate).0));
    }
    match name {
        "unrecorded" => "Unknown cause, with nothing recorded".to_owned(),
        name => CAUSES.iter().find(|(cause, _)| *cause == name).map_or_else(|| words(name), |(_, it)| (*it).to_owned()),
    }
}

/// A fitted number in words; not escaped yet.
pub fn parameter(name: &str) -> String {
    match name {
        "effect_5_95" => "Change from the 5th to the 95th percentile".to_owned(),
        name => words(name),
    }
}

/// From where to where, without the condition that stands above it; not escaped yet.
pub fn span<'a>(span: &'a str, label: &str) -> &'a str {
    span.strip_suffix(&lower(label)).map_or(span, str::trim_end)
}

/// Begins small, for the middle of a sentence.
pub fn lower(phrase: &str) -> String {
    let mut letters = phrase.chars();
    letters.next().map_or_else(String::new, |first| first.to_lowercase().chain(letters).collect())
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
