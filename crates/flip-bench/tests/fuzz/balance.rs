//! Lines of balances. A mass is the one the line shows, and a lost byte never turns it into another
//! mass that looks like the first.

use crate::engine::{Seen, Target, bounded, outcome};
use flip_bench::hardware::balance::reply::{Condition, Reply, Said, Unreadable, Weight};
use flip_bench::hardware::balance::value::{Decimal, Unit};
use flip_bench::hardware::balance::{aandd, mt_sics, ohaus, sbi};

type Parse = fn(&[u8]) -> Result<Reply, Unreadable>;
/// A frame with this number, unit and stability; `None` where the dialect has none.
type Print = fn(&str, Option<Unit>, bool) -> Option<String>;

/// Longest line the driver reads, bytes.
const BYTES_MAX: usize = 256;
const WORDS: &[&str] = &[
    "S S ",
    "S D ",
    "TA A",
    "ZI S",
    "Error 10b",
    "\"",
    "ES",
    "ET",
    "Err8.3",
    "OK!",
    " ?",
    " NET",
    "N     ",
    "Stat  ",
    "Cal.Int.",
    "High",
    "- -",
    "ST,",
    "US,",
    "OL,+9999999E+19",
    "EC,E02",
    "TN,",
    " g",
    " mg",
    " kg",
    "  g",
    " oz",
    "%",
    "\u{663}",
    "\u{6}",
    "  100.0000",
    "100,000[0]",
    "[0]",
    "ST,GS,",
    "lb:oz",
    "OFF",
];

pub const MT_SICS: Target = line("mt_sics", |bytes| check(bytes, mt_sics::parse, print_mt_sics));
pub const OHAUS: Target = line("ohaus", |bytes| check(bytes, ohaus::parse, print_ohaus));
pub const SBI: Target = line("sbi", |bytes| check(bytes, sbi::parse, print_sbi));
pub const AANDD: Target = line("aandd", |bytes| check(bytes, aandd::parse, print_aandd));
pub const DECIMAL: Target = line("decimal", check_decimal);

const fn line(name: &'static str, check: fn(&[u8]) -> Result<Seen, String>) -> Target {
    Target { name, check, repair: None, words: WORDS, bytes_max: BYTES_MAX }
}

fn check(bytes: &[u8], parse: Parse, print: Print) -> Result<Seen, String> {
    let Ok(reply) = bounded(4 * bytes.len() + 256, || parse(bytes))? else {
        return Ok(Seen::Refused(0));
    };
    let to = reply.to.as_ref().map(String::len);
    match &reply.said {
        Said::Weight(weight) => {
            check_weight(bytes, weight)?;
            check_printed(weight, parse, print)?;
            check_lost_bytes(bytes, &reply, weight, parse)?;
            Ok(Seen::Read(outcome((
                to,
                weight.unit.map(|unit| unit as u8),
                weight.stable,
                weight.number.decimals(),
            ))))
        }
        Said::Condition(Condition::ForeignUnit(unit)) if unit.is_empty() || unit.len() > 5 => {
            Err(format!("a unit of {} bytes", unit.len()))
        }
        Said::Condition(Condition::Fault(words)) if words.trim().is_empty() => {
            Err("a fault without words".to_owned())
        }
        Said::Condition(condition) => {
            Ok(Seen::Read(outcome((to, std::mem::discriminant(condition)))))
        }
        Said::Text(text) if !text.bytes().all(|byte| (b' '..=b'~').contains(&byte)) => {
            Err(format!("words that cannot be printed: {text:?}"))
        }
        Said::Text(text) => Ok(Seen::Read(outcome((to, "text", text.is_empty())))),
        Said::Done => Ok(Seen::Read(outcome((to, "done")))),
    }
}

/// Checks that the mass is finite and its digits are in the line.
fn check_weight(line: &[u8], weight: &Weight) -> Result<(), String> {
    let bytes = line.len();
    let unit = weight.unit.unwrap_or(Unit::Gram);
    let (mg, place_mg) = (weight.number.mg(unit), weight.number.last_place_mg(unit));
    if !(mg.is_finite() && place_mg.is_finite() && place_mg > 0.0) {
        return Err(format!("{mg} mg in steps of {place_mg} mg"));
    }
    let digits = shown(weight).trim_start_matches('-').to_owned();
    // A comma is a point, and the last digit may be in brackets.
    let line: Vec<u8> = line
        .iter()
        .filter(|byte| !b"[]".contains(byte))
        .map(|byte| if *byte == b',' { b'.' } else { *byte })
        .collect();
    let is_in_line = line.windows(digits.len()).any(|window| window == digits.as_bytes());
    let is_negative_in_line = line.contains(&b'-');
    if !is_in_line || (mg < 0.0 && !is_negative_in_line) {
        return Err(format!("{mg} mg are not what the line shows, {digits} is not in it"));
    }
    if weight.width > bytes {
        return Err(format!("its number ends at byte {} of {bytes}", weight.width));
    }
    Ok(())
}

