//! Probing runs and powder cards through the sockets, on an emulated laboratory whose spoon follows
//! a formula.

use crate::grpc::{as_operator, channel};
use crate::harness::{Service, fields, problem};
use flip::api::grpc::proto;
use flip::api::grpc::proto::powders_client::PowdersClient;
use flip::api::grpc::proto::weighings_client::WeighingsClient;
use flip::app::Role;
use flip_bench::emulate::arm::{Flow, FormulaSpoon};
use flip_bench::emulate::lab::{Laboratory, Settings};
use flip_bench::hardware::DeviceError;
use flip_bench::hardware::clock::Clock;
use flip_bench::rig::{Devices, OnEvent, Poured, Pouring, Rig};
use flip_core::domain::bench::BenchKind;
use reqwest::Response;
use serde_json::{Value, json};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Salt that leaves the spoon at 25 deg.
const SALT: Flow = Flow {
    level_mg: 0.3,
    e_fold_deg: 25.0,
    power: 1.0,
    onset_deg: 25.0,
    onset_width_deg: 0.5,
    variation: 0.2,
    capacity_mg: 36.0,
};

struct Formula;

impl Rig for Formula {
    fn kind(&self) -> BenchKind {
        BenchKind::Emulated
    }

    fn exchanges_vials(&self) -> bool {
        true
    }

    fn fills_spoon(&self) -> bool {
        true
    }

    fn remembers(&self) -> bool {
        true
    }

    fn readability_mg(&self) -> Option<f64> {
        Some(1.0)
    }

    fn halt(&self) -> Result<(), DeviceError> {
        Ok(())
    }

    fn pour(&self, pouring: &Pouring, on_event: OnEvent<'_>, stop: &AtomicBool) -> Poured {
        let clock = Clock::standing();
        let spoon = Box::new(FormulaSpoon::new(SALT, pouring.simulation.seed));
        let settings = Settings::default();
        let shakes = settings.arm.shakes();
        let laboratory = Laboratory::start(settings, clock.clone(), spoon).unwrap();
        let devices = Devices::with_clock(laboratory.file(), clock);
        devices.pour(&Pouring { shakes, ..pouring.clone() }, on_event, stop)
    }
}

async fn characterise(service: &Service, key: &str, body: &Value) -> Response {
    let request = service.request("POST", "/v1/characterisations");
    let request = request.bearer_auth(service.token(Role::Operator).await);
    request.header("idempotency-key", key).json(body).send().await.unwrap()
}

/// A run of this lot that has ended.
async fn probed(service: &Service, key: &str, lot: &str) -> Value {
    let body = json!({ "powder": "salt", "lot": lot, "seed": 7 });
    let planned = characterise(service, key, &body).await;
    assert_eq!(planned.status(), 202);
    let planned: Value = planned.json().await.unwrap();
    let path = format!("/v1/weighings/{}", planned["id"].as_str().unwrap());
    service.watch(&format!("{path}/events"), None).await;
    service.get(&path).await.json().await.unwrap()
}

async fn card(service: &Service, query: &str) -> Value {
    service.get(&format!("/v1/powders/salt/card{query}")).await.json().await.unwrap()
}

