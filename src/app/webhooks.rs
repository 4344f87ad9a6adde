//! Webhooks: messages to addresses of the laboratory when something has ended, for schedulers that
//! cannot hold a stream.
//!
//! Messages are signed and numbered as Standard Webhooks 1.0 has it (standardwebhooks.com): the id of
//! a message is that of its event, so whoever gets one twice knows it. A message is repeated until it
//! is accepted; how far an address has been told is stored, so that a restart loses none.

use super::agent::agent;
use super::check::Check;
use super::{App, Error, Result};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flip_store::new_id;
use flip_store::webhooks::{Webhook, WebhookRow};
use rand::TryRng;
use rand::rngs::SysRng;
use ring::hmac;
use serde::{Deserialize, Serialize};
use std::sync::LazyLock;
use std::time::Duration;
use ureq::Agent;
use ureq::http::Uri;

/// Most webhooks.
const WEBHOOKS_MAX: usize = 20;
/// How long an address may take to accept a message.
const ANSWER_MAX: Duration = Duration::from_secs(15);

/// An address to tell of ends.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NewWebhook {
    /// Where messages go, http or https.
    pub url: String,
}

static AGENT: LazyLock<Agent> = LazyLock::new(|| agent(ANSWER_MAX));

impl App {
    /// Whether this process tells webhooks: of those that serve a database, the one that has the
    /// first bench by name.
    pub(crate) async fn tells_webhooks(&self) -> bool {
        if self.store().bench_owner().is_none() {
            return true;
        }
        let benches = self.store().benches().await.unwrap_or_default();
        let first = benches.into_iter().find(|bench| bench.served);
        first.is_none_or(|bench| bench.name == self.store().bench_name())
    }

    /// Adds a webhook; returns it, and the secret that its messages are signed with, which is shown
    /// once.
    ///
    /// # Errors
    /// `Invalid`; `Conflict` (`too_many_webhooks`); `Unavailable` if opened read-only.
    pub async fn add_webhook(&self, new: &NewWebhook) -> Result<(Webhook, String)> {
        let mut check = Check::default();
        let uri = new.url.parse::<Uri>().ok();
        let fits = uri.is_some_and(|uri| {
            matches!(uri.scheme_str(), Some("http" | "https")) && uri.host().is_some()
        });
        if !fits || new.url.len() > 2000 {
            let advice =
                "must be an address such as https://lims.lab.example/flip, at most 2000 characters";
            check.refuse("url", advice.to_owned());
        }
        check.done()?;
        if self.store().webhooks().await?.len() >= WEBHOOKS_MAX {
            let advice = format!("there are {WEBHOOKS_MAX} webhooks already: remove one first");
            return Err(Error::conflict("too_many_webhooks", advice));
        }
        let mut secret = [0u8; 32];
        SysRng.try_fill_bytes(&mut secret).map_err(|error| Error::Internal(error.into()))?;
        let webhook = Webhook {
            id: format!("wh-{}", new_id()),
            url: new.url.clone(),
            created_at: flip_store::now(),
            failing_since: None,
            error: None,
        };
        let mut tx = self.store().write().await?;
        tx.insert_webhook(&webhook, &secret).await?;
        tx.commit().await?;
        Ok((webhook, format!("whsec_{}", STANDARD.encode(secret))))
    }

    /// Every webhook, the oldest first; never their secrets.
    pub async fn webhooks(&self) -> Result<Vec<Webhook>> {
        Ok(self.store().webhooks().await?.into_iter().map(|row| row.webhook).collect())
    }

    /// Removes a webhook: it gets no further message.
    ///
    /// # Errors
    /// `NotFound`; `Unavailable` if opened read-only.
    pub async fn remove_webhook(&self, id: &str) -> Result<()> {
        let mut tx = self.store().write().await?;
        if !tx.remove_webhook(id).await? {
            return Err(Error::not_found("webhook", id));
        }
        Ok(tx.commit().await?)
    }

    /// Every webhook, with the secret and how far it has been told.
    pub(crate) async fn webhook_rows(&self) -> Result<Vec<WebhookRow>> {
        Ok(self.store().webhooks().await?)
    }

    /// Sends a message, and notes whether it arrived. `Ok(false)`: it did not.
    pub(crate) async fn send_to_webhook(
        &self,
        row: &WebhookRow,
        seq: i64,
        body: String,
    ) -> Result<bool> {
        let (url, id) = (row.webhook.url.clone(), format!("event-{seq}"));
        let at = flip_store::now().unix_ms() / 1000;
        let signature = signature(&row.secret, &id, at, &body);
        let send = move || {
            AGENT
                .post(&url)
                .header("content-type", "application/json")
                .header("webhook-id", &id)
                .header("webhook-timestamp", at.to_string())
                .header("webhook-signature", signature)
                .send(body)
        };
        let sent = tokio::task::spawn_blocking(send).await;
        let failed = match sent.map_err(|error| Error::Internal(error.into()))? {
            Ok(response) if response.status().is_success() => None,
            Ok(response) => Some(format!("it answered {}", response.status())),
            Err(error) => Some(error.to_string()),
        };
        let mut tx = self.store().write().await?;
        match &failed {
            None => tx.webhook_told(&row.webhook.id, seq).await?,
            Some(why) => tx.webhook_failed(&row.webhook.id, why).await?,
        }
        tx.commit().await?;
        Ok(failed.is_none())
    }

    /// Notes that a webhook needs no message of events up to `seq`.
    pub(crate) async fn skip_for_webhook(&self, id: &str, seq: i64) -> Result<()> {
        let mut tx = self.store().write().await?;
        tx.webhook_told(id, seq).await?;
        Ok(tx.commit().await?)
    }
}

/// `v1,` and the HMAC-SHA256 of id, time and body, in base64 (Standard Webhooks 1.0, Signature
/// scheme).
fn signature(secret: &[u8], id: &str, at: i64, body: &str) -> String {
    let key = hmac::Key::new(hmac::HMAC_SHA256, secret);
    let tag = hmac::sign(&key, format!("{id}.{at}.{body}").as_bytes());
    format!("v1,{}", STANDARD.encode(tag))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_is_signed_as_the_specification_shows() {
        // The example of the specification and of its libraries.
        let secret = STANDARD.decode("MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw").unwrap();
        let made = signature(
            &secret,
            "msg_p5jXN8AQM9LWM0D4loKWxJek",
            1_614_265_330,
            r#"{"test": 2432232314}"#,
        );
        assert_eq!(made, "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE=");
    }
}
