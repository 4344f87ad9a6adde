//! The record of old weighings in files: it reads as before, a lost or changed file is named, and
//! nothing is lost on the way there.

use crate::harness::{Service, problem, storage};
use flip::app::{Archived, back_up, restore};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

const LATER: &str = "2999-01-01";

async fn weighed(service: &Service, key: &str) -> String {
    let request = json!({ "powder": "salt", "target": { "value": 15, "unit": "mg" },
        "tolerance": { "lower": 10, "upper": 10, "unit": "%" } });
    let planned: Value = service.weigh(key, &request).await.json().await.unwrap();
    let id = planned["id"].as_str().unwrap().to_owned();
    service.watch(&format!("/v1/weighings/{id}/events"), None).await;
    id
}

/// Everything reported about the record of these weighings and of all.
async fn told(service: &Service, ids: &[String]) -> Vec<String> {
    let mut told = Vec::new();
    for id in ids {
        told.push(
            service
                .get(&format!("/v1/weighings/{id}/certificate.html"))
                .await
                .text()
                .await
                .unwrap(),
        );
        told.push(
            service.get(&format!("/v1/audit?weighing={id}&limit=200")).await.text().await.unwrap(),
        );
        told.push(
            service.get(&format!("/v1/audit.json?weighing={id}")).await.text().await.unwrap(),
        );
    }
    told
}

/// Every record except those of the archiving itself, read page by page and as a file.
async fn all_records(service: &Service) -> (Vec<Value>, Vec<Value>) {
    let is_other = |it: &Value| it["body"]["action"] != "archive audit";
    let (mut listed, mut path) = (Vec::new(), "/v1/audit?limit=3".to_owned());
    loop {
        let page: Value = service.get(&path).await.json().await.unwrap();
        listed.extend(page["items"].as_array().unwrap().iter().filter(|it| is_other(it)).cloned());
        let Some(next) = page["next"].as_str() else { break };
        path = format!("/v1/audit?limit=3&after={next}");
    }
    let file: Vec<Value> = service.get("/v1/audit.json").await.json().await.unwrap();
    (listed, file.into_iter().filter(is_other).collect())
}

async fn verified(service: &Service) -> Value {
    service.get("/v1/audit/verification").await.json().await.unwrap()
}

async fn archive(service: &Service) -> Archived {
    service.app.archive_audit(LATER).await.unwrap()
}

fn file_of(folder: &Path, done: &Archived) -> PathBuf {
    folder.join(&done.files[0])
}

async fn rows(service: &Service) -> i64 {
    let pool = flip_testing::pool(service.folder()).await;
    sqlx::query_scalar("SELECT count(*) FROM audit").fetch_one(&pool).await.unwrap()
}

async fn sql(service: &Service, sql: &'static str) {
    let pool = flip_testing::pool(service.folder()).await;
    sqlx::query(sql).execute(&pool).await.unwrap();
    pool.close().await;
}

#[tokio::test]
async fn an_audit_trail_that_was_archived_reads_as_before_to_the_byte() {
    let service = Service::ready().await;
    let ids = [weighed(&service, "one").await, weighed(&service, "two").await];
    let (before, records, whole) =
        (told(&service, &ids).await, all_records(&service).await, verified(&service).await);
    let in_table = rows(&service).await;
    let done = archive(&service).await;
    assert_eq!((done.weighings, done.files.len()), (2, 1), "{done:?}");
    assert_eq!(rows(&service).await, in_table - done.records + 1);
    assert!(done.records >= 10, "{done:?}");

    assert_eq!(told(&service, &ids).await, before);
    assert_eq!(all_records(&service).await, records);
    let after = verified(&service).await;
    assert_eq!((&after["broken"], &after["archives"]), (&Value::Null, &Value::Null), "{after}");
    assert_eq!(after["records"].as_i64().unwrap(), whole["records"].as_i64().unwrap() + 1);
    for hash in [whole["last_hash"].as_str().unwrap(), records.1[7]["hash"].as_str().unwrap()] {
        let held = service.app.verify_audit(Some(hash)).await.unwrap();
        assert_eq!(held.holds_hash, Some(true), "also where it lies in a file");
    }
    // The chain continues, and archived records are not archived again.
    let third = weighed(&service, "three").await;
    assert_eq!(
        service.app.archive_audit("2000-01-01").await.unwrap().records,
        0,
        "nothing ended before"
    );
    let again = archive(&service).await;
    assert_eq!((again.weighings, verified(&service).await["broken"].clone()), (1, Value::Null));
    assert_eq!(service.get(&format!("/v1/weighings/{third}/certificate.html")).await.status(), 200);
    assert_eq!(told(&service, &ids).await, before);
}

