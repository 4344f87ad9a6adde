//! Shakes through the sockets: of weighings, of files, and forgotten.

use crate::harness::{Service, fields, problem};
use crate::investigations::as_operator;
use crate::toy::Bench;
use flip::api::grpc::proto;
use flip::api::grpc::proto::shakes_client::ShakesClient;
use flip::api::grpc::proto::weighings_client::WeighingsClient;
use flip::app::Role;
use flip_bench::emulate::lab::Settings as LaboratorySettings;
use flip_bench::hardware::DeviceError;
use flip_bench::rig::{Emulated, OnEvent, Poured, Pouring, Rig};
use flip_core::domain::bench::BenchKind;
use reqwest::Response;
use serde_json::{Value, json};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use tonic::{Code, Request};

/// Weighs salt of this lot, and returns the weighing with its ticks.
async fn weighed(service: &Service, key: &str, lot: Option<&str>) -> Value {
    let mut request = json!({
        "powder": "salt",
        "target": { "value": 15, "unit": "mg" },
        "tolerance": { "lower": 10, "upper": 10, "unit": "%" },
    });
    if let Some(lot) = lot {
        request["asked"] = json!({ "lot": lot });
    }
    let planned: Value = service.weigh(key, &request).await.json().await.unwrap();
    let path = format!("/v1/weighings/{}", planned["id"].as_str().unwrap());
    service.watch(&format!("{path}/events"), None).await;
    service.get(&path).await.json().await.unwrap()
}

async fn listed(service: &Service, query: &str) -> Vec<Value> {
    let page: Value = service.get(&format!("/v1/shakes{query}")).await.json().await.unwrap();
    page["items"].as_array().unwrap_or_else(|| panic!("{page}")).clone()
}

async fn send(service: &Service, method: &str, path: &str, csv: &str) -> Response {
    let request = service.request(method, path).bearer_auth(service.token(Role::Operator).await);
    request.header("content-type", "text/csv").body(csv.to_owned()).send().await.unwrap()
}

async fn import(service: &Service, query: &str, csv: &str) -> Response {
    send(service, "POST", &format!("/v1/shakes/import{query}"), csv).await
}

async fn forget(service: &Service, query: &str) -> Value {
    send(service, "DELETE", &format!("/v1/shakes{query}"), "").await.json().await.unwrap()
}

fn fell_mg(item: &Value) -> Vec<f64> {
    let shakes = item["spoonful"]["shakes"].as_array().unwrap();
    shakes.iter().map(|shake| shake["fell_mg"].as_f64().unwrap()).collect()
}

fn names(items: &[Value]) -> Vec<&str> {
    items.iter().map(|item| item["spoonful"]["weighing"].as_str().unwrap()).collect()
}

#[tokio::test]
async fn the_shakes_of_a_weighing_are_those_of_its_trace() {
    let service = Service::ready().await;
    let done = weighed(&service, "one", Some("L1")).await;
    weighed(&service, "two", None).await;
    let items = listed(&service, "?powder=salt&lot=L1").await;
    let [item] = &items[..] else { panic!("{items:?}") };
    assert_eq!(
        (&item["bench"], &item["at"]),
        (&json!("simulated"), &done["weighing"]["started_at"])
    );
    let spoonful = &item["spoonful"];
    assert_eq!(spoonful["weighing"], done["weighing"]["id"]);
    assert_eq!(spoonful["session"], item["at"].as_str().unwrap()[..10]);
    assert_eq!((&spoonful["lot"], &spoonful["readability_mg"]), (&json!("L1"), &json!(1.0)));
    assert_eq!(fell_mg(item), [7.5, 7.5]);
    let holds_mg = done["weighing"]["apparatus"]["capacity_mg"].as_f64().unwrap();
    let left_mg = spoonful["shakes"][1]["spoon_mg"].as_f64().unwrap();
    assert!((holds_mg - 7.5 - left_mg).abs() < 1e-9 && holds_mg > 10.0, "{spoonful}");
    // Pages do not overlap, and nothing is left out.
    let first: Value = service.get("/v1/shakes?limit=1").await.json().await.unwrap();
    let next = first["next"].as_str().unwrap();
    let second = listed(&service, &format!("?limit=1&after={next}")).await;
    let id = done["weighing"]["id"].as_str().unwrap();
    assert_eq!(names(first["items"].as_array().unwrap()), [id]);
    assert!(second.len() == 1 && second[0]["spoonful"]["lot"].is_null(), "{second:?}");
    assert!(listed(&service, "?bench=devices").await.is_empty());
    problem(service.get("/v1/shakes?bench=dreamt").await, 400).await;
}

