//! `flip serve` is killed repeatedly in the middle of its work. Nothing is lost, and nothing is
//! done twice.

use crate::harness::Service;
use serde_json::{Value, json};
use sqlx::sqlite::{SqliteConnectOptions, SqlitePool};
use std::path::Path;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Kills in each half.
const KILLS: u64 = 5;
/// Longest wait for anything.
const PATIENCE: Duration = Duration::from_secs(240);

impl Service {
    async fn post(&self, path: &str, token: &str, body: &Value) -> Value {
        let request = self.client.post(format!("{}{path}", self.url)).bearer_auth(token).json(body);
        let response = request.send().await.unwrap();
        assert!(
            response.status().is_success(),
            "{path}: {} {}",
            response.status(),
            response.text().await.unwrap()
        );
        response.json().await.unwrap()
    }

    async fn items(&self, path: &str) -> Vec<Value> {
        self.get(&format!("{path}?limit=5000")).await["items"].as_array().unwrap().clone()
    }

    /// Requests a weighing; returns its id.
    async fn weigh(&self, token: &str, key: &str, body: &Value) -> String {
        let request =
            self.client.post(format!("{}/v1/weighings", self.url)).bearer_auth(token).json(body);
        let response = request.header("Idempotency-Key", key).send().await.unwrap();
        assert!(
            response.status().is_success(),
            "{} {}",
            response.status(),
            response.text().await.unwrap()
        );
        response.json::<Value>().await.unwrap()["id"].as_str().unwrap().to_owned()
    }

    async fn works_on(&self, job: &str) -> bool {
        let job = self.get(&format!("/v1/jobs/{job}")).await;
        ["queued", "running"].contains(&job["state"].as_str().unwrap())
    }

