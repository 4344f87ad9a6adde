//! Policies.

use super::{App, Error, Result};
use flip_store::page::{LIST_LIMIT_MAX, Page, PageQuery};
use flip_store::policies::Policy;

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
}
