//! The service's front end: dedicated threads that accept connections, read request heads, and
//! carry stops through.
//!
//! ```text
//!  socket ─► table ─► TLS ─► HTTP ─► edge, origin, token ─┬─► stop ────────────────────────► bench
//!            (room for one more)                        ├─► /healthz, /readyz
//!                                                       └─► hall: role, body, seat ─► main runtime: every other route
//! ```
//!
//! Nothing here computes, queries the database or waits for a driver, so a stop is read and carried
//! out whatever the rest of the service does and whatever clients do to it. `table.rs` and
//! `connection.rs` decide which connections stay open, `hall.rs` and `arrival.rs` what a request
//! has to wait for.

mod answer;
mod arrival;
mod connection;
mod descriptors;
mod hall;
mod handshake;
mod stop;
mod table;
mod wire;

pub use connection::{Connection, Kind};

use super::complaint::Complaint;
use super::{asked, auth, edge, probes};
use crate::app::App;
use answer::Answer;
use axum::Router;
use axum::body::Body;
use axum::extract::{Extension, Request};
use axum::middleware::{Next, from_fn, from_fn_with_state};
use axum::response::Response;
use connection::HEAD;
use hall::{Hall, hall, is_stream};
use handshake::Handshakes;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto;
use hyper_util::service::TowerToHyperService;
use std::io;
use std::net::TcpListener;
use std::pin::pin;
use std::sync::Arc;
use std::time::{Duration, Instant};
use table::{Place, Table};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio::runtime::{Handle, Runtime};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio_rustls::TlsAcceptor;
use tokio_util::sync::CancellationToken;
use tower::Layer;
use tower_http::catch_panic::CatchPanicLayer;
use wire::Wire;

/// I/O threads; two, so that one that is busy decrypting does not delay a stop.
const THREADS: usize = 2;
/// Connections that may be open beyond the table's capacity: those it has just closed.
const CLOSING: usize = 16;
/// One in this many of all descriptors is for connections of a small front end.
const SHARE: usize = 8;
/// How often connections are checked.
const SWEEP: Duration = Duration::from_millis(500);
/// Maximum concurrent requests on one HTTP/2 connection: more than event streams and waiting stops
/// may take together, so that there is always room for a stop.
const HTTP2_STREAMS: u32 = 192;
/// Maximum size of a request head, and read-ahead per connection, bytes.
const HEAD_BYTES: usize = 32 * 1024;
/// Flow-control windows of HTTP/2, bytes: per request, and per connection.
const HTTP2_AHEAD: [u32; 2] = [128 * 1024, 512 * 1024];

/// The running front end; stops when dropped.
pub struct Front {
    /// Its own runtime and, with TLS, the handshake runtime; kept until it is dropped.
    runtimes: Vec<Runtime>,
    doors: Doors,
}

/// Shared by all connections; cheap to clone.
#[derive(Clone)]
struct Doors {
    table: Arc<Table>,
    /// Bounds the descriptors, independently of the table's bookkeeping.
    free: Arc<Semaphore>,
    handshakes: Option<Handshakes>,
    http: Arc<auto::Builder<TokioExecutor>>,
    router: Router,
    closing: CancellationToken,
}

impl Front {
    /// Starts accepting connections; requests other than stops go to `main`, on the runtime this is
    /// called on.
    ///
    /// # Errors
    /// The system cannot spawn threads.
    pub fn open(
        listener: TcpListener,
        tls: Option<TlsAcceptor>,
        router: Router,
        closing: CancellationToken,
    ) -> io::Result<Self> {
        Self::with_room(listener, tls, router, closing, descriptors::room())
    }

    /// As [`Front::open`], for at most this many connections beside the others of the process.
    ///
    /// # Errors
    /// As [`Front::open`].
    pub fn open_small(
        listener: TcpListener,
        tls: Option<TlsAcceptor>,
        router: Router,
        closing: CancellationToken,
        most: usize,
    ) -> io::Result<Self> {
        let room = (descriptors::room() / SHARE).min(most);
        Self::with_room(listener, tls, router, closing, room.max(1))
    }

    fn with_room(
        listener: TcpListener,
        tls: Option<TlsAcceptor>,
        router: Router,
        closing: CancellationToken,
        room: usize,
    ) -> io::Result<Self> {
        let (handshakes, shaking) = tls.map(Handshakes::with).transpose()?.unzip();
        let doors = Doors {
            table: Arc::new(Table::new(room)),
            free: Arc::new(Semaphore::new(room + CLOSING)),
            handshakes,
            http: Arc::new(http()),
            router,
            closing,
        };
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(THREADS)
            .thread_name("front")
            .enable_all()
            .build()?;
        runtime.spawn(doors.clone().take_all(listener));
        runtime.spawn(doors.clone().sweep());
        Ok(Self { runtimes: shaking.into_iter().chain([runtime]).collect(), doors })
    }

