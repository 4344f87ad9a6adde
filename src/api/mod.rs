//! REST, gRPC and the web page on one port, SiLA 2 on another, all through [`crate::app`].
//!
//! A request passes, from the outside in: [`front`] (connections, on dedicated threads), [`asked`]
//! (number of stops so far), [`edge`] (id, protocol of errors, headers, metrics), a panic handler,
//! [`auth::same_origin`], [`auth::identify`]; a stop then goes to the bench, and everything else
//! waits for its body and its seat ([`limits`]) and goes on to its route in [`rest`], [`grpc`],
//! [`madsci`], [`probes`] or [`page`] on the main runtime. [`sila`] says how its requests go.

mod asked;
mod auth;
mod complaint;
mod docs;
mod edge;
mod front;
pub mod grpc;
mod journal;
mod limits;
mod listen;
mod madsci;
mod page;
mod probes;
pub mod problem;
pub mod rest;
pub mod sila;
mod webhooks;
pub mod wire;

pub use listen::{ServeConfig, ServeError, Tls};

use crate::app::App;
use axum::Router;
use axum::middleware::from_fn;
use front::Front;
use std::future::Future;
use std::net::{SocketAddr, TcpListener};
use std::time::Duration;
use tokio_util::sync::CancellationToken;
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::compression::CompressionLayer;
use tower_http::compression::predicate::{DefaultPredicate, NotForContentType, Predicate};

/// How long open requests may take to finish once the service shuts down.
const DRAIN: Duration = Duration::from_secs(10);

/// The service, bound to its address but not yet answering.
pub struct Server {
    app: App,
    config: ServeConfig,
    listener: TcpListener,
    sila: Option<sila::Bound>,
}

/// Listens and answers until `shutdown` completes; combines [`bind`] and [`Server::run`].
///
/// # Errors
/// As [`bind`] and [`Server::run`].
pub async fn serve(
    app: App,
    config: ServeConfig,
    shutdown: impl Future<Output = ()> + Send,
) -> Result<(), ServeError> {
    bind(app, config)?.run(shutdown).await
}

/// Binds the address, so that the caller can report it before the service runs.
///
/// # Errors
/// [`ServeError::Exposed`] for an address reachable unencrypted from other machines,
/// [`ServeError::Refused`] for settings of SiLA 2 that would expose the bench,
/// [`ServeError::Listen`] if an address is not free.
pub fn bind(app: App, config: ServeConfig) -> Result<Server, ServeError> {
    let listener = config.listen()?;
    let sila = config.sila.clone().map(|it| sila::bind(&app, it)).transpose()?;
    Ok(Server { app, config, listener, sila })
}

impl Server {
    /// The address the service listens on.
    ///
    /// # Errors
    /// The system's error.
    pub fn address(&self) -> Result<SocketAddr, ServeError> {
        Ok(self.listener.local_addr()?)
    }

    /// The address of the SiLA server, if there is one.
    ///
    /// # Errors
    /// The system's error.
    pub fn sila_address(&self) -> Result<Option<SocketAddr>, ServeError> {
        Ok(self.sila.as_ref().map(sila::Bound::address).transpose()?)
    }

    /// Answers until `shutdown` completes. Then accepts no more connections, gives open requests
    /// [`DRAIN`] to finish, and closes the application: the spoon is levelled, running jobs save a
    /// checkpoint, event streams end.
    ///
    /// # Errors
    /// [`ServeError::Tls`] for unusable certificates, [`ServeError::Broken`] if the server fails.
    pub async fn run(self, shutdown: impl Future<Output = ()> + Send) -> Result<(), ServeError> {
        let closing = CancellationToken::new();
        // However this ends, the followers of tokens, health and the journal must not outlive it.
        let _ending = closing.clone().drop_guard();
        let tls = self.config.tls()?;
        let main = main_router(&self.app, closing.clone());
        let router =
            front::router(self.app.clone(), self.config.is_loopback(), main, closing.clone());
        let front = Front::open(self.listener, tls, router, closing.clone())?;
        let sila = self.sila.map(|it| it.open(&self.app, closing.clone())).transpose()?;
        tokio::spawn(closing.clone().run_until_cancelled_owned(self.app.clone().keep_tokens()));
        tokio::spawn(closing.clone().run_until_cancelled_owned(self.app.clone().greet_provider()));
        tokio::spawn(journal::keep(self.app.clone(), closing.clone()));
        tokio::spawn(webhooks::keep(self.app.clone(), closing.clone()));
        shutdown.await;
        closing.cancel();
        let close = async {
            if let Err(error) = self.app.shutdown().await {
                tracing::error!(%error, "the application did not close cleanly");
            }
        };
        let leave_sila = async {
            if let Some(sila) = &sila {
                sila.front.leave(DRAIN).await;
            }
        };
        tokio::join!(front.leave(DRAIN), leave_sila, close);
        Ok(())
    }
}

/// Not event streams and gRPC, which must arrive as they are sent, nor problems, which [`edge`] writes
/// once more.
fn is_compressed() -> impl Predicate {
    DefaultPredicate::new().and(NotForContentType::const_new("application/problem+json"))
}

/// Everything that the front end hands over.
fn main_router(app: &App, closing: CancellationToken) -> Router {
    rest::router(app.clone())
        .merge(grpc::router(app.clone(), closing))
        .merge(madsci::router(app.clone()))
        .merge(probes::metrics(app.clone()))
        .fallback(page::fallback)
        .layer(CompressionLayer::new().compress_when(is_compressed()))
        .layer(from_fn(auth::on_behalf))
        .layer(from_fn(asked::as_of_head))
        .layer(CatchPanicLayer::custom(edge::panicked))
        .layer(from_fn(edge::tell_route))
}
