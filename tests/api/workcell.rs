//! The MADSci node over its socket; its own client and engine drive it in tests/clients.

use crate::harness::{Service, fields, problem};
use flip::app::Role;
use reqwest::Response;
use serde_json::{Value, json};

struct Node {
    service: Service,
    token: String,
}

impl Node {
    async fn ready() -> Self {
        let service = Service::ready().await;
        let token = service.token(Role::Operator).await;
        Self { service, token }
    }

    async fn post(&self, path: &str, body: Value) -> Response {
        let request = self.service.request("POST", &format!("/madsci{path}"));
        request.basic_auth("workcell", Some(&self.token)).json(&body).send().await.unwrap()
    }

    async fn get(&self, path: &str) -> Value {
        self.service.get(&format!("/madsci{path}")).await.json().await.unwrap()
    }

    async fn created(&self, name: &str, args: Value) -> String {
        let created = self.post(&format!("/action/{name}"), json!({ "args": args })).await;
        assert_eq!(created.status(), 200);
        created.json::<Value>().await.unwrap()["action_id"].as_str().unwrap().to_owned()
    }

    async fn started(&self, name: &str, id: &str) -> Value {
        self.post(&format!("/action/{name}/{id}/start"), Value::Null).await.json().await.unwrap()
    }

    /// The result once the action has ended.
    async fn ended(&self, id: &str) -> Value {
        loop {
            let result = self.get(&format!("/action/{id}/result")).await;
            if !matches!(result["status"].as_str(), Some("running" | "not_started")) {
                return result;
            }
            tokio::time::sleep(std::time::Duration::from_millis(20)).await;
        }
    }
}

fn dose() -> Value {
    json!({ "powder": "salt", "target_mg": 15.0, "tolerance_mg": 1.5, "vial": "A1", "vial_in_place": true })
}

#[tokio::test]
async fn an_action_is_created_started_and_poured_once_however_often_it_is_started() {
    let node = Node::ready().await;
    let hold = node.service.hold_bench();
    let id = node.created("dose_powder", dose()).await;
    assert_eq!(node.get(&format!("/action/{id}/status")).await, "not_started");
    let first = node.started("dose_powder", &id).await;
    assert_eq!(first["status"], "running");
    node.service.until_pouring().await;
    let status = node.get("/status").await;
    assert_eq!((&status["busy"], &status["running_actions"]), (&json!(true), &json!([id])));
    let again = node.started("dose_powder", &id).await;
    assert_eq!(again["json_result"]["id"], first["json_result"]["id"]);
    drop(hold);
    let result = node.ended(&id).await;
    assert_eq!((&result["status"], &result["errors"]), (&json!("succeeded"), &json!([])));
    assert_eq!(result["json_result"]["asked"]["vial"], "A1");
    assert_eq!(node.started("dose_powder", &id).await["status"], "succeeded");
    assert_eq!(node.service.pours(), 1);

    assert_eq!(result["files"], json!(["certificate", "trace"]));
    let zip = node.service.get(&format!("/madsci/action/{id}/download")).await;
    assert_eq!(zip.headers()["content-type"], "application/zip");
    let mut zip =
        zip::ZipArchive::new(std::io::Cursor::new(zip.bytes().await.unwrap().to_vec())).unwrap();
    let mut trace = String::new();
    std::io::Read::read_to_string(&mut zip.by_name("trace.csv").unwrap(), &mut trace).unwrap();
    assert!(trace.starts_with("step,t_s,"));
    assert!(zip.by_name("certificate.html").is_ok());

    let history = node.get("/action").await;
    assert_eq!(history[&id][0]["status"], "succeeded");
    assert_eq!(node.get(&format!("/action?action_id={id}")).await.as_object().unwrap().len(), 1);
    node.service.stop().await;
}

