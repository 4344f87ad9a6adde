//! State of one connection: what it has requested, and whether it still deserves its file
//! descriptor.

use std::net::{IpAddr, Ipv6Addr};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio_util::sync::CancellationToken;

/// How long a client may take to send the head of its first request, TLS included; and of each
/// later one.
pub const HEAD: Duration = Duration::from_secs(15);
/// How long a connection may idle between requests.
const REST: Duration = Duration::from_secs(60);
/// How long a response may make no progress: longer than the timeouts for its body, its seat and
/// the database together.
const STALLED: Duration = Duration::from_secs(120);
/// How long the network may accept no bytes from us.
const BLOCKED: Duration = Duration::from_secs(30);
/// How long a connection that was asked to close may take to do so.
const LEAVING: Duration = Duration::from_secs(5);
/// How long a new connection may still turn out to be one that requests a stop.
const FRESH: Duration = Duration::from_secs(1);

/// Kind of request, as far as its connection is concerned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Answered once and done.
    Ordinary,
    /// A stream of events as they happen.
    Stream,
    /// A stop.
    Stop,
}

/// One connection.
#[derive(Debug)]
pub struct Connection {
    /// Address of the peer; for IPv6 its network, because one household or one attacker holds a
    /// whole network.
    pub peer: IpAddr,
    /// Finish requests under way, then close.
    pub leave: CancellationToken,
    /// Close now.
    pub cut: CancellationToken,
    born: Instant,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    /// A complete request head has arrived.
    has_asked: bool,
    /// A request carried a valid token.
    is_holder: bool,
    /// Requests under way, by [`Kind`].
    under_way: [usize; 3],
    /// When the last request began.
    begun: Instant,
    /// When a response last made progress or a request last began or ended.
    moved: Instant,
    /// Since when the network has accepted nothing.
    blocked: Option<Instant>,
    asked_to_leave: Option<Instant>,
}

/// What to do with a connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// It is healthy.
    Keep,
    /// It has idled long enough.
    Leave,
    /// It occupies a slot without making progress.
    Cut,
}

/// How useful a connection is: when there is no room the least useful is closed first, and among
/// equals the one that made progress longest ago.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Use {
    /// Has not sent a request within the time an honest client needs.
    Silent,
    /// Has sent a request without a token, and idles.
    Resting,
    /// Follows events without a token.
    Watching,
    /// Is being answered, without a token.
    Asking,
    /// Connected or sent a request a moment ago.
    Fresh,
    /// Has presented a token, and idles.
    HolderResting,
    /// Follows events with a token.
    HolderWatching,
    /// Is being answered, with a token.
    HolderAsking,
    /// Requests a stop.
    Stopping,
}

impl Connection {
    /// A connection accepted just now.
    pub fn new(peer: IpAddr, now: Instant) -> Self {
        let state = State {
            has_asked: false,
            is_holder: false,
            under_way: [0; 3],
            begun: now,
            moved: now,
            blocked: None,
            asked_to_leave: None,
        };
        let (leave, cut) = (CancellationToken::new(), CancellationToken::new());
        Self { peer: network(peer), leave, cut, born: now, state: Mutex::new(state) }
    }

    /// Registers a request; it is under way until the returned guard is dropped.
    pub fn begin(self: &Arc<Self>, kind: Kind) -> UnderWay {
        let mut state = self.state();
        state.has_asked = true;
        state.begun = Instant::now();
        state.moved = state.begun;
        state.under_way[kind as usize] += 1;
        UnderWay { connection: self.clone(), kind }
    }

    /// Records that a request presented a valid token.
    pub fn shown_token(&self) {
        self.state().is_holder = true;
    }

    /// Records whether the network accepted bytes.
    pub fn wrote(&self, taken: bool) {
        let mut state = self.state();
        state.blocked = if taken { None } else { state.blocked.or_else(|| Some(Instant::now())) };
    }

    /// Number of event streams under way.
    pub fn streams(&self) -> usize {
        self.state().under_way[Kind::Stream as usize]
    }

    /// Number of stops under way.
    pub fn stops(&self) -> usize {
        self.state().under_way[Kind::Stop as usize]
    }

    /// Decides whether the connection keeps its descriptor; remembers that it was asked to close.
    pub fn verdict(&self, now: Instant) -> Verdict {
        let mut state = self.state();
        let verdict = state.verdict(self.born, now);
        if verdict == Verdict::Leave {
            state.asked_to_leave = Some(now);
        }
        verdict
    }

