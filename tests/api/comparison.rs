//! Comparison of two calibrations, and the posterior, over both transports.

use crate::harness::{Service, fields, problem};
use flip::api::grpc::proto;
use flip::api::grpc::proto::calibrations_client::CalibrationsClient;
use flip::app::Role;
use serde_json::{Value, json};
use tonic::Code;

/// A calibration by the formula of the toy heap, once it has ended: its id and state.
async fn ended(service: &Service, body: &Value) -> (String, Value) {
    let request = service
        .request("POST", "/v1/calibrations")
        .bearer_auth(service.token(Role::Operator).await);
    let job: Value = request.json(body).send().await.unwrap().json().await.unwrap();
    let id = job["id"].as_str().unwrap_or_else(|| panic!("{job}")).to_owned();
    service.watch(&format!("/v1/jobs/{id}/events"), None).await;
    let job: Value = service.get(&format!("/v1/jobs/{id}")).await.json().await.unwrap();
    (id, job["state"].clone())
}

async fn calibrated(service: &Service, body: &Value) -> String {
    let (id, state) = ended(service, body).await;
    assert_eq!(state, "succeeded");
    id
}

#[tokio::test]
async fn two_calibrations_are_compared_the_same_over_both_transports() {
    let service = Service::start().await;
    let of = |powder: &str| json!({ "powder": powder, "method": "sequential", "sets": 3 });
    let (salt, sand) =
        (calibrated(&service, &of("salt")).await, calibrated(&service, &of("sand")).await);
    let rest: Value = service
        .get(&format!("/v1/calibrations/{salt}/compare?with={sand}"))
        .await
        .json()
        .await
        .unwrap();
    let alone: Value = service.get(&format!("/v1/calibrations/{salt}")).await.json().await.unwrap();
    let side = &rest["calibration"];
    assert_eq!((&side["id"], &rest["with"]["id"]), (&json!(salt), &json!(sand)));
    assert_eq!((&side["method"], &side["target"]), (&json!("sequential"), &alone["target"]));
    for key in ["evaluations", "verification_runs", "verified_error_deg"] {
        assert_eq!(side[key], alone["result"][key], "{key}");
    }
    let sets = alone["result"]["sets"].as_array().unwrap();
    assert_eq!(side["sets"], sets.len());
    let friction: Vec<f64> =
        sets.iter().map(|set| set["parameters"]["friction"].as_f64().unwrap()).collect();
    let spread = &side["parameters"][4];
    assert_eq!(spread["key"], "friction");
    assert_eq!(spread["lower"].as_f64(), friction.iter().copied().reduce(f64::min));
    assert_eq!(spread["upper"].as_f64(), friction.iter().copied().reduce(f64::max));
    // The toy heap has no noise: powders of 36 and 29 deg differ, and a calibration agrees with
    // itself.
    assert_eq!(rest["agree"], false, "{rest}");
    let itself: Value = service
        .get(&format!("/v1/calibrations/{salt}/compare?with={salt}"))
        .await
        .json()
        .await
        .unwrap();
    assert_eq!((&itself["agree"], &itself["difference_deg"]), (&json!(true), &json!(0.0)));

    let mut calibrations = CalibrationsClient::connect(service.url("")).await.unwrap();
    let message = proto::CompareCalibrationsRequest { calibration: salt, with: sand };
    let grpc = calibrations.compare_calibrations(message).await.unwrap().into_inner();
    assert_eq!(
        (grpc.agree, json!(grpc.difference_deg)),
        (Some(false), rest["difference_deg"].clone())
    );
    let wire = grpc.calibration.unwrap();
    assert_eq!(wire.method(), proto::CalibrationMethod::Sequential);
    assert_eq!(json!(wire.repose_deg), side["repose_deg"]);
    assert_eq!(
        (wire.parameters.len(), json!(wire.parameters[4].mean)),
        (9, spread["mean"].clone())
    );
}

#[tokio::test]
async fn what_cannot_be_compared_is_refused() {
    let service = Service::start().await;
    let id =
        calibrated(&service, &json!({ "powder": "salt", "method": "sequential", "sets": 1 })).await;
    problem(service.get(&format!("/v1/calibrations/none/compare?with={id}")).await, 404).await;
    problem(service.get(&format!("/v1/calibrations/{id}/compare?with=none")).await, 404).await;
    let missing = problem(service.get(&format!("/v1/calibrations/{id}/compare")).await, 400).await;
    assert_eq!(fields(&missing), ["with"]);
    // Ten trials cannot find a hundred sets.
    let hopeless =
        json!({ "powder": "salt", "method": "sequential", "sets": 100, "trials_max": 10 });
    let (failed, state) = ended(&service, &hopeless).await;
    assert_eq!(state, "failed");
    let unfinished =
        problem(service.get(&format!("/v1/calibrations/{id}/compare?with={failed}")).await, 409)
            .await;
    assert_eq!(unfinished["type"], "urn:flip:problem:calibration-unfinished");
    let mut calibrations = CalibrationsClient::connect(service.url("")).await.unwrap();
    let message =
        proto::CompareCalibrationsRequest { calibration: id.clone(), with: "none".into() };
    assert_eq!(
        calibrations.compare_calibrations(message).await.unwrap_err().code(),
        Code::NotFound
    );
    let message = proto::GetPosteriorRequest { calibration: id };
    assert_eq!(
        calibrations.get_posterior(message).await.unwrap_err().code(),
        Code::FailedPrecondition
    );
    let message = proto::GetPosteriorRequest { calibration: "none".into() };
    assert_eq!(calibrations.get_posterior(message).await.unwrap_err().code(), Code::NotFound);
}

#[tokio::test]
async fn the_posterior_is_the_same_over_both_transports() {
    let service = Service::start().await;
    let id = calibrated(&service, &json!({ "powder": "salt", "sets": 2 })).await;
    let rest: Value =
        service.get(&format!("/v1/calibrations/{id}/posterior")).await.json().await.unwrap();
    let mut calibrations = CalibrationsClient::connect(service.url("")).await.unwrap();
    let message = proto::GetPosteriorRequest { calibration: id };
    let grpc = calibrations.get_posterior(message).await.unwrap().into_inner();
    let draws: Vec<_> = grpc.draws.iter().map(|draw| &draw.values).collect();
    assert_eq!(json!(draws), rest["draws"]);
    assert_eq!(
        (json!(grpc.repose_deg), json!(grpc.effective)),
        (rest["repose_deg"].clone(), rest["effective"].clone())
    );
    let parameters = grpc.parameters.iter().map(|m| {
        json!({ "key": m.key, "mean": m.mean, "interval": [m.lower, m.upper], "learnt": m.learnt, "inert": m.inert })
    });
    assert_eq!(json!(parameters.collect::<Vec<_>>()), rest["parameters"]);
    let together = grpc
        .together
        .iter()
        .map(|pair| json!({ "keys": pair.keys, "correlation": pair.correlation }));
    assert_eq!(json!(together.collect::<Vec<_>>()), rest["together"]);
}