#[tokio::test]
async fn a_byte_that_was_changed_in_an_archive_is_found_and_a_lost_one_costs_that_part_only() {
    let service = Service::ready().await;
    let first = weighed(&service, "one").await;
    let lost = archive(&service).await;
    let second = weighed(&service, "two").await;
    let kept = archive(&service).await;
    let file = file_of(service.folder(), &lost);
    let bytes = std::fs::read(&file).unwrap();
    for at in [4, bytes.len() / 2, bytes.len() - 1] {
        let mut changed = bytes.clone();
        changed[at] ^= 1;
        std::fs::write(&file, changed).unwrap();
        let found = verified(&service).await;
        assert_eq!(found["archives"][0]["file"], json!(lost.files[0]), "byte {at}: {found}");
        assert!(
            found["broken"]["why"].as_str().unwrap().contains(&lost.files[0]),
            "byte {at}: {found}"
        );
    }
    std::fs::remove_file(&file).unwrap();
    let found = verified(&service).await;
    assert_eq!(found["archives"].as_array().unwrap().len(), 1, "{found}");
    assert_eq!((&found["changed"], &found["others"]), (&Value::Null, &Value::Null), "{found}");
    assert_ne!(lost.files, kept.files);

    let certificate = async |id: &str| {
        service.get(&format!("/v1/weighings/{id}/certificate.html")).await.text().await.unwrap()
    };
    let (damaged, intact) = (certificate(&first).await, certificate(&second).await);
    assert!(
        damaged.contains("Part of its record is lost") && damaged.contains(&lost.files[0]),
        "{damaged}"
    );
    assert!(!intact.contains("is lost"), "{intact}");
    let page: Value =
        service.get(&format!("/v1/audit?weighing={first}&limit=200")).await.json().await.unwrap();
    let kinds: Vec<_> =
        page["items"].as_array().unwrap().iter().map(|it| it["kind"].as_str().unwrap()).collect();
    assert!(["intent", "lost", "outcome"].iter().all(|kind| kinds.contains(kind)), "{kinds:?}");
    assert_eq!(service.get("/v1/audit.json").await.status(), 200);
    // Back in its place it is intact again.
    std::fs::write(&file, bytes).unwrap();
    assert_eq!(verified(&service).await["broken"], Value::Null);
}

#[tokio::test]
async fn a_result_row_that_was_changed_after_its_record_was_archived_is_noticed() {
    let service = Service::ready().await;
    let id = weighed(&service, "one").await;
    archive(&service).await;
    sql(&service, "UPDATE weighing SET reading_mg = 10").await;
    assert_eq!(verified(&service).await["changed"][0]["weighing"], json!(id));
    problem(service.get(&format!("/v1/weighings/{id}/certificate.html")).await, 409).await;
}

#[tokio::test]
async fn an_end_between_the_file_and_the_rows_loses_nothing_and_the_next_try_goes_on() {
    let service = Service::ready().await;
    let ids = [weighed(&service, "one").await];
    let (before, in_table) = (told(&service, &ids).await, rows(&service).await);
    // The transaction that names the file fails, as if the process had ended before it.
    let ended = match flip_testing::on_postgres() {
        true => {
            "CREATE TRIGGER ended BEFORE INSERT ON audit_away FOR EACH ROW EXECUTE FUNCTION refuse_change()"
        }
        false => {
            "CREATE TRIGGER ended BEFORE INSERT ON audit_away BEGIN SELECT RAISE(ABORT, 'ended'); END"
        }
    };
    sql(&service, ended).await;
    assert!(service.app.archive_audit(LATER).await.is_err());
    let files = || std::fs::read_dir(service.folder().join("audit")).unwrap().count();
    assert_eq!((files(), rows(&service).await), (1, in_table));
    assert_eq!(
        (told(&service, &ids).await, verified(&service).await["broken"].clone()),
        (before.clone(), Value::Null)
    );
    let pool = flip_testing::pool(service.folder()).await;
    flip_testing::drop_trigger(&pool, "ended", "audit_away").await;
    let done = archive(&service).await;
    assert_eq!((files(), done.weighings), (1, 1), "the same file");
    assert_eq!(
        (told(&service, &ids).await, verified(&service).await["broken"].clone()),
        (before, Value::Null)
    );
}