/// Checks that reading it again from a frame of our own returns the same.
fn check_printed(weight: &Weight, parse: Parse, print: Print) -> Result<(), String> {
    let Some(line) = print(&shown(weight), weight.unit, weight.stable) else { return Ok(()) };
    match parse(line.as_bytes()).map(|reply| reply.said) {
        Ok(Said::Weight(again))
            if form(&again) == form(weight) && again.stable == weight.stable =>
        {
            Ok(())
        }
        other => Err(format!("written as {line:?} it is read as {other:?} instead of {weight:?}")),
    }
}

/// Frames have no checksum; but a line that lost a byte, or its end, is not a frame, or has another
/// form, which makes the driver query again.
fn check_lost_bytes(
    line: &[u8],
    reply: &Reply,
    weight: &Weight,
    parse: Parse,
) -> Result<(), String> {
    let without_one = (0..line.len()).map(|at| [&line[..at], &line[at + 1..]].concat());
    let cut = (0..line.len()).map(|end| line[..end].to_vec());
    for damaged in without_one.chain(cut) {
        let Ok(Reply { to, said: Said::Weight(other) }) = parse(&damaged) else { continue };
        let looks_alike =
            to == reply.to && other.width == weight.width && other.unit == weight.unit;
        if looks_alike
            && other.number.decimals() == weight.number.decimals()
            && form(&other) != form(weight)
        {
            let (line, damaged) =
                (String::from_utf8_lossy(line), String::from_utf8_lossy(&damaged));
            return Err(format!(
                "{line:?} that lost a byte, {damaged:?}, is another mass of the same form"
            ));
        }
    }
    Ok(())
}

/// Mass, decimals and unit.
fn form(weight: &Weight) -> (f64, i32, Option<Unit>) {
    (weight.number.mg(weight.unit.unwrap_or(Unit::Gram)), weight.number.decimals(), weight.unit)
}

/// The number as it would be displayed, computed from the milligrams.
fn shown(weight: &Weight) -> String {
    let unit = weight.unit.unwrap_or(Unit::Gram);
    let decimals = usize::try_from(weight.number.decimals()).expect("at most fifteen");
    format!("{:.decimals$}", weight.number.mg(unit) / mg_in(unit))
}

fn mg_in(unit: Unit) -> f64 {
    match unit {
        Unit::Milligram => 1.0,
        Unit::Gram => 1e3,
        Unit::Kilogram => 1e6,
    }
}

fn name(unit: Unit) -> &'static str {
    match unit {
        Unit::Milligram => "mg",
        Unit::Gram => "g",
        Unit::Kilogram => "kg",
    }
}

fn print_mt_sics(number: &str, unit: Option<Unit>, stable: bool) -> Option<String> {
    let status = if stable { "S" } else { "D" };
    unit.filter(|_| number.len() <= 10)
        .map(|unit| format!("S {status} {number:>10} {}", name(unit)))
}

fn print_ohaus(number: &str, unit: Option<Unit>, stable: bool) -> Option<String> {
    let mark = if stable { "" } else { " ?" };
    unit.filter(|_| number.len() <= 11).map(|unit| format!("{number:>11} {}{mark}", name(unit)))
}

fn print_sbi(number: &str, unit: Option<Unit>, stable: bool) -> Option<String> {
    let (sign, digits) = signed(number);
    let is_frame = digits.len() <= 9 && unit.is_some() == stable;
    is_frame.then(|| format!("N     {sign}{digits:>9} {:<3}", unit.map_or("", name)))
}

fn print_aandd(number: &str, unit: Option<Unit>, stable: bool) -> Option<String> {
    let (sign, digits) = signed(number);
    let header = if stable { "ST" } else { "US" };
    unit.filter(|_| digits.len() <= 10)
        .map(|unit| format!("{header},{sign}{digits:0>9}{:>3}", name(unit)))
}

fn signed(number: &str) -> (char, &str) {
    number.strip_prefix('-').map_or(('+', number), |digits| ('-', digits))
}

fn check_decimal(text: &[u8]) -> Result<Seen, String> {
    let Some(number) = bounded(4 * text.len() + 64, || Decimal::parse(text))? else {
        return Ok(Seen::Refused(0));
    };
    let digits: String =
        text.iter().filter(|byte| byte.is_ascii_digit()).map(|byte| char::from(*byte)).collect();
    let count: f64 = digits.parse::<u64>().map_err(|error| format!("{digits:?}: {error}"))? as f64;
    // A number with more digits than `f64` can distinguish must have been refused.
    let again = format!("{:.*}", number.decimals() as usize, number.mg(Unit::Milligram).abs())
        .replace('.', "");
    if again.trim_start_matches('0') != digits.trim_start_matches('0') {
        return Err(format!("{digits} became {again}"));
    }
    let sign = if text[0] == b'-' { -1.0 } else { 1.0 };
    for unit in [Unit::Milligram, Unit::Gram, Unit::Kilogram] {
        // Steps of the last place, counted: the digits without their point.
        let (mg, wanted) =
            (number.mg(unit), sign * count * mg_in(unit) / 10_f64.powi(number.decimals()));
        let is_near = (mg - wanted).abs() <= 4.0 * f64::EPSILON * wanted.abs();
        if !is_near || (mg == 0.0 && mg.is_sign_negative()) {
            return Err(format!("{mg} mg instead of {wanted} mg"));
        }
    }
    Ok(Seen::Read(outcome((number.decimals(), digits.len(), sign < 0.0))))
}
