//! Lists of weighings: what matches, in which order, page by page, against a reading of the whole.

use crate::grpc::channel;
use crate::harness::{Service, fields, problem};
use crate::record::weighed;
use flip::api::grpc::proto;
use flip::api::grpc::proto::weighings_client::WeighingsClient;
use serde_json::Value;

/// Weighings beside the first.
const MORE: usize = 300;

/// A service with many weighings that differ in all that can be asked for.
async fn crowded() -> Service {
    let service = Service::ready().await;
    weighed(&service, "one").await;
    let pool = flip_testing::pool(service.folder()).await;
    // A number of four digits, in SQL that both databases know.
    const ID: &str = "'w' || substr('0000' || n, length('0000' || n) - 3)";
    let sql = format!(
        r#"WITH RECURSIVE k (n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM k WHERE n < {MORE})
         INSERT INTO weighing (id, idempotency_key, request_sha256, powder, target_mg, tolerance_lower_mg, tolerance_upper_mg,
             policy, parameter_set, seed, state, outcome, error_mg, seconds, error, bench, asked, labels, created_at, finished_at)
         SELECT {ID}, {ID}, request_sha256, CASE n % 2 WHEN 0 THEN 'salt' ELSE 'sand' END,
             5 + n % 9, 1, 1, policy, parameter_set, n,
             CASE n % 4 WHEN 3 THEN 'aborted' ELSE 'done' END,
             CASE n % 4 WHEN 0 THEN 'within' WHEN 1 THEN 'over' WHEN 2 THEN 'under' ELSE 'aborted' END,
             CASE n % 4 WHEN 3 THEN NULL ELSE ((n * 37) % 23 - 11) / 10.0 END,
             CASE n % 4 WHEN 3 THEN NULL ELSE n % 50 END,
             CASE n % 4 WHEN 3 THEN 'the arm lost its lease' END,
             CASE n % 3 WHEN 0 THEN 'devices' ELSE 'emulated' END,
             '{{"lot":"L' || (n % 5) || '","vial":"V' || n || '","operator":"' ||
                 CASE n % 3 WHEN 0 THEN 'Ada' WHEN 1 THEN 'Bo_Li' ELSE '100%' END || '"}}',
             CASE n % 4 WHEN 0 THEN '{{"plate.row":"P:' || (n % 7) || '"}}' END,
             1795000000000 + n * 3600000, 1795000000000 + n * 3600000
         FROM k, (SELECT * FROM weighing LIMIT 1) AS first"#
    );
    sqlx::query(sqlx::AssertSqlSafe(sql)).execute(&pool).await.unwrap();
    pool.close().await;
    service
}

/// All weighings that this query finds, read in pages of so many, and their number as told.
async fn found(service: &Service, query: &str, limit: usize) -> (Vec<Value>, usize) {
    let (mut all, mut after) = (Vec::new(), String::new());
    loop {
        let path = format!("/v1/weighings?{query}&limit={limit}{after}");
        let page: Value = service.get(&path).await.json().await.unwrap();
        let total = page["total"].as_u64().unwrap_or_else(|| panic!("{path}: {page}"));
        all.extend(page["items"].as_array().unwrap().iter().cloned());
        match page["next"].as_str() {
            Some(next) => after = format!("&after={next}"),
            None => return (all, total as usize),
        }
    }
}

fn ids(all: &[Value]) -> Vec<&str> {
    all.iter().map(|it| it["id"].as_str().unwrap()).collect()
}

fn text(of: &Value, at: &str) -> Option<String> {
    of.pointer(at).and_then(Value::as_str).map(str::to_owned)
}

/// Whether it was requested between these times.
fn is_between(of: &Value, from: &str, to: &str) -> bool {
    (from..to).contains(&text(of, "/created_at").unwrap().as_str())
}

fn number(of: &Value, field: &str) -> f64 {
    of[field].as_f64().map_or(-1.0, f64::abs)
}

