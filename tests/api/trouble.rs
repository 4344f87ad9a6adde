//! Responses of the service while its data folder is in trouble (locked by another program, full,
//! gone), and while the bench is latched.

use crate::harness::{Service, problem};
use flip::app::Role;
use serde_json::{Value, json};
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;

/// How often health is asked for, 50 ms apart: much longer than a change takes to be noticed.
const LOOKS: usize = 600;

/// Waits until `/readyz` answers with this status; returns its document.
async fn until_ready_is(service: &Service, status: u16) -> Value {
    for _ in 0..LOOKS {
        let response = service.get("/readyz").await;
        if response.status() == status {
            return response.json().await.unwrap();
        }
        tokio::time::sleep(std::time::Duration::from_millis(50)).await;
    }
    panic!("/readyz does not answer {status}");
}

async fn until_health_is(service: &Service, name: &str, status: ServingStatus) {
    let channel =
        tonic::transport::Endpoint::from_shared(service.url("")).unwrap().connect().await.unwrap();
    let mut client = HealthClient::new(channel);
    let request = HealthCheckRequest { service: name.to_owned() };
    for _ in 0..LOOKS {
        if client.check(request.clone()).await.unwrap().into_inner().status() == status {
            return;
        }
        tokio::time::sleep(std::time::Duration::from_millis(50)).await;
    }
    panic!("the health of {name} is not {status:?}");
}

#[tokio::test]
async fn a_database_that_another_program_locks_is_a_503_that_says_so_and_ends_with_the_lock() {
    let service = Service::start().await;
    let token = service.token(Role::Operator).await;
    let measured = json!({ "method": "manual", "repose_deg": 40, "sd_deg": 1, "n": 3 });
    let post = || {
        service
            .request("POST", "/v1/powders/salt/measurements")
            .bearer_auth(&token)
            .json(&measured)
            .send()
    };
    let other = flip_testing::locked(service.folder()).await;
    let response = post().await.unwrap();
    assert!(response.headers().contains_key("retry-after"));
    let refused = problem(response, 503).await;
    assert!(
        refused["detail"].as_str().unwrap().contains("another program holds the database"),
        "{refused}"
    );
    let told = until_ready_is(&service, 503).await;
    assert_eq!(
        (&told["checks"]["database"]["ok"], &told["checks"]["disk"]["ok"]),
        (&json!(false), &json!(true))
    );
    assert!(
        told["checks"]["database"]["why"].as_str().unwrap().contains("another program holds"),
        "{told}"
    );
    until_health_is(&service, "flip.v1.Powders", ServingStatus::NotServing).await;

    other.rollback().await.unwrap();
    until_ready_is(&service, 200).await;
    until_health_is(&service, "flip.v1.Powders", ServingStatus::Serving).await;
    assert_eq!(post().await.unwrap().status(), 201);
}

#[tokio::test]
async fn a_latched_bench_is_named_and_only_what_needs_it_is_not_served() {
    let service = Service::start().await;
    let ready = until_ready_is(&service, 200).await;
    let names: Vec<_> = ready["checks"].as_object().unwrap().keys().map(String::as_str).collect();
    for name in ["disk", "database", "folder", "lock", "bench"] {
        assert!(names.contains(&name) && ready["checks"][name]["ok"] == true, "{ready}");
    }
    let pool = flip_testing::pool(service.folder()).await;
    sqlx::query("INSERT INTO latch (at, reason) VALUES (1, 'the arm was pushed')")
        .execute(&pool)
        .await
        .unwrap();
    let told = until_ready_is(&service, 503).await;
    assert_eq!((&told["ready"], &told["checks"]["bench"]["ok"]), (&json!(false), &json!(false)));
    assert!(
        told["checks"]["bench"]["why"].as_str().unwrap().contains("the arm was pushed"),
        "{told}"
    );
    until_health_is(&service, "", ServingStatus::NotServing).await;
    until_health_is(&service, "flip.v1.Weighings", ServingStatus::NotServing).await;
    until_health_is(&service, "flip.v1.Powders", ServingStatus::Serving).await;
}

#[tokio::test]
async fn a_data_folder_that_is_replaced_is_noticed_and_nothing_is_written_into_the_lost_file() {
    if flip_testing::only_sqlite_has("a file") {
        return;
    }
    let service = Service::start().await;
    let token = service.token(Role::Operator).await;
    let database = service.folder().join("flip.db");
    std::fs::rename(&database, service.folder().join("elsewhere.db")).unwrap();
    let told = until_ready_is(&service, 503).await;
    assert_eq!(told["checks"]["folder"]["ok"], false, "{told}");
    let new = json!({ "id": "flour", "name": "Flour" });
    let refused =
        service.request("POST", "/v1/powders").bearer_auth(&token).json(&new).send().await.unwrap();
    let refused = problem(refused, 503).await;
    assert!(refused["detail"].as_str().unwrap().contains("removed or replaced"), "{refused}");
    assert!(!database.exists(), "and no new database is made in its place");
}

#[tokio::test]
async fn a_lock_file_that_is_removed_is_noticed() {
    let service = Service::start().await;
    until_ready_is(&service, 200).await;
    std::fs::remove_file(service.folder().join("flip.lock")).unwrap();
    assert_eq!(until_ready_is(&service, 503).await["checks"]["lock"]["ok"], false);
}
