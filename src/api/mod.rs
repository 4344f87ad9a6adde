//! REST, gRPC and the page on one port, all through [`crate::app`].
//!
//! A request passes, from the outside in: [`edge`] (id, protocol of refusals, headers, counts), a net for panics,
//! [`limits::fair`], [`auth::same_origin`], [`auth::identify`], then its route in [`rest`], [`grpc`], [`probes`] or [`page`].

mod auth;
mod edge;
pub mod grpc;
mod journal;
mod limits;
mod listen;
mod page;
mod probes;
pub mod problem;
pub mod rest;

pub use listen::{ServeConfig, ServeError, Tls};

use crate::app::App;
use axum::Router;
use axum::middleware::{from_fn, from_fn_with_state};
use axum_server::tls_rustls::{RustlsAcceptor, RustlsConfig};
use hyper_util::rt::TokioTimer;
use std::future::Future;
use std::net::{SocketAddr, TcpListener};
use std::time::Duration;
use tokio_util::sync::CancellationToken;
use tower_http::catch_panic::CatchPanicLayer;

/// How long open requests may take to end once the service shuts down.
const DRAIN: Duration = Duration::from_secs(10);

/// How long a client may take to send the head of a request, and how often silent HTTP/2 ones are asked for a sign of life.
const HEAD: Duration = Duration::from_secs(15);

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

    /// Answers until `shutdown` completes. Then takes no more connections, gives open requests [`DRAIN`] to end, and closes
    /// the application: the spoon is levelled, running jobs are checkpointed, event streams end.
    ///
    /// # Errors
    /// [`ServeError::Tls`] for unusable certificates, [`ServeError::Broken`] if the server breaks down.
    pub async fn run(self, shutdown: impl Future<Output = ()> + Send) -> Result<(), ServeError> {
        let closing = CancellationToken::new();
        let handle = axum_server::Handle::new();
        let mut close = std::pin::pin!(async {
            shutdown.await;
            closing.cancel();
            handle.graceful_shutdown(Some(DRAIN));
            if let Err(error) = self.app.shutdown().await {
                tracing::error!(%error, "the application did not close cleanly");
            }
        });
        // However this ends: who follows tokens and health must not outlive it.
        let _ending = closing.clone().drop_guard();
        tokio::spawn(closing.clone().run_until_cancelled_owned(self.app.clone().keep_tokens()));
        let router = router(&self.app, &self.config, closing.clone());
        tokio::spawn(journal::keep(self.app.clone(), closing.clone()));
        let tls = self.config.tls().await?;
        let mut answer = std::pin::pin!(answer(self.listener, tls, handle.clone(), router));
        tokio::select! {
            ended = &mut answer => {
                // Drained before the application was closed; or broken, and then nothing closes it but us.
                if closing.is_cancelled() {
                    close.await;
                }
                ended
            }
            () = &mut close => answer.await,
        }
    }
}

async fn answer(
    listener: TcpListener,
    tls: Option<RustlsConfig>,
    handle: axum_server::Handle<SocketAddr>,
    router: Router,
) -> Result<(), ServeError> {
    let mut server = axum_server::from_tcp(listener)?.handle(handle);
    let http = server.http_builder();
    http.http1().timer(TokioTimer::new()).header_read_timeout(HEAD);
    http.http2().timer(TokioTimer::new()).keep_alive_interval(HEAD);
    let service = router.into_make_service();
    match tls {
        None => server.serve(service).await?,
        Some(tls) => server.acceptor(RustlsAcceptor::new(tls)).serve(service).await?,
    }
    Ok(())
}

fn router(app: &App, config: &ServeConfig, closing: CancellationToken) -> Router {
    let gate = auth::Gate { app: app.clone(), loopback: config.is_loopback() };
    rest::router(app.clone())
        .merge(grpc::router(app.clone(), closing.clone()))
        .merge(probes::router(app.clone(), closing))
        .fallback(page::fallback)
        .layer(from_fn(auth::on_behalf))
        .layer(from_fn_with_state(gate, auth::identify))
        .layer(from_fn(auth::same_origin))
        .layer(from_fn_with_state(limits::Limits::default(), limits::fair))
        .layer(CatchPanicLayer::custom(edge::panicked))
        .layer(from_fn(edge::edge))
}
