//! The audit trail by kind, person, day and words: the same from REST, gRPC and the files, before
//! and after it was archived. And who stopped a dose.

use crate::grpc::channel;
use crate::harness::{Service, fields, problem};
use crate::record::weighed;
use flip::api::grpc::proto;
use flip::api::grpc::proto::bench_client::BenchClient;
use flip::api::grpc::proto::weighings_client::WeighingsClient;
use flip::app::Role;
use serde_json::{Value, json};

/// Positions of the records that a search finds, read in pages of three, and how many it tells.
async fn found(service: &Service, query: &str) -> (Vec<i64>, usize) {
    let (mut all, mut after) = (Vec::new(), String::new());
    loop {
        let path = format!("/v1/audit?limit=3&{query}{after}");
        let page: Value = service.get(&path).await.json().await.unwrap();
        let total = page["total"].as_u64().unwrap_or_else(|| panic!("{path}: {page}"));
        all.extend(page["items"].as_array().unwrap().iter().map(|it| it["seq"].as_i64().unwrap()));
        match page["next"].as_str() {
            Some(next) => after = format!("&after={next}"),
            None => return (all, total as usize),
        }
    }
}

#[tokio::test]
async fn what_matches_is_what_a_reading_of_the_whole_record_finds_also_in_archives() {
    let service = Service::ready().await;
    let (first, second) = (weighed(&service, "one").await, weighed(&service, "two").await);
    let all: Vec<Value> = service.get("/v1/audit.json").await.json().await.unwrap();
    let is = |it: &Value, field: &str, value: &str| it[field] == value;
    let holds = |it: &Value, text: &str| it.to_string().contains(text);
    type Test<'a> = Box<dyn Fn(&Value) -> bool + 'a>;
    let cases: Vec<(String, Test<'_>)> = vec![
        (String::new(), Box::new(|_| true)),
        ("kind=reading".to_owned(), Box::new(|it| is(it, "kind", "reading"))),
        ("kind=outcome".to_owned(), Box::new(|it| is(it, "kind", "outcome"))),
        (
            format!("weighing={first}&kind=state"),
            Box::new(|it| is(it, "weighing", &first) && is(it, "kind", "state")),
        ),
        ("person=TEST".to_owned(), Box::new(|it| is(&it["body"]["who"], "name", "test"))),
        ("q=dosing".to_owned(), Box::new(|it| holds(it, "dosing"))),
        (
            format!("q={second}%20state"),
            Box::new(|it| is(it, "weighing", &second) && holds(it, "state")),
        ),
        ("until=2020-01-01".to_owned(), Box::new(|_| false)),
        ("since=2020-01-01&kind=intent".to_owned(), Box::new(|it| is(it, "kind", "intent"))),
    ];
    for archived in [false, true] {
        if archived {
            service.app.archive_audit("2999-01-01").await.unwrap();
        }
        for (query, test) in &cases {
            let mut expected: Vec<i64> =
                all.iter().filter(|it| test(it)).map(|it| it["seq"].as_i64().unwrap()).collect();
            let file: Vec<Value> =
                service.get(&format!("/v1/audit.json?{query}")).await.json().await.unwrap();
            let new = |it: &i64| *it <= all.len() as i64;
            let of_file: Vec<i64> =
                file.iter().map(|it| it["seq"].as_i64().unwrap()).filter(new).collect();
            assert_eq!(of_file, expected, "{query}, archived: {archived}");
            expected.reverse();
            let (listed, total) = found(&service, query).await;
            assert_eq!(total, listed.len(), "{query}, archived: {archived}");
            assert_eq!(
                listed.into_iter().filter(new).collect::<Vec<_>>(),
                expected,
                "{query}, archived: {archived}"
            );
            assert!(!expected.is_empty() || query.starts_with("until"), "{query}: finds nothing");
        }
    }
    let csv = service.get("/v1/audit.csv?kind=intent").await.text().await.unwrap();
    assert_eq!(csv.lines().count(), 3, "{csv}");
    service.stop().await;
}

#[tokio::test]
async fn both_transports_search_the_record_alike_and_refuse_by_name() {
    let service = Service::ready().await;
    weighed(&service, "one").await;
    let mut bench = BenchClient::new(channel(&service).await);
    let asked =
        proto::ListAuditRequest { kind: Some("state".into()), person: None, ..Default::default() };
    let answer = bench.list_audit(asked).await.unwrap().into_inner();
    let (rest, total) = found(&service, "kind=state").await;
    let grpc: Vec<i64> = answer.items.iter().map(|it| it.seq).collect();
    assert_eq!((grpc, answer.total as usize), (rest, total));
    assert!(total > 1);
    for (query, field) in [
        ("kind=persons", "kind"),
        ("since=soon", "since"),
        ("since=2026-11-22&until=2026-11-21", "until"),
    ] {
        for path in ["/v1/audit", "/v1/audit.json", "/v1/audit.csv"] {
            let refused = problem(service.get(&format!("{path}?{query}")).await, 400).await;
            assert_eq!(fields(&refused), [field], "{path} {query}");
        }
    }
    let refused = problem(service.get("/v1/audit?kind=persons").await, 400).await;
    assert!(
        refused["errors"][0]["message"].as_str().unwrap().contains("did you mean `person`?"),
        "{refused}"
    );
    let asked = proto::ListAuditRequest { kind: Some("none".into()), ..Default::default() };
    assert!(bench.list_audit(asked).await.unwrap_err().message().contains("kind"));
    service.stop().await;
}

#[tokio::test]
async fn who_stopped_a_dose_stands_with_it_and_on_its_certificate() {
    let service = Service::ready().await;
    let token = service.app.create_token("Ada", Role::Operator).await.unwrap();
    let stop = async |id: &str| {
        let request = service.request("POST", &format!("/v1/weighings/{id}/stop"));
        assert_eq!(request.bearer_auth(&token).send().await.unwrap().status(), 202);
        service.watch(&format!("/v1/weighings/{id}/events"), None).await;
    };
    let hold = service.hold_bench();
    let request = json!({ "powder": "salt", "target": { "value": 15, "unit": "mg" },
        "tolerance": { "lower": 1, "upper": 1, "unit": "mg" } });
    let moving: Value = service.weigh("moving", &request).await.json().await.unwrap();
    service.until_pouring().await;
    let waiting: Value = service.weigh("waiting", &request).await.json().await.unwrap();
    let ids = [waiting["id"].as_str().unwrap(), moving["id"].as_str().unwrap()];
    for id in ids {
        stop(id).await;
    }
    drop(hold);
    let mut weighings = WeighingsClient::new(channel(&service).await);
    for id in ids {
        let path = format!("/v1/weighings/{id}");
        // The record of a stop follows the stop.
        let detail = loop {
            let detail: Value = service.get(&path).await.json().await.unwrap();
            if detail["stopped"].is_object() {
                break detail;
            }
            tokio::task::yield_now().await;
        };
        assert_eq!(detail["stopped"]["by"], "Ada", "{detail}");
        let at = detail["stopped"]["at"].as_str().unwrap();
        let page = service.get(&format!("{path}/certificate.html")).await.text().await.unwrap();
        assert!(page.contains(&format!("Ada (operator), {at}")), "{page}");
        let asked = proto::GetCertificateRequest { id: Some(id.to_owned()), list: None };
        assert_eq!(weighings.get_certificate(asked).await.unwrap().into_inner().html, page);
    }
    service.stop().await;
}
