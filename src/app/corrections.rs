//! Measurements that turn out to be wrong: withdrawn or corrected with a reason. The old row stays
//! and is shown, and nothing uses it again.

use super::check::Check;
use super::{App, Error, NewMeasurement, NewObservation, Result};
use flip_core::domain::FieldError;
use flip_store::Tx;
use flip_store::now;
use flip_store::observations::PowderObservation;
use flip_store::powders::Measurement;
use flip_store::withdrawals::{Withdrawn, said};
use serde::{Deserialize, Serialize};
use serde_json::json;

/// Maximum length of a reason, characters.
const REASON_CHARS_MAX: usize = 500;

/// Why a measurement no longer counts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WithdrawalRequest {
    /// The reason, 1 to 500 characters.
    pub reason: String,
}

/// What a measurement should have been, and why it was wrong.
#[derive(Debug, Clone, PartialEq)]
pub struct Correction<T> {
    /// The reason, 1 to 500 characters.
    pub reason: String,
    /// The corrected measurement, in full.
    pub corrected: T,
}

impl App {
    /// Withdraws a measurement of a powder: from now on it is shown and not used.
    ///
    /// # Errors
    /// `NotFound`; `Invalid`; `Conflict` (`withdrawn`).
    pub async fn withdraw_measurement(
        &self,
        powder: &str,
        id: &str,
        request: WithdrawalRequest,
    ) -> Result<Measurement> {
        let reason = reason(&request.reason)?;
        let mut tx = self.store().write().await?;
        let mut old = counts(tx.measurement(powder, id).await?, id, |it| it.withdrawn.is_none())?;
        old.withdrawn = Some(withdraw(tx, powder, id, &reason, "withdraw measurement").await?);
        Ok(old)
    }

    /// Puts a corrected measurement in the place of one; returns the new one.
    ///
    /// # Errors
    /// As for [`App::withdraw_measurement`], and those of a new measurement.
    pub async fn correct_measurement(
        &self,
        powder: &str,
        id: &str,
        correction: Correction<NewMeasurement>,
    ) -> Result<Measurement> {
        let mut check = Check::default();
        let reason = check.keep(reason(&correction.reason));
        let new = correction.corrected.checked(&mut check);
        check.done()?;
        let (Some(reason), Some((method, flowability, origin))) = (reason, new) else {
            unreachable!("checked above")
        };
        let mut tx = self.store().write().await?;
        counts(tx.measurement(powder, id).await?, id, |it| it.withdrawn.is_none())?;
        let new = tx.insert_measurement(powder, method, flowability, &origin).await?;
        let withdrawn = tx.withdraw(id, &reason, Some(&new.id)).await?;
        let body = json!({ "measurement": new, "withdrawal": said(id, &withdrawn) });
        finish(tx, "correct measurement", body).await?;
        Ok(new)
    }

    /// Withdraws an observation of a powder: from now on it is shown and not used.
    ///
    /// # Errors
    /// As for [`App::withdraw_measurement`].
    pub async fn withdraw_observation(
        &self,
        powder: &str,
        id: &str,
        request: WithdrawalRequest,
    ) -> Result<PowderObservation> {
        let reason = reason(&request.reason)?;
        let mut tx = self.store().write().await?;
        let mut old = counts(tx.observation(powder, id).await?, id, |it| it.withdrawn.is_none())?;
        old.withdrawn = Some(withdraw(tx, powder, id, &reason, "withdraw observation").await?);
        Ok(old)
    }

    /// Puts a corrected observation in the place of one; returns the new one.
    ///
    /// # Errors
    /// As for [`App::withdraw_measurement`], and those of a new observation.
    pub async fn correct_observation(
        &self,
        powder: &str,
        id: &str,
        correction: Correction<NewObservation>,
    ) -> Result<PowderObservation> {
        let mut check = Check::default();
        let reason = check.keep(reason(&correction.reason));
        let new = correction.corrected.checked(&mut check);
        check.done()?;
        let (Some(reason), Some((observed, origin))) = (reason, new) else {
            unreachable!("checked above")
        };
        let mut tx = self.store().write().await?;
        counts(tx.observation(powder, id).await?, id, |it| it.withdrawn.is_none())?;
        let new = tx.insert_observation(powder, &observed, &origin).await?;
        let withdrawn = tx.withdraw(id, &reason, Some(&new.id)).await?;
        let body = json!({ "observation": new, "withdrawal": said(id, &withdrawn) });
        finish(tx, "correct observation", body).await?;
        Ok(new)
    }
}

/// Withdraws a row that counts, and records it.
async fn withdraw(
    mut tx: Tx,
    powder: &str,
    id: &str,
    reason: &str,
    action: &str,
) -> Result<Withdrawn> {
    let withdrawn = tx.withdraw(id, reason, None).await?;
    let body = json!({ "withdrawal": said(id, &withdrawn), "powder_id": powder });
    finish(tx, action, body).await?;
    Ok(withdrawn)
}

async fn finish(mut tx: Tx, action: &str, body: serde_json::Value) -> Result<()> {
    tx.audit_deed(None, action, body, now()).await?;
    Ok(tx.commit().await?)
}

/// The row, if it is there and still counts.
fn counts<T>(found: Option<T>, id: &str, still: impl Fn(&T) -> bool) -> Result<T> {
    let found = found.ok_or_else(|| Error::not_found("measurement of this powder", id))?;
    match still(&found) {
        true => Ok(found),
        false => {
            let advice = format!("measurement {id} was withdrawn before: its reason is beside it");
            Err(Error::conflict("withdrawn", advice))
        }
    }
}

fn reason(text: &str) -> std::result::Result<String, FieldError> {
    let text = text.trim();
    let mut check = Check::default();
    check.text("reason", text, REASON_CHARS_MAX);
    match check.refusals() {
        Ok(()) => Ok(text.to_owned()),
        Err(mut errors) => Err(errors.remove(0)),
    }
}
