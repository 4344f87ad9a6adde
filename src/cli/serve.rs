//! `flip serve`: REST, gRPC and the web page on one port, SiLA 2 on another if asked for, until
//! SIGTERM or Ctrl-C.

use super::Common;
use super::benches::BenchArguments;
use super::failure::Failure;
use super::oidc::OidcArguments;
use super::session::{StopSignals, service_runtime};
use super::token;
use crate::api::sila::SilaConfig;
use crate::api::{self, ServeConfig, ServeError, Server, Tls};
use crate::app::{App, DEFAULT_BENCH, Options, Storage, Workers, check_bench_name};
use crate::telemetry;
use clap::ValueEnum;
use flip_core::domain::FieldError;
use serde::Serialize;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

/// Arguments of `flip serve`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    address: Address,
    #[command(flatten)]
    bench: BenchArguments,
    /// Name of this bench among those of a server's database, each of which has one process
    /// [default: bench].
    #[arg(long, value_name = "NAME")]
    bench_name: Option<String>,
    /// Name of the laboratory, at the head of certificates.
    #[arg(long, value_name = "NAME")]
    laboratory: Option<String>,
    #[command(flatten)]
    sila: SilaArguments,
    #[command(flatten)]
    oidc: OidcArguments,
    /// Format of log lines on stderr; FLIP_LOG selects which are shown, e.g. FLIP_LOG=flip=debug.
    #[arg(long, value_enum, default_value_t = LogFormat::Text)]
    log_format: LogFormat,
}

/// Where to listen.
#[derive(Debug, Clone, clap::Args)]
pub(super) struct Address {
    /// Address and port; port 0 lets the system choose.
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:8080")]
    pub(super) listen: SocketAddr,
    /// Certificate chain, PEM; turns on TLS.
    #[arg(long, value_name = "FILE", requires = "tls_key")]
    tls_cert: Option<PathBuf>,
    /// Private key of the certificate, PEM.
    #[arg(long, value_name = "FILE", requires = "tls_cert")]
    tls_key: Option<PathBuf>,
    /// Allow listening beyond this machine without TLS: tokens and results cross the network in
    /// clear text.
    #[arg(long)]
    insecure_lan: bool,
}

/// SiLA 2 (docs/interfaces.md).
#[derive(Debug, Clone, clap::Args)]
struct SilaArguments {
    /// Also serve SiLA 2 here, for schedulers: address and port; port 0 lets the system choose. With
    /// TLS; without --tls-cert by a certificate of its own, which the data folder keeps.
    #[arg(long, value_name = "ADDRESS")]
    sila: Option<SocketAddr>,
    /// Serve SiLA 2 without TLS; on loopback addresses only.
    #[arg(long, requires = "sila")]
    sila_insecure: bool,
    /// Name of an operator's or viewer's token by which SiLA clients act that send no access token:
    /// some cannot, and whoever reaches the port then acts by it [default: none].
    #[arg(long, value_name = "NAME", requires = "sila")]
    sila_role: Option<String>,
    /// Let SiLA clients lock the server, which reserves the bench; some clients then have to send the
    /// lock with every call.
    #[arg(long, requires = "sila")]
    sila_lock: bool,
    /// Do not announce the SiLA server on its network.
    #[arg(long, requires = "sila")]
    sila_unannounced: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
pub(super) enum LogFormat {
    Text,
    Json,
}

/// Document printed by `flip serve --json` once it listens.
#[derive(Debug, Serialize)]
struct Document {
    url: String,
    /// Where SiLA 2 is served, if it is.
    #[serde(skip_serializing_if = "Option::is_none")]
    sila: Option<String>,
    /// An admin's token, on the first start only.
    token: Option<String>,
}

impl Arguments {
    /// What is stored, served with the named bench.
    fn storage(&self, common: &Common) -> Result<Storage, Failure> {
        let storage = common.storage()?;
        let Some(name) = &self.bench_name else { return Ok(storage) };
        check_bench_name(name)?;
        if !storage.is_on_server() && name != DEFAULT_BENCH {
            let advice = "a data folder has one bench, which needs no name: leave it out, or name a server's database with --database-url";
            return Err(FieldError::new("bench_name", advice).into());
        }
        Ok(storage.with_bench(name))
    }
}

/// Serves until asked to stop.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    telemetry::start(arguments.log_format.into(), telemetry::SERVICE);
    service_runtime()?.block_on(async {
        let signals = StopSignals::catch()?;
        let options = Options {
            workers: Workers::GiveWay,
            laboratory: arguments.laboratory.clone(),
            oidc: arguments.oidc.provider()?,
            ..arguments.bench.options()?
        };
        let app = App::open(arguments.storage(common)?, options).await?;
        let sila = arguments.sila.config(&common.data_dir, &arguments.address);
        let server = match bind(&app, &arguments.address, sila) {
            Ok(server) => server,
            Err(failure) => {
                app.shutdown().await?;
                return Err(failure);
            }
        };
        let document = Document {
            url: arguments.address.url(&server)?,
            sila: server.sila_address()?.map(|address| format!("sila://{address}")),
            token: token::first(&app).await?,
        };
        if common.print(&document, || text(&document)).is_err() {
            // The bench may be in use already.
            tracing::warn!(
                url = document.url,
                "nobody reads stdout; `flip token create` makes a token if one is needed"
            );
        }
        server.run(stopped(signals)).await?;
        Ok(())
    })
}

