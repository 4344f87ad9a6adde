//! Common to every address: problems, methods, headers, probes, the page.

use crate::harness::{Service, problem};
use flip::api::{self, ServeConfig, ServeError};
use tokio::io::{AsyncBufReadExt, AsyncWriteExt};

#[tokio::test]
async fn unknown_paths_and_wrong_methods_are_problems() {
    let service = Service::start().await;
    problem(service.get("/v1/nothing").await, 404).await;
    problem(service.request("DELETE", "/nothing").send().await.unwrap(), 404).await;
    let response = service.request("DELETE", "/v1/parameters").send().await.unwrap();
    assert_eq!(response.headers()["allow"], "GET,HEAD");
    problem(response, 405).await;
    problem(service.request("POST", "/healthz").send().await.unwrap(), 405).await;
}

#[tokio::test]
async fn every_answer_is_hardened() {
    let service = Service::start().await;
    for path in [
        "/",
        "/v1/parameters",
        "/v1/nothing",
        "/openapi.json",
        "/healthz",
        "/weighings/1",
        "/assets/none.js",
    ] {
        let response = service.get(path).await;
        let header = |name: &str| {
            response
                .headers()
                .get(name)
                .unwrap_or_else(|| panic!("{path}: {name}"))
                .to_str()
                .unwrap()
        };
        let csp = header("content-security-policy");
        assert!(csp.starts_with("default-src 'self';") && !csp.contains("unsafe"), "{path}: {csp}");
        assert_eq!(header("x-content-type-options"), "nosniff", "{path}");
        assert_eq!(header("referrer-policy"), "no-referrer", "{path}");
        assert!(!header("x-request-id").is_empty());
        assert!(!header("cache-control").is_empty());
    }
}

#[tokio::test]
async fn the_page_is_served_at_the_root_and_at_addresses_of_its_own() {
    let service = Service::start().await;
    let root = service.get("/").await;
    assert_eq!(root.status(), 200);
    let root = root.text().await.unwrap();
    assert!(root.contains("FLIP"), "{root}");
    let browser = service.request("GET", "/weighings/some").header("accept", "text/html,*/*;q=0.8");
    assert_eq!(browser.send().await.unwrap().text().await.unwrap(), root);
    problem(service.get("/assets/missing.js").await, 404).await;
}

#[tokio::test]
async fn an_answer_is_compressed_for_who_asks_but_neither_a_problem_nor_a_stream_of_events() {
    let service = Service::ready().await;
    crate::record::weighed(&service, "one").await;
    let packed = async |path: &str| {
        let request = service.request("GET", path).header("accept-encoding", "gzip");
        request.send().await.unwrap()
    };
    let encoding =
        |response: &reqwest::Response| response.headers().get("content-encoding").cloned();
    // A document, and a stream of pieces.
    for path in ["/openapi.json", "/v1/audit.csv"] {
        let plain = service.get(path).await;
        assert_eq!(encoding(&plain), None);
        let plain = plain.bytes().await.unwrap();
        let answer = packed(path).await;
        assert_eq!(encoding(&answer).unwrap(), "gzip", "{path}");
        assert!(answer.headers()["vary"].to_str().unwrap().contains("accept-encoding"));
        let answer = answer.bytes().await.unwrap();
        assert!(answer.len() < plain.len(), "{path}: {} of {}", answer.len(), plain.len());
        let mut read = Vec::new();
        std::io::Read::read_to_end(&mut flate2::read::GzDecoder::new(&answer[..]), &mut read)
            .unwrap();
        assert_eq!(read, plain, "{path}");
    }
    let refused = packed("/v1/powders/unobtainium").await;
    assert_eq!(encoding(&refused), None);
    problem(refused, 404).await;
    let events = packed("/v1/events").await;
    assert_eq!(events.headers()["content-type"], "text/event-stream");
    assert_eq!(encoding(&events), None);
}

/// The first line of the answer to these bytes.
async fn answer_to(service: &Service, bytes: &str) -> String {
    let mut connection = tokio::net::TcpStream::connect(service.address).await.unwrap();
    connection.write_all(bytes.as_bytes()).await.unwrap();
    let mut answer = String::new();
    tokio::io::BufReader::new(connection).read_line(&mut answer).await.unwrap();
    answer.trim_end().to_owned()
}

#[tokio::test]
async fn a_request_names_one_host_and_nobody_is_let_in_by_a_name_before_it() {
    let service = Service::start().await;
    let get = |hosts: &str| format!("GET /v1/powders HTTP/1.1\r\n{hosts}connection: close\r\n\r\n");
    for (hosts, status) in [
        ("host: 127.0.0.1\r\n", "200 OK"),
        ("", "400 Bad Request"),
        ("host: 127.0.0.1\r\nhost: evil.example\r\n", "400 Bad Request"),
        ("host: evil@127.0.0.1\r\n", "401 Unauthorized"),
    ] {
        assert_eq!(answer_to(&service, &get(hosts)).await, format!("HTTP/1.1 {status}"), "{hosts}");
    }
}

#[tokio::test]
async fn a_body_that_says_it_is_too_long_is_not_asked_for() {
    let service = Service::start().await;
    let token = service.token(flip::app::Role::Operator).await;
    let head = format!(
        "POST /v1/powders HTTP/1.1\r\nhost: 127.0.0.1\r\nauthorization: Bearer {token}\r\ncontent-type: application/json\r\n\
         content-length: 1073741824\r\nexpect: 100-continue\r\n\r\n"
    );
    assert_eq!(answer_to(&service, &head).await, "HTTP/1.1 413 Payload Too Large");
}

