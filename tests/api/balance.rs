//! The balance while nothing is dosed: the same over both transports.

use crate::grpc::{as_operator, channel, problem_of};
use crate::harness::{Service, problem};
use flip::api::grpc::proto;
use flip::api::grpc::proto::bench_client::BenchClient;
use flip::app::{LaboratorySettings, Role};
use flip_bench::emulate::arm::{Flow, FormulaSpoon};
use flip_bench::emulate::lab::{self, Laboratory};
use flip_bench::hardware::clock::Clock;
use flip_bench::rig::{Devices, Emulated};
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::Duration;

const BALANCE: &str = "/v1/bench/balance";

async fn order(service: &Service, verb: &str, body: &Value) -> reqwest::Response {
    let request = service.request("POST", &format!("{BALANCE}/{verb}"));
    request.bearer_auth(service.token(Role::Operator).await).json(body).send().await.unwrap()
}

async fn ok(response: reqwest::Response) -> Value {
    assert_eq!(response.status(), 200);
    response.json().await.unwrap()
}

fn mass_mg(shown: &Value) -> f64 {
    shown["mass_mg"].as_f64().unwrap()
}

fn code(problem: &Value) -> &str {
    problem["type"].as_str().unwrap().rsplit(':').next().unwrap()
}

fn salt(vial_check: &str) -> Value {
    json!({
        "powder": "salt", "target": { "value": 15.0, "unit": "mg" }, "vial_check": vial_check,
        "tolerance": { "lower": 10, "upper": 10, "unit": "%" },
    })
}

#[tokio::test]
async fn an_emulated_balance_is_read_and_tared_between_doses_and_a_dose_is_none_the_worse() {
    let service = Service::ready_on(Arc::new(Emulated::new(LaboratorySettings::default()))).await;
    let first = ok(service.get(BALANCE).await).await;
    // An empty vial of twelve grams stands on it.
    assert!((mass_mg(&first) - 12_000.0).abs() < 5.0, "{first}");
    assert_eq!(first["readability_mg"], 1.0);
    let tared = ok(order(&service, "tare", &json!({})).await).await;
    assert!(mass_mg(&tared).abs() <= 2.0 && tared["stable"] == json!(true), "{tared}");
    let mut bench = BenchClient::new(channel(&service).await);
    let read = bench.read_balance(proto::ReadBalanceRequest {}).await.unwrap().into_inner();
    assert!(read.mass_mg.abs() <= 3.0 && read.at.is_some(), "{read:?}");
    let zero = as_operator(&service, proto::ZeroBalanceRequest::default()).await;
    match bench.zero_balance(zero).await {
        Ok(zeroed) => assert!(zeroed.into_inner().mass_mg.abs() <= 2.0),
        // Twelve grams are beyond the zero range of some balances.
        Err(refused) => assert_eq!(code(&problem_of(&refused)), "balance-failed"),
    }
    let audit: Value = service.get("/v1/audit?kind=person").await.json().await.unwrap();
    let deeds: Vec<&Value> =
        audit["items"].as_array().unwrap().iter().map(|it| &it["body"]).collect();
    let tare = deeds.iter().find(|it| it["action"] == "tare").unwrap();
    assert!((tare["before_mg"].as_f64().unwrap() - 12_000.0).abs() < 5.0, "{tare}");
    assert_eq!(tare["who"]["role"], "operator", "{tare}");
    let weighing: Value = service.weigh("one", &salt("skip")).await.json().await.unwrap();
    let place = format!("/v1/weighings/{}", weighing["id"].as_str().unwrap());
    let ended: Value = service.get(&format!("{place}?wait=60")).await.json().await.unwrap();
    assert_eq!(ended["weighing"]["state"], "done", "{ended}");
    let tare_mg = ended["weighing"]["measured"]["tare_mg"].as_f64().unwrap();
    assert!((tare_mg - 12_000.0).abs() < 5.0, "{tare_mg}");
    service.stop().await;
}

