//! `flip export`.

use crate::harness::{command, document, expect_status, flip, stderr};
use serde_json::Value;
use std::fs;
use std::path::Path;

fn rows(folder: &Path, name: &str) -> Vec<Vec<String>> {
    let text = fs::read_to_string(folder.join(name)).unwrap();
    let mut csv = csv_rows(&text);
    csv.retain(|row| !row.is_empty());
    csv
}

/// The rows of a file without quoted line breaks.
fn csv_rows(text: &str) -> Vec<Vec<String>> {
    let mut rows = vec![];
    for line in text.lines() {
        let (mut row, mut quoted) = (vec![String::new()], false);
        for letter in line.chars() {
            match letter {
                '"' => quoted = !quoted,
                ',' if !quoted => row.push(String::new()),
                other => row.last_mut().unwrap().push(other),
            }
        }
        rows.push(row);
    }
    rows
}

#[test]
fn everything_is_exported_into_tables_that_name_what_their_rows_belong_to() {
    let folder = tempfile::tempdir().unwrap();
    let csv = folder.path().join("piles.csv");
    fs::write(&csv, "powder,method,repose_deg\nZinc oxide,manual,41.2\nZinc oxide,manual,42.0\n")
        .unwrap();
    let import = ["measurements", "import", csv.to_str().unwrap(), "--create"];
    let data = folder.path().join("data");
    expect_status(&flip(&data, &import), 0);
    let out = folder.path().join("out");
    let export = |format: &str, out: &Path| {
        let arguments = ["export", "--json", "--format", format, "--out", out.to_str().unwrap()];
        flip(&data, &arguments)
    };
    let said = document(&export("csv", &out));
    assert_eq!(said["lost"], Value::Array(vec![]));
    let measured = rows(&out, "powders-measurements.csv");
    let at = |name: &str| measured[0].iter().position(|it| it == name).unwrap();
    let ours: Vec<_> = measured.iter().filter(|row| row[at("powder")] == "zinc_oxide").collect();
    assert_eq!(ours.len(), 1);
    let mean: f64 = ours[0][at("repose_deg")].parse().unwrap();
    assert!((mean - 41.6).abs() < 1e-9, "{mean}");
    assert_eq!(
        measured.len() - 1,
        said["rows"]["powders-measurements.csv"].as_u64().unwrap() as usize
    );
    // The shipped policies, whose files are what `flip policy export` writes.
    let policies = rows(&out, "policies.csv");
    assert_eq!(said["policies"], policies.len() as u64 - 1);
    let id = &policies[1][policies[0].iter().position(|it| it == "id").unwrap()];
    let alone = folder.path().join("alone.safetensors");
    let asked = ["policy", "export", "--policy", id, "--out", alone.to_str().unwrap()];
    expect_status(&flip(&data, &asked), 0);
    let file = fs::read(out.join("policies").join(format!("{id}.safetensors"))).unwrap();
    assert_eq!(file, fs::read(alone).unwrap());
    // A table without rows has its header; keys are not exported; each file's columns are named.
    assert_eq!(rows(&out, "weighings-trace.csv").len(), 1);
    assert!(!out.join("tokens.csv").exists());
    let named: Value =
        serde_json::from_slice(&fs::read(out.join("columns.json")).unwrap()).unwrap();
    for (file, columns) in named.as_object().unwrap() {
        let header = &rows(&out, file)[0];
        let names: Vec<_> =
            columns.as_array().unwrap().iter().map(|it| it["name"].as_str().unwrap()).collect();
        assert_eq!(header, &names, "{file}");
    }

    let refused = export("csv", &out);
    expect_status(&refused, 2);
    assert!(stderr(&refused).contains("out: "), "{}", stderr(&refused));
    let arrow = folder.path().join("arrow");
    expect_status(&export("arrow", &arrow), 0);
    assert!(fs::read(arrow.join("powders.arrow")).unwrap().starts_with(b"ARROW1"));
}

#[test]
fn an_export_that_cannot_be_written_leaves_no_folder() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    fs::write(&file, "").unwrap();
    let out = file.join("out");
    let output = command(&folder.path().join("data"), &["export", "--out", out.to_str().unwrap()])
        .output()
        .unwrap();
    expect_status(&output, 2);
    assert!(stderr(&output).contains("out: "), "{}", stderr(&output));
}
