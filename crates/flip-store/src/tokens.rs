//! API tokens: only their hashes are stored, and they are never deleted, because records refer to
//! them.

use super::page::{Page, Window};
use super::row::{Columns, word};
use super::sql::Flag;
use super::{Error, Result, Store, Tx, now};
use crate::artifacts::sha256_hex;
use flip_core::domain::timestamp::Timestamp;
use serde::{Deserialize, Serialize};
use sqlx::any::AnyRow;

/// How long an expired token is still reported, ms: its last use may not be stored yet.
const EXPIRED_KEPT_MS: i64 = 86_400_000;

/// Permissions of a token's holder; each role includes the ones before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Read.
    Viewer,
    /// Start and stop jobs and weighings, add powders.
    Operator,
    /// Everything.
    Admin,
}

/// Metadata of a token; never its secret.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TokenEntry {
    /// Id: the first part of the secret, used in records.
    pub id: String,
    /// Who holds it.
    pub name: String,
    /// Role of its holder.
    pub role: Role,
    /// Whether its holder may clear a latched bench; an admin always may.
    pub may_clear: bool,
    /// When it was created.
    pub created_at: Timestamp,
    /// When it expires; absent if it does not.
    pub expires_at: Option<Timestamp>,
    /// When a person revoked it.
    pub revoked_at: Option<Timestamp>,
    /// When it was last used, to about a minute; absent if it never was.
    pub last_used_at: Option<Timestamp>,
    /// Provider that the holder logged in with; absent for a token that somebody created.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub issuer: Option<String>,
    /// The provider's own name for the holder, which no two people share.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub subject: Option<String>,
}

/// A token with the hash of its secret.
#[derive(Debug, Clone)]
pub struct HashedToken {
    pub entry: TokenEntry,
    pub sha256: Vec<u8>,
}

impl Store {
    /// Every token but those that expired more than a day ago, of which log-ins leave many, on a
    /// connection that nobody else waits for.
    pub async fn every_token(&self) -> Result<Vec<HashedToken>> {
        let sql = "SELECT * FROM token WHERE expires_at IS NULL OR expires_at > $1 ORDER BY seq";
        let since = now().unix_ms() - EXPIRED_KEPT_MS;
        let rows = sqlx::query(sql).bind(since).fetch_all(&self.apart).await?;
        rows.iter()
            .map(|row| Ok(HashedToken { entry: entry(row)?, sha256: row.plain("sha256")? }))
            .collect()
    }

    /// Tokens, newest first.
    pub async fn tokens(&self, window: Window) -> Result<Page<TokenEntry>> {
        let sql = "SELECT * FROM token WHERE seq < $1 ORDER BY seq DESC LIMIT $2";
        let query = sqlx::query(sql).bind(window.before()).bind(window.rows());
        window.page_of(&query.fetch_all(&self.reader).await?, entry)
    }

    /// Whether there are any tokens.
    pub async fn has_tokens(&self) -> Result<bool> {
        let sql = "SELECT EXISTS (SELECT 1 FROM token)";
        let Flag(has) = sqlx::query_scalar(sql).fetch_one(&self.reader).await?;
        Ok(has)
    }
}

impl Tx {
    /// Store the hash of a new token's secret.
    pub async fn insert_token(&mut self, new: &HashedToken) -> Result<()> {
        let sql = "INSERT INTO token (id, name, role, sha256, created_at, expires_at, may_clear, issuer, subject) VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9)";
        let HashedToken { entry, sha256 } = new;
        sqlx::query(sql)
            .bind(&entry.id)
            .bind(&entry.name)
            .bind(word(&entry.role))
            .bind(sha256)
            .bind(entry.created_at.unix_ms())
            .bind(entry.expires_at.map(Timestamp::unix_ms))
            .bind(entry.may_clear)
            .bind(&entry.issuer)
            .bind(&entry.subject)
            .execute(&mut *self.inner)
            .await?;
        let mut said = serde_json::json!({ "token": entry });
        said["token"]["secret"] = mark(sha256).into();
        self.audit_deed(None, "new token", said, now()).await
    }