#[tokio::test]
async fn a_probing_run_is_a_weighing_without_a_dose_and_its_shakes_are_on_the_card() {
    let service = Service::ready_on(Arc::new(Formula)).await;
    let before = card(&service, "").await;
    assert!(before["card"]["missing"].as_str().unwrap().starts_with("0 of at least 2"), "{before}");
    let done = probed(&service, "one", "L1").await;
    let weighing = &done["weighing"];
    assert_eq!(
        (&weighing["state"], &weighing["outcome"]),
        (&json!("done"), &json!("probed")),
        "{}",
        weighing["error"]
    );
    assert_eq!(
        weighing["asked"],
        json!({ "lot": "L1", "on_overdose": { "action": "stop" }, "probe": { "spoonfuls": 3 } })
    );
    assert_eq!(
        (&weighing["error_mg"], &weighing["error"]),
        (&Value::Null, &Value::Null),
        "{weighing}"
    );
    let fell_mg = weighing["reading_mg"].as_f64().unwrap();
    assert!(fell_mg > 50.0 && fell_mg <= weighing["target_mg"].as_f64().unwrap(), "{weighing}");
    let seconds = weighing["seconds"].as_f64().unwrap();
    assert!((60.0..600.0).contains(&seconds), "{seconds}");
    let spoonfuls = done["ticks"].as_array().unwrap().iter().map(|tick| tick["spoonful"].as_u64());
    assert_eq!(spoonfuls.max(), Some(Some(3)));

    let of = card(&service, "?lot=L1").await;
    assert_eq!(
        (&of["bench"], &of["lots"]),
        (&json!("emulated"), &json!([{ "lot": "L1", "spoonfuls": 3 }]))
    );
    assert_eq!(of["last_at"], weighing["started_at"]);
    let found = &of["card"];
    assert_eq!((&found["spoonfuls"], &found["shakes"]), (&json!(3), &weighing["shakes"]), "{of}");
    let onset = found["onset_deg"]["mean"].as_f64().unwrap();
    assert!((24.0..36.0).contains(&onset), "{found}");
    let curves = found["curves"].as_array().unwrap();
    let strokes: Vec<&str> = curves.iter().map(|it| it["stroke"].as_str().unwrap()).collect();
    assert_eq!(strokes, ["full", "half", "quarter"]);
    // The longest strokes as the formula has it, within its scatter and the display's steps.
    let cells = curves[0]["cells"].as_array().unwrap();
    for cell in cells.iter().filter(|cell| cell["n"].as_u64() >= Some(2)) {
        let mean_mg = SALT
            .mean_mg(cell["pitch_deg"].as_f64().unwrap(), curves[0]["shake_mm"].as_f64().unwrap());
        let seen_mg = cell["mean_mg"].as_f64().unwrap();
        assert!((seen_mg - mean_mg).abs() < 0.8 + 0.4 * mean_mg, "{cell}, not {mean_mg}");
    }
    assert_eq!(card(&service, "?lot=L1").await, of, "the same shakes, the same card");
}

#[tokio::test]
async fn it_is_made_once_for_a_key_refuses_what_it_cannot_do_and_has_no_certificate() {
    let service = Service::ready_on(Arc::new(Formula)).await;
    let done = probed(&service, "one", "L1").await;
    let body = json!({ "powder": "salt", "lot": "L1", "seed": 7 });
    let again = characterise(&service, "one", &body).await;
    assert_eq!(again.headers()["idempotency-replayed"], "true");
    assert_eq!(again.json::<Value>().await.unwrap()["id"], done["weighing"]["id"]);
    let other = json!({ "powder": "salt", "lot": "L2", "seed": 7 });
    problem(characterise(&service, "one", &other).await, 422).await;
    for (wrong, field) in [
        (json!({ "powder": "salt", "spoonfuls": 0 }), "spoonfuls"),
        (json!({ "powder": "salt", "spoonfuls": 10 }), "spoonfuls"),
        (json!({ "powder": "salt", "limit_mg": 0.5 }), "limit_mg"),
        (json!({ "powder": "chalk" }), "powder"),
    ] {
        let refused = problem(characterise(&service, "two", &wrong).await, 400).await;
        assert_eq!(fields(&refused), [field], "{wrong}");
    }
    let dose = json!({
        "powder": "salt", "target": { "value": 15, "unit": "mg" }, "asked": { "probe": { "spoonfuls": 1 } },
        "tolerance": { "lower": 1, "upper": 1, "unit": "mg" },
    });
    let refused = problem(service.weigh("three", &dose).await, 400).await;
    assert_eq!(fields(&refused), ["asked.probe"]);
    let path =
        format!("/v1/weighings/{}/certificate.html", done["weighing"]["id"].as_str().unwrap());
    let refused = problem(service.get(&path).await, 409).await;
    assert!(refused["detail"].as_str().unwrap().contains("weighed no dose"), "{refused}");
    problem(service.get("/v1/powders/chalk/card").await, 404).await;
    problem(service.get("/v1/powders/salt/card?bench=dreamt").await, 400).await;
}

