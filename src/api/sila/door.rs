//! Where the SiLA server listens, what it refuses to expose, and the way of a request to its
//! feature.

use super::announce::{Announcement, announce};
use super::binary::Binaries;
use super::identity::{Gate, Sessions, identify};
use super::lock::Lock;
use super::nameplate::NamePlate;
use super::proto::sila2::flip::discovery::simulatordiscovery::v1::simulator_discovery_server::SimulatorDiscoveryServer;
use super::proto::sila2::flip::flowability::angleofreposemeasurement::v1::angle_of_repose_measurement_server::AngleOfReposeMeasurementServer;
use super::proto::sila2::flip::flowability::powdercalibration::v1::powder_calibration_server::PowderCalibrationServer;
use super::proto::sila2::flip::weighing::balancereading::v1::balance_reading_server::BalanceReadingServer;
use super::proto::sila2::flip::weighing::benchcontrol::v1::bench_control_server::BenchControlServer;
use super::proto::sila2::flip::weighing::powderweighing::v1::powder_weighing_server::PowderWeighingServer;
use super::proto::sila2::org::silastandard::core::authenticationservice::v1::authentication_service_server::AuthenticationServiceServer;
use super::proto::sila2::org::silastandard::core::authorizationservice::v1::authorization_service_server::AuthorizationServiceServer;
use super::proto::sila2::org::silastandard::core::commands::cancelcontroller::v1::cancel_controller_server::CancelControllerServer;
use super::proto::sila2::org::silastandard::core::lockcontroller::v1::lock_controller_server::LockControllerServer;
use super::proto::sila2::org::silastandard::core::silaservice::v1::si_la_service_server::SiLaServiceServer;
use super::standard::binary_download_server::BinaryDownloadServer;
use super::standard::binary_upload_server::BinaryUploadServer;
use super::{Sila, certificate, feature};
use crate::api::front::{Connection, Front, Kind, registered};
use crate::api::listen::{ServeError, Tls, listener};
use crate::api::{asked, auth, edge};
use crate::app::{App, FieldError, Role};
use axum::Router;
use axum::extract::{Extension, Request, State};
use axum::middleware::{Next, from_fn, from_fn_with_state};
use axum::response::Response;
use std::fs;
use std::net::{SocketAddr, TcpListener};
use std::path::PathBuf;
use std::sync::Arc;
use tokio::runtime::Handle;
use tokio_util::sync::CancellationToken;
use tonic::Status;
use tonic::service::Routes;
use tower_http::catch_panic::CatchPanicLayer;

/// Most connections: a laboratory has few schedulers.
const CONNECTIONS_MAX: usize = 64;

/// Where and how to serve SiLA 2.
#[derive(Debug, Clone)]
pub struct SilaConfig {
    /// Address and port; port 0 lets the system choose.
    pub listen: SocketAddr,
    /// The data folder: UUID, name and certificate are kept there.
    pub data_dir: PathBuf,
    /// Certificate and key; one signed by itself if there are none.
    pub tls: Option<Tls>,
    /// Speak without TLS; only on a loopback address.
    pub insecure: bool,
    /// Name of a token by which callers without one act.
    pub role: Option<String>,
    /// Whether clients may lock the server.
    pub lock: bool,
    /// Whether the server is announced on its network.
    pub announce: bool,
}

impl SilaConfig {
    /// Without TLS on a loopback address, not announced.
    pub fn loopback(listen: SocketAddr, data_dir: PathBuf) -> Self {
        Self {
            listen,
            data_dir,
            tls: None,
            insecure: true,
            role: None,
            lock: false,
            announce: false,
        }
    }

    fn check(&self, app: &App) -> Result<(), FieldError> {
        if self.insecure && !self.listen.ip().is_loopback() {
            let advice = format!(
                "is for loopback addresses only, and {} can be reached from other machines: leave it out, and clients connect with the certificate that is announced",
                self.listen
            );
            return Err(FieldError::new("sila_insecure", advice));
        }
        let Some(name) = &self.role else { return Ok(()) };
        let advice = match app.holder_named(name) {
            None => format!(
                "there is no valid token with the name `{name}`: make one with flip token create --name {name} --role operator"
            ),
            Some(holder) if holder.role == Role::Admin => format!(
                "`{name}` is an admin's token, and whoever reaches the port would be one: name an operator's or a viewer's"
            ),
            Some(_) => return Ok(()),
        };
        Err(FieldError::new("sila_role", advice))
    }
}

/// The SiLA server, bound to its address but not yet answering.
pub struct Bound {
    config: SilaConfig,
    listener: TcpListener,
    plate: NamePlate,
}

/// Binds the address.
///
/// # Errors
/// [`ServeError::Refused`] for settings that would expose the bench, [`ServeError::Listen`] if the
/// address is not free, [`ServeError::Broken`] if the data folder cannot be written.
pub fn bind(app: &App, config: SilaConfig) -> Result<Bound, ServeError> {
    config.check(app).map_err(ServeError::Refused)?;
    let plate = NamePlate::of(&config.data_dir, app.installation())?;
    let listener = listener(config.listen)?;
    Ok(Bound { config, listener, plate })
}

/// The running server.
pub struct Running {
    /// Its connections.
    pub front: Front,
    _announcement: Option<Announcement>,
}

