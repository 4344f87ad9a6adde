//! Commands alongside a running `flip serve`, each in its own process: tokens, backups, and starts
//! that are refused.

use crate::harness::Service;
use serde_json::{Value, json};
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

async fn add_powder(service: &Service, token: &str, id: &str) -> u16 {
    let new = json!({ "id": id, "name": id });
    let request =
        service.client.post(format!("{}/v1/powders", service.url)).bearer_auth(token).json(&new);
    request.send().await.unwrap().status().as_u16()
}

/// What a command says. One that serves although it should refuse is ended after a while.
fn flip(data_dir: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new("timeout");
    command
        .args(["60", env!("CARGO_BIN_EXE_flip")])
        .args(arguments)
        .arg("--data-dir")
        .arg(data_dir)
        .env_remove("FLIP_LOG")
        .output()
        .unwrap()
}

fn document(output: &Output) -> Value {
    let said = || String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{}", said());
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: {}", said()))
}

/// Everything below a folder, by name and content.
fn contents(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap().map(Result::unwrap) {
        match entry.path().is_dir() {
            true => found.extend(contents(&entry.path())),
            false => {
                found.push((entry.path().display().to_string(), fs::read(entry.path()).unwrap()))
            }
        }
    }
    found.sort();
    found
}

/// Name and niceness of every thread of a process.
fn threads(process: u32) -> Vec<(String, i32)> {
    let tasks = fs::read_dir(format!("/proc/{process}/task")).unwrap();
    let texts = tasks.filter_map(|task| fs::read_to_string(task.ok()?.path().join("stat")).ok());
    let read = |text: String| {
        let (before, after) = text.split_once(") ").unwrap();
        // The 19th field of proc(5), counted from the first.
        let niceness = after.split(' ').nth(16).unwrap().parse().unwrap();
        (before.split_once('(').unwrap().1.to_owned(), niceness)
    };
    texts.map(read).collect()
}

#[tokio::test]
async fn threads_that_read_stops_and_drive_the_bench_go_before_those_that_answer() {
    let folder = tempfile::tempdir().unwrap();
    let service = Service::start(folder.path());
    // Answered by the main runtime, from a thread of its database.
    service.get("/v1/powders").await;
    let threads = threads(service.id());
    let of = |name: &str| {
        let found: Vec<i32> =
            threads.iter().filter(|(it, _)| it.starts_with(name)).map(|(_, nice)| *nice).collect();
        assert!(!found.is_empty(), "no thread {name}: {threads:?}");
        found
    };
    let ours = of("flip");
    for first in ["front", "bench", "stop"] {
        assert!(of(first).iter().all(|nice| *nice == ours[0]), "{first}: {threads:?}");
    }
    assert!(of("tokio").iter().all(|nice| *nice > ours[0]), "{threads:?}");
}

#[tokio::test]
async fn tokens_are_made_listed_and_revoked_while_the_service_runs() {
    let folder = tempfile::tempdir().unwrap();
    let service = Service::start(folder.path());
    assert!(service.token.is_some());
    let made = document(&flip(
        folder.path(),
        &[
            "token",
            "create",
            "--role",
            "operator",
            "--name",
            "robot",
            "--may-clear",
            "--expires-in",
            "1h",
            "--json",
        ],
    ));
    let secret = made["token"].as_str().unwrap();
    assert_eq!(add_powder(&service, secret, "flour").await, 201);
    let list = document(&flip(folder.path(), &["token", "list", "--json"]));
    let text = list.to_string();
    assert!(
        text.contains("robot") && text.contains("first start") && !text.contains(secret),
        "{text}"
    );
    assert_eq!(list["items"][1]["role"], "admin", "who starts the service first makes the others");
    let id = made["id"].as_str().unwrap();
    document(&flip(folder.path(), &["token", "revoke", id, "--json"]));
    while add_powder(&service, secret, "rye").await != 401 {
        tokio::task::yield_now().await;
    }
    let verified = document(&flip(folder.path(), &["audit", "verify", "--json"]));
    assert_eq!(verified["broken"], Value::Null);
    assert_eq!(flip(folder.path(), &["token", "revoke", "0000"]).status.code(), Some(2));
}

#[tokio::test]
async fn the_record_is_archived_beside_a_service_and_a_day_that_is_none_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let _service = Service::start(folder.path());
    let done =
        document(&flip(folder.path(), &["audit", "archive", "--before", "2026-11-26", "--json"]));
    assert_eq!((&done["records"], &done["files"]), (&json!(0), &json!([])), "no dose is there");
    let refused = flip(folder.path(), &["audit", "archive", "--before", "26.11.2026"]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(
        String::from_utf8_lossy(&refused.stderr).contains("before: must be a day"),
        "{refused:?}"
    );
}

