//! `flip config` and the settings file.

use crate::harness::{document, expect_status, flip, stderr};
use std::process::Command;

#[test]
fn a_settings_file_stands_behind_the_command_line_and_a_mistake_in_it_begins_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (data, file) = (folder.path().join("data"), folder.path().join("flip.toml"));
    let file_name = file.to_str().unwrap();
    let run = |text: &str, words: &[&str]| {
        std::fs::write(&file, text).unwrap();
        Command::new(env!("CARGO_BIN_EXE_flip"))
            .args(words)
            .env("FLIP_SETTINGS", &file)
            .output()
            .unwrap()
    };
    let settings = format!(
        "data_dir = {:?}\njson = true\n[heap]\nfriction = 0.3\ncohesion = 0\n",
        data.to_str().unwrap()
    );
    let by_file = run(&settings, &["heap"]);
    expect_status(&by_file, 0);
    let typed = flip(&data, &["heap", "--friction", "0.3", "--cohesion", "0", "--json"]);
    assert_eq!(document(&by_file), document(&typed));
    let over = run(&settings, &["heap", "--friction", "0.5"]);
    assert_ne!(document(&over)["parameters"], document(&typed)["parameters"]);
    let wrong = run("[heap]\nfricton = 0.3\n", &["heap", "--json"]);
    expect_status(&wrong, 2);
    assert!(
        document(&wrong).to_string().contains("did you mean `friction`"),
        "{}",
        document(&wrong)
    );
    let checked = run("[serve]\nlisten = \"127.0.0.1:9\"\n", &["config", "check", file_name]);
    assert_eq!(
        String::from_utf8(checked.stdout).unwrap().trim(),
        "flip serve --listen 127.0.0.1:9"
    );
    let half = run(
        "[serve]\nlisten = \"127.0.0.1:0\"\ntls_cert = \"c.pem\"\n",
        &["serve", "--data-dir", data.to_str().unwrap()],
    );
    expect_status(&half, 2);
    assert!(stderr(&half).contains("--tls-key"), "{}", stderr(&half));
    // The bench file of `flip bench check --config` is not the settings file.
    let check = run(
        "",
        &[
            "bench",
            "check",
            "--config",
            "/no/such/bench.toml",
            "--data-dir",
            data.to_str().unwrap(),
        ],
    );
    expect_status(&check, 2);
    assert!(
        stderr(&check).contains("/no/such/bench.toml") && !stderr(&check).contains("settings"),
        "{}",
        stderr(&check)
    );
}
