//! Names, notes, tags and archives; powders by the names people write; corrected measurements.

use crate::grpc::{as_operator, channel, problem_of};
use crate::harness::{Service, fields, problem};
use flip::api::grpc::proto;
use flip::api::grpc::proto::labels_client::LabelsClient;
use flip::api::grpc::proto::powders_client::PowdersClient;
use flip::app::Role;
use reqwest::Response;
use serde_json::{Value, json};
use tonic::{Code, Request};

async fn send(service: &Service, method: &str, path: &str, body: &Value) -> Response {
    let request = service.request(method, path).bearer_auth(service.token(Role::Operator).await);
    request.json(body).send().await.unwrap()
}

async fn put(service: &Service, path: &str, body: Value) -> Value {
    let response = send(service, "PUT", path, &body).await;
    assert_eq!(response.status(), 200, "{path} {body}");
    response.json().await.unwrap()
}

async fn read(service: &Service, path: &str) -> Value {
    let response = service.get(path).await;
    assert_eq!(response.status(), 200, "{path}");
    response.json().await.unwrap()
}

async fn ids(service: &Service, path: &str) -> Vec<String> {
    let list = read(service, path).await;
    list["items"]
        .as_array()
        .unwrap()
        .iter()
        .map(|it| it["id"].as_str().unwrap().to_owned())
        .collect()
}

/// A dose of salt, to its end.
async fn dose(service: &Service, key: &str) -> String {
    let request = json!({ "powder": "salt", "target": { "value": 10, "unit": "mg" },
        "tolerance": { "lower": 10, "upper": 10, "unit": "%" } });
    let response = service.weigh(key, &request).await;
    assert_eq!(response.status(), 202);
    let id = response.json::<Value>().await.unwrap()["id"].as_str().unwrap().to_owned();
    service.watch(&format!("/v1/weighings/{id}/events"), None).await;
    id
}