#[tokio::test]
async fn a_backup_while_serving_holds_what_was_committed_and_is_restored_after_a_kill() {
    let folder = tempfile::tempdir().unwrap();
    let (data, kept, back) =
        (folder.path().join("data"), folder.path().join("kept"), folder.path().join("back"));
    let service = Service::start(&data);
    let token = service.token.clone().unwrap();
    for k in 0..20 {
        assert_eq!(add_powder(&service, &token, &format!("powder_{k}")).await, 201);
    }
    let kept_name = kept.to_str().unwrap();
    let made = document(&flip(&data, &["backup", kept_name, "--json"]));
    assert_eq!((&made["lost"], &made["audit_broken"]), (&json!([]), &Value::Null), "{made}");
    let again = flip(&data, &["backup", kept_name]);
    assert_eq!(again.status.code(), Some(2), "nothing is written over");
    service.kill();

    let before = contents(&kept);
    let restored = document(&flip(&back, &["restore", kept_name, "--json"]));
    assert_eq!(restored["last_hash"], made["last_hash"]);
    assert_eq!(contents(&kept), before, "the backup stays as it is");
    assert_eq!(flip(&back, &["restore", kept_name]).status.code(), Some(2), "nor here");
    let hash = made["last_hash"].as_str().unwrap();
    assert_eq!(
        document(&flip(&back, &["audit", "verify", "--hash", hash, "--json"]))["holds_hash"],
        true
    );
    let service = Service::start(&back);
    assert_eq!(service.token, None, "it has tokens");
    assert_eq!(restored["revoked_tokens"], 1, "{restored}");
    assert_eq!(add_powder(&service, &token, "flour").await, 401, "none of before opens");
    let made = document(&flip(
        &back,
        &["token", "create", "--role", "operator", "--name", "new", "--json"],
    ));
    let token = made["token"].as_str().unwrap();
    let why = service.get("/v1/bench").await["held"]["reason"].as_str().unwrap().to_owned();
    assert!(why.starts_with("restored from a backup of "), "its bench waits for a person: {why}");
    for k in 0..20 {
        assert_eq!(
            add_powder(&service, token, &format!("powder_{k}")).await,
            409,
            "powder_{k} is there"
        );
    }
    service.kill();
}

#[test]
fn a_start_without_its_database_beside_blobs_is_refused_and_deletes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    document(&flip(&data, &["jobs", "--json"]));
    let blob = data.join("blobs/ab").join("ab".repeat(32));
    fs::create_dir_all(blob.parent().unwrap()).unwrap();
    fs::write(&blob, b"a trace").unwrap();
    let database = data.join("flip.db");
    let removed = fs::read(&database).unwrap();
    for empty in [false, true] {
        fs::remove_file(&database).unwrap();
        if empty {
            fs::write(&database, b"").unwrap();
        }
        for arguments in [&["serve", "--listen", "127.0.0.1:0"][..], &["jobs"]] {
            let refused = flip(&data, arguments);
            let said = String::from_utf8_lossy(&refused.stderr).into_owned();
            assert!(
                !refused.status.success() && said.contains("flip.db is missing or empty"),
                "{said}"
            );
        }
        assert!(blob.exists());
        fs::write(&database, &removed).unwrap();
        assert!(flip(&data, &["jobs"]).status.success() && blob.exists(), "put back, it starts");
    }
}

#[tokio::test]
async fn a_database_of_a_newer_flip_is_refused_and_so_is_a_damaged_one() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    document(&flip(&data, &["jobs", "--json"]));
    let database = data.join("flip.db");
    let sound = fs::read(&database).unwrap();
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(&database);
    let pool = sqlx::sqlite::SqlitePool::connect_with(options).await.unwrap();
    let newer = "INSERT INTO _sqlx_migrations (version, description, success, checksum, execution_time) VALUES (99, 'later', 1, x'00', 0)";
    sqlx::query(newer).execute(&pool).await.unwrap();
    pool.close().await;
    for arguments in [&["serve", "--listen", "127.0.0.1:0"][..], &["jobs"], &["backup", "copy"]] {
        let refused = flip(&data, arguments);
        let said = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(!refused.status.success() && said.contains("newer FLIP"), "{arguments:?}: {said}");
    }
    let mut damaged = sound.clone();
    let half = damaged.len() / 2;
    damaged[half..].fill(0x5a);
    for bytes in [damaged, b"no database at all, but a text of some length".to_vec()] {
        fs::write(&database, &bytes).unwrap();
        let refused = flip(&data, &["serve", "--listen", "127.0.0.1:0"]);
        let said = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(
            !refused.status.success() && said.contains("damaged") && said.contains("flip restore"),
            "{said}"
        );
        assert_eq!(fs::read(&database).unwrap(), bytes, "nothing was changed");
    }
    fs::write(&database, &sound).unwrap();
    assert!(flip(&data, &["jobs"]).status.success());
}

#[test]
fn what_flip_makes_is_for_its_user_alone() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    document(&flip(&data, &["jobs", "--json"]));
    let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
    assert_eq!((mode(&data), mode(&data.join("flip.db"))), (0o700, 0o600));
}
