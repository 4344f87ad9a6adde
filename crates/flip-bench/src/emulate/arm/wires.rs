//! The TCP connections of an emulated driver, which can be cut.

use std::net::{Shutdown, TcpListener};
use std::os::fd::AsFd;
use std::sync::{Arc, Mutex, PoisonError};
use tokio::net::TcpStream;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;

/// Maximum number of connections waiting to be served.
const WAITING_MAX: usize = 16;

/// Every open connection. Clones share them.
#[derive(Clone, Default)]
pub(super) struct Wires(Arc<Mutex<Open>>);

#[derive(Default)]
struct Open {
    is_cut: bool,
    streams: Vec<std::net::TcpStream>,
}

impl Wires {
    /// Break every connection, including new ones, until [`Wires::mend`].
    pub(super) fn cut(&self) {
        let mut open = self.locked();
        open.is_cut = true;
        for stream in open.streams.drain(..) {
            // The other end may have closed it already.
            let _ = stream.shutdown(Shutdown::Both);
        }
    }

    pub(super) fn mend(&self) {
        self.locked().is_cut = false;
    }

    /// Accept connections until the receiver is dropped.
    pub(super) fn accept(
        &self,
        listener: TcpListener,
    ) -> std::io::Result<ReceiverStream<std::io::Result<TcpStream>>> {
        listener.set_nonblocking(true)?;
        let listener = tokio::net::TcpListener::from_std(listener)?;
        let (pass, incoming) = mpsc::channel(WAITING_MAX);
        let wires = self.clone();
        tokio::spawn(async move {
            while let Ok((stream, _)) = listener.accept().await {
                if wires.admits(&stream) && pass.send(Ok(stream)).await.is_err() {
                    return;
                }
            }
        });
        Ok(ReceiverStream::new(incoming))
    }

    /// Keep a second handle to the connection for cutting it; `false` where it is cut at once.
    fn admits(&self, stream: &TcpStream) -> bool {
        let mut open = self.locked();
        if open.is_cut {
            return false;
        }
        let _ = stream.set_nodelay(true);
        let Ok(grip) = stream.as_fd().try_clone_to_owned() else { return false };
        open.streams.retain(|other| other.peer_addr().is_ok());
        open.streams.push(grip.into());
        true
    }

    fn locked(&self) -> std::sync::MutexGuard<'_, Open> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