impl Bound {
    /// The address the server listens on.
    ///
    /// # Errors
    /// The system's error.
    pub fn address(&self) -> std::io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    /// Answers until `closing` is cancelled.
    ///
    /// # Errors
    /// [`ServeError::Tls`] for unusable certificates, [`ServeError::Broken`] if it does not start.
    pub fn open(self, app: &App, closing: CancellationToken) -> Result<Running, ServeError> {
        let address = self.address()?;
        let Self { config, listener, plate } = self;
        let tls = match (config.insecure, &config.tls) {
            (true, _) => None,
            (false, Some(given)) => Some(given.clone()),
            (false, None) => {
                Some(certificate::own(&plate, &certificate::names(config.listen.ip()))?)
            }
        };
        // Only a certificate that nobody signed needs to be told.
        let own = tls.as_ref().filter(|_| config.tls.is_none());
        let pem = own.map(|own| fs::read_to_string(&own.certificate)).transpose()?;
        let announcement = (config.announce && !address.ip().is_loopback())
            .then(|| announce(&plate, address, pem.as_deref()))
            .and_then(|announced| {
                announced.inspect_err(|error| {
                    tracing::warn!(%error, "the SiLA server cannot be announced on the network; clients need its address");
                }).ok()
            });
        let acceptor = tls.map(|tls| tls.acceptor()).transpose()?;
        let router = router(app, &config, plate);
        let front = Front::open_small(listener, acceptor, router, closing, CONNECTIONS_MAX)?;
        Ok(Running { front, _announcement: announcement })
    }
}

/// The features, and every layer in front of them.
fn router(app: &App, config: &SilaConfig, plate: NamePlate) -> Router {
    let loopback = config.listen.ip().is_loopback();
    let sessions = Arc::<Sessions>::default();
    let guarded = match config.role {
        Some(_) => Vec::new(),
        None => feature::guarded(config.lock, loopback),
    };
    let sila = Sila {
        app: app.clone(),
        plate: Arc::new(plate),
        sessions: sessions.clone(),
        binaries: Arc::<Binaries>::default(),
        audience: Arc::default(),
        lock: config.lock.then(Arc::<Lock>::default),
        guarded: guarded.into(),
    };
    let gate = Gate { app: app.clone(), sessions, loopback, role: config.role.clone() };
    features(sila)
        .layer(from_fn(edge::tell_route))
        .layer(from_fn(asked::as_of_head))
        .layer(from_fn_with_state(gate, identify))
        .layer(from_fn_with_state(Handle::current(), on_main))
        .layer(from_fn(auth::same_origin))
        .layer(CatchPanicLayer::custom(edge::panicked))
        .layer(from_fn(edge::edge))
        .layer(from_fn(follow))
        .layer(from_fn_with_state(app.clone(), asked::at_head))
}

fn features(sila: Sila) -> Router {
    let lock = sila.lock.is_some().then(|| LockControllerServer::new(sila.clone()));
    let mut routes = Routes::new(SiLaServiceServer::new(sila.clone()))
        .add_service(AuthenticationServiceServer::new(sila.clone()))
        .add_service(AuthorizationServiceServer::new(sila.clone()))
        .add_service(CancelControllerServer::new(sila.clone()))
        .add_service(PowderWeighingServer::new(sila.clone()))
        .add_service(BenchControlServer::new(sila.clone()))
        .add_service(BalanceReadingServer::new(sila.clone()))
        .add_service(AngleOfReposeMeasurementServer::new(sila.clone()))
        .add_service(PowderCalibrationServer::new(sila.clone()))
        .add_service(SimulatorDiscoveryServer::new(sila.clone()))
        .add_service(BinaryUploadServer::new(sila.clone()))
        .add_service(BinaryDownloadServer::new(sila));
    if let Some(lock) = lock {
        routes = routes.add_service(lock);
    }
    routes.into_axum_router()
}

/// Registers the request with its connection.
async fn follow(
    Extension(connection): Extension<Arc<Connection>>,
    request: Request,
    next: Next,
) -> Response {
    let kind = if is_stream(request.uri().path()) { Kind::Stream } else { Kind::Ordinary };
    registered(&connection, kind, request, next).await
}

/// Whether the answer at this path goes on for as long as something happens.
fn is_stream(path: &str) -> bool {
    let method = path.rsplit('/').next().unwrap_or_default();
    method.starts_with("Subscribe_")
        || method.ends_with("_Info")
        || method.ends_with("_Intermediate")
        || method.ends_with("Chunk")
}

/// Carries a request out on the main runtime, which outlives the connections.
async fn on_main(State(main): State<Handle>, request: Request, next: Next) -> Response {
    let answered = main.spawn(next.run(request)).await;
    answered.unwrap_or_else(|_| Status::unavailable("shutting down").into_http())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_goes_on_is_known_by_its_name() {
        let weighing = "/sila2.flip.weighing.powderweighing.v1.PowderWeighing/DosePowder";
        assert!(
            is_stream(&format!("{weighing}_Info"))
                && is_stream(&format!("{weighing}_Intermediate"))
        );
        assert!(is_stream("/sila2.flip.weighing.benchcontrol.v1.BenchControl/Subscribe_State"));
        assert!(!is_stream(weighing) && !is_stream(&format!("{weighing}_Result")));
    }
}
