//! What passed over a bench's wires, for whoever keeps the record.

use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Which way something went.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Direction {
    /// To the device.
    Sent,
    /// From the device.
    Received,
}

/// One message between FLIP and a device.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Exchange {
    /// Which device, as messages name it.
    pub device: String,
    /// Which way.
    pub direction: Direction,
    /// The message: text as it was with control characters escaped, binary frames in hexadecimal, remote calls by name and arguments.
    pub text: String,
}

/// Hears of every message as it passes. Called by the thread that talks to the device, so it must be quick.
#[derive(Clone)]
pub struct Tap(Arc<dyn Fn(Exchange) + Send + Sync>);

impl Tap {
    /// Whoever hears of messages.
    pub fn new(hear: impl Fn(Exchange) + Send + Sync + 'static) -> Self {
        Self(Arc::new(hear))
    }

    /// Nobody listens.
    pub fn none() -> Self {
        Self::new(|_| {})
    }

    /// Text went to a device.
    pub fn sent(&self, device: &str, text: impl Into<String>) {
        (self.0)(Exchange { device: device.to_owned(), direction: Direction::Sent, text: text.into() });
    }

    /// Text came from a device.
    pub fn received(&self, device: &str, text: impl Into<String>) {
        (self.0)(Exchange { device: device.to_owned(), direction: Direction::Received, text: text.into() });
    }
}

impl std::fmt::Debug for Tap {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Tap")
    }
}

/// Bytes as text that shows what they are: printable ASCII as it is, the rest escaped.
pub fn shown(bytes: &[u8]) -> String {
    bytes.escape_ascii().to_string()
}
