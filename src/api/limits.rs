//! Limits on what one client can take from the others: seats of its class, and streams.
//!
//! A stop needs neither, and liveness probes have seats of their own.

use super::complaint::Complaint;
use super::front::Connection;
use super::problem::Problem;
use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// How long a request may wait for a seat.
const WAIT: Duration = Duration::from_secs(5);
/// Maximum number of event streams open at once.
const STREAMS: usize = 256;
/// Of these, streams without a token.
const STREAMS_ANONYMOUS: usize = 128;
/// Of these, streams of one network address; on this machine all clients share one.
const STREAMS_PEER: usize = 64;
/// Of these, streams on one connection: the rest of an HTTP/2 connection's streams stay free for
/// other requests.
const STREAMS_CONNECTION: usize = 32;

/// Class of request; requests of one class share seats.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Class {
    /// Health, reflection and metrics.
    Probe,
    /// Without a token.
    Anonymous,
    /// With a token, read-only.
    Reader,
    /// With a token, making changes.
    Writer,
    /// A long response, without a token.
    LongAnonymous,
    /// A long response, with a token.
    Long,
}

/// Limits the requests processed at once; cheap to clone.
#[derive(Debug, Clone)]
pub struct Seats(Arc<[Row; 6]>);

#[derive(Debug)]
struct Row {
    seats: Arc<Semaphore>,
    /// Requests that may wait for a seat; more are refused at once, which is kinder than a queue
    /// that outlasts the clients' patience.
    queue: Semaphore,
    full: Complaint,
}

impl Row {
    fn new(seats: usize, queue: usize) -> Self {
        Self {
            seats: Arc::new(Semaphore::new(seats)),
            queue: Semaphore::new(queue),
            full: Complaint::default(),
        }
    }

    async fn take(&self) -> Option<OwnedSemaphorePermit> {
        if let Ok(seat) = self.seats.clone().try_acquire_owned() {
            return Some(seat);
        }
        let _place = self.queue.try_acquire().ok()?;
        tokio::time::timeout(WAIT, self.seats.clone().acquire_owned()).await.ok()?.ok()
    }
}

impl Default for Seats {
    /// 256 in all, split so that no class can take another's seats. Long responses hold a seat
    /// until they are sent.
    fn default() -> Self {
        let rows = [(24, 64), (96, 256), (64, 256), (64, 128), (4, 16), (4, 16)];
        Self(Arc::new(rows.map(|(seats, queue)| Row::new(seats, queue))))
    }
}

impl Seats {
    /// Takes a seat, at once or after a short wait.
    ///
    /// # Errors
    /// 503 if too many are waiting already or none became free in time.
    pub async fn take(&self, class: Class) -> Result<OwnedSemaphorePermit, Problem> {
        let row = &self.0[class as usize];
        if let Some(seat) = row.take().await {
            return Ok(seat);
        }
        row.full.happened(1, move |refused| {
            tracing::warn!(?class, refused, "all seats of a class of requests are taken")
        });
        Err(Problem::unavailable("too many requests at once; try again in a moment"))
    }
}

/// Open event streams; cheap to clone.
#[derive(Debug, Clone, Default)]
pub struct Streams(Arc<Following>);

#[derive(Debug, Default)]
struct Following {
    open: Mutex<Open>,
    full: Complaint,
}

#[derive(Debug, Default)]
struct Open {
    all: usize,
    anonymous: usize,
    by_peer: HashMap<IpAddr, usize>,
}

/// Seat of one stream, held until dropped.
#[derive(Debug)]
pub struct StreamSeat {
    streams: Streams,
    peer: IpAddr,
    anonymous: bool,
}

impl Streams {
    /// Takes a seat for a stream on this connection, which already counts it.
    ///
    /// # Errors
    /// 429 if the connection or address has too many, 503 if too many are open in all.
    pub fn take(&self, connection: &Connection, anonymous: bool) -> Result<StreamSeat, Problem> {
        let refused = match connection.streams() > STREAMS_CONNECTION {
            true => Some(Problem::too_many(format!(
                "this connection follows {STREAMS_CONNECTION} streams already: close some, or follow GET /v1/events, which has every event"
            ))),
            false => self.open().refusal(connection.peer, anonymous),
        };
        if let Some(problem) = refused {
            let (peer, why) = (connection.peer, problem.detail.clone());
            self.0.full.happened(1, move |refused| {
                tracing::warn!(%peer, refused, why, "a stream of events was refused");
            });
            return Err(problem);
        }
        self.open().count(connection.peer, anonymous, 1);
        Ok(StreamSeat { streams: self.clone(), peer: connection.peer, anonymous })
    }

