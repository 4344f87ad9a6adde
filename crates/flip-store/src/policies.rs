//! Policies: the trained weights as bytes, and their metadata.

use super::artifacts::sha256_hex;
use super::labels::shown;
use super::page::{Page, Window};
use super::row::{Columns, json};
use super::{Error, Result, Store, Tx, now};
use flip_core::domain::conditions::Under;
use flip_core::domain::timestamp::Timestamp;
use serde::{Deserialize, Serialize};
use sqlx::any::AnyRow;

/// A trained policy. Never changes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Policy {
    /// Content address: `p-` and 16 hexadecimal digits.
    pub id: String,
    /// `learned`, `recurrent`, `fixed`, `schedule`, `dispenser`, `pid`,
    /// `fuzzy` or `paced`.
    pub kind: String,
    /// The training that made it.
    pub training: Option<String>,
    /// Settings, seed, parameter sets, curriculum history, versions.
    pub manifest: serde_json::Value,
    /// SHA-256 of the bytes, hexadecimal.
    pub sha256: String,
    /// Length of the bytes.
    pub size_bytes: u64,
    /// Mean absolute errors from evaluations in the base simulator, one entry for each powder
    /// weighed in any.
    pub evaluated: Vec<PolicyError>,
    /// When it was stored.
    pub created_at: Timestamp,
}

/// Evaluation results of a policy on one powder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PolicyError {
    /// Powder id.
    pub powder: String,
    /// Mean absolute error over all evaluated weighings of the powder, mg.
    pub mae_mg: f64,
    /// Number of those weighings.
    pub n: u32,
}

impl Store {
    /// Policies, newest first.
    pub async fn policies(&self, window: Window) -> Result<Page<Policy>> {
        let sql = concat!(
            "SELECT * FROM policy_card WHERE seq < $1 AND ",
            shown!("'policy'", "policy_card.id", "$3", "$4"),
            " ORDER BY seq DESC LIMIT $2"
        );
        let rows = self.rows_shown(sql, &window).await?;
        let mut page = window.page_of(&rows, policy)?;
        for policy in &mut page.items {
            policy.evaluated = self.policy_errors(&policy.id).await?;
        }
        Ok(page)
    }

    /// One policy.
    pub async fn policy(&self, id: &str) -> Result<Option<Policy>> {
        let row = sqlx::query("SELECT * FROM policy_card WHERE id = $1")
            .bind(id)
            .fetch_optional(&self.reader)
            .await?;
        let Some(row) = row else { return Ok(None) };
        Ok(Some(Policy { evaluated: self.policy_errors(id).await?, ..policy(&row)? }))
    }

    /// A policy's bytes, checked against its SHA-256.
    ///
    /// # Errors
    /// [`Error::Corrupt`] when they are not what was stored.
    pub async fn policy_bytes(&self, id: &str) -> Result<Option<Vec<u8>>> {
        let sql = "SELECT bytes, sha256 FROM policy WHERE id = $1";
        let found = sqlx::query(sql).bind(id).fetch_optional(&self.reader).await?;
        found.as_ref().map(|row| verified(id, row)).transpose()
    }

    /// The bytes of a network that a training kept, by their policy id, verified against their
    /// SHA-256; `None` without one.
    ///
    /// # Errors
    /// [`Error::Corrupt`] when they are not what was stored.
    pub async fn kept_policy(&self, id: &str) -> Result<Option<Vec<u8>>> {
        let sql = "SELECT bytes, sha256 FROM kept_policy WHERE id = $1 LIMIT 1";
        let found = sqlx::query(sql).bind(id).fetch_optional(&self.reader).await?;
        found.as_ref().map(|row| verified(id, row)).transpose()
    }

    /// The episodes whose networks these trainings kept, in order: training, number of the episode
    /// from 1, policy id.
    pub async fn kept_episodes(&self, trainings: &[&str]) -> Result<Vec<(String, u32, String)>> {
        let sql = "SELECT job, episode, id FROM kept_policy \
                   WHERE job IN (SELECT value FROM json_each($1)) ORDER BY job, episode";
        let rows = sqlx::query(sql).bind(json(&trainings)?).fetch_all(&self.reader).await?;
        rows.iter()
            .map(|row| Ok((row.plain("job")?, row.count("episode")?, row.plain("id")?)))
            .collect()
    }

