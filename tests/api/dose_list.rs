//! Lists of doses: checked row by row, planned all or none, weighed in order, certified together.

use crate::grpc::{as_operator, channel};
use crate::harness::{Service, fields, problem};
use flip::api::grpc::proto;
use flip::api::grpc::proto::weighings_client::WeighingsClient;
use flip::app::Role;
use serde_json::{Value, json};

/// As copied from a spreadsheet, with names and signs of a laboratory's own.
const TABLE: &str =
    "Substance\tMass [mg]\tWell\tTol (mg)\nSalt\t15\tTray1\t1,5\nsalt\t8,5\tTray2\t\n";

async fn send(service: &Service, key: &str, body: &Value) -> reqwest::Response {
    let token = service.token(Role::Operator).await;
    let request = service.request("POST", "/v1/weighings/list").bearer_auth(token);
    request.header("Idempotency-Key", key).json(body).send().await.unwrap()
}

async fn total(service: &Service, query: &str) -> u64 {
    let path = format!("/v1/weighings?{query}");
    let page: Value = service.get(&path).await.json().await.unwrap();
    page["total"].as_u64().unwrap()
}

#[tokio::test]
async fn a_pasted_table_is_checked_then_weighed_in_order_and_certified_as_one() {
    let service = Service::ready().await;
    let body = |check: bool| json!({ "name": "Plate 7/b", "table": TABLE, "operator": "Ada", "check": check });
    let checked = send(&service, "", &body(true)).await;
    assert_eq!(checked.status(), 200);
    let checked: Value = checked.json().await.unwrap();
    let row = |k: usize, field: &str| checked["doses"][k][field].clone();
    assert_eq!((row(0, "powder"), row(0, "target_mg")), (json!("salt"), json!(15.0)));
    assert_eq!(
        (row(0, "tolerance_upper_mg"), row(1, "tolerance_upper_mg")),
        (json!(1.5), json!(1.0))
    );
    assert_eq!((row(1, "target_mg"), row(1, "weighing")), (json!(8.5), Value::Null));
    assert_eq!(
        (row(1, "asked")["position"].clone(), row(1, "asked")["operator"].clone()),
        (json!("Tray2"), json!("Ada"))
    );
    assert_eq!(total(&service, "").await, 0, "checking stores nothing");

    let planned = send(&service, "k", &body(false)).await;
    assert_eq!(planned.status(), 202);
    let location = planned.headers()["location"].to_str().unwrap().to_owned();
    let planned: Value = planned.json().await.unwrap();
    let again = send(&service, "k", &body(false)).await;
    assert_eq!(again.headers()["idempotency-replayed"], "true");
    assert_eq!(again.json::<Value>().await.unwrap(), planned);
    let path = "/v1/weighings/certificate.html?list=Plate+7%2Fb";
    for dose in planned["doses"].as_array().unwrap() {
        let id = dose["weighing"].as_str().unwrap();
        service.watch(&format!("/v1/weighings/{id}/events"), None).await.unwrap();
    }
    assert_eq!(service.pours(), 2);
    let found: Value = service.get(&format!("{location}&sort=oldest")).await.json().await.unwrap();
    let positions: Vec<&Value> =
        found["items"].as_array().unwrap().iter().map(|it| &it["asked"]["position"]).collect();
    assert_eq!(positions, ["Tray1", "Tray2"]);
    assert!(found["items"][0]["started_at"].as_str() < found["items"][1]["started_at"].as_str());
    assert_eq!(total(&service, "q=tray2").await, 1);

    let page = service.get(path).await;
    assert_eq!(page.status(), 200);
    let page = page.text().await.unwrap();
    for said in ["Plate 7/b", "2 of 2 doses within tolerance", "Tray1", "no real powder"] {
        assert!(page.contains(said), "{said}: {page}");
    }
    let none = service.get("/v1/weighings/certificate.html?list=Plate+8").await;
    problem(none, 404).await;
}

