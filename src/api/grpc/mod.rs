//! gRPC: one file per service of `proto/flip/v1/flip.proto`, each method one call of the
//! application.

pub mod access;
mod bench;
mod calibrations;
mod card;
mod convert;
mod evaluations;
mod films;
mod health;
mod investigations;
mod jobs;
mod labels;
mod observables;
mod policies;
mod powders;
mod repose;
mod shakes;
mod simulators;
pub mod status;
mod tokens;
mod trainings;
mod webhooks;
mod weighings;

use super::auth;
use super::rest::extract::{BODY_BYTES_MAX, LARGE_BYTES_MAX};
use crate::api::problem::Problem;
use crate::app::App;
use crate::app::Event;
use crate::app::Role;
use axum::Router;
use axum::body::Body;
use axum::http::{HeaderMap, header};
use axum::middleware::map_request;
use flip_core::domain::FieldError;
use futures::StreamExt;
use futures::stream::BoxStream;
use proto::bench_server::BenchServer;
use proto::calibrations_server::CalibrationsServer;
use proto::evaluations_server::EvaluationsServer;
use proto::films_server::FilmsServer;
use proto::investigations_server::InvestigationsServer;
use proto::jobs_server::JobsServer;
use proto::labels_server::LabelsServer;
use proto::policies_server::PoliciesServer;
use proto::powders_server::PowdersServer;
use proto::repose_measurements_server::ReposeMeasurementsServer;
use proto::shakes_server::ShakesServer;
use proto::simulators_server::SimulatorsServer;
use proto::tokens_server::TokensServer;
use proto::trainings_server::TrainingsServer;
use proto::webhooks_server::WebhooksServer;
use proto::weighings_server::WeighingsServer;
use tokio_util::sync::CancellationToken;
use tonic::service::Routes;
use tonic::{Request, Status};

/// Messages, servers and clients, generated from the contract.
#[expect(missing_docs, reason = "generated; the contract has the comments")]
pub mod proto {
    tonic::include_proto!("flip.v1");
}

/// The descriptors of `flip.v1` and what it imports, as protoc writes them.
pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/flip.v1.bin"));

/// An encoded message without fields: not compressed, zero bytes.
const EMPTY_MESSAGE: &[u8] = &[0; 5];

/// All services with health and reflection; once `closing` is cancelled, health reports that they
/// do not serve.
pub fn router(app: App, closing: CancellationToken) -> Router {
    let (reporter, health) = tonic_health::server::health_reporter();
    tokio::spawn(health::report(app.clone(), reporter, closing));
    let service = Service { app };
    macro_rules! limited {
        ($server:ident) => {
            $server::new(service.clone()).max_decoding_message_size(BODY_BYTES_MAX)
        };
        ($server:ident, $bytes_max:ident) => {
            $server::new(service.clone()).max_decoding_message_size($bytes_max)
        };
    }
    // Responses contain frames as large as those received.
    let frames = limited!(ReposeMeasurementsServer, LARGE_BYTES_MAX);
    let frames = frames.max_encoding_message_size(LARGE_BYTES_MAX);
    let mut routes = Routes::new(health);
    if let Ok(reflection) = reflection().build_v1() {
        routes = routes.add_service(reflection);
    }
    // Python and older Go clients request the first version of reflection.
    if let Ok(reflection) = reflection().build_v1alpha() {
        routes = routes.add_service(reflection);
    }
    routes
        .add_service(limited!(PowdersServer))
        .add_service(limited!(CalibrationsServer))
        .add_service(limited!(TrainingsServer))
        .add_service(limited!(PoliciesServer, LARGE_BYTES_MAX))
        .add_service(limited!(EvaluationsServer))
        .add_service(limited!(InvestigationsServer, LARGE_BYTES_MAX))
        .add_service(limited!(SimulatorsServer, LARGE_BYTES_MAX))
        .add_service(limited!(ShakesServer, LARGE_BYTES_MAX))
        .add_service(limited!(WeighingsServer))
        .add_service(limited!(FilmsServer))
        .add_service(limited!(BenchServer))
        .add_service(frames)
        .add_service(limited!(JobsServer))
        .add_service(limited!(LabelsServer))
        .add_service(limited!(TokensServer))
        .add_service(limited!(WebhooksServer))
        .into_axum_router()
        .reset_fallback()
}

/// `StopBench`, for the front end. Its message is empty, so it is not awaited.
pub fn bench_stop(app: App) -> Router {
    let without_message = map_request(async |request: axum::extract::Request| {
        request.map(|_| Body::from(EMPTY_MESSAGE))
    });
    Router::new()
        .route_service("/flip.v1.Bench/StopBench", BenchServer::new(Service { app }))
        .route_layer(without_message)
}

/// `StopWeighing`, for the front end.
pub fn weighing_stop(app: App) -> Router {
    Router::new()
        .route_service("/flip.v1.Weighings/StopWeighing", WeighingsServer::new(Service { app }))
}

fn reflection() -> tonic_reflection::server::Builder<'static> {
    tonic_reflection::server::Builder::configure()
        .register_encoded_file_descriptor_set(DESCRIPTORS)
        .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
}

/// Whether a request is gRPC, so that its response must be too.
pub fn is_grpc(headers: &HeaderMap) -> bool {
    let kind = headers.get(header::CONTENT_TYPE).map(|value| value.as_bytes());
    kind.is_some_and(|kind| kind.starts_with(b"application/grpc"))
}

/// Implements all services.
#[derive(Clone)]
struct Service {
    app: App,
}

/// The message, if the caller may read.
fn read<T>(request: Request<T>) -> Result<T, Status> {
    auth::require(request.extensions(), Role::Viewer)?;
    Ok(request.into_inner())
}

/// The message, if the caller may start, stop and add things.
fn write<T>(request: Request<T>) -> Result<T, Status> {
    auth::require(request.extensions(), Role::Operator)?;
    Ok(request.into_inner())
}

/// The message, if the caller is an admin.
fn govern<T>(request: Request<T>) -> Result<T, Status> {
    auth::require(request.extensions(), Role::Admin)?;
    Ok(request.into_inner())
}

/// The message, if the caller may clear a latched bench.
fn clear<T>(request: Request<T>) -> Result<T, Status> {
    auth::require_clearer(request.extensions())?;
    Ok(request.into_inner())
}

/// Response type of the watch methods.
type EventStream = BoxStream<'static, Result<proto::Event, Status>>;

fn watch(events: BoxStream<'static, crate::app::Result<Event>>) -> EventStream {
    events.map(|event| Ok(event?.into())).boxed()
}

/// Sequence number after which a stream begins.
fn after(seq: i64) -> Result<i64, Problem> {
    match seq {
        ..0 => {
            Err(FieldError::new("after_seq", "must be the position of an event, a number from 0")
                .into())
        }
        seq => Ok(seq),
    }
}
