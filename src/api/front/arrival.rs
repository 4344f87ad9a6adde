//! Incoming request bodies: awaited before a seat is taken, for a limited time, and only from
//! callers whose request may succeed.

use crate::api::complaint::Complaint;
use crate::api::problem::Problem;
use axum::body::{Body, Bytes, HttpBody};
use axum::http::{HeaderMap, header};
use std::future::poll_fn;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::sync::{Semaphore, SemaphorePermit};

/// How long the next bytes of a body may take.
const PAUSE: Duration = Duration::from_secs(10);
/// How long a complete body may take.
const WHOLE: Duration = Duration::from_secs(60);
/// Number of bodies that may be awaited at once.
const WAITED_FOR: usize = 128;
/// Memory for all partially received bodies, KiB.
const KIB: usize = 64 * 1024;

/// How many bytes of an oversized body are still read, and for how long: a client that is still
/// sending would see its connection reset instead of the response.
const DISCARDED: (usize, Duration) = (32 * 1024 * 1024, Duration::from_secs(2));

/// Callers currently sending bodies.
#[derive(Debug)]
pub struct Arrivals {
    /// Permits for callers without a token, and for all others.
    waited_for: [Semaphore; 2],
    kib: Semaphore,
    /// How long the next bytes of a body may take.
    pause: Duration,
    full: Complaint,
}

impl Default for Arrivals {
    fn default() -> Self {
        let waited_for = [Semaphore::new(WAITED_FOR), Semaphore::new(WAITED_FOR)];
        Self { waited_for, kib: Semaphore::new(KIB), pause: PAUSE, full: Complaint::default() }
    }
}

/// A partially received body.
struct Gathered<'a> {
    bytes: Vec<u8>,
    /// Acquired once the body makes us wait.
    waiting: Option<SemaphorePermit<'a>>,
    kib: Vec<SemaphorePermit<'a>>,
}

impl Arrivals {
    /// Reads the whole body, of at most `bytes_max`.
    ///
    /// # Errors
    /// 413 if it is longer, 408 if it does not arrive in time, 503 if too many bodies are awaited,
    /// 400 if it breaks off.
    pub async fn gather(
        &self,
        headers: &HeaderMap,
        mut body: Body,
        bytes_max: usize,
        known: bool,
    ) -> Result<Bytes, Problem> {
        let announced = headers
            .get(header::CONTENT_LENGTH)
            .and_then(|text| text.to_str().ok()?.parse::<u64>().ok());
        let late = || Problem::too_slow("the body of the request did not arrive in time");
        let gathered = match announced.is_some_and(|bytes| bytes > bytes_max as u64) {
            true => Err(Problem::too_large(bytes_max)),
            false => {
                let read =
                    tokio::time::timeout(WHOLE, self.read(&mut body, bytes_max, known)).await;
                read.unwrap_or_else(|_| Err(late()))
            }
        };
        // A client that asks first whether to send the body has not started sending.
        if gathered.as_ref().is_err_and(|problem| problem.status == 413)
            && !headers.contains_key(header::EXPECT)
        {
            discard(body).await;
        }
        gathered
    }

    async fn read(&self, body: &mut Body, bytes_max: usize, known: bool) -> Result<Bytes, Problem> {
        let mut gathered = Gathered { bytes: Vec::new(), waiting: None, kib: Vec::new() };
        loop {
            let next = poll_fn(|cx| self.next(body, &mut gathered.waiting, known, cx));
            let frame = tokio::time::timeout(self.pause, next).await;
            let late =
                || Problem::too_slow("the next part of the request's body did not arrive in time");
            match frame.map_err(|_| late())?? {
                None => return Ok(gathered.bytes.into()),
                Some(data) => self.keep(&mut gathered, &data, bytes_max)?,
            }
        }
    }

