//! `flip health`: is a service alive? For containers, which have no other HTTP client.

use super::Common;
use super::failure::Failure;
use super::server::Request;
use super::session::there;
use anyhow::{Context, anyhow};
use serde::Serialize;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

/// Timeout for each of connecting, requesting and responding.
const PATIENCE: Duration = Duration::from_secs(3);
/// Enough of the response to hold its status line.
const STATUS_LINE_BYTES: u64 = 64;

/// Arguments of `flip health`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Address and port of the service; plain HTTP only.
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:8080")]
    listen: SocketAddr,
}

#[derive(Debug, Serialize)]
struct Document {
    alive: bool,
}

/// Exit status 0 if the service answers `/healthz` with 200, else 1.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    if let Some(server) = common.server()? {
        let alive = Request::outside("/healthz");
        there(server.clone(), async |_| Ok(server.answer(alive).await.map(drop)?))?;
        return common.print(&Document { alive: true }, || "alive".into());
    }
    let status = ask(arguments.listen)
        .with_context(|| format!("no service answers at {}", arguments.listen))?;
    match status.split(' ').nth(1) {
        Some("200") => common.print(&Document { alive: true }, || "alive".into()),
        _ => Err(anyhow!("{} answers `{}`", arguments.listen, status.trim()).into()),
    }
}

/// Whether a service answers at this address.
pub(super) fn is_alive(address: SocketAddr) -> bool {
    ask(address).is_ok_and(|status| status.split(' ').nth(1) == Some("200"))
}

/// The status line of the response to `GET /healthz`.
fn ask(address: SocketAddr) -> std::io::Result<String> {
    let mut connection = TcpStream::connect_timeout(&address, PATIENCE)?;
    connection.set_read_timeout(Some(PATIENCE))?;
    connection.set_write_timeout(Some(PATIENCE))?;
    // In a single write: a service that responds after the first of several and closes would break
    // the pipe for the others.
    let request = format!("GET /healthz HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
    connection.write_all(request.as_bytes())?;
    let mut answer = Vec::new();
    connection.take(STATUS_LINE_BYTES).read_to_end(&mut answer)?;
    Ok(String::from_utf8_lossy(&answer).lines().next().unwrap_or_default().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::TcpListener;

    /// A service that answers one request with `answer`.
    fn service(answer: &'static str) -> SocketAddr {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        std::thread::spawn(move || {
            let (mut connection, _) = listener.accept().unwrap();
            let mut request = [0; 1024];
            let _ = connection.read(&mut request).unwrap();
            connection.write_all(answer.as_bytes()).unwrap();
        });
        address
    }

    #[test]
    fn the_status_line_is_all_that_counts() {
        assert_eq!(ask(service("HTTP/1.1 200 OK\r\n\r\nalive\n")).unwrap(), "HTTP/1.1 200 OK");
        assert_eq!(
            ask(service("HTTP/1.1 503 Service Unavailable\r\n\r\n")).unwrap(),
            "HTTP/1.1 503 Service Unavailable"
        );
    }

    #[test]
    fn a_closed_port_is_an_error() {
        let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        assert!(ask(free).is_err());
    }
}
