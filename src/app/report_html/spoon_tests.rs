use super::super::{fragment, html};
use crate::app::document::hostile::assert_inert;
use flip_discover::Report;
use serde_json::json;
use std::collections::BTreeMap;

/// A report whose spoons were judged, with these words where others come from outside.
fn report(word: &str) -> Report {
    let text = include_str!("../../../web/tests/reports/nothing.json");
    let mut report: Report = serde_json::from_str(text).unwrap();
    let step = |k: u32| {
        json!({ "pitch_deg": 20.0 + f64::from(k), "shake_mm": 8.0, "weighed_mg": f64::from(k),
            "simulated_mg": 2.0 * f64::from(k), "band90_mg": [0.0, 3.0 * f64::from(k)] })
    };
    let powder = json!({
        "powder": word, "verdict": "cause", "sentence": word, "p_value": 0.025,
        "p_corrected": 0.05, "spoonfuls": [5, 9], "sets": 3,
        "summaries": [{ "name": "total", "unit": "mg", "measured": 4.4, "simulated": 17.0,
            "band90": [9.4, 26.6] }],
        "courses": [{ "weighing": word, "spoonful": 1, "steps": [step(1), step(2), step(3)],
            "left_mg": null, "after_mg": 4.0 }],
        "causes": [{ "cause": "spoon_adhesion", "family": "spoon", "probability": 0.93,
            "log10_evidence": 4.0, "amplitude": 3.0, "amplitude_ci95": [2.0, 4.0],
            "effect_mg": -12.0, "effect_ci95_mg": [-14.0, -10.0], "angle_deg": null,
            "experiment": word }],
        "families": [{ "family": "spoon", "probability": 0.97 }],
        "unknown_probability": 0.01, "ambiguous_between": [],
        "gain": { "by": "session", "spoonfuls": 5, "error_before_mg": 12.6,
            "error_after_mg": 1.2, "error_sham_mg": 12.0, "gain_ci95_mg": [9.0, 13.0],
            "accepted": true },
        "extension": null,
    });
    let spoon = json!({
        "sentence": word, "p_value": 0.05, "powders": [powder],
        "unjudged": [{ "powder": word, "why": word }],
        "campaigns": 39, "replays": 429, "heaps": 60, "blind_spots": [word],
    });
    report.spoon = Some(serde_json::from_value(spoon).unwrap());
    report
}

#[test]
fn what_spoons_say_is_on_the_page_with_its_gain_and_its_sham() {
    let page = html(&report("salt"));
    for told in [
        "Spoonfuls of Salt in numbers",
        "5 spoonfuls of 9, 3 calibrated sets",
        "4.40 mg",
        "[9.40, 26.60]",
        "Adhesion to the spoon",
        "93 %",
        "A sham: causes that change nothing",
        "95 % [9.00, 13.00]",
        "It is accepted.",
        "429 spoonfuls replayed, 60 heaps poured.",
        "Salt, spoonful 1: 3.0 mg weighed in the end, 6.0 mg simulated",
    ] {
        assert!(page.contains(told), "{told}");
    }
    assert!(!page.contains("NaN"), "every place is a number");
    let named = BTreeMap::from([("salt".to_owned(), "Salt of the sea".to_owned())]);
    assert!(fragment(&report("salt"), &named).contains("Salt of the sea, spoonful 1"));
}

#[test]
fn nothing_that_spoons_say_is_markup() {
    assert_inert(|word| html(&report(word)));
}
