//! Versions of the simulator over both transports: what they predict, which one is current, and
//! back.

use crate::harness::{Service, fields, problem};
use crate::investigations::{as_operator, finished, humid_campaign, post};
use flip::api::grpc::proto;
use flip::api::grpc::proto::simulators_client::SimulatorsClient;
use flip::app::Role;
use reqwest::Response;
use serde_json::{Value, json};
use tonic::{Code, Request};

const CURRENT: &str = "/v1/simulators/current";
const NEW_ROWS: &str = "powder,relative_humidity_pct\nsalt,32\nsalt,68\nlactose,68\n";

/// A service with one version, and its id.
async fn with_version() -> (Service, String) {
    let service = Service::start().await;
    let job: Value =
        post(&service, &json!({ "measurements_csv": humid_campaign(), "simulations": 99 }))
            .await
            .json()
            .await
            .unwrap();
    let found = finished(&service, job["id"].as_str().unwrap()).await;
    let version = found["report"]["simulator_version"]["extended"].as_str().unwrap().to_owned();
    (service, version)
}

async fn current(service: &Service) -> Value {
    service.get(CURRENT).await.json().await.unwrap()
}

async fn choose(service: &Service, body: &Value) -> Response {
    let request = service.request("PUT", CURRENT).bearer_auth(service.token(Role::Operator).await);
    request.json(body).send().await.unwrap()
}

async fn chosen(service: &Service, simulator: &str) -> Value {
    choose(service, &json!({ "simulator": simulator })).await.json().await.unwrap()
}

/// The reasons given for the choices so far.
async fn choices(service: &Service) -> Vec<Value> {
    use futures::StreamExt;
    let events = service.app.events(flip::app::Topic::All, 0).await.unwrap();
    // Everything before the newest event is there already.
    let last = service.app.last_event();
    let mut events = events.map(Result::unwrap);
    let mut data = Vec::new();
    while let Some(event) = events.next().await {
        if event.topic == "simulator" {
            assert_eq!(event.kind, "current");
            data.push(event.data);
        }
        if event.seq >= last {
            break;
        }
    }
    data
}

#[tokio::test]
async fn a_version_is_made_current_and_rolled_back_and_each_choice_is_an_event() {
    let (service, version) = with_version().await;
    let fresh = current(&service).await;
    let listed: Value = service.get("/v1/simulators").await.json().await.unwrap();
    assert_eq!(fresh["base"], listed["items"][0]["base"]);
    assert_eq!(
        (&fresh["simulator"], &fresh["chosen_at"], &fresh["before"]),
        (&json!("base"), &Value::Null, &Value::Null),
        "nobody has chosen"
    );
    assert_eq!(chosen(&service, "base").await, fresh, "what is current already is no choice");

    let now = chosen(&service, &version).await;
    assert_eq!((&now["simulator"], &now["before"]), (&json!(version), &json!("base")));
    assert!(now["chosen_at"].is_string());
    assert_eq!(chosen(&service, &version).await, now, "again is the same");
    assert_eq!(current(&service).await, now);

    let back = chosen(&service, now["before"].as_str().unwrap()).await;
    assert_eq!((&back["simulator"], &back["before"]), (&json!("base"), &json!(version)));
    let events = choices(&service).await;
    let expected = [
        json!({ "version": version, "before": null }),
        json!({ "version": null, "before": version }),
    ];
    assert_eq!(events, expected, "one for each choice, none for what changed nothing");
    let still: Value =
        service.get(&format!("/v1/simulators/{version}")).await.json().await.unwrap();
    assert_eq!(still, listed["items"][0], "versions never change");
    assert_eq!(
        chosen(&service, fresh["base"].as_str().unwrap()).await,
        back,
        "the base goes by its own name too"
    );
    let record: Value = service.get("/v1/audit?limit=200").await.json().await.unwrap();
    let bodies = record["items"].as_array().unwrap().iter().map(|record| &record["body"]);
    let choices: Vec<_> = bodies.filter(|body| body["action"] == "choose simulator").collect();
    assert_eq!(choices.len(), 2, "{record:#}");
    assert!(choices.iter().all(|body| body["who"]["role"] == "operator"), "{choices:?}");
}

#[tokio::test]
async fn only_a_version_that_is_there_can_be_chosen_and_only_by_an_operator() {
    let service = Service::start().await;
    for (body, field) in [
        (json!({ "simulator": "sv-0000000000000000" }), "simulator"),
        (json!({ "simulator": "current" }), "simulator"),
        (json!({ "simulator": "" }), "simulator"),
        (json!({ "simulator": null }), "simulator"),
        (json!({}), "simulator"),
        (json!({ "simulator": "base", "why": "" }), "why"),
    ] {
        let refused = problem(choose(&service, &body).await, 400).await;
        assert_eq!(fields(&refused), [field], "{body}: {refused}");
    }
    let body = json!({ "simulator": "base" });
    problem(service.request("PUT", CURRENT).json(&body).send().await.unwrap(), 401).await;
    let viewer = service.request("PUT", CURRENT).bearer_auth(service.token(Role::Viewer).await);
    problem(viewer.json(&body).send().await.unwrap(), 403).await;
    assert_eq!(current(&service).await["chosen_at"], Value::Null);
}

