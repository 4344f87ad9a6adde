//! The record against tampering with its subject: rows by SQL, files by hand.

use crate::harness::{Service, fields, problem};
use flip::app::Role;
use serde_json::{Value, json};
use std::path::PathBuf;

pub async fn weighed(service: &Service, key: &str) -> String {
    let request = json!({
        "powder": "salt",
        "target": { "value": 15, "unit": "mg" },
        "tolerance": { "lower": 10, "upper": 10, "unit": "%" },
    });
    let planned: Value = service.weigh(key, &request).await.json().await.unwrap();
    let id = planned["id"].as_str().unwrap().to_owned();
    service.watch(&format!("/v1/weighings/{id}/events"), None).await;
    id
}

async fn change(service: &Service, sql: &'static str) {
    let pool = flip_testing::pool(service.folder()).await;
    let done = sqlx::query(sqlx::AssertSqlSafe(flip_testing::with_bytes(sql)));
    let done = done.execute(&pool).await.unwrap();
    assert!(done.rows_affected() > 0, "{sql}");
    pool.close().await;
}

async fn verified(service: &Service) -> Value {
    service.get("/v1/audit/verification").await.json().await.unwrap()
}

/// Path of a weighing's ticks.
async fn trace_file(service: &Service, id: &str) -> PathBuf {
    let pool = flip_testing::pool(service.folder()).await;
    let sha256: String = sqlx::query_scalar("SELECT trace FROM weighing WHERE id = $1")
        .bind(id)
        .fetch_one(&pool)
        .await
        .unwrap();
    service.folder().join("blobs").join(&sha256[..2]).join(sha256)
}

#[tokio::test]
async fn a_result_row_that_was_changed_by_sql_neither_passes_verification_nor_is_certified() {
    let service = Service::ready().await;
    let id = weighed(&service, "one").await;
    let certificate = format!("/v1/weighings/{id}/certificate.html");
    assert_eq!(verified(&service).await["broken"], Value::Null);
    assert_eq!(service.get(&certificate).await.status(), 200);
    for sql in [
        "UPDATE weighing SET reading_mg = 10",
        "UPDATE weighing SET outcome = 'under'",
        "UPDATE weighing SET powder = 'sand'",
        "UPDATE weighing SET asked = '{\"vial\":\"another\"}'",
        "UPDATE weighing SET finished_at = finished_at + 1000",
        "UPDATE weighing SET tolerance_upper_mg = 15",
        "UPDATE weighing SET trace = '0000000000000000000000000000000000000000000000000000000000000000'",
    ] {
        let service = Service::ready().await;
        let id = weighed(&service, "one").await;
        change(&service, sql).await;
        let found = verified(&service).await;
        assert_eq!(found["changed"][0]["weighing"], json!(id), "{sql}: {found}");
        assert!(
            found["broken"]["why"].as_str().unwrap().contains("changed outside FLIP"),
            "{sql}: {found}"
        );
        let refused =
            problem(service.get(&format!("/v1/weighings/{id}/certificate.html")).await, 409).await;
        assert_eq!(refused["type"], "urn:flip:problem:record-differs", "{sql}");
    }
}

#[tokio::test]
async fn rows_that_were_slipped_in_or_taken_out_by_sql_are_noticed() {
    let service = Service::ready().await;
    weighed(&service, "one").await;
    change(&service, "DELETE FROM weighing").await;
    assert!(verified(&service).await["broken"]["why"].as_str().unwrap().contains("is gone"));

    let service = Service::ready().await;
    weighed(&service, "one").await;
    change(
        &service,
        "INSERT INTO weighing (id, idempotency_key, request_sha256, powder, target_mg, tolerance_lower_mg, tolerance_upper_mg, \
         policy, parameter_set, seed, state, outcome, reading_mg, created_at, finished_at) \
         SELECT 'forged', 'forged', request_sha256, powder, target_mg, tolerance_lower_mg, tolerance_upper_mg, policy, parameter_set, \
         seed, state, outcome, reading_mg, created_at, finished_at FROM weighing",
    )
    .await;
    assert_eq!(verified(&service).await["changed"][0]["weighing"], "forged");
    problem(service.get("/v1/weighings/forged/certificate.html").await, 409).await;
}

#[tokio::test]
async fn a_forged_row_that_says_it_is_older_than_the_record_is_not_taken_for_one_from_before_it() {
    let service = Service::ready().await;
    weighed(&service, "one").await;
    change(
        &service,
        "INSERT INTO weighing (id, idempotency_key, request_sha256, powder, target_mg, tolerance_lower_mg, tolerance_upper_mg, \
         policy, parameter_set, seed, state, outcome, reading_mg, created_at, finished_at) \
         SELECT 'old', 'old', request_sha256, powder, target_mg, tolerance_lower_mg, tolerance_upper_mg, policy, parameter_set, \
         seed, state, outcome, reading_mg, 1000, 2000 FROM weighing",
    )
    .await;
    let found = verified(&service).await;
    assert_eq!(found["changed"][0]["weighing"], "old", "{found}");
    problem(service.get("/v1/weighings/old/certificate.html").await, 409).await;
}

