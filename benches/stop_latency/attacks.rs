//! Load from other clients while the service is stopped. None of them has a token.

use crate::Service;
use axum::body::Body;
use futures::StreamExt;
use futures::stream;
use rustix::process::{Resource, Rlimit, getrlimit, setpriority_process, setrlimit};
use sqlx::sqlite::{SqliteConnectOptions, SqlitePool};
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::runtime::Runtime;
use tower::ServiceExt;

/// One kind of attack.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Attack {
    /// 300 gRPC messages on three connections that never complete.
    Messages,
    /// 1200 connections that send nothing, half a preface of HTTP/2 or half a head.
    Silent,
    /// 60 clients that request everything ever measured or recorded, half of which read slowly.
    Readers,
    /// 300 clients that poll repeatedly.
    Pollers,
    /// 300 streams of events.
    Streams,
    /// Another process that holds the database's write lock half of the time.
    Lock,
}

const NAMES: [(Attack, &str); 6] = [
    (Attack::Messages, "messages"),
    (Attack::Silent, "silent"),
    (Attack::Readers, "readers"),
    (Attack::Pollers, "pollers"),
    (Attack::Streams, "streams"),
    (Attack::Lock, "lock"),
];

impl Attack {
    /// Every attack.
    pub const ALL: [Self; 6] =
        [Self::Messages, Self::Silent, Self::Readers, Self::Pollers, Self::Streams, Self::Lock];

    /// The attack of this name; `all` and `none` are names too.
    pub fn named(name: &str) -> anyhow::Result<Vec<Self>> {
        match name {
            "all" => return Ok(Self::ALL.to_vec()),
            "none" => return Ok(Vec::new()),
            _ => {}
        }
        let found = NAMES.iter().find(|(_, known)| *known == name).map(|(attack, _)| vec![*attack]);
        found.ok_or_else(|| anyhow::anyhow!("there is no attack `{name}`"))
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        NAMES.iter().find(|(attack, _)| *attack == self).map_or("", |(_, name)| name)
    }
}

/// A client of many connections needs as many descriptors.
pub fn raise_the_limit_of_files() -> anyhow::Result<()> {
    let Rlimit { maximum, .. } = getrlimit(Resource::Nofile);
    Ok(setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum })?)
}

/// Threads for work that would run on other machines: here they share the cores, at low priority so
/// that the service is what is measured.
pub fn elsewhere() -> std::io::Result<Runtime> {
    let mut builder = tokio::runtime::Builder::new_multi_thread();
    builder.on_thread_start(|| assert!(setpriority_process(None, 15).is_ok()));
    builder.worker_threads(2).enable_all().build()
}

/// Starts the attacks on threads of their own, which end when the returned value is dropped.
pub async fn begin(attacks: &[Attack], service: &Arc<Service>) -> anyhow::Result<Runtime> {
    let runtime = elsewhere()?;
    if attacks.contains(&Attack::Readers) {
        fill(service).await?;
    }
    for attack in attacks {
        match attack {
            Attack::Messages => {
                (0..3).for_each(|_| drop(runtime.spawn(messages(service.url.clone()))))
            }
            Attack::Silent => {
                (0..1200).for_each(|k| drop(runtime.spawn(silent(service.url.clone(), k))))
            }
            Attack::Readers => {
                (0..60).for_each(|k| drop(runtime.spawn(read(service.url.clone(), k))))
            }
            Attack::Pollers => {
                (0..300).for_each(|_| drop(runtime.spawn(poll(service.url.clone()))))
            }
            Attack::Streams => {
                (0..300).for_each(|_| drop(runtime.spawn(follow(service.url.clone()))))
            }
            Attack::Lock => drop(runtime.spawn(lock(database(service).await?))),
        }
    }
    Ok(runtime)
}

async fn messages(url: String) {
    let Ok(endpoint) = tonic::transport::Channel::from_shared(url) else { return };
    let channel = endpoint.connect_lazy();
    let endless = (0..100).map(|k| {
        let channel = channel.clone();
        async move {
            let method =
                ["/flip.v1.Weighings/StartWeighing", "/flip.v1.Weighings/ListWeighings"][k % 2];
            loop {
                let sent =
                    stream::iter([Ok::<_, std::convert::Infallible>(&b"\0\0\0\x10\0abc"[..])]);
                let body = tonic::body::Body::new(Body::from_stream(sent.chain(stream::pending())));
                let request =
                    axum::http::Request::post(method).header("content-type", "application/grpc");
                if let Ok(request) = request.header("te", "trailers").body(body) {
                    let _answer = channel.clone().oneshot(request).await;
                }
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        }
    });
    futures::future::join_all(endless).await;
}

async fn silent(url: String, k: usize) {
    let begun: [&[u8]; 3] = [b"", b"PRI * HTTP/2.0\r\n", b"GET / HTTP/1.1\r\nhost: 127.0.0.1\r\n"];
    loop {
        if let Ok(mut connection) = TcpStream::connect(url.trim_start_matches("http://")).await {
            let _sent = connection.write_all(begun[k % 3]).await;
            // Until the peer closes it.
            let _closed = connection.read(&mut [0; 64]).await;
        }
        tokio::time::sleep(Duration::from_millis(500)).await;
    }
}

async fn read(url: String, k: usize) {
    let path = ["/v1/audit.json", "/v1/measurements.csv"][k % 2];
    let client = reqwest::Client::new();
    loop {
        if let Ok(mut response) = client.get(format!("{url}{path}")).send().await {
            while let Ok(Some(_)) = response.chunk().await {
                if k % 4 < 2 {
                    tokio::time::sleep(Duration::from_millis(100)).await;
                }
            }
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

async fn poll(url: String) {
    let client = reqwest::Client::new();
    loop {
        if let Ok(response) = client.get(format!("{url}/v1/powders")).send().await {
            let _text = response.bytes().await;
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

async fn follow(url: String) {
    let client = reqwest::Client::new();
    loop {
        if let Ok(mut response) = client.get(format!("{url}/v1/events")).send().await {
            while let Ok(Some(_)) = response.chunk().await {}
        }
        tokio::time::sleep(Duration::from_millis(500)).await;
    }
}

async fn lock(database: SqlitePool) {
    loop {
        if let Ok(held) = database.begin_with("BEGIN IMMEDIATE").await {
            tokio::time::sleep(Duration::from_millis(300)).await;
            let _freed = held.rollback().await;
        }
        tokio::time::sleep(Duration::from_millis(300)).await;
    }
}

async fn database(service: &Service) -> anyhow::Result<SqlitePool> {
    let file = SqliteConnectOptions::new().filename(service.data.join("flip.db"));
    Ok(SqlitePool::connect_with(file.busy_timeout(Duration::from_secs(5))).await?)
}

/// Measurements of a powder that nobody weighs, so that the export of all of them is long.
async fn fill(service: &Service) -> anyhow::Result<()> {
    let database = database(service).await?;
    sqlx::query(
        "WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM n WHERE k < 20000)
         INSERT INTO measurement (id, powder, method, repose_deg, sd_deg, n, source, created_at)
         SELECT 'many-' || k, 'salt', 'manual', 30, 1, 5, '', 0 FROM n",
    )
    .execute(&database)
    .await?;
    Ok(())
}
