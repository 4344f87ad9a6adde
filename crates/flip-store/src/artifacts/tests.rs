//! What holds for artifacts in a folder and in a bucket.

use super::*;
use crate::{Storage, testing};
use flip_testing::disk::Disk;
use flip_testing::s3::{self, S3};
use std::fs;
use std::net::TcpListener;
use std::path::Path;
use std::time::Instant;
use tempfile::TempDir;

/// A place for artifacts, and how somebody else changes what is in it.
struct Tried {
    artifacts: Artifacts,
    folder: TempDir,
    s3: Option<S3>,
}

impl Tried {
    fn each() -> [Self; 2] {
        let folder = || tempfile::tempdir().unwrap();
        let (here, s3) = (folder(), S3::start());
        [
            Self {
                artifacts: Artifacts::in_folder(here.path().to_owned()),
                folder: here,
                s3: None,
            },
            Self { artifacts: in_bucket(&s3, "north"), folder: folder(), s3: Some(s3) },
        ]
    }

    fn put(&self, key: &str, bytes: &[u8]) {
        let Some(s3) = &self.s3 else {
            let path = self.folder.path().join(key);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            return fs::write(path, bytes).unwrap();
        };
        s3.put(&format!("north/{key}"), bytes);
    }

    /// Everything that is there, in order.
    fn keys(&self) -> Vec<String> {
        let Some(s3) = &self.s3 else {
            let mut found = Vec::new();
            let mut folders = vec![self.folder.path().to_owned()];
            while let Some(folder) = folders.pop() {
                for entry in fs::read_dir(folder).unwrap() {
                    let path = entry.unwrap().path();
                    if path.is_dir() {
                        folders.push(path);
                        continue;
                    }
                    let key = path.strip_prefix(self.folder.path()).unwrap();
                    found.push(key.to_str().unwrap().to_owned());
                }
            }
            found.sort();
            return found;
        };
        s3.keys().into_iter().filter_map(|it| Some(it.strip_prefix("north/")?.to_owned())).collect()
    }
}

/// One that gives up soon.
const HASTY: Patience = Patience {
    retry: Duration::from_millis(1500),
    connect: Duration::from_secs(2),
    request: Duration::from_secs(2),
};

fn in_bucket(s3: &S3, prefix: &str) -> Artifacts {
    let address = format!("s3://{}/{prefix}", s3::BUCKET);
    Artifacts::at(&address, s3.variables().into_iter(), HASTY).unwrap()
}

fn path(sha256: &str) -> String {
    format!("{}/{sha256}", &sha256[..2])
}

/// Something asynchronous is tried for each place.
async fn for_each(test: impl AsyncFn(&Tried)) {
    for tried in Tried::each() {
        test(&tried).await;
    }
}

async fn open_in(bucket: Artifacts, folder: &TempDir) -> Result<Store> {
    let storage = testing::storage(folder.path()).await;
    Store::open(storage.with_artifacts_in(bucket)).await
}

