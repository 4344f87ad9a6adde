//! The balance as a scale: read, tared and zeroed while nothing is dosed.

use super::weighings::latched;
use super::{App, Error, Result};
use crate::jobs::bench::Standing;
use flip_bench::hardware::DeviceError;
use flip_bench::rig::{Order, Shown};
use flip_core::domain::timestamp::Timestamp;
use flip_store::now;
use flip_store::who::{Who, acting_maybe};
use serde::{Deserialize, Serialize};

/// What the balance shows while nothing is dosed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BalanceReading {
    /// Display, mg: net of what was tared last.
    pub mass_mg: f64,
    /// Whether the balance calls it stable.
    pub stable: bool,
    /// When it was read.
    pub at: Timestamp,
    /// Readability (display step), mg, where known.
    pub readability_mg: Option<f64>,
    /// The balance as it identified itself at the last dose, if there was one.
    pub balance: Option<String>,
}

/// A request to tare or zero the balance.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BalanceRequest {
    /// The bench reservation under which the request is made, `rs-…`, if any.
    #[serde(default)]
    pub reservation: Option<String>,
}

impl App {
    /// What the balance shows now.
    ///
    /// # Errors
    /// `Conflict` (`no_balance`, `bench_busy`, `balance_failed`).
    pub async fn read_balance(&self) -> Result<BalanceReading> {
        let bench = self.jobs_or_refuse()?.bench();
        is_at_rest(&bench.standing(), self.is_piling()?)?;
        Ok(self.reading(bench.read_balance().await.map_err(refused)?))
    }

    /// Tares the balance with the load on it, and returns what it then shows.
    ///
    /// # Errors
    /// As [`App::zero_balance`].
    pub async fn tare_balance(&self, request: BalanceRequest) -> Result<BalanceReading> {
        self.change_zero(Order::Tare, &request).await
    }

    /// Sets the balance's zero point, and returns what it then shows.
    ///
    /// # Errors
    /// `Conflict` (`no_balance`, `bench_busy`, `bench_latched`, `bench_reserved`,
    /// `reservation_ended`, `ending_unwritten`, `balance_failed`).
    pub async fn zero_balance(&self, request: BalanceRequest) -> Result<BalanceReading> {
        self.change_zero(Order::Zero, &request).await
    }

    async fn change_zero(&self, order: Order, request: &BalanceRequest) -> Result<BalanceReading> {
        self.check_reservation(request.reservation.as_deref())?;
        let app = self.clone();
        let work = async move {
            let bench = app.jobs_or_refuse()?.bench();
            let alone = bench.alone().await;
            let zeroed = app.zero_alone(order).await;
            drop(alone);
            // A dose whose turn came meanwhile.
            bench.wake();
            zeroed
        };
        // What the balance has begun is recorded, also if the caller leaves meanwhile.
        let carried_out = tokio::spawn(acting_maybe(Who::now(), work)).await;
        carried_out.map_err(|error| Error::Internal(error.into()))?
    }

    /// Changes the zero while no dose starts.
    async fn zero_alone(&self, order: Order) -> Result<BalanceReading> {
        let bench = self.jobs_or_refuse()?.bench();
        let standing = bench.standing();
        if let Some(latch) = &standing.latch {
            return Err(latched(latch));
        }
        is_at_rest(&standing, self.is_piling()?)?;
        Ok(self.reading(bench.zero_balance(order).await?.map_err(refused)?))
    }

    fn is_piling(&self) -> Result<bool> {
        let bench = self.jobs_or_refuse()?.bench();
        Ok(bench.stand().is_some_and(|stand| stand.piling().is_some()))
    }

    fn reading(&self, shown: Shown) -> BalanceReading {
        let bench = self.inner.jobs.as_ref().map(|jobs| jobs.bench());
        BalanceReading {
            mass_mg: shown.reading.mass_mg,
            stable: shown.reading.stable,
            at: now(),
            readability_mg: bench.and_then(|bench| bench.readability_mg()),
            balance: bench.and_then(|bench| bench.devices().remove("balance")),
        }
    }
}

/// Refuses while the balance belongs to a dose or a pile.
fn is_at_rest(standing: &Standing, piling: bool) -> Result<()> {
    if let Some(moving) = &standing.moving {
        let advice = format!(
            "weighing {moving} has the balance: ask again when it has ended; its readings are in its trace (GET /v1/weighings/{moving}/trace)"
        );
        return Err(Error::conflict("bench_busy", advice));
    }
    if piling {
        let advice = "a pile is being made: ask again when it has ended";
        return Err(Error::conflict("bench_busy", advice));
    }
    if let Some(unwritten) = &standing.unwritten {
        let advice = format!(
            "the end of weighing {} is not recorded yet: {}",
            unwritten.weighing, unwritten.why
        );
        return Err(Error::conflict("ending_unwritten", advice));
    }
    Ok(())
}

fn refused(error: DeviceError) -> Error {
    let message = format!("{error}: {}", error.advice());
    match error {
        DeviceError::Unsupported { .. } => {
            let advice = "the simulated bench has no balance between doses: start FLIP with `--bench emulated` or with a bench file";
            Error::conflict("no_balance", advice)
        }
        DeviceError::Forbidden { .. } => Error::conflict("bench_busy", message),
        _ => Error::conflict("balance_failed", message),
    }
}
