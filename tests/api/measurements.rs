//! Measurements of powders, as laboratories submit them: numbers, repeats, heaps, other
//! experiments, CSV files.

use crate::harness::{Service, fields, problem};
use flip::api::grpc::proto;
use flip::api::grpc::proto::powders_client::PowdersClient;
use flip::app::Role;
use reqwest::Response;
use serde_json::{Value, json};
use tonic::{Code, Request};

const MEASUREMENTS: &str = "/v1/powders/salt/measurements";
const OBSERVATIONS: &str = "/v1/powders/salt/observations";

async fn post(service: &Service, path: &str, body: &Value) -> Response {
    let request = service.request("POST", path).bearer_auth(service.token(Role::Operator).await);
    request.json(body).send().await.unwrap()
}

async fn created(service: &Service, path: &str, body: &Value) -> Value {
    let response = post(service, path, body).await;
    assert_eq!(response.status(), 201, "{body}");
    response.json().await.unwrap()
}

async fn import(service: &Service, query: &str, csv: impl Into<reqwest::Body>) -> Response {
    let request = service.request("POST", &format!("/v1/measurements/import{query}"));
    let request =
        request.bearer_auth(service.token(Role::Operator).await).header("content-type", "text/csv");
    request.body(csv).send().await.unwrap()
}

async fn count(service: &Service, path: &str) -> usize {
    service.get(path).await.json::<Value>().await.unwrap()["items"].as_array().unwrap().len()
}

#[tokio::test]
async fn a_measurement_is_given_as_a_mean_as_repeats_or_as_heaps() {
    let service = Service::start().await;
    for (body, angle, sd, n) in [
        (json!({ "method": "manual", "repose_deg": 33.5, "sd_deg": 1.25, "n": 4 }), 33.5, 1.25, 4),
        (json!({ "method": "manual", "repeats_deg": [30, 32, 34] }), 32.0, 2.0, 3),
        // A single value: its spread is unknown.
        (json!({ "method": "manual", "repose_deg": 33.5 }), 33.5, 0.0, 1),
        (json!({ "method": "manual", "repose_deg": 33.5, "n": 1 }), 33.5, 0.0, 1),
        (
            json!({ "method": "manual", "heights_mm": [20, 20], "base_diameters_mm": [40] }),
            45.0,
            0.0,
            2,
        ),
        (
            json!({ "method": "manual", "heights_mm": [20, 50], "base_diameters_mm": [40, 100], "funnel_height_mm": 50 }),
            45.0,
            0.0,
            2,
        ),
    ] {
        let measured = created(&service, MEASUREMENTS, &body).await;
        assert!(
            (measured["repose_deg"].as_f64().unwrap() - angle).abs() < 1e-9,
            "{body}: {measured}"
        );
        assert!((measured["sd_deg"].as_f64().unwrap() - sd).abs() < 1e-9, "{body}: {measured}");
        assert_eq!(measured["n"], n, "{body}");
    }
}

#[tokio::test]
async fn a_bad_measurement_is_refused_by_field_and_stores_nothing() {
    let service = Service::start().await;
    let before = count(&service, MEASUREMENTS).await;
    let heaps =
        |heights: Value, bases: Value| json!({ "heights_mm": heights, "base_diameters_mm": bases });
    for (body, field) in [
        (json!({}), "repose_deg"),
        (json!({ "sd_deg": 1, "n": 5 }), "repose_deg"),
        (json!({ "repose_deg": 30, "n": 5 }), "sd_deg"),
        (json!({ "repose_deg": 30, "sd_deg": 1 }), "n"),
        (json!({ "repose_deg": 30, "sd_deg": -1, "n": 5 }), "sd_deg"),
        (json!({ "repose_deg": 30, "sd_deg": 1, "n": 0 }), "n"),
        (json!({ "repose_deg": 86, "sd_deg": 1, "n": 5 }), "repose_deg"),
        (json!({ "repose_deg": 30, "sd_deg": 1, "n": 1, "repeats_deg": [30] }), "repose_deg"),
        (
            json!({ "repose_deg": 30, "sd_deg": 1, "n": 1, "funnel_height_mm": 30 }),
            "funnel_height_mm",
        ),
        (json!({ "repeats_deg": [30], "n": 1 }), "n"),
        (json!({ "repeats_deg": [] }), "repeats_deg"),
        (json!({ "repeats_deg": vec![30; 10_001] }), "repeats_deg"),
        (json!({ "repeats_deg": [30, 4] }), "repeats_deg[1]"),
        (json!({ "repeats_deg": [30, "steep"] }), "repeats_deg[1]"),
        (json!({ "heights_mm": [20] }), "base_diameters_mm"),
        (heaps(json!([]), json!([40])), "heights_mm"),
        (heaps(json!([20, 20, 20]), json!([40, 40])), "base_diameters_mm"),
        (heaps(json!([20]), json!([-40])), "base_diameters_mm[0]"),
        (heaps(json!([20, 300]), json!([40])), "heights_mm[1]"),
        (
            json!({ "heights_mm": [20], "base_diameters_mm": [40], "funnel_height_mm": 15 }),
            "heights_mm[0]",
        ),
        (
            json!({ "heights_mm": [20], "base_diameters_mm": [40], "repeats_deg": [45] }),
            "repeats_deg",
        ),
        (json!({ "repeats_deg": [30], "source": "x".repeat(501) }), "source"),
    ] {
        let mut body = body;
        body["method"] = json!("manual");
        let problem = problem(post(&service, MEASUREMENTS, &body).await, 400).await;
        assert_eq!(fields(&problem), [field], "{problem}");
    }
    assert_eq!(count(&service, MEASUREMENTS).await, before);
}

