//! SiLA 2 from outside, by a client made from the same definitions; `tests/clients` has clients that
//! others wrote.

use crate::harness::Service;
use base64::Engine;
use base64::engine::general_purpose::{STANDARD, STANDARD_NO_PAD};
use flip::api::ServeConfig;
use flip::api::sila::SilaConfig;
use flip::api::sila::proto::sila2::flip::weighing::benchcontrol::v1::bench_control_client::BenchControlClient;
use flip::api::sila::proto::sila2::flip::weighing::benchcontrol::v1::{
    StopParameters, SubscribeStateParameters,
};
use flip::api::sila::proto::sila2::flip::weighing::powderweighing::v1::DosePowderParameters;
use flip::api::sila::proto::sila2::flip::weighing::powderweighing::v1::powder_weighing_client::PowderWeighingClient;
use flip::api::sila::proto::sila2::org::silastandard::core::commands::cancelcontroller::v1::cancel_controller_client::CancelControllerClient;
use flip::api::sila::proto::sila2::org::silastandard::core::commands::cancelcontroller::v1::{
    CancelAllParameters, CancelCommandParameters, DataTypeUuid,
};
use flip::api::sila::proto::sila2::org::silastandard::core::silaservice::v1::si_la_service_client::SiLaServiceClient;
use flip::api::sila::proto::sila2::org::silastandard::core::silaservice::v1::GetServerUuidParameters;
use flip::api::sila::proto::sila2::org::silastandard::execution_info::CommandStatus;
use flip::api::sila::proto::sila2::org::silastandard::si_la_error::Error;
use flip::api::sila::proto::sila2::org::silastandard::{
    self as standard, CommandExecutionUuid, SiLaError,
};
use flip::app::Role;
use futures::{StreamExt, TryStreamExt};
use prost::Message;
use std::time::Duration;
use tempfile::TempDir;
use tonic::transport::Channel;
use tonic::{Code, Request, Status};

const WEIGHING: &str = "flip/weighing/PowderWeighing/v1";

/// A service that speaks SiLA on a loopback address, with salt ready to weigh, and what the server
/// keeps.
async fn service() -> (Service, Channel, TempDir) {
    let kept = tempfile::tempdir().unwrap();
    let sila = SilaConfig::loopback("127.0.0.1:0".parse().unwrap(), kept.path().to_owned());
    let config =
        ServeConfig { sila: Some(sila), ..ServeConfig::loopback("127.0.0.1:0".parse().unwrap()) };
    let service = Service::start_at(config).await;
    crate::toy::calibrate_salt(service.data_dir()).await;
    let url = format!("http://{}", service.sila.unwrap());
    let channel = Channel::from_shared(url).unwrap().connect().await.unwrap();
    (service, channel, kept)
}

fn text(value: &str) -> Option<standard::String> {
    Some(standard::String { value: value.to_owned() })
}

fn real(value: f64) -> Option<standard::Real> {
    Some(standard::Real { value })
}

fn salt(key: &str, target_mg: f64) -> DosePowderParameters {
    DosePowderParameters {
        powder: text("salt"),
        target_mass: real(target_mg),
        lower_tolerance: real(1.0),
        upper_tolerance: real(1.0),
        vial: text(""),
        lot: text(""),
        operator: text("Ada"),
        vial_check: text("Confirm"),
        dose_identifier: text(key),
    }
}

/// A message with the metadata AccessToken.
async fn as_operator<T>(service: &Service, message: T) -> Request<T> {
    let token = service.token(Role::Operator).await;
    // A message with one field, a message with one field.
    let value = [&[10, token.len() as u8], token.as_bytes()].concat();
    let sent = [&[10, value.len() as u8], &*value].concat();
    let mut request = Request::new(message);
    let name = "sila-org.silastandard-core-authorizationservice-v1-metadata-accesstoken-bin";
    let value = tonic::metadata::BinaryMetadataValue::from_bytes(&sent);
    assert_eq!(value.as_encoded_bytes(), STANDARD_NO_PAD.encode(&sent).as_bytes());
    request.metadata_mut().insert_bin(name, value);
    request
}

/// The error of the standard that a status carries.
fn error(status: &Status) -> Error {
    assert_eq!(status.code(), Code::Aborted, "{status:?}");
    let bytes = STANDARD.decode(status.message()).unwrap();
    SiLaError::decode(&*bytes).unwrap().error.unwrap()
}

/// The identifier of a defined execution error, and its message.
fn defined(status: &Status) -> (String, String) {
    match error(status) {
        Error::DefinedExecutionError(error) => (error.error_identifier, error.message),
        other => panic!("{other:?}"),
    }
}

fn execution(uuid: &str) -> CommandExecutionUuid {
    CommandExecutionUuid { value: uuid.to_owned() }
}

