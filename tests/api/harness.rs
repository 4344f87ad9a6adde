//! A separate service for every test: port 0, a temporary data folder, a toy bench.

use crate::toy::{Bench, Hold};
use flip::api::{self, ServeConfig};
use flip::app::{App, Functions, Oidc, Options, Role, Storage};
use flip_bench::rig::Rig;
use reqwest::{Method, Response};
use serde_json::Value;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tempfile::TempDir;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;

/// Where the data folder's database is, on the database that tests run on.
pub async fn storage(folder: &std::path::Path) -> Storage {
    match flip_testing::database_url(folder).await {
        Some(url) => Storage::on_server(&url, folder).unwrap(),
        None => folder.into(),
    }
}

/// A running service; dropping it ends it.
pub struct Service {
    pub app: App,
    pub address: SocketAddr,
    /// Where it speaks SiLA 2, if it does.
    pub sila: Option<SocketAddr>,
    bench: Bench,
    client: reqwest::Client,
    stop: Option<oneshot::Sender<()>>,
    ended: JoinHandle<Result<(), api::ServeError>>,
    data: TempDir,
}

impl Service {
    /// Starts on a loopback address, with the published powders.
    pub async fn start() -> Self {
        Self::start_at(ServeConfig::loopback("127.0.0.1:0".parse().unwrap())).await
    }

    /// As [`Service::start`], with salt ready to weigh.
    pub async fn ready() -> Self {
        let service = Self::start().await;
        crate::toy::calibrate_salt(service.data.path()).await;
        service
    }

    /// Starts on this bench, with salt ready to weigh.
    pub async fn ready_on(rig: Arc<dyn Rig>) -> Self {
        let config = ServeConfig::loopback("127.0.0.1:0".parse().unwrap());
        let service = Self::start_with(config, Some(rig), None).await;
        crate::toy::calibrate_salt(service.data.path()).await;
        service
    }

    pub async fn start_at(config: ServeConfig) -> Self {
        Self::start_with(config, None, None).await
    }

    /// Starts with a provider of log-ins.
    pub async fn start_beside(oidc: Oidc) -> Self {
        let config = ServeConfig::loopback("127.0.0.1:0".parse().unwrap());
        Self::start_with(config, None, Some(oidc)).await
    }

    async fn start_with(
        config: ServeConfig,
        rig: Option<Arc<dyn Rig>>,
        oidc: Option<Oidc>,
    ) -> Self {
        let data = TempDir::new().unwrap();
        let bench = Bench::default();
        let rig = rig.unwrap_or_else(|| Arc::new(bench.clone()));
        let functions = Functions { rig, ..bench.functions() };
        let options = Options { functions, oidc, ..Options::default() };
        let app = App::open(storage(data.path()).await, options).await.unwrap();
        let server = api::bind(app.clone(), config).unwrap();
        let (address, sila) = (server.address().unwrap(), server.sila_address().unwrap());
        let (stop, stopped) = oneshot::channel();
        let ended = tokio::spawn(server.run(async {
            let _told_or_dropped = stopped.await;
        }));
        flip_testing::speak_tls();
        let client = reqwest::Client::new();
        Self { app, address, sila, bench, client, stop: Some(stop), ended, data }
    }

    /// Shuts the service down and waits until it has.
    pub async fn stop(mut self) {
        drop(self.stop.take());
        self.ended.await.unwrap().unwrap();
    }

    /// The data folder.
    pub fn folder(&self) -> &std::path::Path {
        self.data.path()
    }

    pub fn url(&self, path: &str) -> String {
        format!("http://127.0.0.1:{}{path}", self.address.port())
    }

    pub fn request(&self, method: &str, path: &str) -> reqwest::RequestBuilder {
        self.client.request(Method::from_bytes(method.as_bytes()).unwrap(), self.url(path))
    }

    /// GET without a token.
    pub async fn get(&self, path: &str) -> Response {
        self.request("GET", path).send().await.unwrap()
    }

    /// A new token's secret.
    pub async fn token(&self, role: Role) -> String {
        self.app.create_token("test", role).await.unwrap()
    }

    /// Requests a weighing, as an operator.
    pub async fn weigh(&self, key: &str, body: &Value) -> Response {
        let request =
            self.request("POST", "/v1/weighings").bearer_auth(self.token(Role::Operator).await);
        request.header("idempotency-key", key).json(body).send().await.unwrap()
    }

    /// Follows events until they end; `None` if there is nothing to follow (204).
    pub async fn watch(&self, path: &str, last_event_id: Option<i64>) -> Option<Vec<Watched>> {
        let mut request = self.request("GET", path);
        if let Some(id) = last_event_id {
            request = request.header("last-event-id", id);
        }
        let response = request.send().await.unwrap();
        if response.status() == 204 {
            return None;
        }
        assert_eq!(response.headers()["content-type"], "text/event-stream");
        Some(frames(&response.text().await.unwrap()))
    }

    /// Where the database is.
    pub fn data_dir(&self) -> &std::path::Path {
        self.data.path()
    }

    /// Pours that the bench has begun.
    pub fn pours(&self) -> usize {
        self.bench.pours()
    }

    /// Blocks every pour until the hold is dropped or the weighing is stopped.
    pub fn hold_bench(&self) -> Hold {
        self.bench.hold()
    }

    /// Waits until a pour has begun.
    pub fn hold_bench_at_half(&self) -> Hold {
        self.bench.hold_at_half()
    }

    pub async fn until_pouring(&self) {
        while self.pours() == 0 {
            tokio::time::sleep(Duration::from_millis(2)).await;
        }
    }
}

/// The problem of a refusal, after checking its status, content type and request id.
pub async fn problem(response: Response, status: u16) -> Value {
    let id = response.headers()["x-request-id"].to_str().unwrap().to_owned();
    let kind = response.headers().get("content-type").map(|k| k.to_str().unwrap().to_owned());
    let actual = response.status().as_u16();
    let text = response.text().await.unwrap();
    assert_eq!(actual, status, "{text}");
    assert_eq!(kind.as_deref(), Some("application/problem+json"), "{text}");
    let problem: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(problem["status"], status);
    assert_eq!(problem["instance"], format!("urn:uuid:{id}"));
    assert!(problem["type"].as_str().unwrap().starts_with("urn:flip:problem:"));
    problem
}

/// The fields a problem names.
pub fn fields(problem: &Value) -> Vec<&str> {
    problem["errors"].as_array().unwrap().iter().map(|e| e["field"].as_str().unwrap()).collect()
}

/// One server-sent event.
pub struct Watched {
    pub id: i64,
    pub kind: String,
    pub data: Value,
}

/// The events of a stream that has ended. Every frame must hold one line each of `id`, `event` and
/// `data`.
fn frames(text: &str) -> Vec<Watched> {
    let frame = |frame: &str| {
        let field = |name: &str| {
            let line = frame.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(':'));
            line.unwrap_or_else(|| panic!("no {name} in {frame}")).trim().to_owned()
        };
        Watched {
            id: field("id").parse().unwrap(),
            kind: field("event"),
            data: serde_json::from_str(&field("data")).unwrap(),
        }
    };
    text.split("\n\n")
        .filter(|text| !text.is_empty() && !text.starts_with(':'))
        .map(frame)
        .collect()
}
