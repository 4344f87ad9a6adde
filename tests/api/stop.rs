//! The stop, while others occupy what it used to need: seats, readers, descriptors, the write lock.

use crate::grpc::{as_operator, channel, with_token};
use crate::harness::{Service, problem};
use flip::api::grpc::access::{Access, access, methods};
use flip::api::grpc::proto::bench_client::BenchClient;
use flip::api::grpc::proto::weighings_client::WeighingsClient;
use flip::api::grpc::proto::{StopBenchRequest, StopWeighingRequest};
use flip::app::Role;
use futures::StreamExt;
use futures::stream;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Write};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;
use tokio::task::JoinSet;
use tower::ServiceExt;

/// Much longer than a stop takes on a busy machine, much shorter than it took when others could
/// delay it.
const SOON: Duration = Duration::from_secs(5);

type Piece = Result<&'static [u8], std::convert::Infallible>;

/// A body that announces 4096 bytes of a message and sends three; `begun` counts the bodies sent.
fn unfinished(begun: &Arc<AtomicUsize>) -> impl futures::Stream<Item = Piece> + Send + 'static {
    let begun = begun.clone();
    let then_nothing = stream::poll_fn(move |_| {
        begun.fetch_add(1, Ordering::Relaxed);
        std::task::Poll::Pending
    });
    stream::iter([Ok(&b"\0\0\0\x10\0abc"[..])]).chain(then_nothing)
}

/// Sends this method a message that never completes; the task ends when it is answered.
async fn send_unfinished(
    channel: tonic::transport::Channel,
    method: &str,
    begun: Arc<AtomicUsize>,
    answered: Arc<AtomicUsize>,
) {
    let body = axum::body::Body::from_stream(unfinished(&begun));
    let request = axum::http::Request::post(method)
        .header("content-type", "application/grpc")
        .header("te", "trailers");
    let _answer = channel.oneshot(request.body(tonic::body::Body::new(body)).unwrap()).await;
    answered.fetch_add(1, Ordering::Relaxed);
}

/// Requests a stop; returns its status and document.
async fn stop(service: &Service, token: &str) -> (u16, Value) {
    let request = service.request("POST", "/v1/bench/stop").bearer_auth(token).timeout(SOON);
    let response = request.send().await.expect("a stop is answered soon");
    (response.status().as_u16(), response.json().await.unwrap())
}

/// A dose that hangs in its first pour; its id.
async fn pouring(service: &Service) -> String {
    let id = asked_for(service, "held").await;
    service.until_pouring().await;
    id
}

/// Requests a weighing that begins when its turn comes; returns its id.
async fn asked_for(service: &Service, key: &str) -> String {
    let mg = |value: f64| json!({ "value": value, "unit": "mg" });
    let tolerance = json!({ "lower": 1, "upper": 1, "unit": "mg" });
    let body = json!({ "powder": "salt", "target": mg(15.0), "tolerance": tolerance });
    let weighing: Value = service.weigh(key, &body).await.json().await.unwrap();
    weighing["id"].as_str().unwrap().to_owned()
}

/// How a weighing ended, once it has.
async fn outcome(service: &Service, id: &str) -> String {
    service.watch(&format!("/v1/weighings/{id}/events"), None).await;
    service
        .app
        .weighing(id)
        .await
        .unwrap()
        .weighing
        .outcome
        .map(|outcome| json!(outcome).as_str().unwrap().to_owned())
        .unwrap()
}

#[tokio::test]
async fn unfinished_messages_on_three_connections_take_no_stop_away() {
    for method in ["/flip.v1.Weighings/StartWeighing", "/flip.v1.Weighings/ListWeighings"] {
        let service = Service::ready().await;
        let _held = service.hold_bench();
        let id = pouring(&service).await;
        let token = service.token(Role::Operator).await;
        let (begun, answered) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicUsize::new(0)));
        let mut attack = JoinSet::new();
        for _ in 0..3 {
            let channel = channel(&service).await;
            for _ in 0..100 {
                attack.spawn(send_unfinished(
                    channel.clone(),
                    method,
                    begun.clone(),
                    answered.clone(),
                ));
            }
        }
        while begun.load(Ordering::Relaxed) + answered.load(Ordering::Relaxed) < 256 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        assert_eq!(service.get("/healthz").await.status(), 200);
        assert_eq!(stop(&service, &token).await.0, 200, "{method}");
        assert_eq!(outcome(&service, &id).await, "stopped", "{method}");
        let mut bench = BenchClient::new(channel(&service).await);
        bench.stop_bench(as_operator(&service, StopBenchRequest {}).await).await.unwrap();
    }
}