#[tokio::test]
async fn records_that_are_in_no_archive_cannot_be_deleted_and_what_was_changed_is_not_archived() {
    let service = Service::ready().await;
    weighed(&service, "one").await;
    let pool = flip_testing::pool(service.folder()).await;
    let delete =
        async || sqlx::query("DELETE FROM audit WHERE kind = 'intent'").execute(&pool).await;
    assert!(delete().await.unwrap_err().to_string().contains("only ever added to"));
    flip_testing::drop_trigger(&pool, "audit_stays", "audit").await;
    let done = sqlx::query(
        "UPDATE audit SET body = replace(body, 'mass_mg', 'mass_g') WHERE kind = 'reading'",
    );
    assert!(done.execute(&pool).await.unwrap().rows_affected() > 0);
    let refused = service.app.archive_audit(LATER).await.unwrap_err();
    assert!(format!("{refused:?}").contains("not what was written"), "{refused:?}");
    assert!(delete().await.is_err() && !service.folder().join("audit").exists());
    assert!(verified(&service).await["broken"]["why"].is_string());
}

#[tokio::test]
async fn a_backup_holds_the_archives_and_says_which_are_lost() {
    let service = Service::ready().await;
    weighed(&service, "one").await;
    let done = archive(&service).await;
    let away = tempfile::tempdir().unwrap();
    let made =
        back_up(storage(service.folder()).await, &away.path().join("kept"), &|_| {}).await.unwrap();
    assert_eq!((&made.audit_broken, &made.lost), (&None, &Vec::new()));
    let copied = std::fs::read(file_of(&away.path().join("kept"), &done)).unwrap();
    assert_eq!(copied, std::fs::read(file_of(service.folder(), &done)).unwrap());
    std::fs::remove_file(file_of(service.folder(), &done)).unwrap();
    let made = back_up(storage(service.folder()).await, &away.path().join("poorer"), &|_| {})
        .await
        .unwrap();
    assert_eq!(made.lost, done.files);
    assert!(made.audit_broken.unwrap().contains(&done.files[0]));
}

#[tokio::test]
async fn records_that_the_table_of_archives_gives_to_another_weighing_are_found() {
    let service = Service::ready().await;
    let (one, two) = (weighed(&service, "one").await, weighed(&service, "two").await);
    archive(&service).await;
    let pool = flip_testing::pool(service.folder()).await;
    flip_testing::drop_trigger(&pool, "audit_away_stays", "audit_away").await;
    let rename = async |from: &str, to: &str| {
        let rows = sqlx::query("UPDATE audit_away SET weighing = $2 WHERE weighing = $1")
            .bind(from)
            .bind(to);
        assert!(rows.execute(&pool).await.unwrap().rows_affected() > 0);
    };
    rename(&one, &two).await;
    let why = verified(&service).await["broken"]["why"].as_str().unwrap().to_owned();
    assert!(why.contains(&format!("is of {one}, the table of archives says {two}")), "{why}");
    let page: Value =
        service.get(&format!("/v1/audit?weighing={two}&limit=200")).await.json().await.unwrap();
    let (kinds, of_one) = (page["items"].as_array().unwrap(), json!(one));
    assert!(
        kinds.iter().any(|it| it["kind"] == "lost")
            && !kinds.iter().any(|it| it["weighing"] == of_one),
        "{page}"
    );
}

#[tokio::test]
async fn weighings_that_changed_their_names_in_the_table_of_archives_are_found() {
    let service = Service::ready().await;
    let (one, two) = (weighed(&service, "one").await, weighed(&service, "two").await);
    archive(&service).await;
    let pool = flip_testing::pool(service.folder()).await;
    flip_testing::drop_trigger(&pool, "audit_away_stays", "audit_away").await;
    let swap = "UPDATE audit_away SET weighing = CASE weighing WHEN $1 THEN $2 ELSE $1 END";
    sqlx::query(swap).bind(one).bind(two).execute(&pool).await.unwrap();
    assert!(
        verified(&service).await["broken"]["why"]
            .as_str()
            .unwrap()
            .contains("the table of archives says")
    );
}

