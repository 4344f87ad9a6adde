//! Log-ins with the lab's own accounts, through the sockets of the service and of a provider.

use crate::grpc::with_token;
use crate::harness::{Service, problem};
use crate::login_provider::{PAGE, Provider, settings};
use flip::api::grpc::proto::tokens_client::TokensClient;
use flip::api::grpc::proto::{
    BeginLogInRequest, FinishLogInRequest, GetIdentityRequest, GetLogInRequest,
};
use flip::app::Role;
use reqwest::Response;
use serde_json::{Value, json};
use std::time::Duration;
use tonic::Code;

async fn started() -> (Service, Provider) {
    let provider = Provider::start().await;
    (Service::start_beside(settings(&provider.issuer)).await, provider)
}

async fn begin(service: &Service) -> Value {
    let response = service.request("POST", "/v1/login").send().await.unwrap();
    assert_eq!(response.status(), 200);
    response.json().await.unwrap()
}

/// What the provider gives the browser: code and state.
async fn at_provider(url: &str) -> (String, String) {
    let browser = reqwest::Client::builder().redirect(reqwest::redirect::Policy::none());
    let response = browser.build().unwrap().get(url).send().await.unwrap();
    let back = response.headers()["location"].to_str().unwrap().to_owned();
    let query = back.strip_prefix(&format!("{PAGE}?")).unwrap();
    let value = |name: &str| {
        let pair = query.split('&').find_map(|it| it.strip_prefix(&format!("{name}=")));
        pair.unwrap().to_owned()
    };
    (value("code"), value("state"))
}

async fn finish(service: &Service, code: &str, state: &str, secret: &Value) -> Response {
    let answer = json!({ "code": code, "state": state, "secret": secret });
    service.request("POST", "/v1/login/finish").json(&answer).send().await.unwrap()
}

async fn log_in(service: &Service) -> Response {
    let begun = begin(service).await;
    let (code, state) = at_provider(begun["url"].as_str().unwrap()).await;
    finish(service, &code, &state, &begun["secret"]).await
}

async fn refused(response: Response, reason: &str) {
    let detail = problem(response, 403).await["detail"].as_str().unwrap().to_owned();
    assert!(detail.contains(reason), "{reason}: {detail}");
}

#[tokio::test]
async fn a_person_logs_in_and_has_a_token_of_flips_own() {
    let (service, provider) = started().await;
    let offer: Value = service.get("/v1/login").await.json().await.unwrap();
    assert_eq!(offer["provider"], provider.issuer.strip_prefix("http://").unwrap());
    let response = log_in(&service).await;
    assert_eq!(response.status(), 201);
    let token: Value = response.json().await.unwrap();
    assert_eq!(
        (&token["name"], &token["role"], &token["may_clear"]),
        (&json!("Ada"), &json!("operator"), &json!(false)),
        "of staff and balance, the higher role"
    );
    assert_eq!(
        (&token["issuer"], &token["subject"]),
        (&json!(provider.issuer), &json!("person-17"))
    );
    let secret = token["secret"].as_str().unwrap();

    let me = service.request("GET", "/v1/me").bearer_auth(secret).send().await.unwrap();
    let me: Value = me.json().await.unwrap();
    assert_eq!((&me["name"], &me["issuer"]), (&json!("Ada"), &json!(provider.issuer)));
    let left = time_left_h(me["expires_at"].as_str().unwrap());
    assert!((11.9..=12.0).contains(&left), "{left} h");
    let mut tokens = TokensClient::connect(service.url("")).await.unwrap();
    let who = tokens.get_identity(with_token(secret, GetIdentityRequest {})).await.unwrap();
    assert_eq!(who.into_inner().issuer, Some(provider.issuer.clone()));
    let powder = json!({ "id": "flour", "name": "Flour" });
    let request = service.request("POST", "/v1/powders").bearer_auth(secret).json(&powder);
    assert_eq!(request.send().await.unwrap().status(), 201);

    // Recorded as the making of any token, by the person; and the record still matches the table.
    let audit: Value = service.get("/v1/audit?limit=50").await.json().await.unwrap();
    let made = audit["items"].as_array().unwrap().iter().find(|it| {
        it["body"]["action"] == "new token" && it["body"]["token"]["subject"] == "person-17"
    });
    let made = &made.unwrap()["body"];
    assert_eq!((&made["who"]["name"], &made["who"]["token"]), (&json!("Ada"), &token["id"]));
    let verified: Value = service.get("/v1/audit/verification").await.json().await.unwrap();
    assert_eq!((&verified["broken"], verified.get("others")), (&Value::Null, None), "{verified}");

    // People lists it, and revokes it.
    let admin = service.token(Role::Admin).await;
    let list = service.request("GET", "/v1/tokens").bearer_auth(&admin).send().await.unwrap();
    let list: Value = list.json().await.unwrap();
    let listed = list["items"].as_array().unwrap().iter().find(|it| it["id"] == token["id"]);
    assert_eq!(listed.unwrap()["issuer"], provider.issuer);
    let path = format!("/v1/tokens/{}", token["id"].as_str().unwrap());
    let revoked = service.request("DELETE", &path).bearer_auth(&admin).send().await.unwrap();
    assert_eq!(revoked.status(), 200);
    problem(service.request("GET", "/v1/me").bearer_auth(secret).send().await.unwrap(), 401).await;
}

fn time_left_h(at: &str) -> f64 {
    let end = time::OffsetDateTime::parse(at, &time::format_description::well_known::Rfc3339);
    (end.unwrap() - time::OffsetDateTime::now_utc()).as_seconds_f64() / 3600.0
}