    /// The policy with the smallest evaluated error on the powder under this version of the
    /// simulator and its conditions, or in the base; `None` unless `known`, which a rival has to
    /// beat, was evaluated on it there.
    pub async fn best_policy(
        &self,
        powder: &str,
        under: Option<&Under>,
        known: &str,
    ) -> Result<Option<String>> {
        let sql = "WITH here AS (SELECT policy, mae_mg, n FROM evaluation_row
                                 WHERE powder = $1 AND policy IS NOT NULL AND under IS NOT DISTINCT FROM $3)
                   SELECT policy FROM here WHERE EXISTS (SELECT 1 FROM here WHERE policy = $2)
                   GROUP BY policy ORDER BY sum(mae_mg * n) / sum(n), policy <> $2, policy LIMIT 1";
        let under = under.map(json).transpose()?;
        let best = sqlx::query_scalar(sql).bind(powder).bind(known).bind(under);
        Ok(best.fetch_optional(&self.reader).await?)
    }

    async fn policy_errors(&self, policy: &str) -> Result<Vec<PolicyError>> {
        let sql = "SELECT powder, sum(mae_mg * n) / sum(n) AS mae_mg, CAST(sum(n) AS BIGINT) AS n FROM evaluation_row \
                   WHERE policy = $1 AND under IS NULL GROUP BY powder ORDER BY powder";
        let rows = sqlx::query(sql).bind(policy).fetch_all(&self.reader).await?;
        let error = |row: &AnyRow| {
            Ok(PolicyError {
                powder: row.plain("powder")?,
                mae_mg: row.plain("mae_mg")?,
                n: row.count("n")?,
            })
        };
        rows.iter().map(error).collect()
    }
}

/// The bytes of a policy, if they are what was stored.
fn verified(id: &str, row: &AnyRow) -> Result<Vec<u8>> {
    let bytes: Vec<u8> = row.plain("bytes")?;
    match sha256_hex(&bytes) == row.plain::<String>("sha256")? {
        true => Ok(bytes),
        false => Err(Error::Corrupt(format!("policy {id} does not match its SHA-256"))),
    }
}

impl Tx {
    /// Store a policy. If another training has already produced the same bytes, the first row
    /// stays.
    pub async fn insert_policy(
        &mut self,
        id: &str,
        kind: &str,
        training: Option<&str>,
        manifest: &str,
        bytes: &[u8],
    ) -> Result<()> {
        let sql = "INSERT INTO policy (id, kind, training, manifest, bytes, sha256, created_at) \
                   VALUES ($1, $2, $3, $4, $5, $6, $7) ON CONFLICT (id) DO NOTHING";
        sqlx::query(sql)
            .bind(id)
            .bind(kind)
            .bind(training)
            .bind(manifest)
            .bind(bytes)
            .bind(sha256_hex(bytes))
            .bind(now().unix_ms())
            .execute(&mut *self.inner)
            .await?;
        Ok(())
    }

    /// Keep the network that played an episode of a training. `false`: it is kept already; a resumed
    /// training plays the episodes after its last checkpoint again.
    pub async fn insert_kept(
        &mut self,
        training: &str,
        episode: u32,
        id: &str,
        bytes: &[u8],
    ) -> Result<bool> {
        let sql = "INSERT INTO kept_policy (job, episode, id, bytes, sha256) \
                   VALUES ($1, $2, $3, $4, $5) ON CONFLICT DO NOTHING";
        let done = sqlx::query(sql)
            .bind(training)
            .bind(i64::from(episode))
            .bind(id)
            .bind(bytes)
            .bind(sha256_hex(bytes))
            .execute(&mut *self.inner)
            .await?;
        Ok(done.rows_affected() == 1)
    }
}

fn policy(row: &AnyRow) -> Result<Policy> {
    Ok(Policy {
        id: row.plain("id")?,
        kind: row.plain("kind")?,
        training: row.plain("training")?,
        manifest: row.json("manifest")?,
        sha256: row.plain("sha256")?,
        size_bytes: row.plain::<i64>("size_bytes")?.unsigned_abs(),
        evaluated: Vec::new(),
        created_at: row.time("created_at")?,
    })
}