async fn begin(service: &Service, channel: &Channel, key: &str) -> Result<String, Status> {
    let request = as_operator(service, salt(key, 15.0)).await;
    let confirmed = PowderWeighingClient::new(channel.clone()).dose_powder(request).await?;
    Ok(confirmed.into_inner().command_execution_uuid.unwrap().value)
}

#[tokio::test]
async fn a_dose_is_followed_to_its_last_value_and_has_a_result() {
    let (service, channel, _kept) = service().await;
    let mut weighing = PowderWeighingClient::new(channel.clone());
    let (hold, half) = (service.hold_bench(), service.hold_bench_at_half());
    let id = begin(&service, &channel, "dose").await.unwrap();
    service.until_pouring().await;
    let unfinished = weighing.dose_powder_result(execution(&id)).await.unwrap_err();
    assert!(matches!(error(&unfinished), Error::FrameworkError(it) if it.error_type == 2));
    let infos = weighing.dose_powder_info(execution(&id)).await.unwrap().into_inner();
    let mut values = weighing.dose_powder_intermediate(execution(&id)).await.unwrap().into_inner();
    drop(hold);
    // A stream shows the newest value, so the dose stands still until this one is seen.
    while values.message().await.unwrap().expect("half of the dose").mass != real(7.5) {}
    drop(half);
    let infos: Vec<_> = infos.try_collect().await.unwrap();
    assert_eq!(infos[0].command_status(), CommandStatus::Running);
    let last = infos.last().unwrap();
    assert_eq!(last.command_status(), CommandStatus::FinishedSuccessfully);
    assert_eq!(last.progress_info, real(1.0));
    let values: Vec<_> = values.try_collect().await.unwrap();
    let last = values.last().unwrap();
    assert_eq!((&last.state, last.mass), (&text("done"), real(15.0)));
    let result = weighing.dose_powder_result(execution(&id)).await.unwrap().into_inner();
    assert_eq!((result.outcome, result.mass), (text("within"), real(15.0)));
    assert!(result.weighing.unwrap().value.contains(&id));
    // What has ended says so at once, and nothing else.
    let infos: Vec<_> = weighing
        .dose_powder_info(execution(&id))
        .await
        .unwrap()
        .into_inner()
        .try_collect()
        .await
        .unwrap();
    assert_eq!(infos.len(), 1);
    service.stop().await;
}

#[tokio::test]
async fn a_dose_that_is_asked_for_again_is_the_same_and_another_under_its_name_is_refused() {
    let (service, channel, _kept) = service().await;
    let first = begin(&service, &channel, "once").await.unwrap();
    assert_eq!(begin(&service, &channel, "once").await.unwrap(), first);
    let other = as_operator(&service, salt("once", 16.0)).await;
    let status = PowderWeighingClient::new(channel.clone()).dose_powder(other).await.unwrap_err();
    assert_eq!(
        defined(&status).0,
        format!("{WEIGHING}/DefinedExecutionError/DoseIdentifierReused")
    );
    service.stop().await;
}

#[tokio::test]
async fn who_shows_no_token_may_read_and_follow_and_nothing_else() {
    let (service, channel, _kept) = service().await;
    let refused = PowderWeighingClient::new(channel.clone())
        .dose_powder(salt("anonymous", 15.0))
        .await
        .unwrap_err();
    assert!(matches!(error(&refused), Error::FrameworkError(it) if it.error_type == 3));
    let mut bench = BenchControlClient::new(channel.clone());
    let stopped = bench.stop(StopParameters { person: text("Eve") }).await.unwrap_err();
    assert!(matches!(error(&stopped), Error::FrameworkError(_)));
    let id = begin(&service, &channel, "followed").await.unwrap();
    let infos =
        PowderWeighingClient::new(channel.clone()).dose_powder_info(execution(&id)).await.unwrap();
    infos.into_inner().try_collect::<Vec<_>>().await.unwrap();
    // The service itself takes no metadata.
    let asked = as_operator(&service, GetServerUuidParameters {}).await;
    let mut server = SiLaServiceClient::new(channel);
    let refused = server.get_server_uuid(asked).await.unwrap_err();
    assert!(matches!(error(&refused), Error::FrameworkError(it) if it.error_type == 4));
    assert!(server.get_server_uuid(GetServerUuidParameters {}).await.is_ok());
    service.stop().await;
}

