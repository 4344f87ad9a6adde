//! TLS: what makes an address reachable by others acceptable.

use crate::harness::Service;
use flip::api::{ServeConfig, ServeError, Tls, bind};
use tonic::transport::{Certificate, Channel, ClientTlsConfig};
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_client::HealthClient;

/// A new certificate for `localhost` and its key, in PEM files.
fn certificate(folder: &std::path::Path) -> (Tls, String) {
    let made = rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
    let tls = Tls { certificate: folder.join("cert.pem"), key: folder.join("key.pem") };
    std::fs::write(&tls.certificate, made.cert.pem()).unwrap();
    std::fs::write(&tls.key, made.signing_key.serialize_pem()).unwrap();
    (tls, made.cert.pem())
}

#[tokio::test]
async fn with_a_certificate_the_service_answers_encrypted_on_any_address() {
    let folder = tempfile::tempdir().unwrap();
    let (tls, root) = certificate(folder.path());
    let config =
        ServeConfig { tls: Some(tls), ..ServeConfig::loopback("0.0.0.0:0".parse().unwrap()) };
    let service = Service::start_at(config).await;
    let trust =
        ClientTlsConfig::new().ca_certificate(Certificate::from_pem(root)).domain_name("localhost");
    let url = format!("https://127.0.0.1:{}", service.address.port());
    let channel =
        Channel::from_shared(url).unwrap().tls_config(trust).unwrap().connect().await.unwrap();
    let answer = HealthClient::new(channel).check(HealthCheckRequest::default()).await.unwrap();
    assert_eq!(answer.into_inner().status, 1);
    // Nothing is answered in plain text.
    assert!(reqwest::get(service.url("/healthz")).await.is_err());
}

#[tokio::test]
async fn files_that_are_no_certificate_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (tls, _) = certificate(folder.path());
    std::fs::write(&tls.key, "no key").unwrap();
    let service = Service::start().await;
    let config =
        ServeConfig { tls: Some(tls), ..ServeConfig::loopback("127.0.0.1:0".parse().unwrap()) };
    let server = bind(service.app.clone(), config).unwrap();
    assert!(matches!(server.run(std::future::pending()).await, Err(ServeError::Tls(_))));
}
