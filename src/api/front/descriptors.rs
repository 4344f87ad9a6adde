//! How many connections there is room for: what the system gives this process, less what the rest of it needs.

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// Most connections, however many descriptors there are: a bench has a few clients, and each connection costs memory.
const CONNECTIONS_MAX: usize = 1024;
/// Descriptors kept back for the database, its files, devices and what is being closed.
const KEPT_BACK: usize = 96;
/// Where the system gives less, the rest of the process has to do with less.
const CONNECTIONS_MIN: usize = 16;

/// Connections that may be open at once, after asking the system for all the descriptors that it gives.
pub fn room() -> usize {
    let room = connections(descriptors());
    if room < CONNECTIONS_MAX / 4 {
        tracing::warn!(connections = room, "the limit of open files is low: raise it (ulimit -n 4096)");
    }
    room
}

fn connections(descriptors: usize) -> usize {
    descriptors.saturating_sub(KEPT_BACK.max(descriptors / 4)).clamp(CONNECTIONS_MIN, CONNECTIONS_MAX)
}

/// The soft limit, raised as far as the hard one allows.
fn descriptors() -> usize {
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    let raised = setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum });
    let limit = if raised.is_ok() { maximum } else { current };
    limit.map_or(usize::MAX, |limit| usize::try_from(limit).unwrap_or(usize::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn descriptors_are_kept_back_and_there_is_always_room_for_some() {
        assert_eq!(connections(usize::MAX), CONNECTIONS_MAX);
        assert_eq!(connections(1024), 768);
        assert_eq!(connections(160), 160 - KEPT_BACK);
        assert_eq!(connections(20), CONNECTIONS_MIN);
    }
}
