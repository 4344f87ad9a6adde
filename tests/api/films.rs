//! Films of weighings, made from the record, and of heaps: the same over both transports, cancelled,
//! refused.

use crate::harness::{Service, fields, problem};
use flip::api::grpc::proto;
use flip::api::grpc::proto::films_client::FilmsClient;
use flip::app::Role;
use flip_bench::rig::Simulated;
use flip_core::domain::parameters::ParameterSet;
use flip_sim::repose::{Settings, repose};
use futures::StreamExt;
use reqwest::Response;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::sync::Arc;

/// A dose that has ended: the weighing with its ticks.
async fn dose(service: &Service) -> Value {
    let body = json!({
        "powder": "salt",
        "target": { "value": 12, "unit": "mg" },
        "tolerance": { "lower": 20, "upper": 20, "unit": "%" },
        "seed": 3,
    });
    let planned: Value = service.weigh("dose", &body).await.json().await.unwrap();
    let path = format!("/v1/weighings/{}", planned["id"].as_str().unwrap());
    service.watch(&format!("{path}/events"), None).await.unwrap();
    service.get(&path).await.json().await.unwrap()
}

async fn ask(service: &Service, body: &Value) -> Response {
    let token = service.token(Role::Operator).await;
    service.request("POST", "/v1/films").bearer_auth(token).json(body).send().await.unwrap()
}

#[tokio::test]
async fn a_simulated_dose_is_filmed_to_the_last_grain_the_same_over_both_transports() {
    let service = Service::ready_on(Arc::new(Simulated)).await;
    let detail = dose(&service).await;
    let (weighing, ticks) = (&detail["weighing"], detail["ticks"].as_array().unwrap());
    let started = ask(&service, &json!({ "weighing": weighing["id"] })).await;
    assert_eq!(started.status(), 202);
    let location = started.headers()["location"].to_str().unwrap().to_owned();
    let job: Value = started.json().await.unwrap();
    let id = job["id"].as_str().unwrap();
    assert_eq!((location.as_str(), &job["kind"]), (&*format!("/v1/films/{id}"), &json!("film")));
    service.watch(&format!("/v1/jobs/{id}/events"), None).await;
    let film: Value = service.get(&location).await.json().await.unwrap();
    assert_eq!(film["job"]["state"], "succeeded", "{film}");
    assert_eq!((&film["weighing"], &film["spoonful"]), (&weighing["id"], &json!(1)));
    let head = &film["result"]["head"];
    assert!(head["vial_mg"].as_f64().unwrap() > 1.0, "{head}");
    assert_eq!(head["vial_mg"], weighing["dispensed_mg"], "the dose that was poured");
    // A step for each action, and the way back to level.
    assert_eq!(head["steps"].as_array().unwrap().len(), ticks.len());
    assert_eq!(head["steps"][0]["pitch_deg"], ticks[1]["pitch_deg"]);

    let file = service.get(&format!("{location}/grains")).await;
    assert_eq!(file.headers()["content-type"], "application/octet-stream");
    let etag = file.headers()["etag"].to_str().unwrap().to_owned();
    let bytes = file.bytes().await.unwrap();
    assert_eq!(film["result"]["size_bytes"], bytes.len());
    let sha256 = hex::encode(Sha256::digest(&bytes));
    assert_eq!((etag, &film["result"]["sha256"]), (format!("\"{sha256}\""), &json!(sha256)));
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    let inside: Value = serde_json::from_slice(&bytes[16..16 + length]).unwrap();
    assert_eq!(inside, *head);

    let again = ask(&service, &json!({ "weighing": weighing["id"], "spoonful": 1 })).await;
    assert_eq!(again.status(), 200);
    assert_eq!(again.json::<Value>().await.unwrap()["id"], id);
    let list = async |query: String| {
        let list = service.get(&format!("/v1/films{query}")).await;
        list.json::<Value>().await.unwrap()["items"].clone()
    };
    let own = format!("?weighing={}", weighing["id"].as_str().unwrap());
    assert_eq!(list(own).await, json!([film]));
    assert_eq!(list("?weighing=another".to_owned()).await, json!([]));

    let mut films = FilmsClient::connect(service.url("")).await.unwrap();
    let got = films.get_film(proto::GetFilmRequest { id: id.to_owned() }).await.unwrap();
    let got = got.into_inner().result.unwrap();
    let wire = got.head.unwrap();
    assert_eq!((got.sha256, got.size_bytes), (sha256, bytes.len() as u64));
    assert_eq!(
        (json!(wire.vial_mg), json!(wire.bowl_width_mm)),
        (head["vial_mg"].clone(), head["bowl_mm"][1].clone())
    );
    assert_eq!(json!(wire.steps[0].fell_mg), head["steps"][0]["fell_mg"]);
    let asked = proto::ListFilmsRequest {
        weighing: Some("another".to_owned()),
        ..proto::ListFilmsRequest::default()
    };
    assert!(films.list_films(asked).await.unwrap().into_inner().items.is_empty());
    let asked = proto::DownloadFilmRequest { id: id.to_owned() };
    let chunks = films.download_film(asked).await.unwrap().into_inner();
    let chunks: Vec<_> = chunks.map(|chunk| chunk.unwrap().chunk).collect().await;
    assert!(chunks.concat() == bytes, "the same file");
}