#[tokio::test]
async fn the_shakes_of_an_emulated_bench_add_up_to_its_reading() {
    let rig = Emulated::new(LaboratorySettings::default());
    let service = Service::ready_on(Arc::new(rig)).await;
    let done = weighed(&service, "one", None).await;
    let reading_mg = done["weighing"]["reading_mg"].as_f64().unwrap_or_else(|| panic!("{done}"));
    let items = listed(&service, "?bench=emulated").await;
    let shakes = items[0]["spoonful"]["shakes"].as_array().unwrap();
    let sum: f64 = fell_mg(&items[0]).iter().sum();
    // The result is a mean of later readings of a balance that wanders; between the first and the last
    // reading of the dose, nothing is lost.
    let ticks = done["ticks"].as_array().unwrap();
    let shown_mg = |tick: &Value| tick["reading"]["mass_mg"].as_f64().unwrap();
    let rose_mg = shown_mg(ticks.last().unwrap()) - shown_mg(&ticks[0]);
    assert!((sum - rose_mg).abs() < 1e-9, "{sum} mg in shakes, {rose_mg} mg in all");
    assert!((sum - reading_mg).abs() < 5.0, "{sum} mg in shakes, a result of {reading_mg} mg");
    assert_eq!(shakes.len() + 1, ticks.len());
    let strokes = shakes.iter().filter(|shake| shake["shake_mm"].as_f64().unwrap() > 0.0);
    assert_eq!(strokes.clone().count() as u64, done["weighing"]["shakes"].as_u64().unwrap());
    assert!(strokes.clone().all(|shake| shake["acceleration_m_s2"].as_f64().unwrap() > 0.1));
    assert!(
        reading_mg > 5.0 && shakes.iter().all(|it| it["since_filled_s"].as_f64().unwrap() > 0.0)
    );
}

#[tokio::test]
async fn an_export_is_imported_elsewhere_as_it_was_and_again_adds_nothing() {
    let (service, other) = (Service::ready().await, Service::ready().await);
    weighed(&service, "one", Some("L1")).await;
    let own =
        "weighing,spoonful,powder,pitch_deg,shake_mm,fell_mg,sd_mg\nmine,1,salt,40,16,-1,0.4\n";
    assert_eq!(import(&service, "?source=notebook", own).await.status(), 201);
    let items = listed(&service, "").await;
    assert_eq!((fell_mg(&items[1]), &items[1]["source"]), (vec![-1.0], &json!("notebook")));
    assert!(items[1].get("bench").is_none(), "{}", items[1]);

    let csv = service.get("/v1/shakes.csv?powder=salt").await;
    assert!(csv.headers()["content-type"].to_str().unwrap().starts_with("text/csv"));
    let csv = csv.text().await.unwrap();
    assert_eq!(csv.lines().count(), 1 + 2 + 1, "{csv}");
    let added: Value = import(&other, "", &csv).await.json().await.unwrap();
    assert_eq!((&added["spoonfuls"], &added["shakes"]), (&json!(2), &json!(3)), "{added}");
    assert_eq!(other.get("/v1/shakes.csv").await.text().await.unwrap(), csv);
    let spoonfuls = |items: Vec<Value>| -> Vec<Value> {
        items.into_iter().map(|item| item["spoonful"].clone()).collect()
    };
    assert_eq!(spoonfuls(listed(&other, "").await), spoonfuls(items));
    for service in [&service, &other] {
        let again: Value = import(service, "", &csv).await.json().await.unwrap();
        assert_eq!((&again["spoonfuls"], &again["already_stored"]), (&json!(0), &json!(2)));
    }
    let changed = csv.replace(",-1,", ",-2,");
    let refused = problem(import(&other, "", &changed).await, 400).await;
    assert_eq!(fields(&refused), ["row[4].weighing"]);
    let unknown = own.replace("salt", "Mother of pearl");
    let refused = problem(import(&other, "", &unknown).await, 400).await;
    assert_eq!(fields(&refused), ["row[2].powder"]);
    let added: Value = import(&other, "?create=true", &unknown).await.json().await.unwrap();
    assert_eq!(added["powders"], json!(["mother_of_pearl"]));
    let found: Value = other.get("/v1/audit/verification").await.json().await.unwrap();
    assert_eq!(found["broken"], Value::Null, "{found}");
}

