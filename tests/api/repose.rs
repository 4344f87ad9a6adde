//! Angles of repose by camera: a fully emulated laboratory, and devices whose frames are uploaded.

use crate::grpc::{as_operator, channel, problem_of};
use crate::harness::{Service, fields, problem};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flip::api::grpc::proto;
use flip::api::grpc::proto::bench_client::BenchClient;
use flip::api::grpc::proto::repose_measurements_client::ReposeMeasurementsClient;
use flip::app::{LaboratorySettings, Role};
use flip_bench::emulate::arm::{Flow, FormulaSpoon};
use flip_bench::emulate::camera::{
    CameraFault, Noise, Optics, Pose, Scene, Studio, Surface, faulty_uploads, frames, upload,
};
use flip_bench::emulate::lab::{self, Laboratory};
use flip_bench::hardware::camera::Upload;
use flip_bench::hardware::clock::Clock;
use flip_bench::rig::{Devices, Emulated};
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::powder::PUBLISHED;
use reqwest::Response;
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tonic::Code;

const MEASUREMENTS: &str = "/v1/repose-measurements";

async fn post(service: &Service, path: &str, body: &Value) -> Response {
    let request = service.request("POST", path).bearer_auth(service.token(Role::Operator).await);
    request.json(body).send().await.unwrap()
}

async fn get(service: &Service, path: &str) -> Value {
    let response = service.get(path).await;
    assert_eq!(response.status(), 200, "{path}");
    response.json().await.unwrap()
}

/// Starts a measurement; returns its location.
async fn started(service: &Service, body: &Value) -> String {
    let response = post(service, MEASUREMENTS, body).await;
    assert_eq!(response.status(), 202, "{body}");
    response.headers()["location"].to_str().unwrap().to_owned()
}

