//! Webhooks, told over real sockets: signed, repeated until accepted, and not lost by a restart.

use crate::harness::{Service, fields, problem};
use axum::body::Bytes;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flip::app::Role;
use ring::hmac;
use serde_json::{Value, json};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// A scheduler's server: refuses the first `refuse` messages, keeps the others.
#[derive(Clone, Default)]
struct Receiver {
    refuse: Arc<AtomicUsize>,
    tried: Arc<Mutex<Vec<String>>>,
    kept: Arc<Mutex<Vec<(HeaderMap, Bytes)>>>,
}

async fn receive(State(receiver): State<Receiver>, headers: HeaderMap, body: Bytes) -> StatusCode {
    let id = headers["webhook-id"].to_str().unwrap().to_owned();
    receiver.tried.lock().unwrap().push(id);
    let left =
        receiver.refuse.fetch_update(Ordering::SeqCst, Ordering::SeqCst, |n| n.checked_sub(1));
    if left.is_ok() {
        return StatusCode::SERVICE_UNAVAILABLE;
    }
    receiver.kept.lock().unwrap().push((headers, body));
    StatusCode::NO_CONTENT
}

impl Receiver {
    /// Its address.
    async fn listen(&self) -> String {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let router = axum::Router::new()
            .route("/flip", axum::routing::post(receive))
            .with_state(self.clone());
        tokio::spawn(async move { axum::serve(listener, router).await.unwrap() });
        format!("http://{address}/flip")
    }

    /// The messages of a type, once there are so many.
    async fn of_type(&self, kind: &str, count: usize) -> Vec<(HeaderMap, Bytes)> {
        for _ in 0..1500 {
            let kept = self.kept.lock().unwrap().clone();
            let found: Vec<_> = kept
                .into_iter()
                .filter(|(_, body)| serde_json::from_slice::<Value>(body).unwrap()["type"] == kind)
                .collect();
            if found.len() >= count {
                return found;
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        panic!("no {count} messages of {kind}: {:?}", self.kept.lock().unwrap());
    }
}

async fn add(service: &Service, url: &str) -> Value {
    let token = service.token(Role::Admin).await;
    let request = service.request("POST", "/v1/webhooks").bearer_auth(token);
    let added = request.json(&json!({ "url": url })).send().await.unwrap();
    assert_eq!(added.status(), 201);
    added.json().await.unwrap()
}

async fn dosed(service: &Service, key: &str) -> Value {
    let dose = json!({
        "powder": "salt",
        "target": { "value": 15.0, "unit": "mg" },
        "tolerance": { "lower": 1, "upper": 1, "unit": "mg" },
    });
    let planned: Value = service.weigh(key, &dose).await.json().await.unwrap();
    let path = format!("/v1/weighings/{}?wait=60", planned["id"].as_str().unwrap());
    service.get(&path).await.json::<Value>().await.unwrap()["weighing"].clone()
}

#[tokio::test]
async fn an_end_is_told_signed_and_repeated_until_it_is_accepted() {
    let service = Service::ready().await;
    let receiver = Receiver::default();
    receiver.refuse.store(1, Ordering::SeqCst);
    let added = add(&service, &receiver.listen().await).await;
    let weighing = dosed(&service, "told").await;
    let told = receiver.of_type("weighing.ended", 1).await;
    let (headers, body) = &told[0];
    let message: Value = serde_json::from_slice(body).unwrap();
    assert_eq!(message["data"], weighing, "as REST gives it");
    let tried = receiver.tried.lock().unwrap().clone();
    assert_eq!(tried[0], tried[1], "the same message again, by its id");
    assert_eq!(headers["webhook-id"].to_str().unwrap(), tried[0]);
    assert_eq!(tried[0], format!("event-{}", message["seq"]));

    let secret = added["secret"].as_str().unwrap().strip_prefix("whsec_").unwrap();
    let key = hmac::Key::new(hmac::HMAC_SHA256, &STANDARD.decode(secret).unwrap());
    let text = |name: &str| headers[name].to_str().unwrap();
    let mut signed = format!("{}.{}.", text("webhook-id"), text("webhook-timestamp")).into_bytes();
    signed.extend_from_slice(body);
    let signature = text("webhook-signature").strip_prefix("v1,").unwrap();
    hmac::verify(&key, &signed, &STANDARD.decode(signature).unwrap()).expect("it is signed");
}

#[tokio::test]
async fn what_nobody_accepts_delays_no_other_webhook_and_is_shown() {
    let service = Service::ready().await;
    let gone = add(&service, "http://127.0.0.1:9/flip").await;
    let receiver = Receiver::default();
    add(&service, &receiver.listen().await).await;
    dosed(&service, "one").await;
    dosed(&service, "two").await;
    receiver.of_type("weighing.ended", 2).await;
    let admin = service.token(Role::Admin).await;
    let list = async || -> Value {
        let request = service.request("GET", "/v1/webhooks").bearer_auth(&admin);
        request.send().await.unwrap().json().await.unwrap()
    };
    let mut listed = list().await;
    while listed[0]["failing_since"].is_null() {
        tokio::time::sleep(Duration::from_millis(20)).await;
        listed = list().await;
    }
    assert!(!listed[0]["error"].as_str().unwrap().is_empty());
    assert!(listed[1]["failing_since"].is_null());
    assert!(listed[0]["secret"].is_null(), "shown once");
    let path = format!("/v1/webhooks/{}", gone["id"].as_str().unwrap());
    let remove =
        async || service.request("DELETE", &path).bearer_auth(&admin).send().await.unwrap();
    assert_eq!(remove().await.status(), 204);
    problem(remove().await, 404).await;
    assert_eq!(list().await.as_array().unwrap().len(), 1);
}

#[tokio::test]
async fn only_admins_add_webhooks_and_only_to_addresses() {
    let service = Service::start().await;
    let operator = service.token(Role::Operator).await;
    let request = service.request("POST", "/v1/webhooks").bearer_auth(operator);
    problem(request.json(&json!({ "url": "http://lab/x" })).send().await.unwrap(), 403).await;
    let admin = service.token(Role::Admin).await;
    for url in ["lab/x", "ftp://lab/x", "https://", "javascript:alert(1)"] {
        let request = service.request("POST", "/v1/webhooks").bearer_auth(&admin);
        let refused = request.json(&json!({ "url": url })).send().await.unwrap();
        assert_eq!(fields(&problem(refused, 400).await), ["url"], "{url}");
    }
}
