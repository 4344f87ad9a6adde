//! `flip weigh --list`.

use crate::characterise::calibrated;
use crate::harness::{document, expect_status, flip, stderr};
use serde_json::{Value, json};

#[test]
fn a_list_is_weighed_in_order_and_asked_for_again_pours_nothing_twice() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path();
    calibrated(data);
    let file = data.join("plate 7.csv");
    std::fs::write(&file, "powder;target_mg;vial\nSalt;15;V1\nsalt;8,5;V2\n").unwrap();
    let weigh = ["weigh", "--list", file.to_str().unwrap(), "--json"];
    let output = flip(data, &weigh);
    expect_status(&output, 0);
    let list = document(&output);
    assert_eq!(list["name"], "plate 7");
    let of = |key: &str| -> Vec<Value> {
        list["doses"].as_array().unwrap().iter().map(|dose| dose[key].clone()).collect()
    };
    assert_eq!(of("target_mg"), [json!(15.0), json!(8.5)]);
    assert_eq!(
        of("asked"),
        [("V1"), ("V2")].map(|vial| {
            json!({ "vial": vial, "list": "plate 7", "on_overdose": { "action": "stop" } })
        })
    );
    assert!(of("state").iter().all(|state| state == "done"), "{list}");
    assert!(stderr(&output).contains("dose 2 of 2: "), "{}", stderr(&output));

    let again = flip(data, &weigh);
    expect_status(&again, 0);
    assert!(stderr(&again).contains("was begun before"), "{}", stderr(&again));
    assert_eq!(document(&again), list);

    std::fs::write(&file, "powder;target_mg\nsalt;99999\nchalk;5\n").unwrap();
    let wrong = flip(data, &[&weigh[..], &["--name", "plate 8"]].concat());
    expect_status(&wrong, 2);
    let fields: Vec<Value> = document(&wrong)["error"]["errors"]
        .as_array()
        .unwrap()
        .iter()
        .map(|error| error["field"].clone())
        .collect();
    assert_eq!(fields, ["row[2].target_mg", "row[3].powder"]);
}