    fn open(&self) -> MutexGuard<'_, Open> {
        self.0.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Open {
    fn refusal(&self, peer: IpAddr, anonymous: bool) -> Option<Problem> {
        let of_peer = self.by_peer.get(&peer).copied().unwrap_or(0);
        if !peer.is_loopback() && of_peer >= STREAMS_PEER {
            let advice = "event streams are already open from this address: close some, or follow GET /v1/events once";
            return Some(Problem::too_many(format!("{STREAMS_PEER} {advice}")));
        }
        let full = self.all >= STREAMS || anonymous && self.anonymous >= STREAMS_ANONYMOUS;
        let advice = "too many event streams are open: close some, send a token, or read GET /v1/weighings/{id} and /v1/jobs/{id}";
        full.then(|| Problem::unavailable(advice))
    }

    fn count(&mut self, peer: IpAddr, anonymous: bool, change: isize) {
        let of_peer = self.by_peer.entry(peer).or_default();
        *of_peer = of_peer.saturating_add_signed(change);
        if *of_peer == 0 {
            self.by_peer.remove(&peer);
        }
        self.all = self.all.saturating_add_signed(change);
        if anonymous {
            self.anonymous = self.anonymous.saturating_add_signed(change);
        }
    }
}

impl Drop for StreamSeat {
    fn drop(&mut self) {
        self.streams.open().count(self.peer, self.anonymous, -1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Instant;

    #[tokio::test]
    async fn a_class_that_is_full_takes_nothing_from_the_others() {
        let seats = Seats::default();
        let mut taken = Vec::new();
        while let Ok(seat) = seats.0[Class::Anonymous as usize].seats.clone().try_acquire_owned() {
            taken.push(seat);
        }
        let _all_places = seats.0[Class::Anonymous as usize].queue.try_acquire_many(256).unwrap();
        assert_eq!(seats.take(Class::Anonymous).await.unwrap_err().status, 503);
        for class in [Class::Probe, Class::Reader, Class::Writer, Class::LongAnonymous, Class::Long]
        {
            assert!(seats.take(class).await.is_ok(), "{class:?}");
        }
    }

    #[tokio::test]
    async fn who_waits_gets_the_seat_that_becomes_free() {
        let row = Arc::new(Row::new(1, 1));
        let first = row.take().await.unwrap();
        let waiting = tokio::spawn({
            let row = row.clone();
            async move { row.take().await.is_some() }
        });
        while row.queue.available_permits() > 0 {
            tokio::task::yield_now().await;
        }
        assert!(row.take().await.is_none(), "one waits already");
        drop(first);
        assert!(waiting.await.unwrap());
    }

    fn refused(
        streams: &Streams,
        peer: [u8; 4],
        anonymous: bool,
        n: usize,
    ) -> (Vec<StreamSeat>, Option<u16>) {
        let connection = Connection::new(IpAddr::from(peer), Instant::now());
        let mut seats = Vec::new();
        for _ in 0..n {
            match streams.take(&connection, anonymous) {
                Ok(seat) => seats.push(seat),
                Err(problem) => return (seats, Some(problem.status)),
            }
        }
        (seats, None)
    }

    #[test]
    fn streams_are_capped_for_an_address_and_in_all_and_come_back() {
        let streams = Streams::default();
        let (of_one, status) = refused(&streams, [10, 0, 0, 1], true, 100);
        assert_eq!((of_one.len(), status), (STREAMS_PEER, Some(429)));
        let (here, status) = refused(&streams, [127, 0, 0, 1], true, 500);
        assert_eq!((of_one.len() + here.len(), status), (STREAMS_ANONYMOUS, Some(503)));
        let (holders, status) = refused(&streams, [127, 0, 0, 1], false, 500);
        assert_eq!((STREAMS_ANONYMOUS + holders.len(), status), (STREAMS, Some(503)));
        drop((of_one, here, holders));
        assert!(streams.open().by_peer.is_empty() && streams.open().all == 0);
    }
}