    /// Waits until the job has ended, and returns it.
    async fn ended(&self, id: &str) -> Value {
        let deadline = Instant::now() + PATIENCE;
        while self.works_on(id).await {
            assert!(Instant::now() < deadline, "job {id} does not end");
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        self.get(&format!("/v1/jobs/{id}")).await
    }
}

/// Kills the service repeatedly while it works on a job: at a different moment each time, and every
/// other time only after this life has saved something. Returns the service that finally lives.
async fn torment(mut service: Service, folder: &Path, job: &str, series: &str) -> Service {
    for kill in 0..KILLS {
        let before = service.items(series).await.len();
        let deadline = Instant::now() + PATIENCE;
        while kill % 2 == 0
            && service.items(series).await.len() == before
            && service.works_on(job).await
        {
            assert!(Instant::now() < deadline, "nothing is saved");
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        let moment = flip_core::domain::seed::derive(2026, &[kill]) % 1200;
        tokio::time::sleep(Duration::from_millis(moment)).await;
        service.kill();
        service = Service::start(folder);
    }
    service
}

fn is_whole(series: &[Value]) -> bool {
    series.iter().enumerate().all(|(k, item)| item["index"] == k)
}

#[tokio::test(flavor = "multi_thread")]
async fn ten_kills_during_a_calibration_and_a_training_lose_nothing_and_repeat_nothing() {
    let folder = TempDir::new().unwrap();
    let service = Service::start(folder.path());
    let token = service.token.clone().expect("the first start prints a token");

    let request = json!({"powder": "sand", "method": "sequential", "sets": 2, "seed": 3});
    let calibration =
        service.post("/v1/calibrations", &token, &request).await["id"].as_str().unwrap().to_owned();
    let trials = format!("/v1/calibrations/{calibration}/trials");
    let service = torment(service, folder.path(), &calibration, &trials).await;
    let job = service.ended(&calibration).await;
    assert_eq!(job["state"], "succeeded", "{job}");
    let found = service.get(&format!("/v1/calibrations/{calibration}")).await["result"].clone();
    let trials = service.items(&trials).await;
    assert_eq!(
        trials.len() as u64,
        found["evaluations"].as_u64().unwrap() + found["verification_runs"].as_u64().unwrap()
    );
    assert!(is_whole(&trials));

    let request = json!({"powders": ["sand"], "episodes": 12, "surrogate_episodes": 0, "seed": 3});
    let training =
        service.post("/v1/trainings", &token, &request).await["id"].as_str().unwrap().to_owned();
    let episodes = format!("/v1/trainings/{training}/episodes");
    let service = torment(service, folder.path(), &training, &episodes).await;
    let job = service.ended(&training).await;
    assert_eq!(job["state"], "succeeded", "{job}");
    let episodes = service.items(&episodes).await;
    assert!(episodes.len() == 12 && is_whole(&episodes));

    let mut policies = service.get("/v1/policies").await["items"].as_array().unwrap().clone();
    policies.retain(|policy| policy["kind"] == "learned");
    assert_eq!(policies.len(), 1, "one training, one policy");
    let sets = service.get("/v1/parameter-sets").await["items"].as_array().unwrap().clone();
    assert_eq!(sets.len(), found["sets"].as_array().unwrap().len());
    assert_eq!(service.get("/v1/jobs").await["items"].as_array().unwrap().len(), 2);

    let service = interrupted_weighing(service, folder.path(), &token).await;
    service.kill();
    check_database(folder.path()).await;
}

/// A weighing in motion when the process ended is never resumed; a waiting one is.
async fn interrupted_weighing(service: Service, folder: &Path, token: &str) -> Service {
    let mg = |value: f64| json!({"value": value, "unit": "mg"});
    let tolerance = json!({"lower": 1.0, "upper": 1.0, "unit": "mg"});
    let body = json!({"powder": "sand", "target": mg(12.0), "tolerance": tolerance});
    let moving = service.weigh(token, "moving", &body).await;
    let waiting = service.weigh(token, "waiting", &body).await;
    let state = async |service: &Service, id: &str| {
        let weighing = service.get(&format!("/v1/weighings/{id}")).await;
        weighing["weighing"]["state"].as_str().unwrap().to_owned()
    };
    let deadline = Instant::now() + PATIENCE;
    while state(&service, &moving).await == "planned" {
        assert!(Instant::now() < deadline, "the bench does not move");
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
    service.kill();
    let service = Service::start(folder);
    assert_eq!(state(&service, &moving).await, "unknown");
    assert_eq!(service.weigh(token, "moving", &body).await, moving, "its key does not pour again");
    while ["planned", "armed", "dosing", "settling"]
        .contains(&state(&service, &waiting).await.as_str())
    {
        assert!(Instant::now() < deadline, "the waiting weighing is not taken up");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    assert_eq!(state(&service, &waiting).await, "done");
    assert_eq!(state(&service, &moving).await, "unknown");
    service
}

/// SQLite's own integrity check of the file left by so many processes.
async fn check_database(folder: &Path) {
    let pool =
        SqlitePool::connect_with(SqliteConnectOptions::new().filename(folder.join("flip.db")))
            .await
            .unwrap();
    let integrity: String =
        sqlx::query_scalar("PRAGMA integrity_check").fetch_one(&pool).await.unwrap();
    assert_eq!(integrity, "ok");
    let broken: Vec<sqlx::sqlite::SqliteRow> =
        sqlx::query("PRAGMA foreign_key_check").fetch_all(&pool).await.unwrap();
    assert!(broken.is_empty());
    let twice =
        "SELECT count(*) FROM event WHERE kind = 'state' AND data ->> '$.state' = 'succeeded'";
    let successes: i64 = sqlx::query_scalar(twice).fetch_one(&pool).await.unwrap();
    assert_eq!(successes, 2, "each job succeeds once");
    pool.close().await;
}

/// Number of stored emulator heaps, as soon as there are more than were known, or all.
async fn more_heaps(folder: &Path, known: i64) -> i64 {
    let options = SqliteConnectOptions::new().filename(folder.join("flip.db")).read_only(true);
    let pool = SqlitePool::connect_with(options).await.unwrap();
    let began = Instant::now();
    loop {
        let heaps: i64 =
            sqlx::query_scalar("SELECT count(*) FROM emulator_run").fetch_one(&pool).await.unwrap();
        if heaps > known || heaps >= 240 {
            pool.close().await;
            return heaps;
        }
        assert!(began.elapsed() < PATIENCE, "{heaps} heaps, and no more come");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn killed_while_it_builds_an_emulator_the_service_goes_on_with_the_heaps_it_has() {
    let folder = TempDir::new().unwrap();
    let mut service = Service::start(folder.path());
    let token = service.token.clone().expect("the first start prints a token");
    // Small heaps are quick; a wide tolerance is met at once.
    let request = json!({
        "repose_deg": 35.0, "particles": 300, "sets": 2, "verify_repeats": 2, "readings": 2, "tolerance_deg": 5.0
    });
    let calibration =
        service.post("/v1/calibrations", &token, &request).await["id"].as_str().unwrap().to_owned();
    let mut known = 0;
    for _ in 0..3 {
        known = more_heaps(folder.path(), known).await;
        service.kill();
        service = Service::start(folder.path());
    }
    let job = service.ended(&calibration).await;
    assert_eq!(job["state"], "succeeded", "{job}");
    let result = service.get(&format!("/v1/calibrations/{calibration}")).await["result"].clone();
    let [runs, built] = ["runs", "built"].map(|key| result["emulator"][key].as_u64().unwrap());
    assert!(runs == 240 && built < runs, "the last life built {built} of {runs} heaps, not all");
    assert_eq!(result["reached"], true, "{result}");
    service.kill();

    let pool = SqlitePool::connect_with(
        SqliteConnectOptions::new().filename(folder.path().join("flip.db")),
    )
    .await
    .unwrap();
    let distinct = "SELECT count(DISTINCT (body ->> '$.seed') || (body ->> '$.parameters')) FROM";
    for (table, rows) in [("emulator_run", 240), ("trial", -1)] {
        let different: i64 = sqlx::query_scalar(sqlx::AssertSqlSafe(format!("{distinct} {table}")))
            .fetch_one(&pool)
            .await
            .unwrap();
        let stored: i64 =
            sqlx::query_scalar(sqlx::AssertSqlSafe(format!("SELECT count(*) FROM {table}")))
                .fetch_one(&pool)
                .await
                .unwrap();
        assert!(
            different == stored && (rows < 0 || stored == rows),
            "{table}: {stored} heaps, {different} different"
        );
    }
    pool.close().await;
}
