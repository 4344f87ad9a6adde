//! gRPC alongside REST: the same data, the same refusals; health and reflection.

use crate::harness::{Service, fields};
use flip::api::grpc::proto;
use flip::api::grpc::proto::jobs_client::JobsClient;
use flip::api::grpc::proto::powders_client::PowdersClient;
use flip::api::grpc::proto::weighings_client::WeighingsClient;
use flip::app::Role;
use futures::StreamExt;
use serde_json::{Value, json};
use tonic::transport::Channel;
use tonic::{Code, Request, Status};

pub async fn channel(service: &Service) -> Channel {
    Channel::from_shared(service.url("")).unwrap().connect().await.unwrap()
}

pub async fn as_operator<T>(service: &Service, message: T) -> Request<T> {
    with_token(&service.token(Role::Operator).await, message)
}

/// A message with this token.
pub fn with_token<T>(token: &str, message: T) -> Request<T> {
    let mut request = Request::new(message);
    request.metadata_mut().insert("authorization", format!("Bearer {token}").parse().unwrap());
    request
}

/// The problem carried by a status, after checking that both agree.
pub fn problem_of(status: &Status) -> Value {
    let bytes = status
        .metadata()
        .get_bin("flip-problem-bin")
        .expect("a problem in the trailer")
        .to_bytes()
        .unwrap();
    let problem: Value = serde_json::from_slice(&bytes).unwrap();
    assert_eq!(problem["detail"], status.message());
    assert!(problem["instance"].as_str().unwrap().starts_with("urn:uuid:"));
    problem
}

fn salt(target_mg: f64, key: &str) -> proto::StartWeighingRequest {
    proto::StartWeighingRequest {
        powder: "salt".into(),
        target: Some(proto::Target { value: target_mg, unit: proto::MassUnit::Mg.into() }),
        tolerance: Some(proto::Tolerance {
            lower: 10.0,
            upper: 10.0,
            unit: proto::ToleranceUnit::Percent.into(),
        }),
        policy: None,
        idempotency_key: key.into(),
        seed: Some(7),
        ..Default::default()
    }
}

#[tokio::test]
async fn a_weighing_is_the_same_over_both_transports() {
    let service = Service::ready().await;
    let mut weighings = WeighingsClient::new(channel(&service).await);
    let started = weighings
        .start_weighing(as_operator(&service, salt(15.0, "shared")).await)
        .await
        .unwrap()
        .into_inner();
    assert!(!started.replayed);
    let id = started.weighing.unwrap().id;

    let body = json!({
        "powder": "salt",
        "target": { "value": 15.0, "unit": "mg" },
        "tolerance": { "lower": 10.0, "upper": 10.0, "unit": "%" },
        "seed": 7,
    });
    let replay = service.weigh("shared", &body).await;
    assert_eq!(replay.headers()["idempotency-replayed"], "true", "the key counts on both sides");
    assert_eq!(replay.json::<Value>().await.unwrap()["id"], id.as_str());

    let watch = proto::WatchRequest { id: id.clone(), after_seq: 0 };
    let events: Vec<_> =
        weighings.watch_weighing(watch).await.unwrap().into_inner().collect().await;
    let over_rest = service.watch(&format!("/v1/weighings/{id}/events"), None).await.unwrap();
    assert_eq!(events.len(), over_rest.len());
    for (event, rest) in events.iter().zip(over_rest) {
        let event = event.as_ref().unwrap();
        assert_eq!((event.seq, &event.kind), (rest.id, &rest.kind));
        assert_eq!(serde_json::from_str::<Value>(&event.data_json).unwrap(), rest.data["data"]);
    }

    let get = proto::GetWeighingRequest { id: id.clone() };
    let detail = weighings.get_weighing(get).await.unwrap().into_inner();
    let weighing = detail.weighing.unwrap();
    let rest: Value = service.get(&format!("/v1/weighings/{id}")).await.json().await.unwrap();
    assert_eq!(weighing.state(), proto::WeighingState::Done);
    assert_eq!(weighing.outcome(), proto::Outcome::Within);
    let of_grpc = json!({
        "id": weighing.id, "powder": weighing.powder, "target_mg": weighing.target_mg, "policy": weighing.policy,
        "tolerance_lower_mg": weighing.tolerance_lower_mg, "tolerance_upper_mg": weighing.tolerance_upper_mg,
        "parameter_set": weighing.parameter_set, "seed": weighing.seed, "dispensed_mg": weighing.dispensed_mg,
        "reading_mg": weighing.reading_mg, "error_mg": weighing.error_mg, "shakes": weighing.shakes,
        "seconds": weighing.seconds, "error": weighing.error,
    });
    for (name, value) in of_grpc.as_object().unwrap() {
        assert_eq!(value, &rest["weighing"][name], "{name}");
    }
    assert_eq!(detail.ticks.len(), rest["ticks"].as_array().unwrap().len());
    for (tick, rest) in detail.ticks.iter().zip(rest["ticks"].as_array().unwrap()) {
        assert_eq!(
            (tick.t_s, tick.mass_mg),
            (rest["t_s"].as_f64().unwrap(), rest["reading"]["mass_mg"].as_f64().unwrap())
        );
    }
}

