//! Bad input: a 4xx problem that names the field, never a 5xx, and nothing stored.

use crate::harness::{Service, fields, problem};
use flip::app::Role;
use serde_json::{Value, json};

/// A valid body with one thing changed.
fn weighing(change: impl FnOnce(&mut Value)) -> String {
    let mut body = json!({
        "powder": "salt",
        "target": { "value": 15, "unit": "mg" },
        "tolerance": { "lower": 1, "upper": 1, "unit": "mg" },
    });
    change(&mut body);
    body.to_string()
}

struct Case {
    what: &'static str,
    body: String,
    status: u16,
    /// Empty: no single field is at fault.
    field: &'static str,
}

fn cases() -> Vec<Case> {
    let case = |what, field, body| Case { what, body, status: 400, field };
    let raw =
        |number: &str| weighing(|_| ()).replace("\"value\":15", &format!("\"value\":{number}"));
    vec![
        case("NaN", "target.value", raw("NaN")),
        case("an infinite number", "target.value", raw("1e999")),
        case("a negative target", "target.value", raw("-15")),
        case("a target of nothing", "target.value", raw("0")),
        case("a target above what the spoon holds", "target.value", raw("5000")),
        case("a target as text", "target.value", raw("\"15\"")),
        case("a target that is too small to weigh", "target.value", raw("1e-300")),
        case(
            "a wrong unit of the target",
            "target.unit",
            weighing(|b| b["target"]["unit"] = json!("lb")),
        ),
        case(
            "a wrong unit of the tolerance",
            "tolerance.unit",
            weighing(|b| b["tolerance"]["unit"] = json!("ppm")),
        ),
        case(
            "a negative tolerance",
            "tolerance.lower",
            weighing(|b| b["tolerance"]["lower"] = json!(-1)),
        ),
        case("an unknown powder", "powder", weighing(|b| b["powder"] = json!("unobtainium"))),
        case(
            "a powder that is no name",
            "powder",
            weighing(|b| b["powder"] = json!("../etc/passwd")),
        ),
        case(
            "an unknown policy",
            "policy",
            weighing(|b| b["policy"] = json!("p-0000000000000000")),
        ),
        case("an unknown field", "pour", weighing(|b| b["pour"] = json!(true))),
        case(
            "an unknown field within",
            "target.mass",
            weighing(|b| b["target"]["mass"] = json!(1)),
        ),
        case(
            "a missing field",
            "target",
            weighing(|b| drop(b.as_object_mut().unwrap().remove("target"))),
        ),
        case(
            "a missing field within",
            "target.unit",
            weighing(|b| drop(b["target"].as_object_mut().unwrap().remove("unit"))),
        ),
        case("malformed JSON", "", "{\"powder\":".into()),
        case("no JSON at all", "", "powder=salt".into()),
        case("an array", "", "[]".into()),
        case("nothing", "", String::new()),
        case("two documents", "", weighing(|_| ()) + "{}"),
        Case {
            what: "an oversized body",
            body: " ".repeat(1024 * 1024 + 1),
            status: 413,
            field: "",
        },
    ]
}

#[tokio::test]
async fn a_bad_weighing_is_refused_by_field_and_stores_nothing() {
    let service = Service::ready().await;
    let token = service.token(Role::Operator).await;
    for Case { what, body, status, field } in cases() {
        let request = service.request("POST", "/v1/weighings").bearer_auth(&token);
        let request = request
            .header("content-type", "application/json")
            .header("idempotency-key", "k")
            .body(body);
        let problem = problem(request.send().await.unwrap(), status).await;
        let expected: &[&str] = if field.is_empty() { &[] } else { &[field] };
        assert_eq!(fields(&problem), expected, "{what}: {problem}");
    }
    let stored: Value = service.get("/v1/weighings").await.json().await.unwrap();
    assert_eq!(stored["items"], json!([]));
}

#[tokio::test]
async fn a_weighing_needs_a_key_and_json() {
    let service = Service::ready().await;
    let token = service.token(Role::Operator).await;
    let post =
        || service.request("POST", "/v1/weighings").bearer_auth(&token).body(weighing(|_| ()));
    let json = "application/json";
    let keyless = problem(post().header("content-type", json).send().await.unwrap(), 400).await;
    assert_eq!(fields(&keyless), ["Idempotency-Key"]);
    let blank =
        post().header("content-type", json).header("idempotency-key", "a b").send().await.unwrap();
    assert_eq!(fields(&problem(blank, 400).await), ["Idempotency-Key"]);
    let form = post()
        .header("content-type", "application/x-www-form-urlencoded")
        .header("idempotency-key", "k");
    problem(form.send().await.unwrap(), 415).await;
}