#[tokio::test]
async fn the_newest_observation_of_an_equal_experiment_counts() {
    let service = Service::start().await;
    let shake = |pitch: i32, mean: f64| json!({ "observable": { "kind": "shake_mass", "pitch_deg": pitch, "shake_mm": 4 }, "mean": mean, "sd": 0.5, "n": 5 });
    let drained = json!({ "observable": { "kind": "drained_angle" }, "mean": 38, "sd": 1, "n": 3, "source": "cup 2" });
    for body in [shake(30, 3.0), drained, shake(20, 1.0), shake(30, 4.0)] {
        let stored = created(&service, OBSERVATIONS, &body).await;
        assert_eq!(
            (&stored["powder"], &stored["mean"].as_f64()),
            (&json!("salt"), &body["mean"].as_f64())
        );
    }
    assert_eq!(count(&service, OBSERVATIONS).await, 4);
    let first: Value = service.get(&format!("{OBSERVATIONS}?limit=1")).await.json().await.unwrap();
    assert_eq!((&first["items"][0]["mean"], first["next"].is_string()), (&json!(3.0), true));
    let detail: Value = service.get("/v1/powders/salt").await.json().await.unwrap();
    let now = detail["observations"].as_array().unwrap();
    let known: Vec<_> = now
        .iter()
        .map(|o| (o["observable"]["kind"].as_str().unwrap(), o["mean"].as_f64().unwrap()))
        .collect();
    assert_eq!(known, [("drained_angle", 38.0), ("shake_mass", 1.0), ("shake_mass", 4.0)]);
    assert_eq!(count(&service, "/v1/powders/sand/observations").await, 0);
}

#[tokio::test]
async fn a_bad_observation_is_refused_by_field_and_stores_nothing() {
    let service = Service::start().await;
    let flow = |mass: f64, orifice: f64, mean: f64, sd: f64, n: i32| {
        let observable = json!({ "kind": "flow_time", "mass_g": mass, "orifice_mm": orifice });
        json!({ "observable": observable, "mean": mean, "sd": sd, "n": n })
    };
    for (body, field) in [
        (flow(50.0, 2.5, -1.0, 1.0, 5), "mean"),
        (flow(50.0, 2.5, 30.0, -1.0, 5), "sd"),
        (flow(50.0, 2.5, 30.0, 1.0, 1), "n"),
        (flow(50.0, 2.5, 30.0, 1.0, 10_001), "n"),
        (flow(0.0, 2.5, 30.0, 1.0, 5), "observable.mass_g"),
        (flow(50.0, 9.0, 30.0, 1.0, 5), "observable.orifice_mm"),
        (json!({ "observable": { "kind": "taste" }, "mean": 1, "sd": 1, "n": 5 }), "observable"),
        (json!({ "mean": 1, "sd": 1, "n": 5 }), "observable"),
    ] {
        let problem = problem(post(&service, OBSERVATIONS, &body).await, 400).await;
        assert!(fields(&problem)[0].starts_with(field), "{field}: {problem}");
    }
    assert_eq!(count(&service, OBSERVATIONS).await, 0);
    let body = flow(50.0, 2.5, 30.0, 1.0, 5);
    problem(post(&service, "/v1/powders/none/observations", &body).await, 404).await;
    problem(service.request("POST", OBSERVATIONS).json(&body).send().await.unwrap(), 401).await;
}