#[tokio::test]
async fn what_is_forgotten_is_not_listed_and_stays_on_record() {
    let service = Service::ready().await;
    let first = weighed(&service, "one", Some("L1")).await;
    weighed(&service, "two", Some("L2")).await;
    let own = "weighing,powder,lot,pitch_deg,shake_mm,fell_mg,sd_mg\nmine,salt,L1,40,16,3,0.4\n";
    import(&service, "", own).await;
    let found = forget(&service, "?powder=salt&lot=L1").await;
    assert_eq!((&found["spoonfuls"], &found["forgotten"]["lot"]), (&json!(2), &json!("L1")));
    let left = listed(&service, "").await;
    assert_eq!((left.len(), &left[0]["spoonful"]["lot"]), (1, &json!("L2")));
    // What comes later counts.
    let later = weighed(&service, "three", Some("L1")).await;
    import(&service, "", own).await;
    let items = listed(&service, "?lot=L1").await;
    assert_eq!(names(&items), [later["weighing"]["id"].as_str().unwrap(), "mine"]);
    assert_eq!(forget(&service, "?powder=salt").await["spoonfuls"], 3);
    assert!(listed(&service, "").await.is_empty());
    // Evidence stays.
    let path = format!("/v1/weighings/{}/trace", first["weighing"]["id"].as_str().unwrap());
    assert_eq!(service.get(&path).await.json::<Value>().await.unwrap(), first["ticks"]);
    let verified: Value = service.get("/v1/audit/verification").await.json().await.unwrap();
    assert_eq!(verified["broken"], Value::Null, "{verified}");
    let trail = service.get("/v1/audit.json").await.text().await.unwrap();
    assert_eq!(trail.matches("\"forget shakes\"").count(), 2);
    let pool = flip_testing::pool(service.folder()).await;
    for sql in ["DELETE FROM forgotten WHERE lot IS NULL", "UPDATE spoonful SET lot = 'L9'"] {
        sqlx::query(sql).execute(&pool).await.unwrap();
    }
    pool.close().await;
    let found: Value = service.get("/v1/audit/verification").await.json().await.unwrap();
    let others: Vec<&str> =
        found["others"].as_array().unwrap().iter().map(|it| it["what"].as_str().unwrap()).collect();
    assert_eq!(others, ["spoonful", "spoonful", "forgotten"], "{found}");
    let send = |path: &'static str| send(&service, "DELETE", path, "");
    problem(send("/v1/shakes?powder=none").await, 404).await;
    problem(send("/v1/shakes").await, 400).await;
}

/// A bench whose doses may inform the next.
struct Remembering(Bench);

impl Rig for Remembering {
    fn kind(&self) -> BenchKind {
        BenchKind::Simulated
    }

    fn exchanges_vials(&self) -> bool {
        true
    }

    fn halt(&self) -> Result<(), DeviceError> {
        Ok(())
    }

    fn readability_mg(&self) -> Option<f64> {
        Some(1.0)
    }

    fn remembers(&self) -> bool {
        true
    }

    fn pour(&self, pouring: &Pouring, on_event: OnEvent<'_>, stop: &AtomicBool) -> Poured {
        self.0.pour(pouring, on_event, stop)
    }
}