    /// Revoke a token; one that has ended stays as it was. `None`: there is none.
    pub async fn revoke_token(&mut self, id: &str, now: Timestamp) -> Result<Option<TokenEntry>> {
        let sql =
            "UPDATE token SET revoked_at = $2 WHERE id = $1 AND revoked_at IS NULL RETURNING *";
        let row =
            sqlx::query(sql).bind(id).bind(now.unix_ms()).fetch_optional(&mut *self.inner).await?;
        if let Some(row) = row {
            let revoked = entry(&row)?;
            self.audit_deed(None, "revoke token", serde_json::json!({ "token": revoked }), now)
                .await?;
            return Ok(Some(revoked));
        }
        let row = sqlx::query("SELECT * FROM token WHERE id = $1")
            .bind(id)
            .fetch_optional(&mut *self.inner)
            .await?;
        row.as_ref().map(entry).transpose()
    }

    /// Store when tokens were last used.
    pub async fn note_uses(&mut self, uses: &[(String, Timestamp)]) -> Result<()> {
        let sql =
            "UPDATE token SET last_used_at = max(coalesce(last_used_at, 0), $2) WHERE id = $1";
        for (id, at) in uses {
            sqlx::query(sql).bind(id).bind(at.unix_ms()).execute(&mut *self.inner).await?;
        }
        Ok(())
    }
}

/// The mark of a secret's hash kept in the record: the hash of the hash, which identifies it
/// without granting access.
fn mark(sha256: &[u8]) -> String {
    sha256_hex(sha256)
}

/// The fields of a row, by the names used in its record.
pub(super) fn says(row: &AnyRow) -> Result<serde_json::Value> {
    let mut said =
        serde_json::to_value(entry(row)?).map_err(|error| Error::Corrupt(error.to_string()))?;
    said["secret"] = mark(&row.plain::<Vec<u8>>("sha256")?).into();
    if let Some(fields) = said.as_object_mut() {
        fields.remove("last_used_at");
    }
    Ok(said)
}

fn entry(row: &AnyRow) -> Result<TokenEntry> {
    Ok(TokenEntry {
        id: row.plain("id")?,
        name: row.plain("name")?,
        role: row.word("token", "role")?,
        may_clear: row.flag("may_clear")?,
        created_at: row.time("created_at")?,
        expires_at: row.maybe_time("expires_at")?,
        revoked_at: row.maybe_time("revoked_at")?,
        last_used_at: row.maybe_time("last_used_at")?,
        issuer: row.plain("issuer")?,
        subject: row.plain("subject")?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;

    #[tokio::test]
    async fn tokens_that_expired_long_ago_are_listed_and_not_read_again_and_again() {
        let folder = tempfile::tempdir().unwrap();
        let store = testing::open(folder.path()).await.unwrap();
        let mut tx = store.write().await.unwrap();
        let ends = [None, Some(-2), Some(-25), Some(1)];
        for (k, hours) in ends.into_iter().enumerate() {
            let at = |hours: i64| Timestamp::from_unix_ms(now().unix_ms() + hours * 3_600_000);
            let entry = TokenEntry {
                id: k.to_string(),
                name: "Ada".into(),
                role: Role::Viewer,
                may_clear: false,
                created_at: at(-30),
                expires_at: hours.map(at),
                revoked_at: None,
                last_used_at: None,
                issuer: Some("https://id.example.org".into()),
                subject: Some("17".into()),
            };
            tx.insert_token(&HashedToken { entry, sha256: vec![k as u8; 32] }).await.unwrap();
        }
        tx.commit().await.unwrap();
        let read = store.every_token().await.unwrap();
        let ids: Vec<_> = read.iter().map(|token| token.entry.id.as_str()).collect();
        assert_eq!(ids, ["0", "1", "3"]);
        assert_eq!(read[0].entry.subject.as_deref(), Some("17"));
        let window = crate::page::PageQuery::default().window(10).unwrap();
        assert_eq!(store.tokens(window).await.unwrap().items.len(), 4);
        let verified = store.verify_audit(None).await.unwrap();
        assert!(verified.others.is_empty() && verified.broken.is_none(), "{verified:?}");
    }
}