/// Runs `clients` that poll `path` repeatedly while `then` works.
async fn while_polled<T>(
    service: &Service,
    clients: usize,
    path: &'static str,
    then: impl AsyncFnOnce() -> T,
) -> T {
    let (over, answered) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicUsize::new(0)));
    let mut pollers = JoinSet::new();
    for _ in 0..clients {
        let (over, answered, client, url) =
            (over.clone(), answered.clone(), reqwest::Client::new(), service.url(path));
        pollers.spawn(async move {
            while !over.load(Ordering::Relaxed) {
                if let Ok(response) = client.get(&url).send().await {
                    let _text = response.bytes().await;
                }
                answered.fetch_add(1, Ordering::Relaxed);
            }
        });
    }
    while answered.load(Ordering::Relaxed) < clients / 10 {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    let result = then().await;
    over.store(true, Ordering::Relaxed);
    pollers.abort_all();
    result
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn three_hundred_pollers_take_no_stop_away() {
    let service = Service::start().await;
    let token = service.token(Role::Operator).await;
    let stops = async || {
        for _ in 0..10 {
            assert_eq!(stop(&service, &token).await.0, 200);
        }
    };
    while_polled(&service, 300, "/v1/powders", stops).await;
}

/// Rows that make exports long.
async fn fill(service: &Service) {
    let pool = flip_testing::pool(service.folder()).await;
    let many = "WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM n WHERE k < 20000)";
    for insert in [
        "INSERT INTO measurement (id, powder, method, repose_deg, sd_deg, n, source, created_at)
         SELECT 'many-' || k, 'salt', 'manual', 30, 1, 5, '', 0 FROM n",
        "INSERT INTO audit (seq, at, weighing, kind, body, hash)
         SELECT (SELECT coalesce(max(seq), 0) FROM audit) + k, 0, NULL, 'reading', '{\"mass_mg\":1.0}', substr('0000000000000000000000000000000000000000000000000000000000000000' || k, length('0000000000000000000000000000000000000000000000000000000000000000' || k) - 63) FROM n",
    ] {
        sqlx::query(sqlx::AssertSqlSafe(format!("{many} {insert}"))).execute(&pool).await.unwrap();
    }
    pool.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn readers_of_everything_hold_up_neither_a_stop_nor_other_readers() {
    for path in ["/v1/audit.json", "/v1/measurements.csv"] {
        let service = Service::start().await;
        fill(&service).await;
        let token = service.token(Role::Operator).await;
        let asked = async || {
            assert_eq!(stop(&service, &token).await.0, 200, "{path}");
            let request = service.request("GET", "/v1/powders").bearer_auth(&token).timeout(SOON);
            assert_eq!(
                request.send().await.expect("a short answer comes soon").status(),
                200,
                "{path}"
            );
        };
        while_polled(&service, 60, path, asked).await;
    }
}

#[tokio::test]
async fn long_answers_are_whole_and_the_same_as_before() {
    let service = Service::start().await;
    fill(&service).await;
    let records: Vec<Value> = service.get("/v1/audit.json").await.json().await.unwrap();
    assert!(
        records.len() >= 20_000
            && records.windows(2).all(|two| two[0]["seq"].as_i64() < two[1]["seq"].as_i64())
    );
    let lines = service.get("/v1/audit.csv").await.text().await.unwrap();
    assert_eq!(
        (lines.lines().next(), lines.lines().count()),
        (Some("seq,at,weighing,kind,body,hash"), records.len() + 1)
    );
    let measured = service.get("/v1/measurements.csv").await.text().await.unwrap();
    assert_eq!(measured, service.app.measured(None).await.unwrap().csv());
    let of_salt = service.get("/v1/powders/salt/measurements.csv").await.text().await.unwrap();
    assert_eq!(of_salt, service.app.measured(Some("salt")).await.unwrap().csv());
}

#[tokio::test]
async fn a_stop_is_not_kept_waiting_by_its_own_body() {
    let service = Service::ready().await;
    let _held = service.hold_bench();
    let id = pouring(&service).await;
    let token = service.token(Role::Operator).await;
    let begun = Arc::new(AtomicUsize::new(0));
    let request = service.request("POST", "/v1/bench/stop").bearer_auth(&token).timeout(SOON);
    let response =
        request.body(reqwest::Body::wrap_stream(unfinished(&begun))).send().await.unwrap();
    assert_eq!(response.status(), 200);
    assert_eq!(outcome(&service, &id).await, "stopped");
}

#[tokio::test]
async fn a_stop_needs_the_role_and_the_origin_that_it_always_needed() {
    let service = Service::start().await;
    let viewer = service.token(Role::Viewer).await;
    let operator = service.token(Role::Operator).await;
    for path in ["/v1/bench/stop", "/v1/weighings/none/stop"] {
        let post = || service.request("POST", path);
        problem(post().send().await.unwrap(), 401).await;
        problem(post().bearer_auth(&viewer).send().await.unwrap(), 403).await;
        problem(post().bearer_auth("flip_none").send().await.unwrap(), 401).await;
        let foreign = post().bearer_auth(&operator).header("origin", "http://elsewhere.example");
        problem(foreign.send().await.unwrap(), 403).await;
        problem(service.get(path).await, 405).await;
    }
    let missing = service.request("POST", "/v1/weighings/none/stop").bearer_auth(&operator);
    problem(missing.send().await.unwrap(), 404).await;
}

/// The gRPC status of a call whose message never ends.
async fn status_before_the_message(service: &Service, method: &str, token: Option<&str>) -> i32 {
    let begun = Arc::new(AtomicUsize::new(0));
    let request =
        service.request("POST", method).header("content-type", "application/grpc").timeout(SOON);
    let request = token.into_iter().fold(request, |request, token| request.bearer_auth(token));
    let response = request.body(reqwest::Body::wrap_stream(unfinished(&begun))).send().await;
    response.expect(method).headers()["grpc-status"].to_str().unwrap().parse().unwrap()
}

#[tokio::test]
async fn a_grpc_method_asks_for_its_role_before_its_message_has_come() {
    let service = Service::start().await;
    let viewer = service.token(Role::Viewer).await;
    let mut refused = 0;
    for method in methods()
        .filter(|method| matches!(access(method), Some(Access::Least(role)) if role > Role::Viewer))
    {
        assert_eq!(status_before_the_message(&service, method, None).await, 16, "{method}");
        assert_eq!(status_before_the_message(&service, method, Some(&viewer)).await, 7, "{method}");
        refused += 1;
    }
    assert!(refused >= 14, "only {refused} methods");
    for method in ["/flip.v1.Weighings/Nothing", "/flip.v1.Nothing/Nothing"] {
        assert_eq!(status_before_the_message(&service, method, None).await, 12, "{method}");
    }
}

#[tokio::test]
async fn no_grpc_method_is_refused_to_those_it_is_for() {
    let service = Service::start().await;
    let viewer = service.token(Role::Viewer).await;
    for method in methods() {
        let request = service
            .request("POST", method)
            .header("content-type", "application/grpc")
            .bearer_auth(&viewer);
        let answer = request.body(&b"\0\0\0\0\0"[..]).send().await.unwrap();
        let status =
            answer.headers().get("grpc-status").map(|status| status.to_str().unwrap().to_owned());
        let reads = matches!(access(method), Some(Access::Least(Role::Viewer) | Access::LogIn));
        // The role required by the method itself is the same.
        assert_eq!(status.as_deref() != Some("7"), reads, "{method}: {status:?}");
    }
}

#[tokio::test]
async fn streams_beyond_the_cap_are_refused_with_advice_and_holders_keep_theirs() {
    let service = Service::start().await;
    let token = service.token(Role::Operator).await;
    let mut open = Vec::new();
    let refused = loop {
        let response = service.get("/v1/events").await;
        if response.status() != 200 {
            break response;
        }
        open.push(response);
        assert!(open.len() < 1000, "streams are not capped");
    };
    let problem = problem(refused, 503).await;
    assert!(problem["detail"].as_str().unwrap().contains("send a token"), "{problem}");
    let with_token = service.request("GET", "/v1/events").bearer_auth(&token).send().await.unwrap();
    assert_eq!(with_token.status(), 200);
    assert_eq!(stop(&service, &token).await.0, 200);
    drop(open);
    while service.get("/v1/events").await.status() != 200 {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

#[tokio::test]
async fn a_write_lock_that_another_process_holds_delays_no_stop() {
    let service = Service::ready().await;
    let _held = service.hold_bench();
    let id = pouring(&service).await;
    let token = service.token(Role::Operator).await;
    let lock = flip_testing::locked(service.folder()).await;
    let (status, bench) = stop(&service, &token).await;
    assert_eq!(status, 200, "{bench}");
    lock.rollback().await.unwrap();
    assert_eq!(outcome(&service, &id).await, "stopped");
}

#[tokio::test]
async fn a_stop_asks_no_database_who_shows_its_token() {
    let service = Service::ready().await;
    let _held = service.hold_bench();
    let id = pouring(&service).await;
    let token = service.token(Role::Operator).await;
    let pool = flip_testing::pool(service.folder()).await;
    sqlx::query("ALTER TABLE token RENAME TO token_away").execute(&pool).await.unwrap();
    assert_eq!(stop(&service, &token).await.0, 200);
    assert_eq!(outcome(&service, &id).await, "stopped");
    sqlx::query("ALTER TABLE token_away RENAME TO token").execute(&pool).await.unwrap();
}

/// Stops of waiting weighings, each requested repeatedly; returns the statuses.
fn stops_of_waiting(service: &Service, token: &str, ids: &[String], times: usize) -> JoinSet<u16> {
    let mut stops = JoinSet::new();
    for id in ids.iter().cycle().take(times) {
        let request =
            service.request("POST", &format!("/v1/weighings/{id}/stop")).bearer_auth(token);
        stops.spawn(async move { request.send().await.unwrap().status().as_u16() });
    }
    stops
}

#[tokio::test]
async fn two_hundred_stops_of_waiting_weighings_behind_a_write_lock_delay_no_stop_of_what_moves() {
    let service = Service::ready().await;
    let _held = service.hold_bench();
    let moving = pouring(&service).await;
    let mut ids = Vec::new();
    for k in 0..8 {
        ids.push(asked_for(&service, &format!("waits-{k}")).await);
    }
    let token = service.token(Role::Operator).await;
    let lock = flip_testing::locked(service.folder()).await;
    let mut stops = stops_of_waiting(&service, &token, &ids, 200);
    for _ in 0..20 {
        let held: Value = service.get("/v1/bench").await.json().await.unwrap();
        assert!(held["held"].is_null(), "stops of weighings that wait hold nothing: {held}");
    }
    let request = service
        .request("POST", &format!("/v1/weighings/{moving}/stop"))
        .bearer_auth(&token)
        .timeout(SOON);
    assert_eq!(request.send().await.expect("a stop of what moves is answered soon").status(), 202);
    for _ in 0..20 {
        let (status, bench) = stop(&service, &token).await;
        assert_eq!((status, bench["held"].is_object()), (200, true), "{bench}");
    }
    lock.rollback().await.unwrap();
    let mut statuses = Vec::new();
    while let Some(status) = stops.join_next().await {
        statuses.push(status.unwrap());
    }
    assert!(statuses.iter().all(|status| matches!(status, 202 | 200)), "{statuses:?}");
    assert_eq!(statuses.iter().filter(|status| **status == 202).count(), ids.len());
    assert_eq!(outcome(&service, &moving).await, "stopped");
}

#[tokio::test]
async fn stops_of_waiting_weighings_leave_room_for_a_stop_of_the_bench_on_the_same_connection() {
    let service = Service::ready().await;
    let _held = service.hold_bench();
    let moving = pouring(&service).await;
    let id = asked_for(&service, "waits").await;
    let token = service.token(Role::Operator).await;
    let lock = flip_testing::locked(service.folder()).await;
    let channel = channel(&service).await;
    let mut stops = JoinSet::new();
    for _ in 0..200 {
        let (mut client, message) =
            (WeighingsClient::new(channel.clone()), StopWeighingRequest { id: id.clone() });
        let request = with_token(&token, message);
        stops.spawn(async move { client.stop_weighing(request).await });
    }
    // No stream is left before some of them are refused.
    let refused = stops.join_next().await.unwrap().unwrap().unwrap_err();
    assert_eq!(refused.code(), tonic::Code::Unavailable, "{refused}");
    assert!(refused.message().contains("too many stops"), "at once, not in the end: {refused}");
    let request = with_token(&token, StopBenchRequest {});
    let stopped = tokio::time::timeout(SOON, BenchClient::new(channel).stop_bench(request)).await;
    assert!(stopped.expect("a stop is answered soon").unwrap().into_inner().held.is_some());
    lock.rollback().await.unwrap();
    assert_eq!(outcome(&service, &moving).await, "stopped");
}

/// Sends a request on this thread, which does nothing else meanwhile; returns the first line of the
/// answer.
fn ask_blocking(service: &Service, path: &str, token: &str) -> String {
    let mut connection = TcpStream::connect(("127.0.0.1", service.address.port())).unwrap();
    connection.set_read_timeout(Some(SOON)).unwrap();
    write!(
        connection,
        "POST {path} HTTP/1.1\r\nhost: 127.0.0.1\r\nauthorization: Bearer {token}\r\n\r\n"
    )
    .unwrap();
    let mut line = String::new();
    BufReader::new(connection).read_line(&mut line).expect("a stop is answered soon");
    line
}

#[tokio::test]
async fn a_runtime_that_is_stuck_delays_no_stop_of_what_moves() {
    let service = Service::ready().await;
    let _held = service.hold_bench();
    let moving = pouring(&service).await;
    let token = service.token(Role::Operator).await;
    // Everything except stops runs on this test's thread, which waits.
    let stopped = ask_blocking(&service, &format!("/v1/weighings/{moving}/stop"), &token);
    assert!(stopped.starts_with("HTTP/1.1 202"), "{stopped}");
    let stopped = ask_blocking(&service, "/v1/bench/stop", &token);
    assert!(stopped.starts_with("HTTP/1.1 200"), "{stopped}");
    assert_eq!(outcome(&service, &moving).await, "stopped");
}

/// A service in its own process with a low limit on open files; killed when dropped.
struct Confined {
    process: Child,
    url: String,
    token: String,
    log: std::path::PathBuf,
    _folder: tempfile::TempDir,
}

impl Drop for Confined {
    fn drop(&mut self) {
        let _ended = self.process.kill();
        let _status = self.process.wait();
    }
}

impl Confined {
    fn start(files: usize) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let log = folder.path().join("log");
        let command = format!(
            "ulimit -n {files}; exec \"$0\" serve --json --listen 127.0.0.1:0 --data-dir \"$1\""
        );
        let mut process = Command::new("sh")
            .args(["-c", &command, env!("CARGO_BIN_EXE_flip")])
            .arg(folder.path().join("data"))
            .stdout(Stdio::piped())
            .stderr(std::fs::File::create(&log).unwrap())
            .spawn()
            .unwrap();
        let said = serde_json::Deserializer::from_reader(process.stdout.take().unwrap())
            .into_iter::<Value>()
            .next();
        let said = said.expect("the service says where it is").unwrap();
        let text = |key: &str| said[key].as_str().unwrap().to_owned();
        Self { process, url: text("url"), token: text("token"), log, _folder: folder }
    }

    fn address(&self) -> &str {
        self.url.strip_prefix("http://").unwrap()
    }

    async fn stop(&self) -> u16 {
        let request = reqwest::Client::new()
            .post(format!("{}/v1/bench/stop", self.url))
            .bearer_auth(&self.token);
        request.timeout(SOON).send().await.expect("a stop is answered soon").status().as_u16()
    }
}

#[tokio::test]
async fn more_silent_connections_than_descriptors_take_no_stop_away_and_the_log_tells() {
    let service = Confined::start(160);
    let begun: [&[u8]; 3] = [b"", b"PRI * HTTP/2.0\r\n", b"GET / HTTP/1.1\r\nhost: 127.0.0.1\r\n"];
    let silent: Vec<_> = (0..400)
        .map(|k| {
            let mut connection = TcpStream::connect(service.address()).unwrap();
            connection.write_all(begun[k % 3]).unwrap();
            connection
        })
        .collect();
    for _ in 0..5 {
        assert_eq!(service.stop().await, 200);
    }
    let log = std::fs::read_to_string(&service.log).unwrap();
    assert!(log.contains("all connections are taken"), "{log}");
    drop(silent);
}

#[tokio::test]
async fn event_streams_on_all_descriptors_take_no_stop_away() {
    let service = Confined::start(160);
    let watching: Vec<_> = (0..300)
        .map(|_| {
            let mut connection = TcpStream::connect(service.address()).unwrap();
            // Possibly closed already in favour of a later one.
            let _sent = connection.write_all(b"GET /v1/events HTTP/1.1\r\nhost: 127.0.0.1\r\n\r\n");
            connection
        })
        .collect();
    for _ in 0..5 {
        assert_eq!(service.stop().await, 200);
    }
    drop(watching);
}
