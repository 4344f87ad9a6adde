//! Lists as CSV and as Arrow files: all pages of them, with the rows of the JSON.

use crate::harness::{Service, fields, problem};
use arrow_array::cast::AsArray;
use arrow_array::types::{Float64Type, TimestampMillisecondType};
use arrow_ipc::reader::FileReader;
use flip::app::Role;
use serde_json::{Value, json};
use std::io::Cursor;
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// A service with 205 powders of names that a table must not break on: more than a page.
async fn many() -> (Service, Vec<Value>) {
    let service = Service::start().await;
    let token = service.token(Role::Operator).await;
    for k in 0..205 {
        let name = format!("Powder {k}, \"fine\"");
        let new = json!({ "id": format!("p{k}"), "name": name });
        let made = service.request("POST", "/v1/powders").bearer_auth(&token).json(&new);
        assert_eq!(made.send().await.unwrap().status(), 201);
    }
    let (mut all, mut path) = (Vec::new(), "/v1/powders?limit=200".to_owned());
    loop {
        let page: Value = service.get(&path).await.json().await.unwrap();
        all.extend(page["items"].as_array().unwrap().clone());
        let Some(next) = page["next"].as_str() else { break };
        path = format!("/v1/powders?limit=200&after={next}");
    }
    assert!(all.len() > 204);
    (service, all)
}

#[tokio::test]
async fn a_csv_file_has_every_row_of_every_page() {
    let (service, all) = many().await;
    let table = service.get("/v1/powders?format=csv").await;
    assert_eq!(table.headers()["content-type"], "text/csv; charset=utf-8");
    let named = table.headers()["content-disposition"].to_str().unwrap();
    assert_eq!(named, "attachment; filename=\"powders.csv\"");
    let text = table.text().await.unwrap();
    let mut csv = csv::Reader::from_reader(text.as_bytes());
    let header = csv.headers().unwrap().clone();
    let (id, name) =
        (header.iter().position(|it| it == "id"), header.iter().position(|it| it == "name"));
    let rows: Vec<_> = csv.records().map(|row| row.unwrap()).collect();
    assert_eq!(rows.len(), all.len());
    for (row, item) in rows.iter().zip(&all) {
        assert_eq!(row[id.unwrap()], *item["id"].as_str().unwrap());
        assert_eq!(row[name.unwrap()], *item["name"].as_str().unwrap());
    }
    let accepted = service.request("GET", "/v1/powders").header("accept", "text/csv;q=1, */*");
    assert_eq!(accepted.send().await.unwrap().text().await.unwrap(), text);

    let page = service.get("/v1/powders?format=csv&limit=3").await.text().await.unwrap();
    assert_eq!(csv::Reader::from_reader(page.as_bytes()).records().count(), 3, "that page alone");
    let json = service.get("/v1/powders?format=json&limit=3").await;
    assert_eq!(json.json::<Value>().await.unwrap()["items"].as_array().unwrap().len(), 3);
}

#[tokio::test]
async fn an_arrow_file_has_typed_columns() {
    let service = Service::ready().await;
    let dose = json!({
        "powder": "salt",
        "target": { "value": 15.0, "unit": "mg" },
        "tolerance": { "lower": 1, "upper": 1, "unit": "mg" },
        "asked": { "lot": "L-42" },
    });
    for key in ["first", "second"] {
        let weighing: Value = service.weigh(key, &dose).await.json().await.unwrap();
        let path = format!("/v1/weighings/{}?wait=60", weighing["id"].as_str().unwrap());
        service.get(&path).await.bytes().await.unwrap();
    }
    let list: Value = service.get("/v1/weighings").await.json().await.unwrap();
    let told = &list["items"][1];
    let table = service.get("/v1/weighings?format=arrow").await;
    assert_eq!(table.headers()["content-type"], "application/vnd.apache.arrow.file");
    let bytes = table.bytes().await.unwrap().to_vec();
    let batches: Vec<_> =
        FileReader::try_new(Cursor::new(bytes), None).unwrap().map(Result::unwrap).collect();
    assert_eq!(batches.iter().map(|batch| batch.num_rows()).sum::<usize>(), 2);
    let column = |name: &str| batches[0].column_by_name(name).unwrap();
    let target = column("target_mg").as_primitive::<Float64Type>();
    assert_eq!(target.value(1), 15.0);
    assert_eq!(column("asked.lot").as_string::<i32>().value(1), "L-42");
    assert_eq!(column("outcome").as_string::<i32>().value(1), told["outcome"].as_str().unwrap());
    let at = column("created_at").as_primitive::<TimestampMillisecondType>();
    let said = OffsetDateTime::parse(told["created_at"].as_str().unwrap(), &Rfc3339).unwrap();
    assert_eq!(i128::from(at.value(1)), said.unix_timestamp_nanos() / 1_000_000);
    // Filters and refusals are those of the list.
    let none = service.get("/v1/weighings?format=arrow&outcome=over").await.bytes().await.unwrap();
    let none = FileReader::try_new(Cursor::new(none.to_vec()), None).unwrap();
    assert_eq!(none.map(|batch| batch.unwrap().num_rows()).sum::<usize>(), 0);
    problem(service.get("/v1/weighings?format=csv&outcome=nonsense").await, 400).await;
    let refused = problem(service.get("/v1/weighings?format=xlsx").await, 400).await;
    assert_eq!(fields(&refused), ["format"]);
}
