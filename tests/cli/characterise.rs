//! `flip characterise`.

use crate::harness::{document, expect_status, flip, stderr};
use flip_core::domain::parameters::ParameterSet;
use serde_json::{Value, json};
use std::path::Path;

/// A salt that needs no calibration.
pub fn calibrated(data_dir: &Path) {
    expect_status(&flip(data_dir, &["bench", "status"]), 0);
    let set = ParameterSet::default();
    let job = "INSERT INTO job (id, kind, spec, spec_sha256, state, result, created_at, finished_at) \
               VALUES ('toy', 'calibration', '{}', zeroblob(32), 'succeeded', '{}', 0, 0)";
    let row = "INSERT INTO parameter_set (id, powder, calibration, position, parameters, repose_deg, runs, error_deg, created_at) \
               VALUES (?1, 'salt', 'toy', 0, ?2, 36, 1, 0, 0)";
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let options = sqlx::sqlite::SqliteConnectOptions::new().filename(data_dir.join("flip.db"));
        let pool = sqlx::SqlitePool::connect_with(options).await.unwrap();
        sqlx::query(job).execute(&pool).await.unwrap();
        let text = serde_json::to_string(&set).unwrap();
        sqlx::query(row).bind(set.id()).bind(text).execute(&pool).await.unwrap();
        pool.close().await;
    });
}

#[test]
fn a_powder_is_probed_on_the_emulated_bench_and_its_card_survives_until_it_is_forgotten() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path();
    calibrated(data);
    let bench = ["--powder", "salt", "--lot", "L1", "--bench", "emulated", "--json"];
    let probe = [&["characterise", "--spoonfuls", "2"], &bench[..]].concat();
    let output = flip(data, &probe);
    expect_status(&output, 0);
    assert!(stderr(&output).contains("spoonful 2"), "{}", stderr(&output));
    let found = document(&output);
    assert_eq!((&found["outcome"], &found["bench"]), (&json!("probed"), &json!("emulated")));
    let limit_mg = found["limit_mg"].as_f64().unwrap();
    assert!(found["reading_mg"].as_f64().is_some_and(|mg| mg > 0.0 && mg <= limit_mg), "{found}");
    assert_eq!(
        (&found["lots"], &found["card"]["spoonfuls"]),
        (&json!([{ "lot": "L1", "spoonfuls": 2 }]), &json!(2))
    );
    assert!(found["card"]["onset_deg"]["mean"].is_f64() && found["card"]["missing"].is_null());

    // Another process, and no bench: the same card.
    let show = [&["characterise", "--show"], &bench[..]].concat();
    let shown = document(&flip(data, &show));
    let of = |document: &Value| {
        ["powder", "lot", "lots", "last_at", "card"].map(|key| document[key].clone())
    };
    assert_eq!(of(&shown), of(&found));
    let text = flip(data, &show[..show.len() - 1]);
    let text = String::from_utf8(text.stdout).unwrap();
    assert!(text.contains("onset ") && text.contains("90 % of the mean"), "{text}");

    expect_status(&flip(data, &["shakes", "forget", "--powder", "salt"]), 0);
    let gone = document(&flip(data, &show));
    assert!(gone["card"]["missing"].as_str().unwrap().contains("probe the powder"), "{gone}");
}

#[test]
fn what_cannot_be_probed_exits_2() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path();
    for (arguments, field) in [
        (&["--powder", "salt", "--spoonfuls", "10"][..], "spoonfuls"),
        (&["--powder", "salt", "--limit-mg", "-1"][..], "limit_mg"),
    ] {
        let output = flip(data, &[&["characterise"], arguments].concat());
        expect_status(&output, 2);
        assert!(stderr(&output).contains(field), "{}", stderr(&output));
    }
    expect_status(&flip(data, &["characterise", "--powder", "chalk", "--show"]), 2);
}
