//! Names of columns that belong to the measured heap or flow.

use crate::data::campaign::Quantity;

/// Properties only a heap has.
const OF_HEAPS: [&str; 16] = [
    "pile",
    "heap",
    "cone",
    "mound",
    "flank",
    "flanks",
    "repose",
    "aor",
    "apex",
    "talus",
    "kegel",
    "flanke",
    "schuettkegel",
    "schüttkegel",
    "boeschung",
    "böschung",
];
/// Properties that heaps and other things have: taken as a heap's if nothing else is named.
const MEASURES: [&str; 36] = [
    "height",
    "diameter",
    "dia",
    "radius",
    "width",
    "base",
    "footprint",
    "area",
    "volume",
    "aspect",
    "slope",
    "slopes",
    "angle",
    "angles",
    "tan",
    "tangent",
    "tangens",
    "cot",
    "theta",
    "alpha",
    "steepness",
    "inclination",
    "perimeter",
    "circumference",
    "profile",
    "side",
    "hoehe",
    "höhe",
    "durchmesser",
    "breite",
    "neigung",
    "winkel",
    "hauteur",
    "diametre",
    "pente",
    "rayon",
];
/// Words for manner, side or unit that name no object.
const QUALIFIERS: [&str; 71] = [
    "mean",
    "average",
    "avg",
    "median",
    "left",
    "right",
    "front",
    "back",
    "north",
    "south",
    "east",
    "west",
    "l",
    "r",
    "max",
    "min",
    "final",
    "measured",
    "norm",
    "normed",
    "normalised",
    "normalized",
    "scaled",
    "per",
    "over",
    "by",
    "to",
    "of",
    "the",
    "mass",
    "weight",
    "ratio",
    "rel",
    "relative",
    "squared",
    "cubed",
    "sqrt",
    "root",
    "log",
    "ln",
    "est",
    "estimate",
    "estimated",
    "estimator",
    "calc",
    "calculated",
    "computed",
    "derived",
    "sin",
    "cos",
    "half",
    "total",
    "camera",
    "manual",
    "image",
    "photo",
    "laser",
    "caliper",
    "ruler",
    "h",
    "d",
    "x",
    "y",
    "links",
    "rechts",
    "second",
    "first",
    "other",
    "again",
    "check",
    "value",
];
const UNITS: [&str; 15] =
    ["mm", "cm", "m", "um", "deg", "rad", "mm2", "cm2", "mm3", "cm3", "ml", "g", "mg", "kg", "pct"];
/// Apparatus that heaps are poured with, onto or in.
const APPARATUS: [&str; 22] = [
    "funnel", "nozzle", "orifice", "hole", "hopper", "outlet", "drop", "fall", "spoon", "vial",
    "plate", "table", "room", "fill", "pour", "grain", "particle", "sieve", "stand", "tilt",
    "light", "trichter",
];
/// Properties of a flow.
const OF_FLOWS: [&str; 9] = [
    "flow",
    "flowrate",
    "efflux",
    "discharge",
    "throughput",
    "outflow",
    "duration",
    "seconds",
    "auslaufzeit",
];
/// Single-letter names of lengths.
const LETTERS: [&str; 5] = ["h", "d", "r", "w", "v"];

/// Whether a column is named after the measured quantity.
pub(crate) fn is_of_heap(name: &str, quantity: Quantity) -> bool {
    let words = words(name);
    let has = |of: &[&str]| words.iter().any(|word| of.contains(&word.as_str()));
    if has(&APPARATUS) {
        return false;
    }
    if quantity == Quantity::FlowTime {
        return has(&OF_FLOWS);
    }
    let is_said = |word: &String| {
        let word = word.as_str();
        let is_number = word.chars().all(|c| c.is_ascii_digit());
        [&OF_HEAPS[..], &MEASURES, &QUALIFIERS, &UNITS].iter().any(|of| of.contains(&word))
            || is_number
    };
    let is_letter = matches!(&words[..], [letter, unit] if LETTERS.contains(&letter.as_str()) && UNITS.contains(&unit.as_str()));
    has(&OF_HEAPS) || (has(&MEASURES) && words.iter().all(is_said)) || is_letter
}

/// Whether only a heap has such a property.
pub(crate) fn is_of_heaps_alone(name: &str) -> bool {
    words(name).iter().any(|word| OF_HEAPS.contains(&word.as_str()))
}

/// Splits a name into words: `PileHeight2_mm` is pile, height, 2, mm.
fn words(name: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let (mut was_small, mut was_digit) = (false, false);
    for c in name.chars() {
        let begins = (c.is_uppercase() && was_small) || (c.is_ascii_digit() != was_digit);
        (was_small, was_digit) = (c.is_lowercase(), c.is_ascii_digit());
        if !c.is_alphanumeric() || begins {
            words.push(String::new());
        }
        if let Some(last) = words.last_mut().filter(|_| c.is_alphanumeric()) {
            last.extend(c.to_lowercase());
        }
    }
    words.retain(|word| !word.is_empty());
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_heaps_are_told_from_names_of_what_heaps_are_poured_with() {
        for name in [
            "pile_height_mm",
            "base_diameter_mm",
            "left_flank_deg",
            "PileHeight",
            "height_mm",
            "h_mm",
            "tan_alpha",
            "height_per_mass",
            "mean_slope_deg",
            "aor2",
            "heap volume (ml)",
            "angle_camera_deg",
            "height_over_radius",
        ] {
            assert!(is_of_heap(name, Quantity::Repose), "{name}");
        }
        for name in [
            "funnel_height_mm",
            "drop_height_mm",
            "plate_angle_deg",
            "grain_diameter_um",
            "barometer_hpa",
            "clock_h",
            "supply_v",
            "tilt_angle",
            "noise_db",
            "mass_g",
            "hopper_cone_angle",
            "left",
            "x",
        ] {
            assert!(!is_of_heap(name, Quantity::Repose), "{name}");
        }
        assert!(
            is_of_heap("flow_rate_g_s", Quantity::FlowTime)
                && !is_of_heap("pile_height_mm", Quantity::FlowTime)
        );
    }
}