#[tokio::test]
async fn what_the_table_of_archives_says_is_compared_with_the_record_also_where_the_file_is_gone() {
    let service = Service::ready().await;
    let (one, two) = (weighed(&service, "one").await, weighed(&service, "two").await);
    let done = archive(&service).await;
    let (file, pool) =
        (file_of(service.folder(), &done), flip_testing::pool(service.folder()).await);
    let added = "INSERT INTO audit_away SELECT 1, 1, weighing, before, hash, archive, start, bytes FROM audit_away LIMIT 1";
    sqlx::query(added).execute(&pool).await.unwrap();
    let found = verified(&service).await;
    assert!(
        found["broken"]["why"].as_str().unwrap().contains("names parts that are not in the chain"),
        "{found}"
    );
    for trigger in ["audit_away_keeps", "audit_away_stays"] {
        flip_testing::drop_trigger(&pool, trigger, "audit_away").await;
    }
    let removed = "DELETE FROM audit_away WHERE first = 1";
    sqlx::query(removed).execute(&pool).await.unwrap();
    assert_eq!(verified(&service).await["broken"], Value::Null);
    std::fs::remove_file(file).unwrap();
    let of_two = async || {
        service
            .get(&format!("/v1/audit.json?weighing={two}"))
            .await
            .json::<Vec<Value>>()
            .await
            .unwrap()
    };
    assert!(of_two().await.iter().any(|it| it["kind"] == "lost"));
    let renamed = sqlx::query("UPDATE audit_away SET weighing = $2 WHERE weighing = $1")
        .bind(&two)
        .bind(&one);
    renamed.execute(&pool).await.unwrap();
    let found = verified(&service).await;
    assert!(found["archives"][0]["why"].as_str().unwrap().contains("weighings"), "{found}");
}

#[tokio::test]
async fn a_damaged_archive_is_copied_as_it_is_and_named_and_its_other_parts_still_read() {
    let service = Service::ready().await;
    weighed(&service, "one").await;
    let other = weighed(&service, "two").await;
    let done = archive(&service).await;
    let file = file_of(service.folder(), &done);
    let mut bytes = std::fs::read(&file).unwrap();
    bytes[40] ^= 1;
    std::fs::write(&file, &bytes).unwrap();
    let away = tempfile::tempdir().unwrap();
    let (kept, back) = (away.path().join("kept"), away.path().join("back"));
    let copied = back_up(storage(service.folder()).await, &kept, &|_| {}).await.unwrap();
    let restored = restore(&kept, storage(&back).await, false, &|_| {}).await.unwrap();
    for (made, folder) in [(copied, &kept), (restored, &back)] {
        assert_eq!((&made.damaged, &made.lost), (&done.files, &done.files));
        assert_eq!(std::fs::read(file_of(folder, &done)).unwrap(), bytes);
        let why = made.audit_broken.unwrap();
        assert!(why.contains(&done.files[0]) && !why.contains("No such file"), "{why}");
    }
    let page: Value =
        service.get(&format!("/v1/audit?weighing={other}&limit=200")).await.json().await.unwrap();
    assert!(page["items"].as_array().unwrap().iter().all(|it| it["kind"] != "lost"), "{page}");
}

#[tokio::test]
async fn of_three_archivings_at_once_one_moves_the_records_and_the_others_say_that_it_is_under_way()
{
    let service = Service::ready().await;
    weighed(&service, "one").await;
    let one = || service.app.archive_audit(LATER);
    let (a, b, c) = tokio::join!(one(), one(), one());
    let (done, refused): (Vec<_>, Vec<_>) = [a, b, c].into_iter().partition(Result::is_ok);
    assert!(done.into_iter().any(|it| it.unwrap().records > 0));
    for refused in refused {
        let why = format!("{:?}", refused.unwrap_err());
        assert!(why.contains("another archiving of the audit trail is under way"), "{why}");
    }
    assert_eq!(verified(&service).await["broken"], Value::Null);
    assert_eq!(archive(&service).await.records, 0, "and then anybody may");
}
