//! Tokens: made, listed, ended, also by another process; and who did what in the record.

use crate::grpc::with_token;
use crate::harness::{Service, problem, storage};
use flip::api::grpc::proto::tokens_client::TokensClient;
use flip::api::grpc::proto::weighings_client::WeighingsClient;
use flip::api::grpc::proto::{
    CreateTokenRequest, GetIdentityRequest, ListTokensRequest, RevokeTokenRequest,
    Role as WireRole, WatchRequest,
};
use flip::app::{App, NewToken, Role, Who, acting};
use serde_json::{Value, json};
use std::time::Duration;
use tonic::Code;

async fn may_write(service: &Service, token: &str, powder: &str) -> u16 {
    let new = json!({ "id": powder, "name": powder });
    service
        .request("POST", "/v1/powders")
        .bearer_auth(token)
        .json(&new)
        .send()
        .await
        .unwrap()
        .status()
        .as_u16()
}

/// Bodies of records of persons' actions, newest first.
async fn deeds(service: &Service) -> Vec<Value> {
    let page: Value = service.get("/v1/audit?limit=200").await.json().await.unwrap();
    let records =
        page["items"].as_array().unwrap().iter().filter(|record| record["kind"] == "person");
    records.map(|record| record["body"].clone()).collect()
}

#[tokio::test]
async fn a_token_that_another_process_made_opens_at_once_and_one_that_it_revoked_closes() {
    let service = Service::start().await;
    let other = App::open_beside(storage(service.folder()).await).await.unwrap();
    let secret = other.create_token("from beside", Role::Operator).await.unwrap();
    assert_eq!(may_write(&service, &secret, "flour").await, 201);
    let id = secret.split('_').nth(1).unwrap();
    other.revoke_token(id).await.unwrap();
    while may_write(&service, &secret, "flour").await != 401 {
        tokio::task::yield_now().await;
    }
    // Both wrote into one chain.
    assert_eq!(service.app.verify_audit(None).await.unwrap().broken, None);
    other.shutdown().await.unwrap();
}

#[tokio::test]
async fn tokens_are_listed_without_their_secrets_and_end_when_they_are_revoked() {
    let service = Service::start().await;
    let admin = service.token(Role::Admin).await;
    let as_admin = |method: &str, path: &str| service.request(method, path).bearer_auth(&admin);
    let new =
        json!({ "name": "robot", "role": "operator", "may_clear": true, "expires_in_s": 3600 });
    let made: Value =
        as_admin("POST", "/v1/tokens").json(&new).send().await.unwrap().json().await.unwrap();
    let (id, secret) = (made["id"].as_str().unwrap(), made["secret"].as_str().unwrap());
    assert_eq!(
        (made["may_clear"].as_bool(), made["expires_at"].is_string()),
        (Some(true), true),
        "{made}"
    );
    assert_eq!(may_write(&service, secret, "flour").await, 201);

    let list = as_admin("GET", "/v1/tokens").send().await.unwrap().text().await.unwrap();
    assert!(!list.contains(secret) && !list.contains("sha256"), "{list}");
    let list: Value = serde_json::from_str(&list).unwrap();
    let entry = list["items"].as_array().unwrap().iter().find(|it| it["id"] == id).unwrap();
    assert_eq!((&entry["name"], &entry["role"]), (&json!("robot"), &json!("operator")));
    assert!(entry["last_used_at"].is_string() && entry["revoked_at"].is_null(), "{entry}");

    let path = format!("/v1/tokens/{id}");
    let ended: Value = as_admin("DELETE", &path).send().await.unwrap().json().await.unwrap();
    assert!(ended["revoked_at"].is_string(), "{ended}");
    assert_eq!(may_write(&service, secret, "rye").await, 401);
    let again: Value = as_admin("DELETE", &path).send().await.unwrap().json().await.unwrap();
    assert_eq!(again["revoked_at"], ended["revoked_at"]);
    problem(as_admin("DELETE", "/v1/tokens/0000").send().await.unwrap(), 404).await;
    for wrong in [json!(0), json!(u64::MAX), json!(-1)] {
        let new = json!({ "name": "robot", "role": "viewer", "expires_in_s": wrong });
        problem(as_admin("POST", "/v1/tokens").json(&new).send().await.unwrap(), 400).await;
    }
}

