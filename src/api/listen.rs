//! Where the service listens, and what it refuses to expose.

use super::sila::SilaConfig;
use crate::app::FieldError;
use rustls::ServerConfig;
use rustls::crypto::ring;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::path::PathBuf;
use std::sync::Arc;
use tokio_rustls::TlsAcceptor;

/// Listen backlog: a flood of connections fills a short queue, and a stop then waits a second for
/// its retry.
const BACKLOG: i32 = 4096;

/// Where and how to serve.
#[derive(Debug, Clone)]
pub struct ServeConfig {
    /// Address and port; port 0 lets the system choose.
    pub listen: SocketAddr,
    /// Certificate chain and private key, PEM files.
    pub tls: Option<Tls>,
    /// Accept a non-loopback address without TLS: tokens then cross the network in clear text.
    pub insecure_lan: bool,
    /// Where and how to serve SiLA 2 besides, if at all.
    pub sila: Option<SilaConfig>,
}

/// PEM files of a TLS server.
#[derive(Debug, Clone)]
pub struct Tls {
    /// Certificate chain, leaf first.
    pub certificate: PathBuf,
    /// Private key.
    pub key: PathBuf,
}

/// Why the service did not start or did not end well.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// An address reachable from other machines, without encryption and without the explicit flag.
    #[error(
        "{0} can be reached from other machines: give --tls-cert and --tls-key, or accept readable traffic with --insecure-lan"
    )]
    Exposed(SocketAddr),
    /// Settings that would let others at the bench, by the option that does.
    #[error("{0}")]
    Refused(FieldError),
    /// The port is taken or the address is not local.
    #[error("cannot listen on {address}: {source}")]
    Listen {
        /// The requested address.
        address: SocketAddr,
        /// The system's error.
        source: std::io::Error,
    },
    /// The certificate or the key cannot be used.
    #[error("TLS files cannot be used: {0}")]
    Tls(std::io::Error),
    /// The server failed.
    #[error("the server stopped: {0}")]
    Broken(#[from] std::io::Error),
}

impl ServeConfig {
    /// Plain HTTP on `listen`, which must be a loopback address.
    pub fn loopback(listen: SocketAddr) -> Self {
        Self { listen, tls: None, insecure_lan: false, sila: None }
    }

    /// Whether only this machine can reach the address.
    pub fn is_loopback(&self) -> bool {
        self.listen.ip().is_loopback()
    }

    /// A bound listener.
    ///
    /// # Errors
    /// [`ServeError::Exposed`] before anything is bound; [`ServeError::Listen`] from the system.
    pub fn listen(&self) -> Result<TcpListener, ServeError> {
        if !self.is_loopback() && self.tls.is_none() && !self.insecure_lan {
            return Err(ServeError::Exposed(self.listen));
        }
        listener(self.listen)
    }

    /// Loads the TLS settings from their files.
    ///
    /// # Errors
    /// [`ServeError::Tls`] if a file is missing, is not PEM, or certificate and key do not belong
    /// together.
    pub fn tls(&self) -> Result<Option<TlsAcceptor>, ServeError> {
        self.tls.as_ref().map(Tls::acceptor).transpose()
    }
}

/// A bound listener.
///
/// # Errors
/// [`ServeError::Listen`] from the system.
pub fn listener(address: SocketAddr) -> Result<TcpListener, ServeError> {
    let broken = |source| ServeError::Listen { address, source };
    let listener = TcpListener::bind(address).map_err(broken)?;
    // A second call only extends the queue beyond the standard library's 128.
    rustix::net::listen(&listener, BACKLOG).map_err(|error| broken(error.into()))?;
    listener.set_nonblocking(true).map_err(broken)?;
    Ok(listener)
}

impl Tls {
    /// Speaks TLS with these files.
    ///
    /// # Errors
    /// As [`ServeConfig::tls`].
    pub fn acceptor(&self) -> Result<TlsAcceptor, ServeError> {
        // A second call in the same process finds the provider already installed, which is fine.
        let _installed = ring::default_provider().install_default();
        let config =
            self.config().map_err(|error| ServeError::Tls(std::io::Error::other(error)))?;
        Ok(TlsAcceptor::from(Arc::new(config)))
    }

    fn config(&self) -> Result<ServerConfig, Box<dyn std::error::Error + Send + Sync>> {
        let certificates =
            CertificateDer::pem_file_iter(&self.certificate)?.collect::<Result<Vec<_>, _>>()?;
        let key = PrivateKeyDer::from_pem_file(&self.key)?;
        let mut config =
            ServerConfig::builder().with_no_client_auth().with_single_cert(certificates, key)?;
        config.alpn_protocols = vec![b"h2".to_vec(), b"http/1.1".to_vec()];
        Ok(config)
    }
}

/// Whether a Host header or authority, with or without port, names this machine.
///
/// A page elsewhere can point its own name at 127.0.0.1 (DNS rebinding) and then read as if it were
/// ours; the host name gives it away.
pub fn is_loopback_name(authority: &str) -> bool {
    let Ok(authority) = authority.parse::<axum::http::uri::Authority>() else { return false };
    if authority.as_str().contains('@') {
        return false;
    }
    let host = authority.host();
    let address = host.trim_start_matches('[').trim_end_matches(']').parse::<IpAddr>();
    host.eq_ignore_ascii_case("localhost") || address.is_ok_and(|ip| ip.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_names_of_this_machine_count_as_loopback() {
        for name in
            ["localhost", "LOCALHOST:8080", "127.0.0.1:1", "127.9.9.9", "[::1]:8080", "[::1]"]
        {
            assert!(is_loopback_name(name), "{name}");
        }
        for name in [
            "localhost.evil.example",
            "example.org:8080",
            "10.0.0.1",
            "127.0.0.1.nip.io",
            "evil@127.0.0.1",
            "",
            "a b",
        ] {
            assert!(!is_loopback_name(name), "{name}");
        }
    }

    #[test]
    fn an_exposed_address_is_refused_before_it_is_bound() {
        let exposed = ServeConfig::loopback("0.0.0.0:0".parse().unwrap());
        assert!(matches!(exposed.listen(), Err(ServeError::Exposed(_))));
        assert!(ServeConfig { insecure_lan: true, ..exposed }.listen().is_ok());
    }
}