    /// How useful the connection is, and when it last made progress.
    pub fn usefulness(&self, now: Instant) -> (Use, Instant) {
        let state = self.state();
        (state.usefulness(now), state.moved)
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    fn verdict(&self, born: Instant, now: Instant) -> Verdict {
        let past = |since: Instant, limit: Duration| now.saturating_duration_since(since) > limit;
        let [ordinary, streams, stops] = self.under_way;
        let silent = !self.has_asked && past(born, HEAD);
        let blocked = self.blocked.is_some_and(|since| past(since, BLOCKED));
        let stalled = ordinary > 0 && past(self.moved, STALLED);
        if silent
            || blocked
            || stalled
            || self.asked_to_leave.is_some_and(|since| past(since, LEAVING))
        {
            return Verdict::Cut;
        }
        let rests = ordinary + streams + stops == 0 && self.has_asked && past(self.moved, REST);
        if rests && self.asked_to_leave.is_none() { Verdict::Leave } else { Verdict::Keep }
    }

    fn usefulness(&self, now: Instant) -> Use {
        // A client that connected or sent a request a moment ago may be about to present a token.
        let is_fresh = now.saturating_duration_since(self.begun) < FRESH;
        let [ordinary, streams, stops] = self.under_way;
        match (stops, ordinary, streams, self.is_holder) {
            (1.., ..) => Use::Stopping,
            (0, 1.., _, true) => Use::HolderAsking,
            (0, 0, 1.., true) => Use::HolderWatching,
            (0, 0, 0, true) => Use::HolderResting,
            (0, 1.., _, false) if is_fresh => Use::Fresh,
            (0, 1.., _, false) => Use::Asking,
            (0, 0, 1.., false) => Use::Watching,
            (0, 0, 0, false) if self.has_asked => Use::Resting,
            (0, 0, 0, false) if is_fresh => Use::Fresh,
            (0, 0, 0, false) => Use::Silent,
        }
    }
}

/// A request and its response, until the last of it is sent or abandoned.
#[derive(Debug)]
pub struct UnderWay {
    connection: Arc<Connection>,
    kind: Kind,
}

impl UnderWay {
    /// Records that the response made progress.
    pub fn moved(&self) {
        self.connection.state().moved = Instant::now();
    }
}

impl Drop for UnderWay {
    fn drop(&mut self) {
        let mut state = self.connection.state();
        state.under_way[self.kind as usize] -= 1;
        state.moved = Instant::now();
    }
}

fn network(peer: IpAddr) -> IpAddr {
    match peer.to_canonical() {
        IpAddr::V6(address) if !address.is_loopback() => {
            let [a, b, c, d, ..] = address.segments();
            IpAddr::V6(Ipv6Addr::new(a, b, c, d, 0, 0, 0, 0))
        }
        peer => peer,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn connection() -> (Arc<Connection>, Instant) {
        let now = Instant::now();
        (Arc::new(Connection::new(IpAddr::from([127, 0, 0, 1]), now)), now)
    }

    const SOON: Duration = Duration::from_millis(100);

    #[test]
    fn a_connection_that_never_asks_is_cut_and_one_that_rests_may_finish() {
        let (silent, born) = connection();
        assert_eq!(silent.verdict(born + HEAD), Verdict::Keep);
        assert_eq!(silent.verdict(born + HEAD + SOON), Verdict::Cut);
        let (resting, born) = connection();
        drop(resting.begin(Kind::Ordinary));
        assert_eq!(resting.verdict(born + HEAD + SOON), Verdict::Keep);
        let later = Instant::now() + REST + SOON;
        assert_eq!(resting.verdict(later), Verdict::Leave);
        assert_eq!(resting.verdict(later + SOON), Verdict::Keep, "asked once");
        assert_eq!(resting.verdict(later + LEAVING + SOON), Verdict::Cut);
    }

    #[test]
    fn an_answer_that_nobody_takes_is_cut_and_a_stream_in_which_nothing_happens_is_not() {
        let (slow, _) = connection();
        let answer = slow.begin(Kind::Ordinary);
        assert_eq!(slow.verdict(Instant::now() + STALLED + SOON), Verdict::Cut);
        drop(answer);
        let (watching, _) = connection();
        let _events = watching.begin(Kind::Stream);
        assert_eq!(watching.verdict(Instant::now() + 10 * STALLED), Verdict::Keep);
        watching.wrote(false);
        assert_eq!(watching.verdict(Instant::now() + BLOCKED + SOON), Verdict::Cut);
        watching.wrote(true);
        assert_eq!(watching.verdict(Instant::now() + BLOCKED + SOON), Verdict::Keep);
    }

    #[test]
    fn whoever_shows_a_token_or_asks_for_a_stop_is_worth_more_than_all_who_do_not() {
        let (it, _) = connection();
        let used_after = |age: Duration| it.usefulness(Instant::now() + age).0;
        assert_eq!((used_after(Duration::ZERO), used_after(FRESH)), (Use::Fresh, Use::Silent));
        drop(it.begin(Kind::Ordinary));
        assert_eq!(used_after(FRESH), Use::Resting);
        let watch = it.begin(Kind::Stream);
        assert_eq!(used_after(FRESH), Use::Watching);
        let _ask = it.begin(Kind::Ordinary);
        assert_eq!((used_after(Duration::ZERO), used_after(FRESH)), (Use::Fresh, Use::Asking));
        drop(watch);
        it.shown_token();
        assert!(used_after(FRESH) > Use::Fresh);
        let _stop = it.begin(Kind::Stop);
        assert_eq!(used_after(FRESH), Use::Stopping);
    }

    #[test]
    fn a_network_of_ipv6_counts_as_one_peer() {
        let of = |text: &str| network(text.parse().unwrap());
        assert_eq!(of("2001:db8:1:2:3:4:5:6"), of("2001:db8:1:2:ffff::1"));
        assert_ne!(of("2001:db8:1:2::1"), of("2001:db8:1:3::1"));
        assert_eq!(of("::ffff:10.0.0.1"), of("10.0.0.1"));
        assert!(of("::1").is_loopback());
    }
}