#[tokio::test]
async fn bad_queries_are_refused_by_parameter() {
    let service = Service::start().await;
    for (path, field) in [
        ("/v1/powders?limit=0", "limit"),
        ("/v1/powders?limit=201", "limit"),
        ("/v1/powders?limit=-1", "limit"),
        ("/v1/powders?limit=many", "limit"),
        ("/v1/powders?after=nonsense", "after"),
        ("/v1/weighings?after=%00", "after"),
        ("/v1/jobs?state=asleep", "state"),
        ("/v1/jobs?kind=laundry", "kind"),
        ("/v1/policies?page=2", "page"),
        ("/v1/events?after_seq=-1", "after_seq"),
    ] {
        let problem = problem(service.get(path).await, 400).await;
        assert_eq!(fields(&problem), [field], "{path}: {problem}");
    }
    let both = service.request("GET", "/v1/events?after_seq=-1").header("last-event-id", "0");
    assert_eq!(fields(&problem(both.send().await.unwrap(), 400).await), ["after_seq"]);
    let request = service.request("GET", "/v1/events").header("last-event-id", "yesterday");
    assert_eq!(fields(&problem(request.send().await.unwrap(), 400).await), ["Last-Event-ID"]);
}

#[tokio::test]
async fn things_that_do_not_exist_are_not_found() {
    let service = Service::start().await;
    for resource in [
        "powders/none",
        "powders/none/measurements",
        "powders/none/observations",
        "parameter-sets/none",
        "parameter-sets?powder=none",
        "shakes?powder=none",
        "shakes.csv?powder=none",
        "calibrations/none",
        "calibrations/none/trials",
        "calibrations/none/posterior",
        "trainings/none",
        "trainings/none/episodes",
        "policies/none",
        "policies/none/manifest",
        "policies/none/weights",
        "evaluations/none",
        "films/none",
        "films/none/grains",
        "weighings/none",
        "weighings/none/trace",
        "weighings/none/trace.csv",
        "weighings/none/events",
        "jobs/none",
        "jobs/none/events",
        "weighings/%3Cscript%3E",
    ] {
        problem(service.get(&format!("/v1/{resource}")).await, 404).await;
    }
    problem(service.get("/v1/powders/%ff").await, 400).await;
}

#[tokio::test]
async fn bad_powders_and_jobs_are_refused_by_field() {
    let service = Service::start().await;
    let token = service.token(Role::Operator).await;
    for (path, body, field) in [
        ("/v1/powders", json!({ "id": "Flour!", "name": "Flour" }), "id"),
        ("/v1/powders", json!({ "id": "flour", "name": "" }), "name"),
        (
            "/v1/powders/salt/measurements",
            json!({ "method": "guess", "repose_deg": 30, "sd_deg": 1, "n": 5 }),
            "method",
        ),
        (
            "/v1/powders/salt/measurements",
            json!({ "method": "manual", "repose_deg": 95, "sd_deg": 1, "n": 5 }),
            "repose_deg",
        ),
        (
            "/v1/powders/salt/measurements",
            json!({ "method": "manual", "repose_deg": 30, "sd_deg": 1, "n": -5 }),
            "n",
        ),
        ("/v1/calibrations", json!({ "powder": "unobtainium" }), "powder"),
        ("/v1/calibrations", json!({ "powder": "salt", "sets": 0 }), "sets"),
        ("/v1/calibrations", json!({ "powder": "salt", "tolerance_deg": -1 }), "tolerance_deg"),
        ("/v1/trainings", json!({ "episodes": 0 }), "episodes"),
        ("/v1/trainings", json!({ "order": "sideways" }), "order"),
        ("/v1/trainings", json!({ "gradients": "by hand" }), "gradients"),
        ("/v1/films", json!({ "weighing": "none" }), "weighing"),
        ("/v1/evaluations", json!({ "repeats": 0 }), "repeats"),
        ("/v1/evaluations", json!({ "particles": 499 }), "particles"),
        ("/v1/evaluations", json!({ "substep_us": 9 }), "substep_us"),
        ("/v1/evaluations", json!({ "device": "abacus" }), "device"),
        ("/v1/evaluations", json!({ "device": "cuda" }), "device"),
        ("/v1/trainings", json!({ "device": "cuda" }), "device"),
        ("/v1/evaluations", json!({ "extensions": { "wind": 1.0 } }), "extensions.wind"),
    ] {
        let request = service.request("POST", path).bearer_auth(&token).json(&body);
        let problem = problem(request.send().await.unwrap(), 400).await;
        assert_eq!(fields(&problem), [field], "{path} {body}: {problem}");
    }
    let on_card = service.request("POST", "/v1/evaluations").bearer_auth(&token);
    let refused = on_card.json(&json!({ "device": "cuda" })).send().await.unwrap();
    let refused = problem(refused, 400).await.to_string();
    for said in ["no driver in this test", "leaving this field out"] {
        assert!(refused.contains(said), "{refused}");
    }
    let jobs: Value = service.get("/v1/jobs").await.json().await.unwrap();
    assert_eq!(jobs["items"], json!([]));
    let taken = service
        .request("POST", "/v1/powders")
        .bearer_auth(&token)
        .json(&json!({ "id": "salt", "name": "Salt" }));
    let taken = problem(taken.send().await.unwrap(), 409).await;
    assert_eq!(taken["type"], "urn:flip:problem:powder-exists");
}
