//! `flip bench`.

use crate::harness::{document, expect_status, flip, stderr};
use serde_json::json;

#[test]
fn a_latched_bench_of_devices_is_not_cleared_by_a_command_that_has_another_bench() {
    let folder = tempfile::tempdir().unwrap();
    expect_status(&flip(folder.path(), &["bench", "status"]), 0);
    let latch = "INSERT INTO latch (at, reason, bench) VALUES (1, 'a device failed', 'devices')";
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let options =
            sqlx::sqlite::SqliteConnectOptions::new().filename(folder.path().join("flip.db"));
        let pool = sqlx::SqlitePool::connect_with(options).await.unwrap();
        sqlx::query(latch).execute(&pool).await.unwrap();
        pool.close().await;
    });
    let clear = ["bench", "clear", "--by", "Ada", "--looked", "--vial-ready"];
    let refused = flip(folder.path(), &clear);
    expect_status(&refused, 2);
    assert!(stderr(&refused).contains("--bench FILE"), "{}", stderr(&refused));
    let status = document(&flip(folder.path(), &["bench", "status", "--json"]));
    assert_eq!(
        (&status["latch"]["reason"], &status["held"]),
        (&json!("a device failed"), &json!(null))
    );
}

#[test]
fn a_bench_is_reserved_and_released_on_the_command_line_and_only_a_held_one_is_resumed() {
    let folder = tempfile::tempdir().unwrap();
    let refused = flip(folder.path(), &["bench", "resume", "--by", "Ada"]);
    expect_status(&refused, 2);
    assert!(stderr(&refused).contains("not held"), "{}", stderr(&refused));
    let reserved = document(&flip(
        folder.path(),
        &["bench", "reserve", "--owner", "Ada", "--seconds", "600", "--json"],
    ));
    let id = reserved["id"].as_str().unwrap();
    let status = document(&flip(folder.path(), &["bench", "status", "--json"]));
    assert_eq!(status["reservation"], reserved);
    expect_status(&flip(folder.path(), &["bench", "release", id]), 0);
    expect_status(&flip(folder.path(), &["bench", "release", id]), 2);
}

#[test]
fn the_balance_is_read_and_tared_on_the_command_line_where_there_is_one() {
    let folder = tempfile::tempdir().unwrap();
    let ask =
        |verb: &str, bench: &str| flip(folder.path(), &["bench", verb, "--bench", bench, "--json"]);
    let shown = document(&ask("read", "emulated"));
    assert!((shown["mass_mg"].as_f64().unwrap() - 12_000.0).abs() < 5.0, "{shown}");
    let tared = document(&ask("tare", "emulated"));
    assert!(tared["mass_mg"].as_f64().unwrap().abs() <= 2.0, "{tared}");
    let refused = ask("read", "simulated");
    expect_status(&refused, 2);
    assert!(stderr(&refused).contains("--bench emulated"), "{}", stderr(&refused));
}

#[test]
fn bench_writes_the_same_bed_twice_as_centres_in_metres() {
    let folder = tempfile::tempdir().unwrap();
    let bed = || {
        let file = folder.path().join("bed.csv");
        let output = flip(
            folder.path(),
            &["bench", "bed", "--particles", "150", file.to_str().unwrap(), "--json"],
        );
        expect_status(&output, 0);
        assert_eq!(document(&output)["particles"], 150);
        std::fs::read_to_string(file).unwrap()
    };
    let first = bed();
    assert_eq!(first.lines().count(), 150);
    for line in first.lines() {
        let centre: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
        assert!(
            centre.len() == 3 && centre.iter().all(|m| m.abs() < 0.005) && centre[2] > 0.0001,
            "{line}"
        );
    }
    assert_eq!(first, bed());
}
