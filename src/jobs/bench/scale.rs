//! The balance while nothing is dosed.

use super::{Bench, audit_exchanges};
use flip_bench::hardware::DeviceError;
use flip_bench::rig::{Order, Shown};
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
    /// After a refusal, or where the record fails, the pan is known as before: if the balance did
    /// not follow, a vial with powder in it is still recognised.
    ///
    /// # Errors
    /// [`store::Error`]: what the balance did is not recorded. Inside, why it did not.
    pub async fn zero_balance(&self, order: Order) -> store::Result<Result<Shown, DeviceError>> {
        let shown = self.order(order).await;
        let (details, exchanges) = match &shown {
            Ok(Shown { before_mg, reading, exchanges }) => {
                let seen =
                    serde_json::json!({ "before_mg": before_mg, "shows_mg": reading.mass_mg });
                (seen, exchanges.as_slice())
            }
            Err(error) => (serde_json::json!({ "failed": error.to_string() }), &[][..]),
        };
        let mut tx = self.store.write_for_bench().await?;
        tx.audit_deed(None, order.verb(), details, now()).await?;
        audit_exchanges(&mut tx, None, exchanges, now()).await?;
        let before_mg = shown.as_ref().ok().and_then(|shown| shown.before_mg);
        let pan = before_mg
            .filter(|_| !self.exchanges_vials())
            .map(|mg| self.condition.pan().zeroed(mg, self.readability_mg()));
        if let Some(pan) = &pan {
            tx.set_pan(pan).await?;
        }
        tx.commit().await?;
        pan.into_iter().for_each(|pan| self.condition.set_pan(pan));
        Ok(shown)
    }

    async fn order(&self, order: Order) -> Result<Shown, DeviceError> {
        let rig = self.rig.clone();
        let asked = tokio::task::spawn_blocking(move || rig.balance(order)).await;
        asked.unwrap_or_else(|error| {
            Err(DeviceError::Faulted { device: "the balance", cause: error.to_string() })
        })
    }
}
