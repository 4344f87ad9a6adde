//! The stop of one dose: a flag for whoever moves, and a bell for whoever waits.

use std::sync::atomic::{AtomicBool, Ordering};
use tokio::sync::Notify;

/// Anybody presses it; the lane alone waits for it.
#[derive(Debug, Default)]
pub(super) struct StopSign {
    flag: AtomicBool,
    bell: Notify,
}

impl StopSign {
    /// From now on nothing is begun, and nothing is waited for.
    pub fn press(&self) {
        self.flag.store(true, Ordering::SeqCst);
        // Kept for whoever begins to wait afterwards.
        self.bell.notify_one();
    }

    /// Somebody has pressed it.
    pub fn is_pressed(&self) -> bool {
        self.flag.load(Ordering::SeqCst)
    }

    /// What is looked at before every motion.
    pub fn flag(&self) -> &AtomicBool {
        &self.flag
    }

    /// Wait until somebody presses it.
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