#[tokio::test]
async fn a_cancelled_dose_has_stopped_and_the_bench_is_held() {
    let (service, channel, _kept) = service().await;
    let _hold = service.hold_bench();
    let id = begin(&service, &channel, "cancelled").await.unwrap();
    service.until_pouring().await;
    let mut states = BenchControlClient::new(channel.clone())
        .subscribe_state(SubscribeStateParameters {})
        .await
        .unwrap()
        .into_inner();
    assert_eq!(states.next().await.unwrap().unwrap().state, text("Moving"));
    let uuid = Some(DataTypeUuid { uuid: text(&id) });
    let mut cancel = CancelControllerClient::new(channel.clone());
    for _ in 0..2 {
        let command = CancelCommandParameters { command_execution_uuid: uuid.clone() };
        cancel.cancel_command(as_operator(&service, command).await).await.unwrap();
    }
    let mut weighing = PowderWeighingClient::new(channel);
    let infos = weighing.dose_powder_info(execution(&id)).await.unwrap().into_inner();
    let infos: Vec<_> = infos.try_collect().await.unwrap();
    assert_eq!(infos.last().unwrap().command_status(), CommandStatus::FinishedWithError);
    let status = weighing.dose_powder_result(execution(&id)).await.unwrap_err();
    let (identifier, message) = defined(&status);
    assert_eq!(identifier, format!("{WEIGHING}/DefinedExecutionError/DoseStopped"));
    let document: serde_json::Value =
        serde_json::from_str(message.split_once('\n').unwrap().1).unwrap();
    assert_eq!((&document["id"], &document["outcome"]), (&id.into(), &"stopped".into()));
    let held = async { while states.next().await.unwrap().unwrap().state != text("Held") {} };
    tokio::time::timeout(Duration::from_secs(20), held).await.unwrap();
    service.stop().await;
}

#[tokio::test]
async fn cancel_all_ends_what_was_begun_here_and_nothing_else() {
    let (service, channel, _kept) = service().await;
    let hold = service.hold_bench();
    let dose = serde_json::json!({
        "powder": "salt", "target": { "value": 15.0, "unit": "mg" }, "tolerance": { "lower": 1, "upper": 1, "unit": "mg" },
    });
    let moving: serde_json::Value = service.weigh("of-REST", &dose).await.json().await.unwrap();
    service.until_pouring().await;
    let ours = begin(&service, &channel, "of-SiLA").await.unwrap();
    let mut cancel = CancelControllerClient::new(channel.clone());
    cancel.cancel_all(as_operator(&service, CancelAllParameters {}).await).await.unwrap();
    let status = PowderWeighingClient::new(channel).dose_powder_result(execution(&ours)).await;
    let stopped = format!("{WEIGHING}/DefinedExecutionError/DoseStopped");
    assert_eq!(defined(&status.unwrap_err()).0, stopped);
    drop(hold);
    let path = format!("/v1/weighings/{}?wait=60", moving["id"].as_str().unwrap());
    let ended: serde_json::Value = service.get(&path).await.json().await.unwrap();
    assert_eq!(ended["weighing"]["outcome"], "within");
    service.stop().await;
}

#[tokio::test]
async fn an_execution_that_is_not_there_is_named_so_and_a_wrong_value_by_its_parameter() {
    let (service, channel, _kept) = service().await;
    let mut weighing = PowderWeighingClient::new(channel);
    let unknown = weighing.dose_powder_info(execution("nothing")).await.unwrap_err();
    assert!(matches!(error(&unknown), Error::FrameworkError(it) if it.error_type == 1));
    for (wrong, parameter) in [
        (DosePowderParameters { powder: text("nothing"), ..salt("1", 15.0) }, "Powder"),
        (DosePowderParameters { vial_check: text("Maybe"), ..salt("2", 15.0) }, "VialCheck"),
        (DosePowderParameters { target_mass: None, ..salt("3", 15.0) }, "TargetMass"),
        (salt("4", 0.0), "TargetMass"),
        (salt("", 15.0), "DoseIdentifier"),
        (DosePowderParameters { lower_tolerance: real(-1.0), ..salt("5", 15.0) }, "LowerTolerance"),
    ] {
        let status = weighing.dose_powder(as_operator(&service, wrong).await).await.unwrap_err();
        let Error::ValidationError(error) = error(&status) else { panic!("{parameter}") };
        let expected = format!("{WEIGHING}/Command/DosePowder/Parameter/{parameter}");
        assert_eq!(error.parameter, expected, "{}", error.message);
    }
    let much = as_operator(&service, salt("6", 5000.0)).await;
    let status = weighing.dose_powder(much).await.unwrap_err();
    let identifier = format!("{WEIGHING}/DefinedExecutionError/TargetAboveCapacity");
    assert_eq!(defined(&status).0, identifier);
    service.stop().await;
}

#[tokio::test]
async fn a_page_in_a_browser_reaches_no_feature() {
    let (service, _channel, _kept) = service().await;
    let url = format!(
        "http://{}/sila2.org.silastandard.core.silaservice.v1.SiLAService/Get_ServerName",
        service.sila.unwrap()
    );
    // HTTP/1.1, which is what a page can make a browser send without encryption.
    let answer = reqwest::Client::new()
        .post(url)
        .header("content-type", "application/grpc")
        .body(vec![0u8; 5])
        .send()
        .await
        .unwrap();
    assert_eq!(answer.headers()["grpc-status"], "3");
    service.stop().await;
}