    /// Lets open requests finish, for at most `limit`; then closes every connection.
    pub async fn leave(&self, limit: Duration) {
        self.doors.closing.cancel();
        let all = u32::try_from(self.doors.table.room() + CLOSING).unwrap_or(u32::MAX);
        self.doors.table.all(|connection| connection.leave.cancel());
        let _all_ended = tokio::time::timeout(limit, self.doors.free.acquire_many(all)).await;
        self.doors.table.all(|connection| connection.cut.cancel());
    }
}

impl Drop for Front {
    fn drop(&mut self) {
        self.runtimes.drain(..).for_each(Runtime::shutdown_background);
    }
}

/// Everything from the head of a request to its response; `main` answers all but stops and liveness
/// probes.
pub fn router(app: App, loopback: bool, main: Router, closing: CancellationToken) -> Router {
    let gate = auth::Gate { app: app.clone(), loopback };
    stop::router(app.clone(), &Handle::current())
        .merge(probes::alive(app.clone(), closing))
        .fallback_service(
            Router::new().fallback(hall).with_state(Hall::new(Handle::current(), main)),
        )
        .layer(from_fn(known))
        .layer(from_fn_with_state(gate, auth::identify))
        .layer(from_fn(auth::same_origin))
        .layer(from_fn(auth::one_host))
        .layer(CatchPanicLayer::custom(edge::panicked))
        .layer(from_fn(edge::edge))
        .layer(from_fn(follow))
        .layer(from_fn_with_state(app, asked::at_head))
}

/// Registers the request with its connection.
async fn follow(
    Extension(connection): Extension<Arc<Connection>>,
    request: Request,
    next: Next,
) -> Response {
    let kind = if is_stream(request.uri()) { Kind::Stream } else { Kind::Ordinary };
    registered(&connection, kind, request, next).await
}

/// Answers a request that is registered with its connection until the last of the answer is sent.
pub async fn registered(
    connection: &Arc<Connection>,
    kind: Kind,
    request: Request,
    next: Next,
) -> Response {
    let under_way = connection.begin(kind);
    next.run(request).await.map(|body| Body::new(Answer::new(body, under_way)))
}

/// Records on the connection that the caller holds a token.
async fn known(
    Extension(connection): Extension<Arc<Connection>>,
    request: Request,
    next: Next,
) -> Response {
    if !auth::Caller::of(request.extensions()).is_anonymous() {
        connection.shown_token();
    }
    next.run(request).await
}

fn http() -> auto::Builder<TokioExecutor> {
    let mut http = auto::Builder::new(TokioExecutor::new());
    http.http1().timer(TokioTimer::new()).header_read_timeout(HEAD).max_buf_size(HEAD_BYTES);
    let [stream, connection] = HTTP2_AHEAD;
    http.http2()
        .timer(TokioTimer::new())
        .keep_alive_interval(HEAD)
        .max_concurrent_streams(HTTP2_STREAMS)
        .max_header_list_size(HEAD_BYTES as u32)
        .initial_stream_window_size(stream)
        .initial_connection_window_size(connection);
    http
}

impl Doors {
    async fn take_all(self, listener: TcpListener) {
        let listener = match tokio::net::TcpListener::from_std(listener) {
            Ok(listener) => listener,
            Err(error) => return tracing::error!(%error, "no connection can be taken"),
        };
        let no_descriptor = Complaint::default();
        loop {
            let Ok(door) = self.free.clone().acquire_owned().await else { return };
            let taken = tokio::select! {
                taken = listener.accept() => taken,
                () = self.closing.cancelled() => return,
            };
            match taken {
                // Admitted here, in order of arrival: tasks may start in any order.
                Ok((stream, peer)) => {
                    let place = self.table.admit(peer.ip(), Instant::now());
                    self.clone().begin(stream, place, door);
                }
                Err(error) => self.make_room(&error, &no_descriptor).await,
            }
        }
    }

    /// A connection could not be accepted, usually because something else has used up the
    /// descriptors.
    async fn make_room(&self, error: &io::Error, complaint: &Complaint) {
        let error = error.to_string();
        complaint.happened(1, move |times| {
            tracing::warn!(
                error,
                times,
                "a connection could not be taken: the least useful one is closed for it"
            );
        });
        self.table.give_way();
        tokio::time::sleep(Duration::from_millis(5)).await;
    }

    async fn sweep(self) {
        let mut every = tokio::time::interval(SWEEP);
        loop {
            every.tick().await;
            self.table.sweep(Instant::now());
        }
    }

