//! A command says the same of a folder, opened here or asked of its server.

use crate::characterise::calibrated;
use crate::harness::{Service, document, expect_status, flip, stderr};
use serde_json::{Value, json};
use std::path::Path;

/// A folder with a dose, a film of it, shakes and measurements from files.
fn furnished(folder: &Path) -> String {
    calibrated(folder);
    let weigh = ["weigh", "--powder", "salt", "--target-mg", "8", "--lot", "L 1&2"];
    expect_status(&flip(folder, &weigh), 0);
    expect_status(&flip(folder, &["film"]), 0);
    let measured = folder.join("measured.csv");
    std::fs::write(&measured, "powder,repose_deg,drained_deg\nflour,46,38\nflour,48,40\n").unwrap();
    let import = ["measurements", "import", measured.to_str().unwrap(), "--create"];
    expect_status(&flip(folder, &import), 0);
    let trail = folder.join("trail.json");
    expect_status(&flip(folder, &["audit", "export", "--out", trail.to_str().unwrap()]), 0);
    let trail: Value = serde_json::from_slice(&std::fs::read(trail).unwrap()).unwrap();
    let id = trail.as_array().unwrap().iter().find_map(|it| it["weighing"].as_str());
    id.unwrap().to_owned()
}

#[test]
fn what_a_folder_holds_reads_the_same_here_and_there() {
    let folder = tempfile::tempdir().unwrap();
    let weighing = furnished(folder.path());
    let status = flip(folder.path(), &["bench", "status"]);
    let service = Service::start(folder.path());
    let policies = document(&flip(folder.path(), &["policy", "list", "--json"]));
    let policy = policies["items"][0]["id"].as_str().unwrap();
    for command in [
        &["jobs"][..],
        &["jobs", "--kind", "film", "--state", "succeeded", "--limit", "1", "--json"],
        &["jobs", "--times", "--json"],
        &["policy", "list"],
        &["policy", "list", "--limit", "1", "--json"],
        &["policy", "show", "--policy", policy, "--json"],
        &["measurements", "export"],
        &["measurements", "export", "--json"],
        &["measurements", "export", "--powder", "flour"],
        &["measurements", "compare", "--json"],
        &["shakes", "list"],
        &["shakes", "list", "--lot", "L 1&2", "--json"],
        &["shakes", "export", "--powder", "salt", "--bench", "simulated"],
        &["discover", "versions", "--json"],
        &["characterise", "--powder", "salt", "--show", "--json"],
        &["audit", "verify", "--json"],
        // Refused alike.
        &["policy", "show", "--policy", "p-0", "--json"],
        &["jobs", "--limit", "0"],
        &["measurements", "export", "--powder", "chalk"],
        &["compare", "none", "other"],
    ] {
        let (here, there) = (flip(folder.path(), command), service.ask(command));
        let text = |output: &std::process::Output| {
            (String::from_utf8_lossy(&output.stdout).into_owned(), stderr(output))
        };
        assert_eq!(text(&there), text(&here), "{command:?}");
        assert_eq!(there.status, here.status, "{command:?}");
    }
    assert_eq!(service.ask(&["bench", "status"]).stdout, status.stdout);
    files_are_the_same(folder.path(), &service, &weighing, policy);
    health(&service);
}

/// An admin's export of a server has what a folder's has: no tokens, no webhooks.
#[test]
fn an_export_has_the_same_files_here_and_there() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path();
    let measured = data.join("measured.csv");
    std::fs::write(&measured, "powder,repose_deg\nflour,46\nflour,48\n").unwrap();
    let import = ["measurements", "import", measured.to_str().unwrap(), "--create"];
    expect_status(&flip(data, &import), 0);
    let service = Service::start(data);
    let (here, there) = (data.join("here"), data.join("there"));
    let (one, other) = (here.to_str().unwrap(), there.to_str().unwrap());
    let one = document(&flip(data, &["export", "--json", "--out", one]));
    let other = document(&service.ask(&["export", "--json", "--out", other]));
    assert_eq!(one["rows"], other["rows"]);
    assert!(one["rows"]["powders.csv"] == 6 && one["policies"] == other["policies"], "{one}");
    let files = |folder: &Path| {
        let mut files: Vec<_> =
            std::fs::read_dir(folder).unwrap().map(|it| it.unwrap().file_name()).collect();
        files.sort();
        files
    };
    assert_eq!(files(&here), files(&there));
    for file in files(&here).iter().filter(|it| here.join(it).is_file()) {
        let read = |folder: &Path| std::fs::read_to_string(folder.join(file)).unwrap();
        assert_eq!(read(&here), read(&there), "{file:?}");
    }
    // A token that does not fit is an error, not an empty export.
    let out = data.join("nothing");
    let refused =
        super::ask(&service.url(), "flip_wrong", &["export", "--out", out.to_str().unwrap()]);
    assert!(!refused.status.success() && !out.exists(), "{}", stderr(&refused));
    assert!(stderr(&refused).contains("FLIP_TOKEN"), "{}", stderr(&refused));
}