async fn as_operator<T>(service: &Service, message: T) -> Request<T> {
    let mut request = Request::new(message);
    let token = format!("Bearer {}", service.token(Role::Operator).await);
    request.metadata_mut().insert("authorization", token.parse().unwrap());
    request
}

#[tokio::test]
async fn measurements_and_observations_are_the_same_over_grpc() {
    let service = Service::start().await;
    let mut powders = PowdersClient::connect(service.url("")).await.unwrap();
    let new = || proto::AddMeasurementRequest {
        powder: "salt".into(),
        method: proto::Method::Manual.into(),
        ..proto::AddMeasurementRequest::default()
    };
    // As sent by a client that only has the three numbers and omits a zero.
    let plain = proto::AddMeasurementRequest { repose_deg: Some(30.0), n: Some(5), ..new() };
    let repeats = proto::AddMeasurementRequest { repeats_deg: vec![30.0, 32.0, 34.0], ..new() };
    let heaps = proto::AddMeasurementRequest {
        heights_mm: vec![20.0],
        base_diameters_mm: vec![40.0],
        ..new()
    };
    for (message, sd, n) in [(plain, 0.0, 5), (repeats, 2.0, 3), (heaps, 0.0, 1)] {
        let measured = powders
            .add_measurement(as_operator(&service, message).await)
            .await
            .unwrap()
            .into_inner();
        assert_eq!((measured.sd_deg, measured.n), (sd, n));
    }
    for message in [
        new(),
        proto::AddMeasurementRequest { repose_deg: Some(30.0), ..new() },
        proto::AddMeasurementRequest { repeats_deg: vec![f64::NAN], ..new() },
        proto::AddMeasurementRequest {
            heights_mm: vec![f64::INFINITY],
            base_diameters_mm: vec![40.0],
            ..new()
        },
        proto::AddMeasurementRequest { repeats_deg: vec![30.0], heights_mm: vec![20.0], ..new() },
    ] {
        let status =
            powders.add_measurement(as_operator(&service, message).await).await.unwrap_err();
        assert_eq!(status.code(), Code::InvalidArgument, "{status}");
    }

    use proto::observable::Kind;
    let kinds = [
        Kind::FlowTime(proto::FlowTime { mass_g: 50.0, orifice_mm: 2.5 }),
        Kind::ShakeMass(proto::ShakeMass { pitch_deg: 30.0, shake_mm: 4.0 }),
        Kind::DrainedAngle(proto::DrainedAngle {}),
        Kind::PileHeight(proto::PileHeight { base_diameter_mm: 40.0, fall_mm: 8.0 }),
    ];
    let observed = |kind: Option<Kind>| proto::AddObservationRequest {
        powder: "salt".into(),
        observable: kind.map(|kind| proto::Observable { kind: Some(kind) }),
        mean: 20.0,
        sd: 1.0,
        n: 5,
        source: None,
        measured_on: None,
    };
    for kind in kinds {
        powders.add_observation(as_operator(&service, observed(Some(kind))).await).await.unwrap();
    }
    let missing =
        powders.add_observation(as_operator(&service, observed(None)).await).await.unwrap_err();
    assert_eq!(missing.code(), Code::InvalidArgument);
    let list = proto::ListObservationsRequest { powder: "salt".into(), page: None };
    let items = powders.list_observations(list).await.unwrap().into_inner().items;
    let rest: Value = service.get(OBSERVATIONS).await.json().await.unwrap();
    let ids: Vec<&str> = items.iter().map(|item| item.id.as_str()).collect();
    assert_eq!(
        ids,
        rest["items"]
            .as_array()
            .unwrap()
            .iter()
            .map(|o| o["id"].as_str().unwrap())
            .collect::<Vec<_>>()
    );
    assert_eq!(
        items.iter().map(|item| item.observable.unwrap().kind.unwrap()).collect::<Vec<_>>(),
        kinds
    );
    let detail = powders
        .get_powder(proto::GetPowderRequest { id: "salt".into() })
        .await
        .unwrap()
        .into_inner();
    assert_eq!(detail.observations.len(), 4);
}

