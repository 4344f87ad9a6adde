//! TLS handshakes, on a dedicated thread: the front-end threads only see established connections.
//!
//! The cost of a handshake lies in answering the client's first message. One is answered at a time;
//! addresses take turns, and within an address the newest goes first: under overload, the clients
//! that have waited longest have mostly given up.

use super::wire::Wire;
use crate::api::complaint::Complaint;
use futures::poll;
use rustls::server::Acceptor;
use std::collections::VecDeque;
use std::io;
use std::net::IpAddr;
use std::pin::pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::Poll;
use tokio::runtime::{Handle, Runtime};
use tokio::sync::oneshot;
use tokio_rustls::server::TlsStream;
use tokio_rustls::{LazyConfigAcceptor, TlsAcceptor};

/// Maximum queued handshakes per address; for IPv6 per network.
const PEER_MAX: usize = 64;
/// Maximum queued handshakes in total.
const ALL_MAX: usize = 512;

/// Performs handshakes; cheap to clone.
#[derive(Clone)]
pub struct Handshakes {
    tls: TlsAcceptor,
    turns: Turns,
    /// Its dedicated thread.
    pub thread: Handle,
}

impl Handshakes {
    /// Creates it with this certificate, together with its thread, which the caller must keep.
    ///
    /// # Errors
    /// The system cannot spawn a thread.
    pub fn with(tls: TlsAcceptor) -> io::Result<(Self, Runtime)> {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .thread_name("handshake")
            .build()?;
        Ok((Self { tls, turns: Turns::default(), thread: runtime.handle().clone() }, runtime))
    }

    /// The established connection; `None` if the client sends something else or too many are
    /// queued.
    pub async fn shake(&self, wire: Wire, peer: IpAddr) -> Option<TlsStream<Wire>> {
        let hello = LazyConfigAcceptor::new(Acceptor::default(), wire).await.ok()?;
        let turn = self.turns.take(peer).await?;
        let mut rest = pin!(hello.into_stream(self.tls.config().clone()));
        let answered = poll!(rest.as_mut());
        // The remaining steps wait for the client and cost little.
        drop(turn);
        match answered {
            Poll::Ready(shaken) => shaken.ok(),
            Poll::Pending => rest.await.ok(),
        }
    }
}

/// Queue for the turn; cheap to clone.
#[derive(Debug, Clone, Default)]
struct Turns(Arc<Shared>);

#[derive(Debug, Default)]
struct Shared {
    queue: Mutex<Queue>,
    full: Complaint,
}

#[derive(Debug, Default)]
struct Queue {
    /// The turn is taken.
    taken: bool,
    /// Addresses in the order of their turns, each with its handshakes, newest last.
    peers: VecDeque<(IpAddr, VecDeque<oneshot::Sender<Turn>>)>,
}

/// The turn, held until dropped.
#[derive(Debug)]
struct Turn(Turns);

impl Turns {
    /// Waits for the turn; `None` if newer handshakes displaced this one.
    async fn take(&self, peer: IpAddr) -> Option<Turn> {
        let turn = {
            let mut queue = self.queue();
            if !queue.taken {
                queue.taken = true;
                return Some(Turn(self.clone()));
            }
            let (say, hear) = oneshot::channel();
            if queue.wait(peer, say) {
                let log = |refused| tracing::warn!(%peer, refused, "too many TLS handshakes at once: the oldest were given up");
                self.0.full.happened(1, log);
            }
            hear
        };
        turn.await.ok()
    }

    fn queue(&self) -> MutexGuard<'_, Queue> {
        self.0.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        let next = self.0.queue().next();
        if let Some(next) = next {
            // A receiver that has just gone away passes the turn on by dropping it.
            let _gone = next.send(Self(self.0.clone()));
        }
    }
}

impl Queue {
    /// Queues one more handshake of this address; returns whether the oldest one of the busiest
    /// address had to be dropped for it.
    fn wait(&mut self, peer: IpAddr, say: oneshot::Sender<Turn>) -> bool {
        match self.peers.iter_mut().find(|it| it.0 == peer) {
            Some((_, waiting)) => waiting.push_back(say),
            None => self.peers.push_back((peer, [say].into())),
        }
        let all: usize = self.peers.iter().map(|it| it.1.len()).sum();
        let most = self.peers.iter_mut().max_by_key(|it| it.1.len());
        most.filter(|it| it.1.len() > PEER_MAX || all > ALL_MAX)
            .is_some_and(|it| it.1.pop_front().is_some())
    }

    /// The newest handshake of the address whose turn it is.
    fn next(&mut self) -> Option<oneshot::Sender<Turn>> {
        while let Some((peer, mut waiting)) = self.peers.pop_front() {
            waiting.retain(|it| !it.is_closed());
            let next = waiting.pop_back();
            if !waiting.is_empty() {
                self.peers.push_back((peer, waiting));
            }
            if next.is_some() {
                return next;
            }
        }
        self.taken = false;
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures::FutureExt;
    use std::future::Future;
    use std::pin::Pin;

    type Waiting = Pin<Box<dyn Future<Output = Option<Turn>>>>;

    /// A queued handshake from the address 10.0.0.`peer`.
    fn one_more(turns: &Turns, peer: u8) -> Waiting {
        let turns = turns.clone();
        let mut waiting: Waiting =
            Box::pin(async move { turns.take(IpAddr::from([10, 0, 0, peer])).await });
        assert!(waiting.as_mut().now_or_never().is_none());
        waiting
    }

    #[test]
    fn a_flood_of_handshakes_from_one_address_keeps_another_waiting_for_one_of_them_only() {
        let turns = Turns::default();
        let first = turns.take(IpAddr::from([10, 0, 0, 1])).now_or_never().flatten();
        let mut flood: Vec<_> = (0..1000).map(|_| one_more(&turns, 1)).collect();
        let mut other = one_more(&turns, 2);
        drop(first);
        let newest = flood.pop().unwrap().now_or_never().flatten();
        assert!(newest.is_some() && other.as_mut().now_or_never().is_none());
        drop(newest);
        assert!(other.now_or_never().flatten().is_some());
        let given_up = flood
            .iter_mut()
            .filter_map(|it| it.as_mut().now_or_never())
            .filter(Option::is_none)
            .count();
        assert_eq!(given_up, 1000 - PEER_MAX);
    }

    #[test]
    fn handshakes_from_many_addresses_are_bounded_in_all() {
        let turns = Turns::default();
        let _first = turns.take(IpAddr::from([10, 0, 0, 1])).now_or_never().flatten();
        let mut flood: Vec<_> = (0..2000).map(|k| one_more(&turns, (k % 200) as u8)).collect();
        let given_up = flood.iter_mut().filter_map(|it| it.as_mut().now_or_never()).count();
        assert_eq!(given_up, 2000 - ALL_MAX);
    }

    #[test]
    fn a_client_that_is_gone_does_not_keep_the_turn() {
        let turns = Turns::default();
        let first = turns.take(IpAddr::from([10, 0, 0, 1])).now_or_never().flatten();
        let (gone, mut waits, told) =
            (one_more(&turns, 1), one_more(&turns, 1), one_more(&turns, 1));
        drop(gone);
        drop(first);
        // It has been given the turn, and leaves without having taken it.
        drop(told);
        assert!(waits.as_mut().now_or_never().flatten().is_some());
        assert!(turns.take(IpAddr::from([10, 0, 0, 1])).now_or_never().flatten().is_some());
    }
}