#[tokio::test]
async fn a_limit_bounds_what_falls() {
    let service = Service::ready_on(Arc::new(Formula)).await;
    let body = json!({ "powder": "salt", "seed": 7, "limit_mg": 12, "spoonfuls": 2 });
    let planned: Value = characterise(&service, "one", &body).await.json().await.unwrap();
    assert_eq!(planned["target_mg"], json!(12.0));
    let path = format!("/v1/weighings/{}", planned["id"].as_str().unwrap());
    service.watch(&format!("{path}/events"), None).await;
    let done: Value = service.get(&path).await.json().await.unwrap();
    let weighing = &done["weighing"];
    assert_eq!(weighing["outcome"], "probed", "{weighing}");
    assert!(weighing["reading_mg"].as_f64().unwrap() <= 13.0, "{weighing}");
}

#[tokio::test]
async fn the_card_is_of_its_lot_informs_the_next_dose_and_is_forgotten_with_its_shakes() {
    let service = Service::ready_on(Arc::new(Formula)).await;
    probed(&service, "one", "L1").await;
    probed(&service, "two", "L2").await;
    let both = card(&service, "").await;
    assert_eq!(both["card"]["spoonfuls"], 6);
    assert_eq!(both["lots"].as_array().unwrap().len(), 2);
    assert_eq!(card(&service, "?bench=devices").await["card"]["spoonfuls"], 0);
    // By gRPC the same numbers.
    let mut powders = PowdersClient::new(channel(&service).await);
    let request =
        proto::GetPowderCardRequest { id: "salt".into(), lot: Some("L1".into()), bench: None };
    let found = powders.get_powder_card(request).await.unwrap().into_inner();
    let rest = card(&service, "?lot=L1").await;
    assert_eq!(json!(found.onset_deg.unwrap().mean), rest["card"]["onset_deg"]["mean"]);
    assert_eq!(found.curves.len(), rest["card"]["curves"].as_array().unwrap().len());
    assert_eq!((found.spoonfuls, found.bench.as_deref()), (3, Some("emulated")));
    // The next dose of the lot is forecast from the run.
    let dose = json!({
        "powder": "salt", "target": { "value": 15, "unit": "mg" }, "asked": { "lot": "L1" },
        "tolerance": { "lower": 1, "upper": 1, "unit": "mg" },
    });
    let planned: Value = service.weigh("three", &dose).await.json().await.unwrap();
    let id = planned["id"].as_str().unwrap();
    service.watch(&format!("/v1/weighings/{id}/events"), None).await;
    let trail = service.get("/v1/audit.json").await.text().await.unwrap();
    assert!(trail.contains("forecast from earlier doses of the powder"), "{id}");

    let forget = service.request("DELETE", "/v1/shakes?powder=salt&lot=L1");
    let forget = forget.bearer_auth(service.token(Role::Operator).await).send().await.unwrap();
    assert_eq!(forget.json::<Value>().await.unwrap()["spoonfuls"], 4);
    let left = card(&service, "?lot=L1").await;
    assert!(left["card"]["missing"].is_string() && left["lots"] == json!([]), "{left}");
    assert_eq!(card(&service, "").await["card"]["spoonfuls"], 3);
    let verified: Value = service.get("/v1/audit/verification").await.json().await.unwrap();
    assert_eq!(verified["broken"], Value::Null, "{verified}");
}

#[tokio::test]
async fn grpc_starts_the_same_run() {
    let service = Service::ready_on(Arc::new(Formula)).await;
    let mut weighings = WeighingsClient::new(channel(&service).await);
    let request = proto::CharacteriseRequest {
        powder: "salt".into(),
        idempotency_key: "one".into(),
        spoonfuls: Some(1),
        ..Default::default()
    };
    let request = as_operator(&service, request).await;
    let planned = weighings.characterise(request).await.unwrap().into_inner().weighing.unwrap();
    service.watch(&format!("/v1/weighings/{}/events", planned.id), None).await;
    let get = proto::GetWeighingRequest { id: planned.id };
    let done = weighings.get_weighing(get).await.unwrap().into_inner().weighing.unwrap();
    assert_eq!(done.outcome(), proto::Outcome::Probed);
    assert_eq!(done.asked.unwrap().probe_spoonfuls, Some(1));
}
