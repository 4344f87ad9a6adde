//! The thread that commands the arm to stop: a stop request does not wait for the arm's reply.

use flip_bench::rig::Rig;
use std::io;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};

/// Notifies the arm. Dropping it ends its thread.
pub(super) struct Halter {
    rig: Arc<dyn Rig>,
    say: Sender<()>,
}

impl Halter {
    /// Creates it with its own thread.
    ///
    /// # Errors
    /// The system cannot spawn a thread.
    pub fn start(rig: Arc<dyn Rig>) -> io::Result<Self> {
        let (say, hear) = channel();
        let telling = rig.clone();
        std::thread::Builder::new().name("stop".into()).spawn(move || tell(&hear, &*telling))?;
        Ok(Self { rig, say })
    }

    /// Commands the arm to stop now, without waiting.
    pub fn tell(&self) {
        if self.say.send(()).is_err() {
            // The thread panicked during an earlier stop. This stop gets its own.
            let rig = self.rig.clone();
            if let Err(error) =
                std::thread::Builder::new().name("stop".into()).spawn(move || halt(&*rig))
            {
                tracing::error!(%error, "the arm could not be told of a stop: it hears of it before its next motion");
            }
        }
    }
}

fn tell(hear: &Receiver<()>, rig: &dyn Rig) {
    while hear.recv().is_ok() {
        // One message serves all requests queued until it is sent.
        while hear.try_recv().is_ok() {}
        halt(rig);
    }
}

fn halt(rig: &dyn Rig) {
    if let Err(error) = rig.halt() {
        tracing::error!(%error, "the arm could not be told to stop: its dead-man acts");
    }
}