    /// The next bytes; a body that has not arrived yet needs a permit to be awaited.
    fn next<'a>(
        &'a self,
        body: &mut Body,
        waiting: &mut Option<SemaphorePermit<'a>>,
        known: bool,
        cx: &mut Context<'_>,
    ) -> Poll<Result<Option<Bytes>, Problem>> {
        match Pin::new(body).poll_frame(cx) {
            Poll::Ready(None) => Poll::Ready(Ok(None)),
            Poll::Ready(Some(Ok(frame))) => {
                Poll::Ready(Ok(Some(frame.into_data().unwrap_or_default())))
            }
            Poll::Ready(Some(Err(_))) => {
                Poll::Ready(Err(Problem::malformed("the body ended before it was complete")))
            }
            Poll::Pending if waiting.is_some() => Poll::Pending,
            Poll::Pending => match self.waited_for[usize::from(known)].try_acquire() {
                Ok(place) => {
                    *waiting = Some(place);
                    Poll::Pending
                }
                Err(_) => Poll::Ready(Err(self.refuse())),
            },
        }
    }

    fn keep<'a>(
        &'a self,
        gathered: &mut Gathered<'a>,
        data: &[u8],
        bytes_max: usize,
    ) -> Result<(), Problem> {
        if gathered.bytes.len() + data.len() > bytes_max {
            return Err(Problem::too_large(bytes_max));
        }
        let kib = self
            .kib
            .try_acquire_many(data.len().div_ceil(1024) as u32)
            .map_err(|_| self.refuse())?;
        gathered.kib.push(kib);
        gathered.bytes.extend_from_slice(data);
        Ok(())
    }

    fn refuse(&self) -> Problem {
        self.full
            .happened(1, |refused| tracing::warn!(refused, "too many requests are sent in part"));
        Problem::unavailable("too many requests are being sent at once; try again in a moment")
    }
}

/// Reads what is on its way anyway, and discards it.
async fn discard(mut body: Body) {
    let (mut left, limit) = DISCARDED;
    let rest = async {
        while left > 0 {
            let Some(Ok(frame)) = poll_fn(|cx| Pin::new(&mut body).poll_frame(cx)).await else {
                return;
            };
            left = left.saturating_sub(frame.data_ref().map_or(0, Bytes::len));
        }
    };
    let _enough = tokio::time::timeout(limit, rest).await;
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::BoxError;
    use futures::StreamExt;
    use futures::stream;

    /// A body that delivers these pieces and then stalls.
    fn unfinished(pieces: &[&'static [u8]]) -> Body {
        let pieces: Vec<_> =
            pieces.iter().map(|piece| Ok::<_, BoxError>(Bytes::from_static(piece))).collect();
        Body::from_stream(stream::iter(pieces).chain(stream::pending()))
    }

    async fn status(arrivals: &Arrivals, body: Body, bytes_max: usize) -> u16 {
        arrivals
            .gather(&HeaderMap::new(), body, bytes_max, false)
            .await
            .map_or_else(|problem| problem.status, |_| 200)
    }

    #[tokio::test]
    async fn a_body_that_never_ends_is_given_up_and_one_that_is_there_needs_no_place() {
        let arrivals = Arrivals { pause: Duration::from_millis(5), ..Arrivals::default() };
        assert_eq!(status(&arrivals, unfinished(&[b"abc"]), 10).await, 408);
        assert_eq!(status(&arrivals, Body::from("abcdefghijk"), 10).await, 413);
        let _all = arrivals.waited_for[0].try_acquire_many(WAITED_FOR as u32).unwrap();
        assert_eq!(status(&arrivals, unfinished(&[]), 10).await, 503);
        assert_eq!(status(&arrivals, Body::from("whole"), 10).await, 200);
    }

    #[tokio::test]
    async fn bodies_that_have_come_in_part_share_their_memory() {
        let arrivals = Arrivals::default();
        let _others = arrivals.kib.try_acquire_many(KIB as u32).unwrap();
        assert_eq!(status(&arrivals, Body::from("x"), 10).await, 503);
    }

    #[tokio::test]
    async fn a_body_that_says_it_is_too_long_is_not_read() {
        let expect = (header::EXPECT, "100-continue".parse().unwrap());
        let headers =
            HeaderMap::from_iter([(header::CONTENT_LENGTH, "11".parse().unwrap()), expect]);
        let refused =
            Arrivals::default().gather(&headers, unfinished(&[]), 10, true).await.unwrap_err();
        assert_eq!(refused.status, 413);
    }
}
