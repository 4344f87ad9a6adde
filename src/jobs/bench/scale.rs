//! The balance while nothing is dosed.

use super::{Bench, audit_exchanges};
use flip_bench::hardware::DeviceError;
use flip_bench::rig::{Order, Shown};
use flip_core::domain::vial::Pan;
use flip_store::{self as store, now};

impl Bench {
    /// What the balance shows.
    ///
    /// # Errors
    /// [`DeviceError`]: there is none between doses, a dose or a pile is being made, or it failed.
    pub async fn read_balance(&self) -> Result<Shown, DeviceError> {
        self.order(Order::Show).await
    }

    /// Tares or zeroes the balance and records it, with the load that its zero stands for from then
    /// on. No dose may start meanwhile: hold [`Bench::alone`].
    ///
    /// # Errors
    /// [`store::Error`]: nothing was asked of the balance, or what it did is not recorded; what its
    /// zero stands for is unknown then. Inside, why the balance did not.
    pub async fn zero_balance(&self, order: Order) -> store::Result<Result<Shown, DeviceError>> {
        let pan = self.condition.pan();
        let meanwhile = pan.being_zeroed();
        self.record_zero(&meanwhile, None).await?;
        let shown = self.order(order).await;
        let before_mg = shown.as_ref().ok().and_then(|shown| shown.before_mg);
        let after = before_mg.map_or(meanwhile, |mg| pan.zeroed(mg, self.readability_mg()));
        self.record_zero(&after, Some((order, &shown))).await?;
        Ok(shown)
    }

    /// Records the pan, unless the bench exchanges vials, and what was done.
    async fn record_zero(
        &self,
        pan: &Pan,
        done: Option<(Order, &Result<Shown, DeviceError>)>,
    ) -> store::Result<()> {
        let mut tx = self.store.write().await?;
        if let Some((order, shown)) = done {
            let details = match shown {
                Ok(Shown { before_mg, reading, .. }) => {
                    serde_json::json!({ "before_mg": before_mg, "shows_mg": reading.mass_mg })
                }
                Err(error) => serde_json::json!({ "failed": error.to_string() }),
            };
            tx.audit_deed(None, order.verb(), details, now()).await?;
            let exchanges = shown.as_ref().map_or(&[][..], |shown| &shown.exchanges);
            audit_exchanges(&mut tx, None, exchanges, now()).await?;
        }
        if !self.exchanges_vials() {
            tx.set_pan(pan).await?;
        }
        tx.commit().await?;
        if !self.exchanges_vials() {
            self.condition.set_pan(pan.clone());
        }
        Ok(())
    }

    async fn order(&self, order: Order) -> Result<Shown, DeviceError> {
        let rig = self.rig.clone();
        let asked = tokio::task::spawn_blocking(move || rig.balance(order)).await;
        asked.unwrap_or_else(|error| {
            Err(DeviceError::Faulted { device: "the balance", cause: error.to_string() })
        })
    }
}