#[tokio::test]
async fn what_matches_is_what_a_reading_of_all_weighings_finds() {
    let service = crowded().await;
    let (all, total) = found(&service, "", 200).await;
    assert_eq!((all.len(), total), (MORE + 1, MORE + 1));
    type Test = Box<dyn Fn(&Value) -> bool>;
    let is = |at: &'static str, value: &'static str| -> Test {
        Box::new(move |it| text(it, at).as_deref() == Some(value))
    };
    let cases: Vec<(&str, Test)> = vec![
        ("powder=salt", is("/powder", "salt")),
        ("lot=L3", is("/asked/lot", "L3")),
        ("vial=V7", is("/asked/vial", "V7")),
        ("operator=100%25", is("/asked/operator", "100%")),
        ("label=plate.row:P:3", is("/labels/plate.row", "P:3")),
        ("bench=devices", is("/bench", "devices")),
        ("outcome=over", is("/outcome", "over")),
        (
            "outside=true",
            Box::new(|it| matches!(text(it, "/outcome").as_deref(), Some("over" | "under"))),
        ),
        ("state=aborted", is("/state", "aborted")),
        ("policy=none", Box::new(|_| false)),
        (
            "lot=L3&outcome=over&powder=sand",
            Box::new(|it| {
                text(it, "/asked/lot").as_deref() == Some("L3")
                    && text(it, "/outcome").as_deref() == Some("over")
            }),
        ),
        (
            "since=2026-11-20&until=2026-11-21",
            Box::new(|it| is_between(it, "2026-11-20", "2026-11-22")),
        ),
        (
            "since=2026-11-20T06:00:00Z&until=2026-11-20T07:30:00%2B01:00",
            Box::new(|it| is_between(it, "2026-11-20T06:00:00", "2026-11-20T06:30:00")),
        ),
        // Words in any order and case; a wildcard of SQL is a character.
        (
            "q=LEASE%20v1",
            Box::new(|it| {
                text(it, "/error").is_some()
                    && text(it, "/asked/vial").is_some_and(|v| v.starts_with("V1"))
            }),
        ),
        ("q=0%25", is("/asked/operator", "100%")),
        ("q=bo_li", is("/asked/operator", "Bo_Li")),
    ];
    for (query, test) in cases {
        let expected: Vec<Value> = all.iter().filter(|it| test(it)).cloned().collect();
        let (got, total) = found(&service, query, 17).await;
        assert_eq!(ids(&got), ids(&expected), "{query}");
        assert_eq!(total, expected.len(), "{query}");
        assert!(total > 0 || query == "policy=none", "{query}: a filter that nothing passes");
    }
    service.stop().await;
}

#[tokio::test]
async fn words_are_looked_for_in_the_names_that_doses_were_given() {
    let service = crowded().await;
    let token = service.token(flip::app::Role::Operator).await;
    let put = service.request("PUT", "/v1/labels/weighing/w0007").bearer_auth(token);
    let put = put.json(&serde_json::json!({ "name": "Reference 100%" })).send().await.unwrap();
    assert!(put.status().is_success(), "{}", put.status());
    for query in ["q=REFERENCE", "q=ence", "q=w0007%20reference"] {
        let (got, total) = found(&service, query, 200).await;
        assert_eq!((ids(&got), total), (vec!["w0007"], 1), "{query}");
    }
    assert_eq!(found(&service, "q=reference%20none", 200).await.1, 0);
    service.stop().await;
}

#[tokio::test]
async fn every_order_is_whole_in_pages_of_any_size_and_the_newest_decides_among_equals() {
    let service = crowded().await;
    let (newest, _) = found(&service, "", 200).await;
    let mut oldest = newest.clone();
    oldest.reverse();
    let by = |field: &'static str| {
        let mut all = newest.clone();
        all.sort_by(|a, b| number(b, field).total_cmp(&number(a, field)));
        all
    };
    let orders = [
        ("newest", newest.clone()),
        ("oldest", oldest),
        ("error", by("error_mg")),
        ("target", by("target_mg")),
        ("seconds", by("seconds")),
    ];
    for (sort, expected) in orders {
        for limit in [7, 200] {
            let (got, _) = found(&service, &format!("sort={sort}"), limit).await;
            assert_eq!(ids(&got), ids(&expected), "{sort}, {limit}");
        }
    }
    service.stop().await;
}

#[tokio::test]
async fn both_transports_find_the_same_and_refuse_the_same() {
    let service = crowded().await;
    let mut weighings = WeighingsClient::new(channel(&service).await);
    let asked = proto::ListWeighingsRequest {
        lot: Some("L2".into()),
        outcome: proto::Outcome::Under.into(),
        sort: proto::WeighingSort::Error.into(),
        ..Default::default()
    };
    let answer = weighings.list_weighings(asked).await.unwrap().into_inner();
    let (rest, total) = found(&service, "lot=L2&outcome=under&sort=error", 200).await;
    let grpc: Vec<&str> = answer.items.iter().map(|it| it.id.as_str()).collect();
    assert_eq!((grpc, answer.total as usize), (ids(&rest), total));
    assert!(total > 3);
    for (query, field) in [
        ("since=tuesday", "since"),
        ("until=2026-11-31", "until"),
        ("since=2026-11-22&until=2026-11-21", "until"),
        ("limit=0", "limit"),
        ("after=nonsense", "after"),
    ] {
        let refused = problem(service.get(&format!("/v1/weighings?{query}")).await, 400).await;
        assert_eq!(fields(&refused), [field], "{query}");
    }
    let long = "x".repeat(201);
    let refused = problem(service.get(&format!("/v1/weighings?q={long}")).await, 400).await;
    assert_eq!(fields(&refused), ["q"]);
    let asked = proto::ListWeighingsRequest { since: Some("soon".into()), ..Default::default() };
    let status = weighings.list_weighings(asked).await.unwrap_err();
    assert!(status.message().contains("since"), "{status}");
    service.stop().await;
}
