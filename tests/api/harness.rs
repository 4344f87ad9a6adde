//! A service of one's own for every test: port 0, a temporary data folder, a toy bench.

use flip::api::{self, ServeConfig};
use flip::app::{App, Options, Role};
use reqwest::{Method, Response};
use serde_json::Value;
use std::net::SocketAddr;
use tempfile::TempDir;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;

/// A running service; dropping it ends it.
pub struct Service {
    pub app: App,
    pub address: SocketAddr,
    client: reqwest::Client,
    stop: Option<oneshot::Sender<()>>,
    ended: JoinHandle<Result<(), api::ServeError>>,
    _data: TempDir,
}

impl Service {
    /// On a loopback address.
    pub async fn start() -> Self {
        Self::start_at(ServeConfig::loopback("127.0.0.1:0".parse().unwrap())).await
    }

    pub async fn start_at(config: ServeConfig) -> Self {
        let data = TempDir::new().unwrap();
        let app = App::open(data.path(), Options::default()).await.unwrap();
        let server = api::bind(app.clone(), config).unwrap();
        let address = server.address().unwrap();
        let (stop, stopped) = oneshot::channel();
        let ended = tokio::spawn(server.run(async {
            let _told_or_dropped = stopped.await;
        }));
        let client = reqwest::Client::new();
        Self { app, address, client, stop: Some(stop), ended, _data: data }
    }

    /// Shuts the service down and waits until it has.
    pub async fn stop(mut self) {
        drop(self.stop.take());
        self.ended.await.unwrap().unwrap();
    }

    pub fn url(&self, path: &str) -> String {
        format!("http://127.0.0.1:{}{path}", self.address.port())
    }

    pub fn request(&self, method: &str, path: &str) -> reqwest::RequestBuilder {
        self.client.request(Method::from_bytes(method.as_bytes()).unwrap(), self.url(path))
    }

    /// As nobody.
    pub async fn get(&self, path: &str) -> Response {
        self.request("GET", path).send().await.unwrap()
    }

    pub async fn token(&self, role: Role) -> String {
        self.app.create_token("test", role).await.unwrap()
    }
}

/// The problem of a refusal, after checking that it is one: status, content type, request id.
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

/// The fields that a problem names.
pub fn fields(problem: &Value) -> Vec<&str> {
    problem["errors"].as_array().unwrap().iter().map(|e| e["field"].as_str().unwrap()).collect()
}