#[tokio::test]
async fn a_program_that_probes_for_an_interface_is_told_that_there_is_none() {
    let service = Service::start().await;
    for path in ["/status", "/info", "/version", "/.well-known/oauth", "/weighings/some"] {
        for accept in ["application/json", "*/*"] {
            let answer =
                service.request("GET", path).header("accept", accept).send().await.unwrap();
            assert_eq!(answer.headers()["content-type"], "application/problem+json", "{path}");
            problem(answer, 404).await;
        }
    }
}

#[tokio::test]
async fn invented_methods_make_no_labels_of_their_own() {
    let service = Service::start().await;
    for method in ["M1YYYY", "M2YYYY", "BREW"] {
        service.request(method, "/healthz").send().await.unwrap();
    }
    let metrics = service.get("/metrics").await.text().await.unwrap();
    assert!(!metrics.contains("YYYY") && !metrics.contains("BREW"), "{metrics}");
    assert!(metrics.contains("method=\"other\""), "{metrics}");
}

#[tokio::test]
async fn metrics_tell_of_the_bench_the_queue_and_each_dose() {
    let service = Service::ready().await;
    let metrics = async || service.get("/metrics").await.text().await.unwrap();
    let before = metrics().await;
    for line in [
        "flip_bench_latched 0",
        "flip_bench_moving 0",
        "flip_queue_age_seconds{queue=\"weighings\"} 0",
        "flip_queue_age_seconds{queue=\"jobs\"} 0",
        concat!("flip_build_info{version=\"", env!("CARGO_PKG_VERSION"), "\"} 1"),
    ] {
        assert!(before.contains(&format!("{line}\n")), "{line} in {before}");
    }
    let body = serde_json::json!({
        "powder": "salt",
        "target": { "value": 15, "unit": "mg" },
        "tolerance": { "lower": 1, "upper": 1, "unit": "mg" },
    });
    let weighing: serde_json::Value = service.weigh("told", &body).await.json().await.unwrap();
    service
        .watch(&format!("/v1/weighings/{}/events", weighing["id"].as_str().unwrap()), None)
        .await
        .unwrap();
    let told = |text: &str| {
        [
            "flip_dose_error_mg_count{",
            "flip_dose_seconds_count{",
            "flip_dose_shakes_count{",
            "flip_doses_total{",
        ]
        .iter()
        .all(|name| text.contains(&format!("{name}bench=\"simulated\",outcome=\"within\"}}")))
    };
    let deadline = tokio::time::Instant::now() + std::time::Duration::from_secs(20);
    while !told(&metrics().await) {
        assert!(tokio::time::Instant::now() < deadline, "{}", metrics().await);
        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
    }
}

#[tokio::test]
async fn probes_answer_and_metrics_count_requests() {
    let service = Service::start().await;
    assert_eq!(service.get("/healthz").await.status(), 200);
    assert_eq!(service.get("/readyz").await.status(), 200);
    service.get("/v1/parameters").await;
    let metrics = service.get("/metrics").await.text().await.unwrap();
    let counted = |line: &&str| {
        line.starts_with("flip_requests_total{") && line.contains("route=\"/v1/parameters\"")
    };
    assert!(metrics.lines().any(|line| counted(&line)), "{metrics}");
    assert!(metrics.contains("flip_request_seconds_bucket"), "{metrics}");
}

#[tokio::test]
async fn metrics_count_weighings_by_outcome() {
    let service = Service::ready().await;
    let body = serde_json::json!({
        "powder": "salt",
        "target": { "value": 15, "unit": "mg" },
        "tolerance": { "lower": 1, "upper": 1, "unit": "mg" },
    });
    let weighing: serde_json::Value = service.weigh("counted", &body).await.json().await.unwrap();
    service
        .watch(&format!("/v1/weighings/{}/events", weighing["id"].as_str().unwrap()), None)
        .await
        .unwrap();
    let metrics = service.get("/metrics").await.text().await.unwrap();
    assert!(metrics.contains("flip_weighings{state=\"done\",outcome=\"within\"} 1\n"), "{metrics}");
    assert!(
        metrics.contains("flip_jobs{kind=\"calibration\",state=\"succeeded\"} 1\n"),
        "{metrics}"
    );
}

#[tokio::test]
async fn an_address_that_others_reach_is_refused_without_tls_or_the_flag() {
    let service = Service::start().await;
    let exposed = ServeConfig::loopback("0.0.0.0:0".parse().unwrap());
    let refused = api::bind(service.app.clone(), exposed.clone()).err().unwrap();
    assert!(matches!(refused, ServeError::Exposed(_)));
    assert!(refused.to_string().contains("--insecure-lan"));
    assert!(api::bind(service.app.clone(), ServeConfig { insecure_lan: true, ..exposed }).is_ok());
}

#[tokio::test]
async fn shutting_down_ends_the_service() {
    let service = Service::start().await;
    let url = service.url("/healthz");
    assert_eq!(service.get("/healthz").await.status(), 200);
    service.stop().await;
    assert!(reqwest::get(url).await.is_err());
}
