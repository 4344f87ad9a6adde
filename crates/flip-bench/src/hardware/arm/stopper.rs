//! Stop the arm from any thread, whatever its owner is doing.

use super::proto::{StopRequest, arm_client::ArmClient};
use super::remote::Remote;
use crate::hardware::DeviceError;
use std::time::Duration;
use tonic::transport::Channel;

/// Stops the arm over its own connection. Clones share it.
///
/// This is a message, not an emergency stop: that one is wired.
#[derive(Clone)]
pub struct Stopper {
    remote: Remote,
    limit: Duration,
}

impl Stopper {
    pub(super) fn connect(
        beside: &Remote,
        url: &str,
        limit: Duration,
    ) -> Result<Self, DeviceError> {
        Ok(Self { remote: beside.beside(url, limit)?, limit })
    }

    /// Stop now; returns when the spoon is at rest. It is not level yet: call
    /// [`Arm::retract`](super::Arm::retract), or drop the arm.
    ///
    /// # Errors
    /// The driver did not answer, or cannot be reached: if the connection is gone, its dead-man
    /// acts.
    pub fn stop(&self, reason: &str) -> Result<(), DeviceError> {
        // After a broken connection the first call may only discover that; the second reconnects.
        match self.once(reason) {
            Err(DeviceError::Lost { .. }) => self.once(reason),
            answer => answer,
        }
    }

    fn once(&self, reason: &str) -> Result<(), DeviceError> {
        let request = StopRequest { reason: reason.chars().take(200).collect() };
        let call = |mut client: ArmClient<Channel>| async move { client.stop(request).await };
        self.remote.ask("Stop".to_owned(), self.limit, call).map(drop)
    }
}
