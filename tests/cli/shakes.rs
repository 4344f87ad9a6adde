//! `flip shakes`.

use crate::harness::{document, expect_status, flip, stderr};

#[test]
fn shakes_come_from_a_file_go_back_into_one_and_are_forgotten() {
    let folder = tempfile::tempdir().unwrap();
    let (data, file) = (folder.path().join("data"), folder.path().join("shakes.csv"));
    // A trace as for `discover`: readings, of which one is below zero.
    let text = "weighing_id,balance_mg,powder,shake_index,shake_mm,spoon_pitch_deg,lot\n\
                run 1,0.0,Wheat flour,0,,,L1\n\
                run 1,-0.1,Wheat flour,1,8,46,\n\
                run 1,4.4,Wheat flour,2,16,48,\n";
    std::fs::write(&file, text).unwrap();
    let import = ["shakes", "import", file.to_str().unwrap(), "--source", "notebook 3"];
    let unknown = flip(&data, &import);
    expect_status(&unknown, 2);
    let said = stderr(&unknown);
    assert!(said.contains("row[2].powder: there is no powder `wheat_flour`"), "{said}");
    let imported = document(&flip(&data, &[&import[..], &["--create", "--json"]].concat()));
    assert_eq!((&imported["spoonfuls"], &imported["shakes"]), (&1.into(), &2.into()));

    let list = document(&flip(&data, &["shakes", "list", "--lot", "L1", "--json"]));
    let [item] = &list["items"].as_array().unwrap()[..] else { panic!("{list}") };
    let fell: Vec<f64> = item["spoonful"]["shakes"]
        .as_array()
        .unwrap()
        .iter()
        .map(|shake| shake["fell_mg"].as_f64().unwrap())
        .collect();
    assert!((fell[0] + 0.1).abs() < 1e-9 && (fell[1] - 4.5).abs() < 1e-9, "{list}");
    assert_eq!(item["source"], "notebook 3");

    let export = |data: &std::path::Path| {
        let output = flip(data, &["shakes", "export", "--powder", "wheat_flour"]);
        expect_status(&output, 0);
        output.stdout
    };
    let exported = export(&data);
    std::fs::write(&file, &exported).unwrap();
    let other = folder.path().join("other");
    expect_status(&flip(&other, &[&import[..], &["--create"]].concat()), 0);
    assert_eq!(export(&other), exported);

    let forget = ["shakes", "forget", "--powder", "wheat_flour", "--json"];
    assert_eq!(document(&flip(&data, &forget))["spoonfuls"], 1);
    let list = document(&flip(&data, &["shakes", "list", "--json"]));
    assert_eq!(list["items"], serde_json::json!([]));
    expect_status(&flip(&data, &["shakes", "forget", "--powder", "chalk"]), 2);
    expect_status(&flip(&data, &["shakes", "forget"]), 2);
}