const FILE: &str = "\
powder,method,repose_deg,repose_sd_deg,n,height_mm,base_diameter_mm,flow_time_s,poured_mass_g,orifice_mm,source
flour,,47,,,,,,,,\"Bench 2, Tuesday\"
flour,,49,,,,,,,,\"Bench 2, Tuesday\"
flour,manual,,,,20,40,,,,ruler
chalk,manual,44.5,1.25,6,,,,,,
flour,,,,,,,31.5,50,2.5,Hall
flour,,,,,,,32.5,50,2.5,Hall
";

#[tokio::test]
async fn a_file_is_taken_in_whole_and_comes_back_as_it_was() {
    let service = Service::start().await;
    let response = import(&service, "?create=true", FILE).await;
    assert_eq!(response.status(), 201);
    let added: Value = response.json().await.unwrap();
    assert_eq!(added["powders"], json!(["flour", "chalk"]));
    let angles = added["measurements"].as_array().unwrap();
    let angles: Vec<_> =
        angles.iter().map(|m| json!([m["powder"], m["method"], m["n"], m["source"]])).collect();
    assert_eq!(
        angles,
        [
            json!(["flour", "automated", 2, "Bench 2, Tuesday"]),
            json!(["flour", "manual", 1, "ruler"]),
            json!(["chalk", "manual", 6, ""]),
        ]
    );
    assert_eq!(
        (&added["measurements"][0]["repose_deg"], &added["observations"][0]["mean"]),
        (&json!(48.0), &json!(32.0))
    );

    let export = service.get("/v1/powders/flour/measurements.csv").await;
    assert_eq!(export.headers()["content-type"], "text/csv; charset=utf-8");
    assert!(
        export.headers()["content-disposition"]
            .to_str()
            .unwrap()
            .contains("flour-measurements.csv")
    );
    let export = export.text().await.unwrap();
    assert_eq!(export.lines().count(), 4, "{export}");
    let other = Service::start().await;
    assert_eq!(import(&other, "?create=true", export.clone()).await.status(), 201);
    assert_eq!(other.get("/v1/powders/flour/measurements.csv").await.text().await.unwrap(), export);

    // Ten published measurements, three measurements and one observation, and the header.
    let everything = service.get("/v1/measurements.csv").await.text().await.unwrap();
    assert_eq!(everything.lines().count(), 15);
    assert_eq!(import(&service, "", everything).await.status(), 201, "no powder of it is new");
}

#[tokio::test]
async fn the_same_file_again_makes_no_duplicates_and_says_how_many_were_left_out() {
    let service = Service::start().await;
    let first: Value = import(&service, "?create=true", FILE).await.json().await.unwrap();
    assert!(first.get("already_stored").is_none(), "{first}");
    let all = service.get("/v1/measurements.csv").await.text().await.unwrap();
    let again: Value = import(&service, "", FILE).await.json().await.unwrap();
    assert_eq!(
        (&again["already_stored"], &again["measurements"], &again["observations"]),
        (&json!(4), &json!([]), &json!([]))
    );
    assert_eq!(service.get("/v1/measurements.csv").await.text().await.unwrap(), all);
    // Another source, another value or another powder is another measurement, and so is a row that
    // the file has once more than the store.
    for (csv, added) in [
        (
            "powder,method,repose_deg,repose_sd_deg,n\nchalk,manual,44.5,1.25,6\nchalk,manual,44.5,1.25,6\n",
            1,
        ),
        ("powder,method,repose_deg,repose_sd_deg,n,source\nchalk,manual,44.5,1.25,6,Hall\n", 1),
        (
            "powder,method,repose_deg,repose_sd_deg,n\nchalk,automated,44.5,1.25,6\nflour,manual,44.5,1.25,6\n",
            2,
        ),
        (
            "powder,method,repose_deg,repose_sd_deg,n\nchalk,manual,44.5,1.5,6\nchalk,manual,44.5,1.25,7\n",
            2,
        ),
    ] {
        let more: Value = import(&service, "", csv).await.json().await.unwrap();
        assert_eq!(more["measurements"].as_array().unwrap().len(), added, "{csv}: {more}");
    }
}

#[tokio::test]
async fn a_name_that_is_nearly_right_is_asked_about() {
    let service = Service::start().await;
    for (csv, meant) in [
        ("powder,repose_dge\nsalt,30\n", "did you mean `repose_deg`?"),
        ("powder,repose_deg\nsodium_bicarbonat,30\n", "did you mean `sodium_bicarbonate`?"),
        ("powder,repose_deg\nSodium bicarbonat,30\n", "did you mean `sodium_bicarbonate`?"),
    ] {
        let refused = problem(import(&service, "", csv).await, 400).await;
        assert!(refused["detail"].as_str().unwrap().contains(meant), "{csv}: {refused}");
    }
    let other = problem(import(&service, "", "powder,repose_deg\nflour,30\n").await, 400).await;
    assert!(!other.to_string().contains("did you mean"), "{other}");
}

