//! `flip doctor`.

use crate::harness::{command, document, expect_status, flip, stderr};
use flip_testing::s3::{S3, SECRET};
use serde_json::{Value, json};
use sqlx::{Connection, SqliteConnection};
use std::path::Path;
use std::process::Output;

#[test]
fn a_doctor_looks_and_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let looked = flip(&data, &["doctor", "--listen", "127.0.0.1:0", "--json"]);
    expect_status(&looked, 0);
    let found = document(&looked);
    let names: Vec<&str> =
        found.as_array().unwrap().iter().map(|it| it["what"].as_str().unwrap()).collect();
    let expected = [
        "processor",
        "graphics card",
        "memory",
        "clock",
        "descriptors",
        "disk",
        "data folder",
        "port",
    ];
    assert_eq!(names, expected);
    // Whether there is one or not, it is named or the reason is.
    assert_eq!(found[1]["verdict"], json!("ok"));
    assert!(found[1]["found"].as_str().unwrap().len() > 10, "{found}");
    assert!(!data.exists());
    expect_status(&flip(&data, &["jobs"]), 0);
    std::fs::write(folder.path().join("bench.toml"), "[balance]\n").unwrap();
    let bench = folder.path().join("bench.toml");
    let looked = flip(
        &data,
        &["doctor", "--listen", "127.0.0.1:0", "--bench", bench.to_str().unwrap(), "--json"],
    );
    expect_status(&looked, 1);
    let found = document(&looked);
    let of = |what: &str| {
        found.as_array().unwrap().iter().find(|it| it["what"] == what).unwrap()["verdict"].clone()
    };
    assert_eq!((of("database"), of("bench file")), (json!("ok"), json!("failed")));
}

/// Has a row name an artifact that was never there.
async fn name_an_artifact(data: &Path, sha256: &str) {
    let database = format!("sqlite://{}", data.join("flip.db").display());
    let mut connection = SqliteConnection::connect(&database).await.unwrap();
    let insert = "INSERT INTO job (id, kind, spec, spec_sha256, state, created_at, checkpoint) \
                  VALUES ('j-1', 'training', '{}', zeroblob(32), 'queued', 0, $1)";
    sqlx::query(insert).bind(sha256).execute(&mut connection).await.unwrap();
    connection.close().await.unwrap();
}

fn artifacts(looked: &Output) -> Value {
    let found = document(looked);
    found.as_array().unwrap().iter().find(|it| it["what"] == "artifacts").unwrap().clone()
}

#[tokio::test]
async fn a_doctor_names_artifacts_without_a_row_and_rows_without_their_artifact() {
    let (folder, s3) = (tempfile::tempdir().unwrap(), S3::start());
    let (missing, unnamed) = ("ab".repeat(32), "cd".repeat(32));
    for place in [None, Some("s3://lab/flip")] {
        let data = folder.path().join(if place.is_some() { "bucket" } else { "folder" });
        let flip = |words: &[&str]| {
            let mut command = command(&data, words);
            command.envs(s3.variables()).envs(place.map(|place| ("FLIP_ARTIFACTS", place)));
            command.output().unwrap()
        };
        let doctor = ["doctor", "--listen", "127.0.0.1:0", "--thorough", "--json"];
        expect_status(&flip(&["jobs"]), 0);
        let looked = flip(&doctor);
        expect_status(&looked, 0);
        let found = artifacts(&looked);
        assert_eq!(found["found"], "all that rows name are there and whole");
        assert_eq!(found["artifacts"], json!({ "unnamed": [], "lost": [] }));
        name_an_artifact(&data, &missing).await;
        if place.is_some() {
            s3.put(&format!("flip/cd/{unnamed}"), b"x");
        } else {
            std::fs::create_dir_all(data.join("blobs/cd")).unwrap();
            std::fs::write(data.join("blobs/cd").join(&unnamed), "x").unwrap();
        }
        let looked = flip(&doctor);
        expect_status(&looked, 1);
        let found = artifacts(&looked);
        let lost = json!({ "sha256": missing, "named_by": ["job j-1"], "damaged": false });
        assert_eq!(found["artifacts"], json!({ "unnamed": [unnamed], "lost": [lost] }));
        assert_eq!(found["verdict"], "failed");
        let told = found["found"].as_str().unwrap();
        for part in ["1 missing", &missing, "job j-1", "from a backup", &unnamed] {
            assert!(told.contains(part), "{part}: {told}");
        }
    }
}

#[test]
fn artifacts_that_cannot_be_used_are_named_and_their_key_is_not() {
    let (folder, s3) = (tempfile::tempdir().unwrap(), S3::start());
    let data = folder.path().join("data");
    let asked = |artifacts: &str| {
        let words = ["doctor", "--listen", "127.0.0.1:0", "--json", "--artifacts", artifacts];
        command(&data, &words).envs(s3.variables()).output().unwrap()
    };
    let looked = asked("s3://lab/flip");
    expect_status(&looked, 0);
    assert_eq!(artifacts(&looked)["found"], "s3://lab/flip can be reached");
    let looked = asked("s3://other/flip");
    expect_status(&looked, 1);
    assert!(artifacts(&looked)["found"].as_str().unwrap().contains("make the bucket first"));
    for (wrong, why) in [("gs://lab/flip", "gs://"), ("s3://a:b@lab", "AWS_ACCESS_KEY_ID")] {
        let looked = asked(wrong);
        expect_status(&looked, 2);
        let said = stderr(&looked) + &String::from_utf8_lossy(&looked.stdout);
        assert!(said.contains("artifacts") && said.contains(why), "{said}");
        assert!(said.contains("s3://bucket/prefix"), "{said}");
    }
    for looked in [asked("s3://lab/flip"), asked("s3://other/flip")] {
        let said = stderr(&looked) + &String::from_utf8_lossy(&looked.stdout);
        assert!(!said.contains(SECRET), "{said}");
    }
}
