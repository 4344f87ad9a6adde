//! How far powders are moved, in words: every named powder has its own effect next to its name.
//!
//! Up to [`NAMED_MAX`] powders are named, each with its effect. For more, the average is given
//! along with the two that are moved least and most.

use super::printed::{decimals, is_shown, is_told};
use crate::report::{Finding, PowderEffect};

/// Most powders a sentence names one by one.
const NAMED_MAX: usize = 4;

/// The verbs a sentence uses for up and down.
pub(crate) struct Verbs {
    /// `pile steeper`
    pub up: &'static str,
    /// `pile flatter`
    pub down: &'static str,
    /// `than the simulation predicts`
    pub than: &'static str,
}

pub(crate) const ANGLES: Verbs =
    Verbs { up: "pile steeper", down: "pile flatter", than: "than the simulation predicts" };
pub(crate) const FLOW: Verbs =
    Verbs { up: "flow out more slowly", down: "flow out more quickly", than: "than usual" };

/// `+2.4° [1.6, 3.1]`, or `+12 % [8, 16]`.
pub(crate) fn sized(effect: f64, ci95: [f64; 2], unit: &str) -> String {
    let decimals = decimals(unit);
    // Values printed as zero have no sign.
    let number =
        |value: f64| format!("{:.decimals$}", if is_shown(value, decimals) { value } else { 0.0 });
    let sign = if effect > 0.0 && is_shown(effect, decimals) { "+" } else { "" };
    let unit = if unit == "deg" { "°".to_owned() } else { format!(" {unit}") };
    format!("{sign}{}{unit} [{}, {}]", number(effect), number(ci95[0]), number(ci95[1]))
}

/// How large the effect of a finding is: on average, or for the powder it is reported for; `None`
/// if it is not distinguishable from zero.
pub(crate) fn size(finding: &Finding) -> Option<String> {
    is_told(finding.ci95, &finding.unit).then(|| any_size(finding))
}

/// The same for any finding.
pub(crate) fn any_size(finding: &Finding) -> String {
    let size = sized(finding.effect, finding.ci95, &finding.unit);
    match &finding.powder {
        Some(powder) => format!("{} {size} {}", words(powder), finding.span),
        None if finding.by_powder.len() > 1 => {
            format!("{size} {} on average over powders", finding.span)
        }
        None => format!("{size} {}", finding.span),
    }
}

/// `sugar and salt pile steeper than the simulation predicts: sugar +3.1° [2.2, 4.0], salt +2.2°
/// [1.5, 3.0] from 30 to 70 % relative humidity`
pub(crate) fn moved(finding: &Finding, verbs: &Verbs) -> String {
    let told = told(finding);
    let of = |sign: f64| -> Vec<&PowderEffect> {
        told.iter().copied().filter(|on| sign * on.effect > 0.0).collect()
    };
    let (up, down) = (of(1.0), of(-1.0));
    let who = |which: &[&PowderEffect]| who(which, told.len(), finding.by_powder.len());
    let how = match (up.is_empty(), down.is_empty()) {
        (false, true) => format!("{} {}", who(&up), verbs.up),
        (true, false) => format!("{} {}", who(&down), verbs.down),
        (false, false) => format!("{} {} and {} {}", who(&up), verbs.up, who(&down), verbs.down),
        (true, true) => {
            format!("powders {}", if finding.effect > 0.0 { verbs.up } else { verbs.down })
        }
    };
    format!("{how} {}: {}", verbs.than, sizes(finding))
}

/// Which powders are moved, in either direction.
pub(crate) fn whom(finding: &Finding) -> String {
    let told = told(finding);
    who(&told, told.len(), finding.by_powder.len())
}

/// Each named powder's effect, or the average and the powders moved least and most.
pub(crate) fn sizes(finding: &Finding) -> String {
    let told = told(finding);
    let of = |on: &PowderEffect| sized(on.effect, on.ci95, &finding.unit);
    let span = &finding.span;
    if told.is_empty() {
        return any_size(finding);
    }
    if told.len() <= NAMED_MAX {
        let each: Vec<String> =
            told.iter().map(|on| format!("{} {}", words(&on.powder), of(on))).collect();
        return format!("{} {span}", each.join(", "));
    }
    let by = |a: &&&PowderEffect, b: &&&PowderEffect| a.effect.total_cmp(&b.effect);
    let ends = told.iter().min_by(by).into_iter().chain(told.iter().max_by(by));
    let ends: Vec<String> = ends.map(|on| format!("{} {}", words(&on.powder), of(on))).collect();
    match finding.powder {
        None => format!("{} (from {})", any_size(finding), ends.join(" to ")),
        Some(_) => format!("from {} {span}", ends.join(" to ")),
    }
}

