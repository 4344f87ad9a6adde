//! Policies.

use super::{App, Result};
use crate::store::page::{Page, PageQuery};
use crate::store::policies::Policy;

impl App {
    /// Policies, newest first.
    pub async fn policies(&self, _page: PageQuery) -> Result<Page<Policy>> {
        self.stub()
    }

    /// One policy.
    pub async fn policy(&self, _id: &str) -> Result<Policy> {
        self.stub()
    }

    /// A policy's safetensors, checked against its SHA-256.
    pub async fn policy_bytes(&self, _id: &str) -> Result<Vec<u8>> {
        self.stub()
    }
}