#[tokio::test]
async fn versions_are_the_same_over_grpc() {
    let (service, version) = with_version().await;
    let mut client = SimulatorsClient::connect(service.url("")).await.unwrap();
    let rest: Value = service.get(&format!("/v1/simulators/{version}")).await.json().await.unwrap();
    let get = proto::GetSimulatorRequest { id: version.clone() };
    let one = client.get_simulator(get).await.unwrap().into_inner();
    assert_eq!(serde_json::from_str::<Value>(&one.body_json).unwrap(), rest["body"]);
    let of_grpc = json!({ "id": one.id, "base": one.base, "investigation": one.investigation });
    for (name, value) in of_grpc.as_object().unwrap() {
        assert_eq!(value, &rest[name], "{name}");
    }
    assert!(one.created_at.is_some_and(|at| at.seconds > 0));
    let list = client
        .list_simulators(proto::ListSimulatorsRequest { page: None })
        .await
        .unwrap()
        .into_inner();
    assert_eq!((list.items.as_slice(), list.next), ([one].as_slice(), None));

    let ask = |id: &str| proto::PredictRequest {
        id: id.to_owned(),
        measurements_csv: NEW_ROWS.to_owned(),
    };
    let predicted =
        client.predict(as_operator(&service, ask(&version)).await).await.unwrap().into_inner();
    let path = format!("/v1/simulators/{version}/predictions");
    let request = service.request("POST", &path).bearer_auth(service.token(Role::Operator).await);
    let text = request
        .json(&json!({ "measurements_csv": NEW_ROWS }))
        .send()
        .await
        .unwrap()
        .text()
        .await
        .unwrap();
    let cell = |value: Option<f64>| value.map_or(String::new(), |value| value.to_string());
    let rows: Vec<String> = predicted
        .rows
        .iter()
        .map(|it| {
            let (before, after) = (cell(it.before_deg), cell(it.after_deg));
            format!(
                "{},{},{before},{},{after},{}",
                it.row, it.powder, it.before_sd_deg, it.after_sd_deg
            )
        })
        .collect();
    assert_eq!(rows, text.lines().skip(1).collect::<Vec<_>>());
    assert_eq!(rows.len(), 3);

    // `current` is the version currently in use, over both transports.
    let base = client.predict(as_operator(&service, ask("current")).await).await.unwrap_err();
    assert_eq!(base.code(), Code::InvalidArgument, "{base}");
    assert!(base.message().contains("simulator"), "{base}");
    let choice = proto::ChooseSimulatorRequest {
        simulator: version.clone(),
        reason: Some("predicts humid days".into()),
    };
    let now =
        client.choose_simulator(as_operator(&service, choice).await).await.unwrap().into_inner();
    assert_eq!((now.simulator.as_str(), now.before()), (version.as_str(), "base"));
    let by_current =
        client.predict(as_operator(&service, ask("current")).await).await.unwrap().into_inner();
    assert_eq!(by_current, predicted);
    let request = service.request("POST", "/v1/simulators/current/predictions");
    let request = request.bearer_auth(service.token(Role::Operator).await);
    let again = request.json(&json!({ "measurements_csv": NEW_ROWS })).send().await.unwrap();
    assert_eq!(again.text().await.unwrap(), text);
    let of_rest = current(&service).await;
    let of_grpc = client
        .get_current_simulator(proto::GetCurrentSimulatorRequest {})
        .await
        .unwrap()
        .into_inner();
    assert_eq!(
        (json!(of_grpc.simulator), json!(of_grpc.base)),
        (of_rest["simulator"].clone(), of_rest["base"].clone())
    );
    assert_eq!(
        (of_grpc.before(), of_grpc.reason(), of_grpc.chosen_at),
        (of_rest["before"].as_str().unwrap(), "predicts humid days", now.chosen_at)
    );
    assert_eq!(of_rest["reason"], "predicts humid days");
}

#[tokio::test]
async fn grpc_refuses_what_rest_refuses() {
    let service = Service::start().await;
    let mut client = SimulatorsClient::connect(service.url("")).await.unwrap();
    let none = || "sv-0000000000000000".to_owned();
    let missing =
        client.get_simulator(proto::GetSimulatorRequest { id: none() }).await.unwrap_err();
    assert_eq!(missing.code(), Code::NotFound);
    let choice = || proto::ChooseSimulatorRequest { simulator: none(), reason: None };
    let unknown = client.choose_simulator(as_operator(&service, choice()).await).await.unwrap_err();
    assert_eq!(unknown.code(), Code::InvalidArgument, "{unknown}");
    let anonymous = client.choose_simulator(choice()).await.unwrap_err();
    assert_eq!(anonymous.code(), Code::Unauthenticated);
    let ask = proto::PredictRequest { id: none(), measurements_csv: NEW_ROWS.to_owned() };
    assert_eq!(
        client.predict(Request::new(ask.clone())).await.unwrap_err().code(),
        Code::Unauthenticated
    );
    assert_eq!(
        client.predict(as_operator(&service, ask).await).await.unwrap_err().code(),
        Code::NotFound
    );
}