#[tokio::test]
async fn what_an_action_lacks_or_is_refused_is_said() {
    let node = Node::ready().await;
    let mut wrong = dose();
    wrong["target"] = json!(1);
    let refused = node.post("/action/dose_powder", json!({ "args": wrong })).await;
    assert_eq!(fields(&problem(refused, 400).await), ["target"]);
    let refused = node.post("/action/dose_powder", json!({ "args": { "powder": "salt" } })).await;
    assert_eq!(fields(&problem(refused, 400).await), ["target_mg"]);
    let refused = problem(node.post("/action/pour", json!({ "args": {} })).await, 404).await;
    assert!(refused["detail"].as_str().unwrap().contains("dose_powder, measure_repose"));
    let refused =
        node.post("/action/dose_powder", json!({ "args": dose(), "var_args": [1] })).await;
    problem(refused, 400).await;

    let uncalibrated =
        node.created("dose_powder", json!({ "powder": "sand", "target_mg": 15.0 })).await;
    let result = node.started("dose_powder", &uncalibrated).await;
    assert_eq!(result["status"], "failed");
    assert_eq!(result["errors"][0]["error_type"], "calibration-missing");
    assert_eq!(node.get(&format!("/action/{uncalibrated}/result")).await, result, "it stays so");
    let other = node.service.get(&format!("/madsci/action/calibrate/{uncalibrated}/status")).await;
    problem(other, 404).await;

    let clear = json!({ "by": "Ada", "looked": true, "vial_ready": true });
    let id = node.created("clear_latch", clear).await;
    let refused = node.post(&format!("/action/clear_latch/{id}/start"), Value::Null).await;
    problem(refused, 403).await;
    let nobody = node.service.request("POST", "/madsci/action/dose_powder").json(&json!({}));
    problem(nobody.send().await.unwrap(), 401).await;
}

#[tokio::test]
async fn a_safety_stop_holds_the_bench_until_it_is_resumed_and_a_lock_reserves_it() {
    let node = Node::ready().await;
    let _hold = node.service.hold_bench();
    let id = node.created("dose_powder", dose()).await;
    node.started("dose_powder", &id).await;
    node.service.until_pouring().await;
    // As MADSci's client writes it on Python 3.11.
    let stop = node.post("/admin/AdminCommands.SAFETY_STOP", Value::Null).await;
    assert_eq!(stop.json::<Value>().await.unwrap()["success"], true);
    let again: Value = node.post("/admin/safety_stop", Value::Null).await.json().await.unwrap();
    assert_eq!(again["success"], true);
    assert_eq!(node.ended(&id).await["status"], "cancelled");
    assert_eq!(node.get("/status").await["stopped"], true);
    for (command, success) in [
        ("AdminCommands.RESUME", true),
        ("resume", false),
        ("reset", true),
        ("lock", true),
        ("lock", false),
        ("unlock", true),
        ("unlock", false),
        ("pause", false),
        ("shutdown", false),
    ] {
        let path = format!("/admin/{command}");
        let answer: Value = node.post(&path, Value::Null).await.json().await.unwrap();
        assert_eq!(answer["success"], success, "{command}: {answer}");
        assert_eq!(answer["errors"].as_array().unwrap().is_empty(), success, "{command}");
        let locked = node.get("/status").await["locked"].as_bool().unwrap();
        assert_eq!(locked, command == "lock", "{command}");
    }
    problem(node.post("/admin/dance", Value::Null).await, 404).await;
}

#[tokio::test]
async fn the_node_says_who_it_is() {
    let node = Node::ready().await;
    let info = node.get("/info").await;
    assert_eq!(info["node_id"].as_str().unwrap().len(), 26);
    assert_eq!(info["node_id"], node.get("/info").await["node_id"]);
    let actions: Vec<_> = info["actions"].as_object().unwrap().keys().collect();
    assert_eq!(actions, ["calibrate", "clear_latch", "dose_powder", "measure_repose"]);
    assert!(node.get("/state").await["bench"]["waiting"].is_array());
    assert!(!node.get("/log").await.as_object().unwrap().is_empty());
}
