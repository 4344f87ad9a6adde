//! API tokens: `flip_<id>_<secret>`. The secret has 256 random bits, so its plain SHA-256 cannot be guessed back and no
//! slow hash is needed.

use super::check::Check;
use super::{App, Error, Result};
use crate::store::tokens::Role;
use rand::TryRng;
use rand::rngs::SysRng;
use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;

impl App {
    /// Make a token and return its secret, which is shown once and not stored.
    pub async fn create_token(&self, name: &str, role: Role) -> Result<String> {
        let mut check = Check::default();
        check.text("name", name, 100);
        check.done()?;
        let mut random = [0u8; 40];
        SysRng.try_fill_bytes(&mut random).map_err(|error| Error::Internal(error.into()))?;
        let (id, secret) = random.split_at(8);
        let id = hex::encode(id);
        let token = format!("flip_{id}_{}", hex::encode(secret));
        let mut tx = self.store().write().await?;
        tx.insert_token(&id, name, role, &Sha256::digest(&token)).await?;
        tx.commit().await?;
        Ok(token)
    }

    /// The role of a token's holder; `None` when the secret belongs to no token.
    pub async fn authenticate(&self, secret: &str) -> Result<Option<Role>> {
        let Some(id) = secret.strip_prefix("flip_").and_then(|rest| rest.split('_').next()) else { return Ok(None) };
        let Some((sha256, role)) = self.store().token(id).await? else { return Ok(None) };
        let same = Sha256::digest(secret).ct_eq(sha256.as_slice());
        Ok(bool::from(same).then_some(role))
    }

    /// Whether any token exists: the first start prints one.
    pub async fn has_tokens(&self) -> Result<bool> {
        Ok(self.store().has_tokens().await?)
    }
}