#[tokio::test]
async fn a_vial_that_was_tared_with_powder_in_it_is_still_known_as_not_empty() {
    let spoon = Box::new(FormulaSpoon::new(Flow::default(), 1));
    let clock = Clock::standing();
    let laboratory = Laboratory::start(lab::Settings::default(), clock.clone(), spoon).unwrap();
    let devices = Devices::with_clock(laboratory.file(), clock);
    let service = Service::ready_on(Arc::new(devices)).await;
    let weighed = async |key: &str, check: &str| {
        let weighing: Value = service.weigh(key, &salt(check)).await.json().await.unwrap();
        let place = format!("/v1/weighings/{}", weighing["id"].as_str().unwrap());
        if check == "confirm" {
            let token = service.token(Role::Operator).await;
            let path = format!("{place}/vial-ready");
            let confirmed = async || {
                let request = service.request("POST", &path).bearer_auth(&token);
                request.json(&json!({ "by": "Ada" })).send().await.unwrap().status() == 200
            };
            while !confirmed().await {
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        }
        let ended: Value = service.get(&format!("{place}?wait=60")).await.json().await.unwrap();
        ended["weighing"].clone()
    };
    let first = weighed("one", "skip").await;
    assert_eq!(first["state"], "done", "{first}");
    let poured_mg = first["reading_mg"].as_f64().unwrap();
    let shown = ok(service.get(BALANCE).await).await;
    assert!((mass_mg(&shown) - poured_mg).abs() < 5.0, "{shown} after {poured_mg}");
    // Refused with twelve grams on the pan, and so forgets nothing.
    let refused = problem(order(&service, "zero", &json!({})).await, 409).await;
    assert_eq!(code(&refused), "balance-failed");
    let tared = ok(order(&service, "tare", &json!({})).await).await;
    assert!(mass_mg(&tared).abs() <= 2.0, "{tared}");
    let bench: Value = service.get("/v1/bench").await.json().await.unwrap();
    assert_eq!(bench["vial"]["weighing"], first["id"], "{bench}");
    let second = weighed("two", "confirm").await;
    let error = second["error"].as_str().unwrap();
    assert!(error.contains("still on the pan"), "{second}");
    assert!((laboratory.dispensed_mg() - poured_mg).abs() < 5.0, "nothing was poured on top");
    service.stop().await;
}

#[tokio::test]
async fn a_tare_whose_caller_leaves_is_recorded_all_the_same() {
    let spoon = Box::new(FormulaSpoon::new(Flow::default(), 1));
    // A tare takes a while of the wall clock.
    let laboratory = Laboratory::start(lab::Settings::default(), Clock::fast(5.0), spoon).unwrap();
    let service = Service::ready_on(Arc::new(Devices::new(laboratory.file()))).await;
    let token = service.token(Role::Operator).await;
    let request = service.request("POST", &format!("{BALANCE}/tare")).bearer_auth(token);
    let left = request.json(&json!({})).timeout(Duration::from_millis(50)).send().await;
    assert!(left.unwrap_err().is_timeout(), "the caller has left");
    let recorded = async || {
        let audit: Value = service.get("/v1/audit?kind=person").await.json().await.unwrap();
        let deeds = audit["items"].as_array().unwrap();
        deeds.iter().any(|it| it["body"]["action"] == "tare" && it["body"]["shows_mg"].is_number())
    };
    for _ in 0..1000 {
        if recorded().await {
            return service.stop().await;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    panic!("the balance was tared, and nobody wrote it down");
}

#[tokio::test]
async fn a_balance_that_is_not_there_in_use_or_not_the_callers_says_so() {
    let service = Service::ready().await;
    assert_eq!(code(&problem(service.get(BALANCE).await, 409).await), "no-balance");
    let refused = order(&service, "tare", &json!({ "mass": 3 })).await;
    assert_eq!(problem(refused, 400).await["errors"][0]["field"], "mass");

    let hold = service.hold_bench();
    let weighing: Value = service.weigh("held", &salt("skip")).await.json().await.unwrap();
    while service.pours() == 0 {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    let busy = problem(service.get(BALANCE).await, 409).await;
    assert_eq!(code(&busy), "bench-busy");
    assert!(busy["detail"].as_str().unwrap().contains(weighing["id"].as_str().unwrap()), "{busy}");
    assert_eq!(code(&problem(order(&service, "zero", &json!({})).await, 409).await), "bench-busy");
    drop(hold);

    let reserve = json!({ "owner": "Ada", "seconds": 60 });
    let token = service.token(Role::Operator).await;
    let id = weighing["id"].as_str().unwrap();
    service.watch(&format!("/v1/weighings/{id}/events"), None).await;
    while service.app.bench().await.unwrap().moving.is_some() {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    let request = service.request("POST", "/v1/bench/reservation").bearer_auth(token);
    let reserved: Value = request.json(&reserve).send().await.unwrap().json().await.unwrap();
    assert!(reserved["id"].is_string(), "{reserved}");
    let refused = order(&service, "tare", &json!({})).await;
    assert_eq!(code(&problem(refused, 409).await), "bench-reserved");
    let mine = order(&service, "tare", &json!({ "reservation": reserved["id"] })).await;
    assert_eq!(code(&problem(mine, 409).await), "no-balance");
}