#[tokio::test]
async fn a_heap_is_filmed_from_its_set_and_seed_the_same_over_both_transports() {
    let service = Service::ready().await;
    let set = ParameterSet::default();
    let started = ask(&service, &json!({ "set": set.id(), "seed": 7 })).await;
    assert_eq!(started.status(), 202);
    let job: Value = started.json().await.unwrap();
    let id = job["id"].as_str().unwrap();
    service.watch(&format!("/v1/jobs/{id}/events"), None).await;
    let film: Value = service.get(&format!("/v1/films/{id}")).await.json().await.unwrap();
    assert_eq!((&film["set"], &film["seed"]), (&json!(set.id()), &json!(7)), "{film}");
    assert_eq!((&film["weighing"], &film["result"]["head"]), (&Value::Null, &Value::Null));
    let heap = &film["result"]["heap"];
    // The angles are those of the experiment that calibration uses.
    let truth = repose(&set, &Settings::default(), 7).unwrap();
    assert_eq!(
        (&heap["tip_deg"], &heap["cone_deg"]),
        (&json!(truth.tip_deg), &json!(truth.cone_deg))
    );
    assert_eq!(
        (&heap["grains"], heap["rings"].as_array().unwrap().len() > 24),
        (&json!(2000), true)
    );
    let bytes = service.get(&format!("/v1/films/{id}/grains")).await.bytes().await.unwrap();
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    let inside: Value = serde_json::from_slice(&bytes[16..16 + length]).unwrap();
    assert_eq!(inside, *heap);

    // Asked for over gRPC it is the same film; another seed makes another.
    let mut films = FilmsClient::connect(service.url("")).await.unwrap();
    let token = service.token(Role::Operator).await;
    let mut start = async |seed| {
        let set = Some(set.id());
        let body = proto::StartFilmRequest { set, seed, ..proto::StartFilmRequest::default() };
        let mut request = tonic::Request::new(body);
        let bearer = format!("Bearer {token}").parse().unwrap();
        request.metadata_mut().insert("authorization", bearer);
        films.start_film(request).await.unwrap().into_inner().job.unwrap().id
    };
    assert_eq!(start(Some(7)).await, id);
    let other = start(None).await;
    assert_ne!(other, id);
    let asked = proto::GetFilmRequest { id: id.to_owned() };
    let got = films.get_film(asked).await.unwrap().into_inner();
    assert_eq!((got.seed, got.weighing, got.bench), (Some(7), None, None));
    let wire = got.result.unwrap().heap.unwrap();
    assert_eq!(json!(wire.rings[3].height_mm), heap["rings"][3]["height_mm"]);
    let list: Value =
        service.get(&format!("/v1/films?set={}", set.id())).await.json().await.unwrap();
    let ids: Vec<&Value> =
        list["items"].as_array().unwrap().iter().map(|it| &it["job"]["id"]).collect();
    assert_eq!(ids, [&json!(other), &json!(id)]);
    let none: Value = service.get("/v1/films?set=another").await.json().await.unwrap();
    assert_eq!(none["items"], json!([]));
}

