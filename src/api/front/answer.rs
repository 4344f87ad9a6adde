//! Response bodies: tracking how much of one the client has taken, and relaying those produced
//! elsewhere.

use super::connection::UnderWay;
use axum::body::{Body, Bytes, HttpBody};
use http_body::{Frame, SizeHint};
use std::future::poll_fn;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::sync::mpsc;

/// Bytes handed to the network at once, so that a client that stops reading within a response is
/// noticed.
const PIECE: usize = 64 * 1024;
/// Frames produced before they are taken.
const AHEAD: usize = 4;
/// How long a frame may wait to be taken.
const PATIENCE: Duration = Duration::from_secs(60);
/// Error of a response that ends early.
const BROKEN: &str = "the answer broke off";

type Polled = Poll<Option<Result<Frame<Bytes>, axum::Error>>>;

/// A response in flight: counted as under way until it is sent or abandoned.
pub struct Answer {
    body: Body,
    /// Remainder of a frame too long for one piece.
    rest: Bytes,
    under_way: UnderWay,
}

impl Answer {
    /// The body of the response to a request under way.
    pub fn new(body: Body, under_way: UnderWay) -> Self {
        Self { body, rest: Bytes::new(), under_way }
    }

    fn piece(&mut self, mut data: Bytes) -> Frame<Bytes> {
        let piece = data.split_to(data.len().min(PIECE));
        self.rest = data;
        Frame::data(piece)
    }
}

impl HttpBody for Answer {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Polled {
        if !self.rest.is_empty() {
            self.under_way.moved();
            let rest = std::mem::take(&mut self.rest);
            return Poll::Ready(Some(Ok(self.piece(rest))));
        }
        let polled = std::task::ready!(Pin::new(&mut self.body).poll_frame(cx));
        self.under_way.moved();
        Poll::Ready(polled.map(|frame| match frame?.into_data() {
            Ok(data) => Ok(self.piece(data)),
            Err(other) => Ok(other),
        }))
    }

    fn is_end_stream(&self) -> bool {
        self.rest.is_empty() && self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        let (mut hint, rest) = (self.body.size_hint(), self.rest.len() as u64);
        match hint.exact() {
            Some(exact) => SizeHint::with_exact(exact + rest),
            None => {
                hint.set_lower(hint.lower() + rest);
                hint
            }
        }
    }
}

/// A body whose frames are produced by another task.
pub struct Relay {
    frames: mpsc::Receiver<Result<Frame<Bytes>, axum::Error>>,
    whole: Arc<AtomicBool>,
}

/// The producing end of a [`Relay`].
pub struct Source {
    frames: mpsc::Sender<Result<Frame<Bytes>, axum::Error>>,
    /// The last frame has been sent: without it the client must not treat the response as complete.
    whole: Arc<AtomicBool>,
}

/// Creates both ends.
pub fn relay() -> (Source, Body) {
    let (sender, receiver) = mpsc::channel(AHEAD);
    let whole = Arc::new(AtomicBool::new(false));
    (Source { frames: sender, whole: whole.clone() }, Body::new(Relay { frames: receiver, whole }))
}

impl HttpBody for Relay {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Polled {
        let polled = std::task::ready!(self.frames.poll_recv(cx));
        let broken = polled.is_none() && !self.whole.swap(true, Ordering::Relaxed);
        Poll::Ready(if broken { Some(Err(axum::Error::new(BROKEN))) } else { polled })
    }
}

impl Source {
    /// Feeds the frames of `body` until it ends, the client has gone, or a frame is not taken in
    /// time.
    pub async fn feed(self, mut body: Body) {
        loop {
            let frame = tokio::select! {
                frame = poll_fn(|cx| Pin::new(&mut body).poll_frame(cx)) => frame,
                () = self.frames.closed() => return,
            };
            let Some(frame) = frame else { return self.whole.store(true, Ordering::Relaxed) };
            let sent = tokio::time::timeout(PATIENCE, self.frames.send(frame)).await;
            if !matches!(sent, Ok(Ok(()))) {
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::connection::{Connection, Kind};
    use super::*;
    use axum::BoxError;
    use std::net::IpAddr;
    use std::time::Instant;

    #[tokio::test]
    async fn a_long_answer_goes_out_in_pieces_with_its_length_and_every_byte() {
        let connection = Arc::new(Connection::new(IpAddr::from([127, 0, 0, 1]), Instant::now()));
        let text: Vec<u8> = (0..3 * PIECE + 7).map(|k| k as u8).collect();
        let mut answer = Answer::new(Body::from(text.clone()), connection.begin(Kind::Ordinary));
        assert_eq!(answer.size_hint().exact(), Some(text.len() as u64));
        let mut seen = Vec::new();
        while let Some(frame) = poll_fn(|cx| Pin::new(&mut answer).poll_frame(cx)).await {
            let piece = frame.unwrap().into_data().unwrap();
            assert!(piece.len() <= PIECE);
            seen.extend_from_slice(&piece);
            assert_eq!(answer.size_hint().exact(), Some((text.len() - seen.len()) as u64));
        }
        assert!(seen == text && answer.is_end_stream());
    }

    #[tokio::test]
    async fn a_relay_ends_when_nobody_listens() {
        let (source, body) = relay();
        drop(body);
        source.feed(Body::from_stream(futures::stream::pending::<Result<Bytes, BoxError>>())).await;
    }
    #[tokio::test]
    async fn an_answer_whose_maker_is_gone_is_not_taken_for_a_whole_one() {
        let (source, mut body) = relay();
        drop(source);
        let frame = poll_fn(|cx| Pin::new(&mut body).poll_frame(cx)).await;
        assert!(frame.unwrap().is_err());
        let (source, mut body) = relay();
        source.feed(Body::empty()).await;
        assert!(poll_fn(|cx| Pin::new(&mut body).poll_frame(cx)).await.is_none());
    }
}