#[tokio::test]
async fn the_spread_of_a_single_value_is_unknown_and_not_nothing() {
    let service = Service::start().await;
    let added: Value =
        import(&service, "", "powder,repose_deg,n\nsalt,36.2,1\nsand,30,\nsand,30,\n")
            .await
            .json()
            .await
            .unwrap();
    assert_eq!(added["measurements"][0]["sd_unknown"], true, "{added}");
    assert!(
        added["measurements"][1].get("sd_unknown").is_none(),
        "two equal repeats have a spread of nothing"
    );
    let export = service.get("/v1/powders/salt/measurements.csv").await.text().await.unwrap();
    assert!(export.contains("\nsalt,automated,36.2,,1,"), "{export}");
    assert_eq!(import(&Service::start().await, "", export).await.status(), 201);
}

#[tokio::test]
async fn a_bad_file_is_refused_by_row_and_column_and_stores_nothing() {
    let service = Service::start().await;
    let before = service.get("/v1/measurements.csv").await.text().await.unwrap();
    for (query, csv, named) in [
        (
            "?create=true",
            "powder,repose_deg\nflour,30\nflour,86\n",
            &["row[3].repose_deg"] as &[&str],
        ),
        (
            "",
            "powder,repose_deg\nsalt,30\nflour,30\nflour,31\nchalk,30\n",
            &["row[3].powder", "row[5].powder"],
        ),
        ("", "powder,repose\nsalt,30\n", &["repose"]),
        ("", "powder,repose_deg\nsalt,30,5\n", &["row[2]"]),
        ("", "powder,drained_deg\nsalt,30\n", &["row[2].drained_deg"]),
        ("", "", &["powder"]),
        ("?create=maybe", "powder,repose_deg\nsalt,30\n", &["create"]),
        ("?update=true", "powder,repose_deg\nsalt,30\n", &["update"]),
    ] {
        let problem = problem(import(&service, query, csv).await, 400).await;
        assert_eq!(fields(&problem), named, "{csv}: {problem}");
    }
    let unknown = problem(import(&service, "", "powder,repose_deg\nflour,30\n").await, 400).await;
    assert!(unknown["detail"].as_str().unwrap().contains("`flour`"), "{unknown}");
    problem(import(&service, "", b"powder\n\xff\n".to_vec()).await, 400).await;
    let large = problem(import(&service, "", " ".repeat(8 * 1024 * 1024 + 1)).await, 400).await;
    assert_eq!(fields(&large), ["file"]);
    problem(import(&service, "", " ".repeat(16 * 1024 * 1024 + 1)).await, 413).await;
    let problem_of_json =
        problem(post(&service, "/v1/measurements/import", &json!({})).await, 415).await;
    assert!(problem_of_json["detail"].as_str().unwrap().contains("text/csv"));
    problem(service.request("POST", "/v1/measurements/import").send().await.unwrap(), 401).await;
    problem(service.get("/v1/powders/flour").await, 404).await;
    problem(service.get("/v1/powders/flour/measurements.csv").await, 404).await;
    assert_eq!(service.get("/v1/measurements.csv").await.text().await.unwrap(), before);
}

