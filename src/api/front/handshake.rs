//! TLS handshakes, on a thread of their own: the front's threads see established connections alone.
//!
//! What a handshake costs is the answer to the client's first message. One answer is made at a time; addresses take turns, and within an address the
//! newest goes first: where more come than can be served, those who have waited longest have mostly given up.

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

/// Handshakes of one address that may wait for their turn; of IPv6 one network's.
const PEER_MAX: usize = 64;
/// Handshakes of all addresses that may.
const ALL_MAX: usize = 512;

/// Shakes hands; cheap to clone.
#[derive(Clone)]
pub struct Handshakes {
    tls: TlsAcceptor,
    turns: Turns,
    /// The thread for it.
    pub thread: Handle,
}

impl Handshakes {
    /// With this certificate, and the thread for it, which the caller keeps.
    ///
    /// # Errors
    /// The system gives no thread.
    pub fn with(tls: TlsAcceptor) -> io::Result<(Self, Runtime)> {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).thread_name("handshake").build()?;
        Ok((Self { tls, turns: Turns::default(), thread: runtime.handle().clone() }, runtime))
    }

    /// The connection, established; `None` if the client sends something else, or too many wait.
    pub async fn shake(&self, wire: Wire, peer: IpAddr) -> Option<TlsStream<Wire>> {
        let hello = LazyConfigAcceptor::new(Acceptor::default(), wire).await.ok()?;
        let turn = self.turns.take(peer).await?;
        let mut rest = pin!(hello.into_stream(self.tls.config().clone()));
        let answered = poll!(rest.as_mut());
        // What is left waits for the client, and costs little.
        drop(turn);
        match answered {
            Poll::Ready(shaken) => shaken.ok(),
            Poll::Pending => rest.await.ok(),
        }
    }
}

/// Whose turn it is; cheap to clone.
#[derive(Debug, Clone, Default)]
struct Turns(Arc<Shared>);

#[derive(Debug, Default)]
struct Shared {
    queue: Mutex<Queue>,
    full: Complaint,
}

#[derive(Debug, Default)]
struct Queue {
    /// Somebody has the turn.
    taken: bool,
    /// Addresses in the order of their turns, with their handshakes, the newest last.
    peers: VecDeque<(IpAddr, VecDeque<oneshot::Sender<Turn>>)>,
}

/// The turn, until it is dropped.
#[derive(Debug)]
struct Turn(Turns);

impl Turns {
    /// The turn, when it comes; `None` if newer ones took its place.
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
            // Whoever has just gone hands it on by dropping it.
            let _gone = next.send(Self(self.0.clone()));
        }
    }
}

impl Queue {
    /// One more of this address; whether the oldest of those with the most had to go for it.
    fn wait(&mut self, peer: IpAddr, say: oneshot::Sender<Turn>) -> bool {
        match self.peers.iter_mut().find(|it| it.0 == peer) {
            Some((_, waiting)) => waiting.push_back(say),
            None => self.peers.push_back((peer, [say].into())),
        }
        let all: usize = self.peers.iter().map(|it| it.1.len()).sum();
        let most = self.peers.iter_mut().max_by_key(|it| it.1.len());
        most.filter(|it| it.1.len() > PEER_MAX || all > ALL_MAX).is_some_and(|it| it.1.pop_front().is_some())
    }

    /// The newest of the address whose turn it is.
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

    /// A handshake of the address 10.0.0.`peer` that waits.
    fn one_more(turns: &Turns, peer: u8) -> Waiting {
        let turns = turns.clone();
        let mut waiting: Waiting = Box::pin(async move { turns.take(IpAddr::from([10, 0, 0, peer])).await });
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
        let given_up = flood.iter_mut().filter_map(|it| it.as_mut().now_or_never()).filter(Option::is_none).count();
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
        let (gone, mut waits, told) = (one_more(&turns, 1), one_more(&turns, 1), one_more(&turns, 1));
        drop(gone);
        drop(first);
        // It has been given the turn, and goes without having taken it.
        drop(told);
        assert!(waits.as_mut().now_or_never().flatten().is_some());
        assert!(turns.take(IpAddr::from([10, 0, 0, 1])).now_or_never().flatten().is_some());
    }
}
