//! The stop of one dose: a flag for the code that moves, and a notification for the code that
//! waits.

use std::sync::atomic::{AtomicBool, Ordering};
use tokio::sync::Notify;

/// Anyone may press it; only the lane waits for it.
#[derive(Debug, Default)]
pub(super) struct StopSign {
    flag: AtomicBool,
    bell: Notify,
}

impl StopSign {
    /// From now on nothing is started and nothing is waited for.
    pub fn press(&self) {
        self.flag.store(true, Ordering::SeqCst);
        // Kept for a waiter that arrives later.
        self.bell.notify_one();
    }

    /// Whether it has been pressed.
    pub fn is_pressed(&self) -> bool {
        self.flag.load(Ordering::SeqCst)
    }

    /// The flag that is checked before every motion.
    pub fn flag(&self) -> &AtomicBool {
        &self.flag
    }

    /// Waits until it is pressed.
    pub async fn pressed(&self) {
        while !self.is_pressed() {
            self.bell.notified().await;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    #[tokio::test]
    async fn whoever_waits_hears_of_a_press_from_before_and_of_one_that_comes() {
        let sign = Arc::new(StopSign::default());
        let waits = tokio::spawn({
            let sign = sign.clone();
            async move { sign.pressed().await }
        });
        tokio::task::yield_now().await;
        assert!(!sign.is_pressed() && !waits.is_finished());
        sign.press();
        waits.await.unwrap();
        sign.pressed().await;
        assert!(sign.flag().load(Ordering::SeqCst));
    }
}