#[tokio::test]
async fn a_powder_is_registered_by_its_name_under_an_id_that_is_told() {
    let service = Service::start().await;
    let utf16 = |text: &str| -> Vec<u8> {
        [0xff, 0xfe].into_iter().chain(text.encode_utf16().flat_map(u16::to_le_bytes)).collect()
    };
    let file = "Powder\tRepose_Deg\r\nLactose 200M\t40,5\r\n3-Nitrotoluene\t38,5\r\nSodium bicarbonate\t42,5\r\n";
    let unknown = problem(import(&service, "", utf16(file)).await, 400).await;
    assert_eq!(
        fields(&unknown),
        ["row[2].powder", "row[3].powder"],
        "sodium bicarbonate is registered"
    );
    let added: Value = import(&service, "?create=true", utf16(file)).await.json().await.unwrap();
    assert_eq!(added["powders"], json!(["lactose_200m", "p_3_nitrotoluene"]));
    assert_eq!(added["named"][0], json!({ "name": "Lactose 200M", "id": "lactose_200m" }));
    assert_eq!(added["measurements"][2]["powder"], "sodium_bicarbonate");
    let powder: Value = service.get("/v1/powders/p_3_nitrotoluene").await.json().await.unwrap();
    assert_eq!(powder["powder"]["name"], "3-Nitrotoluene");
    let again = import(&service, "", "powder,repose_deg\nLACTOSE 200M,41\nlactose_200m,41\n").await;
    assert_eq!(again.status(), 201, "by the name that it has, or its id");
    let other = problem(
        import(&service, "?create=true", "powder,repose_deg\nLactose-200M,41\n").await,
        400,
    )
    .await;
    assert!(other["detail"].as_str().unwrap().contains("`Lactose 200M`"), "{other}");

    // The same without a file.
    let post = async |body: Value| post(&service, "/v1/powders", &body).await;
    let made: Value = post(json!({ "name": "Stärke (Mais)" })).await.json().await.unwrap();
    assert_eq!((&made["id"], &made["name"]), (&json!("staerke_mais"), &json!("Stärke (Mais)")));
    assert_eq!(post(json!({ "name": "Lactose 200-M", "id": "lac" })).await.status(), 201);
    assert_eq!(fields(&problem(post(json!({ "name": "?!" })).await, 400).await), ["name"]);
    problem(post(json!({ "name": "Salt" })).await, 409).await;
    let mut powders = PowdersClient::connect(service.url("")).await.unwrap();
    let new = proto::CreatePowderRequest {
        name: "食盐".into(),
        soluble: Some(true),
        ..Default::default()
    };
    let made = powders.create_powder(as_operator(&service, new).await).await.unwrap().into_inner();
    assert!(made.id.starts_with("p_") && made.name == "食盐", "{}", made.id);
    assert_eq!(made.soluble, Some(true));
    let quartz = post(json!({ "name": "Quartz", "soluble": false })).await;
    assert_eq!(quartz.json::<serde_json::Value>().await.unwrap()["soluble"], false);
}

#[tokio::test]
async fn twenty_thousand_rows_are_taken_over_rest_and_grpc() {
    let service = Service::start().await;
    // Two sources, 10000 repeats at most each; a remark makes it more than a megabyte.
    let row = |k: u32| {
        format!("salt,{}.{},\"bench {}, {:>60}\"\r\n", 30 + k % 7, k % 10, k % 2, "by the window")
    };
    let rows: String = (0..20_000).map(row).collect();
    let response = import(&service, "", format!("powder,repose_deg,source\r\n{rows}")).await;
    assert_eq!(response.status(), 201);
    let added: Value = response.json().await.unwrap();
    assert_eq!(
        (&added["measurements"][0]["n"], &added["measurements"][1]["n"]),
        (&json!(10_000), &json!(10_000))
    );
}

#[tokio::test]
async fn the_day_of_a_measurement_is_kept_told_and_exported() {
    let service = Service::start().await;
    let file = "powder,repose_deg,date\nsalt,30,2026-02-03\nsalt,32,3.2.2026\nsalt,40,2026-02-04\n";
    let added: Value = import(&service, "", file).await.json().await.unwrap();
    let of = |it: &Value| (it["measured_on"].clone(), it["n"].clone());
    let days: Vec<_> = added["measurements"].as_array().unwrap().iter().map(of).collect();
    assert_eq!(days, [(json!("2026-02-03"), json!(2)), (json!("2026-02-04"), json!(1))]);
    let export = service.get("/v1/measurements.csv").await.text().await.unwrap();
    assert!(export.lines().next().unwrap().ends_with(",source,date"), "{export}");
    assert!(export.lines().any(|line| line.ends_with(",2026-02-04")), "{export}");
    let again: Value = import(&service, "", file).await.json().await.unwrap();
    assert_eq!(again["measurements"], json!([]), "it is stored already");
    let refused =
        problem(import(&service, "", "powder,repose_deg,date\nsalt,30,2/3/2026\n").await, 400)
            .await;
    assert_eq!(fields(&refused), ["row[2].date"]);
    let verified: Value = service.get("/v1/audit/verification").await.json().await.unwrap();
    assert_eq!(verified["broken"], Value::Null, "{verified}");
    let wrong = json!({ "method": "manual", "repose_deg": 31, "measured_on": "yesterday" });
    let refused = problem(post(&service, "/v1/powders/salt/measurements", &wrong).await, 400).await;
    assert_eq!(fields(&refused), ["measured_on"]);
}