    /// Serves a connection; with TLS, once the handshake is done.
    fn begin(self, stream: TcpStream, place: Place, door: OwnedSemaphorePermit) {
        // Without it the connection is only slower.
        let _nodelay = stream.set_nodelay(true);
        let connection = place.connection.clone();
        let wire = Wire::new(stream, connection.clone());
        let Some(handshakes) = self.handshakes.clone() else {
            return drop(tokio::spawn(self.serve(wire, place, door)));
        };
        let (front, thread) = (Handle::current(), handshakes.thread.clone());
        thread.spawn(async move {
            let shaken = handshakes.shake(wire, connection.peer);
            if let Some(Some(stream)) = connection.cut.run_until_cancelled(shaken).await {
                front.spawn(self.serve(stream, place, door));
            }
        });
    }

    async fn serve(
        self,
        stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
        place: Place,
        _door: OwnedSemaphorePermit,
    ) {
        let connection = &place.connection;
        connection.cut.run_until_cancelled(self.speak(stream, connection)).await;
    }

    /// Answers requests until either side closes; errors on the connection are left for the client
    /// to notice.
    async fn speak(
        &self,
        stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
        connection: &Arc<Connection>,
    ) {
        let service =
            TowerToHyperService::new(Extension(connection.clone()).layer(self.router.clone()));
        let mut conversation = pin!(self.http.serve_connection(TokioIo::new(stream), service));
        tokio::select! {
            _ended = conversation.as_mut() => {}
            () = connection.leave.cancelled() => {
                conversation.as_mut().graceful_shutdown();
                let _ended = conversation.await;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustls::crypto::ring::sign::any_supported_type;
    use rustls::pki_types::PrivateKeyDer;
    use rustls::server::{ClientHello, ResolvesServerCert};
    use rustls::sign::CertifiedKey;
    use rustls::{ClientConfig, RootCertStore, ServerConfig};
    use std::net::SocketAddr;
    use std::sync::mpsc;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio_rustls::TlsConnector;
    use tokio_rustls::client::TlsStream;

    /// Reports each handshake, and lets it continue with the next permit.
    #[derive(Debug)]
    struct Slow {
        key: Arc<CertifiedKey>,
        begun: tokio::sync::mpsc::UnboundedSender<()>,
        permits: std::sync::Mutex<mpsc::Receiver<()>>,
    }

    impl ResolvesServerCert for Slow {
        fn resolve(&self, _hello: ClientHello<'_>) -> Option<Arc<CertifiedKey>> {
            self.begun.send(()).ok()?;
            self.permits.lock().unwrap().recv().ok()?;
            Some(self.key.clone())
        }
    }

    async fn connect(
        address: SocketAddr,
        roots: RootCertStore,
    ) -> io::Result<TlsStream<TcpStream>> {
        let config = ClientConfig::builder().with_root_certificates(roots).with_no_client_auth();
        let stream = TcpStream::connect(address).await?;
        TlsConnector::from(Arc::new(config)).connect("localhost".try_into().unwrap(), stream).await
    }

    #[tokio::test]
    async fn handshakes_that_compute_for_ever_hold_up_no_established_connection() {
        let made = rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
        let mut roots = RootCertStore::empty();
        roots.add(made.cert.der().clone()).unwrap();
        let key =
            any_supported_type(&PrivateKeyDer::Pkcs8(made.signing_key.serialize_der().into()))
                .unwrap();
        let key = Arc::new(CertifiedKey::new(vec![made.cert.der().clone()], key));
        let ((begun, mut begins), (permit, permits)) =
            (tokio::sync::mpsc::unbounded_channel(), mpsc::channel());
        let slow = Slow { key, begun, permits: permits.into() };
        let tls = ServerConfig::builder().with_no_client_auth().with_cert_resolver(Arc::new(slow));

        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        listener.set_nonblocking(true).unwrap();
        let address = listener.local_addr().unwrap();
        let router = Router::new().route("/", axum::routing::get(async || "here"));
        let _front =
            Front::open(listener, Some(Arc::new(tls).into()), router, CancellationToken::new())
                .unwrap();
        permit.send(()).unwrap();
        let mut established = connect(address, roots.clone()).await.unwrap();
        begins.recv().await.unwrap();
        let waiting: Vec<_> =
            (0..8).map(|_| tokio::spawn(connect(address, roots.clone()))).collect();
        // One of them computes, and none of them gets any further.
        begins.recv().await.unwrap();
        for _ in 0..8 {
            established.write_all(b"GET / HTTP/1.1\r\nhost: localhost\r\n\r\n").await.unwrap();
            let mut answer = Vec::new();
            while !answer.ends_with(b"here") {
                let read = tokio::time::timeout(
                    Duration::from_secs(20),
                    established.read_buf(&mut answer),
                )
                .await;
                assert!(read.expect("an established connection is answered").unwrap() > 0);
            }
        }
        assert!(waiting.iter().all(|it| !it.is_finished()));
        // Those waiting for a permit learn that none will come.
        drop(permit);
    }
}
