//! All open connections: there is always room for another, because the least useful one is closed.

use super::connection::{Connection, Use, Verdict};
use crate::api::complaint::Complaint;
use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// One peer may hold at most one in this many of all connections; on this machine all share one
/// address.
const PEERS: usize = 4;
/// When there is no room, one in this many of all connections is closed at once: scanning all of
/// them for each new one would cost more than the flood itself.
const AT_ONCE: usize = 32;

/// The open connections.
#[derive(Debug)]
pub struct Table {
    room: usize,
    open: Mutex<Open>,
    full: Complaint,
    silent: Complaint,
}

#[derive(Debug, Default)]
struct Open {
    next: u64,
    by_id: HashMap<u64, Arc<Connection>>,
}

/// A connection's place in the table, until it is dropped.
#[derive(Debug)]
pub struct Place {
    table: Arc<Table>,
    id: u64,
    /// The connection.
    pub connection: Arc<Connection>,
}

impl Drop for Place {
    fn drop(&mut self) {
        self.table.open().by_id.remove(&self.id);
    }
}

impl Table {
    /// A table for this many connections.
    pub fn new(room: usize) -> Self {
        Self {
            room,
            open: Mutex::default(),
            full: Complaint::default(),
            silent: Complaint::default(),
        }
    }

    /// Its capacity.
    pub fn room(&self) -> usize {
        self.room
    }

    /// Admits a connection; if the table is full, the least useful ones are closed.
    pub fn admit(self: &Arc<Self>, peer: IpAddr, now: Instant) -> Place {
        let connection = Arc::new(Connection::new(peer, now));
        let mut open = self.open();
        self.make_room(&mut open, &connection, now);
        let id = open.next;
        open.next += 1;
        open.by_id.insert(id, connection.clone());
        Place { table: self.clone(), id, connection }
    }

    fn make_room(&self, open: &mut Open, new: &Connection, now: Instant) {
        if open.by_id.len() >= self.room {
            self.evict(open, |_| true, now);
        } else if !new.peer.is_loopback() {
            let same = |old: &Connection| old.peer == new.peer;
            if open.by_id.values().filter(|old| same(old)).count() >= (self.room / PEERS).max(1) {
                self.evict(open, same, now);
            }
        }
    }

    /// Closes the least useful of those that `may_go`.
    fn evict(&self, open: &mut Open, may_go: impl Fn(&Connection) -> bool, now: Instant) {
        let candidates = open
            .by_id
            .iter()
            .filter(|(_, old)| may_go(old))
            .map(|(id, old)| (old.usefulness(now), *id));
        let mut candidates: Vec<_> =
            candidates.filter(|((used, _), _)| *used < Use::Stopping).collect();
        candidates.sort_unstable();
        candidates.truncate((self.room / AT_ONCE).max(1));
        for (_, id) in &candidates {
            if let Some(old) = open.by_id.remove(id) {
                old.cut.cancel();
            }
        }
        let (room, gone) = (self.room, candidates.len() as u64);
        self.full.happened(gone, move |closed| {
            tracing::warn!(
                room,
                closed,
                "all connections are taken; the least useful ones were closed for new ones"
            );
        });
    }

    /// Closes the least useful connection: the process has run out of descriptors.
    pub fn give_way(&self) {
        self.evict(&mut self.open(), |_| true, Instant::now());
    }

    /// Checks every connection: idle ones are asked to close, stalled ones are closed.
    pub fn sweep(&self, now: Instant) {
        let mut closed = 0;
        for connection in self.open().by_id.values() {
            match connection.verdict(now) {
                Verdict::Keep => {}
                Verdict::Leave => connection.leave.cancel(),
                Verdict::Cut => {
                    connection.cut.cancel();
                    closed += 1;
                }
            }
        }
        if closed > 0 {
            self.silent.happened(closed, |closed| {
                tracing::warn!(
                    closed,
                    "connections that sent no whole request or took no answer in time were closed"
                );
            });
        }
    }

    /// Applies `act` to all of them, to ask them to close or to close them.
    pub fn all(&self, act: impl Fn(&Connection)) {
        self.open().by_id.values().for_each(|connection| act(connection));
    }

    fn open(&self) -> MutexGuard<'_, Open> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::super::connection::Kind;
    use super::*;
    use std::time::Duration;

    const HERE: IpAddr = IpAddr::V4(std::net::Ipv4Addr::LOCALHOST);

    #[test]
    fn a_flood_of_silent_connections_pushes_out_silent_ones_and_nobody_who_asks() {
        let (table, start) = (Arc::new(Table::new(8)), Instant::now());
        let asking = table.admit(HERE, start);
        asking.connection.shown_token();
        let _answer = asking.connection.begin(Kind::Ordinary);
        let known = table.admit(HERE, start);
        known.connection.shown_token();
        let silent: Vec<_> = (0..6).map(|_| table.admit(HERE, start)).collect();
        let flood: Vec<_> =
            (1..=50).map(|k| table.admit(HERE, start + Duration::from_secs(2 * k))).collect();
        let cut = |place: &Place| place.connection.cut.is_cancelled();
        assert!(silent.iter().all(cut) && flood[..40].iter().all(cut));
        assert!(!cut(&asking) && !cut(&known) && !cut(&flood[49]));
        assert!(table.open().by_id.len() <= 8);
    }

    #[test]
    fn one_peer_of_the_network_cannot_push_out_another() {
        let (table, start) = (Arc::new(Table::new(8)), Instant::now());
        let other = table.admit(IpAddr::from([10, 0, 0, 2]), start);
        let flood: Vec<_> = (1..=50)
            .map(|k| table.admit(IpAddr::from([10, 0, 0, 1]), start + Duration::from_secs(2 * k)))
            .collect();
        assert!(!other.connection.cut.is_cancelled());
        assert_eq!(flood.iter().filter(|place| !place.connection.cut.is_cancelled()).count(), 2);
    }

    #[test]
    fn a_stop_under_way_is_never_pushed_out() {
        let (table, start) = (Arc::new(Table::new(2)), Instant::now());
        let stopping = table.admit(HERE, start);
        let _stop = stopping.connection.begin(Kind::Stop);
        let _others: Vec<_> =
            (0..20).map(|_| table.admit(HERE, start + Duration::from_secs(60))).collect();
        assert!(!stopping.connection.cut.is_cancelled());
    }
}
