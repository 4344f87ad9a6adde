//! API tokens: only their hashes are stored.

use super::row::{Columns, word};
use super::{Result, Store, Tx, now};
use serde::{Deserialize, Serialize};

/// What the holder of a token may do; each role may do what the ones before it may.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Read.
    Viewer,
    /// Start and stop jobs and weighings, add powders.
    Operator,
    /// Everything.
    Admin,
}

impl Store {
    /// Hash and role of a token.
    pub(crate) async fn token(&self, id: &str) -> Result<Option<(Vec<u8>, Role)>> {
        let sql = "SELECT sha256, role FROM token WHERE id = ?1";
        let row = sqlx::query(sql).bind(id).fetch_optional(&self.reader).await?;
        row.map(|row| Ok((row.plain("sha256")?, row.word("role")?))).transpose()
    }

    /// Whether there is any token.
    pub(crate) async fn has_tokens(&self) -> Result<bool> {
        Ok(sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM token)").fetch_one(&self.reader).await?)
    }
}

impl Tx {
    /// Store the hash of a new token's secret.
    pub(crate) async fn insert_token(&mut self, id: &str, name: &str, role: Role, sha256: &[u8]) -> Result<()> {
        let sql = "INSERT INTO token (id, name, role, sha256, created_at) VALUES (?1, ?2, ?3, ?4, ?5)";
        sqlx::query(sql)
            .bind(id)
            .bind(name)
            .bind(word(&role))
            .bind(sha256)
            .bind(now().unix_ms())
            .execute(&mut *self.inner)
            .await?;
        Ok(())
    }
}