#[tokio::test]
async fn powders_and_parameters_are_the_same_over_both_transports() {
    let service = Service::start().await;
    let mut powders = PowdersClient::new(channel(&service).await);
    let page = proto::PageRequest { limit: Some(2), ..Default::default() };
    let first = powders
        .list_powders(proto::ListPowdersRequest { page: Some(page) })
        .await
        .unwrap()
        .into_inner();
    let rest: Value = service.get("/v1/powders?limit=2").await.json().await.unwrap();
    assert_eq!(first.next.as_deref(), rest["next"].as_str());
    let flowability = first.items[0].flowability.unwrap();
    assert_eq!(json!(flowability.repose_deg), rest["items"][0]["flowability"]["repose_deg"]);
    let ids: Vec<_> = first.items.iter().map(|powder| powder.id.as_str()).collect();
    assert_eq!(json!(ids), json!([rest["items"][0]["id"], rest["items"][1]["id"]]));

    let parameters =
        powders.list_parameters(proto::ListParametersRequest {}).await.unwrap().into_inner().items;
    let rest: Value = service.get("/v1/parameters").await.json().await.unwrap();
    assert_eq!((parameters.len(), rest["items"].as_array().unwrap().len()), (9, 9));
    assert_eq!(json!(parameters[3].upper), rest["items"][3]["upper"]);
}

#[tokio::test]
async fn refusals_carry_the_problem_that_rest_would_send() {
    let service = Service::ready().await;
    let mut weighings = WeighingsClient::new(channel(&service).await);
    for (change, field) in [
        ((|r| r.target = None) as fn(&mut proto::StartWeighingRequest), "target"),
        (|r| r.target.as_mut().unwrap().unit = 0, "target.unit"),
        (|r| r.target.as_mut().unwrap().value = f64::NAN, "target.value"),
        (|r| r.target.as_mut().unwrap().value = f64::INFINITY, "target.value"),
        (|r| r.target.as_mut().unwrap().value = -15.0, "target.value"),
        (|r| r.tolerance.as_mut().unwrap().unit = 99, "tolerance.unit"),
        (|r| r.tolerance.as_mut().unwrap().lower = f64::NAN, "tolerance.lower"),
        (|r| r.powder = "unobtainium".into(), "powder"),
        (|r| r.idempotency_key.clear(), "Idempotency-Key"),
    ] {
        let mut message = salt(15.0, "refused");
        change(&mut message);
        let status =
            weighings.start_weighing(as_operator(&service, message).await).await.unwrap_err();
        assert_eq!(status.code(), Code::InvalidArgument, "{field}: {status}");
        assert_eq!(fields(&problem_of(&status)), [field]);
    }
    weighings.start_weighing(as_operator(&service, salt(15.0, "used")).await).await.unwrap();
    let reused = weighings
        .start_weighing(as_operator(&service, salt(16.0, "used")).await)
        .await
        .unwrap_err();
    assert_eq!(reused.code(), Code::AlreadyExists);
    let missing =
        weighings.get_weighing(proto::GetWeighingRequest { id: "none".into() }).await.unwrap_err();
    assert_eq!(
        (missing.code(), problem_of(&missing)["status"].as_u64()),
        (Code::NotFound, Some(404))
    );
    assert_eq!(
        service.get("/v1/weighings").await.json::<Value>().await.unwrap()["items"]
            .as_array()
            .unwrap()
            .len(),
        1
    );
}

#[tokio::test]
async fn writing_needs_a_token_and_reading_does_not() {
    let service = Service::ready().await;
    let mut weighings = WeighingsClient::new(channel(&service).await);
    weighings.list_weighings(proto::ListWeighingsRequest::default()).await.unwrap();
    let status = weighings.start_weighing(salt(15.0, "nobody")).await.unwrap_err();
    assert_eq!(
        (status.code(), problem_of(&status)["status"].as_u64()),
        (Code::Unauthenticated, Some(401))
    );
    let mut forged = Request::new(proto::ListWeighingsRequest::default());
    forged.metadata_mut().insert("authorization", "Bearer flip_none".parse().unwrap());
    assert_eq!(weighings.list_weighings(forged).await.unwrap_err().code(), Code::Unauthenticated);
}