/// Binds the address before any long work: a port that is taken should be reported at once.
pub(super) fn bind(
    app: &App,
    address: &Address,
    sila: Option<SilaConfig>,
) -> Result<Server, Failure> {
    // A settings file may give only one of the two, which clap does not check.
    if address.tls_cert.is_some() != address.tls_key.is_some() {
        let message =
            "certificate and key go together: name both files, or neither to speak without TLS";
        return Err(FieldError::new("tls_cert", message).into());
    }
    let config = ServeConfig {
        listen: address.listen,
        tls: address.tls(),
        insecure_lan: address.insecure_lan,
        sila,
    };
    Ok(api::bind(app.clone(), config)?)
}

impl SilaArguments {
    fn config(&self, data_dir: &Path, address: &Address) -> Option<SilaConfig> {
        let listen = self.sila?;
        Some(SilaConfig {
            listen,
            data_dir: data_dir.to_owned(),
            tls: address.tls(),
            insecure: self.sila_insecure,
            role: self.sila_role.clone(),
            lock: self.sila_lock,
            announce: !self.sila_unannounced,
        })
    }
}

impl Address {
    fn tls(&self) -> Option<Tls> {
        let files = self.tls_cert.clone().zip(self.tls_key.clone());
        files.map(|(certificate, key)| Tls { certificate, key })
    }

    /// The address to open in a browser.
    pub(super) fn url(&self, server: &Server) -> Result<String, Failure> {
        let scheme = if self.tls_cert.is_some() { "https" } else { "http" };
        Ok(format!("{scheme}://{}", server.address()?))
    }
}

/// The message of a first start about its token.
pub(super) fn announce(token: &str) -> String {
    format!(
        "admin token (shown once; `flip token create` makes others, `flip token revoke` ends one): {token}"
    )
}

/// Completes when the process is asked to stop.
async fn stopped(mut signals: StopSignals) {
    let signal = signals.received().await;
    tracing::info!(signal, "shutting down");
}

fn text(document: &Document) -> String {
    let token =
        document.token.as_deref().map_or(String::new(), |token| format!("\n{}", announce(token)));
    let sila = document.sila.as_deref().map_or(String::new(), |at| format!(", SiLA 2 at {at}"));
    format!("FLIP serves {}{sila}{token}", document.url)
}

impl From<LogFormat> for telemetry::Format {
    fn from(format: LogFormat) -> Self {
        match format {
            LogFormat::Text => Self::Text,
            LogFormat::Json => Self::Json,
        }
    }
}

impl From<ServeError> for Failure {
    fn from(error: ServeError) -> Self {
        match error {
            ServeError::Exposed(_) => FieldError::new("listen", error.to_string()).into(),
            ServeError::Tls(_) => FieldError::new("tls_cert", error.to_string()).into(),
            ServeError::Refused(error) => error.into(),
            error => Self::Failed(error.into()),
        }
    }
}
