//! Thread priorities: computing yields to answering requests, and answering to stops and doses. In
//! a service, compute threads run at the lowest priority of the system's scheduler, request threads
//! at a lower one than the threads that read stops and drive a bench, which keep that of the
//! process.
//!
//! Niceness is per thread on Linux, and threads inherit it from the thread that spawns them:
//! libtorch's do so too.

use rustix::process::{getpriority_process, setpriority_process};

/// The lowest priority; the scheduler gives such a thread what others leave, a seventieth of a core
/// next to a busy one.
const NICEST: i32 = 19;
/// Priority of request threads: a third of the share of a thread that reads stops.
const ANSWERS: i32 = 5;

/// Makes the calling thread yield to every other thread of this process from now on. Undoing it
/// needs privileges.
pub(super) fn give_way() {
    if let Err(error) = setpriority_process(None, NICEST) {
        tracing::warn!(%error, "a thread that computes could not be given a lower priority: the service may answer late");
    }
}

/// Makes the calling thread, which answers requests, yield to those that read stops and drive a
/// bench from now on.
pub fn give_way_to_the_bench() {
    if getpriority_process(None).is_ok_and(|nice| nice >= ANSWERS) {
        return;
    }
    if let Err(error) = setpriority_process(None, ANSWERS) {
        tracing::warn!(%error, "a thread that answers could not be given a lower priority: a stop may be read late");
    }
}

/// Computes on so many threads. Only the first call in a process has an effect, and only before
/// anything was computed.
pub fn compute_on(threads: usize) {
    if rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().is_err() {
        tracing::warn!("the threads that compute began before their number was set");
    }
}

/// Makes the shared compute threads yield. Only the first call in a process has an effect, and only
/// before anything was computed.
pub(super) fn make_pool_give_way() {
    let pool = rayon::ThreadPoolBuilder::new().start_handler(|_| give_way()).build_global();
    if pool.is_err() && !rayon::broadcast(|_| is_nice()).into_iter().all(|nice| nice) {
        tracing::warn!(
            "the threads that compute began before the service did and keep its priority"
        );
    }
}

fn is_nice() -> bool {
    getpriority_process(None).is_ok_and(|nice| nice >= NICEST)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_that_gives_way_passes_it_on_and_leaves_the_others_alone() {
        let computes = std::thread::spawn(|| {
            give_way();
            (is_nice(), std::thread::spawn(is_nice).join().unwrap())
        });
        assert_eq!(computes.join().unwrap(), (true, true));
        assert!(!std::thread::spawn(is_nice).join().unwrap());
    }
}