/// Powders whose own effect is distinguishable from zero.
fn told(finding: &Finding) -> Vec<&PowderEffect> {
    finding.by_powder.iter().filter(|on| is_told(on.ci95, &finding.unit)).collect()
}

/// `told`: number of powders with an effect distinguishable from zero, out of `of`.
fn who(which: &[&PowderEffect], told: usize, of: usize) -> String {
    match which {
        [] => "powders".to_owned(),
        all if all.len() == of && of > NAMED_MAX => "all powders".to_owned(),
        some if told > NAMED_MAX => format!("{} of {of} powders", some.len()),
        [one] => words(&one.powder),
        [first @ .., last] => {
            let first: Vec<String> = first.iter().map(|on| words(&on.powder)).collect();
            format!("{} and {}", first.join(", "), words(&last.powder))
        }
    }
}

fn words(powder: &str) -> String {
    powder.replace('_', " ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::Channel;

    fn finding(effects: &[(&str, f64)]) -> Finding {
        let around = |effect: f64| [effect - 0.5, effect + 0.5];
        let of = |(powder, effect): &(&str, f64)| PowderEffect {
            powder: (*powder).to_owned(),
            effect: *effect,
            ci95: around(*effect),
        };
        let mean = effects.iter().map(|it| it.1).sum::<f64>() / effects.len() as f64;
        Finding {
            channel: Channel::Repose,
            covariate: Some("relative_humidity_pct".to_owned()),
            powders: Vec::new(),
            effect: mean,
            ci95: around(mean),
            unit: "deg".to_owned(),
            span: "from 30 to 70 % relative humidity".to_owned(),
            powder: None,
            by_powder: effects.iter().map(of).collect(),
        }
    }

    #[test]
    fn a_powder_that_is_named_has_its_own_effect() {
        let some = finding(&[("sand", 0.1), ("icing_sugar", 3.0), ("salt", 2.0)]);
        assert_eq!(
            moved(&some, &ANGLES),
            "icing sugar and salt pile steeper than the simulation predicts: icing sugar +3.0° [2.5, 3.5], salt +2.0° [1.5, 2.5] from \
             30 to 70 % relative humidity"
        );
        let mixed = finding(&[("sand", -1.0), ("salt", 2.0)]);
        assert!(
            moved(&mixed, &ANGLES).starts_with("salt pile steeper and sand pile flatter than"),
            "{}",
            moved(&mixed, &ANGLES)
        );
        let nobody = finding(&[("sand", 0.4), ("salt", 0.4)]);
        assert!(
            moved(&nobody, &FLOW)
                .starts_with("powders flow out more slowly than usual: +0.4° [-0.1, 0.9]")
        );
    }

    #[test]
    fn of_many_powders_the_average_and_its_ends_are_told() {
        let all = finding(&[("a", 1.0), ("b", 2.0), ("c", 3.0), ("d", 4.0), ("e", 5.0)]);
        assert_eq!(
            moved(&all, &ANGLES),
            "all powders pile steeper than the simulation predicts: +3.0° [2.5, 3.5] from 30 to 70 % relative humidity on average over \
             powders (from a +1.0° [0.5, 1.5] to e +5.0° [4.5, 5.5])"
        );
        assert_eq!(whom(&all), "all powders");
        let most =
            finding(&[("a", 1.0), ("b", 2.0), ("c", 3.0), ("d", 4.0), ("e", 5.0), ("f", 0.0)]);
        assert!(
            moved(&most, &ANGLES).starts_with("5 of 6 powders pile steeper"),
            "{}",
            moved(&most, &ANGLES)
        );
    }

    #[test]
    fn what_is_printed_as_zero_has_no_sign() {
        assert_eq!(sized(0.01, [-0.04, 0.04], "deg"), "0.0° [0.0, 0.0]");
        assert_eq!(sized(-12.4, [-20.0, -0.2], "%"), "-12 % [-20, 0]");
        let nothing = finding(&[("sand", 0.1)]);
        assert_eq!(size(&nothing), None);
    }
}