#[tokio::test]
async fn a_film_is_of_a_dose_or_of_a_heap_and_each_has_its_own_fields() {
    let service = Service::ready().await;
    let set = ParameterSet::default().id();
    for (body, field) in [
        (json!({}), "weighing"),
        (json!({ "weighing": "w", "set": set }), "set"),
        (json!({ "set": "ps-none" }), "set"),
        (json!({ "set": set, "spoonful": 1 }), "spoonful"),
        (json!({ "weighing": "w", "seed": 1 }), "seed"),
    ] {
        let refused = problem(ask(&service, &body).await, 400).await;
        assert_eq!(fields(&refused), [field], "{refused}");
    }
}

#[tokio::test]
async fn a_film_is_refused_where_there_is_nothing_to_film() {
    let service = Service::ready().await;
    let hold = service.hold_bench();
    let body = json!({
        "powder": "salt",
        "target": { "value": 12, "unit": "mg" },
        "tolerance": { "lower": 20, "upper": 20, "unit": "%" },
    });
    let planned: Value = service.weigh("held", &body).await.json().await.unwrap();
    service.until_pouring().await;
    let weighing = planned["id"].clone();
    let early = problem(ask(&service, &json!({ "weighing": weighing })).await, 409).await;
    assert_eq!(early["type"], "urn:flip:problem:weighing-not-ended");
    drop(hold);
    let path = format!("/v1/weighings/{}", weighing.as_str().unwrap());
    service.watch(&format!("{path}/events"), None).await.unwrap();
    for spoonful in [0, 2] {
        let body = json!({ "weighing": weighing, "spoonful": spoonful });
        let refused = problem(ask(&service, &body).await, 400).await;
        assert_eq!(fields(&refused), ["spoonful"], "{refused}");
        let said = format!("must be from 1 to 1, got {spoonful}");
        assert!(refused["errors"][0]["message"].as_str().unwrap().contains(&said), "{refused}");
    }
    let unknown = problem(ask(&service, &json!({ "weighing": "none" })).await, 400).await;
    assert_eq!(fields(&unknown), ["weighing"], "{unknown}");
    let jobs: Value = service.get("/v1/jobs?kind=film").await.json().await.unwrap();
    assert_eq!(jobs["items"], json!([]));
}

#[tokio::test]
async fn a_film_is_cancelled_like_any_job_and_asked_for_again() {
    let service = Service::ready_on(Arc::new(Simulated)).await;
    let weighing = dose(&service).await["weighing"]["id"].clone();
    let body = json!({ "weighing": weighing });
    let job: Value = ask(&service, &body).await.json().await.unwrap();
    let id = job["id"].as_str().unwrap();
    let token = service.token(Role::Operator).await;
    let cancel = service.request("POST", &format!("/v1/jobs/{id}/cancel")).bearer_auth(token);
    assert!(cancel.send().await.unwrap().status().is_success());
    service.watch(&format!("/v1/jobs/{id}/events"), None).await;
    let film: Value = service.get(&format!("/v1/films/{id}")).await.json().await.unwrap();
    assert_eq!((&film["job"]["state"], &film["result"]), (&json!("cancelled"), &Value::Null));
    let missing = problem(service.get(&format!("/v1/films/{id}/grains")).await, 409).await;
    assert_eq!(missing["type"], "urn:flip:problem:film-missing");
    assert!(missing["detail"].as_str().unwrap().contains("ask for it again"), "{missing}");
    let again = ask(&service, &body).await;
    assert_eq!(again.status(), 202);
    assert_ne!(again.json::<Value>().await.unwrap()["id"], id);
}
