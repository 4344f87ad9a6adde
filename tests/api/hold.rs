//! Stop, resume, vials and reservations: the same over both transports.

use crate::grpc::{as_operator, channel, problem_of};
use crate::harness::{Service, problem};
use flip::api::grpc::proto;
use flip::api::grpc::proto::bench_client::BenchClient;
use flip::api::grpc::proto::weighings_client::WeighingsClient;
use flip::app::Role;
use serde_json::{Value, json};
use tonic::Code;

async fn post(service: &Service, path: &str, body: &Value) -> reqwest::Response {
    let request = service.request("POST", path).bearer_auth(service.token(Role::Operator).await);
    request.json(body).send().await.unwrap()
}

fn salt() -> Value {
    json!({
        "powder": "salt",
        "target": { "value": 15.0, "unit": "mg" },
        "tolerance": { "lower": 10, "upper": 10, "unit": "%" },
        "asked": { "vial": "A7" },
    })
}

#[tokio::test]
async fn a_bench_that_was_stopped_over_one_transport_is_resumed_over_the_other() {
    let service = Service::ready().await;
    let mut bench = BenchClient::new(channel(&service).await);
    let stopped: Value = post(&service, "/v1/bench/stop", &json!({})).await.json().await.unwrap();
    assert!(stopped["held"]["at"].is_string() && stopped["latch"].is_null(), "{stopped}");
    assert_eq!(
        (&stopped["exchanges_vials"], &stopped["vial"], &stopped["reservation"]),
        (&json!(true), &json!(null), &json!(null))
    );
    let waits: Value = service.weigh("waits", &salt()).await.json().await.unwrap();
    let found: Value = service.get("/v1/bench").await.json().await.unwrap();
    let waiting = json!([{ "id": waits["id"], "powder": "salt", "target_mg": 15.0, "vial": "A7", "state": "planned" }]);
    assert_eq!(found["waiting"], waiting);

    let mut over_grpc = bench.get_bench(proto::GetBenchRequest {}).await.unwrap().into_inner();
    assert!(over_grpc.held.is_some() && over_grpc.exchanges_vials == Some(true));
    let waiting = over_grpc.waiting.remove(0);
    assert_eq!(
        (waiting.id.as_str(), waiting.vial.as_deref()),
        (waits["id"].as_str().unwrap(), Some("A7"))
    );
    let nameless = proto::ResumeBenchRequest::default();
    let refused = bench.resume_bench(as_operator(&service, nameless).await).await.unwrap_err();
    assert_eq!(refused.code(), Code::InvalidArgument);
    let by = proto::ResumeBenchRequest { by: "Ada".into(), note: String::new() };
    let resumed = bench.resume_bench(as_operator(&service, by).await).await.unwrap().into_inner();
    assert!(resumed.held.is_none());
    service
        .watch(&format!("/v1/weighings/{}/events", waits["id"].as_str().unwrap()), None)
        .await
        .unwrap();
    assert_eq!(service.pours(), 1);
    let refused =
        problem(post(&service, "/v1/bench/resume", &json!({ "by": "Ada" })).await, 409).await;
    assert_eq!(refused["type"], "urn:flip:problem:bench-not-held");
    bench.stop_bench(as_operator(&service, proto::StopBenchRequest {}).await).await.unwrap();
    let resumed =
        post(&service, "/v1/bench/resume", &json!({ "by": "Ada", "note": "looked" })).await;
    assert_eq!(resumed.json::<Value>().await.unwrap()["held"], json!(null));
}

#[tokio::test]
async fn a_reservation_keeps_others_out_over_both_transports() {
    let service = Service::ready().await;
    let mut bench = BenchClient::new(channel(&service).await);
    let answer =
        post(&service, "/v1/bench/reservation", &json!({ "owner": "Ada", "seconds": 600 })).await;
    assert_eq!(answer.status(), 201);
    let reserved: Value = answer.json().await.unwrap();
    let id = reserved["id"].as_str().unwrap();
    assert_eq!(
        problem(service.weigh("other", &salt()).await, 409).await["type"],
        "urn:flip:problem:bench-reserved"
    );
    let request = proto::ReserveBenchRequest { owner: "Bob".into(), seconds: 60, id: None };
    let refused = bench.reserve_bench(as_operator(&service, request).await).await.unwrap_err();
    assert_eq!(problem_of(&refused)["type"], "urn:flip:problem:bench-reserved");
    let mut own = salt();
    own["reservation"] = json!(id);
    assert_eq!(service.weigh("own", &own).await.status(), 202);
    let path = format!("/v1/bench/reservation/{id}");
    let release = service
        .request("DELETE", &path)
        .bearer_auth(service.token(Role::Operator).await)
        .send()
        .await
        .unwrap();
    assert_eq!(
        (release.status().as_u16(), &release.json::<Value>().await.unwrap()["reservation"]),
        (200, &json!(null))
    );
    // The same request once the reservation has ended is the same dose.
    let again = service.weigh("own", &salt()).await;
    assert_eq!(again.headers()["idempotency-replayed"], "true");
    let request = proto::ReleaseBenchRequest { id: id.to_owned() };
    let gone = bench.release_bench(as_operator(&service, request).await).await.unwrap_err();
    assert_eq!(gone.code(), Code::NotFound);
}

#[tokio::test]
async fn a_vial_is_asked_for_only_where_it_is_the_weighings_turn() {
    let service = Service::ready().await;
    let mut weighings = WeighingsClient::new(channel(&service).await);
    post(&service, "/v1/bench/stop", &json!({})).await;
    let waits: Value = service.weigh("waits", &salt()).await.json().await.unwrap();
    let id = waits["id"].as_str().unwrap().to_owned();
    // This bench exchanges vials: nothing waits for one.
    let refused =
        problem(post(&service, &format!("/v1/weighings/{id}/vial-ready"), &json!({})).await, 409)
            .await;
    assert_eq!(refused["type"], "urn:flip:problem:not-its-turn");
    let request = proto::VialReadyRequest { id, by: None, vial: None };
    let refused = weighings.vial_ready(as_operator(&service, request).await).await.unwrap_err();
    assert_eq!(problem_of(&refused)["type"], "urn:flip:problem:not-its-turn");
    problem(post(&service, "/v1/weighings/none/vial-ready", &json!({ "by": "Ada" })).await, 404)
        .await;
}
