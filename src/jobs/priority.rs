//! Computing gives way to answering, and answering to stops and doses: in a service, what computes runs at the lowest priority of the
//! system's scheduler, what answers at a lower one than what reads stops and drives a bench, which keeps that of the process.
//!
//! Niceness is a thread's own on Linux, and threads inherit it from the one that makes them: libtorch's do so too.

use rustix::process::{getpriority_process, setpriority_process};

/// The lowest priority; the scheduler gives such a thread what others leave, a seventieth of a core beside a busy one.
const NICEST: i32 = 19;
/// That of what answers: a third of the share of a thread that reads stops.
const ANSWERS: i32 = 5;

/// From here on the calling thread gives way to every other of this process. It cannot be taken back without rights.
pub(super) fn give_way() {
    if let Err(error) = setpriority_process(None, NICEST) {
        tracing::warn!(%error, "a thread that computes could not be given a lower priority: the service may answer late");
    }
}

/// From here on the calling thread, which answers, gives way to those that read stops and drive a bench.
pub fn give_way_to_the_bench() {
    if getpriority_process(None).is_ok_and(|nice| nice >= ANSWERS) {
        return;
    }
    if let Err(error) = setpriority_process(None, ANSWERS) {
        tracing::warn!(%error, "a thread that answers could not be given a lower priority: a stop may be read late");
    }
}

/// Have the threads that all computations share give way. Only the first call of a process has an effect, and only before anything was computed.
pub(super) fn make_pool_give_way() {
    let pool = rayon::ThreadPoolBuilder::new().start_handler(|_| give_way()).build_global();
    if pool.is_err() && !rayon::broadcast(|_| is_nice()).into_iter().all(|nice| nice) {
        tracing::warn!("the threads that compute began before the service did and keep its priority");
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
