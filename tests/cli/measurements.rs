//! `flip measurements`.

use crate::harness::{document, expect_status, flip, stderr};
use std::path::Path;

#[test]
fn measurements_come_from_a_file_and_go_back_into_one() {
    let folder = tempfile::tempdir().unwrap();
    let (data, file) = (folder.path().join("data"), folder.path().join("bench.csv"));
    let text = "powder,repose_deg,drained_deg\nflour,46,38\nflour,48,40\n";
    std::fs::write(&file, text).unwrap();
    let import = ["measurements", "import", file.to_str().unwrap()];
    let unknown = flip(&data, &import);
    expect_status(&unknown, 2);
    assert!(
        stderr(&unknown).contains("row[2].powder: there is no powder `flour`"),
        "{}",
        stderr(&unknown)
    );
    let imported = document(&flip(&data, &[&import[..], &["--create", "--json"]].concat()));
    assert_eq!(
        (&imported["powders"][0], &imported["measurements"][0]["n"]),
        (&"flour".into(), &2.into())
    );
    let export = |data: &Path| {
        let output = flip(data, &["measurements", "export", "--powder", "flour"]);
        expect_status(&output, 0);
        output.stdout
    };
    let exported = export(&data);
    std::fs::write(&file, &exported).unwrap();
    let other = folder.path().join("other");
    expect_status(&flip(&other, &[&import[..], &["--create"]].concat()), 0);
    assert_eq!(export(&other), exported);
    let all = document(&flip(&data, &["measurements", "export", "--json"]));
    assert_eq!(
        (
            all["measurements"].as_array().unwrap().len(),
            all["observations"].as_array().unwrap().len()
        ),
        (11, 1)
    );
}
