//! The OpenAPI document: in step with the page's client, complete, and true.

use crate::harness::Service;
use serde_json::Value;

const COMMITTED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/web/openapi.json");

/// Every operation of the document: method, path and its description.
pub fn operations() -> Vec<(String, String, Value)> {
    let document = serde_json::to_value(flip::api::rest::openapi()).unwrap();
    let paths = document["paths"].as_object().unwrap().clone();
    let of_path = |(path, item): (String, Value)| {
        let item = item.as_object().unwrap().clone();
        item.into_iter()
            .map(move |(method, operation)| (method.to_uppercase(), path.clone(), operation))
    };
    paths.into_iter().flat_map(of_path).collect()
}

#[test]
fn the_committed_document_is_the_one_the_code_makes() {
    let made = serde_json::to_string_pretty(&flip::api::rest::openapi()).unwrap() + "\n";
    if std::env::var_os("UPDATE").is_some() {
        std::fs::write(COMMITTED, &made).unwrap();
    }
    let committed = std::fs::read_to_string(COMMITTED).unwrap_or_default();
    assert!(
        committed == made,
        "web/openapi.json is out of date: UPDATE=1 cargo test --test api document"
    );
}

#[test]
fn the_page_has_the_names_that_the_code_has() {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/web/src/names.json");
    let made = serde_json::to_string_pretty(&flip::app::names::table()).unwrap() + "\n";
    if std::env::var_os("UPDATE").is_some() {
        std::fs::write(file, &made).unwrap();
    }
    let committed = std::fs::read_to_string(file).unwrap_or_default();
    assert!(
        committed == made,
        "web/src/names.json is out of date: UPDATE=1 cargo test --test api document"
    );
}

#[test]
fn every_operation_says_what_it_does_takes_and_answers() {
    let mut ids = Vec::new();
    for (method, path, operation) in operations() {
        let name = format!("{method} {path}");
        assert_eq!(operation["tags"].as_array().map(Vec::len), Some(1), "{name}: one tag");
        assert!(operation["summary"].as_str().is_some_and(|s| s.len() > 5), "{name}: a summary");
        ids.push(operation["operationId"].as_str().unwrap().to_owned());
        let parameters = operation["parameters"].as_array().cloned().unwrap_or_default();
        for placeholder in path.split('{').skip(1).map(|rest| rest.split('}').next().unwrap()) {
            let described =
                parameters.iter().any(|p| p["name"] == placeholder && p["in"] == "path");
            assert!(described, "{name}: path parameter {placeholder}");
        }
        for parameter in &parameters {
            assert!(parameter["description"].is_string(), "{name}: {}", parameter["name"]);
        }
        let responses = operation["responses"].as_object().unwrap();
        assert!(
            responses.keys().any(|status| status.starts_with('2')),
            "{name}: an answer that is not a refusal"
        );
        for (status, response) in responses.iter().filter(|(status, _)| status.as_str() >= "400") {
            let schema = &response["content"]["application/problem+json"]["schema"]["$ref"];
            assert_eq!(schema, "#/components/schemas/Problem", "{name}: {status}");
        }
        assert_eq!(
            method == "GET",
            operation["security"][0] == serde_json::json!({}),
            "{name}: security"
        );
    }
    let count = ids.len();
    ids.sort();
    ids.dedup();
    assert_eq!(ids.len(), count, "operation ids are unique");
}

#[tokio::test]
async fn the_service_hands_out_its_document() {
    let service = Service::start().await;
    let document: Value = service.get("/openapi.json").await.json().await.unwrap();
    assert_eq!(document, serde_json::to_value(flip::api::rest::openapi()).unwrap());
}
