//! The service that is killed and restarted, and its database.

use crate::laboratory::{Laboratory, Process, started};
use crate::{TARGET_MG, TOLERANCE_MG};
use flip_core::domain::bench::Action;
use flip_testing::Cluster;
use flip_testing::cable::Cable;
use serde::Deserialize;
use serde_json::{Value, json};
use std::path::Path;
use std::time::{Duration, Instant};

/// Longest wait for anything.
const PATIENCE: Duration = Duration::from_secs(120);

/// A server of PostgreSQL of one laboratory, and the cable to it.
pub struct Database {
    pub cluster: Cluster,
    pub cable: Cable,
    pub url: String,
}

impl Database {
    /// None on SQLite.
    pub async fn start(folder: &Path) -> Option<Self> {
        if !flip_testing::on_postgres() {
            return None;
        }
        let cluster = Cluster::start(false).unwrap_or_else(|why| panic!("{why}"));
        let cable = cluster.cable();
        let url = cable.address(&cluster.database_of(folder).await);
        Some(Self { cluster, cable, url })
    }
}

/// The service, which is killed and restarted.
pub struct Service {
    process: Process,
    url: String,
    client: reqwest::Client,
    token: String,
}

impl Service {
    pub fn start(
        folder: &Path,
        laboratory: &Laboratory,
        database: Option<&Database>,
        token: Option<String>,
    ) -> Self {
        let data = folder.join("data");
        let bench = laboratory.bench.to_str().unwrap();
        let serve = [
            "serve",
            "--listen",
            "127.0.0.1:0",
            "--bench",
            bench,
            "--data-dir",
            data.to_str().unwrap(),
        ];
        let database = database.iter().flat_map(|it| ["--database-url", &it.url]);
        let serve: Vec<&str> = serve.into_iter().chain(database).collect();
        let (process, said) = started(&serve);
        let url = said["url"].as_str().unwrap().to_owned();
        let token = token.or_else(|| said["token"].as_str().map(str::to_owned)).expect("a token");
        flip_testing::speak_tls();
        let client = reqwest::Client::builder().timeout(PATIENCE).build().unwrap();
        Self { process, url, client, token }
    }

    /// SIGKILL: no destructor, no final output.
    pub fn kill(mut self) -> String {
        self.process.0.kill().unwrap();
        self.process.0.wait().unwrap();
        self.token
    }

    /// Asks until there is an answer: a crashed database is there again in a moment.
    pub async fn get(&self, path: &str) -> Value {
        let deadline = Instant::now() + PATIENCE;
        loop {
            let answer = self.client.get(format!("{}{path}", self.url)).send().await.unwrap();
            if answer.status().is_success() {
                return answer.json().await.unwrap();
            }
            let status = answer.status();
            assert!(Instant::now() < deadline, "{path}: {status} {}", answer.text().await.unwrap());
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    async fn post(&self, path: &str, key: Option<&str>, body: &Value) -> (u16, Value) {
        let request =
            self.client.post(format!("{}{path}", self.url)).bearer_auth(&self.token).json(body);
        let request =
            key.into_iter().fold(request, |request, key| request.header("Idempotency-Key", key));
        let response = request.send().await.unwrap();
        (response.status().as_u16(), response.json().await.unwrap())
    }

    pub async fn weigh(&self, key: &str) -> (u16, Value) {
        let mg = |value: f64| json!({"value": value, "unit": "mg"});
        let tolerance = json!({"lower": TOLERANCE_MG, "upper": TOLERANCE_MG, "unit": "mg"});
        self.post(
            "/v1/weighings",
            Some(key),
            &json!({"powder": "sand", "target": mg(TARGET_MG), "tolerance": tolerance, "vial_check": "skip"}),
        )
        .await
    }

    pub async fn state(&self, id: &str) -> String {
        self.get(&format!("/v1/weighings/{id}")).await["weighing"]["state"]
            .as_str()
            .unwrap()
            .to_owned()
    }

    pub async fn has_ended(&self, id: &str) -> bool {
        ["done", "aborted", "unknown"].contains(&self.state(id).await.as_str())
    }

    /// The shakes the guard let through, according to the audit trail, mm.
    pub async fn decided_mm(&self, id: &str) -> Vec<f64> {
        let records = self.get(&format!("/v1/audit.json?weighing={id}")).await;
        let decisions =
            records.as_array().unwrap().iter().filter(|record| record["kind"] == "decision");
        let allowed = decisions.filter_map(|record| {
            Option::<Action>::deserialize(&record["body"]["allowed"]).unwrap()
        });
        allowed
            .map(|action| action.executed_shake_mm())
            .filter(|shake_mm| *shake_mm > 0.0)
            .collect()
    }

    pub async fn clear(&self) {
        let said =
            json!({"by": "the test", "note": "vial looked at", "looked": true, "vial_ready": true});
        let (status, body) = self.post("/v1/bench/clear", None, &said).await;
        assert_eq!(status, 200, "{body}");
    }

    pub async fn wait_for(&self, what: &str, id: &str, states: &[&str]) -> String {
        let deadline = Instant::now() + PATIENCE;
        loop {
            let state = self.state(id).await;
            if states.contains(&state.as_str()) {
                return state;
            }
            assert!(Instant::now() < deadline, "{what}: {state}");
            tokio::time::sleep(Duration::from_millis(3)).await;
        }
    }
}

/// A powder with sets, from small heaps.
pub async fn calibrate(service: &Service) {
    let heaps = json!({"powder": "sand", "method": "sequential", "sets": 2, "seed": 3, "tolerance_deg": 5, "trials_max": 60, "particles": 400});
    let (_, job) = service.post("/v1/calibrations", None, &heaps).await;
    let (id, deadline) = (job["id"].as_str().unwrap().to_owned(), Instant::now() + PATIENCE);
    while service.get(&format!("/v1/jobs/{id}")).await["state"] != "succeeded" {
        assert!(Instant::now() < deadline, "the calibration does not end");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}
