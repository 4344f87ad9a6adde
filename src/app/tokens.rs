//! API tokens: `flip_<id>_<secret>`. The secret has 256 random bits, so its plain SHA-256 cannot be
//! reversed by guessing and no slow hash is needed.

use super::check::Check;
use super::keyring::Holder;
use super::{App, Error, Result};
use flip_core::domain::timestamp::Timestamp;
use flip_store::now;
use flip_store::page::{LIST_LIMIT_MAX, Page, PageQuery};
use flip_store::tokens::{HashedToken, Role, TokenEntry};
use flip_store::who::{Who, acting_maybe};
use rand::TryRng;
use rand::rngs::SysRng;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::time::Duration;

/// Maximum lifetime that can be requested, s: 100 years of 365 days.
const LIFE_S_MAX: u64 = 100 * 365 * 86_400;
/// How often the tokens are reread from the database: another process may have revoked one.
const LOOK: Duration = Duration::from_secs(1);
/// Number of rereads between two updates of when tokens were last used.
const LOOKS_A_NOTE: u32 = 60;

/// A token to create.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NewToken {
    /// Holder of the token, for the record.
    pub name: String,
    /// What the holder may do.
    pub role: Role,
    /// Whether the holder may clear a latched bench; an admin always may.
    #[serde(default)]
    pub may_clear: bool,
    /// Seconds until it expires; default never.
    #[serde(default, alias = "expires_in", skip_serializing_if = "Option::is_none")]
    pub expires_in_s: Option<u64>,
}

impl App {
    /// Creates a token of this role that does not expire; returns its secret.
    ///
    /// # Errors
    /// As [`App::make_token`].
    pub async fn create_token(&self, name: &str, role: Role) -> Result<String> {
        let new = NewToken { name: name.to_owned(), role, may_clear: false, expires_in_s: None };
        Ok(self.make_token(&new).await?.1)
    }

    /// Creates a token; returns its entry, and its secret, which is shown once and not stored.
    ///
    /// # Errors
    /// `Invalid`: the name, or a lifetime of more than 100 years or less than a second.
    pub async fn make_token(&self, new: &NewToken) -> Result<(TokenEntry, String)> {
        let mut check = Check::default();
        check.text("name", &new.name, 100);
        if let Some(life_s) = new.expires_in_s.filter(|life_s| !(1..=LIFE_S_MAX).contains(life_s)) {
            check.refuse("expires_in_s", format!("must be from 1 to {LIFE_S_MAX} s, got {life_s}"));
        }
        check.done()?;
        self.issue_token(new, None).await
    }

    /// Creates a token; for a log-in, with its provider and the provider's own name for the holder,
    /// who is then on record as its maker.
    pub(super) async fn issue_token(
        &self,
        new: &NewToken,
        account: Option<(&str, &str)>,
    ) -> Result<(TokenEntry, String)> {
        let mut random = [0u8; 40];
        SysRng.try_fill_bytes(&mut random).map_err(|error| Error::Internal(error.into()))?;
        let (id, secret) = random.split_at(8);
        let secret = format!("flip_{}_{}", hex::encode(id), hex::encode(secret));
        let mut entry = entry(hex::encode(id), new);
        let mut who = Who::now();
        if let Some((issuer, subject)) = account {
            (entry.issuer, entry.subject) = (Some(issuer.to_owned()), Some(subject.to_owned()));
            let (name, id) = (entry.name.clone(), entry.id.clone());
            who = Some(Who { name, token: Some(id), role: Some(entry.role) });
        }
        let token = HashedToken { entry, sha256: Sha256::digest(&secret).to_vec() };
        acting_maybe(who, async {
            let mut tx = self.store().write().await?;
            tx.insert_token(&token).await?;
            tx.commit().await
        })
        .await?;
        self.inner.keyring.look(self.store()).await?;
        Ok((token.entry, secret))
    }

    /// Tokens, newest first, including ended ones; never their secrets.
    ///
    /// # Errors
    /// `Invalid`
    pub async fn tokens(&self, page: PageQuery) -> Result<Page<TokenEntry>> {
        let mut page = self.store().tokens(page.window(LIST_LIMIT_MAX)?).await?;
        let uses = self.inner.keyring.uses();
        for entry in &mut page.items {
            let used = uses.iter().find(|(id, _)| *id == entry.id).map(|(_, at)| *at);
            entry.last_used_at = entry.last_used_at.max(used);
        }
        Ok(page)
    }

    /// Revokes a token with immediate effect; one that has ended is left unchanged.
    ///
    /// # Errors
    /// `NotFound`
    pub async fn revoke_token(&self, id: &str) -> Result<TokenEntry> {
        let mut tx = self.store().write().await?;
        let revoked =
            tx.revoke_token(id, now()).await?.ok_or_else(|| Error::not_found("token", id))?;
        tx.commit().await?;
        self.inner.keyring.look(self.store()).await?;
        Ok(revoked)
    }

    /// Holder of a token; `None` if the secret belongs to no valid token. Reads only memory.
    pub fn authenticate(&self, secret: &str) -> Option<Holder> {
        self.inner.keyring.holder(secret)
    }

    /// Holder of the newest valid token with this name, for callers who cannot show one. Reads only
    /// memory.
    pub fn holder_named(&self, name: &str) -> Option<Holder> {
        self.inner.keyring.named(name)
    }

    /// As [`App::authenticate`], after rereading the table: another process may just have created
    /// the token.
    pub async fn authenticate_late(&self, secret: &str) -> Option<Holder> {
        if !secret.starts_with("flip_") {
            return None;
        }
        self.inner.keyring.look_after_a_miss(self.store()).await;
        self.authenticate(secret)
    }

    /// Follows changes to the tokens by other processes, and stores when tokens were last used,
    /// until dropped.
    pub async fn keep_tokens(self) {
        let mut looks = 0u32;
        loop {
            tokio::time::sleep(LOOK).await;
            if let Err(error) = self.inner.keyring.look(self.store()).await {
                tracing::warn!(%error, "the tokens could not be looked up; those known so far count");
            }
            looks += 1;
            if looks.is_multiple_of(LOOKS_A_NOTE) {
                self.note_uses().await;
            }
        }
    }

    /// Stores when tokens were last used.
    pub(super) async fn note_uses(&self) {
        let uses = self.inner.keyring.uses();
        let noted = async {
            let mut tx = self.store().write().await?;
            tx.note_uses(&uses).await?;
            tx.commit().await
        };
        if !uses.is_empty()
            && let Err(error) = noted.await
        {
            tracing::warn!(%error, "when tokens were last used was not written down; the next try may");
        }
    }

    /// Whether any token exists: the first start prints one.
    pub async fn has_tokens(&self) -> Result<bool> {
        Ok(self.store().has_tokens().await?)
    }
}

fn entry(id: String, new: &NewToken) -> TokenEntry {
    let created_at = now();
    let life_ms = new.expires_in_s.map(|life_s| life_s as i64 * 1000);
    TokenEntry {
        id,
        name: new.name.clone(),
        role: new.role,
        may_clear: new.may_clear || new.role == Role::Admin,
        created_at,
        expires_at: life_ms.map(|ms| Timestamp::from_unix_ms(created_at.unix_ms() + ms)),
        revoked_at: None,
        last_used_at: None,
        issuer: None,
        subject: None,
    }
}