/// Polls until the condition holds.
async fn until(service: &Service, path: &str, so: impl Fn(&Value) -> bool) -> Value {
    let deadline = Instant::now() + Duration::from_secs(120);
    loop {
        let found = get(service, path).await;
        if so(&found) {
            return found;
        }
        assert!(Instant::now() < deadline, "{found}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

fn has_ended(found: &Value) -> bool {
    !["queued", "running"].contains(&found["job"]["state"].as_str().unwrap())
}

fn body(Upload { depth, colour, description }: &Upload) -> Value {
    let description: Value = serde_json::from_slice(description).unwrap();
    json!({ "depth": STANDARD.encode(depth), "colour": STANDARD.encode(colour), "description": description })
}

fn photographed(deg: f64, seed: u64, count: usize) -> Vec<Upload> {
    let scene = Scene::of(Surface::Cone(Studio::drawn(deg, seed).cone));
    let taken =
        frames(&scene, &Pose::default(), &Optics::default(), &Noise::default(), seed, count);
    taken.iter().map(|frame| upload(frame).unwrap()).collect()
}

/// Frames are rendered of cones as steep as the simulated heap, here the toy's formula.
#[tokio::test]
async fn an_emulated_laboratory_piles_and_photographs_by_itself() {
    let service = Service::ready_on(Arc::new(Emulated::new(LaboratorySettings::default()))).await;
    let asked = json!({ "powder": "salt", "run": 3, "procedure": { "repeats": 2, "open_s": 2.0, "rest_s": 1.0 } });
    let place = started(&service, &asked).await;
    let found = until(&service, &place, has_ended).await;
    assert_eq!(found["job"]["state"], "succeeded", "{found}");
    let piles = found["piles"].as_array().unwrap();
    assert_eq!(piles.len(), 2);
    for pile in piles {
        let files = pile["frames"].as_array().unwrap();
        assert_eq!((files.len(), pile["refusal"].is_null()), (10, true));
        assert!(pile["measured"]["tip"]["u_deg"].as_f64().unwrap() > 0.0);
        // The apex is below the tip, and the base below the apex.
        let down = |at: &serde_json::Value| at[1].as_f64().unwrap();
        let outline = &pile["outline"];
        assert_eq!(outline["size"], json!([848, 480]));
        assert!(down(&outline["tip"]) < down(&outline["apex"]), "{outline}");
        assert!(down(&outline["apex"]) < down(&outline["base"][0]), "{outline}");
    }
    let deg = found["result"]["repeats"]["tip"]["repose_deg"].as_f64().unwrap();
    // The toy's heap of the default set.
    let unit = ParameterSet::default().to_unit();
    let heap = 20.0 + 30.0 * unit[4] + 15.0 * unit[7];
    assert!((deg - heap).abs() < 1.5, "{deg} {heap}");
    let known = PUBLISHED.iter().find(|it| it.id == "salt").unwrap().automated.repose_deg;
    // Nobody has measured the powder: its previous value stays.
    assert_eq!(found["result"]["registered"], false);
    assert_eq!(
        get(&service, "/v1/powders/salt").await["powder"]["flowability"]["repose_deg"],
        known
    );
    // The same request again returns the same measurement; another run is another one.
    assert_eq!(post(&service, MEASUREMENTS, &asked).await.status(), 200);
    // A raw frame is exactly the photographed one.
    let raw = service.get(&format!("{place}/piles/2/frames/10/depth")).await;
    assert_eq!(raw.status(), 200);
    let headers = ["content-type", "x-content-type-options"];
    assert_eq!(headers.map(|name| raw.headers()[name].to_str().unwrap()), ["image/png", "nosniff"]);
    assert!(raw.bytes().await.unwrap().starts_with(b"\x89PNG"));
    for missing in [
        "piles/3/frames/1/depth",
        "piles/1/frames/11/depth",
        "piles/1/frames/0/depth",
        "piles/1/frames/1/sound",
    ] {
        problem(service.get(&format!("{place}/{missing}")).await, 404).await;
    }
    // The wire traffic is on record, and so is every pile.
    let audit = get(&service, "/v1/audit?limit=200").await;
    let kinds: Vec<&str> =
        audit["items"].as_array().unwrap().iter().map(|it| it["kind"].as_str().unwrap()).collect();
    assert_eq!(kinds.iter().filter(|kind| **kind == "pile").count(), 2);
    assert!(kinds.contains(&"sent") && kinds.contains(&"received"));
    let list = get(&service, MEASUREMENTS).await;
    assert_eq!(list["items"].as_array().unwrap().len(), 1);
    service.stop().await;
}

#[tokio::test]
async fn frames_are_uploaded_while_a_pile_waits_and_one_without_an_angle_is_made_again() {
    let clock = Clock::fast(20.0);
    let spoon = Box::new(FormulaSpoon::new(Flow::default(), 1));
    let laboratory = Laboratory::start(lab::Settings::default(), clock, spoon).unwrap();
    let service = Service::ready_on(Arc::new(Devices::new(laboratory.file()))).await;
    let asked =
        json!({ "powder": "salt", "procedure": { "repeats": 1, "open_s": 1.0, "rest_s": 0.0 } });
    let place = started(&service, &asked).await;
    let frames_at = format!("{place}/frames");
    until(&service, &place, |found| {
        found["awaits"] == json!({ "pile": 1, "have": 0, "wanted": 10 })
    })
    .await;
    // Unreadable frames are refused while the pile still lies there, and do not count.
    let mut bad = body(&photographed(35.0, 1, 1)[0]);
    bad["description"]["depth_unit_m"] = json!(null);
    assert_eq!(
        fields(&problem(post(&service, &frames_at, &bad).await, 400).await),
        ["depth_unit_m"]
    );
    bad["depth"] = json!("not base64!");
    assert_eq!(fields(&problem(post(&service, &frames_at, &bad).await, 400).await), ["depth"]);
    let scene = Scene::of(Surface::Cone(Studio::drawn(35.0, 1).cone));
    for frame in faulty_uploads(CameraFault::FunnelMissing, &scene, &Optics::default(), 1).unwrap()
    {
        assert_eq!(post(&service, &frames_at, &body(&frame)).await.status(), 202);
    }
    until(&service, &place, |found| found["awaits"]["pile"] == 2).await;
    let good = photographed(35.0, 1, 10);
    for frame in &good {
        assert_eq!(post(&service, &frames_at, &body(frame)).await.status(), 202);
    }
    let found = until(&service, &place, has_ended).await;
    assert_eq!(
        (&found["job"]["state"], &found["result"]["registered"]),
        (&json!("succeeded"), &json!(true)),
        "{found}"
    );
    assert!(
        found["piles"][0]["measured"].is_null() && found["piles"][0]["refusal"].as_str().is_some()
    );
    let tip = found["piles"][1]["measured"]["tip"]["deg"].as_f64().unwrap();
    assert!((tip - 35.0).abs() < 1.5, "{tip}");
    // It is now the value for salt, and it is compared with the manual measurements.
    let salt = get(&service, "/v1/powders/salt").await;
    assert_eq!(salt["powder"]["flowability"]["repose_deg"].as_f64(), Some(tip));
    let compared = get(&service, "/v1/measurements/comparison").await;
    let row = compared.as_array().unwrap().iter().find(|row| row["powder"] == "salt").unwrap();
    assert_eq!(row["automated"]["repose_deg"].as_f64(), Some(tip));
    assert_eq!(compared.as_array().unwrap().len(), 5);
    // The bytes are those received.
    let raw = service.get(&format!("{place}/piles/2/frames/3/colour")).await.bytes().await.unwrap();
    assert_eq!(raw, good[2].colour);
    let late = problem(post(&service, &frames_at, &body(&good[0])).await, 409).await;
    assert!(late["type"].as_str().unwrap().ends_with("no-pile-waits"), "{late}");
    // A frame that nobody waits for is not read at all: this one could not be.
    let unread = serde_json::json!({ "depth": "no Base64 at all" });
    problem(post(&service, &frames_at, &unread).await, 409).await;
    service.stop().await;
}

#[tokio::test]
async fn over_grpc_a_measurement_is_the_same_and_takes_frames() {
    let spoon = Box::new(FormulaSpoon::new(Flow::default(), 1));
    let laboratory = Laboratory::start(lab::Settings::default(), Clock::fast(20.0), spoon).unwrap();
    let service = Service::ready_on(Arc::new(Devices::new(laboratory.file()))).await;
    let mut client =
        ReposeMeasurementsClient::new(channel(&service).await).max_decoding_message_size(1 << 24);
    let asked = |procedure: &str| proto::StartReposeMeasurementRequest {
        powder: "salt".into(),
        procedure_json: Some(procedure.to_owned()),
        ..Default::default()
    };
    let wrong = as_operator(&service, asked("{\"repeats\": \"one\"}")).await;
    let refused = client.start_repose_measurement(wrong).await.unwrap_err();
    assert_eq!(refused.code(), Code::InvalidArgument);
    assert_eq!(fields(&problem_of(&refused)), ["procedure_json"]);
    let right =
        as_operator(&service, asked("{\"repeats\": 1, \"open_s\": 1.0, \"rest_s\": 0.0}")).await;
    let id = client.start_repose_measurement(right).await.unwrap().into_inner().job.unwrap().id;
    let place = format!("{MEASUREMENTS}/{id}");
    until(&service, &place, |found| found["awaits"]["have"] == 0).await;
    let frames = photographed(35.0, 1, 10);
    for (k, frame) in frames.iter().enumerate() {
        let Upload { depth, colour, description } = frame.clone();
        let description_json = String::from_utf8(description).unwrap();
        let frame = proto::AddFrameRequest { id: id.clone(), depth, colour, description_json };
        let awaited =
            client.add_frame(as_operator(&service, frame).await).await.unwrap().into_inner();
        assert_eq!((awaited.pile, awaited.have, awaited.wanted), (1, k as u32 + 1, 10));
    }
    let rest = until(&service, &place, has_ended).await;
    let get = proto::GetReposeMeasurementRequest { id: id.clone() };
    let found = client.get_repose_measurement(get).await.unwrap().into_inner();
    assert_eq!(serde_json::from_str::<Value>(&found.rig_json).unwrap(), rest["rig"]);
    assert_eq!(
        found.piles[0].tip.unwrap().deg,
        rest["piles"][0]["measured"]["tip"]["deg"].as_f64().unwrap()
    );
    let result = found.result.unwrap();
    assert!(
        result.registered
            && result.tip_u_deg == rest["result"]["repeats"]["tip_u_deg"].as_f64().unwrap()
    );
    let raw = proto::DownloadFrameRequest { id, pile: 1, frame: 3, part: "depth".into() };
    assert_eq!(client.download_frame(raw).await.unwrap().into_inner().bytes, frames[2].depth);
    let list = client
        .list_repose_measurements(proto::ListReposeMeasurementsRequest::default())
        .await
        .unwrap();
    assert!(
        list.into_inner()
            .items
            .iter()
            .all(|it| it.powder == "salt" && it.piles.is_empty() && it.result.is_some())
    );
    let compared =
        client.compare_methods(proto::CompareMethodsRequest {}).await.unwrap().into_inner().items;
    let salt = compared.iter().find(|it| it.powder == "salt").unwrap();
    assert_eq!(salt.automated.unwrap().repose_deg, result.tip.unwrap().repose_deg);
    service.stop().await;
}

#[tokio::test]
async fn a_bench_that_cannot_and_numbers_that_mean_nothing_are_refused() {
    let service = Service::ready().await;
    let refused =
        problem(post(&service, MEASUREMENTS, &json!({ "powder": "salt" })).await, 409).await;
    assert!(refused["type"].as_str().unwrap().ends_with("no-stand"), "{refused}");
    for (body, field) in [
        (json!({}), "powder"),
        (json!({ "powder": "chalk" }), "powder"),
        (json!({ "powder": "salt", "run": 0 }), "run"),
        (json!({ "powder": "salt", "procedure": { "repeats": 21 } }), "procedure.repeats"),
        (json!({ "powder": "salt", "procedure": { "frames": 5 } }), "procedure.frames"),
        (json!({ "powder": "salt", "procedure": { "open_s": 0.5 } }), "procedure.open_s"),
        (json!({ "powder": "salt", "rig": { "base_diameter_mm": -60 } }), "rig.base_diameter_mm"),
        (
            json!({ "powder": "salt", "limits": { "pile_invalid_max": 2 } }),
            "limits.pile_invalid_max",
        ),
    ] {
        assert_eq!(
            fields(&problem(post(&service, MEASUREMENTS, &body).await, 400).await),
            [field],
            "{body}"
        );
    }
    assert_eq!(get(&service, MEASUREMENTS).await["items"], json!([]));
    service.stop().await;
}

/// Waits until the gate is open: a measurement that has failed never opens it.
async fn gate_open(laboratory: &Laboratory) {
    let opened = async {
        while laboratory.slide.opening() < 1.0 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    };
    tokio::time::timeout(Duration::from_secs(60), opened).await.expect("the gate opens");
}

#[tokio::test]
async fn a_stop_at_the_bench_and_a_cancelled_measurement_find_the_gate_closed() {
    let spoon = Box::new(FormulaSpoon::new(Flow::default(), 1));
    let laboratory = Laboratory::start(lab::Settings::default(), Clock::fast(20.0), spoon).unwrap();
    let service = Service::ready_on(Arc::new(Devices::new(laboratory.file()))).await;
    let asked = json!({ "powder": "salt", "procedure": { "repeats": 1, "open_s": 300.0 } });
    for (end, state) in [("/v1/bench/stop", "failed"), ("cancel", "cancelled")] {
        let place = started(&service, &asked).await;
        gate_open(&laboratory).await;
        let id = place.rsplit('/').next().unwrap();
        let end = if end == "cancel" { format!("/v1/jobs/{id}/cancel") } else { end.to_owned() };
        assert!(post(&service, &end, &json!({})).await.status().is_success(), "{end}");
        let found = until(&service, &place, has_ended).await;
        assert_eq!(found["job"]["state"], state, "{found}");
        assert_eq!((laboratory.slide.opening(), &found["piles"]), (0.0, &json!([])));
        if end == "/v1/bench/stop" {
            let refused = problem(post(&service, MEASUREMENTS, &asked).await, 409).await;
            assert_eq!(refused["type"], "urn:flip:problem:bench-held");
            let resumed = post(&service, "/v1/bench/resume", &json!({ "by": "the test" })).await;
            assert!(resumed.status().is_success());
        }
    }
    service.stop().await;
}

#[tokio::test]
async fn a_pile_that_is_being_made_is_told_as_what_moves_and_a_stop_of_the_bench_ends_it() {
    let spoon = Box::new(FormulaSpoon::new(Flow::default(), 1));
    let laboratory = Laboratory::start(lab::Settings::default(), Clock::fast(20.0), spoon).unwrap();
    let service = Service::ready_on(Arc::new(Devices::new(laboratory.file()))).await;
    let mut bench = BenchClient::new(channel(&service).await);
    let metrics = async || service.get("/metrics").await.text().await.unwrap();
    let place = started(
        &service,
        &json!({ "powder": "salt", "procedure": { "repeats": 1, "open_s": 300.0 } }),
    )
    .await;
    let id = place.rsplit('/').next().unwrap();
    gate_open(&laboratory).await;
    let found = get(&service, "/v1/bench").await;
    assert_eq!(
        (&found["piling"], &found["moving"]),
        (&json!({ "job": id, "pile": 1 }), &json!(null))
    );
    assert!(metrics().await.contains("flip_bench_moving 1\n"));
    let piling =
        bench.get_bench(proto::GetBenchRequest {}).await.unwrap().into_inner().piling.unwrap();
    assert_eq!((piling.job.as_str(), piling.pile), (id, 1));
    assert_eq!(post(&service, "/v1/bench/stop", &json!({})).await.status(), 200);
    until(&service, &place, has_ended).await;
    assert_eq!(
        (laboratory.slide.opening(), &get(&service, "/v1/bench").await["piling"]),
        (0.0, &json!(null))
    );
    assert!(metrics().await.contains("flip_bench_moving 0\n"));

    // A measurement at rest, waiting for its frames, does not move.
    assert_eq!(
        post(&service, "/v1/bench/resume", &json!({ "by": "the test" })).await.status(),
        200
    );
    let procedure = json!({ "repeats": 1, "open_s": 1.0, "rest_s": 0.0 });
    let place = started(&service, &json!({ "powder": "salt", "procedure": procedure })).await;
    until(&service, &place, |found| found["awaits"]["have"] == 0).await;
    assert_eq!(get(&service, "/v1/bench").await["piling"], json!(null));
    service.stop().await;
}
