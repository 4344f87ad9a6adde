//! REST, gRPC and the page on one port, all through [`crate::app`].
//!
//! A request passes, from the outside in: [`edge`] (id, protocol of refusals, headers, counts), a net for panics,
//! [`auth::same_origin`], [`auth::identify`], then its route in [`rest`], [`grpc`], [`probes`] or [`page`].

mod auth;
mod edge;
pub mod grpc;
mod listen;
mod page;
mod probes;
pub mod problem;
pub mod rest;

pub use listen::{ServeConfig, ServeError, Tls};

use crate::app::App;
use axum::Router;
use axum::middleware::{from_fn, from_fn_with_state};
use std::future::Future;
use std::net::{SocketAddr, TcpListener};
use std::time::Duration;
use tokio_util::sync::CancellationToken;
use tower_http::catch_panic::CatchPanicLayer;

/// How long open requests may take to end once the service shuts down.
const DRAIN: Duration = Duration::from_secs(10);

/// The service, bound to its address and not yet answering.
pub struct Server {
    app: App,
    config: ServeConfig,
    listener: TcpListener,
}

/// Listens and answers until `shutdown` completes; [`bind`] and [`Server::run`] in one.
///
/// # Errors
/// As [`bind`] and [`Server::run`].
pub async fn serve(app: App, config: ServeConfig, shutdown: impl Future<Output = ()> + Send) -> Result<(), ServeError> {
    bind(app, config)?.run(shutdown).await
}

/// Binds the address, so that the caller can tell where the service is before it runs.
///
/// # Errors
/// [`ServeError::Exposed`] for an address that others can reach unencrypted, [`ServeError::Listen`] if it is not free.
pub fn bind(app: App, config: ServeConfig) -> Result<Server, ServeError> {
    let listener = config.listen()?;
    Ok(Server { app, config, listener })
}

impl Server {
    /// Where the service listens.
    ///
    /// # Errors
    /// What the system says.
    pub fn address(&self) -> Result<SocketAddr, ServeError> {
        Ok(self.listener.local_addr()?)
    }

    /// Answers until `shutdown` completes. Then: says that it is not ready, closes the application (the spoon is levelled,
    /// running jobs are checkpointed, event streams end), and gives open requests [`DRAIN`] to end.
    ///
    /// # Errors
    /// [`ServeError::Tls`] for unusable certificates, [`ServeError::Broken`] if the server breaks down.
    pub async fn run(self, shutdown: impl Future<Output = ()> + Send) -> Result<(), ServeError> {
        let tls = self.config.tls().await?;
        let closing = CancellationToken::new();
        let router = router(&self.app, &self.config, closing.clone());
        let handle = axum_server::Handle::new();
        let server = axum_server::from_tcp(self.listener)?.handle(handle.clone());

        let close = async {
            shutdown.await;
            closing.cancel();
            if let Err(error) = self.app.shutdown().await {
                tracing::error!(%error, "the application did not close cleanly");
            }
            handle.graceful_shutdown(Some(DRAIN));
            std::future::pending().await
        };
        let service = router.into_make_service();
        let answer = async {
            match tls {
                None => server.serve(service).await,
                Some(tls) => server.acceptor(axum_server::tls_rustls::RustlsAcceptor::new(tls)).serve(service).await,
            }
        };
        tokio::select! {
            ended = answer => Ok(ended?),
            () = close => Ok(()),
        }
    }
}

fn router(app: &App, config: &ServeConfig, closing: CancellationToken) -> Router {
    let gate = auth::Gate { app: app.clone(), loopback: config.is_loopback() };
    rest::router(app.clone())
        .merge(grpc::router(app.clone(), closing.clone()))
        .merge(probes::router(app.clone(), closing))
        .fallback(page::fallback)
        .layer(from_fn_with_state(gate, auth::identify))
        .layer(from_fn(auth::same_origin))
        .layer(CatchPanicLayer::custom(edge::panicked))
        .layer(from_fn(edge::edge))
}