#[tokio::test]
async fn messages_that_do_not_decode_are_the_callers_fault() {
    let service = Service::ready().await;
    let token = service.token(Role::Operator).await;
    let huge = [&[0, 0x7f, 0xff, 0xff, 0xff][..], &[1; 64]].concat();
    for (what, body, code) in [
        (
            "field 1 with a wrong wire type",
            b"\x00\x00\x00\x00\x02\x09\x01".to_vec(),
            Code::InvalidArgument,
        ),
        (
            "text that is not UTF-8",
            b"\x00\x00\x00\x00\x04\x0a\x02\xff\xfe".to_vec(),
            Code::InvalidArgument,
        ),
        ("an unknown compression", b"\x07\x00\x00\x00\x00".to_vec(), Code::InvalidArgument),
        ("an oversized message", huge, Code::OutOfRange),
    ] {
        let request =
            service.request("POST", "/flip.v1.Weighings/StartWeighing").bearer_auth(&token);
        let response =
            request.header("content-type", "application/grpc").body(body).send().await.unwrap();
        assert_eq!(response.status(), 200, "{what}");
        let status = response.headers()["grpc-status"].to_str().unwrap().parse::<i32>().unwrap();
        assert_eq!(
            Code::from_i32(status),
            code,
            "{what}: {:?}",
            response.headers().get("grpc-message")
        );
    }
    for path in ["/flip.v1.Weighings/Nothing", "/flip.v1.Nothing/Nothing"] {
        let request = service.request("POST", path).header("content-type", "application/grpc");
        assert_eq!(
            request.send().await.unwrap().headers()["grpc-status"],
            "12",
            "{path} is unimplemented"
        );
    }
    let stored: Value = service.get("/v1/weighings").await.json().await.unwrap();
    assert_eq!(stored["items"], json!([]));
}

#[tokio::test]
async fn watching_a_job_ends_with_the_job() {
    let service = Service::start().await;
    let token = service.token(Role::Operator).await;
    let request = service.request("POST", "/v1/calibrations").bearer_auth(&token);
    let job: Value = request
        .json(&json!({ "powder": "salt", "method": "sequential", "sets": 1 }))
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    let id = job["id"].as_str().unwrap().to_owned();
    let mut jobs = JobsClient::new(channel(&service).await);
    let watch = proto::WatchRequest { id: id.clone(), after_seq: 0 };
    let events: Vec<_> = jobs.watch_job(watch).await.unwrap().into_inner().collect().await;
    assert!(events.len() >= 2 && events.iter().all(Result::is_ok));
    let job = jobs.get_job(proto::GetJobRequest { id }).await.unwrap().into_inner();
    assert_eq!(
        (job.kind(), job.state()),
        (proto::JobKind::Calibration, proto::JobState::Succeeded),
        "{job:?}"
    );
}

#[tokio::test]
async fn health_and_reflection_know_every_service() {
    use tonic_health::pb::health_client::HealthClient;
    use tonic_reflection::pb::v1 as reflection;

    let service = Service::start().await;
    let channel = channel(&service).await;
    let mut asked =
        reflection::server_reflection_client::ServerReflectionClient::new(channel.clone());
    let list = reflection::ServerReflectionRequest {
        host: String::new(),
        message_request: Some(reflection::server_reflection_request::MessageRequest::ListServices(
            String::new(),
        )),
    };
    let mut answers =
        asked.server_reflection_info(tokio_stream::once(list)).await.unwrap().into_inner();
    let answer = answers.message().await.unwrap().unwrap().message_response.unwrap();
    let reflection::server_reflection_response::MessageResponse::ListServicesResponse(services) =
        answer
    else {
        panic!("{answer:?}");
    };
    let names: Vec<_> = services.service.into_iter().map(|service| service.name).collect();
    let mut health = HealthClient::new(channel);
    for name in [
        "Powders",
        "Calibrations",
        "Trainings",
        "Policies",
        "Evaluations",
        "Investigations",
        "Simulators",
        "Shakes",
        "Weighings",
        "Films",
        "Bench",
        "ReposeMeasurements",
        "Jobs",
        "Tokens",
    ] {
        let name = format!("flip.v1.{name}");
        assert!(names.contains(&name), "{name} in {names:?}");
        let check = tonic_health::pb::HealthCheckRequest { service: name.clone() };
        assert_eq!(health.check(check).await.unwrap().into_inner().status, 1, "{name} serves");
    }
}
