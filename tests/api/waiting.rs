//! Clients that cannot hold a stream, or send a Bearer token.

use crate::harness::{Service, fields, problem};
use flip::app::Role;
use serde_json::{Value, json};
use std::time::{Duration, Instant};

fn dose() -> Value {
    json!({
        "powder": "salt",
        "target": { "value": 15.0, "unit": "mg" },
        "tolerance": { "lower": 1, "upper": 1, "unit": "mg" },
        "asked": { "operator": "Ada", "lot": "L-42", "vial": "A1" },
    })
}

async fn planned(service: &Service, key: &str) -> String {
    let weighing: Value = service.weigh(key, &dose()).await.json().await.unwrap();
    weighing["id"].as_str().unwrap().to_owned()
}

#[tokio::test]
async fn an_answer_waits_for_the_end_of_a_weighing_or_for_its_patience() {
    let service = Service::ready().await;
    let hold = service.hold_bench();
    let id = planned(&service, "held").await;
    service.until_pouring().await;

    let begun = Instant::now();
    let path = format!("/v1/weighings/{id}?wait=1");
    let waited: Value = service.get(&path).await.json().await.unwrap();
    assert!(waited["weighing"]["outcome"].is_null(), "its patience was over first");
    assert!(begun.elapsed() >= Duration::from_secs(1));

    let path = format!("/v1/weighings/{id}?wait=300");
    let (waited, ()) = tokio::join!(service.get(&path), async { drop(hold) });
    assert!(waited.headers()["content-type"].to_str().unwrap().starts_with("application/json"));
    let waited: Value = waited.json().await.unwrap();
    assert_eq!(waited["weighing"]["outcome"], "within");
    let now: Value = service.get(&format!("/v1/weighings/{id}")).await.json().await.unwrap();
    assert_eq!(waited, now, "the same answer as without waiting");

    let refused = service.get(&format!("/v1/weighings/{id}?wait=301")).await;
    assert_eq!(fields(&problem(refused, 400).await), ["wait"]);
    assert_eq!(service.get("/v1/weighings/none?wait=5").await.status(), 404);
}

#[tokio::test]
async fn a_weighing_that_has_ended_may_be_stopped_as_often_as_anybody_likes() {
    let service = Service::ready().await;
    let token = service.token(Role::Operator).await;
    let id = planned(&service, "dosed").await;
    let path = format!("/v1/weighings/{id}?wait=60");
    let ended: Value = service.get(&path).await.json().await.unwrap();
    for _ in 0..2 {
        let path = format!("/v1/weighings/{id}/stop");
        let stopped = service.request("POST", &path).bearer_auth(&token).send().await.unwrap();
        assert_eq!(stopped.status(), 200);
        assert_eq!(stopped.json::<Value>().await.unwrap(), ended["weighing"]);
    }
    let bench: Value = service.get("/v1/bench").await.json().await.unwrap();
    assert!(bench["held"].is_null(), "nothing moved, so nothing is held");
}

#[tokio::test]
async fn a_token_is_the_password_of_http_basic() {
    let service = Service::ready().await;
    let token = service.token(Role::Admin).await;
    let with = |password: String| {
        let request = service.request("GET", "/v1/tokens").basic_auth("anybody", Some(password));
        async move { request.send().await.unwrap() }
    };
    assert_eq!(with(token.clone()).await.status(), 200);
    problem(with(format!("{token}x")).await, 401).await;
    problem(with(String::new()).await, 401).await;
    let broken = service.request("GET", "/v1/tokens").header("authorization", "Basic ???");
    problem(broken.send().await.unwrap(), 401).await;
}

#[tokio::test]
async fn a_weighing_is_told_in_allotropes_model() {
    let service = Service::ready().await;
    let hold = service.hold_bench();
    let id = planned(&service, "told").await;
    service.until_pouring().await;
    problem(service.get(&format!("/v1/weighings/{id}/asm.json")).await, 409).await;
    drop(hold);
    let path = format!("/v1/weighings/{id}?wait=60");
    let detail: Value = service.get(&path).await.json().await.unwrap();
    let document: Value =
        service.get(&format!("/v1/weighings/{id}/asm.json")).await.json().await.unwrap();
    let manifest = document["$asm.manifest"].as_str().unwrap();
    assert!(manifest.ends_with("/balance/REC/2025/03/balance.manifest"));
    let weighed = &document["weighing aggregate document"]["weighing document"][0];
    assert_eq!(weighed["analyst"], "Ada");
    let measured = &weighed["measurement aggregate document"]["measurement document"][0];
    let told = &detail["weighing"];
    let net = told["measured"]["net_mg"].as_f64().or(told["reading_mg"].as_f64());
    assert_eq!(measured["sample weight"], json!({ "value": net, "unit": "mg" }));
    assert_eq!(measured["measurement identifier"], id.as_str());
    let sample =
        json!({ "written name": "salt", "batch identifier": "L-42", "sample identifier": "A1" });
    assert_eq!(measured["sample document"], sample);
    let readings = measured["data cube"]["data"]["measures"][0].as_array().unwrap();
    assert_eq!(readings.len(), detail["ticks"].as_array().unwrap().len());
    let custom = measured["custom information aggregate document"]["custom information document"]
        .as_array()
        .unwrap();
    assert!(custom.contains(&json!({ "datum label": "outcome", "scalar string datum": "within" })));
}
