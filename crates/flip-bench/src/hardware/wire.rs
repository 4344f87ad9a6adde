//! Traffic on a bench's wires, for the record.

use serde::{Deserialize, Serialize};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Direction of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Direction {
    /// To the device.
    Sent,
    /// From the device.
    Received,
}

/// One message between FLIP and a device.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Exchange {
    /// Name of the device used in messages.
    pub device: String,
    /// Its direction.
    pub direction: Direction,
    /// The message: text verbatim with control characters escaped, binary frames in hexadecimal,
    /// remote calls by name and arguments.
    pub text: String,
}

/// Receives every message as it passes. Called by the thread that talks to the device, so it must
/// be quick.
#[derive(Clone)]
pub struct Tap(Arc<dyn Fn(Exchange) + Send + Sync>);

impl Tap {
    /// A tap that calls `hear` for every message.
    pub fn new(hear: impl Fn(Exchange) + Send + Sync + 'static) -> Self {
        Self(Arc::new(hear))
    }

    /// A tap that ignores messages.
    pub fn none() -> Self {
        Self::new(|_| {})
    }

    /// Record text sent to a device.
    pub fn sent(&self, device: &str, text: impl Into<String>) {
        (self.0)(Exchange {
            device: device.to_owned(),
            direction: Direction::Sent,
            text: text.into(),
        });
    }

    /// Record text received from a device.
    pub fn received(&self, device: &str, text: impl Into<String>) {
        (self.0)(Exchange {
            device: device.to_owned(),
            direction: Direction::Received,
            text: text.into(),
        });
    }
}

impl std::fmt::Debug for Tap {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Tap")
    }
}

/// Keeps messages until they are taken. Clones share them.
#[derive(Clone, Default)]
pub struct Recorder(Arc<Mutex<Vec<Exchange>>>);

impl Recorder {
    /// A tap into this recorder.
    pub fn tap(&self) -> Tap {
        let kept = self.clone();
        Tap::new(move |exchange| kept.locked().push(exchange))
    }

    /// Takes what has passed since the last call.
    pub fn take(&self) -> Vec<Exchange> {
        std::mem::take(&mut *self.locked())
    }

    fn locked(&self) -> MutexGuard<'_, Vec<Exchange>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Bytes as readable text: printable ASCII verbatim, the rest escaped.
pub fn shown(bytes: &[u8]) -> String {
    bytes.escape_ascii().to_string()
}
