//! The thread that tells the arm to stand still: whoever presses stop does not wait for the arm's answer.

use std::io;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};

/// Tells the arm. Dropping it ends its thread.
pub(super) struct Halter {
    halt: Arc<dyn Fn() + Send + Sync>,
    say: Sender<()>,
}

impl Halter {
    /// With a thread of its own.
    ///
    /// # Errors
    /// The system has none left.
    pub fn start(halt: Arc<dyn Fn() + Send + Sync>) -> io::Result<Self> {
        let (say, hear) = channel();
        let telling = halt.clone();
        std::thread::Builder::new().name("stop".into()).spawn(move || tell(&hear, &*telling))?;
        Ok(Self { halt, say })
    }

    /// Tell the arm now; nothing is waited for.
    pub fn tell(&self) {
        if self.say.send(()).is_err() {
            // The thread broke down in an earlier stop. This one has its own.
            let halt = self.halt.clone();
            if let Err(error) = std::thread::Builder::new().name("stop".into()).spawn(move || halt()) {
                tracing::error!(%error, "the arm could not be told of a stop: it hears of it before its next motion");
            }
        }
    }
}

fn tell(hear: &Receiver<()>, halt: &(dyn Fn() + Send + Sync)) {
    while hear.recv().is_ok() {
        // One message stops for all who asked until it is sent.
        while hear.try_recv().is_ok() {}
        halt();
    }
}