/// The report on other rows after this change.
async fn other_rows_after(sql: &'static str) -> (String, Value) {
    let service = Service::ready().await;
    service.token(Role::Operator).await;
    let body = json!({ "method": "manual", "repose_deg": 31.5, "sd_deg": 1, "n": 5 });
    let operator = service.token(Role::Operator).await;
    let post =
        service.request("POST", "/v1/powders/salt/measurements").bearer_auth(&operator).json(&body);
    assert_eq!(post.send().await.unwrap().status(), 201);
    let file = "powder,drained_deg\nsalt,38\nsalt,39\n";
    let post = service.request("POST", "/v1/measurements/import").bearer_auth(&operator);
    assert_eq!(
        post.header("content-type", "text/csv").body(file).send().await.unwrap().status(),
        201
    );
    let whole = verified(&service).await;
    assert_eq!((&whole["broken"], &whole["others"]), (&Value::Null, &Value::Null), "{whole}");
    change(&service, sql).await;
    let found = verified(&service).await;
    assert!(found["broken"]["why"].is_string(), "{sql}: {found}");
    (found["others"][0]["what"].as_str().unwrap_or_default().to_owned(), found)
}

#[tokio::test]
async fn a_token_that_was_made_mightier_by_sql_does_not_pass_verification() {
    for (sql, named) in [
        ("UPDATE token SET role = 'admin'", "role is \"admin\", \"operator\" was recorded"),
        ("UPDATE token SET may_clear = TRUE", "may_clear is true"),
        ("UPDATE token SET sha256 = zeroblob(32)", "secret is"),
        ("UPDATE token SET name = 'somebody else'", "name is"),
        ("UPDATE token SET expires_at = 1", "expires_at is"),
        ("DELETE FROM token", "its row is gone"),
        (
            "INSERT INTO token (id, name, role, sha256, created_at) VALUES ('ff', 'mine', 'admin', zeroblob(32), 1)",
            "the record knows nothing of it",
        ),
    ] {
        let (what, found) = other_rows_after(sql).await;
        assert_eq!(what, "token", "{sql}: {found}");
        assert!(found["others"][0]["why"].as_str().unwrap().contains(named), "{sql}: {found}");
    }
}

#[tokio::test]
async fn a_revoked_token_that_was_made_good_again_by_sql_does_not_pass_verification() {
    let service = Service::start().await;
    let secret = service.token(Role::Operator).await;
    let id = secret.split('_').nth(1).unwrap();
    service.app.revoke_token(id).await.unwrap();
    assert_eq!(verified(&service).await["broken"], Value::Null);
    change(&service, "UPDATE token SET revoked_at = NULL").await;
    let found = verified(&service).await;
    assert_eq!(
        (&found["others"][0]["what"], &found["others"][0]["id"]),
        (&json!("token"), &json!(id)),
        "{found}"
    );
}

#[tokio::test]
async fn what_was_measured_and_what_the_bench_is_cannot_be_changed_by_sql_unseen() {
    for (sql, what) in [
        ("UPDATE measurement SET repose_deg = 50 WHERE repose_deg = 31.5", "measurement"),
        ("UPDATE measurement SET sd_deg = 9 WHERE source LIKE '%2506%' OR n = 5", "measurement"),
        ("DELETE FROM measurement WHERE repose_deg = 31.5", "measurement"),
        (
            "INSERT INTO measurement (id, powder, method, repose_deg, sd_deg, n, source, created_at) \
             VALUES ('x', 'salt', 'automated', 60, 1, 5, '', 0)",
            "measurement",
        ),
        ("UPDATE observation SET body = replace(body, '\"mean\":', '\"mean\":1')", "observation"),
        ("UPDATE powder SET name = 'Sugar' WHERE id = 'salt'", "powder"),
        ("UPDATE parameter_set SET parameters = replace(parameters, '0.', '0.0')", "parameter_set"),
        (
            "INSERT INTO latch (at, reason, cleared_at, cleared_by) VALUES (1, 'never', 2, 'nobody')",
            "latch",
        ),
        ("INSERT INTO bench_hold (at, reason) VALUES (1, 'never')", "hold"),
        ("INSERT INTO bench_check (at, kind, body) VALUES (1, 'repeatability', '{}')", "check"),
    ] {
        let (found, all) = other_rows_after(sql).await;
        assert_eq!(found, what, "{sql}: {all}");
    }
}

