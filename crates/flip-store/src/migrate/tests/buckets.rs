//! Copies whose artifacts are in a bucket, on either side.

use super::made::work;
use super::*;
use crate::artifacts::{Artifacts, Patience};
use flip_testing::s3::{BUCKET, S3};

fn in_bucket(side: Storage, s3: &S3, prefix: &str) -> Storage {
    let address = format!("s3://{BUCKET}/{prefix}");
    let variables = s3.variables().into_iter();
    side.with_artifacts_in(Artifacts::at(&address, variables, Patience::default()).unwrap())
}

/// The keys below a prefix.
fn below(s3: &S3, prefix: &str) -> Vec<String> {
    let keys = s3.keys().into_iter();
    keys.filter_map(|it| Some(it.strip_prefix(prefix)?.to_owned())).collect()
}

/// A store at work, closed again; its answers and one of its artifacts.
async fn worked(side: &Storage) -> (Vec<String>, String) {
    let store = open(side).await;
    let trace = work(&store).await;
    let said = answers(&store).await;
    store.close().await;
    (said, trace)
}

async fn assert_whole(side: &Storage, said: &[String], trace: &str) {
    let store = open(side).await;
    assert_same(&answers(&store).await, said);
    assert_eq!(store.artifacts().get(trace).await.unwrap(), "ticks of a dose, µ".as_bytes());
    assert_eq!(store.check_artifacts(true).await.unwrap().lost, []);
    store.close().await;
}

#[tokio::test]
async fn artifacts_move_from_a_folder_to_a_bucket_and_back() {
    let Some(places) = Places::new() else { return };
    let s3 = S3::start();
    let first = places.folder("first");
    let second = in_bucket(places.server("second").await, &s3, "second/");
    let third = places.folder("third");
    let (said, trace) = worked(&first).await;
    let moved = migrate(&first, &second, &quiet).await.unwrap();
    assert_eq!((moved.files, moved.lost), (2, Vec::new()));
    assert_eq!(below(&s3, "second/"), [format!("{}/{trace}", &trace[..2])]);
    assert!(!places.path("second").join("blobs").exists());
    assert_whole(&second, &said, &trace).await;
    let moved = migrate(&second, &third, &quiet).await.unwrap();
    assert_eq!((moved.files, moved.lost), (2, Vec::new()));
    assert_whole(&third, &said, &trace).await;
    assert!(places.path("third").join("blobs").join(&trace[..2]).join(&trace).exists());
}

#[tokio::test]
async fn a_copy_that_fails_leaves_its_bucket_empty_and_one_that_is_in_use_as_it_is() {
    let Some(places) = Places::new() else { return };
    let s3 = S3::start();
    let first = places.folder("first");
    let (said, trace) = worked(&first).await;
    let second = in_bucket(places.server("second").await, &s3, "second");
    s3.put("second/ab/README", b"theirs");
    let cut_off = |done: CopyProgress<'_>| {
        if matches!(done, CopyProgress::Rows { table: "weighing", .. }) {
            assert_eq!(below(&s3, "second/").len(), 2);
            meanwhile(async {
                let cut = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity \
                           WHERE datname = current_database() AND pid <> pg_backend_pid()";
                url_of(&second).await.execute(cut).await.unwrap();
            });
        }
    };
    let refused = migrate(&first, &second, &cut_off).await.unwrap_err();
    assert!(matches!(refused, Error::Unreachable(_)), "{refused:?}");
    assert_eq!(s3.keys(), ["second/ab/README"]);
    migrate(&first, &second, &quiet).await.unwrap();
    assert_whole(&second, &said, &trace).await;
    // What is in use is not mixed with anything.
    let before = s3.keys();
    let other = in_bucket(places.server("other").await, &s3, "second");
    let refused = migrate(&first, &other, &quiet).await.unwrap_err();
    assert!(matches!(refused, Error::ArtifactsTaken(_)), "{refused}");
    assert_eq!(s3.keys(), before);
    // A database that moves may leave them where they are.
    let stays = in_bucket(places.folder("stays"), &s3, "second");
    migrate(&second, &stays, &quiet).await.unwrap();
    assert_eq!(s3.keys(), before);
    assert_whole(&stays, &said, &trace).await;
}

#[tokio::test]
async fn a_backup_of_a_store_with_a_bucket_is_a_folder_and_comes_back_to_a_bucket() {
    let (s3, folder) = (S3::start(), tempfile::tempdir().unwrap());
    let path = |name: &str| folder.path().join(name);
    let from = in_bucket(Storage::in_folder(path("from")), &s3, "from");
    let (said, trace) = worked(&from).await;
    let wrong = in_bucket(Storage::in_folder(path("from")), &s3, "wrong");
    let refused = backup::copy_of(&wrong, &path("kept"), &quiet).await.unwrap_err();
    assert!(matches!(refused, Error::ArtifactsTaken(_)), "{refused}");
    let made = backup::copy_of(&from, &path("kept"), &quiet).await.unwrap();
    assert_eq!((made.files, &made.lost), (2, &Vec::new()));
    assert_whole(&Storage::in_folder(path("kept")), &said, &trace).await;
    let back = in_bucket(Storage::in_folder(path("back")), &s3, "back");
    let made = backup::restore_to(&path("kept"), &back, true, &quiet).await.unwrap();
    assert_eq!((made.files, &made.lost), (2, &Vec::new()));
    assert!(!path("back").join("blobs").exists());
    let store = open(&back).await;
    assert!(store.artifacts().get(&trace).await.is_ok());
    let taken = in_bucket(Storage::in_folder(path("again")), &s3, "back");
    let refused = backup::restore_to(&path("kept"), &taken, true, &quiet).await.unwrap_err();
    assert!(matches!(refused, Error::ArtifactsTaken(_)), "{refused}");
    assert!(!path("again").exists());
}
