//! Who may do what: every operation of the OpenAPI document, every kind of caller.

use crate::document::operations;
use crate::harness::{Service, problem};
use flip::api::ServeConfig;
use flip::app::Role;
use serde_json::json;

/// The least role of an operation. Unlisted operations require a viewer for GET and an operator
/// otherwise, so a new operation cannot be open by oversight.
fn least(method: &str, path: &str) -> Option<Role> {
    Some(match (method, path) {
        // Who logs in has no token yet.
        (_, "/v1/login" | "/v1/login/finish") => return None,
        (_, "/v1/tokens" | "/v1/tokens/{id}" | "/v1/webhooks" | "/v1/webhooks/{id}") => Role::Admin,
        // An operator's too, if the token was made for it; these were not.
        ("POST", "/v1/bench/clear" | "/v1/benches/{name}/clear") => Role::Admin,
        ("GET", _) => Role::Viewer,
        _ => Role::Operator,
    })
}

/// Sends the operation with an empty body and an id that does not exist: authorised callers get a
/// status other than 401 or 403, and nothing is changed.
async fn status(service: &Service, method: &str, path: &str, token: Option<&str>) -> u16 {
    let path = path.replace("{id}", "none").replace("{name}", "none");
    let mut request = service.request(method, &path);
    if method != "GET" {
        request = request.json(&json!({ "no such field": 1 }));
    }
    if let Some(token) = token {
        request = request.bearer_auth(token);
    }
    request.send().await.unwrap().status().as_u16()
}

async fn check_every_operation(service: &Service, anonymous_reads: bool) {
    let callers = [None, Some(Role::Viewer), Some(Role::Operator), Some(Role::Admin)];
    let mut cells = 0;
    for (method, path, _) in operations() {
        for caller in callers {
            let token = match caller {
                Some(role) => Some(service.token(role).await),
                None => None,
            };
            let least = least(&method, &path);
            let expected = match caller {
                _ if least.is_none() => None,
                None if anonymous_reads && least == Some(Role::Viewer) => None,
                None => Some(401),
                role if role >= least => None,
                Some(_) => Some(403),
            };
            let status = status(service, &method, &path, token.as_deref()).await;
            let refused = matches!(status, 401 | 403).then_some(status);
            assert_eq!(refused, expected, "{method} {path} as {caller:?}: {status}");
            cells += 1;
        }
    }
    assert!(cells >= 4 * 30, "only {cells} cells");
}

#[tokio::test]
async fn on_loopback_anyone_reads_and_only_roles_write() {
    check_every_operation(&Service::start().await, true).await;
}

#[tokio::test]
async fn on_other_addresses_nobody_reads_without_a_token() {
    let exposed =
        ServeConfig { insecure_lan: true, ..ServeConfig::loopback("0.0.0.0:0".parse().unwrap()) };
    let service = Service::start_at(exposed).await;
    check_every_operation(&service, false).await;
    problem(service.get("/metrics").await, 401).await;
    assert_eq!(service.get("/healthz").await.status(), 200);
    assert_eq!(service.get("/").await.status(), 200);
}

#[tokio::test]
async fn tokens_that_are_not_known_are_refused_even_where_none_is_needed() {
    let service = Service::start().await;
    let known = service.token(Role::Admin).await;
    let mut forged = known.clone();
    forged.replace_range(known.len() - 1.., if known.ends_with('A') { "B" } else { "A" });
    for header in
        [format!("Bearer {forged}"), "Bearer flip_none".into(), format!("Basic {known}"), known]
    {
        let request = service.request("GET", "/v1/powders").header("authorization", &header);
        let response = request.send().await.unwrap();
        assert!(
            response.headers()["www-authenticate"].to_str().unwrap().starts_with("Bearer"),
            "{header}"
        );
        problem(response, 401).await;
    }
}

#[tokio::test]
async fn a_page_that_points_its_own_name_at_us_reads_nothing() {
    let service = Service::start().await;
    let request = service.request("GET", "/v1/powders").header("host", "rebound.example");
    problem(request.send().await.unwrap(), 401).await;
}

#[tokio::test]
async fn a_page_of_another_origin_cannot_write_even_with_a_token() {
    let service = Service::start().await;
    let token = service.token(Role::Operator).await;
    let new = json!({ "id": "flour", "name": "Flour" });
    for (name, value) in [("origin", "http://elsewhere.example"), ("sec-fetch-site", "cross-site")]
    {
        let request = service
            .request("POST", "/v1/powders")
            .bearer_auth(&token)
            .header(name, value)
            .json(&new);
        problem(request.send().await.unwrap(), 403).await;
    }
    let ours = service.url("").trim_end_matches('/').to_owned();
    let request = service
        .request("POST", "/v1/powders")
        .bearer_auth(&token)
        .header("origin", ours)
        .json(&new);
    assert_eq!(request.send().await.unwrap().status(), 201);
}

#[tokio::test]
async fn an_admin_makes_a_token_that_works() {
    let service = Service::start().await;
    let admin = service.token(Role::Admin).await;
    let request = service.request("POST", "/v1/tokens").bearer_auth(&admin);
    let response =
        request.json(&json!({ "name": "robot", "role": "operator" })).send().await.unwrap();
    assert_eq!(response.status(), 201);
    let token: serde_json::Value = response.json().await.unwrap();
    let new = json!({ "id": "flour", "name": "Flour" });
    let request =
        service.request("POST", "/v1/powders").bearer_auth(token["secret"].as_str().unwrap());
    assert_eq!(request.json(&new).send().await.unwrap().status(), 201);
}
