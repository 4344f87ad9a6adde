//! A weighing from its request to its trace, watched and repeated.

use crate::harness::{Service, Watched, problem};
use flip::app::Role;
use serde_json::{Value, json};
use std::collections::HashSet;

fn request(target_mg: f64) -> Value {
    json!({
        "powder": "salt",
        "target": { "value": target_mg, "unit": "mg" },
        "tolerance": { "lower": 10, "upper": 10, "unit": "%" },
    })
}

#[tokio::test]
async fn a_weighing_is_planned_poured_and_kept_with_its_trace() {
    let service = Service::ready().await;
    let response = service.weigh("first", &request(15.0)).await;
    assert_eq!(response.status(), 202);
    let location = response.headers()["location"].to_str().unwrap().to_owned();
    let planned: Value = response.json().await.unwrap();
    assert_eq!(location, format!("/v1/weighings/{}", planned["id"].as_str().unwrap()));
    assert_eq!(planned["target_mg"], 15.0);
    assert_eq!(planned["tolerance_lower_mg"], 1.5);

    service.watch(&format!("{location}/events"), None).await.unwrap();
    let detail: Value = service.get(&location).await.json().await.unwrap();
    let done = &detail["weighing"];
    assert_eq!((&done["state"], &done["outcome"]), (&json!("done"), &json!("within")), "{done}");
    assert_eq!(service.pours(), 1);

    let ticks = detail["ticks"].as_array().unwrap();
    assert!(ticks.len() >= 2);
    let trace: Value = service.get(&format!("{location}/trace")).await.json().await.unwrap();
    assert_eq!(trace.as_array(), Some(ticks));
    let csv = service.get(&format!("{location}/trace.csv")).await;
    assert!(csv.headers()["content-type"].to_str().unwrap().starts_with("text/csv"));
    assert_eq!(csv.text().await.unwrap().lines().count(), 1 + ticks.len());
}

#[tokio::test]
async fn a_hundred_requests_with_one_key_pour_once() {
    let service = Service::ready().await;
    let body = request(15.0);
    let responses =
        futures::future::join_all((0..100).map(|_| service.weigh("one-key", &body))).await;
    let mut ids = HashSet::new();
    let mut replays = 0;
    for response in responses {
        assert_eq!(response.status(), 202);
        replays += usize::from(response.headers().contains_key("idempotency-replayed"));
        ids.insert(response.json::<Value>().await.unwrap()["id"].as_str().unwrap().to_owned());
    }
    assert_eq!((ids.len(), replays), (1, 99));
    let id = ids.into_iter().next().unwrap();
    service.watch(&format!("/v1/weighings/{id}/events"), None).await.unwrap();
    // A second weighing is queued behind every pour that the first could have caused.
    let second: Value = service.weigh("another-key", &body).await.json().await.unwrap();
    service
        .watch(&format!("/v1/weighings/{}/events", second["id"].as_str().unwrap()), None)
        .await
        .unwrap();
    assert_eq!(service.pours(), 2);
    let list: Value = service.get("/v1/weighings").await.json().await.unwrap();
    assert_eq!(list["items"].as_array().unwrap().len(), 2);
}

#[tokio::test]
async fn a_key_that_comes_back_with_another_request_is_refused() {
    let service = Service::ready().await;
    assert_eq!(service.weigh("key", &request(15.0)).await.status(), 202);
    let refused = problem(service.weigh("key", &request(16.0)).await, 422).await;
    assert_eq!(refused["type"], "urn:flip:problem:idempotency-key-reused");
    assert_eq!(service.weigh("key", &request(15.0)).await.status(), 202);
}

#[tokio::test]
async fn sixty_four_weighings_wait_and_the_next_is_refused() {
    let service = Service::ready().await;
    let hold = service.hold_bench();
    // One moves (or is about to), 64 wait.
    let first: Value = service.weigh("moves", &request(15.0)).await.json().await.unwrap();
    service.until_pouring().await;
    for index in 0..64 {
        assert_eq!(
            service.weigh(&format!("waits-{index}"), &request(15.0)).await.status(),
            202,
            "{index}"
        );
    }
    let refused = problem(service.weigh("too-many", &request(15.0)).await, 409).await;
    assert_eq!(refused["type"], "urn:flip:problem:queue-full");
    let token = service.token(Role::Operator).await;
    let stop = format!("/v1/weighings/{}/stop", first["id"].as_str().unwrap());
    assert_eq!(
        service.request("POST", &stop).bearer_auth(&token).send().await.unwrap().status(),
        202
    );
    drop(hold);
}

#[tokio::test]
async fn events_resume_where_the_watcher_left_off() {
    let service = Service::ready().await;
    let weighing: Value = service.weigh("watched", &request(15.0)).await.json().await.unwrap();
    let path = format!("/v1/weighings/{}/events", weighing["id"].as_str().unwrap());
    let all: Vec<Watched> = service.watch(&path, None).await.unwrap();
    let seqs: Vec<i64> = all.iter().map(|event| event.id).collect();
    assert!(seqs.len() >= 3 && seqs.is_sorted_by(|a, b| a < b), "{seqs:?}");
    assert!(all.iter().any(|event| event.kind == "tick"));
    assert!(all.iter().all(|event| event.data["seq"] == event.id));

    for (seen, id) in seqs.iter().enumerate().take(seqs.len() - 1) {
        let rest: Vec<i64> =
            service.watch(&path, Some(*id)).await.unwrap().iter().map(|event| event.id).collect();
        assert_eq!(rest, seqs[seen + 1..]);
    }
    // 204 tells a browser not to reconnect.
    let last = *seqs.last().unwrap();
    assert!(service.watch(&path, Some(last)).await.is_none());
}

#[tokio::test]
async fn pages_of_weighings_follow_each_other_by_their_links() {
    let service = Service::ready().await;
    let mut made = Vec::new();
    for index in 0..5 {
        let weighing: Value =
            service.weigh(&format!("key-{index}"), &request(15.0)).await.json().await.unwrap();
        made.push(weighing["id"].as_str().unwrap().to_owned());
    }
    let (mut listed, mut path) = (Vec::new(), "/v1/weighings?limit=2".to_owned());
    loop {
        let response = service.get(&path).await;
        let link = response.headers().get("link").map(|link| link.to_str().unwrap().to_owned());
        let page: Value = response.json().await.unwrap();
        let items = page["items"].as_array().unwrap();
        listed.extend(items.iter().map(|item| item["id"].as_str().unwrap().to_owned()));
        assert_eq!(link.is_some(), page["next"].is_string());
        let Some(link) = link else { break };
        path = link.trim_start_matches('<').split('>').next().unwrap().to_owned();
        assert!(path.starts_with("/v1/weighings?limit=2&after="), "{path}");
    }
    made.reverse();
    assert_eq!(listed, made, "newest first, each once");
}
