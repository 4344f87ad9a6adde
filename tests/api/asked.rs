//! Requests begun before a stop and completed after it: the head of a request counts, however late
//! the rest arrives.

use crate::harness::Service;
use base64::Engine;
use base64::engine::general_purpose::STANDARD_NO_PAD;
use flip::api::grpc::proto;
use flip::app::Role;
use flip_bench::emulate::arm::{Flow, FormulaSpoon};
use flip_bench::emulate::lab::{self, Laboratory};
use flip_bench::hardware::clock::Clock;
use flip_bench::rig::Devices;
use flip_core::domain::weighing::WeighingState;
use prost::Message;
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::TcpStream;

/// A request: path, content type and body.
type Asking = (String, &'static str, Vec<u8>);

fn rest(path: &str, body: &Value) -> Asking {
    (path.to_owned(), "application/json", body.to_string().into_bytes())
}

fn grpc(method: &str, message: &impl Message) -> Asking {
    let content = message.encode_to_vec();
    let length = u32::try_from(content.len()).unwrap().to_be_bytes();
    (format!("/flip.v1.{method}"), "application/grpc", [&[0], &length[..], &content].concat())
}

/// A request whose last two bytes are held back.
struct HeldBack {
    connection: BufReader<TcpStream>,
    last: Vec<u8>,
}

impl HeldBack {
    /// The service has its head and waits for its body.
    async fn send(service: &Service, token: &str, (path, kind, body): &Asking) -> Self {
        let mut connection = BufReader::new(TcpStream::connect(service.address).await.unwrap());
        let head = format!(
            "POST {path} HTTP/1.1\r\nhost: 127.0.0.1\r\nauthorization: Bearer {token}\r\ncontent-type: {kind}\r\n\
             content-length: {}\r\nexpect: 100-continue\r\nconnection: close\r\n\r\n",
            body.len()
        );
        connection.write_all(head.as_bytes()).await.unwrap();
        let mut asked_for = String::new();
        while !asked_for.ends_with("\r\n\r\n") {
            assert_ne!(
                connection.read_line(&mut asked_for).await.unwrap(),
                0,
                "{path}: {asked_for}"
            );
        }
        assert!(asked_for.starts_with("HTTP/1.1 100"), "{path}: {asked_for}");
        let (first, last) = body.split_at(body.len() - 2);
        connection.write_all(first).await.unwrap();
        Self { connection, last: last.to_vec() }
    }

    /// Sends the rest; returns the kind of problem, if the answer is one.
    async fn end(mut self) -> Option<String> {
        self.connection.write_all(&self.last).await.unwrap();
        let mut answer = Vec::new();
        self.connection.read_to_end(&mut answer).await.unwrap();
        problem_kind(&String::from_utf8_lossy(&answer))
    }
}

/// The kind of a problem, as formatted by REST and gRPC.
fn problem_kind(answer: &str) -> Option<String> {
    let (head, body) = answer.split_once("\r\n\r\n").expect(answer);
    let carried = head.lines().find_map(|line| line.strip_prefix("flip-problem-bin: "));
    let problem: Value = match carried {
        Some(base64) => {
            serde_json::from_slice(&STANDARD_NO_PAD.decode(base64.trim_end_matches('=')).unwrap())
                .unwrap()
        }
        None if head.starts_with("HTTP/1.1 200") => return None,
        None => serde_json::from_str(body).expect(answer),
    };
    Some(problem["type"].as_str().unwrap().to_owned())
}

fn voided() -> Option<String> {
    Some("urn:flip:problem:stopped-meanwhile".to_owned())
}

async fn is_held(service: &Service) -> bool {
    service.app.bench().await.unwrap().held.is_some()
}

#[tokio::test]
async fn a_resume_or_a_clear_whose_body_comes_after_a_stop_does_not_undo_it() {
    let service = Service::start().await;
    let token = service.token(Role::Admin).await;
    let by = || "Ada".to_owned();
    let resume = proto::ResumeBenchRequest { by: by(), ..Default::default() };
    let clear = proto::ClearBenchRequest {
        by: by(),
        looked: true,
        vial_ready: true,
        resume: true,
        ..Default::default()
    };
    let cleared = json!({ "by": "Ada", "looked": true, "vial_ready": true, "resume": true });
    let resumes =
        [rest("/v1/bench/resume", &json!({ "by": "Ada" })), grpc("Bench/ResumeBench", &resume)];
    let clears = [rest("/v1/bench/clear", &cleared), grpc("Bench/ClearBench", &clear)];
    for asking in resumes.iter().chain(&clears) {
        service.app.stop_bench().await.unwrap();
        let held_back = HeldBack::send(&service, &token, asking).await;
        service.app.stop_bench().await.unwrap();
        assert_eq!(held_back.end().await, voided(), "{}", asking.0);
        assert!(is_held(&service).await, "{}", asking.0);
    }
    // It is the stop that invalidates them, not the wait.
    for asking in &resumes {
        service.app.stop_bench().await.unwrap();
        let held_back = HeldBack::send(&service, &token, asking).await;
        assert_eq!(held_back.end().await, None, "{}", asking.0);
        assert!(!is_held(&service).await, "{}", asking.0);
    }
}

#[tokio::test]
async fn a_vial_that_is_said_to_be_in_by_a_body_that_comes_after_a_stop_is_not_poured_into() {
    let spoon = Box::new(FormulaSpoon::new(Flow::default(), 1));
    let laboratory = Laboratory::start(lab::Settings::default(), Clock::fast(20.0), spoon).unwrap();
    let service = Service::ready_on(Arc::new(Devices::new(laboratory.file()))).await;
    let token = service.token(Role::Operator).await;
    let tolerance = json!({ "lower": 10, "upper": 10, "unit": "%" });
    let body = json!({ "powder": "salt", "target": { "value": 15.0, "unit": "mg" }, "tolerance": tolerance });
    let weighing: Value = service.weigh("waits", &body).await.json().await.unwrap();
    let id = weighing["id"].as_str().unwrap().to_owned();
    let state = async || service.app.weighing(&id).await.unwrap().weighing.state;
    while state().await != WeighingState::AwaitingVial {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    let message = proto::VialReadyRequest { id: id.clone(), ..Default::default() };
    let path = format!("/v1/weighings/{id}/vial-ready");
    for asking in [rest(&path, &json!({ "by": "Ada" })), grpc("Weighings/VialReady", &message)] {
        let held_back = HeldBack::send(&service, &token, &asking).await;
        service.app.stop_bench().await.unwrap();
        assert_eq!(held_back.end().await, voided(), "{}", asking.0);
        assert!(is_held(&service).await, "{}", asking.0);
    }
    assert_eq!((state().await, laboratory.dispensed_mg()), (WeighingState::AwaitingVial, 0.0));
    service.stop().await;
}
