//! How many connections fit: the process's limit on file descriptors, less those needed elsewhere.

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// Maximum number of connections, however many descriptors there are: a bench has few clients, and
/// each connection costs memory.
const CONNECTIONS_MAX: usize = 1024;
/// Descriptors reserved for the database, its files, devices and connections being closed.
const KEPT_BACK: usize = 96;
/// Minimum number of connections; where the limit is lower, the rest of the process makes do with
/// fewer descriptors.
const CONNECTIONS_MIN: usize = 16;

/// Number of connections that may be open at once, after raising the descriptor limit as far as the
/// system allows.
pub fn room() -> usize {
    let room = connections(descriptors());
    if room < CONNECTIONS_MAX / 4 {
        tracing::warn!(
            connections = room,
            "the limit of open files is low: raise it (ulimit -n 4096)"
        );
    }
    room
}

fn connections(descriptors: usize) -> usize {
    descriptors
        .saturating_sub(KEPT_BACK.max(descriptors / 4))
        .clamp(CONNECTIONS_MIN, CONNECTIONS_MAX)
}

/// The soft limit, raised to the hard limit if possible.
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
