//! What jobs may be asked to compute on.

use super::{App, Result};
use flip_core::domain::FieldError;
use flip_core::domain::device::Device;
use flip_core::domain::job::JobKind;
use flip_store::now;
use flip_store::workers::Worker;

/// A worker that was not heard of for so long is not counted on, ms: it says at least twice in this time
/// that it is there.
const SILENT_MS: i64 = 20_000;

impl App {
    /// Refuses a device on which nobody would compute a job of this kind.
    ///
    /// # Errors
    /// `Invalid`, `device`: what was found instead of a card, and what to do.
    pub async fn check_device(&self, kind: JobKind, device: Device) -> Result<()> {
        if device.is_cpu() {
            return Ok(());
        }
        let Err(found) = self.jobs_or_refuse()?.card().await else { return Ok(()) };
        let is_there = |it: &Worker| {
            let since_ms = now().unix_ms() - it.heard_at.unix_ms();
            it.card.is_some()
                && it.kinds.contains(&kind)
                && it.ended_at.is_none()
                && since_ms < SILENT_MS
        };
        // Where only this process computes, older rows are of processes that are gone.
        if self.store().is_shared() && self.workers().await?.iter().any(is_there) {
            return Ok(());
        }
        let advice = match self.store().is_shared() {
            true => ", by leaving this field out, or start `flip worker` on a machine with a card",
            false => ", by leaving this field out",
        };
        Err(FieldError::new("device", format!("no graphics card can be used: {found}{advice}"))
            .into())
    }
}
