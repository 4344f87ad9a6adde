//! Policies.

use super::{App, Error, Result};
use flip_core::domain::FieldError;
use flip_policy as policy;
use flip_store::now;
use flip_store::page::{LIST_LIMIT_MAX, Page, PageQuery};
use flip_store::policies::Policy;
use serde_json::json;

impl App {
    /// Policies, newest first.
    pub async fn policies(&self, page: PageQuery) -> Result<Page<Policy>> {
        Ok(self.store().policies(page.window(LIST_LIMIT_MAX)?).await?)
    }

    /// One policy.
    pub async fn policy(&self, id: &str) -> Result<Policy> {
        self.store().policy(id).await?.ok_or_else(|| Error::not_found("policy", id))
    }

    /// A policy's safetensors, checked against its SHA-256.
    pub async fn policy_bytes(&self, id: &str) -> Result<Vec<u8>> {
        let found = self
            .store()
            .policy_bytes(id)
            .await
            .map_err(|error| Error::of_part("the file of this policy", error))?;
        found.ok_or_else(|| Error::not_found("policy", id))
    }

    /// Stores a policy that was trained elsewhere, and whether it is new here; `field` names the
    /// bytes in errors. It can be evaluated and weighed with like one that was trained here.
    ///
    /// # Errors
    /// `Invalid` if the bytes are not a policy.
    pub async fn import_policy(&self, field: &str, bytes: &[u8]) -> Result<(Policy, bool)> {
        let decoded =
            policy::decode(bytes).map_err(|error| FieldError::new(field, error.to_string()))?;
        let id = policy::id(bytes);
        if let Some(known) = self.store().policy(&id).await? {
            return Ok((known, false));
        }
        let manifest = serde_json::to_string(&decoded.manifest)
            .map_err(|error| Error::Internal(error.into()))?;
        let mut tx = self.store().write().await?;
        tx.insert_policy(&id, decoded.manifest.kind.name(), None, &manifest, bytes).await?;
        let said = json!({ "policy": id, "size_bytes": bytes.len() });
        tx.audit_deed(None, "policy imported", said, now()).await?;
        tx.commit().await?;
        Ok((self.policy(&id).await?, true))
    }
}