#[tokio::test(flavor = "multi_thread")]
async fn a_name_a_note_and_tags_are_kept_listed_searched_and_in_the_record() {
    let service = Service::ready().await;
    let weighing = dose(&service, "k1").await;
    let other = dose(&service, "k2").await;
    let policy = ids(&service, "/v1/policies").await[0].clone();
    for (kind, id, list) in [
        ("weighing", weighing.as_str(), "/v1/weighings"),
        ("policy", policy.as_str(), "/v1/policies"),
        ("powder", "salt", "/v1/powders"),
    ] {
        let path = format!("/v1/labels/{kind}/{id}");
        let before = read(&service, &path).await;
        assert_eq!((&before["note"], &before["tags"]), (&json!(""), &json!([])), "{kind}");
        let change = json!({ "name": " Bench 2, morning ", "note": "two\nlines", "tags": ["GMP", "gmp", "batch 7"] });
        let label = put(&service, &path, change).await;
        assert_eq!(label["name"], "Bench 2, morning", "{kind}");
        assert_eq!(label["tags"], json!(["GMP", "batch 7"]), "{kind}");
        assert_eq!(label["changed_by"], "test", "{kind}");
        // What a change leaves out stays.
        let label = put(&service, &path, json!({ "note": "" })).await;
        assert_eq!((&label["note"], &label["tags"][0]), (&json!(""), &json!("GMP")), "{kind}");

        let tagged = read(&service, &format!("{list}?tag=gmp")).await;
        let items = tagged["items"].as_array().unwrap();
        assert_eq!(items.len(), 1, "{kind}: {tagged}");
        assert_eq!(
            (&items[0]["id"], &items[0]["label"]["tags"][1]),
            (&json!(id), &json!("batch 7"))
        );
        assert!(ids(&service, &format!("{list}?tag=nothing")).await.is_empty());

        put(&service, &path, json!({ "archived": true })).await;
        assert!(!ids(&service, list).await.contains(&id.to_owned()), "{kind} is hidden");
        assert_eq!(ids(&service, &format!("{list}?archived=only")).await, [id], "{kind}");
        assert!(ids(&service, &format!("{list}?archived=include")).await.contains(&id.to_owned()));
        assert_eq!(service.get(&format!("{list}/{id}")).await.status(), 200, "{kind} is there");
    }
    assert_eq!(ids(&service, "/v1/weighings").await, [other]);
    let renamed = read(&service, "/v1/powders/salt").await;
    assert_eq!(renamed["powder"]["name"], "Bench 2, morning");
    assert_eq!(
        read(&service, "/v1/labels?archived=only").await["items"].as_array().unwrap().len(),
        3
    );
    put(&service, &format!("/v1/labels/weighing/{weighing}"), json!({ "archived": false })).await;
    assert_eq!(ids(&service, "/v1/weighings").await.len(), 2);

    let verified = read(&service, "/v1/audit/verification").await;
    assert_eq!(verified["broken"], Value::Null, "{verified}");
    let of_weighing = read(&service, &format!("/v1/audit?weighing={weighing}")).await;
    let deeds: Vec<&Value> =
        of_weighing["items"].as_array().unwrap().iter().map(|it| &it["body"]["action"]).collect();
    assert_eq!(deeds.iter().filter(|deed| ***deed == json!("label")).count(), 4, "{deeds:?}");
    // A label that somebody changes in the file is found.
    let pool = flip_testing::pool(service.data_dir()).await;
    sqlx::query("UPDATE label SET archived_at = NULL WHERE kind = 'policy'")
        .execute(&pool)
        .await
        .unwrap();
    let broken = read(&service, "/v1/audit/verification").await;
    assert_eq!(broken["others"][0]["what"], "label", "{broken}");
    service.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_label_that_cannot_be_is_refused_by_field_and_changes_nothing() {
    let service = Service::ready().await;
    let path = "/v1/labels/powder/salt";
    for (change, field) in [
        (json!({ "name": "" }), "name"),
        (json!({ "name": "x".repeat(101) }), "name"),
        (json!({ "note": "x".repeat(4001) }), "note"),
        (json!({ "tags": ["a", "b,c"] }), "tags[1]"),
        (json!({ "tags": (0..21).map(|k| k.to_string()).collect::<Vec<_>>() }), "tags"),
        (json!({ "colour": "red" }), "colour"),
    ] {
        let refused = problem(send(&service, "PUT", path, &change).await, 400).await;
        assert_eq!(fields(&refused), [field], "{change}");
    }
    let taken = problem(send(&service, "PUT", path, &json!({ "name": " SAND " })).await, 409).await;
    assert!(taken["detail"].as_str().unwrap().contains("`sand`"), "{taken}");
    problem(send(&service, "PUT", "/v1/labels/powder/none", &json!({ "note": "x" })).await, 404)
        .await;
    problem(service.get("/v1/labels/vial/v1").await, 400).await;
    problem(service.get("/v1/powders?archived=maybe").await, 400).await;
    let anonymous =
        service.request("PUT", path).json(&json!({ "note": "x" })).send().await.unwrap();
    problem(anonymous, 401).await;
    assert!(ids_of_labels(&service).await.is_empty());

    // What moves is on the list.
    let hold = service.hold_bench();
    let response = service
        .weigh(
            "k",
            &json!({ "powder": "salt", "target": { "value": 10, "unit": "mg" },
                "tolerance": { "lower": 1, "upper": 1, "unit": "mg" } }),
        )
        .await;
    let id = response.json::<Value>().await.unwrap()["id"].as_str().unwrap().to_owned();
    service.until_pouring().await;
    let moves =
        send(&service, "PUT", &format!("/v1/labels/weighing/{id}"), &json!({ "archived": true }))
            .await;
    let moves = problem(moves, 409).await;
    assert_eq!(moves["type"], "urn:flip:problem:not-over", "{moves}");
    drop(hold);
    service.stop().await;
}

async fn ids_of_labels(service: &Service) -> Vec<String> {
    ids(service, "/v1/labels?archived=include").await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_list_of_doses_is_named_and_archived_with_its_doses() {
    let service = Service::ready().await;
    let table = "powder;mass (mg)\nsalt;10\nsalt;12\n";
    let request = service
        .request("POST", "/v1/weighings/list")
        .bearer_auth(service.token(Role::Operator).await);
    let body = json!({ "name": "plate 7 / north", "table": table });
    let response = request.header("idempotency-key", "list").json(&body).send().await.unwrap();
    assert_eq!(response.status(), 202, "{}", response.text().await.unwrap());
    loop {
        let list = read(&service, "/v1/weighings?state=done").await;
        if list["total"] == 2 {
            break;
        }
        tokio::time::sleep(std::time::Duration::from_millis(10)).await;
    }
    let single = dose(&service, "single").await;
    let path = "/v1/labels/dose_list/plate%207%20%2F%20north";
    put(&service, path, json!({ "tags": ["north"], "archived": true })).await;
    assert_eq!(ids(&service, "/v1/weighings").await, [single]);
    assert_eq!(ids(&service, "/v1/weighings?archived=only").await.len(), 2);
    assert_eq!(ids(&service, "/v1/weighings?archived=include&tag=North").await.len(), 2);
    // Who asks for the list sees it, and its certificate holds all of it.
    assert_eq!(ids(&service, "/v1/weighings?list=plate%207%20/%20north").await.len(), 2);
    let certificate =
        service.get("/v1/weighings/certificate.html?list=plate%207%20/%20north").await;
    assert_eq!(certificate.status(), 200);
    service.stop().await;
}

#[tokio::test]
async fn powders_are_called_what_people_call_them_and_the_service_makes_the_ids() {
    let service = Service::start().await;
    let mut made = Vec::new();
    for (name, id) in [
        ("3-Nitrotoluene", Some("p_3_nitrotoluene")),
        ("Lactose 200M", Some("lactose_200m")),
        ("Lactose-200M", Some("lactose_200m_2")),
        ("Lactose (200M)", Some("lactose_200m_3")),
        ("α-D-Glucose", Some("alpha_d_glucose")),
        ("ブドウ糖", None),
        ("ぶどう糖", None),
    ] {
        let response = send(&service, "POST", "/v1/powders", &json!({ "name": name })).await;
        assert_eq!(response.status(), 201, "{name}");
        let powder: Value = response.json().await.unwrap();
        assert_eq!(powder["name"], name);
        let got = powder["id"].as_str().unwrap().to_owned();
        assert_eq!(id.unwrap_or(&got), got, "{name}");
        assert!(!made.contains(&got), "{name}: {got}");
        assert_eq!(service.get(&format!("/v1/powders/{got}")).await.status(), 200);
        made.push(got);
    }
    let again = send(&service, "POST", "/v1/powders", &json!({ "name": "lactose  200m" })).await;
    let again = problem(again, 409).await;
    assert!(again["detail"].as_str().unwrap().contains("`lactose_200m`"), "{again}");
    // The same names in the same order make the same ids elsewhere.
    let elsewhere = Service::start().await;
    let mut client = PowdersClient::new(channel(&elsewhere).await);
    let request =
        |name: &str| proto::CreatePowderRequest { name: name.into(), ..Default::default() };
    let katakana =
        client.create_powder(as_operator(&elsewhere, request("ブドウ糖")).await).await.unwrap();
    assert_eq!(katakana.into_inner().id, made[5]);
    elsewhere.stop().await;
    service.stop().await;
}

#[tokio::test]
async fn a_refused_measurement_leaves_no_powder_behind() {
    let service = Service::start().await;
    let before = ids(&service, "/v1/powders").await;
    let body = |angle: f64| json!({ "name": "Talc", "measurement": { "method": "manual", "repose_deg": angle, "sd_deg": 1, "n": 5 } });
    let refused = problem(send(&service, "POST", "/v1/powders", &body(95.0)).await, 400).await;
    assert_eq!(fields(&refused), ["measurement.repose_deg"]);
    assert_eq!(ids(&service, "/v1/powders").await, before);
    assert_eq!(send(&service, "POST", "/v1/powders", &body(45.0)).await.status(), 201);
    let talc = read(&service, "/v1/powders/talc").await;
    assert_eq!(talc["powder"]["flowability"]["repose_deg"], 45.0);
    let verified = read(&service, "/v1/audit/verification").await;
    assert_eq!(verified["broken"], Value::Null, "{verified}");
    service.stop().await;
}

#[tokio::test]
async fn a_corrected_or_withdrawn_measurement_is_shown_with_its_reason_and_never_used_again() {
    let service = Service::start().await;
    let csv =
        "powder,method,repose_deg,repose_sd_deg,n,source\ntalc,manual,52.5,1.5,5,notebook 3\n";
    let import = async || {
        let request = service.request("POST", "/v1/measurements/import?create=true");
        let request = request
            .bearer_auth(service.token(Role::Operator).await)
            .header("content-type", "text/csv");
        request.body(csv).send().await.unwrap().json::<Value>().await.unwrap()
    };
    let wrong = import().await["measurements"][0]["id"].as_str().unwrap().to_owned();
    let aim = async || {
        read(&service, "/v1/powders/talc").await["powder"]["flowability"]["repose_deg"].clone()
    };
    assert_eq!(aim().await, 52.5);

    let path = format!("/v1/powders/talc/measurements/{wrong}");
    let right = json!({ "method": "manual", "repose_deg": 42.5, "sd_deg": 1.5, "n": 5, "source": "notebook 3" });
    let unsaid = json!({ "reason": " ", "corrected": right });
    let refused = send(&service, "POST", &format!("{path}/correct"), &unsaid).await;
    assert_eq!(fields(&problem(refused, 400).await), ["reason"]);
    assert_eq!(aim().await, 52.5, "nothing half done");
    let correction = json!({ "reason": "a 5 for a 4", "corrected": right });
    let response = send(&service, "POST", &format!("{path}/correct"), &correction).await;
    assert_eq!(response.status(), 201);
    let new = response.json::<Value>().await.unwrap()["id"].as_str().unwrap().to_owned();
    assert_eq!(aim().await, 42.5);
    let list = read(&service, "/v1/powders/talc/measurements").await;
    let old = &list["items"][0];
    assert_eq!(
        (
            &old["repose_deg"],
            &old["withdrawn"]["reason"],
            &old["withdrawn"]["replaced_by"],
            &old["withdrawn"]["by"]
        ),
        (&json!(52.5), &json!("a 5 for a 4"), &json!(new), &json!("test"))
    );
    assert_eq!(list["items"][1]["withdrawn"], Value::Null);
    let twice =
        send(&service, "POST", &format!("{path}/withdraw"), &json!({ "reason": "again" })).await;
    assert_eq!(problem(twice, 409).await["type"], "urn:flip:problem:withdrawn");
    let elsewhere = send(
        &service,
        "POST",
        &format!("/v1/powders/salt/measurements/{new}/withdraw"),
        &json!({ "reason": "x" }),
    )
    .await;
    problem(elsewhere, 404).await;

    // Neither a file nor the file it came from brings the old value back.
    let exported = service.get("/v1/powders/talc/measurements.csv").await.text().await.unwrap();
    assert!(exported.contains("42.5") && !exported.contains("52.5"), "{exported}");
    let again = import().await;
    assert_eq!((&again["measurements"], &again["already_stored"]), (&json!([]), &json!(1)));

    let mut client = PowdersClient::new(channel(&service).await);
    let request = |reason: &str| proto::WithdrawRequest {
        powder: "talc".into(),
        id: new.clone(),
        reason: reason.into(),
    };
    let refused =
        client.withdraw_measurement(as_operator(&service, request("")).await).await.unwrap_err();
    assert_eq!(
        (refused.code(), fields(&problem_of(&refused))),
        (Code::InvalidArgument, vec!["reason"])
    );
    let gone =
        client.withdraw_measurement(as_operator(&service, request("spilt")).await).await.unwrap();
    assert_eq!(gone.into_inner().withdrawn.unwrap().reason, "spilt");
    assert_eq!(aim().await, Value::Null, "nothing is left to aim at");

    let observation =
        json!({ "observable": { "kind": "drained_angle" }, "mean": 40, "sd": 1, "n": 3 });
    let response = send(&service, "POST", "/v1/powders/talc/observations", &observation).await;
    let observed = response.json::<Value>().await.unwrap()["id"].as_str().unwrap().to_owned();
    let path = format!("/v1/powders/talc/observations/{observed}/withdraw");
    assert_eq!(
        send(&service, "POST", &path, &json!({ "reason": "wrong tray" })).await.status(),
        200
    );
    assert_eq!(read(&service, "/v1/powders/talc").await["observations"], json!([]));
    let kept = read(&service, "/v1/powders/talc/observations").await;
    assert_eq!(kept["items"][0]["withdrawn"]["reason"], "wrong tray");
    let verified = read(&service, "/v1/audit/verification").await;
    assert_eq!(verified["broken"], Value::Null, "{verified}");
    service.stop().await;
}

#[tokio::test]
async fn labels_are_the_same_over_both_transports() {
    let service = Service::start().await;
    let mut client = LabelsClient::new(channel(&service).await);
    let request = proto::SetLabelRequest {
        kind: proto::LabelKind::Powder.into(),
        id: "salt".into(),
        note: Some("from the second drum".into()),
        tags: Some(proto::Tags { tags: vec!["drum 2".into()] }),
        ..Default::default()
    };
    let label = client.set_label(as_operator(&service, request).await).await.unwrap().into_inner();
    let rest = read(&service, "/v1/labels/powder/salt").await;
    assert_eq!(
        (json!(label.name), json!(label.note), json!(label.tags)),
        (rest["name"].clone(), rest["note"].clone(), rest["tags"].clone())
    );
    assert_eq!(rest["tags"], json!(["drum 2"]));
    let page = proto::PageRequest { tag: Some("drum 2".into()), ..Default::default() };
    let request = proto::ListPowdersRequest { page: Some(page) };
    let listed =
        PowdersClient::new(channel(&service).await).list_powders(Request::new(request)).await;
    let listed = listed.unwrap().into_inner().items;
    assert_eq!(listed.len(), 1);
    assert_eq!(listed[0].label.as_ref().unwrap().note, "from the second drum");
    let unset = proto::GetLabelRequest { kind: 0, id: "salt".into() };
    let refused = client.get_label(Request::new(unset)).await.unwrap_err();
    assert_eq!(fields(&problem_of(&refused)), ["kind"]);
    service.stop().await;
}
