//! Frames of a pile that are uploaded, from any source.

use super::{Piling, Unpiled};
use crate::hardware::camera::Upload;
use std::ops::ControlFlow;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Timeout for the frames of a pile at rest.
const FRAMES_MAX: Duration = Duration::from_secs(15 * 60);
/// How often the callback is polled for a stop while waiting for frames.
const ASK_EVERY: Duration = Duration::from_millis(100);

/// Receives frames while a pile waits for them.
#[derive(Default)]
pub struct Inbox {
    waiting: Mutex<Option<Waiting>>,
    arrived: Condvar,
}

struct Waiting {
    job: String,
    number: u32,
    wanted: usize,
    uploads: Vec<Upload>,
}

/// The pile waiting for frames, and how many it has and needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Awaited {
    /// Which pile, from 1.
    pub pile: u32,
    /// Frames received.
    pub have: u32,
    /// Frames needed.
    pub wanted: u32,
}

impl Inbox {
    /// The pile of this measurement that is waiting for frames.
    pub fn awaits(&self, job: &str) -> Option<Awaited> {
        self.locked().as_ref().filter(|it| it.job == job).map(Waiting::awaited)
    }

    /// Adds a frame; returns the pile's new count. `None`: no pile of this measurement is waiting
    /// for one.
    pub fn add(&self, job: &str, frame: Upload) -> Option<Awaited> {
        let mut waiting = self.locked();
        let open = waiting.as_mut().filter(|it| it.job == job && it.uploads.len() < it.wanted)?;
        open.uploads.push(frame);
        self.arrived.notify_all();
        Some(open.awaited())
    }

    /// Waits until the pile has its frames. `go_on` is called meanwhile, and may end the waiting.
    pub(super) fn collect(
        &self,
        piling: &Piling<'_>,
        go_on: &mut dyn FnMut(&str) -> ControlFlow<()>,
    ) -> Result<Vec<Upload>, Unpiled> {
        let wanted = piling.procedure.frames as usize;
        let job = piling.job.to_owned();
        *self.locked() = Some(Waiting { job, number: piling.number, wanted, uploads: Vec::new() });
        let until = Instant::now() + FRAMES_MAX;
        let collected = loop {
            let have = self.locked().as_ref().map_or(0, |it| it.uploads.len());
            let ended = match () {
                () if have >= wanted => Some(Ok(())),
                () if go_on(&format!("waits for frames, {have} of {wanted} have come"))
                    .is_break() =>
                {
                    Some(Err(Unpiled::Stopped))
                }
                () if Instant::now() >= until => {
                    let minutes = FRAMES_MAX.as_secs() / 60;
                    let cause = format!(
                        "{have} of {wanted} frames came within {minutes} minutes: is the camera's program running?"
                    );
                    Some(Err(Unpiled::Failed(cause)))
                }
                () => None,
            };
            if let Some(ended) = ended {
                break ended;
            }
            let waiting = self.locked();
            drop(self.arrived.wait_timeout(waiting, ASK_EVERY));
        };
        let waited = self.locked().take();
        collected.map(|()| waited.map_or_else(Vec::new, |it| it.uploads))
    }

    fn locked(&self) -> MutexGuard<'_, Option<Waiting>> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Waiting {
    fn awaited(&self) -> Awaited {
        Awaited { pile: self.number, have: self.uploads.len() as u32, wanted: self.wanted as u32 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hardware::stand::Procedure;
    use std::sync::Arc;

    fn frame(k: u8) -> Upload {
        Upload { depth: vec![k], colour: vec![], description: vec![] }
    }

    #[test]
    fn frames_are_taken_while_a_pile_waits_for_them_and_not_one_more() {
        let inbox = Arc::new(Inbox::default());
        assert_eq!(inbox.add("m", frame(0)), None);
        let procedure = Procedure { frames: 3, ..Procedure::default() };
        let waits = inbox.clone();
        let waiting = std::thread::spawn(move || {
            let piling =
                Piling { job: "m", number: 2, procedure: &procedure, cone_deg: None, seed: 1 };
            waits.collect(&piling, &mut |_| ControlFlow::Continue(()))
        });
        while inbox.awaits("m").is_none() {
            std::thread::yield_now();
        }
        assert_eq!((inbox.awaits("other"), inbox.add("other", frame(9))), (None, None));
        for k in 1..=3 {
            assert_eq!(
                inbox.add("m", frame(k)),
                Some(Awaited { pile: 2, have: u32::from(k), wanted: 3 })
            );
        }
        assert_eq!(inbox.add("m", frame(4)), None);
        assert_eq!(waiting.join().unwrap(), Ok(vec![frame(1), frame(2), frame(3)]));
        assert_eq!(inbox.awaits("m"), None);
    }

    #[test]
    fn whoever_stops_waiting_leaves_no_pile_that_waits() {
        let inbox = Inbox::default();
        let procedure = Procedure::default();
        let piling = Piling { job: "m", number: 1, procedure: &procedure, cone_deg: None, seed: 1 };
        assert_eq!(inbox.collect(&piling, &mut |_| ControlFlow::Break(())), Err(Unpiled::Stopped));
        assert_eq!(inbox.awaits("m"), None);
    }
}