#[tokio::test]
async fn files_that_no_row_names_and_rows_whose_file_is_lost_are_listed() {
    for_each(async |tried| {
        let folder = tempfile::tempdir().unwrap();
        let store = open_in(tried.artifacts.clone(), &folder).await.unwrap();
        let put = async |text: &str| store.artifacts().put(text.as_bytes()).await.unwrap();
        let (whole, damaged, unnamed) =
            (put("whole").await, put("damaged").await, put("unnamed").await);
        let gone = sha256_hex(b"gone");
        let insert = "INSERT INTO job (id, kind, spec, spec_sha256, state, created_at, checkpoint, finished_at, result) \
                      VALUES ($1, $2, '{}', $3, $4, 0, $5, $6, $7)";
        let film = format!(r#"{{"sha256":"{damaged}"}}"#);
        let rows = [
            ("a", "training", "queued", Some(&whole), None, None),
            ("b", "film", "succeeded", Some(&gone), Some(1_i64), Some(&film)),
            ("c", "training", "queued", Some(&gone), None, None),
        ];
        for (id, kind, state, checkpoint, finished_at, result) in rows {
            let row = sqlx::query(insert)
                .bind(id)
                .bind(kind)
                .bind(sha256_hex(id.as_bytes()).into_bytes()[..32].to_vec());
            let row = row.bind(state).bind(checkpoint).bind(finished_at).bind(result);
            row.execute(store.writer().unwrap()).await.unwrap();
        }
        let pile = format!(r#"{{"frames":[{{"depth":"{whole}"}},{{"depth":"{gone}"}}]}}"#);
        let sql = "INSERT INTO pile (job, number, body) VALUES ('a', 1, $1)";
        sqlx::query(sql).bind(pile).execute(store.writer().unwrap()).await.unwrap();
        tried.put(&path(&damaged), b"otherwise");
        let lost = |sha256: &String, named_by: &[&str], damaged| LostArtifact {
            sha256: sha256.clone(),
            named_by: named_by.iter().map(|it| (*it).to_owned()).collect(),
            damaged,
        };
        let found = store.check_artifacts(false).await.unwrap();
        let gone = lost(&gone, &["job b", "job c", "pile 1 of job a"], false);
        assert_eq!(found, Disagreement { unnamed: vec![unnamed], lost: vec![gone.clone()] });
        let mut both = vec![gone, lost(&damaged, &["job b"], true)];
        both.sort_by(|a, b| a.sha256.cmp(&b.sha256));
        assert_eq!(store.check_artifacts(true).await.unwrap().lost, both);
    })
    .await;
}

#[tokio::test]
async fn bytes_come_back_under_their_hash_and_damage_is_noticed() {
    for_each(async |tried| {
        let artifacts = &tried.artifacts;
        let sha256 = artifacts.put(b"weights").await.unwrap();
        assert_eq!(artifacts.put(b"weights").await.unwrap(), sha256);
        assert_eq!(artifacts.get(&sha256).await.unwrap(), b"weights");
        assert_eq!(tried.keys(), [path(&sha256)]);
        tried.put(&path(&sha256), b"weighs");
        assert!(matches!(artifacts.get(&sha256).await, Err(Error::Corrupt(_))));
        let none = artifacts.get(&"0".repeat(64)).await.unwrap_err();
        assert!(none.is_lost_part() && matches!(none, Error::File { .. }), "{none}");
    })
    .await;
}

#[tokio::test]
async fn sweeping_removes_what_no_row_names() {
    for_each(async |tried| {
        let artifacts = &tried.artifacts;
        let kept = artifacts.put(b"kept").await.unwrap();
        let lost = artifacts.put(b"lost").await.unwrap();
        let named = HashSet::from([kept.clone()]);
        artifacts.sweep(&named, Duration::ZERO).await.unwrap();
        assert_eq!(artifacts.get(&kept).await.unwrap(), b"kept");
        assert!(artifacts.get(&lost).await.is_err());
    })
    .await;
}

#[tokio::test]
async fn sweeping_removes_half_written_files_in_a_folder() {
    let [tried, _] = Tried::each();
    let artifacts = &tried.artifacts;
    let kept = artifacts.put(b"kept").await.unwrap();
    for half in [format!("{}#1", path(&kept)), format!("{}/0190.part", &kept[..2])] {
        tried.put(&half, b"half");
    }
    let named = HashSet::from([kept.clone()]);
    artifacts.sweep(&named, SWEEP_GRACE).await.unwrap();
    assert_eq!(tried.keys().len(), 3, "somebody may be writing them");
    artifacts.sweep(&named, Duration::ZERO).await.unwrap();
    assert_eq!(tried.keys(), [path(&kept)]);
}

#[tokio::test]
async fn sweeping_spares_what_is_young_and_what_is_so_much_that_the_rows_must_be_missing() {
    for_each(async |tried| {
        let artifacts = &tried.artifacts;
        let young = artifacts.put(b"a restore brought it a moment ago").await.unwrap();
        artifacts.sweep(&HashSet::new(), SWEEP_GRACE).await.unwrap();
        assert!(artifacts.get(&young).await.is_ok());
        for k in 0..=SWEPT_MAX {
            artifacts.put(&k.to_le_bytes()).await.unwrap();
        }
        artifacts.sweep(&HashSet::new(), Duration::ZERO).await.unwrap();
        assert_eq!(tried.keys().len(), SWEPT_MAX + 2);
    })
    .await;
}

#[tokio::test]
async fn files_and_folders_of_others_are_neither_removed_nor_in_the_way() {
    for_each(async |tried| {
        let artifacts = &tried.artifacts;
        let kept = artifacts.put(b"kept").await.unwrap();
        let foreign =
            ["README", "0f", "lost+found/x", ".snapshot/ab/y", "cd/notes.txt", "cd/deeper/z"];
        foreign.iter().for_each(|name| tried.put(name, b"theirs"));
        artifacts.sweep(&HashSet::from([kept.clone()]), Duration::ZERO).await.unwrap();
        assert_eq!(tried.keys().len(), foreign.len() + 1);
        assert!(artifacts.get(&kept).await.is_ok());
    })
    .await;
    let [tried, _] = Tried::each();
    tried.put("README", b"theirs");
    assert!(!tried.artifacts.any_in_data_folder().unwrap());
    tried.artifacts.put(b"ours").await.unwrap();
    assert!(tried.artifacts.any_in_data_folder().unwrap());
}

#[tokio::test]
async fn a_bucket_that_is_busy_for_a_moment_is_asked_again() {
    let s3 = S3::start();
    let artifacts = in_bucket(&s3, "north");
    s3.refuse(3, 503);
    let sha256 = artifacts.put(b"weights").await.unwrap();
    s3.refuse(2, 500);
    assert_eq!(artifacts.get(&sha256).await.unwrap(), b"weights");
    assert_eq!(s3.requests().len(), 4 + 3);
    // The bytes are there, and nobody said so: written again, they are the same.
    s3.hang_up(2);
    assert_eq!(artifacts.put(b"weights").await.unwrap(), sha256);
    assert_eq!(s3.keys(), [format!("north/{}", path(&sha256))]);
    assert_eq!(artifacts.get(&sha256).await.unwrap(), b"weights");
}

#[tokio::test]
async fn a_bucket_that_cannot_be_used_is_named_with_what_to_do() {
    let s3 = S3::start();
    let at = |address: &str, variables: [(String, String); 3]| {
        Artifacts::at(address, variables.into_iter(), HASTY).unwrap()
    };
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let nobody = s3::variables(&format!("http://{free}"));
    let mut other_key = s3.variables();
    other_key[1].1 = "somebody".to_owned();
    let address = "s3://lab/north";
    let sha256 = sha256_hex(b"weights");
    for (artifacts, is_away, advice) in [
        (at(address, nobody), true, "Connection refused"),
        (at(address, other_key), false, "check AWS_ACCESS_KEY_ID"),
        (at("s3://nothing/north", s3.variables()), false, "make the bucket first"),
    ] {
        let started = Instant::now();
        for error in [
            artifacts.put(b"weights").await.err(),
            artifacts.get(&sha256).await.err(),
            artifacts.files().await.err(),
            artifacts.claim("01", false).await.err(),
        ] {
            let error = error.unwrap();
            assert_eq!(matches!(error, Error::ArtifactsAway { .. }), is_away, "{error}");
            assert!(!error.is_lost_part(), "{error}");
            let said = error.to_string();
            assert!(said.contains(advice) && said.contains(&artifacts.to_string()), "{said}");
            assert!(!said.contains(s3::SECRET) && said.len() < 400, "{said}");
        }
        assert!(started.elapsed() < Duration::from_secs(25), "{:?}", started.elapsed());
    }
    // Who knows nothing of S3 does not say that a file is lost.
    s3.refuse(1, 404);
    let error = in_bucket(&s3, "north").get(&sha256).await.unwrap_err();
    assert!(matches!(error, Error::Artifacts { .. }) && !error.is_lost_part(), "{error}");
    assert!(error.to_string().contains("AWS_ENDPOINT"), "{error}");
    s3.refuse(1000, 503);
    let error = in_bucket(&s3, "north").put(b"weights").await.unwrap_err();
    assert!(matches!(error, Error::ArtifactsAway { .. }), "{error}");
}

#[tokio::test]
async fn keys_that_are_half_there_or_missing_are_named() {
    let at = |variables: &[(&str, &str)]| {
        let variables = variables.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned()));
        Artifacts::at("s3://lab/north", variables.collect::<Vec<_>>().into_iter(), HASTY)
    };
    let refused = at(&[("AWS_ACCESS_KEY_ID", "lab")]).unwrap_err().to_string();
    assert!(refused.to_lowercase().contains("secret"), "{refused}");
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let endpoint = format!("http://{free}");
    let none = at(&[("AWS_ENDPOINT", &endpoint), ("AWS_METADATA_ENDPOINT", &endpoint)]).unwrap();
    let refused = none.put(b"weights").await.unwrap_err().to_string();
    assert!(refused.contains("AWS_ACCESS_KEY_ID is not set"), "{refused}");
}