#[tokio::test]
async fn a_hold_that_was_ended_by_sql_is_still_on_record() {
    let service = Service::ready().await;
    let operator = service.token(Role::Admin).await;
    let stop =
        service.request("POST", "/v1/bench/stop").bearer_auth(&operator).send().await.unwrap();
    assert!(stop.status().is_success(), "{}", stop.status());
    while service.get("/v1/bench").await.json::<Value>().await.unwrap()["held"].is_null() {
        tokio::task::yield_now().await;
    }
    // The hold is in memory first and in the record a moment later.
    while verified(&service).await["others"].is_array() {
        tokio::task::yield_now().await;
    }
    change(&service, "UPDATE bench_hold SET resumed_at = 1, resumed_by = 'nobody'").await;
    let found = verified(&service).await;
    assert_eq!(found["others"][0]["what"], "hold", "{found}");
}

#[tokio::test]
async fn an_intent_that_was_changed_before_its_dose_is_noticed() {
    let service = Service::ready().await;
    let hold = service.hold_bench();
    let request = json!({ "powder": "salt", "target": { "value": 15, "unit": "mg" },
        "tolerance": { "lower": 1, "upper": 1, "unit": "mg" } });
    service.weigh("first", &request).await;
    service.until_pouring().await;
    let second: Value = service.weigh("second", &request).await.json().await.unwrap();
    assert_eq!(
        verified(&service).await["broken"],
        Value::Null,
        "what moves and what waits is as it was asked for"
    );
    change(&service, "UPDATE weighing SET target_mg = 30 WHERE idempotency_key = 'second'").await;
    assert_eq!(verified(&service).await["changed"][0]["weighing"], second["id"]);
    drop(hold);
}

#[tokio::test]
async fn an_intent_says_who_asked_and_with_which_key() {
    let service = Service::ready().await;
    let id = weighed(&service, "the-key").await;
    let page: Value =
        service.get(&format!("/v1/audit?weighing={id}&limit=200")).await.json().await.unwrap();
    let intent =
        page["items"].as_array().unwrap().iter().find(|it| it["kind"] == "intent").unwrap();
    assert_eq!(intent["body"]["idempotency_key"], "the-key");
    assert_eq!(
        (&intent["body"]["who"]["name"], &intent["body"]["who"]["role"]),
        (&json!("test"), &json!("operator")),
        "{intent}"
    );
    let outcome =
        page["items"].as_array().unwrap().iter().find(|it| it["kind"] == "outcome").unwrap();
    assert!(outcome["body"]["who"].is_null(), "the bench's own work has nobody");
    let certificate =
        service.get(&format!("/v1/weighings/{id}/certificate.html")).await.text().await.unwrap();
    assert!(certificate.contains("test (operator)"), "{certificate}");
}

#[tokio::test]
async fn a_lost_or_damaged_trace_costs_the_trace_and_nothing_else() {
    let service = Service::ready().await;
    let id = weighed(&service, "one").await;
    let path = format!("/v1/weighings/{id}");
    let whole: Value = service.get(&path).await.json().await.unwrap();
    assert!(whole["trace_lost"].is_null() && !whole["ticks"].as_array().unwrap().is_empty());
    let file = trace_file(&service, &id).await;
    let damages: [fn(&std::path::Path); 3] = [
        |file| std::fs::write(file, b"[]").unwrap(),
        |file| std::fs::write(file, b"").unwrap(),
        |file| std::fs::remove_file(file).unwrap(),
    ];
    for damage in damages {
        damage(&file);
        let detail: Value = service.get(&path).await.json().await.unwrap();
        assert_eq!((&detail["weighing"], &detail["ticks"]), (&whole["weighing"], &json!([])));
        assert!(detail["trace_lost"].as_str().unwrap().contains("gone or damaged"), "{detail}");
        for part in ["trace", "trace.csv"] {
            let lost = problem(service.get(&format!("{path}/{part}")).await, 410).await;
            assert!(
                lost["detail"].as_str().unwrap().contains("the trace of this weighing is lost"),
                "{lost}"
            );
        }
        let certificate = service.get(&format!("{path}/certificate.html")).await;
        assert_eq!(certificate.status(), 200);
        assert!(certificate.text().await.unwrap().contains("is lost"));
        assert!(service.watch(&format!("{path}/events"), None).await.is_some());
    }
    assert_eq!(verified(&service).await["broken"], Value::Null, "the record is not the trace");
}