#[tokio::test]
async fn every_wrong_row_is_named_by_row_and_column_and_nothing_is_stored() {
    let service = Service::ready().await;
    let table = "powder;target_mg;vial;repeats;tolerance_mg\n\
                 salt;15;V1;;\n\
                 gold;5;V2;;\n\
                 salt;;V3;;\n\
                 salt;-3;;;\n\
                 salt;10;V1;;\n\
                 salt;10;V4;2;\n\
                 salt;10;;3;20\n";
    let refused =
        problem(send(&service, "k", &json!({ "name": "L", "table": table })).await, 400).await;
    let mut all = fields(&refused);
    all.sort_unstable();
    // Rows first, then what only the service knows.
    assert_eq!(all, ["row[4].target_mg", "row[5].target_mg", "row[7].repeats"], "{refused}");
    let rest = "powder;target_mg;vial;repeats;tolerance_mg\nsalt;15;V1;;\ngold;5;V2;;\nsalt;10;V1;;\nsalt;10;;3;20\n";
    let vials =
        problem(send(&service, "k", &json!({ "name": "L", "table": rest })).await, 400).await;
    assert_eq!(fields(&vials), ["row[4].vial"]);
    let rest = rest.replace("10;V1", "10;V5");
    let known =
        problem(send(&service, "k", &json!({ "name": "L", "table": rest })).await, 400).await;
    assert!(
        fields(&known).starts_with(&["row[3].powder"])
            && fields(&known).contains(&"row[5].tolerance_lower_mg"),
        "{known}"
    );
    for (body, field) in [
        (json!({ "name": " ", "table": "powder,target_mg\nsalt,5\n" }), "name"),
        (json!({ "name": "L" }), "doses"),
        (json!({ "name": "L", "table": "powder\nsalt\n" }), "row[1]"),
        (
            json!({ "name": "L", "table": format!("powder,target_mg,repeats\n{}", "salt,5,40\n".repeat(2)) }),
            "doses",
        ),
    ] {
        let refused = problem(send(&service, "k", &body).await, 400).await;
        assert_eq!(fields(&refused)[0], field, "{refused}");
    }
    let one = json!({ "powder": "salt", "target": { "value": 0, "unit": "mg" }, "tolerance": { "lower": 1, "upper": 1, "unit": "mg" } });
    let refused =
        problem(send(&service, "k", &json!({ "name": "L", "doses": [one] })).await, 400).await;
    assert_eq!(fields(&refused), ["doses[0].target.value"]);
    let one = json!({ "powder": "salt", "target": { "value": 9, "unit": "mg" }, "tolerance": { "lower": 1, "upper": 1, "unit": "mg" }, "asked": { "list": "K" } });
    let refused =
        problem(send(&service, "k", &json!({ "name": "L", "doses": [one] })).await, 400).await;
    assert_eq!(fields(&refused), ["doses[0].asked.list"]);
    assert_eq!((total(&service, "").await, service.pours()), (0, 0));
}

#[tokio::test]
async fn a_list_is_planned_once_under_its_name_and_its_key() {
    let service = Service::ready().await;
    let hold = service.hold_bench();
    let body = json!({ "name": "L", "table": "powder,target_mg,repeats\nsalt,15,3\n" });
    let at_once = futures::future::join_all((0..8).map(|_| send(&service, "k", &body))).await;
    assert!(at_once.iter().all(|response| response.status() == 202));
    assert_eq!(total(&service, "list=L").await, 3);
    let other = json!({ "name": "L", "table": "powder,target_mg,repeats\nsalt,16,3\n" });
    problem(send(&service, "k", &other).await, 422).await;
    let taken = problem(send(&service, "k2", &other).await, 409).await;
    assert_eq!(taken["type"], "urn:flip:problem:list-exists");
    // One pours and two wait: 62 more may.
    service.until_pouring().await;
    let more = |name: &str, repeats: u32| json!({ "name": name, "table": format!("powder,target_mg,repeats\nsalt,15,{repeats}\n") });
    let busy = problem(send(&service, "k3", &more("M", 63)).await, 409).await;
    assert!(busy["detail"].as_str().unwrap().contains("62 doses or fewer"), "{busy}");
    assert_eq!(total(&service, "list=M").await, 0);
    assert_eq!(send(&service, "k4", &more("N", 62)).await.status(), 202);
    let open = service.get("/v1/weighings/certificate.html?list=L").await;
    assert_eq!(problem(open, 409).await["type"], "urn:flip:problem:weighing-unfinished");
    drop(hold);
}

#[tokio::test]
async fn a_list_comes_by_grpc_as_it_does_by_rest() {
    let service = Service::ready().await;
    let mut client = WeighingsClient::new(channel(&service).await);
    let request = |check: bool| {
        as_operator(
            &service,
            proto::StartDoseListRequest {
                name: "G".to_owned(),
                table: Some(TABLE.to_owned()),
                check,
                idempotency_key: "k".to_owned(),
                ..proto::StartDoseListRequest::default()
            },
        )
    };
    let checked = client.start_dose_list(request(true).await).await.unwrap().into_inner();
    assert!(checked.doses.len() == 2 && checked.doses[0].weighing.is_none());
    let planned = client.start_dose_list(request(false).await).await.unwrap().into_inner();
    let again = client.start_dose_list(request(false).await).await.unwrap().into_inner();
    assert!(!planned.replayed && again.replayed && planned.doses == again.doses);
    assert_eq!(planned.doses[1].asked.as_ref().unwrap().position.as_deref(), Some("Tray2"));
    let found = proto::ListWeighingsRequest { list: Some("G".to_owned()), ..Default::default() };
    let found =
        client.list_weighings(as_operator(&service, found).await).await.unwrap().into_inner();
    assert_eq!(found.total, 2);
}