#[tokio::test]
async fn a_store_keeps_its_artifacts_in_a_bucket_and_nothing_of_them_in_its_folder() {
    let (s3, folder) = (S3::start(), tempfile::tempdir().unwrap());
    let store = open_in(in_bucket(&s3, "north"), &folder).await.unwrap();
    let kept = store.artifacts().put(b"kept").await.unwrap();
    let unnamed = store.artifacts().put(b"unnamed").await.unwrap();
    let insert = "INSERT INTO job (id, kind, spec, spec_sha256, state, created_at, checkpoint) \
                  VALUES ('a', 'training', '{}', $1, 'queued', 0, $2)";
    let row = sqlx::query(insert).bind(vec![7_u8; 32]).bind(&kept);
    row.execute(store.writer().unwrap()).await.unwrap();
    s3.age(2 * SWEEP_GRACE);
    let young = store.artifacts().put(b"young").await.unwrap();
    store.forget_artifact(&kept).await.unwrap();
    store.close().await;
    drop(store);
    let store = open_in(in_bucket(&s3, "north"), &folder).await.unwrap();
    assert_eq!(store.artifacts().get(&kept).await.unwrap(), b"kept");
    assert!(store.artifacts().get(&unnamed).await.is_err());
    store.forget_artifact(&young).await.unwrap();
    assert_eq!(s3.keys(), [format!("north/{}", path(&kept)), "north/installation".to_owned()]);
    assert!(!folder.path().join("blobs").exists());
}