#[tokio::test]
async fn a_damaged_policy_is_lost_by_name_and_the_list_goes_on() {
    let service = Service::ready().await;
    let list: Value = service.get("/v1/policies").await.json().await.unwrap();
    let id = list["items"][0]["id"].as_str().unwrap();
    change(&service, "UPDATE policy SET bytes = x'00'").await;
    problem(service.get(&format!("/v1/policies/{id}/weights")).await, 410).await;
    assert_eq!(service.get("/v1/policies").await.status(), 200);
    assert_eq!(service.get(&format!("/v1/policies/{id}")).await.status(), 200);
    let token = service.token(Role::Viewer).await;
    let mut client =
        flip::api::grpc::proto::policies_client::PoliciesClient::connect(service.url(""))
            .await
            .unwrap();
    let mut request =
        tonic::Request::new(flip::api::grpc::proto::DownloadWeightsRequest { id: id.to_owned() });
    request.metadata_mut().insert("authorization", format!("Bearer {token}").parse().unwrap());
    assert_eq!(client.download_weights(request).await.unwrap_err().code(), tonic::Code::DataLoss);
}

#[tokio::test]
async fn a_policy_trained_elsewhere_is_stored_under_its_own_id() {
    use flip::api::grpc::proto::{ImportPolicyRequest, policies_client::PoliciesClient};
    let (service, elsewhere) = (Service::ready().await, Service::ready().await);
    let gains = flip_policy::Gains { p: 0.1, i: 0.0, d: 0.0 };
    let pid = flip_policy::Pid { incline: gains, shake: gains };
    let policy = flip_policy::Policy {
        manifest: flip_policy::Manifest::of_untrained(
            flip_policy::Kind::Pid { gains: pid },
            flip_policy::Rules::FLIP,
            0,
        ),
        controller: flip_policy::Controller::Pid(pid),
    };
    let file = flip_policy::encode(&policy);
    let post = async |kind: &str, body: Vec<u8>| {
        let token = service.token(Role::Operator).await;
        let request = service.request("POST", "/v1/policies").bearer_auth(token);
        request.header("content-type", kind).body(body).send().await.unwrap()
    };
    let first = post("application/octet-stream", file.clone()).await;
    assert_eq!(first.status(), 201);
    let stored: Value = first.json().await.unwrap();
    assert_eq!(stored["id"], flip_policy::id(&file).as_str());
    assert_eq!(post("application/octet-stream", file.clone()).await.status(), 200);
    let weights = format!("/v1/policies/{}/weights", flip_policy::id(&file));
    assert_eq!(service.get(&weights).await.bytes().await.unwrap(), file);

    problem(post("application/json", file.clone()).await, 415).await;
    let mut damaged = file.clone();
    damaged.truncate(file.len() / 2);
    let refused = problem(post("application/octet-stream", damaged).await, 400).await;
    assert_eq!(fields(&refused), ["file"]);

    let token = elsewhere.token(Role::Operator).await;
    let mut client = PoliciesClient::connect(elsewhere.url("")).await.unwrap();
    for file in [file, b"no policy".to_vec()] {
        let valid = file.len() > 20;
        let mut request = tonic::Request::new(ImportPolicyRequest { file });
        request.metadata_mut().insert("authorization", format!("Bearer {token}").parse().unwrap());
        match client.import_policy(request).await {
            Ok(policy) => assert!(valid && policy.into_inner().id == stored["id"]),
            Err(status) => assert!(!valid && status.message().contains("file"), "{status}"),
        }
    }
}

#[tokio::test]
async fn a_key_that_was_changed_so_that_a_retry_would_pour_again_is_noticed() {
    for (sql, name) in [
        ("UPDATE weighing SET idempotency_key = 'another'", "idempotency_key"),
        ("UPDATE weighing SET request_sha256 = zeroblob(32)", "request_sha256"),
        ("UPDATE weighing SET patch = '{}'", "patch"),
    ] {
        let service = Service::ready().await;
        let id = weighed(&service, "one").await;
        change(&service, sql).await;
        let found = verified(&service).await;
        assert_eq!(found["changed"][0]["weighing"], json!(id), "{sql}: {found}");
        let why = found["broken"]["why"].as_str().unwrap();
        assert!(why.contains(&format!("{name} is another than was recorded")), "{sql}: {found}");
    }
}

#[tokio::test]
async fn a_powder_that_was_made_at_another_time_and_a_stock_that_was_not_taken_are_noticed() {
    let service = Service::ready().await;
    assert_eq!(verified(&service).await["broken"], Value::Null);
    for (sql, what) in [
        ("UPDATE powder SET created_at = created_at + 1", "powder"),
        ("UPDATE stock SET at = at + 1", "stock"),
        ("DELETE FROM stock", "stock"),
    ] {
        let service = Service::ready().await;
        change(&service, sql).await;
        let found = verified(&service).await;
        assert_eq!(found["others"][0]["what"], what, "{sql}: {found}");
    }
}
