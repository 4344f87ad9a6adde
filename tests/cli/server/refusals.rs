//! What a server does not take, in the words and with the exit status of the command line.

use super::ask;
use crate::characterise::calibrated;
use crate::harness::{Service, document, expect_status, stderr};
use serde_json::json;

fn expect(output: &std::process::Output, status: i32, parts: &[&str]) {
    expect_status(output, status);
    let said = stderr(output);
    assert!(parts.iter().all(|part| said.contains(part)), "{parts:?} in {said}");
}

#[test]
fn refusals_name_the_option_the_token_or_the_address() {
    let folder = tempfile::tempdir().unwrap();
    calibrated(folder.path());
    let service = Service::start(folder.path());
    let url = service.url();
    let dose = ["weigh", "--powder", "salt", "--target-mg"];
    let large = service.ask(&[&dose[..], &["1e6", "--json"]].concat());
    expect_status(&large, 2);
    assert_eq!(document(&large)["error"]["errors"][0]["field"], json!("target_mg"));
    let unknown = service.ask(&[&dose[..], &["8", "--policy", "p-0"]].concat());
    expect(&unknown, 2, &["policy: there is no policy `p-0`"]);
    let train = service.ask(&["train", "--episodes", "0"]);
    expect(&train, 2, &["episodes"]);

    let viewer = document(&service.ask(&["token", "create", "--role", "viewer", "--json"]));
    let viewer = viewer["token"].as_str().unwrap();
    expect_status(&ask(&url, viewer, &["jobs"]), 0);
    let said = ["FLIP_TOKEN", "operator", &url];
    expect(&ask(&url, viewer, &[&dose[..], &["8"]].concat()), 2, &said);
    expect(&ask(&url, "flip_wrong", &["jobs"]), 2, &["FLIP_TOKEN", &url]);
    expect(&ask(&url, "two words", &["jobs"]), 2, &["FLIP_TOKEN: must hold a token alone"]);

    let file = folder.path().join("token");
    std::fs::write(&file, format!("{}\n", service.token())).unwrap();
    let list = ["token", "list", "--token-file", file.to_str().unwrap()];
    expect_status(&ask(&format!("{url}/"), "flip_wrong", &list), 0);
    let gone = ["token", "list", "--token-file", "/nowhere/token"];
    expect(&ask(&url, "", &gone), 2, &["token_file: /nowhere/token cannot be read"]);
    expect(&ask(&format!("{url}/elsewhere"), "", &["jobs"]), 2, &["server"]);
}

#[test]
fn a_server_that_is_not_there_is_named_at_once() {
    let silent = ask("http://127.0.0.1:1", "", &["jobs"]);
    expect(&silent, 1, &["http://127.0.0.1:1", "flip serve"]);
    for wrong in ["127.0.0.1:8080", "ftp://lab", "http://lab?x"] {
        let refused = ask(wrong, "", &["jobs", "--json"]);
        expect(&refused, 2, &["--server", "http://127.0.0.1:8080"]);
        assert_eq!(document(&refused)["error"]["kind"], "bad_input");
    }
}

#[test]
fn what_a_server_has_itself_is_left_out_and_a_settings_file_gives_way() {
    let of = |arguments: &[&str]| ask("http://127.0.0.1:1", "", arguments);
    let weigh = ["weigh", "--powder", "salt", "--target-mg", "8"];
    let bench = of(&[&weigh[..], &["--bench", "emulated"]].concat());
    expect(&bench, 2, &["bench: the server has its own bench: leave --bench out"]);
    let folder = of(&[&weigh[..], &["--data-dir", "x"]].concat());
    expect(&folder, 2, &["data_dir: the server has its own data folder"]);

    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("flip.toml");
    std::fs::write(&file, "data_dir = \"x\"\n[weigh]\nbench = \"emulated\"\n").unwrap();
    let settings = ["--settings", file.to_str().unwrap()];
    expect(&of(&[&weigh[..], &settings].concat()), 1, &["http://127.0.0.1:1"]);
}

#[test]
fn a_server_in_a_settings_file_is_asked_by_the_commands_that_can_and_no_others() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("flip.toml");
    std::fs::write(&file, "server = \"http://127.0.0.1:1\"\ndata_dir = \"x\"\n").unwrap();
    let run = |arguments: &[&str]| {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_flip"));
        command.args(arguments).args(["--settings", file.to_str().unwrap()]);
        command.current_dir(folder.path()).env_remove("FLIP_TOKEN").output().unwrap()
    };
    expect(&run(&["jobs"]), 1, &["http://127.0.0.1:1"]);
    expect_status(&run(&["completions", "bash"]), 0);
    // What is typed goes before the file.
    expect_status(&run(&["jobs", "--data-dir", "here"]), 0);
    assert!(folder.path().join("here").exists() && !folder.path().join("x").exists());
}