#[tokio::test]
async fn two_databases_do_not_share_artifacts_and_a_worker_names_those_of_its_own() {
    let s3 = S3::start();
    for there in ["bucket", "folder"] {
        let [one, other, shared] = [0; 3].map(|_| tempfile::tempdir().unwrap());
        let artifacts = |prefix: &str| match there {
            "bucket" => in_bucket(&s3, prefix),
            _ => {
                let folder = shared.path().join(prefix);
                Artifacts::at(folder.to_str().unwrap(), [].into_iter(), HASTY).unwrap()
            }
        };
        let store = open_in(artifacts("north"), &one).await.unwrap();
        let refused = open_in(artifacts("north"), &other).await.unwrap_err();
        assert!(matches!(refused, Error::ArtifactsTaken(_)), "{refused}");
        open_in(artifacts("south"), &other).await.unwrap();
        store.join_artifacts().await.unwrap();
        let storage = testing::storage(one.path()).await;
        for (prefix, why) in [("south", "another database"), ("east", "no artifacts of this")] {
            let beside = storage.clone().with_artifacts_in(artifacts(prefix));
            let beside = Store::open_beside(beside).await.unwrap();
            let refused = beside.join_artifacts().await.unwrap_err();
            let said = refused.to_string();
            assert!(matches!(refused, Error::ArtifactsTaken(_)) && said.contains(why), "{said}");
        }
    }
}

#[test]
fn a_storage_says_where_its_artifacts_are() {
    let folder = Storage::in_folder("flip-data");
    assert_eq!(folder.artifacts().to_string(), "flip-data/blobs");
    let elsewhere = folder.with_artifacts("file:///srv/flip").unwrap();
    assert_eq!(elsewhere.artifacts().to_string(), "/srv/flip");
    assert_eq!(elsewhere.folder(), Path::new("flip-data"));
    assert!(format!("{elsewhere:?}").contains("/srv/flip"));
}

#[tokio::test]
async fn a_full_disk_refuses_a_file_whole_and_a_start_only_where_no_other_start_was() {
    let folder = tempfile::tempdir().unwrap();
    let mut disk = match Disk::mounted(folder.path()) {
        Ok(disk) => disk,
        Err(why) => return println!("skipped: a disk that can be full: {why}"),
    };
    let artifacts = |below: &str| {
        let at = folder.path().join(below);
        Artifacts::at(at.to_str().unwrap(), std::iter::empty(), HASTY).unwrap()
    };
    let (known, unknown) = (artifacts("known"), artifacts("unknown"));
    known.claim("north", false).await.unwrap();
    let kept = known.put(b"there was room").await.unwrap();
    disk.fill().unwrap();
    let bytes = vec![7; 1 << 20];
    let refused = known.put(&bytes).await.unwrap_err();
    assert!(refused.is_full() && refused.may_pass(), "{refused:?}");
    let found = known.files().await.unwrap();
    let names: Vec<&str> = found.iter().map(|it| it.name.as_str()).collect();
    assert_eq!(names, [&kept], "nothing half-written");
    known.claim("north", false).await.unwrap();
    assert_eq!(known.get(&kept).await.unwrap(), b"there was room");
    let another = known.claim("south", false).await;
    assert!(matches!(another, Err(Error::ArtifactsTaken(_))), "{another:?}");
    let new = unknown.claim("north", false).await.unwrap_err();
    assert!(new.is_full(), "{new:?}");
    disk.make_room().unwrap();
    unknown.claim("north", false).await.unwrap();
    assert_eq!(known.put(&bytes).await.unwrap(), sha256_hex(&bytes));
}