/// Commands that write a file.
fn files_are_the_same(data: &Path, service: &Service, weighing: &str, policy: &str) {
    let (one, other) = (data.join("one"), data.join("other"));
    let (one, other) = (one.to_str().unwrap(), other.to_str().unwrap());
    for command in [
        &["policy", "export", "--policy", policy][..],
        &["audit", "certificate", "--weighing", weighing],
        &["audit", "export"],
        &["audit", "export", "--format", "csv", "--kind", "outcome"],
        &["film", "--weighing", weighing],
    ] {
        let there = service.ask(&[command, &["--out", other]].concat());
        expect_status(&there, 0);
        let bytes = std::fs::read(other).unwrap();
        if command[0] == "film" {
            assert_eq!(&bytes[..8], b"FLIPFILM");
            continue;
        }
        expect_status(&flip(data, &[command, &["--out", one]].concat()), 0);
        assert!(bytes == std::fs::read(one).unwrap(), "{command:?}");
    }
}

fn health(service: &Service) {
    let alive = service.ask(&["health", "--json"]);
    expect_status(&alive, 0);
    assert_eq!(document(&alive), json!({ "alive": true }));
}

#[test]
fn what_is_changed_there_stands_in_the_folder() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path();
    let service = Service::start(data);
    let token = document(&service.ask(&["token", "create", "--role", "viewer", "--json"]));
    assert!(token["token"].as_str().unwrap().starts_with("flip_"));
    let id = token["id"].as_str().unwrap();
    expect_status(&service.ask(&["token", "revoke", id]), 0);
    let tokens = document(&service.ask(&["token", "list", "--json"]));
    let ids = |list: &Value| -> Vec<Value> {
        list["items"].as_array().unwrap().iter().map(|it| it["id"].clone()).collect()
    };
    assert_eq!(ids(&tokens), ids(&document(&flip(data, &["token", "list", "--json"]))));

    let file = data.join("bench.csv");
    std::fs::write(&file, "powder,repose_deg\nflour,46\nflour,48\n").unwrap();
    let import = ["measurements", "import", file.to_str().unwrap(), "--json"];
    let unknown = service.ask(&import);
    expect_status(&unknown, 2);
    assert!(stderr(&unknown).contains("row[2].powder: there is no powder"), "{}", stderr(&unknown));
    let imported = document(&service.ask(&[&import[..], &["--create"]].concat()));
    assert_eq!(imported["powders"], json!(["flour"]));

    std::fs::write(
        &file,
        "weighing,powder,pitch_deg,shake_mm,fell_mg,sd_mg\nr1,flour,40,8,2.5,1\n",
    )
    .unwrap();
    let import = ["shakes", "import", file.to_str().unwrap(), "--source", "notebook 3 & 4"];
    expect_status(&service.ask(&import), 0);
    let kept = document(&flip(data, &["shakes", "list", "--json"]));
    assert_eq!(kept["items"][0]["source"], "notebook 3 & 4");
    let forget = ["shakes", "forget", "--powder", "flour", "--json"];
    assert_eq!(document(&service.ask(&forget))["spoonfuls"], 1);

    let policy = data.join("policy.safetensors");
    let policies = document(&flip(data, &["policy", "list", "--json"]));
    let id = policies["items"][0]["id"].as_str().unwrap();
    let file = policy.to_str().unwrap();
    expect_status(&service.ask(&["policy", "export", "--policy", id, "--out", file]), 0);
    let known = service.ask(&["policy", "import", "--file", file]);
    assert_eq!(String::from_utf8_lossy(&known.stdout).trim(), format!("{id} was known already"));
    the_bench(&service);
}

fn the_bench(service: &Service) {
    let reserve = ["bench", "reserve", "--owner", "Ada", "--seconds", "600", "--json"];
    let reserved = document(&service.ask(&reserve));
    let status = document(&service.ask(&["bench", "status", "--json"]));
    assert_eq!(status["reservation"], reserved);
    expect_status(&service.ask(&["bench", "release", reserved["id"].as_str().unwrap()]), 0);
    let readings = ["bench", "repeatability", "--readings-mg", "1,2,1,2,1,2,1,2,1,2"];
    expect_status(&service.ask(&readings), 0);
    for (command, why) in [
        (&["bench", "resume", "--by", "Ada"][..], "not held"),
        (&["bench", "clear", "--by", "Ada", "--looked", "--vial-ready"], "not latched"),
        (&["bench", "clear", "--by", "Ada"], "looked"),
        (&["bench", "vial-ready", "none"], "there is no weighing `none`"),
    ] {
        let refused = service.ask(command);
        expect_status(&refused, 2);
        assert!(stderr(&refused).contains(why), "{command:?}: {}", stderr(&refused));
    }
    expect_status(&service.ask(&["discover", "use", "base"]), 0);
}