#[tokio::test]
async fn a_token_of_the_provider_that_cannot_be_trusted_opens_nothing() {
    let (service, provider) = started().await;
    for (claim, value, reason) in [
        ("nonce", json!("another"), "another log-in"),
        ("exp", json!(1_300_819_380), "expired"),
        ("aud", json!("another program"), "another program"),
        ("iss", json!("https://evil.example"), "somebody else"),
        ("groups", json!(["visitors"]), "none of the groups there has a role here"),
        ("groups", Value::Null, "none of the groups there has a role here"),
    ] {
        provider.says(move |claims| claims[claim] = value.clone());
        refused(log_in(&service).await, reason).await;
    }
    provider.says(|_| {});
    provider.forges();
    refused(log_in(&service).await, "signature").await;
    assert!(service.app.tokens(flip::app::PageQuery::default()).await.unwrap().items.is_empty());
}

#[tokio::test]
async fn a_log_in_counts_once_and_for_whoever_began_it() {
    let (service, _provider) = started().await;
    let begun = begin(&service).await;
    let (code, state) = at_provider(begun["url"].as_str().unwrap()).await;
    let reason = "not begun in this tab";
    refused(finish(&service, &code, "another", &begun["secret"]).await, reason).await;
    assert_eq!(finish(&service, &code, &state, &begun["secret"]).await.status(), 201);
    refused(finish(&service, &code, &state, &begun["secret"]).await, reason).await;

    // Whoever reads the address in a log has code and state, and not the secret.
    let begun = begin(&service).await;
    let (code, state) = at_provider(begun["url"].as_str().unwrap()).await;
    refused(finish(&service, &code, &state, &json!("guess")).await, reason).await;
    // The code of one log-in does not finish another: neither used, nor unused (PKCE).
    for used in ["code-1", code.as_str()] {
        let own = begin(&service).await;
        let (_, state) = at_provider(own["url"].as_str().unwrap()).await;
        refused(finish(&service, used, &state, &own["secret"]).await, "does not accept the code")
            .await;
    }
}

#[tokio::test]
async fn nothing_in_a_request_says_where_a_browser_is_sent() {
    let (service, provider) = started().await;
    let evil = "https%3A%2F%2Fevil.example";
    let path = format!("/v1/login?redirect_uri={evil}&redirect_url={evil}&next={evil}");
    let begun: Value = service.request("POST", &path).send().await.unwrap().json().await.unwrap();
    let url = begun["url"].as_str().unwrap();
    assert!(url.starts_with(&format!("{}/authorize?", provider.issuer)), "{url}");
    assert!(!url.contains("evil"), "{url}");
    let back = service.get(&format!("/?code=c&state=s&next={evil}")).await;
    assert_eq!((back.status().as_u16(), back.headers().get("location")), (200, None));
    let extra =
        json!({ "code": "c", "state": "s", "secret": "x", "redirect_url": "https://evil.example" });
    let request = service.request("POST", "/v1/login/finish").json(&extra);
    problem(request.send().await.unwrap(), 400).await;
    let foreign = service.request("POST", "/v1/login").header("origin", "https://evil.example");
    problem(foreign.send().await.unwrap(), 403).await;
}

#[tokio::test]
async fn a_provider_that_is_down_keeps_nobody_from_weighing_and_is_tried_again() {
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let service = Service::start_beside(settings(&format!("http://{free}"))).await;
    assert_eq!(service.get("/v1/powders").await.status(), 200);
    let response = service.request("POST", "/v1/login").send().await.unwrap();
    let detail = problem(response, 503).await["detail"].as_str().unwrap().to_owned();
    assert!(detail.contains(&free.to_string()) && detail.contains("cannot be reached"), "{detail}");
    let _provider = Provider::start_at(free).await;
    tokio::time::sleep(Duration::from_millis(2200)).await;
    assert_eq!(log_in(&service).await.status(), 201);
}

#[tokio::test]
async fn a_provider_by_another_name_is_not_believed() {
    let provider = Provider::start().await;
    let service = Service::start_beside(settings(&format!("{}/", provider.issuer))).await;
    let response = service.request("POST", "/v1/login").send().await.unwrap();
    let detail = problem(response, 503).await["detail"].as_str().unwrap().to_owned();
    assert!(detail.contains("--oidc-issuer must be exactly that"), "{detail}");
}

#[tokio::test]
async fn a_service_without_a_provider_says_so() {
    let service = Service::start().await;
    let offer: Value = service.get("/v1/login").await.json().await.unwrap();
    assert_eq!(offer, json!({ "provider": null }));
    let response = service.request("POST", "/v1/login").send().await.unwrap();
    let told = problem(response, 409).await;
    assert_eq!(told["type"], "urn:flip:problem:log-in-not-set-up");
}

#[tokio::test]
async fn a_log_in_is_the_same_over_grpc() {
    let (service, provider) = started().await;
    let mut tokens = TokensClient::connect(service.url("")).await.unwrap();
    let offer = tokens.get_log_in(GetLogInRequest {}).await.unwrap().into_inner();
    assert_eq!(offer.provider.as_deref(), provider.issuer.strip_prefix("http://"));
    let begun = tokens.begin_log_in(BeginLogInRequest {}).await.unwrap().into_inner();
    let (code, state) = at_provider(&begun.url).await;
    assert_eq!(state, begun.state);
    let answer = FinishLogInRequest { state, code, secret: begun.secret };
    let made = tokens.finish_log_in(answer.clone()).await.unwrap().into_inner();
    let entry = made.token.unwrap();
    assert_eq!((entry.name.as_str(), entry.subject()), ("Ada", "person-17"));
    assert_eq!(tokens.finish_log_in(answer).await.unwrap_err().code(), Code::PermissionDenied);
}
