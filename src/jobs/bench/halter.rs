//! The thread that tells the arm to stand still: whoever presses stop does not wait for the arm's answer.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};

/// Tells the arm. Dropping it ends its thread.
pub(super) struct Halter {
    halt: Arc<dyn Fn() + Send + Sync>,
    say: Option<Sender<()>>,
}

impl Halter {
    /// With a thread of its own; where the system has none left, whoever stops tells the arm himself.
    pub fn start(halt: Arc<dyn Fn() + Send + Sync>) -> Self {
        let (say, hear) = channel();
        let telling = halt.clone();
        let thread = std::thread::Builder::new().name("stop".into()).spawn(move || tell(&hear, &*telling));
        if let Err(error) = &thread {
            tracing::warn!(%error, "there is no thread for stops");
        }
        Self { halt, say: thread.is_ok().then_some(say) }
    }

    /// Tell the arm now.
    pub fn tell(&self) {
        let told = self.say.as_ref().is_some_and(|say| say.send(()).is_ok());
        if !told {
            (self.halt)();
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
