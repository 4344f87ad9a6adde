//! Buffered log lines on their way to stderr: logging never waits for the reader of stderr and
//! never fails because there is none.
//!
//! A single thread writes. While it is blocked, lines are queued up to a limit; further lines are
//! dropped, and once there is room again the log reports how many.

use std::collections::VecDeque;
use std::io::{self, Write};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Maximum number of queued bytes.
const BYTES_MAX: usize = 1 << 20;

/// Lines queued for the writer thread.
#[derive(Debug, Default)]
struct Waiting {
    lines: VecDeque<Vec<u8>>,
    bytes: usize,
    /// Lines dropped and not yet reported.
    dropped: u64,
    /// A line, or the report of dropped lines, is being written.
    writing: bool,
}

/// A queue of lines with a thread that writes them; cheap to clone.
#[derive(Debug, Clone, Default)]
pub(super) struct Lines(Arc<Queue>);

#[derive(Debug, Default)]
struct Queue {
    waiting: Mutex<Waiting>,
    /// Signalled when a line has been queued or written.
    changed: Condvar,
}

impl Lines {
    /// Creates a queue whose own thread writes to `out`; `tell` reports how many lines were
    /// dropped, as a log line or in any other way.
    ///
    /// # Errors
    /// The system cannot spawn a thread.
    pub fn to(
        out: impl Write + Send + 'static,
        tell: impl Fn(u64) + Send + 'static,
    ) -> io::Result<Self> {
        let lines = Self::default();
        let queue = lines.0.clone();
        std::thread::Builder::new().name("log".to_owned()).spawn(move || queue.write(out, tell))?;
        Ok(lines)
    }

    /// Queues a line, or drops it when too many are queued; returns at once in either case.
    pub fn push(&self, line: &[u8]) {
        let mut waiting = self.0.waiting();
        if waiting.bytes + line.len() > BYTES_MAX {
            waiting.dropped += 1;
            return;
        }
        waiting.bytes += line.len();
        waiting.lines.push_back(line.to_owned());
        self.0.changed.notify_all();
    }

    /// Waits until all lines are written, for at most `limit`. Returns whether they are.
    pub fn flush(&self, limit: Duration) -> bool {
        let unwritten = |waiting: &mut Waiting| waiting.writing || !waiting.lines.is_empty();
        let waited = self.0.changed.wait_timeout_while(self.0.waiting(), limit, unwritten);
        !waited.unwrap_or_else(PoisonError::into_inner).1.timed_out()
    }
}

impl Queue {
    fn write(&self, mut out: impl Write, tell: impl Fn(u64)) {
        loop {
            let line = self.next();
            let written = out.write_all(&line).and_then(|()| out.flush());
            let dropped = self.lost(written.is_ok());
            if dropped > 0 {
                tell(dropped);
            }
            self.waiting().writing = false;
            self.changed.notify_all();
        }
    }

    fn next(&self) -> Vec<u8> {
        let mut waiting = self.waiting();
        loop {
            if let Some(line) = waiting.lines.pop_front() {
                waiting.bytes -= line.len();
                waiting.writing = true;
                return line;
            }
            waiting = self.changed.wait(waiting).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Number of dropped lines to report now: once a line could be written again and there is room
    /// for the report.
    fn lost(&self, well: bool) -> u64 {
        let mut waiting = self.waiting();
        waiting.dropped += u64::from(!well);
        match well && waiting.bytes <= BYTES_MAX / 2 {
            true => std::mem::take(&mut waiting.dropped),
            false => 0,
        }
    }

    fn waiting(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::{Receiver, Sender, channel};

    /// Writer that passes lines on one by one, each once permitted; fails for each `false`.
    struct Gate {
        may: Receiver<bool>,
        seen: Sender<Vec<u8>>,
    }

    impl Write for Gate {
        fn write(&mut self, line: &[u8]) -> io::Result<usize> {
            if !self.may.recv().unwrap_or(true) {
                return Err(io::ErrorKind::BrokenPipe.into());
            }
            self.seen.send(line.to_owned()).map_err(io::Error::other)?;
            Ok(line.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    fn gate() -> (Lines, Sender<bool>, Receiver<Vec<u8>>, Receiver<u64>) {
        let ((let_through, may), (seen, written), (told, dropped)) =
            (channel(), channel(), channel());
        let lines = Lines::to(Gate { may, seen }, move |lines| told.send(lines).unwrap()).unwrap();
        (lines, let_through, written, dropped)
    }

    #[test]
    fn a_log_that_nobody_reads_holds_nobody_up_and_says_afterwards_how_many_lines_it_lost() {
        let (lines, let_through, written, dropped) = gate();
        let line = vec![b'x'; 1000];
        // Twice what may be queued: the first line is held by the writer, which never returns.
        let pushed = 2 * BYTES_MAX / line.len();
        (0..pushed).for_each(|_| lines.push(&line));
        assert!(!lines.flush(Duration::from_millis(1)));
        // From here on the writer accepts lines.
        drop(let_through);
        let lost = dropped.recv().unwrap();
        assert!(lines.flush(Duration::MAX));
        assert_eq!(written.try_iter().count() as u64 + lost, pushed as u64);
    }

    #[test]
    fn a_broken_pipe_is_no_end_and_no_flood() {
        let (lines, let_through, written, dropped) = gate();
        for may in [false, false, true] {
            let_through.send(may).unwrap();
            lines.push(b"line");
        }
        assert_eq!((written.recv().unwrap(), dropped.recv().unwrap()), (b"line".to_vec(), 2));
        assert_eq!((written.try_iter().count(), dropped.try_iter().count()), (0, 0));
    }
}