/// How many earlier spoonfuls informed the forecast of this one, by its record.
async fn informed_by(service: &Service, weighing: &Value) -> u64 {
    let id = weighing["weighing"]["id"].as_str().unwrap();
    let path = format!("/v1/audit?weighing={id}&limit=200");
    let trail: Value = service.get(&path).await.json().await.unwrap();
    let action = "forecast from earlier doses of the powder";
    let mut records = trail["items"].as_array().unwrap().iter();
    let found = records.find(|record| record["body"]["action"] == action);
    found.map_or(0, |record| record["body"]["spoonfuls"].as_u64().unwrap())
}

#[tokio::test]
async fn a_dose_is_forecast_from_its_lot_and_not_from_what_was_forgotten() {
    let service = Service::ready_on(Arc::new(Remembering(Bench::default()))).await;
    let mut seen = Vec::new();
    for (key, lot) in [("1", Some("A")), ("2", Some("B")), ("3", Some("A")), ("4", None)] {
        seen.push(informed_by(&service, &weighed(&service, key, lot).await).await);
    }
    assert_eq!(seen, [0, 0, 1, 3]);
    forget(&service, "?powder=salt&lot=A").await;
    let mut seen = Vec::new();
    for (key, lot) in [("5", Some("A")), ("6", Some("B")), ("7", None)] {
        seen.push(informed_by(&service, &weighed(&service, key, lot).await).await);
    }
    // Of the lot A the one since; of any lot the two of B, the one of A and the one of none.
    assert_eq!(seen, [0, 1, 4]);
}

#[tokio::test]
async fn grpc_lists_imports_and_forgets_the_same() {
    let service = Service::ready().await;
    let mut client = ShakesClient::connect(service.url("")).await.unwrap();
    let shakes_csv =
        "weighing,powder,lot,pitch_deg,shake_mm,fell_mg,sd_mg\nmine,salt,L1,40,16,-1,0.4\n";
    let request = proto::ImportShakesRequest {
        shakes_csv: shakes_csv.to_owned(),
        source: "notebook".to_owned(),
        create: false,
    };
    let refused = client.import_shakes(Request::new(request.clone())).await.unwrap_err();
    assert_eq!(refused.code(), Code::Unauthenticated);
    let request = as_operator(&service, request).await;
    assert_eq!(client.import_shakes(request).await.unwrap().into_inner().shakes, 1);
    let done = weighed(&service, "one", Some("L1")).await;
    let mut weighings = WeighingsClient::connect(service.url("")).await.unwrap();
    let id = done["weighing"]["id"].as_str().unwrap().to_owned();
    let found = weighings.get_weighing(proto::GetWeighingRequest { id }).await.unwrap();
    let apparatus = found.into_inner().weighing.unwrap().apparatus.unwrap();
    let rest = &done["weighing"]["apparatus"];
    assert_eq!(json!(apparatus.readability_mg), rest["readability_mg"]);
    assert_eq!(json!(apparatus.capacity_mg), rest["capacity_mg"]);
    let list = |bench: &str| proto::ListShakesRequest {
        lot: Some("L1".to_owned()),
        bench: Some(bench.to_owned()),
        ..Default::default()
    };
    let found = client.list_shakes(list("simulated")).await.unwrap().into_inner().items;
    let rest = listed(&service, "?lot=L1").await;
    for (item, rest) in found.iter().zip(&rest) {
        let spoonful = item.spoonful.as_ref().unwrap();
        let fell: Vec<f64> = spoonful.shakes.iter().map(|shake| shake.fell_mg).collect();
        assert_eq!(fell, fell_mg(rest));
        assert_eq!(spoonful.weighing, rest["spoonful"]["weighing"]);
        assert_eq!(item.bench.as_deref(), rest["bench"].as_str());
    }
    assert_eq!((found.len(), found[1].source.as_str()), (2, "notebook"));
    let refused = client.list_shakes(list("dreamt")).await.unwrap_err();
    assert_eq!(refused.code(), Code::InvalidArgument);
    let forget = proto::ForgetShakesRequest { powder: "salt".to_owned(), lot: None };
    let request = as_operator(&service, forget).await;
    assert_eq!(client.forget_shakes(request).await.unwrap().into_inner().spoonfuls, 2);
    assert!(listed(&service, "").await.is_empty());
}
