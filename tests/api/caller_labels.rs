//! What callers write on weighings and jobs, and find them by.

use crate::grpc::channel;
use crate::harness::{Service, fields, problem};
use flip::api::grpc::proto;
use flip::api::grpc::proto::jobs_client::JobsClient;
use flip::api::grpc::proto::weighings_client::WeighingsClient;
use flip::app::Role;
use serde_json::{Value, json};

fn dose(labels: &Value) -> Value {
    json!({
        "powder": "salt",
        "target": { "value": 15.0, "unit": "mg" },
        "tolerance": { "lower": 1, "upper": 1, "unit": "mg" },
        "labels": labels,
    })
}

/// Ids of what a list holds.
async fn ids(service: &Service, path: &str) -> Vec<String> {
    let page: Value = service.get(path).await.json().await.unwrap();
    let items = page["items"].as_array().unwrap_or_else(|| panic!("{path}: {page}"));
    items.iter().map(|it| it["id"].as_str().unwrap().to_owned()).collect()
}

async fn calibration(service: &Service, labels: &Value, correlation: &str) -> Value {
    let request = service
        .request("POST", "/v1/calibrations")
        .bearer_auth(service.token(Role::Operator).await)
        .header("x-correlation-id", correlation)
        .json(&json!({ "powder": "sand", "method": "sequential", "labels": labels }));
    let answer = request.send().await.unwrap();
    assert_eq!(answer.headers()["x-correlation-id"], correlation);
    answer.json().await.unwrap()
}

#[tokio::test]
async fn a_weighing_is_found_by_what_its_caller_wrote_on_it() {
    let service = Service::ready().await;
    let labels = json!({ "plate": "A7", "eln/run": "Grüße: 7" });
    let weighing: Value = service.weigh("k1", &dose(&labels)).await.json().await.unwrap();
    assert_eq!(weighing["labels"], labels);
    service.weigh("k2", &dose(&json!({ "plate": "A8" }))).await;
    service.weigh("k3", &dose(&json!({}))).await;
    let id = weighing["id"].as_str().unwrap();
    for query in ["plate:A7", "eln/run:Gr%C3%BC%C3%9Fe:%207"] {
        assert_eq!(ids(&service, &format!("/v1/weighings?label={query}")).await, [id], "{query}");
    }
    for query in ["plate:a7", "plate:", "run:A7"] {
        assert!(ids(&service, &format!("/v1/weighings?label={query}")).await.is_empty(), "{query}");
    }
    let mut weighings = WeighingsClient::new(channel(&service).await);
    let wanted =
        proto::ListWeighingsRequest { label: Some("plate:A7".into()), ..Default::default() };
    let found = weighings.list_weighings(wanted).await.unwrap().into_inner().items;
    assert_eq!(found.len(), 1);
    assert_eq!(found[0].labels["eln/run"], "Grüße: 7");
    let other = service.weigh("k1", &dose(&json!({ "plate": "A9" }))).await;
    assert_eq!(other.status(), 422, "another request under the same key");
}

