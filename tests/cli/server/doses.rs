//! Doses and jobs at a server: poured at most once, waited for, stopped.

use super::proxy::Proxy;
use super::{ask, command};
use crate::characterise::calibrated;
use crate::harness::{Service, document, expect_status, flip, signal, stderr};
use serde_json::{Value, json};
use std::path::Path;
use std::process::{Child, Output, Stdio};
use std::time::Duration;

const DOSE: [&str; 6] = ["weigh", "--powder", "salt", "--target-mg", "8", "--json"];
const PATIENCE: Duration = Duration::from_secs(60);

fn served() -> (tempfile::TempDir, Service) {
    let folder = tempfile::tempdir().unwrap();
    calibrated(folder.path());
    let service = Service::start(folder.path());
    (folder, service)
}

/// States of the weighings in a folder that a server holds.
fn states(data: &Path) -> Vec<String> {
    let query = "SELECT state FROM weighing";
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let options = sqlx::sqlite::SqliteConnectOptions::new().filename(data.join("flip.db"));
        let pool = sqlx::SqlitePool::connect_with(options).await.unwrap();
        let states = sqlx::query_scalar(query).fetch_all(&pool).await.unwrap();
        pool.close().await;
        states
    })
}

#[test]
fn a_dose_whose_answers_are_lost_is_poured_once_and_ends_as_it_would_here() {
    let here = tempfile::tempdir().unwrap();
    calibrated(here.path());
    let alone = flip(here.path(), &DOSE);
    expect_status(&alone, 0);

    let (folder, service) = served();
    let lose = ["POST /v1/weighings ", "GET /v1/weighings/"];
    let proxy = Proxy::to(&service.address(), &lose);
    let there = ask(&proxy.url, service.token(), &DOSE);
    expect_status(&there, 0);
    assert_eq!(proxy.lost.try_iter().collect::<Vec<_>>(), lose);
    assert_eq!(document(&there), document(&alone));
    assert_eq!(states(folder.path()), ["done"]);

    // On a bench where someone confirms the vial, the command does.
    let vial = [&DOSE[..], &["--vial", "V1"]].concat();
    expect_status(&service.ask(&vial), 0);
    assert_eq!(states(folder.path()), ["done", "done"]);
}

#[test]
fn a_list_is_weighed_there_and_asked_for_again_pours_nothing_twice() {
    let (folder, service) = served();
    let file = folder.path().join("plate 7.csv");
    std::fs::write(&file, "powder;target_mg;vial\nSalt;8;V1\n").unwrap();
    let weigh = ["weigh", "--list", file.to_str().unwrap(), "--json"];
    let proxy = Proxy::to(&service.address(), &["POST /v1/weighings/list "]);
    let output = ask(&proxy.url, service.token(), &weigh);
    expect_status(&output, 0);
    let list = document(&output);
    assert_eq!((&list["name"], &list["doses"][0]["state"]), (&json!("plate 7"), &json!("done")));
    // The first answer was lost, so the second says that the list was there.
    assert!(stderr(&output).contains("was begun before"), "{}", stderr(&output));
    assert_eq!(document(&service.ask(&weigh)), list);
    assert_eq!(states(folder.path()), ["done"]);
}

/// Interrupts a command once the proxy has lost an answer, and returns what it said.
fn interrupted(process: Child, proxy: &Proxy) -> Output {
    let lost = proxy.lost.recv_timeout(PATIENCE);
    signal(&process, "INT");
    let output = process.wait_with_output().unwrap();
    assert!(lost.is_ok(), "{}", stderr(&output));
    expect_status(&output, 1);
    output
}

#[test]
fn an_interrupt_stops_the_dose_at_the_server() {
    let (folder, service) = served();
    let proxy = Proxy::to(&service.address(), &["GET /v1/weighings/"]);
    let long = ["weigh", "--powder", "salt", "--target-mg", "36"];
    let mut weigh = command(&proxy.url, service.token(), &long);
    let weigh = weigh.stderr(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let output = interrupted(weigh, &proxy);
    let said = stderr(&output);
    assert!(said.contains("stopped by Ctrl-C: weighing"), "{said}");
    let status = document(&service.ask(&["bench", "status", "--json"]));
    let is_held = status["held"].is_object();
    assert_eq!(is_held, said.contains("the bench is held"), "{said}: {status}");
    assert!(is_held || said.contains("had not begun"), "{said}");
    // A dose that moved levels its spoon first.
    let is_over = || states(folder.path()) == ["aborted"];
    let over =
        (0..600).any(|_| is_over() || (std::thread::sleep(Duration::from_millis(100)), false).1);
    assert!(over, "{:?}", states(folder.path()));
    if is_held {
        expect_status(&service.ask(&DOSE), 1);
        expect_status(&service.ask(&["bench", "resume", "--by", "Ada"]), 0);
    }
}

#[test]
fn an_interrupt_leaves_a_job_at_the_server_and_the_same_command_finds_it() {
    let (_folder, service) = served();
    let calibrate = [
        "calibrate",
        "--powder",
        "sand",
        "--method",
        "sequential",
        "--sets",
        "2",
        "--tolerance-deg",
        "5",
        "--particles",
        "400",
        "--json",
    ];
    let proxy = Proxy::to(&service.address(), &["GET /v1/jobs/"]);
    let mut process = command(&proxy.url, service.token(), &calibrate);
    let process = process.stderr(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let said = stderr(&interrupted(process, &proxy));
    let jobs = document(&service.ask(&["jobs", "--kind", "calibration", "--limit", "1", "--json"]));
    let id = jobs["items"][0]["id"].as_str().unwrap();
    assert!(said.contains(&format!("job {id} goes on at {}", proxy.url)), "{said}");

    let done = service.ask(&calibrate);
    expect_status(&done, 0);
    let found = document(&done);
    assert_eq!(found["powders"][0]["sets"].as_array().map(Vec::len), Some(2), "{found}");
    let here = tempfile::tempdir().unwrap();
    assert_eq!(document(&flip(here.path(), &calibrate)), found);
    let jobs = document(&service.ask(&["jobs", "--kind", "calibration", "--json"]));
    let of_sand = |job: &&Value| job["subject"]["powders"] == json!(["sand"]);
    assert_eq!(jobs["items"].as_array().unwrap().iter().filter(of_sand).count(), 1, "{jobs}");
}
