//! What a person checks before a dose: written by the lab, confirmed with the request, on the
//! certificate.

use crate::grpc::{as_operator, channel};
use crate::harness::{Service, fields, problem};
use flip::api::grpc::proto;
use flip::api::grpc::proto::bench_client::BenchClient;
use flip::app::Role;
use serde_json::{Value, json};

async fn put(service: &Service, items: &Value) -> reqwest::Response {
    let request = service.request("PUT", "/v1/bench/checklist");
    let request = request.bearer_auth(service.token(Role::Operator).await);
    request.json(&json!({ "items": items })).send().await.unwrap()
}

async fn checklist(service: &Service) -> Value {
    service.get("/v1/bench/checklist").await.json().await.unwrap()
}

#[tokio::test]
async fn a_lab_writes_its_own_checklist_over_rest_and_grpc() {
    let service = Service::start().await;
    let shipped = checklist(&service).await;
    assert_eq!(
        (shipped["items"].as_array().unwrap().len(), &shipped["changed_at"]),
        (3, &Value::Null)
    );
    let own = json!(["Glove box closed", "Spoon 3 gripped"]);
    let changed = put(&service, &own).await;
    assert_eq!(changed.status(), 200);
    assert_eq!(checklist(&service).await["items"], own);
    let mut client = BenchClient::new(channel(&service).await);
    let of_grpc = client.get_checklist(proto::GetChecklistRequest {}).await.unwrap().into_inner();
    assert_eq!((json!(of_grpc.items), of_grpc.changed_at.is_some()), (own, true));
    let none = proto::ChangeChecklistRequest { items: Vec::new() };
    let none = client.change_checklist(as_operator(&service, none).await).await.unwrap();
    assert!(none.into_inner().items.is_empty(), "a lab may want none");
    assert_eq!(checklist(&service).await["items"], json!([]));
    let audit: Value = service.get("/v1/audit?limit=1").await.json().await.unwrap();
    assert_eq!(audit["items"][0]["body"]["action"], "change checklist");
}

#[tokio::test]
async fn items_have_words_a_bound_and_no_doubles() {
    let service = Service::start().await;
    let long = "x".repeat(201);
    for (items, field) in [
        (json!(["a", " "]), "items[1]"),
        (json!([long]), "items[0]"),
        (json!(["a", "b", "a"]), "items[2]"),
        (json!((0..21).map(|k| k.to_string()).collect::<Vec<_>>()), "items"),
    ] {
        let refused = problem(put(&service, &items).await, 400).await;
        assert_eq!(fields(&refused), [field], "{refused}");
    }
    assert_eq!(checklist(&service).await["changed_at"], Value::Null, "nothing was kept");
}

#[tokio::test]
async fn what_was_confirmed_is_kept_with_the_dose_and_stands_on_its_certificate() {
    let service = Service::ready().await;
    let body = |checked: Value| {
        json!({
            "powder": "salt", "target": { "value": 15, "unit": "mg" },
            "tolerance": { "lower": 1, "upper": 1, "unit": "mg" },
            "asked": { "checked": checked },
        })
    };
    let send = async |key: &str, checked: Value| {
        let request = service.request("POST", "/v1/weighings").header("Idempotency-Key", key);
        let request = request.bearer_auth(service.token(Role::Operator).await);
        request.json(&body(checked)).send().await.unwrap()
    };
    let refused = problem(send("a", json!(["a", "a"])).await, 400).await;
    assert_eq!(fields(&refused), ["asked.checked[1]"], "{refused}");
    let planned: Value =
        send("b", json!(["Glove box closed", "Spoon < 3"])).await.json().await.unwrap();
    let id = planned["id"].as_str().unwrap();
    service.watch(&format!("/v1/weighings/{id}/events"), None).await.unwrap();
    let detail: Value = service.get(&format!("/v1/weighings/{id}")).await.json().await.unwrap();
    assert_eq!(detail["weighing"]["asked"]["checked"], json!(["Glove box closed", "Spoon < 3"]));
    let path = format!("/v1/weighings/{id}/certificate.html");
    let certificate = service.get(&path).await.text().await.unwrap();
    assert!(certificate.contains("Glove box closed; Spoon &lt; 3"), "{certificate}");
}