/// Follows everything, one weighing, and the same over gRPC with a token; ends when all of these
/// end.
async fn follow(service: &Service, weighing: &str, token: &str, then: impl AsyncFnOnce()) {
    let sse = async |path: &str| {
        let stream = service.request("GET", path).bearer_auth(token).send().await.unwrap();
        assert_eq!(stream.status(), 200);
        stream
    };
    let (all, one) =
        (sse("/v1/events").await, sse(&format!("/v1/weighings/{weighing}/events")).await);
    let mut client = WeighingsClient::connect(service.url("")).await.unwrap();
    let asked = with_token(token, WatchRequest { id: weighing.to_owned(), after_seq: 0 });
    let mut watch = client.watch_weighing(asked).await.unwrap().into_inner();
    then().await;
    let grpc = async {
        loop {
            match watch.message().await {
                Ok(event) => assert!(event.is_some(), "an end that looks like the weighing's"),
                Err(status) => return status,
            }
        }
    };
    let ended = async { tokio::join!(all.text(), one.text(), grpc) };
    let (all, one, grpc) =
        tokio::time::timeout(Duration::from_secs(10), ended).await.expect("streams end");
    assert!(all.is_ok() && one.unwrap().contains("event:"));
    assert_eq!(grpc.code(), Code::Unauthenticated, "{grpc}");
}

#[tokio::test]
async fn streams_of_events_end_when_their_token_expires_or_is_revoked_here_or_elsewhere() {
    let service = Service::ready().await;
    let _held = service.hold_bench();
    let (target, tolerance) =
        (json!({ "value": 15, "unit": "mg" }), json!({ "lower": 1, "upper": 1, "unit": "mg" }));
    let body = json!({ "powder": "salt", "target": target, "tolerance": tolerance });
    let weighing: Value = service.weigh("followed", &body).await.json().await.unwrap();
    let weighing = weighing["id"].as_str().unwrap();
    let id = |secret: &str| secret.split('_').nth(1).unwrap().to_owned();

    let secret = service.token(Role::Viewer).await;
    follow(&service, weighing, &secret, async || {
        drop(service.app.revoke_token(&id(&secret)).await.unwrap())
    })
    .await;
    let other = App::open_beside(storage(service.folder()).await).await.unwrap();
    let secret = service.token(Role::Admin).await;
    follow(&service, weighing, &secret, async || {
        drop(other.revoke_token(&id(&secret)).await.unwrap())
    })
    .await;
    other.shutdown().await.unwrap();
    let soon = NewToken {
        name: "soon".into(),
        role: Role::Operator,
        may_clear: false,
        expires_in_s: Some(1),
    };
    let (_, secret) = service.app.make_token(&soon).await.unwrap();
    follow(&service, weighing, &secret, async || {}).await;

    // Other tokens' streams continue.
    let secret = service.token(Role::Viewer).await;
    let mut mine = service
        .request("GET", "/v1/events")
        .bearer_auth(service.token(Role::Viewer).await)
        .send()
        .await
        .unwrap();
    service.app.revoke_token(&id(&secret)).await.unwrap();
    service
        .request("POST", "/v1/bench/stop")
        .bearer_auth(service.token(Role::Operator).await)
        .send()
        .await
        .unwrap();
    assert!(mine.chunk().await.unwrap().is_some());
}

#[tokio::test]
async fn the_record_names_who_made_and_ended_a_token_and_who_changed_the_data() {
    let service = Service::start().await;
    let admin = service.app.create_token("Ada", Role::Admin).await.unwrap();
    let as_admin = |method: &str, path: &str| service.request(method, path).bearer_auth(&admin);
    let new = json!({ "name": "robot", "role": "operator" });
    let made: Value =
        as_admin("POST", "/v1/tokens").json(&new).send().await.unwrap().json().await.unwrap();
    as_admin("DELETE", &format!("/v1/tokens/{}", made["id"].as_str().unwrap()))
        .send()
        .await
        .unwrap();
    let flour = json!({ "id": "flour", "name": "Flour" });
    as_admin("POST", "/v1/powders").json(&flour).send().await.unwrap();
    let measured = json!({ "method": "manual", "repose_deg": 40, "sd_deg": 1, "n": 3 });
    as_admin("POST", "/v1/powders/flour/measurements").json(&measured).send().await.unwrap();
    let job: Value = as_admin("POST", "/v1/calibrations")
        .json(&json!({ "powder": "flour" }))
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    as_admin("POST", &format!("/v1/jobs/{}/cancel", job["id"].as_str().unwrap()))
        .send()
        .await
        .unwrap();

    let deeds = deeds(&service).await;
    for action in [
        "new token",
        "revoke token",
        "new powder",
        "new measurement",
        "start calibration",
        "cancel job",
    ] {
        let deed = deeds.iter().find(|deed| deed["action"] == action && deed["who"].is_object());
        let deed = deed.unwrap_or_else(|| panic!("nobody did `{action}` in {deeds:#?}"));
        assert_eq!(
            (&deed["who"]["name"], &deed["who"]["role"]),
            (&json!("Ada"), &json!("admin")),
            "{deed}"
        );
    }
    let text = serde_json::to_string(&deeds).unwrap();
    assert!(!text.contains(made["secret"].as_str().unwrap()) && !text.contains(&admin));
}

