//! The gripper's wire: a serial port or a TCP connection whose frames are all recorded by the tap.

use super::DEVICE;
use crate::hardware::wire::Tap;
use std::io;
use std::net::ToSocketAddrs;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio_serial::SerialStream;

const BAUD: u32 = 115_200;
/// Connect timeout.
const CONNECT: Duration = Duration::from_secs(3);

trait Stream: AsyncRead + AsyncWrite + Unpin + Send {}
impl<T: AsyncRead + AsyncWrite + Unpin + Send> Stream for T {}

fn connect(address: &str) -> io::Result<TcpStream> {
    let unknown = || io::Error::new(io::ErrorKind::NotFound, "no such host");
    let address = address.to_socket_addrs()?.next().ok_or_else(unknown)?;
    let stream = std::net::TcpStream::connect_timeout(&address, CONNECT)?;
    stream.set_nodelay(true)?;
    stream.set_nonblocking(true)?;
    TcpStream::from_std(stream)
}

/// The stream under Modbus: passes every frame to the tap, and discards input that arrived before a
/// request. Clones are the same stream.
#[derive(Clone)]
pub(super) struct Wire {
    ends: Arc<Mutex<Ends>>,
}

struct Ends {
    stream: Box<dyn Stream>,
    tap: Tap,
    /// Bytes received since the last request.
    heard: Vec<u8>,
}

impl Wire {
    /// Open `port`, a path or `tcp://host:port`, within a runtime.
    pub(super) fn open(port: &str, tap: Tap) -> io::Result<Self> {
        let stream: Box<dyn Stream> = match port.strip_prefix("tcp://") {
            Some(address) => Box::new(connect(address)?),
            None => Box::new(SerialStream::open(&tokio_serial::new(port, BAUD))?),
        };
        Ok(Self { ends: Arc::new(Mutex::new(Ends { stream, tap, heard: Vec::new() })) })
    }

    /// Bytes received since the last request.
    pub(super) fn heard(&self) -> Vec<u8> {
        self.ends().heard.clone()
    }

    fn ends(&self) -> MutexGuard<'_, Ends> {
        self.ends.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Ends {
    /// Read available bytes.
    fn poll_take(
        &mut self,
        waker: &mut Context<'_>,
        into: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = into.filled().len();
        std::task::ready!(Pin::new(&mut self.stream).poll_read(waker, into))?;
        let came = &into.filled()[before..];
        if came.is_empty() {
            return Poll::Ready(Err(io::Error::new(
                io::ErrorKind::UnexpectedEof,
                "the connection was closed",
            )));
        }
        self.tap.received(DEVICE, shown(came));
        self.heard.extend_from_slice(came);
        Poll::Ready(Ok(()))
    }
}

impl AsyncRead for Wire {
    fn poll_read(
        self: Pin<&mut Self>,
        waker: &mut Context<'_>,
        into: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        self.ends().poll_take(waker, into)
    }
}

impl AsyncWrite for Wire {
    fn poll_write(
        self: Pin<&mut Self>,
        waker: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let mut ends = self.ends();
        let mut late = [0; 256];
        while let Poll::Ready(taken) = ends.poll_take(waker, &mut ReadBuf::new(&mut late)) {
            taken?;
        }
        let count = std::task::ready!(Pin::new(&mut ends.stream).poll_write(waker, bytes))?;
        ends.tap.sent(DEVICE, shown(&bytes[..count]));
        ends.heard.clear();
        Poll::Ready(Ok(count))
    }

    fn poll_flush(self: Pin<&mut Self>, waker: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.ends().stream).poll_flush(waker)
    }

    fn poll_shutdown(self: Pin<&mut Self>, waker: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.ends().stream).poll_shutdown(waker)
    }
}

/// Bytes in Modbus notation: `09 03 07 D0`.
pub(super) fn shown(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02X}")).collect::<Vec<_>>().join(" ")
}