#[tokio::test]
async fn the_callers_own_id_comes_back_and_finds_what_it_began() {
    let service = Service::ready().await;
    let begin = async |key: &str, name: &str, value: &str| {
        let request = service
            .request("POST", "/v1/weighings")
            .bearer_auth(service.token(Role::Operator).await)
            .header("idempotency-key", key)
            .header(name, value);
        request.json(&dose(&json!({}))).send().await.unwrap()
    };
    let answer = begin("k1", "x-correlation-id", "run-7/3").await;
    assert_eq!(answer.headers()["x-correlation-id"], "run-7/3");
    let weighing: Value = answer.json().await.unwrap();
    assert_eq!(weighing["labels"], json!({ "correlation_id": "run-7/3" }));
    // The same request again is the same, whatever its own id is by then.
    let again: Value = begin("k1", "x-request-id", "run-7/4").await.json().await.unwrap();
    assert_eq!(again["id"], weighing["id"]);
    assert_eq!(again["labels"], weighing["labels"]);
    let found = ids(&service, "/v1/weighings?label=correlation_id:run-7/3").await;
    assert_eq!(found, [weighing["id"].as_str().unwrap()]);
    let refused = begin("k2", "x-correlation-id", &"r".repeat(201)).await;
    assert_eq!(fields(&problem(refused, 400).await), ["x-correlation-id"]);
    assert_eq!(ids(&service, "/v1/weighings").await.len(), 1, "nothing was begun");
    // A stop is carried out whatever header comes with it.
    let stop = service.request("POST", "/v1/bench/stop").json(&json!({}));
    let stop = stop.bearer_auth(service.token(Role::Operator).await);
    let stopped = stop.header("x-correlation-id", "r ".repeat(201)).send().await.unwrap();
    assert!(stopped.status().is_success(), "{}", stopped.status());
}

#[tokio::test]
async fn a_job_has_the_labels_of_all_who_asked_for_it() {
    let service = Service::start().await;
    let first = calibration(&service, &json!({ "team": "a", "campaign": "May" }), "one").await;
    let again = calibration(&service, &json!({ "team": "b" }), "two").await;
    assert_eq!(first["id"], again["id"]);
    let both = json!({ "team": "b", "campaign": "May", "correlation_id": "two" });
    assert_eq!(again["labels"], both);
    let id = first["id"].as_str().unwrap();
    let job: Value = service.get(&format!("/v1/jobs/{id}")).await.json().await.unwrap();
    assert_eq!(job["labels"], both);
    assert_eq!(ids(&service, "/v1/jobs?label=team:b").await, [id]);
    assert!(ids(&service, "/v1/jobs?label=team:a").await.is_empty());
    let mut jobs = JobsClient::new(channel(&service).await);
    let wanted =
        proto::ListJobsRequest { label: Some("campaign:May".into()), ..Default::default() };
    assert_eq!(jobs.list_jobs(wanted).await.unwrap().into_inner().items.len(), 1);
}

#[tokio::test]
async fn a_list_of_doses_writes_its_labels_on_every_dose_that_has_not_its_own() {
    let service = Service::ready().await;
    let doses = [dose(&json!({})), dose(&json!({ "well": "B2", "plate": "own" }))];
    let list = json!({ "name": "Plate 7", "doses": doses, "labels": { "plate": "P7" } });
    let request = service
        .request("POST", "/v1/weighings/list")
        .bearer_auth(service.token(Role::Operator).await)
        .header("idempotency-key", "list");
    assert_eq!(request.json(&list).send().await.unwrap().status(), 202);
    assert_eq!(ids(&service, "/v1/weighings?label=plate:P7").await.len(), 1);
    assert_eq!(ids(&service, "/v1/weighings?label=well:B2&list=Plate%207").await.len(), 1);
}

#[tokio::test]
async fn labels_that_do_not_fit_are_refused_by_their_key() {
    let service = Service::ready().await;
    let many: Value =
        (0..33).map(|k| (format!("k{k}"), json!("v"))).collect::<serde_json::Map<_, _>>().into();
    for (labels, field) in [
        (json!({ "a b": "c" }), "labels"),
        (json!({ "k": "a\nb" }), "labels.k"),
        (json!({ "k": 7 }), "labels.k"),
        (many, "labels"),
    ] {
        let refused = service.weigh("k", &dose(&labels)).await;
        assert_eq!(fields(&problem(refused, 400).await), [field], "{labels}");
    }
    for wrong in ["plate", ":A7", "a%20b:c"] {
        for list in ["weighings", "jobs"] {
            let refused = service.get(&format!("/v1/{list}?label={wrong}")).await;
            assert_eq!(fields(&problem(refused, 400).await), ["label"], "{wrong}");
        }
    }
}