#[tokio::test]
async fn the_command_line_is_named_as_such() {
    let service = Service::start().await;
    let other = App::open_beside(storage(service.folder()).await).await.unwrap();
    acting(Who::command_line(), other.create_token("robot", Role::Viewer)).await.unwrap();
    other.shutdown().await.unwrap();
    assert_eq!(deeds(&service).await[0]["who"]["name"], "command line");
}

#[tokio::test]
async fn grpc_makes_lists_and_ends_tokens_for_admins_alone() {
    let service = Service::start().await;
    let admin = service.token(Role::Admin).await;
    let operator = service.token(Role::Operator).await;
    let mut client = TokensClient::connect(service.url("")).await.unwrap();
    let new = CreateTokenRequest {
        name: "robot".into(),
        role: WireRole::Viewer.into(),
        may_clear: false,
        expires_in_s: None,
    };
    let refused = client.create_token(with_token(&operator, new.clone())).await.unwrap_err();
    assert_eq!(refused.code(), Code::PermissionDenied);
    let made = client.create_token(with_token(&admin, new)).await.unwrap().into_inner();
    assert!(service.app.authenticate(&made.secret).is_some());
    let id = made.token.unwrap().id;
    let list = client
        .list_tokens(with_token(&admin, ListTokensRequest::default()))
        .await
        .unwrap()
        .into_inner();
    assert!(list.items.iter().any(|token| token.id == id && token.revoked_at.is_none()));
    let ended = client
        .revoke_token(with_token(&admin, RevokeTokenRequest { id: id.clone() }))
        .await
        .unwrap()
        .into_inner();
    assert!(ended.revoked_at.is_some() && service.app.authenticate(&made.secret).is_none());
    let unknown = CreateTokenRequest { name: "robot".into(), ..CreateTokenRequest::default() };
    assert_eq!(
        client.create_token(with_token(&admin, unknown)).await.unwrap_err().code(),
        Code::InvalidArgument
    );
}

#[tokio::test]
async fn every_caller_learns_who_it_is() {
    let service = Service::start().await;
    let me = async |token: Option<&str>| -> serde_json::Value {
        let request = service.request("GET", "/v1/me");
        let request = match token {
            Some(token) => request.bearer_auth(token),
            None => request,
        };
        request.send().await.unwrap().json().await.unwrap()
    };
    let nobody = me(None).await;
    assert_eq!((&nobody["role"], &nobody["name"]), (&json!("viewer"), &json!(null)));
    let new = NewToken {
        name: "Ada".into(),
        role: Role::Operator,
        may_clear: true,
        expires_in_s: Some(3600),
    };
    let (entry, secret) = service.app.make_token(&new).await.unwrap();
    let ada = me(Some(&secret)).await;
    assert_eq!(
        (&ada["token"], &ada["name"], &ada["role"], &ada["may_clear"]),
        (&json!(entry.id), &json!("Ada"), &json!("operator"), &json!(true))
    );
    assert_eq!(ada["expires_at"], json!(entry.expires_at));
    let mut client = TokensClient::connect(service.url("")).await.unwrap();
    let of_grpc =
        client.get_identity(with_token(&secret, GetIdentityRequest {})).await.unwrap().into_inner();
    assert_eq!(
        (of_grpc.name(), of_grpc.role(), of_grpc.may_clear),
        ("Ada", WireRole::Operator, true)
    );
    let unknown = service.request("GET", "/v1/me").bearer_auth("flip_0_0").send().await.unwrap();
    assert_eq!(unknown.status(), 401);
}
